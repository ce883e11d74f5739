"""Distort the tracks of real recordings, and count the calibrations that are wrong without a word.

    python -m studies.tables.distorted_tracks FOLDER FOLDER [--yaw DEG,DEG] [--only NAME,...] [--log FILE]

Each folder is a recording that `ul.open` reads, with a track. A calibration is *refused* by an error, *said* where its
message or a warning names the kind of fault as suspected or unchecked, *right* where the offsets still are those of the
undistorted recording, and SILENT else. What moves no pose by 5 cm, as a scale across a straight rail, is no fault of
the offsets. Without --yaw the mount is unknown, so that every calibration says that axes and attitudes are unchecked;
with it they are checked.
"""

from __future__ import annotations

import argparse
import csv
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

import ullage as ul
from ullage.data import Calibration
from ullage.errors import UllageError

Moved = Callable[[ul.Trajectory], ul.Trajectory]
RIGHT_S, RIGHT_M, SIGMAS = 0.02, 0.05, 3.0
RATE, SCALE, AXES, ARM = (
    ("rate of the clock",),
    ("scale of the track",),
    ("axes", "the track may be", "cannot tell this track"),
    ("the antenna seems to be",),
)


class Distortion(NamedTuple):
    """A fault of a track, the words that say it, and how the clock offset moves with it."""

    moved: Moved
    named: tuple[str, ...] = ()  # none: only right offsets or a refusal will do
    offset_s: float | None = None  # None: no offset is right


def turned(matrix: np.ndarray) -> Moved:
    """Positions under a matrix, attitudes as they were."""
    return lambda track: ul.Trajectory(track.t_ns, track.position @ matrix.T, track.quat_xyzw)


def scaled(*factors: float) -> Moved:
    """Lengths times a factor, or one for each axis."""
    return turned(np.diag(np.broadcast_to(factors, 3)))


def lever(*offset_m: float) -> Moved:
    """The pose of another point of the body."""
    return lambda track: ul.Trajectory(
        track.t_ns, track.position + track.world_from_body[:, :3, :3] @ np.array(offset_m), track.quat_xyzw
    )


def attitude(*signs: float) -> Moved:
    """Quaternions with factors on x, y, z and w."""
    return lambda track: ul.Trajectory(
        track.t_ns, track.position, (track.quat_xyzw * signs + [0, 0, 0, 1e-9]) if any(signs) else level(track)
    )


def level(track: ul.Trajectory) -> np.ndarray:
    """Attitudes of a body that never turns."""
    return np.tile([0.0, 0, 0, 1], (len(track), 1))


def timed(factor: float, later_s: float = 0.0) -> Moved:
    """Times stretched about the first, and shifted."""
    return lambda track: ul.Trajectory(
        track.t_ns[0] + np.rint((track.t_ns - track.t_ns[0]) * factor + later_s * 1e9).astype(np.int64),
        track.position,
        track.quat_xyzw,
    )


def backwards(track: ul.Trajectory) -> ul.Trajectory:
    """The track flown from its end."""
    t_ns = track.t_ns[0] + (track.t_ns[-1] - track.t_ns)[::-1]
    return ul.Trajectory(t_ns, track.position[::-1], track.quat_xyzw[::-1])


def noisy(track: ul.Trajectory) -> ul.Trajectory:
    """Positions with 2 cm of noise, independent from pose to pose."""
    noise = np.random.default_rng(1).normal(0, 0.02, track.position.shape)
    return ul.Trajectory(track.t_ns, track.position + noise, track.quat_xyzw)


def rounded(track: ul.Trajectory) -> ul.Trajectory:
    """Positions in whole decimetres."""
    return ul.Trajectory(track.t_ns, track.position.round(1), track.quat_xyzw)


DISTORTIONS = {
    "none": Distortion(scaled(1.0), (), 0.0),
    **{f"scale {factor:g}": Distortion(scaled(factor), SCALE) for factor in (0.8, 0.9, 0.95, 1.05, 1.1, 1.25)},
    "millimetres for metres": Distortion(scaled(1e3), SCALE),
    "metres for millimetres": Distortion(scaled(1e-3), SCALE),
    "feet for metres": Distortion(scaled(1 / 0.3048), SCALE),
    "x times 1.1": Distortion(scaled(1.1, 1, 1), SCALE),
    "y times 1.1": Distortion(scaled(1, 1.1, 1), SCALE),
    "mirrored in x": Distortion(scaled(-1, 1, 1), AXES),
    "mirrored in y": Distortion(scaled(1, -1, 1), AXES),
    "mirrored in z": Distortion(scaled(1, 1, -1), AXES),
    "x and y swapped": Distortion(turned(np.eye(3)[[1, 0, 2]]), AXES),
    "x and z swapped": Distortion(turned(np.eye(3)[[2, 1, 0]]), AXES),
    "y and z swapped": Distortion(turned(np.eye(3)[[0, 2, 1]]), AXES),
    "axes cycled": Distortion(turned(np.eye(3)[[1, 2, 0]]), AXES),
    "positions turned by 90 deg": Distortion(turned(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])), AXES),
    "quaternions conjugated": Distortion(attitude(-1, -1, -1, 1), AXES),
    "attitude level": Distortion(attitude(0), AXES),
    "backwards in time": Distortion(backwards),
    "times 1 % long": Distortion(timed(1.01), RATE),
    "times 1 % short": Distortion(timed(0.99), RATE),
    "times 10 % long": Distortion(timed(1.1)),
    "times 2 s early": Distortion(timed(1.0, -2.0), (), -2.0),
    "track of the other recording": Distortion(scaled(1.0)),  # replaced in `main`
    "tracked point 0.3 m ahead": Distortion(lever(0.3, 0, 0), ARM, 0.0),
    "tracked point 0.3 m aside": Distortion(lever(0, 0.3, 0), ARM, 0.0),
    "noise of 2 cm": Distortion(noisy, (), 0.0),
    "whole decimetres": Distortion(rounded, (), 0.0),
}


def judged(frames: ul.Frames, fault: Distortion, whole: Calibration) -> tuple[str, str]:
    """Verdict on one distortion of a recording, and what was said.

    Args:
        frames: as recorded, with their track.
        fault: the distortion.
        whole: calibration of the undistorted recording.
    """
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            found = ul.calibrate(replace(frames, track=fault.moved(frames.track), poses=None)).calibration
        except UllageError as error:
            return "refused", str(error)
    offset_s = 0.0 if fault.offset_s is None and _harmless(frames.track, fault) else fault.offset_s
    message = "; ".join([found.message, *(str(one.message) for one in warned)])
    said = (
        f"clock {found.t_offset_s:+.3f} +- {found.t_sigma_s:.3f} s, range {found.range_offset_m:+.3f} +- "
        f"{found.range_sigma_m:.3f} m, scale {found.scale:.2f} +- {found.scale_sigma:.2f}; {message}"
    )
    if any(word in message for word in fault.named):
        return "said", said
    return ("right" if _right(found, whole, offset_s) else "SILENT"), said


def _harmless(track: ul.Trajectory, fault: Distortion) -> bool:
    """Whether it leaves times, attitudes and, but for a common offset, positions as they were."""
    moved = fault.moved(track)
    if len(moved) != len(track) or (moved.t_ns != track.t_ns).any() or (moved.quat_xyzw != track.quat_xyzw).any():
        return False
    away = moved.position - track.position
    return bool(np.linalg.norm(away - away.mean(0), axis=1).max() < RIGHT_M)


def _right(found: Calibration, whole: Calibration, offset_s: float | None) -> bool:
    """Whether the offsets agree with the undistorted recording's, within bounds or their own doubt."""
    if offset_s is None:
        return False
    clock_s, range_m = found.t_offset_s - whole.t_offset_s - offset_s, found.range_offset_m - whole.range_offset_m
    return abs(clock_s) < max(RIGHT_S, SIGMAS * found.t_sigma_s) and abs(range_m) < max(
        RIGHT_M, SIGMAS * found.range_sigma_m
    )


def table(rows: list[tuple[str, str, str, str]]) -> str:
    """Verdicts by distortion and recording."""
    places = sorted({row[0] for row in rows})
    verdict = {(place, name): said for place, name, said, _ in rows}
    lines = [f"| distortion | {' | '.join(places)} |", "|---" * (1 + len(places)) + "|"]
    names = dict.fromkeys(row[1] for row in rows)
    lines += [f"| {name} | {' | '.join(verdict.get((place, name), '') for place in places)} |" for name in names]
    silent = sum(row[2] == "SILENT" for row in rows)
    return "\n".join([*lines, f"wrong without a word: {silent} of {sum(row[1] != 'none' for row in rows)}"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--yaw", help="of the antenna on each body [deg], with commas; default: unknown")
    parser.add_argument("--only", help="names of distortions, with commas")
    parser.add_argument("--log", type=Path, help="CSV file to add rows to")
    given = parser.parse_args()
    mounts = [{"mount": ul.MountSpec(yaw_deg=float(yaw))} for yaw in given.yaw.split(",")] if given.yaw else [{}, {}]
    recordings = {
        folder.name: ul.open(folder, **mount).frames() for folder, mount in zip(given.folders, mounts, strict=False)
    }
    rows: list[tuple[str, str, str, str]] = []
    for place, frames in recordings.items():
        other = next((one.track for name, one in recordings.items() if name != place), None)
        whole = ul.calibrate(frames).calibration
        for name in DISTORTIONS if given.only is None else given.only.split(","):
            fault, begin = DISTORTIONS[name], time.monotonic()
            if name.startswith("track of the other"):
                if other is None:
                    continue
                fault = Distortion(lambda _, other=other: other)
            rows.append((place, name, *judged(frames, fault, whole)))
            took = time.monotonic() - begin
            print(f"{place:10s} {name:28s} {rows[-1][2]:8s} {took:4.0f} s  {rows[-1][3]}", flush=True)
            if given.log is not None:
                with given.log.open("a", newline="") as file:
                    csv.writer(file).writerow(rows[-1])
    print(table(rows))


if __name__ == "__main__":
    main()
