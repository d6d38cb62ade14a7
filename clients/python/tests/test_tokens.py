"""Tokens against a real broker: owning, losing, waiting, handing over, fences."""

from __future__ import annotations

import asyncio
from typing import List

import pytest
from conftest import PATIENCE, Broker, Cutter, heard, state

import mom

TOKEN, ARM = "/robot/token", "/robot/arm"


async def test_one_drives_and_others_are_told_who(broker: Broker) -> None:
    async with broker.connect("alice") as alice, broker.connect("bob") as bob:
        arm, token = await alice.channel(ARM), await alice.token(TOKEN)
        watching, events = await bob.channel(ARM), (await bob.token(TOKEN)).events()
        async with token.grab() as guard:
            assert guard.lease == 180 and guard.path == TOKEN and guard.loan is None
            grabbed = await heard(events, mom.Grabbed)
            assert (grabbed.owner, grabbed.fence, grabbed.lease) == (alice.name, guard.fence, 180)
            with pytest.raises(mom.RefusedError) as caught:
                await (await bob.token(TOKEN)).grab()
            error = caught.value
            assert (error.code, error.number) == ("held", 101) and error.rule and error.retry_after
            assert (error.wire.owner, error.wire.owner_level, error.wire.may_retry) == (alice.name, 1, True)
            commands = watching.events()
            assert (await arm.send_acknowledged("command", "grip open", fence=guard.fence)).delivered == 2
            command = (await heard(commands, mom.Message)).parcel
            watching.gate.check(command)
            command.fence = guard.fence - 1
            with pytest.raises(mom.StaleError):
                watching.gate.check(command)
            assert not guard.is_lost
            async with token.grab() as same:
                assert same.fence == guard.fence
            assert not guard.is_lost, "the last guard releases it"
        assert guard.is_lost and (await guard.lost()).reason == "released"
        released = await heard(events, mom.Released)
        assert (released.owner, released.reason, released.fence) == (alice.name, "released", guard.fence)
        halt = (await heard(commands, mom.Message)).parcel
        assert (halt.name, halt.sender) == ("halt", "hub")
        watching.gate.check(halt)
        command.fence = guard.fence
        with pytest.raises(mom.StaleError):
            watching.gate.check(command)


async def test_a_release_may_wait_until_the_last_command_is_carried_out(broker: Broker) -> None:
    async with broker.connect("alice") as alice, broker.connect("arm") as robot:
        arm, token, device = await alice.channel(ARM), await alice.token(TOKEN), await robot.channel(ARM)
        events = device.events()

        async def commands(count: int) -> List[mom.Parcel]:
            for number in range(count):
                await arm.send("command", number)
            found: List[mom.Parcel] = []
            while len(found) < count:
                parcel = (await heard(events, mom.Message)).parcel
                found += [parcel] if parcel.name == "command" else []
            return found

        guard = await token.grab()
        first, last = await commands(2)
        releasing = asyncio.ensure_future(guard.release(after="done"))
        words = [(first, alice.name, "finished"), (last, "bob", "finished"), (last, alice.name, "executing")]
        for parcel, peer, word in words:
            await device.send_acknowledged("status", {"peer": peer, "id": parcel.id, "state": word})
        assert (await alice.info(TOKEN))["owner"] == alice.name and not releasing.done()
        await device.send("status", {"peer": alice.name, "id": last.id, "state": "error"})
        await releasing
        assert (await alice.info(TOKEN)).get("owner") is None

        guard = await token.grab()
        await commands(1)
        with pytest.raises(mom.TimedOutError):
            await guard.release(after="done", within=0.01)
        assert (await alice.info(TOKEN)).get("owner") is None


async def test_a_higher_level_takes_it(broker: Broker) -> None:
    async with broker.connect("alice") as alice, broker.connect("carol") as carol:
        guard = await (await alice.token(TOKEN)).grab()
        async with (await carol.token(TOKEN)).grab():
            lost = await asyncio.wait_for(guard.lost(), PATIENCE)
            assert (lost.reason, lost.by) == ("preempted", carol.name)
        await guard.release()


async def test_waiting_in_the_queue(broker: Broker) -> None:
    async with broker.connect("alice") as alice, broker.connect("bob") as bob:
        guard = await (await alice.token(TOKEN)).grab()
        token = await bob.token(TOKEN)
        events = token.events()
        waiting = asyncio.ensure_future(token.grab(wait=mom.UNLIMITED)._run())
        assert (await heard(events, mom.Queued)).place == 1
        waiting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await waiting
        while (await alice.info(TOKEN)).get("queue"):
            pass
        waiting = asyncio.ensure_future(token.grab(wait=60)._run())
        await heard(events, mom.Queued)
        await guard.release()
        async with await asyncio.wait_for(waiting, PATIENCE) as mine:
            assert mine.fence > guard.fence
            with pytest.raises(mom.RefusedError) as caught:
                await (await alice.token(TOKEN)).grab(wait=0.05)
            assert caught.value.code == "timed-out"


async def test_giving_for_a_while_and_back(broker: Broker) -> None:
    async with broker.connect("alice") as alice, broker.connect("bob") as bob:
        guard = await (await alice.token(TOKEN)).grab()
        token, arm = await bob.token(TOKEN), await bob.channel(ARM)
        events = token.events()
        given = await guard.give(bob.name, commands=1)
        offer = await heard(events, mom.Offer)
        assert (offer.by, offer.to, offer.commands) == (alice.name, bob.name, 1)
        borrowed = await token.accept()
        assert await asyncio.wait_for(given.outcome(), PATIENCE) == "taken"
        assert borrowed.loan == mom.Loan(alice.name, None, 1)
        assert (await guard.lost()).reason == "given"
        await arm.send_acknowledged("command", "grip open", fence=borrowed.fence)
        back = await asyncio.wait_for(given.back(), PATIENCE)
        assert back is not None and back.fence > borrowed.fence and (await borrowed.lost()).reason == "returned"
        declined = await back.give(bob.name, within=5)
        await heard(events, mom.Offer)
        await token.decline()
        assert await asyncio.wait_for(declined.outcome(), PATIENCE) == "declined" and not back.is_lost
        forever = await back.give(bob.name)
        await heard(events, mom.Offer)
        async with token.accept():
            assert await forever.outcome() == "taken" and await forever.back() is None
        with pytest.raises(mom.RefusedError):
            await back.give("nobody")


async def test_who_has_lent_it_is_told_where_it_does_not_come_back(broker: Broker) -> None:
    async with broker.connect("alice") as alice, broker.connect("bob") as bob, broker.connect("carol") as carol:
        hers, his, boss = await alice.token(TOKEN), await bob.token(TOKEN), await carol.token(TOKEN)
        events = his.events()

        async def lend() -> mom.Given:
            given = await (await hers.grab()).give(bob.name, time=60)
            await heard(events, mom.Offer)
            await his.accept()
            return given

        given = await lend()
        async with boss.grab():
            assert await asyncio.wait_for(given.back(), PATIENCE) is None, "preempted"
        given = await lend()
        await boss.break_hold()
        assert await asyncio.wait_for(given.back(), PATIENCE) is None, "broken"
        given = await lend()
        await carol.expel(TOKEN, alice.name, time=0.001)
        assert await asyncio.wait_for(given.back(), PATIENCE) is None, "put out of it"


async def test_asking_the_owner(broker: Broker) -> None:
    async with broker.connect("alice") as alice, broker.connect("bob") as bob:
        mine, theirs = await alice.token(TOKEN), await bob.token(TOKEN)
        events, guard = mine.events(), await mine.grab()
        asking = asyncio.ensure_future(theirs.request("my turn", within=20)._run())
        requested = await heard(events, mom.Requested)
        assert (requested.member.peer, requested.text) == (bob.name, "my turn")
        await mine.decline_request(bob.name, "later")
        with pytest.raises(mom.RefusedError) as caught:
            await asking
        assert caught.value.code == "declined"
        asking = asyncio.ensure_future(theirs.request()._run())
        await heard(events, mom.Requested)
        await mine.accept_request(bob.name)
        async with await asking:
            assert (await guard.lost()).reason == "given"


async def test_shared_holds_and_breaking(broker: Broker) -> None:
    async with broker.connect("carol") as carol, broker.connect("carol") as other:
        token = await carol.token(TOKEN)
        events = (await other.token(TOKEN)).events()
        async with await token.inhibit() as held:
            assert (await heard(events, mom.Inhibited)).holders == [carol.name]
            with pytest.raises(mom.RefusedError) as caught:
                await (await other.token(TOKEN)).grab()
            assert caught.value.code == "held" and caught.value.wire.holders == [carol.name]
        assert held.is_lost and (await heard(events, mom.Uninhibited)).peer == carol.name
        guard = await token.grab()
        assert await (await other.token(TOKEN)).break_hold() == [carol.name]
        assert (await asyncio.wait_for(guard.lost(), PATIENCE)).reason == "broken"


async def test_it_renews_by_itself(broker: Broker) -> None:
    async with broker.connect("carol") as carol, broker.connect("bob") as bob:
        await carol.create("/key", {"kind": "token", "lease": 300, "deadman": 300, "manager": "open", "transient": True})
        try:
            guard = await (await carol.token("/key")).grab()
            assert guard.deadman == 0.3
            token = await bob.token("/key")
            waiting = asyncio.ensure_future(token.grab(wait=mom.UNLIMITED)._run())
            await asyncio.wait([waiting], timeout=1)
            assert not guard.is_lost or waiting.done()
            waiting.cancel()
            await asyncio.wait([waiting])
        finally:
            await carol.delete("/key")
        assert (await asyncio.wait_for(guard.lost(), PATIENCE)).reason in ("deleted", "expired")


async def test_a_lost_connection_loses_it(broker: Broker, cutter: Cutter) -> None:
    """With a hub that gives no link, or a client that asks for none."""
    address = f"bin://127.0.0.1:{cutter.port}"
    async with mom.connect(address, user="alice", password="alice", link=False) as alice:
        token = await alice.token(TOKEN)
        events, guard = token.events(), await token.grab()
        cutter.cut()
        assert (await asyncio.wait_for(guard.lost(), PATIENCE)).reason == "disconnected"
        await heard(events, mom.LinkDown)
        await heard(events, mom.Rejoined)
        assert (await state(alice, "connected")).door == address
        async with token.grab() as again:
            assert again.fence > guard.fence
