"""What happens in contexts and to the link, and subscriptions to it."""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass
from typing import Any, AsyncIterator, Callable, Deque, Dict, List, Optional, Tuple

from .errors import WireError
from .parcel import Parcel
from .states import LinkState


@dataclass(frozen=True)
class Member:
    """A member of a context."""

    peer: str
    """Its name at the hub."""
    user: str
    """The user that it logged in as."""
    level: int = 0
    """The user's level; higher goes first."""
    device: bool = False
    """Whether it obeys stops there, and says so."""

    @staticmethod
    def of(content: Dict[str, Any]) -> Member:
        """Reads `{peer, user, level}`."""
        level = content.get("level")
        return Member(
            _text(content, "peer"), _text(content, "user"), level if isinstance(level, int) else 0,
            content.get("device") is True,
        )  # fmt: skip


@dataclass(frozen=True)
class ContextInfo:
    """A context, as lists show it."""

    path: str
    """Its path."""
    kind: str
    """`session`, `channel` or `token`."""
    number: int = 0
    """Its number at the hub."""
    members: Optional[int] = None
    """How many members it has, where the hub says so."""

    @staticmethod
    def of(content: Dict[str, Any]) -> ContextInfo:
        """Reads a summary."""
        return ContextInfo(
            _text(content, "path"), _text(content, "kind"), _int(content, "number") or 0, _int(content, "members")
        )


class Event:
    """The base of all events; what it says of tokens and contexts is under the path of `path`."""


@dataclass(frozen=True)
class Message(Event):
    """A message, as the hub forwarded it."""

    parcel: Parcel
    """All of its slots."""

    @property
    def name(self) -> str:
        """Its name."""
        return self.parcel.name

    @property
    def sender(self) -> Optional[str]:
        """The peer that sent it, or `hub`."""
        return self.parcel.sender

    @property
    def content(self) -> Any:
        """Its content."""
        return self.parcel.content


@dataclass(frozen=True)
class Joined(Event):
    """A peer joined the context."""

    member: Member


@dataclass(frozen=True)
class Left(Event):
    """A peer left it."""

    member: Member


@dataclass(frozen=True)
class PeerLost(Event):
    """A member's connection is lost. It may come back within the time; what it owned was made safe at once."""

    member: Member
    within: float


@dataclass(frozen=True)
class PeerResumed(Event):
    """A member whose connection was lost is back."""

    member: Member


@dataclass(frozen=True)
class Count(Event):
    """The number of members: large contexts report it instead of `Joined` and `Left`."""

    count: int


@dataclass(frozen=True)
class Created(Event):
    """A context was made in this session."""

    info: ContextInfo


@dataclass(frozen=True)
class Deleted(Event):
    """This context, or one in this session, was deleted."""

    path: str


@dataclass(frozen=True)
class Grabbed(Event):
    """A token has a new owner."""

    path: str
    owner: str
    level: int
    fence: int
    lease: Optional[float]


@dataclass(frozen=True)
class Released(Event):
    """A token's owner lost it or gave it back; `reason` as in docs/PROTOCOL.md, `by` the peer that caused it."""

    path: str
    owner: str
    reason: str
    fence: int
    by: Optional[str] = None


@dataclass(frozen=True)
class Requested(Event):
    """A peer asks the owner for the token: `Token.accept_request` or `Token.decline_request`."""

    path: str
    member: Member
    within: float
    text: Optional[str] = None


@dataclass(frozen=True)
class Offer(Event):
    """A token's owner offers it to a peer: `Token.accept` or `Token.decline`."""

    path: str
    by: str
    to: str
    level: int
    within: float
    fence: int
    time: Optional[float] = None
    commands: Optional[int] = None


@dataclass(frozen=True)
class Lapsed(Event):
    """An offer or a request (`what`) came to nothing; `reason` is `declined`, `timed-out`, `withdrawn`, `lost` or `left`."""

    path: str
    what: str
    by: str
    to: str
    reason: str


@dataclass(frozen=True)
class Queued(Event):
    """A grab of this peer waits in the queue of a token; place 1 is next."""

    path: str
    place: int
    expected: Optional[float] = None


@dataclass(frozen=True)
class Notice(Event):
    """This peer's time with a token ends, because others wait."""

    path: str
    within: float
    waiting: int


@dataclass(frozen=True)
class Inhibited(Event):
    """A peer has joined the shared hold of a token."""

    path: str
    peer: str
    holders: List[str]


@dataclass(frozen=True)
class Uninhibited(Event):
    """A peer has left the shared hold of a token."""

    path: str
    peer: str
    holders: List[str]
    reason: str


@dataclass(frozen=True)
class Invited(Event):
    """This peer is invited to a context."""

    path: str
    by: str
    kind: str


@dataclass(frozen=True)
class Expelled(Event):
    """A peer was expelled from a context."""

    path: str
    peer: str
    by: Optional[str] = None
    text: Optional[str] = None


@dataclass(frozen=True)
class Dropped(Event):
    """Parcels were dropped on their way, by the hub or before they left.

    Of what this client said the reason is `replaced`, `withdrawn` (an `unstop`, by a stop), `expired` or `queue-full`; where
    the connection was lost `lost`, if it had not left, or `unknown`: nobody knows whether the hub has read it.
    """

    reason: str
    count: int
    parcel: Parcel


@dataclass(frozen=True)
class Refused(Event):
    """A message that was sent without awaiting an answer was refused; `id` is the one that `send` returned."""

    error: WireError
    id: Optional[int] = None


@dataclass(frozen=True)
class Lagged(Event):
    """So many events were dropped here, because they were not taken in time."""

    lost: int


@dataclass(frozen=True)
class LinkDown(Event):
    """The connection is lost and could not be resumed: tokens, waiting requests and unsent messages are lost with it."""


@dataclass(frozen=True)
class Rejoined(Event):
    """Logged in anew after `LinkDown`, and this context joined again."""


@dataclass(frozen=True)
class StateChanged(Event):
    """The link has another state."""

    state: LinkState


@dataclass(frozen=True)
class Other(Event):
    """Any other parcel of the hub."""

    parcel: Parcel


def of_parcel(parcel: Parcel) -> Event:
    """Reads a message or an event; an unknown one stays a parcel."""
    if parcel.family == "message":
        return Message(parcel)
    read = _READERS.get(parcel.name) if parcel.family == "event" else None
    return read(parcel, parcel.map(), parcel.context or "") if read else Other(parcel)


_Reader = Callable[[Parcel, Dict[str, Any], str], Event]
_READERS: Dict[str, _Reader] = {
    "joined": lambda p, c, at: Count(c["count"]) if "count" in c else Joined(Member.of(c)),
    "left": lambda p, c, at: Count(c["count"]) if "count" in c else Left(Member.of(c)),
    "lost": lambda p, c, at: PeerLost(Member.of(c), seconds(c, "within") or 0.0),
    "resumed": lambda p, c, at: PeerResumed(Member.of(c)),
    "created": lambda p, c, at: Created(ContextInfo.of(c)),
    "deleted": lambda p, c, at: Deleted(at),
    "grabbed": lambda p, c, at: Grabbed(
        at, _text(c, "owner"), _int(c, "level") or 0, _int(c, "fence") or 0, seconds(c, "lease")
    ),
    "released": lambda p, c, at: Released(
        at, _text(c, "owner"), _text(c, "reason"), _int(c, "fence") or 0, c.get("by")
    ),
    "requested": lambda p, c, at: Requested(at, Member.of(c), seconds(c, "within") or 0.0, c.get("text")),
    "offer": lambda p, c, at: Offer(
        at, _text(c, "by"), _text(c, "to"), _int(c, "level") or 0, seconds(c, "within") or 0.0, _int(c, "fence") or 0,
        seconds(c, "for"), _int(c, "commands"),
    ),
    "lapsed": lambda p, c, at: Lapsed(at, _text(c, "what"), _text(c, "by"), _text(c, "to"), _text(c, "reason")),
    "queued": lambda p, c, at: Queued(at, _int(c, "place") or 0, seconds(c, "expected")),
    "notice": lambda p, c, at: Notice(at, seconds(c, "within") or 0.0, _int(c, "waiting") or 0),
    "inhibited": lambda p, c, at: Inhibited(at, _text(c, "peer"), c.get("holders") or []),
    "uninhibited": lambda p, c, at: Uninhibited(at, _text(c, "peer"), c.get("holders") or [], _text(c, "reason")),
    "invited": lambda p, c, at: Invited(_text(c, "path") or at, _text(c, "by"), _text(c, "kind")),
    "expelled": lambda p, c, at: Expelled(at, _text(c, "peer"), c.get("by"), c.get("text")),
    "dropped": lambda p, c, at: Dropped(_text(c, "reason"), _int(c, "count") or 0, p),
}  # fmt: skip


def _text(content: Dict[str, Any], key: str) -> str:
    found = content.get(key)
    return found if isinstance(found, str) else ""


def _int(content: Dict[str, Any], key: str) -> Optional[int]:
    found = content.get(key)
    return found if isinstance(found, int) and not isinstance(found, bool) else None


def seconds(content: Dict[str, Any], key: str) -> Optional[float]:
    """A duration of the wire, which is in ms."""
    found = _int(content, key)
    return None if found is None else found / 1000


class Events:
    """A subscription: events wait in a bounded queue, and are taken by `async for`.

    When the queue is full the oldest are dropped, and the next event is `Lagged` with their number. Of `stop`, `unstop`,
    `halt` and what else the hub says to make a device safe, only those are dropped that a newer one of the same name, sender
    and context follows. It ends when the context is left or deleted or the client closed; `close` ends it sooner.
    """

    _MOST_BYTES = 64 << 20

    def __init__(self, most: int, is_over: Callable[[Parcel], bool], close: Callable[[Events], None]) -> None:
        self._events: Deque[Tuple[int, int, Event]] = deque()
        self._safety: Deque[Tuple[int, int, Event]] = deque()
        self._most, self._bytes, self._lost, self._numbers = most, 0, 0, 0
        self._is_over, self._unsubscribe = is_over, close
        self._closed = False
        self._wake = asyncio.Event()

    def __aiter__(self) -> AsyncIterator[Event]:
        return self

    async def __anext__(self) -> Event:
        event = await self.next()
        if event is None:
            raise StopAsyncIteration
        return event

    async def next(self) -> Optional[Event]:
        """The next event; `None` at the end. Safe to cancel."""
        while True:
            event = self.try_next()
            if event is not None:
                return event
            if self._closed:
                return None
            self._wake.clear()
            await self._wake.wait()

    def try_next(self) -> Optional[Event]:
        """The next event, if one waits."""
        if self._lost:
            lost, self._lost = self._lost, 0
            return Lagged(lost)
        while self._events or self._safety:
            is_first = not self._events or bool(self._safety) and self._safety[0][0] < self._events[0][0]
            event = self._take(self._safety if is_first else self._events)
            if not (isinstance(event, Message) and self._is_over(event.parcel)):
                return event
        return None

    def close(self) -> None:
        """Ends the subscription; the context stays joined."""
        self._unsubscribe(self)
        self._end()

    def _end(self) -> None:
        """What waits can still be taken."""
        self._closed = True
        self._wake.set()

    def _take(self, events: Deque[Tuple[int, int, Event]]) -> Event:
        _, weight, event = events.popleft()
        self._bytes -= weight
        return event

    @property
    def _is_full(self) -> bool:
        return len(self._events) + len(self._safety) >= self._most

    def _push(self, event: Event) -> None:
        weight = event.parcel.size if isinstance(event, (Message, Other)) else 0
        key = _safety_key(event)
        if key is not None and self._is_full:
            self._drop_older(key)
        while self._events and (self._is_full or self._bytes + weight > self._MOST_BYTES):
            self._take(self._events)
            self._lost += 1
        if key is None and self._is_full:
            self._lost += 1
        else:
            self._numbers += 1
            (self._events if key is None else self._safety).append((self._numbers, weight, event))
            self._bytes += weight
        self._wake.set()

    def _drop_older(self, key: Tuple[object, ...]) -> None:
        """Drops what a newer one of this key is about to follow."""
        kept = [waiting for waiting in self._safety if _safety_key(waiting[2]) != key]
        self._lost += len(self._safety) - len(kept)
        self._bytes -= sum(waiting[1] for waiting in self._safety) - sum(waiting[1] for waiting in kept)
        self._safety = deque(kept)

    def _keep_safety(self) -> None:
        """Drops all but what makes a device safe, and takes nothing else from now on."""
        while self._events:
            self._take(self._events)
            self._lost += 1
        self._most = 0


def _safety_key(event: Event) -> Optional[Tuple[object, ...]]:
    """Of what a device must not miss: what it has in common with those that it may take the place of."""
    if not isinstance(event, Message):
        return None
    parcel = event.parcel
    # Other names of the hub's are those of safe states; its log is not.
    if parcel.name not in ("stop", "unstop", "halt") and (parcel.sender != "hub" or parcel.name == "log"):
        return None
    return parcel.context, parcel.sender, parcel.name


class Subscribers:
    """The subscriptions by context."""

    def __init__(self, most: int, is_over: Callable[[Parcel], bool]) -> None:
        self._most, self._is_over = max(most, 1), is_over
        self._by_path: Dict[str, List[Events]] = {}
        self._early: Dict[str, Events] = {}
        self._others: List[Events] = []
        self._consults: List[Events] = []

    def _events(self) -> Events:
        return Events(self._most, self._is_over, self._unsubscribe)

    def keep_early(self, path: str) -> None:
        """Keeps what comes from now on for the first subscriber, unless there is one."""
        if path not in self._by_path:
            self._early.setdefault(path, self._events())

    def subscribe(self, path: str) -> Events:
        """The events of a context from now on; the first subscriber's from the join on."""
        events = self._early.pop(path, None) or self._events()
        events._most = self._most
        self._by_path.setdefault(path, []).append(events)
        return events

    def unaddressed(self) -> Events:
        """What no subscription of a context takes."""
        self._others.append(self._events())
        return self._others[-1]

    def consults(self) -> Events:
        """The hub's questions."""
        self._consults.append(self._events())
        return self._consults[-1]

    def _unsubscribe(self, events: Events) -> None:
        for known in (self._others, self._consults, *self._by_path.values()):
            known[:] = [other for other in known if other is not events]

    def deliver(self, paths: List[str], event: Event) -> None:
        """Gives an event to the subscribers of these contexts, or else to the unaddressed."""
        found = [events for path in paths for events in self._of(path, event)]
        for events in found or self._others:
            events._push(event)

    def deliver_only(self, path: str, event: Event) -> None:
        """Gives an event to the subscribers of this context, or else to nobody."""
        for events in self._of(path, event):
            events._push(event)

    def deliver_others(self, event: Event) -> None:
        """Gives an event to the unaddressed."""
        for events in self._others:
            events._push(event)

    def deliver_consult(self, event: Event) -> bool:
        """Gives a question to those that answer questions; whether there are any."""
        for events in self._consults:
            events._push(event)
        return bool(self._consults)

    def deliver_all(self, event: Event) -> None:
        """Gives an event to every subscriber."""
        for events in [*self._others, *self._early.values(), *(one for all_ in self._by_path.values() for one in all_)]:
            events._push(event)

    def close_within(self, top: str) -> None:
        """Ends the subscriptions of a context and of all below it."""
        for path in [path for path in self._by_path if is_within(path, top)]:
            for events in self._by_path.pop(path):
                events._end()
        for path in [path for path in self._early if is_within(path, top)]:
            del self._early[path]

    def close_all(self) -> None:
        """Ends all of them."""
        self.close_within("/")
        for events in [*self._others, *self._consults]:
            events._end()

    def _of(self, path: str, event: Event) -> List[Events]:
        early = self._early.get(path)
        if early is not None and early._is_full:
            # Nobody has come for it: others get what comes from now on, and this only what a device must not miss.
            early._keep_safety()
            early._push(event)
            early = None
        return self._by_path.get(path, []) + ([early] if early else [])


def is_within(path: str, top: str) -> bool:
    """Whether a path is another one or lies below it."""
    return top == "/" or path == top or path.startswith(top + "/")
