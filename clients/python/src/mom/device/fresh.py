"""What a command is based on, how old it may be when it begins, and which request it answers."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Optional

from ..clock import Age
from ..errors import WireError
from ..parcel import Parcel
from ..values import to_micros
from .errors import DeviceError

BASED_ON = "based-on"
"""The slot of a command that names the state which it was based on, by that state's id."""
MAX_ID = (1 << 53) - 1
"""The greatest id of a parcel."""

_HUB = "hub"
_FIRST = 1 << 52
"""The ids of states lie in this half of all; those that the client itself gives out never get here."""


class RefusedCommandError(Exception):
    """A command that is refused in the words of the hub's table: `stale-state`, `bad-slot`, `expired`."""

    def __init__(self, wire: WireError) -> None:
        super().__init__(str(wire))
        self.wire = wire


def _refused(code: str, text: str, **details: object) -> RefusedCommandError:
    return RefusedCommandError(WireError(code, text, details))


class StateGate:
    """Refuses commands based on an outdated state: "ten millimetres to the left" is wrong once the device has moved.

    A device gives each state that it sends an id by this gate, and says which of them tell of a motion. The ids are higher than all of an
    earlier start.
    """

    def __init__(self, start: datetime) -> None:
        self._newest = _FIRST + max(to_micros(start), 0) % _FIRST
        self._moved = self._newest + 1
        """That of the newest state which told of a motion. None of the states before the first one holds."""
        self.moving = False
        """Whether the device moves now, or has motions ahead of it: no state holds until it stops."""

    def stamp(self, state: Parcel, moved: bool) -> None:
        """Gives a state that is about to be sent its id; `moved`: it is in another position than in the state before."""
        self._newest = min(self._newest + 1, MAX_ID)
        if moved:
            self._moved = self._newest
        state.id = self._newest

    def check(self, command: Parcel) -> None:
        """Passes a command whose state still holds, or that names none; raises `stale-state`, or `bad-slot` for what is not an id."""
        if BASED_ON not in command.extra:
            return
        given = command.extra[BASED_ON]
        if not isinstance(given, int) or isinstance(given, bool) or not 0 <= given <= MAX_ID:
            text = f"the slot {BASED_ON} is the id of a state, a number from 0 to {MAX_ID}"
            raise _refused("bad-slot", text, slot=BASED_ON)
        if given > self._newest:
            text = "the device has not published this state since it was started"
        elif given < self._moved:
            text = "the device has moved since the state that this was based on"
        elif self.moving:
            text = "the device is still moving, so no state of it holds"
        else:
            return
        raise _refused("stale-state", text, state=self._newest)


@dataclass
class Freshness:
    """Until when a command may begin."""

    max_age: Optional[int] = None
    """µs that it may be old, whatever its sender says; `None` if that is its sender's business alone."""
    pace: int = 1
    """How many times as fast as the senders' time the device's passes."""

    def use_by(self, name: str, command: Parcel, age: Optional[Age], now: int) -> Optional[int]:
        """Until when a command may begin, by the time of the device; raises `too-old`.

        Until it expires, and until it is older than the device allows. An unknown age fails the device's own limit.
        """
        # The hub's own command is the safe state, which does not grow old.
        if command.sender == _HUB:
            return None
        expires = None
        if command.expires is not None:
            left = command.expires * 1000 - (0 if age is None else round(age.seconds * 1e6))
            expires = now + left * self.pace
        if self.max_age is None:
            return expires
        oldest = _at_most(age)
        if oldest is None:
            text = (
                f"{name} takes commands of at most {self.max_age // 1000} ms, and the age of this one is not known: "
                "its sender has not measured its clock yet"
            )
            raise DeviceError("too-old", text).with_retry()
        if oldest > self.max_age:
            text = f"the command is {oldest // 1000} ms old, and {name} takes those of at most {self.max_age // 1000} ms"
            raise DeviceError("too-old", text)
        own = now + (self.max_age - oldest) * self.pace
        return own if expires is None else min(own, expires)


class Pull:
    """What a device has asked for, and which command it takes.

    It takes the answer to its newest request, once, and only while it is surely good: a request that was asked again is void, so that a
    command that comes late is never carried out, and its sender may send it anew.
    """

    def __init__(self, wait: int) -> None:
        self.wait = wait
        """µs for which a request waits."""
        self._asked: Optional[int] = None
        """The id of the newest request, while it is not answered."""
        self.due = 0
        """When it is asked again."""

    def ask(self, id: Optional[int], now: int) -> None:
        """Notes that it asks now, by a message of this id."""
        self._asked, self.due = id, now + self.wait

    def renew(self, now: int) -> None:
        """Has it ask as soon as it has nothing to do: its request was answered, or there is another owner to ask."""
        self._asked, self.due = None, now

    def check(self, command: Parcel, age: Optional[Age]) -> None:
        """Passes a command that may be taken, and always the safe state of the hub; raises `bad-slot` and `expired`."""
        if command.sender == _HUB:
            return
        if command.expires is None:
            text = "this device asks for its commands, so each requires the slot `expires` (ms)"
            raise _refused("bad-slot", text, slot="expires")
        if command.reference is None:
            text = "this device asks for its commands: answer its message `next`, with its id in the slot `reference`"
            raise _refused("bad-slot", text, slot="reference")
        oldest = _at_most(age)
        if oldest is None:
            text = "how old the command is is not known, as a clock is not measured yet; the device does not carry it out, and asks again"
            raise _refused("expired", text)
        if oldest >= command.expires * 1000:
            text = f"the command may be {-(-oldest // 1000)} ms old, and was good for {command.expires} ms"
            raise _refused("expired", f"{text}; the device does not carry it out, and asks again")
        if command.reference != self._asked:
            text = "the command answers an earlier request, which is void since the device has asked again or was answered"
            raise _refused("expired", text)


def _at_most(age: Optional[Age]) -> Optional[int]:
    """How old something may be, in µs; `None` if that is not known."""
    if age is None or age.error is None:
        return None
    return round((max(age.seconds, 0.0) + age.error) * 1e6)


