"""An agent for hire: who lends it the arm sees it wave."""

import asyncio
import os

import mom
import mom.agent


class Waver(mom.agent.Agent):
    """Waves with the arm."""

    verb, token = "wave", "/robot/token"

    async def work(self, task: mom.agent.Task) -> str:
        async with task.driving("/robot/arm") as arm:
            for height in (350, 250, 300):
                (await arm.carry_out(f"move 0 0 {height} 0 0")).check()
                await task.tell(f"I am at {height} mm")
        return "I have waved"


async def main() -> None:
    async with mom.connect(os.environ["MOM_HUB"], user="assistant", password=os.environ["MOM_PASSWORD"]) as client:
        await mom.agent.serve(client, "/waving", Waver())


asyncio.run(main())
