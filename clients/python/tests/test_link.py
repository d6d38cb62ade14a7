"""The link: what is counted, kept, sent again, and what is not. Against a hub of the tests' own."""

from __future__ import annotations

import asyncio
import random
from typing import Any, AsyncIterator, Callable, List

import pytest
import pytest_asyncio
from conftest import PATIENCE, heard, state
from fake_hub import FakeHub

import mom
from mom.parcel import Parcel

QUICK = mom.Reconnect(first=0.005, most=0.02)
GUARD = {"guard": {"token": "/t", "names": ["command"], "fence": 7, "owner": "alice"}, "kind": "channel"}


@pytest_asyncio.fixture
async def hub() -> AsyncIterator[FakeHub]:
    hub = await FakeHub().start()
    hub.replies = {"join": GUARD, "grab": {"fence": 7, "lease": 60_000}, "renew": {"fence": 7, "lease": 60_000}}
    yield hub
    await hub.stop()


def connect(hub: FakeHub, **options: Any) -> mom.Connect:
    return mom.connect(hub.address, user="alice", password="alice", **{"reconnect": QUICK, **options})


async def until(condition: Callable[[], Any]) -> None:
    async def wait() -> None:
        while not condition():
            await asyncio.sleep(0.002)  # tidy: looks again until it is so

    await asyncio.wait_for(wait(), PATIENCE)


def contents(parcels: List[Parcel]) -> List[Any]:
    return [parcel.content for parcel in parcels if parcel.family == "message"]


async def test_what_was_said_arrives_once_and_in_order_over_a_hundred_lost_connections(hub: FakeHub) -> None:
    random.seed(1)
    async with connect(hub) as client:
        channel = await client.channel("/c")
        answers = []
        for number in range(2000):
            await channel.send("say", number)
            if number % 20 == 10:
                hub.cut_after = random.randrange(1, 3000)
                answers.append(asyncio.ensure_future(channel.send_acknowledged("ask", number + 0.5)))
                await asyncio.sleep(0)  # tidy: lets the other begin
            if number % 20 == 0:
                before = len(hub.resumes)
                hub.cut()
                await until(lambda: len(hub.resumes) > before)
        hub.cut_after = None
        receipts = await asyncio.wait_for(asyncio.gather(*answers), PATIENCE)
        assert receipts == [mom.Receipt(1, [])] * 100
        await until(lambda: len(contents(hub.heard)) == 2100)
        assert contents(hub.heard) == sorted(contents(hub.heard)), "in order, none lost, none twice"
        assert len(hub.logins) == 1 and len(hub.resumes) >= 100


async def test_large_parcels_are_begun_again_as_a_whole(hub: FakeHub) -> None:
    async with connect(hub) as client:
        channel = await client.channel("/c")
        hub.cut_after = 200_000
        images = [bytes([number]) * 150_000 for number in range(20)]
        for image in images:
            await channel.send("image", image)
        await until(lambda: len(contents(hub.heard)) == 20)
        assert contents(hub.heard) == images and len(hub.resumes) > 5


async def test_what_the_hub_says_is_heard_once(hub: FakeHub) -> None:
    async with connect(hub) as client:
        events = (await client.channel("/c")).events()
        for number in range(300):
            hub.say(Parcel("message", "say", "/c", number, sender="bob"))
            if number % 25 == 0:
                await asyncio.sleep(0)  # tidy: lets the other begin
                hub.cut()
                await until(lambda: client.state.word == "connected" and not hub.writer.transport.is_closing())
        taken = [(await heard(events, mom.Message)).content for _ in range(300)]
        assert taken == list(range(300)) and events.try_next() is None
        assert len(hub.logins) == 1 and len(hub.resumes) > 5


async def test_what_was_read_is_said_in_time(hub: FakeHub) -> None:
    async with connect(hub) as client:
        channel = await client.channel("/c")
        before = hub.sent
        for number in range(256):
            hub.say(Parcel("message", "say", "/c", number, sender="bob"))
        await until(lambda: hub.acks and hub.acks[-1] >= before + 255)
        hub.say(Parcel("message", "say", "/c", bytes(70_000), sender="bob"))
        await until(lambda: hub.acks[-1] >= before + 257)
        hub.say(Parcel("message", "say", "/c", 1, sender="bob"))
        hub.raw(Parcel("time", "ping", id=0, content={}))
        await until(lambda: hub.acks[-1] == hub.sent)
        assert hub.marks[hub.marks.index("pong") - 1] == "ack"
        hub.raw(Parcel("time", "ack", content={"read": hub.read}))
        await channel.send_acknowledged("say")
        assert len(client._core.link._kept) <= 1, "what was acknowledged is forgotten"


async def test_what_was_not_read_is_sent_again_before_all_that_is_new(hub: FakeHub) -> None:
    """Reliable messages and requests are; of others the place in the count is given up, and the sender is told."""
    async with connect(hub) as client:
        channel = await client.channel("/c")
        events = channel.events()
        for name, options in [
            ("one", {}),
            ("seen", {"delivery": "latest"}),
            ("command", {}),
            ("gone", {"delivery": "fleeting"}),
            ("two", {}),
        ]:
            await channel.send(name, name, **options)
        await until(lambda: contents(hub.heard)[-1:] == ["two"])
        hub.lag = 5
        hub.resumable, port = True, hub.port
        hub._server.close()
        hub.cut()
        await state(client, "resuming")
        # Said while the connection is lost: what is for the moment is dropped, too.
        await channel.send("command", "late")
        await channel.send("late", "latest", delivery="latest")
        with pytest.raises(mom.RefusedError) as caught:
            await channel.send_acknowledged("command", "late")
        assert caught.value.code == "older-fence"
        await channel.send("three", "three")
        hub.port, hub.marks = port, []
        await hub.start()
        await until(lambda: contents(hub.heard)[-1:] == ["three"])
        assert contents(hub.heard) == ["one", "two", "three"]
        said = [name for name in hub.marks if name in ("one", "two", "resent", "three")]
        assert said == ["one", "two", "resent", "three"]
        hub.lag = 0
        told = []
        while len(told) < 5:
            told.append(await heard(events, mom.Dropped))
        assert sorted((event.parcel.name, event.reason) for event in told) == [
            ("command", "older-fence"),
            ("command", "older-fence"),
            ("gone", "disconnected"),
            ("late", "disconnected"),
            ("seen", "disconnected"),
        ]
        assert client._core.link.sent == hub.read


async def test_tokens_and_waiting_requests_outlive_a_connection(hub: FakeHub) -> None:
    async with connect(hub) as client:
        hub.replies["join"] = {"kind": "token"}
        token = await client.token("/t")
        guard, events, others = await token.grab(), token.events(), client.unaddressed()
        hub.silent, hub.forgotten = True, 3
        waiting = asyncio.ensure_future(client.info("/t"))
        await until(lambda: hub.heard[-1].name == "info")
        hub.cut()
        await until(lambda: hub.resumes)
        assert not guard.is_lost and not waiting.done()
        assert (await heard(others, mom.Dropped)).count == 3
        hub.silent = False
        hub.say(Parcel("reply", "ok", "/t", {"fence": 7}, reference=hub.heard[-1].id))
        assert (await asyncio.wait_for(waiting, PATIENCE))["fence"] == 7
        said = events.try_next()
        assert said is None or isinstance(said, mom.StateChanged)


async def test_a_link_that_is_not_resumed_is_a_new_login_on_that_connection(hub: FakeHub) -> None:
    async with connect(hub) as client:
        channel = await client.channel("/c")
        hub.replies["join"] = {"kind": "token"}
        guard = await (await client.token("/t")).grab()
        hub.replies["join"], events = GUARD, channel.events()
        hub.resumable = False
        hub.silent = True
        waiting = asyncio.ensure_future(client.info("/c"))
        await until(lambda: hub.heard[-1].name == "info")
        hub.silent, hub.marks = False, []
        hub.cut()
        await heard(events, mom.LinkDown)
        await heard(events, mom.Rejoined)
        with pytest.raises(mom.ConnectionDownError):
            await waiting
        assert (await guard.lost()).reason == "disconnected"
        said = [name for name in hub.marks if name not in ("ping", "ack")]
        assert said[:4] == ["resume", "login", "join", "join"]
        assert (await channel.send_acknowledged("say")).delivered == 1
        assert [parcel.context for parcel in hub.heard if parcel.name == "join"][-2:] == ["/c", "/t"]


async def test_after_the_grace_time_all_is_lost(hub: FakeHub) -> None:
    hub.grace = 100
    async with connect(hub, grace=0.1) as client:
        assert hub.logins[0]["link"] == {"grace": 100}
        hub.replies["join"] = {"kind": "token"}
        guard, port = await (await client.token("/t")).grab(), hub.port
        await hub.stop()
        lost = await asyncio.wait_for(guard.lost(), PATIENCE)
        assert lost.reason == "disconnected" and client.state.word in ("trying", "resuming")
        hub.port = port
        await hub.start()
        await state(client, "connected")
        assert not hub.resumes and len(hub.logins) == 2


@pytest.mark.parametrize("code, number, back", [("shutdown", 300, True), ("revoked", 406, False), ("taken-over", 409, False)])
async def test_a_code_that_closes_ends_the_link(hub: FakeHub, code: str, number: int, back: bool) -> None:
    client = await connect(hub)
    hub.raw(Parcel("error", code, "/", {"code": number, "text": "said why"}))
    hub.writer.write_eof()
    if back:
        await until(lambda: len(hub.logins) == 2)
    else:
        closed = await state(client, "closed")
        assert closed.error and (closed.error.code, closed.error.number) == (code, number)
        with pytest.raises(mom.ClosedError, match="said why"):
            await client.list()
    assert not hub.resumes
    await client.close()


async def test_counts_that_cannot_be_end_the_link(hub: FakeHub) -> None:
    async with connect(hub):
        hub.raw(Parcel("time", "ack", content={"read": 10_000}))
        await until(lambda: len(hub.logins) == 2)
        assert not hub.resumes


async def test_signs_of_life_and_a_silent_hub(hub: FakeHub) -> None:
    """A half-open connection is noticed: stale first, then lost, then resumed."""
    hub.limits = {"heartbeat": 100, "gone": 300}
    words: List[str] = []
    async with connect(hub, heartbeat=0.1, on_state=lambda state: words.append(state.word)) as client:
        assert hub.logins[0]["heartbeat"] == 100
        await until(lambda: hub.marks.count("ping") >= 8)
        assert words == ["trying", "connected"]
        hub.silent = True
        await until(lambda: hub.resumes)
        hub.silent = False
        await state(client, "connected")
        assert words[:5] == ["trying", "connected", "stale", "resuming", "connected"]


async def test_a_hub_without_links(hub: FakeHub) -> None:
    hub.gives_link = False
    async with connect(hub) as client:
        channel = await client.channel("/c")
        events = channel.events()
        hub.cut()
        await heard(events, mom.LinkDown)
        await heard(events, mom.Rejoined)
        assert len(hub.logins) == 2 and (await channel.send_acknowledged("say")).delivered == 1


async def test_a_parcel_that_cannot_be_read_is_told_and_counted(hub: FakeHub) -> None:
    async with connect(hub) as client:
        events = (await client.channel("/c")).events()
        before = client._core.link.read
        parcel = Parcel("message", "say", "/c", {"a": 1}, sender="bob")
        hub.sent += 1
        from mom.binary import encode, frame

        hub.writer.write(frame(encode(parcel)[:-1]))
        dropped = await heard(events, mom.Dropped)
        assert dropped.reason == "bad-content" and client._core.link.read == before + 1
