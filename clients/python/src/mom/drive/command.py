"""A command, as its sender wants it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Mapping, Optional

from .course import NEWEST, Basis
from .relative import is_relative


@dataclass(frozen=True)
class Command:
    """A command to a device."""

    text: str
    """Its statements, such as `move 100 50 200 0 0; grip close`."""
    based_on: Basis = None
    """Of a relative command the state that it is based on: `"newest"`, the newest one in which the device rests, or the `id` of one that
    its user has seen. `None`: it is not relative, or is so by the device's card, and then based on the newest."""
    attachments: Optional[Mapping[str, bytes]] = None
    """Bytes that its statements name, such as a sound."""
    expires: Optional[float] = None
    """Seconds after which it is worth nothing."""
    when_asked: bool = False
    """Whether it is sent when the device asks for it (`next`), and again when that did not begin it in time."""
    once: bool = False
    """Whether it is never sent again, whatever is in its way."""

    def __post_init__(self) -> None:
        if not isinstance(self.text, str):
            raise TypeError(f"a command is a text, not {self.text!r}")
        if self.based_on not in (None, NEWEST) and (isinstance(self.based_on, bool) or not isinstance(self.based_on, int)):
            raise ValueError(f'a command is based on "newest" or the id of a state, not on {self.based_on!r}')

    def basis(self, card: Optional[Mapping[str, Any]]) -> Basis:
        """The state that it is based on, for a device with this card."""
        is_known = self.based_on is None and card is not None
        return NEWEST if is_known and card is not None and is_relative(card, self.text) else self.based_on

    def content(self) -> Any:
        """The content of its message."""
        return {"script": self.text, "attachments": dict(self.attachments)} if self.attachments else self.text
