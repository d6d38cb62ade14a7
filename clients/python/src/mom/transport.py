"""What carries the bytes of a connection: TCP, TLS on it, a WebSocket."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import socket
import ssl
from typing import Any, Dict, Optional, Tuple, Union
from urllib.parse import SplitResult, unquote, urlsplit
from urllib.request import getproxies, proxy_bypass

from .address import Address
from .errors import ConnectionDownError, LocalError

Trust = Union[None, str, ssl.SSLContext]
"""Which hub is the right one over TLS: `None` = one that this system trusts, or that the address pins; a string = the
fingerprint of its certificate (`sha256:…`); a context of `ssl` = whatever that trusts, and a certificate to show."""

_NOTSENT_LOWAT = getattr(socket, "TCP_NOTSENT_LOWAT", 25)
_WAITING = 64 * 1024


class Transport:
    """Carries bytes both ways."""

    async def read(self) -> bytes:
        """What has arrived; nothing at the end."""
        raise NotImplementedError

    async def write(self, data: bytes) -> None:
        """Passes bytes on; waits while too many wait."""
        raise NotImplementedError

    async def close(self) -> None:
        """Ends it."""
        raise NotImplementedError

    def abort(self) -> None:
        """Ends it at once, without a word."""
        raise NotImplementedError


class StreamTransport(Transport):
    """TCP, or TLS on it."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self._writer = reader, writer
        stream = writer.get_extra_info("socket")
        writer.transport.set_write_buffer_limits(high=_WAITING)
        if stream is not None:
            bound_waiting(stream)

    async def read(self) -> bytes:
        return await self._reader.read(256 * 1024)

    async def write(self, data: bytes) -> None:
        self._writer.write(data)
        await self._writer.drain()

    async def close(self) -> None:
        self._writer.close()
        try:
            await asyncio.wait_for(self._writer.wait_closed(), 1)
        except (OSError, asyncio.TimeoutError):
            self.abort()

    def abort(self) -> None:
        self._writer.transport.abort()


class WebSocketTransport(Transport):
    """A WebSocket, by the package `websockets`."""

    def __init__(self, link: Any) -> None:
        self._link = link

    async def read(self) -> bytes:
        from websockets.exceptions import ConnectionClosed

        try:
            data = await self._link.recv()
        except ConnectionClosed:
            return b""
        if isinstance(data, str):
            raise LocalError("bad-frame", "the hub sent text over a WebSocket of the binary form")
        return bytes(data)

    async def write(self, data: bytes) -> None:
        from websockets.exceptions import ConnectionClosed

        try:
            await self._link.send(data)
        except ConnectionClosed as error:
            raise ConnectionResetError(str(error)) from None

    async def close(self) -> None:
        await self._link.close()

    def abort(self) -> None:
        self._link.transport.abort()


def bound_waiting(stream: Any) -> None:
    """Sends at once, and lets little wait in the kernel, so that what is urgent does not wait behind it."""
    try:
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        stream.setsockopt(socket.IPPROTO_TCP, _NOTSENT_LOWAT, _WAITING)
    except OSError:
        pass  # Not every system has the second one; it only makes urgent things faster.


def tls_context(address: Address, trust: Trust) -> Optional[ssl.SSLContext]:
    """What checks the hub's certificate; none without TLS."""
    if not address.tls:
        return None
    if isinstance(trust, ssl.SSLContext):
        return trust
    context = ssl.create_default_context()
    if _pin(address, trust):
        # The fingerprint is compared instead, when the hub has shown its certificate.
        context.check_hostname = False
        context.verify_mode = ssl.CERT_NONE
    return context


def check_pin(address: Address, trust: Trust, tls: Any) -> None:
    """Refuses a hub with another certificate than the one that is pinned."""
    pin = _pin(address, trust)
    if not address.tls or not pin:
        return
    shown = hashlib.sha256((tls.getpeercert(True) if tls else None) or b"").hexdigest()
    if shown != pin:
        raise LocalError(
            "bad-login", f"{address} does not have the pinned certificate, but sha256:{shown}; nothing was sent"
        )


def _pin(address: Address, trust: Trust) -> Optional[str]:
    pin = trust if isinstance(trust, str) else address.pin if trust is None else None
    return pin.lower().split(":")[-1] if pin else None


def has_websockets() -> bool:
    """Whether the optional package for WebSockets is installed."""
    try:
        import websockets.asyncio.client  # noqa: F401
    except ImportError:
        return False
    return True


async def dial(
    address: Address, trust: Trust, context: Optional[ssl.SSLContext]
) -> Tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """Connects, with TLS through the proxy that the environment names (`HTTPS_PROXY`, `NO_PROXY`), and checks who is there."""
    name, proxy = address.host if context else None, _proxy(address)
    if proxy is None:
        reader, writer = await asyncio.open_connection(
            address.host, address.port, ssl=context, server_hostname=name, limit=1 << 20
        )
    else:
        through = await _through(proxy, address)
        reader, writer = await asyncio.open_connection(sock=through, ssl=context, server_hostname=name, limit=1 << 20)
    try:
        check_pin(address, trust, writer.get_extra_info("ssl_object"))
    except LocalError:
        writer.transport.abort()
        raise
    return reader, writer


def _proxy(address: Address) -> Optional[SplitResult]:
    """The proxy on the way; none without TLS, as it could read along."""
    url = getproxies().get("https") if address.tls else None
    if not url or proxy_bypass(address.host):
        return None
    proxy = urlsplit(url if "://" in url else f"http://{url}")
    if proxy.scheme != "http" or not proxy.hostname:
        raise LocalError("not-taken", f"HTTPS_PROXY is {proxy.scheme}://{proxy.hostname}: only http:// proxies are supported")
    return proxy


async def _through(proxy: SplitResult, address: Address) -> socket.socket:
    """Has a proxy connect to the hub."""
    loop, port = asyncio.get_running_loop(), proxy.port or 80
    found = await loop.getaddrinfo(proxy.hostname, port, type=socket.SOCK_STREAM)
    stream = socket.socket(found[0][0], socket.SOCK_STREAM)
    try:
        stream.setblocking(False)
        await loop.sock_connect(stream, found[0][4])
        head = f"CONNECT {address.authority} HTTP/1.1\r\nHost: {address.authority}\r\n"
        if proxy.username:
            pair = f"{unquote(proxy.username)}:{unquote(proxy.password or '')}"
            head += f"Proxy-Authorization: Basic {base64.b64encode(pair.encode()).decode()}\r\n"
        await loop.sock_sendall(stream, (head + "\r\n").encode())
        said = b""
        while not said.endswith(b"\r\n\r\n"):
            # One byte at a time, as what follows is not ours to read.
            byte = await loop.sock_recv(stream, 1)
            said += byte
            if not byte or len(said) > 16_384:
                raise ConnectionDownError(f"{address}: the proxy {proxy.hostname}:{port} does not answer")
        status = said.split(b"\r\n")[0].decode("latin-1").split(" ", 1)[-1]
        if not status.startswith("2"):
            raise ConnectionDownError(f"{address}: the proxy {proxy.hostname}:{port} answers {status}")
        return stream
    except BaseException:
        stream.close()
        raise


async def open_websocket(address: Address, trust: Trust, context: Optional[ssl.SSLContext]) -> Transport:
    """Connects through a WebSocket."""
    if not has_websockets():
        raise LocalError("not-taken", f"{address} needs the package websockets: pip install 'mom-client[web]'")
    from websockets.asyncio.client import connect
    from websockets.exceptions import WebSocketException
    from websockets.typing import Subprotocol

    scheme, proxy = "wss" if address.tls else "ws", _proxy(address)
    through: Dict[str, Any] = {"sock": await _through(proxy, address)} if proxy else {}
    try:
        link = await connect(
            f"{scheme}://{address.authority}/mom",
            ssl=context,
            subprotocols=[Subprotocol("mom.bin.v1")],
            compression=None,
            max_size=None,
            ping_interval=None,
            open_timeout=None,
            close_timeout=1,
            # It is on the way already.
            proxy=None,
            **through,
        )
    except WebSocketException as error:
        raise ConnectionDownError(f"{address}: {error}") from error
    bound_waiting(link.transport.get_extra_info("socket"))
    try:
        check_pin(address, trust, link.transport.get_extra_info("ssl_object"))
    except LocalError:
        link.transport.abort()
        raise
    return WebSocketTransport(link)
