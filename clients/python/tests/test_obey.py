"""A device at a hub of the test's: what halts it, what frees it, and what it says of itself."""

from __future__ import annotations

import asyncio
import logging
from typing import Any, AsyncIterator, Dict, List

import pytest
import pytest_asyncio
from conftest import PATIENCE
from device_robot import ARM, Recorder, Robot, robot_at_hub

import mom
from mom.binary import encode, frame
from mom.connection import Connection
from mom.device import DeviceError
from mom.driver import Driver
from mom.parcel import Parcel


@pytest_asyncio.fixture
async def robot() -> AsyncIterator[Robot]:
    async with robot_at_hub() as robot:
        yield robot


async def test_a_device_obeys_stops_by_their_numbers_and_says_after_each_how_it_stands(robot: Robot) -> None:
    await robot.start()
    await robot.until(lambda: robot.said("state"))
    assert robot.arm.may_move() is None
    robot.say("command", "do home", id=8)
    await robot.until(lambda: "home" in robot.told)
    await robot.settled()
    before = len(robot.said("state"))
    robot.say("stop", "smoke", number=7)
    robot.say("command", "do up", id=9)
    await robot.until(lambda: robot.errors())
    robot.say("unstop", number=6)
    await robot.until(lambda: len(robot.said("state")) >= before + 2)
    assert robot.deeds == ["home", "halt"] and robot.arm.is_stopped
    (status,) = [one for one in robot.hub.heard if one.is_("message", "status") and one.content["state"] == "error"]
    assert (status.content["peer"], status.content["id"], status.reference) == ("bob", 9, 9)
    words = "the arm is stopped and takes no command until the stop is released"
    assert status.content["error"] == {"name": "stopped", "code": 5102, "text": words}
    robot.say("unstop", number=7)
    await robot.until(lambda: not robot.said("state")[-1]["stopped"])
    states = [(state["stopped"], state["stop"], state["position"]) for state in robot.said("state")[before:]]
    assert states[0] == states[-2] == (True, 7, 7) and states[-1] == (False, 7, 7)
    assert not robot.arm.is_stopped and robot.deeds == ["home", "halt"], "it moves by the next command only"
    kept = [parcel for parcel in robot.hub.heard if parcel.is_("message", "state")]
    assert all(parcel.delivery == "latest" and parcel.echo is False for parcel in kept)


async def test_a_command_goes_through_its_states_and_its_end_is_told_behind_a_state(robot: Robot) -> None:
    await robot.start()
    robot.say("command", "do up; wait 1; do down", id=3)
    await robot.until(lambda: [one for one in robot.said("status") if one["state"] == "finished"])
    assert robot.told == ["halt", "up", "down"] or robot.told == ["up", "down"]
    words = [(one["state"], one["statement"], one["of"]) for one in robot.said("status")]
    assert words == [("waiting", 0, 3), ("executing", 1, 3), ("executing", 2, 3), ("executing", 3, 3), ("finished", 3, 3)]
    said = [parcel for parcel in robot.hub.heard if parcel.family == "message"]
    assert [parcel.name for parcel in said[-2:]] == ["state", "status"] and "executing" not in said[-2].content


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


async def test_a_device_tells_its_card_to_hubs_that_take_it(robot: Robot) -> None:
    await robot.start()
    for minor, card in ((3, None), (None, None), (4, Recorder.card())):
        robot.client._core.welcome["protocol"] = {"major": 1, "minor": minor}
        # A join again keeps it.
        await robot.arm.channel.thin(newest=True)
        (*_, join) = [parcel.content for parcel in robot.hub.heard if parcel.is_("context", "join") and parcel.context == ARM]
        assert join["device"].get("card") == card and join["newest"]


async def test_a_device_learns_from_a_halt_which_token_guards_it_from_now_on(robot: Robot) -> None:
    await robot.start()
    robot.say("command", "do free")
    await robot.until(lambda: "free" in robot.told)
    guard = {"token": "/robot/token", "names": ["command"], "owner": "bob", "fence": 3}
    # Only the hub may say so.
    robot.say("halt", {"guard": guard})
    robot.say("command", "do again")
    await robot.until(lambda: "again" in robot.told)
    robot.say("halt", {"guard": guard}, sender="hub")
    robot.say("command", "do unguarded", id=4)
    robot.say("command", "do mine", fence=3)
    await robot.until(lambda: "mine" in robot.told)
    assert robot.deeds == ["free", "again", "halt", "mine"]
    assert robot.errors() == [(4, "older-fence")]
    assert robot.why(4) == "the command was sent without a fence, and bob owns its token now, with fence 3"
    robot.say("halt", {"guard": {}}, sender="hub")
    robot.say("command", "do unguarded")
    await robot.until(lambda: "unguarded" in robot.told)


async def test_a_device_that_is_put_out_of_its_channel_halts_and_says_why(robot: Robot) -> None:
    await robot.start()
    # Another one that is put out does not concern this one.
    robot.tell("expelled", peer="bob", text="off")
    robot.say("command", "do before")
    robot.tell("expelled", peer=robot.client.name, text="arm~2 is the device here now")
    robot.say("command", "do after")
    await robot.arm.ended()
    words = "it was expelled from its channel: arm~2 is the device here now"
    assert robot.told[-1] == "halt" and "after" not in robot.told
    held = robot.arm.may_move()
    assert held is not None and (held.word, held.text) == ("unknown", words)


async def test_what_the_hub_itself_says_is_the_safe_state(robot: Robot) -> None:
    await robot.start()
    robot.say("command", "hold", id=1)
    await robot.until(lambda: "hold" in robot.told)
    # Only the hub may say this.
    robot.say("halt")
    await robot.settled()
    assert robot.deeds == ["hold"]
    robot.say("halt", sender="hub")
    robot.say("command", "hold", id=2)
    await robot.until(lambda: robot.told.count("hold") == 2)
    robot.say("command", "do park", sender="hub")
    await robot.until(lambda: "park" in robot.told)
    assert robot.deeds == ["hold", "halt", "hold", "halt", "park"]
    assert robot.errors() == [(1, "halted"), (2, "halted")] and "the hub ordered the safe state" in robot.why(1)


async def test_a_device_obeys_no_earlier_owner_and_no_old_message(robot: Robot) -> None:
    robot.guard = {"guard": {"token": "/robot/token", "names": ["command"], "owner": "bob", "fence": 3}}
    await robot.start()
    robot.say("command", "do earlier", fence=2, id=4)
    robot.say("command", "do mine", fence=3)
    await robot.until(lambda: "mine" in robot.told)
    robot.hub.say(Parcel("message", "command", ARM, "do kept", sender="bob", fence=3, extra={"history": True}))
    robot.say("command", "hold", fence=3, id=6)
    await robot.until(lambda: "hold" in robot.told)
    robot.hub.say(Parcel("event", "released", "/robot/token", {"owner": "bob", "reason": "released", "fence": 3}))
    robot.say("command", "do later", fence=3, id=5)
    await robot.until(lambda: len(robot.errors()) == 3)
    assert robot.deeds == ["mine", "hold", "halt"]
    assert robot.errors() == [(4, "older-fence"), (6, "halted"), (5, "older-fence")]


async def test_the_first_motion_of_a_new_owner_waits_until_the_device_rests(robot: Robot) -> None:
    robot.guard = {"guard": {"token": "/robot/token", "names": ["command"], "owner": "bob", "fence": 3}}
    await robot.start()
    robot.say("command", "hold", fence=3, id=1)
    await robot.until(lambda: "hold" in robot.told)
    place = 0
    rolling = iter(range(100))

    def position() -> Dict[str, Any]:
        # For a while it rolls on, though it was halted.
        nonlocal place
        place = next(rolling) * 5 if place < 30 else place
        return {"position": place}

    robot.device.position = position  # type: ignore[method-assign]
    robot.hub.say(Parcel("event", "grabbed", "/robot/token", {"owner": "carol", "level": 1, "fence": 4}))
    robot.say("command", "do next", sender="carol", fence=4, id=2)
    await robot.until(lambda: "next" in robot.told)
    await robot.settled()
    rests = [state for state in robot.said("state") if state.get("fence") == 4 and state.get("rest") == "measured"]
    assert place >= 30 and rests and rests[0]["position"] == place and not rests[0]["moving"]
    assert robot.errors() == [(1, "halted")] and robot.why(1) == "the arm was halted: the token changed hands"


async def test_it_moves_nothing_before_it_has_heard_how_it_stands_on_this_connection(robot: Robot) -> None:
    await robot.start()
    robot.say("command", "hold", id=1)
    await robot.until(lambda: "hold" in robot.told)
    robot.say("stop", number=5)
    await robot.until(lambda: robot.arm.is_stopped)
    robot.say("unstop", number=5)
    robot.say("command", "hold", id=2)
    await robot.until(lambda: robot.told.count("hold") == 2)
    robot.say("stop", number=6)
    await robot.until(lambda: robot.arm.is_stopped)
    robot.hub.cut()
    await robot.until(lambda: robot.hub.resumes)
    await robot.settled()
    assert robot.arm.is_stopped, "what stopped it holds over the loss"
    robot.tell("unstopped", number=6, stopped=False)
    await robot.until(lambda: robot.arm.may_move() is None)
    # Not stopped before, and still it has to hear so.
    robot.say("command", "hold", id=3)
    await robot.until(lambda: robot.told.count("hold") == 3)
    robot.hub.cut()
    await robot.until(lambda: len(robot.hub.resumes) == 2)
    robot.say("command", "do early", id=4)
    await robot.settled()
    held = robot.arm.may_move()
    assert held is not None and held.word == "unknown" and "early" not in robot.told
    # What was said while the link was down is said when it is back.
    await robot.until(lambda: len(robot.errors()) == 4)
    assert robot.why(3) == "the arm was halted: the link to the hub was lost" and robot.errors()[3] == (4, "stopped")
    robot.say("stop", {"by": "carol", "reason": "fire"}, sender="hub", number=8)
    await robot.until(lambda: robot.arm.is_stopped)
    held = robot.arm.may_move()
    assert held is not None and held.text == "stopped by carol: fire"


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
    joined = [parcel.name for parcel in robot.hub.heard if parcel.context == ARM and parcel.family in ("context", "message")]
    assert all(joined[place - 1] != "logout" for place in range(len(joined))) and joined[0] == "join"


async def test_how_a_command_ended_is_told_when_the_channel_is_joined_again(robot: Robot) -> None:
    await robot.start()
    robot.say("command", "hold", id=1)
    await robot.until(lambda: "hold" in robot.told)
    robot.hub.resumable = False
    robot.hub.cut()
    await robot.until(lambda: robot.errors())
    names = [parcel.name for parcel in robot.hub.heard if parcel.context == ARM]
    assert robot.why(1) == "the arm was halted: the link to the hub was lost"
    assert "status" in names[len(names) - names[::-1].index("join") :], "nothing is said before it is a member again"


async def test_a_hub_that_tells_no_state_of_stops_has_none(robot: Robot) -> None:
    robot.hub.replies["join"] = {"path": ARM, "kind": "channel", "number": 7}
    robot.client = await mom.connect(robot.hub.address, guest=True)
    robot.arm = await robot.client.obey(ARM, robot.device)
    await robot.until(lambda: robot.arm.may_move() is None)


async def test_a_stop_behind_more_than_it_keeps_is_obeyed(robot: Robot) -> None:
    await robot.start(event_buffer=8)
    await robot.until(lambda: robot.said("state"))
    robot.say("command", "hold", id=1)
    await robot.until(lambda: "hold" in robot.told)
    # All of it is there before the device takes the first.
    notes = [Parcel("message", "note", ARM, number, sender="bob") for number in range(1100)]
    flood = [*notes, Parcel("message", "stop", ARM, "smoke", sender="bob", extra={"stop": 7}), *notes]
    robot.hub.writer.write(b"".join(frame(encode(parcel)) for parcel in flood))  # type: ignore[union-attr]
    robot.hub.sent += len(flood)
    await robot.until(lambda: robot.arm.is_stopped and robot.told[-1] == "halt")
    await robot.settled()
    assert robot.said("state")[-1]["stop"] == 7
    # It has missed some, and it missed only that stop.
    assert robot.said("stop") == [] and robot.errors() == [(1, "stopped")]
    held = robot.arm.may_move()
    assert held is not None and held.text == "stopped by bob: smoke" and "it has missed" in robot.why(1)


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
    robot.say("command", "hold", id=1)
    await robot.until(lambda: "hold" in robot.told)
    robot.arm.stop_itself("bumper")
    assert robot.told[-1] == "halt"
    await robot.until(lambda: robot.said("stop"))
    assert robot.said("stop") == [{"reason": "stopped by itself: bumper"}]
    await robot.until(lambda: robot.errors())
    assert robot.why(1) == "the arm was stopped: bumper"
    robot.hub.resumable = False
    robot.hub.cut()
    await robot.until(lambda: len(robot.said("stop")) == 2)


async def test_it_halts_when_the_hub_is_silent_and_may_move_when_that_is_heard(robot: Robot) -> None:
    robot.hub.limits = {"heartbeat": 100, "gone": 30_000}
    await robot.start(heartbeat=0.1)
    await robot.until(lambda: robot.arm.may_move() is None)
    robot.say("command", "hold", id=1)
    await robot.until(lambda: "hold" in robot.told)
    robot.hub.silent = True
    await robot.until(lambda: robot.told[-1] == "halt")
    held = robot.arm.may_move()
    assert held is not None and held.text == "the hub is silent"
    robot.hub.silent = False
    await robot.until(lambda: robot.arm.may_move() is None)
    await robot.until(lambda: robot.errors())
    assert robot.why(1) == "the arm was halted: the hub is silent"


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
    robot.say("command", "do up")
    await robot.until(lambda: len(served) > 1)
    assert robot.told and set(robot.told) == {"halt"}


async def test_it_halts_at_its_end(robot: Robot) -> None:
    await robot.start()
    robot.say("command", "hold", id=1)
    await robot.until(lambda: "hold" in robot.told)
    await robot.arm.leave()
    assert robot.told[-1] == "halt"
    # It says so before it leaves.
    names = [parcel.name for parcel in robot.hub.heard if parcel.context == ARM]
    assert names[-1] == "leave" and robot.why(1) == "the arm was halted: it is leaving its channel"
    held = robot.arm.may_move()
    assert held is not None and "no longer a device" in held.text
    again = Recorder()
    arm = await robot.client.obey(ARM, again)
    await robot.client.close()
    await asyncio.wait_for(arm.ended(), PATIENCE)
    assert again.told[-1] == "halt"


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

    robot.device.moving = lambda word: move(word)
    for number, command in enumerate(("up", "down")):
        robot.say("command", f"do {command}", id=number)
    await robot.until(lambda: "up" in robot.told)
    robot.say("stop", number=7)
    await robot.until(lambda: len(robot.errors()) == 2)
    # One command is carried out at a time: the other has not begun.
    assert steps == ["up ends"] and "down" not in robot.told
    assert robot.errors() == [(0, "stopped"), (1, "stopped")]
    robot.say("unstop", number=7)
    robot.say("command", "do break", id=3)
    await robot.until(lambda: len(robot.errors()) == 3)
    assert robot.errors()[2] == (3, "link") and robot.why(3) == "statement 1: `do` failed: ValueError: no such joint"


async def test_what_a_verb_raises_is_told_to_its_sender(robot: Robot, caplog: pytest.LogCaptureFixture) -> None:
    await robot.start()

    def move(word: str) -> None:
        raise DeviceError("obstacle", "a hand is in it") if word == "one" else KeyError("joint")

    robot.device.moving = move
    robot.say("command", "wait 1; do one; do two", id=1)
    robot.say("command", "do three", id=2)
    robot.say("command", "do four", id=3)
    await robot.until(lambda: len(robot.errors()) == 3)
    assert robot.errors() == [(1, "obstacle"), (2, "halted"), (3, "halted")]
    (error, *_) = [one["error"] for one in robot.said("status") if one["state"] == "error"]
    assert error == {"name": "obstacle", "code": 5110, "text": "statement 2: a hand is in it", "statement": 2}
    assert robot.why(2) == "the command before it failed, so this one was not begun"
    assert robot.told[-1] == "halt" and not caplog.records[1:], "what it says itself is not logged"
    robot.say("command", "do two", id=4)
    await robot.until(lambda: len(robot.errors()) == 4)
    assert robot.errors()[3] == (4, "link") and "the arm: `do` failed" in caplog.text
    robot.device.moving = lambda word: None
    robot.say("command", "do five")
    await robot.until(lambda: "five" in robot.told)


@pytest.mark.parametrize("what", ["halt", "position", "report"])
async def test_a_machine_that_fails_stands_and_says_why(robot: Robot, caplog: pytest.LogCaptureFixture, what: str) -> None:
    await robot.start()
    robot.say("command", "hold", id=1)
    await robot.until(lambda: "hold" in robot.told)
    halted: List[str] = []

    def fails() -> Any:
        halted.append(what)
        raise ZeroDivisionError(what)

    setattr(robot.device, what, fails)
    robot.say("stop", number=7)
    robot.say("unstop", number=7)
    robot.say("command", "do up", id=2)
    with pytest.raises(ZeroDivisionError):
        await asyncio.wait_for(robot.arm.ended(), PATIENCE)
    assert robot.arm.may_move() is not None and "obeys nothing any more" in caplog.text
    # Also where that is what fails, it is tried.
    assert robot.told[-1] == "halt" if what != "halt" else len(halted) > 1
    robot.arm.report()
    robot.arm.stop_itself("bumper")
    await robot.settled()
    assert "up" not in robot.told and robot.said("stop") == []


async def test_it_hears_how_it_stands_also_where_the_channel_is_heard_already(robot: Robot) -> None:
    robot.books(number=0, stopped=False)
    robot.client = await mom.connect(robot.hub.address, guest=True)
    (await robot.client.channel(ARM, device=True)).events()
    robot.arm = await robot.client.obey(ARM, robot.device)
    await robot.until(lambda: robot.arm.may_move() is None)
    robot.hub.say(Parcel("event", "joined", ARM, {"peer": "carol", "user": "carol", "level": 1}))
    await robot.until(lambda: any(parcel.address == ["carol"] for parcel in robot.hub.heard))
    (told,) = [parcel.content for parcel in robot.hub.heard if parcel.address == ["carol"]]
    assert told["stops-within"] == 1000


async def test_a_device_with_a_slow_heartbeat_is_told_so(robot: Robot, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "mom"):
        await robot.start()
    assert "connect with heartbeat=0.5" in caplog.text


async def test_a_path_that_cannot_be_joined_is_no_device(robot: Robot) -> None:
    robot.hub.replies["join"] = {"path": ARM, "kind": "session", "number": 7}
    robot.client = await mom.connect(robot.hub.address, guest=True)
    with pytest.raises(mom.RefusedError, match="wrong-kind"):
        await robot.client.obey(ARM, robot.device)
    assert robot.told == []


async def test_what_cannot_be_a_device_leaves_the_channel(robot: Robot) -> None:
    await robot.start()
    with pytest.raises(TypeError, match="mom.device.Device as its base"):
        await robot.client.obey("/robot/other", Recorder)  # type: ignore[arg-type]
    broken = Recorder()
    broken.is_reached = lambda: 1 / 0  # type: ignore[method-assign, assignment, return-value]
    with pytest.raises(ZeroDivisionError):
        await robot.client.obey("/robot/other", broken)
    await robot.settled()
    said = [parcel.name for parcel in robot.hub.heard if parcel.context == "/robot/other"]
    assert said == ["join", "leave"] and "/robot/other" not in robot.client._core.places


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
