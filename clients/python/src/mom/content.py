"""Reading maps of content: what is not there, or of another type, is left out."""

from __future__ import annotations

from typing import Any, Dict, List, Mapping, Optional


def text(content: Mapping[str, Any], key: str) -> str:
    """A string; empty if there is none."""
    found = content.get(key)
    return found if isinstance(found, str) else ""


def number(content: Mapping[str, Any], key: str) -> Optional[int]:
    """An int."""
    found = content.get(key)
    return found if isinstance(found, int) and not isinstance(found, bool) else None


def seconds(content: Mapping[str, Any], key: str) -> Optional[float]:
    """A duration of the wire, which is in ms."""
    found = number(content, key)
    return None if found is None else found / 1000


def names(content: Mapping[str, Any], key: str) -> List[str]:
    """A list of strings."""
    found = content.get(key)
    return [name for name in found if isinstance(name, str)] if isinstance(found, list) else []


def maps(content: Mapping[str, Any], key: str) -> List[Dict[str, Any]]:
    """A list of maps."""
    found = content.get(key)
    return [one for one in found if isinstance(one, dict)] if isinstance(found, list) else []
