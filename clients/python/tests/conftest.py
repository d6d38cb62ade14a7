"""A real broker on a free port, and a switch between it and a client that cuts connections."""

from __future__ import annotations

import asyncio
import datetime
import hashlib
import os
import re
import shutil
import signal
import ssl
import subprocess
from pathlib import Path
from typing import Any, AsyncIterator, Iterator, List, Optional, Set

import pytest
import pytest_asyncio
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

import mom

ROOT = Path(__file__).parents[3]
PATIENCE = 30

CONFIG = """
listen = ["127.0.0.1:0"]
users = "users.toml"
root = "lab"
[tls]
certificate = "hub.crt"
key = "hub.key"
self-signed = true
[login]
guests = true
hub = "lab"
"""


class Broker:
    """The lab's broker as a process."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.device = mom.Key.generate()
        text = (ROOT / "config/lab.toml").read_text().replace('root = "lab"\n', "").replace('users = "lab-users.toml"\n', "")
        (folder / "hub.toml").write_text(CONFIG + text)
        users = (ROOT / "config/lab-users.toml").read_text()
        proofs = f'keys = ["{self.device.public()}"]\ncertificates = ["{self._certificate()}"]'
        user = f'[[users]]\nname = "robot"\n{proofs}\nlevel = 1\ngroups = ["operator"]\n'
        (folder / "users.toml").write_text(users + user)
        self.port = 0
        self.program = os.environ.get("MOM_BROKER", str(ROOT / "target/debug/mom-broker"))
        self._process: Optional[subprocess.Popen[str]] = None
        self.start()

    def _certificate(self) -> str:
        """Makes a certificate for the robot; gives its fingerprint."""
        key = ec.generate_private_key(ec.SECP256R1())
        name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "robot")])
        day = datetime.timedelta(days=1)
        today = datetime.datetime.now(datetime.timezone.utc)
        builder = x509.CertificateBuilder(name, name, key.public_key(), 1, today - day, today + day)
        made = builder.sign(key, hashes.SHA256())
        plain = serialization.NoEncryption()
        forms = (serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, plain)
        (self.folder / "robot.pem").write_bytes(made.public_bytes(forms[0]) + key.private_bytes(*forms))
        return "sha256:" + made.fingerprint(hashes.SHA256()).hex()

    def start(self) -> None:
        """Starts it; at the port that it had before, if it had one."""
        program = self.program
        if not shutil.which(program):
            pytest.exit(f"{program} is missing: cargo build -p mom-broker, or MOM_BROKER=…/mom-broker")
        self._process = subprocess.Popen(
            [program, "--config", str(self.folder / "hub.toml"), "--listen", f"127.0.0.1:{self.port}"],
            env={**os.environ, "XDG_STATE_HOME": str(self.folder), "RUST_LOG": "error"},
            stdout=subprocess.PIPE,
            stderr=open(self.folder / "log", "a"),
            text=True,
        )
        assert self._process.stdout
        for line in self._process.stdout:
            found = re.search(r"bin://127.0.0.1:(\d+)", line)
            if found:
                self.port = int(found.group(1))
                return
        raise AssertionError((self.folder / "log").read_text())

    def signal(self, number: signal.Signals) -> None:
        """Sends it a signal."""
        assert self._process
        self._process.send_signal(number)

    def stop(self) -> None:
        """Ends it."""
        if self._process:
            self._process.terminate()
            # One that a test has frozen hears of it only then.
            self._process.send_signal(signal.SIGCONT)
            self._process.wait(PATIENCE)
            self._process.stdout.close()  # type: ignore[union-attr]

    @property
    def pin(self) -> str:
        """The fingerprint of its certificate."""
        pem = (self.folder / "hub.crt").read_text()
        return "sha256:" + hashlib.sha256(ssl.PEM_cert_to_DER_cert(pem)).hexdigest()

    def address(self, scheme: str = "bin") -> str:
        """Its address by this door."""
        pin = f"?pin={self.pin}" if scheme in ("bins", "wss", "https", "moms") else ""
        return f"{scheme}://127.0.0.1:{self.port}{pin}"

    def connect(self, user: str = "alice", scheme: str = "bin", **options: Any) -> mom.Connect:
        """A client of it."""
        return mom.connect(self.address(scheme), user=user, password=user, **options)


@pytest.fixture(autouse=True)
def no_proxy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever proxy the machine has, nothing goes through it."""
    for name in ("HTTPS_PROXY", "https_proxy", "HTTP_PROXY", "http_proxy", "ALL_PROXY", "all_proxy"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture(scope="session")
def broker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Broker]:
    """One for all tests, which undo what they do."""
    broker = Broker(tmp_path_factory.mktemp("broker"))
    yield broker
    broker.stop()


@pytest.fixture
def own_broker(tmp_path: Path) -> Iterator[Broker]:
    """One for a test that ends it."""
    broker = Broker(tmp_path)
    yield broker
    broker.stop()


class Cutter:
    """Passes TCP on to a hub, until it is told to cut it, or to hold it back."""

    def __init__(self, port: int) -> None:
        self.hub, self.port, self.connections = port, 0, 0
        self.refuses = False
        """Whether new connections are closed at once."""
        self.after: Optional[int] = None
        """Cuts when a connection has passed so many bytes; once, as few of them let nobody in."""
        self.up = 0
        """How many bytes have passed to the hub."""
        self._flows, self._flows_down = asyncio.Event(), asyncio.Event()
        self.let_go()
        self._writers: Set[asyncio.StreamWriter] = set()
        self._tasks: List["asyncio.Task[None]"] = []
        self._server: Optional[asyncio.AbstractServer] = None

    async def start(self) -> None:
        """Listens at a free port."""
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.port = self._server.sockets[0].getsockname()[1]

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        if self.refuses:
            writer.transport.abort()
            return
        self._writers.add(writer)
        there, back = await asyncio.open_connection("127.0.0.1", self.hub)
        if writer not in self._writers:
            # Cut meanwhile.
            back.transport.abort()
            return
        self._writers.add(back)
        passed = [0]
        ways = [self._pass(reader, back, passed, True), self._pass(there, writer, passed, False)]
        self._tasks += map(asyncio.ensure_future, ways)

    async def _pass(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, passed: List[int], up: bool) -> None:
        try:
            while data := await reader.read(65536):
                await (self._flows if up else self._flows_down).wait()
                passed[0] += len(data)
                self.up += len(data) if up else 0
                if self.after is not None and passed[0] > self.after:
                    writer.write(data[: max(0, len(data) - (passed[0] - self.after))])
                    await writer.drain()
                    self.after = None
                    self.cut()
                    return
                writer.write(data)
                await writer.drain()
        except OSError:
            pass
        writer.close()

    def cut(self) -> None:
        """Ends all connections at once."""
        for writer in self._writers:
            writer.transport.abort()
        self._writers.clear()

    def hold(self, up: bool = True) -> None:
        """Passes nothing on from now on; or, if not `up`, nothing of what the hub says."""
        if up:
            self._flows.clear()
        self._flows_down.clear()

    def let_go(self) -> None:
        """Passes on again."""
        self._flows.set()
        self._flows_down.set()

    async def close(self) -> None:
        """Ends it."""
        self.cut()
        assert self._server
        self._server.close()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)


@pytest_asyncio.fixture
async def cutter(broker: Broker) -> AsyncIterator[Cutter]:
    """Between a client and the broker of all tests."""
    cutter = Cutter(broker.port)
    await cutter.start()
    yield cutter
    await cutter.close()


async def heard(events: mom.Events, kind: Any) -> Any:
    """The next event of this kind."""

    async def wait() -> Any:
        async for event in events:
            if isinstance(event, kind):
                return event
        raise AssertionError(f"the events ended before {kind}")

    return await asyncio.wait_for(wait(), PATIENCE)


async def state(client: mom.Client, word: str) -> mom.LinkState:
    """Waits for a state of the link."""

    async def wait() -> mom.LinkState:
        async for state in client.states():
            if state.word == word:
                return state
        raise AssertionError(f"closed before {word}")

    return await asyncio.wait_for(wait(), PATIENCE)
