"""What waits to be sent: one parcel, and its row of the table "What overtakes, replaces, outlives" in docs/PROTOCOL.md."""

from __future__ import annotations

import asyncio
from typing import Any, Callable, Optional, Tuple

from . import binary
from .connection import Pieces
from .events import is_within
from .parcel import Parcel

STOP, LIFE, AGAIN, CONTROL, DATA = range(5)
"""The lanes, in the order in which they leave: stops, signs of life, what is sent again, control, messages."""


class Entry:
    """A parcel that waits, or that was sent and is not acknowledged."""

    def __init__(
        self,
        parcel: Parcel,
        delivery: str = "reliable",
        token: Optional[str] = None,
        answer: Optional[asyncio.Future[Any]] = None,
        now: Optional[float] = None,
    ) -> None:
        self.parcel = parcel
        self.body = binary.encode(parcel)
        self.size = len(self.body)
        self.delivery = delivery
        """The class, that of the channel where the parcel names none."""
        self.token = token
        """The token that guards it: then it is valid only under the ownership under which it was said."""
        self.answer = answer
        """Where its sender waits for the answer."""
        self.counted = parcel.family != "time"
        """Whether it counts for the link."""
        self.is_stop = parcel.is_("message", "stop")
        self.is_unstop = parcel.is_("message", "unstop")
        self.addressees = frozenset(parcel.address) if parcel.address else None
        """Whom it is for, in no order; `None` = all members."""
        self.key = parcel.family, parcel.context, parcel.name, self.addressees
        """What it has in common with those that may replace it."""
        self.lane = _lane(parcel)
        self.priority = (parcel.priority or 0) if self.lane == DATA else 0
        self.number = 0
        """Its place among those of equal urgency."""
        self.deadline: Optional[float] = None
        """When it is worthless, by the clock of `now`. A stop does not grow old."""
        if parcel.expires is not None and now is not None and not self.is_stop:
            self.deadline = now + parcel.expires / 1000
        self.perishes = token is not None or _perishes(parcel)
        """Whether it is meant for the moment, and so dropped at a loss of the connection, wherever it is."""
        self.outlives = not self.perishes and (delivery == "reliable" or self.is_stop)
        """Whether it is sent again after a loss of the connection, if it had left and was not read."""
        self.pieces: Optional[Pieces] = None
        """What is left of it, once some of it is sent."""
        self.follows = _follows(parcel)
        """Which messages that were said before it waits behind; what is said after it does not overtake it. `None` = none."""

    @property
    def rank(self) -> Tuple[int, int]:
        """Lower leaves sooner."""
        return self.lane, -self.priority

    def __lt__(self, other: Entry) -> bool:
        return (self.rank, self.number) < (other.rank, other.number)

    @property
    def needs_room(self) -> bool:
        """Whether it may have to wait until others have left."""
        return not self.is_stop and not self.is_unstop

    @property
    def is_whole(self) -> bool:
        """Whether it is never cut: a stop must not wait for its own end, and half an unstop could not be withdrawn."""
        return self.lane == STOP or self.is_unstop

    @property
    def is_awaited(self) -> bool:
        """Whether its sender waits for the answer."""
        return self.answer is not None and not self.answer.done()

    def overlaps(self, other: Entry) -> bool:
        """Whether some peer is meant by both, in the same context."""
        mine, theirs = self.addressees, other.addressees
        return self.parcel.context == other.parcel.context and (mine is None or theirs is None or bool(mine & theirs))

    def passes(self, other: Entry) -> bool:
        """Whether it does not wait for another one that waits behind messages.

        A renewal does not: an owner that lets go something else goes on owning its token.
        """
        if not self.parcel.is_("token", "renew") or other.parcel.family == "login":
            return False
        return other.parcel.family != "token" or other.parcel.context != self.parcel.context

    def begin_anew(self) -> None:
        """The connection that took some of it is lost."""
        self.pieces = None

    def leave_again(self) -> None:
        """It was sent and not read: it leaves before all that was not sent; a stop before that."""
        self.begin_anew()
        if self.lane != STOP:
            self.lane, self.priority = AGAIN, 0


def _lane(parcel: Parcel) -> int:
    if parcel.family in ("message", "context") and parcel.name == "stop":
        return STOP
    if parcel.family == "message" and parcel.name != "unstop":
        return DATA
    return LIFE if parcel.family == "time" else CONTROL


def _perishes(parcel: Parcel) -> bool:
    if parcel.family in ("message", "context") and parcel.name == "unstop" or parcel.is_("message", "command"):
        return True
    if parcel.is_("token", "release"):
        # With a fence it can end no other ownership than the one that was meant.
        return parcel.fence is None
    return _hands_over(parcel)


def _hands_over(parcel: Parcel) -> bool:
    if parcel.family != "token":
        return False
    # With a peer it is the owner who accepts a request; without, a peer accepts the owner's offer.
    return parcel.name in ("give", "inhibit") or parcel.name == "accept" and "peer" in parcel.map()


def _follows(parcel: Parcel) -> Optional[Callable[[Entry], bool]]:
    path = parcel.context or "/"
    if parcel.is_("message", "unstop"):
        return lambda other: other.parcel.context == path
    if parcel.is_("token", "release") or _hands_over(parcel):
        return lambda other: other.token == path
    if parcel.family == "context" and parcel.name in ("leave", "delete", "unstop"):
        return lambda other: is_within(other.parcel.context or "/", path)
    if parcel.is_("login", "logout"):
        return lambda other: True
    return None
