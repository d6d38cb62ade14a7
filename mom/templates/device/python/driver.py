"""The motors of the robot: simulated ones, and the place of the real ones."""

import asyncio
import math
import os
import time

SPEED = 200.0
"""mm/s of `drive`."""
RATE = 60.0
"""degrees/s of `turn`."""
DEADLINE = 0.3
"""s after which the motors stand by themselves when they hear nothing: no program can halt them when its computer fails."""


class SimulatedMotors:
    """Motors that take what they are told at once."""

    def __init__(self):
        self._x, self._y, self._heading = 0.0, 0.0, 0.0
        self._speed, self._rate, self._since = 0.0, 0.0, time.monotonic()
        self._heard = self._since

    def set_speed(self, speed, rate):
        """Goes on at so many mm/s and degrees/s."""
        self._advance()
        self._speed, self._rate, self._heard = speed, rate, self._since

    def keep_alive(self):
        """Goes on as it does, if it has not stood by itself."""
        self._advance()
        self._heard = self._since

    def brake(self):
        """Stands, at once, whatever it does."""
        self.set_speed(0.0, 0.0)

    def pose(self):
        """Where it is: mm, mm, degrees; whole ones, since what is based on a state is refused once the position is another."""
        self._advance()
        return {"x": round(self._x), "y": round(self._y), "heading": round(self._heading) % 360}

    def battery(self):
        """What is left, in %."""
        return 100

    def estop(self):
        """Whether its emergency stop is pressed: of these motors, whether there is a file `estop` here."""
        return os.path.exists("estop")

    async def drive(self, way):
        """Drives so many mm."""
        await self._go_on(math.copysign(SPEED, way), 0.0, abs(way) / SPEED)

    async def turn(self, angle):
        """Turns by so many degrees."""
        await self._go_on(0.0, math.copysign(RATE, angle), abs(angle) / RATE)

    async def _go_on(self, speed, rate, seconds):
        self.set_speed(speed, rate)
        await asyncio.sleep(seconds)  # tidy: the simulated way takes so long
        self.brake()

    def _advance(self):
        now = time.monotonic()
        is_late = now > self._heard + DEADLINE
        seconds = max(0.0, min(now, self._heard + DEADLINE) - self._since)
        self._since = now
        middle = math.radians(self._heading + self._rate * seconds / 2)
        self._x += self._speed * seconds * math.cos(middle)
        self._y += self._speed * seconds * math.sin(middle)
        self._heading += self._rate * seconds
        if is_late:
            self._speed, self._rate = 0.0, 0.0


class RealMotors(SimulatedMotors):
    """Yours: write `set_speed`, `brake`, `keep_alive`, `pose`, `battery` and `estop`; have `drive` and `turn` end by what `pose` measures."""

    def __init__(self, port):
        raise NotImplementedError(f"no driver for the motors at {port} yet: write it in driver.py")


def motors():
    """The motors at `MOTORS`, such as /dev/ttyUSB0; simulated ones without it."""
    port = os.environ.get("MOTORS")
    return RealMotors(port) if port else SimulatedMotors()
