"""What a device itself can do, for its server."""

from __future__ import annotations

from typing import Any, Dict, Mapping, Optional, Sequence

from .errors import DeviceError
from .rest import Sample
from .script import Attachments, Script
from .words import ScriptWord, Words


class Machine:
    """A device without its queue, its owner and its link: what its actions are, and how it carries one out.

    Its methods are called with times in µs that never go back; it knows the time of the latest call. `mom.device.Device` makes one of a
    class with verbs: this is for tests, and for what fits no such class.
    """

    name = "the device"
    """What it is called in texts, such as `the camera`."""
    verbs: Sequence[str] = ()
    """The first words of its statements, for the nearest one to a wrong word; without `wait`."""
    period = 50_000
    """µs between two states while it moves."""
    stopping_time = 1_000_000
    """µs within which it stands once it is halted. It says that it rests by this only where it does not measure."""
    patience = 1_000_000
    """µs for which what was begun may go on while the program stands still, and by which a later statement may begin too late."""
    tolerance = 1.0
    """The numbers of its position differ by less than this, each in its unit, while it rests."""
    completes = False
    """Whether what its owner began may come to the end of the present statement where the token is given away, without a `halt`."""

    def read(self, verb: ScriptWord, words: Words) -> Any:
        """Reads what follows the verb of a statement; gives an action, `None` if there is no such verb; raises `syntax`."""
        raise NotImplementedError

    def attach(self, action: Any, attachments: Attachments) -> None:
        """Gives an action the bytes that it names, of those that came with its script; raises `syntax` if they did not come."""

    def is_relative(self, action: Any) -> Optional[bool]:
        """Whether an action says only how far it goes, so that it is wrong from anywhere else; `None`: it takes the device nowhere."""
        return False

    def never_waits(self, action: Any) -> bool:
        """Whether an action waits behind no other: it takes the place of one that gives way, and is `busy` behind any other."""
        return False

    def is_moving(self) -> bool:
        """Whether it is busy with something that no command began, or moves on after one."""
        raise NotImplementedError

    def is_driven(self) -> bool:
        """Whether it moves as it was told to: if not, it is halted again where it does not rest in time."""
        return self.is_moving()

    def is_at_rest(self) -> bool:
        """Whether a halt would change nothing: it does not move, and nothing that a command left behind goes on."""
        return not self.is_moving()

    def is_reached(self) -> bool:
        """Whether it can tell its mechanism what to do, and hears of it. What is not reached is never said to rest."""
        return True

    def estop(self) -> Optional[bool]:
        """Whether an emergency stop at the device itself is pressed; `None` if it knows of none. It is asked at each turn of its server."""
        return None

    def is_changing(self) -> bool:
        """Whether what it reports changes by itself although it does not move. States follow meanwhile."""
        return False

    def is_carried(self) -> bool:
        """Whether its position changes though nothing that is carried out moves it. States follow meanwhile."""
        return False

    def blocked(self) -> int:
        """For how many µs its own halts have kept the program so far: that does not count as its standing still."""
        return 0

    def plan(self, script: Script) -> None:
        """Checks a script from where the device will be after those that were planned before, and plans on from its end.

        Raises what cannot be carried out, with the statement's number. Then nothing is planned.
        """

    def begin(self, action: Any, now: int) -> None:
        """Begins an action; raises why it cannot be begun. Then all commands end."""
        raise NotImplementedError

    def done_at(self) -> Optional[int]:
        """When the action that was begun last is done, as far as that is known."""
        raise NotImplementedError

    def pursue(self, until: int) -> Optional[int]:
        """Goes on with the action that was begun last, until then at most; when it was done, or has failed, if it was."""
        done = self.done_at()
        return done if done is not None and done <= until else None

    def take_failure(self) -> Optional[DeviceError]:
        """Why everything has to end that is being carried out or waits, if it has; once."""
        return None

    def gives_way(self) -> bool:
        """Whether what was begun goes on until another command comes. Then it gives way, and its command is finished."""
        return False

    def give_way(self, now: int) -> None:
        """Gives way to the command that begins next."""
        self.halt(now)

    def halt(self, now: int) -> None:
        """Comes to a stand at once, and forgets what was planned. Each stop and each halt comes here, also at rest."""
        raise NotImplementedError

    def advance(self, now: int) -> None:
        """Lets time pass until `now`."""

    def next_wake(self) -> Optional[int]:
        """When `advance` has to be called next; `None` if it changes by commands only."""
        return None

    def known_at(self) -> Optional[int]:
        """Since when what the state tells may have been so, if that is not now: of a device that is asked, when it was."""
        return None

    def position(self) -> Mapping[str, Any]:
        """What commands may be based on: where the device is, as it stands in the state, key by key."""
        raise NotImplementedError

    def measured(self, at: int) -> Optional[Sample]:
        """What is measured of all of it that can move, at this time; `None` where something that may have moved is not measured."""
        return Sample.of(self.position(), at)

    def report(self) -> Dict[str, Any]:
        """What else stands in the state."""
        return {}
