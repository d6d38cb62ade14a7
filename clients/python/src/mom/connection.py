"""One connection to a hub, without a login: parcels as they are."""

from __future__ import annotations

import asyncio
import time
import zlib
from collections import deque
from typing import Any, Callable, Deque, Dict, Optional

from . import binary
from .address import Address
from .errors import ConnectionDownError, LocalError
from .parcel import Parcel
from .doors import open_transport
from .transport import Transport, Trust

PIECE = 16 * 1024
"""Larger parcels are cut into chunks of this size, so that others can go between them."""

_LEVEL = 3
"""Of zlib: it takes microseconds for a message."""

_BROKEN = (OSError, EOFError, asyncio.IncompleteReadError)


def _slept() -> float:
    """For how many seconds the machine has slept since its start, where that can be known."""
    boot = getattr(time, "CLOCK_BOOTTIME", None)
    return 0.0 if boot is None else time.clock_gettime(boot) - time.clock_gettime(time.CLOCK_MONOTONIC)


class Connection:
    """One connection to a hub, without a login: for tests, and for programs that speak the protocol themselves.

    Everything else is done by `mom.Client`, which is made of one such connection after another.
    """

    def __init__(self, transport: Transport, numbers: Optional[Dict[int, str]] = None) -> None:
        self.decoder = binary.Decoder(numbers)
        self.heard = 0.0
        """When something arrived last, by the loop's clock."""
        self.gone = float("inf")
        """For how many seconds the connection lives without a sign of life."""
        self.said: Callable[[], float] = lambda: float("inf")
        """When something left last, by the loop's clock."""
        self._slept = _slept()
        self._transport = transport
        self._parcels: Deque[Parcel] = deque()
        self._streams = 0
        self._deflate: Optional[Any] = None
        self._mark = b""

    def take_stream(self) -> None:
        """The hub may compress what it says from here on: the login asks for `stream-deflate`."""
        self.decoder.takes_stream = True

    def begin_stream(self) -> None:
        """Compresses what is written from here on, as the hub has agreed to."""
        self._deflate = zlib.compressobj(_LEVEL)
        self._mark = binary.STREAM_MARK

    @classmethod
    async def open(cls, address: str, *, trust: Trust = None, timeout: float = 10) -> Connection:
        """Connects through the door of an address, and waits for the hub's preface.

        `AddressError`, `ConnectionDownError`, `LocalError` for a hub that is none or not the one meant.
        """
        return await cls.to(Address.parse(address), trust, timeout=timeout)

    @classmethod
    async def to(
        cls, address: Address, trust: Trust = None, numbers: Optional[Dict[int, str]] = None, timeout: float = 10
    ) -> Connection:
        """The same for an address that was read; `numbers` are those of contexts, known from earlier connections."""
        try:
            return await asyncio.wait_for(cls._to(address, trust, numbers), timeout)
        except asyncio.TimeoutError:
            raise ConnectionDownError(f"{address}: no answer within {timeout:g} s") from None

    @classmethod
    async def _to(cls, address: Address, trust: Trust, numbers: Optional[Dict[int, str]]) -> Connection:
        transport = await open_transport(address, trust)
        connection = cls(transport, numbers)
        try:
            await transport.write(binary.PREFACE)
            # A server that accepts connections need not be a hub: its preface says so.
            while not connection.decoder.began:
                if not await connection._arrive():
                    raise ConnectionDownError(f"{address}: closed before anything was received")
        except _BROKEN as error:
            transport.abort()
            raise ConnectionDownError(f"{address}: {error}") from error
        except BaseException:
            transport.abort()
            raise
        return connection

    async def _arrive(self) -> bool:
        data = await self._transport.read()
        now = asyncio.get_running_loop().time()
        # What lies there after a halt of the whole program was said before, and the hub has given the link up: a device must not move by it.
        slept, self._slept = _slept() - self._slept, _slept()
        if self.heard and now - min(self.heard, self.said()) + slept >= self.gone:
            raise ConnectionDownError("this program was suspended for longer than a connection lasts")
        self.heard = now
        for parcel, size in self.decoder.feed(data) if data else ():
            parcel.size = size
            self._parcels.append(parcel)
        return bool(data)

    async def receive(self) -> Optional[Parcel]:
        """The next parcel; `None` at the end of the connection. `ConnectionDownError` for one that broke."""
        while not self._parcels:
            try:
                if not await self._arrive():
                    return None
            except _BROKEN as error:
                raise ConnectionDownError(str(error) or type(error).__name__) from error
        return self._parcels.popleft()

    async def send_parcel(self, parcel: Parcel) -> None:
        """Sends a parcel as it is, in chunks if it is large."""
        body = binary.encode(parcel)
        pieces = Pieces(body, self.next_stream)
        while not pieces.done:
            await self.write(pieces.next())

    def next_stream(self) -> int:
        """A number for a stream of chunks, used by no other."""
        self._streams += 1
        return self._streams

    async def write(self, data: bytes) -> None:
        """Passes bytes on; waits while too many wait. `ConnectionDownError` for a connection that broke."""
        if self._deflate is not None and data:
            # Each write is flushed: nothing waits for what comes later.
            packed = self._deflate.compress(data) + self._deflate.flush(zlib.Z_SYNC_FLUSH)
            data, self._mark = self._mark + packed, b""
        try:
            await self._transport.write(data)
        except _BROKEN as error:
            raise ConnectionDownError(str(error) or type(error).__name__) from error

    async def close(self) -> None:
        """Ends the connection."""
        try:
            await self._transport.close()
        except (*_BROKEN, LocalError):
            self._transport.abort()

    def abort(self) -> None:
        """Ends the connection at once."""
        self._transport.abort()


class Pieces:
    """The frames of one parcel: one, or chunks."""

    def __init__(self, body: bytes, stream: Callable[[], int], whole: bool = False) -> None:
        self._body, self._at, self._next_stream = body, 0, stream
        self._whole = whole or len(body) <= 2 * PIECE
        self._stream: Optional[int] = None
        self.done = False
        """Whether all of it was given."""

    def next(self) -> bytes:
        """The next frame."""
        body = self._body
        if self._whole:
            self.done = True
            return binary.frame(body)
        if self._stream is None:
            self._stream = self._next_stream()
        piece = body[self._at : self._at + PIECE]
        first, self._at = self._at == 0, self._at + len(piece)
        self.done = self._at >= len(body)
        return binary.chunk(self._stream, piece, len(body), first, self.done)
