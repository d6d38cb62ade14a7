"""The program of a device: what asyncio still does for it at its end moves nothing for long, since halts follow that."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import List, Tuple

import pytest
from conftest import PATIENCE, ROOT

PROGRAM = """
import asyncio, os, signal, sys
import mom
from dataclasses import dataclass
from fake_hub import FakeHub
from mom.device import Device, run, verb
how, halting = sys.argv[1:]
def say(word):
    print(word, flush=True)
@dataclass
class Cart(Device):
    stops_within = 200
    at_last = False
    def halt(self):
        say("halt")
        if Cart.at_last and halting == "raises":
            raise OSError("no brake")
        if Cart.at_last and halting == "awaits":
            return self.later("halted")
        if Cart.at_last and halting == "begins":
            asyncio.ensure_future(self.later("halted"))
        if Cart.at_last and halting == "hangs":
            return self.hangs()
    async def later(self, word):
        await asyncio.sleep(0)  # tidy: it takes a turn
        say(word)
    async def hangs(self):
        while True:
            try:
                await asyncio.Event().wait()
            except asyncio.CancelledError:
                pass
@dataclass
class Other(Cart):
    name = "other"
async def left():
    try:
        await asyncio.Event().wait()
    finally:
        Cart.at_last = True
        say("moves")
async def steps():
    try:
        yield 1
    finally:
        Cart.at_last = True
        say("moves")
async def main():
    hub = await FakeHub().start()
    client = await mom.connect(hub.address, guest=True, heartbeat=0.5)
    for path, device in (("/robot/arm", Cart()), ("/robot/other", Other())):
        hub.replies["join"] = {"path": path, "kind": "channel", "number": 7}
        peer = await client.obey(path, device)
    del device
    held.append(steps())
    await held[0].__anext__()
    task = asyncio.ensure_future(left())
    held.append(task)
    asyncio.get_running_loop().call_soon(say, "begun")
    await asyncio.sleep(0)  # tidy: it has begun
    if how == "raise":
        raise ValueError("no way")
    if how == "exit":
        sys.exit(3)
    if how == "signal":
        os.kill(os.getpid(), signal.SIGTERM)
        await asyncio.Event().wait()
held = []
run(main())
"""


def ends(how: str, halting: str = "plain") -> Tuple[List[str], int, str]:
    """What its motors were told since it had begun, its exit code, and what it has logged."""
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT / "clients/python/src"), str(ROOT / "clients/python/tests")])}
    done = subprocess.run([sys.executable, "-c", PROGRAM, how, halting], env=env, capture_output=True, text=True, timeout=PATIENCE)
    told = done.stdout.split()
    return told[told.index("begun") + 1 :], done.returncode, done.stderr


@pytest.mark.parametrize(("how", "code"), [("return", 0), ("raise", 1), ("exit", 3), ("signal", 143)])
def test_each_device_is_halted_behind_all_that_asyncio_clears_up(how: str, code: int) -> None:
    told, found, log = ends(how)
    assert told.count("moves") == 2 and told[-2:] == ["halt", "halt"] and found == code, (told, found, log)


@pytest.mark.parametrize("halting", ["raises", "awaits", "begins", "hangs"])
def test_whatever_its_last_halt_does_each_is_called_and_the_exit_code_stays(halting: str) -> None:
    told, code, log = ends("exit", halting)
    last = told[len(told) - told[::-1].index("moves") :]
    assert last == ["halt", "halt", *(["halted"] * 2 if halting in ("awaits", "begins") else [])] and code == 3, (told, log)
    assert ("no brake" in log) == (halting == "raises") and ("does not end" in log) == (halting == "hangs"), log
