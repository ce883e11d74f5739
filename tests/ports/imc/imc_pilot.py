"""A controller on an IMC bus over UDP that packs its own bytes and flies whatever takes its commands.

Run as a process: `python imc_pilot.py`. The port is the first line it prints, and at the end what it saw, as JSON. It
sets a height, sends the vehicle to a place by a maneuver, flies ahead by velocities, and falls silent.
"""

from __future__ import annotations

import json
import math
import socket
import struct
import time
from collections.abc import Callable

from imc_bus import LAT, LON, announce, heartbeat, packed, text

GOTO, ALTITUDE, SURGE = 450, 2, 1
FAR_M = (3.0, 2.0)
MAJOR_M, ECCENTRICITY2 = 6_378_137.0, 0.00669437999014


def place(east_m: float, north_m: float) -> tuple[float, float]:
    """Latitude and longitude of a point near the origin."""
    root = math.sqrt(1 - ECCENTRICITY2 * math.sin(LAT) ** 2)
    meridian, normal = MAJOR_M * (1 - ECCENTRICITY2) / root**3, MAJOR_M / root
    return LAT + north_m / meridian, LON + east_m / (normal * math.cos(LAT))


def desired_z(altitude_m: float) -> bytes:
    return packed(401, struct.pack("<fB", altitude_m, ALTITUDE), t_s=time.time())


def desired_velocity(ahead_m_s: float) -> bytes:
    return packed(409, struct.pack("<6dB", ahead_m_s, 0, 0, 0, 0, 0, SURGE), t_s=time.time())


def go_to(east_m: float, north_m: float, altitude_m: float, speed_m_s: float) -> bytes:
    """A VehicleCommand that starts a Goto."""
    lat, lon = place(east_m, north_m)
    goto = struct.pack("<HddfBfBddd", 0, lat, lon, altitude_m, ALTITUDE, speed_m_s, 0, 0, 0, 0) + text(b"")
    command = struct.pack("<BHB", 0, 77, 0) + struct.pack("<H", GOTO) + goto + struct.pack("<H", 0) + text(b"")
    return packed(501, command, t_s=time.time())


class Pilot:
    """Hears the vehicle and sends commands."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.02)
        self.peer: tuple[str, int] | None = None
        self.place = (math.nan, math.nan, math.nan)  # east, north, up [m]
        self.velocity = (math.nan, math.nan, math.nan)
        self.states, self.answer = 0, -1
        self.beat_s = 0.0

    def send(self, data: bytes) -> None:
        if self.peer is not None:
            self.socket.sendto(data, self.peer)

    def hear(self) -> None:
        try:
            data, self.peer = self.socket.recvfrom(65536)
        except TimeoutError:
            return
        number = struct.unpack_from("<H", data, 2)[0]
        if number == 350:
            x, y, z = struct.unpack_from("<3f", data, 20 + 20)
            vx, vy, vz = struct.unpack_from("<3f", data, 20 + 56)
            self.place, self.velocity = (y, x, -z), (vy, vx, -vz)
            self.states += 1
        elif number == 501:
            kind, request = struct.unpack_from("<BH", data, 20)
            self.answer = kind if request == 77 else -2

    def until(self, over: Callable[[], bool], each: Callable[[], bytes], limit_s: float = 40.0) -> bool:
        """Hear and send five times a second, with a heartbeat; whether it was over in time."""
        end, due = time.monotonic() + limit_s, 0.0
        while not over():
            now = time.monotonic()
            if now > end:
                return False
            if now > due:
                due = now + 0.2
                self.send(each())
            if now > self.beat_s:
                self.beat_s = now + 0.5
                self.send(announce(time.time()))
                self.send(heartbeat(time.time()))
            self.hear()
        return True


def main() -> None:
    pilot = Pilot()
    print(pilot.socket.getsockname()[1], flush=True)
    seen: dict[str, object] = {}
    seen["met"] = pilot.until(lambda: pilot.states > 5, lambda: heartbeat(time.time()), 90.0)
    seen["risen"] = pilot.until(lambda: abs(pilot.place[2] - 2.0) < 0.05, lambda: desired_z(2.0))
    there = (*FAR_M, 1.5)
    seen["arrived"] = pilot.until(lambda: math.dist(pilot.place, there) < 0.1, lambda: go_to(*there, 0.8))
    seen["answer"] = pilot.answer
    start = time.monotonic()
    pilot.until(lambda: time.monotonic() - start > 3.0, lambda: desired_velocity(0.4))
    seen["speed"] = math.hypot(*pilot.velocity)
    silent = time.monotonic()
    while time.monotonic() - silent < 6.0:
        pilot.hear()
    first, seen["silent_speed"] = pilot.place, math.hypot(*pilot.velocity)
    while time.monotonic() - silent < 7.0:
        pilot.hear()
    seen |= {"drift": math.dist(first, pilot.place), "place": pilot.place, "states": pilot.states}
    print(json.dumps(seen), flush=True)


if __name__ == "__main__":
    main()
