"""Radar-inertial odometry: poses from radars and inertial unit, and bounds of their errors by solution separation.

A surface that is not what its jet says can fit its own echoes well, for its direction and curvature adapt: innovations
do not show it. So every frame updates one solution by all radars, and for each radar one without it (`solution`). The
published sigmas cover what each of these allows [BlanchEtAl2015].
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping
from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np

from ullage.arrays import Floats
from ullage.data import Frames, Height, Imu, Recording, Trajectory, sensors_of
from ullage.errors import InputError
from ullage.geometry import quat_rpy
from ullage.processing.health import HealthMonitor
from ullage.processing.odometry.echo_list import echo_lists
from ullage.processing.odometry.solution import OdometrySpec, PoseEstimate, Reading, Solution
from ullage.processing.own_echo import OwnEchoFilter

_BOUND_SIGMAS = 3.0  # k: the error is to stay within so many sigma


@dataclass(frozen=True, slots=True)
class Lost:
    """A time in which the poses are not to be trusted."""

    from_ns: int
    to_ns: int
    why: str


@dataclass(frozen=True, slots=True, eq=False)
class OdometryResult:
    """Poses along a flight, how sure they are, and when they are not to be trusted."""

    trajectory: Trajectory
    sigma: Floats  # (n, 4) of x, y, z [m] and yaw [rad]
    covariance: Floats  # (n, 4, 4) of the same
    consistency: Floats  # (n) mean square of the innovations over their sigmas; NaN where nothing was seen
    lost: tuple[Lost, ...]


class Odometry:
    """Poses of the body as frames and inertial readings come, with sigmas that hold if any one radar misleads.

    Args:
        start: its first pose counts; None: the origin, heading along x.
        spec: settings.
    """

    def __init__(self, *, start: Trajectory | None = None, spec: OdometrySpec | None = None) -> None:
        self.spec = spec or OdometrySpec()
        self._all = Solution(start, self.spec)
        self._without: dict[str, Solution] = {}  # the radar left out
        self._mounts: dict[str, Floats] = {}
        self._readings: deque[Reading] = deque()
        self._heights: deque[tuple[int, float, float]] = deque()
        self._waiting: list[tuple[int, str, Frames]] = []
        self._own, self._health = OwnEchoFilter(most=48, growth=1.5), HealthMonitor()
        self._now_ns = 0
        self._poses: list[PoseEstimate] = []

    @property
    def pose(self) -> PoseEstimate | None:
        """The newest pose; None before the first frame."""
        return self._poses[-1] if self._poses else None

    def add_imu(self, imu: Imu) -> None:
        """Take inertial readings."""
        self._readings.extend(zip(imu.t_ns.tolist(), imu.angular_velocity, imu.specific_force, strict=True))

    def add_height(self, height: Height) -> None:
        """Take heights."""
        self._heights.extend(
            (int(t), float(z), height.sigma_m) for t, z in zip(height.t_ns, height.height_m, strict=True)
        )

    def add(self, frames: Mapping[str, Frames]) -> list[PoseEstimate]:
        """Take frames of one or more radars; the poses at those times that the inertial readings have reached.

        The poses and the truth of the frames are not read.
        """
        bare = {name: replace(part, poses=None, truth=None, track=None) for name, part in frames.items()}
        sound = self._health.judge(bare)
        for name, part in self._own.clean(bare).items():
            self._mounts.setdefault(name, part.spec.mount.body_from_sensor())
            self._waiting += [(int(t), name, part[i : i + 1]) for i, t in enumerate(part.t_ns) if sound[name][i]]
        self._waiting.sort(key=lambda one: one[:2])
        return list(self._due())

    def placed(self, frames: Mapping[str, Frames]) -> dict[str, Frames]:
        """Frames that were added, at the estimated poses; those without a pose that is to be trusted are left out."""
        if not self._poses:
            return {}
        path, trusted = self.result().trajectory, np.array([not one.lost for one in self._poses])
        out = {}
        for name, part in frames.items():
            row = np.minimum(np.searchsorted(path.t_ns, part.t_ns), len(path) - 1)
            known = (path.t_ns[row] == part.t_ns) & trusted[row]
            if known.any():
                out[name] = replace(part[known], poses=path[row[known]].mounted(self._mounts[name]), track=None)
        return out

    def _due(self) -> Iterable[PoseEstimate]:
        newest = self._readings[-1][0] if self._readings else self._now_ns
        while self._waiting and self._waiting[0][0] <= newest:
            t_ns = self._waiting[0][0]
            count = sum(one[0] == t_ns for one in self._waiting)
            parts = {name: part for _, name, part in self._waiting[:count]}
            del self._waiting[:count]
            self._poses.append(self._step(t_ns, parts))
            self._now_ns = t_ns
            yield self._poses[-1]

    def _step(self, t_ns: int, parts: Mapping[str, Frames]) -> PoseEstimate:
        """Step all solutions, and bound the error of the one by all radars."""
        for name in parts.keys() - self._without.keys():
            self._without[name] = deepcopy(self._all)  # which has received nothing of it so far
        readings, heights = list[Reading](), list[tuple[float, float]]()
        while self._readings and self._readings[0][0] <= t_ns:
            readings.append(self._readings.popleft())
        if self._readings:
            readings.append(self._readings[0])  # spans this time
        while self._heights and self._heights[0][0] <= t_ns:
            heights.append(self._heights.popleft()[1:])
        received = {name: (part, *echo_lists(part)[0]) for name, part in parts.items()}
        whole = self._all.step(t_ns, readings, heights, received)
        rest = [
            one.step(t_ns, readings, heights, {other: it for other, it in received.items() if other != name})
            for name, one in self._without.items()
        ]
        return bounded(whole, dict(zip(self._without, rest, strict=True)), self.spec.lost_m)

    def result(self) -> OdometryResult:
        """All poses so far.

        Raises:
            InputError: there are none.
        """
        poses = self._poses
        if not poses:
            raise InputError("no frame at or after the first inertial reading", where="odometry")
        t_ns = np.array([one.t_ns for one in poses])

        def column(name: str) -> Floats:
            return np.array([getattr(one, name) for one in poses], np.float64)

        path = Trajectory(t_ns, column("position"), column("quat_xyzw"), column("velocity"), column("angular_velocity"))
        return OdometryResult(path, column("sigma"), column("covariance"), column("consistency"), _spans(poses))


def odometry(
    frames: Recording,
    imu: Imu,
    *,
    start: Trajectory | None = None,
    height: Height | None = None,
    spec: OdometrySpec | None = None,
) -> OdometryResult:
    """Estimate the poses of the body from its radars and inertial unit.

    Neither poses nor truth of the frames are read.

    Args:
        frames: of one radar or several on one body.
        imu: readings; the body rests during those before the first frame.
        start: its first pose counts; None: the origin, heading along x.
        height: readings of an altimeter; None: only what radars and inertial unit show.
        spec: settings.

    Raises:
        InputError: there are no readings or no frames in their time.
    """
    work = Odometry(start=start, spec=spec)
    work.add_imu(imu)
    if height is not None:
        work.add_height(height)
    work.add({part.sensor: part for part in sensors_of(frames)})
    return work.result()


def bounded(whole: PoseEstimate, without: Mapping[str, PoseEstimate], lost_m: float) -> PoseEstimate:
    """Bound the error of a pose by solution separation [BlanchEtAl2015].

    If one radar misleads, the solution without it errs by its own sigma only. So the solution by all errs by no more
    than k sigma of that one and the separation of the two. The bound is the largest over all radars; divided by k it
    replaces sigma. Correlations stay those of the solution by all.

    Args:
        whole: by all radars.
        without: by all but the named one.
        lost_m: one sigma of the position beyond which it is lost [m].
    """
    sigma, why = whole.sigma, ""
    for name, other in without.items():
        apart = np.abs(other.position - whole.position)
        turned = abs(math.remainder(_heading(other) - _heading(whole), math.tau))
        bound = other.sigma + np.append(apart, turned) / _BOUND_SIGMAS
        if np.max(bound[:3]) > max(lost_m, float(np.max(sigma[:3]))):
            why = f"position known to {np.max(bound[:3]):.2g} m only without {name}"
        sigma = np.maximum(sigma, bound)
    scale = sigma / whole.sigma
    covariance = whole.covariance * np.outer(scale, scale)
    if not why and (worst := float(np.max(sigma[:3]))) > lost_m:
        why = f"position known to {worst:.2g} m only"
    return replace(whole, sigma=sigma, covariance=covariance, lost=why)


def _heading(pose: PoseEstimate) -> float:
    return float(quat_rpy(pose.quat_xyzw)[2])


def _spans(poses: list[PoseEstimate]) -> tuple[Lost, ...]:
    out, first = list[Lost](), 0
    for k in range(1, len(poses) + 1):
        if k == len(poses) or bool(poses[k].lost) != bool(poses[first].lost):
            if poses[first].lost:
                out.append(Lost(poses[first].t_ns, poses[k - 1].t_ns, poses[first].lost))
            first = k
    return tuple(out)
