"""An agent: it asks for the arm, works, reports, gives the token back, and is interrupted at any moment."""

import asyncio
import os

import mom


async def work(arm: mom.Channel, chat: mom.Channel, fence: int, me: str) -> None:
    events = arm.events()
    for height in (350, 250, 300):
        await arm.send_acknowledged("command", f"move 0 0 {height} 0 0", fence=fence)
        async for event in events:  # Work: until the arm says what became of the command.
            if isinstance(event, mom.Message) and event.name == "status" and event.content["peer"] == me:
                if event.content["state"] in ("finished", "error"):
                    await chat.send("chat", f"{event.content['state']}: {height} mm")  # Report.
                    break


async def main() -> None:
    async with mom.connect(os.environ["MOM_HUB"], user="assistant", password=os.environ["MOM_PASSWORD"]) as client:
        arm, chat = await client.channel("/robot/arm"), await client.channel("/chat")
        token = await client.token("/robot/token")
        offers = token.events()
        # Ask. A person answers by: mom give assistant /robot/token --for 1m --commands 5
        await chat.send("chat", "may I have the arm, to wave?")
        async for event in offers:
            if isinstance(event, mom.Offer) and event.to == client.name:
                break
        async with token.accept() as guard:  # Return: the block gives the token back, whatever happens in it.
            working = asyncio.ensure_future(work(arm, chat, guard.fence, client.name))
            lost = asyncio.ensure_future(guard.lost())
            await asyncio.wait({working, lost}, return_when=asyncio.FIRST_COMPLETED)
            # Asked here, since the end of the block gives the token back, and then it is lost, too.
            interrupted = lost.done() and (working.cancel() or working.exception() is not None)
        if interrupted:  # By a peer that takes the token, or by the end of the scope.
            return print(f"interrupted: {lost.result().reason} by {lost.result().by}")
        working.result()
        print("done")


asyncio.run(main())
