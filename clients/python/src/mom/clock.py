"""The hub's clock, measured over the link, and the age of parcels."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass
from datetime import datetime
from functools import reduce
from typing import Any, Callable, Deque, Dict, NamedTuple, Optional, Tuple

from .parcel import Parcel
from .values import from_micros, now, to_micros

_WINDOW, _QUICK = 16, 4
_DRIFT = 100
"""The greatest drift between two clocks, in millionths."""


class _Bounds(NamedTuple):
    """The offset of the other clock lies between these, at this time of the monotonic clock; all in µs."""

    low: int
    high: int
    at: int

    def later(self, at: int) -> _Bounds:
        parted = -(-max(at - self.at, 0) * _DRIFT // 1_000_000)
        return _Bounds(self.low - parted, self.high + parted, max(self.at, at))

    def both(self, other: _Bounds) -> Optional[_Bounds]:
        at = max(self.at, other.at)
        one, two = self.later(at), other.later(at)
        low, high = max(one.low, two.low), min(one.high, two.high)
        return _Bounds(low, high, at) if low <= high else None


class OffsetEstimator:
    """How far another clock is ahead, from the stamps of pings and pongs.

    A parcel is sent before it arrives: with `sent` and `heard` by one's own clock, `received` and `replied` by the other,
    the offset lies between `replied - heard` and `received - sent`. Several exchanges are intersected; one that
    contradicts the others shows that a clock was set, and counts alone from then on.
    """

    def __init__(self) -> None:
        self._window: Deque[_Bounds] = deque(maxlen=_WINDOW)
        self._agreed: Optional[_Bounds] = None

    def push(self, sent: int, received: int, replied: int, heard: int, at: int) -> bool:
        """Takes the four stamps of an exchange, in µs; whether it could be used."""
        doubt = 1 - (-max(heard - sent, 0) * _DRIFT // 1_000_000)
        bounds = _Bounds(replied - heard - doubt, received - sent + doubt, at)
        if not (sent <= heard and received <= replied and bounds.low <= bounds.high):
            return False
        if self._agreed is not None and self._agreed.both(bounds) is None:
            self._window.clear()
        self._window.append(bounds)
        self._agreed = reduce(lambda one, other: one.both(other) or other, self._window)
        return True

    def at(self, micros: int) -> Optional[Tuple[int, int]]:
        """The offset and its error bound at a time of the monotonic clock; `None` before the first exchange."""
        if self._agreed is None:
            return None
        bounds = self._agreed.later(micros)
        width = bounds.high - bounds.low
        return bounds.low + width // 2, -(-width // 2)

    def __len__(self) -> int:
        return len(self._window)


@dataclass(frozen=True)
class Age:
    """How long ago something was created, as its receiver sees it now."""

    seconds: float
    """Below 0 at most by the error."""
    error: Optional[float]
    """The error bound in seconds; `None` = the age counts from the arrival at the hub, as the sender's clock is unknown."""


class HubClock:
    """The hub's clock, measured by the link's own pings. Setting the wall clock does not disturb it."""

    def __init__(self, wall: Callable[[], datetime] = now) -> None:
        self._wall = wall
        self._anchor, self._start = to_micros(wall()), time.monotonic_ns()
        self._estimator = OffsetEstimator()
        self._asked: Optional[Tuple[int, int]] = None
        self.expired = 0
        """How many messages were not delivered because they had expired."""

    def now(self) -> Optional[Tuple[datetime, float]]:
        """The hub's time now, and its error bound in seconds; `None` before the first exchange of a connection."""
        offset = self._estimator.at(self._elapsed())
        return None if offset is None else (from_micros(self._own() + offset[0]), offset[1] / 1e6)

    def age(self, parcel: Parcel) -> Optional[Age]:
        """How old a parcel is now; `None` while the hub's clock is unknown, and for parcels that it did not stamp."""
        offset = self._estimator.at(self._elapsed())
        if offset is None or parcel.received is None:
            return None
        micros = self._own() + offset[0] - to_micros(parcel.received) + (parcel.age or 0)
        error = None if parcel.age_error is None else (parcel.age_error + offset[1]) / 1e6
        return Age(micros / 1e6, error)

    def is_expired(self, parcel: Parcel) -> bool:
        """Whether a message has expired, as far as is known. A stop never does."""
        if parcel.expires is None or parcel.is_("message", "stop"):
            return False
        age = self.age(parcel)
        return age is not None and age.seconds * 1000 >= parcel.expires

    def _elapsed(self) -> int:
        return (time.monotonic_ns() - self._start) // 1000

    def _own(self) -> int:
        return self._anchor + self._elapsed()

    def _ask(self, number: int) -> Dict[str, Any]:
        """The content of a ping that is sent now."""
        self._asked = (number, self._own())
        return {"sent": self._wall()}

    def _answer(self) -> Dict[str, Any]:
        """The content of a pong."""
        return {"received": self._wall(), "sent": self._wall()}

    def _answered(self, pong: Parcel) -> bool:
        """Learns from a pong; whether to ask again at once."""
        heard, asked, content = self._own(), self._asked, pong.map()
        if asked is None or pong.reference != asked[0]:
            return False
        self._asked = None
        received, replied = content.get("received"), content.get("sent")
        if not isinstance(received, datetime) or not isinstance(replied, datetime):
            return False
        used = self._estimator.push(asked[1], to_micros(received), to_micros(replied), heard, self._elapsed())
        return used and len(self._estimator) < _QUICK

    def _forget(self) -> None:
        """Starts over with another hub process: its clock may be another."""
        self._estimator, self._asked = OffsetEstimator(), None
