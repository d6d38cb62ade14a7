"""Which devices this program is, and where: each instance is one, and each channel has one of this client."""

from __future__ import annotations

import asyncio
import threading
from typing import Any, Dict, Mapping, Optional

_AT_WORK: Dict[int, Any] = {}
"""The instances that are a device now, of all clients, by their identity: a class may compare them as it likes."""


class _Obeyed(threading.local):
    """Those that have obeyed in the program of this thread, kept while `mom.device.run` runs it, which halts them once more at its end."""

    devices: Optional[Dict[int, Any]] = None


OBEYED = _Obeyed()


class Devices:
    """The devices of one client, by their channels."""

    def __init__(self) -> None:
        self._peers: Dict[str, Any] = {}
        """Its `DevicePeer`; `None` while it joins."""

    async def take(self, path: str, device: Any, places: Mapping[str, Any]) -> None:
        """Has it become the device of a channel; raises `ValueError` where that would carry out commands twice."""
        if id(device) in _AT_WORK:
            raise ValueError(f"this {type(device).__name__} is a device already: make another one, or let it `leave` first")
        peer = self._peers.get(path)
        if peer is None and path in self._peers:
            raise ValueError(f"this client is becoming the device of {path} already")
        if peer is not None and not peer.is_over and places.get(path) is peer.channel._place:
            raise ValueError(f"this client is the device of {path} already: that one has to `leave` first")
        if OBEYED.devices is not None:
            OBEYED.devices[id(device)] = device
        # Before anything is awaited.
        _AT_WORK[id(device)], self._peers[path] = device, None
        try:
            if peer is not None:
                # It may still clear up.
                await asyncio.wait([peer._obeying])
        except BaseException:
            self.free(path, device)
            raise

    def note(self, path: str, peer: Any) -> None:
        """It is the device of the channel from now on, until it has ended."""
        self._peers[path] = peer
        peer.on_end = lambda: self._end(path, peer)

    def _end(self, path: str, peer: Any) -> None:
        _AT_WORK.pop(id(peer.device), None)
        if self._peers.get(path) is peer:
            del self._peers[path]

    def free(self, path: str, device: Any) -> None:
        """It has not become one."""
        _AT_WORK.pop(id(device), None)
        self._peers.pop(path, None)
