"""Driving real devices: the arm of the lab, the cart of `examples/rail.py`, and some that do not do what they ought to."""

from __future__ import annotations

import asyncio
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, AsyncIterator, Awaitable, Dict, Iterator, List

import pytest
import pytest_asyncio
from conftest import PATIENCE, ROOT, Broker, Cutter, heard

import mom
from mom.drive import Command, CommandEnd, Commander, CommandFailed, DriveError, Progress, driving
from mom.parcel import Parcel

ARM, TOKEN = "/robot/arm", "/robot/token"
HERE = Path(__file__).parents[1]
FOR_LONG = "wait 60000"


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a lab with an arm."""
    program = Path(os.environ.get("MOM_BROKER", str(ROOT / "target/debug/mom-broker"))).with_name("mom")
    assert program.exists(), f"{program} is missing: cargo build -p mom"
    home = str(tmp_path_factory.mktemp("lab"))
    process = subprocess.Popen(
        [str(program), "lab", "--listen", "127.0.0.1:0", "--log", "error"],
        env={**os.environ, "XDG_STATE_HOME": home, "XDG_CONFIG_HOME": home},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout
    found = (re.search(r"bin://127\.0\.0\.1:\d+", line) for line in process.stdout)
    try:
        yield next(address.group() for address in found if address)
    finally:
        process.terminate()
        process.communicate()


def person(hub: str, name: str) -> mom.Connect:
    return mom.connect(hub, user=name, password=name)


async def soon(coming: Awaitable[CommandEnd]) -> CommandEnd:
    return await asyncio.wait_for(coming, PATIENCE)


class Under:
    """A command under way in a task of its own."""

    def __init__(self, arm: Commander, command: str) -> None:
        self._begun = asyncio.Event()
        self.told: List[str] = []
        self.end = asyncio.ensure_future(arm.carry_out(command, told=self._hear))

    def _hear(self, progress: Progress) -> None:
        self.told.append(str(progress))
        if progress.state == "executing":
            self._begun.set()

    async def begun(self) -> Under:
        """Waits until the device carries it out."""
        await asyncio.wait_for(self._begun.wait(), PATIENCE)
        return self


async def statuses(events: mom.Events, state: str) -> Parcel:
    """The next `status` with this state."""
    while True:
        message = await heard(events, mom.Message)
        if message.name == "status" and message.content["state"] == state:
            return message.parcel  # type: ignore[no-any-return]


async def test_commands_to_their_end(lab: str) -> None:
    async with person(lab, "alice") as alice:
        async with driving(alice, ARM) as arm:
            told: List[str] = []
            end = await soon(arm.carry_out("move 0 0 250 0 0; wait 10", told=lambda progress: told.append(str(progress))))
            end.check()
            assert end.finished and (end.name, end.text, end.hint, end.error) == ("finished", "finished", None, None)
            assert told == ["waiting 0 of 2", "executing 1 of 2", "executing 2 of 2"]
            # Its card says that `by` is relative.
            assert (await soon(arm.carry_out("wait 1; by 0 0 -50 0 0"))).finished
            assert arm.state and abs(arm.state["pose"]["z"] - 200) < 1
            assert (await soon(arm.carry_out(Command("by 0 0 10 0 0", based_on="newest")))).finished
        assert (await alice.info(TOKEN)).get("owner") is None
        with pytest.raises(RuntimeError):
            await arm.carry_out("home")


async def test_what_the_device_refuses(lab: str) -> None:
    async with person(lab, "alice") as alice, driving(alice, ARM) as arm:
        end = await soon(arm.carry_out("wait 1; move 0 0 900 0 0"))
        words = "statement 2: z is 900 mm, but the workspace reaches from 0 to 450 mm [workspace-boundary 5002]"
        assert (end.kind, end.name, end.text, end.hint) == ("error", "workspace-boundary", words, None)
        assert end.unreachable and not end.finished and end.error and end.error.number == 5002
        with pytest.raises(CommandFailed) as caught:
            end.check()
        assert (caught.value.code, caught.value.number, str(caught.value)) == ("workspace-boundary", 5002, words)
        end = await soon(arm.carry_out("mvoe 1"))
        assert end.text == "statement 1: there is no `mvoe`; did you mean `move`? [syntax 5001]" and not end.unreachable


async def test_a_fence_alone_will_do(lab: str) -> None:
    async with person(lab, "alice") as alice, person(lab, "bob") as bob:
        channel = await alice.channel(ARM)
        async with (await alice.token(TOKEN)).grab() as guard, Commander(channel, guard.fence) as arm:
            # Without a card it does not know that this is relative.
            assert (await soon(arm.carry_out("by 0 0 10 0 0"))).name == "no-state"
            assert (await soon(arm.carry_out("by 0 0 10 0 0", based_on="newest"))).finished
            running = await Under(arm, FOR_LONG).begun()
            with pytest.raises(RuntimeError):
                await arm.carry_out("home")
            report = await bob.stop("/robot", reason="smoke")
            end = await soon(running.end)
            assert end.name == "stopped" and end.hint == "let it go with: mom unstop /robot/arm"
            (stopped,) = [told for told in report.channels if told.path == ARM]
            await bob.unstop(ARM, stopped.number)
            await arm.end(guard.release)


async def test_the_token_lost_to_a_higher_level(lab: str) -> None:
    async with person(lab, "alice") as alice, person(lab, "carol") as carol:
        async with driving(alice, ARM) as arm:
            running = await Under(arm, FOR_LONG).begun()
            async with driving(carol, ARM) as theirs:
                end = await soon(running.end)
                lost = "lost /robot/token: carol has a higher level and took it; "
                assert (end.name, end.text, end.ended) == ("lost", lost + "the device has ended the command", True)
                assert end.lost == mom.Lost("preempted", "carol")
                end = await soon(arm.carry_out("home"))
                assert (end.text, end.ended) == (lost + "nothing of the command ran", None)
                assert (await soon(theirs.carry_out("wait 1"))).finished
            with pytest.raises(CommandFailed):
                end.check()


async def test_a_loss_that_its_holder_tells(lab: str) -> None:
    async with person(lab, "alice") as alice, person(lab, "carol") as carol:
        channel, guard = await alice.channel(ARM), await (await alice.token(TOKEN)).grab()
        arm = Commander(channel, guard.fence)
        running = await Under(arm, FOR_LONG).begun()
        async with (await carol.token(TOKEN)).grab():
            end = await arm.lost(await asyncio.wait_for(guard.lost(), PATIENCE))
        assert end is not None and end == await soon(running.end) and end.ended
        arm.close()
        idle = Commander(channel, guard.fence)
        assert await idle.lost(mom.Lost("preempted", "carol")) is None
        again = await soon(idle.carry_out("home"))
        assert again.text == "lost /robot/token: carol has a higher level and took it; nothing of the command ran"
        idle.close()


async def test_who_owns_it_is_told(lab: str) -> None:
    async with person(lab, "alice") as alice, person(lab, "bob") as bob, driving(alice, ARM):
        with pytest.raises(mom.RefusedError) as caught:
            await driving(bob, ARM).__aenter__()
        assert caught.value.code == "held" and caught.value.wire.owner == "alice"
        with pytest.raises(DriveError) as unowned:
            await driving(bob, "/chat").__aenter__()
        assert str(unowned.value) == "no token guards /chat, so it cannot be owned"


async def test_the_end_of_the_work_ends_what_runs(lab: str) -> None:
    async with person(lab, "alice") as alice, person(lab, "bob") as bob:
        events = (await alice.channel(ARM)).events()
        async with driving(alice, ARM) as arm:
            running = await Under(arm, FOR_LONG).begun()
            waiting = asyncio.ensure_future(driving(bob, ARM, wait=PATIENCE).__aenter__())
        # It has been heard by now, and need not be waited for.
        said = [event for event in iter(events.try_next, None) if isinstance(event, mom.Message)]
        states = [message.content["state"] for message in said if message.name == "status"]
        assert states == ["waiting", "executing", "error"], states
        with pytest.raises(asyncio.CancelledError):
            await running.end
        theirs = await asyncio.wait_for(waiting, PATIENCE)
        assert (await soon(theirs.carry_out("wait 1"))).finished


async def test_what_a_block_raises_is_told_and_ends_what_runs(lab: str) -> None:
    async with person(lab, "alice") as alice:
        events = (await alice.channel(ARM)).events()
        with pytest.raises(ZeroDivisionError):
            async with driving(alice, ARM) as arm:
                waiting = Under(arm, FOR_LONG)
                await waiting.begun()
                # Given up by who waits, it goes on, and another one waits behind it.
                waiting.end.cancel()
                await asyncio.wait([waiting.end])
                await until_told(arm, "waiting 0 of 1")
                raise ZeroDivisionError
        ends = [await statuses(events, "error"), await statuses(events, "error")]
        assert len({end.map()["id"] for end in ends}) == 2 and {end.map()["error"]["name"] for end in ends} == {"halted"}
        assert (await alice.info(TOKEN)).get("owner") is None


async def until_told(arm: Commander, words: str) -> None:
    told = asyncio.Event()
    task = asyncio.ensure_future(arm.carry_out("wait 1", told=lambda progress: told.set() if str(progress) == words else None))
    await asyncio.wait_for(told.wait(), PATIENCE)
    task.cancel()


async def test_a_loan_ends_with_the_block(lab: str) -> None:
    async with person(lab, "alice") as alice, person(lab, "bob") as bob:
        guard, token = await (await alice.token(TOKEN)).grab(), await bob.token(TOKEN)
        events = token.events()
        given = await guard.give("bob", commands=5)
        await heard(events, mom.Offer)
        async with driving(bob, ARM, guard=await token.accept()) as arm:
            assert (await soon(arm.carry_out("wait 1"))).finished
        back = await asyncio.wait_for(given.back(), PATIENCE)
        assert back is not None
        await back.release()


async def test_a_block_that_ends_the_work_itself(lab: str) -> None:
    async with person(lab, "alice") as alice:
        async with driving(alice, ARM) as arm:
            arm.close()
        assert arm.is_closed and (await alice.info(TOKEN)).get("owner") is None
        async with (await alice.token(TOKEN)).grab() as guard:
            async with driving(alice, ARM, guard=guard) as arm:
                await arm.end(guard.release)
            assert guard.is_lost
        with pytest.raises(RuntimeError):
            await arm.end(guard.release)


async def test_a_device_that_is_killed(own_broker: Broker) -> None:
    rail = await asyncio.create_subprocess_exec(
        sys.executable, str(HERE / "examples/rail.py"), ARM,
        env={**os.environ, "PYTHONPATH": str(HERE / "src"), "MOM_HUB": own_broker.address(), "MOM_USER": "arm", "MOM_PASSWORD": "arm"},
    )  # fmt: skip
    try:
        async with own_broker.connect("alice") as alice:
            events = (await alice.channel(ARM)).events()
            while (await heard(events, mom.Message)).name != "state":
                pass
            with pytest.raises(DriveError, match="has not said that it has ended its command"):
                async with driving(alice, ARM) as cart:
                    assert (await soon(cart.carry_out("by 20; by -20"))).finished
                    running = await Under(cart, "go 1000; go 0").begun()
                    rail.kill()
                    end = await soon(running.end)
                    unknown = "what became of the command is not known"
                    gone = f"the hub has lost the connection of arm, the device in /robot/arm; {unknown}"
                    assert (end.name, end.text, end.hint) == ("gone", gone, "see who is there: mom tree /robot")
                    # What nobody can say any more is not waited for by the next one.
                    end = await soon(cart.carry_out("go 0"))
                    assert end.name == "no-answer" and end.text == "no device answers in /robot/arm"
    finally:
        if rail.returncode is None:
            rail.kill()
        await rail.wait()


class Odd:
    """A device that hears nothing of halts, and says what a test wants."""

    def __init__(self, channel: mom.Channel) -> None:
        self.channel, self.events = channel, channel.events()

    async def hears(self, name: str) -> Parcel:
        while (message := await heard(self.events, mom.Message)).name != name:
            pass
        return message.parcel  # type: ignore[no-any-return]

    async def says(self, command: Parcel, state: str, error: str = "") -> None:
        content: Dict[str, Any] = {"peer": command.sender, "id": command.id, "state": state, "statement": 1, "of": 1}
        content.update({"error": {"name": error, "code": 5101, "text": "as told"}} if error else {})
        await self.channel.send_acknowledged("status", content, echo=False)


@pytest_asyncio.fixture
async def odd(own_broker: Broker) -> AsyncIterator[Odd]:
    async with own_broker.connect("arm") as client:
        yield Odd(await client.channel(ARM))


async def test_a_device_that_hears_no_halt_is_stopped(own_broker: Broker, odd: Odd) -> None:
    async with own_broker.connect("alice") as alice:
        with pytest.raises(DriveError) as caught:
            async with driving(alice, ARM) as arm:
                running = Under(arm, "home")
                command = await odd.hears("command")
                await odd.says(command, "executing")
                await running.begun()
                ending = asyncio.ensure_future(end_when_stopped(odd, command))
        await ending
        did_not = "the device in /robot/arm did not end its command when the hub halted it, so it was stopped"
        assert caught.value.text == did_not
        assert caught.value.hint == "see what is wrong with it, then let it go with: mom unstop /robot/arm"
        assert (await alice.info(TOKEN)).get("owner") is None and (await alice.stops(ARM)).stopped


async def end_when_stopped(odd: Odd, command: Parcel) -> None:
    await odd.hears("stop")
    await odd.says(command, "error", "stopped")


async def test_a_device_that_leaves(own_broker: Broker, odd: Odd) -> None:
    async with own_broker.connect("alice") as alice:
        channel, token = await alice.channel(ARM), await alice.token(TOKEN)
        async with token.grab() as guard, Commander(channel, guard) as arm:
            running = Under(arm, "home")
            await odd.says(await odd.hears("command"), "executing")
            await running.begun()
            await odd.channel.leave()
            end = await soon(running.end)
            assert end.text == "arm has left /robot/arm; what became of the command is not known"


async def test_a_device_that_asks_for_its_commands(own_broker: Broker, odd: Odd) -> None:
    async with own_broker.connect("alice") as alice, driving(alice, ARM) as arm:
        running = Under(arm, "home")
        assert (await odd.hears("command")).reference is None
        running.end.cancel()
        pulled = asyncio.ensure_future(
            arm.carry_out("play bell", when_asked=True, attachments={"bell": b"\7"}, expires=5)
        )
        # It is under way once this is answered.
        await alice.info(ARM)
        asked = odd.channel.message("next")
        await odd.channel._core.request(set_receipt(asked))
        command = await odd.hears("command")
        assert command.reference == asked.id and command.expires == 5000
        assert command.content == {"script": "play bell", "attachments": {"bell": b"\7"}}
        await odd.says(command, "finished")
        assert (await soon(pulled)).finished


def set_receipt(parcel: Parcel) -> Parcel:
    parcel.receipt = True
    return parcel


@pytest.mark.parametrize("link", [False, True])
async def test_a_link_that_is_lost(own_broker: Broker, odd: Odd, link: bool) -> None:
    cutter = Cutter(own_broker.port)
    await cutter.start()
    async with mom.connect(f"bin://127.0.0.1:{cutter.port}", user="alice", password="alice", link=link) as alice:
        async with driving(alice, ARM) as arm:
            running = Under(arm, "home")
            command = await odd.hears("command")
            await odd.says(command, "executing")
            await running.begun()
            cutter.cut()
            if link:
                # It is resumed, and what the device says meanwhile is heard.
                await odd.hears("halt")
                await odd.says(command, "error", "halted")
                assert (await soon(running.end)).name == "halted"
            else:
                end = await soon(running.end)
                told = "the connection to the hub is lost, and the token with it; what became of the command is not known"
                assert (end.name, end.text, end.hint) == ("disconnected", told, "see what it did: mom watch /robot/arm")
                again = await soon(arm.carry_out("home"))
                assert again.text == "the connection to the hub is lost, and the token with it; nothing of the command ran"
    await cutter.close()


def readme_example() -> str:
    found = re.search(r"## Drive a device\n.*?```python\n(.*?)```", (HERE / "README.md").read_text(), re.DOTALL)
    assert found
    return found.group(1)


async def test_the_example_of_the_readme(lab: str) -> None:
    example = readme_example()
    assert len(example.strip().splitlines()) <= 15
    env = {**os.environ, "PYTHONPATH": str(HERE / "src"), "MOM_HUB": lab}
    done = await asyncio.get_running_loop().run_in_executor(
        None, lambda: subprocess.run([sys.executable, "-c", example], env=env, capture_output=True, text=True, timeout=PATIENCE)
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        "waiting 0 of 1",
        "executing 1 of 1",
        "workspace-boundary: statement 1: z is 900 mm, but the workspace reaches from 0 to 450 mm [workspace-boundary 5002]",
        "200 mm",
    ]
