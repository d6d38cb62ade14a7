"""Commands as a device keeps them, and what its queue tells of them and of itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, Mapping, Optional, Union

from .errors import DeviceError
from .script import Script


@dataclass(frozen=True)
class Order:
    """Whose command it is."""

    peer: str
    """Who sent it."""
    id: Optional[int] = None
    """Its id, if it has one."""
    fence: Optional[int] = None
    """The fence under which it was sent, if its channel is guarded."""


@dataclass(frozen=True)
class Progress:
    """A command, and how far it is."""

    order: Order
    statement: int
    """The statement being carried out, or the last one begun; 1 for the first, 0 before it."""
    of: int
    """How many statements the command has."""


@dataclass(frozen=True)
class Command:
    """A command in the queue."""

    order: Order
    script: Script
    use_by: Optional[int] = None
    """When it is too old to begin."""

    def progress(self, begun: int) -> Progress:
        """How far it is when so many statements have begun."""
        return Progress(self.order, begun, len(self.script.statements))


@dataclass(frozen=True)
class State:
    """What is known of the device at one time."""

    seq: int
    """Rises with every change."""
    position: Mapping[str, Any]
    """Where it is: what commands are based on."""
    report: Dict[str, Any]
    """What else is told of it."""
    moving: bool
    """Whether it moves, or does not rest yet though it is to stand."""
    rest: Optional[str]
    """How it is known that it rests, if it is."""
    reached: bool
    """Whether it can tell its mechanism what to do."""
    stopped: bool
    """Whether it takes no command until it is released."""
    executing: Optional[Progress]
    """The command being carried out."""
    waiting: int
    """How many commands wait behind it."""


@dataclass(frozen=True)
class Told:
    """What became of a command: `word` is `waiting`, `executing`, `finished`, or `error` with the error."""

    word: str
    progress: Progress
    error: Optional[DeviceError] = None


QueueEvent = Union[Told, State]
"""What a queue tells, in order: of commands, and its state."""
