"""The device's side of stops: what holds, by the order of causes, and what it waits for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, Optional

from .content import text
from .events import Event, Lagged, LinkDown, Message, Stops
from .stops import StopState


@dataclass(frozen=True)
class Reaction:
    """What a device does about an event.

    | `word` | |
    |---|---|
    | `stop` | it halts, and moves no more until it is told so |
    | `free` | it may move again |
    | `halt` | it halts; the next command moves it again, as soon as it may move |
    | `same` | it was told of stops, and nothing changes: it says how it stands |
    """

    word: str
    """One of the words above."""
    why: str = ""
    """Of a `stop`: why, for people."""


@dataclass(frozen=True)
class Held:
    """Why a device may not move."""

    word: str
    """`stopped`: somebody has stopped it; `own`: it has stopped itself, and the hub has not given that a number yet; `unknown`: it
    has not heard on this connection how it stands."""
    text: str
    """The same for people."""


_UNKNOWN = Held("unknown", "the hub has not said yet whether it is stopped")


class Latch:
    """Whether a device may move, by what it has heard: fed with the events of its channel in their order.

    Every stop has a number that only rises. An unstop below the newest stop frees nobody, whichever way it came. A device moves
    nothing before it has heard on this connection how it stands, and a gap in its events counts as a stop of its own, because it
    may have contained one.
    """

    def __init__(self) -> None:
        self._number, self._lifted = 0, 0
        self._held: Optional[Held] = None
        self._known = False

    def observe(self, event: Event) -> Optional[Reaction]:
        """Takes in an event of the device's channel; gives what it means for the device."""
        if isinstance(event, Message) and event.name == "stop":
            return self._stop(event)
        if isinstance(event, Message) and event.name == "unstop":
            return self._unstop(event.stop)
        if isinstance(event, Stops):
            return self._learn(event.state)
        if isinstance(event, Lagged):
            return self.stop_itself(f"it has missed {event.lost} events")
        if isinstance(event, LinkDown):
            return self.lose()
        return None

    def may_move(self) -> Optional[Held]:
        """Why the device may not move; `None` if it may."""
        return self._held or (None if self._known else _UNKNOWN)

    @property
    def number(self) -> int:
        """The newest stop that it has heard of: the key `stop` of its states."""
        return self._number

    @property
    def is_stopped(self) -> bool:
        """Whether a stop holds."""
        return self._held is not None

    @property
    def is_own(self) -> bool:
        """Whether it has stopped itself and the hub does not know: it says `stop` with itself as the only address."""
        return self._held is not None and self._held.word == "own"

    def stop_itself(self, why: str) -> Reaction:
        """Stops by itself, until a peer lifts that."""
        self._held = self._held or Held("own", f"stopped by itself: {why}")
        return Reaction("stop", why)

    def lose(self) -> Reaction:
        """The connection is lost, whether it will be resumed or not."""
        self._known = False
        return Reaction("halt")

    def word(self) -> Dict[str, Any]:
        """What it says of itself when it joins."""
        return {"stop": self._number, "stopped": self._held is not None and self._held.word == "stopped"}

    def _stop(self, event: Message) -> Reaction:
        content: Dict[str, Any] = event.parcel.map()
        # So it tells a device that has come back how it stands.
        self._known = self._known or event.sender == "hub"
        reason = text(content, "reason") or (event.content if isinstance(event.content, str) else "")
        number = self._number if event.stop is None else event.stop
        return self._take(number, text(content, "by") or event.sender, reason)

    def _take(self, number: int, by: Optional[str], reason: Optional[str]) -> Reaction:
        self._number = max(self._number, number)
        if 0 < number <= self._lifted:
            # It was lifted before it came: the cause is an old one. To halt is never wrong.
            return Reaction("halt")
        self._held = Held("stopped", f"stopped by {by or 'a peer'}" + (f": {reason}" if reason else ""))
        return Reaction("stop", self._held.text)

    def _unstop(self, up_to: Optional[int]) -> Reaction:
        # Hubs that give stops no numbers name none. What it has stopped for itself has a higher number, which has not come yet.
        lifts = up_to is None or (not self.is_own and up_to >= self._number)
        self._lifted = max(self._lifted, up_to or 0)
        if not lifts or self._held is None:
            return Reaction("same")
        self._held = None
        return Reaction("free")

    def _learn(self, state: StopState) -> Optional[Reaction]:
        if state.stopped and (state.only or state.excepted):
            # Of others: what concerns this device comes by a message.
            return None
        self._known = True
        return self._take(state.number, state.by, state.reason) if state.stopped else self._unstop(state.number)
