"""Poses by radar for runs: odometry on simulated or recorded frames, and how far it is from the truth.

No recording of a radar that is read holds an inertial unit. It is therefore simulated, and an altimeter too, from the
true flight or from motion capture. The odometry gets nothing else of these.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from ullage.arrays import Bools
from ullage.data import Frames, Imu, Metric, Trajectory, even_times, strung
from ullage.errors import UllageWarning
from ullage.flight.imu import ImuSpec, simulate_height, simulate_imu
from ullage.processing.odometry.odometry import Odometry, OdometryResult

SMOOTH_HZ = 5.0
"""Motion capture counts below this frequency: differences of its noise would be no readings of a unit."""
REST_M_S = 0.05  # a body slower than this rests at the first frame
STILL_S = 2.0  # of simulated rest before it


class RadarPoses:
    """Estimate the poses of frames that come in pieces, and compare them with the truth.

    Args:
        truth: path of the body, of which inertial unit and altimeter are simulated.
        seed: of their noise.
        source: of the truth, in words.
        captured: the truth is motion capture, with its noise.
        flown_by: poses of a flight in closed loop, whose frames have them already.
    """

    def __init__(
        self, truth: Trajectory, *, seed: int, source: str, captured: bool = False,
        flown_by: OdometryResult | None = None,
    ) -> None:  # fmt: skip
        self._truth, self._seed, self._source, self._captured = truth, seed, source, captured
        self._result = flown_by

    @property
    def sentence(self) -> str:
        """Where the poses come from."""
        also = ", which is else the truth alone and what clock and range are calibrated by" if self._captured else ""
        return (
            "Poses come from the radars, with an inertial unit and an altimeter simulated from the "
            f"{self._source}{also}; they are often lost within half a minute."
        )

    def placed(self, pieces: Iterator[Mapping[str, Frames]]) -> Iterator[dict[str, Frames]]:
        """Give the frames at estimated poses, but for those whose pose is not to be trusted."""
        warnings.warn(self.sentence, UllageWarning, stacklevel=2)
        work: Odometry | None = None
        for piece in pieces:
            if work is None:
                work = self._begun(min(int(part.t_ns[0]) for part in piece.values()))
            work.add(piece)
            if out := work.placed(piece):
                yield out
        if work is not None:
            self._result = work.result()

    def _begun(self, first_ns: int) -> Odometry:
        path = smoothed(self._truth, SMOOTH_HZ) if self._captured else self._truth
        begin = int(np.searchsorted(path.t_ns, first_ns, side="right")) - 1
        path = path[max(begin, 0) :]
        rests = float(np.linalg.norm(path.rates[0][0])) < REST_M_S or not self._captured
        work = Odometry(start=path[:1])
        work.add_imu(simulate_imu(path, still_s=STILL_S if rests else 0.0, seed=self._seed))
        work.add_height(simulate_height(path, seed=self._seed))
        return work

    def report(self) -> tuple[list[str], list[Metric]]:
        """Return sentences and scores of the finished run; the clock of the sentences begins with the frames."""
        found = self._result
        if found is None:
            return [], []
        t_ns = found.trajectory.t_ns
        spans = [f"{(one.from_ns - t_ns[0]) * 1e-9:.1f} to {(one.to_ns - t_ns[0]) * 1e-9:.1f} s ({one.why})"
                 for one in found.lost]  # fmt: skip
        more = f" and {len(spans) - 3} more times" if len(spans) > 3 else ""
        lines = [self.sentence]
        if spans:
            lines.append(f"The poses are lost from {'; '.join(spans[:3])}{more}. Frames of that time are not mapped.")
        scores = {one.name: one for one in errors(found, self._truth)}
        rms, end, worst = (scores[name].value for name in ("pose_rms", "pose_end", "pose_sigmas"))
        share, last = (scores[name].value for name in ("pose_rms_of_path", "pose_end_of_path"))
        lines.append(
            f"Against the {self._source} they err by {rms:.2f} m (rms) and {end:.2f} m at the end, "
            f"{share:.0f} and {last:.0f} % of the way, and by at most {worst:.1f} sigma while not lost."
        )
        return lines, list(scores.values())


def errors(found: OdometryResult, truth: Trajectory) -> list[Metric]:
    """Return errors of estimated poses, over all times and while not lost."""
    path = found.trajectory
    error = path.position - truth.at(path.t_ns).position
    size, lost = np.linalg.norm(error, axis=1), is_lost(found)
    sigmas = (np.abs(error) / found.sigma[:, :3]).max(1)[~lost]
    moved = smoothed(truth.at(path.t_ns), SMOOTH_HZ).position if len(path) > 2 else path.position
    way_m = max(float(np.linalg.norm(np.diff(moved, axis=0), axis=1).sum()), 1e-9)
    rms, end = float(np.sqrt((size**2).mean())), float(size[-1])
    return [
        Metric("pose_rms", rms, "m"),
        Metric("pose_end", end, "m"),
        Metric("pose_rms_of_path", 100 * rms / way_m, "%"),
        Metric("pose_end_of_path", 100 * end / way_m, "%"),
        Metric("poses_lost", 100 * float(lost.mean()), "%"),
        Metric("pose_sigmas", float(sigmas.max(initial=0.0))),
    ]


def is_lost(found: OdometryResult) -> Bools:
    """Return which poses (n) are not to be trusted."""
    t_ns = found.trajectory.t_ns
    out = np.zeros(len(t_ns), bool)
    for one in found.lost:
        out |= (t_ns >= one.from_ns) & (t_ns <= one.to_ns)
    return out


def smoothed(path: Trajectory, hz: float) -> Trajectory:
    """Return a path without what is faster than a frequency, by a Gaussian filter (-3 dB at 0.83 of it)."""
    rate_hz = (len(path) - 1) / path.duration_s
    even = path.at(even_times(rate_hz, t0_ns=int(path.t_ns[0]), t1_ns=int(path.t_ns[-1])))
    flips = np.cumprod(np.append(1.0, np.where((even.quat_xyzw[1:] * even.quat_xyzw[:-1]).sum(1) < 0, -1.0, 1.0)))
    width = rate_hz / (2 * np.pi * hz)
    position, quat = (gaussian_filter1d(rows, width, axis=0, mode="nearest")
                      for rows in (even.position, even.quat_xyzw * flips[:, None]))  # fmt: skip
    return Trajectory(even.t_ns, position, quat / np.linalg.norm(quat, axis=1, keepdims=True))


class LivePoses:
    """Believed pose of each step of a flight in closed loop: odometry by its frames, as they come.

    Args:
        seed: of the simulated inertial unit and altimeter.
    """

    def __init__(self, seed: int) -> None:
        self._seed, self._spec = seed, ImuSpec()
        self._work: Odometry | None = None
        self._last: Trajectory | None = None
        self._first_ns = 0

    def __call__(self, truth: Trajectory, frames: Mapping[str, Frames]) -> Trajectory:
        """Take a step's true pose, of which readings are simulated, and its frames without poses."""
        if self._work is None or self._last is None:
            self._work, self._first_ns = Odometry(start=truth), int(truth.t_ns[0])
            after_ns = truth.t_ns + round(1e9 / self._spec.rate_hz)
            rest = strung([truth, replace(truth, t_ns=after_ns)])
            imu = simulate_imu(rest, self._spec, still_s=STILL_S, seed=self._seed)
            imu = imu[imu.t_ns <= truth.t_ns[0]]
        else:
            piece = strung([self._last, truth])
            imu = simulate_imu(piece, self._spec, still_s=0.0, seed=self._seed, begun_ns=self._first_ns)[1:]
        self._work.add_imu(self.read(imu))
        self._work.add_height(simulate_height(truth, seed=self._seed))
        self._last = truth
        self._work.add(frames)
        pose = self._work.pose
        if pose is None:  # no radar has given a frame yet
            return truth
        state = (pose.position, pose.quat_xyzw, pose.velocity, pose.angular_velocity)
        return Trajectory(truth.t_ns, *(row[None] for row in state))

    @property
    def lost(self) -> str:
        """Why the latest pose is not to be trusted; empty: it is."""
        pose = None if self._work is None else self._work.pose
        return "" if pose is None else pose.lost

    def read(self, imu: Imu) -> Imu:
        """Return what the unit gives; a faulty one gives something else."""
        return imu

    def result(self) -> OdometryResult | None:
        """All poses so far; None before the first."""
        return None if self._work is None else self._work.result()


def of_flight(poses: object, flown: Trajectory) -> RadarPoses | None:
    """Return what to report of a closed loop that flew by its radars; None: it flew by other poses."""
    found = poses.result() if isinstance(poses, LivePoses) else None
    return None if found is None else RadarPoses(flown, seed=0, source="true flight", flown_by=found)
