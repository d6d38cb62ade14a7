"""Whether the device rests: measured, not meant."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, List, Mapping, Optional, Sequence

REST = 300_000
"""Measurements that differ by less than the tolerance over so long, in µs, are those of a device at rest."""

_LOOK = 50_000
"""µs between two looks at a device that may be coming to rest."""

_HEADING = "heading"
"""The key of a position that is an angle, degrees."""

MEASURED, NOT_MEASURED = "measured", "not-measured"


@dataclass(frozen=True)
class Sample:
    """What is measured of the device at one time: each number of its position, always in the same order."""

    values: Sequence[float]
    at: int
    """When it was measured, at the earliest."""
    until: Optional[int] = None
    """And at the latest, such as when it came; `None` = `at`."""

    @staticmethod
    def of(position: Mapping[str, Any], at: int) -> Optional[Sample]:
        """Of a position; `None` if that has no number."""
        values: List[float] = []
        for key, value in position.items():
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                continue
            if key == _HEADING and math.isfinite(value):
                # Degrees that go on from 359 at 0: on a circle on which a small turn is as long as its angle.
                angle = math.radians(value)
                values += [math.degrees(math.sin(angle)), math.degrees(math.cos(angle))]
            else:
                values.append(float(value))
        return Sample(values, at) if values else None

    @property
    def latest(self) -> int:
        """When it was measured, at the latest."""
        return self.at if self.until is None else max(self.until, self.at)

    def is_finite(self) -> bool:
        """Whether all of it are numbers."""
        return all(map(math.isfinite, self.values))

    def is_near(self, other: Sample, tolerance: float) -> bool:
        """Whether it has moved by less than this, all numbers together: a turn must not hide behind two that change a little less each."""
        if len(self.values) != len(other.values):
            return False
        return math.hypot(*(one - there for one, there in zip(self.values, other.values))) < tolerance


class Rest:
    """Watches a device come to rest. What was measured before it was to stand is worth nothing."""

    def __init__(self, tolerance: float, stopping_time: int) -> None:
        self._tolerance, self._stopping_time = tolerance, stopping_time
        self._since: Optional[int] = None
        """When something moved it last, or it was to stand; `None` before it was looked at."""
        self._first: Optional[Sample] = None
        """The first of the measurements that differ by less than the tolerance."""
        self.known: Optional[str] = None
        """How it is known that it rests, `measured` or `not-measured`, if it is."""

    def disturb(self, now: int) -> None:
        """Something moves it, or may: that it rests is to be found out anew."""
        self._since, self._first, self.known = now, None, None

    def observe(self, sample: Optional[Sample], now: int) -> None:
        """Takes in what is measured now; without a measurement its stopping time is waited for."""
        if self._since is None:
            self._since = now
        # What is not a number is not a measurement.
        if sample is None or not sample.is_finite():
            self._first = None
            self.known = NOT_MEASURED if now - self._since >= self._stopping_time else None
            return
        if sample.at < self._since:
            return
        first = self._first
        if first is None or not sample.is_near(first, self._tolerance):
            self._first, self.known = sample, None
        elif sample.at - first.latest >= REST:
            self.known = MEASURED
        elif self.known != MEASURED:
            # It is not known yet, or was before it measured.
            self.known = None

    def next_look(self, now: int) -> Optional[int]:
        """When it is to be looked at next; `None` once it rests."""
        return now + _LOOK if self.known is None else None
