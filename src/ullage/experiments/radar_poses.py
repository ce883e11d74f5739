"""Poses by radar for runs: odometry on simulated or recorded frames, and how far it is from the truth.

The altimeter is simulated from the true flight or from the recorded track, and so is the inertial unit where none was
recorded. The odometry gets nothing else of these but the first pose.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d

from ullage.arrays import Bools, Longs
from ullage.data import Frames, Imu, Metric, Trajectory, even_times, strung
from ullage.errors import InputError, UllageWarning
from ullage.flight.imu import simulate_height, simulate_imu
from ullage.ports.intake import warn
from ullage.processing.odometry.odometry import Odometry, OdometryResult
from ullage.processing.odometry.solution import OdometrySpec
from ullage.specs import ImuSpec

SMOOTH_HZ = 5.0
"""Motion capture counts below this frequency: differences of its noise would be no readings of a unit."""
REST_M_S, REST_RAD_S = 0.05, 0.05  # a body slower than both rests
STILL_S = 2.0  # of rest before the first frame, at most


class RadarPoses:
    """Estimate the poses of frames that come in pieces, and compare them with the truth.

    Args:
        truth: path of the body, of which the altimeter is simulated, and the inertial unit if none was recorded.
        seed: of their noise.
        source: of the truth, in words.
        captured: the truth is motion capture, with its noise.
        flown_by: poses of a flight in closed loop, whose frames have them already.
        unit: data sheet of the inertial unit.
        imu: its readings and their file; None: they are simulated.
    """

    def __init__(
        self, truth: Trajectory, *, seed: int, source: str, captured: bool = False,
        flown_by: OdometryResult | None = None, unit: ImuSpec | None = None, imu: tuple[Imu, str] | None = None,
    ) -> None:  # fmt: skip
        self._truth, self._seed, self._source, self._captured = truth, seed, source, captured
        self._result, self._unit, self._imu = flown_by, unit or ImuSpec(), imu
        self._start_ns = 0  # of the odometry

    @property
    def sentence(self) -> str:
        """Where the poses come from."""
        units, also = "an inertial unit and an altimeter", ""
        if self._imu is not None:
            units = f"the inertial unit recorded in {Path(self._imu[1]).name}, and an altimeter"
            sheet = "the data sheet of a BMI088, as flight.imu is not set" if self._unit == ImuSpec() else "flight.imu"
            also = f" Its axes are taken for the body's, its clock for the track's, its noise and offsets from {sheet}."
        if self._captured:
            also += " Otherwise the track only calibrates clock and range, and serves as truth."
        return (
            f"Poses come from the radars, with {units} simulated from the {self._source}; "
            f"they are often lost within half a minute.{also}"
        )

    def placed(self, pieces: Iterator[Mapping[str, Frames]]) -> Iterator[dict[str, Frames]]:
        """Give the frames at estimated poses, but for those whose pose is not to be trusted."""
        warnings.warn(self.sentence, UllageWarning, stacklevel=2)
        work: Odometry | None = None
        for piece in pieces:
            if work is None:
                work = self._begun(min(int(part.t_ns[0]) for part in piece.values()))
            later = {name: part.t_ns >= self._start_ns for name, part in piece.items()}
            work.add(kept := {name: part[later[name]] for name, part in piece.items() if later[name].any()})
            if out := work.placed(kept):
                yield out
        if work is not None:
            self._result = work.result()

    def _begun(self, first_ns: int) -> Odometry:
        path = smoothed(self._truth, SMOOTH_HZ) if self._captured else self._truth
        speed, turning = (np.linalg.norm(rate, axis=1) for rate in path.rates)
        moves = ((speed >= REST_M_S) | (turning >= REST_RAD_S)) & self._captured
        self._start_ns, imu = first_ns, None
        if self._imu is not None:
            self._start_ns, imu = _rested(self._imu[0], path.t_ns, moves, first_ns)
            if rest_ns := self._start_ns - first_ns:
                warn(f"frames of the first {_seconds(rest_ns)} s, a rest that shows the unit's offsets, are left out")
        begin = max(int(np.searchsorted(path.t_ns, self._start_ns, side="right")) - 1, 0)
        still_s, path = 0.0 if moves[begin] else STILL_S, path[begin:]
        work = Odometry(start=path[:1], spec=OdometrySpec(imu=self._unit))
        work.add_imu(imu or simulate_imu(path, self._unit, still_s=still_s, seed=self._seed))
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


def _rested(imu: Imu, t_ns: Longs, moves: Bools, first_ns: int) -> tuple[int, Imu]:
    """Return when to begin [ns], and the readings from the rest before that on.

    The odometry takes what is read before its first frame for rest, and finds the offsets of the unit by it. Of a
    recording that begins at rest, frames count from `STILL_S` on, or from when the body moves.

    Args:
        imu: readings.
        t_ns: times of the track (n) [ns].
        moves: at which of them the body moves (n).
        first_ns: time of the first frame [ns].
    """
    still_ns, moving = round(STILL_S * 1e9), t_ns[moves]
    since_ns = max([int(imu.t_ns[0]), *moving[moving <= first_ns][-1:].tolist()])
    row, until_ns = max(int(np.searchsorted(t_ns, first_ns, side="right")) - 1, 0), moving[moving > first_ns][:1]
    start_ns = first_ns if moves[row] else max(first_ns, min([since_ns + still_ns, *until_ns.tolist()]))
    last = int(np.searchsorted(imu.t_ns, start_ns, side="right")) - 1
    return start_ns, imu[min(int(np.searchsorted(imu.t_ns, max(since_ns, start_ns - still_ns))), last) :]


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


def covered(frames: Mapping[str, Frames], imu: Imu, where: str) -> dict[str, Frames]:
    """Return the frames in the time of recorded readings; the others are left out, with a warning.

    Args:
        frames: of each radar.
        imu: readings by the clock of the frames.
        where: their file.

    Raises:
        InputError: no frame is in their time, or readings are missing for longer than from one frame to the next.
    """
    inside = {name: (part.t_ns >= imu.t_ns[0]) & (part.t_ns <= imu.t_ns[-1]) for name, part in frames.items()}
    out = {name: part[inside[name]] for name, part in frames.items() if inside[name].any()}
    times = np.unique(np.concatenate([part.t_ns for part in (out or frames).values()]))
    if not out:
        what = f"readings of the inertial unit from {_seconds(*imu.t_ns[[0, -1]])} s"
        raise InputError(what, where=where, allowed=f"the frames' time, {_seconds(*times[[0, -1]])} s")
    if left := sum(int((~rows).sum()) for rows in inside.values()):
        warn(f"{where}: {left} of {sum(map(len, frames.values()))} frames lie outside its readings; left out")
    steps = np.diff(imu.t_ns)
    between = [np.median(np.diff(part.t_ns)) for part in out.values() if len(part) > 1]
    most = max(*between, 2 * np.median(steps), 0)
    bad = (steps > most) & (imu.t_ns[1:] > times[0]) & (imu.t_ns[:-1] < times[-1])
    if bad.any():
        k = int(np.argmax(bad))
        raise InputError(f"no readings for {_seconds(steps[k])} s from {_seconds(imu.t_ns[k])} s on", where=where,
                         allowed=f"{_seconds(most)} s, the time from one frame to the next")  # fmt: skip
    return out


def _seconds(*times_ns: float) -> str:
    return " to ".join(f"{t_ns * 1e-9:.3f}" for t_ns in times_ns)


class LivePoses:
    """Believed pose of each step of a flight in closed loop: odometry by its frames, as they come.

    Args:
        seed: of the simulated inertial unit and altimeter.
        unit: data sheet of the inertial unit.
    """

    def __init__(self, seed: int, unit: ImuSpec | None = None) -> None:
        self._seed, self._spec = seed, unit or ImuSpec()
        self._work: Odometry | None = None
        self._last: Trajectory | None = None
        self._first_ns = 0

    def __call__(self, truth: Trajectory, frames: Mapping[str, Frames]) -> Trajectory:
        """Take a step's true pose, of which readings are simulated, and its frames without poses."""
        if self._work is None or self._last is None:
            self._work = Odometry(start=truth, spec=OdometrySpec(imu=self._spec))
            self._first_ns = int(truth.t_ns[0])
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
