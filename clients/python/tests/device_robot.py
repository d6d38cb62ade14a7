"""A device of a test's, and the hub that it is at."""

from __future__ import annotations

import asyncio
from contextlib import asynccontextmanager
from typing import Any, AsyncIterator, Callable, Dict, List, Optional

from conftest import PATIENCE
from fake_hub import FakeHub

import mom
from mom.device import Device, DevicePeer, verb
from mom.parcel import Parcel

ARM = "/robot/arm"
QUICK = mom.Reconnect(first=0.005, most=0.05)


class Recorder(Device):
    """Notes what it is told."""

    name = "arm"

    def __init__(self) -> None:
        self.told: List[Any] = []
        self.moving: Callable[[str], Any] = lambda word: None
        self.reporting: Callable[[], Dict[str, Any]] = dict

    def halt(self) -> None:
        self.told.append("halt")

    def position(self) -> Dict[str, Any]:
        return {"position": 7}

    def report(self) -> Dict[str, Any]:
        return self.reporting()

    @verb
    async def do(self, word: str) -> None:
        self.told.append(word)
        moving = self.moving(word)
        if moving is not None:
            await moving

    @verb
    async def hold(self) -> None:
        self.told.append("hold")
        await asyncio.Event().wait()


class Robot:
    """A device, its machine, and the hub that it is at."""

    def __init__(self, hub: FakeHub) -> None:
        self.hub = hub
        self.device: Any = Recorder()
        self.guard: Dict[str, Any] = {}
        self.client: mom.Client
        self.arm: DevicePeer

    async def start(self, **options: Any) -> None:
        self.books(number=0, stopped=False)
        self.client = await mom.connect(self.hub.address, guest=True, reconnect=QUICK, **{"heartbeat": 5.0, **options})
        self.arm = await self.client.obey(ARM, self.device)

    def books(self, **state: Any) -> None:
        """What the hub says to who joins."""
        self.hub.replies["join"] = {"path": ARM, "kind": "channel", "number": 7, "stop": state, **self.guard}

    def say(
        self,
        name: str,
        content: Any = None,
        sender: str = "bob",
        number: Optional[int] = None,
        based_on: Optional[int] = None,
        **slots: Any,
    ) -> None:
        found = {"stop": number, "based-on": based_on}
        extra = {key: value for key, value in found.items() if value is not None}
        self.hub.say(Parcel("message", name, ARM, content, sender=sender, extra=extra, **slots))

    def tell(self, name: str, **state: Any) -> None:
        self.hub.say(Parcel("event", name, ARM, state, sender="hub"))

    def said(self, name: str) -> List[Any]:
        return [parcel.content for parcel in self.hub.heard if parcel.is_("message", name)]

    @property
    def told(self) -> List[Any]:
        return self.device.told

    @property
    def deeds(self) -> List[Any]:
        """What it was told to do, each halt that followed once."""
        told = self.told
        return [word for place, word in enumerate(told) if word != "halt" or told[place - 1 : place] != ["halt"] and place]

    def errors(self) -> List[Any]:
        """The commands that ended by an error, with its name."""
        return [(one.get("id"), one["error"]["name"]) for one in self.said("status") if one["state"] == "error"]

    def why(self, number: int) -> str:
        """Why this command ended."""
        return "".join(one["error"]["text"] for one in self.said("status") if one.get("id") == number and "error" in one)

    async def until(self, condition: Callable[[], Any]) -> None:
        async def wait() -> None:
            while not condition():
                await asyncio.sleep(0.002)  # tidy: looks again until it is so

        try:
            await asyncio.wait_for(wait(), PATIENCE)
        except asyncio.TimeoutError:
            said = [(parcel.name, parcel.content) for parcel in self.hub.heard[-12:]]
            raise AssertionError(f"told {self.told[-12:]}, said at last {said}") from None

    async def settled(self) -> None:
        """All that the hub has said so far is heard, and all that the device has said to it has come."""
        for _ in range(2):
            await self.client.lookup("/")


@asynccontextmanager
async def robot_at_hub() -> AsyncIterator[Robot]:
    """A device that is not started yet, at a hub of its own."""
    hub = await FakeHub().start()
    robot = Robot(hub)
    yield robot
    await robot.client.close()
    await hub.stop()
