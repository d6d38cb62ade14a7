"""Driving devices: commands, each followed to its end, in the same words as everywhere in MOM.

    import asyncio, mom, mom.drive

    async def main():
        async with mom.connect("mom://localhost", user="alice", password="alice") as client:
            async with mom.drive.driving(client, "/robot/arm", wait=60) as arm:
                end = await arm.carry_out("move 100 50 200 0 0", told=print)
                if end.unreachable:
                    print(f"it cannot go there: {end.text}")
                (await arm.carry_out("by 0 0 -50 0 0")).check()     # CommandFailed, if it was not carried out
        # released, and the arm has said that it has ended what ran

    asyncio.run(main())

`driving` joins the channel, owns its token for the block and gives a `Commander`. That alone is for programs that hold the token
otherwise: `Commander(channel, guard)`. A `CommandEnd` says how a command ended: carried out, refused by the device or the hub, with a device that
does not answer or is gone, or with the token or the link lost.
"""

from .command import Command
from .commander import Commander
from .course import Progress
from .driving import Driving, driving
from .end import CommandEnd, CommandFailed, DriveError, lost_words

__all__ = [
    "Command",
    "CommandEnd",
    "CommandFailed",
    "Commander",
    "DriveError",
    "Driving",
    "Progress",
    "driving",
    "lost_words",
]
