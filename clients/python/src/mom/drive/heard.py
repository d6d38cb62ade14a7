"""What a device says of itself and of commands, as far as who commands it has to know."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, Mapping, Optional

from ..content import number
from ..errors import WireError
from ..parcel import Parcel

_NO_WORDS = "it failed, and the device does not say why"
_ESCAPES = {"\n": "\\n", "\r": "\\r"}


def visible(text: str) -> str:
    """Text of others, safe to show on one line of a terminal: what moves the cursor or turns the direction of writing is an escape."""
    return "".join(map(_shown, text))


def _shown(letter: str) -> str:
    code = ord(letter)
    if letter == "\t":
        return " "
    is_control = code < 0x20 or 0x7F <= code < 0xA0
    turns = code in (0x200E, 0x200F) or 0x2028 <= code <= 0x202E or 0x2066 <= code <= 0x2069
    return _ESCAPES.get(letter, f"\\u{{{code:x}}}") if is_control or turns else letter


@dataclass(frozen=True)
class StateNews:
    """What of a device's state matters to who commands it."""

    id: Optional[int]
    """The id of the message, which a relative command is based on."""
    moving: bool = False
    """Whether it moves, or may do so."""
    linked: bool = True
    """Whether its mechanism is in reach."""
    fence: Optional[int] = None
    """The newest fence that it has heard of; `None` of one that says nothing of fences."""
    stopped: bool = False
    """Whether it is stopped."""

    @staticmethod
    def read(parcel: Parcel) -> Optional[StateNews]:
        """Reads a message `state`; `None` if it is none."""
        content = parcel.content
        if not isinstance(content, dict):
            return None
        moving, linked, reached = content.get("moving", False), content.get("linked", True), content.get("reached", True)
        fence, stopped = content.get("fence"), content.get("stopped", False)
        flags_are_flags = all(isinstance(flag, bool) for flag in (moving, linked, reached, stopped))
        if not flags_are_flags or (fence is not None and number(content, "fence") is None):
            return None
        return StateNews(parcel.id, moving, linked and reached, fence, stopped)

    def stands_for(self, fence: int) -> bool:
        """Whether it rests, and has heard that the token's owner has this fence."""
        return not self.moving and (self.fence is None or self.fence >= fence)


@dataclass(frozen=True)
class Report:
    """A report about a command: a message `status`."""

    peer: str
    """Whose command it is."""
    state: str
    """`waiting`, `executing`, `finished`, `error`, and what else devices may say."""
    id: Optional[int] = None
    """The command's."""
    fence: Optional[int] = None
    """Under which it came."""
    statement: int = 0
    """The statement that is carried out, 0 before the first."""
    of: int = 0
    """How many there are."""
    error: Optional[Mapping[str, Any]] = None
    """`name`, `code`, `text`, …, where the state is `error`."""

    @staticmethod
    def read(parcel: Parcel) -> Optional[Report]:
        """Reads a message `status`; `None` if it is none."""
        content: Dict[str, Any] = parcel.map()
        peer, state, error = content.get("peer"), content.get("state"), content.get("error")
        if not isinstance(peer, str) or not isinstance(state, str):
            return None
        known = {key: number(content, key) for key in ("id", "fence", "statement", "of")}
        if any(known[key] is None and content.get(key) is not None for key in known):
            return None
        return Report(
            peer, state, known["id"], known["fence"], known["statement"] or 0, known["of"] or 0,
            error if isinstance(error, dict) else None,
        )  # fmt: skip

    @property
    def is_end(self) -> bool:
        """Whether it is the last one of its command."""
        return self.state in ("finished", "error")

    @property
    def error_name(self) -> Optional[str]:
        """What its error is called, such as `joint-limit`."""
        name = (self.error or {}).get("name")
        return name if isinstance(name, str) else None

    @property
    def has_begun(self) -> bool:
        """Whether the device has begun the command by it."""
        return self.statement > 0 or self.state == "executing"

    @property
    def was_too_late(self) -> bool:
        """Whether the device has not begun it, as it came or waited too long."""
        return self.error_name in ("expired", "too-old")

    @property
    def may_retry(self) -> bool:
        """Whether the same command may be sent again."""
        return (self.error or {}).get("retry") is True

    @property
    def error_text(self) -> str:
        """The device's words for its error."""
        text = (self.error or {}).get("text")
        return visible(text if isinstance(text, str) else _NO_WORDS)

    @property
    def error_words(self) -> str:
        """The same with the statement, the name and the number (M53): `statement 2: too far [joint-limit 5005]`."""
        error, text = self.error or {}, self.error_text
        said, code = number(error, "statement"), number(error, "code")
        statement = self.statement if said is None else said
        place = f"statement {statement}: " if statement > 0 and not text.startswith("statement ") else ""
        known = [visible(self.error_name)] if self.error_name is not None else []
        known += [str(code)] if code is not None else []
        return f"{place}{text} [{' '.join(known)}]" if known else f"{place}{text}"

    @property
    def wire_error(self) -> WireError:
        """Its error, in the form of those of the hub."""
        text = (self.error or {}).get("text")
        return WireError(self.error_name or "denied", text if isinstance(text, str) else "", self.error)
