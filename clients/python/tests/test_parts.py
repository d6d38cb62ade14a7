"""Parts of the client that need no hub: addresses, doors, delays, clocks, gates, the queue."""

from __future__ import annotations

import asyncio
from typing import Any, Dict, List, Optional

import pytest

import mom
from mom.address import Address
from mom.clock import OffsetEstimator
from mom.connection import Connection
from mom.core import Core
from mom.entry import Entry
from mom.events import of_parcel
from mom.link import Link
from mom.login import Credentials
from mom.outbox import Outbox
from mom.parcel import Parcel
from mom.subscriptions import Subscribers
from mom.values import now

PIN = "4355a46b19d348dc2f57c046f8ef63d4538ebb936000f3c9ee954a27460dd865"


@pytest.mark.parametrize(
    "text, shown",
    [
        ("bin://lab", "bin://lab:7666"),
        ("bins://lab:1/robot/arm", "bins://lab:1/robot/arm"),
        ("mom://[::1]", "mom://[::1]:7666"),
        ("wss://lab", "wss://lab:443"),
        ("http://lab/", "http://lab:80"),
        ("https://lab:1?poll=1", "https://lab:1?poll=1"),
        (f"moms://lab?pin={PIN}", f"moms://lab:7666?pin=sha256:{PIN}"),
        (f"mom://lab?pin=sha256:{PIN.upper()}", f"moms://lab:7666?pin=sha256:{PIN}"),
    ],
)
def test_addresses(text: str, shown: str) -> None:
    assert str(Address.parse(text)) == shown


@pytest.mark.parametrize(
    "text, why",
    [
        ("", "begin with"),
        ("lab:7666", "begin with"),
        ("ftp://lab", "ftp://"),
        ("tcp://lab", "XML: bin://"),
        ("jsons://lab", "JSON: bins://"),
        ("bin://", "no host"),
        ("bin://:1", "no host"),
        ("bin://lab:", "port"),
        ("bin://lab:70000", "port"),
        ("bin://::1:7666", "brackets"),
        ("bin://[lab]:7666", "brackets"),
        ("bin://alice@lab", "not a host name"),
        ("bins://lab?pin=12", "64 hexadecimal digits"),
        ("bins://lab?name=12", "pin="),
        (f"bin://lab?pin={PIN}", "requires TLS"),
    ],
)
def test_what_is_no_address(text: str, why: str) -> None:
    with pytest.raises(mom.AddressError, match="is not the address of a hub") as caught:
        Address.parse(text)
    assert why in str(caught.value)


@pytest.mark.parametrize(
    "address, private",
    [("bin://localhost", 1), ("bin://127.9.9.9", 1), ("bin://[::1]", 1), ("bin://[::ffff:127.0.0.1]", 1), ("bins://lab", 1)]
    + [("bin://localhost.example.org", 0), ("bin://10.0.0.1", 0), ("ws://lab", 0), ("http://0.0.0.0", 0)],
)
def test_where_nobody_reads_along(address: str, private: int) -> None:
    assert Address.parse(address).is_private == bool(private)


@pytest.mark.parametrize(
    "address, secret, doors",
    [
        ("mom://lab", True, ["bins://lab:7666", "wss://lab:443", "https://lab:443"]),
        ("mom://lab", False, ["bins://lab:7666", "wss://lab:443", "https://lab:443", "bin://lab:7666", "ws://lab:80"]),
        ("moms://lab:9", False, ["bins://lab:9", "wss://lab:9", "https://lab:9"]),
        (
            "mom://127.0.0.1:9",
            True,
            [f"{scheme}://127.0.0.1:9" for scheme in ("bin", "ws", "http", "bins", "wss", "https")],
        ),
        ("bin://lab", False, ["bin://lab:7666"]),
    ],
)
def test_the_doors_that_a_login_permits(address: str, secret: bool, doors: List[str]) -> None:
    proof: Dict[str, Any] = {"user": "alice", "password": "x"} if secret else {"guest": True}
    assert [str(door) for door in Credentials(**proof).doors(Address.parse(address))] == doors


async def test_the_first_door_that_leads_to_a_hub_is_taken_and_remembered(
    unused_tcp_port_factory: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mom.driver import Driver, Options

    tried: List[str] = []
    opens = {"websocket"}

    async def to(door: Address, *_: Any) -> Any:
        tried.append(str(door).split(":")[0])
        if door.tls:
            await asyncio.sleep(60)  # tidy: a door that never opens
        if door.door not in opens:
            raise mom.ConnectionDownError("closed")
        return "a connection"

    monkeypatch.setattr(Connection, "to", to)
    address = Address.parse(f"mom://127.0.0.1:{unused_tcp_port_factory()}")
    options = Options(address, None, True, None, None, 10.0, None)
    driver = Driver.__new__(Driver)
    driver.options, driver.credentials = options, Credentials(guest=True)
    driver.core = type("Core", (), {"numbers": {}})()
    assert str((await driver._open())[1]).startswith("ws://") and tried == ["bin", "ws"]
    tried.clear()
    await driver._open()
    assert tried == ["ws"]
    # A tunnel that has worked does not come before what is better.
    opens = {"tunnel"}
    assert str((await driver._open())[1]).startswith("http://")
    tried.clear()
    opens = {"websocket", "tunnel"}
    assert str((await driver._open())[1]).startswith("ws://") and tried == ["bin", "ws"]


def test_delays_have_full_jitter() -> None:
    reconnect = mom.Reconnect()
    for attempt, most in [(0, 0.1), (1, 0.2), (5, 3.2), (50, 30.0)]:
        delays = [reconnect.delay(attempt) for _ in range(300)]
        assert 0 <= min(delays) < most / 4 and most * 3 / 4 < max(delays) <= most
    assert reconnect.delay(0, 9.0) == 9.0, "no less than the hub asked for"


@pytest.mark.parametrize("grace", [0.4, 2.0, 30.0, 600.0])
def test_several_attempts_fall_into_the_grace_time_and_the_last_just_before_its_end(grace: float) -> None:
    for reconnect in [mom.Reconnect(), mom.Reconnect(first=grace, most=10 * grace)]:
        at, delays = 0.0, []
        while (delay := reconnect.delay(len(delays), None, grace, grace - at)) < grace - at:
            at += delay
            delays.append(delay)
        assert len(delays) >= 4 and max(delays) <= grace / 4
        assert at >= grace - max(0.5, grace / 8)
    assert reconnect.delay(0, 2 * grace, grace, grace) == 2 * grace, "no less than the hub asked for"
    assert max(reconnect.delay(9) for _ in range(300)) > grace, "afterwards they are as always"


def test_the_offset_of_another_clock() -> None:
    hour, estimator = 3_600_000_000, OffsetEstimator()
    assert estimator.at(0) is None
    assert estimator.push(0, hour + 300, hour + 320, 420, 420)
    assert estimator.at(420) == (hour + 100, 202)
    assert estimator.push(1000, hour + 1150, hour + 1150, 1100, 1100), "a quicker one says more"
    assert (estimator.at(1100) or (0, 999))[1] < 100
    later = estimator.at(1_001_100)
    assert later is not None and later[1] >= 100, "drift widens it"
    assert not estimator.push(10, 5, 4, 20, 20), "a clock was set meanwhile"
    assert estimator.push(0, 300, 320, 420, 420) and len(estimator) == 1, "a contradiction counts alone"


def guard(owner: Optional[str], fence: int) -> Dict[str, Any]:
    return {"guard": {"token": "/t", "names": ["command"], "owner": owner, "fence": fence}}


def told(name: str, owner: str, fence: int, path: str = "/t") -> Parcel:
    return Parcel("event", name, path, {"owner": owner, "fence": fence})


def test_fences_never_fall() -> None:
    gate = mom.FenceGate()
    gate.check(Parcel("message", "command"))
    gate.joined(guard("ally", 7))
    for event, owner, fence in [
        (told("grabbed", "bob", 6), "ally", 7),
        (told("grabbed", "bob", 9, "/other"), "ally", 7),
        (told("grabbed", "bob", 9), "bob", 9),
        (told("released", "ally", 7), "bob", 9),
        (told("released", "bob", 9), None, 9),
    ]:
        gate.observe(event)
        assert gate.guard and (gate.guard.owner, gate.guard.fence) == (owner, fence)
    gate.joined(guard("ally", 5))
    assert gate.guard and (gate.guard.owner, gate.guard.fence) == (None, 9), "a hub with older fences"
    gate.joined(guard("ally", 10))
    gate.check(Parcel("message", "command", fence=10))
    gate.check(Parcel("message", "halt", sender="hub"))
    gate.check(Parcel("message", "state", fence=1))
    for parcel in (Parcel("message", "command"), Parcel("message", "command", fence=9)):
        with pytest.raises(mom.StaleError):
            gate.check(parcel)
    gate.forget_owner()
    with pytest.raises(mom.StaleError):
        gate.check(Parcel("message", "command", fence=10))


class Wire:
    """A connection of which the test says when it takes more."""

    def __init__(self) -> None:
        self.frames: "asyncio.Queue[bytes]" = asyncio.Queue(1)
        self.streams = 0

    async def write(self, data: bytes) -> None:
        await self.frames.put(data)

    def next_stream(self) -> int:
        self.streams += 1
        return self.streams


async def test_what_is_urgent_goes_between_the_pieces() -> None:
    dropped: List[str] = []
    outbox, wire, sent = Outbox(lambda entry, reason: dropped.append(f"{entry.parcel.name} {reason}")), Wire(), []
    outbox.put(Entry(Parcel("message", "image", "/c", bytes(100_000))))
    sending = asyncio.ensure_future(outbox.send_all(wire, lambda entry: sent.append(entry.parcel.name)))  # type: ignore
    await wire.frames.get()
    for parcel in [
        Parcel("message", "later", "/c"),
        Parcel("message", "urgent", "/c", priority=9),
        Parcel("context", "list", "/"),
        Parcel("message", "state", "/c", 1, delivery="latest"),
        Parcel("message", "state", "/c", 2, delivery="latest"),
        Parcel("time", "ping"),
        Parcel("message", "stop", "/c"),
        Parcel("message", "stop", "/c"),
        Parcel("login", "logout", "/"),
        Parcel("message", "never heard", "/c", priority=9),
    ]:
        outbox.put(Entry(parcel, parcel.delivery or "reliable"))
    for _ in range(13):
        await asyncio.wait_for(wire.frames.get(), 5)
    sending.cancel()
    assert sent[:8] == ["stop", "ping", "list", "urgent", "image", "later", "state", "logout"]
    assert dropped == ["state replaced"]


@pytest.mark.parametrize("pieces, kept", [(1, True), (7, False)])
async def test_what_was_passed_on_whole_counts_though_nobody_says_that_it_was_taken(pieces: int, kept: bool) -> None:
    outbox, wire, sent = Outbox(lambda entry, reason: None), Wire(), []
    image = Entry(Parcel("message", "image", "/c", bytes(100_000)))
    outbox.put(image)
    sending = asyncio.ensure_future(outbox.send_all(wire, sent.append))  # type: ignore
    for _ in range(pieces - 1):
        await asyncio.wait_for(wire.frames.get(), 5)
    await asyncio.wait([sending], timeout=0.05)
    sending.cancel()
    await asyncio.wait([sending])
    assert sent == ([] if kept else [image]) and (outbox._bytes > 0) is kept
    outbox.lose()
    assert not kept or image.pieces is None, "it begins anew"


async def test_the_queue_is_bounded() -> None:
    dropped: List[Any] = []
    outbox = Outbox(lambda entry, reason: dropped.append((entry.parcel.content[:1], reason)))
    assert (outbox.most, outbox.most_open) == (4 << 20, 8 << 20), "as docs/PROTOCOL.md has it, until the hub says its own"
    outbox.most = 1000
    large = Entry(Parcel("message", "image", "/c", bytes(5000)))
    await outbox.capacity(large)
    outbox.put(large)
    assert not outbox.has_capacity(Entry(Parcel("message", "a", "/c")))
    waiting = asyncio.ensure_future(outbox.capacity(Entry(Parcel("message", "a", "/c"))))
    await asyncio.sleep(0)  # tidy: lets the other begin
    assert not waiting.done()
    outbox.lose(everything=True)
    await asyncio.wait_for(waiting, 5)
    dropped.clear()
    for number in range(4):
        entry = Entry(Parcel("message", "frame", "/c", bytes([number]) * 300), "fleeting")
        await outbox.capacity(entry)
        outbox.put(entry)
    assert dropped == [(b"\0", "queue-full")], "the oldest fleeting one makes room"


def large(name: str, priority: int, size: int = 100_000) -> Entry:
    return Entry(Parcel("message", name, "/c", bytes(size), priority=priority))


async def test_a_hub_is_sent_no_more_streams_than_it_takes_and_stops_beside_them() -> None:
    """It closes a connection on which more are open, or announce more together than one parcel may have."""
    for most, count in ((8 << 20, 6), (350_000, 3)):
        outbox, wire, sent = Outbox(lambda entry, reason: None), Wire(), []
        outbox.most_open = most
        sending = asyncio.ensure_future(outbox.send_all(wire, lambda entry: sent.append(entry.parcel.name)))  # type: ignore
        for number in range(count):
            outbox.put(large(f"image {number}", number))
            while wire.streams <= number:
                await asyncio.wait_for(wire.frames.get(), 5)
                await asyncio.sleep(0)  # tidy: lets the queue go on by one frame
        # There is no room for these as streams; what is small or never cut needs none.
        for number in range(2):
            outbox.put(large(f"late {number}", 50 + number))
        outbox.put(Entry(Parcel("message", "note", "/c", priority=90)))
        outbox.put(Entry(Parcel("message", "stop", "/c", bytes(200_000))))
        assert wire.streams == count
        while not outbox.is_empty:
            await asyncio.wait_for(wire.frames.get(), 5)
            await asyncio.sleep(0)  # tidy: lets the queue go on by one frame
            assert len(outbox._streams) <= count
        sending.cancel()
        # The first that ends makes room for what is most urgent.
        assert sent[:5] == ["stop", "note", f"image {count - 1}", "late 1", "late 0"] and sent[-1] == "image 0"


async def test_a_parcel_that_is_larger_than_all_streams_may_be_goes_alone() -> None:
    outbox, sent = Outbox(lambda entry, reason: None), []  # type: ignore[var-annotated]
    outbox.most_open, wire = 1000, Wire()
    outbox.put(large("image", 0))
    sending = asyncio.ensure_future(outbox.send_all(wire, sent.append))  # type: ignore[arg-type]
    while not sent:
        await asyncio.wait_for(wire.frames.get(), 5)
    sending.cancel()


async def test_what_has_begun_to_leave_leaves_whole_though_it_expires() -> None:
    seconds, dropped, sent = [0.0], [], []  # type: ignore[var-annotated]
    outbox = Outbox(lambda entry, reason: dropped.append(reason), lambda: seconds[0])
    image, wire = Entry(Parcel("message", "image", "/c", bytes(100_000), expires=5), now=0.0), Wire()
    outbox.put(image)
    sending = asyncio.ensure_future(outbox.send_all(wire, sent.append))  # type: ignore[arg-type]
    await asyncio.wait_for(wire.frames.get(), 5)
    seconds[0] = 1.0
    while not sent and not dropped:
        await asyncio.wait_for(wire.frames.get(), 5)
    sending.cancel()
    assert sent == [image] and not dropped
    seconds[0] = 2.0
    for expires in (1000, 1001):
        outbox.put(Entry(Parcel("message", "note", "/c", expires, expires=expires), now=1.0))
    sending = asyncio.ensure_future(outbox.send_all(Wire(), sent.append))  # type: ignore[arg-type]
    while not outbox.is_empty:
        await asyncio.sleep(0)  # tidy: lets the queue go on by one frame
    sending.cancel()
    assert [entry.parcel.content for entry in sent[1:]] == [1001] and dropped == ["expired"]


async def test_a_stop_is_replaced_once_nobody_waits_for_its_answer_any_more() -> None:
    outbox = Outbox(lambda entry, reason: None)
    answer: "asyncio.Future[Any]" = asyncio.get_running_loop().create_future()
    stops = [Entry(Parcel("message", "stop", "/c", number), answer=answer if number == 0 else None) for number in range(3)]
    outbox.put(stops[0])
    outbox.put(stops[1])
    assert list(outbox._queue) == stops[:2]
    answer.cancel()
    outbox.put(stops[2])
    assert list(outbox._queue) == stops[2:]


async def test_stops_and_unstops_are_never_cut() -> None:
    for name in ("stop", "unstop"):
        outbox, wire = Outbox(lambda entry, reason: None), Wire()
        outbox.put(Entry(Parcel("message", name, "/c", bytes(100_000))))
        sending = asyncio.ensure_future(outbox.send_all(wire, lambda entry: None))  # type: ignore[arg-type]
        frame = await asyncio.wait_for(wire.frames.get(), 5)
        sending.cancel()
        assert len(frame) > 100_000 and outbox.is_empty and wire.streams == 0


@pytest.mark.parametrize("name", ["command", "note"])
async def test_only_what_is_fleeting_makes_fleeting_messages_leave_their_place(name: str) -> None:
    dropped: List[str] = []
    outbox = Outbox(lambda entry, reason: dropped.append(reason))
    outbox.most = 1000
    outbox.put(Entry(Parcel("message", "frame", "/c", bytes(700)), "fleeting"))
    waiting = asyncio.ensure_future(outbox.capacity(Entry(Parcel("message", name, "/c", bytes(700)))))
    await asyncio.sleep(0)  # tidy: lets it begin
    assert not waiting.done() and not dropped
    outbox.lose()
    await asyncio.sleep(0)  # tidy: lets it look again
    await asyncio.sleep(0)  # tidy: and end, if it does
    assert waiting.done() is (name == "command"), "while the connection is lost a command is dropped at once"
    outbox.resume([])
    sending = asyncio.ensure_future(outbox.send_all(Wire(), lambda entry: None))  # type: ignore[arg-type]
    await asyncio.wait_for(waiting, 5)
    sending.cancel()
    assert outbox.is_empty and not dropped


def test_a_link_keeps_what_outlives_a_loss() -> None:
    note = Entry(Parcel("message", "note", "/c", bytes(400)))
    link = Link("link", b"", 30.0)
    for entry in [note, note, Entry(Parcel("message", "frame", "/c", bytes(4000)), "fleeting"), Entry(Parcel("time", "ping"))]:
        link.wrote(entry)
    assert link.sent == 3 and len(link.unread) == 3 and link.kept_bytes == 2 * note.size
    for wrong in (4, -1, "1"):
        assert not link.acknowledged({"read": wrong}) and len(link.unread) == 3
    assert link.acknowledged({"read": 1}) and not link.acknowledged({"read": 0})
    assert len(link.unread) == 2 and link.kept_bytes == note.size
    assert link.acknowledged({"read": 3}) and link.kept_bytes == 0
    link.wrote(note)
    both = link.resumed({"read": 3})
    assert both == ([note], []) and link.sent == 3 and not link.unread and link.kept_bytes == 0


async def test_messages_are_held_back_beyond_what_is_kept_and_nothing_else_is() -> None:
    class Open(Wire):
        async def write(self, data: bytes) -> None:
            pass

    sent: List[Any] = []
    core = Core(now, 4, 1.0)
    outbox, held = core.outbox, 0

    def count() -> None:
        nonlocal held
        held += 1

    def wrote(entry: Entry) -> None:
        sent.append(entry.parcel.name)
        assert core.link
        core.link.wrote(entry)

    outbox.most, outbox.held, core.link = 1000, count, Link("link", b"", 30.0)
    for size, name in [(5000, "map"), (400, "note"), (10, "short")]:
        outbox.put(Entry(Parcel("message", name, "/c", bytes(size))))
    sending = asyncio.ensure_future(outbox.send_all(Open(), wrote))  # type: ignore[arg-type]

    async def leave(*names: str) -> None:
        for _ in range(20):
            await asyncio.sleep(0)  # tidy: lets the other go on
        assert sent == list(names)
        sent.clear()

    await leave("map")  # One parcel of any size may be under way.
    assert held == 1
    for parcel in [Parcel("context", "info", "/c"), Parcel("message", "unstop", "/d"), Parcel("message", "stop", "/c")]:
        outbox.put(Entry(parcel))
    await leave("stop", "info", "unstop")
    outbox.put(Entry(Parcel("message", "urgent", "/c", bytes(10), priority=9)))
    await leave()
    assert core.link.acknowledged({"read": 1})
    outbox.wake()
    await leave("urgent", "note", "short")
    sending.cancel()


@pytest.mark.parametrize("heartbeat", [0.0999, 10.001, 0, -1, float("nan"), float("inf")])
def test_a_heartbeat_that_no_hub_takes_is_refused_here(heartbeat: float) -> None:
    with pytest.raises(mom.LocalError, match=r"a heartbeat must be from 0\.1 s to 10 s, not ") as caught:
        mom.connect("bin://127.0.0.1:1", guest=True, heartbeat=heartbeat)
    assert caught.value.code == "bad-content"


def test_heartbeats_within_the_range_are_taken() -> None:
    for heartbeat in (None, 0.1, 0.5, 10):
        mom.connect("bin://127.0.0.1:1", guest=True, heartbeat=heartbeat)


def said(name: str, content: Any, sender: str = "alice", path: str = "/c") -> mom.Message:
    return mom.Message(Parcel("message", name, path, content, sender=sender))


def taken(events: mom.Events) -> List[Any]:
    found: List[Any] = []
    while (event := events.try_next()) is not None:
        found.append(event.content if isinstance(event, mom.Message) else event)
    return found


def subscribers(most: int = 4) -> Subscribers:
    return Subscribers(most, lambda parcel: False)


async def test_a_full_queue_of_events_drops_the_oldest_and_says_so() -> None:
    events = subscribers().unaddressed()
    for number in range(7):
        events._push(said("note", number))
    assert taken(events) == [mom.Lagged(3), 3, 4, 5, 6]


@pytest.mark.parametrize("name, sender", [("stop", "bob"), ("unstop", "bob"), ("halt", "hub"), ("park", "hub")])
async def test_a_full_queue_of_events_keeps_what_a_device_must_not_miss(name: str, sender: str) -> None:
    events = subscribers().unaddressed()
    events._push(said("note", 0))
    events._push(said(name, "kept", sender))
    for number in range(1, 9):
        events._push(said("note", number))
    assert taken(events) == [mom.Lagged(6), "kept", 6, 7, 8]
    # In its order among the others, and also where it comes last.
    for number in range(4):
        events._push(said("note", number))
    events._push(said(name, "kept", sender))
    assert taken(events) == [mom.Lagged(1), 1, 2, 3, "kept"]


async def test_a_full_queue_of_events_keeps_what_is_said_of_stops_and_of_the_link() -> None:
    down = mom.StateChanged(mom.LinkState("resuming"))
    kept = [mom.Stops("/c", mom.StopState(3, True)), mom.LinkDown(), down, mom.StateChanged(mom.LinkState("connected"))]
    events = subscribers().unaddressed()
    for event in kept:
        events._push(event)
        for number in range(9):
            events._push(said("note", number))
    assert taken(events) == [mom.Lagged(36), *kept]
    for event in [*kept, mom.Stops("/c", newer := mom.StopState(5, True))]:
        events._push(event)
    assert taken(events) == [mom.Lagged(1), *kept[1:], mom.Stops("/c", newer)]


async def test_other_messages_are_kept_no_longer_than_others() -> None:
    events = subscribers(2).unaddressed()
    for name, sender in [("log", "hub"), ("halted", "bob"), ("command", "bob"), ("joined", "alice")]:
        events._push(said(name, name, sender))
    assert taken(events) == [mom.Lagged(2), "command", "joined"]


async def test_of_stops_a_full_queue_keeps_the_newest_of_each_sender_and_context() -> None:
    events = subscribers().unaddressed()
    for number in range(100):
        for sender in ("alice", "bob"):
            for path in ("/a", "/b"):
                events._push(said("stop", f"{sender} {path} {number}", sender, path))
                events._push(said("unstop", f"not {sender} {path} {number}", sender, path))
                events._push(said("note", "in between"))
    newest = [f"{word}{sender} {path} 99" for sender in ("alice", "bob") for path in ("/a", "/b") for word in ("", "not ")]
    found = taken(events)
    assert found[1:] == newest and isinstance(found[0], mom.Lagged) and found[0].lost == 1200 - 8
    assert events._bytes == 0 and taken(events) == []


async def test_a_stop_is_kept_for_whoever_comes_late_for_the_events_of_a_context() -> None:
    """Of the rest nobody waits for, others hear."""
    all_ = subscribers()
    others = all_.unaddressed()
    all_.keep_early("/c")
    all_.deliver(["/c"], said("stop", "first"))
    for number in range(9):
        all_.deliver(["/c"], said("note", number))
    all_.deliver(["/c"], said("stop", "second"))
    all_.deliver(["/c"], said("stop", "bob's", "bob"))
    assert taken(others) == [mom.Lagged(4), 7, 8, "second", "bob's"]
    events = all_.subscribe("/c")
    assert taken(events) == [mom.Lagged(10), "second", "bob's"]
    for number in range(5):
        all_.deliver(["/c"], said("note", number))
    assert taken(events) == [mom.Lagged(1), 1, 2, 3, 4] and taken(others) == []


@pytest.mark.parametrize(
    "name, content, event",
    [
        ("joined", {"count": 300}, mom.Count(300)),
        ("lost", {"peer": "a", "user": "b", "level": 1, "within": 30000}, mom.PeerLost(mom.Member("a", "b", 1), 30.0)),
        ("resumed", {"peer": "a", "user": "b", "level": 1}, mom.PeerResumed(mom.Member("a", "b", 1))),
        ("notice", {"within": 5000, "waiting": 2}, mom.Notice("/t", 5.0, 2)),
        ("lapsed", {"what": "offer", "by": "a", "to": "b", "reason": "left"}, mom.Lapsed("/t", "offer", "a", "b", "left")),
        ("queued", {"place": 3}, mom.Queued("/t", 3, None)),
        ("dropped", {}, mom.Dropped("", 0, Parcel("event", "dropped", "/t", {}))),
    ],
)
def test_events_are_typed(name: str, content: Dict[str, Any], event: mom.Event) -> None:
    assert of_parcel(Parcel("event", name, "/t", content)) == event


def test_an_unknown_event_stays_a_parcel() -> None:
    parcel = Parcel("event", "eclipse", "/t", {})
    assert of_parcel(parcel) == mom.Other(parcel)


def test_parcels_and_errors_are_shown_short() -> None:
    assert repr(Parcel("message", "say", "/c", "hi", id=1)) == (
        "Parcel(family='message', name='say', context='/c', content='hi', id=1)"
    )
    wire = mom.WireError("held", "alice drives", {"code": 101, "retry-after": 1500, "rule": "r", "holders": ["a"]})
    error = mom.RefusedError(wire)
    assert str(error) == "refused: held: alice drives"
    assert (error.code, error.number, error.retry_after, error.rule, wire.holders) == ("held", 101, 1.5, "r", ["a"])
    assert "alice" not in repr(Credentials(user="bob", password="alice"))
