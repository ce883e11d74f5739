"""Switch ArduCopter to its mode BRAKE before an obstacle: `--to mavlink:PLACE?guard=brake`.

A set-point of zero velocity would not do. In Guided the newest set-point counts, so ours would alternate with those of
the program that flies. In Auto and Loiter ArduCopter ignores them. It accepts a mode from a companion in all three, and
holds its position in BRAKE until the pilot chooses another mode [ArduPilotBrake]. Version 4.7 shapes that stop as
v' = -v / T with T = 7.5 m/s^2 / PSC_JERK_XY, 1.5 s by default: from 1 m/s it needs 1.5 m.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from ullage.arrays import Floats
from ullage.config import GuardSpec
from ullage.data import Trajectory
from ullage.geometry import rpy_quat
from ullage.ports.intake import Once
from ullage.ports.mavlink.link import Link, command_to
from ullage.ports.mavlink.options import SinkOptions
from ullage.processing.guard import Guard
from ullage.processing.obstacles import STALE_S, ObstacleSectors

BRAKE = 17
"""Number of the mode BRAKE."""
MODES = {3: "Auto", 4: "Guided", 5: "Loiter"}
"""Modes that it switches from. In the others the pilot flies by hand, or a failsafe brings the vehicle home."""
COPTERS = frozenset({2, 3, 4, 13, 14, 15, 29, 35})
"""MAV_TYPE of multirotors and helicopters: other vehicles give other meanings to the numbers of modes."""
LEAST_M_S = 0.1
"""Slower than this, estimates of velocities are noise."""
DELAY_S = 0.2
"""From the time at which distances are sent until BRAKE acts: a frame period, the link, the mode."""
CLEAR_S = 1.0
"""An event is over when it was safe for so long."""
ASK_S, ASKS = 0.2, 5
"""Between two requests without an answer, and how many."""
BRAKING_M_S2 = 4.0
"""Deceleration that a lean of 22 degrees gives: it reaches it where PSC_JERK_XY allows."""
POSES_HZ = 20.0


class ModeBrake:
    """Asks for BRAKE once for each event: when the vehicle is about to enter the margin, or where no radar is alive.

    It asks for nothing else: the pilot, or his program, decides how the flight goes on. While an event lasts, another
    mode that he chooses stands.

    Args:
        link: to the autopilot; its messages are watched.
        options: size of the vehicle and how it stops.
        send_text: shows a severity and a text to the pilot.
        now: a clock that never goes back [s].
    """

    def __init__(
        self, link: Link, options: SinkOptions, send_text: Callable[[int, str], None], *,
        now: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        self._link, self._options, self._send_text, self._now = link, options, send_text, now
        self._copter: bool | None = None  # None: no HEARTBEAT yet
        self._mode = -1  # while it is armed
        self._velocity, self._moved_s = np.zeros(2), -math.inf  # east, north [m/s], and when it came
        self._yaw = math.nan  # counter-clockwise from east [rad]
        self._unsafe_s: float | None = None  # when it was unsafe last; None: no event
        self._from, self._asks, self._asked_s, self._answer = -1, 0, 0.0, -1  # of the event
        self._warn = Once(lambda text: send_text(link.dialect.MAV_SEVERITY_CRITICAL, text))
        link.watchers.append(self._take)
        link.request_hz = link.request_hz or POSES_HZ

    def _take(self, message: Any) -> None:
        d, kind = self._link.dialect, message.get_type()
        if kind == "HEARTBEAT":
            self._copter = message.autopilot == d.MAV_AUTOPILOT_ARDUPILOTMEGA and message.type in COPTERS
            self._mode = message.custom_mode if message.base_mode & d.MAV_MODE_FLAG_SAFETY_ARMED else -1
        elif kind == "LOCAL_POSITION_NED":
            self._velocity, self._moved_s = np.array([message.vy, message.vx]), self._now()
            self._link.poses_come = True
        elif kind == "ATTITUDE":
            self._yaw = math.pi / 2 - message.yaw
        elif kind == "ATTITUDE_QUATERNION":
            w, x, y, z = message.q1, message.q2, message.q3, message.q4
            self._yaw = math.pi / 2 - math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        elif kind == "COMMAND_ACK" and message.command == d.MAV_CMD_DO_SET_MODE:
            self._answer = int(message.result)

    def judge(self, sectors: ObstacleSectors, age_s: float) -> None:
        """Brake if the vehicle moves and could not stop later.

        Args:
            sectors: the last obstacles.
            age_s: how old they are [s].
        """
        d, now = self._link.dialect, self._now()
        cause = self._cause(sectors, age_s)
        if cause:
            if self._unsafe_s is None:
                self._from, self._asks, self._asked_s, self._answer = self._mode, 0, -math.inf, -1
                self._send_text(d.MAV_SEVERITY_CRITICAL, f"guard: BRAKE, {cause}")
            self._unsafe_s = now
        if self._unsafe_s is None:
            return
        self._ask(now)
        if now - self._unsafe_s > CLEAR_S:
            self._unsafe_s = None
            self._send_text(d.MAV_SEVERITY_NOTICE, "guard: clear; choose a mode")

    def _cause(self, sectors: ObstacleSectors, age_s: float) -> str:
        """Why it has to brake now; empty where it has not."""
        if not self._moves():
            return ""
        if age_s > STALE_S:
            return "no distances"
        hull_m, latency_s = self._options.hull_m, max(age_s, 0.0) + DELAY_S
        spec = GuardSpec(latency_s=latency_s, lag_s=self._options.stop_s, braking_m_s2=BRAKING_M_S2)
        limit = Guard(spec, hull_m=hull_m).judge(sectors, self._odometry(sectors.t_ns))
        if limit.state == "free":
            return ""
        if math.isnan(limit.free_m):
            return f"no distance of radar {limit.sensor}" if limit.sensor else "no radar covers that direction"
        return f"{limit.sensor} {limit.free_m + hull_m + spec.margin_m:.1f} m"

    def _moves(self) -> bool:
        """Whether it moves, in a mode from which it is braked."""
        if self._copter is False:
            self._warn("guard=brake: no ArduCopter, so no brake")
        if not self._copter or self._mode not in MODES:
            return False
        known = self._now() - self._moved_s <= STALE_S and np.isfinite([*self._velocity, self._yaw]).all()
        if not known:
            self._warn("guard: no velocity comes, so no brake")
        return bool(known and math.hypot(*self._velocity) >= LEAST_M_S)

    def _odometry(self, t_ns: int) -> Trajectory:
        velocity: Floats = np.array([[*self._velocity, 0.0]])  # a landing is not an approach
        quat = rpy_quat(0.0, 0.0, self._yaw)[None]
        return Trajectory(np.array([t_ns]), np.zeros((1, 3)), quat, velocity, np.zeros((1, 3)))

    def _ask(self, now: float) -> None:
        """Ask for BRAKE until it is answered, or the pilot has chosen another mode."""
        d, there = self._link.dialect, self._link.autopilot
        if self._answer > d.MAV_RESULT_ACCEPTED:
            self._warn(f"guard: the autopilot refused BRAKE ({self._answer})")
        if there is None or self._answer >= 0 or self._mode != self._from or now - self._asked_s < ASK_S:
            return
        if self._asks == ASKS:
            self._warn("guard: no answer to BRAKE")
            return
        mode = d.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, BRAKE
        self._link.send(command_to(there, d.MAV_CMD_DO_SET_MODE, *mode, confirmation=self._asks))
        self._asks, self._asked_s = self._asks + 1, now
