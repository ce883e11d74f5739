"""A vehicle by imcpy, which is not ours: finds ullage by its announcement, says where it is, counts what it hears."""

import json
import time
from collections import Counter

import imcpy
from imc_bus import LAT, LON, VEHICLE
from imcpy.actors import DynamicActor
from imcpy.decorators import Periodic, Subscribe

SPEED = 0.5
QUIET_S = 3.0
"""It ends when no frame has come for so long since the first."""


class Vehicle(DynamicActor):
    """Flies north from the origin, looking east, from the moment that it hears a heartbeat."""

    def __init__(self) -> None:
        super().__init__(imc_id=VEHICLE)
        self.announce.sys_name = "imcpy-vehicle"
        self.announce.sys_type = imcpy.SystemType.UAV
        self.heartbeat.append("ullage")
        self.first = self.heard = None  # when the first heartbeat came, and the last frame
        self.count, self.speakers, self.listed = Counter(), set(), ""

    @Periodic(1)
    def announce_often(self) -> None:
        self._send_announce()

    @Periodic(0.05)
    def tell(self) -> None:
        if self.first is None:
            return
        flown_s = time.monotonic() - self.first
        quiet_s = time.monotonic() - self.heard if self.heard else 0.0
        if quiet_s > QUIET_S:
            self.stop()
        told = imcpy.EstimatedState()
        told.lat, told.lon, told.height = LAT, LON, 40.0
        told.x, told.z, told.psi, told.vx = SPEED * flown_s, -1.5, 1.5707963, SPEED
        self.send("ullage", told)

    @Subscribe(imcpy.Message)
    def hear(self, message: imcpy.Message) -> None:
        if message.src == VEHICLE:
            return
        self.count[type(message).__name__] += 1
        self.speakers.add(message.src)
        if isinstance(message, imcpy.Heartbeat) and self.first is None:
            self.first = time.monotonic()
        if isinstance(message, imcpy.DevDataBinary):
            self.heard = time.monotonic()
        if isinstance(message, imcpy.EntityList):
            self.listed = message.list


vehicle = Vehicle()
vehicle.run()
print(json.dumps({"count": vehicle.count, "speakers": sorted(vehicle.speakers), "listed": vehicle.listed}))
