"""What goes wrong: exceptions with the code's word and number, its text, and its details."""

from __future__ import annotations

from typing import Any, Dict, List, Mapping, Optional

CODES: Dict[str, int] = {
    "try-later": 100, "held": 101, "timed-out": 102, "full": 103, "declined": 104, "withdrawn": 105,
    "over-quota": 106, "storage-failed": 107, "over-memory": 108,
    "occupied": 109,
    "denied": 200, "bad-login": 201, "not-logged-in": 202, "not-member": 203, "not-owner": 204,
    "older-fence": 205, "bad-fence": 206, "expired": 207, "stale-state": 208, "not-resumed": 209, "unknown-path": 210,
    "unknown-peer": 211, "unknown-verb": 212, "unknown-manager": 213, "exists": 214, "wrong-kind": 215,
    "permanent": 216, "no-offer": 217, "too-late": 218, "not-recorded": 219, "bad-slot": 220, "bad-path": 221,
    "bad-name": 222,
    "bad-content": 223, "bad-encoding": 224, "bad-xml": 225, "bad-mime": 226, "bad-cid": 227, "too-deep": 228,
    "not-encodable": 229, "too-long": 230, "bad-json": 231,
    "shutdown": 300, "slow-receiver": 301, "silent": 302, "login-timeout": 303, "too-many-connections": 304,
    "disconnected": 305, "out-of-memory": 306,
    "bad-frame": 400, "bad-version": 401, "restricted-xml": 402, "too-large": 403, "insecure": 404,
    "too-many-logins": 405, "revoked": 406, "not-taken": 407, "bad-count": 408,
    "taken-over": 409,
}  # fmt: skip
"""The codes of errors: word and number. A hub may know more; go by the range of the number then."""


class WireError:
    """An error as it is said on the wire: a code, plain words, and details."""

    def __init__(self, code: str, text: str, details: Optional[Mapping[str, Any]] = None) -> None:
        self.code = code
        """The code's word, such as `held`."""
        self.text = text
        """What is wrong, for people."""
        self.details: Dict[str, Any] = dict(details or {})
        """All that the hub said about it."""
        known = self.details.get("code")
        self.number: int = known if isinstance(known, int) else CODES.get(code, 299)
        """The code's number, such as 101; its range says what may be done."""

    @property
    def retry_after(self) -> Optional[float]:
        """Seconds after which the same request may pass."""
        wait = self._number("retry-after")
        return None if wait is None else wait / 1000

    @property
    def rule(self) -> Optional[str]:
        """The rule that refused."""
        return self._text("rule")

    @property
    def owner(self) -> Optional[str]:
        """The peer that owns the token."""
        return self._text("owner")

    @property
    def owner_level(self) -> Optional[int]:
        """That peer's level."""
        return self._number("owner-level")

    @property
    def place(self) -> Optional[int]:
        """The place in the queue that a waiting grab has or would get."""
        return self._number("place")

    @property
    def nearest(self) -> Optional[str]:
        """The nearest thing that exists."""
        return self._text("nearest")

    @property
    def slot(self) -> Optional[str]:
        """The slot at fault."""
        return self._text("slot")

    @property
    def holders(self) -> List[str]:
        """The peers that hold the token together."""
        found = self.details.get("holders")
        return [name for name in found if isinstance(name, str)] if isinstance(found, list) else []

    @property
    def may_retry(self) -> bool:
        """Whether the same request may be made again later (100–199)."""
        return 100 <= self.number < 200

    @property
    def closes(self) -> bool:
        """Whether the connection is closed with it (300–499)."""
        return 300 <= self.number < 500

    @property
    def may_reconnect(self) -> bool:
        """Whether a client connects again after it (300–399)."""
        return 300 <= self.number < 400

    def _text(self, key: str) -> Optional[str]:
        found = self.details.get(key)
        return found if isinstance(found, str) else None

    def _number(self, key: str) -> Optional[int]:
        found = self.details.get(key)
        return found if isinstance(found, int) and not isinstance(found, bool) else None

    def __str__(self) -> str:
        return f"{self.code}: {self.text}" if self.text else self.code

    def __repr__(self) -> str:
        return f"WireError({self.code!r}, {self.text!r})"


class MomError(Exception):
    """The base of all errors of this library."""

    wire: Optional[WireError] = None
    """The error in the words of the wire, if there is one."""

    @property
    def code(self) -> Optional[str]:
        """The code's word, such as `held`."""
        return self.wire.code if self.wire else None

    @property
    def number(self) -> Optional[int]:
        """The code's number, such as 101."""
        return self.wire.number if self.wire else None

    @property
    def text(self) -> str:
        """What is wrong, for people."""
        return self.wire.text if self.wire else str(self)

    @property
    def retry_after(self) -> Optional[float]:
        """Seconds after which the same request may pass."""
        return self.wire.retry_after if self.wire else None

    @property
    def rule(self) -> Optional[str]:
        """The rule that refused."""
        return self.wire.rule if self.wire else None


class RefusedError(MomError):
    """The hub answered with an error: `code`, `number`, `text`, `rule`, `retry_after`, and all of it in `wire`."""

    wire: WireError

    def __init__(self, wire: WireError) -> None:
        super().__init__(f"refused: {wire}")
        self.wire = wire


class ConnectionDownError(MomError):
    """The connection is lost, or cannot be made."""

    def __init__(self, text: str) -> None:
        super().__init__(f"no connection: {text}")


class LostError(ConnectionDownError):
    """What was said went with the connection: meant for the moment, or the link could not be resumed.

    `code` is `lost` if it had not left, and `unknown` if it had: nobody knows whether the hub has read it.
    """

    def __init__(self, what: str, code: str, why: str = "") -> None:
        lost = f"{what} is lost: it had not been sent when the connection was lost"
        unknown = f"{what} had been sent when the connection was lost: it is unknown whether it was carried out"
        super().__init__((lost if code == "lost" else unknown) + (f" ({why})" if why else ""))
        self._code = code

    @property
    def code(self) -> str:
        """`lost` or `unknown`."""
        return self._code


class DroppedError(MomError):
    """What was said was not sent: `code` is `replaced`, `withdrawn` (an `unstop`, by a stop), `expired` or `queue-full`."""

    def __init__(self, what: str, code: str) -> None:
        super().__init__(f"{what} was not sent: {code}")
        self._code = code

    @property
    def code(self) -> str:
        """Why, as in the event `Dropped`."""
        return self._code


class TimedOutError(MomError):
    """No answer came in time. Nobody knows whether the request was carried out."""

    def __init__(self, what: str, after: float) -> None:
        super().__init__(f"no answer to {what} within {after:g} s")


class ClosedError(MomError):
    """The client is closed for good: it logged out, or the hub closed with a code of 400–499."""

    def __init__(self, wire: Optional[WireError] = None) -> None:
        super().__init__(f"closed: {wire}" if wire else "closed")
        self.wire = wire


class AddressError(MomError):
    """What was given as the address of a hub is none."""

    def __init__(self, address: str, why: str) -> None:
        super().__init__(f"{address!r} is not the address of a hub: {why}")


class LocalError(MomError):
    """An error on this side: a value without a form on the wire, a password that others could read, a broken frame."""

    wire: WireError

    def __init__(self, code: str, text: str) -> None:
        self.wire = WireError(code, text)
        super().__init__(str(self.wire))
