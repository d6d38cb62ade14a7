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


class Link:
    """The counts of one link, which outlives its connections.

    Each side counts the parcels of each direction, without a number on the wire. What outlives a loss is kept until the hub
    has said that it has read it; of the rest the place in the count, and whom to tell.
    """

    def __init__(self, name: str, secret: bytes, grace: float) -> None:
        self.name, self.grace = name, grace
        self.sent, self.read = 0, 0
        """How many parcels were written whole, and how many were read whole."""
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
        return Link(name, secret, grace / 1000)

    def wrote(self, entry: Entry) -> None:
        """Notes that the last byte of a parcel is written."""
        if not entry.counted:
            return
        self.sent += 1
        self._kept.append(entry)
        if entry.outlives:
            self.kept_bytes += entry.size

    def acknowledged(self, read: Any) -> bool:
        """Forgets what the hub has read; whether that can be."""
        if not isinstance(read, int) or not self.sent - len(self._kept) <= read <= self.sent:
            return False
        while self.sent - len(self._kept) < read:
            entry = self._kept.popleft()
            self.kept_bytes -= entry.size if entry.outlives else 0
        return True

    def count(self, parcel: Parcel) -> bool:
        """Counts a parcel of the hub; whether it is time to say so."""
        if parcel.family != "time":
            self.read += 1
            self._bytes += parcel.size
        return self.read - self._said >= _ACK_PARCELS or self._bytes >= _ACK_BYTES

    def acknowledgement(self) -> Optional[Parcel]:
        """What to say of what was read; `None` if all of it is said."""
        if self.read == self._said:
            return None
        self._said, self._bytes = self.read, 0
        return Parcel("time", "ack", content={"read": self.read})

    def answer(self, challenge: Parcel) -> Dict[str, Any]:
        """The content of the answer to the challenge of a resume."""
        hub, nonce = read_challenge(challenge, _LINK)
        signed = b"\0".join([_LINK, hub.encode(), self.name.encode(), nonce])
        self._said, self._bytes = self.read, 0
        return {"proof": hmac.new(self._secret, signed, hashlib.sha256).digest(), "read": self.read}

    @property
    def unread(self) -> List[Entry]:
        """What was sent, and may not have been read."""
        return list(self._kept)

    def resumed(self, read: Any) -> Optional[Tuple[List[Entry], List[Entry]]]:
        """After a resume: what is to be sent again, in the old order, and what is not; `None` for a count that cannot be."""
        if not self.acknowledged(read):
            return None
        left, self._kept, self.kept_bytes = list(self._kept), deque(), 0
        self.sent = read
        return [entry for entry in left if entry.outlives], [entry for entry in left if not entry.outlives]
