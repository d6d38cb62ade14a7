"""The device's server: reacts to the events of its channel, without a connection and without a clock."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Callable, Dict, Generic, List, Optional, Tuple, Union

from ..clock import Age
from ..errors import WireError
from ..events import Count, Dropped, Event, Expelled, Grabbed, Joined, Lagged, LinkDown, Message, Rejoined, Released
from ..gate import FenceGate, StaleError
from ..latch import Held, Latch, Reaction
from ..parcel import Parcel
from .command import Command, Order, Progress, QueueEvent, State
from .errors import DeviceError
from .estop import Estop
from .fresh import BASED_ON, Freshness, Pull, RefusedCommandError, StateGate
from .queue import CommandQueue, M
from .script import Attachments, read_script

COMMAND = "command"
"""The message that carries a script."""
STATUS = "status"
"""The message that tells how far a command has come."""
STATE = "state"
"""The message that tells the device's state."""
NEXT = "next"
"""The message by which a device asks for its next command."""

_HUB = "hub"
_SAFE = "the hub ordered the safe state, because the token's owner lost it or gave it up"
_UNLOOKED = "?"
"""Stands for the token that guards the channel before that was looked at; the path of a token begins with `/`."""


@dataclass(frozen=True)
class Resumed(Event):
    """The link goes on over another connection: `LinkDown` was told to the server when the last one was lost."""


class DeviceServer(Generic[M]):
    """The decisions of a device's peer. Times are in µs; every method gives the parcels that are to be sent, in order.

    `handle` takes an event of the device's channel, `advance` lets time pass: the driver calls it whenever `next_wake` is due.

    - A command is obeyed if the fence gate lets it pass, if the state that it was based on (where it names one, as a relative one has to)
      still holds, if it is not too old, and if the device takes its script. Otherwise, and at every later change, a `status` is broadcast.
    - Whenever the owner changes, another token guards the channel, the hub sends `halt`, or the link is lost, all commands end and the
      device stands at once. Where owners hand over by agreement and the hub sends no `halt`, the present statement comes to its end in a
      machine that `completes`; what comes meanwhile is refused as `changing-hands`, and may be sent again.
    - The first motion of a new owner waits until the device rests, at most twice its stopping time and a second.
    - Anybody's `stop` ends all commands too, and holds until an `unstop` that names it or a newer one (`Latch`). A gap in the events is a
      stop of its own, of which it tells the hub. After each of both it says how it stands, changed or not.
    - An emergency stop at the device itself (`Machine.estop`) is a stop of its own, too. While it is pressed nothing is carried out,
      whatever is lifted.
    - A peer that joins the channel gets the state; after a lost link it is sent again.
    """

    def __init__(self, machine: M, channel: str, start: datetime) -> None:
        self._queue: CommandQueue[M] = CommandQueue(machine)
        self._channel = channel
        self.name: Optional[str] = None
        """What it is called at the hub, once that is known: so it can stop itself there."""
        self.latch = Latch()
        """Whether it may move."""
        self.held: Optional[Held] = None
        """Why it may not move beside that, as its driver knows: its hub is silent."""
        self._states = StateGate(start)
        self._told: Optional[Dict[str, Any]] = None
        """Where the device was in the last state that was told."""
        self._guard: Optional[str] = _UNLOOKED
        """The token that guards its channel."""
        self._fence = 0
        """The newest fence of it that was heard of."""
        self._commanded = 0
        """That of the command that was taken last, 0 for the hub's."""
        self._pull: Optional[Pull] = None
        self._handing_over = False
        """Whether its owner has given the token away, and nobody has it yet."""
        self.estop = Estop()
        """The emergency stop at the device itself."""
        self._fresh = Freshness()
        self._out: List[Parcel] = []

    # Settings.

    def with_max_age(self, max_age: int) -> DeviceServer[M]:
        """This server, for commands that are not older than this (µs) when they begin, whatever their senders say."""
        self._fresh.max_age = max_age
        return self

    def at_pace(self, pace: int) -> DeviceServer[M]:
        """This server, for a device whose time passes so many times as fast as that of its users, as a simulated one's may."""
        self._queue.pace = self._fresh.pace = max(pace, 1)
        return self

    def pulling(self, wait: int) -> DeviceServer[M]:
        """Has it ask for its commands by `next {wait}`, each time for so many µs, and take only answers that are surely fresh."""
        self._pull = Pull(wait)
        return self

    # What is known of it.

    @property
    def machine(self) -> M:
        """The device itself."""
        return self._queue.machine

    def state(self) -> State:
        """How it stands."""
        return self._queue.state()

    def next_wake(self) -> Optional[int]:
        """When `advance` is to be called next; `None` while the device has nothing to do."""
        return self._queue.next_wake()

    def silence(self, now: int) -> int:
        """For how many µs its program has stood still now."""
        return self._queue.silence(now)

    def may_move(self) -> Optional[Held]:
        """Why it may not move; `None` if it may."""
        own = None if self.estop.owed is None else Held("own", f"stopped by itself: {self.estop.owed}")
        return own or self.latch.may_move() or self.held

    # What happens to it.

    def handle(self, event: Event, gate: FenceGate, age: Optional[Age], now: int) -> List[Parcel]:
        """Handles an event. `gate` is the channel's; `age` is how old a message is, as far as that is known."""
        self._advance(now)
        self._watch_guard(gate, now)
        reaction = self.latch.observe(event)
        self.estop.hear(event, self.name, isinstance(event, Resumed))
        if reaction is not None:
            self._react(event, reaction, now)
        if isinstance(event, Message):
            self._message(event.parcel, gate, age, now)
        elif isinstance(event, Joined):
            self._out.append(self._full_state([event.member.peer]))
        elif isinstance(event, Count) or (isinstance(event, Dropped) and event.parcel.map().get("sender") == _HUB):
            # Who has joined is not known: all are told.
            self._report()
        elif isinstance(event, (Rejoined, Resumed)):
            self._report()
            self._tell_own_stop()
            self._tell_estop()
        elif isinstance(event, Expelled) and event.peer == self.name:
            self._halt(f"this device was put out of its channel: {event.text or 'nobody says why'}", now)
        elif isinstance(event, Grabbed):
            self._take_owner(event.fence, now)
        elif isinstance(event, Released):
            self._handing_over = self.machine.completes and event.reason in ("given", "returned")
            self._end_older(event.fence + 1, now)
        return self._said()

    def advance(self, now: int) -> List[Parcel]:
        """Lets time pass until `now`."""
        self._advance(now)
        return self._said()

    def note(self, now: int, what: Callable[[M], None]) -> List[Parcel]:
        """Lets something be done to the device that no command does, such as that news of it have come."""
        self._act(lambda events: self._queue.note(now, what, events))
        return self._said()

    def break_off(self, error: DeviceError) -> List[Parcel]:
        """Ends every command with this error, where the device itself can be asked nothing any more."""
        for progress in self._queue.drop_all():
            self._out.append(self._status(progress, "error", error.content()))
        return self._said()

    def fail(self, now: int, error: DeviceError) -> List[Parcel]:
        """Ends every command with this error, because the device cannot carry it out."""
        self._act(lambda events: self._queue.fail(now, error, events))
        return self._said()

    def halt(self, reason: str, now: int) -> List[Parcel]:
        """Ends every command, for a reason in plain words."""
        self._halt(reason, now)
        return self._said()

    def stop_itself(self, why: str, now: int) -> List[Parcel]:
        """Stops by itself until a peer lifts that, and tells the hub."""
        self._advance(now)
        self._obey_stop(lambda events: self._queue.stop(now, self.latch.stop_itself(why).why, events))
        self._tell_own_stop()
        return self._said()

    def report(self) -> List[Parcel]:
        """Tells all members of the channel the state."""
        self._watch_estop(self._queue.now)
        self._report()
        return self._said()

    def ask(self, gate: FenceGate, now: int) -> List[Parcel]:
        """Asks for the next command, if that is due and the token has an owner."""
        due = self.asks_at(gate)
        if self._pull is not None and due is not None and due <= now:
            parcel = self._broadcast(NEXT, {"wait": self._pull.wait // 1000})
            parcel.delivery = "latest"
            self._states.stamp(parcel, False)
            self._pull.ask(parcel.id, now)
            self._out.append(parcel)
        return self._said()

    def asks_at(self, gate: FenceGate) -> Optional[int]:
        """When `ask` has to be called next."""
        guard = gate.guard
        if self._pull is None or self._queue.is_busy or guard is None or guard.owner is None:
            return None
        try:
            self._queue.check_free()
        except DeviceError:
            return None
        return self._pull.due

    # Messages.

    def _message(self, parcel: Parcel, gate: FenceGate, age: Optional[Age], now: int) -> None:
        if parcel.name == "halt" and parcel.sender == _HUB:
            # Only the hub may send it; a peer that wants the device to stop has `stop`.
            self._halt(_SAFE, now)
        if parcel.name != COMMAND or parcel.history:
            return
        # The safe state that the token declares ends what the owner began, as `halt` does, and then moves the device.
        if parcel.sender == _HUB:
            self._halt(_SAFE, now)
        order = Order(parcel.sender or "", parcel.id, parcel.fence)
        try:
            gate.check(parcel)
            self._obey(order, parcel, age, now)
        except StaleError:
            self._refuse(order, _stale(parcel, gate))
        except DeviceError as error:
            self._refuse(order, error.content())
        except RefusedCommandError as refused:
            self._refuse(order, _words(refused.wire))

    def _refuse(self, order: Order, error: Dict[str, Any]) -> None:
        self._out.append(self._status(Progress(order, 0, 0), "error", error))

    def _obey(self, order: Order, parcel: Parcel, age: Optional[Age], now: int) -> None:
        # The token's events may still be under way; the command's fence has the same information.
        self._take_owner(order.fence or 0, now)
        queue, name = self._queue, self.machine.name
        self._states.moving = queue.is_busy or queue.is_moving()
        self._states.check(parcel)
        if self._pull is not None:
            self._pull.check(parcel, age)
        text, attachments = _script_of(parcel.content, name)
        if order.id is not None and any(other == order for other in queue.orders()):
            text = f"command {order.id} of {order.peer} is still waiting or executing; choose another id"
            raise DeviceError("duplicate-id", text)
        if self.estop.is_pressed:
            raise DeviceError("estop", f"the emergency stop of {name} is pressed: reset it there, and then lift the stop")
        queue.check_free()
        held = self.may_move()
        if held is not None:
            raise DeviceError("stopped", f"{name} may not move: {held.text}")
        script = read_script(self.machine, text, attachments)
        first = (self.machine.is_relative(action) for action, _ in script.actions())
        is_relative = next((relative for relative in first if relative is not None), False)
        if is_relative and BASED_ON not in parcel.extra:
            text = "a relative command requires the slot `based-on`: the id of the state that it is based on"
            raise DeviceError("no-state", text)
        command = Command(order, script, self._fresh.use_by(name, parcel, age, now))
        self._act(lambda events: queue.submit(command, now, events))
        self._commanded = order.fence or 0
        if self._pull is not None:
            self._pull.renew(now)

    # Stops.

    def _react(self, event: Event, reaction: Reaction, now: int) -> None:
        """Does what an event about stops means."""
        queue = self._queue
        if reaction.word == "stop":
            self._obey_stop(lambda events: queue.stop(now, reaction.why, events))
        elif reaction.word == "free" and self.estop.owed is not None:
            # It was said before the stop that the hub does not know yet.
            self._report()
        elif reaction.word == "free":
            self._obey_stop(lambda events: queue.unstop(now, events))
        elif reaction.word == "same":
            self._report()
        elif isinstance(event, LinkDown):
            self._halt("the link to the hub was lost", now)
        else:
            self._obey_stop(lambda events: queue.halt(now, "a stop has come that was lifted before", events))
        if isinstance(event, Lagged):
            self._tell_own_stop()

    def _obey_stop(self, action: Callable[[List[QueueEvent]], None]) -> None:
        """Stops, or does so no more, and says how the device stands, changed or not."""
        before = len(self._out)
        self._act(action)
        self._report_unless_told(before)

    def _watch_estop(self, now: int) -> None:
        """Looks at the emergency stop of the device itself.

        Each press and each reset is a stop of its own: a person who resets it does not set the device in motion, nor does a velocity that
        is still being sent, nor an `unstop` that was said before.
        """
        why = self.estop.look(self.machine.estop())
        if why is None:
            return
        name = "estop" if self.estop.is_pressed else "stopped"
        self._obey_stop(lambda events: self._queue.stop(now, why, events, name))
        self._tell_estop()

    def _tell_estop(self) -> None:
        """Tells the hub that its emergency stop was pressed or reset, as long as the hub does not know."""
        why = self.estop.to_say()
        if why is not None and self.name is not None:
            stop = Parcel("message", "stop", self._channel, {"reason": f"stopped by itself: {why}"}, address=[self.name])
            self._states.stamp(stop, False)
            self.estop.said(stop.id)
            self._out.append(stop)

    def _tell_own_stop(self) -> None:
        """Tells the hub that it has stopped itself, if the hub does not know: from then on it is a stop like any other."""
        held = self.latch.may_move()
        if self.name is None or not self.latch.is_own or held is None:
            return
        self._out.append(Parcel("message", "stop", self._channel, {"reason": held.text}, address=[self.name]))

    # Owners.

    def _watch_guard(self, gate: FenceGate, now: int) -> None:
        """Ends all commands where another token guards the channel than before, or one where none did.

        Fences of two tokens say nothing of each other, and a sender that was allowed before may not be now.
        """
        token = gate.guard.token if gate.guard is not None else None
        if self._guard == token:
            return
        is_first, self._guard = self._guard == _UNLOOKED, token
        if not is_first:
            self._fence, self._commanded, self._handing_over = 0, 0, False
            self._halt("another token guards its channel from now on", now)

    def _take_owner(self, fence: int, now: int) -> None:
        """The token has an owner of this fence, perhaps a new one."""
        if fence <= self._fence:
            return
        # Before anything is told: each state from now on says that it stands for the new owner.
        self._fence = fence
        if self._pull is not None:
            self._pull.renew(now)
        before = len(self._out)
        self._end_older(fence, now)
        self._handing_over = False
        self._act(lambda events: self._queue.change_hands(now, events))
        self._report_unless_told(before)

    def _end_older(self, fence: int, now: int) -> None:
        """Ends what older owners have begun, also what their commands left behind: its sender no longer owns the token."""
        queue = self._queue
        is_left = not queue.is_busy and not queue.is_at_rest() and self._commanded < fence
        # What was sent without a fence, before the channel was guarded, is older than any; the hub's own is the safe state of a change.
        is_older = any((order.fence or 0) < fence and order.peer != _HUB for order in queue.orders())
        if not is_left and not is_older:
            return
        reason = "the token changed hands"
        if self._handing_over:
            self._act(lambda events: queue.end_statement(now, reason, events))
        else:
            self._halt(reason, now)

    # What is said.

    def _said(self) -> List[Parcel]:
        out, self._out = self._out, []
        return out

    def _advance(self, now: int) -> None:
        self._watch_estop(now)
        self._act(lambda events: self._queue.advance(now, events))

    def _halt(self, reason: str, now: int) -> None:
        self._act(lambda events: self._queue.halt(now, reason, events))

    def _report(self) -> None:
        self._out.append(self._full_state())

    def _report_unless_told(self, before: int) -> None:
        """Says how it stands, if nothing that was said after the first so many parcels did."""
        if not any(parcel.name == STATE for parcel in self._out[before:]):
            self._report()

    def _act(self, action: Callable[[List[QueueEvent]], None]) -> None:
        """Lets the device act, and reports the outcome, also where it was refused at last."""
        events: List[QueueEvent] = []
        try:
            action(events)
        finally:
            for event in events:
                self._out.append(self._told_of(event))

    def _told_of(self, event: QueueEvent) -> Parcel:
        if isinstance(event, State):
            return self._state(event)
        return self._status(event.progress, event.word, event.error.content() if event.error is not None else None)

    def _status(self, progress: Progress, word: str, error: Optional[Dict[str, Any]] = None) -> Parcel:
        """`{id?, peer, state, statement, of, fence?, error?}`."""
        order = progress.order
        content = {**_id(order), "peer": order.peer, "state": word, "statement": progress.statement, "of": progress.of}
        if order.fence is not None:
            content["fence"] = order.fence
        if error is not None:
            content["error"] = error
        parcel = self._broadcast(STATUS, content)
        parcel.reference = order.id
        return parcel

    def _full_state(self, to: Optional[List[str]] = None) -> Parcel:
        """The state with what never changes, for a peer that has just come."""
        parcel = self._state(self._queue.state())
        parcel.content["stops-within"] = self.machine.stopping_time // 1000
        parcel.address = to
        return parcel

    def _state(self, state: State) -> Parcel:
        """`{seq, …position, …report, moving, rest?, reached, stopped, estop?, stop, executing?, waiting, fence?}`."""
        content: Dict[str, Any] = {"seq": state.seq}
        for known in (state.position, state.report):
            content.update((key, value) for key, value in known.items() if not _is_unknown(value))
        content["moving"] = state.moving
        if state.rest is not None:
            content["rest"] = state.rest
        stopped = state.stopped or self.estop.owed is not None
        content.update({"reached": state.reached, "stopped": stopped, "stop": self.latch.number})
        if self.estop.known is not None:
            content["estop"] = self.estop.known
        if state.executing is not None:
            progress = state.executing
            content["executing"] = {
                **_id(progress.order), "peer": progress.order.peer, "statement": progress.statement, "of": progress.of,
            }  # fmt: skip
        content["waiting"] = state.waiting
        if self._fence > 0:
            content["fence"] = self._fence
        parcel = self._broadcast(STATE, content)
        parcel.delivery = "latest"
        position = dict(state.position)
        moved = self._told != position
        self._told = position
        self._states.stamp(parcel, moved)
        return parcel

    def _broadcast(self, name: str, content: Dict[str, Any]) -> Parcel:
        """A broadcast without echo."""
        return Parcel("message", name, self._channel, content, echo=False)


def _script_of(content: Any, name: str) -> Tuple[str, Attachments]:
    """The script of a command's content, and the bytes that came with it."""
    if isinstance(content, str):
        return content, Attachments()
    script: Union[str, Any] = content.get("script") if isinstance(content, dict) else None
    if not isinstance(script, str):
        text = f"the content of a command is a string, the script of {name}, or {{script, attachments}}"
        raise DeviceError("syntax", text)
    if "attachments" not in content:
        return script, Attachments()
    if not isinstance(content["attachments"], dict):
        raise DeviceError("syntax", "attachments are a map of names to bytes")
    return script, Attachments(content["attachments"])


def _id(order: Order) -> Dict[str, Any]:
    return {} if order.id is None else {"id": order.id}


def _is_unknown(value: Any) -> bool:
    """Whether it is a number that cannot be said: what is not known is left out."""
    return isinstance(value, float) and not math.isfinite(value)


def _words(wire: WireError) -> Dict[str, Any]:
    return {"name": wire.code, "code": wire.number, "text": wire.text, **wire.details}


def _stale(parcel: Parcel, gate: FenceGate) -> Dict[str, Any]:
    """Why a command that its sender may not give any more is refused."""
    guard = gate.guard
    owner = guard.owner if guard is not None else None
    fence = guard.fence if guard is not None else 0
    now = "nobody owns its token now" if owner is None else f"{owner} owns its token now, with fence {fence}"
    given = "without a fence" if parcel.fence is None else f"under fence {parcel.fence}"
    error = _words(WireError("older-fence", f"the command was sent {given}, and {now}"))
    return error if owner is None else {**error, "owner": owner}
