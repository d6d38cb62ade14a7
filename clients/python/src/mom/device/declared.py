"""The machine of a device that declares its verbs: runs them, one at a time."""

from __future__ import annotations

import asyncio
import inspect
import logging
import numbers
from dataclasses import dataclass
from typing import Any, Callable, Dict, Generator, Iterator, Mapping, Optional

from .declare import Attachment, Verb
from .device import Call, Device
from .errors import DeviceError, syntax
from .machine import Machine
from .script import Attachments, Script
from .words import ScriptWord, Words

LOG = logging.getLogger("mom")

RESERVED = frozenset(
    ("seq", "moving", "rest", "reached", "stopped", "stop", "executing", "waiting", "fence", "stops-within")
)
"""The keys of a state that say how every device stands."""


@dataclass
class Action:
    """What a statement of a declared device makes it do."""

    verb: Verb
    arguments: Dict[str, Any]


class DeclaredMachine(Machine):
    """Carries out the verbs of a `Device`, on the running loop.

    What a halted verb still clears up comes to its end before the next one begins.
    """

    def __init__(self, device: Device) -> None:
        self.device = device
        self.on_end: Callable[[asyncio.Future[Any]], None] = lambda task: None
        """Called when a verb has come to its end, which `ended` is to be told of."""
        self.may_go_on: Callable[[], None] = lambda: None
        """Called before each step of a verb: it may halt the device."""
        self.name = f"the {device.called()}"
        self.verbs = tuple(device._verbs)
        self.stopping_time = device.stops_within * 1000
        self.tolerance = device.tolerance
        self.completes = device.completes_on_give
        self._running: Optional[asyncio.Future[Any]] = None
        self._called, self._moves = "", False
        """The verb that was begun last, and whether it moves the device."""
        self._halted: Dict[asyncio.Future[Any], float] = {}
        """Verbs that were cancelled, and have not come to their end yet; until when they may clear up, by the loop's time."""
        self._leaves = False
        """Whether what a plain function has begun may go on."""
        self._done: Optional[int] = None
        self._until: Optional[int] = None
        """When a velocity ends; `None` without one."""
        self._follower: Optional[bool] = None
        """Whether a velocity follows the present one; `None`: nothing does."""
        self._rolls = False
        """A velocity has given way to another one, which begins now."""
        self._failure: Optional[DeviceError] = None
        self._now = 0

    # What its scripts say.

    def read(self, verb: ScriptWord, words: Words) -> Optional[Action]:
        """Reads what follows the verb of a statement."""
        known = self.device._verbs.get(verb.text)
        return None if known is None else Action(known, known.read(words))

    def attach(self, action: Action, attachments: Attachments) -> None:
        """Gives an action the bytes that it names."""
        for argument in action.verb.arguments:
            name = action.arguments[argument.parameter]
            if isinstance(argument.kind, Attachment) and isinstance(name, str):
                action.arguments[argument.parameter] = attachments.get(name)

    def is_relative(self, action: Action) -> Optional[bool]:
        """Whether an action says only how far it goes; `None` of one that takes the device nowhere."""
        return action.verb.relative if action.verb.moves else None

    def never_waits(self, action: Action) -> bool:
        """Whether an action is a velocity."""
        return action.verb.velocity is not None

    def plan(self, script: Script) -> None:
        """Has the device check a script."""
        _check_alone(script)
        calls = [Call(action.verb.name, dict(action.arguments), number) for action, number in script.actions()]
        try:
            self.device.plan(calls)
        except DeviceError:
            raise
        except Exception as error:
            raise _failed(self.name, "its plan", error) from error
        if self.gives_way() and self._follower is None:
            first = script.statements[0]
            self._follower = isinstance(first, Action) and self.never_waits(first)

    # What it does.

    def begin(self, action: Action, now: int) -> None:
        """Calls the method of a verb."""
        verb, goes_on = action.verb, self._rolls and action.verb.velocity is not None
        if self._rolls and not goes_on:
            self.device.halt()
        self._rolls, self._follower, self._failure = False, None, None
        self._called, self._moves, self._done = verb.name, verb.moves, None
        self._until = None if verb.velocity is None else now + verb.velocity * 1000
        method = getattr(self.device, verb.method)
        if self._halted:
            self._run(self._after_halted(method, action.arguments))
            return
        try:
            found = method(**action.arguments)
        except DeviceError:
            raise
        except Exception as error:
            raise _failed(self.name, f"`{verb.name}`", error) from error
        if inspect.isawaitable(found):
            self._run(found)
        else:
            self._done, self._leaves = now, self._leaves or (verb.moves and verb.velocity is None)

    def _run(self, found: Any) -> None:
        task = asyncio.ensure_future(_run_in_steps(found, self._may_go_on, self._clears_up_too_long))
        self._running = task
        task.add_done_callback(lambda ended: self._tell_end(ended, found))

    def _tell_end(self, task: asyncio.Future[Any], found: Any) -> None:
        if inspect.iscoroutine(found) and inspect.getcoroutinestate(found) == inspect.CORO_CREATED:
            # It was halted before its first step.
            found.close()
        self.on_end(task)

    async def _after_halted(self, method: Callable[..., Any], arguments: Dict[str, Any]) -> None:
        while self._halted:
            await asyncio.wait(set(self._halted))
        found = method(**arguments)
        if inspect.isawaitable(found):
            await found
        else:
            self._leaves = self._moves and self._until is None

    def _may_go_on(self) -> bool:
        """Whether the verb that is about to take a step may do so."""
        self.may_go_on()
        # Who was halted may clear up.
        return asyncio.current_task() not in self._halted

    def _clears_up_too_long(self) -> bool:
        """Whether the verb that is about to take a step was halted longer ago than it may take to stand."""
        task = asyncio.current_task()
        return task in self._halted and asyncio.get_running_loop().time() > self._halted[task]

    def ended(self, task: asyncio.Future[Any], now: int) -> None:
        """A verb has come to its end."""
        error = None if task.cancelled() else task.exception()
        if task in self._halted:
            del self._halted[task]
            if not task.cancelled() and self._running is None:
                # It may have gone on beyond its halt.
                LOG.warning("%s: a verb that was halted did not end by that", self.name, exc_info=error)
                self.device.halt()
            return
        if task is not self._running:
            return
        self._running, self._done = None, now
        if task.cancelled():
            self._failure = DeviceError("link", f"`{self._called}` failed: the device's own program cancelled it")
        elif isinstance(error, DeviceError):
            self._failure = error
        elif error is not None:
            self._failure = _failed(self.name, f"`{self._called}`", error)

    def take_failure(self) -> Optional[DeviceError]:
        """What a verb has raised, once."""
        failure, self._failure = self._failure, None
        return failure

    def done_at(self) -> Optional[int]:
        """When the verb that was begun last has come to its end; of a velocity its end."""
        if self._failure is not None:
            return self._done
        return self._done if self._until is None else self._until

    def gives_way(self) -> bool:
        """Whether a velocity goes on."""
        return self._until is not None and self._now < self._until

    def give_way(self, now: int) -> None:
        """Ends a velocity for the command that begins next; another velocity takes the motion over as it is."""
        self._cancel()
        self._rolls = self._follower is True
        self._until, self._done = None, now
        if not self._rolls:
            self.device.halt()

    def halt(self, now: int) -> None:
        """Cancels the verb, and has the device stand."""
        self._cancel()
        self._rolls, self._until, self._done, self._follower, self._leaves = False, None, None, None, False
        self.device.halt()

    def give_up(self) -> None:
        """Cancels the verb, and has the device stand, whatever it raises: for the end of a device that has failed."""
        self._cancel()
        try:
            self.device.halt()
        except Exception:
            LOG.exception("%s: it cannot be halted", self.name)

    def _cancel(self) -> None:
        task, self._running = self._running, None
        if task is not None:
            self._halted[task] = task.get_loop().time() + self.stopping_time / 1e6
            # From here on it takes no step more, but for its own clearing up.
            task.cancel()

    def advance(self, now: int) -> None:
        """Ends a velocity whose time is over."""
        self._now = now
        if self._until is not None and now >= self._until:
            self._cancel()
            self._done, self._until = self._until, None
            self.device.halt()

    def next_wake(self) -> Optional[int]:
        """While a verb runs it is called again and again: so it is noticed that the program stood still."""
        return None if self._running is None else self._now + self.period

    # What is known of it.

    def is_moving(self) -> bool:
        """Whether a verb that moves it is carried out, or one that was halted has not come to its end."""
        acts = self._running is not None or self._until is not None or self._rolls
        return (acts and self._moves) or bool(self._halted)

    def is_at_rest(self) -> bool:
        """Whether a halt would change nothing."""
        return self._running is None and not self._leaves and not self.is_moving()

    def is_reached(self) -> bool:
        """Whether the device says that it is."""
        return self.device.is_reached()

    def position(self) -> Mapping[str, Any]:
        """Where the device says that it is."""
        return _said(self.device.position())

    def report(self) -> Dict[str, Any]:
        """What else the device says."""
        return _said(self.device.report())


class _Steps:
    """Goes on with something that can be awaited step by step, each only if it may be taken; cancels it otherwise."""

    def __init__(self, steps: Iterator[Any], may_go_on: Callable[[], bool], is_late: Callable[[], bool]) -> None:
        self._steps: Any = steps
        self._may_go_on, self._is_late = may_go_on, is_late

    def __await__(self) -> Generator[Any, Any, Any]:
        error: Optional[BaseException] = None
        ends = False
        while True:
            if not ends and not self._may_go_on():
                # It was cancelled just now: that comes with the next turn of the loop, once.
                error = (yield from self._turn(None)) or asyncio.CancelledError()
            # From its cancellation on it may clear up, for a while.
            ends = ends or isinstance(error, asyncio.CancelledError)
            if ends and self._is_late():
                self._give_up()
            try:
                waits_for = self._steps.throw(error) if error is not None else next(self._steps)
            except StopIteration as end:
                return end.value
            error = yield from self._turn(waits_for)
            ends = ends or isinstance(error, asyncio.CancelledError)

    def _give_up(self) -> None:
        try:
            self._steps.close()
        except RuntimeError:
            # It takes nothing for an end; it gets no other turn.
            pass
        raise TimeoutError("it still took steps when the device had to stand")

    def _turn(self, waits_for: Any) -> Generator[Any, Any, Optional[BaseException]]:
        """Lets the loop go on until what is waited for is there; gives what is to be raised then."""
        try:
            yield waits_for
        except BaseException as raised:
            return raised
        return None


async def _run_in_steps(found: Any, may_go_on: Callable[[], bool], is_late: Callable[[], bool]) -> Any:
    return await _Steps(found.__await__(), may_go_on, is_late)


def _check_alone(script: Script) -> None:
    """A velocity stands alone: what would follow it would begin nobody knows where."""
    for action, number in script.actions():
        if action.verb.velocity is not None and len(script.statements) > 1:
            raise syntax(0, f"`{action.verb.name}` stands alone in its script").at_statement(number)


def _failed(name: str, what: str, error: BaseException) -> DeviceError:
    """What is raised that is not a `DeviceError`: nothing is known of what was under way, as where the link to the mechanism fails."""
    LOG.error("%s: %s failed", name, what, exc_info=error)
    return DeviceError("link", f"{what} failed: {type(error).__name__}: {error}")


def _said(told: Mapping[str, Any]) -> Dict[str, Any]:
    """What a device tells of itself; `ValueError` for what only its queue may say, such as that it rests."""
    wrong = sorted(RESERVED.intersection(told))
    if wrong:
        raise ValueError(f"`{wrong[0]}` is a key of every device's state: position and report need another one")
    return {key: _plain(value) for key, value in told.items()}


def _plain(value: Any) -> Any:
    """A number of any kind as one that can be sent."""
    if isinstance(value, (bool, int, float)) or not isinstance(value, numbers.Real):
        return value
    return float(value)
