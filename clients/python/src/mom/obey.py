"""A device: a peer that moves something, and halts it when it has to stand."""

from __future__ import annotations

import asyncio
import inspect
import logging
from typing import Any, Awaitable, Coroutine, Dict, List, Mapping, Optional, Set

from .core import Core
from .errors import MomError
from .events import Dropped, Event, Expelled, Joined, Lagged, Message, Rejoined, Released, StateChanged
from .gate import StaleError
from .latch import Held, Latch, Reaction
from .proxies import Channel
from .subscriptions import Events

LOG = logging.getLogger("mom")

_SLOW_HEARTBEAT = 1000
"""More than that, in ms, is much for what moves."""


class Machine:
    """What a device moves: make a class of it with `halt` and `move`. None of them may block, as nothing is heard meanwhile."""

    def halt(self, why: str) -> None:
        """Comes to rest at once; also called when nothing moves. `why` is for people."""
        raise NotImplementedError

    def move(self, command: Any, message: Message) -> Optional[Awaitable[Any]]:
        """Carries out a command that may be obeyed. What it raises is told to the sender.

        It may be a coroutine: then the next event does not wait for it, and it is cancelled before the machine is halted.
        """
        raise NotImplementedError

    def state(self) -> Mapping[str, Any]:
        """What its messages `state` say beside `stopped` and `stop`."""
        return {}

    def free(self) -> None:
        """It may move again: nothing has to be done."""


class Device:
    """The device side of a channel, made by `Client.obey`.

    It halts at each stop, each loss of the connection, each silence and each gap in what it has heard, and at its end. It moves
    nothing before it has heard on this connection how it stands, lets only an unstop free it that names the newest stop, and
    says how it stands after each.
    """

    def __init__(self, core: Core, channel: Channel, machine: Machine, events: Events) -> None:
        self._core, self._machine, self._events = core, machine, events
        self.channel = channel
        """Its channel."""
        self._latch = Latch()
        self._moves: Dict[asyncio.Future[Any], Message] = {}
        self._saying: Set[asyncio.Future[Any]] = set()
        heartbeat = core.limit("heartbeat", 10_000)
        if heartbeat > _SLOW_HEARTBEAT:
            text = "the device of %s notices only after %g s that its hub is silent: connect with heartbeat=0.5"
            LOG.warning(text, channel.path, heartbeat * 1.5 / 1000)
        self._over = "it is no longer a device of its channel"
        """Why, once it is so."""
        self._obeying = asyncio.ensure_future(self._obey())

    def may_move(self) -> Optional[Held]:
        """Why it may not move; `None` if it may."""
        if self._obeying.done():
            return Held("unknown", self._over)
        is_silent = self._core.state.word != "connected"
        return self._latch.may_move() or (Held("unknown", "the hub is silent") if is_silent else None)

    @property
    def is_stopped(self) -> bool:
        """Whether a stop holds."""
        return self._latch.is_stopped

    def stop_itself(self, why: str) -> None:
        """Stops by itself, as at a bumper, until a peer lifts that."""
        self._take(self._latch.stop_itself(why))
        self._say(self._tell_own_stop())

    def report(self, to: Optional[List[str]] = None) -> None:
        """Says how it stands: call it when something else has changed in `Machine.state`."""
        content = {**self._machine.state(), "stopped": self._latch.is_stopped, "stop": self._latch.number}
        self._say(self.channel.send("state", content, to=to, delivery="latest", echo=False))

    async def ended(self) -> None:
        """Waits until it is not a device there any more; raises what its machine has raised. Safe to cancel."""
        await asyncio.shield(self._obeying)

    async def leave(self) -> None:
        """Halts, and leaves the channel."""
        self._halt("it is leaving its channel")
        await self.channel.leave()
        await self.ended()

    async def _obey(self) -> None:
        try:
            async for event in self._events:
                self._heard(event)
        except Exception:
            LOG.exception("%s: the device has failed, and obeys nothing any more", self.channel.path)
            raise
        finally:
            self._events.close()
            self._halt(self._over)

    def _heard(self, event: Event) -> None:
        reaction = self._latch.observe(event)
        if reaction is not None:
            self._take(reaction)
        if isinstance(event, Expelled) and event.peer == self._core.peer:
            self._over = "it was expelled from its channel" + (f": {event.text}" if event.text else "")
            LOG.warning("%s: %s", self.channel.path, self._over)
        if isinstance(event, Lagged):
            self._say(self._tell_own_stop())
        elif isinstance(event, StateChanged):
            self._link(event.state.word)
        elif isinstance(event, Joined):
            self.report([event.member.peer])
        elif isinstance(event, Dropped) and event.parcel.map().get("sender") == "hub":
            # Who has joined meanwhile is not known.
            self.report()
        elif isinstance(event, Rejoined):
            self.report()
            self._say(self._tell_own_stop())
        elif isinstance(event, Released):
            self._halt("its owner no longer owns it")
            self.report()
        elif isinstance(event, Message):
            self._message(event)

    def _link(self, word: str) -> None:
        if word == "stale":
            self._halt("the hub is silent")
        elif word != "connected":
            # Of a loss that can be resumed, too: what was said meanwhile comes when it is.
            self._latch.lose()
            self._halt("the connection to the hub is lost")

    def _take(self, reaction: Reaction) -> None:
        if reaction.word == "stop":
            self._halt(reaction.why)
        elif reaction.word == "halt":
            self._halt("the connection was lost, or a stop has come that was lifted before")
        elif reaction.word == "free":
            self._machine.free()
        self.report()

    def _halt(self, why: str) -> None:
        for move in self._moves:
            # From here on it takes no step more, but for its own clearing up.
            move.cancel()
        self._machine.halt(why)

    def _message(self, message: Message) -> None:
        name, sender = message.name, message.sender
        if sender == "hub" and name in ("halt", "command"):
            # The safe state of the token: it ends what the owner began, and may move the device then.
            self._halt("safe state")
            self.report()
        if name == "command" and not message.parcel.history:
            self._command(message)

    def _command(self, message: Message) -> None:
        held = self.may_move()
        if held is not None:
            self._refuse(message, "stopped", held.text)
            return
        try:
            self.channel.gate.check(message.parcel)
            moving = self._machine.move(message.content, message)
        except Exception as error:
            self._failed(message, error)
            return
        if inspect.isawaitable(moving):
            move = asyncio.ensure_future(moving)
            self._moves[move] = message
            move.add_done_callback(self._moved)

    def _moved(self, move: asyncio.Future[Any]) -> None:
        message = self._moves.pop(move)
        error = None if move.cancelled() else move.exception()
        if move.cancelled():
            self._refuse(message, "halted", "it was halted")
        elif isinstance(error, Exception):
            self._failed(message, error)

    def _failed(self, message: Message, error: Exception) -> None:
        if isinstance(error, StaleError):
            self._refuse(message, "older-fence", str(error))
        elif isinstance(error, MomError):
            self._refuse(message, error.code or "failed", error.text)
        else:
            LOG.warning("%s: a command failed", self.channel.path, exc_info=error)
            self._refuse(message, "failed", f"{type(error).__name__}: {error}")

    def _refuse(self, message: Message, code: str, why: str) -> None:
        number = message.parcel.id
        error = {"name": code, "text": why}
        content = {"peer": message.sender, "id": number, "state": "error", "statement": 0, "of": 0, "error": error}
        self._say(self.channel.send("status", content, echo=False, reference=number))

    async def _tell_own_stop(self) -> None:
        """Tells the hub that it has stopped itself, unless it knows: from then on it is a stop like any other."""
        held = self._latch.may_move()
        if self._latch.is_own and held is not None:
            await self.channel.send("stop", {"reason": held.text}, to=[self._core.peer])

    def _say(self, saying: Coroutine[Any, Any, Any]) -> None:
        if self._core.state.word == "closed":
            saying.close()
            return
        task = asyncio.ensure_future(saying)
        self._saying.add(task)
        task.add_done_callback(self._said)

    def _said(self, task: asyncio.Future[Any]) -> None:
        self._saying.discard(task)
        error = None if task.cancelled() else task.exception()
        # What cannot be said now is said when the channel is joined again.
        if error is not None and not isinstance(error, MomError):
            LOG.error("%s: a device cannot say how it stands", self.channel.path, exc_info=error)
