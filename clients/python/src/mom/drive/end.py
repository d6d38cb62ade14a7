"""How commands, and the work under a token, end, in the same words everywhere."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Optional, Tuple

from ..core.holds import Lost
from ..errors import MomError, WireError
from .heard import Report, visible

TIMES = 3
"""How often a device is stopped that does not end its command."""

_NOTHING = "; nothing of the command ran"
"""Of a command that the device cannot have heard of."""
_GO_AND_LOOK = "go and look; switch it off where it moves"
_POSES = ("workspace-boundary", "joint-limit", "singularity")


class DriveError(MomError):
    """A device could not be driven: `text` says why, `hint` what to do, where something can be done."""

    def __init__(self, text: str, hint: Optional[str] = None) -> None:
        super().__init__(f"{text} ({hint})" if hint else text)
        self._text = text
        self.hint = hint
        """What to do, where something can be done."""
        self.at_end: Optional[DriveError] = None
        """What else was wrong where a block of `driving` ended by this: the token was not taken back, or the device was stopped or is silent."""

    @property
    def text(self) -> str:
        """What went wrong, for people."""
        return self._text


class CommandFailed(DriveError):
    """A command was not carried out: `end` says how it ended, `code` is its `name`."""

    def __init__(self, end: CommandEnd) -> None:
        super().__init__(end.text, end.hint)
        self.end = end
        """How it ended."""
        self.wire = end.error

    @property
    def code(self) -> str:
        """The word for it: `end.name`."""
        return self.end.name


@dataclass(frozen=True)
class CommandEnd:
    """A command's end, and how it is told.

    | `kind` | |
    |---|---|
    | `finished` | it was carried out |
    | `error` | the device has refused it, or ended it, with `error` |
    | `refused` | the hub has refused it, with `error` |
    | `unanswered` | the hub has not said whether it has it |
    | `no-answer` | no device answers, or the device asks for no commands |
    | `silent` | the device has begun it, and says nothing any more |
    | `gone` | the device has left, or the hub misses it |
    | `disconnected` | the link to the hub is down |
    | `lagged` | events were lost here |
    | `lost` | the token was lost: `lost` says how |
    """

    kind: str
    """One of the words above."""
    text: str
    """How it ended, in words."""
    hint: Optional[str] = None
    """What to do, where something can be done."""
    error: Optional[WireError] = None
    """The device's error or the hub's: `code` is its word, `details` what else was said."""
    lost: Optional[Lost] = None
    """Why the token was lost, if that is it."""
    ended: Optional[bool] = None
    """Where the token was lost: whether the device has said that it has ended the command; `None` if nothing of it ran."""

    @property
    def finished(self) -> bool:
        """Whether it was carried out."""
        return self.kind == "finished"

    @property
    def name(self) -> str:
        """The word for it: that of the device's or the hub's error, such as `joint-limit` or `held`, else `kind`."""
        if self.kind == "refused" and self.error is not None:
            return self.error.code
        given = self.error.details.get("name") if self.kind == "error" and self.error is not None else None
        if not isinstance(given, str):
            return self.kind
        shown = visible(given)[:_LONGEST]
        return "error" if shown in _OWN else shown

    @property
    def unreachable(self) -> bool:
        """Whether the device can read the command and cannot go there, so that another pose may do."""
        return self.kind == "error" and self.name in _POSES

    def check(self) -> None:
        """Nothing, if it was carried out; raises `CommandFailed` with `text` and `hint` otherwise."""
        if not self.finished:
            raise CommandFailed(self)


_LONGEST = 64
"""Characters of the longest name of an error that is told."""
_OWN = ("", "finished", "error", "dropped", "unanswered", "no-answer", "silent", "gone", "disconnected", "lagged", "lost")
"""What a device's error may not be called: these are words of the commander's own."""


class Halt(Enum):
    """How a device took the end of the work."""

    CONFIRMED = "confirmed"
    """It has said that its command has ended, or nothing ran."""
    STOPPED = "stopped"
    """It has said so after a `stop` only, which holds until an unstop."""
    SILENT = "silent"
    """It has said nothing."""

    def check(self, device: str) -> None:
        """Nothing, if the device in this channel has obeyed; raises `DriveError` if it was stopped, or says nothing."""
        if self is Halt.STOPPED:
            raise DriveError(
                f"the device in {device} did not end its command when the hub halted it, so it was stopped",
                f"see what is wrong with it, then let it go with: mom unstop {device}",
            )
        if self is Halt.SILENT:
            raise DriveError(
                f"the device in {device} has not said that it has ended its command, "
                f"though the hub was asked to halt it, and {TIMES} times to stop it",
                _GO_AND_LOOK,
            )


@dataclass(frozen=True)
class Whose:
    """What is commanded; says how commands to it end. `runs`: whether the command was sent, and no end of it was heard."""

    place: str
    """The device's channel."""
    token: Optional[str] = None
    """The token that guards it."""

    @property
    def around(self) -> str:
        """Where to see who is there."""
        return f"see who is there: mom tree {self.place.rsplit('/', 1)[0] or '/'}"

    @property
    def look_or_stop(self) -> str:
        """What to do where nobody knows what it does."""
        return f"look at it: mom watch {self.place}; stop it: mom stop {self.place}"

    def failed(self, report: Report) -> CommandEnd:
        """The device has refused it, or ended it with an error."""
        hint = None
        if report.error_name == "stopped":
            hint = f"let it go with: mom unstop {self.place}"
        elif report.error_name == "estop":
            hint = f"reset its emergency stop, then let it go with: mom unstop {self.place}"
        elif report.error_name in ("changing-hands", "link"):
            hint = self.look_or_stop
        return CommandEnd("error", report.error_words, hint, report.wire_error)

    def refused(self, command: str, error: WireError) -> CommandEnd:
        """The hub has refused it."""
        nearest = f" (did you mean {error.nearest}?)" if error.nearest is not None else ""
        text = f"send {quoted(command)} to {self.place}: {error.code}: {error.text}{nearest}"
        return CommandEnd("refused", text, error=error)

    def dropped(self, command: str, reason: str) -> CommandEnd:
        """The hub has dropped it on its way to the device."""
        text = f"send {quoted(command)} to {self.place}: the hub dropped it on its way: {visible(reason)}{_NOTHING}"
        return CommandEnd("dropped", text)

    def unanswered(self, command: str, why: str, runs: bool) -> CommandEnd:
        """The hub has not said whether it has it."""
        text = f"send {quoted(command)} to {self.place}: {why}{_unknown(runs)}"
        return CommandEnd("unanswered", text, self.look_or_stop)

    def no_answer(self) -> CommandEnd:
        """No device answers."""
        return CommandEnd("no-answer", f"no device answers in {self.place}", self.around)

    def asks_nothing(self) -> CommandEnd:
        """The device asks for no commands."""
        hint = f"start it so that it asks for its commands, or let it go with: mom unstop {self.place}"
        return CommandEnd("no-answer", f"the device in {self.place} asks for nothing", hint)

    def silent(self, runs: bool) -> CommandEnd:
        """The device has begun it, and says nothing any more."""
        return CommandEnd("silent", f"the device in {self.place} has said nothing for 90 s{_unknown(runs)}", self.around)

    def gone(self, device: str, missed: bool, runs: bool) -> CommandEnd:
        """The device has left, or the hub has lost its connection (`missed`)."""
        name = visible(device)
        gone = f"the hub has lost the connection of {name}, the device in" if missed else f"{name} has left"
        return CommandEnd("gone", f"{gone} {self.place}{_unknown(runs)}", self.around)

    def disconnected(self, runs: bool) -> CommandEnd:
        """The link to the hub is down."""
        text = f"the connection to the hub is lost, and the token with it{_unknown(runs)}"
        return CommandEnd("disconnected", text, f"see what it did: mom watch {self.place}" if runs else None)

    def lagged(self, count: int, runs: bool) -> CommandEnd:
        """So many events were lost here."""
        were = "event was" if count == 1 else "events were"
        return CommandEnd("lagged", f"{count} {were} lost here{_unknown(runs)}", self.look_or_stop)

    def lost(self, lost: Lost, ended: Optional[bool]) -> CommandEnd:
        """The token was lost. `ended`: whether the device has said that it has ended the command; `None` if nothing of it ran."""
        what, hint = _ended_words(ended)
        text = f"{lost_words(self.token or 'the token', lost)}{what}"
        return CommandEnd("lost", text, hint, lost=lost, ended=ended)


FINISHED = CommandEnd("finished", "finished")
"""It was carried out."""


def _unknown(runs: bool) -> str:
    return "; what became of the command is not known" if runs else _NOTHING


def _ended_words(ended: Optional[bool]) -> Tuple[str, Optional[str]]:
    if ended is None:
        return _NOTHING, None
    if ended:
        return "; the device has ended the command", None
    return "; the device has not said that it has ended the command", _GO_AND_LOOK


def lost_words(token: str, lost: Lost) -> str:
    """That a token is lost, and why, in words."""
    return f"lost {token}: {_loss_words(lost)}"


def _loss_words(lost: Lost) -> str:
    plain = {
        "disconnected": "the connection to the hub is lost",
        "deleted": "it was deleted",
        "returned": "it returned to its giver",
        "revoked": "you may no longer be here",
    }
    if lost.reason in plain:
        return plain[lost.reason]
    if lost.by is None:
        return "the lease was over" if lost.reason == "expired" else visible(lost.reason)
    by = visible(lost.by)
    caused = {
        "preempted": f"{by} has a higher level and took it",
        "expired": f"the time was over, and {by} was next",
        "given": f"{by} has it now",
        "broken": f"{by} took it away",
    }
    return caused.get(lost.reason, f"{visible(lost.reason)} by {by}")


_QUOTED = {'"': '\\"', "\\": "\\\\", "\n": "\\n", "\r": "\\r", "\t": "\\t", "\0": "\\0"}


def quoted(text: str) -> str:
    """A text between quotes, on one line."""
    letters = (_QUOTED.get(one) or (one if one.isprintable() else f"\\u{{{ord(one):x}}}") for one in text)
    return f'"{"".join(letters)}"'
