"""Elfes' cell update for one range reading, over plain arrays."""

from __future__ import annotations

import math

import numpy as np

from ullage.kernels.loops import inner, loop


@loop(fastmath=True)
def insert_reading(
    empty: np.ndarray,
    occupied: np.ndarray,
    column0: float,
    row0: float,
    step: float,
    x: float,
    y: float,
    yaw: float,
    near: float,
    reach: float,
    spread: float,
    echo: bool,
    half: float,
    box: np.ndarray,
) -> None:
    """Blend one reading into both layers; `box` takes the rows and columns looked at.

    Without an echo only emptiness up to `reach` is added. `column0`, `row0` are the lower corner of cell (0, 0).
    """
    far = reach + spread if echo else reach
    rows, columns = empty.shape
    box[0], box[1], box[2], box[3] = _lobe_cells(column0, row0, step, x, y, yaw, far, half, rows, columns)
    corner = column0 - x, row0 - y, step
    lobe = math.cos(yaw), math.sin(yaw), math.cos(half), half
    clear = max(reach - spread, near) if echo else reach
    total = _add_emptiness(empty, box, corner, lobe, near, clear, far, reach, spread)
    if echo and total > 0.0:
        _add_echo(empty, occupied, box, corner, lobe, clear, far, reach, spread, total)


@inner(fastmath=True)
def _add_emptiness(
    empty: np.ndarray,
    box: np.ndarray,
    corner: tuple[float, float, float],
    lobe: tuple[float, float, float, float],
    near: float,
    clear: float,
    far: float,
    reach: float,
    spread: float,
) -> float:
    """Blend f_e into the cells before the arc; returns the sum of f_o over it, each weakened by its cell's emptiness.

    The arc is what lies from `clear` to `far`; there is none where these are the same.
    """
    total = 0.0
    for row in range(box[0], box[1]):
        for column in range(box[2], box[3]):
            distance, angle = _seen(row, column, corner, lobe, near, far)
            if angle > 1.0:
                continue
            across = 1.0 - angle * angle
            if distance < clear:
                part = (distance - near) / (clear - near)
                weight = (1.0 - part * part) * across
                empty[row, column] += weight - empty[row, column] * weight
            elif clear < far:
                part = (distance - reach) / spread
                total += (1.0 - part * part) * across * (1.0 - empty[row, column])
    return total


@inner(fastmath=True)
def _add_echo(
    empty: np.ndarray,
    occupied: np.ndarray,
    box: np.ndarray,
    corner: tuple[float, float, float],
    lobe: tuple[float, float, float, float],
    clear: float,
    far: float,
    reach: float,
    spread: float,
    total: float,
) -> None:
    """Blend f_o into the cells of the arc, weakened by their emptiness and normalised to `total`."""
    for row in range(box[0], box[1]):
        for column in range(box[2], box[3]):
            distance, angle = _seen(row, column, corner, lobe, clear, far)
            if angle > 1.0:
                continue
            part = (distance - reach) / spread
            weight = (1.0 - part * part) * (1.0 - angle * angle) * (1.0 - empty[row, column]) / total
            occupied[row, column] += weight - occupied[row, column] * weight


@inner(fastmath=True)
def _seen(
    row: int,
    column: int,
    corner: tuple[float, float, float],
    lobe: tuple[float, float, float, float],
    low: float,
    high: float,
) -> tuple[float, float]:
    """Distance of a cell's centre [m] and its angle off the axis, in halves of the lobe; 2 outside lobe or range.

    `corner` is that of cell (0, 0) from the sensor and the cells' side [m], `lobe` cosine and sine of the yaw, cosine
    of the half angle and that angle.
    """
    dx, dy = corner[0] + (column + 0.5) * corner[2], corner[1] + (row + 0.5) * corner[2]
    distance = math.sqrt(dx * dx + dy * dy)
    along = dx * lobe[0] + dy * lobe[1]
    if distance < low or distance > high or along < lobe[2] * distance:
        return distance, 2.0
    return distance, abs(math.atan2(dy * lobe[0] - dx * lobe[1], along)) / lobe[3]


@inner()
def _lobe_cells(
    column0: float, row0: float, step: float, x: float, y: float, yaw: float, far: float, half: float, rows: int,
    columns: int,
) -> tuple[int, int, int, int]:  # fmt: skip
    """First and last row, first and last column of the square about a lobe that reaches to `far`."""
    low_x, high_x, low_y, high_y = _lobe_square(x, y, yaw, half, far)
    return (
        min(rows, max(0, math.floor((low_y - row0) / step))),
        max(0, min(rows, math.floor((high_y - row0) / step) + 1)),
        min(columns, max(0, math.floor((low_x - column0) / step))),
        max(0, min(columns, math.floor((high_x - column0) / step) + 1)),
    )


@loop()
def lobe_box(
    column0: float, row0: float, step: float, x: float, y: float, yaw: float, far: float, half: float, rows: int,
    columns: int, box: np.ndarray,
) -> None:  # fmt: skip
    """The rows and columns that a reading up to `far` can change, as `insert_reading` finds them, into `box`."""
    box[0], box[1], box[2], box[3] = _lobe_cells(column0, row0, step, x, y, yaw, far, half, rows, columns)


@inner()
def _lobe_square(x: float, y: float, yaw: float, half: float, far: float) -> tuple[float, float, float, float]:
    low_x, high_x, low_y, high_y = x, x, y, y
    for k in range(6):
        angle = yaw - half if k == 4 else yaw + half if k == 5 else k * math.pi / 2
        if k < 4 and math.cos(angle - yaw) < math.cos(half):
            continue
        px, py = x + far * math.cos(angle), y + far * math.sin(angle)
        low_x, high_x = min(low_x, px), max(high_x, px)
        low_y, high_y = min(low_y, py), max(high_y, py)
    return low_x, high_x, low_y, high_y
