"""Driving a device: one command after the other, each to its end."""

from __future__ import annotations

import asyncio
import logging
from types import TracebackType
from typing import Any, Awaitable, Callable, Coroutine, Dict, Mapping, Optional, Set, Type, Union

from ..core.holds import Lost
from ..errors import ClosedError, ConnectionDownError, DroppedError, LocalError, LostError, MomError, RefusedError, WireError
from ..events import Dropped, Event, Lagged, Left, LinkDown, Message, PeerLost
from ..parcel import Parcel
from ..proxies import Channel, TokenGuard
from ..subscriptions import Events
from .command import Command
from .course import ANSWER, Course, Do, Progress, Step
from .end import CommandEnd, DriveError, Halt, Whose
from .heard import Report, StateNews

LOG = logging.getLogger("mom")

Told = Callable[[Progress], None]
"""Is called with how far a command has come."""


class Commander:
    """A device that is driven under a token.

    `Commander(channel, guard)` or, with the guard's fence alone, `Commander(channel, fence)`. It hears by itself when the token is lost, and
    does not give it back: `end` does, by what it is given. `mom.drive.driving` does all of that. Make it before the device says what is
    to be heard of it: a relative command waits for a state, and devices say one to who joins, and to a new owner.

    What the device says is heard from here on until `end` or `close`.
    """

    def __init__(
        self,
        channel: Channel,
        fence: Union[int, TokenGuard],
        *,
        card: Optional[Mapping[str, Any]] = None,
        events: Optional[Events] = None,
    ) -> None:
        """Drives the device of a channel as the owner with this fence, or by this guard.

        - `card`: what the device can do, as `client.card` gives it: by it a relative command is based on the newest state by itself.
        - `events`: those of the channel, if they are taken already, and by nobody else; else those from now on.
        """
        self.channel = channel
        """Its channel."""
        self._core, self._card = channel._core, card
        guard = channel.gate.guard
        self._token = guard.token if guard is not None else None
        self._fence = fence if isinstance(fence, int) else fence.fence
        self._course = Course(self._core.peer, Whose(channel.path, self._token), self._fence)
        self._loop = asyncio.get_running_loop()
        self._since = self._loop.time()
        self._timer: Optional[asyncio.TimerHandle] = None
        self._events = channel.events() if events is None else events
        self._tasks: Set[asyncio.Task[None]] = set()
        self._command = Command("")
        self._sending: Optional[asyncio.Task[None]] = None
        self._news: Optional[asyncio.Queue[Union[Progress, CommandEnd, None]]] = None
        """What is told to who waits for a command; `None` at the end of the work."""
        self._loss: Optional[Lost] = None
        self._loss_end: Optional[asyncio.Future[Optional[CommandEnd]]] = None
        """How the command ends that was under way when the token was lost."""
        self._release: Optional[Callable[[], Awaitable[None]]] = None
        self._released: Optional[asyncio.Future[None]] = None
        self._halt: Optional[asyncio.Future[Halt]] = None
        self._state: Optional[Dict[str, Any]] = None
        self._is_closed = False
        self._listening = asyncio.ensure_future(self._listen())
        hold = self._core.holds.of(self._token or "") if isinstance(fence, int) else fence._hold
        if hold is not None and hold.fence == self._fence:
            # Not by a task: it is to be heard before the answer to a question that the hub has answered after it.
            hold.lost.add_done_callback(self._heard_of_loss)

    @property
    def state(self) -> Optional[Dict[str, Any]]:
        """The content of the device's newest state; `None` if none has come yet."""
        return self._state

    @property
    def is_closed(self) -> bool:
        """Whether the work has ended, so that it hears nothing and carries out nothing any more."""
        return self._is_closed

    async def carry_out(
        self,
        command: Union[str, Command],
        *,
        told: Optional[Told] = None,
        based_on: Union[None, int, str] = None,
        attachments: Optional[Mapping[str, bytes]] = None,
        expires: Optional[float] = None,
        when_asked: bool = False,
    ) -> CommandEnd:
        """Has a command carried out: gives how it ended, and raises nothing for that (`CommandEnd.check` does).

        What is in its way and passes is waited for: the device still does what its last owner began, its mechanism is out of reach, or
        this program's clock is being measured. `told` is called with each `Progress`. The other options are those of `Command`.

        Cancelling it does not end the command: the end of the work does. One command at a time: `RuntimeError` where another call waits,
        or after the end.
        """
        if not isinstance(command, Command):
            command = Command(command, based_on, attachments, expires, when_asked)
        elif (based_on, attachments, expires, when_asked) != (None, None, None, False):
            raise TypeError("the options are those of the Command: give them to that")
        if self._is_closed or self._halt is not None:
            raise RuntimeError("the work has ended: no command is carried out any more")
        if self._news is not None:
            raise RuntimeError("a command is being carried out: one at a time")
        # What has happened by now says nothing of this command.
        while (event := self._events.try_next()) is not None:
            self._take(event)
        news = self._news = asyncio.Queue()
        try:
            self._act(lambda: self._begin_command(command))
            while True:
                came = await news.get()
                if came is None:
                    raise asyncio.CancelledError("the work has ended")
                if isinstance(came, CommandEnd):
                    return came
                if told is not None:
                    told(came)
        finally:
            self._news = None

    async def lost(self, lost: Lost) -> Optional[CommandEnd]:
        """The token is lost: how the command ends that was under way then, within some two seconds; `None` if none was.

        It hears that by itself of a token that this client owns. A command that is wanted later ends as `lost` at once.
        """
        self._note_loss(lost)
        return await asyncio.shield(self._loss_end) if self._loss_end is not None else None

    async def end(self, release: Callable[[], Awaitable[None]]) -> None:
        """Ends the work: `release`, such as `guard.release`, gives the token back, and the device is heard to have ended what runs.

        One that has not said so two seconds after that is stopped, up to three times. `DriveError` says in words that the token was not
        taken back, or that the device was stopped or is silent. A `carry_out` that waits in another task is cancelled.
        """
        if self._is_closed or self._halt is not None:
            raise RuntimeError("the work has ended already")
        halt: asyncio.Future[Halt] = self._loop.create_future()
        self._halt, self._release = halt, release
        try:
            self._act(self._course.cancel)
            taken = await halt
            self._verdict(taken)
        finally:
            self.close()

    def _verdict(self, halt: Halt) -> None:
        """Raises what went wrong with the release, with how the device took it, or with both."""
        words, hint, released = [], None, self._released
        failure = released.exception() if released is not None and released.done() and not released.cancelled() else None
        if failure is not None and not isinstance(failure, MomError):
            raise failure
        if failure is not None:
            words.append(f"release {self._token or 'the token'}: {failure}")
        elif released is None or not released.done():
            words.append("the hub does not say that it has the token back")
        try:
            halt.check(self.channel.path)
        except DriveError as error:
            words.append(error.text)
            hint = error.hint
        if words:
            raise DriveError("; ".join(words), hint) from failure

    def close(self) -> None:
        """Hears nothing any more. The token stays, and what the device does goes on: `end` ends the work."""
        if self._is_closed:
            return
        self._is_closed = True
        self._events.close()
        if self._timer is not None:
            self._timer.cancel()
        for task in (self._listening, self._sending):
            if task is not None:
                task.cancel()
        if self._news is not None:
            self._news.put_nowait(None)
        self._tell_loss_end(None)

    async def __aenter__(self) -> Commander:
        return self

    async def __aexit__(
        self, kind: Optional[Type[BaseException]], error: Optional[BaseException], trace: Optional[TracebackType]
    ) -> None:
        self.close()

    # What happens.

    def _now(self) -> int:
        return int((self._loop.time() - self._since) * 1000)

    def _act(self, happens: Callable[[], None]) -> None:
        """Lets something happen, and does what is to be done then."""
        if self._is_closed:
            return
        self._course.at(self._now())
        happens()
        while (step := self._course.poll()) is not None:
            self._do(step)
        if self._timer is not None:
            self._timer.cancel()
        due = self._course.next_wake()
        self._timer = None if due is None else self._loop.call_at(self._since + due / 1000, self._wake, due)

    def _wake(self, due: int) -> None:
        # The loop's clock may be a little early.
        self._act(lambda: self._course.wake(max(self._now(), due)))

    async def _listen(self) -> None:
        async for event in self._events:
            self._take(event)
        # The channel is left or deleted, or the client closed.
        self._act(self._course.link_down)

    def _take(self, event: Event) -> None:
        self._act(lambda: self._hear(event))

    def _hear(self, event: Event) -> None:
        if isinstance(event, Message):
            self._hear_message(event.parcel)
        elif isinstance(event, Left):
            self._course.gone(event.member.peer, missed=False)
        elif isinstance(event, PeerLost):
            self._course.gone(event.member.peer, missed=True)
        elif isinstance(event, Dropped) and event.parcel.family == "event":
            said = event.parcel.map()
            receiver = said.get("receiver")
            if said.get("sender") == self._course.me:
                self._course.dropped(event.reason, receiver if isinstance(receiver, str) else None)
        elif isinstance(event, LinkDown):
            self._course.link_down()
        elif isinstance(event, Lagged):
            self._course.lagged(event.lost)

    def _hear_message(self, parcel: Parcel) -> None:
        if parcel.name == "state":
            news = StateNews.read(parcel)
            if news is not None:
                self._state = parcel.map()
                self._course.state_told(news, parcel.sender, parcel.history)
        elif parcel.name == "status" and not parcel.history:
            report = Report.read(parcel)
            if report is not None:
                self._course.reported(report, parcel.sender)
        elif parcel.name == "next" and not parcel.history and parcel.id is not None:
            self._course.asks(parcel.id)

    def _heard_of_loss(self, lost: asyncio.Future[Lost]) -> None:
        if not lost.cancelled():
            self._note_loss(lost.result())

    def _note_loss(self, lost: Lost) -> None:
        if self._loss is not None:
            return
        self._loss = lost
        if self._course.is_under_way:
            self._loss_end = self._loop.create_future()
        self._act(lambda: self._course.lost(lost))

    def _tell_loss_end(self, end: Optional[CommandEnd]) -> None:
        if self._loss_end is not None and not self._loss_end.done():
            self._loss_end.set_result(end)

    def _begin_command(self, command: Command) -> None:
        if self._sending is not None:
            # The answer to the one before is not that to this one.
            self._sending.cancel()
        self._command = command
        if self._loss is not None:
            self._course.begin_without(self._loss)
        else:
            self._course.begin(command.text, command.basis(self._card), command.when_asked, command.once)

    # What is done.

    def _do(self, step: Step) -> None:
        if isinstance(step, (Progress, CommandEnd)):
            if self._news is not None:
                self._news.put_nowait(step)
            if isinstance(step, CommandEnd):
                self._tell_loss_end(step)
        elif isinstance(step, Halt):
            if self._halt is not None and not self._halt.done():
                self._halt.set_result(step)
        elif step is Do.ASK:
            self._spawn(self._ask())
        elif step is Do.RELEASE:
            self._spawn(self._give_back())
        elif step is Do.STOP:
            # Of three that cannot be sent, or hang, the next is due all the same.
            self._spawn(self._stop())
        elif not isinstance(step, Do):
            self._sending = self._spawn(self._send(step.on, step.to))

    def _spawn(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    async def _send(self, on: Optional[int], to: Optional[int]) -> None:
        course, command = self._course, self._command
        try:
            # Not under another ownership, should the token be lost and come back meanwhile.
            options: Dict[str, Any] = {"fence": self._fence, "based_on": on, "reference": to, "expires": command.expires}
            parcel = self.channel.message("command", command.content(), echo=False, **options)
            parcel.receipt = True
            receipt = await self._core.request(parcel)
        except (RefusedError, LocalError) as error:
            refusal = error.wire
            self._act(lambda: course.refused(refusal))
        except DroppedError as error:
            dropped = WireError(error.code, str(error))
            self._act(lambda: course.refused(dropped))
        except LostError as error:
            why = str(error)
            self._act(lambda: course.unanswered(why) if error.code == "unknown" else course.kept_back())
        except (ConnectionDownError, ClosedError):
            self._act(course.link_down)
        except Exception as error:
            if not isinstance(error, MomError):
                LOG.error("%s: sending a command failed", self.channel.path, exc_info=error)
            why = str(error)
            self._act(lambda: course.unanswered(why))
        else:
            reached = receipt.map().get("delivered") != 0
            self._act(lambda: course.sent(receipt.reference if reached else None))

    async def _ask(self) -> None:
        try:
            if self._token is not None:
                await self._core.ask("context", "info", self._token, timeout=ANSWER / 1000)
        except MomError:
            # Then it says nothing of a loss.
            pass
        self._act(self._course.asked)

    async def _give_back(self) -> None:
        if self._release is None:
            return
        self._released = asyncio.ensure_future(self._await_release(self._release))
        # Who waits no more has been told that the hub has said nothing, also where the program ends before it does.
        self._released.add_done_callback(lambda released: released.cancelled() or released.exception())
        await asyncio.wait([self._released])
        self._act(self._course.released)

    async def _await_release(self, release: Callable[[], Awaitable[None]]) -> None:
        await release()

    async def _stop(self) -> None:
        reason = "it did not end a command when its token was given back"
        try:
            await self.channel.send_acknowledged("stop", {"reason": reason}, echo=False)
        except MomError as error:
            LOG.warning("%s: the device could not be stopped: %s", self.channel.path, error)
