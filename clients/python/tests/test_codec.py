"""The binary form: golden files, values, chunks."""

from __future__ import annotations

import random
import struct
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any, List

import json_form
import msgpack
import pytest

from mom.binary import PREFACE, Decoder, chunk, decode, encode, frame, varint
from mom.errors import CODES, LocalError
from mom.parcel import Parcel
from mom.values import EPOCH, from_micros, pack, unpack

ROOT = Path(__file__).parents[3]
GOLDEN = ROOT / "mom-proto/tests/golden"


def at(micros: int) -> datetime:
    return EPOCH + timedelta(microseconds=micros)


def golden_hex(name: str) -> bytes:
    lines = (GOLDEN / "binary" / f"{name}.hex").read_text().splitlines()
    return bytes.fromhex("".join(line for line in lines if not line.startswith("#")))


GOLDENS = {
    "login": Parcel("login", "login", "/", {"name": "alice", "password": "secret"}, id=1),
    "all_slots": Parcel(
        "event", "lights", "/a/b", [None, True, -1, 0.5, at(1), b"\0\xff"], id=300, reference=2,
        address=["bob", "hub"], priority=-5, expires=250, delivery="fleeting", age=-1, age_error=9, echo=False,
        receipt=True, extra={"colour": "red"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", GOLDENS)
def test_golden_files_of_the_binary_form(name: str) -> None:
    parcel, numbers = GOLDENS[name], {}
    read = decode(golden_hex(name)[4:], numbers)
    read.has_content = False
    assert read == parcel
    if name == "login":
        assert frame(encode(parcel)) == golden_hex(name)
    else:
        assert numbers == {129: "/a/b"}, "a number and a path bind each other"
        again = decode(encode(parcel), {})
        again.has_content = False
        assert again == parcel


def test_a_command_names_its_channel_by_number() -> None:
    read = decode(golden_hex("command")[4:], {5: "/robot/arm"})
    assert (read.context, read.name, read.sender, read.content) == ("/robot/arm", "command", "alice", "grip open")
    assert (read.id, read.fence, read.age) == (7, (1 << 20) + 3, 0)
    assert read.timestamp == at(1_795_255_200_000_123) and read.received == at(1_795_255_200_000_456)


@pytest.mark.parametrize("name", ["all_slots", "by_hand", "kinds", "login", "numbers", "reply"])
def test_golden_files_of_json_pass_through_the_binary_form(name: str) -> None:
    lines = (GOLDEN / "json" / f"{name}.json").read_bytes().split(b"\n")
    for line in filter(bytes.strip, lines):
        parcel = json_form.read(line.decode())
        through = decode(encode(parcel), {})
        assert through.fault is None and through == parcel
        assert json_form.read(json_form.write(through)) == parcel


def test_the_codes_are_those_of_the_protocol() -> None:
    rows = [line.split("|") for line in (ROOT / "docs/PROTOCOL.md").read_text().splitlines() if line.startswith("|")]
    told = {row[2].strip(" `"): int(row[1]) for row in rows if row[1].strip().isdigit() and len(row) == 5}
    assert {code: told.get(code) for code in CODES} == CODES


VALUES: List[Any] = [
    None, True, False, 0, -1, 127, 128, -(1 << 63), (1 << 63) - 1, 0.0, -1.5e300, "", "é\n😀", b"", bytes(70000),
    at(0), at(-1), at(1_795_255_200_000_123), datetime(9999, 12, 31, 23, 59, 59, 999999, timezone.utc), [], {},
    [1, [2, {"a": [b"x"]}]], {"b": 1, "a": None},
]  # fmt: skip


@pytest.mark.parametrize("value", VALUES, ids=lambda value: repr(value)[:30])
def test_values_keep_their_type(value: Any) -> None:
    back = unpack(pack(value))
    assert back == value and type(back) is type(value)


def test_what_may_be_sent_too() -> None:
    assert unpack(pack((1, bytearray(b"x"), memoryview(b"y")))) == [1, b"x", b"y"]
    east = timezone(timedelta(hours=9))
    assert unpack(pack(datetime(2026, 1, 1, 9, tzinfo=east))) == datetime(2026, 1, 1, tzinfo=timezone.utc)
    assert list(unpack(pack({"z": 1, "a": 2}))) == ["z", "a"], "in order"


@pytest.mark.parametrize(
    "value, code",
    [
        (float("nan"), "not-encodable"),
        (float("inf"), "not-encodable"),
        (1 << 63, "not-encodable"),
        ({1: 2}, "not-encodable"),
        ("\0", "not-encodable"),
        ("\ud800", "not-encodable"),
        (object(), "not-encodable"),
        (datetime(2026, 1, 1), "not-encodable"),
    ],
    ids=repr,
)
def test_what_has_no_form_is_refused(value: Any, code: str) -> None:
    with pytest.raises(LocalError) as caught:
        pack([value])
    assert caught.value.code == code and caught.value.number == CODES[code]


def test_nesting_has_a_limit() -> None:
    value: Any = None
    for _ in range(32):
        value = [value]
    pack(value)
    with pytest.raises(LocalError, match="32 deep"):
        pack([value])


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xc1",
        b"\x01\x02",
        b"\xa2\xff\xfe",
        b"\x82\xa1a\x01\xa1a\x02",
        b"\x81\x01\x02",
        b"\x81\xc4\x01a\x02",
        b"\xcb\x7f\xf8" + bytes(6),
        b"\xcf\xff" + bytes(7),
        b"\xd4\x05\x00",
        b"\xdd\x7f\xff\xff\xff",
        pytest.param(b"\x91" * 600 + b"\x00", id="deep"),
    ],
    ids=repr,
)
def test_content_that_is_no_value_is_a_fault_of_the_parcel_alone(data: bytes) -> None:
    with pytest.raises(LocalError):
        unpack(data)
    body = encode(Parcel("message", "say", "/chat", sender="alice", has_content=True))
    read = decode(body[:-1] + data, {})
    assert read.fault and (read.name, read.context, read.sender) == ("say", "/chat", "alice")


@pytest.mark.parametrize("seconds, form", [(1, 4), (1 << 33, 8), (-5, 12)])
def test_all_timestamps_are_read(seconds: int, form: int) -> None:
    stamp = msgpack.packb(msgpack.Timestamp(seconds, 0))
    assert len(stamp) - form in (2, 3)
    assert unpack(stamp) == at(seconds * 1_000_000)
    assert len(pack(at(seconds * 1_000_000))) == 15, "written as timestamp 96"


def test_a_year_that_python_has_not() -> None:
    assert from_micros(-62_167_219_200_000_000) == datetime.min.replace(tzinfo=timezone.utc)


def parcels_of(data: bytes, decoder: Decoder) -> List[Parcel]:
    return [parcel for parcel, _ in decoder.feed(data)]


def test_chunks_of_any_size_in_any_slices() -> None:
    random.seed(7)
    large = Parcel("message", "image", "/camera", bytes(random.randrange(256) for _ in range(5000)))
    small = Parcel("message", "stop", "/robot", sender="hub")
    body, sizes = encode(large), [0, 1, 7, 500, 5000]
    for _ in range(20):
        stream, at_, pieces = PREFACE, 0, 0
        while at_ < len(body):
            size = min(random.choice(sizes), len(body) - at_)
            piece, first = body[at_ : at_ + size], pieces == 0
            at_, pieces = at_ + size, pieces + 1
            stream += chunk(9, piece, len(body), first, False) + frame(encode(small)) + frame(b"\xff whatever")
        stream += chunk(9, b"", len(body), False, True)
        decoder, found = Decoder(), []
        while stream:
            size = random.choice([1, 3, 100, 4000])
            found += parcels_of(stream[:size], decoder)
            stream, decoder = stream[size:], decoder
        assert [parcel.name for parcel in found] == ["stop"] * pieces + ["image"]
        assert found[-1].content == large.content


def test_streams_end_and_begin_again() -> None:
    body = encode(Parcel("message", "say", "/chat", "hello"))
    begin, rest = chunk(1, body[:3], len(body), True, False), chunk(1, body[3:], len(body), False, True)
    aborted = frame(b"\x01\x01\x04")
    assert len(parcels_of(PREFACE + begin + aborted + begin + rest + begin + rest, Decoder())) == 2


@pytest.mark.parametrize(
    "data",
    [
        b"HTTP/1.1 400",
        b"\x8fMOM\x02\x00",
        PREFACE + frame(b"\x02"),
        PREFACE + frame(b"\x01\x01\x04"),
        PREFACE + frame(b"\x01\x01\x02x"),
        PREFACE + frame(b"\x01\x01\x09\x05x"),
        PREFACE + frame(b"\x01\x01\x03\x05x"),
        PREFACE + frame(b"\x01\x01\x01\x00"),
        PREFACE + frame(b"\x01\x01"),
        PREFACE + chunk(1, b"x", 5, True, False) * 2,
        PREFACE + chunk(1, b"x", 9 << 20, True, False),
        PREFACE + b"".join(chunk(number, b"", 1, True, False) for number in range(9)),
        PREFACE + struct.pack(">I", 9 << 20),
        PREFACE + bytes(4),
    ],
    ids=repr,
)
def test_a_broken_stream_is_an_error(data: bytes) -> None:
    with pytest.raises(LocalError):
        parcels_of(data, Decoder())


def test_what_a_later_version_may_add_is_skipped() -> None:
    bits = 1 << 1 | 1 << 10 | 1 << 20 | 1 << 63
    body = b"\0" + varint(bits) + varint(2 * 2) + b"hi" + b"\x05" + varint(3) + b"abc" + varint(0) + b"left over"
    read = decode(body, {})
    assert (read.family, read.name, read.fault) == ("event", "hi", None)
    unknown = decode(b"\0" + varint(1 << 1) + varint(2001), {})
    assert unknown.fault and not unknown.name


@pytest.mark.parametrize("body", [b"\0", b"\0" + b"\x80" * 11, b"\0" + varint(2) + varint(200) + b"x"], ids=repr)
def test_a_slot_that_is_cut_is_a_fault(body: bytes) -> None:
    assert decode(body, {}).fault


def test_padded_varints_are_read() -> None:
    read = decode(b"\0\x92\x80\x80\x00" + varint(2 * 2) + b"hi" + b"\x87\x00", {})
    assert (read.name, read.id, read.fault) == ("hi", 7, None)
