"""Lost connections against a real broker: what is resumed, through which door, and what is made safe."""

from __future__ import annotations

import asyncio
import random
from typing import Any, AsyncIterator, List

import pytest
import pytest_asyncio
from conftest import PATIENCE, Broker, Cutter, heard, state

import mom
from mom.address import Address

QUICK = mom.Reconnect(first=0.005, most=0.05)
TOKEN, ARM = "/robot/token", "/robot/arm"


@pytest_asyncio.fixture
async def alice(cutter: Cutter) -> AsyncIterator[mom.Client]:
    """Behind the cutter."""
    address = f"bin://127.0.0.1:{cutter.port}"
    async with mom.connect(address, user="alice", password="alice", reconnect=QUICK) as alice:
        assert alice._core.link is not None, "the hub gives a link"
        yield alice


async def lost_and_back(client: mom.Client, cutter: Cutter) -> None:
    """Cuts its connection and waits until there is another."""
    before = cutter.connections
    cutter.cut()
    while cutter.connections == before or client.state.word != "connected":
        await asyncio.sleep(0.002)  # tidy: looks again until it is so


@pytest.mark.parametrize("scheme, seed", [("bin", 1), ("bin", 2), ("ws", 3), ("bins", 4), ("http", 5)])
async def test_nothing_is_lost_and_nothing_comes_twice(broker: Broker, cutter: Cutter, scheme: str, seed: int) -> None:
    """Cut in both directions at any byte, while both talk."""
    random.seed(seed)
    # A tunnel goes on over other connections by itself, after pauses: it is cut less often.
    each = 100 if scheme == "http" else 20
    address = broker.address(scheme).replace(str(broker.port), str(cutter.port))

    def connect(user: str) -> mom.Connect:
        return mom.connect(address, user=user, password=user, reconnect=QUICK)

    async with connect("alice") as alice, connect("bob") as bob:
        mine, theirs = await alice.channel("/chat"), await bob.channel("/chat")
        heard_here, heard_there = mine.events(), theirs.events()
        downs: List[Any] = []
        guard, receipts = await (await alice.token(TOKEN)).grab(), []
        for number in range(600):
            await mine.send("a", number, echo=False)
            await theirs.send("b", number, echo=False)
            if number % 10 == 5:
                receipts.append(asyncio.ensure_future(mine.send_acknowledged("c", number, echo=False)))
                cutter.after = random.randrange(1, 9000) if number % each == 5 else None
                await asyncio.sleep(0)  # tidy: lets both go on
            if number % each == 0:
                await lost_and_back(alice, cutter)
        cutter.after = None

        async def taken(events: mom.Events, name: str) -> List[Any]:
            found: List[Any] = []
            while len(found) < 600:
                event = await asyncio.wait_for(events.next(), PATIENCE)
                downs.extend([event] if isinstance(event, (mom.LinkDown, mom.Lagged, mom.Refused)) else [])
                if isinstance(event, mom.Message) and event.name == name:
                    found.append(event.content)
            return found

        assert await taken(heard_there, "a") == list(range(600))
        assert await taken(heard_here, "b") == list(range(600))
        answers = await asyncio.wait_for(asyncio.gather(*receipts), PATIENCE)
        assert len(answers) == 60 and not downs and not guard.is_lost
        assert cutter.connections > 600 / each
        await guard.release()


async def test_members_hear_of_it(broker: Broker, cutter: Cutter, alice: mom.Client) -> None:
    async with broker.connect("bob") as bob:
        events = (await bob.channel("/chat")).events()
        await alice.channel("/chat")
        joined = await heard(events, mom.Joined)
        await lost_and_back(alice, cutter)
        lost = await heard(events, mom.PeerLost)
        assert lost.member == joined.member and 0 < lost.within <= 30
        assert (await heard(events, mom.PeerResumed)).member == joined.member
        await alice.close()
        assert (await heard(events, mom.Left)).member == joined.member


async def test_what_was_commanded_before_is_not_done_after(broker: Broker, cutter: Cutter, alice: mom.Client) -> None:
    """The robot is made safe at the loss. The token stays, and what is commanded anew passes."""
    async with broker.connect("arm") as device:
        channel = await device.channel(ARM, device=True)
        events, arm = channel.events(), await alice.channel(ARM)
        told, guard = arm.events(), await (await alice.token(TOKEN)).grab()
        await arm.send_acknowledged("command", "first", echo=False)
        cutter.hold()
        await arm.send("command", "under way", echo=False)
        cutter.refuses = True
        cutter.cut()
        cutter.let_go()
        await state(alice, "resuming")
        await arm.send("command", "said meanwhile", echo=False)
        cutter.refuses = False
        await state(alice, "connected")
        assert not guard.is_lost
        await arm.send_acknowledged("command", "anew", echo=False, fence=guard.fence)
        obeyed: List[Any] = []
        while "anew" not in obeyed:
            message = await heard(events, mom.Message)
            channel.gate.check(message.parcel)
            obeyed.append(message.content if message.name == "command" else message.name)
        assert obeyed == ["first", "halt", "anew"]
        dropped = [await heard(told, mom.Dropped) for _ in range(2)]
        assert [(event.reason, event.parcel.content) for event in dropped] == [
            ("lost", "said meanwhile"),
            ("unknown", "under way"),
        ]
        await guard.release()


async def test_a_token_that_is_released_during_a_loss_is_free_after_it(broker: Broker, cutter: Cutter, alice: mom.Client) -> None:
    guard = await (await alice.token(TOKEN)).grab()
    cutter.refuses = True
    cutter.cut()
    await state(alice, "resuming")
    releasing = asyncio.ensure_future(guard.release())
    await asyncio.sleep(0)  # tidy: lets it be said
    assert not releasing.done()
    cutter.refuses = False
    await asyncio.wait_for(releasing, PATIENCE)
    async with broker.connect("bob") as bob:
        async with (await bob.token(TOKEN)).grab() as theirs:
            assert theirs.fence > guard.fence


async def test_a_token_outlives_a_loss_with_much_under_way(broker: Broker, cutter: Cutter, alice: mom.Client) -> None:
    """16 MiB are said, and the hub's acknowledgements do not come: no more leave than both sides keep."""
    async with broker.connect("bob") as bob:
        mine, events = await alice.channel("/chat"), (await bob.channel("/chat")).events()
        guard = await (await alice.token(TOKEN)).grab()
        cutter.hold(up=False)
        before = cutter.up

        async def say() -> None:
            for number in range(256):
                await mine.send("part", number.to_bytes(1, "big") * (64 << 10), echo=False)

        told = asyncio.ensure_future(asyncio.wait_for(say(), PATIENCE))
        link, outbox = alice._core.link, alice._core.outbox
        assert link
        while cutter.up - before < 5 << 20:
            await asyncio.sleep(0.002)  # tidy: looks again until it is so
            head = outbox._next()
            if head is not None and not outbox.permits(head) and cutter.up - before > link.kept_bytes:
                break
        assert 3 << 20 < cutter.up - before < 5 << 20 and not told.done()
        # Neither a request nor a stop waits for that.
        asked, at = asyncio.ensure_future(alice.info("/chat")), cutter.up
        stopped = asyncio.ensure_future(alice.stop("/chat"))
        while link.unread[-1].parcel.name != "info" or all(entry.parcel.name != "stop" for entry in link.unread):
            await asyncio.sleep(0.002)  # tidy: looks again until it is so
        cutter.refuses = True
        cutter.cut()
        cutter.let_go()
        await state(alice, "resuming")
        cutter.refuses = False
        await told
        assert (await asked)["path"] == "/chat" and (await stopped).is_obeyed and cutter.up > at
        found: List[int] = []
        while len(found) < 256:
            message = await heard(events, mom.Message)
            found += [message.content[0]] if message.name == "part" else []
        assert found == list(range(256)) and not guard.is_lost
        await guard.release()


async def test_through_another_door(broker: Broker, cutter: Cutter, alice: mom.Client) -> None:
    chat = await alice.channel("/chat")
    name = alice.name
    for scheme in ("http", "ws", "bins", "bin"):
        alice._driver.options.address = Address.parse(broker.address(scheme))
        before = alice._driver._connection
        before.abort()
        await chat.send("say", scheme)
        while alice._driver._connection is before or alice.state.word != "connected":
            await asyncio.sleep(0.002)  # tidy: looks again until it is so
        assert alice.state.door.startswith(f"{scheme}:")
        assert (await chat.send_acknowledged("say", scheme)).delivered >= 1 and alice.name == name


async def test_a_half_open_connection_is_noticed(broker: Broker, cutter: Cutter) -> None:
    words: List[str] = []
    address = f"bin://127.0.0.1:{cutter.port}"
    async with mom.connect(
        address, user="alice", password="alice", heartbeat=0.2, reconnect=QUICK, on_state=lambda state: words.append(state.word)
    ) as client:
        assert client.welcome["limits"]["heartbeat"] == 200 and client.welcome["limits"]["gone"] == 600
        chat = await client.channel("/chat")
        cutter.hold()
        await state(client, "resuming")
        cutter.cut()
        cutter.let_go()
        await state(client, "connected")
        assert words[:4] == ["trying", "connected", "stale", "resuming"]
        assert (await chat.send_acknowledged("say")).delivered >= 1


async def test_after_a_restart_of_the_hub_all_begins_anew(own_broker: Broker) -> None:
    async with own_broker.connect("alice", reconnect=QUICK) as alice:
        chat, guard = await alice.channel("/chat"), await (await alice.token(TOKEN)).grab()
        events = chat.events()
        own_broker.stop()
        own_broker.start()
        await heard(events, mom.LinkDown)
        await heard(events, mom.Rejoined)
        assert (await guard.lost()).reason == "disconnected"
        assert (await chat.send_acknowledged("say")).delivered == 1
