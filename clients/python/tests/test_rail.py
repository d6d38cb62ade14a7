"""The cart of `examples/rail.py` at a broker: what it says of its commands, its owners and its stops."""

from __future__ import annotations

import asyncio
import runpy
from pathlib import Path
from typing import Any, AsyncIterator, Dict, List

import pytest_asyncio
from conftest import Broker, heard

import mom
from mom.device import DevicePeer

RAIL = Path(__file__).parents[1] / "examples/rail.py"
ARM, TOKEN = "/robot/arm", "/robot/token"


@pytest_asyncio.fixture
async def cart(broker: Broker) -> AsyncIterator[DevicePeer]:
    """The cart at the lab. What another test has stopped is let go."""
    made = runpy.run_path(str(RAIL))["Cart"]()
    async with broker.connect("arm", heartbeat=0.5) as client, broker.connect("alice") as alice:
        device = await client.obey(ARM, made)
        await alice.unstop(ARM, (await alice.stops(ARM)).number, within=0)
        yield device
        await device.leave()


async def until(events: mom.Events, name: str, **wanted: Any) -> Dict[str, Any]:
    """The next message of this name that says all of this."""
    while True:
        message = await heard(events, mom.Message)
        if message.name == name and all(message.content.get(key) == value for key, value in wanted.items()):
            return {**message.content, "of-parcel": message.parcel.id}


async def test_a_cart_drives_and_says_so(broker: Broker, cart: DevicePeer) -> None:
    async with broker.connect("alice") as alice:
        rail = await alice.channel(ARM)
        events = rail.events()
        async with (await alice.token(TOKEN)).grab() as guard:
            told: List[Any] = []
            await rail.send_acknowledged("command", "lamp 40; go 30; wait 20; go 0", id=7, fence=guard.fence)
            while not told or told[-1] != "finished":
                told.append((await until(events, "status", id=7))["state"])
            assert told == ["waiting", *["executing"] * 4, "finished"]
            rests = await until(events, "state", rest="measured", moving=False)
            assert abs(rests["x"]) < 5 and rests["lamp"] == 40 and rests["fence"] == guard.fence
            await rail.send_acknowledged("command", "by 20", id=8, fence=guard.fence, based_on=rests["of-parcel"])
            await until(events, "status", id=8, state="finished")
            await rail.send_acknowledged("command", "by 20", id=9, fence=guard.fence, based_on=rests["of-parcel"])
            assert (await until(events, "status", id=9))["error"]["name"] == "stale-state"
            await rail.send_acknowledged("command", "wait 1; by 2000", id=10, fence=guard.fence)
            error = (await until(events, "status", id=10))["error"]
            assert error["text"].startswith("statement 2: `by` takes way/mm: way is a number from -1000 to 1000 mm")
            for number, speed in enumerate((50, 80), 11):
                await rail.send_acknowledged("command", f"jog {speed}", id=number, fence=guard.fence)
            assert (await until(events, "status", id=11, state="finished"))["of"] == 1
            await until(events, "status", id=12, state="finished")


async def test_its_next_owner_finds_it_at_rest(broker: Broker, cart: DevicePeer) -> None:
    async with broker.connect("alice") as alice, broker.connect("bob") as bob:
        theirs = await bob.channel(ARM)
        events = theirs.events()
        async with (await alice.token(TOKEN)).grab() as guard:
            await (await alice.channel(ARM)).send_acknowledged("command", "go 1000; go 0", id=7, fence=guard.fence)
            await until(events, "status", id=7, state="executing")
        error = (await until(events, "status", id=7, state="error"))["error"]
        assert (error["name"], error["code"]) == ("halted", 5101)
        async with (await bob.token(TOKEN)).grab() as guard:
            await theirs.send_acknowledged("command", "go 0", id=8, fence=guard.fence)
            # It says before that it rests; a newer state may take the place of that one on the way.
            await until(events, "status", id=8, state="executing")
            report = await bob.stop(ARM, reason="enough")
            assert report.is_obeyed and report.channels[0].devices[0].rest == "measured"
            assert (await until(events, "status", id=8, state="error"))["error"]["name"] == "stopped"
            await bob.unstop(ARM, report.channels[0].number)
        await asyncio.sleep(0)  # tidy: lets the release be heard
