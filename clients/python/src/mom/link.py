"""The link: what both sides have counted, so that a lost connection loses nothing."""

from __future__ import annotations

import hashlib
import hmac
from collections import deque
from typing import Any, Deque, Dict, List, Optional, Tuple

from .entry import Entry
from .login import _LINK, read_challenge
from .parcel import Parcel

_ACK_PARCELS, _ACK_BYTES = 256, 64 * 1024

_BASIS, _PRIME = 0x811C9DC5, 0x01000193
_CHECKSUMS = 3
"""The minor version from which on hubs take a checksum; those before refuse it."""


def _with(checksum: int, parcel: Parcel) -> int:
    """The checksum that goes on with this parcel."""
    number = parcel.id if parcel.id is not None else parcel.reference or 0
    return (checksum ^ number & 0xFFFFFFFF) * _PRIME & 0xFFFFFFFF


class Link:
    """The counts of one link, which outlives its connections.

    Each side counts the parcels of each direction, without a number on the wire, and makes a checksum of them, by which the
    other sees that both count the same. What outlives a loss is kept until the hub
    has said that it has read it; of the rest the place in the count, and whom to tell.
    """

    def __init__(self, name: str, secret: bytes, grace: float, checks: bool = False) -> None:
        self.name, self.grace = name, grace
        self.checks = checks
        """Whether the hub takes a checksum at a resume."""
        self.sent, self.read = 0, 0
        """How many parcels were written whole, and how many were read whole."""
        self._checksum, self._sent_checksum = _BASIS, _BASIS
        """Of what was read, and of what was sent before what is kept."""
        self._secret = secret
        self._kept: Deque[Entry] = deque()
        self.kept_bytes = 0
        """The size of what is kept; the queue holds messages back that would let it grow beyond what may wait."""
        self._said, self._bytes = 0, 0

    @staticmethod
    def of_reply(content: Dict[str, Any]) -> Optional[Link]:
        """Reads the reply to a login; `None` for a hub that gives no link."""
        told = content.get("link")
        if not isinstance(told, dict):
            return None
        name, secret, grace = told.get("id"), told.get("secret"), told.get("grace")
        if not isinstance(name, str) or not isinstance(secret, bytes) or not isinstance(grace, int):
            return None
        version = content.get("protocol")
        minor = version.get("minor") if isinstance(version, dict) else None
        return Link(name, secret, grace / 1000, isinstance(minor, int) and minor >= _CHECKSUMS)

    def wrote(self, entry: Entry) -> None:
        """Notes that the last byte of a parcel is written."""
        if not entry.counted:
            return
        self.sent += 1
        self._kept.append(entry)
        if entry.outlives:
            self.kept_bytes += entry.size

    def acknowledged(self, content: Dict[str, Any]) -> bool:
        """Forgets what the hub says that it has read; whether that can be, and is of the parcels that were sent."""
        read, checksum = content.get("read"), content.get("checksum")
        if not isinstance(read, int) or not self.sent - len(self._kept) <= read <= self.sent:
            return False
        while self.sent - len(self._kept) < read:
            entry = self._kept.popleft()
            self.kept_bytes -= entry.size if entry.outlives else 0
            self._sent_checksum = _with(self._sent_checksum, entry.parcel)
        return checksum is None or checksum == self._sent_checksum

    def count(self, parcel: Parcel) -> bool:
        """Counts a parcel of the hub; whether it is time to say so."""
        if parcel.family != "time":
            self.read += 1
            self._checksum = _with(self._checksum, parcel)
            self._bytes += parcel.size
        return self.read - self._said >= _ACK_PARCELS or self._bytes >= _ACK_BYTES

    def acknowledgement(self) -> Optional[Parcel]:
        """What to say of what was read; `None` if all of it is said."""
        if self.read == self._said:
            return None
        self._said, self._bytes = self.read, 0
        return Parcel("time", "ack", content={"read": self.read, "checksum": self._checksum})

    def answer(self, challenge: Parcel) -> Dict[str, Any]:
        """The content of the answer to the challenge of a resume."""
        hub, nonce = read_challenge(challenge, _LINK)
        signed = b"\0".join([_LINK, hub.encode(), self.name.encode(), nonce])
        self._said, self._bytes = self.read, 0
        content = {"proof": hmac.new(self._secret, signed, hashlib.sha256).digest(), "read": self.read}
        return {**content, "checksum": self._checksum} if self.checks else content

    @property
    def unread(self) -> List[Entry]:
        """What was sent, and may not have been read."""
        return list(self._kept)

    def resumed(self, content: Dict[str, Any]) -> Optional[Tuple[List[Entry], List[Entry]]]:
        """After a resume: what is to be sent again, in the old order, and what is not; `None` for a count that cannot be."""
        if not self.acknowledged(content):
            return None
        left, self._kept, self.kept_bytes = list(self._kept), deque(), 0
        self.sent = content["read"]
        return [entry for entry in left if entry.outlives], [entry for entry in left if not entry.outlives]
