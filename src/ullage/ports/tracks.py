"""Tracks of a radar from text files: Motive exports, TUM and EuRoC trajectories, and CSV with named columns.

All but Motive's are world_from_radar with z up: a row is one pose. TUM: time [s], x, y, z [m], quaternion x, y, z, w,
between blanks [TUM2012]. EuRoC: a header with `#timestamp`, time [ns], x, y, z, quaternion w, x, y, z [EuRoC2016].
Named columns: `t_s` or `t_ns`, `x_m`, `y_m`, `z_m` and, where the attitude is known,
`qx`, `qy`, `qz`, `qw`, in any order. Poses that cannot be are left out and counted, as live ports do.
"""

from __future__ import annotations

import csv
from decimal import Decimal
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ullage.arrays import Floats, Longs
from ullage.checks import is_in_nanoseconds
from ullage.data import Trajectory
from ullage.errors import InputError
from ullage.ports.intake import Counters, checked_pose, warn
from ullage.ports.motive import read_tracks
from ullage.ports.protocol import mend_clock
from ullage.untrusted import reading

KINDS = "a Motive export, a TUM or EuRoC trajectory, or a CSV with columns t_s, x_m, y_m, z_m, qx, qy, qz, qw"
PLACE, TURN = ("x_m", "y_m", "z_m"), ("qx", "qy", "qz", "qw")
TUM = ("t_s", *PLACE, *TURN)
EUROC = ("t_ns", *PLACE, "qw", "qx", "qy", "qz")
MOST_M, MOST_S = 1e6, 9e9


def read_bodies(path: str | Path) -> dict[str, Trajectory]:
    """Track of each body by name; files of one body call it "radar". The kind is recognised by its first lines.

    Raises:
        InputError: the file is of no known kind, holds no pose, or a line of it cannot be read.
    """
    path = Path(path)
    with reading(path):
        lines = path.read_text("utf-8-sig", errors="replace").splitlines()
    if not any(line.strip() for line in lines):
        raise InputError("the file is empty", where=path, allowed=KINDS)
    if any(line.startswith("Frame,") for line in lines[:50]) or lines[0].startswith("Format Version"):
        return read_tracks(path)
    first = next(line for line in lines if line.strip())
    named = [name.strip() for name in first.split(",")]
    if first.startswith("#timestamp"):
        return {"radar": _track(_rows(lines, ",", EUROC, path), EUROC, path)}
    if "x_m" in named:
        return {
            "radar": _track(
                _rows(lines[lines.index(first) + 1 :], ",", named, path, lines.index(first) + 2), named, path
            )
        }
    numbers = next((line for line in lines if line.strip() and not line.startswith("#")), "")
    if len(numbers.split()) == len(TUM):
        return {"radar": _track(_rows(lines, " ", TUM, path), TUM, path)}
    raise InputError("of no known kind of track", where=path, line=1, allowed=KINDS)


def _rows(
    lines: list[str], mark: str, names: tuple[str, ...] | list[str], path: Path, start: int = 1
) -> list[list[str]]:
    """The cells of every pose; comments and empty lines are left out."""
    out = []
    blanks = map(str.split, lines) if mark == " " else csv.reader(lines, delimiter=mark, skipinitialspace=True)
    for number, kept in enumerate(blanks, start):
        if not any(cell.strip() for cell in kept) or kept[0].startswith("#"):
            continue
        if len(kept) < len(names):
            raise InputError(f"{len(kept)} cells", where=path, line=number, allowed=", ".join(names))
        try:
            for cell in kept[: len(names)]:
                float(cell)
        except ValueError:
            raise InputError("a cell is not a number", where=path, line=number, allowed=", ".join(names)) from None
        out.append(kept)
    return out


def _track(rows: list[list[str]], names: tuple[str, ...] | list[str], path: Path) -> Trajectory:
    at = {name: index for index, name in enumerate(names)}
    clock = "t_ns" if "t_ns" in at else "t_s"
    if missing := [name for name in (clock, *PLACE) if name not in at]:
        raise InputError(f"no column {', '.join(missing)}", where=path, allowed=KINDS)
    if twice := [name for name in (clock, *PLACE, *TURN) if list(names).count(name) > 1]:
        raise InputError(
            f"{len(twice)} columns stand twice: {', '.join(twice)}", where=path, allowed="each column once"
        )
    some = [name for name in TURN if name in at]
    if some and len(some) < len(TURN):
        raise InputError(f"only {', '.join(some)} of the attitude", where=path, allowed=", ".join(TURN))

    def columns(wanted: tuple[str, ...]) -> Floats:
        return np.array([[float(row[at[name]]) for name in wanted] for row in rows]).reshape(len(rows), len(wanted))

    position = columns(PLACE)
    quat = columns(TURN) if some else np.tile([0.0, 0.0, 0.0, 1.0], (len(rows), 1))
    t_ns, timed = _times([row[at[clock]] for row in rows], clock, path)
    position[~timed] = np.nan
    if abs(position[np.isfinite(position)]).max(initial=0) > MOST_M:
        raise InputError("positions are absurd", where=path, allowed=f"|x| < {MOST_M:g} m")
    return good_poses(t_ns, position, quat, where=path)


def good_poses(t_ns: Longs, position: ArrayLike, quat_xyzw: ArrayLike, *, where: Path) -> Trajectory:
    """The poses of a file without those that `checked_pose` refuses; a warning counts them, as live ports do.

    Args:
        t_ns: (n) [ns].
        position: (n, 3) [m].
        quat_xyzw: (n, 4).
        where: the file.

    Raises:
        InputError: fewer than two poses are left, or their times are out of order.
    """
    counters, topic = Counters(), f"{where}: poses"
    counters.receive(topic, len(t_ns))
    found = [checked_pose(*pose) for pose in zip(np.asarray(position), np.asarray(quat_xyzw), strict=True)]
    for index, pose in enumerate(found):
        if isinstance(pose, str):
            counters.drop(topic, "bad", f"pose {index}: {pose}")
    good = [pose for pose in found if not isinstance(pose, str)]
    if len(good) < 2:
        why = "".join(line.removeprefix(topic) for line in counters.lines())
        raise InputError(f"{len(good)} poses{why}", where=where, allowed="at least 2")
    for line in counters.lines():
        warn(line)
    times = mend_clock(t_ns[[not isinstance(pose, str) for pose in found]], where=where)
    return Trajectory(times, *(np.array(part) for part in zip(*good, strict=True)))


def _times(cells: list[str], clock: str, path: Path) -> tuple[Longs, NDArray[np.bool_]]:
    """Exact times [ns], as doubles of seconds since 1970 lose 0.1 microseconds; and which of them are finite."""
    given = np.array([float(cell) for cell in cells])
    timed = np.isfinite(given)
    unit = 1 if clock == "t_ns" or is_in_nanoseconds(given, path) else 1_000_000_000
    if abs(given[timed]).max(initial=0) * unit > MOST_S * 1e9:
        raise InputError("times are absurd", where=path, allowed=f"|t| < {MOST_S:g} s")
    exact = [round(Decimal(cell.strip()) * unit) if good else 0 for cell, good in zip(cells, timed, strict=True)]
    return np.array(exact, np.int64), timed
