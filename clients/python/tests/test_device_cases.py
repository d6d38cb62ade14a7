"""What every device does alike: the dialogues of `tests/cases/device.txt`, over a cart on a rail."""

from __future__ import annotations

import asyncio
from typing import Any, Dict, List, Mapping, Optional, Tuple

import pytest
from device_stage import Stage, VirtualLoop, declared, declared_stage, dialogues

from mom.device import Call, Device, DeviceError, verb
from mom.device.machine import Machine
from mom.device.script import Script
from mom.device.words import ScriptWord, Words, read_number

SPEED = 100.0
"""mm/s."""
HOLDS = 200_000
"""µs for which a velocity holds."""
END = 1000.0
"""mm from the middle of its rail to an end."""


class Cart(Machine):
    """A cart on a rail that stands at once, or rolls out for a moment."""

    name = "the cart"
    verbs = ("go", "by", "jog")
    rolls_for = 0
    """µs for which it rolls on after a halt."""

    def __init__(self) -> None:
        self.now, self.x, self.planned = 0, 0.0, 0.0
        self.speed, self.until = 0.0, 0
        self.pushed = 0.0
        self.is_jogging, self.acts = False, False
        self.is_pressed = False

    def read(self, verb: ScriptWord, words: Words) -> Any:
        if verb.text not in self.verbs:
            return None
        word = words.need(verb.text, "a number", "it")
        number = read_number(word.text)
        assert number is not None
        return verb.text, number

    def is_relative(self, action: Tuple[str, float]) -> Optional[bool]:
        return action[0] == "by"

    def never_waits(self, action: Tuple[str, float]) -> bool:
        return action[0] == "jog"

    def is_moving(self) -> bool:
        return self.acts and self.speed != 0.0

    def plan(self, script: Script) -> None:
        planned = self.planned
        for (word, number), place in script.actions():
            planned = number if word == "go" else planned + number if word == "by" else planned
            if abs(planned) > END:
                raise DeviceError("workspace-boundary", "the rail ends before").at_statement(place)
        self.planned = planned

    def begin(self, action: Tuple[str, float], now: int) -> None:
        self.advance(now)
        word, number = action
        self.is_jogging, self.acts = word == "jog", True
        way = number - self.x if word == "go" else number
        self.speed = number if word == "jog" else SPEED if way > 0 else -SPEED
        self.until = now + (HOLDS if word == "jog" else int(abs(way) / SPEED * 1e6))

    def done_at(self) -> Optional[int]:
        return self.until

    def gives_way(self) -> bool:
        return self.is_jogging

    def give_way(self, now: int) -> None:
        # It goes on until the next one begins.
        self.is_jogging = False

    def halt(self, now: int) -> None:
        self.advance(now)
        if self.acts:
            self.until = now + self.rolls_for
        self.is_jogging = self.acts = False
        self.advance(now)
        self.planned, self.pushed = self.x, 0.0

    def advance(self, now: int) -> None:
        ends = min(now, self.until)
        self.x += self.speed * max(ends - self.now, 0) / 1e6
        self.x += self.pushed * (now - self.now) / 1e6
        if now >= self.until:
            self.speed, self.is_jogging, self.acts = 0.0, False, False
        self.now = now

    def position(self) -> Mapping[str, Any]:
        return {"x": self.x}

    def next_wake(self) -> Optional[int]:
        # Something may move it.
        return self.now + 150_000

    def estop(self) -> bool:
        return self.is_pressed

    def push(self) -> None:
        """As by a hand."""
        self.pushed = 50.0


class RollingCart(Cart):
    """It rolls on for 200 ms, and lets its statement come to its end where its token is given away."""

    completes = True
    rolls_for = 200_000


class BlindCart(Cart):
    """It does not measure, and waits for its stopping time. It can do nothing that a dialogue may need."""

    stopping_time = 2_000_000
    verbs = ("go",)

    def measured(self, at: int) -> None:
        return None

    def plan(self, script: Script) -> None:
        pass


class DeclaredCart(Device):
    """The same cart, as its author would write it."""

    name = "cart"

    def __init__(self) -> None:
        self.loop = VirtualLoop()
        self.x, self.speed, self.since, self.planned = 0.0, 0.0, 0, 0.0
        self.is_pressed = False
        self.kept = -1_000_000
        """When it was kept alive last."""

    def position(self) -> Dict[str, float]:
        return {"x": self.x + self.speed * (self.loop.micros - self.since) / 1e6}

    def drive(self, speed: float) -> None:
        self.x, self.speed, self.since = self.position()["x"], speed, self.loop.micros

    def estop(self) -> bool:
        return self.is_pressed

    def keep_alive(self) -> None:
        self.kept = self.loop.micros

    def push(self) -> None:
        """As by a timer that a verb has left behind."""
        self.drive(50.0)

    def halt(self) -> None:
        self.drive(0.0)
        self.planned = self.x

    def plan(self, calls: List[Call]) -> None:
        planned = self.planned
        for call in calls:
            (number,) = call.arguments.values()
            planned = number if call.verb == "go" else planned + number if call.verb == "by" else planned
            if abs(planned) > END:
                raise call.error("workspace-boundary", "the rail ends before")
        self.planned = planned

    @verb
    async def go(self, x: float) -> None:
        await self.by(x - self.position()["x"])

    @verb(relative=True)
    async def by(self, way: float) -> None:
        self.drive(SPEED if way > 0 else -SPEED)
        await asyncio.sleep(abs(way) / SPEED)  # tidy: by the time of the dialogue
        self.drive(0.0)

    @verb(velocity=200)
    def jog(self, speed: float) -> None:
        self.drive(speed)


class CompletingCart(DeclaredCart):
    """It lets its statement come to its end where its token is given away."""

    completes_on_give = True


ALL: Dict[str, Optional[str]] = {
    "go": "go 100",
    "back": "go 0",
    "wrong": "og 100",
    "beyond": "go 1001",
    "beyond-error": "workspace-boundary 5002",
    "relative": "by 20",
    "velocity": "jog 50",
}
FEW = {key: value if key in ("go", "back", "wrong") else None for key, value in ALL.items()}


def machine_of(kind: Any) -> Machine:
    return declared(kind()) if issubclass(kind, Device) else kind()  # type: ignore[no-any-return]


def cases(kind: Any, statements: Dict[str, Optional[str]]) -> Any:
    machine = machine_of(kind)
    # What does not measure does not know that it is pushed.
    has = {"completes": machine.completes, "halts-on-give": not machine.completes, "pushes": kind is not BlindCart, "estop": True, "keep-alive": issubclass(kind, Device)}
    return [
        pytest.param(kind, lines, id=f"{kind.__name__}: {title}")
        for title, lines in dialogues(statements, lambda need: has.get(need) or bool(statements.get(need)), machine)
    ]


CASES = {kind: cases(kind, ALL) for kind in (Cart, RollingCart, DeclaredCart, CompletingCart)}
CASES[BlindCart] = cases(BlindCart, FEW)


@pytest.mark.parametrize(("kind", "lines"), [case for played in CASES.values() for case in played])
def test_dialogue(kind: Any, lines: str) -> None:
    if not issubclass(kind, Device):
        Stage.at_rest(kind()).play(lines)
        return
    with declared_stage(kind()) as stage:
        stage.play(lines)


def test_no_dialogue_is_left_out() -> None:
    least = {Cart: 51, RollingCart: 55, DeclaredCart: 51, CompletingCart: 55, BlindCart: 42}
    assert {kind: len(played) for kind, played in CASES.items() if len(played) < least[kind]} == {}
