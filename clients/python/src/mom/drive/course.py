"""The course of the commands to one device, from sending to the end, without a connection and without a clock.

`tests/cases/commander.txt` says as dialogues what it does; those who drive in Rust and JavaScript replay them too.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import Enum, auto
from typing import Deque, List, Optional, Tuple, Union

from ..core.holds import Lost
from ..errors import WireError
from .end import FINISHED, TIMES, CommandEnd, Halt, Whose
from .heard import Report, StateNews

NEWEST = "newest"
"""Of a relative command: it is based on the newest state in which the device rests."""
Basis = Union[None, int, str]
"""The state that a command is based on: `None`, its id, or `NEWEST`."""

# All times are in ms.
ANSWER = 10_000
"""In which a device answers a command, and the hub a question."""
_RECEIPT = 15_000
"""In which the hub gives a receipt."""
_SILENT = 90_000
"""After which a device that says nothing is not there any more; a statement may wait for a minute."""
_STANDING = 60_000
"""For which a device may do what its last owner began, or its mechanism may be out of reach."""
_MEASURED, _SOON = 10_000, 100
"""For which the hub may measure our clock, and between two commands to a device that may take the next one."""
_ASKS = 65_000
"""Within which a device that asks for its commands does so, unless it has something to do."""
_RELEASED, _HALTED = 1_000, 2_000
"""In which the hub takes a token back, and a device ends a command after the hub's `halt`."""
_REPEATED = 300
"""Between two stops of a device that does not end its command."""
_EARLY = 64
"""Reports that may come before the receipt."""


@dataclass(frozen=True)
class Progress:
    """How far a command has come: `str` gives it in words."""

    state: str
    """What the device says of it: `waiting`, `executing`; `again`: it will be sent again, since what is in its way passes."""
    statement: int = 0
    """The statement that is carried out, 0 before the first."""
    of: int = 0
    """How many there are."""
    why: Optional[str] = None
    """Of `again`: the error's name, such as `changing-hands`, `link`, `too-old`; also `late` of what a device asks for."""
    text: str = ""
    """Of `again`: the device's or the hub's words."""

    def __str__(self) -> str:
        return f"not yet: {self.text}" if self.why is not None else f"{self.state} {self.statement} of {self.of}"


@dataclass(frozen=True)
class Send:
    """The command is to be sent: `Course.sent`, `refused` or `unanswered` follows."""

    on: Optional[int]
    """The state that it is based on."""
    to: Optional[int]
    """The `next` that it answers."""


class Do(Enum):
    """What else is to be done."""

    ASK = auto()
    """The hub is to be asked about the token: `Course.asked` follows."""
    RELEASE = auto()
    """The token is to be given back: `Course.released` follows."""
    STOP = auto()
    """The device is to be told to stop."""


Step = Union[Send, Progress, Do, CommandEnd, Halt]
"""What is to be done or told next; `CommandEnd`: the command has ended, `Halt`: the work has."""


class _Wait(Enum):
    """What is waited for."""

    NOTHING = auto()
    STATE = auto()
    """The state that a relative command is based on."""
    NEXT = auto()
    """That the device asks for its command."""
    RECEIPT = auto()
    ANSWER = auto()
    RUNNING = auto()
    """A command that was begun."""
    OBSTACLE = auto()
    """Whatever is in the way passes."""
    ASKED = auto()
    """The hub's word, whether the token is lost."""
    LOSS = auto()
    """That the device says that it has ended what was begun under the token."""
    RELEASE = auto()
    """The hub has the token back."""
    ENDED = auto()
    """The device says that it has ended the command."""


_OVER = (_Wait.NOTHING, _Wait.RELEASE, _Wait.ENDED)
_ENDING = (_Wait.RELEASE, _Wait.ENDED, _Wait.LOSS)
_SENT = (_Wait.RECEIPT, _Wait.ANSWER, _Wait.RUNNING, _Wait.NEXT)


class Course:
    """The commands to one device under one fence. What happens is told by its methods; then `poll` says what is to be done."""

    def __init__(self, me: str, whose: Whose, fence: int) -> None:
        self._me, self._whose, self._fence = me, whose, fence
        self._text, self._pulls = "", False
        self._basis: Basis = None
        self._ids: List[int] = []
        self._left: Deque[int] = deque(maxlen=_EARLY)
        """The ids of commands that were given up for another, and whose end was not heard."""
        self._early: Deque[Report] = deque(maxlen=_EARLY)
        self._runs = False
        """Whether the command was sent, and no end of it was heard."""
        self._reported = self._begun = self._once = False
        """Whether the device has said anything of the command, that it has begun it; and that it is never sent again."""
        self._worker: Optional[str] = None
        """Who has said anything of it first."""
        self._sent_at = 0
        """When it was sent last."""
        self._state: Optional[StateNews] = None
        self._device: Optional[str] = None
        """The device's peer, once it has said something."""
        self._now, self._wait = 0, _Wait.NOTHING
        self._due: Optional[int] = None
        self._since = 0
        """When it began to wait for a state."""
        self._met: Optional[Tuple[str, int]] = None
        """What is in the way, and when it was first met."""
        self._obstacle: Optional[Tuple[Report, int]] = None
        """What the device said of it, and how long it is waited for."""
        self._taken: Optional[int] = None
        """The id of the command that the device has taken."""
        self._stops = 0
        self._end_to_be: Optional[CommandEnd] = None
        self._loss: Optional[Lost] = None
        self._steps: Deque[Step] = deque()

    @property
    def me(self) -> str:
        """This peer's name."""
        return self._me

    @property
    def is_under_way(self) -> bool:
        """Whether a command is under way."""
        return self._wait not in _OVER

    def poll(self) -> Optional[Step]:
        """What is to be done next."""
        return self._steps.popleft() if self._steps else None

    def next_wake(self) -> Optional[int]:
        """When it is to be woken, ms."""
        return self._due

    def _await(self, wait: _Wait, ms: Optional[int] = None) -> None:
        self._wait, self._due = wait, None if ms is None else self._now + ms

    def at(self, now: int) -> None:
        """What comes next happens at this time, ms; what has come before a time-out counts."""
        self._now = max(self._now, now)

    def wake(self, now: int) -> None:
        """Nothing has come until this time."""
        self.at(now)
        if self._due is None or now < self._due:
            return
        wait, whose = self._wait, self._whose
        self._await(_Wait.NOTHING)
        if wait is _Wait.STATE and self._state is not None:
            # It says itself that it moves.
            self._send(None)
        elif wait in (_Wait.STATE, _Wait.ANSWER):
            self._end(whose.no_answer())
        elif wait is _Wait.NEXT:
            self._end(whose.asks_nothing())
        elif wait is _Wait.RECEIPT:
            self._end(whose.unanswered(self._text, f"no receipt within {_RECEIPT // 1000} s", self._runs))
        elif wait is _Wait.RUNNING:
            self._end(whose.silent(self._runs))
        elif wait is _Wait.OBSTACLE and self._obstacle is not None:
            report, until = self._obstacle
            if now < until:
                self._begin_again()
            else:
                self._ask(whose.failed(report))
        elif wait is _Wait.ASKED:
            self._wait = wait
            self.asked()
        elif wait is _Wait.LOSS and self._loss is not None:
            self._end(whose.lost(self._loss, False))
        elif wait is _Wait.RELEASE:
            self._wait = wait
            self.released()
        elif wait is _Wait.ENDED:
            self._stop_again()

    def _stop_again(self) -> None:
        if self._stops == TIMES:
            self._steps.append(Halt.SILENT)
            return
        self._stops += 1
        self._steps.append(Do.STOP)
        self._await(_Wait.ENDED, _REPEATED)

    # From its beginning until the hub has it.

    def begin(self, text: str, basis: Basis = None, pulls: bool = False, once: bool = False) -> None:
        """A command is to be carried out; `pulls`: when the device asks for it; `once`: never sent again. One before that goes on."""
        self._text, self._basis, self._pulls, self._met = text, basis, pulls, None
        self._steps.clear()
        if self._runs:
            self._left.extend(self._ids)
        self._runs = self._reported = self._begun = False
        self._worker, self._once = None, once
        self._begin_again()

    def begin_without(self, lost: Lost) -> None:
        """A command is wanted whose token is lost already: nothing of it is sent."""
        self._steps.clear()
        is_down = lost.reason == "disconnected"
        self._steps.append(self._whose.disconnected(False) if is_down else self._whose.lost(lost, None))

    def _begin_again(self) -> None:
        self._ids = []
        if self._pulls:
            self._await(_Wait.NEXT, _ASKS)
        elif self._basis == NEWEST:
            self._since = self._now
            self._await(_Wait.STATE, ANSWER if self._state is None else _STANDING)
            self._send_if_based()
        else:
            self._send(None)

    def _send_if_based(self) -> None:
        """Sends a relative command, if the device rests."""
        if self._wait is _Wait.STATE and self._state is not None and not self._state.moving:
            self._send(None)

    def _send(self, to: Optional[int]) -> None:
        on = self._basis if isinstance(self._basis, int) else None
        if self._basis == NEWEST and self._state is not None:
            on = self._state.id
        # From here on it may run, whether or not its receipt comes.
        self._runs, self._reported = True, False
        self._sent_at = self._now
        self._early.clear()
        self._await(_Wait.RECEIPT, _RECEIPT)
        self._steps.append(Send(on, to))

    def sent(self, id: Optional[int]) -> None:
        """The receipt of the command; `None` if there is nobody to take it."""
        if id is None:
            self._unsent(self._whose.no_answer())
            return
        self._ids.append(id)
        if self._wait is _Wait.RECEIPT and self._pulls:
            self._await(_Wait.NEXT, _ASKS)
        elif self._wait is _Wait.RECEIPT:
            self._await(_Wait.ANSWER, ANSWER)
        early = list(self._early)
        self._early.clear()
        for report in early:
            self._report(report)

    def refused(self, error: WireError) -> None:
        """The hub has refused the command."""
        if self._pulls and error.code in ("expired", "try-later") and self._wait is _Wait.RECEIPT:
            self._runs = bool(self._ids)
            self._await(_Wait.NEXT, _ASKS)
            self._again(error.code, error.text)
        else:
            self._unsent(self._whose.refused(self._text, error))

    def unanswered(self, why: str) -> None:
        """The hub has not said whether it has the command."""
        if self._wait is _Wait.RECEIPT:
            self._end(self._whose.unanswered(self._text, why, self._runs))

    def kept_back(self) -> None:
        """The connection was lost before the command had left."""
        self._unsent(self._whose.disconnected(bool(self._ids)))

    def _unsent(self, end: CommandEnd) -> None:
        """The command did not go out."""
        self._runs = bool(self._ids)
        if self._wait is _Wait.RECEIPT and end.kind == "refused":
            self._ask(end)
        elif self._wait is _Wait.RECEIPT:
            self._end(end)
        elif self._wait is _Wait.LOSS and self._loss is not None and not self._runs:
            self._end(self._whose.lost(self._loss, None))
        elif self._wait is _Wait.ENDED and not self._runs:
            self._has_ended()

    def _again(self, why: str, text: str) -> None:
        self._steps.append(Progress("again", why=why, text=text))

    # What the device says.

    def asks(self, id: int) -> None:
        """The device asks for a command, by a `next` with this id."""
        if self._wait is _Wait.NEXT:
            if self._ids:
                self._again("late", "it was not begun in time")
            self._send(id)

    def state_told(self, news: StateNews, by: Optional[str], is_old: bool = False) -> None:
        """The device's state. Old ones are from before this program came."""
        if not is_old:
            self._hears(by)
        is_first, self._state = self._state is None, news
        if not is_old and news.stopped and not news.moving and self._wait is _Wait.ENDED and self._stops:
            # What is stopped and rests has ended what it did.
            self._has_ended()
            return
        if is_first and self._wait is _Wait.STATE:
            self._due = self._since + _STANDING
        self._send_if_based()
        if is_old or self._wait is not _Wait.OBSTACLE or self._obstacle is None:
            return
        report, until = self._obstacle
        if report.error_name not in ("changing-hands", "link"):
            return
        soon = self._sent_at + _SOON
        if not (news.stands_for(self._fence) if report.error_name == "changing-hands" else news.linked):
            # A state will tell when it has passed.
            self._due = until
        elif self._now < soon:
            self._due = min(until, soon)
        else:
            self._begin_again()

    def _hears(self, by: Optional[str]) -> None:
        self._device = by if by is not None else self._device
        if self._wait is _Wait.RUNNING:
            self._await(_Wait.RUNNING, _SILENT)

    def reported(self, report: Report, by: Optional[str]) -> None:
        """A report about a command."""
        if report.peer == self._me and report.fence in (None, self._fence):
            # Where several devices are, it is the one's that has answered.
            if self._worker is not None and by is not None and by != self._worker:
                return
            self._hears(by)
            if report.id is not None and report.id in self._ids:
                self._worker = by
            self._report(report)

    def dropped(self, reason: str, receiver: Optional[str]) -> None:
        """The hub has dropped a message of this peer on its way to a device, for this reason."""
        is_other = receiver is not None and self._device is not None and receiver != self._device
        if self._reported or not self._runs or is_other:
            return
        if self._wait is _Wait.ANSWER:
            self._runs = False
            self._ask(self._whose.dropped(self._text, reason))
        elif self._wait is _Wait.LOSS and self._loss is not None:
            self._runs = False
            self._end(self._whose.lost(self._loss, None))
        elif self._wait is _Wait.RELEASE:
            self._runs = False
        elif self._wait is _Wait.ENDED and not self._left:
            self._has_ended()

    def _report(self, report: Report) -> None:
        is_this = report.id is not None and report.id in self._ids
        was_left = report.id is not None and report.id in self._left
        self._reported = self._reported or is_this
        self._begun = self._begun or (is_this and report.has_begun)
        if was_left and report.is_end:
            self._left.remove(report.id or 0)
        if self._wait in _ENDING:
            if report.is_end:
                self._hears_an_end(report, is_this, was_left)
        elif self._wait is _Wait.RECEIPT and not is_this:
            self._early.append(report)
        elif self._wait in _SENT and is_this:
            self._comes(report)
        elif self._wait is _Wait.OBSTACLE and is_this and not report.is_end and self._begun:
            # It has begun all the same.
            self._comes(report)
        elif self._wait is _Wait.NOTHING and is_this and report.is_end:
            # It was given up.
            self._runs = False

    def _hears_an_end(self, report: Report, is_this: bool, was_left: bool) -> None:
        """A command has ended at the end of the work."""
        # Which one runs may not be known yet: then the end of any of ours is its end.
        is_this = is_this or (not self._ids and not was_left)
        self._ids = [id for id in self._ids if id != report.id]
        # Of those that a device was given which asks for them, at most one is begun.
        if is_this and not (self._ids and report.was_too_late):
            self._runs = False
        if not self._may_run:
            self._has_ended()

    def _comes(self, report: Report) -> None:
        """The command has come further."""
        if report.state != "error" and report.statement > 0:
            # Commands are carried out one after the other.
            self._left.clear()
        if report.state == "finished":
            self._runs = False
            self._end(FINISHED)
        elif report.state == "error":
            self._fails(report)
        else:
            self._await(_Wait.RUNNING, _SILENT)
            self._taken = report.id
            self._steps.append(Progress(report.state, report.statement, report.of))

    def _fails(self, report: Report) -> None:
        """The device does not carry it out; unless what is in the way passes."""
        name = report.error_name or ""
        if self._pulls and report.was_too_late and not self._begun:
            # Of those that it was given, at most one is ever begun, and none that came before one that it has answered.
            self._ids = self._ids[self._ids.index(report.id or 0) + 1 :]
            if self._wait is _Wait.NEXT or (self._wait is _Wait.RUNNING and self._taken == report.id):
                self._runs = bool(self._ids)
                self._await(_Wait.NEXT, _ASKS)
                self._again(name, report.error_text)
            return
        self._runs = False
        patience = {"changing-hands": _STANDING, "link": _STANDING, "too-old": _MEASURED}.get(name)
        # What may have begun is never said twice.
        if patience is None or not report.may_retry or self._pulls or self._once or self._begun:
            self._ask(self._whose.failed(report))
            return
        if self._met is None or self._met[0] != name:
            self._met = name, self._now
        until = self._met[1] + patience
        stands = self._state is None or (self._state.stands_for(self._fence) and self._state.linked)
        self._again(name, report.error_text)
        self._wait, self._obstacle = _Wait.OBSTACLE, (report, until)
        # No state tells that a clock has been measured, nor again that a device stands.
        self._due = min(until, self._now + _SOON) if name == "too-old" or stands else until

    # How it ends.

    def _ask(self, end: CommandEnd) -> None:
        """A device that was halted because the token is lost may say so before the hub does."""
        self._steps.append(Do.ASK)
        self._end_to_be = end
        self._await(_Wait.ASKED, ANSWER)

    def asked(self) -> None:
        """The hub has answered, after all that it had to say before."""
        if self._wait is _Wait.ASKED and self._end_to_be is not None:
            self._end(self._end_to_be)

    def lost(self, lost: Lost) -> None:
        """The token is lost, and the hub halts the device."""
        if lost.reason == "disconnected":
            # Nobody would be heard.
            self.link_down()
        elif self._wait in _OVER or self._wait is _Wait.LOSS:
            pass
        elif self._wait is _Wait.ASKED and self._end_to_be is not None and self._end_to_be.kind == "error" and not self._left:
            self._end(self._whose.lost(lost, True))
        elif not self._may_run:
            self._end(self._whose.lost(lost, None))
        else:
            self._loss = lost
            self._await(_Wait.LOSS, _HALTED)
            if self._has_ended_early:
                self._has_ended()

    def gone(self, peer: str, missed: bool) -> None:
        """A peer has left, or the hub misses it."""
        if peer == (self._worker if self._worker is not None else self._device):
            self._breaks(self._whose.gone(peer, missed, self._runs))

    def link_down(self) -> None:
        """The link to the hub is down."""
        self._breaks(self._whose.disconnected(self._runs))

    def lagged(self, count: int) -> None:
        """So many events were lost."""
        self._breaks(self._whose.lagged(count, self._runs))

    def _breaks(self, end: CommandEnd) -> None:
        # What is waited for at the end may come all the same, or nobody knows soon enough.
        if self._wait not in _OVER and self._wait is not _Wait.LOSS:
            self._end(end)

    def cancel(self) -> None:
        """Ends the work: the token is given back, and the device heard to have ended what runs."""
        self._steps.clear()
        self._steps.append(Do.RELEASE)
        self._runs = self._runs and not self._has_ended_early
        self._await(_Wait.RELEASE, _RELEASED if self._may_run else ANSWER)

    def released(self) -> None:
        """The hub has the token back, or has refused it."""
        if self._wait is not _Wait.RELEASE:
            return
        if self._may_run:
            self._stops = 0
            self._await(_Wait.ENDED, _HALTED)
        else:
            self._halted(Halt.CONFIRMED)

    @property
    def _may_run(self) -> bool:
        """Whether something may run that was commanded here."""
        return self._runs or bool(self._left)

    @property
    def _has_ended_early(self) -> bool:
        """Whether the device has said before the receipt that a command has ended."""
        return not self._ids and any(report.is_end for report in self._early)

    def _has_ended(self) -> None:
        """What runs has ended."""
        self._runs = False
        self._left.clear()
        if self._wait is _Wait.ENDED:
            self._halted(Halt.STOPPED if self._stops else Halt.CONFIRMED)
        elif self._wait is _Wait.LOSS and self._loss is not None:
            self._end(self._whose.lost(self._loss, True))

    def _halted(self, halt: Halt) -> None:
        self._await(_Wait.NOTHING)
        self._steps.append(halt)

    def _end(self, end: CommandEnd) -> None:
        self._await(_Wait.NOTHING)
        self._steps.append(end)
        if end.kind == "lost":
            # The device is another owner's by then, whom a stop would meet.
            self._runs = False
            self._left.clear()
