"""What waits to be sent: the most urgent first, large parcels in pieces between which others may go."""

from __future__ import annotations

import asyncio
import time
from bisect import bisect_left, insort
from itertools import takewhile
from typing import Callable, Dict, List, Optional, Set

from .connection import PIECE, Connection, Pieces
from .entry import AGAIN, CONTROL, DATA, STOP, Entry
from .parcel import Parcel

_OPEN_STREAMS = 6


class Outbox:
    """The queue of one client, over its connections.

    It keeps to the table "What overtakes, replaces, outlives" in docs/PROTOCOL.md; tests/cases/send-queue.json are its cases.

    What may leave waits in `_queue`, the most urgent first. What must wait behind messages that were said before is kept
    out of it, at the head of `_behind`, until the last of those (`_ahead`) is gone; and behind it, in the order in which it
    was said, all else that was said since, as that must not overtake it. Stops, signs of life and what is sent again are
    never kept there, and renewals only behind what concerns their own token.
    """

    def __init__(self, dropped: Callable[[Entry, str], None], clock: Callable[[], float] = time.monotonic) -> None:
        self.most = 4 << 20
        """What may wait, in bytes; one parcel always may."""
        self.most_open = 8 << 20
        """What streams of chunks that are open together may announce, in bytes."""
        self.permits: Callable[[Entry], bool] = lambda entry: True
        """Whether an entry may leave now; `wake` when that may have changed."""
        self.held: Callable[[], None] = lambda: None
        """Called when the most urgent entry may not."""
        self.clock = clock
        self._dropped = dropped
        self._queue: List[Entry] = []
        self._ahead: Set[Entry] = set()
        self._behind: Dict[Entry, None] = {}
        self._latest: Dict[object, Entry] = {}
        self._streams: Set[Entry] = set()
        self._bytes, self._numbers = 0, 0
        self._is_lost = False
        self._wake, self._room = asyncio.Event(), asyncio.Event()

    @property
    def is_empty(self) -> bool:
        """Whether nothing waits."""
        return not self._queue and not self._behind

    def has_capacity(self, entry: Entry) -> bool:
        """Whether an entry may wait, too."""
        return not entry.needs_room or self._bytes == 0 or self._bytes + entry.size <= self.most

    async def capacity(self, entry: Entry) -> None:
        """Waits until an entry may wait, too, or will be dropped at once; of those that may be dropped the oldest make room."""
        if entry.delivery == "fleeting":
            for older in self._as_said():
                if self.has_capacity(entry):
                    break
                if older.lane == DATA and older.delivery == "fleeting" and older.pieces is None:
                    self._drop(older, "queue-full")
        while not self.has_capacity(entry) and not (self._is_lost and entry.perishes):
            self._room.clear()
            await self._room.wait()

    # Putting in.

    def put(self, entry: Entry) -> None:
        """Lets an entry wait, in the place of what it replaces; while the connection is lost, only what outlives that."""
        if self._is_lost and entry.perishes:
            self._dropped(entry, "lost")
            return
        self._numbers += 1
        entry.number = self._numbers
        self._insert(entry)

    def _insert(self, entry: Entry) -> None:
        place = self._supersede(entry)
        if place is not None:
            entry.number = place
        self._bytes += entry.size
        self._admit(entry)

    def _supersede(self, entry: Entry) -> Optional[int]:
        """Takes out what an entry replaces and withdraws; gives the place that it takes, if it takes one."""
        if entry.is_stop:
            return self._stop(entry)
        if entry.is_unstop:
            for older in self._urgent():
                if older.key == entry.key:
                    # It does not take its place, as it waits behind what was said meanwhile.
                    self._drop(older, "replaced")
        elif entry.delivery == "latest":
            return self._replace_latest(entry)
        return None

    def _stop(self, stop: Entry) -> Optional[int]:
        place = None
        for older in self._urgent():
            if older.is_unstop and older.overlaps(stop):
                self._drop(older, "withdrawn")
            elif older.key == stop.key and not older.is_awaited:
                # Nobody is told: the newer one says the same.
                self._take_out(older)
                place = older.number
        return place

    def _replace_latest(self, entry: Entry) -> Optional[int]:
        older, self._latest[entry.key] = self._latest.get(entry.key), entry
        if older is None or older.pieces is not None:
            return None
        self._drop(older, "replaced")
        return older.number if older.priority == entry.priority else None

    def _admit(self, entry: Entry) -> None:
        """Lets an entry leave when its turn comes, or keeps it behind what it must not overtake."""
        if entry.lane >= CONTROL:
            if entry.follows is not None and not self._behind:
                # Nothing of another lane could be overtaken.
                self._ahead = {other for other in self._queue if other.lane == DATA and entry.follows(other)}
            passes = bool(self._behind) and all(entry.passes(other) for other in self._behind)
            if self._ahead and not passes:
                self._behind[entry] = None
                return
        insort(self._queue, entry)
        self._wake.set()

    # Taking out.

    def _urgent(self) -> List[Entry]:
        """All among which there may be stops and unstops."""
        return [*takewhile(lambda entry: entry.lane < DATA, self._queue), *self._behind]

    def _as_said(self) -> List[Entry]:
        # What is behind was said later, also where it has the number of what it has replaced.
        return [*sorted(self._queue, key=lambda entry: entry.number), *self._behind]

    def _take_out(self, entry: Entry) -> None:
        """Takes an entry out, wherever it waits."""
        first = next(iter(self._behind), None)
        if entry in self._behind:
            del self._behind[entry]
        else:
            del self._queue[bisect_left(self._queue, entry)]
        if self._latest.get(entry.key) is entry:
            del self._latest[entry.key]
        self._bytes -= entry.size
        self._streams.discard(entry)
        self._room.set()
        self._ahead.discard(entry)
        if not self._ahead or first is entry:
            # What was to leave behind those messages need not wait any more, or is gone itself.
            again, self._behind, self._ahead = self._behind, {}, set()
            for other in again:
                self._admit(other)

    def _drop(self, entry: Entry, reason: str) -> None:
        self._take_out(entry)
        self._dropped(entry, reason)

    # Sending.

    async def send_all(self, connection: Connection, wrote: Callable[[Entry], None]) -> None:
        """Sends what waits and what comes, until the connection breaks or this is cancelled."""
        while True:
            entry = self._next()
            if entry is not None and entry.deadline is not None and entry.pieces is None and entry.deadline <= self.clock():
                self._drop(entry, "expired")
            elif entry is not None and self.permits(entry):
                await self._send(connection, entry, wrote)
            else:
                # What comes may be more urgent.
                self._wake.clear()
                if entry is not None:
                    self.held()
                await self._wake.wait()

    def wake(self) -> None:
        """More may leave than before."""
        self._wake.set()

    def _next(self) -> Optional[Entry]:
        """The most urgent of those that can go on, or begin."""
        return next((entry for entry in self._queue if entry in self._streams or self._may_begin(entry)), None)

    def _may_begin(self, entry: Entry) -> bool:
        announced = sum(other.size for other in self._streams)
        fits = len(self._streams) < _OPEN_STREAMS and announced + entry.size <= self.most_open
        return fits or not self._streams or not _is_cut(entry)

    async def _send(self, connection: Connection, entry: Entry, wrote: Callable[[Entry], None]) -> None:
        """Sends an entry whole, or a piece of it: then something more urgent may go before the next."""
        if entry.pieces is None:
            entry.pieces = Pieces(entry.body, connection.next_stream, not _is_cut(entry))
            self._streams.add(entry)
        piece = entry.pieces.next()
        if entry.pieces.done:
            # From here on the hub may read all of it, even if this side never hears that it was taken.
            self._take_out(entry)
            wrote(entry)
        await connection.write(piece)

    # Losing the connection, and what becomes of it.

    def lose(self, everything: bool = False) -> None:
        """The connection is lost: drops what is for the moment, or `everything`; what is left begins anew on the next one."""
        waiting, self._is_lost = self._as_said(), True
        self._queue, self._behind, self._ahead, self._bytes = [], {}, set(), 0
        self._latest, self._streams = {}, set()
        for entry in waiting:
            entry.begin_anew()
            if entry.parcel.family == "time":
                continue
            if everything or entry.perishes:
                self._dropped(entry, "lost")
                continue
            # What was half sent waits again as a whole: a newer one may replace it now.
            self._insert(entry)
        self._room.set()

    def open(self) -> None:
        """There is a connection again, of another link."""
        self._is_lost = False

    def resume(self, entries: List[Entry]) -> None:
        """The link goes on over another connection: what was sent and not read leaves first, in its old order."""
        self._is_lost = False
        # Stops that were sent give way to newer ones. What an earlier resume has begun to send again comes behind what it had sent.
        waiting = [entry for entry in self._queue if entry.lane in (STOP, AGAIN)]
        for entry in waiting:
            self._take_out(entry)
        for entry in [*entries, *waiting]:
            entry.leave_again()
            self.put(entry)
        resent = Entry(Parcel("time", "resent"))
        resent.lane = AGAIN
        self.put(resent)


def _is_cut(entry: Entry) -> bool:
    return not entry.is_whole and entry.size > 2 * PIECE
