"""Addresses of hubs, and the doors that one may lead to."""

from __future__ import annotations

import ipaddress
import re
from dataclasses import dataclass, replace
from typing import Dict, List, Optional, Tuple

from .errors import AddressError

DEFAULT_PORT = 7666
"""The port of the hub where an address names none."""

TCP, WEBSOCKET, TUNNEL, ANY = "tcp", "websocket", "tunnel", "any"

_SCHEMES: Dict[str, Tuple[str, bool, int]] = {
    "bin": (TCP, False, DEFAULT_PORT),
    "bins": (TCP, True, DEFAULT_PORT),
    "ws": (WEBSOCKET, False, 80),
    "wss": (WEBSOCKET, True, 443),
    "http": (TUNNEL, False, 80),
    "https": (TUNNEL, True, 443),
    "mom": (ANY, False, DEFAULT_PORT),
    "moms": (ANY, True, DEFAULT_PORT),
}
_HOST = re.compile(r"[\w.-]+\Z")
_PIN = re.compile(r"(?:sha256:)?([0-9a-fA-F]{64})\Z")


@dataclass(frozen=True)
class Address:
    """Where a hub is and how to speak to it.

    `bin://host:port` (TCP), `ws://host:port` (WebSocket) and `http://host:port` (tunnel), with TLS `bins://`, `wss://` and
    `https://`, which may end in `?pin=sha256:` and the fingerprint of the hub's certificate. `mom://host` stands for all
    of these doors that the login permits, `moms://host` for those with TLS.
    """

    door: str
    """`tcp`, `websocket`, `tunnel`, or `any`."""
    tls: bool
    """With TLS."""
    host: str
    """A name or number of the host."""
    port: int
    """The TCP port."""
    path: Optional[str] = None
    """A context at that hub, if the address names one."""
    pin: Optional[str] = None
    """The SHA-256 of the certificate that the hub has to show, in hexadecimal digits."""
    polled: bool = False
    """A tunnel whose answers are whole ones, for proxies that hold streams back."""
    port_given: bool = True
    """Whether the address names the port itself."""

    @staticmethod
    def parse(text: str) -> Address:
        """Reads an address; `AddressError` for what is none."""
        scheme, found, rest = text.partition("://")
        if not found:
            raise AddressError(text, "the address must begin with mom:// or bin://")
        if scheme in ("tcp", "tcps", "json", "jsons"):
            form = "XML" if scheme.startswith("tcp") else "JSON"
            raise AddressError(text, f"this client speaks the binary form, not {form}: bin{'s' * scheme.endswith('s')}://")
        if scheme not in _SCHEMES:
            raise AddressError(text, f"{scheme}:// is not a scheme of a hub")
        door, tls, port = _SCHEMES[scheme]
        rest, _, query = rest.partition("?")
        authority, slash, path = rest.partition("/")
        host, given = _split(text, authority)
        address = Address(
            door, tls, host, given or port, f"/{path}" if slash and path else None, port_given=given is not None
        )
        return address._with_query(text, query)

    def _with_query(self, text: str, query: str) -> Address:
        address = self
        for part in query.split("&") if query else []:
            key, _, value = part.partition("=")
            pin = _PIN.match(value) if key == "pin" else None
            if pin and self.door != ANY and not self.tls:
                raise AddressError(text, "a fingerprint requires TLS")
            if pin:
                address = replace(address, pin=pin.group(1).lower(), tls=True)
            elif key == "pin":
                raise AddressError(text, "a fingerprint must be sha256: and 64 hexadecimal digits")
            elif part == "poll=1" and self.door == TUNNEL:
                address = replace(address, polled=True)
            elif part != "form=bin" and part != "form=binary":
                raise AddressError(text, "after ? only pin= and a fingerprint may follow")
        return address

    @property
    def is_loopback(self) -> bool:
        """Whether it leads to this machine for sure: a number of loopback, or `localhost`. No other name is looked up."""
        try:
            number = ipaddress.ip_address(self.host)
        except ValueError:
            return self.host.lower() == "localhost"
        mapped = getattr(number, "ipv4_mapped", None)
        return (mapped or number).is_loopback

    @property
    def is_private(self) -> bool:
        """Whether nobody between can read what is said."""
        return self.tls or self.is_loopback

    @property
    def authority(self) -> str:
        """Host and port, as HTTP wants them."""
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"

    def doors(self, secret: bool) -> List[Address]:
        """The doors to try, in this order; with a `secret` none where others could read it.

        On this machine the shortest way is first; from elsewhere those with TLS are. A port that is named is that of all
        doors, as a hub takes all of them on one port; without one, WebSocket and tunnel have the ports of the web.
        """
        if self.door != ANY:
            return [self]
        ways = [(TCP, True), (WEBSOCKET, True), (TUNNEL, True), (TCP, False), (WEBSOCKET, False)]
        if self.is_loopback:
            ways = [(TCP, False), (WEBSOCKET, False), (TUNNEL, False)] + ways[:3]
        found = []
        for door, tls in ways:
            port = self.port if self.port_given or door == TCP else 443 if tls else 80
            address = replace(self, door=door, tls=tls, port=port, pin=self.pin if tls else None)
            if (tls or not self.tls) and (not secret or address.is_private):
                found.append(address)
        return found

    def __str__(self) -> str:
        known = [name for name, (door, tls, _) in _SCHEMES.items() if (door, tls) == (self.door, self.tls)]
        query = ["poll=1"] if self.polled else []
        query += [f"pin=sha256:{self.pin}"] if self.pin else []
        return f"{known[0]}://{self.authority}{self.path or ''}" + ("?" + "&".join(query) if query else "")


def _split(text: str, authority: str) -> Tuple[str, Optional[int]]:
    if authority.startswith("["):
        host, bracket, rest = authority[1:].partition("]")
        if not bracket or ":" not in host or (rest and not rest.startswith(":")):
            raise AddressError(text, "brackets are for IPv6 addresses, as [::1]")
        port = rest[1:] if rest else None
    else:
        host, colon, rest = authority.partition(":")
        port = rest if colon else None
        if ":" in rest:
            raise AddressError(text, "write an IPv6 address in brackets, as [::1]")
        if not host:
            raise AddressError(text, "the address has no host")
        if not _HOST.match(host):
            raise AddressError(text, f"{host!r} is not a host name")
    if port is None:
        return host, None
    if not port.isdecimal() or not 0 < int(port) < 65536:
        raise AddressError(text, f"a port must be a number from 1 to 65535, not {port!r}")
    return host, int(port)
