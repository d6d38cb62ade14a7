"""What a program reports of its own errors to a hub, if it is told to (M56)."""

from __future__ import annotations

import asyncio
import json
import os
from pathlib import Path
from typing import Any, List

import pytest
from conftest import Broker

import mom
from mom import reports


@pytest.fixture(autouse=True)
def fresh(monkeypatch: pytest.MonkeyPatch) -> None:
    """This program has reported nothing yet."""
    monkeypatch.setattr(reports, "_lately", {})
    monkeypatch.setattr(reports, "_blocked", 0.0)


async def logs(broker: Broker) -> List[Any]:
    """What operators read."""
    login = {"MOM_HUB": f"bin://127.0.0.1:{broker.port}", "MOM_USER": "carol", "MOM_PASSWORD": "carol"}
    program = Path(broker.program).with_name("mom")
    pipe = asyncio.subprocess.PIPE
    asked = await asyncio.create_subprocess_exec(program, "logs", "--json", env={**os.environ, **login}, stdout=pipe, stderr=pipe)
    said, error = await asked.communicate()
    assert asked.returncode == 0, error.decode()
    return [json.loads(line) for line in said.decode().splitlines()]


async def test_a_client_that_cannot_connect_reports_why_if_it_is_told_to(own_broker: Broker) -> None:
    login = {"user": "alice", "password": "secret-of-alice", "reconnect": None}
    # Nobody vouches for its certificate.
    address = f"bins://127.0.0.1:{own_broker.port}"
    with pytest.raises(mom.ConnectionDownError):
        await mom.connect(address, **login)
    # What the hub refuses it knows.
    with pytest.raises(mom.RefusedError):
        await mom.connect(f"bin://127.0.0.1:{own_broker.port}", **login, report="refused")
    assert await logs(own_broker) == []
    with pytest.raises(mom.ConnectionDownError):
        await mom.connect(address, **login, report=("survey", "1.2"))
    (found,) = await logs(own_broker)
    assert "certificate" in found["text"] and "secret" not in json.dumps(found)
    assert [found[key] for key in ("level", "program", "version", "from")] == ["error", "survey", "1.2", "127.0.0.1"]


async def test_a_report_is_cut_to_what_the_hub_takes_whatever_is_in_it(own_broker: Broker) -> None:
    address = f"mom://127.0.0.1:{own_broker.port}/robot"
    for letter in ["x", "\0", "😀", '"', "\ud800"]:
        assert await mom.report(address, letter * 10_000, code=letter * 100, program="mine", level="warn"), repr(letter)
    found = await logs(own_broker)
    assert [(one["program"], one["level"]) for one in found] == [("mine", "warn")] * 5
    assert 3000 < len(found[0]["text"]) < 4096


async def test_reports_are_few_and_the_same_is_said_once(monkeypatch: pytest.MonkeyPatch) -> None:
    heard: List[str] = []
    status = "204 No Content"

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        heard.append((await reader.readuntil(b"\r\n")).decode())
        writer.write(f"HTTP/1.1 {status}\r\nRetry-After: 60\r\n\r\n".encode())
        await writer.drain()
        writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    address = f"bins://127.0.0.1:{server.sockets[0].getsockname()[1]}"
    said = [await mom.report(address, text) for text in ["1", "1", "2", "3", "4", "5", "6"]]
    assert said == [True, False, True, True, True, True, False]
    assert heard == ["POST /log HTTP/1.1\r\n"] * 5
    # A hub that takes none, and one that has had enough.
    for status, then in [("404 Not Found", True), ("429 Too Many", False)]:
        monkeypatch.setattr(reports, "_lately", {})
        assert not await mom.report(address, "1")
        status = "204 No Content"
        assert await mom.report(address, "2") is then
    server.close()


async def test_a_report_never_fails(unused_tcp_port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reports, "_HTTP", unused_tcp_port)
    wrong: List[Any] = ["", "no address", f"http://127.0.0.1:{unused_tcp_port}", None]
    for address in wrong:
        assert not await mom.report(address, f"{address}")
    wrong = [None, " ", 7]
    for text in wrong:
        assert not await mom.report(f"bin://127.0.0.1:{unused_tcp_port}", text)
