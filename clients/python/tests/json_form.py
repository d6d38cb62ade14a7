"""The JSON form of parcels, for the adapter of the dialogues and for golden files: the client itself speaks binary."""

from __future__ import annotations

import base64
import json
from datetime import datetime, timezone
from typing import Any, Dict

from mom.parcel import Parcel

_BIGGEST = (1 << 53) - 1
_TIMES = ("timestamp", "received")
_SLOTS = {
    "family": "family", "name": "name", "id": "id", "reference": "reference", "sender": "sender", "address": "address",
    "timestamp": "timestamp", "priority": "priority", "context": "context", "expires": "expires",
    "delivery": "delivery", "fence": "fence", "received": "received", "age": "age", "age-error": "age_error",
    "echo": "echo", "receipt": "receipt",
}  # fmt: skip


def _int(text: str) -> Any:
    number = int(text)
    return number if text != "-0" and -(1 << 63) <= number < 1 << 63 else float(text)


def read(line: str) -> Parcel:
    """Reads one line."""
    slots = json.loads(line, parse_int=_int)
    parcel = Parcel("", "")
    for key, value in slots.items():
        if key == "content":
            parcel.content, parcel.has_content = _value(value), True
        elif key in _TIMES:
            setattr(parcel, key, _time(value if isinstance(value, str) else value["$time"]))
        elif key in _SLOTS:
            setattr(parcel, _SLOTS[key], _value(value))
        else:
            parcel.extra[key] = _value(value)
    return parcel


def _value(value: Any) -> Any:
    if isinstance(value, list):
        return [_value(member) for member in value]
    if not isinstance(value, dict):
        return value
    tag = next(iter(value), "")
    if not tag.startswith("$"):
        return {key: _value(member) for key, member in value.items()}
    inside = value[tag]
    return {
        "$map": lambda: {key: _value(member) for key, member in inside.items()},
        "$int": lambda: int(inside),
        "$double": lambda: float(inside),
        "$time": lambda: _time(inside),
        "$binary": lambda: base64.b64decode(inside),
    }[tag]()


def _time(text: str) -> datetime:
    if text.startswith("0000"):
        # Python has no such year.
        return datetime.min.replace(tzinfo=timezone.utc)
    whole, _, part = text.rstrip("Z").partition(".")
    time = datetime.strptime(whole, "%Y-%m-%dT%H:%M:%S")
    return time.replace(microsecond=int(part.ljust(6, "0")) if part else 0, tzinfo=timezone.utc)


def write(parcel: Parcel) -> str:
    """Writes one line, without its end."""
    slots: Dict[str, Any] = {}
    for key, attribute in _SLOTS.items():
        value = getattr(parcel, attribute)
        if value is not None:
            slots[key] = _shown_time(value) if key in _TIMES else value
    for key, value in parcel.extra.items():
        slots[key] = _shown(value)
    if parcel.has_content or parcel.content is not None:
        slots["content"] = _shown(parcel.content)
    return json.dumps(slots, ensure_ascii=False, separators=(",", ":"))


def _shown(value: Any) -> Any:
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) > _BIGGEST:
        return {"$int": str(value)}
    if isinstance(value, bytes):
        return {"$binary": base64.b64encode(value).decode()}
    if isinstance(value, datetime):
        return {"$time": _shown_time(value)}
    if isinstance(value, list):
        return [_shown(member) for member in value]
    if isinstance(value, dict):
        members = {key: _shown(member) for key, member in value.items()}
        return {"$map": members} if next(iter(value), "").startswith("$") else members
    return value


def _shown_time(time: datetime) -> str:
    whole = f"{time.year:04}-" + time.strftime("%m-%dT%H:%M:%S")
    return whole + (f".{time.microsecond:06}" if time.microsecond else "") + "Z"
