"""A device as its author writes it: a class with verbs."""

from __future__ import annotations

import inspect
import math
from dataclasses import dataclass
from typing import Any, ClassVar, Dict, List, Mapping, Optional, Sequence

from .declare import NAME, Kind, Verb, does_of, verbs_of
from .errors import DeviceError

CARD = 1
"""The version of the form of cards."""


@dataclass(frozen=True)
class Call:
    """A statement of a script, as `Device.plan` gets it; `wait` is not among them."""

    verb: str
    """The verb's name in scripts."""
    arguments: Dict[str, Any]
    """What the method will be called with, by the names of its parameters."""
    statement: int
    """Its number in the script, 1 for the first."""

    def error(self, name: str, text: str, *, reachable: Any = None) -> DeviceError:
        """An error of this statement, to be raised: `raise call.error("workspace-boundary", "the rail ends at 1000 mm")`."""
        return DeviceError(name, text, reachable=reachable).at_statement(self.statement)


class Device:
    """A device: make a class of it with `halt`, `position` and a method with `@verb` for each statement of its scripts.

        class Cart(Device):
            \"\"\"A cart on a rail.\"\"\"

            def halt(self) -> None:
                motors.brake()

            def position(self) -> dict:
                return {"x": motors.x()}

            @verb
            async def go(self, x: Annotated[float, Number("mm", -1000, 1000)]) -> None:
                \"\"\"Drives to a place.\"\"\"
                await motors.drive_to(x)

    `await client.obey("/robot/cart", Cart())` makes it a device there. No method may block, since nothing is heard meanwhile.

    What a verb raises ends its command, and all that wait, with an error, and halts the device: a `DeviceError` is told as it is, all else
    as `link`, and is logged. What `halt`, `position`, `report`, `estop` or `keep_alive` raise ends the device: it halts, and obeys nothing any more.
    """

    name: ClassVar[str] = ""
    """What it is called in texts and in its card; the name of the class in small letters if empty."""
    state: ClassVar[Mapping[str, Kind]] = {}
    """What the keys of `position` and `report` are, for the card: `{"x": Number("mm", does="Along the rail")}`."""
    cameras: ClassVar[Sequence[str]] = ()
    """The channels of cameras that see it, for the card."""
    stops_within: ClassVar[int] = 1000
    """ms within which it stands once it is halted, whatever it did before."""
    tolerance: ClassVar[float] = 1.0
    """The numbers of its position differ by less than this, all together, while it rests."""
    max_age: ClassVar[Optional[int]] = None
    """ms that a command may be old when it begins, whatever its sender says; `None` = any, but for what `expires` says."""
    completes_on_give: ClassVar[bool] = False
    """Whether the present statement comes to its end where the token is given away by agreement; otherwise it is halted then, too."""

    _verbs: ClassVar[Dict[str, Verb]] = {}

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if cls.halt is Device.halt:
            raise TypeError(f"{cls.__name__} has no `halt`: every device can be halted")
        for name in ("halt", "position", "report", "is_reached", "estop", "keep_alive", "plan"):
            if inspect.iscoroutinefunction(getattr(cls, name)):
                raise TypeError(f"{cls.__name__}.{name} has to be a plain function: it is called at once, and must not block")
        if not NAME.fullmatch(cls.called()) or cls.called() == "hub":
            raise TypeError(f"{cls.__name__}: no device can be called `{cls.called()}`")
        limits = (cls.stops_within, cls.tolerance, *([] if cls.max_age is None else [cls.max_age]))
        if not all(isinstance(limit, (int, float)) and math.isfinite(limit) and limit > 0 for limit in limits):
            raise TypeError(f"{cls.__name__}: stops_within, tolerance and max_age are finite numbers, and more than 0")
        cls._verbs = {verb.name: verb for verb in verbs_of(cls)}

    def halt(self) -> None:
        """Comes to a stand at once, and forgets what was planned. Also called when nothing moves."""
        raise NotImplementedError

    def position(self) -> Mapping[str, Any]:
        """Where it is: numbers by which its rest is measured, and which commands are based on. `heading` is in degrees.

        They stand in each state. Empty = it does not measure: `stops_within` passes until it is said to rest.
        """
        return {}

    def report(self) -> Mapping[str, Any]:
        """What else its states say."""
        return {}

    def is_reached(self) -> bool:
        """Whether it can tell its mechanism what to do, and hears of it. What is not reached is never said to rest."""
        return True

    def estop(self) -> Optional[bool]:
        """Whether an emergency stop at the device itself is pressed, such as a button on it or its pendant; `None` if it knows of none.

        It is asked at each turn, each 150 ms at the latest, and must not block. While it is pressed nothing is carried out, and when it was
        reset nothing either until an `unstop` that was said after that. What knows of one says so from the first.
        """
        return None

    def keep_alive(self) -> None:
        """Tells its mechanism that its program is there, each 50 ms while a statement that moves it is carried out, and not otherwise.

        So motors that stand by themselves when they have heard nothing for a moment, such as 0.3 s, stand where the program stands still.
        """

    def plan(self, calls: List[Call]) -> None:
        """Checks a script before it waits: raise `call.error(…)` for what cannot be carried out. Then nothing of it is begun.

        It starts where the scripts that wait lead to; `halt` forgets those.
        """

    @classmethod
    def called(cls) -> str:
        """What it is called in texts and in its card."""
        return cls.name or cls.__name__.lower()

    @classmethod
    def card(cls) -> Dict[str, Any]:
        """What it can do, as a map: its verbs with their arguments, its state, and how soon it stands."""
        does = does_of(cls) if cls.__doc__ else ""
        card: Dict[str, Any] = {"card": CARD, "name": cls.called(), **({"does": does} if does else {})}
        card["verbs"] = [verb.card() for verb in cls._verbs.values()]
        if cls.state:
            card["state"] = [_field(name, kind) for name, kind in cls.state.items()]
        card.update({"stops-within": cls.stops_within, "on-loss": "halt"})
        return {**card, "cameras": list(cls.cameras)} if cls.cameras else card


def _field(name: str, kind: Kind) -> Dict[str, Any]:
    """A field of the state, in the card."""
    said = {key: value for key, value in kind.card().items() if key in ("type", "unit")}
    return {"name": name, **said, **({"does": kind.does} if kind.does else {})}
