"""An agent that holds the token as its task says: what every agent of the kit does alike, in Python."""

import asyncio
import os

import mom
import mom.agent
from mom.device import run
from mom.drive import DriveError


class Holder(mom.agent.Agent):
    """Holds the token."""

    verb, token = "hold", "/robot/token"

    def read(self, content):
        if not isinstance(content.get("what"), str):
            raise mom.agent.Refused("bad-content", "say `what`")
        return content["what"]

    def words(self, what):
        return f"hold {what}"

    async def meet(self, task):
        if task.what == "nothing":
            raise mom.agent.Refused("try-later", "there is nothing to hold")
        return self.token

    async def work(self, task):
        if task.what == "badly":
            raise DriveError("my hands are full")
        if task.what == "crashes":
            raise KeyError("it crashes, as it is to")
        if task.what == "unsayable":
            nested: list = []
            nested.append(nested)
            return {"text": "I held it", "how": nested, "often": 2**80}
        if task.what == "cancels itself":
            raise asyncio.CancelledError
        if task.what == "once":
            return {"text": "I held it once", "times": 1}
        if task.what == "the arm":
            async with task.driving("/robot/arm") as arm:
                (await arm.carry_out("home; wait 60000")).check()
        while True:
            try:
                await asyncio.Event().wait()
            except asyncio.CancelledError:
                if task.what != "deaf":
                    raise


async def main():
    async with mom.connect(os.environ["MOM_HUB"], user="servo", password="servo") as client:
        print("ready", flush=True)
        await mom.agent.serve(client, "/servo", Holder())


run(main())
