"""What waits to be sent: the most urgent first, large parcels in pieces between which others may go."""

from __future__ import annotations

import asyncio
import heapq
from typing import Callable, Dict, List, Optional, Tuple

from . import binary
from .connection import Connection, Pieces
from .parcel import Parcel

STOP, CONTROL, AGAIN, DATA = range(4)
"""The lanes, in the order in which they leave."""

_FIRST, _LAST = 1000, -1000
_OPEN_STREAMS = 6


class Entry:
    """A parcel that waits, or that was sent and is not acknowledged."""

    def __init__(self, parcel: Parcel, delivery: str = "reliable", guarded: bool = False) -> None:
        self.parcel = parcel
        self.body = binary.encode(parcel)
        self.size = len(self.body)
        self.delivery = delivery
        """The class, that of the channel where the parcel names none."""
        self.guarded = guarded
        """Whether it is valid only under the ownership under which it was said."""
        self.counted = parcel.family != "time"
        """Whether it counts for the link."""
        self.lane, self.priority = _place(parcel)
        self.number = 0
        """Its place among those of equal urgency."""
        self.deadline: Optional[float] = None
        """When it is worthless, by the loop's clock."""
        self.pieces: Optional[Pieces] = None
        """What is left of it, once some of it is sent."""
        self.replaced = False
        """Whether a newer one has taken its place."""

    @property
    def is_reliable(self) -> bool:
        """Whether it is sent again after a lost connection."""
        return self.delivery == "reliable" and not self.guarded

    @property
    def rank(self) -> Tuple[int, int]:
        """Lower leaves sooner."""
        return self.lane, -self.priority

    def __lt__(self, other: Entry) -> bool:
        return (self.rank, self.number) < (other.rank, other.number)


def _place(parcel: Parcel) -> Tuple[int, int]:
    if parcel.family == "message":
        return (STOP, 0) if parcel.name == "stop" else (DATA, parcel.priority or 0)
    if parcel.family == "time" or parcel.is_("token", "renew"):
        return CONTROL, 0
    # What gives something up leaves after all that was said before.
    return DATA, _LAST if parcel.name in ("release", "leave", "logout", "uninhibit") else _FIRST


class Outbox:
    """The queue of one client, over its connections."""

    def __init__(self, dropped: Callable[[Entry, str], None]) -> None:
        self.most = 4 << 20
        """What may wait, in bytes; one parcel always may."""
        self._dropped = dropped
        self._heap: List[Entry] = []
        self._bytes, self._numbers = 0, 0
        self._partial: List[Entry] = []
        self._newest: Dict[Tuple[Optional[str], str, int], Entry] = {}
        self._wake, self._room = asyncio.Event(), asyncio.Event()

    def has_capacity(self, entry: Entry) -> bool:
        """Whether an entry may wait, too."""
        return self._bytes == 0 or self._bytes + entry.size <= self.most

    async def capacity(self, entry: Entry) -> None:
        """Waits until an entry may wait, too; of those that may be dropped the oldest make room."""
        if entry.delivery == "fleeting":
            for older in sorted(self._heap):
                if self.has_capacity(entry):
                    break
                if older.delivery == "fleeting" and older.pieces is None:
                    self._remove(older, "queue-full")
        while not self.has_capacity(entry):
            self._room.clear()
            await self._room.wait()

    def put(self, entry: Entry) -> None:
        """Lets an entry wait. A newer one of class `latest` takes the place of the older, a `stop` that of the stop."""
        self._numbers += 1
        entry.number = self._numbers
        if entry.parcel.family == "message" and (entry.lane == STOP or entry.delivery == "latest"):
            key = (entry.parcel.context, entry.parcel.name, entry.priority)
            older = self._newest.get(key)
            if older is not None and older.pieces is None:
                entry.number = older.number
                self._remove(older, "replaced")
            self._newest[key] = entry
        self._push(entry)

    def put_again(self, entries: List[Entry]) -> None:
        """Lets entries wait that were sent and not read: before all that was not sent, in their old order."""
        # What an earlier resume has begun to send again comes behind what it had sent.
        left = sorted(entry for entry in self._heap if entry.lane == AGAIN)
        self._heap = [entry for entry in self._heap if entry.lane != AGAIN]
        heapq.heapify(self._heap)
        self._bytes -= sum(entry.size for entry in left)
        for entry in entries + left:
            self._numbers += 1
            entry.number, entry.pieces, entry.deadline = self._numbers, None, None
            entry.lane, entry.priority = AGAIN, 0
            self._push(entry)

    def _push(self, entry: Entry) -> None:
        heapq.heappush(self._heap, entry)
        self._bytes += entry.size
        self._wake.set()

    def _pop(self) -> Entry:
        entry = heapq.heappop(self._heap)
        self._bytes -= entry.size
        key = (entry.parcel.context, entry.parcel.name, entry.priority)
        if self._newest.get(key) is entry:
            del self._newest[key]
        self._room.set()
        return entry

    def _remove(self, entry: Entry, reason: str) -> None:
        self._heap = [other for other in self._heap if other is not entry]
        heapq.heapify(self._heap)
        self._bytes -= entry.size
        entry.replaced = True
        self._room.set()
        self._dropped(entry, reason)

    async def send_all(self, connection: Connection, wrote: Callable[[Entry], None]) -> None:
        """Sends what waits and what comes, until the connection breaks or this is cancelled."""
        loop = asyncio.get_running_loop()
        self._partial = []
        while True:
            while not self._heap:
                self._wake.clear()
                await self._wake.wait()
            entry = self._pop()
            if entry.deadline is not None and entry.pieces is None and entry.deadline <= loop.time():
                self._dropped(entry, "expired")
                continue
            await self._send(connection, entry, wrote)

    async def _send(self, connection: Connection, entry: Entry, wrote: Callable[[Entry], None]) -> None:
        """Sends an entry, or as much of it as nothing more urgent waits for."""
        if entry.pieces is None:
            entry.pieces = Pieces(entry.body, connection.next_stream)
        else:
            self._partial.remove(entry)
        while not entry.pieces.done:
            piece = entry.pieces.next()
            if entry.pieces.done:
                # From here on the hub may read all of it, even if this side never hears that it was taken.
                wrote(entry)
            try:
                await connection.write(piece)
            except BaseException:
                if not entry.pieces.done:
                    # It is sent as a whole when there is another connection.
                    self._push(entry)
                raise
            urgent = bool(self._heap) and self._heap[0].rank < entry.rank
            if urgent and not entry.pieces.done and len(self._partial) < _OPEN_STREAMS:
                self._partial.append(entry)
                self._push(entry)
                return

    def lose(self, which: Callable[[Entry], bool], reason: str) -> None:
        """Drops what waits and is so; what is left begins anew on the next connection."""
        entries, self._heap = sorted(self._heap), []
        self._partial, self._bytes = [], 0
        for entry in entries:
            entry.pieces = None
            if entry.parcel.family == "time":
                continue
            if which(entry):
                self._dropped(entry, reason)
            else:
                self._push(entry)
        kept = set(map(id, self._heap))
        self._newest = {key: entry for key, entry in self._newest.items() if id(entry) in kept}
        self._room.set()
