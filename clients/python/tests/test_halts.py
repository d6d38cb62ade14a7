"""What a device does at its halts: the last word is theirs, whatever its verbs still do, and what moves is said to move."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import time
from typing import Any, AsyncIterator, Dict, List

import pytest
import pytest_asyncio
from conftest import PATIENCE, ROOT
from device_robot import ARM, Recorder, Robot, robot_at_hub

from mom import LocalError
from mom.device import Device, DeviceError, verb
from mom.device.declared import DeclaredMachine


class Cart(Device):
    """Its motor goes on as it was told last, so that it moves, whoever has told it."""

    stops_within = 100

    def __init__(self) -> None:
        self.told: List[Any] = []
        self.going = asyncio.Event()
        self.free = asyncio.Event()
        self.x, self.speed, self.since = 0.0, 0.0, time.monotonic()
        self.rolls_for = 0.0

    def motor(self, speed: float) -> None:
        self.told.append(speed)
        self.drive(speed)

    def drive(self, speed: float) -> None:
        self.x, self.speed, self.since = self.place(), speed, time.monotonic()

    def place(self) -> float:
        passed = time.monotonic() - self.since
        return self.x + self.speed * min(passed, self.rolls_for or passed)

    def halt(self) -> None:
        self.told.append("halt")
        self.drive(0.0)

    def position(self) -> Dict[str, Any]:
        return {"x": self.place()}

    @verb
    async def sweep(self) -> None:
        """It sets its motor when it clears up."""
        self.going.set()
        try:
            await asyncio.Event().wait()
        finally:
            self.motor(30)

    @verb
    async def linger(self) -> None:
        """It clears up for too long, and then once more."""
        self.going.set()
        try:
            try:
                await asyncio.Event().wait()
            finally:
                await self.free.wait()
        finally:
            self.motor(30)

    @verb
    async def defy(self) -> None:
        """It takes nothing for its end."""
        self.going.set()
        while True:
            try:
                await asyncio.Event().wait()
            except BaseException:
                self.motor(30)

    @verb
    async def entrust(self) -> None:
        """What it waits for takes nothing for its end."""
        self.going.set()
        work = asyncio.ensure_future(self.work())
        while not work.done():
            try:
                await work
            except asyncio.CancelledError:
                pass

    async def work(self) -> None:
        while not self.free.is_set():
            try:
                await self.free.wait()
            except asyncio.CancelledError:
                self.motor(30)

    @verb(velocity=50)
    async def jog(self) -> None:
        self.going.set()
        try:
            await asyncio.Event().wait()
        finally:
            self.motor(30)

    @verb
    def roll(self, speed: float) -> None:
        self.motor(speed)

    @verb(relative=True)
    def by(self, way: float) -> None:
        self.told.append(f"by {way:g}")

    @verb(moves=False)
    async def lamp(self) -> None:
        self.told.append("lamp")


@pytest_asyncio.fixture
async def robot() -> AsyncIterator[Robot]:
    async with robot_at_hub() as robot:
        yield robot


async def start(robot: Robot) -> Cart:
    robot.device = cart = Cart()
    await robot.start()
    await robot.until(lambda: robot.said("state"))
    return cart


async def begin(robot: Robot, script: str, number: int = 1) -> None:
    robot.say("command", script, id=number)
    await asyncio.wait_for(robot.device.going.wait(), PATIENCE)


def ended(robot: Robot, number: int) -> bool:
    return any(one.get("id") == number and one["state"] in ("finished", "error") for one in robot.said("status"))


@pytest.mark.parametrize("how", ["stop", "halt", "expelled", "time", "down"])
async def test_a_halt_follows_what_a_verb_clears_up(robot: Robot, how: str) -> None:
    cart = await start(robot)
    await begin(robot, "jog" if how == "time" else "sweep")
    if how == "stop":
        robot.say("stop", number=7)
    elif how == "halt":
        robot.say("halt", sender="hub")
    elif how == "expelled":
        robot.tell("expelled", peer=robot.client.name, text="off")
    elif how == "down":
        robot.hub.cut()
    await robot.until(lambda: 30 in cart.told)
    place = cart.told.index(30)
    # In the same step: nothing can come between.
    assert cart.told[place - 1 : place + 2] == ["halt", 30, "halt"] and cart.speed == 0
    if how == "expelled":
        await robot.arm.ended()
    assert cart.told[-1] == "halt"


@pytest.mark.parametrize("how", ["leave", "close", "cancel"])
async def test_its_end_waits_for_what_its_verbs_clear_up_and_halts_again(robot: Robot, how: str) -> None:
    cart = await start(robot)
    cart.stops_within = 5000  # type: ignore[misc]
    robot.arm._machine.stopping_time = 5_000_000
    await begin(robot, "linger")
    ending = asyncio.ensure_future(
        robot.arm.leave() if how == "leave" else robot.client.close() if how == "close" else asyncio.sleep(0)  # tidy: nothing to do
    )
    if how == "cancel":
        robot.arm._obeying.cancel()
    await robot.until(lambda: robot.arm.is_over)
    assert not robot.arm._obeying.done(), "it waits"
    cart.free.set()
    await asyncio.wait([robot.arm._obeying, ending], timeout=PATIENCE)
    assert robot.arm._obeying.done() and cart.told[-2:] == ["halt", "halt"] and 30 in cart.told


async def test_a_verb_gets_no_turn_any_more_when_the_device_has_to_stand(robot: Robot) -> None:
    cart = await start(robot)
    await begin(robot, "linger")
    robot.say("stop", number=7)
    await robot.until(lambda: 30 in cart.told)
    assert not cart.free.is_set(), "it is ended in the middle of its clean-up"
    assert cart.told[cart.told.index(30) + 1] == "halt"
    robot.say("unstop", number=7)
    robot.say("command", "lamp", id=2)
    await robot.until(lambda: "lamp" in cart.told)
    count = cart.told.count(30)
    cart.free.set()
    await robot.settled()
    assert cart.told.count(30) == count == 1


@pytest.mark.parametrize("word", ["defy", "entrust"])
async def test_a_device_whose_verb_does_not_end_refuses_commands(robot: Robot, word: str) -> None:
    cart = await start(robot)
    await begin(robot, word)
    robot.say("stop", number=7)
    robot.say("unstop", number=7)
    # It waits for the end of that, and waits no longer.
    robot.say("command", "lamp", id=2)
    await robot.until(lambda: ended(robot, 2))
    robot.say("command", "lamp", id=3)
    await robot.until(lambda: ended(robot, 3))
    assert robot.errors() == [(1, "stopped"), (2, "link"), (3, "link")] and "lamp" not in cart.told
    assert f"`{word}` was halted and does not end" in robot.why(3)
    await robot.until(lambda: cart.told[-1] == "halt")
    assert all(cart.told[place + 1] in ("halt", 30) for place, told in enumerate(cart.told) if told == 30)
    if word == "entrust":
        cart.free.set()
        await robot.until(lambda: not robot.arm._machine._stuck)
        robot.say("command", "lamp", id=4)
        await robot.until(lambda: "lamp" in cart.told)


@pytest.mark.parametrize("word", ["defy", "entrust"])
async def test_no_later_statement_waits_for_a_verb_that_does_not_end(robot: Robot, word: str) -> None:
    cart = await start(robot)
    await begin(robot, word)
    robot.say("stop", number=7)
    robot.say("unstop", number=7)
    # It was given up on while this waits.
    robot.say("command", "wait 400; lamp", id=2)
    await robot.until(lambda: ended(robot, 2))
    assert robot.errors() == [(1, "stopped"), (2, "link")] and "lamp" not in cart.told
    assert f"`{word}` was halted and does not end" in robot.why(2)
    cart.free.set()


async def test_what_rolls_after_its_command_is_said_to_move(robot: Robot) -> None:
    cart = await start(robot)
    cart.rolls_for = 0.4
    robot.say("command", "roll 200; wait 100", id=1)
    await robot.until(lambda: ended(robot, 1))
    first = [parcel for parcel in robot.hub.heard if parcel.is_("message", "state")][-1]
    assert first.content["moving"] and "executing" not in first.content
    robot.say("command", "by 5", id=2, based_on=first.id)
    await robot.until(lambda: ended(robot, 2))
    assert robot.errors() == [(2, "stale-state")] and cart.place() < 80
    count = len(robot.said("state"))
    await robot.until(lambda: robot.said("state")[-1].get("rest") == "measured")
    states = robot.said("state")[count:]
    assert len(states) > 3 and not states[-1]["moving"] and abs(states[-1]["x"] - 80) < 0.1
    assert all(state["moving"] or state["x"] == states[-1]["x"] for state in states)


async def test_what_is_pushed_says_so_and_obeys_no_state_of_before(robot: Robot) -> None:
    cart = await start(robot)
    await robot.until(lambda: robot.said("state")[-1].get("rest") == "measured")
    rests = [parcel for parcel in robot.hub.heard if parcel.is_("message", "state")][-1]
    cart.drive(100)
    await robot.until(lambda: robot.said("state")[-1]["moving"])
    robot.say("command", "by 5", id=1, based_on=rests.id)
    await robot.until(lambda: ended(robot, 1))
    count = len(robot.said("state"))
    await robot.until(lambda: len(robot.said("state")) > count + 3)
    assert robot.errors() == [(1, "stale-state")] and all(state["moving"] for state in robot.said("state")[count:])
    cart.drive(0)
    await robot.until(lambda: robot.said("state")[-1].get("rest") == "measured")


async def test_it_is_halted_before_anything_else(robot: Robot) -> None:
    robot.device = cart = Cart()
    asked: List[int] = []
    cart.is_reached = lambda: asked.append(len(cart.told)) or True  # type: ignore[method-assign, func-returns-value]
    cart.position = lambda: asked.append(len(cart.told)) or {}  # type: ignore[method-assign, func-returns-value, assignment, return-value]
    await robot.start()
    assert cart.told[0] == "halt" and asked and 0 not in asked


def deep() -> Any:
    value: List[Any] = []
    for _ in range(40):
        value = [value]
    return value


@pytest.mark.parametrize("value", [1 << 64, "a\0b", object(), deep(), b" " * (9 << 20), [float("nan")]])
async def test_a_device_that_cannot_say_how_it_stands_ends(robot: Robot, value: Any) -> None:
    robot.device = recorder = Recorder()
    await robot.start()
    robot.say("command", "hold", id=1)
    await robot.until(lambda: "hold" in robot.told)
    recorder.reporting = lambda: {"lamp": value}
    robot.arm.report()
    with pytest.raises(Exception):
        await asyncio.wait_for(robot.arm.ended(), PATIENCE)
    assert robot.told[-1] == "halt" and robot.arm.may_move() is not None


async def test_a_number_that_is_not_known_ends_nothing(robot: Robot) -> None:
    robot.device.reporting = lambda: {"lamp": float("nan")}
    await robot.start()
    robot.say("command", "do up")
    await robot.until(lambda: "up" in robot.told)


async def test_what_no_string_may_hold_is_replaced_in_errors_and_reasons(robot: Robot) -> None:
    await robot.start()

    def move(word: str) -> None:
        raise DeviceError("obstacle", "a \x1b[31mhand\ud800", reachable=object())

    robot.device.moving = move
    robot.say("command", "do up", id=1)
    await robot.until(lambda: robot.errors())
    assert robot.why(1) == "statement 1: a \ufffd[31mhand\ufffd"
    robot.arm.stop_itself("bumper\0")
    await robot.until(lambda: robot.said("stop"))
    assert robot.said("stop")[0]["reason"].endswith("bumper\ufffd")


async def test_a_channel_has_one_device_of_a_client_and_an_instance_one_channel(robot: Robot) -> None:
    await robot.start()
    with pytest.raises(ValueError, match="is the device of /robot/arm already"):
        await robot.client.obey(ARM, Recorder())
    with pytest.raises(ValueError, match="is a device already"):
        await robot.client.obey("/robot/other", robot.device)
    both = await asyncio.gather(*(robot.client.obey("/robot/two", Recorder()) for _ in range(2)), return_exceptions=True)
    assert [type(one).__name__ for one in both] == ["DevicePeer", "ValueError"]
    robot.say("command", "do up")
    await robot.until(lambda: "up" in robot.told)
    await robot.settled()
    assert robot.told.count("up") == 1 and ARM in robot.client._core.places
    await robot.arm.leave()
    robot.arm = await robot.client.obey(ARM, robot.device)


async def test_a_halt_that_is_to_be_awaited_is_refused(robot: Robot) -> None:
    async def later() -> None: ...

    robot.device.halt = lambda: later()
    with pytest.raises(TypeError, match="has to be a plain function"):
        await robot.start()


async def test_the_time_that_a_halt_takes_does_not_count_as_a_standstill(robot: Robot) -> None:
    cart = await start(robot)
    robot.arm._machine.patience = 200_000
    slow = cart.halt

    def halt() -> None:
        slow()
        time.sleep(0.4)  # tidy: it blocks

    cart.halt = halt  # type: ignore[method-assign]
    await begin(robot, "sweep")
    robot.say("stop", number=7)
    robot.say("unstop", number=7)
    robot.say("command", "lamp; wait 1; lamp", id=2)
    await robot.until(lambda: ended(robot, 2))
    assert robot.errors() == [(1, "stopped")] and cart.told.count("lamp") == 2


@pytest.mark.parametrize("value", [1 << 64, "a\0b", object(), deep(), [float("nan")]])
def test_what_cannot_be_said_is_refused_before_it_is_sent(value: Any) -> None:
    device = Recorder()
    device.reporting = lambda: {"lamp": value}
    with pytest.raises(LocalError):
        DeclaredMachine(device).report()


DEFIANT = """
import asyncio
from mom.device import Device, run, verb
from mom.device.declared import Action, DeclaredMachine
class Cart(Device):
    stops_within = 50
    def halt(self):
        print("halt", flush=True)
    @verb
    async def defy(self):
        while True:
            try:
                await asyncio.Event().wait()
            except BaseException:
                print("sets", flush=True)
async def main():
    machine, begun = DeclaredMachine(Cart()), asyncio.Event()
    machine.begin(Action(machine.verbs and Cart._verbs["defy"], {}), 0)
    asyncio.get_running_loop().call_soon(begun.set)
    await begun.wait()
    machine.halt(0)
    await machine.come_to_an_end()
run(main())
"""


def test_a_verb_that_takes_nothing_for_its_end_gets_no_turn_at_the_end_of_python() -> None:
    env = {**os.environ, "PYTHONPATH": str(ROOT / "clients/python/src")}
    done = subprocess.run([sys.executable, "-c", DEFIANT], env=env, stdout=subprocess.PIPE, text=True, timeout=PATIENCE, check=True)
    told = done.stdout.split()
    assert "sets" in told and told[-1] == "halt", told
    assert all(told[place + 1] == "halt" for place, word in enumerate(told) if word == "sets")


async def test_a_device_that_fails_ends_its_commands(robot: Robot) -> None:
    cart = await start(robot)
    robot.say("command", "wait 30000", id=1)
    robot.say("command", "wait 5", id=2)
    await robot.until(lambda: any(said.get("id") == 1 and said["state"] == "executing" for said in robot.said("status")))

    def fails() -> bool:
        raise OSError("the input is gone")

    cart.estop = fails  # type: ignore[method-assign]
    await robot.until(lambda: ended(robot, 1) and ended(robot, 2))
    errors = [said["error"] for said in robot.said("status") if "error" in said]
    assert [error["name"] for error in errors] == ["link", "link"] and "the input is gone" in errors[0]["text"]
    with pytest.raises(OSError):
        await asyncio.wait_for(robot.arm.ended(), PATIENCE)
