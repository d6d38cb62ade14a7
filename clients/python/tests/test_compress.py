"""Connections that are compressed as a whole (M16), against a real broker."""

from __future__ import annotations

import zlib
from typing import Any, Dict, Tuple

import pytest
from conftest import Broker, Cutter, heard, state

import mom
from mom import binary
from mom.errors import LocalError

PROGRAM = "".join(f"MoveL [[{line},0.0,712.0],[0.7071,0,0.7071,0]], vslow, fine, gripper;\n" for line in range(4000))
DOORS = ["bin", "bins", "ws", "wss", "http", "https", "mom"]
QUICK = mom.Reconnect(first=0.005, most=0.02)


async def carried(asking: mom.Client, name: str) -> Tuple[int, int]:
    """How many bytes the hub has taken from a connection, and given to it."""
    stats: Dict[str, Any] = await asking.stats("/")
    # A tunnel that has ended is there for a second more.
    peer = [peer for peer in stats["peers"] if peer["peer"] == name][-1]
    return int(peer["received"]), int(peer["sent"])


async def said(events: mom.Events, name: str) -> mom.Message:
    """The next message of this name."""
    while True:
        message: mom.Message = await heard(events, mom.Message)
        if message.name == name:
            return message


@pytest.mark.parametrize("scheme", DOORS)
async def test_a_tenth_of_the_bytes_travels_both_ways(broker: Broker, scheme: str) -> None:
    async with broker.connect("carol") as carol, broker.connect("bob", scheme, compress=True) as bob:
        chat = await bob.channel("/chat")
        events = chat.events()
        before = await carried(carol, bob.name)
        await chat.send("program", PROGRAM)
        assert (await said(events, "program")).content == PROGRAM
        after = await carried(carol, bob.name)
        for was, now in zip(before, after):
            assert now - was < len(PROGRAM) / 8, (scheme, before, after)
        # Small ones follow at once: nothing waits in a compressor.
        await chat.send_acknowledged("note", "short")


async def test_who_does_not_ask_gets_it_plain(broker: Broker) -> None:
    async with broker.connect("carol") as carol, broker.connect("bob") as bob:
        chat = await bob.channel("/chat")
        before = await carried(carol, bob.name)
        await chat.send_acknowledged("program", PROGRAM)
        after = await carried(carol, bob.name)
        assert after[0] - before[0] > len(PROGRAM)


async def test_a_link_goes_on_compressed(broker: Broker) -> None:
    network = Cutter(broker.port)
    await network.start()
    address = f"bin://127.0.0.1:{network.port}"
    connecting = mom.connect(address, user="bob", password="bob", compress=True, reconnect=QUICK)
    async with broker.connect("carol") as carol, connecting as bob:
        ours, theirs = await bob.channel("/chat"), await carol.channel("/chat")
        at_bob, at_carol = ours.events(), theirs.events()
        for number in range(6):
            await theirs.send("from-carol", {"number": number, "text": PROGRAM})
            await ours.send("from-bob", {"number": number, "text": PROGRAM})
            network.cut()
        for events, name in ((at_bob, "from-carol"), (at_carol, "from-bob")):
            for number in range(6):
                message = await said(events, name)
                assert message.content == {"number": number, "text": PROGRAM}, (name, number)
        await state(bob, "connected")
        assert (await carried(carol, bob.name))[1] < len(PROGRAM)
    await network.close()


def frames(*bodies: bytes) -> bytes:
    return b"".join(len(body).to_bytes(4, "big") + body for body in bodies)


def test_a_stream_is_opened_wherever_it_is_cut_and_only_where_it_was_asked_for() -> None:
    ping = binary.encode(mom.Parcel("time", "ping"))
    packer = zlib.compressobj()
    packed = b"".join(packer.compress(frames(ping)) + packer.flush(zlib.Z_SYNC_FLUSH) for _ in range(5))
    whole = binary.PREFACE + frames(ping) + binary.STREAM_MARK + packed
    for size in (1, 2, 7, len(whole)):
        decoder = binary.Decoder()
        decoder.takes_stream = True
        parcels = [parcel for at in range(0, len(whole), size) for parcel, _ in decoder.feed(whole[at : at + size])]
        assert [parcel.name for parcel in parcels] == ["ping"] * 6, size
    with pytest.raises(LocalError, match="frame 2"):
        list(binary.Decoder().feed(whole))


def test_what_is_no_stream_ends_the_connection() -> None:
    for packed in (b"no zlib at all", zlib.compress(b"")):
        decoder = binary.Decoder()
        decoder.takes_stream = True
        with pytest.raises(LocalError) as error:
            list(decoder.feed(binary.PREFACE + binary.STREAM_MARK + packed))
        assert error.value.code == "bad-frame"


def test_a_bomb_is_opened_some_at_a_time() -> None:
    decoder = binary.Decoder(most=1 << 20)
    decoder.takes_stream = True
    bomb = zlib.compress(b"\0\1\0\0" * (16 << 20))
    with pytest.raises(LocalError):
        list(decoder.feed(binary.PREFACE + binary.STREAM_MARK + bomb))
    assert len(decoder._input) <= 2 << 20
