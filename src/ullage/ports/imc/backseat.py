"""A mission of ours at the wheel of a DUNE vehicle: FollowReference is started, and References lead it along."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from ullage.data import Floats
from ullage.flight.missions import Waypoints
from ullage.ports.imc.codec import Packet, make
from ullage.ports.imc.link import Link
from ullage.ports.imc.places import SWAP, Geodetic, Pose

REQUEST, SUCCESS, FAILURE = 0, 1, 2
START, STOP = 0, 1
IGNORE_ERRORS = 2
LOCATION, SPEED, HEIGHT_FLAG, DONE = 0x01, 0x02, 0x04, 0x80
UNITS = {"depth": 1, "altitude": 2, "height": 3}
EVERY_S, ANSWER_S = 0.5, 5.0
PLAN = "ullage"


class Backseat:
    """Leads a vehicle from waypoint to waypoint.

    Args:
        link: to the vehicle's bus.
        mission: where to go, and how fast.
        z: how heights are told: "height" over the ellipsoid, "altitude" over the ground, "depth" under the origin.
        near_m: a waypoint this near is reached [m].
        say: told of what happens.
    """

    def __init__(
        self, link: Link, mission: Waypoints, *, z: str, near_m: float, say: Callable[[str], None]
    ) -> None:  # fmt: skip
        self._link, self._mission, self._units, self._near, self._say = link, mission, UNITS[z], near_m, say
        self.target = 0
        self.done = self.refused = False
        self._accepted = False
        self._request, self._asked, self._told = 0, -math.inf, -math.inf

    def take(self, packet: Packet) -> None:
        """Heed the vehicle's answers."""
        if packet.name != "PlanControl" or packet["request_id"] != self._request or packet["op"] != START:
            return
        if packet["type"] == SUCCESS and not self._accepted:
            self._accepted = True
            self._say(f"system {packet.src:#06x} follows")
        elif packet["type"] == FAILURE and not self.refused:
            self.refused = True
            self._say(f"system {packet.src:#06x} does not follow: {packet['info'] or 'it does not say why'}")

    def lead(self, vehicle: int, pose: Pose, origin: Geodetic) -> None:
        """Send what is due, now that the vehicle is there."""
        if self.done or self.refused:
            return
        now = time.monotonic()
        if not self._accepted and now - self._asked > ANSWER_S:
            self._asked = now
            self._start(vehicle)
        while self.target < len(self._mission) and self._reached(pose):
            self.target += 1
        if self.target >= len(self._mission):
            self._end(vehicle, origin)
        elif now - self._told >= EVERY_S:
            self._told = now
            self._refer(vehicle, origin, self.target, LOCATION | SPEED | HEIGHT_FLAG)

    def _reached(self, pose: Pose) -> bool:
        goal: Floats = self._mission.points[self.target]
        return float(np.linalg.norm(goal - pose.position)) <= self._near

    def _start(self, vehicle: int) -> None:
        self._request = (self._request + 1) % 65536
        follow = make(
            "FollowReference", control_src=self._link.me.system_id, control_ent=255, timeout=10.0,
            loiter_radius=max(self._near, 1.0), altitude_interval=max(self._near / 2, 0.5),
        )  # fmt: skip
        self._send(
            vehicle,
            "PlanControl",
            type=REQUEST,
            op=START,
            request_id=self._request,
            plan_id=PLAN,
            flags=IGNORE_ERRORS,
            arg=follow,
        )

    def _refer(self, vehicle: int, origin: Geodetic, index: int, flags: int) -> None:
        goal = self._mission.points[index]
        there = origin.moved(SWAP @ goal)
        values = {1: -goal[2], 2: goal[2], 3: there.height_m}
        self._send(
            vehicle, "Reference", flags=flags, lat=there.lat_rad, lon=there.lon_rad,
            speed=make("DesiredSpeed", value=self._mission.speed_m_s, speed_units=0),
            z=make("DesiredZ", value=float(values[self._units]), z_units=self._units),
        )  # fmt: skip

    def _end(self, vehicle: int, origin: Geodetic) -> None:
        self.done = True
        self._refer(vehicle, origin, len(self._mission) - 1, LOCATION | SPEED | HEIGHT_FLAG | DONE)
        self._send(vehicle, "PlanControl", type=REQUEST, op=STOP, request_id=self._request + 1, plan_id=PLAN)
        self._say("the mission is flown")

    def _send(self, vehicle: int, kind: str, **values: Any) -> None:
        self._link.send(make(kind, **values), entity=1, dst=vehicle, dst_ent=255)
