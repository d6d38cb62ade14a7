"""A device: a cart on a rail of two metres, simulated.

    MOM_HUB=mom://lab.example.org MOM_USER=rail MOM_PASSWORD=… python rail.py /robot/rail
"""

import asyncio
import os
import sys
import time
from typing import Annotated, Any, Dict, List, Optional

import mom
from mom.device import Call, Device, Number, Whole, run, verb

END = 1000.0
SPEED = 200.0


class Cart(Device):
    """A cart on a rail."""

    stops_within = 200
    state = {"x": Number("mm", does="From the middle of the rail"), "lamp": Whole("%")}

    def __init__(self) -> None:
        self._x, self._speed, self._since, self._lamp = 0.0, 0.0, time.monotonic(), 0
        self._planned: Optional[float] = None

    def halt(self) -> None:
        self._drive(0.0)
        self._planned = None

    def position(self) -> Dict[str, float]:
        x = self._x + self._speed * (time.monotonic() - self._since)
        return {"x": min(max(x, -END), END)}

    def report(self) -> Dict[str, int]:
        return {"lamp": self._lamp}

    def plan(self, calls: List[Call]) -> None:
        x = self.position()["x"] if self._planned is None else self._planned
        for call in calls:
            x = call.arguments["x"] if call.verb == "go" else x + call.arguments.get("way", 0.0)
            if abs(x) > END:
                raise call.error("workspace-boundary", f"the rail ends at {END:g} mm")
        self._planned = x

    @verb
    async def go(self, x: Annotated[float, Number("mm", -END, END)]) -> None:
        """Drives to a place."""
        way = x - self.position()["x"]
        self._drive(SPEED if way > 0 else -SPEED)
        await asyncio.sleep(abs(way) / SPEED)
        self._drive(0.0)

    @verb(relative=True)
    async def by(self, way: Annotated[float, Number("mm", -END, END)]) -> None:
        """Drives so far from where it is."""
        await self.go(self.position()["x"] + way)

    @verb(velocity=300)
    def jog(self, speed: Annotated[float, Number("mm/s", -SPEED, SPEED)]) -> None:
        """Drives at a speed."""
        self._drive(speed)

    @verb(moves=False)
    def lamp(self, brightness: Annotated[int, Whole("%", 0, 100)] = 100) -> None:
        """Lights its lamp."""
        self._lamp = brightness

    def _drive(self, speed: float) -> None:
        self._x, self._since, self._speed = self.position()["x"], time.monotonic(), speed


async def main() -> None:
    login: Dict[str, Any] = {"user": os.environ["MOM_USER"], "password": os.environ["MOM_PASSWORD"], "heartbeat": 0.5}
    async with mom.connect(os.environ["MOM_HUB"], **login) as client:
        await (await client.obey(sys.argv[1], Cart())).ended()


if __name__ == "__main__":
    run(main())
