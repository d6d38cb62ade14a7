"""The client: one peer at a hub."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from datetime import datetime
from types import TracebackType
from typing import Any, AsyncIterator, Callable, Dict, Generator, Iterable, List, Mapping, Optional, Tuple, Type, Union

from .address import Address
from .clock import HubClock
from .core import Core, Place
from .device import Device, DevicePeer
from .driver import Driver, Options
from .errors import MomError
from .events import ContextInfo, Member, Other
from .login import Credentials, JwtSource, Key
from .parcel import Parcel
from .proxies import Channel, Session, Token, pages, thinning
from .states import LinkState, Reconnect
from .stops import StopReport, StopState
from .subscriptions import Events
from .transport import Trust
from .values import now

_CLOSE = 1.0


class Connect:
    """A client to come: `client = await mom.connect(…)`, or `async with mom.connect(…) as client:`."""

    def __init__(
        self, core: Callable[[], Core], credentials: Credentials, options: Options, states: List[Callable[[LinkState], None]]
    ) -> None:
        self._core, self._credentials, self._options, self._states = core, credentials, options, states
        self._client: Optional[Client] = None

    def __await__(self) -> Generator[Any, None, Client]:
        return self._run().__await__()

    async def _run(self) -> Client:
        core = self._core()
        core.on_state.extend(self._states)
        driver = Driver(core, self._credentials, self._options)
        connection = await driver.first()
        return Client(core, driver, asyncio.ensure_future(driver.run(connection)))

    async def __aenter__(self) -> Client:
        self._client = await self._run()
        return self._client

    async def __aexit__(
        self, kind: Optional[Type[BaseException]], error: Optional[BaseException], trace: Optional[TracebackType]
    ) -> None:
        if self._client is not None:
            await self._client.close()


def connect(
    address: str,
    *,
    user: str = "",
    password: Optional[str] = None,
    key: Optional[Key] = None,
    token: Optional[JwtSource] = None,
    certificate: bool = False,
    guest: bool = False,
    nickname: Optional[str] = None,
    installation: Optional[str] = None,
    hub_name: Optional[str] = None,
    trust: Trust = None,
    link: bool = True,
    grace: Optional[float] = None,
    heartbeat: Optional[float] = None,
    compress: bool = False,
    reconnect: Optional[Reconnect] = Reconnect(),
    request_timeout: float = 40.0,
    connect_timeout: float = 10.0,
    event_buffer: int = 1024,
    wall_clock: Callable[[], datetime] = now,
    on_state: Optional[Callable[[LinkState], None]] = None,
    report: Union[None, str, Tuple[str, str]] = None,
) -> Connect:
    """Connects and logs in. Use it as `async with mom.connect(…) as client:`, or `await` it and `close` the client.

    - `address`: `mom://host` tries all doors that the login permits, `bin://`, `bins://`, `ws://`, `wss://`, `http://` and
      `https://` are one door each (`mom.Address`).
    - `user` with `password`, `key` or `certificate`, or `token`, or `guest`: who this is, and its proof. Passwords and tokens
      are sent over TLS or to loopback only. A `token` (JWT) may be a function or a coroutine function that gives one, which is
      asked at each login: what it raises at first is raised here, too; later the attempt has failed, and is made again.
    - `installation`: which installed program a device is: the same after each start, and no other's, 64 bytes at most. Where a
      channel has one device, a program that is started later takes the place of its own earlier start; without it each client is
      another device.
    - `nickname`: the requested name at the hub; `hub_name`: the only hub for which the key signs.
    - `trust`: which hub is the right one over TLS (`mom.Trust`).
    - `link`, `grace`: whether a lost connection is resumed, and for how many seconds the hub is to wait for that; without
      `reconnect` it is not asked to.
    - `heartbeat`: the signs of life of this connection, from 0.1 to 10 seconds; a lost one is noticed after three of them.
    - `compress`: whether both sides compress all that they say (zlib), which brings texts to about a tenth of their bytes and pictures to
      what they were. It costs each side some hundred KiB of memory, and time: for slow links.
    - `reconnect`: the delays between attempts, at first and after a loss, when several fall into the grace time; `None`: a lost
      connection closes the client.
    - `request_timeout`, `connect_timeout`: how long to wait for a reply, and for a connection with its login.
    - `event_buffer`: the most events that wait for one subscription.
    - `wall_clock`: the clock that stamps this peer's parcels. It may be wrong: the hub measures its offset.
    - `on_state`: called with each state of the link, from the first attempt on.
    - `report`: the name of this program, or that and its version: reports to the hub, once, without a login and in the clear, why the
      first attempt to connect failed, if the connection is at fault. Off unless it is given. `mom.report` reports other errors.

    Raises `AddressError` for a wrong address, `LocalError` for what is wrong on this side (`insecure` for a password that others
    could read), `RefusedError` with `bad-login` and other refusals of the hub, and `ConnectionDownError` where attempts are
    bounded.
    """
    credentials = Credentials(user, password, key, token, certificate, guest, nickname, hub_name)
    # Who does not come back leaves at once.
    links = link and reconnect is not None
    options = Options(Address.parse(address), trust, links, grace, heartbeat, connect_timeout, reconnect, compress, report)
    return Connect(
        lambda: Core(wall_clock, event_buffer, request_timeout, installation), credentials, options, [on_state] if on_state else []
    )


class Client:
    """A peer that is logged in at a hub; made by `connect`."""

    def __init__(self, core: Core, driver: Driver, running: "asyncio.Future[None]") -> None:
        self._core, self._driver, self._running = core, driver, running

    @property
    def name(self) -> str:
        """The peer's name at the hub. It may be another one after a reconnect."""
        return self._core.peer

    @property
    def user(self) -> str:
        """The user."""
        return str(self._core.welcome.get("user", ""))

    @property
    def level(self) -> int:
        """The user's level; higher goes first."""
        level = self._core.welcome.get("level")
        return level if isinstance(level, int) else 0

    @property
    def welcome(self) -> Dict[str, Any]:
        """The hub's login reply: `peer`, `user`, `level`, `groups`, `protocol`, `limits`, `time`, `preferences`, …"""
        return dict(self._core.welcome)

    @property
    def clock(self) -> HubClock:
        """The hub's clock as measured over this link, for the age of arriving parcels."""
        return self._core.clock

    @property
    def state(self) -> LinkState:
        """The state of the link."""
        return self._core.state

    async def states(self) -> AsyncIterator[LinkState]:
        """The present state of the link and each that follows; it ends with `closed`."""
        changes: "asyncio.Queue[LinkState]" = asyncio.Queue()
        changes.put_nowait(self._core.state)
        self._core.on_state.append(changes.put_nowait)
        try:
            while True:
                state = await changes.get()
                yield state
                if state.word == "closed":
                    return
        finally:
            self._core.on_state.remove(changes.put_nowait)

    # Contexts.

    async def session(self, path: str) -> Session:
        """Joins a session, parents first."""
        return Session(self._core, await self._core.enter_all(path, "session"))

    async def channel(
        self, path: str, *, newest: bool = False, rate: Union[None, str, int] = None, device: bool = False
    ) -> Channel:
        """Joins a channel, parents first.

        With `newest` or a `rate` the messages of others are thinned (`Channel.thin`). A `device` obeys stops there, and says so
        after each: `obey` does all of that, `Latch` the part without scripts.
        """
        terms = {**thinning(newest, rate), **({"device": True} if device else {})}
        return Channel(self._core, await self._core.enter_all(path, "channel", terms or None))

    async def obey(self, path: str, device: Device) -> DevicePeer:
        """Joins a channel, parents first, as this device: it carries out its owner's scripts, and halts when it has to stand.

        A device that may move ought to be connected with `heartbeat=0.5`: then it halts within a second when its hub is silent.
        """
        if not isinstance(device, Device):
            raise TypeError(f"a device is made of a class with mom.device.Device as its base, not of {device!r}")
        await self._core.devices.take(path, device, self._core.places)
        # From here on, since the answer to the join says how it stands.
        events = self._core.subscribers.subscribe(path)
        place: Optional[Place] = None
        try:
            place = await self._core.enter_all(path, "channel", {"device": {"card": device.card()}})
            peer = DevicePeer(self._core, Channel(self._core, place), device, events)
            self._core.devices.note(path, peer)
            return peer
        except BaseException:
            events.close()
            self._core.devices.free(path, device)
            if place is not None:
                # Nothing obeys there: it must not pass for a device.
                self._core.post(Parcel("context", "leave", path))
                self._core.forget_within(path, "released")
            raise

    # Stops.

    async def stop(
        self, path: str, *, reason: str = "", only: Optional[Iterable[str]] = None, within: Optional[float] = None
    ) -> StopReport:
        """Stops all devices of a channel, or of all channels below a session in which this peer has the right `stop`.

        It joins nothing, goes before everything else, and is answered when each device has said that it obeys, or after a second
        (`within`, at most 10). `reason` is for anyone who finds the devices stopped; `only` names the devices of a channel.
        """
        return await self._stopping("stop", path, {"reason": reason} if reason else {}, only, within)

    async def unstop(
        self,
        path: str,
        stops: Union[int, Mapping[str, int]],
        *,
        only: Optional[Iterable[str]] = None,
        within: Optional[float] = None,
    ) -> StopReport:
        """Lifts the stops of a channel up to this number, or of channels by their paths up to theirs.

        They are the newest that its user has seen, as in `StopState`, and never taken from a refusal: a newer one holds on, and
        is named in the report.
        """
        numbers: Dict[str, Any] = {"stop": stops} if isinstance(stops, int) else {"stops": dict(stops)}
        return await self._stopping("unstop", path, numbers, only, within)

    async def stops(self, channel: str) -> StopState:
        """How the devices of a channel stand by the hub's books."""
        return StopState.of((await self.info(channel)).get("stop"))

    async def _stopping(
        self, name: str, path: str, content: Dict[str, Any], only: Optional[Iterable[str]], within: Optional[float]
    ) -> StopReport:
        content.update({"only": list(only)} if only is not None else {})
        content.update({"within": round(within * 1000)} if within is not None else {})
        return StopReport.of((await self._core.ask("context", name, path, content)).map())

    async def token(self, path: str) -> Token:
        """Joins a token, parents first; this gives its events, not ownership."""
        return Token(self._core, await self._core.enter_all(path, "token"))

    async def lookup(self, path: str) -> ContextInfo:
        """Looks up a path; `RefusedError` with `unknown-path` and the nearest one."""
        return ContextInfo.of((await self._core.ask("context", "lookup", path)).map())

    async def list(self, path: str = "/") -> List[ContextInfo]:
        """The contexts in a session, as far as this peer may look them up."""
        return [ContextInfo.of(child) for child in await pages(self._core, "list", path, "children")]

    async def info(self, path: str) -> Dict[str, Any]:
        """Details of a context, as docs/PROTOCOL.md lists them."""
        return (await self._core.ask("context", "info", path)).map()

    async def card(self, path: str) -> Optional[Dict[str, Any]]:
        """What the device of a channel says that it can do; `None` where no device there has a card. Nothing that protects may rely on it."""
        return (await self._core.ask("context", "info", path, {"card": True})).map().get("card")

    async def members(self, path: str) -> List[Member]:
        """The members of a context."""
        return [Member.of(member) for member in await pages(self._core, "members", path, "members")]

    async def stats(self, path: str) -> Dict[str, Any]:
        """Statistics of a channel or session, as docs/PROTOCOL.md lists them."""
        return (await self._core.ask("context", "stats", path)).map()

    async def create(self, path: str, spec: Mapping[str, Any]) -> ContextInfo:
        """Creates a context, and joins its parent; `spec` has `kind` and what else docs/PROTOCOL.md lists."""
        await self._core.enter_all(path.rsplit("/", 1)[0] or "/")
        return ContextInfo.of((await self._core.ask("context", "create", path, dict(spec))).map())

    async def delete(self, path: str) -> None:
        """Deletes a context with all below it."""
        await self._core.ask("context", "delete", path)

    async def invite(self, path: str, peer: str) -> None:
        """Invites a peer to a context, which this one joins for it. The peer gets `Invited`."""
        await self._core.enter_all(path)
        await self._core.ask("context", "invite", path, {"peer": peer})

    async def expel(self, path: str, peer: str, text: str = "", time: Optional[float] = None) -> None:
        """Expels a peer from a context and all below it, and keeps it out for a time, by default 60 s."""
        content: Dict[str, Any] = {"peer": peer, **({"text": text} if text else {})}
        if time is not None:
            content["for"] = int(time * 1000)
        await self._core.ask("context", "expel", path, content)

    # Parcels.

    async def request(self, parcel: Parcel, timeout: Optional[float] = None) -> Parcel:
        """Sends a request, with a new id unless it has one, and waits for the reply."""
        return await self._core.request(parcel, timeout)

    async def send(self, parcel: Parcel) -> int:
        """Sends a message; waits only for room in this client's own queue, stops not even for that. Gives its id."""
        return await self._core.send(parcel)

    def unaddressed(self) -> Events:
        """Events that no other subscription takes, from now on; and the state of the link."""
        return self._core.subscribers.unaddressed()

    def consults(self) -> Consults:
        """The hub's questions about contexts that this peer manages or chairs, from now on."""
        return Consults(self._core)

    # Login.

    async def authenticate_again(
        self, *, password: Optional[str] = None, key: Optional[Key] = None, token: Optional[JwtSource] = None
    ) -> None:
        """Authenticates again, for example before a token expires; later reconnects use this proof, too.

        As another user this becomes another peer: `LinkDown` and `Rejoined` follow, as after a lost link.
        """
        known = self._driver.credentials
        again = replace(known, password=password, key=key, token=token, certificate=False, guest=False)
        again.doors(self._driver.options.address)
        content = again.content(await again.ask_for_token())
        reply = await self._core.request(Parcel("login", "login", "/", content))
        if reply.name == "challenge":
            reply = await self._core.request(Parcel("login", "answer", "/", again.answer(reply)))
        before, self._driver.credentials = self.user, again
        self._driver.welcomed(reply)
        if self.user != before:
            self._driver.begin_anew("logged in as another user")

    async def close(self) -> None:
        """Logs out after everything sent before, and waits briefly for the answer."""
        self._driver.ending = True
        if self._core.is_up:
            try:
                await self._core.request(Parcel("login", "logout", "/"), timeout=_CLOSE)
                await asyncio.wait([self._running], timeout=_CLOSE)
            except MomError:
                pass  # The end of the connection does the same.
        self._running.cancel()
        await asyncio.wait([self._running])

    async def __aenter__(self) -> Client:
        return self

    async def __aexit__(
        self, kind: Optional[Type[BaseException]], error: Optional[BaseException], trace: Optional[TracebackType]
    ) -> None:
        await self.close()


class Consults:
    """The hub's questions, taken by `async for`; `close` ends it."""

    def __init__(self, core: Core) -> None:
        self._core, self._events = core, core.subscribers.consults()

    def __aiter__(self) -> AsyncIterator[Consult]:
        return self

    async def __anext__(self) -> Consult:
        async for event in self._events:
            if isinstance(event, Other):
                return Consult(self._core, event.parcel)
        raise StopAsyncIteration

    def close(self) -> None:
        """Takes no more of them: then the hub asks others, or refuses when the time is over."""
        self._events.close()


class Consult:
    """A question of the hub about a context that this peer manages or chairs."""

    def __init__(self, core: Core, parcel: Parcel) -> None:
        self._core, self.parcel = core, parcel

    @property
    def content(self) -> Dict[str, Any]:
        """What is asked: `verb`, `peer`, `user`, `level`, `groups`, `kind`, `within`, …"""
        return self.parcel.map()

    async def answer(self, allow: bool, text: str = "", stands: bool = False) -> None:
        """Answers it; `stands`: also later questions of the same kind. `RefusedError` with `too-late` if it is over."""
        content: Dict[str, Any] = {"consult": self.parcel.id, "allow": allow}
        content.update({"text": text} if text else {})
        content.update({"stands": True} if stands else {})
        await self._core.request(Parcel("manager", "verdict", None, content))
