"""The cases of the table "What overtakes, replaces, outlives": each is replayed with the client's own queue and link.

`tests/cases/README.md` says what the steps mean.
"""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any, Dict, List, Optional, Set

import pytest

import mom
from mom.binary import PREFACE, Decoder, encode
from mom.core import Core, Place
from mom.link import Link
from mom.parcel import Parcel
from mom.values import now

FILE = Path(__file__).parents[3] / "tests/cases/send-queue.json"
CASES = [case for case in json.loads(FILE.read_text()) if "python" in case.get("on", ["python"])]
TOKEN = "/robot/token"
GUARD = {"kind": "channel", "guard": {"token": TOKEN, "names": ["*"], "owner": "alice", "fence": 3}}
CHANNEL = {"kind": "channel"}
SLOTS = ("address", "delivery", "priority", "expires", "fence")
ITEM = {"is", "family", "name", "context", "bytes", "stop", "peer", "guarded", "awaited", *SLOTS}
TURNS = 5000
"""More turns of the loop than any step takes."""


class Wire:
    """A connection that takes so many frames as a step says, and hears what they make."""

    def __init__(self, labels: Dict[int, str]) -> None:
        self.frames = 0
        self.heard: List[str] = []
        self.streams = 0
        self._labels, self._decoder = labels, Decoder()
        self._free = asyncio.Event()
        list(self._decoder.feed(PREFACE))

    def take(self) -> None:
        """Takes one more."""
        self._free.set()

    def next_stream(self) -> int:
        self.streams += 1
        return self.streams

    async def write(self, data: bytes) -> None:
        # As a socket does it: it takes the bytes, and is written to again when there is room for more.
        self.frames += 1
        for parcel, _ in self._decoder.feed(data):
            self.heard.append("resent" if parcel.is_("time", "resent") else self._labels[parcel.id or 0])
        self._free.clear()
        await self._free.wait()


class Replay:
    """One case: a client's core without a hub."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self.core = Core(now, 1024, 40.0)
        self.core.outbox.clock = lambda: self.seconds
        # The cases have no acknowledgements for which messages could wait.
        self.core.outbox.permits = lambda entry: True
        self.core.link = Link("link", b"secret", 30.0)
        self.core.begin_anew()
        self.labels: Dict[int, str] = {}
        self.answers: Dict[str, "asyncio.Future[Parcel]"] = {}
        self.told: Set[str] = set()
        self.events = self.core.subscribers.unaddressed()
        self.wire = Wire(self.labels)
        self.sending: "Optional[asyncio.Future[None]]" = None

    async def step(self, kind: str, value: Any) -> None:
        if kind == "put":
            self.put(value)
        elif kind == "fill":
            self.fill(value)
        elif kind == "takes":
            for count in range(1, len(value) + 1):
                await self.until(lambda: len(self.wire.heard) >= count)
            self.expect(value)
        elif kind == "begins":
            frames, before = self.wire.frames, set(self.core.outbox._streams)
            await self.until(lambda: self.wire.frames > frames)
            begun = self.core.outbox._streams - before
            assert [self.labels[entry.parcel.id or 0] for entry in begun] == [value]
            self.expect([])
        elif kind == "hears":
            await self.until(lambda: self.core.outbox.is_empty)
            self.expect(value)
        elif kind == "lose":
            await self.lose()
        elif kind == "resume":
            assert self.core.resume({"read": value}), "a count that cannot be"
        elif kind == "told":
            assert self.hear() == value
        elif kind == "clock":
            self.seconds += value / 1000
        else:
            raise AssertionError(f"no step is called {kind}")

    def put(self, item: Dict[str, Any]) -> None:
        assert not set(item) - ITEM, f"what is that of an item: {set(item) - ITEM}"
        parcel = Parcel(item.get("family", "message"), item["name"], item.get("context", "/robot/arm"))
        for slot in SLOTS:
            setattr(parcel, slot, item.get(slot))
        parcel.extra = {"stop": item["stop"]} if "stop" in item else {}
        if "bytes" in item:
            parcel.content = bytes(item["bytes"])
        elif "peer" in item:
            parcel.content = {"peer": item["peer"]}
        self.say(item["is"], parcel, item.get("guarded", False), item.get("awaited", False))

    def say(self, label: str, parcel: Parcel, guarded: bool = False, awaited: bool = False) -> None:
        parcel.id = self.core.next_id()
        self.labels[parcel.id] = label
        if parcel.family == "time":
            self.core.post(parcel)
            return
        if awaited or parcel.family != "message":
            self.answers[label] = self.core.begin(parcel)
        if parcel.family == "message":
            # As in the reply to a join: the channel is guarded, or it is not.
            place = self.core.places.setdefault(parcel.context or "/", Place(parcel.context or "/"))
            place.gate.joined(GUARD if guarded else CHANNEL)
            saying = self.core.send(parcel)
            with pytest.raises(StopIteration):
                saying.send(None)
                saying.close()
                pytest.fail(f"{label} waits for room")

    def fill(self, label: str) -> None:
        outbox = self.core.outbox
        parcel = Parcel("message", "note", "/robot/arm", bytes(outbox.most))
        parcel.id, parcel.timestamp = 1, now()
        parcel.content = bytes(outbox.most - outbox._bytes - (len(encode(parcel)) - outbox.most))
        self.say(label, parcel)
        assert outbox._bytes == outbox.most

    async def until(self, condition: Any) -> None:
        """Lets the link take one frame after the other until it is so."""
        if self.sending is None:
            self.sending = asyncio.ensure_future(self.core.outbox.send_all(self.wire, self.wrote))  # type: ignore[arg-type]
        for _ in range(TURNS):
            if condition():
                return
            self.wire.take()
            await asyncio.sleep(0)  # tidy: lets the queue go on by one frame
            assert not self.sending.done(), self.sending.exception()
        raise AssertionError(f"it does not come to that; heard: {self.wire.heard}")

    def wrote(self, entry: Any) -> None:
        assert self.core.link is not None
        self.core.link.wrote(entry)

    def expect(self, labels: List[str]) -> None:
        heard, self.wire.heard = self.wire.heard, []
        assert heard == labels

    async def lose(self) -> None:
        if self.sending is not None:
            self.sending.cancel()
            await asyncio.wait([self.sending])
        assert not self.wire.heard, "what a case does not expect"
        self.core.suspend()
        self.wire, self.sending = Wire(self.labels), None

    def hear(self) -> Dict[str, str]:
        told: Dict[str, str] = {}
        while (event := self.events.try_next()) is not None:
            if isinstance(event, mom.Dropped):
                label = self.labels[event.parcel.id or 0]
                assert label not in told, f"{label} is told twice"
                told[label] = event.reason
        for label, answer in self.answers.items():
            error = answer.exception() if answer.done() else None
            if isinstance(error, (mom.LostError, mom.DroppedError)) and label not in self.told:
                assert isinstance(error, mom.LostError) == (error.code in ("lost", "unknown"))
                told[label] = error.code
        self.told |= set(told)
        return told

    async def end(self) -> None:
        if self.sending is not None:
            self.sending.cancel()
            await asyncio.wait([self.sending])
        for answer in self.answers.values():
            if not answer.cancel() and not answer.cancelled():
                answer.exception()


@pytest.mark.parametrize("case", CASES, ids=[case["name"] for case in CASES])
async def test_case(case: Dict[str, Any]) -> None:
    replay = Replay()
    try:
        for number, step in enumerate(case["steps"], 1):
            ((kind, value),) = step.items()
            try:
                await replay.step(kind, value)
            except AssertionError as error:
                raise AssertionError(f"step {number}, {json.dumps(step)}: {error}") from error
    finally:
        await replay.end()


def test_every_case_has_a_name_of_its_own() -> None:
    assert CASES and len({case["name"] for case in CASES}) == len(CASES)
