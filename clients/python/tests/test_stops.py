"""Stopping and letting go by the hub's own requests: a channel or a whole session, without joining it."""

from __future__ import annotations

import asyncio
import json
import time
from datetime import datetime
from pathlib import Path
from typing import Any, AsyncIterator, Dict

import pytest
import pytest_asyncio
from conftest import PATIENCE, Broker, heard, state
from fake_hub import FakeHub

import mom
from mom.device import Device, DevicePeer, verb
from mom.stops import StopReport

ARM = "/robot/arm"


class Arm(Device):
    stops_within = 50

    def __init__(self) -> None:
        self.halts = 0
        self.rolls = False

    def halt(self) -> None:
        self.halts += 1

    def position(self) -> Dict[str, Any]:
        # It does not measure, unless it rolls.
        return {"x": time.monotonic()} if self.rolls else {}

    @verb
    async def drive(self) -> None:
        await asyncio.Event().wait()


@pytest_asyncio.fixture
async def arm(broker: Broker) -> AsyncIterator[DevicePeer]:
    """A device at the lab. What another test has stopped is let go."""
    async with broker.connect("arm", heartbeat=0.5) as client, broker.connect("alice") as alice:
        device = await client.obey(ARM, Arm())
        await alice.unstop(ARM, (await alice.stops(ARM)).number, within=0)
        yield device


async def eventually(condition: Any) -> None:
    async def wait() -> None:
        while not condition():
            await asyncio.sleep(0.002)  # tidy: looks again until it is so

    await asyncio.wait_for(wait(), PATIENCE)


async def test_one_request_stops_what_is_below_a_session(broker: Broker, arm: DevicePeer) -> None:
    async with broker.connect("alice") as alice, broker.connect("bob") as bob:
        seen = (await bob.channel(ARM)).events()
        report = await alice.stop("/", reason="smoke")
        (told,) = [channel for channel in report.channels if channel.path == ARM]
        rests = mom.DeviceAnswer(arm._core.peer, "stopped", rest="not-measured")
        assert told.guarded and told.devices == [rests] and told.is_obeyed
        assert report.others > 0 and arm.is_stopped
        # The camera that turns has a token, and nobody there says that it stands.
        assert [channel.path for channel in report.unobeyed] == ["/camera/pan"] and not report.is_obeyed
        while (stop := await heard(seen, mom.Message)).name != "stop":
            pass
        assert (stop.stop, stop.parcel.context) == (told.number, ARM)
        # A peer that asks or comes later finds out who did it and why.
        books = await bob.stops(ARM)
        assert (books.number, books.stopped, books.by, books.user, books.reason) == (
            told.number,
            True,
            alice.name,
            "alice",
            "smoke",
        )
        assert isinstance(books.since, datetime) and books.only == []
        listed = {info.path: info.stop for info in await bob.list("/robot")}
        assert listed[ARM] == books and listed["/robot/token"] is None
        async with broker.connect("bob") as late:
            events = (await late.channel(ARM)).events()
            known = await heard(events, mom.Stops)
            assert (known.path, known.state.number, known.state.reason) == (ARM, told.number, "smoke")
            freed = await bob.unstop("/", {channel.path: channel.number for channel in report.channels})
            (one,) = [channel for channel in freed.channels if channel.path == ARM]
            assert (
                one.is_obeyed
                and one.devices == [mom.DeviceAnswer(arm._core.peer, "unstopped")]
                and arm.may_move() is None
            )
            while (unstop := await heard(events, mom.Message)).name != "unstop":
                pass
            assert unstop.stop == told.number
        assert not (await bob.stops(ARM)).stopped


ANSWERS = json.loads((Path(__file__).parents[3] / "tests/cases/answers.json").read_text())


@pytest.mark.parametrize("case", ANSWERS, ids=[case["name"] for case in ANSWERS])
def test_case(case: Dict[str, Any]) -> None:
    channel = {"path": ARM, "number": 7, "guard": True, "kept": True, "devices": [{"peer": "arm", **case["answer"]}]}
    (told,) = StopReport.of({"channels": [channel]}).channels
    assert told.is_obeyed == case["obeyed"]
    assert told.devices == [mom.DeviceAnswer("arm", **case["answer"])]


async def test_what_obeys_and_still_moves_does_not_stand(broker: Broker) -> None:
    class Rolling(Arm):
        tolerance = 0.001

    async with broker.connect("arm", heartbeat=0.5) as client, broker.connect("alice") as alice:
        rolling = Rolling()
        await client.obey(ARM, rolling)
        await alice.unstop(ARM, (await alice.stops(ARM)).number, within=0)
        states = (await alice.channel(ARM)).events()
        async with (await alice.token("/robot/token")).grab() as guard:
            arm = await alice.channel(ARM)
            await arm.send_acknowledged("command", "drive", fence=guard.fence)
            while (said := await heard(states, mom.Message)).name != "status" or said.content["state"] != "executing":
                pass
            rolling.rolls = True
            report = await alice.stop(ARM, within=0.1)
            (told,) = report.channels
            assert told.devices == [mom.DeviceAnswer(client.name, "stopped", moving=True)] and not report.is_obeyed
            # It stands, and the stop that waits for that is answered.
            stopping = asyncio.ensure_future(alice.stop(ARM, within=PATIENCE / 10))
            rolling.position = lambda: {"x": 7}  # type: ignore[method-assign]
            report = await stopping
            (told,) = report.channels
            assert told.devices == [mom.DeviceAnswer(client.name, "stopped", rest="measured")] and report.is_obeyed
            await alice.unstop(ARM, told.number)


async def test_an_unstop_of_an_older_stop_names_who_has_stopped_since(broker: Broker, arm: DevicePeer) -> None:
    async with broker.connect("alice") as alice, broker.connect("bob") as bob:
        first = (await alice.stop(ARM)).channels[0].number
        second = (await bob.stop(ARM, reason="a hand is in it", within=0.5)).channels[0].number
        assert second > first
        report = await alice.unstop(ARM, first)
        (newer,) = report.channels[0].newer
        assert (newer.number, newer.by, newer.reason, newer.stopped) == (second, bob.name, "a hand is in it", True)
        assert report.unobeyed == report.channels and arm.is_stopped
        # By a message, too, where the number stands in a slot.
        channel = await alice.channel(ARM)
        with pytest.raises(mom.RefusedError, match="newer-stop"):
            await channel.send_acknowledged("unstop", stop=first)
        with pytest.raises(mom.RefusedError, match="bad-slot"):
            await channel.send_acknowledged("unstop")
        await channel.send_acknowledged("unstop", stop=second)
        await eventually(lambda: not arm.is_stopped)


async def test_a_stop_of_its_own_is_in_the_books_of_the_hub(broker: Broker, arm: DevicePeer) -> None:
    async with broker.connect("bob") as bob:
        await arm.channel.thin(newest=True)
        assert [(member.peer, member.device) for member in await bob.members(ARM)] == [(arm._core.peer, True)]
        arm.stop_itself("bumper")

        async def stopped() -> mom.StopState:
            while not (books := await bob.stops(ARM)).stopped:
                pass
            return books

        books = await asyncio.wait_for(stopped(), PATIENCE)
        assert (books.only, books.reason) == ([arm._core.peer], "stopped by itself: bumper")
        await eventually(lambda: (arm.may_move() or mom.Held("", "")).word == "stopped")
        await bob.unstop(ARM, books.number, only=[arm._core.peer])
        assert not arm.is_stopped


async def test_who_is_stopped_while_away_comes_back_stopped(broker: Broker) -> None:
    async with broker.connect("alice") as alice:
        async with broker.connect("arm") as client:
            await client.obey(ARM, Arm())
        (told,) = (await alice.stop(ARM, reason="away", within=0.1)).channels
        assert told.devices == [] and not told.is_obeyed, "nobody has said that it stands"
        async with broker.connect("arm") as client:
            device = await client.obey(ARM, arm := Arm())
            await eventually(lambda: device.is_stopped)
            held = device.may_move()
            assert arm.halts and held is not None and held.text == f"stopped by {alice.name}: away"
            await alice.unstop(ARM, told.number)
            assert device.may_move() is None


def test_a_report_is_read_whatever_the_hub_says() -> None:
    report = StopReport.of(
        {
            "channels": [
                {"path": "/a", "number": 3, "devices": [{"peer": "x", "word": "lost"}, {"peer": "y"}], "kept": True},
                {"path": "/b", "number": 4, "devices": [{"peer": "z", "word": "stopped"}], "error": "the disk is full"},
                {"path": "/c", "number": 5, "newer": [{"number": 6, "device": "w", "by": "bob"}], "devices": [7]},
                {"path": "/d", "number": 5, "guard": True},
                {"path": "/e"},
                "no map",
            ],
            "others": True,
            "denied": ["/f", 3],
        }
    )
    assert [channel.path for channel in report.unobeyed] == ["/a", "/b", "/c", "/d"]
    assert [device.word for device in report.channels[0].devices] == ["lost", "silent"]
    assert report.channels[2].newer == [mom.StopState(6, True, "bob", only=["w"])]
    assert (report.others, report.denied, report.is_obeyed) == (0, ["/f"], False)
    assert StopReport.of({}).is_obeyed and not StopReport.of({"denied": ["/f"]}).is_obeyed
    assert mom.StopState.of("nothing") == mom.StopState() == mom.StopState.of({"since": 3, "by": ""})


async def test_a_request_to_stop_is_sent_again_after_a_loss_and_what_lets_go_is_not() -> None:
    hub = await FakeHub().start()
    hub.replies["stop"] = hub.replies["unstop"] = {"channels": [], "others": 0, "denied": []}
    async with mom.connect(hub.address, guest=True, reconnect=mom.Reconnect(first=0.005, most=0.05)) as alice:
        hub.silent = True
        asked = [
            asyncio.ensure_future(alice.stop("/robot", reason="smoke")),
            asyncio.ensure_future(alice.unstop("/robot", {ARM: 2})),
        ]
        await eventually(lambda: [parcel.name for parcel in hub.heard] == ["stop", "unstop"])
        # As if it had read neither.
        hub.lag, hub.silent = 2, False
        hub.cut()
        await state(alice, "resuming")
        with pytest.raises(mom.LostError) as lost:
            await alice.unstop(ARM, 3)
        assert lost.value.code == "lost"
        assert await asked[0] == mom.StopReport([], 0, [])
        with pytest.raises(mom.LostError) as unknown:
            await asked[1]
        assert unknown.value.code == "unknown"
        stops = [parcel for parcel in hub.heard if parcel.name in ("stop", "unstop")]
        assert [(parcel.family, parcel.name, parcel.content) for parcel in stops] == [
            ("context", "stop", {"reason": "smoke"})
        ]
        assert (await alice.unstop(ARM, 3, only=["x"], within=0.25)).is_obeyed
        assert hub.heard[-1].content == {"stop": 3, "only": ["x"], "within": 250}
    await hub.stop()
