"""The check of fences on the device's side."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, List, Mapping, Optional

from .errors import MomError
from .parcel import Parcel


@dataclass(frozen=True)
class GuardState:
    """The last known state of the token that guards a channel."""

    token: str
    """The token's path."""
    names: List[str]
    """The messages that need it; `*` stands for all."""
    owner: Optional[str]
    """The peer that owns it now."""
    fence: int
    """The highest fence heard of."""

    def covers(self, name: str) -> bool:
        """Whether messages of this name need the token. `stop`, `unstop` and `halt` never do."""
        return name not in ("stop", "unstop", "halt") and (name in self.names or "*" in self.names)


class StaleError(MomError):
    """A guarded message that was not sent by the token's present owner."""


class FenceGate:
    """Refuses messages of earlier owners of a device's token.

    The hub refuses such messages too, but only the device can refuse those that were on their way when the token changed
    hands. A channel's gate learns owner and fence from the join's reply and from the token's events, before any of them
    reaches `Events`. Fences never fall.
    """

    def __init__(self) -> None:
        self.guard: Optional[GuardState] = None
        """The last known guard; `None` = the channel is not guarded."""

    def check(self, parcel: Parcel) -> None:
        """Passes what may be obeyed now; raises `StaleError` for all else."""
        if parcel.sender == "hub" and parcel.fence is None:
            return
        guard = self.guard
        if guard is None or not guard.covers(parcel.name):
            return
        if guard.owner is None or parcel.fence != guard.fence:
            raise StaleError(
                f"{parcel.name} is stale: its fence is {parcel.fence}, that of {guard.owner or 'nobody'} is {guard.fence}"
            )

    def joined(self, reply: Mapping[str, Any]) -> None:
        """Learns from the content of the reply to a join."""
        told, known = _read(reply.get("guard")), self.guard
        if told and known and told.token == known.token and told.fence < known.fence:
            # A hub with older fences must not make old commands valid again.
            told = replace(told, owner=None, fence=known.fence)
        self.guard = told

    def observe(self, event: Parcel) -> None:
        """Learns from `grabbed` and `released` of the guarding token."""
        guard, content = self.guard, event.map()
        fence, owner = content.get("fence"), content.get("owner")
        if guard is None or event.context != guard.token or not isinstance(fence, int):
            return
        if event.name == "grabbed" and fence > guard.fence:
            self.guard = replace(guard, fence=fence, owner=owner if isinstance(owner, str) else None)
        elif event.name == "released" and fence >= guard.fence:
            self.guard = replace(guard, fence=fence, owner=None)

    def forget_owner(self) -> None:
        """Nobody is known to own the token until the channel is joined again."""
        if self.guard:
            self.guard = replace(self.guard, owner=None)


def _read(guard: Any) -> Optional[GuardState]:
    if not isinstance(guard, dict) or not isinstance(guard.get("token"), str):
        return None
    names = [name for name in guard.get("names") or [] if isinstance(name, str)]
    return GuardState(guard["token"], names, guard.get("owner"), guard.get("fence") or 0)
