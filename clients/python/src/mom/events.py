"""What happens in contexts and to the link."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Callable, Dict, List, Optional

from .content import names, number, seconds, text
from .errors import WireError
from .parcel import Parcel
from .states import LinkState
from .stops import StopState


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
            text(content, "peer"), text(content, "user"), level if isinstance(level, int) else 0,
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
    stop: Optional[StopState] = None
    """Who has stopped its devices, in lists and of stopped channels only."""

    @staticmethod
    def of(content: Dict[str, Any]) -> ContextInfo:
        """Reads a summary."""
        return ContextInfo(
            text(content, "path"), text(content, "kind"), number(content, "number") or 0, number(content, "members"),
            StopState.of(content["stop"]) if "stop" in content else None,
        )  # fmt: skip


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

    @property
    def stop(self) -> Optional[int]:
        """The number of a `stop`; of an `unstop` that of the newest stop that it lifts."""
        found = number(self.parcel.extra, "stop")
        return found if found is None or found >= 0 else None


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
class Stops(Event):
    """How the devices of this channel stand by the hub's books.

    It comes when this peer has joined it as a device or has come back, when it joins it where something was ever stopped, and
    where a stop began or ended without a message to this peer.
    """

    path: str
    state: StopState
    unstopped_by: Optional[str] = None


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
        at, text(c, "owner"), number(c, "level") or 0, number(c, "fence") or 0, seconds(c, "lease")
    ),
    "released": lambda p, c, at: Released(
        at, text(c, "owner"), text(c, "reason"), number(c, "fence") or 0, c.get("by")
    ),
    "requested": lambda p, c, at: Requested(at, Member.of(c), seconds(c, "within") or 0.0, c.get("text")),
    "offer": lambda p, c, at: Offer(
        at, text(c, "by"), text(c, "to"), number(c, "level") or 0, seconds(c, "within") or 0.0, number(c, "fence") or 0,
        seconds(c, "for"), number(c, "commands"),
    ),
    "lapsed": lambda p, c, at: Lapsed(at, text(c, "what"), text(c, "by"), text(c, "to"), text(c, "reason")),
    "queued": lambda p, c, at: Queued(at, number(c, "place") or 0, seconds(c, "expected")),
    "notice": lambda p, c, at: Notice(at, seconds(c, "within") or 0.0, number(c, "waiting") or 0),
    "inhibited": lambda p, c, at: Inhibited(at, text(c, "peer"), names(c, "holders")),
    "uninhibited": lambda p, c, at: Uninhibited(at, text(c, "peer"), names(c, "holders"), text(c, "reason")),
    "invited": lambda p, c, at: Invited(text(c, "path") or at, text(c, "by"), text(c, "kind")),
    "expelled": lambda p, c, at: Expelled(at, text(c, "peer"), c.get("by"), c.get("text")),
    "stopped": lambda p, c, at: Stops(at, StopState.of(c)),
    "unstopped": lambda p, c, at: Stops(at, StopState.of(c), text(c, "unstopped-by") or None),
    "dropped": lambda p, c, at: Dropped(text(c, "reason"), number(c, "count") or 0, p),
}  # fmt: skip


def is_within(path: str, top: str) -> bool:
    """Whether a path is another one or lies below it."""
    return top == "/" or path == top or path.startswith(top + "/")
