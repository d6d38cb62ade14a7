"""A peer of a dialogue: reads parcels in the JSON form and sends them, writes what it hears in the same form.

The protocol of adapters is described in `tests/src/dialogue/program.rs`.
"""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "src")]

import json_form  # noqa: E402
from mom.connection import Connection  # noqa: E402
from mom.errors import MomError  # noqa: E402
from mom.parcel import Parcel  # noqa: E402


def say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


async def send_all(connection: Connection, lines: asyncio.StreamReader) -> None:
    while line := (await lines.readline()).decode().strip():
        await connection.send_parcel(json_form.read(line))


async def hear_all(connection: Connection) -> None:
    while parcel := await connection.receive():
        if parcel.is_("time", "ping"):
            await connection.send_parcel(Parcel("time", "pong", reference=parcel.id, content={}))
        else:
            say(json_form.write(parcel))


async def main(address: str) -> int:
    lines = asyncio.StreamReader(limit=1 << 26)
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
    try:
        connection = await Connection.open(address)
    except MomError as error:
        print(error, file=sys.stderr)
        return 1
    say("")
    both = [asyncio.ensure_future(send_all(connection, lines)), asyncio.ensure_future(hear_all(connection))]
    done, _ = await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
    if both[0] in done and both[0].exception() and both[1] not in done:
        # What cannot be sent any more is not a fault: the hub has closed, and what it said is still to be heard.
        await asyncio.wait(both)
    await connection.close()
    both[0].cancel()
    both[1].cancel()
    return 0


if __name__ == "__main__":
    sys.exit(asyncio.run(main(sys.argv[1])))
