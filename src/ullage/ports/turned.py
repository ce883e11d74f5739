"""Cells of a map that stands at an angle to the world, rotated onto the axes of the world."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ullage.errors import InputError
from ullage.grids import UNKNOWN, Grid
from ullage.untrusted import MOST_CELLS

SAMPLES = (-1 / 3, 0.0, 1 / 3)
"""Where a new cell looks into the old ones, from its centre along each axis [cells]."""


def along_axes(
    percent: NDArray[np.int8], origin_m: tuple[float, float, float], step_m: float, *, yaw: float, occupied_from: int
) -> tuple[Grid, NDArray[np.int8]]:
    """Rotate a map that is turned about its origin onto the axes of the world.

    A new cell takes what lies at its centre, or the most occupied of nine places in it, so walls stay closed.

    Args:
        percent: of each cell (ny, nx), low y first.
        origin_m: lower left corner of the first cell [m].
        step_m: edge of a cell [m].
        yaw: from the world's x axis to that of the map [rad].
        occupied_from: least percent of an occupied cell.

    Returns:
        The grid, and the percent of its cells; unknown beyond the map.

    Raises:
        InputError: the turned map has too many cells.
    """
    ny, nx = percent.shape
    yaw = math.remainder(yaw, math.tau)
    if abs(yaw) * math.hypot(nx, ny) < 0.5:  # no cell moves by half its edge
        return Grid(origin_m, step_m, percent.shape), percent
    cos, sin = math.cos(yaw), math.sin(yaw)
    corners = np.array([[0, 0], [nx, 0], [0, ny], [nx, ny]]) @ np.array([[cos, sin], [-sin, cos]])  # [cells]
    low = corners.min(axis=0)
    width, height = (int(n) for n in np.ceil(np.ptp(corners, axis=0) - 1e-6))
    if width * height > MOST_CELLS:
        raise InputError(f"{width} x {height} cells once turned", where="map", allowed=f"at most {MOST_CELLS}")
    padded = np.pad(percent, 1, constant_values=UNKNOWN)
    out = np.empty((height, width), np.int8)
    across = low[0] + np.arange(width) + 0.5
    for row in range(height):
        found = []
        for up in SAMPLES:
            for right in SAMPLES:
                x, y = across + right, low[1] + row + 0.5 + up
                column = np.clip(np.floor(cos * x + sin * y), -1, nx).astype(int) + 1
                line = np.clip(np.floor(cos * y - sin * x), -1, ny).astype(int) + 1
                found.append(padded[line, column])
        most = np.max(found, axis=0)
        out[row] = np.where(most >= occupied_from, most, found[len(found) // 2])
    x0, y0, z0 = origin_m
    return Grid((x0 + step_m * low[0], y0 + step_m * low[1], z0), step_m, out.shape), out
