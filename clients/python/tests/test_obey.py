"""A device at a hub of the test's: what halts it, what frees it, and what it says of itself."""

from __future__ import annotations

import asyncio
import logging
from typing import Any, AsyncIterator, Awaitable, Callable, Dict, List, Optional

import pytest
import pytest_asyncio
from conftest import PATIENCE
from fake_hub import FakeHub

import mom
from mom.binary import encode, frame
from mom.connection import Connection
from mom.driver import Driver
from mom.parcel import Parcel

ARM = "/robot/arm"
QUICK = mom.Reconnect(first=0.005, most=0.05)


class Recorder(mom.Machine):
    """Notes what it is told."""

    def __init__(self) -> None:
        self.told: List[Any] = []
        self.moving: Optional[Callable[[Any], Any]] = None

    def halt(self, why: str) -> None:
        self.told.append(f"halt: {why}")

    def move(self, command: Any, message: mom.Message) -> Optional[Awaitable[Any]]:
        self.told.append(command)
        moving: Optional[Awaitable[Any]] = self.moving(command) if self.moving else None
        return moving

    def state(self) -> Dict[str, Any]:
        return {"position": 7}

    def free(self) -> None:
        self.told.append("free")


class Robot:
    """A device, its machine, and the hub that it is at."""

    def __init__(self, hub: FakeHub) -> None:
        self.hub, self.machine = hub, Recorder()
        self.guard: Dict[str, Any] = {}
        self.client: mom.Client
        self.arm: mom.Device

    async def start(self, **options: Any) -> None:
        self.books(number=0, stopped=False)
        self.client = await mom.connect(self.hub.address, guest=True, reconnect=QUICK, **{"heartbeat": 5.0, **options})
        self.arm = await self.client.obey(ARM, self.machine)

    def books(self, **state: Any) -> None:
        """What the hub says to who joins."""
        self.hub.replies["join"] = {"path": ARM, "kind": "channel", "number": 7, "stop": state, **self.guard}

    def say(
        self, name: str, content: Any = None, sender: str = "bob", number: Optional[int] = None, **slots: Any
    ) -> None:
        extra = {} if number is None else {"stop": number}
        self.hub.say(Parcel("message", name, ARM, content, sender=sender, extra=extra, **slots))

    def tell(self, name: str, **state: Any) -> None:
        self.hub.say(Parcel("event", name, ARM, state, sender="hub"))

    def said(self, name: str) -> List[Any]:
        return [parcel.content for parcel in self.hub.heard if parcel.is_("message", name)]

    @property
    def told(self) -> List[Any]:
        return self.machine.told

    async def until(self, condition: Callable[[], Any]) -> None:
        async def wait() -> None:
            while not condition():
                await asyncio.sleep(0.002)  # tidy: looks again until it is so

        try:
            await asyncio.wait_for(wait(), PATIENCE)
        except asyncio.TimeoutError:
            raise AssertionError(f"told {self.told}, said {[(p.name, p.content) for p in self.hub.heard]}") from None

    async def settled(self) -> None:
        """All that the hub has said so far is heard, and all that the device has said to it has come."""
        for _ in range(2):
            await self.client.lookup("/")


@pytest_asyncio.fixture
async def robot() -> AsyncIterator[Robot]:
    hub = await FakeHub().start()
    robot = Robot(hub)
    yield robot
    await robot.client.close()
    await hub.stop()


async def test_a_device_obeys_stops_by_their_numbers_and_says_after_each_how_it_stands(robot: Robot) -> None:
    await robot.start()
    await robot.until(lambda: robot.said("state"))
    assert robot.arm.may_move() is None
    robot.say("command", "home")
    robot.say("stop", "smoke", number=7)
    robot.say("command", "up", id=9)
    await robot.until(lambda: len(robot.said("state")) == 2)
    robot.say("unstop", number=6)
    await robot.until(lambda: len(robot.said("state")) == 3 and robot.said("status"))
    assert robot.told == ["home", "halt: stopped by bob: smoke"]
    (status,) = [parcel for parcel in robot.hub.heard if parcel.is_("message", "status")]
    assert (status.content["state"], status.content["peer"], status.reference) == ("error", "bob", 9)
    assert status.content["error"] == {"name": "stopped", "text": "stopped by bob: smoke"}
    robot.say("unstop", number=7)
    await robot.until(lambda: len(robot.said("state")) == 4)
    states = [(state["stopped"], state["stop"], state["position"]) for state in robot.said("state")]
    assert states == [(False, 0, 7), (True, 7, 7), (True, 7, 7), (False, 7, 7)]
    assert robot.told[-1] == "free" and not robot.arm.is_stopped
    kept = [parcel for parcel in robot.hub.heard if parcel.is_("message", "state")]
    assert all(parcel.delivery == "latest" and parcel.echo is False for parcel in kept)


async def test_a_device_says_what_it_has_heard_of_stops_when_its_channel_is_back(robot: Robot) -> None:
    await robot.start()
    robot.say("stop", "smoke", number=7)
    await robot.until(lambda: robot.arm.is_stopped)
    # As where a hub began anew, and knows no stop.
    robot.tell("deleted")
    await robot.until(lambda: ARM not in robot.client._core.places)
    await robot.client.obey(ARM, Recorder())
    joins = [parcel.content for parcel in robot.hub.heard if parcel.is_("context", "join") and parcel.context == ARM]
    first, last = joins[0]["device"], joins[-1]["device"]
    assert (last["stop"], last["stopped"]) == (7, True)
    # It is the same installation, started when it was.
    assert last["installation"] and [last[key] for key in ("installation", "begun")] == [first[key] for key in ("installation", "begun")]


async def test_a_device_learns_from_a_halt_which_token_guards_it_from_now_on(robot: Robot) -> None:
    await robot.start()
    robot.say("command", "free")
    await robot.until(lambda: "free" in robot.told)
    guard = {"token": "/robot/token", "names": ["command"], "owner": "bob", "fence": 3}
    # Only the hub may say so.
    robot.say("halt", {"guard": guard})
    robot.say("command", "free again")
    await robot.until(lambda: "free again" in robot.told)
    robot.say("halt", {"guard": guard}, sender="hub")
    robot.say("command", "unguarded", id=4)
    robot.say("command", "mine", fence=3)
    await robot.until(lambda: "mine" in robot.told)
    assert robot.told == ["free", "free again", "halt: safe state", "mine"]
    assert [(status["id"], status["error"]["name"]) for status in robot.said("status")] == [(4, "older-fence")]
    robot.say("halt", {"guard": {}}, sender="hub")
    robot.say("command", "unguarded")
    await robot.until(lambda: "unguarded" in robot.told)


async def test_a_device_that_is_put_out_of_its_channel_halts_and_says_why(robot: Robot) -> None:
    await robot.start()
    # Another one that is put out does not concern this one.
    robot.tell("expelled", peer="bob", text="off")
    robot.say("command", "before")
    robot.tell("expelled", peer=robot.client.name, text="arm~2 is the device here now")
    robot.say("command", "after")
    await robot.arm.ended()
    words = "it was expelled from its channel: arm~2 is the device here now"
    assert robot.told == ["before", f"halt: {words}"]
    held = robot.arm.may_move()
    assert held is not None and (held.word, held.text) == ("unknown", words)


async def test_what_the_hub_itself_says_is_the_safe_state(robot: Robot) -> None:
    await robot.start()
    # Only the hub may say this.
    robot.say("halt")
    robot.say("halt", sender="hub")
    robot.say("command", "park", sender="hub")
    await robot.until(lambda: "park" in robot.told)
    assert robot.told == ["halt: safe state", "halt: safe state", "park"]


async def test_a_device_obeys_no_earlier_owner_and_no_old_message(robot: Robot) -> None:
    robot.guard = {"guard": {"token": "/robot/token", "names": ["command"], "owner": "bob", "fence": 3}}
    await robot.start()
    robot.say("command", "earlier", fence=2, id=4)
    robot.say("command", "mine", fence=3)
    await robot.until(lambda: "mine" in robot.told)
    robot.hub.say(Parcel("message", "command", ARM, "kept", sender="bob", fence=3, extra={"history": True}))
    robot.hub.say(Parcel("event", "released", "/robot/token", {"owner": "bob", "reason": "released", "fence": 3}))
    robot.say("command", "later", fence=3, id=5)
    await robot.until(lambda: len(robot.said("status")) == 2)
    assert robot.told == ["mine", "halt: its owner no longer owns it"]
    assert [(status["id"], status["error"]["name"]) for status in robot.said("status")] == [
        (4, "older-fence"),
        (5, "older-fence"),
    ]


async def test_it_moves_nothing_before_it_has_heard_how_it_stands_on_this_connection(robot: Robot) -> None:
    await robot.start()
    robot.say("stop", number=5)
    await robot.until(lambda: robot.arm.is_stopped)
    robot.hub.cut()
    await robot.until(lambda: robot.hub.resumes)
    assert "halt: the connection to the hub is lost" in robot.told
    await robot.settled()
    assert robot.arm.is_stopped, "what stopped it holds over the loss"
    robot.tell("unstopped", number=5, stopped=False)
    await robot.until(lambda: robot.arm.may_move() is None)
    # Not stopped before, and still it has to hear so.
    robot.hub.cut()
    await robot.until(lambda: len(robot.hub.resumes) == 2)
    robot.say("command", "too early")
    await robot.settled()
    held = robot.arm.may_move()
    assert held is not None and held.word == "unknown" and "too early" not in robot.told
    robot.say("stop", {"by": "carol", "reason": "fire"}, sender="hub", number=8)
    await robot.until(lambda: robot.arm.is_stopped)
    assert robot.told[-1] == "halt: stopped by carol: fire"


async def test_it_says_what_it_knew_when_it_joins_again(robot: Robot) -> None:
    await robot.start()
    robot.say("stop", number=8)
    await robot.until(lambda: robot.arm.is_stopped)
    robot.books(number=8, stopped=True, by="bob")
    robot.hub.resumable = False
    robot.hub.cut()

    def joins() -> List[Any]:
        return [parcel.content for parcel in robot.hub.heard if parcel.name == "join" and parcel.context == ARM]

    await robot.until(lambda: len(joins()) == 2)
    words = [(content["device"]["stop"], content["device"]["stopped"]) for content in joins()]
    assert words == [(0, False), (8, True)]
    # With the answer it knows how it stands, and says so.
    await robot.until(lambda: robot.hub.heard[-1].name == "state")
    held = robot.arm.may_move()
    assert held is not None and held.word == "stopped"
    # By the answer to the join and by an event, too, it knows more than it did.
    robot.tell("unstopped", number=9, stopped=False)
    await robot.until(lambda: robot.arm.may_move() is None)
    robot.books(number=11, stopped=True, by="bob")
    for number, word in ((3, {"stop": 8, "stopped": False}), (4, {"stop": 11, "stopped": True})):
        robot.hub.cut()
        await robot.until(lambda: len(joins()) == number)
        said = joins()[-1]["device"]
        assert {key: said[key] for key in word} == word
        await robot.until(lambda: robot.arm.is_stopped)


async def test_a_hub_that_tells_no_state_of_stops_has_none(robot: Robot) -> None:
    robot.hub.replies["join"] = {"path": ARM, "kind": "channel", "number": 7}
    robot.client = await mom.connect(robot.hub.address, guest=True)
    robot.arm = await robot.client.obey(ARM, robot.machine)
    await robot.until(lambda: robot.arm.may_move() is None)


async def test_a_stop_behind_more_than_it_keeps_is_obeyed(robot: Robot) -> None:
    await robot.start(event_buffer=8)
    await robot.until(lambda: robot.said("state"))
    # All of it is there before the device takes the first.
    notes = [Parcel("message", "note", ARM, number, sender="bob") for number in range(1100)]
    flood = [*notes, Parcel("message", "stop", ARM, "smoke", sender="bob", extra={"stop": 7}), *notes]
    robot.hub.writer.write(b"".join(frame(encode(parcel)) for parcel in flood))  # type: ignore[union-attr]
    robot.hub.sent += len(flood)
    await robot.until(lambda: robot.arm.is_stopped and "halt: stopped by bob: smoke" in robot.told)
    await robot.settled()
    assert robot.said("state")[-1]["stop"] == 7
    # It has missed some, and it missed only that stop.
    assert robot.said("stop") == [] and any("it has missed" in str(word) for word in robot.told)


async def test_a_gap_is_a_stop_of_its_own(robot: Robot) -> None:
    await robot.start(event_buffer=2)
    await robot.until(lambda: robot.said("state"))
    flood = [Parcel("message", "map", ARM, number, sender="bob") for number in range(40)]
    robot.hub.writer.write(b"".join(frame(encode(parcel)) for parcel in flood))  # type: ignore[union-attr]
    robot.hub.sent += len(flood)
    await robot.until(lambda: robot.said("stop"))
    (stop,) = [parcel for parcel in robot.hub.heard if parcel.is_("message", "stop")]
    held = robot.arm.may_move()
    assert (
        stop.address == ["alice"] and held is not None and held.word == "own" and stop.content == {"reason": held.text}
    )
    assert held.text.startswith("stopped by itself: it has missed ")
    robot.say("unstop", number=50)
    await robot.settled()
    assert robot.arm.is_stopped, "that does not name its own stop"
    robot.say("stop", stop.content, sender="alice", number=51)
    robot.say("unstop", number=51)
    await robot.until(lambda: robot.arm.may_move() is None)


async def test_it_stops_itself_and_tells_the_hub_when_that_is_back(robot: Robot) -> None:
    await robot.start()
    robot.arm.stop_itself("bumper")
    assert robot.told == ["halt: bumper"]
    await robot.until(lambda: robot.said("stop"))
    assert robot.said("stop") == [{"reason": "stopped by itself: bumper"}]
    robot.hub.resumable = False
    robot.hub.cut()
    await robot.until(lambda: len(robot.said("stop")) == 2)


async def test_it_halts_when_the_hub_is_silent_and_may_move_when_that_is_heard(robot: Robot) -> None:
    robot.hub.limits = {"heartbeat": 100, "gone": 30_000}
    await robot.start(heartbeat=0.1)
    await robot.until(lambda: robot.arm.may_move() is None)
    robot.hub.silent = True
    await robot.until(lambda: "halt: the hub is silent" in robot.told)
    held = robot.arm.may_move()
    assert held is not None and held.text == "the hub is silent"
    robot.hub.silent = False
    await robot.until(lambda: robot.arm.may_move() is None)


async def test_it_moves_by_nothing_that_came_while_its_program_stood_still(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    served: List[Connection] = []
    serve = Driver._serve

    async def noting(driver: Driver, connection: Connection) -> str:
        served.append(connection)
        return await serve(driver, connection)

    monkeypatch.setattr(Driver, "_serve", noting)
    await robot.start()
    await robot.until(lambda: robot.said("state"))
    # As if nothing had run for so long: what is there then is older than the connection lives.
    served[0].heard -= 1000
    robot.say("command", "up")
    await robot.until(lambda: len(served) > 1)
    assert robot.told and all(str(word).startswith("halt: ") for word in robot.told)


async def test_it_halts_at_its_end(robot: Robot) -> None:
    await robot.start()
    await robot.arm.leave()
    assert robot.told[-1] == "halt: it is no longer a device of its channel"
    held = robot.arm.may_move()
    assert held is not None and "no longer a device" in held.text
    again = Recorder()
    arm = await robot.client.obey(ARM, again)
    await robot.client.close()
    await asyncio.wait_for(arm.ended(), PATIENCE)
    assert again.told[-1] == "halt: it is no longer a device of its channel"


async def test_a_move_that_takes_long_is_cancelled_before_the_machine_is_halted(robot: Robot) -> None:
    await robot.start()
    steps: List[str] = []

    async def move(command: str) -> None:
        if command == "break":
            raise ValueError("no such joint")
        try:
            await asyncio.Event().wait()
        finally:
            steps.append(f"{command} ends")
        steps.append("never")

    robot.machine.moving = move
    for number, command in enumerate(("up", "down")):
        robot.say("command", command, id=number)
    await robot.until(lambda: robot.told == ["up", "down"])
    robot.say("stop", number=7)
    await robot.until(lambda: len(robot.said("status")) == 2)
    assert sorted(steps) == ["down ends", "up ends"]
    assert [status["error"]["name"] for status in robot.said("status")] == ["halted", "halted"]
    robot.say("unstop", number=7)
    robot.say("command", "break", id=3)
    await robot.until(lambda: len(robot.said("status")) == 3)
    assert robot.said("status")[2]["error"] == {"name": "failed", "text": "ValueError: no such joint"}


async def test_what_a_move_raises_is_told_to_its_sender(robot: Robot) -> None:
    await robot.start()

    def move(command: Any) -> None:
        raise mom.LocalError("stale-state", "it has moved since") if command == 1 else KeyError("joint")

    robot.machine.moving = move
    for number in (1, 2):
        robot.say("command", number, id=number)
    await robot.until(lambda: len(robot.said("status")) == 2)
    assert [status["error"]["name"] for status in robot.said("status")] == ["stale-state", "failed"]
    robot.machine.moving = None
    robot.say("command", 3)
    await robot.until(lambda: 3 in robot.told)


async def test_a_machine_that_fails_stands_and_says_why(robot: Robot, caplog: pytest.LogCaptureFixture) -> None:
    await robot.start()
    robot.machine.free = lambda: 1 / 0  # type: ignore[method-assign, assignment]
    robot.say("stop", number=7)
    robot.say("unstop", number=7)
    with pytest.raises(ZeroDivisionError):
        await asyncio.wait_for(robot.arm.ended(), PATIENCE)
    assert robot.told[-1] == "halt: it is no longer a device of its channel" and robot.arm.may_move() is not None
    assert "obeys nothing any more" in caplog.text


async def test_it_hears_how_it_stands_also_where_the_channel_is_heard_already(robot: Robot) -> None:
    robot.books(number=0, stopped=False)
    robot.client = await mom.connect(robot.hub.address, guest=True)
    (await robot.client.channel(ARM, device=True)).events()
    robot.arm = await robot.client.obey(ARM, robot.machine)
    await robot.until(lambda: robot.arm.may_move() is None)
    robot.hub.say(Parcel("event", "joined", ARM, {"peer": "carol", "user": "carol", "level": 1}))
    await robot.until(lambda: any(parcel.address == ["carol"] for parcel in robot.hub.heard))


async def test_a_device_with_a_slow_heartbeat_is_told_so(robot: Robot, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "mom"):
        await robot.start()
    assert "connect with heartbeat=0.5" in caplog.text


async def test_a_path_that_cannot_be_joined_is_no_device(robot: Robot) -> None:
    robot.hub.replies["join"] = {"path": ARM, "kind": "session", "number": 7}
    robot.client = await mom.connect(robot.hub.address, guest=True)
    with pytest.raises(mom.RefusedError, match="wrong-kind"):
        await robot.client.obey(ARM, robot.machine)
    assert robot.told == []


async def test_what_the_hub_says_of_stops_is_kept_in_a_full_queue_the_newest_of_it(robot: Robot) -> None:
    await robot.start(event_buffer=2)
    events = robot.arm.channel.events()
    for name, number in (("stopped", 1), ("unstopped", 1), ("stopped", 2)):
        robot.tell(name, number=number, stopped=name == "stopped", by="bob", **{"unstopped-by": "carol"})
    robot.tell("stopped", number=3, stopped=True, only=["belt"])
    for number in range(9):
        robot.say("map", number)
    await robot.settled()
    taken = []
    while (event := events.try_next()) is not None:
        if isinstance(event, mom.Stops):
            taken.append(
                (event.state.number, event.state.stopped, event.state.by, event.unstopped_by, event.state.only)
            )
    assert taken == [(1, False, "bob", "carol", []), (2, True, "bob", None, []), (3, True, None, None, ["belt"])]
