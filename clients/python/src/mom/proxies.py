"""What a client has joined: sessions, channels, tokens; and the guards of tokens."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Dict, Generator, Iterable, List, Literal, Mapping, Optional, Type, Union

from .core import Core, Place
from .errors import MomError, TimedOutError
from .events import ContextInfo
from .gate import FenceGate
from .core.holds import Handover, Hold, Loan, Lost
from .parcel import Parcel
from .subscriptions import Events

UNLIMITED = "unlimited"
"""For a grab that waits as long as it takes."""


@dataclass(frozen=True)
class Receipt:
    """The outcome of an acknowledged message."""

    delivered: int
    """Receivers whose queue took it."""
    dropped: List[str]
    """Receivers for which it was dropped."""


class Proxy:
    """Something that this peer has joined, until it leaves or the client is closed."""

    def __init__(self, core: Core, place: Place) -> None:
        self._core, self._place = core, place

    @property
    def path(self) -> str:
        """Its path."""
        return self._place.path

    def events(self) -> Events:
        """Its events from now on; the first subscriber also gets those since the join."""
        return self._core.subscribers.subscribe(self.path)

    async def info(self) -> Dict[str, Any]:
        """Its details, as docs/PROTOCOL.md lists them."""
        return (await self._core.ask("context", "info", self.path)).map()

    async def leave(self) -> None:
        """Leaves it and all below it; ownership of tokens there ends with it."""
        await self._core.leave(self.path)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.path!r})"


class Session(Proxy):
    """A directory of contexts."""

    async def list(self) -> List[ContextInfo]:
        """The contexts in it, as far as this peer may look them up."""
        return [ContextInfo.of(child) for child in await pages(self._core, "list", self.path, "children")]

    async def create(self, name: str, spec: Mapping[str, Any]) -> ContextInfo:
        """Creates a context in it; `spec` has `kind` and what else docs/PROTOCOL.md lists."""
        path = f"{self.path.rstrip('/')}/{name}"
        return ContextInfo.of((await self._core.ask("context", "create", path, dict(spec))).map())


class Channel(Proxy):
    """Where messages are exchanged."""

    async def send(self, name: str, content: Any = None, **options: Any) -> int:
        """Sends a message to all members, or to those in `to`; gives its id.

        It waits only for room in this client's own queue. A refusal comes as the event `Refused` with that id. The options
        are those of `message`.
        """
        return await self._core.send(self.message(name, content, **options))

    async def send_acknowledged(self, name: str, content: Any = None, **options: Any) -> Receipt:
        """Sends a message and waits until every receiver's queue took or dropped it; `RefusedError` with the reason.

        The options are those of `message`.
        """
        parcel = self.message(name, content, **options)
        parcel.receipt = True
        reply = (await self._core.request(parcel)).map()
        delivered = reply.get("delivered")
        return Receipt(delivered if isinstance(delivered, int) else 0, list(reply.get("dropped") or []))

    def message(
        self,
        name: str,
        content: Any = None,
        *,
        to: Optional[Iterable[str]] = None,
        priority: Optional[int] = None,
        expires: Optional[float] = None,
        delivery: Optional[str] = None,
        echo: Optional[bool] = None,
        fence: Optional[int] = None,
        based_on: Optional[int] = None,
        reference: Optional[int] = None,
        stop: Optional[int] = None,
        trace: Optional[str] = None,
        id: Optional[int] = None,
        slots: Optional[Mapping[str, Any]] = None,
    ) -> Parcel:
        """A message, not sent yet.

        - `to`: only to these members; if one is not there, nobody gets it.
        - `priority`: higher is more urgent, from -100 to 100.
        - `expires`: worthless after so many seconds.
        - `delivery`: `reliable`, `latest` or `fleeting`, which decides what happens when a receiver is slow.
        - `echo`: `False` suppresses the echo to this peer.
        - `fence`: valid only under this ownership of the guarding token.
        - `based_on`: valid only if the device has not moved since the state with this id.
        - `reference`: the id of the message that this one replies to.
        - `stop`: of an `unstop`, the number of the newest stop that its user has seen.
        - `trace`: the `traceparent` of the trace that it is part of.
        - `slots`: any others.
        """
        parcel = Parcel("message", name, self.path, content, has_content=content is not None)
        parcel.address = None if to is None else list(to)
        parcel.priority, parcel.delivery, parcel.echo = priority, delivery, echo
        parcel.expires = None if expires is None else max(0, -int(-expires * 1000 // 1))
        parcel.fence, parcel.reference, parcel.id = fence, reference, id
        extra = {"based-on": based_on, "stop": stop, "trace": trace, **(slots or {})}
        parcel.extra = {key: value for key, value in extra.items() if value is not None}
        return parcel

    async def thin(self, *, newest: bool = False, rate: Union[None, str, int] = None) -> None:
        """Asks the hub to thin the messages of others, from now on and after reconnects.

        With `newest` only the newest of each sender and name waits, with a `rate` (`"5/s"`) at most so many come; without
        both, thinning ends. Guarded messages, `stop`, `unstop` and `halt` are never thinned.
        """
        device = self._place.terms.get("device")
        terms = {**({"device": device} if device else {}), **thinning(newest, rate)}
        await self._core._join(self._place, terms)

    @property
    def gate(self) -> FenceGate:
        """The gate that refuses messages of earlier owners; it stays up to date, after reconnects too."""
        return self._place.gate


def thinning(newest: bool, rate: Union[None, str, int]) -> Dict[str, Any]:
    """The terms of thinning, for a join."""
    return {**({"newest": True} if newest else {}), **({"rate": rate} if rate is not None else {})}


async def pages(core: Core, name: str, path: str, key: str) -> List[Dict[str, Any]]:
    """Asks for a list page by page, as long as the hub says that there is more."""
    found: List[Dict[str, Any]] = []
    after: Any = None
    while True:
        page = (await core.ask("context", name, path, {"after": after} if after is not None else None)).map()
        found += [one for one in page.get(key) or [] if isinstance(one, dict)]
        after = page.get("next")
        if page.get("more") is not True or after is None:
            return found


class Guard:
    """Control of what a token guards, until it is released or lost. Leaving its `async with` block releases it.

    It renews by itself. The guards of one ownership (grabbed again while held) share it: the last one releases it.
    """

    def __init__(self, core: Core, hold: Hold) -> None:
        self._core, self._hold = core, hold
        self._released = False
        hold.guards += 1

    @property
    def path(self) -> str:
        """The token."""
        return self._hold.path

    @property
    def is_lost(self) -> bool:
        """Whether it is over."""
        return self._hold.lost.done()

    async def lost(self) -> Lost:
        """Waits until it is over. Safe to cancel."""
        return await asyncio.shield(self._hold.lost)

    async def release(self) -> None:
        """Releases it, after all messages sent before. Does nothing if it is lost already."""
        if not self._released:
            self._released = True
            await self._core.holds.let_go(self._hold)

    async def __aenter__(self: Any) -> Any:
        return self

    async def __aexit__(
        self, kind: Optional[Type[BaseException]], error: Optional[BaseException], trace: Optional[TracebackType]
    ) -> None:
        try:
            await self.release()
        except MomError:
            # A lost link releases it, too. What went wrong inside is told as it is.
            if error is None and self._core.is_up:
                raise


class InhibitGuard(Guard):
    """A part in the shared hold of a token, which nobody can own meanwhile."""


class TokenGuard(Guard):
    """Exclusive control of what a token guards, from `Token.grab` on."""

    async def release(self, *, after: Optional[Literal["done"]] = None, within: float = 10) -> None:
        """Releases it, after all messages sent before. Does nothing if it is lost already.

        That halts the device, and what has not left the hub by then does not leave it any more: `after="done"` waits until the device has
        said by `status` how the last command ended, for `within` seconds at most; then it is released all the same, and `TimedOutError`
        says so.
        """
        done = after is None or self._released or await self._hold.done(within)
        await super().release()
        if not done:
            raise TimedOutError("the last command", within)

    async def __aenter__(self) -> TokenGuard:
        return self

    @property
    def fence(self) -> int:
        """The fence of this ownership, for the option `fence` of messages."""
        return self._hold.fence

    @property
    def lease(self) -> Optional[float]:
        """How long it lasts without renewal; `None` = unlimited."""
        return self._hold.lease

    @property
    def deadman(self) -> Optional[float]:
        """The time after which it ends without a renewal; `None` = no such limit."""
        return self._hold.deadman

    @property
    def loan(self) -> Optional[Loan]:
        """The terms, if another peer gave it for a time or a number of commands."""
        return self._hold.loan

    async def give(
        self,
        to: str,
        *,
        within: Optional[float] = None,
        time: Optional[float] = None,
        commands: Optional[int] = None,
    ) -> Given:
        """Offers the token to another peer: for good, or for a `time` or a number of `commands`.

        This guard owns it until the other peer accepts; then it is lost with the reason `given`.
        """
        content: Dict[str, Any] = {"to": to}
        content.update({"within": int(within * 1000)} if within is not None else {})
        content.update({"for": int(time * 1000)} if time is not None else {})
        content.update({"commands": commands} if commands is not None else {})
        handover = Handover(self.path, to, time is not None or commands is not None, self.fence)
        # The other may answer before the hub's own answer is taken here.
        self._core.holds.offered(handover)
        try:
            await self._core.ask("token", "give", self.path, content)
        except BaseException:
            handover.end("refused")
            self._core.holds.forget(handover)
            raise
        return Given(self._core, handover)


class Given:
    """An offer of a token, and its outcome."""

    def __init__(self, core: Core, handover: Handover) -> None:
        self._core, self._handover = core, handover

    async def outcome(self) -> str:
        """Waits for the answer: `taken`, or why it came to nothing (`declined`, `timed-out`, `withdrawn`, `lost`, `left`)."""
        return await asyncio.shield(self._handover.outcome)

    async def back(self) -> Optional[TokenGuard]:
        """Waits until a token that was given for a while has returned; `None` if it does not return."""
        hold = await asyncio.shield(self._handover.back)
        if hold is None or hold.lost.done():
            return None
        self._core.holds.renew(hold)
        return TokenGuard(self._core, hold)


class Grab:
    """A grab: `guard = await token.grab()`, or `async with token.grab() as guard:`."""

    def __init__(self, token: Token, name: str, content: Dict[str, Any], wait: bool) -> None:
        self._token, self._name, self._content, self._wait = token, name, content, wait
        self._guard: Optional[TokenGuard] = None

    def __await__(self) -> Generator[Any, None, TokenGuard]:
        return self._run().__await__()

    async def _run(self) -> TokenGuard:
        core, path = self._token._core, self._token.path
        core.check_up()
        parcel = Parcel("token", self._name, path, self._content or None)
        answer = core.begin(parcel)
        try:
            reply = await core.answer(parcel, asyncio.shield(answer), wait=not self._wait)
        except asyncio.CancelledError:
            if self._name == "grab" and core.holds.of(path) is None and core.state.word != "closed":
                core.holds.withdraw(path, answer)
            else:
                answer.cancel()
            raise
        except MomError:
            answer.cancel()
            raise
        return TokenGuard(core, core.holds.granted(path, reply.map()))

    async def __aenter__(self) -> TokenGuard:
        self._guard = await self._run()
        return self._guard

    async def __aexit__(
        self, kind: Optional[Type[BaseException]], error: Optional[BaseException], trace: Optional[TracebackType]
    ) -> None:
        if self._guard is not None:
            await self._guard.__aexit__(kind, error, trace)


class Token(Proxy):
    """A token: what one peer at a time owns. Its events include offers to this peer and requests to it as the owner."""

    def grab(self, wait: Union[None, float, str] = None) -> Grab:
        """Grabs it, at once or by way of the queue: `wait` in seconds, or `mom.UNLIMITED`.

        `RefusedError` with `held` (`owner`, `retry_after`, `place` in `wire`), `timed-out` after the wait, or `denied`.
        """
        content: Dict[str, Any] = {}
        if wait is not None:
            content["wait"] = UNLIMITED if wait == UNLIMITED else int(float(wait) * 1000)
        return Grab(self, "grab", content, wait is not None)

    def request(self, text: Optional[str] = None, within: Optional[float] = None) -> Grab:
        """Asks its owner to hand it over, and waits for the answer; a free token is granted at once.

        `RefusedError` with `declined`, `timed-out`, `withdrawn` or `denied`.
        """
        content: Dict[str, Any] = {"text": text} if text else {}
        content.update({"within": int(within * 1000)} if within is not None else {})
        return Grab(self, "request", content, True)

    def accept(self) -> Grab:
        """Accepts the owner's offer (`Offer`)."""
        return Grab(self, "accept", {}, False)

    async def decline(self, text: str = "") -> None:
        """Declines an offer."""
        await self._core.ask("token", "decline", self.path, {"text": text} if text else None)

    async def accept_request(self, peer: str) -> None:
        """Hands it over to a peer that has asked for it (`Requested`). The guard is lost with the reason `given`."""
        await self._core.ask("token", "accept", self.path, {"peer": peer})

    async def decline_request(self, peer: str, text: str = "") -> None:
        """Declines a peer's request; `text` is the reason."""
        await self._core.ask("token", "decline", self.path, {"peer": peer, **({"text": text} if text else {})})

    async def break_hold(self) -> List[str]:
        """Takes it away from its owner, or ends all parts in its shared hold; gives the peers that had it."""
        reply = (await self._core.ask("token", "break", self.path)).map()
        owner = reply.get("owner")
        return list(reply.get("holders") or []) + ([owner] if isinstance(owner, str) else [])

    async def inhibit(self) -> InhibitGuard:
        """Joins its shared hold: nobody can own it meanwhile. An owner gives up its ownership by this."""
        await self._core.ask("token", "inhibit", self.path)
        return InhibitGuard(self._core, self._core.holds.granted(self.path, {}, shared=True))
