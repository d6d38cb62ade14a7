"""The doors of a hub: what opens each of them."""

from __future__ import annotations

from .address import TCP, TUNNEL, WEBSOCKET, Address
from .errors import ConnectionDownError, LocalError
from .transport import StreamTransport, Transport, Trust, dial, open_websocket, tls_context
from .tunnel import open_tunnel


async def open_transport(address: Address, trust: Trust) -> Transport:
    """Connects through one door."""
    context = tls_context(address, trust)
    try:
        if address.door == WEBSOCKET:
            return await open_websocket(address, trust, context)
        if address.door == TUNNEL:
            return await open_tunnel(address, trust, context)
        if address.door != TCP:
            raise LocalError("bad-slot", f"{address} is not a single door: try those of Address.doors")
        return StreamTransport(*await dial(address, trust, context))
    except (OSError, EOFError) as error:
        raise ConnectionDownError(f"{address}: {error}") from error
