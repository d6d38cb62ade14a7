"""Driving a device under its token, from the grab to the end of a block."""

from __future__ import annotations

import logging
from types import TracebackType
from typing import Any, Dict, Optional, Type, Union

from ..client import Client
from ..errors import RefusedError
from ..proxies import TokenGuard
from .commander import Commander
from .end import DriveError

LOG = logging.getLogger("mom")


class Driving:
    """A device to be driven: `async with mom.drive.driving(client, "/robot/arm") as arm:`."""

    def __init__(self, client: Client, path: str, wait: Union[None, float, str], guard: Optional[TokenGuard]) -> None:
        self._client, self._path, self._wait, self._owned = client, path, wait, guard
        self._guard: Optional[TokenGuard] = None
        self._commander: Optional[Commander] = None

    async def __aenter__(self) -> Commander:
        channel = await self._client.channel(self._path)
        known = channel.gate.guard
        if known is None:
            raise DriveError(f"no token guards {self._path}, so it cannot be owned")
        # Before the token: what the device says to its new owner is to be heard.
        events = channel.events()
        try:
            card = await self._card()
            guard = self._owned
            if guard is None:
                guard = await (await self._client.token(known.token)).grab(self._wait)
            self._guard, self._commander = guard, Commander(channel, guard, card=card, events=events)
        except BaseException:
            events.close()
            raise
        return self._commander

    async def _card(self) -> Optional[Dict[str, Any]]:
        try:
            return await self._client.card(self._path)
        except RefusedError as error:
            # Without it a relative command has to say so, and no more.
            LOG.debug("%s: no card: %s", self._path, error)
            return None

    async def __aexit__(
        self, kind: Optional[Type[BaseException]], error: Optional[BaseException], trace: Optional[TracebackType]
    ) -> None:
        commander, guard = self._commander, self._guard
        if commander is None or guard is None:
            return
        if guard.is_lost:
            # The hub has halted the device, and another one may drive it by now.
            commander.close()
            return
        try:
            if commander.is_closed:
                # By the block itself: then nobody hears how the device takes it.
                await guard.release()
            else:
                await commander.end(guard.release)
        except DriveError as failure:
            # What went wrong inside is told as it is.
            if error is None:
                raise
            if isinstance(error, DriveError):
                error.at_end = failure
            LOG.error("%s: %s", self._path, failure)


def driving(
    client: Client, path: str, *, wait: Union[None, float, str] = None, guard: Optional[TokenGuard] = None
) -> Driving:
    """Drives the device of a channel for a block: `async with mom.drive.driving(client, "/robot/arm") as arm:` gives a `Commander`.

    It joins the channel, and grabs the token that guards it: at once, or after `wait` seconds in its queue at most (`mom.UNLIMITED`: as
    long as it takes). With a `guard` the token is owned already, such as one that was accepted. Leaving the block gives the token back
    and hears that the device has ended what runs. If the token is lost before, the command under way ends with words that say why, and
    so does each later one, of which nothing is sent.

    Raises `RefusedError` for a refused join or grab, and `DriveError` where no token guards the channel; at the end of the block
    `DriveError` where the token was not taken back, or the device was stopped or is silent, unless the block raises something itself:
    then that is logged.
    """
    return Driving(client, path, wait, guard)
