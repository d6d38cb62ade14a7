"""Devices: a class with verbs becomes one that obeys its token's owner, stops for anybody, and says how it stands.

    from typing import Annotated
    from mom.device import Device, Number, verb

    class Cart(Device):
        \"\"\"A cart on a rail.\"\"\"

        stops_within = 500

        def halt(self) -> None:
            motors.brake()

        def position(self):
            return {"x": motors.x()}

        @verb
        async def go(self, x: Annotated[float, Number("mm", -1000, 1000)]) -> None:
            \"\"\"Drives to a place.\"\"\"
            await motors.drive_to(x)

`await client.obey("/robot/cart", Cart())` makes it a device there, and gives a `DevicePeer`. `run(main())` runs
the program, and has its devices halted whatever ends it. The other names are for devices that need
another driver or another language: a `DeviceServer` decides without a connection and without a clock.
"""

from .declare import Attachment, Flag, Kind, Number, Whole, Word, verb
from .device import Call, Device
from .errors import ERRORS, DeviceError
from .machine import Machine
from .peer import DevicePeer
from .program import run
from .server import DeviceServer

__all__ = [
    "ERRORS",
    "Attachment",
    "Call",
    "Device",
    "DeviceError",
    "DevicePeer",
    "DeviceServer",
    "Flag",
    "Kind",
    "Machine",
    "Number",
    "Whole",
    "Word",
    "run",
    "verb",
]
