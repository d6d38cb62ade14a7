"""How a peer proves who it is."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Awaitable, Callable, Dict, List, Optional, Union

from .address import Address
from .errors import LocalError
from .parcel import Parcel

_LOGIN, _LINK = b"mom-login-1", b"mom-link-1"

JwtSource = Union[str, Callable[[], Union[str, Awaitable[str]]]]
"""A JWT, or a function that gives one, at once or as a coroutine."""


class Key:
    """A private key (Ed25519). It never leaves this process; the hub knows the public one from its users file.

    Needs the package `cryptography`: `pip install 'mom-client[keys]'`.
    """

    def __init__(self, private: Any) -> None:
        self._private = private

    @classmethod
    def generate(cls) -> Key:
        """A new one."""
        return cls(_ed25519().Ed25519PrivateKey.generate())

    @classmethod
    def from_pem(cls, pem: str) -> Key:
        """Reads PKCS#8 in PEM, as `mom keygen` and `openssl genpkey -algorithm ed25519` write it."""
        kinds = _ed25519()
        from cryptography.hazmat.primitives.serialization import load_pem_private_key

        try:
            private = load_pem_private_key(pem.encode(), None)
        except (ValueError, TypeError):
            private = None
        if not isinstance(private, kinds.Ed25519PrivateKey):
            text = "this is not an Ed25519 private key in PEM (-----BEGIN PRIVATE KEY-----)"
            raise LocalError("bad-encoding", text)
        return cls(private)

    @classmethod
    def from_file(cls, file: Union[str, Path]) -> Key:
        """Reads a file of PEM."""
        try:
            return cls.from_pem(Path(file).read_text())
        except (OSError, UnicodeDecodeError) as error:
            raise LocalError("bad-encoding", f"{file} cannot be read: {error}") from error
        except LocalError as error:
            raise LocalError("bad-encoding", f"{file}: {error.text}") from None

    def to_pem(self) -> str:
        """The private key in PEM. Anyone who reads it can log in as this user: keep it in a file of mode 0600."""
        from cryptography.hazmat.primitives import serialization as forms

        written = self._private.private_bytes(
            forms.Encoding.PEM, forms.PrivateFormat.PKCS8, forms.NoEncryption()
        )
        return str(written.decode())

    def public(self) -> str:
        """The public key as the users file wants it among a user's `keys`: `ed25519 BASE64`."""
        from cryptography.hazmat.primitives import serialization as forms

        raw = self._private.public_key().public_bytes(forms.Encoding.Raw, forms.PublicFormat.Raw)
        return f"ed25519 {base64.b64encode(raw).decode()}"

    def _sign(self, message: bytes) -> bytes:
        return bytes(self._private.sign(message))

    def __repr__(self) -> str:
        return f"Key({self.public()})"


def _ed25519() -> Any:
    try:
        from cryptography.hazmat.primitives.asymmetric import ed25519
    except ImportError:
        text = "keys need the package cryptography: pip install 'mom-client[keys]'"
        raise LocalError("bad-login", text) from None
    return ed25519


@dataclass
class Credentials:
    """The login data of a peer. Exactly one of `password`, `key`, `token`, `certificate` and `guest` is a proof."""

    user: str = ""
    """The user."""
    password: Optional[str] = None
    """The user's password; sent over TLS or to loopback only."""
    key: Optional[Key] = None
    """A key of the user's; accepted from anywhere, because no secret is on the wire."""
    token: Optional[JwtSource] = None
    """A JWT of an issuer that the hub trusts, or what gives one, which is asked at each login; sent where a password is."""
    certificate: bool = False
    """A certificate that is shown over TLS: the `trust` is an `ssl.SSLContext` that has it."""
    guest: bool = False
    """Log in as a guest, where the hub lets them in."""
    nickname: Optional[str] = None
    """The requested name at the hub instead of the user's."""
    hub_name: Optional[str] = None
    """The hub for which the key may sign, by the name in its configuration."""

    def __post_init__(self) -> None:
        proofs = [self.password is not None, self.key is not None, self.token is not None, self.certificate, self.guest]
        if sum(proofs) != 1:
            raise LocalError("bad-content", "give exactly one of password, key, token, certificate and guest")
        if not self.user and (self.password is not None or self.key is not None or self.certificate):
            raise LocalError("bad-content", "a password, a key or a certificate requires the user")

    def __repr__(self) -> str:
        # Secrets do not belong in logs.
        return f"Credentials(user={self.user!r}, nickname={self.nickname!r})"

    @property
    def is_secret(self) -> bool:
        """Whether others must not read the proof."""
        return self.password is not None or self.token is not None

    def doors(self, address: Address) -> List[Address]:
        """The doors through which the proof may be said; `LocalError` with `insecure` where there are none."""
        doors = address.doors(self.is_secret)
        if self.is_secret and not all(door.is_private for door in doors) or not doors:
            what = "password" if self.password is not None else "token"
            raise LocalError(
                "insecure",
                f"a {what} is sent over TLS or to loopback only, and others could read it on the way to {address}: write "
                f"moms://{address.authority}, or log in with a key; nothing was sent",
            )
        return doors

    async def ask_for_token(self) -> Optional[str]:
        """The JWT for a login, if it is one by JWT."""
        if self.token is None or isinstance(self.token, str):
            return self.token
        given = self.token()
        return given if isinstance(given, str) else await given

    def content(self, token: Optional[str] = None) -> Dict[str, Any]:
        """The content of `login login`; `token` is what `ask_for_token` has given."""
        content: Dict[str, Any] = {"name": self.user}
        if self.password is not None:
            content["password"] = self.password
        elif self.key is not None:
            content["key"] = True
        elif self.certificate:
            content["certificate"] = True
        else:
            content = {"token": token} if self.token is not None else {"guest": True}
        if self.nickname is not None:
            content["nickname"] = self.nickname
        return content

    def answer(self, challenge: Parcel) -> Dict[str, Any]:
        """The content of `login answer`; `LocalError` for a hub that is not the one meant."""
        hub, nonce = read_challenge(challenge, _LOGIN)
        if self.key is None:
            raise LocalError("bad-content", "the hub asks for a key, but the login has none")
        if self.hub_name is not None and self.hub_name != hub:
            raise LocalError("bad-login", f"the hub is {hub!r}, not {self.hub_name!r}: nothing was signed for it")
        signed = b"\0".join([_LOGIN, hub.encode(), self.user.encode(), nonce])
        return {"signature": self.key._sign(signed)}


def read_challenge(challenge: Parcel, context: bytes) -> "tuple[str, bytes]":
    """The hub's name and the nonce, if the challenge is for this purpose: an answer must be useless for any other."""
    content = challenge.map()
    hub, nonce = content.get("hub"), content.get("nonce")
    if content.get("context") != context.decode() or not isinstance(hub, str):
        raise LocalError("bad-content", f"the hub's challenge is not one for {context.decode()}")
    if not isinstance(nonce, bytes) or len(nonce) != 32:
        raise LocalError("bad-content", "the nonce of the hub's challenge does not have 32 bytes")
    return hub, nonce
