"""Tracks of a radar from text files: Motive exports, TUM and EuRoC trajectories, and CSV with named columns.

All but Motive's are world_from_radar with z up: a row is one pose. TUM: time [s], x, y, z [m], quaternion x, y, z, w,
between blanks [TUM2012]. EuRoC: a header with `#timestamp`, time [ns], x, y, z, quaternion w, x, y, z [EuRoC2016].
Named columns: `t_s` or `t_ns`, `x_m`, `y_m`, `z_m` and, where the attitude is known,
`qx`, `qy`, `qz`, `qw`, in any order.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from ullage.arrays import Floats
from ullage.data import Trajectory
from ullage.errors import InputError
from ullage.ports.motive import read_tracks
from ullage.ports.protocol import mend_clock

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
    try:
        lines = path.read_text("utf-8-sig", errors="replace").splitlines()
    except OSError as error:
        raise InputError(f"cannot read: {error.strerror}", where=path, allowed=KINDS) from None
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
            values = [float(cell) for cell in kept[: len(names)]]
        except ValueError:
            raise InputError("a cell is not a number", where=path, line=number, allowed=", ".join(names)) from None
        if not np.isfinite(values).all():
            raise InputError("a cell is not finite", where=path, line=number, allowed=", ".join(names))
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
    if len(rows) < 2:
        raise InputError(f"{len(rows)} poses", where=path, allowed="at least 2")

    def columns(wanted: tuple[str, ...]) -> Floats:
        return np.array([[float(row[at[name]]) for name in wanted] for row in rows])

    seconds = columns((clock,))[:, 0] * (1e-9 if clock == "t_ns" else 1.0)
    position = columns(PLACE)
    if abs(seconds).max() > MOST_S or abs(position).max() > MOST_M:
        raise InputError("times or positions are absurd", where=path, allowed=f"|t| < {MOST_S:g} s, |x| < {MOST_M:g} m")
    t_ns = np.array([_nanoseconds(row[at[clock]], clock) for row in rows], np.int64)
    quat = columns(TURN) if some else np.tile([0.0, 0.0, 0.0, 1.0], (len(rows), 1))
    norm = np.linalg.norm(quat, axis=1, keepdims=True)
    if (bad := np.flatnonzero(abs(norm[:, 0] - 1) > 0.01)).size:
        raise InputError(f"the quaternion of pose {int(bad[0])} is not of unit length", where=path, allowed="length 1")
    return Trajectory(mend_clock(t_ns, where=path), position, quat / norm)


def _nanoseconds(text: str, clock: str) -> int:
    """Exact time: doubles of seconds since 1970 lose 0.1 microseconds."""
    from decimal import Decimal

    return round(Decimal(text.strip()) * (1 if clock == "t_ns" else 1_000_000_000))
