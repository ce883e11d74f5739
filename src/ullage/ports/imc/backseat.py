"""Lead a DUNE vehicle by references, along a mission or as a drone in the loop.

The maneuver is FollowReference of IMC: `Follow` starts it, sends References and stops it [MartinsEtAl2009].
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ullage.arrays import Floats
from ullage.flight.missions import Waypoints
from ullage.flight.pilot import Velocity
from ullage.ports.drone import Drone
from ullage.ports.imc.assemble import Track
from ullage.ports.imc.codec import Packet, make, readable
from ullage.ports.imc.helm import FAILURE, REQUEST, START, STOP, SUCCESS
from ullage.ports.imc.link import Link, leave, open_link
from ullage.ports.imc.options import VehicleOptions
from ullage.ports.imc.wires import own_identity
from ullage.ports.intake import Log, warn
from ullage.ports.ned import SWAP, Geodetic
from ullage.ports.pose_events import BodyState

IN_PROGRESS = 3
IGNORE_ERRORS = 2
LOCATION, SPEED, HEIGHT_FLAG, DONE = 0x01, 0x02, 0x04, 0x80
UNITS = {"depth": 1, "altitude": 2, "height": 3}
LOITERS, XY_NEAR, Z_NEAR = (3, 4), 0x02, 0x04
"""FollowRefState: the states of loitering and hovering, and the proximity that DUNE finds."""
EVERY_S, ANSWER_S, CALIBRATION_S, RELEASE_S = 0.5, 5.0, 60.0, 3.0
NEAR_Z_M = 1.0
"""Greatest height error [m] of a vehicle that circles a point: heights and depths are held better than places."""
TURN = 2.0
"""A vehicle circles a point if it travels this many times its least distance and comes no nearer."""
SAME_PLACE_RAD = 1e-7
PLAN = "ullage"


class Follow:
    """Let a vehicle follow references: start the plan, send them, and stop it.

    Args:
        link: to the vehicle's bus.
        z: kind of height sent: "height" over the ellipsoid, "altitude" over the ground, "depth" under the origin.
        radius_m: on which it may loiter about a place [m].
        log: takes lines for the user.
    """

    def __init__(self, link: Link, *, z: str, radius_m: float, log: Log) -> None:
        self._link, self._units, self._radius_m, self._log = link, UNITS[z], radius_m, log
        self.vehicle: int | None = None
        self.refused = self.accepted = self.stopped = False
        self.place: Geodetic | None = None  # of the last Reference
        self._request, self._asked = 0, -math.inf
        self._patience_s = ANSWER_S
        self._stop: tuple[int, float] | None = None  # request to stop, and when it was first sent [s]

    @property
    def over(self) -> bool:
        """Whether the vehicle refused, stopped the plan, or does not answer the request to."""
        if self.refused or self.stopped:
            return True
        return self._stop is not None and time.monotonic() - self._stop[1] > RELEASE_S

    def take(self, packet: Packet) -> None:
        """Handle the vehicle's answers."""
        if packet.src != self.vehicle or packet.name != "PlanControl" or packet["type"] == REQUEST:
            return
        answer = packet["type"]
        if self._stop is not None:
            self.stopped |= packet["request_id"] == self._stop[0] and answer in (SUCCESS, FAILURE)
        elif packet["request_id"] != self._request or packet["op"] != START:
            return
        elif answer == IN_PROGRESS:
            self._patience_s = CALIBRATION_S
        elif answer == SUCCESS and not self.accepted:
            self.accepted = True
            self._log(f"system {packet.src:#06x} follows")
        elif answer == FAILURE and not self.refused:
            self.refused = True
            why = readable(packet["info"], 200) or "it does not say why"
            self._log(f"system {packet.src:#06x} does not follow: {why}")

    def start(self) -> None:
        """Start the plan, again until it is answered."""
        now = time.monotonic()
        if self.accepted or now - self._asked <= self._patience_s:
            return
        self._asked, self._request = now, (self._request + 1) % 65536
        follow = make(
            "FollowReference", control_src=self._link.me.system_id, control_ent=255, timeout=10.0,
            loiter_radius=max(self._radius_m, 1.0), altitude_interval=max(self._radius_m / 2, 0.5),
        )  # fmt: skip
        self._send("PlanControl", type=REQUEST, op=START, request_id=self._request, plan_id=PLAN,
                   flags=IGNORE_ERRORS, arg=follow)  # fmt: skip

    def refer(self, goal: ArrayLike, speed_m_s: float, origin: Geodetic, *, flags: int = 0) -> None:
        """Send a reference: a place (3) in the world [m] and a speed."""
        x, y, z = (float(value) for value in np.asarray(goal, float))
        there = self.place = origin.moved(SWAP @ [x, y, z])
        values = {1: -z, 2: z, 3: there.height_m}
        self._send(
            "Reference", flags=LOCATION | SPEED | HEIGHT_FLAG | flags, lat=there.lat_rad, lon=there.lon_rad,
            speed=make("DesiredSpeed", value=speed_m_s, speed_units=0),
            z=make("DesiredZ", value=values[self._units], z_units=self._units),
        )  # fmt: skip

    def stop(self) -> None:
        """Ask the vehicle to stop our plan."""
        if self.vehicle is None or not self._request or self.refused or self.stopped:
            return
        if self._stop is None:
            self._stop = ((self._request + 1) % 65536, time.monotonic())
        self._send("PlanControl", type=REQUEST, op=STOP, request_id=self._stop[0], plan_id=PLAN)

    def _send(self, kind: str, **values: Any) -> None:
        if self.vehicle is not None:
            self._link.send(make(kind, **values), entity=1, dst=self.vehicle, dst_ent=255)


class Backseat:
    """Lead a vehicle from waypoint to waypoint.

    A waypoint is reached within `near_m`. A vehicle that cannot stop, such as DUNE's lauv-simulator, circles a point on
    its own loiter radius (7.5 m there) instead. So a waypoint is also reached when DUNE reports that it loiters at it
    (FollowRefState), or when the vehicle is seen to circle it: it travels on and comes no nearer.

    Args:
        link: to the vehicle's bus.
        mission: waypoints and speed.
        z: kind of height sent: "height" over the ellipsoid, "altitude" over the ground, "depth" under the origin.
        near_m: a waypoint this near is reached [m].
        log: takes lines for the user.
    """

    def __init__(self, link: Link, mission: Waypoints, *, z: str, near_m: float, log: Log) -> None:
        self._link, self._mission, self._near, self._log = link, mission, near_m, log
        self._follow = Follow(link, z=z, radius_m=near_m, log=log)
        self.target = 0
        self.done = self._loiters = False
        self._sent_s = -math.inf
        self._last: Floats | None = None  # last position of the vehicle
        self._least_m, self._travelled_m = math.inf, 0.0  # least distance from the target, and path length since then

    @property
    def finished(self) -> bool:
        """Whether the mission is over: the vehicle refused, stopped the plan, or does not answer."""
        return self._follow.over

    def take(self, packet: Packet) -> None:
        """Handle the vehicle's answers."""
        self._follow.take(packet)
        if packet.src == self._follow.vehicle and packet.name == "FollowRefState":
            self._loiters = self._loiters or self._loiters_there(packet)

    def _loiters_there(self, packet: Packet) -> bool:
        """Whether DUNE reports that the vehicle loiters at the point of the last Reference."""
        reported, sent = packet["reference"], self._follow.place
        if packet["control_src"] != self._link.me.system_id or reported is None or reported.name != "Reference":
            return False
        if sent is None:
            return False
        if max(abs(reported["lat"] - sent.lat_rad), abs(reported["lon"] - sent.lon_rad)) > SAME_PLACE_RAD:
            return False
        return packet["state"] in LOITERS and packet["proximity"] & (XY_NEAR | Z_NEAR) == XY_NEAR | Z_NEAR

    def lead(self, vehicle: int, pose: BodyState, origin: Geodetic) -> None:
        """Send the messages that are due at this pose of the vehicle."""
        self._follow.vehicle = vehicle
        if self._follow.refused:
            return
        now = time.monotonic()
        due = now - self._sent_s >= EVERY_S
        if self.done:
            if due and not self.finished:
                self._sent_s = now
                self._follow.stop()
            return
        self._follow.start()
        while self.target < len(self._mission) and self._reached(pose):
            self.target += 1
            self._loiters, self._least_m, self._travelled_m = False, math.inf, 0.0
        if self.target >= len(self._mission):
            self.done, self._sent_s = True, now
            self._refer(origin, len(self._mission) - 1, DONE)
            self._follow.stop()
            self._log("the mission is flown")
        elif due:
            self._sent_s = now
            self._refer(origin, self.target, 0)

    def _reached(self, pose: BodyState) -> bool:
        away: Floats = self._mission.points[self.target] - pose.position
        far_m = float(np.linalg.norm(away))
        if far_m <= self._near:
            return True
        step_m = 0.0 if self._last is None else float(np.linalg.norm(pose.position - self._last))
        self._last = pose.position
        if not self._follow.accepted or abs(float(away[2])) > min(self._near, NEAR_Z_M):
            return False
        across_m = math.hypot(away[0], away[1])
        if across_m < 0.95 * self._least_m:
            self._least_m, self._travelled_m = across_m, 0.0
            return self._loiters
        self._travelled_m += step_m
        circles = self._travelled_m > TURN * self._least_m and across_m < 1.2 * self._least_m
        return self._loiters or circles

    def _refer(self, origin: Geodetic, index: int, flags: int) -> None:
        self._follow.refer(self._mission.points[index], self._mission.speed_m_s, origin, flags=flags)

    def release(self) -> None:
        """Stop the plan at the end of a run."""
        self._follow.stop()


EXECUTING = 3
"""State of PlanControlState."""
LEAST_M_S = 0.1
"""Least speed to a place, for a vehicle that holds its place also needs one."""


class ImcDrone(Drone):
    """A vehicle that follows references. It is no longer ours once its plan ends, or another one runs.

    Args:
        place: `tcp://host:port`, `udp://host:port`, or nothing.
        options: which vehicle, and how.

    Raises:
        InputError: the place or an option is not valid.
    """

    settings = VehicleOptions
    takes = ("pose",)
    refusal = "a vehicle that follows references takes no velocities"

    def __init__(self, place: str, options: VehicleOptions) -> None:
        self._link = open_link(place, options, own_identity(options), role="source", log=warn)
        super().__init__(options.state, self._link.counters)
        self._track = Track(self.counters, state=options.state, origin=options.place(), vehicle=options.vehicle)
        self._follow = Follow(self._link, z=options.z, radius_m=1.0, log=warn)
        self._limit_m_s, self._plan = options.limit_m_s, ""  # why its plan is not ours
        self._runs = False  # our plan was reported to run

    @property
    def away(self) -> str:  # type: ignore[override]
        """Why it does not follow references."""
        return self._plan or ("" if self._follow.accepted else "the vehicle has not accepted the plan yet")

    @property
    def broken(self) -> str:  # type: ignore[override]
        """Whether it refused."""
        return "the vehicle does not follow" if self._follow.refused else ""

    def _arrived(self) -> Iterator[BodyState]:
        for packet in self._link.arriving(0.0):
            self._follow.take(packet)
            if packet.src == self._follow.vehicle and packet.name == "PlanControlState":
                ours = packet["plan_id"] == "ullage" and packet["state"] == EXECUTING
                self._runs = self._runs or ours
                self._plan = "" if ours or not self._runs else "another plan runs, or none: the operator took over"
            elif packet.src == self._follow.vehicle and packet.name == "Abort":
                self._plan = "the operator aborted"
            for found in self._track.take(packet):
                self._follow.vehicle = self._track.followed
                yield found.item

    def steer(self, velocity: Velocity) -> None:
        """Let it hover where it is: it takes no velocities."""
        if self._last is not None:
            x, y, z = (float(value) for value in self._last.position)
            self.go_to((x, y, z), 0.0)

    def go_to(self, position: tuple[float, float, float], heading_rad: float) -> None:
        """Send a reference, as fast as the place is away; a vehicle turns towards it by itself."""
        if self._last is None or self._track.origin is None or self._follow.refused:
            return
        self._follow.start()
        away_m = float(np.linalg.norm(np.array(position) - self._last.position))
        self._follow.refer(position, min(max(away_m, LEAST_M_S), self._limit_m_s), self._track.origin)

    def hold(self) -> None:
        """Stop the plan: DUNE holds the vehicle as its configuration says."""
        self._follow.stop()

    def close(self) -> None:
        """Leave the bus after the last messages were sent."""
        self._link.flush(1.0)
        leave(self._link, "source")
