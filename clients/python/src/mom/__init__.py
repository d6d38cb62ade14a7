"""The client of MOM, message-oriented middleware for robots.

A `Client` is one peer: it connects to a hub, logs in, joins contexts and exchanges parcels there. Its proxies are a
`Session` (a directory of contexts), a `Channel` (where messages are exchanged) and a `Token` (exclusive control of a
device). A `TokenGuard` holds a token and renews its lease; a `FenceGate` lets a device refuse messages of earlier owners.
A `HubClock` knows the hub's time and the `Age` of arriving parcels. `mom.device` makes devices of classes with verbs;
`mom.drive` drives them, and follows each command to its end; `mom.agent` makes agents that others hire for that.

    import asyncio, mom

    async def main():
        async with mom.connect("mom://localhost", user="alice", password="alice") as client:
            arm, token = await client.channel("/robot/arm"), await client.token("/robot/token")
            async with token.grab(wait=60) as guard:
                await arm.send_acknowledged("command", "grip open", fence=guard.fence)

    asyncio.run(main())

A lost connection is resumed where the hub gives a link: memberships, tokens and what was under way are kept. What cannot be
resumed is told by the events `LinkDown` and `Rejoined`; then tokens are lost, and contexts are joined again.
"""

from . import agent, device, drive
from .address import DEFAULT_PORT, Address
from .client import Client, Connect, Consult, Consults, connect
from .clock import Age, HubClock
from .connection import Connection
from .errors import (
    CODES,
    AddressError,
    ClosedError,
    ConnectionDownError,
    DroppedError,
    LocalError,
    LostError,
    MomError,
    RefusedError,
    TimedOutError,
    WireError,
)
from .events import (
    ContextInfo,
    Count,
    Created,
    Deleted,
    Dropped,
    Event,
    Expelled,
    Grabbed,
    Inhibited,
    Invited,
    Joined,
    Lagged,
    Lapsed,
    Left,
    LinkDown,
    Member,
    Message,
    Notice,
    Offer,
    Other,
    PeerLost,
    PeerResumed,
    Queued,
    Refused,
    Rejoined,
    Released,
    Requested,
    StateChanged,
    Stops,
    Uninhibited,
)
from .gate import FenceGate, GuardState, StaleError
from .core.holds import Loan, Lost
from .latch import Held, Latch, Reaction
from .login import Key
from .parcel import Parcel
from .proxies import UNLIMITED, Channel, Given, Grab, Guard, InhibitGuard, Receipt, Session, Token, TokenGuard
from .reports import report
from .states import LinkState, Reconnect
from .stops import DeviceAnswer, StopReport, StopState, ToldChannel
from .subscriptions import Events
from .transport import Trust
from .values import Value

__version__ = "0.1.0"

__all__ = [
    "Address",
    "AddressError",
    "Age",
    "CODES",
    "Channel",
    "Client",
    "ClosedError",
    "Connect",
    "Connection",
    "ConnectionDownError",
    "Consult",
    "Consults",
    "ContextInfo",
    "Count",
    "Created",
    "DEFAULT_PORT",
    "Deleted",
    "DeviceAnswer",
    "Dropped",
    "DroppedError",
    "Event",
    "Events",
    "Expelled",
    "FenceGate",
    "Given",
    "Grab",
    "Grabbed",
    "Guard",
    "GuardState",
    "Held",
    "HubClock",
    "InhibitGuard",
    "Inhibited",
    "Invited",
    "Joined",
    "Key",
    "Lagged",
    "Lapsed",
    "Latch",
    "Left",
    "LinkDown",
    "LinkState",
    "Loan",
    "LocalError",
    "Lost",
    "LostError",
    "Member",
    "Message",
    "MomError",
    "Notice",
    "Offer",
    "Other",
    "Parcel",
    "PeerLost",
    "PeerResumed",
    "Queued",
    "Reaction",
    "Receipt",
    "Reconnect",
    "Refused",
    "RefusedError",
    "Rejoined",
    "Released",
    "Requested",
    "Session",
    "StaleError",
    "StateChanged",
    "StopReport",
    "StopState",
    "Stops",
    "TimedOutError",
    "Token",
    "TokenGuard",
    "ToldChannel",
    "Trust",
    "UNLIMITED",
    "Uninhibited",
    "Value",
    "WireError",
    "connect",
    "agent",
    "device",
    "drive",
    "report",
]
