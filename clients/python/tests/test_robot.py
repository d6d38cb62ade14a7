"""The robot of the README, as it stands there, in a process of its own, at a broker that is stopped, frozen and killed."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import AsyncIterator, List

import pytest
import pytest_asyncio
from conftest import PATIENCE, ROOT, Broker, Cutter, heard

import mom

ARM, TOKEN = "/robot/arm", "/robot/token"
README = (Path(__file__).parents[1] / "README.md").read_text()
MOTORS = """
import asyncio, time
def say(*words):
    print(time.monotonic(), *words, flush=True)
def brake():
    say("brake")
async def lift(height):
    say("lift", int(height))
    try:
        await asyncio.Event().wait()
    finally:
        # It is cancelled again meanwhile, when the loop ends.
        await asyncio.sleep(0)  # tidy: it takes a turn
        say("sets")
def height():
    return 7
"""


def example() -> str:
    found = re.search(r"## Be a robot\n.*?```python\n(.*?)```", README, re.DOTALL)
    assert found
    return found.group(1)


class Robot:
    """The robot, and what its motors were told."""

    def __init__(self, broker: Broker, address: str = "") -> None:
        self.broker, self.address = broker, address or broker.address()
        self.told: List[str] = []
        """Words of the motors."""
        self.times: List[float] = []
        self.is_nohup = False
        self._more = asyncio.Event()

    async def start(self) -> None:
        (self.broker.folder / "motors.py").write_text(MOTORS)
        path = os.pathsep.join([str(ROOT / "clients/python/src"), str(self.broker.folder)])
        self._process = await asyncio.create_subprocess_exec(
            sys.executable, "-c", example(),
            env={**os.environ, "PYTHONPATH": path, "MOM_HUB": self.address, "MOM_PASSWORD": "arm"},
            stdout=asyncio.subprocess.PIPE,
            stderr=open(self.broker.folder / "robot.log", "a"),
            # Where the tests run in a shell's background it would not hear of Ctrl-C.
            preexec_fn=self._set_signals,
        )  # fmt: skip
        self._reading = asyncio.ensure_future(self._read())

    def _set_signals(self) -> None:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        signal.signal(signal.SIGHUP, signal.SIG_IGN if self.is_nohup else signal.SIG_DFL)

    async def _read(self) -> None:
        assert self._process.stdout
        async for line in self._process.stdout:
            if not line.endswith(b"\n"):
                # It was killed within a word.
                break
            clock, words = line.decode().rstrip("\n").split(" ", 1)
            self.told.append(words)
            self.times.append(float(clock))
            self._more.set()

    async def hears(self, words: str, after: int = 0) -> int:
        """Waits until its motors are told so; gives how many words they have been told by then."""
        seen = after

        async def wait() -> int:
            nonlocal seen
            while True:
                while seen < len(self.told):
                    seen += 1
                    if self.told[seen - 1] == words:
                        return seen
                self._more.clear()
                await self._more.wait()

        try:
            return await asyncio.wait_for(wait(), PATIENCE)
        except asyncio.TimeoutError:
            raise AssertionError(f"no {words} among {self.told[after:]}") from None

    async def interrupt(self, how: signal.Signals = signal.SIGINT) -> int:
        """Ends it by a signal, as Ctrl-C does; gives its exit code."""
        self._process.send_signal(how)
        code = await asyncio.wait_for(self._process.wait(), PATIENCE)
        await self._reading
        return code

    def send_signal(self, how: signal.Signals) -> None:
        self._process.send_signal(how)

    async def end(self) -> None:
        if self._process.returncode is None:
            self._process.kill()
        await self._process.wait()
        await self._reading


@pytest_asyncio.fixture
async def robot(own_broker: Broker) -> AsyncIterator[Robot]:
    robot = Robot(own_broker)
    await robot.start()
    yield robot
    await robot.end()


def mom_program(broker: Broker, *words: str) -> subprocess.CompletedProcess[str]:
    """Runs `mom`, which is built beside the broker."""
    program = Path(broker.program).with_name("mom")
    assert program.exists(), f"{program} is missing: cargo build -p mom"
    env = {
        **os.environ,
        "MOM_HUB": broker.address(),
        "MOM_USER": "alice",
        "MOM_PASSWORD": "alice",
        "XDG_CONFIG_HOME": str(broker.folder),
    }
    return subprocess.run([str(program), *words], env=env, capture_output=True, text=True, timeout=PATIENCE)


async def run(broker: Broker, *words: str) -> str:
    done = await asyncio.get_running_loop().run_in_executor(None, lambda: mom_program(broker, *words))
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


async def lifts(robot: Robot, alice: mom.Client, height: int, guard: mom.TokenGuard) -> int:
    """Sends a command and waits until the motors are told of it."""
    arm = await alice.channel(ARM)
    await arm.send_acknowledged("command", f"lift {height}", fence=guard.fence)
    return await robot.hears(f"lift {height}")


async def is_there(alice: mom.Client) -> None:
    """Waits until the device is there, and says how it stands."""
    events = (await alice.channel(ARM)).events()
    while True:
        event = await heard(events, mom.Message)
        if event.name == "state":
            return


async def test_a_robot_is_short() -> None:
    assert len(example().strip().splitlines()) <= 20


async def test_it_is_stopped_and_let_go_by_mom(robot: Robot, own_broker: Broker) -> None:
    async with own_broker.connect("bob") as bob:
        await is_there(bob)
        async with (await bob.token(TOKEN)).grab() as guard:
            at = await lifts(robot, bob, 100, guard)
            assert "/robot/arm: arm stands" in await run(own_broker, "stop", "/robot", "--reason", "smoke")
            at = await robot.hears("brake", at)
            arm = await bob.channel(ARM)
            events = arm.events()
            await arm.send_acknowledged("command", "lift 300", fence=guard.fence)
            while (status := await heard(events, mom.Message)).name != "status" or status.content["state"] != "error":
                pass
            assert status.content["error"]["name"] == "stopped"
            assert "arm may move" in await run(own_broker, "unstop", "/robot")
            await lifts(robot, bob, 300, guard)
            assert robot.told.count("lift 300") == 1


async def test_mom_shows_and_drives_what_it_has_never_heard_of(robot: Robot, own_broker: Broker) -> None:
    async with own_broker.connect("alice") as alice:
        await is_there(alice)
        card = await alice.card(ARM)
        assert card and [verb["name"] for verb in card["verbs"]] == ["lift"], card
    for words in (["card", ARM], ["help", ARM]):
        shown = await run(own_broker, *words)
        assert "lift height/mm" in shown and "Lifts the hand to a height" in shown, shown
    script = own_broker.folder / "lift.script"
    script.write_text("wait 1\nlift 900\n")
    loop = asyncio.get_running_loop()
    wrong = await loop.run_in_executor(None, lambda: mom_program(own_broker, "run", str(script)))
    assert wrong.returncode == 1 and f"{script}:2:6: statement 1: height is 900, `lift` takes 0 to 500 mm" in wrong.stderr, wrong.stderr
    assert not any(words.startswith("lift") for words in robot.told)
    script.write_text("wait 1; lift 300\n")
    driving = loop.run_in_executor(None, lambda: mom_program(own_broker, "run", str(script)))
    at = await robot.hears("lift 300")
    await run(own_broker, "stop", "/robot")
    await robot.hears("brake", at)
    assert (await driving).returncode == 1


async def test_a_stop_behind_a_flood_is_obeyed(robot: Robot, own_broker: Broker) -> None:
    async with own_broker.connect("alice") as alice, own_broker.connect("bob") as bob:
        await is_there(alice)
        async with (await bob.token(TOKEN)).grab() as guard:
            at = await lifts(robot, bob, 100, guard)
            arm = await alice.channel(ARM)
            for number in range(1100):
                await arm.send("note", number)
            began = time.monotonic()
            await arm.send("stop", "smoke")
            at = await robot.hears("brake", at)
            print(f"flood: {robot.times[at - 1] - began:.3f} s")
            assert (await alice.stops(ARM)).stopped
            await (await bob.channel(ARM)).send_acknowledged("command", "lift 300", fence=guard.fence)
            # Lifted as far as it is stopped, it carries out the next command, and not that one.
            while (state := await alice.stops(ARM)).stopped:
                await alice.unstop(ARM, state.number)
            await lifts(robot, bob, 200, guard)
            assert "lift 300" not in robot.told


@pytest.mark.parametrize("how", [signal.SIGSTOP, signal.SIGKILL], ids=["frozen", "killed"])
async def test_it_halts_when_its_hub_is(robot: Robot, own_broker: Broker, how: signal.Signals) -> None:
    async with own_broker.connect("alice") as alice:
        await is_there(alice)
        at = await lifts(robot, alice, 100, await (await alice.token(TOKEN)).grab())
        began = time.monotonic()
        own_broker.signal(how)
        at = await robot.hears("brake", at)
        print(f"{how.name}: {robot.times[at - 1] - began:.3f} s")
        assert robot.times[at - 1] - began < 10


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
async def test_whatever_ends_its_program_a_halt_is_the_last_thing(robot: Robot, own_broker: Broker, how: signal.Signals) -> None:
    async with own_broker.connect("alice") as alice:
        await is_there(alice)
        at = await lifts(robot, alice, 100, await (await alice.token(TOKEN)).grab())
        code = await robot.interrupt(how)
        after = robot.told[at:]
        assert after[0] == after[-1] == "brake" and "sets" in after, after
        # By a KeyboardInterrupt Python ends itself with the signal.
        assert code in ((-how, 128 + how) if how == signal.SIGINT else (128 + how,))


async def test_a_program_that_ignores_a_hangup_goes_on(own_broker: Broker) -> None:
    robot = Robot(own_broker)
    robot.is_nohup = True
    await robot.start()
    async with own_broker.connect("alice") as alice:
        await is_there(alice)
        robot.send_signal(signal.SIGHUP)
        await lifts(robot, alice, 100, await (await alice.token(TOKEN)).grab())
        assert await robot.interrupt(signal.SIGTERM) == 143
    await robot.end()


async def test_stopped_while_its_connection_is_lost_it_comes_back_stopped(own_broker: Broker) -> None:
    cutter = Cutter(own_broker.port)
    await cutter.start()
    robot = Robot(own_broker, f"bin://127.0.0.1:{cutter.port}")
    await robot.start()
    async with own_broker.connect("alice") as alice, own_broker.connect("bob") as bob:
        await is_there(alice)
        guard = await (await alice.token(TOKEN)).grab()
        at = await lifts(robot, alice, 100, guard)
        events = (await bob.channel(ARM)).events()
        cutter.refuses = True
        cutter.cut()
        at = await robot.hears("brake", at)
        # The hub has to notice it, too.
        await heard(events, mom.PeerLost)
        report = await bob.stop(ARM, reason="while it was away", within=0.1)
        assert [(device.peer, device.word) for device in report.unobeyed[0].devices] == [("arm", "lost")]
        cutter.refuses = False
        await comes_back_stopped(robot, alice, bob, guard, report.channels[0].number)
    await robot.end()
    await cutter.close()


async def test_stopped_while_it_does_not_run_it_comes_back_stopped(robot: Robot, own_broker: Broker) -> None:
    async with own_broker.connect("alice") as alice, own_broker.connect("bob") as bob:
        await is_there(alice)
        guard = await (await alice.token(TOKEN)).grab()
        await lifts(robot, alice, 100, guard)
        await robot.interrupt()
        assert robot.told[-1] == "brake", "at its end, too"
        (told,) = (await bob.stop(ARM, reason="while it was away", within=0)).channels
        again = Robot(own_broker)
        await again.start()
        await comes_back_stopped(again, alice, bob, guard, told.number)
        await again.end()


async def comes_back_stopped(
    robot: Robot, alice: mom.Client, bob: mom.Client, guard: mom.TokenGuard, number: int
) -> None:
    """It comes and is stopped; it moves nothing before it is let go, and nothing that was said before that."""
    events, arm = (await bob.channel(ARM)).events(), await alice.channel(ARM)
    while (state := await heard(events, mom.Message)).name != "state" or not state.content["stopped"]:
        pass
    assert (state.content["height"], state.content["stop"]) == (7, number)
    await arm.send_acknowledged("command", "lift 300", fence=guard.fence)
    # Where it was ended as Python 3.9 does it, its old connection is still there, and lost.
    (told,) = (await bob.unstop(ARM, number)).channels
    assert mom.DeviceAnswer(state.sender, "unstopped") in told.devices and not told.newer
    await lifts(robot, alice, 200, guard)
    assert "lift 300" not in robot.told
