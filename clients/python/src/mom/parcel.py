"""Parcels: lists of slots."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from datetime import datetime
from typing import Any, Dict, List, Optional

from .errors import WireError

FAMILIES = ("message", "login", "context", "token", "manager", "event", "reply", "error", "time")
DELIVERIES = ("reliable", "latest", "fleeting")


@dataclass(repr=False)
class Parcel:
    """A parcel, with the slots of docs/PROTOCOL.md. What is `None` is absent."""

    family: str
    """The first half of its class: `message`, `event`, `reply`, `error`, …"""
    name: str
    """The second half of its class; the name of a message."""
    context: Optional[str] = None
    """The path of the context that it is about."""
    content: Any = None
    """Its content (see `mom.values`)."""
    id: Optional[int] = None
    """The sender's number for it; the answer carries it as `reference`."""
    reference: Optional[int] = None
    """The `id` that it answers."""
    sender: Optional[str] = None
    """The peer that sent it, or `hub`."""
    address: Optional[List[str]] = None
    """The peers that a message goes to; `None` = all members."""
    timestamp: Optional[datetime] = None
    """When it was created, by its sender's clock."""
    priority: Optional[int] = None
    """Higher leaves sooner; 0 by default."""
    expires: Optional[int] = None
    """Milliseconds after its creation at which it becomes worthless."""
    delivery: Optional[str] = None
    """`reliable`, `latest` or `fleeting`; `None` = as the channel says."""
    fence: Optional[int] = None
    """The fence of the ownership under which a guarded message passed."""
    received: Optional[datetime] = None
    """When the hub received the message, by the hub's clock."""
    age: Optional[int] = None
    """Microseconds from its creation to `received`."""
    age_error: Optional[int] = None
    """The error bound of `age` in microseconds; `None` = the age is unknown."""
    echo: Optional[bool] = None
    """`False`: a broadcast does not come back to its sender."""
    receipt: Optional[bool] = None
    """`True`: an accepted message is answered."""
    extra: Dict[str, Any] = field(default_factory=dict)
    """All other slots, in order."""
    has_content: bool = False
    """Whether the slot `content` is there although its value is `None`."""
    fault: Optional[str] = field(default=None, compare=False)
    """What is wrong with a parcel that cannot be read whole; it is never delivered as a message."""
    size: int = field(default=0, compare=False, repr=False)
    """Its bytes on the wire, of one that has arrived."""

    def __repr__(self) -> str:
        slots = [(slot.name, getattr(self, slot.name)) for slot in fields(self) if slot.repr]
        return f"Parcel({', '.join(f'{name}={value!r}' for name, value in slots if value not in (None, {}, False))})"

    @property
    def history(self) -> bool:
        """Whether it is an earlier message, which the channel kept for those who join late."""
        return self.extra.get("history") is True

    def is_(self, family: str, name: str) -> bool:
        """Whether it is of this class."""
        return self.family == family and self.name == name

    def map(self) -> Dict[str, Any]:
        """Its content if that is a map, else an empty one."""
        return self.content if isinstance(self.content, dict) else {}

    def error(self) -> WireError:
        """What it says, if it is of family `error`."""
        content = self.map()
        text = content.get("text")
        return WireError(self.name, text if isinstance(text, str) else "", content)
