"""The device as a peer: hears its channel, lets time pass, and sends what is to be said."""

from __future__ import annotations

import asyncio
import logging
import time
from typing import Any, Callable, List, Optional

from ..core import Core
from ..events import Event, Expelled, LinkDown, Message, Rejoined, StateChanged
from ..latch import Held
from ..parcel import Parcel
from ..proxies import Channel
from ..subscriptions import Events
from ..values import now as time_of_day
from ..values import sayable
from .command import State
from .declared import DeclaredMachine
from .device import Device
from .errors import DeviceError
from .outlet import Outlet
from .server import DeviceServer, Resumed

LOG = logging.getLogger("mom")

_SLOW_HEARTBEAT = 1000
"""More than that, in ms, is much for what moves."""

_FAREWELL = 1.0
"""How long the last statuses may take to leave, in seconds."""

_LEAVING = "it is leaving its channel"

_EARLY = 1000
"""So many µs before it is due a timer of the loop may come."""


class DevicePeer:
    """A device at work in its channel, made by `Client.obey`.

    It halts at each stop, each loss of the connection, each silence and each gap in what it has heard, and at its end. It moves
    nothing before it has heard on this connection how it stands, lets only an unstop free it that names the newest stop, and says
    how it stands after each.
    """

    def __init__(
        self, core: Core, channel: Channel, device: Device, events: Events, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._core, self._events, self._clock = core, events, clock
        self.channel = channel
        """Its channel."""
        self.device = device
        """What it moves."""
        self._begin = clock()
        self._machine = DeclaredMachine(device, lambda: self._clock())
        # Before anything else: it may still do what it did before this program began.
        self._machine.halt(0)
        self._machine.on_failure = self._break
        self._machine.on_end = self._verb_ended
        self._machine.may_go_on = self._let_time_pass
        self._server = DeviceServer(self._machine, channel.path, time_of_day())
        self._server.name = core.peer
        if device.max_age is not None:
            self._server.with_max_age(device.max_age * 1000)
        self._outlet = Outlet(core.send, self._may_send, self._is_wanted, self._break)
        self._timer: Optional[asyncio.TimerHandle] = None
        self._is_lost, self._begins_anew = False, False
        """Whether the connection was lost and the link has not gone on yet; whether it will not, so that the channel is joined again."""
        self._decides = False
        """Whether its server is at work."""
        self._is_leaving = False
        self._failure: Optional[Exception] = None
        self._is_over = False
        self._over = "it is no longer a device of its channel"
        """Why, once it is so."""
        heartbeat = core.limit("heartbeat", 10_000)
        if heartbeat > _SLOW_HEARTBEAT:
            text = "the device of %s notices only after %g s that its hub is silent: connect with heartbeat=0.5"
            LOG.warning(text, channel.path, heartbeat * 1.5 / 1000)
        self.on_end: Callable[[], None] = lambda: None
        """Called when it has ended."""
        self._obeying = asyncio.ensure_future(self._obey())
        self._obeying.add_done_callback(lambda _: self.on_end())

    # What its program asks and says.

    def may_move(self) -> Optional[Held]:
        """Why it may not move; `None` if it may."""
        if self.is_over:
            return Held("unknown", self._over)
        return self._server.may_move() or self._why_not()

    @property
    def is_over(self) -> bool:
        """Whether it obeys nothing any more; what its verbs clear up may still come to its end."""
        return self._is_over or self._obeying.done()

    @property
    def is_stopped(self) -> bool:
        """Whether a stop holds."""
        return self._server.latch.is_stopped or self._server.estop.owed is not None

    @property
    def state(self) -> State:
        """How it stands."""
        return self._server.state()

    def stop_itself(self, why: str) -> None:
        """Stops by itself, as at a bumper, until a peer lifts that."""
        self._do(lambda now: self._server.stop_itself(sayable(why), now))

    def fail(self, error: DeviceError) -> None:
        """Ends every command with this error, because the device cannot carry it out; halts it."""
        self._do(lambda now: self._server.fail(now, error))

    def report(self) -> None:
        """Says how it stands: call it when something else has changed in `Device.report`, or whether it is reached."""
        self._do(lambda now: self._server.note(now, lambda machine: None) + self._server.report())

    async def ended(self) -> None:
        """Waits until it is not a device there any more; raises what its `halt`, `position` or `report` has raised. Safe to cancel."""
        await asyncio.shield(self._obeying)

    async def leave(self) -> None:
        """Halts, says so, and leaves the channel."""
        self._is_leaving = True
        self._do(lambda now: self._server.halt(_LEAVING, now))
        try:
            await asyncio.wait_for(asyncio.shield(self._outlet.flush()), _FAREWELL)
        except asyncio.TimeoutError:
            LOG.warning("%s: the last messages of a device did not leave in time", self.channel.path)
        await self.channel.leave()
        await self.ended()

    # What it hears.

    async def _obey(self) -> None:
        try:
            self._do(lambda now: self._server.report())
            while self._failure is None:
                event = await self._events.next()
                if event is None:
                    break
                self._hear(event)
            if self._failure is not None:
                raise self._failure
        except Exception as error:
            if self._failure is None:
                self._break(error)
            raise
        finally:
            self._events.close()
            await self._end()

    def _hear(self, event: Event) -> None:
        if isinstance(event, StateChanged):
            self._hear_link(event.state.word)
            return
        if isinstance(event, Rejoined):
            # It may have come back as another peer, by whose name it is put out and says its own stops.
            self._server.name = self._core.peer
        if isinstance(event, (LinkDown, Rejoined)):
            self._is_lost, self._begins_anew = False, isinstance(event, LinkDown)
        age = self._core.clock.age(event.parcel) if isinstance(event, Message) else None
        self._server.held = self._why_not()
        self._do(lambda now: self._server.handle(event, self.channel.gate, age, now))
        if isinstance(event, Expelled) and event.peer == self._core.peer:
            self._over = "it was expelled from its channel" + (f": {event.text}" if event.text else "")
            LOG.warning("%s: %s", self.channel.path, self._over)

    def _hear_link(self, word: str) -> None:
        if word == "stale":
            self._do(lambda now: self._server.halt("the hub is silent", now))
        elif word != "connected":
            # Of a loss that can be resumed, too: what was said meanwhile comes when it is.
            self._is_lost = not self._begins_anew
            self._do(lambda now: self._server.handle(LinkDown(), self.channel.gate, None, now))
        elif self._is_lost:
            self._is_lost = False
            self._do(lambda now: self._server.handle(Resumed(), self.channel.gate, None, now))
        else:
            self._do(lambda now: [])

    def _why_not(self) -> Optional[Held]:
        if self._is_leaving:
            return Held("unknown", _LEAVING)
        return None if self._core.state.word == "connected" else Held("unknown", "the hub is silent")

    # What time and its verbs do.

    def _now(self) -> int:
        return int((self._clock() - self._begin) * 1e6)

    def _do(self, action: Callable[[int], List[Parcel]]) -> None:
        """Lets the server decide, sends what is to be said, and sees to it that it is called when that is due."""
        if self._is_over:
            return
        if self._decides:
            # A verb or a halt says so: what it is called for comes to its end first.
            asyncio.get_running_loop().call_soon(self._do, action)
            return
        self._decides = True
        try:
            self._outlet.push(action(self._now()))
            self._schedule()
        except Exception as error:
            self._break(error)
        finally:
            self._decides = False

    def _schedule(self) -> None:
        due = self._server.next_wake()
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if due is not None:
            wait = max(0.0, (due - self._now()) / 1e6)
            self._timer = asyncio.get_running_loop().call_later(wait, self._wake, due)

    def _wake(self, due: int) -> None:
        self._timer = None
        self._do(lambda now: self._server.advance(due if now < due <= now + _EARLY else now))

    def _verb_ended(self, task: asyncio.Future[Any]) -> None:
        self._do(lambda now: self._server.note(now, lambda machine: machine.ended(task, now)))

    def _let_time_pass(self) -> None:
        """Before each step of a verb: where the program has stood still, no step follows."""
        if not self._is_over and self._server.silence(self._now()) > self._machine.patience:
            self._do(self._server.advance)

    # How it ends.

    def _break(self, error: Exception) -> None:
        """The device has failed: it stands, and obeys nothing any more."""
        if self._is_over:
            LOG.error("%s: the device has failed once more", self.channel.path, exc_info=error)
            return
        LOG.error("%s: the device has failed, and obeys nothing any more", self.channel.path, exc_info=error)
        self._failure = error
        self._outlet.push(self._server.break_off(DeviceError("link", f"{self._machine.name} has failed: {type(error).__name__}: {error}")))
        self._take_leave()
        self._machine.give_up()
        self._events.close()

    async def _end(self) -> None:
        """Halts, lets its verbs come to their end, and halts again."""
        is_broken = self._is_over
        try:
            self._do(lambda now: self._server.halt(self._over, now))
            self._take_leave()
        finally:
            await self._machine.come_to_an_end()
        if self._failure is not None and not is_broken:
            raise self._failure

    def _take_leave(self) -> None:
        self._is_over = True
        if self._timer is not None:
            self._timer.cancel()

    def _may_send(self) -> bool:
        """Whether what it says reaches its channel."""
        place = self.channel._place
        return self._core.is_up and self._core.places.get(place.path) is place and place.joining is None

    def _is_wanted(self, parcel: Parcel) -> bool:
        """Whether something is still to be said: a stop of its own is not, where the one that it may have missed has come meanwhile."""
        return parcel.name != "stop" or self._server.latch.is_own or self._server.estop.owed is not None
