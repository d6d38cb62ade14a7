"""What verbs leave behind: it moves the device after its halt, and is halted again, by the time of a dialogue."""

from __future__ import annotations

import asyncio
from typing import Any, AsyncIterator, Callable, Dict, List, Tuple

import pytest
from device_stage import DeclaredStage, VirtualLoop, declared_stage

from mom.device import Device, verb
from mom.device.rest import REST

STOPS_WITHIN = 500
PERIOD = 50


class Cart(Device):
    """Its motor goes on as it was told last. What its verbs begin moves it at these times, ms after their command."""

    stops_within = STOPS_WITHIN

    def __init__(self, *times: int) -> None:
        self.loop = VirtualLoop()
        self.told: List[Tuple[int, Any]] = []
        self.x, self.speed, self.since = 0.0, 0.0, 0
        self.times = times
        self.left: List[Any] = []
        self.is_free = asyncio.Event()

    def drive(self, speed: float) -> None:
        self.x, self.speed, self.since = self.position()["x"], speed, self.loop.micros

    def moves(self) -> None:
        self.told.append((self.loop.micros // 1000, "moves"))
        self.drive(50.0)

    def halt(self) -> None:
        self.told.append((self.loop.micros // 1000, "halt"))
        self.drive(0.0)

    def position(self) -> Dict[str, float]:
        return {"x": self.x + self.speed * (self.loop.micros - self.since) / 1e6}

    async def work(self) -> None:
        began = self.loop.micros
        for ms in self.times:
            await self.until(began + ms * 1000)
            self.moves()

    async def until(self, micros: int) -> None:
        while self.loop.micros < micros:
            try:
                await asyncio.sleep((micros - self.loop.micros) / 1e6)  # tidy: by the time of the dialogue
            except asyncio.CancelledError:
                # It takes nothing for its end.
                pass

    async def steps(self) -> AsyncIterator[int]:
        try:
            yield 1
        finally:
            await self.work()

    @verb
    async def gather(self) -> None:
        self.left.append(asyncio.gather(self.work(), asyncio.sleep(0)))  # tidy: it takes a turn
        await asyncio.Event().wait()

    @verb
    async def create_task(self) -> None:
        self.left.append(asyncio.ensure_future(self.work()))
        await asyncio.Event().wait()

    @verb
    async def call_soon(self) -> None:
        asyncio.get_running_loop().call_soon(lambda: self.left.append(asyncio.ensure_future(self.work())))
        await asyncio.Event().wait()

    @verb
    async def call_later(self) -> None:
        for ms in self.times:
            asyncio.get_running_loop().call_later(ms / 1000, self.moves)
        await asyncio.Event().wait()

    @verb
    async def generate(self) -> None:
        steps = self.steps()
        await steps.__anext__()
        # Nobody closes it: the loop does so when it is collected.
        del steps
        await asyncio.Event().wait()

    @verb
    async def shield(self) -> None:
        self.left.append(asyncio.ensure_future(self.work()))
        await asyncio.shield(self.left[0])

    @verb
    async def entrust(self) -> None:
        await asyncio.ensure_future(self.work())

    @verb(velocity=5000)
    async def jog(self, speed: float) -> None:
        self.told.append((self.loop.micros // 1000, speed))
        self.drive(speed)
        try:
            await asyncio.Event().wait()
        finally:
            await self.is_free.wait()


def act(stage: DeclaredStage, *lines: str) -> None:
    for line in lines:
        stage.act(line)


def pass_until(stage: DeclaredStage, is_so: Callable[[], bool]) -> int:
    """Lets time pass ms by ms until it is so; gives how many that took."""
    for ms in range(10_000):
        if is_so():
            return ms
        stage.pass_time(1)
    raise AssertionError(f"never: {stage.server.state()}")


LEFT = ("gather", "create_task", "call_soon", "call_later", "generate", "shield")
# Within its stopping time, as that ends, when it has been measured to rest, and again and again.
TIMES = ((30,), (400,), (800,), (100, 700, 2000, 2100, 5000))


@pytest.mark.parametrize("times", TIMES)
@pytest.mark.parametrize("word", LEFT)
def test_what_a_verb_leaves_behind_is_halted_again(word: str, times: Tuple[int, ...]) -> None:
    cart = Cart(*times)
    with declared_stage(cart) as stage:
        cart.told.clear()
        act(stage, f"alice command 1 5: {word.replace('_', '-')}", "after 10", "bob stop 7")
        moves = lambda: sum(what == "moves" for _, what in cart.told)  # noqa: E731
        for count in range(1, len(times) + 1):
            pass_until(stage, lambda: moves() >= count)
            took = pass_until(stage, lambda: cart.speed == 0 or moves() > count)
            assert took <= STOPS_WITHIN + REST // 1000 + PERIOD
        act(stage, "unheard after 0", "rests")
        state = stage.server.state()
        assert cart.speed == 0 and state.stopped and state.rest == "measured" and cart.told[-1][1] == "halt"


def test_what_a_verb_awaits_is_halted_as_long_as_it_goes_on_and_when_it_has_ended() -> None:
    cart = Cart(*range(20, 3000, 20))
    with declared_stage(cart) as stage:
        cart.told.clear()
        act(stage, "alice command 1 5: entrust", "after 10", "bob stop 7")
        assert cart.told[-1] == (stage.now // 1000, "halt")
        while cart.told[-1][1] != "moves" or len(cart.told) < 100:
            stage.pass_time(1)
            assert cart.speed == 0 or stage.now - cart.since <= PERIOD * 1000
        halts = [at for at, what in cart.told if what == "halt"]
        assert max(after - before for before, after in zip(halts, halts[1:])) <= PERIOD
        last = lambda: sum(what == "moves" for _, what in cart.told) == len(cart.times)  # noqa: E731
        pass_until(stage, last)
        at = [when for when, what in cart.told if what == "moves"][-1]
        assert cart.told[-1] == (at, "halt"), "at once, when it has ended"
        act(stage, "unheard after 0", "rests")
        assert cart.speed == 0


def test_a_shielded_task_that_goes_on_is_halted_again_and_again() -> None:
    cart = Cart(*range(20, 6000, 20))
    with declared_stage(cart) as stage:
        cart.told.clear()
        act(stage, "alice command 1 5: shield", "after 10", "bob stop 7", "unheard after 9000", "rests")
        moves, halts = ([at for at, word in cart.told if word == what] for what in ("moves", "halt"))
        assert max(after - before for before, after in zip(halts, halts[1:])) <= STOPS_WITHIN + REST // 1000 + PERIOD
        assert cart.speed == 0 and halts[-1] > moves[-1]


def test_a_velocity_waits_for_another_ones_end_until_it_has_to_stand_and_is_halted_then() -> None:
    cart = Cart()
    with declared_stage(cart) as stage:
        cart.told.clear()
        act(stage, "alice command 1 5: jog 50", "after 100", "alice command 2 5: jog 60", f"after {STOPS_WITHIN - 1}")
        assert [what for _, what in cart.told] == [50] and cart.speed == 50
        act(stage, "after 2")
        assert [what for _, what in cart.told] == [50, "halt", "halt", 60] and cart.speed == 60
        cart.is_free.set()
        act(stage, "alice command 3 5: jog 70", "after 1")
        assert [what for _, what in cart.told] == [50, "halt", "halt", 60, 70], "one that ends in time hands its motion over"
        assert not any("error" in line for line in stage.heard())
