"""The HTTP tunnel: for networks where only requests of HTTP get through."""

from __future__ import annotations

import asyncio
import ssl
from typing import Dict, Optional, Tuple

from .address import Address
from .errors import ConnectionDownError, LocalError
from .transport import Transport, Trust, dial

_BEFORE_LOGIN, _MOST_UP = 16 * 1024, 128 * 1024
_WINDOW, _LONGEST, _PATIENCE = 64 * 1024, 20.0, 30.0
_HELD_BACK = 1.0
_AGAIN = (0.05, 0.25, 1.0, 3.0)
_FAILED = (OSError, EOFError, asyncio.TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, ValueError)


class Requests:
    """Requests one after the other, over one connection as long as it lasts."""

    def __init__(self, address: Address, trust: Trust, context: Optional[ssl.SSLContext]) -> None:
        self._address, self._trust, self._context = address, trust, context
        self._reader: Optional[asyncio.StreamReader] = None
        self._writer: Optional[asyncio.StreamWriter] = None
        self._left: Optional[int] = 0

    async def open(self, method: str, path: str, body: bytes = b"") -> Tuple[int, Dict[str, str]]:
        """Asks, and waits for the head of the answer."""
        if self._reader is None or self._writer is None:
            self._reader, self._writer = await dial(self._address, self._trust, self._context)
        head = f"{method} {path} HTTP/1.1\r\nHost: {self._address.authority}\r\nCache-Control: no-store\r\n"
        kind = "Content-Type: application/octet-stream\r\n" if body else ""
        length = f"Content-Length: {len(body)}\r\n" if body or method == "POST" else ""
        self._writer.write((head + kind + length + "\r\n").encode() + body)
        await self._writer.drain()
        lines = (await self._reader.readuntil(b"\r\n\r\n")).decode("latin-1").split("\r\n")
        headers = {}
        for line in lines[1:]:
            key, _, value = line.partition(":")
            headers[key.lower()] = value.strip()
        chunked = "chunked" in headers.get("transfer-encoding", "")
        self._left = None if chunked else int(headers.get("content-length", "0"))
        return int(lines[0].split(" ")[1]), headers

    async def more(self) -> bytes:
        """More of the answer's body; nothing at its end."""
        assert self._reader is not None
        if self._left is None:
            size = int((await self._reader.readuntil(b"\r\n")).split(b";")[0], 16)
            data = await self._reader.readexactly(size) if size else b""
            await self._reader.readuntil(b"\r\n")
            self._left = 0 if not size else None
            return data
        data = await self._reader.read(self._left) if self._left else b""
        if self._left and not data:
            raise EOFError("the answer was cut off")
        self._left -= len(data)
        return data

    async def whole(self, method: str, path: str, body: bytes = b"") -> Tuple[int, Dict[str, str], bytes]:
        """Asks, and waits for all of the answer."""
        status, headers = await self.open(method, path, body)
        said = b""
        while data := await self.more():
            said += data
        return status, headers, said

    def drop(self) -> None:
        """The next request takes another connection."""
        if self._writer is not None:
            self._writer.transport.abort()
        self._reader = self._writer = None


async def open_tunnel(address: Address, trust: Trust, context: Optional[ssl.SSLContext]) -> Transport:
    """Opens a tunnel to a hub."""
    up = Requests(address, trust, context)
    try:
        status, headers, said = await asyncio.wait_for(up.whole("POST", "/tunnel"), _PATIENCE)
        if status != 201 or len(headers.get("mom-tunnel", "")) != 32:
            raise ConnectionDownError(f"{address}: {status} {said[:200].decode('utf-8', 'replace')}")
    except LocalError:
        up.drop()
        raise
    except _FAILED as error:
        up.drop()
        raise ConnectionDownError(f"{address}: {error}") from error
    return TunnelTransport(up, Requests(address, trust, context), headers["mom-tunnel"], address.polled)


class TunnelTransport(Transport):
    """Some requests bring bytes up, others bring them down; both streams are counted, as requests may be repeated."""

    def __init__(self, up: Requests, down: Requests, tunnel: str, polled: bool) -> None:
        self._id, self._polled = tunnel, polled
        self._up, self._at = bytearray(), 0
        """What was written and is not taken, and where in the stream it begins."""
        self._down, self._arrived, self._told, self._expected = bytearray(), 0, 0, 0
        self._ended, self._finished = False, False
        self._broken: Optional[str] = None
        self._change = asyncio.Event()
        self._tasks = [asyncio.ensure_future(self._bring_up(up)), asyncio.ensure_future(self._bring_down(down))]

    async def _changes(self, timeout: Optional[float] = None) -> bool:
        try:
            await asyncio.wait_for(self._change.wait(), timeout)
        except asyncio.TimeoutError:
            return False
        return True

    def _changed(self) -> None:
        # All who wait look again. Nobody yields between looking and waiting, so nobody misses it.
        self._change.set()
        self._change = asyncio.Event()

    async def read(self) -> bytes:
        while not self._down:
            if self._broken is not None:
                raise ConnectionResetError(self._broken)
            if self._ended:
                return b""
            await self._changes()
        data = bytes(self._down)
        self._down.clear()
        self._changed()
        return data

    async def write(self, data: bytes) -> None:
        self._up += data
        self._changed()
        while len(self._up) > _WINDOW and self._broken is None:
            await self._changes()
        if self._broken is not None or self._ended:
            raise ConnectionResetError(self._broken or "the hub has closed")

    async def close(self) -> None:
        self._finished = True
        self._changed()
        await asyncio.wait(self._tasks, timeout=1)
        self.abort()

    def abort(self) -> None:
        for task in self._tasks:
            task.cancel()
        self._break_off("it was closed here")

    def _break_off(self, why: str) -> None:
        self._broken = self._broken or f"the tunnel broke off: {why}"
        self._changed()

    async def _bring_up(self, requests: Requests) -> None:
        most, failures = _BEFORE_LOGIN, iter(_AGAIN)
        try:
            while True:
                while not self._up and not self._finished and self._arrived - self._told < _WINDOW // 4:
                    await self._changes()
                data, here = bytes(self._up[:most]), self._arrived
                end = self._finished and len(data) == len(self._up)
                path = f"/tunnel/{self._id}?at={self._at}&ack={here}" + ("&end=1" if end else "")
                try:
                    status, headers, _ = await asyncio.wait_for(requests.whole("POST", path, data), _PATIENCE)
                    if status in (502, 504):
                        raise EOFError("a proxy does not pass it on")
                except (*_FAILED, LocalError) as error:
                    requests.drop()
                    pause = next(failures, None)
                    if pause is None:
                        return self._break_off(str(error) or type(error).__name__)
                    await asyncio.sleep(pause)
                    continue
                failures, self._told = iter(_AGAIN), max(self._told, here)
                if len(headers.get("mom-tunnel", "")) == 32:
                    self._id, most = headers["mom-tunnel"], _MOST_UP
                self._expected = max(self._expected, int(headers.get("mom-sent", "0")))
                taken = int(headers.get("mom-taken", "-1"))
                if status == 503:
                    await asyncio.sleep(_AGAIN[0])
                elif status not in (200, 409) or not self._at <= taken <= self._at + len(self._up):
                    return self._break_off(f"the hub answers {status}")
                else:
                    del self._up[: taken - self._at]
                    self._at = taken
                self._changed()
                if end and status == 200:
                    return
        finally:
            requests.drop()

    async def _bring_down(self, requests: Requests) -> None:
        failures = iter(_AGAIN)
        try:
            while True:
                known, before = self._id, self._arrived
                wait = f"&wait={int(_LONGEST * 1000)}" if self._polled else ""
                self._told = max(self._told, self._arrived)
                try:
                    path = f"/tunnel/{known}?at={self._arrived}{wait}"
                    status, headers = await asyncio.wait_for(requests.open("GET", path), _PATIENCE)
                    if status == 200 and "mom-end" in headers:
                        self._ended = True
                    elif status == 404:
                        await self._read_all(requests)
                        await self._other_id(known)
                    elif status != 200:
                        raise EOFError(f"the hub answers {status}")
                    else:
                        await self._take_in(requests)
                    failures = iter(_AGAIN)
                except (*_FAILED, LocalError) as error:
                    requests.drop()
                    if self._arrived > before:
                        # It was lost on the way, and not refused.
                        failures = iter(_AGAIN)
                    pause = next(failures, None)
                    if pause is None:
                        return self._break_off(str(error) or type(error).__name__)
                    await asyncio.sleep(pause)
                self._changed()
                if self._ended:
                    return
        finally:
            requests.drop()

    async def _read_all(self, requests: Requests) -> None:
        while await asyncio.wait_for(requests.more(), _PATIENCE):
            pass

    async def _other_id(self, known: str) -> None:
        """Waits for the other id that the hub gives at login; without one the tunnel has ended."""
        loop = asyncio.get_running_loop()
        until = loop.time() + 10
        while self._id == known and not self._ended:
            left = until - loop.time()
            if left <= 0 or not await self._changes(left):
                self._ended = self._id == known

    async def _take_in(self, requests: Requests) -> None:
        while data := await self._next(requests):
            self._down += data
            self._arrived += len(data)
            self._changed()
            while len(self._down) > 4 * _WINDOW:
                await self._changes()

    async def _next(self, requests: Requests) -> bytes:
        """More of the stream; nothing at its end, or when a proxy holds it back: then it is asked for piece by piece."""
        more = asyncio.ensure_future(requests.more())
        try:
            if self._polled:
                return await asyncio.wait_for(more, _PATIENCE)
            missing = False
            for _ in range(int(_PATIENCE / _HELD_BACK)):
                done, _pending = await asyncio.wait([more], timeout=_HELD_BACK)
                if done:
                    return more.result()
                if missing and self._arrived < self._expected:
                    self._polled = True
                    requests.drop()
                    return b""
                # What the hub has said that it has sent has a second to arrive.
                missing = self._arrived < self._expected
            raise asyncio.TimeoutError
        finally:
            more.cancel()
