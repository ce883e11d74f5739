"""Command the vehicle of an autopilot by set-points: GUIDED of ArduCopter, OFFBOARD of PX4.

The pilot arms, takes off and chooses that mode; any other mode is his again, and nothing more is sent. Both autopilots
take SET_POSITION_TARGET_LOCAL_NED [MAVLink]. PX4 accepts OFFBOARD only while set-points come, so they come before it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from ullage.flight.pilot import HOVER, Velocity
from ullage.geometry import invert, quat_rpy
from ullage.ports.drone import Drone
from ullage.ports.intake import warn
from ullage.ports.mavlink.brake import ASK_S, ASKS, BRAKE, COPTERS
from ullage.ports.mavlink.link import command_to, leave, open_link
from ullage.ports.mavlink.options import DroneOptions
from ullage.ports.mavlink.source import LOCAL_NED, PoseFeed, origin_of
from ullage.ports.ned import SWAP
from ullage.ports.pose_events import BodyState, Notice

PX4_HOLD = (4, 3)  # AUTO, LOITER
ONLY_VELOCITY, ONLY_POSE = 0x5C7, 0x9F8
"""POSITION_TARGET_TYPEMASK of velocity and yaw rate, and of position and yaw."""


class MavlinkDrone(Drone):
    """The vehicle of an autopilot.

    Args:
        place: as of the port.
        options: which poses, and the ids on the link.

    Raises:
        InputError: the place cannot be opened, or no autopilot is there.
        MissingExtra: pymavlink or pyserial is not installed.
    """

    settings = DroneOptions

    def __init__(self, place: str, options: DroneOptions) -> None:
        self._origin, self._only_local, self._skewed = origin_of(options.origin), options.poses == "local", ""
        self._link = open_link(place, options, role="source", log=warn)
        super().__init__("poses", self._link.counters)
        self._heartbeat: Any = None
        self._answers: dict[int, int] = {}  # result by command
        self._link.watchers.append(self._take)
        try:
            self._link.wait_heartbeat(options.wait_s)
        except BaseException:
            leave(self._link, "source")
            raise
        self._feed = PoseFeed(self._link, options)

    def _take(self, message: Any) -> None:
        """Take a message of the autopilot, in the link's thread."""
        kind = message.get_type()
        if kind == "HEARTBEAT":
            self._heartbeat = message
        elif kind == "ODOMETRY" and message.frame_id != LOCAL_NED and not self._only_local:
            self._skewed = "its ODOMETRY is not in MAV_FRAME_LOCAL_NED, as set-points are (poses=local leaves it out)"
        elif kind == "COMMAND_ACK":
            self._answers[int(message.command)] = int(message.result)

    @property
    def away(self) -> str:  # type: ignore[override]
        """Why it does not follow set-points."""
        from pymavlink.mavutil import mode_string_v10

        last = self._heartbeat
        if last is None:
            return "no HEARTBEAT yet"
        if last.type not in COPTERS:
            return "the vehicle is no multirotor"
        mode, wanted = mode_string_v10(last), "OFFBOARD" if self._px4 else "GUIDED"
        if mode != wanted:
            return f"the pilot flies, in mode {mode} and not {wanted}"
        return "" if last.base_mode & self._link.dialect.MAV_MODE_FLAG_SAFETY_ARMED else "the vehicle is disarmed"

    @property
    def _px4(self) -> bool:
        return bool(self._heartbeat.autopilot == self._link.dialect.MAV_AUTOPILOT_PX4)

    @property
    def broken(self) -> str:  # type: ignore[override]
        """Why its poses are not to be trusted any more."""
        return self._feed.jumped or self._skewed

    def _arrived(self) -> Iterator[BodyState]:
        while (found := self._feed.next(0.0)) is not None:
            if isinstance(found, Notice):
                warn(found.text)
            else:
                yield found

    def steer(self, velocity: Velocity) -> None:
        """Command a velocity in the level frame of the heading."""
        if self._last is None:
            return
        yaw = float(quat_rpy(self._last.quat_xyzw)[2])
        cos, sin = math.cos(yaw), math.sin(yaw)
        forward, left, up, turn = velocity
        world = np.array([forward * cos - left * sin, forward * sin + left * cos, up])
        north, east, down = SWAP @ self._origin[:3, :3].T @ world
        self._send(ONLY_VELOCITY, (0, 0, 0, north, east, down, 0, 0, 0, 0, -turn))

    def go_to(self, position: tuple[float, float, float], heading_rad: float) -> None:
        """Command a set-point in the world."""
        local = invert(self._origin) @ np.array([*position, 1.0])
        origin_yaw = math.atan2(self._origin[1, 0], self._origin[0, 0])
        yaw = math.remainder(math.pi / 2 - (heading_rad - origin_yaw), math.tau)
        self._send(ONLY_POSE, (*(SWAP @ local[:3]), 0, 0, 0, 0, 0, 0, yaw, 0))

    def _send(self, mask: int, fields: tuple[float, ...]) -> None:
        """Send a set-point with the time of the pose that it answers."""
        there = self._link.autopilot
        if there is None:
            return
        boot_ns = self._link.boot_ns(self.answered_ns) if self.answered_ns else None
        ms = ((time.monotonic_ns() if boot_ns is None else boot_ns) // 1_000_000) & 0xFFFFFFFF
        message = self._link.dialect.MAVLink_set_position_target_local_ned_message
        self._link.send(message(ms, there.system, there.component, LOCAL_NED, mask, *map(float, fields)))

    def hold(self) -> None:
        """Let it hover by itself: BRAKE of ArduCopter, LOITER of PX4."""
        d = self._link.dialect
        self.steer(HOVER)
        modes = PX4_HOLD if self._heartbeat is not None and self._px4 else (BRAKE, 0)
        self._order(d.MAV_CMD_DO_SET_MODE, (d.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, *modes))

    def land(self) -> None:
        """Let the autopilot finish the landing and stop the motors."""
        self._order(self._link.dialect.MAV_CMD_NAV_LAND, ())

    def _order(self, command: int, values: tuple[float, ...]) -> None:
        """Send a command until it is answered."""
        d, there = self._link.dialect, self._link.autopilot
        if there is None:
            return
        self._answers.pop(command, None)
        for count in range(ASKS):
            self._link.send(command_to(there, command, *values, confirmation=count))
            until = time.monotonic() + ASK_S
            while command not in self._answers and time.monotonic() < until:
                time.sleep(0.01)
            if command in self._answers:
                break
        result = self._answers.get(command)
        if result != d.MAV_RESULT_ACCEPTED:
            what = d.enums["MAV_CMD"][command].name
            warn(f"the autopilot {'does not answer' if result is None else f'refused ({result})'} {what}")

    def close(self) -> None:
        """Leave the link."""
        if self._take in self._link.watchers:
            self._link.watchers.remove(self._take)
        self._feed.close()
