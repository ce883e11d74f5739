"""Motion that grows while a flight goes on: straight lines and great arcs between the poses received."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ullage.arrays import Floats, Longs
from ullage.data import Trajectory
from ullage.geometry import apply, rotations

Poses = tuple[Longs, Floats, Floats]
"""Longs (n) [ns], positions (n, 3) [m] and attitudes (n, 4) xyzw."""


class LiveMotion:
    """Poses of an object as they come; it is at rest before the first known pose and after the last.

    Args:
        position: until the first pose (3), world ENU [m].
        quat_xyzw: world_from_object (4).
    """

    def __init__(self, position: ArrayLike, quat_xyzw: ArrayLike) -> None:
        self._rest = (np.asarray(position, float), np.asarray(quat_xyzw, float))
        self._times: list[int] = []
        self._poses = [self._rest][:0]
        self._seen_ns: int | None = None  # when it was last seen; later poses are held ones
        self._known: Poses | None = None

    @property
    def t_ns(self) -> Longs:
        """Longs of the poses that are known (n) [ns]."""
        return self._all()[0]

    def see(self, t_ns: int, position: ArrayLike, quat_xyzw: ArrayLike) -> None:
        """Take its next pose; one that is no later than the last is passed by.

        Args:
            t_ns: when [ns].
            position: where (3), world ENU [m].
            quat_xyzw: world_from_object (4).
        """
        if self._seen_ns is not None and t_ns <= self._seen_ns:
            return
        while self._times and self._times[-1] >= t_ns:  # held there, since this came late
            self._times.pop()
            self._poses.pop()
        self._seen_ns = t_ns
        self._add(t_ns, (np.asarray(position, float), np.asarray(quat_xyzw, float)))

    def stand_until(self, t_ns: int) -> None:
        """Declare that it has not moved since its last pose."""
        if not self._times or t_ns > self._times[-1]:
            self._add(t_ns, self._poses[-1] if self._poses else self._rest)

    def forget(self, t_ns: int) -> None:
        """Drop poses before a time [ns] except the last two, so that results keep their bits."""
        first = max(int(np.searchsorted(self._times, t_ns)) - 2, 0)
        if first:
            del self._times[:first], self._poses[:first]
            self._known = None

    def at(self, t_ns: ArrayLike) -> Trajectory:
        """Return its poses at some times (m), strictly rising [ns]."""
        return between(self._all(), np.atleast_1d(np.asarray(t_ns, np.int64)))

    def _add(self, t_ns: int, pose: tuple[Floats, Floats]) -> None:
        self._times.append(t_ns)
        self._poses.append(pose)
        self._known = None

    def _all(self) -> Poses:
        if self._known is None:
            poses = self._poses or [self._rest]
            times = np.array(self._times or [0], np.int64)
            self._known = (times, np.stack([p for p, _ in poses]), np.stack([q for _, q in poses]))
        return self._known


def between(poses: Poses, t_ns: NDArray[np.int64]) -> Trajectory:
    """Interpolate poses at other times: straight lines in position, great arcs in attitude."""
    known, position, quat = poses
    if len(known) == 1:
        still = np.zeros((len(t_ns), 3))
        return Trajectory(t_ns, np.repeat(position, len(t_ns), 0), np.repeat(quat, len(t_ns), 0), still, still)
    row = np.clip(np.searchsorted(known, t_ns, side="right") - 1, 0, len(known) - 2)
    step_s = (known[row + 1] - known[row]) * 1e-9
    share = np.clip((t_ns - known[row]) * 1e-9 / step_s, 0.0, 1.0)[:, None]
    turn = (rotations().from_quat(quat[row]).inv() * rotations().from_quat(quat[row + 1])).as_rotvec()
    attitude: Any = rotations().from_quat(quat[row]) * rotations().from_rotvec(share * turn)
    moved = position[row + 1] - position[row]
    return Trajectory(
        t_ns, position[row] + share * moved, attitude.as_quat(), moved / step_s[:, None], turn / step_s[:, None]
    )


def carried(motion: Any, pose: Floats) -> Any:
    """Return a motion after a rigid transform (4, 4) of its world."""
    if isinstance(motion, Trajectory):
        return _carried_path(motion, pose)
    if isinstance(motion, CarriedMotion):
        return CarriedMotion(motion.motion, pose @ motion.pose)
    return CarriedMotion(motion, pose)


@dataclass(frozen=True, slots=True, eq=False)
class CarriedMotion:
    """A motion that still grows, seen through a rigid transform."""

    motion: Any
    pose: Floats  # (4, 4) world_from_old_world

    @property
    def t_ns(self) -> Longs:
        """Longs that it is known at (n) [ns]."""
        return np.asarray(self.motion.t_ns)

    def at(self, t_ns: ArrayLike) -> Trajectory:
        """world_from_object at times (m) [ns]."""
        return _carried_path(self.motion.at(t_ns), self.pose)


def _carried_path(path: Trajectory, pose: Floats) -> Trajectory:
    """Apply a rigid transform to a path; the angular velocity is that of the body and stays."""
    velocity, spin = path.rates
    turned: Any = rotations().from_matrix(pose[:3, :3]) * rotations().from_quat(path.quat_xyzw)
    return Trajectory(path.t_ns, apply(pose, path.position), turned.as_quat(), velocity @ pose[:3, :3].T, spin)
