"""What all proxies and the tasks of a client share: requests, memberships, subscriptions, the queue."""

from __future__ import annotations

import asyncio
import secrets
from collections import OrderedDict
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Callable, Dict, List, Optional

from ..clock import HubClock
from ..entry import DATA, Entry
from ..errors import (
    ClosedError,
    ConnectionDownError,
    DroppedError,
    LostError,
    MomError,
    RefusedError,
    TimedOutError,
    WireError,
)
from ..events import Dropped, LinkDown, Other, Refused, Rejoined, StateChanged, Stops, is_within, of_parcel
from ..gate import FenceGate
from .devices import Devices
from .holds import Holds
from ..latch import Latch
from ..link import Link
from ..outbox import Outbox
from ..parcel import Parcel
from ..states import LinkState
from ..stops import StopState
from ..subscriptions import Subscribers
from ..values import now

_REMEMBERED = 1024
"""The sent messages whose channels are known when a refusal comes."""

_CARDS_SINCE = 4
"""The minor version of the protocol from which on a hub takes cards: an earlier one refuses what it does not know."""


class Place:
    """A context that this client is in."""

    def __init__(self, path: str) -> None:
        self.path = path
        self.terms: Dict[str, Any] = {}
        """What it asked for there: thinning, `device`."""
        self.gate = FenceGate()
        self.latch = Latch()
        """What has come of stops: a device says so when it joins again."""
        self.info: Dict[str, Any] = {}
        """What the hub said when it was joined."""
        self.joining: Optional[asyncio.Future[None]] = None


@dataclass(frozen=True)
class _Pending:
    """A request without its answer."""

    answer: asyncio.Future[Parcel]
    what: str
    taken: Optional[Callable[[Parcel], None]]


class Core:
    """The state of a client."""

    def __init__(
        self, wall: Callable[[], datetime], event_buffer: int, request_timeout: float, installation: Optional[str] = None
    ) -> None:
        self.clock = HubClock(wall)
        self._installation = {"installation": installation or secrets.token_hex(8), "begun": now()}
        """Which device this is, where it is one."""
        self.wall = wall
        self.request_timeout = request_timeout
        self.subscribers = Subscribers(event_buffer, self._is_over)
        self.outbox = Outbox(self.dropped)
        self.outbox.permits = self._permits
        self.holds = Holds(self)
        self.devices = Devices()
        self.places: Dict[str, Place] = {}
        self._latches: Dict[str, Latch] = {}
        """What devices have heard of stops, also of channels that are gone: a hub that began anew without one knows no stop there."""
        self.numbers: Dict[int, str] = {}
        self.welcome: Dict[str, Any] = {}
        """The content of the hub's reply to the login."""
        self.link: Optional[Link] = None
        self.is_up = False
        """Whether there is a connection on which this peer is logged in."""
        self.closing: Optional[WireError] = None
        """With what error the hub ends the connection."""
        self.state = LinkState("trying")
        self.on_state: List[Callable[[LinkState], None]] = []
        self._pending: Dict[int, _Pending] = {}
        self._sent: OrderedDict[int, Optional[str]] = OrderedDict()
        self._ids = 0
        # Of messages that a receiver answers: begun anywhere, so that no status of another connection of this name, and none that a
        # channel has kept, is the answer to one.
        self._answered_ids = (1 << 52) + secrets.randbits(51)

    @property
    def peer(self) -> str:
        """The name that the hub gave."""
        return str(self.welcome.get("peer", ""))

    def limit(self, key: str, default: int) -> int:
        """A limit of the hub."""
        limits = self.welcome.get("limits")
        found = limits.get(key) if isinstance(limits, dict) else None
        if found == "unlimited":
            return (1 << 32) - 1
        return found if isinstance(found, int) and found > 0 else default

    def next_id(self) -> int:
        """A number for a parcel, used by no other."""
        self._ids += 1
        return self._ids

    def _id_of(self, parcel: Parcel) -> int:
        if parcel.family == "message" and (parcel.name == "command" or parcel.receipt):
            self._answered_ids += 1
            return self._answered_ids
        return self.next_id()

    def enter(self, state: LinkState) -> None:
        """Tells of another state of the link."""
        if state != self.state:
            self.state = state
            self.subscribers.deliver_all(StateChanged(state))
            for told in list(self.on_state):
                told(state)

    # What is said.

    def _permits(self, entry: Entry) -> bool:
        """Whether an entry may leave now: what the hub may not have read is kept, and has the same bound as at the hub.

        Only messages wait for that.
        """
        kept = self.link.kept_bytes if self.link is not None else 0
        return entry.lane != DATA or kept == 0 or kept + entry.size <= self.outbox.most

    def check_up(self) -> None:
        """Refuses what cannot be sent, now or when the link is resumed."""
        if self.state.word == "closed":
            raise ClosedError(self.state.error)
        if not self.is_up and self.link is None:
            raise ConnectionDownError("the link to the hub is down")

    async def send(self, parcel: Parcel) -> int:
        """Sends a message, once there is room for it; gives its id."""
        self.check_up()
        if parcel.id is None:
            parcel.id = self._id_of(parcel)
        if parcel.timestamp is None:
            parcel.timestamp = self.wall()
        place = self.places.get(parcel.context or "")
        guard = place.gate.guard if place else None
        token = guard.token if guard is not None and guard.covers(parcel.name) else None
        delivery = parcel.delivery or (place.info.get("delivery") if place else None) or "reliable"
        answer = self._pending[parcel.id].answer if parcel.id in self._pending else None
        entry = Entry(parcel, str(delivery), token, answer, self.outbox.clock())
        most = self.limit("parcel", 8 << 20)
        if entry.size > most:
            raise RefusedError(WireError("too-long", f"the parcel has {entry.size} bytes; the hub accepts at most {most}"))
        await self.outbox.capacity(entry)
        self.check_up()
        self._sent[parcel.id] = parcel.context
        hold = self.holds.of(token) if token is not None and parcel.name == "command" else None
        if hold is not None:
            hold.said(parcel.id)
        if len(self._sent) > _REMEMBERED:
            self._sent.popitem(last=False)
        self.outbox.put(entry)
        return parcel.id

    def post(self, parcel: Parcel, answer: Optional[asyncio.Future[Parcel]] = None) -> None:
        """Lets a parcel wait without asking for room: requests, signs of life."""
        self.outbox.put(Entry(parcel, answer=answer))

    def begin(self, parcel: Parcel, taken: Optional[Callable[[Parcel], None]] = None) -> asyncio.Future[Parcel]:
        """Lets a request wait to be sent; gives its answer to come. `taken` hears the reply before what comes behind it is heard."""
        parcel.id = self._id_of(parcel) if parcel.id is None else parcel.id
        number, future = parcel.id, asyncio.get_running_loop().create_future()
        self._pending[number] = _Pending(future, _what(parcel), taken)
        future.add_done_callback(lambda _: self._pending.pop(number, None))
        if parcel.family != "message":
            self.post(parcel, future)
        return future

    async def request(self, parcel: Parcel, timeout: Optional[float] = None, wait: bool = True) -> Parcel:
        """Sends a request and waits for its answer; `wait` = `False`: as long as it takes."""
        self.check_up()
        future = self.begin(parcel)
        try:
            if parcel.family == "message":
                await self.send(parcel)
            return await self.answer(parcel, future, timeout, wait)
        finally:
            if not future.cancel() and not future.cancelled():
                # An error that is told here already, if nobody has taken it.
                future.exception()

    async def answer(
        self, parcel: Parcel, future: asyncio.Future[Parcel], timeout: Optional[float] = None, wait: bool = True
    ) -> Parcel:
        """Waits for the answer to a request that was begun."""
        after = timeout or self.request_timeout
        try:
            return await asyncio.wait_for(future, after if wait else None)
        except asyncio.TimeoutError:
            raise TimedOutError(_what(parcel), after) from None

    async def ask(self, family: str, name: str, path: str, content: Any = None, **options: Any) -> Parcel:
        """A request about a context."""
        return await self.request(Parcel(family, name, path, content or None), **options)

    # What is heard.

    def receive(self, parcel: Parcel) -> None:
        """Takes a parcel of the hub, other than those of family `time`."""
        if parcel.fault is not None:
            self._receive_faulty(parcel)
        elif parcel.family in ("reply", "error"):
            self._receive_answer(parcel)
        elif parcel.family == "event":
            self._receive_event(parcel)
        elif parcel.is_("manager", "consult") and self.subscribers.deliver_consult(Other(parcel)):
            pass
        else:
            if parcel.is_("message", "status") and not parcel.history:
                self._receive_status(parcel.map())
            event, place = of_parcel(parcel), self.places.get(parcel.context or "")
            if place is not None:
                place.latch.observe(event)
                if parcel.is_("message", "halt") and parcel.sender == "hub" and "guard" in parcel.map():
                    # Another token guards the channel from now on, or none.
                    place.gate.joined(parcel.map())
            self.subscribers.deliver(_paths(parcel), event)

    def _receive_status(self, status: Dict[str, Any]) -> None:
        """How a device says that a command of this peer goes."""
        if status.get("state") in ("finished", "error") and status.get("peer") == self.peer:
            self.holds.ended(status.get("id"))

    def _receive_faulty(self, parcel: Parcel) -> None:
        # The hub passes content on as it came; what cannot be read is as good as lost.
        self.subscribers.deliver(_paths(parcel), Dropped("bad-content", 1, parcel))

    def _receive_answer(self, parcel: Parcel) -> None:
        error = parcel.error() if parcel.family == "error" else None
        if error is not None:
            self.holds.ended(parcel.reference)
        if error is not None and error.closes:
            self.closing = error
        pending = self._pending.get(parcel.reference or 0)
        if pending is not None and not pending.answer.done():
            if error is not None:
                pending.answer.set_exception(RefusedError(error))
                return
            if pending.taken is not None:
                pending.taken(parcel)
            pending.answer.set_result(parcel)
        elif error is not None:
            path = self._sent.get(parcel.reference or 0) or parcel.context
            self.subscribers.deliver([path] if path else [], Refused(error, parcel.reference))

    def _receive_event(self, parcel: Parcel) -> None:
        path, name, event = parcel.context or "/", parcel.name, of_parcel(parcel)
        place = self.places.get(path)
        mine = parcel.map().get("peer") == self.peer
        if place is not None:
            place.latch.observe(event)
        if name == "joined" and mine and place is not None and place.joining is not None:
            # The reply to the join says so, too.
            return
        if name in ("grabbed", "released"):
            guarded = [one for one in self.places.values() if one.gate.guard and one.gate.guard.token == path]
            for one in guarded:
                one.gate.observe(parcel)
            self.holds.heard(path, parcel)
            self.subscribers.deliver([path] + [one.path for one in guarded], event)
            return
        if name in ("lapsed", "uninhibited"):
            self.holds.heard(path, parcel)
        if name == "deleted":
            above = path.rsplit("/", 1)[0] or "/"
            self.subscribers.deliver([path, above], event)
        else:
            self.subscribers.deliver([path], event)
        if name == "deleted" or (name == "expelled" and mine):
            self.forget_within(path, "deleted" if name == "deleted" else "revoked")

    # Memberships.

    async def enter_all(self, path: str, kind: Optional[str] = None, terms: Optional[Dict[str, Any]] = None) -> Place:
        """Joins a context, parents first."""
        parts = [part for part in path.split("/") if part]
        place = Place("/")
        for depth in range(1, len(parts) + 1):
            here = "/" + "/".join(parts[:depth])
            place = await self._enter(here, terms if depth == len(parts) else None)
        if kind is not None and parts and place.info.get("kind") != kind:
            found = place.info.get("kind")
            raise RefusedError(WireError("wrong-kind", f"{path} is a {found}, not a {kind}"))
        return place

    async def _enter(self, path: str, terms: Optional[Dict[str, Any]]) -> Place:
        place = self.places.get(path)
        if place is not None and place.joining is not None:
            await asyncio.shield(place.joining)
            place = self.places.get(path)
        # A device always hears how it stands.
        if place is not None and (terms is None or (terms == place.terms and not terms.get("device"))):
            return place
        if place is not None:
            await self._join(place, terms)
            return place
        place = self.places[path] = Place(path)
        place.latch = self._latches.setdefault(path, place.latch)
        try:
            await self._join(place, terms)
        except BaseException:
            self.places.pop(path, None)
            raise
        return place

    async def _join(self, place: Place, terms: Optional[Dict[str, Any]]) -> None:
        self.check_up()
        await self._joined(place, self._begin_join(place, terms))

    def _begin_join(self, place: Place, terms: Optional[Dict[str, Any]]) -> asyncio.Future[Parcel]:
        place.joining = asyncio.get_running_loop().create_future()
        self.subscribers.keep_early(place.path)
        device = (terms or {}).get("device")
        said = terms
        if device:
            word = {**place.latch.word(), **self._installation, **_card_of(device, self.welcome)}
            said = {**(terms or {}), "device": word}
        parcel = Parcel("context", "join", place.path, said, has_content=terms is not None)
        return self.begin(parcel, lambda reply: self._take_join(place, terms, reply.map()))

    def _take_join(self, place: Place, terms: Optional[Dict[str, Any]], info: Dict[str, Any]) -> None:
        place.terms = place.terms if terms is None else terms
        place.info = info
        place.gate.joined(info)
        if place.terms.get("device") or "stop" in info:
            stops = Stops(place.path, StopState.of(info.get("stop")))
            place.latch.observe(stops)
            self.subscribers.deliver([place.path], stops)

    async def _joined(self, place: Place, answer: asyncio.Future[Parcel]) -> None:
        joining = place.joining
        try:
            await asyncio.wait_for(answer, self.request_timeout)
        except asyncio.TimeoutError:
            raise TimedOutError(f"context join {place.path}", self.request_timeout) from None
        finally:
            place.joining = None
            if joining is not None and not joining.done():
                joining.set_result(None)

    def rejoin_all(self) -> List[asyncio.Task[None]]:
        """Asks to join all contexts again, parents first, after a login that began anew: before anything else is said."""
        asked = []
        for path, place in sorted(self.places.items()):
            answer = self._begin_join(place, place.terms or None)
            asked.append(asyncio.ensure_future(self._rejoined(path, place, answer)))
        if not asked:
            self.subscribers.deliver_others(Rejoined())
        return asked

    async def _rejoined(self, path: str, place: Place, answer: asyncio.Future[Parcel]) -> None:
        try:
            await self._joined(place, answer)
            self.subscribers.deliver([path], Rejoined())
        except RefusedError as error:
            self.subscribers.deliver_only(path, Refused(error.wire))
            self.forget_within(path, "disconnected")
        except MomError:
            # The connection was lost once more: then all of it begins again.
            pass

    async def leave(self, path: str) -> None:
        """Leaves a context and all below it."""
        await self.ask("context", "leave", path)
        self.forget_within(path, "released")

    def forget_within(self, path: str, reason: str) -> None:
        """Forgets a context and all below it, as the hub did."""
        for known in [known for known in self.places if is_within(known, path)]:
            del self.places[known]
        self.holds.lose_within(path, reason)
        self.subscribers.close_within(path)

    # Losses.

    def dropped(self, entry: Entry, reason: str) -> None:
        """Tells of a parcel that will not be sent, or not again."""
        self.holds.ended(entry.parcel.id)
        parcel = entry.parcel
        if entry.answer is not None:
            # Who has got its answer, or waits no more, has heard all that there is to hear.
            if not entry.answer.done():
                kind = LostError if reason in ("lost", "unknown") else DroppedError
                entry.answer.set_exception(kind(_what(parcel), reason))
        else:
            self.subscribers.deliver(_paths(parcel), Dropped(reason, 1, parcel))

    def suspend(self) -> None:
        """The connection is lost, and the link is not: what was meant for the moment is not said later."""
        self.is_up = False
        self.outbox.lose()

    def resume(self, content: Dict[str, Any]) -> bool:
        """The link goes on over another connection; the hub says what it has read. Whether that can be."""
        both = self.link.resumed(content) if self.link is not None else None
        if both is None:
            return False
        self.is_up = True
        self.outbox.resume(both[0])
        for entry in both[1]:
            self.dropped(entry, "unknown")
        return True

    def begin_anew(self) -> None:
        """Logged in, as another peer than before."""
        self.is_up = True
        self.outbox.open()

    def lose_all(self, why: str) -> None:
        """The link is gone: open requests get no answer, and tokens are lost."""
        self._lose_link()
        self.clock._forget()
        self.numbers.clear()
        self.holds.lose_within("/", "disconnected")
        for place in self.places.values():
            place.gate.forget_owner()
        for pending in list(self._pending.values()):
            if not pending.answer.done():
                # The hub has read it, or may have.
                pending.answer.set_exception(LostError(pending.what, "unknown", why))
        self.subscribers.deliver_all(LinkDown())

    def _lose_link(self) -> None:
        link, self.link, self.is_up = self.link, None, False
        self.outbox.lose(everything=True)
        for entry in link.unread if link is not None else ():
            self.dropped(entry, "unknown")

    def close(self, error: Optional[WireError]) -> None:
        """Nothing will come any more."""
        self.enter(LinkState("closed", error=error))
        self.holds.lose_within("/", "disconnected")
        for pending in list(self._pending.values()):
            if not pending.answer.done():
                pending.answer.set_exception(ClosedError(error))
        if error is None:
            # The answer to the logout says that all was read.
            self.link = None
        self._lose_link()
        self.subscribers.close_all()

    def _is_over(self, parcel: Parcel) -> bool:
        over = self.clock.is_expired(parcel)
        self.clock.expired += over
        return over


def _paths(parcel: Parcel) -> List[str]:
    return [parcel.context] if parcel.context else []


def _what(parcel: Parcel) -> str:
    return f"{parcel.family} {parcel.name} {parcel.context or ''}".strip()


def _card_of(device: Any, welcome: Dict[str, Any]) -> Dict[str, Any]:
    """What a device says of what it can do when it joins; `device` are its terms, `True` or `{card}`."""
    protocol = welcome.get("protocol")
    minor = protocol.get("minor") if isinstance(protocol, dict) else None
    takes = isinstance(minor, int) and minor >= _CARDS_SINCE
    return {"card": device["card"]} if takes and isinstance(device, dict) else {}
