"""Poses of the body from an autopilot's messages: NED and FRD on the wire, ENU and FLU here."""

from __future__ import annotations

from collections import deque
from typing import Any, Literal

import numpy as np

from ullage.arrays import Floats
from ullage.errors import InputError
from ullage.geometry import apply, matrix_quat, quat_matrix, rpy_quat, transform
from ullage.ports.intake import Counters, checked_pose
from ullage.ports.ned import enu_position, enu_quat
from ullage.ports.pose_events import ModelPose
from ullage.world.moving import between

FRAMES = {1: "MAV_FRAME_LOCAL_NED", 20: "MAV_FRAME_LOCAL_FRD"}
"""Frames of ODOMETRY that are used: z points down, and the pose is that of a forward-right-down body."""
ODOMETRY_S = 1.0
"""ODOMETRY that came so lately is preferred to LOCAL_POSITION_NED [s of the autopilot's clock]."""
APART_NS = 500_000_000
"""Attitudes farther apart are not interpolated [ns]."""
MOST_WAITING = 256


class PoseBuilder:
    """Makes poses of ODOMETRY, or of LOCAL_POSITION_NED with the attitude at its time.

    An attitude between two that came is on the great arc between them.

    Args:
        counters: count what cannot be used.
        wanted: which messages; auto: ODOMETRY where it comes.
        world_from_local: (4, 4) of the autopilot's local origin, ENU.
    """

    def __init__(
        self, counters: Counters, wanted: Literal["auto", "odometry", "local"], world_from_local: Floats
    ) -> None:
        self._counters, self._wanted, self._origin = counters, wanted, world_from_local
        self._attitudes: deque[tuple[int, Floats]] = deque(maxlen=MOST_WAITING)
        self._waiting: deque[tuple[int, Floats]] = deque()  # positions that wait for a later attitude
        self._odometry_ns: int | None = None
        self._quaternions = False  # ATTITUDE_QUATERNION comes, so ATTITUDE is not needed
        self._resets: int | None = None
        self.reset = False
        """Whether the autopilot's estimator was reset since the caller cleared this."""

    def take(self, message: Any) -> list[ModelPose]:
        """The poses that are known by this message, by the autopilot's clock."""
        kind = message.get_type()
        if kind == "ODOMETRY":
            return self._odometry(message)
        t_ns = message.time_boot_ms * 1_000_000
        if kind == "LOCAL_POSITION_NED":
            self._position(t_ns, message)
        elif kind == "ATTITUDE_QUATERNION":
            self._quaternions = True
            self._attitude(kind, t_ns, [message.q2, message.q3, message.q4, message.q1])
        elif not self._quaternions:
            angles = [message.roll, message.pitch, message.yaw]
            turn = rpy_quat(*angles) if np.isfinite(angles).all() else np.full(4, np.nan)
            self._attitude(kind, t_ns, turn)
        return self._matched()

    def _odometry(self, message: Any) -> list[ModelPose]:
        if self._wanted == "local":
            return []
        w, *xyz = message.q
        ned = [message.x, message.y, message.z]
        if message.frame_id not in FRAMES:
            allowed = " or ".join(FRAMES.values())
            self._counters.drop("ODOMETRY", "bad", f"frame {message.frame_id} is not {allowed}")
            return []
        pose = checked_pose(ned, [*xyz, w])
        if isinstance(pose, str):
            self._counters.drop("ODOMETRY", "bad", pose)
            return []
        if self._resets not in (None, message.reset_counter):
            self.reset = True
        self._resets = message.reset_counter
        self._odometry_ns = message.time_usec * 1000
        return [self._sighting(self._odometry_ns, *pose)]

    def _position(self, t_ns: int, message: Any) -> None:
        lately = self._odometry_ns is not None and abs(t_ns - self._odometry_ns) < ODOMETRY_S * 1e9
        if self._wanted == "odometry" or (self._wanted == "auto" and lately):
            return
        ned = np.array([message.x, message.y, message.z])
        if not np.isfinite(ned).all():
            self._counters.drop("LOCAL_POSITION_NED", "bad", "position is not finite")
            return
        self._waiting.append((t_ns, ned))
        if len(self._waiting) > MOST_WAITING:
            self._waiting.popleft()
            self._counters.drop("LOCAL_POSITION_NED", "no pose", "no attitude comes")

    def _attitude(self, kind: str, t_ns: int, quat: Any) -> None:
        pose = checked_pose(np.zeros(3), quat)
        if isinstance(pose, str):
            self._counters.drop(kind, "bad", pose)
            return
        if self._attitudes and t_ns < self._attitudes[-1][0]:  # the autopilot's clock went back: it was started again
            self._attitudes.clear()
            self._waiting = deque(one for one in self._waiting if one[0] <= t_ns)
        if not self._attitudes or t_ns > self._attitudes[-1][0]:
            self._attitudes.append((t_ns, pose[1]))

    def _matched(self) -> list[ModelPose]:
        """Positions whose time lies between two attitudes."""
        out = []
        while self._waiting and self._attitudes and self._waiting[0][0] <= self._attitudes[-1][0]:
            t_ns, ned = self._waiting.popleft()
            turn = self._attitude_at(t_ns)
            if turn is None:
                self._counters.drop("LOCAL_POSITION_NED", "no pose", "no attitude near its time")
            else:
                out.append(self._sighting(t_ns, ned, turn))
        return out

    def _attitude_at(self, t_ns: int) -> Floats | None:
        after = next(k for k, (at, _) in enumerate(self._attitudes) if at >= t_ns)
        at, quat = self._attitudes[after]
        if at == t_ns:
            return quat
        if not after or at - self._attitudes[after - 1][0] > APART_NS:
            return None
        before = self._attitudes[after - 1]
        known = (np.array([before[0], at]), np.zeros((2, 3)), np.array([before[1], quat]))
        return np.asarray(between(known, np.array([t_ns], np.int64)).quat_xyzw[0])

    def _sighting(self, t_ns: int, ned: Floats, ned_from_frd: Floats) -> ModelPose:
        at = apply(self._origin, enu_position(ned)[None])[0]
        turn = matrix_quat(self._origin[:3, :3] @ quat_matrix(enu_quat(ned_from_frd)))
        x, y, z = at.tolist()
        a, b, c, d = turn.tolist()
        return ModelPose(t_ns, (x, y, z), (a, b, c, d))


def origin_of(text: str) -> Floats:
    """The transform (4, 4) of `x,y,z` [m] or `x,y,z,yaw` [m, deg].

    Raises:
        InputError: it is neither.
    """
    try:
        numbers = [float(part) for part in text.split(",")] if text else [0.0, 0.0, 0.0]
    except ValueError:
        numbers = []
    if len(numbers) not in (3, 4) or not np.isfinite(numbers).all():
        raise InputError(f"origin is {text!r}", where="mavlink", allowed="X,Y,Z or X,Y,Z,YAW in metres and degrees")
    yaw_deg = numbers[3] if len(numbers) == 4 else 0.0
    return transform(numbers[:3], (0.0, 0.0, np.radians(yaw_deg)))
