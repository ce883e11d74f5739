"""Surveyed reflectors of a recording: `reflectors.csv` with the columns `x_m`, `y_m`, `z_m` and optionally `name`.

Places are in the frame of reference of the track as ullage gives it: z up, metres; a Motive export becomes (X, -Z, Y).
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ullage.arrays import Floats
from ullage.errors import InputError
from ullage.untrusted import reading

PLACE = ("x_m", "y_m", "z_m")
COLUMNS = "columns x_m, y_m, z_m and, if wanted, name"
MOST_M, MOST_ROWS = 1e4, 1000


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
    path = Path(path)
    with reading(path):
        lines = path.read_text("utf-8-sig", errors="replace").splitlines()
    rows = [
        (number, [cell.strip() for cell in cells])
        for number, cells in enumerate(csv.reader(lines, skipinitialspace=True), 1)
        if any(cell.strip() for cell in cells) and not cells[0].startswith("#")
    ]
    if not rows:
        raise InputError("the file is empty", where=path, allowed=COLUMNS)
    (first, header), *rest = rows
    if missing := [name for name in PLACE if name not in header]:
        raise InputError(f"no column {', '.join(missing)}", where=path, line=first, allowed=COLUMNS)
    if unknown := [name for name in header if name not in (*PLACE, "name")]:
        raise InputError(f"unknown column {unknown[0]!r}", where=path, line=first, allowed=COLUMNS)
    if not 1 <= len(rest) <= MOST_ROWS:
        raise InputError(f"{len(rest)} reflectors", where=path, allowed=f"1 .. {MOST_ROWS}")
    found = [_row(dict(zip(header, cells, strict=False)), path, number) for number, cells in rest]
    places = np.array([place for place, _ in found])
    for k, (number, _) in enumerate(rest):
        if (np.linalg.norm(places[:k] - places[k], axis=1) < 1e-3).any():
            raise InputError("the place of an earlier line", where=path, line=number, allowed="each reflector once")
    return Survey(places, tuple(name or str(k + 1) for k, (_, name) in enumerate(found)))


def _row(cells: dict[str, str], path: Path, number: int) -> tuple[list[float], str]:
    """Place and name in one line."""
    place = []
    for name in PLACE:
        try:
            value = float(cells.get(name, ""))
        except ValueError:
            value = float("nan")
        if not abs(value) <= MOST_M:
            what = f"{name} is {cells.get(name, '')!r}"
            raise InputError(what, where=path, line=number, allowed=f"a number within {MOST_M:g} m of the origin")
        place.append(value)
    return place, cells.get("name", "")
