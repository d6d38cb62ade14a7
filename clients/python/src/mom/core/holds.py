"""The tokens that this client owns: their leases, and why they ended."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Dict, List, Optional, Set

from ..content import seconds
from ..errors import LostError, MomError, RefusedError
from ..events import is_within
from ..parcel import Parcel

if TYPE_CHECKING:
    from . import Core

_RENEW_AT = 3
"""A lease is renewed at this fraction of it, so that two renewals may fail."""


@dataclass(frozen=True)
class Lost:
    """Why an ownership ended, and who caused it."""

    reason: str
    """A word of docs/PROTOCOL.md, `disconnected` for a lost link, or the code of a refused renewal."""
    by: Optional[str] = None
    """The peer that caused it, if one did."""


@dataclass(frozen=True)
class Loan:
    """The terms of an ownership that another peer gave and that returns to it."""

    giver: str
    """The peer that gave it."""
    time: Optional[float] = None
    """Its duration in seconds from the grant on; `None` = unlimited."""
    commands: Optional[int] = None
    """Its number of guarded messages; `None` = unlimited."""


class Hold:
    """One ownership from a grab to its loss, or a part in a shared hold, which has the fence 0."""

    def __init__(self, path: str, fence: int, shared: bool) -> None:
        self.path, self.fence, self.shared = path, fence, shared
        self.lease: Optional[float] = None
        self.deadman: Optional[float] = None
        self.loan: Optional[Loan] = None
        self.guards = 0
        self.lost: asyncio.Future[Lost] = asyncio.get_running_loop().create_future()
        self.renewing: Optional[asyncio.Task[None]] = None
        self._command: Optional[int] = None
        """The last command that was said under it and of which no device has said how it ended, by its id."""
        self._done: asyncio.Event = asyncio.Event()
        self._done.set()

    def said(self, number: int) -> None:
        """A command is said under it."""
        self._command = number
        self._done.clear()

    def ended(self, number: int) -> None:
        """A command has ended, or will not be carried out."""
        if self._command == number:
            self._command = None
            self._done.set()

    async def done(self, within: float) -> bool:
        """Whether a device says in time how the last command ended, or it was refused or lost, or this is over."""
        done = asyncio.ensure_future(self._done.wait())
        # Whatever it is lost for, nothing is done under it any more.
        self.lost.add_done_callback(lambda _: self._done.set())
        try:
            await asyncio.wait([done], timeout=within)
        finally:
            done.cancel()
        return self._done.is_set()

    def read(self, grant: Dict[str, Any]) -> None:
        """Takes the terms of a grant."""
        self.lease, self.deadman = seconds(grant, "lease"), seconds(grant, "deadman")
        giver = grant.get("from")
        if isinstance(giver, str):
            self.loan = Loan(giver, seconds(grant, "for"), grant.get("commands"))

    def lose(self, reason: str, by: Optional[str] = None) -> None:
        """It is over."""
        if not self.lost.done():
            self.lost.set_result(Lost(reason, by))
        if self.renewing is not None and self.renewing is not asyncio.current_task():
            self.renewing.cancel()


class Handover:
    """An offer of a token to another peer, from the hub's confirmation to its end."""

    def __init__(self, path: str, to: str, delegated: bool, fence: int) -> None:
        self.path, self.to, self.delegated, self.fence = path, to, delegated, fence
        loop = asyncio.get_running_loop()
        self.outcome: asyncio.Future[str] = loop.create_future()
        """`taken`, or why it came to nothing."""
        self.back: asyncio.Future[Optional[Hold]] = loop.create_future()
        """The ownership that has returned; `None` = it does not return."""
        self.leaving = False

    def end(self, reason: str) -> None:
        """It came to nothing, or the token does not return."""
        if not self.outcome.done():
            self.outcome.set_result(reason)
        if not self.back.done():
            self.back.set_result(None)


class Holds:
    """All ownerships and offers of a client."""

    def __init__(self, core: Core) -> None:
        self._core = core
        self._owned: Dict[str, Hold] = {}
        self._shared: Dict[str, Hold] = {}
        self._handovers: List[Handover] = []
        self._withdrawing: Set[asyncio.Task[None]] = set()

    def of(self, path: str, shared: bool = False) -> Optional[Hold]:
        """The ownership of a token, if there is one."""
        return (self._shared if shared else self._owned).get(path)

    def ended(self, number: Optional[int]) -> None:
        """A command has ended, or will not be carried out."""
        for hold in self._owned.values():
            if number is not None:
                hold.ended(number)

    def granted(self, path: str, grant: Dict[str, Any], shared: bool = False, renew: bool = True) -> Hold:
        """Notes a grant; a repeated grab of one's own token is the same ownership."""
        known, fence = self._shared if shared else self._owned, 0 if shared else int(grant.get("fence") or 0)
        hold = known.get(path)
        if hold is None or hold.fence != fence:
            if hold is not None:
                hold.lose("grabbed")
            hold = known[path] = Hold(path, fence, shared)
        hold.read(grant)
        if renew:
            self.renew(hold)
        return hold

    def renew(self, hold: Hold) -> None:
        """Renews an ownership from now on, until it is over."""
        if hold.renewing is None and not hold.shared:
            hold.renewing = asyncio.ensure_future(self._renew(hold))

    async def _renew(self, hold: Hold) -> None:
        while not hold.lost.done():
            terms = [time for time in (hold.lease, hold.deadman) if time is not None]
            if not terms:
                return
            await asyncio.sleep(min(terms) / _RENEW_AT)
            try:
                reply = await self._core.ask("token", "renew", hold.path, timeout=max(min(terms), 1.0))
                hold.read(reply.map())
            except RefusedError as error:
                if error.wire.number < 100 or error.wire.number >= 200:
                    self.lose(hold, error.wire.code)
                    return
            except MomError:
                # Without a link it is lost anyway, and the next time may be in time.
                pass

    def lose(self, hold: Hold, reason: str, by: Optional[str] = None) -> None:
        """An ownership is over."""
        known = self._shared if hold.shared else self._owned
        if known.get(hold.path) is hold:
            del known[hold.path]
        hold.lose(reason, by)

    def lose_within(self, top: str, reason: str) -> None:
        """All ownerships in a context are over."""
        for hold in [*self._owned.values(), *self._shared.values()]:
            if is_within(hold.path, top):
                self.lose(hold, reason)
        for handover in [one for one in self._handovers if is_within(one.path, top)]:
            self._handovers.remove(handover)
            handover.end(reason)

    async def let_go(self, hold: Hold) -> None:
        """One guard less; the last one gives the token back."""
        hold.guards -= 1
        if hold.guards > 0 or hold.lost.done():
            return
        self.lose(hold, "released", self._core.peer)
        name = "uninhibit" if hold.shared else "release"
        await self._core.request(Parcel("token", name, hold.path, fence=hold.fence or None))

    def withdraw(self, path: str, grab: asyncio.Future[Parcel]) -> None:
        """Nobody waits for a grab any more: it leaves the queue, or the token is given back if it was granted meanwhile."""
        # Said at once, so that it does not withdraw a later grab.
        released = self._core.begin(Parcel("token", "release", path))
        task = asyncio.ensure_future(self._withdraw(path, grab, released))
        self._withdrawing.add(task)
        task.add_done_callback(self._withdrawing.discard)

    async def _withdraw(self, path: str, grab: asyncio.Future[Parcel], released: asyncio.Future[Parcel]) -> None:
        try:
            try:
                await released
            except LostError:
                # Without a fence it does not outlive a lost connection, as the grab does.
                fence, hold = (await grab).map().get("fence"), self._owned.get(path)
                if isinstance(fence, int) and (hold is None or hold.fence != fence):
                    await self._core.request(Parcel("token", "release", path, fence=fence))
        except MomError:
            # Then there is nothing to give back, or it is not this peer's any more.
            pass
        finally:
            grab.cancel()

    def offered(self, handover: Handover) -> None:
        """An offer was confirmed by the hub."""
        self._handovers.append(handover)

    def forget(self, handover: Handover) -> None:
        """An offer was refused by the hub."""
        self._handovers = [other for other in self._handovers if other is not handover]

    def heard(self, path: str, event: Parcel) -> None:
        """Applies an event about a token."""
        content = event.map()
        if event.name == "lapsed":
            self._lapsed(path, content)
            return
        if event.name == "uninhibited":
            hold = self._shared.get(path)
            if hold is not None and content.get("peer") == self._core.peer:
                self.lose(hold, str(content.get("reason", "")), content.get("by"))
            return
        fence, hold = content.get("fence"), self._owned.get(path)
        if not isinstance(fence, int):
            return
        for handover in [one for one in self._handovers if one.path == path]:
            self._turn(handover, event.name, fence, content)
        if hold is not None and event.name == "released" and hold.fence == fence:
            self.lose(hold, str(content.get("reason", "")), content.get("by"))
        elif hold is not None and event.name == "grabbed" and hold.fence < fence:
            self.lose(hold, "grabbed", content.get("owner"))

    def _lapsed(self, path: str, content: Dict[str, Any]) -> None:
        for handover in self._handovers:
            # A second offer to the same peer withdraws the first, so the oldest is meant.
            if handover.path == path and handover.to == content.get("to") and content.get("what") == "offer":
                self._handovers.remove(handover)
                handover.end(str(content.get("reason", "")))
                return

    def _turn(self, handover: Handover, name: str, fence: int, content: Dict[str, Any]) -> None:
        owner = content.get("owner")
        if name == "released" and fence == handover.fence and not handover.leaving:
            handover.leaving = content.get("reason") == "given"
            if not handover.leaving:
                self._handovers.remove(handover)
                handover.end("lost")
        elif name == "released" and handover.outcome.done() and fence == handover.fence:
            if content.get("reason") in ("preempted", "broken", "deleted"):
                # However else the other's ownership ends, the token comes back.
                self._handovers.remove(handover)
                handover.end("lost")
        elif name == "grabbed" and handover.leaving and not handover.outcome.done():
            handover.fence = fence
            if owner == handover.to:
                handover.outcome.set_result("taken")
            if owner != handover.to or not handover.delegated:
                self._handovers.remove(handover)
                handover.end("lost")
        elif name == "grabbed" and handover.outcome.done() and fence > handover.fence:
            self._handovers.remove(handover)
            if owner != self._core.peer:
                handover.end("lost")
            elif not handover.back.done():
                # It is renewed once a caller wants it.
                handover.back.set_result(self.granted(handover.path, content, renew=False))
