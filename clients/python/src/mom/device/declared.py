"""The machine of a device that declares its verbs: runs them, one at a time."""

from __future__ import annotations

import asyncio
import inspect
import logging
import math
import numbers
import time
from dataclasses import dataclass
from typing import Any, Callable, Dict, Mapping, Optional

from ..values import pack
from .declare import Attachment, Verb
from .device import Call, Device
from .errors import DeviceError, syntax
from .machine import Machine
from .rest import REST, Sample
from .script import Attachments, Script
from .steps import Steps
from .words import ScriptWord, Words

LOG = logging.getLogger("mom")

RESERVED = frozenset(
    ("seq", "moving", "rest", "reached", "stopped", "stop", "estop", "executing", "waiting", "fence", "stops-within")
)
"""The keys of a state that say how every device stands."""

_LOOK = 150_000
"""µs between two looks at a device that rests."""


_EARLY = 10_000
"""µs by which a mechanism is kept alive sooner where its device is asked for something else just then."""

_TURNS = 10
"""Turns of the loop in which what has come is heard, from the connection to the device."""


@dataclass
class Action:
    """What a statement of a declared device makes it do."""

    verb: Verb
    arguments: Dict[str, Any]


class DeclaredMachine(Machine):
    """Carries out the verbs of a `Device`, on the running loop.

    What a halted verb still clears up comes to its end before the next one begins. A halt follows each step that it still takes, and
    others come meanwhile: what it waits for may take steps of its own.
    """

    def __init__(self, device: Device, clock: Callable[[], float] = time.monotonic) -> None:
        self.device, self._clock = device, clock
        self.on_end: Callable[[asyncio.Future[Any]], None] = lambda task: None
        """Called when a verb has come to its end, which `ended` is to be told of."""
        self.may_go_on: Callable[[], None] = lambda: None
        """Called before each step of a verb: it may halt the device."""
        self.on_failure: Callable[[Exception], None] = lambda error: LOG.error("%s: it cannot be halted", self.name, exc_info=error)
        """Called with what a halt has raised that followed a step of a verb."""
        self.name = f"the {device.called()}"
        self.verbs = tuple(device._verbs)
        self.stopping_time = device.stops_within * 1000
        self.tolerance = device.tolerance
        self.completes = device.completes_on_give
        self._running: Optional[asyncio.Future[Any]] = None
        self._called, self._moves = "", False
        """The verb that was begun last, and whether it moves the device."""
        self._steps: Dict[asyncio.Future[Any], Steps] = {}
        """Those of the verbs that have not come to their end."""
        self._halted: Dict[asyncio.Future[Any], Steps] = {}
        """Verbs that were cancelled, and have not come to their end yet."""
        self._stuck: Dict[asyncio.Future[Any], str] = {}
        """Verbs that have not come to their end by the time at which the device has to stand, with their names."""
        self._undead = ""
        """A verb that takes nothing for its end, and gets no turn any more."""
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
        self._now, self._blocked = 0, 0
        self._stood = 0
        """When it was halted last because a verb that was halted has not come to its end."""
        self._has_estop = False
        """Whether it has told of an emergency stop."""
        self._kept = 0
        """When its mechanism was kept alive last."""
        self._seen: Optional[Sample] = None
        """Where it was when it had moved by its tolerance last."""
        self._moved_at = -REST
        """When that was seen."""

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
        stuck = self._stuck_error()
        if stuck is not None:
            raise stuck
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
        stuck = self._stuck_error()
        if stuck is not None:
            raise stuck
        verb, goes_on = action.verb, self._rolls and action.verb.velocity is not None
        if self._rolls and not goes_on:
            self._stand()
        self._rolls, self._follower, self._failure = False, None, None
        self._called, self._moves, self._done = verb.name, verb.moves, None
        self._until = None if verb.velocity is None else now + verb.velocity * 1000
        method, steps = getattr(self.device, verb.method), Steps(self.may_go_on, self._stand_after)
        if self._halted:
            self._run(steps, self._after_halted(steps, method, action.arguments))
            return
        began = self._clock()
        try:
            found = _call(method, action.arguments)
        except DeviceError:
            raise
        except Exception as error:
            raise _failed(self.name, f"`{verb.name}`", error) from error
        if inspect.isawaitable(found):
            steps.take(found)
            self._run(steps, steps.run())
        else:
            self._leaves = self._leaves or (verb.moves and verb.velocity is None)
            self._end_plain(steps, int((self._clock() - began) * 1e6), now)

    def _end_plain(self, steps: Steps, took: int, now: int) -> None:
        """A plain function has ended: at once, unless it has blocked."""
        if took <= self.period or (self._until is not None and now + took < self._until):
            self._done = now
            return
        if self._until is not None:
            # Its time is over.
            self._until = None
            self._stand()
        self._blocked += took
        steps.take(self._hear_first(took))
        self._run(steps, steps.run())

    async def _hear_first(self, took: int) -> None:
        """Behind a plain function that has blocked so long: what has come meanwhile, such as a stop, is heard before its end counts."""
        if took > self.period:
            await asyncio.sleep(self.period / 1e6)
            for _ in range(_TURNS):
                await asyncio.sleep(0)
        if took > self.patience:
            raise DeviceError("halted", f"{self.name} was halted: its program stood still for {took // 1000} ms")

    def _run(self, steps: Steps, carried_out: Any) -> None:
        task = asyncio.ensure_future(carried_out)
        self._running, self._steps[task] = task, steps
        task.add_done_callback(self._tell_end)

    def _tell_end(self, task: asyncio.Future[Any]) -> None:
        self._steps.pop(task).drop_unbegun()
        was_halted = self._halted.pop(task, None) is not None
        self._stuck.pop(task, None)
        if was_halted and not task.cancelled():
            LOG.warning("%s: a verb that was halted did not end by that", self.name, exc_info=task.exception())
        self.on_end(task)

    async def _after_halted(self, steps: Steps, method: Callable[..., Any], arguments: Dict[str, Any]) -> None:
        while self._halted:
            await asyncio.wait(set(self._halted))
        if not steps.may_go_on():
            raise asyncio.CancelledError
        began = self._clock()
        found = _call(method, arguments)
        if inspect.isawaitable(found):
            steps.take(found)
            await steps.run()
            return
        self._leaves = self._moves and self._until is None
        if steps.is_halted:
            self._stand_after(steps)
        took = int((self._clock() - began) * 1e6)
        self._blocked += took
        await self._hear_first(took)

    def ended(self, task: asyncio.Future[Any], now: int) -> None:
        """A verb has come to its end, or will not."""
        if not task.done():
            if self._running is not None:
                # What waits for its end waits no longer.
                self._cancel()
                self._failure, self._done = self._stuck_error(), now
            return
        if task is not self._running:
            return
        error = None if task.cancelled() else task.exception()
        self._running, self._done = None, now
        if task.cancelled():
            self._failure = DeviceError("link", f"`{self._called}` failed: the device's own program cancelled it")
        elif isinstance(error, DeviceError):
            self._failure = error
        elif error is not None:
            self._failure = _failed(self.name, f"`{self._called}`", error)

    def _stuck_error(self) -> Optional[DeviceError]:
        """Why it carries out nothing, if a verb does not end."""
        verb = next(iter(self._stuck.values()), self._undead)
        return DeviceError("link", f"`{verb}` was halted and does not end: the program of {self.name} has to be mended") if verb else None

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
        self._rolls = self._follower is True
        self._cancel(self._rolls)
        self._until, self._done = None, now
        if not self._rolls:
            self._stand()

    def halt(self, now: int) -> None:
        """Cancels the verb, and has the device stand."""
        self._cancel()
        self._rolls, self._until, self._done, self._follower, self._leaves = False, None, None, None, False
        self._stand()

    def give_up(self) -> None:
        """Cancels the verb, and has the device stand, whatever it raises: for the end of a device."""
        self._cancel()
        try:
            self._stand()
        except Exception:
            LOG.exception("%s: it cannot be halted", self.name)

    async def come_to_an_end(self) -> None:
        """Lets verbs that were cancelled come to their end, for as long as they may take, and has the device stand."""
        try:
            if self._halted:
                await asyncio.wait(set(self._halted), timeout=(self.stopping_time + 2 * self.period) / 1e6)
        finally:
            self.give_up()

    def _stand(self) -> None:
        for steps in self._halted.values():
            steps.is_taken_over = False
        began = self._clock()
        try:
            found: Any = self.device.halt()  # type: ignore[func-returns-value]
        finally:
            self._blocked += int((self._clock() - began) * 1e6)
        if inspect.isawaitable(found):
            if inspect.iscoroutine(found):
                found.close()
            text = f"has to be a plain function: it is called at once, and gave a {type(found).__name__}"
            raise TypeError(f"the `halt` of {self.name} {text}")

    def _stand_after(self, steps: Steps) -> None:
        """Has the device stand after a step of a verb that was halted."""
        if steps.is_taken_over:
            return
        try:
            self._stand()
        except Exception as error:
            self.on_failure(error)

    def blocked(self) -> int:
        """For how long its halts have kept the program, and plain functions behind which what has come meanwhile is heard first."""
        return self._blocked

    def _cancel(self, is_taken_over: bool = False) -> None:
        task, self._running = self._running, None
        if task is None:
            return
        loop, steps = task.get_loop(), self._steps.get(task)
        if steps is None:
            # It has ended just now.
            return
        self._halted[task] = steps
        steps.halt(loop.time() + self.stopping_time / 1e6, is_taken_over)
        loop.call_later(self.stopping_time / 1e6, self._end_late, task, self._called)
        # From here on it takes no step more, but for its own clearing up.
        task.cancel()

    def _end_late(self, task: asyncio.Future[Any], called: str) -> None:
        """The device has to stand now: a verb that still clears up gets no turn any more."""
        steps = self._halted.get(task)
        if steps is None:
            return
        # Where another velocity takes its motion over: that does not wait any longer, and begins from a stand.
        steps.is_taken_over = False
        if not steps.give_up():
            self._undead = called
            self.on_end(task)
        # What it waits for ends by that, or goes on without it.
        task.cancel()
        task.get_loop().call_later(self.period / 1e6, self._note_stuck, task, called)

    def _note_stuck(self, task: asyncio.Future[Any], called: str) -> None:
        if task in self._halted:
            LOG.error("%s: `%s` was halted, and does not end", self.name, called)
            self._stuck[task] = called
            self.on_end(task)

    def advance(self, now: int) -> None:
        """Ends a velocity whose time is over, and looks where the device is."""
        self._now = now
        if self._until is not None and now >= self._until:
            self._cancel()
            self._done, self._until = self._until, None
            self._stand()
        elif now - self._stood >= self.period and any(not steps.is_taken_over for steps in self._halted.values()):
            # What takes steps that it waits for nobody can see.
            self._stood = now
            self._stand()
        if (self.is_driven() or self._leaves) and now - self._kept >= self.period - _EARLY:
            self._kept = now
            self.device.keep_alive()
        sample = self.measured(now)
        if sample is None or not sample.is_finite():
            self._seen = None
        elif self._seen is None:
            self._seen = sample
        elif not sample.is_near(self._seen, self.tolerance):
            self._seen, self._moved_at = sample, now

    def next_wake(self) -> Optional[int]:
        """It is called again and again: so it is noticed that the program stood still, and that the device is moved."""
        acts = self._running is not None or self._leaves or self._halted or self.is_carried()
        return self._now + (self.period if acts else _LOOK)

    # What is known of it.

    def is_moving(self) -> bool:
        """Whether a verb that moves it is carried out, or one that was halted has not come to its end."""
        return self.is_driven() or bool(self._halted)

    def is_driven(self) -> bool:
        """Whether a verb that moves it is carried out: one that was halted may not move it."""
        acts = self._running is not None or self._until is not None or self._rolls
        return acts and self._moves

    def is_at_rest(self) -> bool:
        """Whether a halt would change nothing."""
        return self._running is None and not self._leaves and not self.is_moving() and not self.is_carried()

    def is_carried(self) -> bool:
        """Whether its position has changed just now."""
        return self._now - self._moved_at < REST

    def is_reached(self) -> bool:
        """Whether the device says that it is."""
        return self.device.is_reached()

    def estop(self) -> Optional[bool]:
        """Whether the device says that its emergency stop is pressed: an input may say so by a number."""
        pressed: Any = self.device.estop()
        if pressed is None and not self._has_estop:
            return None
        # What says nothing is not taken for a button that is not pressed.
        if not isinstance(pressed, (bool, int)) and type(pressed).__module__ != "numpy":
            raise TypeError(f"the `estop` of {self.name} has to give True or False, and gave {pressed!r}")
        self._has_estop = True
        return bool(pressed)

    def position(self) -> Mapping[str, Any]:
        """Where the device says that it is."""
        return _said(self.device.position())

    def report(self) -> Dict[str, Any]:
        """What else the device says."""
        return _said(self.device.report())


def _check_alone(script: Script) -> None:
    """A velocity stands alone: what would follow it would begin nobody knows where."""
    for action, number in script.actions():
        if action.verb.velocity is not None and len(script.statements) > 1:
            raise syntax(0, f"`{action.verb.name}` stands alone in its script").at_statement(number)


def _call(method: Callable[..., Any], arguments: Mapping[str, Any]) -> Any:
    """Calls the method of a verb."""
    found = method(**arguments)
    if inspect.isgenerator(found) or inspect.isasyncgen(found):
        raise TypeError("a generator is not a verb: it would do nothing")
    return found


def _failed(name: str, what: str, error: BaseException) -> DeviceError:
    """What is raised that is not a `DeviceError`: nothing is known of what was under way, as where the link to the mechanism fails."""
    LOG.error("%s: %s failed", name, what, exc_info=error)
    return DeviceError("link", f"{what} failed: {type(error).__name__}: {error}")


def _said(told: Mapping[str, Any]) -> Dict[str, Any]:
    """What a device tells of itself; `ValueError` for what only its queue may say, such as that it rests."""
    wrong = sorted(RESERVED.intersection(told))
    if wrong:
        raise ValueError(f"`{wrong[0]}` is a key of every device's state: position and report need another one")
    said = {key: _plain(value) for key, value in told.items()}
    # What cannot be sent would leave it mute. A number that is not known is left out later.
    pack({key: value for key, value in said.items() if not (isinstance(value, float) and not math.isfinite(value))})
    return said


def _plain(value: Any) -> Any:
    """A number of any kind as one that can be sent."""
    if isinstance(value, (bool, int, float)) or not isinstance(value, numbers.Real):
        return value
    return float(value)
