"""The binary form: frames, names by number, chunks."""

from __future__ import annotations

import struct
import zlib
from typing import Any, Dict, Iterator, List, Optional, Tuple

from .errors import LocalError
from .parcel import DELIVERIES, FAMILIES, Parcel
from .values import check_text, from_micros, pack, to_micros, unpack

PREFACE = b"\x8fMOM\x01\x01"
"""What each side says first."""

NAMES = (
    "command state status image chat stop unstop halt login answer resume logout create lookup list info stats join leave "
    "delete members invite expel grab release renew give accept decline request break inhibit uninhibit consult verdict "
    "joined left created deleted grabbed released requested offer lapsed queued invited expelled dropped notice ok "
    "challenge ping pong hub inhibited uninhibited ack resent lost resumed"
).split()
"""The words that have a number, in its order."""

_NUMBERS = {word: number for number, word in enumerate(NAMES)}
_PARCEL, _CHUNK, _COMPRESSED = 0, 1, 2
_FIRST, _LAST, _ABORTED = 1, 2, 4
_STREAMS = 8
_OPENED = 64 * 1024

STREAM_MARK = b"\0\0\0\1\2"
"""Stands before all that is compressed: a frame of one byte, its kind."""


def varint(number: int) -> bytes:
    """7 bits a byte, the lowest first."""
    if number < 0 or number >= 1 << 64:
        raise LocalError("not-encodable", f"{number} is not a count from 0 to 2^64 - 1")
    out = bytearray()
    while number > 0x7F:
        out.append(number & 0x7F | 0x80)
        number >>= 7
    out.append(number)
    return bytes(out)


def _zigzag(number: int) -> bytes:
    return varint((number << 1) ^ (number >> 63))


def _text(text: str) -> bytes:
    check_text(text)
    data = text.encode()
    return varint(len(data)) + data


def _name(word: str) -> bytes:
    number = _NUMBERS.get(word)
    if number is not None:
        return varint(number * 2 + 1)
    check_text(word)
    data = word.encode()
    return varint(len(data) * 2) + data


def _micros(micros: int) -> bytes:
    return struct.pack(">q", micros)


def _names(names: List[str]) -> bytes:
    return varint(len(names)) + b"".join(map(_name, names))


def _extra(extra: Dict[str, Any]) -> bytes:
    data = pack(extra)
    return varint(len(data)) + data


def encode(parcel: Parcel) -> bytes:
    """The body of a parcel's frame: its kind byte and what follows."""
    has_content = parcel.content is not None or parcel.has_content
    slots: List[Tuple[int, Optional[bytes]]] = [
        (1, _name(parcel.name)),
        (2, None if parcel.sender is None else _name(parcel.sender)),
        (3, None if parcel.timestamp is None else _micros(to_micros(parcel.timestamp))),
        (4, None if parcel.id is None else varint(parcel.id)),
        (5, b"" if has_content else None),
        (6, None if parcel.fence is None else varint(parcel.fence)),
        (7, None if parcel.received is None else _micros(to_micros(parcel.received))),
        (8, None if parcel.age is None else _zigzag(parcel.age)),
        (9, None if parcel.age_error is None else varint(parcel.age_error)),
        (10, None if parcel.family == "message" else bytes([_index(FAMILIES, parcel.family, "family")])),
        (11, None if parcel.reference is None else varint(parcel.reference)),
        (12, None if parcel.priority is None else _zigzag(parcel.priority)),
        (13, None if parcel.address is None else _names(parcel.address)),
        (14, None if parcel.expires is None else varint(parcel.expires)),
        (15, None if parcel.delivery is None else bytes([_index(DELIVERIES, parcel.delivery, "delivery")])),
        (16, None if parcel.echo is None else bytes([parcel.echo])),
        (17, None if parcel.receipt is None else bytes([parcel.receipt])),
        (18, None if parcel.context is None else _text(parcel.context)),
        (19, _extra(parcel.extra) if parcel.extra else None),
    ]
    bits = sum(1 << bit for bit, data in slots if data is not None)
    parts = [b"\0", varint(bits)] + [data for _, data in slots if data]
    if has_content:
        parts.append(pack(parcel.content))
    return b"".join(parts)


def _index(words: Tuple[str, ...], word: str, what: str) -> int:
    try:
        return words.index(word)
    except ValueError:
        raise LocalError("bad-slot", f"{word!r} is not a {what}: expected one of {', '.join(words)}") from None


def frame(body: bytes) -> bytes:
    """A whole frame."""
    return struct.pack(">I", len(body)) + body


def chunk(stream: int, data: bytes, total: int, first: bool, last: bool) -> bytes:
    """A frame with a piece of a body of `total` bytes."""
    head = b"\x01" + varint(stream) + bytes([_FIRST * first | _LAST * last])
    return frame(head + (varint(total) if first else b"") + data)


class _Slots:
    """Reads the slots of one frame."""

    def __init__(self, data: bytes, at: int) -> None:
        self.data, self.at = data, at

    def take(self, count: int) -> bytes:
        data = self.data[self.at : self.at + count]
        if len(data) < count:
            raise LocalError("bad-slot", "the frame ends inside a slot")
        self.at += count
        return data

    def varint(self) -> int:
        number = 0
        for shift in range(0, 70, 7):
            byte = self.take(1)[0]
            number |= (byte & 0x7F) << shift
            if byte < 0x80:
                if number >= 1 << 64:
                    break
                return number
        raise LocalError("bad-slot", "a varint has at most 64 bits in 10 bytes")

    def zigzag(self) -> int:
        number = self.varint()
        return (number >> 1) ^ -(number & 1)

    def micros(self) -> int:
        return int(struct.unpack(">q", self.take(8))[0])

    def text(self) -> str:
        try:
            return self.take(self.varint()).decode()
        except UnicodeDecodeError:
            raise LocalError("bad-encoding", "a slot is not UTF-8") from None

    def name(self) -> Optional[str]:
        """A name; none for a number that this side does not know."""
        key = self.varint()
        if key & 1:
            return NAMES[key >> 1] if key >> 1 < len(NAMES) else None
        try:
            return self.take(key >> 1).decode()
        except UnicodeDecodeError:
            raise LocalError("bad-encoding", "a name is not UTF-8") from None

    def word(self, words: Tuple[str, ...]) -> str:
        number = self.take(1)[0]
        if number >= len(words):
            raise LocalError("bad-slot", f"the number {number} stands for none of {', '.join(words)}")
        return words[number]


def decode(body: bytes, numbers: Dict[int, str]) -> Parcel:
    """Reads the body of a frame. `numbers` are the paths of contexts; it learns from the parcel.

    What is wrong inside is told in `Parcel.fault`, because a complete frame leaves the connection whole.
    """
    parcel = Parcel("message", "")
    try:
        slots = _Slots(body, 1)
        _read_slots(parcel, slots, slots.varint(), numbers)
    except LocalError as error:
        parcel.fault = str(error)
    return parcel


def _read_slots(parcel: Parcel, slots: _Slots, bits: int, numbers: Dict[int, str]) -> None:
    number: Optional[int] = None
    for bit in range(64):
        if not bits >> bit & 1:
            continue
        if bit == 0:
            number = slots.varint()
        elif bit in (1, 2):
            name = slots.name()
            if name is None:
                parcel.fault = "a name by a number that this client does not know"
            setattr(parcel, "name" if bit == 1 else "sender", name or "")
        elif bit == 13:
            names = [slots.name() for _ in range(slots.varint())]
            parcel.address = [name or "" for name in names]
        elif bit == 19:
            parcel.extra = unpack(slots.take(slots.varint()))
        elif bit > 19:
            slots.take(slots.varint())
        elif bit != 5:
            _read_plain(parcel, slots, bit)
    if number is not None and parcel.context is not None:
        numbers[number] = parcel.context
    elif number is not None:
        parcel.context = numbers.get(number)
    if bits >> 5 & 1:
        parcel.has_content = True
        parcel.content = unpack(slots.data[slots.at :])


def _read_plain(parcel: Parcel, slots: _Slots, bit: int) -> None:
    if bit in (3, 7):
        setattr(parcel, "timestamp" if bit == 3 else "received", from_micros(slots.micros()))
    elif bit in (8, 12):
        setattr(parcel, "age" if bit == 8 else "priority", slots.zigzag())
    elif bit == 10:
        parcel.family = slots.word(FAMILIES)
    elif bit == 15:
        parcel.delivery = slots.word(DELIVERIES)
    elif bit in (16, 17):
        setattr(parcel, "echo" if bit == 16 else "receipt", slots.take(1) != b"\0")
    elif bit == 18:
        parcel.context = slots.text()
    else:
        slot = {4: "id", 6: "fence", 9: "age_error", 11: "reference", 14: "expires"}[bit]
        setattr(parcel, slot, slots.varint())


class Decoder:
    """Makes parcels of the bytes of one connection, from its preface on."""

    def __init__(self, numbers: Optional[Dict[int, str]] = None, most: int = 8 << 20) -> None:
        self.numbers: Dict[int, str] = {} if numbers is None else numbers
        """The paths of contexts by number, as the hub has told them."""
        self.most = most
        """The largest frame, and the most that open streams may announce together."""
        self.began = False
        """Whether the hub's preface has come."""
        self.takes_stream = False
        """Whether the hub may compress what follows: a login has asked for it by `stream-deflate`."""
        self._inflate: Optional[Any] = None
        self._input = bytearray()
        self._streams: Dict[int, Tuple[int, bytearray]] = {}

    def feed(self, data: bytes) -> Iterator[Tuple[Parcel, int]]:
        """Takes what has arrived; gives whole parcels, and their sizes.

        `LocalError` with `bad-frame`, `bad-version` or `too-large` for a broken connection: nothing follows.
        """
        if self._inflate is not None:
            yield from self._open(data)
            return
        self._input += data
        if not self.began:
            if not self._preface():
                return
        yield from self._frames()

    def _open(self, data: bytes) -> Iterator[Tuple[Parcel, int]]:
        """Opens what has arrived, some at a time."""
        while data:
            try:
                plain = self._inflate.decompress(data, _OPENED) if self._inflate else b""
            except zlib.error as error:
                raise LocalError("bad-frame", f"the hub's stream-deflate cannot be opened: {error}") from None
            if self._inflate is None or self._inflate.eof or not plain and self._inflate.unconsumed_tail == data:
                raise LocalError("bad-frame", "the hub has ended its stream-deflate")
            data = self._inflate.unconsumed_tail
            self._input += plain
            yield from self._frames()

    def _frames(self) -> Iterator[Tuple[Parcel, int]]:
        at, rest = 0, b""
        try:
            while len(self._input) - at >= 4:
                (length,) = struct.unpack_from(">I", self._input, at)
                if length > self.most or length == 0:
                    raise LocalError("too-large", f"a frame of {length} bytes exceeds the limit of {self.most}")
                if len(self._input) - at < 4 + length:
                    break
                body = bytes(memoryview(self._input)[at + 4 : at + 4 + length])
                at += 4 + length
                if body[0] == _COMPRESSED and self.takes_stream and self._inflate is None:
                    self._inflate = zlib.decompressobj()
                    rest, at = bytes(memoryview(self._input)[at:]), len(self._input)
                    break
                whole = self._whole(body)
                if whole is not None:
                    yield decode(whole, self.numbers), len(whole)
        finally:
            del self._input[:at]
        yield from self._open(rest)

    def _preface(self) -> bool:
        seen = bytes(self._input[: len(PREFACE)])
        if not PREFACE.startswith(seen[:4]):
            said = bytes(self._input[:200]).decode("ascii", "replace")
            raise LocalError("bad-frame", f"this is not a hub that speaks the binary form: {said!r}")
        if len(seen) < len(PREFACE):
            return False
        if seen[4] != PREFACE[4]:
            raise LocalError("bad-version", f"the hub speaks version {seen[4]}, this client {PREFACE[4]}")
        self.began = True
        del self._input[: len(PREFACE)]
        return True

    def _whole(self, body: bytes) -> Optional[bytes]:
        if body[0] == _PARCEL:
            return body
        if body[0] == _CHUNK:
            return self._assemble(body)
        if body[0] < 128:
            raise LocalError("bad-frame", f"unknown kind of frame {body[0]}")
        return None

    def _assemble(self, body: bytes) -> Optional[bytes]:
        head = _Slots(body, 1)
        try:
            stream, flags = head.varint(), head.take(1)[0]
            total = head.varint() if flags & _FIRST and not flags & _ABORTED else 0
        except LocalError as error:
            raise LocalError("bad-frame", f"the head of a chunk: {error.text}") from None
        if flags & _ABORTED:
            if self._streams.pop(stream, None) is None:
                raise LocalError("bad-frame", f"stream {stream} is aborted and not open")
            return None
        if flags & _FIRST:
            announced = sum(length for length, _ in self._streams.values())
            if stream in self._streams or len(self._streams) >= _STREAMS or total == 0:
                raise LocalError("bad-frame", f"stream {stream} cannot begin")
            if announced + total > self.most:
                raise LocalError("too-large", f"open streams announce more than {self.most} bytes")
            self._streams[stream] = (total, bytearray())
        if flags & ~(_FIRST | _LAST) or stream not in self._streams:
            raise LocalError("bad-frame", f"stream {stream} is not open, or its flags are {flags}")
        total, data = self._streams[stream]
        data += memoryview(body)[head.at :]
        if len(data) > total or (flags & _LAST and len(data) < total):
            raise LocalError("bad-frame", f"stream {stream} does not have the length that it announced")
        if not flags & _LAST:
            return None
        del self._streams[stream]
        if data[0] != _PARCEL:
            raise LocalError("bad-frame", f"stream {stream} does not carry a parcel")
        return bytes(data)
