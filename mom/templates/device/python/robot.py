"""A robot on two wheels: what it can do, how it stands still, where it is. The kit does the rest."""

import os
from typing import Annotated

import mom
from driver import motors
from mom.device import Device, Number, run, verb


class Robot(Device):
    """A robot on two wheels."""

    name = "newbot"
    stops_within = 500
    state = {"x": Number("mm"), "y": Number("mm"), "heading": Number("degrees"), "battery": Number("%")}

    def __init__(self):
        self.motors = motors()

    def halt(self):
        self.motors.brake()

    def keep_alive(self):
        self.motors.keep_alive()

    def position(self):
        return self.motors.pose()

    def report(self):
        return {"battery": self.motors.battery()}

    def estop(self):
        return self.motors.estop()

    def plan(self, calls):
        if self.motors.battery() < 5:
            raise calls[0].error("battery", "the battery is empty: charge it")

    @verb(relative=True)
    async def drive(self, way: Annotated[float, Number("mm", -2000, 2000)]):
        """Drives straight on."""
        await self.motors.drive(way)

    @verb(relative=True)
    async def turn(self, angle: Annotated[float, Number("degrees", -360, 360)]):
        """Turns on the spot."""
        await self.motors.turn(angle)

    @verb(velocity=300)
    def jog(self, speed: Annotated[float, Number("mm/s", -300, 300)], rate: Annotated[float, Number("degrees/s", -90, 90)]):
        """Drives on for 300 ms."""
        self.motors.set_speed(speed, rate)


async def main():
    hub = os.environ.get("MOM_HUB", "mom://127.0.0.1:7666")
    key = mom.Key.from_file("newbot.key")
    # Started again, it takes the place of its earlier start: nothing else may be called so.
    async with mom.connect(hub, user="newbot", key=key, heartbeat=0.5, installation="newbot") as client:
        device = await client.obey("/newbot/robot", Robot())
        print("newbot is ready", flush=True)
        await device.ended()


if __name__ == "__main__":
    run(main())
