"""Subscriptions to what happens: bounded queues, in which what a device must not miss is kept."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import AsyncIterator, Callable, Deque, Dict, List, Optional, Tuple

from .events import Event, Lagged, LinkDown, Message, Other, StateChanged, Stops, is_within
from .parcel import Parcel


class Events:
    """A subscription: events wait in a bounded queue, and are taken by `async for`.

    When the queue is full the oldest are dropped, and the next event is `Lagged` with their number. Of `stop`, `unstop`,
    `halt` and what else the hub says to make a device safe, only those are dropped that a newer one of the same name, sender
    and context follows; of `Stops`, `LinkDown` and `StateChanged` only those that a newer one of the same kind follows. It ends when the context is left or deleted or the client closed; `close` ends it sooner.
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
    if isinstance(event, Stops):
        # Those of some devices say nothing of the others.
        return "stops", event.path, event.state.stopped, bool(event.state.only)
    if isinstance(event, LinkDown):
        return ("link-down",)
    if isinstance(event, StateChanged):
        return "state", event.state.word
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
