"""The way out to the hub: one parcel after the other, in order, over lost links too."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from typing import Awaitable, Callable, Deque, List, Optional

from ..errors import ClosedError, ConnectionDownError, LocalError, MomError, RefusedError
from ..parcel import Parcel

LOG = logging.getLogger("mom")

_MOST = 4096
"""The most parcels that are held back; a whole queue of commands that ends at once is far below."""


class Outlet:
    """Sends what waits, beside the device's own work, so that a slow link holds up neither motion nor halts.

    While the link is down everything is held back that has to be said all the same: a sender of a command wants to hear how it ended.
    """

    def __init__(
        self,
        send: Callable[[Parcel], Awaitable[object]],
        may_send: Callable[[], bool],
        is_wanted: Callable[[Parcel], bool],
        is_mute: Callable[[Exception], None] = lambda error: None,
    ) -> None:
        self._send, self._may_send, self._is_wanted, self._is_mute = send, may_send, is_wanted, is_mute
        """The last one is called with why a state cannot be said."""
        self._held: Deque[Parcel] = deque()
        self._sending: Optional[asyncio.Future[None]] = None

    def push(self, out: List[Parcel]) -> None:
        """Takes what is to be sent, and goes on sending if that can be done now."""
        for parcel in out:
            if parcel.delivery == "latest":
                # The newer one goes to the end, not to the older one's place: it must not overtake what led to it.
                self._held = deque(older for older in self._held if not _replaces(parcel, older))
            if parcel.name == "stop":
                # The device has stopped itself: that is said before all else.
                self._held.appendleft(parcel)
            else:
                self._held.append(parcel)
        if len(self._held) > _MOST:
            LOG.warning("the link is too slow; %d messages of a device were dropped", len(self._held) - _MOST)
            while len(self._held) > _MOST:
                self._held.popleft()
        if self._held and self._sending is None and self._may_send():
            self._sending = asyncio.ensure_future(self._work())

    async def flush(self) -> None:
        """Waits until all that waits was sent, as far as that can be done now."""
        if self._sending is not None:
            await asyncio.wait([self._sending])

    async def _work(self) -> None:
        try:
            while self._held and self._may_send():
                parcel = self._held.popleft()
                if self._is_wanted(parcel):
                    await self._say(parcel)
        finally:
            self._sending = None

    async def _say(self, parcel: Parcel) -> None:
        try:
            await self._send(parcel)
        except ConnectionDownError:
            # A state is told anew when the link is back; all else has to be said later.
            if parcel.delivery != "latest":
                self._held.appendleft(parcel)
        except ClosedError as error:
            LOG.warning("a message of a device was not sent: %s", error)
        except asyncio.CancelledError:
            raise
        except Exception as error:
            LOG.warning("a message of a device was not sent: %s", error, exc_info=not isinstance(error, MomError))
            if parcel.name == "state" and isinstance(error, (LocalError, RefusedError)):
                # It would go on obeying, and nobody would know how it stands.
                self._is_mute(error)


def _replaces(newer: Parcel, older: Parcel) -> bool:
    """Whether a newer state makes an older one useless."""
    return older.delivery == "latest" and (older.name, older.address) == (newer.name, newer.address)
