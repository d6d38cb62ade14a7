"""The life of a client: one connection after another until it is closed."""

from __future__ import annotations

import asyncio
import logging
from dataclasses import dataclass
from typing import Dict, List, Optional, Set, Tuple, Union

from .address import TUNNEL, WEBSOCKET, Address
from .connection import Connection
from .core import Core
from .entry import Entry
from .errors import ConnectionDownError, LocalError, MomError, RefusedError, WireError
from .events import Dropped
from .link import Link
from .login import Credentials
from .parcel import Parcel
from .reports import report
from .states import LinkState, Reconnect
from .transport import Trust, has_websockets

LOG = logging.getLogger("mom")

_NEXT_DOOR = 0.25
_LAST_WORDS = 2.0
_HEARTBEAT = (0.1, 10.0)
"""What may be asked for, in seconds; the hub's own may be less than the most of it."""
_FINAL = ("insecure", "bad-login", "bad-content", "not-encodable")

_worked: Dict[Tuple[str, int], Address] = {}
"""The door of each hub that worked last."""

_plain: Set[Tuple[str, int]] = set()
"""The hubs that do not know of links."""


@dataclass
class Options:
    """How to connect."""

    address: Address
    trust: Trust
    link: bool
    grace: Optional[float]
    heartbeat: Optional[float]
    connect_timeout: float
    reconnect: Optional[Reconnect]
    compress: bool = False
    """Whether both sides compress all that they say."""
    reporter: Union[None, str, Tuple[str, str]] = None
    """Which program reports that its first attempt fails, and its version."""

    def __post_init__(self) -> None:
        # A hub refuses it as it refuses what it does not know: then there would be no link either.
        if self.heartbeat is not None and not _HEARTBEAT[0] <= self.heartbeat <= _HEARTBEAT[1]:
            least, most = _HEARTBEAT
            raise LocalError("bad-content", f"a heartbeat must be from {least:g} s to {most:g} s, not {self.heartbeat:g} s")


class Driver:
    """Connects, logs in, resumes, and drives each connection."""

    def __init__(self, core: Core, credentials: Credentials, options: Options) -> None:
        self.core, self.credentials, self.options = core, credentials, options
        self.ending = False
        """Whether the client is being closed."""
        self._door = ""
        self._written = self._spoke = 0.0
        self._connection: Optional[Connection] = None
        self._logins = 0
        self._asked = -1
        """How much was sent when the hub was asked what it has read, since messages are held back until it says so."""
        core.outbox.held = self._held
        self._rejoining: List[asyncio.Task[None]] = []

    async def first(self) -> Connection:
        """Connects for the first time. What is wrong on this side, or refused for good, is an error at once."""
        self.credentials.doors(self.options.address)
        for told in self.core.on_state:
            told(self.core.state)
        try:
            return await self._attempts(at_once=True)
        except Exception as error:
            self.core.enter(LinkState("closed", error=error.wire if isinstance(error, MomError) else None))
            raise

    async def run(self, connection: Connection) -> None:
        """Drives connections until the client is closed."""
        core, error = self.core, None
        try:
            while not self.ending:
                why = await self._serve(connection)
                closing, core.closing = core.closing, None
                error = closing
                if self.ending or (closing is not None and not closing.may_reconnect):
                    break
                if self.options.reconnect is None:
                    error = closing or WireError("disconnected", why)
                    break
                LOG.info("the connection is lost: %s", closing or why)
                if closing is not None or core.link is None:
                    core.lose_all(str(closing or why))
                else:
                    core.suspend()
                connection = await self._attempts(at_once=False)
        except MomError as failed:
            error = failed.wire or WireError("disconnected", str(failed))
        except Exception as failed:
            # Waiting tasks must be told.
            LOG.exception("the client failed")
            error = WireError("disconnected", f"the client failed: {failed!r}")
        finally:
            core.close(None if self.ending else error)

    async def _attempts(self, at_once: bool) -> Connection:
        """Tries until it is logged in or has resumed, is refused for good, or it takes too long."""
        loop, core, reconnect = asyncio.get_running_loop(), self.core, self.options.reconnect
        begin, attempt, said = loop.time(), 0, ""
        last: Optional[MomError] = None
        while True:
            word = "trying" if core.link is None else "resuming"
            core.enter(LinkState(word, attempt, error=last.wire if last else None))
            if (attempt or not at_once) and reconnect is not None:
                grace = core.link.grace if core.link is not None else 0.0
                left = begin + grace - loop.time()
                wait = reconnect.delay(attempt, last.retry_after if last else None, grace, left)
                if core.link is not None and wait >= left:
                    # An owner is told in time that its token is lost.
                    await asyncio.sleep(left)
                    wait -= max(0.0, left)
                    core.lose_all("the connection was lost for longer than the hub waits")
                    core.enter(LinkState("trying", attempt, error=last.wire if last else None))
                await asyncio.sleep(wait)
            try:
                if core.link is None:
                    return await self._once()
                # By then the hub has given the link up: an attempt that hangs must not keep anybody from knowing.
                return await asyncio.wait_for(self._once(), max(0.0, begin + core.link.grace - loop.time()))
            except asyncio.TimeoutError:
                if core.link is not None:
                    core.lose_all("the connection was lost for longer than the hub waits")
                last = ConnectionDownError("the hub did not answer within the grace time")
            except RefusedError as error:
                if not error.wire.may_retry and not error.wire.may_reconnect:
                    raise
                last = error
            except LocalError as error:
                if error.code in _FINAL:
                    raise
                last = error
            except ConnectionDownError as error:
                last = error
                if at_once and not attempt:
                    await self._report(error)
            attempt += 1
            passed = loop.time() - begin
            if reconnect is None or (reconnect.give_up_after is not None and passed >= reconnect.give_up_after):
                raise last
            if said != str(last):
                said = str(last)
                LOG.warning("waiting for the hub: %s", said)

    async def _report(self, error: ConnectionDownError) -> None:
        """Reports an error of the connection, if it is to be: what a hub refuses it knows."""
        reporter = self.options.reporter
        if reporter is not None:
            program, version = (reporter, None) if isinstance(reporter, str) else reporter
            await report(str(self.options.address), str(error), code=error.code, program=program, version=version)

    async def _once(self) -> Connection:
        connection, door = await self._open()
        self._connection = connection
        try:
            reply, is_resumed = await asyncio.wait_for(self._enter(connection), self.options.connect_timeout)
            # From here on nothing waits, so that nobody can say anything in between.
            if is_resumed:
                self._resumed(reply)
            else:
                self._logged_in(reply)
        except asyncio.TimeoutError:
            connection.abort()
            raise ConnectionDownError(f"{door}: no answer to the login") from None
        except BaseException:
            connection.abort()
            raise
        self._door = str(door)
        self.core.enter(LinkState("connected", door=self._door))
        return connection

    async def _open(self) -> Tuple[Connection, Address]:
        """Tries the doors, each a moment after the previous; the first that leads to a hub is it."""
        address = self.options.address
        doors = self.credentials.doors(address)
        if len(doors) > 1 and not has_websockets():
            doors = [door for door in doors if door.door != WEBSOCKET]
        known = _worked.get((address.host, address.port))
        # A tunnel is the last resort: what one failure has led to must not be for good.
        if known in doors and known.door != TUNNEL:
            doors.sort(key=lambda door: door != known)
        connection, door = await self._race(doors)
        _worked[(address.host, address.port)] = door
        return connection, door

    async def _race(self, doors: List[Address]) -> Tuple[Connection, Address]:
        timeout, numbers = self.options.connect_timeout, self.core.numbers
        pending: Set[asyncio.Task[Connection]] = set()
        tried: Dict[asyncio.Task[Connection], Address] = {}
        errors: List[MomError] = []
        waiting = list(doors)
        try:
            while waiting or pending:
                if waiting:
                    door = waiting.pop(0)
                    task = asyncio.ensure_future(Connection.to(door, self.options.trust, numbers, timeout))
                    pending.add(task)
                    tried[task] = door
                done, pending = await asyncio.wait(
                    pending, timeout=_NEXT_DOOR if waiting else None, return_when=asyncio.FIRST_COMPLETED
                )
                for task in done:
                    error = task.exception()
                    if error is None:
                        pending |= done - {task}
                        return task.result(), tried[task]
                    if not isinstance(error, MomError):
                        raise error
                    errors.append(error)
        finally:
            for task in pending:
                task.add_done_callback(_close)
                task.cancel()
        if all(isinstance(error, LocalError) for error in errors):
            raise errors[0]
        raise ConnectionDownError("; ".join(str(error).replace("no connection: ", "") for error in errors))

    # Entering.

    async def _token(self) -> Optional[str]:
        """The token for this login. What fails to give one may do so later, where it has done so before."""
        try:
            return await self.credentials.ask_for_token()
        except MomError:
            raise
        except Exception as error:
            if not self._logins:
                raise
            raise ConnectionDownError(f"there is no token to log in with: {error!r}") from error

    async def _enter(self, connection: Connection) -> Tuple[Parcel, bool]:
        """Resumes the link, or logs in; the hub's reply, and whether the link goes on."""
        if self.options.compress:
            connection.take_stream()
        if self.core.link is not None:
            resumed = await self._resume(connection, self.core.link)
            if resumed is not None:
                return resumed, True
            self.core.lose_all("the link could not be resumed")
        token = await self._token()
        try:
            parcel = await self._ask(connection, Parcel("login", "login", "/", self._login(token)))
        except RefusedError as error:
            if error.wire.slot not in ("content/link", "content/heartbeat"):
                raise
            # A hub of an earlier version refuses what it does not know, and counts that as a failed login: once is enough.
            _plain.add((self.options.address.host, self.options.address.port))
            parcel = await self._ask(connection, Parcel("login", "login", "/", self._login(token)))
        if parcel.is_("reply", "challenge"):
            parcel = await self._ask(
                connection, Parcel("login", "answer", "/", self.credentials.answer(parcel))
            )
        return parcel, False

    def _logged_in(self, reply: Parcel) -> None:
        self.welcomed(reply)
        self._logins += 1
        self.core.link = Link.of_reply(reply.map()) if self.options.link else None
        self.core.begin_anew()
        if self._logins > 1:
            # Before anything that others may say from here on. Kept, as the loop itself does not.
            self._rejoining = self.core.rejoin_all()

    def begin_anew(self, why: str) -> None:
        """This is another peer from now on: nothing of the old one belongs to it."""
        self.core.lose_all(why)
        self.core.begin_anew()
        self._rejoining = self.core.rejoin_all()

    def _login(self, token: Optional[str]) -> Dict[str, object]:
        content = self.credentials.content(token)
        if (self.options.address.host, self.options.address.port) in _plain:
            return content
        if self.options.link:
            grace = self.options.grace
            content["link"] = True if grace is None else {"grace": int(grace * 1000)}
        if self.options.heartbeat is not None:
            content["heartbeat"] = round(self.options.heartbeat * 1000)
        if self.options.compress:
            content["compress"] = ["stream-deflate"]
        return content

    def welcomed(self, reply: Parcel) -> None:
        """Takes the hub's reply to a login, or to a resume."""
        content = {**self.core.welcome, **reply.map()}
        if not isinstance(content.get("peer"), str) or not isinstance(content.get("user"), str):
            raise ConnectionDownError("the hub's reply to the login names no peer")
        self.core.welcome = {key: value for key, value in content.items() if key not in ("link", "resumed", "read", "checksum", "dropped")}
        self.core.outbox.most = self.core.limit("outbox", 4 << 20)
        self.core.outbox.most_open = self.core.limit("parcel", 8 << 20)
        if self._connection is not None:
            self._connection.decoder.most = self.core.limit("parcel", 8 << 20)
            if self.options.compress and content.get("compress") == "stream-deflate":
                self._connection.begin_stream()

    async def _ask(self, connection: Connection, parcel: Parcel) -> Parcel:
        """A request before anything else is said; `RefusedError` for a refusal."""
        parcel.id = self.core.next_id()
        failed: Optional[ConnectionDownError] = None
        try:
            await connection.send_parcel(parcel)
        except ConnectionDownError as error:
            # A hub that refuses may close before it has read everything; its error is more useful.
            failed = error
        while True:
            heard = await connection.receive()
            if heard is None:
                raise failed or ConnectionDownError("the hub closed the connection at login")
            if heard.is_("time", "ping"):
                content = self.core.clock._answer()
                await connection.send_parcel(Parcel("time", "pong", reference=heard.id, content=content))
            elif heard.family == "error":
                raise RefusedError(heard.error())
            elif heard.family == "reply" and heard.reference == parcel.id:
                return heard

    async def _resume(self, connection: Connection, link: Link) -> Optional[Parcel]:
        """The hub's reply if the link goes on over this connection; if not, a login may follow on it."""
        try:
            challenge = await self._ask(connection, Parcel("login", "resume", "/", {"link": link.name}))
            return await self._ask(connection, Parcel("login", "answer", "/", link.answer(challenge)))
        except RefusedError as error:
            if error.wire.closes:
                raise
            LOG.info("the link is not resumed: %s", error)
            return None

    def _resumed(self, reply: Parcel) -> None:
        content = reply.map()
        if content.get("resumed") is not True or not self.core.resume(content):
            # The two sides count differently: something would come twice, or never.
            self.core.lose_all("the hub has read parcels that differ from those sent")
            raise ConnectionDownError("the hub resumed a link with impossible counts")
        self.welcomed(reply)
        dropped = content.get("dropped")
        if isinstance(dropped, int) and dropped > 0:
            self.core.subscribers.deliver_others(Dropped("lost", dropped, reply))

    # One connection.

    async def _serve(self, connection: Connection) -> str:
        """Drives one connection to its end; says why it ended."""
        core = self.core
        self._written, self._asked = asyncio.get_running_loop().time(), -1
        connection.gone, connection.said = core.limit("gone", 30_000) / 1000, self._said
        self._ping()
        sender = asyncio.ensure_future(core.outbox.send_all(connection, self._wrote))
        reader = asyncio.ensure_future(self._read(connection))
        pulse = asyncio.ensure_future(self._pulse(connection))
        tasks: List[asyncio.Future[None]] = [sender, reader, pulse]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            if sender.done() and not reader.done():
                # Writing fails first where the hub has closed; what it said last is still to be read.
                await asyncio.wait([reader], timeout=_LAST_WORDS)
        finally:
            core.is_up = False
            connection.abort()
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        for task in (reader, pulse, sender):
            error = None if task.cancelled() else task.exception()
            if error is not None and not isinstance(error, MomError):
                raise error
            if error is not None:
                return str(error)
        return "nothing was heard of the hub" if pulse.done() and not pulse.cancelled() else "the hub closed"

    def _wrote(self, entry: Entry) -> None:
        self._written = asyncio.get_running_loop().time()
        if self.core.link is not None:
            self.core.link.wrote(entry)

    async def _read(self, connection: Connection) -> None:
        core = self.core
        while True:
            parcel = await connection.receive()
            if parcel is None:
                return
            if core.state.word == "stale":
                core.enter(LinkState("connected", door=self._door))
            due = core.link is not None and core.link.count(parcel)
            if parcel.family == "time":
                self._receive_time(parcel)
            else:
                core.receive(parcel)
            if due:
                self._acknowledge()

    def _receive_time(self, parcel: Parcel) -> None:
        core = self.core
        if parcel.name == "ping":
            self._spoke = asyncio.get_running_loop().time()
            self._acknowledge()
            core.post(Parcel("time", "pong", reference=parcel.id, content=core.clock._answer()))
        elif parcel.name == "pong" and core.clock._answered(parcel):
            self._ping()
        elif parcel.name == "ack" and core.link is not None:
            if not core.link.acknowledged(parcel.map()):
                core.link = None
                raise ConnectionDownError("the hub reports having read other parcels than were sent")
            core.outbox.wake()

    def _acknowledge(self) -> None:
        said = self.core.link.acknowledgement() if self.core.link is not None else None
        if said is not None:
            self.core.post(said)

    def _held(self) -> None:
        # By itself the hub says at once what it has read of much only; before a pong it says all.
        if self.core.link is not None and self._asked != self.core.link.sent:
            self._asked = self.core.link.sent
            self._ping()

    def _said(self) -> float:
        """When a sign of life was said last, by the loop's clock: on a slow link it may still be on its way behind what is large."""
        return max(self._written, self._spoke)

    def _ping(self) -> None:
        self._spoke = asyncio.get_running_loop().time()
        self._acknowledge()
        number = self.core.next_id()
        self.core.post(Parcel("time", "ping", id=number, content=self.core.clock._ask(number)))

    async def _pulse(self, connection: Connection) -> None:
        """Says signs of life, and ends when nothing is heard for too long."""
        loop, core = asyncio.get_running_loop(), self.core
        heartbeat, gone = core.limit("heartbeat", 10_000) / 1000, core.limit("gone", 30_000) / 1000
        pinged = loop.time()
        while True:
            await asyncio.sleep(heartbeat / 8)
            now = loop.time()
            silent = now - connection.heard
            # The hub has given the link up, too, where it has not heard of this side for so long.
            if silent >= gone or now - self._said() >= gone:
                return
            if silent >= 1.5 * heartbeat and core.state.word == "connected":
                core.enter(LinkState("stale", door=self._door))
            quiet = now - self._written >= heartbeat * 7 / 8 or silent >= heartbeat
            if quiet and now - pinged >= heartbeat / 2:
                pinged = now
                self._ping()


def _close(task: "asyncio.Task[Connection]") -> None:
    """Ends a connection that came too late."""
    if not task.cancelled() and task.exception() is None:
        task.result().abort()
