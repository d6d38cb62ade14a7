"""The link: what is counted, kept, sent again, and what is not. Against a hub of the tests' own."""

from __future__ import annotations

import asyncio
import random
from typing import Any, AsyncIterator, Callable, Dict, List

import pytest
import pytest_asyncio
from conftest import PATIENCE, heard, state
from fake_hub import FakeHub

import mom
from mom.entry import Entry
from mom.link import Link
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


async def away(hub: FakeHub, client: mom.Client) -> int:
    """Ends the connection, and takes no other; gives the port for `back`."""
    port = hub.port
    assert hub._server
    hub._server.close()
    hub.cut()
    await state(client, "resuming")
    hub.marks = []
    return port


async def back(hub: FakeHub, client: mom.Client, port: int) -> None:
    hub.port, hub.silent = port, False
    await hub.start()
    await state(client, "connected")
    assert client._core.is_up
    hub.lag = 0


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


@pytest.mark.parametrize("direction", ["up", "down"])
async def test_a_connection_may_be_lost_at_every_byte_of_a_resume(hub: FakeHub, direction: str) -> None:
    hasty = mom.Reconnect(first=0.001, most=0.002)
    async with connect(hub, reconnect=hasty) as client:
        channel = await client.channel("/c")
        for byte in range(1, 360):
            hub.cut_after, hub.left = (byte, None) if direction == "up" else (None, byte)
            hub.cut()
            assert await asyncio.wait_for(channel.send_acknowledged("ask", byte), PATIENCE) == mom.Receipt(1, [])
            hub.cut_after = hub.left = None
        assert contents(hub.heard) == list(range(1, 360)) and len(hub.logins) == 1


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
        port = await away(hub, client)
        # Said while the connection is lost: what is for the moment is dropped.
        await channel.send("command", "late")
        with pytest.raises(mom.LostError) as caught:
            await channel.send_acknowledged("command", "late")
        assert caught.value.code == "lost"
        await channel.send("late", "older", delivery="latest")
        await channel.send("late", "late", delivery="latest")
        await channel.send("three", "three")
        await back(hub, client, port)
        await until(lambda: contents(hub.heard)[-1:] == ["three"])
        assert contents(hub.heard) == ["one", "two", "late", "three"]
        said = [name for name in hub.marks if name in ("one", "two", "resent", "late", "three")]
        assert said == ["one", "two", "resent", "late", "three"]
        told = []
        while len(told) < 5:
            told.append(await heard(events, mom.Dropped))
        assert sorted((event.parcel.name, event.reason) for event in told) == [
            ("command", "lost"),
            ("command", "unknown"),
            ("gone", "unknown"),
            ("late", "replaced"),
            ("seen", "unknown"),
        ]
        assert client._core.link.sent == hub.read


async def test_what_is_meant_for_the_moment_is_not_said_after_a_loss(hub: FakeHub) -> None:
    """What had left may have been heard, and what had not is lost; tasks that wait for an answer are told."""
    async with connect(hub) as client:
        channel = await client.channel("/c")
        hub.replies["join"] = {"kind": "token"}
        token = await client.token("/t")
        guard, events = await token.grab(), channel.events()

        def said() -> "List[asyncio.Future[Any]]":
            requests = [guard.give("bob"), token.inhibit(), token.accept_request("bob")]
            messages = [channel.send_acknowledged(name, name) for name in ("unstop", "command")]
            return [asyncio.ensure_future(one) for one in requests + messages]

        hub.silent, before = True, len(hub.heard)
        await channel.send("unstop", "nobody waits", to=["bob"])
        unread = said()
        await until(lambda: len(hub.heard) == before + 6)
        hub.lag = 6
        port = await away(hub, client)
        for one in said():
            with pytest.raises(mom.LostError, match="had not been sent") as caught:
                await asyncio.wait_for(one, PATIENCE)
            assert caught.value.code == "lost"
        await channel.send("unstop", "said meanwhile", to=["bob"])
        assert not [one for one in unread if one.done()], "nobody knows yet"
        await back(hub, client, port)
        for one in unread:
            with pytest.raises(mom.LostError, match="had been sent .* unknown") as caught:
                await asyncio.wait_for(one, PATIENCE)
            assert caught.value.code == "unknown" and "not sent" not in str(caught.value)
        told = [await heard(events, mom.Dropped) for _ in range(2)]
        assert [(event.reason, event.count, event.parcel.content) for event in told] == [
            ("lost", 1, "said meanwhile"),
            ("unknown", 1, "nobody waits"),
        ]
        await channel.send_acknowledged("say")
        assert [parcel.name for parcel in hub.heard[before:]] == ["say"]


async def test_a_stop_is_the_last_word_over_a_loss(hub: FakeHub) -> None:
    async with connect(hub) as client:
        channel, before = await client.channel("/c"), len(hub.heard)
        await channel.send("note", 1)
        await channel.send("unstop")
        await until(lambda: len(hub.heard) == before + 2)
        hub.lag = 2
        port = await away(hub, client)
        await channel.send("stop", "mine")
        await channel.send("stop", "bob's", to=["bob"])
        await back(hub, client, port)
        await channel.send_acknowledged("say")
        said = [name for name in hub.marks if name in ("note", "stop", "unstop", "resent", "say")]
        assert said == ["stop", "stop", "note", "resent", "say"]
        assert contents(hub.heard)[:2] == ["mine", "bob's"]


async def test_a_release_names_its_fence_and_so_outlives_a_loss(hub: FakeHub) -> None:
    async with connect(hub) as client:
        hub.replies["join"] = {"kind": "token"}
        token = await client.token("/t")
        guard = await token.grab()
        hub.silent, hub.lag = True, 1
        releasing = asyncio.ensure_future(guard.release())
        await until(lambda: hub.heard[-1].name == "release")
        assert hub.heard[-1].fence == 7
        port = await away(hub, client)
        await back(hub, client, port)
        await asyncio.wait_for(releasing, PATIENCE)
        assert (hub.heard[-1].name, hub.heard[-1].fence) == ("release", 7)
        guard = await token.grab()
        port = await away(hub, client)
        releasing = asyncio.ensure_future(guard.release())
        await asyncio.sleep(0)  # tidy: lets it be said
        await back(hub, client, port)
        await asyncio.wait_for(releasing, PATIENCE)
        said = [name for name in hub.marks if name in ("resent", "release")]
        assert said == ["resent", "release"]


async def test_a_grab_that_is_taken_back_during_a_loss_is_given_back(hub: FakeHub) -> None:
    """Its release without a fence is lost. The grab is not, and may be granted later."""
    async with connect(hub) as client:
        hub.replies["join"] = {"kind": "token"}
        token = await client.token("/t")
        hub.silent = True
        waiting = asyncio.ensure_future(token.grab(wait=60)._run())
        await until(lambda: hub.heard[-1].name == "grab")
        grab, port = hub.heard[-1], await away(hub, client)
        waiting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await waiting
        await back(hub, client, port)
        hub.say(Parcel("reply", "ok", "/t", {"fence": 9, "lease": 60_000}, reference=grab.id))
        await until(lambda: hub.heard[-1].name == "release")
        assert hub.heard[-1].fence == 9 and hub.heard[-1].context == "/t"
        assert [parcel.name for parcel in hub.heard].count("release") == 1


async def test_what_waits_for_room_at_a_loss_is_not_said_after_it(hub: FakeHub, monkeypatch: pytest.MonkeyPatch) -> None:
    async with connect(hub) as client:
        channel = await client.channel("/c")

        async def stuck(data: bytes) -> None:
            await asyncio.Event().wait()

        monkeypatch.setattr(client._driver._connection, "write", stuck)
        client._core.outbox.most = 1
        # This hub acknowledges nothing, which does not matter here.
        monkeypatch.setattr(client._core.outbox, "permits", lambda entry: True)
        for number in range(2):
            await channel.send("note", number)
            await asyncio.sleep(0)  # tidy: lets the first of them leave
        commanding = asyncio.ensure_future(channel.send_acknowledged("command"))
        noting = asyncio.ensure_future(channel.send_acknowledged("note", 2))
        await asyncio.sleep(0)  # tidy: lets both begin
        assert client._core.outbox._bytes and not commanding.done()
        for name in ("stop", "unstop"):
            await asyncio.wait_for(channel.send(name), PATIENCE)
        hub.cut()
        with pytest.raises(mom.LostError) as caught:
            await asyncio.wait_for(commanding, PATIENCE)
        assert caught.value.code == "lost"
        assert await asyncio.wait_for(noting, PATIENCE) == mom.Receipt(1, [])
        assert [parcel.name for parcel in hub.heard if parcel.family == "message"][0] == "stop"
        assert contents(hub.heard)[1:] == [0, 1, 2]


async def test_what_was_not_acknowledged_is_unknown_when_the_link_ends(hub: FakeHub) -> None:
    async with connect(hub) as client:
        channel = await client.channel("/c")
        events = channel.events()
        await channel.send_acknowledged("answered")
        hub.silent = True
        await channel.send("say", "under way")
        asking = asyncio.ensure_future(channel.send_acknowledged("ask"))
        await until(lambda: hub.heard[-1].name == "ask")
        hub.resumable, port = False, await away(hub, client)
        await channel.send("say", "waits")
        await back(hub, client, port)
        told = [await heard(events, (mom.Dropped, mom.LinkDown)) for _ in range(3)]
        assert [(event.reason, event.parcel.content) for event in told[:2]] == [("lost", "waits"), ("unknown", "under way")]
        assert told[2] == mom.LinkDown()
        with pytest.raises(mom.LostError) as caught:
            await asking
        assert caught.value.code == "unknown"


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


async def test_the_last_attempt_within_the_grace_time_resumes(hub: FakeHub, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the longest delays: six attempts from 0.1 to 4.5 s after the loss find nobody, at 5.5 s the hub is back."""
    hub.grace = 6000
    hub.replies["join"] = {"kind": "token"}
    monkeypatch.setattr("mom.states.random.uniform", lambda least, most: most)
    async with connect(hub, reconnect=mom.Reconnect()) as client:
        guard = await (await client.token("/t")).grab()
        port = await away(hub, client)
        await until(lambda: client.state.attempt == 6)
        assert client.state.word == "resuming"
        await back(hub, client, port)
        assert hub.resumes and len(hub.logins) == 1 and not guard.is_lost


async def test_a_token_is_asked_for_at_each_login_and_what_that_raises_is_told(
    hub: FakeHub, caplog: pytest.LogCaptureFixture
) -> None:
    broken, words, asked = KeyError("none today"), [], 0

    async def token() -> str:
        nonlocal asked
        asked += 1
        if asked in (1, 3):
            raise broken
        return f"token {asked}"

    def note(state: mom.LinkState) -> None:
        words.append(state.word)

    with pytest.raises(KeyError) as caught:
        await mom.connect(hub.address, token=token, reconnect=QUICK, on_state=note)
    assert caught.value is broken and words == ["trying", "closed"]
    hub.resumable = False
    async with mom.connect(hub.address, token=token, reconnect=QUICK, on_state=note) as client:
        hub.cut()
        await until(lambda: len(hub.logins) == 2 and client.state.word == "connected")
        assert "closed" not in words[2:] and "KeyError('none today')" in caplog.text
        await client.authenticate_again(token=lambda: "another")
        hub.cut()
        await until(lambda: len(hub.logins) == 3 and client.state.word == "connected")
    assert [content["token"] for content in hub.logins] == ["token 2", "token 4", "another"]
    assert [parcel.map()["token"] for parcel in hub.heard if parcel.is_("login", "login")] == ["another"]


async def test_a_link_ends_with_its_grace_though_an_attempt_hangs(hub: FakeHub, monkeypatch: pytest.MonkeyPatch) -> None:
    """One attempt that hangs takes 10 s."""
    hub.grace = 300
    async with connect(hub, grace=0.3) as client:
        hub.replies["join"] = {"kind": "token"}
        guard = await (await client.token("/t")).grab()
        monkeypatch.setattr(hub, "_enter", lambda parcel, content: False)
        hub.cut()
        assert (await asyncio.wait_for(guard.lost(), 9)).reason == "disconnected"
        monkeypatch.undo()
        hub.cut()
        await until(lambda: client.state.word == "connected")


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


@pytest.mark.parametrize("wrong", [{"read": 10_000}, {"read": 1, "checksum": 7}])
async def test_counts_that_cannot_be_end_the_link(hub: FakeHub, wrong: Dict[str, int]) -> None:
    async with connect(hub) as client:
        await client.channel("/c")
        hub.raw(Parcel("time", "ack", content=wrong))
        await until(lambda: len(hub.logins) == 2)
        assert not hub.resumes


@pytest.mark.parametrize("wrong", [{"read": 10_000}, {"read": 1, "checksum": 7}])
async def test_a_resume_by_counts_that_cannot_be_is_none(
    hub: FakeHub, wrong: Dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    async with connect(hub) as client:
        channel = await client.channel("/c")

        def resume(answer: Parcel, read: int) -> None:
            answer.content = {"resumed": True, "peer": "alice", "limits": hub.limits, **wrong}
            hub.raw(answer)

        monkeypatch.setattr(hub, "_resume", resume)
        hub.cut()
        await until(lambda: len(hub.logins) == 2 and client.state.word == "connected")
        assert await asyncio.wait_for(channel.send_acknowledged("say"), PATIENCE) == mom.Receipt(1, [])
        assert len(hub.resumes) == 1 and "checksum" not in hub.resumes[0], "only hubs from 1.3 on know it"


async def test_the_checksum_of_the_protocol() -> None:
    """The numbers are those of docs/PROTOCOL.md. A hub that says the right one is gone on with."""
    ids, checksums = [1, 2, (1 << 32) + 3], [2_166_136_261, 67_918_732, 3_983_810_698, 1_456_420_779]
    welcome = {"link": {"id": "a", "secret": b"s" * 32, "grace": 1000}, "protocol": {"major": 1, "minor": 3}}
    for read, checksum in enumerate(checksums):
        link = Link.of_reply(welcome)
        assert link is not None and link.checks
        for number in ids[:read]:
            link.count(Parcel("event", "joined", id=number))
        said = link.acknowledgement()
        assert said is None if read == 0 else said is not None and said.content == {"read": read, "checksum": checksum}
        for number in ids:
            link.wrote(Entry(Parcel("message", "say", "/c", id=number)))
        wrong = checksums[(read + 1) % 4]
        assert link.acknowledged({"read": read, "checksum": checksum})
        assert link.resumed({"read": read, "checksum": wrong}) is None
        assert link.resumed({"read": read}) is not None, "earlier hubs do not say it"
    other = Link.of_reply(welcome)
    assert other is not None
    other.count(Parcel("reply", "ok", reference=1))
    said = other.acknowledgement()
    assert said is not None and said.content == {"read": 1, "checksum": checksums[1]}


async def test_signs_of_life_and_a_silent_hub(hub: FakeHub) -> None:
    """A half-open connection is noticed: stale first, then lost, then resumed."""
    hub.limits = {"heartbeat": 300, "gone": 900}
    words: List[str] = []
    async with connect(hub, heartbeat=0.3, on_state=lambda state: words.append(state.word)) as client:
        assert hub.logins[0]["heartbeat"] == 300
        await until(lambda: hub.marks.count("ping") >= 8)
        assert words == ["trying", "connected"]
        hub.silent = True
        await until(lambda: hub.resumes)
        hub.silent = False
        await state(client, "connected")
        assert words[:5] == ["trying", "connected", "stale", "resuming", "connected"]


async def test_who_does_not_come_back_asks_for_no_link(hub: FakeHub) -> None:
    async with connect(hub, reconnect=None) as client:
        assert "link" not in hub.logins[0]
        hub.cut()
        assert (await state(client, "closed")).error


async def test_a_hub_without_links(hub: FakeHub) -> None:
    hub.gives_link = False
    async with connect(hub) as client:
        channel = await client.channel("/c")
        events = channel.events()
        hub.cut()
        await heard(events, mom.LinkDown)
        await heard(events, mom.Rejoined)
        assert len(hub.logins) == 2 and (await channel.send_acknowledged("say")).delivered == 1


async def test_a_hub_that_refuses_links_is_asked_once(hub: FakeHub) -> None:
    """Because it counts what it does not know as a failed login."""
    hub.knows_link = False
    async with connect(hub) as client:
        events = (await client.channel("/c")).events()
        hub.cut()
        await heard(events, mom.Rejoined)
    async with connect(hub):
        assert ["link" in content for content in hub.logins] == [True, False, False, False]


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
