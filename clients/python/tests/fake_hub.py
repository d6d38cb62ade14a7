"""A hub that speaks only what a link needs, and does what a test wants: for what a real hub does rarely."""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import os
from typing import Any, Dict, List, Optional

from mom.binary import PREFACE, Decoder, encode, frame
from mom.parcel import Parcel


class FakeHub:
    """Answers requests with `ok`, and keeps the link of one peer."""

    def __init__(self) -> None:
        self.port = 0
        self.heard: List[Parcel] = []
        """Every counted parcel that was read, over all connections."""
        self.logins: List[Dict[str, Any]] = []
        self.resumes: List[Dict[str, Any]] = []
        self.acks: List[int] = []
        self.marks: List[str] = []
        """The names of all parcels in their order, those of family `time` too."""
        self.limits: Dict[str, int] = {"heartbeat": 10_000, "gone": 30_000}
        self.grace, self.gives_link, self.resumable = 30_000, True, True
        self.lag = 0
        """So many of the last parcels are as if they had not been read, when a resume comes."""
        self.cut_after: Optional[int] = None
        """Ends each connection when so many bytes have come on it; a low one ends only one, as none gets further."""
        self.forgotten = 0
        """So many parcels it says that it had not kept."""
        self.silent = False
        """Answers nothing."""
        self.replies: Dict[str, Any] = {}
        """Contents of replies, by the name of the request."""
        self.read, self.sent = 0, 0
        self.kept: List[Parcel] = []
        self.id, self.secret = os.urandom(16).hex(), os.urandom(32)
        self.writer: Optional[asyncio.StreamWriter] = None
        self._server: Optional[asyncio.AbstractServer] = None
        self._nonce = b""

    async def start(self) -> "FakeHub":
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", self.port)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def stop(self) -> None:
        assert self._server
        self._server.close()
        self.cut()

    def cut(self) -> None:
        """Ends the connection without a word."""
        if self.writer:
            self.writer.transport.abort()

    @property
    def address(self) -> str:
        return f"bin://127.0.0.1:{self.port}"

    def raw(self, parcel: Parcel) -> None:
        """Says something that does not count."""
        if self.writer and not self.writer.transport.is_closing():
            self.writer.write(frame(encode(parcel)))

    def say(self, parcel: Parcel) -> None:
        """Says something that counts, now or when the peer is back."""
        self.sent += 1
        self.kept.append(parcel)
        self.raw(parcel)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.writer, decoder, came, logged_in = writer, Decoder(), 0, False
        writer.write(PREFACE)
        try:
            while data := await reader.read(65536):
                came += len(data)
                for parcel, _ in decoder.feed(data):
                    self.marks.append(parcel.name)
                    logged_in = self._take(parcel, logged_in)
                if self.cut_after is not None and came > self.cut_after:
                    self.cut_after = self.cut_after if self.cut_after > 10_000 else None
                    break
        except OSError:
            pass
        writer.transport.abort()

    def _take(self, parcel: Parcel, logged_in: bool) -> bool:
        content = parcel.map()
        if parcel.family == "time":
            if parcel.name == "ack":
                self.acks.append(content["read"])
            elif parcel.name == "ping" and not self.silent:
                self.raw(Parcel("time", "pong", reference=parcel.id, content={}))
            return logged_in
        if not logged_in:
            return self._enter(parcel, content)
        self.read += 1
        self.heard.append(parcel)
        if parcel.id is not None and not self.silent and (parcel.family != "message" or parcel.receipt):
            reply = self.replies.get(parcel.name, {"delivered": 1, "dropped": []})
            self.say(Parcel("reply", "ok", parcel.context, reply, reference=parcel.id))
        if parcel.name == "logout" and self.writer:
            self.writer.close()
        return True

    def _enter(self, parcel: Parcel, content: Dict[str, Any]) -> bool:
        answer = Parcel("reply", "ok", "/", reference=parcel.id)
        if parcel.name == "login":
            self.logins.append(content)
            answer.content = {"peer": "alice", "user": "alice", "level": 1, "limits": self.limits}
            if self.gives_link and content.get("link"):
                self.id, self.secret, self.read, self.sent, self.kept = os.urandom(16).hex(), os.urandom(32), 0, 0, []
                answer.content["link"] = {"id": self.id, "secret": self.secret, "grace": self.grace}
        elif parcel.name == "resume":
            self._nonce = os.urandom(32)
            answer.name, answer.content = "challenge", {"nonce": self._nonce, "hub": "lab", "context": "mom-link-1"}
            if not self.resumable or content != {"link": self.id}:
                answer = Parcel("error", "not-resumed", "/", {"code": 209, "resumed": False}, reference=parcel.id)
        else:
            signed = b"mom-link-1\0lab\0" + self.id.encode() + b"\0" + self._nonce
            assert content["proof"] == hmac.new(self.secret, signed, hashlib.sha256).digest()
            self.resumes.append(content)
            self._resume(answer, content["read"])
            return True
        self.raw(answer)
        return parcel.name == "login"

    def _resume(self, answer: Parcel, read: int) -> None:
        self.read -= self.lag
        del self.heard[len(self.heard) - self.lag :]
        answer.content = {
            "resumed": True, "read": self.read, "dropped": self.forgotten, "peer": "alice", "limits": self.limits,
        }  # fmt: skip
        self.raw(answer)
        again = self.kept[len(self.kept) - (self.sent - read) :] if self.sent > read else []
        self.sent, self.kept = read, []
        for parcel in again:
            self.say(parcel)
