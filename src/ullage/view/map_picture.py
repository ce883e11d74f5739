"""Draw an occupancy map as a picture, in the same style for figures and viewers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ullage.grids import AMBIGUOUS, OccupancyMap

PIXELS = 2
"""Edge of a cell in the picture [pixels]."""
AMBER = (242, 193, 78)
PALE, STRIPE = 70, 190
"""Opacity of an ambiguous cell, and of the stripes on it."""


def map_picture(omap: OccupancyMap, *, level: int | None = None, free_alpha: int = 255) -> NDArray[np.uint8]:
    """Draw a map as RGBA (2 ny, 2 nx, 4), from low y to high y.

    Unknown cells are clear. Known cells go from white to black by their chance of being occupied. A wall of one cell
    is drawn two cells wide: it reaches half a cell beyond its borders. Ambiguous cells are pale with stripes.

    Args:
        omap: the map.
        level: index along z, of a volume; None: the highest chance of each column.
        free_alpha: opacity of free cells; the others are opaque in proportion to their chance of being occupied.
    """
    from scipy.ndimage import maximum_filter

    percent = plane_of(omap, level)
    block = np.ones((PIXELS, PIXELS), np.int8)
    thin = np.kron(_thin(percent, omap.occupied_from), block)
    fine = np.maximum(np.kron(percent, block), maximum_filter(thin, size=PIXELS + 1, mode="nearest"))
    out = np.zeros((*fine.shape, 4), np.uint8)
    known = fine >= 0
    chance = fine[known] / 100
    out[known, :3] = np.round(255 - 255 * chance)[:, None]
    out[known, 3] = np.round(free_alpha + (255 - free_alpha) * chance)
    unsure = fine == AMBIGUOUS
    out[unsure] = (*AMBER, PALE)
    row, column = np.indices(fine.shape)
    out[unsure & ((row + column) % (2 * PIXELS) < PIXELS // 2), 3] = STRIPE
    return out


def plane_of(omap: OccupancyMap, level: int | None = None) -> NDArray[np.int8]:
    """Return the cells (ny, nx) of a plane or of one level of a volume; without a level, the column maximum.

    A column of a volume is ambiguous where nothing in it is known but its ambiguity.
    """
    percent = omap.percent
    if percent.ndim == 2:
        return percent
    if level is not None:
        return np.asarray(percent[level])
    top = percent.max(axis=0)
    return np.where((top < 0) & (percent == AMBIGUOUS).any(axis=0), AMBIGUOUS, top).astype(np.int8)


def _thin(percent: NDArray[np.int8], occupied_from: int) -> NDArray[np.int8]:
    """Return occupied cells outside all squares of four occupied cells; others get less than any known value."""
    from scipy.ndimage import binary_opening

    occupied = percent >= occupied_from
    return np.where(occupied & ~binary_opening(occupied, np.ones((2, 2), bool)), percent, AMBIGUOUS).astype(np.int8)
