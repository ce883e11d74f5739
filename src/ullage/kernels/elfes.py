"""Update the cells of Elfes' occupancy grid for one range reading [Elfes1987], over plain arrays."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from numpy.typing import NDArray

from ullage.kernels.loops import inner, loop


class Cells(NamedTuple):
    """Where the cells of a map layer lie."""

    x0: float  # lower corner of cell (0, 0) along x [m]
    y0: float  # and along y [m]
    step: float  # side of a cell [m]


class Reading(NamedTuple):
    """One range reading of a sensor in the plane of the map."""

    x: float  # position of the sensor [m]
    y: float
    yaw: float  # direction of the boresight [rad]
    near: float  # least range that counts [m]
    reach: float  # range of the echo; without an echo the range up to which there is none [m]
    echo: bool


class Lobe(NamedTuple):
    """The sector in which a reading's echo may lie."""

    half: float  # half of its opening [rad]
    spread: float  # half thickness of the arc [m]


class _Sector(NamedTuple):
    """A lobe as the cells of one reading need it."""

    left: float  # corner of cell (0, 0) from the sensor along x [m]
    lower: float  # and along y [m]
    step: float  # side of a cell [m]
    cos: float  # of the yaw
    sin: float
    narrow: float  # cosine of half the opening
    half: float  # half of the opening [rad]


class _Arc(NamedTuple):
    """Ranges of one reading [m]: empty from `near` to `clear`, an echo within `reach` plus or minus `spread`."""

    near: float
    clear: float
    far: float  # where the arc ends; there is no arc where this equals `clear`
    reach: float
    spread: float


@loop(fastmath=True)
def insert_reading(
    empty: NDArray[Any], occupied: NDArray[Any], cells: Cells, reading: Reading, lobe: Lobe, box: NDArray[Any]
) -> None:
    """Blend one reading into the layers of emptiness and occupancy; without an echo only emptiness is added.

    Args:
        empty: (rows, columns) emptiness of each cell, 0 to 1; updated.
        occupied: (rows, columns) occupancy of each cell, 0 to 1; updated.
        cells: of both layers.
        reading: the reading.
        lobe: of the antenna.
        box: (4) gets first and last row, first and last column that the reading reaches.
    """
    far = reading.reach + lobe.spread if reading.echo else reading.reach
    box[0], box[1], box[2], box[3] = _lobe_cells(cells, reading, lobe.half, far, empty.shape)
    sector = _Sector(
        cells.x0 - reading.x, cells.y0 - reading.y, cells.step, math.cos(reading.yaw), math.sin(reading.yaw),
        math.cos(lobe.half), lobe.half,
    )  # fmt: skip
    clear = max(reading.reach - lobe.spread, reading.near) if reading.echo else reading.reach
    arc = _Arc(reading.near, clear, far, reading.reach, lobe.spread)
    total = _add_emptiness(empty, box, sector, arc)
    if reading.echo and total > 0.0:
        _add_echo(empty, occupied, box, sector, arc, total)


@inner(fastmath=True)
def _add_emptiness(empty: NDArray[Any], box: NDArray[Any], sector: _Sector, arc: _Arc) -> float:
    """Blend f_e into the cells before the arc; return the sum of f_o over it, each weakened by its cell's emptiness."""
    total = 0.0
    for row in range(box[0], box[1]):
        for column in range(box[2], box[3]):
            distance, angle = _polar(row, column, sector, arc.near, arc.far)
            if angle > 1.0:
                continue
            across = 1.0 - angle * angle
            if distance < arc.clear:
                part = (distance - arc.near) / (arc.clear - arc.near)
                weight = (1.0 - part * part) * across
                empty[row, column] += weight - empty[row, column] * weight
            elif arc.clear < arc.far:
                part = (distance - arc.reach) / arc.spread
                total += (1.0 - part * part) * across * (1.0 - empty[row, column])
    return total


@inner(fastmath=True)
def _add_echo(
    empty: NDArray[Any], occupied: NDArray[Any], box: NDArray[Any], sector: _Sector, arc: _Arc, total: float
) -> None:
    """Blend f_o into the cells of the arc, weakened by their emptiness and normalised to `total`."""
    for row in range(box[0], box[1]):
        for column in range(box[2], box[3]):
            distance, angle = _polar(row, column, sector, arc.clear, arc.far)
            if angle > 1.0:
                continue
            part = (distance - arc.reach) / arc.spread
            weight = (1.0 - part * part) * (1.0 - angle * angle) * (1.0 - empty[row, column]) / total
            occupied[row, column] += weight - occupied[row, column] * weight


@inner(fastmath=True)
def _polar(row: int, column: int, sector: _Sector, low: float, high: float) -> tuple[float, float]:
    """Return a cell's distance [m] and its angle off the axis in halves of the lobe; 2 outside lobe or range."""
    dx, dy = sector.left + (column + 0.5) * sector.step, sector.lower + (row + 0.5) * sector.step
    distance = math.sqrt(dx * dx + dy * dy)
    along = dx * sector.cos + dy * sector.sin
    if distance < low or distance > high or along < sector.narrow * distance:
        return distance, 2.0
    return distance, abs(math.atan2(dy * sector.cos - dx * sector.sin, along)) / sector.half


@inner()
def _lobe_cells(
    cells: Cells, reading: Reading, half: float, far: float, shape: tuple[int, int]
) -> tuple[int, int, int, int]:
    """Return first and last row, first and last column of the square about a lobe that reaches to `far` [m]."""
    low_x, high_x, low_y, high_y = _lobe_square(reading.x, reading.y, reading.yaw, half, far)
    rows, columns = shape
    return (
        min(rows, max(0, math.floor((low_y - cells.y0) / cells.step))),
        max(0, min(rows, math.floor((high_y - cells.y0) / cells.step) + 1)),
        min(columns, max(0, math.floor((low_x - cells.x0) / cells.step))),
        max(0, min(columns, math.floor((high_x - cells.x0) / cells.step) + 1)),
    )


@loop()
def lobe_box(cells: Cells, reading: Reading, lobe: Lobe, shape: tuple[int, int], box: NDArray[Any]) -> None:
    """Write the rows and columns that a reading with an echo can change into `box`, as `insert_reading` does."""
    far = reading.reach + lobe.spread
    box[0], box[1], box[2], box[3] = _lobe_cells(cells, reading, lobe.half, far, shape)


@inner()
def _lobe_square(x: float, y: float, yaw: float, half: float, far: float) -> tuple[float, float, float, float]:
    """Return the bounds along x and y [m] of a sector: its apex, the ends of its arc and the arc's extremes."""
    low_x, high_x, low_y, high_y = x, x, y, y
    for k in range(6):
        angle = yaw - half if k == 4 else yaw + half if k == 5 else k * math.pi / 2
        if k < 4 and math.cos(angle - yaw) < math.cos(half):
            continue
        px, py = x + far * math.cos(angle), y + far * math.sin(angle)
        low_x, high_x = min(low_x, px), max(high_x, px)
        low_y, high_y = min(low_y, py), max(high_y, py)
    return low_x, high_x, low_y, high_y
