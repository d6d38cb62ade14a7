"""Agents for hire: one waits in a channel of its own, is asked for a task there, is lent the token for it, works, and gives it back.

    import asyncio, mom, mom.agent

    class Waver(mom.agent.Agent):
        \"\"\"Waves with the arm.\"\"\"

        verb, token = "wave", "/robot/token"

        async def work(self, task):
            async with task.driving("/robot/arm") as arm:
                for height in (350, 250, 300):
                    (await arm.carry_out(f"move 0 0 {height} 0 0")).check()
                    await task.tell(f"I am at {height} mm")
            return "I have waved"

    async def main():
        async with mom.connect("mom://localhost", user="waver", password="waver") as client:
            await mom.agent.serve(client, "/waving", Waver())

    asyncio.run(main())

A peer asks by a message `wave` in `/waving`, hears `progress` with the state `accepted`, and gives the agent the token; docs/agents.md has
the rules that the kit keeps.
"""

from __future__ import annotations

import asyncio
import logging
import time
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any, Awaitable, ClassVar, Dict, List, Mapping, Optional, TypeVar, Union

from .client import Client
from .core.holds import Lost
from .drive import DriveError, Driving, driving, lost_words
from .errors import ClosedError, LocalError, MomError, WireError
from .events import Count, Event, Lagged, Left, Message, Offer, PeerLost, PeerResumed
from .parcel import Parcel
from .proxies import Channel, Token, TokenGuard
from .values import sayable

__all__ = ["OFFERED", "Agent", "Refused", "Task", "serve"]

LOG = logging.getLogger("mom")
T = TypeVar("T")

OFFERED = 15.0
"""Seconds for which an accepted task waits for the token."""
_HUB = 0.5
"""Seconds that the hub may need to say that a scope is used up."""
_ANSWER = 10.0
"""Seconds in which it says whether the token is lost."""
_GIVEN = 0.5
"""Seconds in which work that is to end gives the token back: then that is done without it."""
_LAST = 5.0
"""Seconds in which it has to end, and the device with it: then it is said that it does not."""
_MET = 9.0
"""Seconds that finding out whether a task can be done may take: a peer that asks waits no longer for an answer."""
_AWAY = 5.0
"""Seconds for which the peer of a task may be away, as its connection is lost, before the task ends."""
_TEXT = 2000
"""The most letters of what is said of a task."""


class Refused(Exception):
    """Why an agent does not take a task: raise it in `read` or `meet`. `code` is a word of `mom.CODES`."""

    def __init__(self, code: str, text: str) -> None:
        super().__init__(code, text)
        self.wire = WireError(code, text)
        """As it is said to the peer that asked."""


class Agent:
    """What an agent can be hired for: make a class of it with `verb`, `token` and `work`."""

    verb: ClassVar[str] = ""
    """The message by which a task is asked for."""
    token: ClassVar[str] = ""
    """The token that has to be lent for it, unless `meet` says another one."""

    def read(self, content: Any) -> Any:
        """Reads a task, which is `Task.what` from then on; raises `Refused("bad-content", …)`."""
        return content

    def words(self, what: Any) -> str:
        """A task in words that follow "alice has had it": `wave`."""
        return self.verb

    async def meet(self, task: Task) -> str:
        """Joins what the task needs, and finds out whether it can be done, before anything is lent; gives the token that has to be lent.

        Raises `Refused("try-later", …)`.
        """
        return self.token

    async def work(self, task: Task) -> Union[None, str, Mapping[str, Any]]:
        """Works under the token, and says what it has done, in words or as a map with `text`.

        It is cancelled where the task has to end. What it raises ends the task as `failed`: a `DriveError` and `CommandFailed` in their
        own words, all else as an internal error, and is logged. The token is given back whatever happens.
        """
        raise NotImplementedError


@dataclass(eq=False)
class Task:
    """A task that a peer has asked for."""

    peer: str
    """Whose it is."""
    what: Any
    """What is to be done, as `Agent.read` has it."""
    client: Client
    """This agent."""
    channel: Channel
    """Its channel."""
    asked: Optional[int] = None
    """The id of the message that asked for it."""
    guard: Optional[TokenGuard] = None
    """The token, once it was lent."""
    since: float = field(default_factory=time.monotonic)
    _ending: asyncio.Event = field(default_factory=asyncio.Event)
    _why: str = ""

    @property
    def ending(self) -> Optional[str]:
        """Why it is to end, if it is."""
        return self._why if self._ending.is_set() else None

    def driving(self, path: str) -> Driving:
        """Drives a device that the token guards: `async with task.driving("/robot/arm") as arm:`, as `mom.drive.driving` does."""
        if self.guard is None:
            raise DriveError("nothing was lent yet")
        return driving(self.client, path, guard=self.guard)

    async def tell(self, text: str, **more: Any) -> None:
        """Tells all how far it is."""
        await self._tell("working", {"text": text, **more})

    def end(self, why: str) -> None:
        """Has it end, as `cancelled`."""
        if not self._ending.is_set():
            self._why = why
            self._ending.set()

    async def _tell(self, state: str, more: Mapping[str, Any], to: Optional[List[str]] = None) -> None:
        content = {**more, "by": self.peer, "state": state}
        await _say(self.channel, "progress", content, to, self.asked if to is not None else None)

    async def _unless_ended(self, doing: Awaitable[T]) -> T:
        """What this gives, unless the task is to end before: then `_Cancelled`, and it is cancelled."""
        work, ends = asyncio.ensure_future(doing), asyncio.ensure_future(self._ending.wait())
        try:
            await asyncio.wait({work, ends}, return_when=asyncio.FIRST_COMPLETED)
            if not work.done():
                raise _End("cancelled", self._why)
            return await work
        finally:
            ends.cancel()
            await _cancel(work)


@dataclass
class _End(Exception):
    """How a task has ended: `done`, `failed`, `cancelled` or `lost`."""

    state: str
    text: str
    more: Mapping[str, Any] = field(default_factory=dict)


async def serve(client: Client, path: str, agent: Agent) -> None:
    """Serves in its channel, until it is cancelled or its connection is closed for good: then a task under way ends, and the token returns."""
    if not isinstance(agent, Agent) or not agent.verb:
        raise TypeError(f"an agent is made of a class with mom.agent.Agent as its base and a verb, not of {agent!r}")
    channel = await client.channel(path)
    life = _Life(client, channel, agent)
    with closing(channel.events()) as events:
        LOG.info("%s: the agent is ready in %s", client.name, path)
        try:
            async for event in events:
                await life.hear(event)
        finally:
            await life.end("the agent's program ends")
    raise ClosedError(WireError("unknown-path", f"{path} is gone, or the connection is closed"))


class _Life:
    """The life of an agent: it hears tasks, and has one at a time carried out."""

    def __init__(self, client: Client, channel: Channel, agent: Agent) -> None:
        self.client, self.channel, self.agent = client, channel, agent
        self.task: Optional[Task] = None
        self.working: Optional[asyncio.Future[None]] = None
        self.away: Optional[asyncio.TimerHandle] = None

    async def hear(self, event: Event) -> None:
        """Hears what a peer asks for."""
        if isinstance(event, (Left, PeerLost, PeerResumed)) and self.task is not None and event.member.peer == self.task.peer:
            self._note_peer(self.task, event)
        if not isinstance(event, Message) or event.parcel.history or event.parcel.sender is None:
            return
        try:
            if event.name == self.agent.verb:
                self._take(event.parcel)
            elif event.name == "cancel":
                self._cancel(event.parcel.sender)
        except Refused as refused:
            await _refuse(self.channel, event.parcel, refused)

    def _note_peer(self, task: Task, event: Event) -> None:
        if self.away is not None:
            self.away.cancel()
        if isinstance(event, Left):
            task.end(f"{task.peer} has left")
        elif isinstance(event, PeerLost):
            self.away = asyncio.get_running_loop().call_later(_AWAY, task.end, f"{task.peer} has lost its connection")

    def _words(self, what: Any) -> str:
        try:
            return str(self.agent.words(what))
        except Exception:
            LOG.exception("%s: a task has no words", self.client.name)
            return self.agent.verb

    def _take(self, parcel: Parcel) -> None:
        if self.task is not None:
            had = f"{self.task.peer} has had it {self._words(self.task.what)}"
            raise Refused("try-later", f"busy: {had} for {int(time.monotonic() - self.task.since)} s")
        what = self._read(parcel)
        self.task = Task(parcel.sender or "", what, self.client, self.channel, parcel.id)
        LOG.info("%s: a task of %s: %s", self.client.name, self.task.peer, self._words(what))
        self.working = asyncio.ensure_future(self._carry_out(self.task, parcel))

    def _read(self, parcel: Parcel) -> Any:
        try:
            return self.agent.read(parcel.content)
        except Refused:
            raise
        except (Exception, asyncio.CancelledError) as error:
            # Whatever a peer says, it does not end the agent.
            LOG.exception("%s: what %s asks for cannot be read", self.client.name, parcel.sender)
            raise Refused("bad-content", f"the content of `{self.agent.verb}` cannot be read: {type(error).__name__}: {error}") from error

    def _cancel(self, peer: str) -> None:
        if self.task is None:
            raise Refused("try-later", "there is no task to cancel")
        if self.task.peer != peer:
            raise Refused("denied", f"the task is {self.task.peer}'s; only {self.task.peer} cancels it")
        self.task.end(f"{peer} cancelled it")

    async def end(self, why: str) -> None:
        """Ends a task under way."""
        if self.task is not None and self.working is not None:
            self.task.end(why)
            done, _ = await asyncio.wait({self.working}, timeout=_LAST + 1)
            if not done:
                LOG.warning("%s: the task did not end in time; the hub takes the token back", self.client.name)
                await _cancel(self.working)

    async def _carry_out(self, task: Task, parcel: Parcel) -> None:
        """Carries a task out, or refuses it, and says how it ended once the next one can be taken."""
        try:
            end: Union[_End, Refused] = await self._ended(task)
        except Refused as refused:
            end = refused
        except Exception:
            LOG.exception("%s: the task of %s failed", self.client.name, task.peer)
            end = _End("failed", "the agent failed with an internal error")
        finally:
            self.task = None
        if isinstance(end, Refused):
            LOG.info("%s: refused: %s", self.client.name, end.wire.text)
            await _refuse(self.channel, parcel, end)
            return
        LOG.info("%s: the task of %s has ended: %s: %s", self.client.name, task.peer, end.state, end.text)
        await task._tell(end.state, {**end.more, "text": sayable(end.text)[:_TEXT]})

    async def _ended(self, task: Task) -> _End:
        try:
            token = await task._unless_ended(asyncio.wait_for(self._token(task), _MET))
        except _End as end:
            raise Refused("try-later", end.text) from None
        except asyncio.TimeoutError:
            raise Refused("try-later", f"it could not be found out within {_MET:g} s whether that can be done") from None
        # Before anything is asked for, so that no offer is missed.
        with closing(token.events()) as offers:
            await task._tell("accepted", {"text": "offer me the token", "agent": self.client.name}, [task.peer])
            try:
                await task._unless_ended(self._offered(task, token, offers))
                # Not to be cancelled: what the hub grants meanwhile would be nobody's.
                task.guard = guard = await self._accept(token)
            except _End as end:
                return end
        try:
            await task.tell("")
            # What has ended already does not begin.
            return _End("cancelled", task._why) if task._ending.is_set() else await self._work(task, token, guard)
        finally:
            await _release(guard)

    async def _token(self, task: Task) -> Token:
        try:
            return await self.client.token(await self.agent.meet(task))
        except MomError as error:
            raise Refused("try-later", str(error)) from error

    async def _offered(self, task: Task, token: Token, offers: Any) -> None:
        """Waits until the peer of the task offers the token."""
        try:
            await asyncio.wait_for(self._offer(task, token, offers), OFFERED)
        except asyncio.TimeoutError:
            raise _End("failed", f"{task.peer} did not offer the token within {OFFERED:g} s") from None

    async def _accept(self, token: Token) -> TokenGuard:
        try:
            return await token.accept()
        except MomError as error:
            raise _End("failed", f"accept {token.path}: {error}") from error

    async def _offer(self, task: Task, token: Token, offers: Any) -> None:
        async for event in offers:
            if not isinstance(event, Offer) or event.to != self.client.name:
                continue
            if event.by == task.peer:
                return
            LOG.info("%s: an offer of %s without a task is declined", self.client.name, event.by)
            try:
                await token.decline()
            except MomError as error:
                LOG.warning("%s: an offer was not declined: %s", self.client.name, error)
        raise _End("failed", "the connection to the hub is closed")

    async def _work(self, task: Task, token: Token, guard: TokenGuard) -> _End:
        """How the work ends: by itself, with the task, with the token, or with what was lent."""
        work = asyncio.ensure_future(self.agent.work(task))
        beyond = asyncio.ensure_future(_beyond(token, guard))
        lost, ends = asyncio.ensure_future(_taken(guard, self.client.name)), asyncio.ensure_future(task._ending.wait())
        try:
            await asyncio.wait({work, beyond, lost, ends}, return_when=asyncio.FIRST_COMPLETED)
            if not lost.done() and ends.done():
                return _End("cancelled", task._why)
            if not lost.done() and beyond.done():
                return _End("failed", beyond.result())
            if not lost.done() and not work.cancelled() and work.exception() is not None:
                # A device that refuses because the token is lost may say so before the hub does.
                asked = asyncio.ensure_future(_asked(token))
                await asyncio.wait({lost, asked}, timeout=_ANSWER, return_when=asyncio.FIRST_COMPLETED)
                await _cancel(asked)
            return _End("lost", _scope_words(guard, lost.result())) if lost.done() else _done(work)
        finally:
            for other in (beyond, lost, ends):
                other.cancel()
            await self._end_work(task, work, guard)

    async def _end_work(self, task: Task, work: asyncio.Future[Any], guard: TokenGuard) -> None:
        work.cancel()
        gone = asyncio.ensure_future(guard.lost())
        await asyncio.wait({work, gone}, timeout=_GIVEN, return_when=asyncio.FIRST_COMPLETED)
        gone.cancel()
        if not guard.is_lost:
            await _release(guard)
        done, _ = await asyncio.wait({work}, timeout=_LAST)
        if not done:
            LOG.error("%s: the work for %s does not end; the token was given back without it", self.client.name, task.peer)
            await asyncio.wait({work})
        if not work.cancelled() and work.exception() is not None:
            LOG.debug("%s: the work for %s ended with", self.client.name, task.peer, exc_info=work.exception())


def _done(work: asyncio.Future[Any]) -> _End:
    if work.cancelled():
        return _End("failed", "the agent cancelled its own work")
    error = work.exception()
    if isinstance(error, (DriveError, MomError)):
        at_end = getattr(error, "at_end", None)
        return _End("failed", f"{error}; {at_end}" if at_end else str(error))
    if error is not None:
        raise error
    found = work.result()
    if isinstance(found, Mapping):
        more: Dict[str, Any] = dict(found)
        return _End("done", str(more.pop("text", "")), more)
    return _End("done", "" if found is None else str(found))


async def _taken(guard: TokenGuard, me: str) -> Lost:
    """Waits until the token is lost, and not given back by this agent itself, as at the end of `Task.driving`."""
    lost = await guard.lost()
    if lost.reason in ("released", "returned") and lost.by == me:
        await asyncio.get_running_loop().create_future()
    return lost


async def _beyond(token: Token, guard: TokenGuard) -> str:
    """Waits until what was lent is at its end though the hub has not said so: by our own clock, or as its lender has left it."""
    loan = guard.loan
    if loan is None:
        return await asyncio.get_running_loop().create_future()  # type: ignore[no-any-return]
    orphaned = asyncio.ensure_future(_orphaned(token, loan.giver))
    try:
        done, _ = await asyncio.wait({orphaned}, timeout=None if loan.time is None else loan.time + _HUB)
        if done:
            return f"{loan.giver}, who lent {token.path}, has left"
        return f"{_used_up(guard)}; the hub has not said so"
    finally:
        orphaned.cancel()


async def _orphaned(token: Token, giver: str) -> None:
    with closing(token.events()) as events:
        # Of a loan without a giver the hub names none. A question that fails tells nothing; a lost link ends the work otherwise.
        if await _asked(token) is False:
            return
        async for event in events:
            if isinstance(event, Left) and event.member.peer == giver:
                return
            # Where many are, the hub tells how many.
            if isinstance(event, (Count, Lagged)) and await _asked(token) is False:
                return
    await asyncio.get_running_loop().create_future()


async def _asked(token: Token) -> Optional[bool]:
    """Whether the token is lent, as the hub says."""
    try:
        return "delegated" in await token.info()
    except MomError:
        return None


def _scope_words(guard: TokenGuard, lost: Lost) -> str:
    """Why the token is gone, in words; that a scope is used up, where the hub took it back by itself."""
    if guard.loan is not None and lost.reason == "returned" and lost.by is None:
        return f"lost {guard.path}: returned, as {_used_up(guard)}"
    return lost_words(guard.path, lost)


def _used_up(guard: TokenGuard) -> str:
    loan = guard.loan
    assert loan is not None
    limits = [f"{loan.time:g} s"] if loan.time is not None else []
    limits += [f"{loan.commands} commands"] if loan.commands is not None else []
    return f"the scope is used up: {' or '.join(limits)}"


async def _release(guard: TokenGuard) -> None:
    try:
        await guard.release()
    except MomError as error:
        # A lost link gives it back, too.
        LOG.warning("%s was not given back: %s", guard.path, error)


async def _cancel(work: asyncio.Future[Any]) -> None:
    """Cancels it, and waits for its end; what it raises then is nobody's."""
    if not work.done():
        work.cancel()
        await asyncio.wait({work})
    if not work.cancelled():
        work.exception()


async def _refuse(channel: Channel, parcel: Parcel, refused: Refused) -> None:
    wire = refused.wire
    content = {"code": wire.number, "name": wire.code, "text": sayable(wire.text)[:_TEXT], "by": parcel.sender}
    await _say(channel, f"{parcel.name}-refused", content, [parcel.sender or ""], parcel.id)


async def _say(channel: Channel, name: str, content: Any, to: Optional[List[str]], reference: Optional[int]) -> None:
    try:
        try:
            await channel.send(name, content, to=to, reference=reference, echo=False)
        except LocalError as error:
            # What its author says beside that cannot be sent: how the task stands is told all the same.
            LOG.warning("%s: what `%s` says beside its text is left out: %s", channel.path, name, error)
            kept = {key: content[key] for key in ("by", "state", "agent", "code", "name") if key in content}
            text = str(content.get("text") or "")
            await channel.send(name, {**kept, "text": sayable(text)[:_TEXT]}, to=to, reference=reference, echo=False)
    except MomError as error:
        # The peer that asked hears of the end by the token's return, too.
        LOG.warning("%s: `%s` was not sent: %s", channel.path, name, error)
