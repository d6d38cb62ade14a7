"""How the devices of channels stand, and what came of stopping them and of letting them go."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any, Dict, List, Mapping, Optional

from .content import maps, names, number, text


@dataclass(frozen=True)
class StopState:
    """How the devices of a channel stand by the hub's books, or how one of them does."""

    number: int = 0
    """The number of the newest stop, which an unstop names; 0 before the first."""
    stopped: bool = False
    """Whether a stop holds."""
    by: Optional[str] = None
    """The peer that said it."""
    user: Optional[str] = None
    """That peer's user."""
    since: Optional[datetime] = None
    """Since when."""
    reason: Optional[str] = None
    """Why, in that peer's words."""
    only: List[str] = field(default_factory=list)
    """The devices that are stopped, if it is not all of the channel."""
    excepted: List[str] = field(default_factory=list)
    """Devices that were let go by name while all others are stopped (`except` on the wire)."""

    @staticmethod
    def of(content: Any) -> StopState:
        """Reads what the hub tells of stops; where it tells nothing, nothing was ever stopped."""
        found: Dict[str, Any] = content if isinstance(content, dict) else {}
        since = found.get("since")
        return StopState(
            number(found, "number") or 0,
            found.get("stopped") is True,
            text(found, "by") or None,
            text(found, "user") or None,
            since if isinstance(since, datetime) else None,
            text(found, "reason") or None,
            names(found, "only"),
            names(found, "except"),
        )


@dataclass(frozen=True)
class DeviceAnswer:
    """What a device said to a stop or an unstop."""

    peer: str
    """Its name at the hub."""
    word: str
    """`stopped` or `unstopped`: it obeys; `silent`: nothing in time; `lost`: its connection is, and it finds the stop when it comes back."""

    rest: Optional[str] = None
    """How it knows that it rests: `measured`, or `not-measured`; `None`: it does not know yet, or says nothing of it."""
    moving: bool = False
    """It obeys and moves still, or does not know that it does not."""
    reached: bool = True
    """Whether it can tell its mechanism what to do."""
    estop: bool = False
    """An emergency stop at the device itself is pressed: an `unstop` does not let it go."""

    @property
    def obeys(self) -> bool:
        """Whether it has said that it obeys, and not that it still moves."""
        return self.word in ("stopped", "unstopped") and not self.moving and self.reached

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> DeviceAnswer:
        """What a reply says of one device."""
        flag = content.get
        return cls(
            text(content, "peer"),
            text(content, "word") or "silent",
            text(content, "rest") or None,
            flag("moving") is True,
            flag("reached") is not False,
            flag("estop") is True,
        )


@dataclass(frozen=True)
class ToldChannel:
    """One channel that was told."""

    path: str
    """Which."""
    number: int
    """The number of the stop, or of the newest one that the unstop was to lift."""
    guarded: bool
    """Whether a device is meant to be there: a token guards it, or one was there before."""
    kept: bool
    """Whether the hub knows of it after a restart."""
    devices: List[DeviceAnswer]
    """What each device said."""
    newer: List[StopState]
    """Newer stops, which hold on: the unstop did not lift them."""
    error: Optional[str] = None
    """Why the unstop was not handed out."""

    @staticmethod
    def of(content: Dict[str, Any]) -> ToldChannel:
        """Reads one of the hub's list."""
        devices = [DeviceAnswer.of(one) for one in maps(content, "devices")]
        newer = [
            replace(StopState.of(one), stopped=True, only=[one["device"]] if text(one, "device") else [])
            for one in maps(content, "newer")
        ]
        return ToldChannel(
            text(content, "path"),
            number(content, "number") or 0,
            content.get("guard") is True,
            content.get("kept") is True,
            devices,
            newer,
            text(content, "error") or None,
        )

    @property
    def is_obeyed(self) -> bool:
        """Whether every device of it has said that it obeys, and none still moves; a guarded channel has one at least."""
        obeys = all(device.obeys for device in self.devices) and (bool(self.devices) or not self.guarded)
        return obeys and not self.newer and self.error is None


@dataclass(frozen=True)
class StopReport:
    """What came of a stop or an unstop."""

    channels: List[ToldChannel]
    """The channels that have devices or a guard."""
    others: int
    """How many other channels were told."""
    denied: List[str]
    """Channels that this peer may see and not stop."""

    @staticmethod
    def of(content: Dict[str, Any]) -> StopReport:
        """Reads the hub's reply."""
        told = [ToldChannel.of(one) for one in maps(content, "channels")]
        return StopReport(told, number(content, "others") or 0, names(content, "denied"))

    @property
    def unobeyed(self) -> List[ToldChannel]:
        """The channels in which not every device has said that it obeys: they are not known to obey."""
        return [channel for channel in self.channels if not channel.is_obeyed]

    @property
    def is_obeyed(self) -> bool:
        """Whether all devices have said that they obey, and this peer was denied none."""
        return not self.unobeyed and not self.denied
