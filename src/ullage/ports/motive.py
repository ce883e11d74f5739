"""OptiTrack Motive exports: rigid bodies over time from `.csv`, Y up, as world ENU [MotiveCSV].

Motive's (X, Y, Z) becomes ENU (X, -Z, Y), for positions and for the axes of the bodies alike: a body that lies
along Motive's axes looks along +X.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ullage.arrays import Floats
from ullage.data import Trajectory
from ullage.errors import InputError
from ullage.ports.intake import warn
from ullage.ports.protocol import mend_clock
from ullage.untrusted import reading

LENGTHS = {"meters": 1.0, "centimeters": 1e-2, "millimeters": 1e-3, "inches": 0.0254, "feet": 0.3048}
WANTED = tuple([("Rotation", axis) for axis in "XYZW"] + [("Position", axis) for axis in "XYZ"])
GAP_S = 0.5

Columns = list[tuple[str, list[int]]]


def read_tracks(path: str | Path) -> dict[str, Trajectory]:
    """Track of each rigid body by name, without the moments when it was not seen.

    Raises:
        InputError: it is no Motive export that can be used, or no rigid body was seen in it.
    """
    path = Path(path)
    with reading(path):
        lines = path.read_text("utf-8-sig", errors="replace").splitlines()
    start = next((i for i, line in enumerate(lines[:50]) if line.startswith("Frame,")), None)
    if not start:  # none, or without the lines above it
        raise InputError("no line that starts with Frame,Time", where=path, allowed="a Motive .csv export")
    scale = _check_header(lines[0], path)
    columns = _rigid_bodies(lines[: start + 1], path)
    table = _numbers(lines, start + 1, max(max(places) for _, places in columns) + 1, path)
    tracks: dict[str, Trajectory] = {}
    for name, places in columns:
        rows = table[np.isfinite(table[:, [1, *places]]).all(1)][:, [1, *places]]
        rows = rows[abs(np.linalg.norm(rows[:, 1:5], axis=1) - 1) < 0.01]
        if len(rows) > (len(tracks[name]) if name in tracks else 0):
            tracks[name] = _track(rows, scale, f"{path} ({name})")
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


def _numbers(lines: list[str], start: int, width: int, path: Path) -> Floats:
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


def _track(rows: Floats, scale: float, where: str) -> Trajectory:
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
