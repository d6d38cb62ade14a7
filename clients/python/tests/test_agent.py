"""The agent of docs/agents.md, as it stands there, at the lab: a person lends it the arm, and takes it away."""

from __future__ import annotations

import asyncio
import os
import re
import sys
from pathlib import Path
from typing import AsyncIterator

import pytest
import pytest_asyncio
from conftest import PATIENCE, ROOT, heard

import mom

AGENT = Path(__file__).parents[1] / "examples/agent.py"
TOKEN = "/robot/token"


@pytest_asyncio.fixture
async def lab(tmp_path: Path) -> AsyncIterator[str]:
    """The address of a lab with an arm."""
    broker = Path(os.environ.get("MOM_BROKER", str(ROOT / "target/debug/mom-broker")))
    program = broker.with_name("mom")
    assert program.exists(), f"{program} is missing: cargo build -p mom"
    homes = {"XDG_STATE_HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path)}
    process = await asyncio.create_subprocess_exec(
        str(program), "lab", "--listen", "127.0.0.1:0", "--log", "error",
        env={**os.environ, **homes},
        stdout=asyncio.subprocess.PIPE,
    )  # fmt: skip
    assert process.stdout

    async def address() -> str:
        assert process.stdout
        async for line in process.stdout:
            found = re.search(r"bin://127\.0\.0\.1:\d+", line.decode())
            if found:
                return found.group()
        raise AssertionError("the lab has ended")

    try:
        yield await asyncio.wait_for(address(), PATIENCE)
    finally:
        process.terminate()
        await process.communicate()


async def agent(lab: str) -> asyncio.subprocess.Process:
    """Starts it."""
    path = str(ROOT / "clients/python/src")
    env = {**os.environ, "PYTHONPATH": path, "MOM_HUB": lab, "MOM_PASSWORD": "assistant"}
    pipe = asyncio.subprocess.PIPE
    return await asyncio.create_subprocess_exec(sys.executable, str(AGENT), env=env, stdout=pipe, stderr=pipe)


async def lends(alice: mom.Client, chat: mom.Events) -> mom.Given:
    """Waits until it asks, and gives it the arm."""
    await says(chat, "may I have the arm")
    guard = await (await alice.token(TOKEN)).grab()
    return await guard.give("assistant", time=30, commands=5)


async def says(chat: mom.Events, words: str) -> None:
    while not str((await heard(chat, mom.Message)).content).startswith(words):
        pass


def person(lab: str, name: str) -> mom.Connect:
    return mom.connect(lab, user=name, password=name)


@pytest.mark.parametrize("taken", [False, True])
async def test_what_it_says_at_its_end(lab: str, taken: bool) -> None:
    async with person(lab, "alice") as alice, person(lab, "carol") as carol:
        chat = (await alice.channel("/chat")).events()
        process = await agent(lab)
        given = await lends(alice, chat)
        if taken:
            await says(chat, "finished: 350 mm")
            async with (await carol.token(TOKEN)).grab():
                out, err = await asyncio.wait_for(process.communicate(), PATIENCE)
        else:
            out, err = await asyncio.wait_for(process.communicate(), PATIENCE)
            guard = await asyncio.wait_for(given.back(), PATIENCE)
            assert guard, "it is hers again"
            await guard.release()
        assert process.returncode == 0, err.decode()
        assert out.decode().strip() == ("interrupted: preempted by carol" if taken else "done")
