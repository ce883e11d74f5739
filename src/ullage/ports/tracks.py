"""Tracks of a radar and surveyed reflectors from text files.

Tracks are Motive exports, TUM and EuRoC trajectories, and CSV with named columns.

Motive's (X, Y, Z) with Y up becomes ENU (X, -Z, Y), for positions and for the axes of the bodies alike: a body that
lies along Motive's axes looks along +X [MotiveCSV]. All others are world_from_radar with z up: a row is one pose.
TUM: time [s], x, y, z [m], quaternion x, y, z, w, between blanks [TUM2012]. EuRoC: a header with `#timestamp`, time
[ns], x, y, z, quaternion w, x, y, z [EuRoC2016]. Named columns: `t_s` or `t_ns`, `x_m`, `y_m`, `z_m` and, where the
attitude is known, `qx`, `qy`, `qz`, `qw`, in any order. Poses that cannot be are left out and counted.

Surveyed reflectors are `reflectors.csv` with the columns `x_m`, `y_m`, `z_m` and optionally `name`. Places are in the
frame of reference of the track as ullage gives it: z up, metres.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ullage.arrays import Floats, Longs
from ullage.checks import is_in_nanoseconds
from ullage.data import Trajectory
from ullage.errors import InputError
from ullage.ports.intake import Counters, checked_pose, warn
from ullage.ports.protocol import mend_clock
from ullage.untrusted import reading

LENGTHS = {"meters": 1.0, "centimeters": 1e-2, "millimeters": 1e-3, "inches": 0.0254, "feet": 0.3048}
WANTED = tuple([("Rotation", axis) for axis in "XYZW"] + [("Position", axis) for axis in "XYZ"])
GAP_S = 0.5
Columns = list[tuple[str, list[int]]]
KINDS = "a Motive export, a TUM or EuRoC trajectory, or a CSV with columns t_s, x_m, y_m, z_m, qx, qy, qz, qw"
PLACE, TURN = ("x_m", "y_m", "z_m"), ("qx", "qy", "qz", "qw")
TUM = ("t_s", *PLACE, *TURN)
EUROC = ("t_ns", *PLACE, "qw", "qx", "qy", "qz")
MOST_M, MOST_S = 1e6, 9e9
COLUMNS = "columns x_m, y_m, z_m and, if wanted, name"
SURVEY_M, MOST_REFLECTORS = 1e4, 1000
"""How far from the origin a surveyed reflector may be, and how many of them a file may hold."""


def read_bodies(path: str | Path) -> dict[str, Trajectory]:
    """Track of each body by name; files of one body call it "radar". The kind is recognised by its first lines.

    Raises:
        InputError: the file is of no known kind, holds no pose, or a line of it cannot be read.
    """
    path, lines = _lines_of(path)
    if not any(line.strip() for line in lines):
        raise InputError("the file is empty", where=path, allowed=KINDS)
    if any(line.startswith("Frame,") for line in lines[:50]) or lines[0].startswith("Format Version"):
        return _motive_bodies(lines, path)
    first = next(line for line in lines if line.strip())
    named = [name.strip() for name in first.split(",")]
    names: Sequence[str] = named if "x_m" in named else EUROC if first.startswith("#timestamp") else TUM
    numbers = next((line for line in lines if line.strip() and not line.startswith("#")), "")
    if names is TUM and len(numbers.split()) != len(TUM):
        raise InputError("of no known kind of track", where=path, line=1, allowed=KINDS)
    header = lines.index(first) + 1 if names is named else 0
    rows = [row for row in _lines_of_cells(lines, blanks=names is TUM) if row[0] > header]
    return {"radar": _track(_numbers(rows, names, path), names, path)}


def _lines_of(path: str | Path) -> tuple[Path, list[str]]:
    """The path, and the lines of its text."""
    path = Path(path)
    with reading(path):
        return path, path.read_text("utf-8-sig", errors="replace").splitlines()


def _lines_of_cells(lines: list[str], *, blanks: bool = False) -> Iterator[tuple[int, list[str]]]:
    """Give number and cells of each line, with commas or blanks between; comments and empty lines are left out."""
    split = map(str.split, lines) if blanks else csv.reader(lines, skipinitialspace=True)
    for number, cells in enumerate(split, 1):
        if any(cell.strip() for cell in cells) and not cells[0].startswith("#"):
            yield number, cells


def _numbers(rows: list[tuple[int, list[str]]], names: Sequence[str], path: Path) -> list[list[str]]:
    """The cells of every pose, all of them numbers."""
    for number, cells in rows:
        if len(cells) < len(names):
            raise InputError(f"{len(cells)} cells", where=path, line=number, allowed=", ".join(names))
        try:
            for cell in cells[: len(names)]:
                float(cell)
        except ValueError:
            raise InputError("a cell is not a number", where=path, line=number, allowed=", ".join(names)) from None
    return [cells for _, cells in rows]


def _track(rows: list[list[str]], names: Sequence[str], path: Path) -> Trajectory:
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


def read_tracks(path: str | Path) -> dict[str, Trajectory]:
    """Track of each rigid body by name, without the moments when it was not seen.

    Raises:
        InputError: it is no Motive export that can be used, or no rigid body was seen in it.
    """
    path, lines = _lines_of(path)
    return _motive_bodies(lines, path)


def _motive_bodies(lines: list[str], path: Path) -> dict[str, Trajectory]:
    start = next((i for i, line in enumerate(lines[:50]) if line.startswith("Frame,")), None)
    if not start:  # none, or without the lines above it
        raise InputError("no line that starts with Frame,Time", where=path, allowed="a Motive .csv export")
    scale = _check_header(lines[0], path)
    columns = _rigid_bodies(lines[: start + 1], path)
    table = _motive_table(lines, start + 1, max(max(places) for _, places in columns) + 1, path)
    tracks: dict[str, Trajectory] = {}
    for name, places in columns:
        rows = table[np.isfinite(table[:, [1, *places]]).all(1)][:, [1, *places]]
        rows = rows[abs(np.linalg.norm(rows[:, 1:5], axis=1) - 1) < 0.01]
        if len(rows) > (len(tracks[name]) if name in tracks else 0):
            tracks[name] = _motive_track(rows, scale, f"{path} ({name})")
    if not tracks:
        raise InputError("no rigid body was seen in it", where=path)
    return tracks


def _check_header(line: str, path: Path) -> float:
    """Metres in one unit of length; refuses what would be misread."""
    cells = line.split(",")
    header = {key.strip(): value.strip() for key, value in zip(cells[::2], cells[1::2], strict=False)}
    if (kind := header.get("Rotation Type", "Quaternion")) != "Quaternion":
        raise InputError(f"Rotation Type is {kind}", where=path, line=1, allowed="Quaternion")
    if (space := header.get("Coordinate Space", "Global")) != "Global":
        raise InputError(f"Coordinate Space is {space}", where=path, line=1, allowed="Global")
    unit = header.get("Length Units", "Meters").lower()
    if unit not in LENGTHS:
        raise InputError(f"Length Units are {unit}", where=path, line=1, allowed=", ".join(LENGTHS))
    return LENGTHS[unit]


def _rigid_bodies(head: list[str], path: Path) -> Columns:
    """Name and the seven columns, rotation then position, of each rigid body; one name may come twice.

    The kinds stand in the first row of cells and the names in the next; 1.23 also labels them Type and Name.
    """
    rows = [cells for cells in (line.split(",") for line in head[1:-2]) if len(cells) > 2]
    first = next((k for k, cells in enumerate(rows) if "Rigid Body" in cells), len(rows))
    kinds, names = (*rows[first : first + 2], [], [])[:2]
    what, axes = head[-2].split(","), head[-1].split(",")
    out: list[tuple[str, dict[tuple[str, str], int]]] = []
    for k, (kind, name, part, axis) in enumerate(zip(kinds, names, what, axes, strict=False)):
        if kind != "Rigid Body" or (part, axis) not in WANTED:
            continue
        if not out or out[-1][0] != name or (part, axis) in out[-1][1]:
            out.append((name, {}))
        out[-1][1][part, axis] = k
    whole = [(name.strip('"'), [places[want] for want in WANTED]) for name, places in out if len(places) == len(WANTED)]
    if not whole:
        raise InputError("no rigid body with rotation and position", where=path, allowed="a Motive .csv export")
    return whole


def _motive_table(lines: list[str], start: int, width: int, path: Path) -> Floats:
    bad: list[int] = []

    def rows() -> Iterator[list[float]]:
        for number, line in enumerate(lines[start:], start + 1):
            cells = line.split(",")[:width]
            try:
                row = [float(cell) if cell else np.nan for cell in cells]
            except ValueError:
                row = []
            if len(row) == width:
                yield row
            elif line.strip():
                bad.append(number)

    table = np.array(list(rows()), float).reshape(-1, width)
    if bad:
        warn(f"{path}: {len(bad)} lines cannot be read, first line {bad[0]}; left out")
    return table


def _motive_track(rows: Floats, scale: float, where: str) -> Trajectory:
    seconds, quat, position = rows[:, 0], rows[:, 1:5], rows[:, 5:8] * scale
    if abs(seconds).max() > 1e8 or abs(position).max() > 1e6:
        raise InputError("times or positions are absurd", where=where, allowed="seconds and metres of one take")
    t_ns = mend_clock(np.rint(seconds * 1e9).astype(np.int64), where=where)
    gap = float(np.diff(t_ns).max(initial=0)) * 1e-9
    if gap > GAP_S:
        warn(f"{where}: not seen for up to {gap:.2f} s; drawn through")
    unit = quat / np.linalg.norm(quat, axis=1, keepdims=True)
    turned = unit * [1, 1, -1, 1]
    return Trajectory(t_ns, (position * [1, 1, -1])[:, [0, 2, 1]], turned[:, [0, 2, 1, 3]])


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """Places of reflectors."""

    places: Floats  # (r, 3) world [m]
    names: tuple[str, ...]


def read_survey(path: str | Path) -> Survey:
    """Read the places of reflectors from a file with named columns.

    Raises:
        InputError: a column is missing, a cell is no finite number within 10 km, a place comes twice, or there is none.
    """
    path, lines = _lines_of(path)
    rows = [(number, [cell.strip() for cell in cells]) for number, cells in _lines_of_cells(lines)]
    if not rows:
        raise InputError("the file is empty", where=path, allowed=COLUMNS)
    (first, header), *rest = rows
    if missing := [name for name in PLACE if name not in header]:
        raise InputError(f"no column {', '.join(missing)}", where=path, line=first, allowed=COLUMNS)
    if unknown := [name for name in header if name not in (*PLACE, "name")]:
        raise InputError(f"unknown column {unknown[0]!r}", where=path, line=first, allowed=COLUMNS)
    if not 1 <= len(rest) <= MOST_REFLECTORS:
        raise InputError(f"{len(rest)} reflectors", where=path, allowed=f"1 .. {MOST_REFLECTORS}")
    found = [_row(dict(zip(header, cells, strict=False)), path, number) for number, cells in rest]
    places = np.array([place for place, _ in found])
    for k, (number, _) in enumerate(rest):
        if (np.linalg.norm(places[:k] - places[k], axis=1) < 1e-3).any():
            raise InputError("the place of an earlier line", where=path, line=number, allowed="each reflector once")
    return Survey(places, tuple(name or str(k + 1) for k, (_, name) in enumerate(found)))


def _row(cells: dict[str, str], path: Path, number: int) -> tuple[list[float], str]:
    place = []
    for name in PLACE:
        try:
            value = float(cells.get(name, ""))
        except ValueError:
            value = float("nan")
        if not abs(value) <= SURVEY_M:
            what = f"{name} is {cells.get(name, '')!r}"
            raise InputError(what, where=path, line=number, allowed=f"a number within {SURVEY_M:g} m of the origin")
        place.append(value)
    return place, cells.get("name", "")
