"""The queue: a state machine that takes commands and the time, and tells what happens."""

from __future__ import annotations

from collections import deque
from copy import copy
from dataclasses import dataclass
from typing import Callable, Deque, Generic, Iterator, List, Optional, TypeVar

from .command import Command, Order, Progress, QueueEvent, State, Told
from .errors import DeviceError
from .machine import Machine
from .rest import REST, Rest
from .script import MAX_ATTACHED, Script, Wait

MAX_WAITING = 64
"""The most commands that wait behind the one being carried out."""

_OLD = 3_000_000
"""µs after which what was heard of a device that rests does not say that it still does."""

_INTERLOCK = 1_000_000
"""µs that a new owner waits beyond twice the stopping time until the device rests."""

_HUB = "hub"

M = TypeVar("M", bound=Machine)


@dataclass
class _Active:
    """The command being carried out."""

    command: Command
    begun: int
    """How many statements have begun."""
    ends: Optional[int]
    """When the present statement ends, if it is a `wait`, or none has begun; else when its action is done."""
    last: Optional[str] = None
    """Why no statement begins after the present one; `None` if the script goes on."""


class CommandQueue(Generic[M]):
    """A device that carries out one command after the other.

    A driver calls `advance` whenever `next_wake` is due, and the other methods when what they do is asked for. Every method that takes
    `now`, in µs, first advances to it; a time before the latest one counts as the latest. What happens is appended to `events`, in
    order, and every command that was taken ends in exactly one `finished` or `error`.
    """

    def __init__(self, machine: M) -> None:
        self.machine = machine
        self.now = 0
        """The latest time that was given."""
        self.pace = 1
        """How many times as fast as its users' time its own passes."""
        self._seq = 0
        self._stopped = False
        self._active: Optional[_Active] = None
        self._waiting: Deque[Command] = deque()
        self._publish = 0
        """When the next state is due, while it moves."""
        self._told_moving = False
        """Whether the last state that was told said that it moves; beside it, what that said of its rest, and whether it is reached."""
        self._told_rest: Optional[str] = None
        self._told_reached = machine.is_reached()
        self._was_changing, self._was_carried = machine.is_changing(), False
        self._rest = Rest(machine.tolerance, machine.stopping_time)
        self._halting = False
        """It was to stand while it moved, and does not rest yet."""
        self._stands_since: Optional[int] = 0
        """When it was told to stand last, or had something under way after that; none if an action has begun since."""
        self._changes_hands = False
        """It has a new owner, whose first motion waits until it rests."""
        self._waits_until: Optional[int] = None
        """Until when the new owner's command waits, if there is one."""
        self._silence: Optional[int] = None
        """For how long the program has stood still, while that is made up for."""
        self._blocked = machine.blocked()
        """For how long halts had kept the program at the latest time."""

    # What is known of it.

    def is_moving(self) -> bool:
        """Whether it moves, or is to stand and does not rest yet. Where it is not reached nobody knows."""
        return self.machine.is_moving() or self._is_carried() or self._halting or not self.machine.is_reached()

    def _is_carried(self) -> bool:
        """Whether its position changes, whatever moves it."""
        return self._rest.known is None and self.machine.is_carried()

    @property
    def is_busy(self) -> bool:
        """Whether a command is being carried out or waits, so that the device may be elsewhere soon."""
        return self._active is not None or bool(self._waiting)

    def is_at_rest(self) -> bool:
        """Whether a halt would change nothing."""
        return not self.is_busy and self.machine.is_at_rest()

    def orders(self) -> Iterator[Order]:
        """Whose commands are being carried out or wait."""
        if self._active is not None:
            yield self._active.command.order
        for command in self._waiting:
            yield command.order

    def state(self) -> State:
        """The state at the latest time given."""
        active = self._active
        return State(
            seq=self._seq,
            position=dict(self.machine.position()),
            report=dict(self.machine.report()),
            moving=self.is_moving(),
            rest=self._rest.known,
            reached=self.machine.is_reached(),
            stopped=self._stopped,
            executing=active.command.progress(active.begun) if active is not None else None,
            waiting=len(self._waiting),
        )

    def next_wake(self) -> Optional[int]:
        """When `advance` is to be called next; `None` while there is nothing to do."""
        due: List[Optional[int]] = [self.machine.next_wake()]
        if self._active is not None:
            due.append(self._ends(self._active))
        if self._is_lively():
            due.append(self._publish)
        # While it is carrying something out there is no rest to be looked for, and none of what is not reached.
        if self._active is None and not self.machine.is_moving() and self.machine.is_reached():
            due.append(self._rest.next_look(self.now))
        if self._active is None and self._waits_for_rest():
            due.append(self._waits_until)
        return min((one for one in due if one is not None), default=None)

    def check_free(self) -> None:
        """Whether a command could be taken now; raises `stopped` or `queue-full`."""
        if self._stopped:
            text = f"{self.machine.name} is stopped and takes no command until the stop is released"
            raise DeviceError("stopped", text)
        if len(self._waiting) >= MAX_WAITING:
            text = f"{MAX_WAITING} commands are waiting already; try again when one has begun"
            raise DeviceError("queue-full", text)

    # What happens to it.

    def note(self, now: int, what: Callable[[M], None], events: List[QueueEvent]) -> None:
        """Lets something be done to the device that no command does; a state follows if it moves now, or stands."""
        self.advance(now, events)
        what(self.machine)
        self._seq += 1
        self.advance(self.now, events)
        if self._told_moving != self.is_moving():
            self._publish_state(events)

    def submit(self, command: Command, now: int, events: List[QueueEvent]) -> None:
        """Takes a command: has the machine check it, and queues it. It begins at once if nothing else is being carried out.

        Raises `stopped`, `queue-full`, `busy`, `changing-hands`, or why the machine cannot carry it out. Then nothing moves.
        """
        self.advance(now, events)
        self.check_free()
        self._check_attached(command.script)
        self._check_turn(command.script)
        self.machine.plan(command.script)
        self._displace(command.script, events)
        events.append(Told("waiting", command.progress(0)))
        self._waiting.append(command)
        self._seq += 1
        self.advance(now, events)

    def advance(self, now: int, events: List[QueueEvent]) -> None:
        """Lets time pass until `now`.

        Where that is more than the machine's patience later than `next_wake`, the program has stood still: no statement begins for which
        it would have had to be there, and all commands end.
        """
        silence = self.silence(now)
        if now > self.now:
            self._blocked = self.machine.blocked()
        patience = self.machine.patience * self.pace
        if silence > patience and self.is_busy:
            self._silence = silence
            # For so long the mechanism has gone on by itself.
            self._carry_on(now - silence + patience, events)
            if self.is_busy:
                self._end_silent(silence, events)
            self._silence = None
        if silence > patience:
            # What was measured meanwhile is heard only now, and would pass for new.
            self._rest.disturb(now)
        self._carry_on(now, events)

    def silence(self, now: int) -> int:
        """For how long the program has stood still now, but for what its own halts took."""
        due = self.next_wake()
        return 0 if due is None else now - due - (self.machine.blocked() - self._blocked) * self.pace

    def halt(self, now: int, reason: str, events: List[QueueEvent]) -> None:
        """Stands, and drops every command with the error `halted`. Not latched: the next command is taken."""
        self.advance(now, events)
        # What goes on after its command, as a wheel does, is halted too.
        if self.is_at_rest():
            self._doubt_old_news()
            self._halt_machine()
        else:
            error = DeviceError("halted", f"{self.machine.name} was halted: {reason}")
            self._end(error, error, events)

    def fail(self, now: int, error: DeviceError, events: List[QueueEvent]) -> None:
        """Ends every command with this error, because the device cannot carry it out."""
        self.advance(now, events)
        self._end(error, error, events)

    def stop(self, now: int, reason: str, events: List[QueueEvent], name: str = "stopped") -> None:
        """Stands, drops every command with this error, `stopped` or `estop`, and takes none until `unstop`."""
        self.advance(now, events)
        self._doubt_old_news()
        if not self._stopped:
            self._stopped = True
            error = DeviceError(name, f"{self.machine.name} was stopped: {reason}")
            self._end(error, error, events)
        else:
            self._halt_machine()

    def drop_all(self) -> List[Progress]:
        """Drops every command, and asks the machine nothing: it has failed. How far each had come."""
        active, self._active = self._active, None
        waiting, self._waiting = list(self._waiting), deque()
        begun = [] if active is None else [active.command.progress(active.begun)]
        return begun + [command.progress(0) for command in waiting]

    def unstop(self, now: int, events: List[QueueEvent]) -> None:
        """Takes commands again. Nothing moves by itself: the old commands are gone."""
        self.advance(now, events)
        if self._stopped:
            self._stopped = False
            self._publish_state(events)

    # What becomes of commands when the device gets another owner.

    def change_hands(self, now: int, events: List[QueueEvent]) -> None:
        """It has a new owner: no motion of it begins before the device rests."""
        self.advance(now, events)
        self._doubt_old_news()
        self._changes_hands = self._rest.known is None
        self._waits_until = None

    def end_statement(self, now: int, reason: str, events: List[QueueEvent]) -> None:
        """Drops the commands that wait, and lets the one that is being carried out come to the end of its present statement only.

        What would go on until another command comes is halted, and no `wait` is waited for.
        """
        self.advance(now, events)
        if self.machine.gives_way():
            self.halt(now, reason, events)
            return
        error = DeviceError("halted", f"{self.machine.name} did not begin it: {reason}")
        self._drop_waiting(error, events)
        if self._active is not None:
            self._active.last = reason
            self._active.ends = None if self._active.ends is None else self.now
            self.advance(self.now, events)

    def _waits_for_rest(self) -> bool:
        """Whether the first command of a new owner has to wait. The hub's own is the safe state, for which the device was halted."""
        return self._changes_hands and bool(self._waiting) and self._waiting[0].order.peer != _HUB

    def _wait_for_rest(self, events: List[QueueEvent]) -> None:
        """Lets a new owner's commands wait for rest, and refuses them where it does not come."""
        longest = 2 * self.machine.stopping_time + _INTERLOCK
        if self._waits_until is None:
            self._waits_until = self.now + longest
        if self.now < self._waits_until:
            return
        self._waits_until = None
        if self.machine.is_reached():
            why = "it still moves as its old owner had it move"
        else:
            why = "it cannot be reached, so it is unknown whether it is at rest"
        text = f"{self.machine.name} is changing hands, and {why} {longest // 1000} ms after the command"
        self._drop_waiting(DeviceError("changing-hands", text), events)
        # What was planned from is where those would have led.
        self._halt_machine()
        self._publish_state(events)

    def _check_attached(self, script: Script) -> None:
        """Whether there is room for what came with a script."""
        active = [self._active.command] if self._active is not None else []
        held = sum(command.script.attached for command in [*active, *self._waiting])
        more = script.attached
        if more == 0 or held + more <= MAX_ATTACHED:
            return
        if more > MAX_ATTACHED:
            text = f"{more} bytes came with the command, and {MAX_ATTACHED} at most are taken"
        else:
            text = (
                f"{held} bytes came with commands that wait already, and {more} more are more than {MAX_ATTACHED}; "
                "try again when one has ended"
            )
        raise DeviceError("queue-full", text)

    def _check_turn(self, script: Script) -> None:
        """Whether a script may be queued behind what is being carried out.

        Not where its statement waits for nothing, and not where an old owner's statement comes to its end, as where that leads is not
        where its script did.
        """
        active = self._active
        if active is not None and active.last is not None:
            text = "is changing hands and still moves; send the command again when a state tells that it stands"
            raise DeviceError("changing-hands", f"{self.machine.name} {text}").with_retry()
        if active is not None:
            gives_way = self.machine.gives_way() and not self._waiting
        else:
            # Until the device rests for its new owner the newest of them waits, though.
            gives_way = all(self._never_waits(other.script) for other in self._waiting)
        if self._never_waits(script) and self.is_busy and not gives_way:
            text = "carries out a script, behind which this does not wait; send it again when the device is at rest"
            raise DeviceError("busy", f"{self.machine.name} {text}")

    def _displace(self, script: Script, events: List[QueueEvent]) -> None:
        """One that never waits takes the place of those like it that wait for rest."""
        if self._active is None and self._never_waits(script):
            events.extend(Told("finished", other.progress(0)) for other in self._waiting)
            self._waiting.clear()

    def _never_waits(self, script: Script) -> bool:
        return any(self.machine.never_waits(action) for action, _ in script.actions())

    # How time passes.

    def _carry_on(self, now: int, events: List[QueueEvent]) -> None:
        self._carry_out(now, events)
        self._pass(now)
        self._heed_failure(events)
        self._tell_rest(events)
        was_changing, self._was_changing = self._was_changing, self.machine.is_changing()
        if self._is_lively() and self.now >= self._publish:
            late = (self.now - self._publish) // self.machine.period
            self._publish += (late + 1) * self.machine.period
            self._publish_state(events)
        elif was_changing and not self._was_changing:
            self._publish_state(events)
        was_carried, self._was_carried = self._was_carried, self._is_carried()
        if was_carried and not self._was_carried and self._told_moving and not self.is_moving():
            self._publish_state(events)

    def _carry_out(self, now: int, events: List[QueueEvent]) -> None:
        """Begins and ends what is due until `now`."""
        while True:
            if self._active is not None:
                ends = self._pursue(self._active, now)
                if ends is None:
                    return
                # An action that was done without word of it, or before it was looked at, ends now.
                self._pass(ends)
                if self._heed_failure(events):
                    continue
                if self.machine.gives_way():
                    self.machine.give_way(self.now)
                    self._stands_since = self.now
                self._begin_statement(events)
            elif not self._waiting or self._silence is not None:
                return
            elif self._waits_for_rest():
                self._pass(now)
                if self._waits_for_rest():
                    self._wait_for_rest(events)
                    return
                # That it rests is told before the new owner moves it.
                if self._told_rest is None:
                    self._publish_state(events)
            else:
                self._begin_command(events)

    def _pursue(self, active: _Active, until: int) -> Optional[int]:
        """When the present statement ended, if it did until then."""
        if active.ends is not None:
            return active.ends if active.ends <= until else None
        done = self.machine.pursue(until)
        if done is None and self._gives_way():
            return min(self.now, until)
        return done

    def _ends(self, active: _Active) -> Optional[int]:
        if active.ends is not None:
            return active.ends
        done = self.machine.done_at()
        return self.now if done is None and self._gives_way() else done

    def _gives_way(self) -> bool:
        """Whether what is being carried out ends as another command waits."""
        return self.machine.gives_way() and bool(self._waiting)

    def _pass(self, until: int) -> None:
        self._seq += self._is_lively() and until > self.now
        self.now = max(until, self.now)
        self.machine.advance(self.now)
        self._watch_rest()
        self._insist()

    def _halt_machine(self) -> None:
        """Has it stand."""
        self.machine.halt(self.now)
        self._stands_since = self.now

    def _insist(self) -> None:
        """Has it stand again where it was to, has nothing under way and does not rest by when it should.

        Something moves it that no command began.
        """
        if self._stands_since is None:
            return
        # Commands that wait were planned from where it stands; its own motion ends by itself.
        if self.is_busy or self.machine.is_driven():
            self._stands_since = self.now
            return
        is_due = self.now - self._stands_since >= self.machine.stopping_time + REST
        if is_due and self._rest.known is None and self.machine.is_reached():
            self._halt_machine()

    def _watch_rest(self) -> None:
        """Looks whether it rests: not while it is carrying something out, and not where nothing is heard of it."""
        acts = self._active is not None and self._active.begun > 0
        if acts or self.machine.is_moving() or not self.machine.is_reached():
            self._rest.disturb(self.now)
            return
        measured_at = self.machine.known_at()
        self._rest.observe(self.machine.measured(self.now if measured_at is None else measured_at), self.now)
        if self._rest.known is not None:
            self._halting, self._changes_hands, self._waits_until = False, False, None

    def _tell_rest(self, events: List[QueueEvent]) -> None:
        """Tells when it has come to rest, and when it rests no more though nothing drives it."""
        if self._told_reached != self.machine.is_reached():
            self._publish_state(events)
        known = self._rest.known
        comes = known is not None and (known != self._told_rest or self._told_moving)
        # Such as by a push.
        goes = known is None and self._told_rest is not None
        if (comes or goes) and not self.is_busy:
            self._publish_state(events)

    def _is_lively(self) -> bool:
        """Whether its position may change meanwhile: what is not reached tells nothing new."""
        moves = self.machine.is_moving() or self.machine.is_changing() or self._is_carried()
        return self.machine.is_reached() and (moves or self._halting)

    def _doubt_old_news(self) -> None:
        """That it rests is found out anew where what is known of it is old: it may have moved since."""
        known_at = self.machine.known_at()
        if known_at is not None and self.now - known_at > _OLD:
            self._rest.disturb(self.now)

    # How commands begin and end.

    def _begin_command(self, events: List[QueueEvent]) -> None:
        """Takes the next command from the queue, unless it has become too old there."""
        # That it stands is told before it moves again.
        if self._told_moving and not self.is_moving():
            self._publish_state(events)
        command = self._waiting.popleft()
        late = 0 if command.use_by is None else self.now - command.use_by
        self._waits_until = None
        self._active = _Active(command, 0, self.now)
        if late > 0:
            text = f"the command waited {late // 1000} ms longer than it is good for"
            # Those behind it were checked from where it should have led.
            behind = DeviceError("halted", "the command before it was too old, so this one was not begun")
            self._end(DeviceError("too-old", text), behind, events)

    def _begin_statement(self, events: List[QueueEvent]) -> None:
        """Begins what comes next of the active command, or finishes it."""
        self._seq += 1
        active = self._active
        if active is None:
            return
        statements = active.command.script.statements
        if active.begun == len(statements):
            self._active = None
            # Who predicts goes on where it does.
            if not (self.machine.is_moving() and self._waiting):
                self._publish_state(events)
            events.append(Told("finished", active.command.progress(active.begun)))
            return
        if self._silence is not None:
            self._end_silent(self._silence, events)
            return
        if active.last is not None:
            text = f"{self.machine.name} ended the script after statement {active.begun}: {active.last}"
            error = DeviceError("halted", text)
            self._end(error, error, events)
            return
        statement = statements[active.begun]
        active.begun += 1
        events.append(Told("executing", active.command.progress(active.begun)))
        if isinstance(statement, Wait):
            active.ends = self.now + statement.ms * 1000
            if self._told_moving != self.is_moving():
                self._publish_state(events)
            return
        active.ends, self._stands_since = None, None
        try:
            self.machine.begin(statement, self.now)
        except DeviceError as error:
            self._fail_statement(error, events)
            return
        # From here on it moves as this command says, not as one that was to stand.
        self._halting = self._halting and not self.machine.is_moving()
        if self._publish <= self.now:
            self._publish = self.now + self.machine.period

    def _heed_failure(self, events: List[QueueEvent]) -> bool:
        """Ends all commands where the machine has failed."""
        failure = self.machine.take_failure()
        if failure is None or not self.is_busy:
            return False
        self._fail_statement(failure, events)
        return True

    def _fail_statement(self, error: DeviceError, events: List[QueueEvent]) -> None:
        """Ends the active command with an error of its present statement. Those behind it were checked from where it should have led."""
        begun = 0 if self._active is None else self._active.begun
        error = copy(error).at_statement(begun) if begun else error
        self._end(error, DeviceError("halted", "the command before it failed, so this one was not begun"), events)

    def _end_silent(self, silence: int, events: List[QueueEvent]) -> None:
        """Ends all commands, as their program has stood still."""
        text = f"{self.machine.name} was halted: its program stood still for {silence // 1000} ms"
        error = DeviceError("halted", text)
        self._end(error, error, events)

    def _end(self, error: DeviceError, behind: DeviceError, events: List[QueueEvent]) -> None:
        """Ends the active command with one error and those behind it with another."""
        began = self._active is not None and self._active.begun > 0
        was_moving = began or not self.machine.is_at_rest()
        self._halt_machine()
        active, self._active = self._active, None
        waiting, self._waiting = self._waiting, deque()
        self._waits_until = None
        if was_moving:
            self._halting = True
            self._rest.disturb(self.now)
            self._publish = max(self._publish, self.now + self.machine.period)
        self._publish_state(events)
        if active is not None:
            events.append(Told("error", active.command.progress(active.begun), error))
        for command in waiting:
            events.append(Told("error", command.progress(0), behind))

    def _drop_waiting(self, error: DeviceError, events: List[QueueEvent]) -> None:
        waiting, self._waiting = self._waiting, deque()
        for command in waiting:
            events.append(Told("error", command.progress(0), error))

    def _publish_state(self, events: List[QueueEvent]) -> None:
        self._seq += 1
        state = self.state()
        self._told_moving, self._told_rest, self._told_reached = state.moving, state.rest, state.reached
        events.append(state)
