"""The state of the link, and the delays before reconnecting."""

from __future__ import annotations

import random
from dataclasses import dataclass
from typing import Optional

from .errors import WireError

_LAST_ATTEMPT = 0.5
"""From so many seconds before the end of the grace time on, at most, each wait is half of what is left of it."""

_SHORTEST_WAIT = 0.05
"""… but no less than this."""


@dataclass(frozen=True)
class LinkState:
    """The state of the link to the hub.

    | `word` | |
    |---|---|
    | `trying` | connecting and logging in, at first or after all was lost |
    | `connected` | logged in |
    | `stale` | connected, but nothing was heard for one and a half times the heartbeat |
    | `resuming` | the connection is lost, and nothing else yet: another one is tried |
    | `closed` | closed for good |
    """

    word: str
    """One of the words above."""
    attempt: int = 0
    """How many attempts have failed, while `trying` and `resuming`."""
    door: Optional[str] = None
    """The address of the door, while `connected` and `stale`."""
    error: Optional[WireError] = None
    """Why it is `closed`, or why the last attempt failed, if the hub said so."""


@dataclass(frozen=True)
class Reconnect:
    """The delays before attempts to connect: at random from 0 to a bound (full jitter), which doubles with each."""

    first: float = 0.1
    """The first bound, in seconds."""
    most: float = 30.0
    """The greatest bound."""
    give_up_after: Optional[float] = None
    """The client is closed when attempts have failed for so long; `None` = never."""

    def delay(self, attempt: int, at_least: Optional[float] = None, grace: float = 0.0, left: float = 0.0) -> float:
        """The delay before this attempt, from 0; no less than what the hub asked for.

        While a link can be resumed, which is for `left` seconds of its `grace`, several attempts fall into that, and more of
        them just before its end.
        """
        bound = min(self.most, self.first * 2 ** min(attempt, 32))
        last = left - min(_LAST_ATTEMPT, grace / 8)
        if last > 0:
            wait = min(random.uniform(0, min(bound, grace / 4)), last)
        elif left > _SHORTEST_WAIT:
            wait = max(left / 2, _SHORTEST_WAIT)
        else:
            wait = random.uniform(0, bound)
        return max(wait, at_least or 0.0)
