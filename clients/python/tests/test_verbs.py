"""Verbs of a device at work: how they end, how they are halted, and what they may not do after that."""

from __future__ import annotations

import asyncio
import logging
from typing import Any, AsyncIterator, Callable, Dict, List

import pytest
import pytest_asyncio
from conftest import PATIENCE
from device_robot import Recorder, Robot, robot_at_hub

from mom.device import Call, Device, DeviceError, verb
from mom.parcel import Parcel

GUARD = {"guard": {"token": "/robot/token", "names": ["command"], "owner": "bob", "fence": 3}}


class Cart(Device):
    """Notes what it is told."""

    def __init__(self) -> None:
        self.told: List[str] = []
        self.x = 0.0
        self.cleared = asyncio.Event()
        self.check: Callable[[Call], None] = lambda call: None
        self.peer: Any = None
        self.blocking: Callable[[], None] = lambda: None

    def halt(self) -> None:
        self.told.append("halt")

    def position(self) -> Dict[str, float]:
        return {"x": self.x}

    def plan(self, calls: List[Call]) -> None:
        for call in calls:
            self.check(call)

    @verb(velocity=200)
    def drive(self, speed: float) -> None:
        self.told.append(f"drive {speed:g}")

    @verb(velocity=200)
    async def steer(self, angle: float) -> None:
        while True:
            self.told.append(f"steer {angle:g}")
            await asyncio.sleep(0.005)  # tidy: it steers again and again

    @verb(relative=True)
    async def by(self, way: float) -> None:
        self.x += way
        self.told.append(f"by {way:g}")

    @verb
    async def sweep(self) -> None:
        self.told.append("sweep")
        try:
            await asyncio.Event().wait()
        finally:
            await self.cleared.wait()
            self.told.append("cleared")

    @verb
    async def ignore(self) -> None:
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError:
            self.told.append("ignored")

    @verb
    async def step(self) -> None:
        while True:
            self.told.append("step")
            await asyncio.sleep(0.005)  # tidy: it takes one step after the other

    @verb(moves=False)
    async def blink(self) -> None:
        while True:
            self.told.append("blink")
            await asyncio.sleep(0.005)  # tidy: it blinks again and again

    @verb
    def block(self) -> None:
        self.told.append("block")
        self.blocking()

    @verb(velocity=200)
    def creep(self, speed: float) -> None:
        self.told.append(f"creep {speed:g}")
        self.blocking()

    @verb(moves=False)
    def lamp(self) -> None:
        self.told.append("lamp")

    @verb
    def bump(self) -> None:
        self.peer.stop_itself("bumper")

    @verb
    def run(self) -> None: ...

    @verb
    def burn(self) -> None:
        raise OSError("smoke")


@pytest_asyncio.fixture
async def robot() -> AsyncIterator[Robot]:
    async with robot_at_hub() as robot:
        yield robot


async def start(robot: Robot, **options: Any) -> Cart:
    robot.device = cart = Cart()
    await robot.start(**options)
    cart.peer = robot.arm
    await robot.until(lambda: robot.said("state"))
    cart.told.clear()
    return cart


async def ends(robot: Robot, *numbers: int) -> None:
    """Waits until these commands have come to their end."""

    def ended() -> bool:
        return set(numbers) <= {one.get("id") for one in robot.said("status") if one["state"] in ("finished", "error")}

    await robot.until(ended)


async def test_a_velocity_holds_for_its_time_and_is_halted_then(robot: Robot) -> None:
    cart = await start(robot)
    began = asyncio.get_running_loop().time()
    robot.say("command", "drive 5", id=1)
    await ends(robot, 1)
    assert cart.told == ["drive 5", "halt"] and asyncio.get_running_loop().time() - began >= 0.19
    assert robot.errors() == []


async def test_a_velocity_takes_over_from_another_and_all_else_begins_after_a_halt(robot: Robot) -> None:
    cart = await start(robot)
    robot.say("command", "drive 5", id=1)
    robot.say("command", "drive 6", id=2)
    robot.say("command", "lamp", id=3)
    await ends(robot, 3)
    assert cart.told == ["drive 5", "drive 6", "halt", "lamp"]
    # A `wait` does not take over, and nothing follows in the same script.
    robot.say("command", "drive 7", id=4)
    robot.say("command", "wait 1", id=5)
    await ends(robot, 5)
    robot.say("command", "drive 8; lamp", id=6)
    await ends(robot, 6)
    assert cart.told[4:] == ["drive 7", "halt"] and robot.errors() == [(6, "syntax")]


async def test_a_velocity_of_steps_takes_over_without_a_halt(robot: Robot) -> None:
    cart = await start(robot)
    robot.say("command", "steer 3", id=1)
    await robot.until(lambda: "steer 3" in cart.told)
    robot.say("command", "steer 4", id=2)
    await robot.until(lambda: "steer 4" in cart.told)
    assert "halt" not in cart.told
    await ends(robot, 2)
    assert cart.told[-1] == "halt" and robot.errors() == []


async def test_a_velocity_of_steps_ends_with_its_time(robot: Robot) -> None:
    cart = await start(robot)
    robot.say("command", "steer 3", id=1)
    await ends(robot, 1)
    assert cart.told.count("steer 3") > 2 and cart.told[-1] == "halt"
    count = len(cart.told)
    robot.say("command", "lamp", id=2)
    await ends(robot, 2)
    assert cart.told[count:] == ["lamp"]


async def test_what_a_halted_verb_clears_up_ends_before_the_next_one_begins(robot: Robot) -> None:
    cart = await start(robot)
    robot.say("command", "sweep", id=1)
    await robot.until(lambda: "sweep" in cart.told)
    robot.say("halt", sender="hub")
    robot.say("command", "lamp", id=2)
    await robot.until(lambda: robot.errors() and [one for one in robot.said("status") if one.get("id") == 2])
    await robot.settled()
    assert robot.deeds == ["sweep", "halt"], "the next one waits"
    assert robot.said("state")[-1]["moving"], "it may do what is not known"
    cart.cleared.set()
    await ends(robot, 2)
    assert robot.deeds == ["sweep", "halt", "cleared", "halt", "lamp"]


async def test_a_verb_that_ignores_its_halt_is_halted_again(robot: Robot, caplog: pytest.LogCaptureFixture) -> None:
    cart = await start(robot)
    robot.say("command", "ignore", id=1)
    await robot.until(lambda: [one for one in robot.said("status") if one["state"] == "executing"])
    robot.say("stop", number=7)
    await robot.until(lambda: cart.told == ["halt", "ignored", "halt"])
    assert "did not end by that" in caplog.text
    await ends(robot, 1)
    assert robot.errors() == [(1, "stopped")]


async def test_a_verb_that_goes_on_though_it_was_halted_gets_no_turn_any_more(
    robot: Robot, caplog: pytest.LogCaptureFixture
) -> None:
    class Stubborn(Cart):
        stops_within = 50

        @verb
        async def dance(self) -> None:
            while True:
                try:
                    self.told.append("step")
                    await asyncio.sleep(0.005)  # tidy: it takes one step after the other
                except asyncio.CancelledError:
                    self.told.append("goes on")

    robot.device = cart = Stubborn()
    await robot.start()
    robot.say("command", "dance", id=1)
    await robot.until(lambda: "step" in cart.told)
    robot.say("stop", number=7)
    await robot.until(lambda: "it still took steps" in caplog.text)
    assert cart.told[-1] == "halt"
    await ends(robot, 1)
    await robot.until(lambda: robot.said("state")[-1]["moving"] is False)
    assert cart.told[-1] == "halt"


async def test_what_a_plain_verb_began_is_halted_when_its_owner_changes(robot: Robot) -> None:
    robot.guard = GUARD
    cart = await start(robot)
    cart.run = lambda: cart.told.append("run")  # type: ignore[attr-defined]
    robot.say("command", "run", id=1, fence=3)
    await ends(robot, 1)
    cart.told.clear()
    robot.hub.say(Parcel("event", "released", "/robot/token", {"owner": "bob", "reason": "given", "fence": 3}))
    await robot.until(lambda: cart.told == ["halt"])
    await robot.until(lambda: robot.said("state")[-1].get("rest") == "measured")


async def test_a_state_says_of_its_rest_only_what_is_known(robot: Robot) -> None:
    cart = await start(robot)
    cart.report = lambda: {"rest": "measured"}  # type: ignore[method-assign]
    robot.arm.report()
    with pytest.raises(ValueError, match="`rest` is a key of every device's state"):
        await asyncio.wait_for(robot.arm.ended(), PATIENCE)
    assert cart.told[-1] == "halt"


async def test_a_verb_that_is_halted_before_its_first_step_takes_none(robot: Robot) -> None:
    cart = await start(robot)
    for number in range(3):
        robot.say("command", "step", id=number)
    robot.say("stop", number=7)
    await ends(robot, 0, 1, 2)
    await robot.settled()
    assert set(cart.told) <= {"step", "halt"} and cart.told[-1] == "halt"


@pytest.mark.parametrize("word", ["block", "creep 5"])
@pytest.mark.parametrize("seconds", [0.3, 2.5])
@pytest.mark.parametrize("is_stopped", [False, True])
async def test_what_came_while_a_plain_verb_blocked_is_heard_before_its_end(
    robot: Robot, word: str, seconds: float, is_stopped: bool
) -> None:
    cart = await start(robot)
    skipped, clock = 0.0, robot.arm._clock
    robot.arm._clock = lambda: clock() + skipped

    def blocking() -> None:
        nonlocal skipped
        skipped += seconds
        if is_stopped:
            robot.say("stop", number=7)

    cart.blocking = blocking
    robot.say("command", word if " " in word else f"{word}; lamp", id=1)
    robot.say("command", "lamp", id=2)
    await ends(robot, 1, 2)
    word_of = "stopped" if is_stopped else "halted"
    failed = is_stopped or seconds > 1
    assert robot.errors() == ([(1, word_of), (2, word_of)] if failed else [])
    assert ("lamp" in cart.told) != failed and (cart.told[-1] == "halt") == failed
    assert failed or word == "block" or cart.told.index("halt") < cart.told.index("lamp")


async def test_no_verb_takes_a_step_after_its_program_stood_still(robot: Robot) -> None:
    cart = await start(robot)
    skipped = 0.0
    clock = robot.arm._clock
    robot.arm._clock = lambda: clock() + skipped
    robot.say("command", "step; lamp", id=1)
    robot.say("command", "lamp", id=2)
    await robot.until(lambda: "step" in cart.told)
    # As if the program had been stopped for a minute.
    skipped = 60.0
    count = len(cart.told)
    await ends(robot, 1, 2)
    assert set(cart.told[count:]) == {"halt"}
    assert robot.errors() == [(1, "halted"), (2, "halted")] and "its program stood still for" in robot.why(1)


async def test_nor_does_a_verb_that_moves_nothing(robot: Robot) -> None:
    cart = await start(robot)
    skipped = 0.0
    clock = robot.arm._clock
    robot.arm._clock = lambda: clock() + skipped
    robot.say("command", "blink", id=1)
    await robot.until(lambda: "blink" in cart.told)
    assert robot.said("state")[-1]["moving"] is False
    skipped = 60.0
    await ends(robot, 1)
    count = cart.told.index("halt")
    assert set(cart.told[count:]) == {"halt"} and robot.errors() == [(1, "halted")]


async def test_no_command_is_taken_while_it_leaves(robot: Robot) -> None:
    cart = await start(robot)
    robot.say("command", "step", id=1)
    await robot.until(lambda: "step" in cart.told)
    leaving = asyncio.ensure_future(robot.arm.leave())
    await asyncio.sleep(0)  # tidy: it has begun to leave
    robot.say("command", "lamp", id=2)
    await asyncio.wait_for(leaving, PATIENCE)
    assert "lamp" not in cart.told and cart.told[-1] == "halt"


async def test_a_relative_verb_names_the_state_that_it_is_based_on(robot: Robot) -> None:
    cart = await start(robot)
    robot.say("command", "by 5", id=1)
    await ends(robot, 1)
    state = [parcel for parcel in robot.hub.heard if parcel.is_("message", "state")][-1]
    robot.say("command", "by 5", id=2, based_on=state.id)
    await ends(robot, 2)
    robot.say("command", "by 5", id=3, based_on=state.id)
    await ends(robot, 3)
    assert cart.x == 5 and robot.errors() == [(1, "no-state"), (3, "stale-state")]
    error = robot.said("status")[-1]["error"]
    assert error["code"] == 208 and error["state"] > (state.id or 0)


async def test_an_old_command_is_refused_where_the_device_takes_only_new_ones(robot: Robot) -> None:
    robot.device = Cart()
    robot.device.max_age = 200
    await robot.start()
    robot.say("command", "lamp", id=1)
    await ends(robot, 1)
    assert robot.errors() == [(1, "too-old")] and "the age of this one is not known" in robot.why(1)
    assert robot.said("status")[-1]["error"]["retry"] is True


async def test_a_plan_refuses_a_script_before_any_of_it_is_begun(robot: Robot, caplog: pytest.LogCaptureFixture) -> None:
    cart = await start(robot)

    def check(call: Call) -> None:
        if call.verb == "sweep":
            raise call.error("workspace-boundary", "the rail ends before", reachable={"x": 3})

    cart.check = check
    robot.say("command", "lamp; wait 1; sweep", id=1)
    await ends(robot, 1)
    error = robot.said("status")[-1]["error"]
    assert error == {
        "name": "workspace-boundary", "code": 5002, "text": "statement 3: the rail ends before", "statement": 3, "reachable": {"x": 3},
    }  # fmt: skip
    cart.check = lambda call: 1 / 0  # type: ignore[assignment, return-value]
    robot.say("command", "lamp", id=2)
    await ends(robot, 2)
    assert robot.errors()[1] == (2, "link") and cart.told == [] and "its plan failed" in caplog.text


async def test_a_plain_verb_fails_as_any_other_and_may_stop_the_device(robot: Robot) -> None:
    cart = await start(robot)
    robot.say("command", "lamp; burn; lamp", id=1)
    robot.say("command", "bump; sweep", id=2)
    await ends(robot, 1, 2)
    assert robot.errors() == [(1, "link"), (2, "stopped")] and robot.why(1) == "statement 2: `burn` failed: OSError: smoke"
    assert robot.arm.is_stopped and "sweep" not in cart.told and cart.told[-1] == "halt"
    await robot.until(lambda: robot.said("stop"))


async def test_its_program_ends_all_that_it_does_for_a_reason(robot: Robot) -> None:
    cart = await start(robot)
    robot.say("command", "step", id=1)
    robot.say("command", "lamp", id=2)
    await robot.until(lambda: "step" in cart.told)
    robot.arm.fail(DeviceError("battery", "it is empty"))
    await ends(robot, 1, 2)
    assert robot.errors() == [(1, "battery"), (2, "battery")] and "lamp" not in cart.told and cart.told[-1] == "halt"


@pytest.mark.parametrize("completes", [False, True])
async def test_a_statement_comes_to_its_end_at_a_hand_over_where_the_class_says_so(robot: Robot, completes: bool) -> None:
    robot.guard = GUARD
    cart = Cart()
    cart.completes_on_give = completes  # type: ignore[misc]
    robot.device = cart
    await robot.start()
    goes = asyncio.Event()

    async def step() -> None:
        cart.told.append("begun")
        await goes.wait()
        cart.told.append("ended")

    cart.step = step  # type: ignore[method-assign]
    robot.say("command", "step; lamp", id=1, fence=3)
    await robot.until(lambda: "begun" in cart.told)
    robot.hub.say(Parcel("event", "released", "/robot/token", {"owner": "bob", "reason": "given", "fence": 3}))
    robot.hub.say(Parcel("event", "grabbed", "/robot/token", {"owner": "carol", "level": 1, "fence": 4}))
    robot.say("command", "lamp", id=2, fence=4, sender="carol")
    await robot.until(lambda: robot.errors())
    goes.set()
    await ends(robot, 1)
    assert ("ended" in cart.told) == completes and robot.errors()[-1 if completes else 0] == (1, "halted")
    assert ((2, "changing-hands") in robot.errors()) == completes


async def test_a_device_that_does_not_reach_its_mechanism_says_so(robot: Robot) -> None:
    cart = await start(robot)
    cart.is_reached = lambda: False  # type: ignore[method-assign]
    robot.arm.report()
    await robot.until(lambda: robot.said("state")[-1]["reached"] is False)
    assert robot.said("state")[-1]["moving"] is True and robot.arm.state.reached is False


async def test_a_verb_that_is_cancelled_by_its_own_program_has_failed(robot: Robot) -> None:
    robot.device = recorder = Recorder()
    await robot.start()
    inner = asyncio.get_running_loop().create_future()
    recorder.moving = lambda word: inner
    robot.say("command", "do up; do down", id=1)
    await robot.until(lambda: "up" in recorder.told)
    inner.cancel()
    await ends(robot, 1)
    assert robot.errors() == [(1, "link")] and recorder.told[-1] == "halt" and "down" not in recorder.told


async def test_a_halt_that_fails_when_a_verb_ends_ends_the_device(robot: Robot, caplog: pytest.LogCaptureFixture) -> None:
    cart = await start(robot)

    def fails() -> None:
        raise OSError("no brake")

    cart.halt = fails  # type: ignore[method-assign]
    robot.say("command", "drive 5", id=1)
    with caplog.at_level(logging.ERROR, "mom"), pytest.raises(OSError, match="no brake"):
        await asyncio.wait_for(robot.arm.ended(), PATIENCE)
    assert robot.arm.may_move() is not None and "it cannot be halted" in caplog.text
    assert robot.client.state.word == "connected"
