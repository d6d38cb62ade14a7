"""Values of parcels, and their form in MessagePack.

| type of MOM | Python |
|---|---|
| null, boolean, int, double, string | `None`, `bool`, `int` of 64 bits, `float` that is finite, `str` |
| time | `datetime.datetime` with a time zone; what arrives is in UTC |
| binary | `bytes`; `bytearray` and `memoryview` may be sent |
| list | `list`; tuples may be sent |
| map | `dict` with keys of type `str`, in order |
"""

from __future__ import annotations

import math
import re
import struct
from datetime import datetime, timedelta, timezone
from typing import Any, Dict, List, Tuple

import msgpack

from .errors import LocalError

Value = Any
"""A value of a parcel, of one of the types above."""

EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
_MICROSECOND = timedelta(microseconds=1)
_EARLIEST = (datetime.min.replace(tzinfo=timezone.utc) - EPOCH) // _MICROSECOND
_LATEST = (datetime.max.replace(tzinfo=timezone.utc) - EPOCH) // _MICROSECOND

_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_TIME = -1


def now() -> datetime:
    """The system's time, in UTC."""
    return datetime.now(timezone.utc)


def to_micros(time: datetime) -> int:
    """Microseconds since 1970."""
    if time.tzinfo is None:
        raise _not_encodable("a time without a time zone: use datetime.now(timezone.utc)")
    return (time - EPOCH) // _MICROSECOND


def from_micros(micros: int) -> datetime:
    """The instant so many microseconds after 1970. Python has no year 0: what lies before its first day is that day."""
    return EPOCH + timedelta(microseconds=min(max(micros, _EARLIEST), _LATEST))


def pack(value: Value) -> bytes:
    """Writes a value as MessagePack; `LocalError` with `not-encodable` for what has no form on the wire."""
    packer = msgpack.Packer(autoreset=False, use_bin_type=True)
    _pack(packer, value, 0)
    return bytes(packer.bytes())


def _pack(packer: Any, value: Value, depth: int) -> None:
    if isinstance(value, (dict, list, tuple)):
        if depth >= 32:
            raise LocalError("too-deep", "lists and maps nest at most 32 deep")
        _pack_container(packer, value, depth + 1)
    elif value is None or isinstance(value, bool):
        packer.pack(value)
    elif isinstance(value, int):
        if not -(1 << 63) <= value < 1 << 63:
            raise _not_encodable(f"{value} does not fit into 64 bits")
        packer.pack(int(value))
    elif isinstance(value, float):
        if not math.isfinite(value):
            raise _not_encodable(f"{value} is not a number that can be sent: leave it out, or send null")
        packer.pack(float(value))
    elif isinstance(value, str):
        check_text(value)
        packer.pack(str(value))
    elif isinstance(value, (bytes, bytearray, memoryview)):
        packer.pack(bytes(value))
    elif isinstance(value, datetime):
        seconds, micros = divmod(to_micros(value), 1_000_000)
        packer.pack_ext_type(_TIME, struct.pack(">Iq", micros * 1000, seconds))
    else:
        kind = type(value).__name__
        raise _not_encodable(f"a {kind} cannot be sent: see mom.values for the types that can")


def _pack_container(packer: Any, value: Value, depth: int) -> None:
    if isinstance(value, dict):
        packer.pack_map_header(len(value))
        for key, member in value.items():
            if not isinstance(key, str):
                raise _not_encodable(f"the key {key!r} of a map is not a string")
            check_text(key)
            packer.pack(str(key))
            _pack(packer, member, depth)
    else:
        packer.pack_array_header(len(value))
        for member in value:
            _pack(packer, member, depth)


def check_text(text: str) -> None:
    """Refuses what is not text of XML 1.0, which all forms share."""
    found = _NOT_XML.search(text)
    if found:
        raise _not_encodable(f"the character {found.group()!r} is not allowed in a string: send bytes")


def sayable(text: str) -> str:
    """A text with � for each character that no string may hold."""
    return _NOT_XML.sub("\ufffd", str(text))


def unpack(data: bytes) -> Value:
    """Reads one value of MessagePack; `LocalError` with `bad-content` for anything else."""
    try:
        value = msgpack.unpackb(
            data, raw=False, timestamp=0, strict_map_key=True, ext_hook=_no_extension, object_pairs_hook=_map
        )
    except LocalError:
        raise
    except Exception as error:  # msgpack has a dozen kinds of them
        raise LocalError("bad-content", f"not valid MessagePack: {error}") from error
    return _checked(value)


def _map(pairs: List[Tuple[str, Value]]) -> Dict[str, Value]:
    known = dict(pairs)
    if len(known) != len(pairs):
        raise LocalError("bad-content", "a key is twice in a map")
    if not all(isinstance(key, str) for key in known):
        raise LocalError("bad-content", "a key of a map is not a string")
    return known


def _no_extension(code: int, data: bytes) -> Value:
    raise LocalError("bad-content", f"MOM has no MessagePack extension type {code}")


def _checked(value: Value, depth: int = 0) -> Value:
    # The hub's own limit is 32, but it passes on what it does not open.
    if depth > 128:
        raise LocalError("too-deep", "lists and maps nest more than 128 deep")
    if isinstance(value, dict):
        for key, member in value.items():
            value[key] = _checked(member, depth + 1)
    elif isinstance(value, list):
        value[:] = [_checked(member, depth + 1) for member in value]
    elif isinstance(value, float) and not math.isfinite(value):
        raise LocalError("bad-content", f"{value} is not a valid number")
    elif isinstance(value, int) and value >= 1 << 63:
        raise LocalError("bad-content", f"{value} does not fit into 64 bits")
    elif isinstance(value, msgpack.Timestamp):
        return from_micros(value.seconds * 1_000_000 + value.nanoseconds // 1000)
    return value


def _not_encodable(text: str) -> LocalError:
    return LocalError("not-encodable", text)
