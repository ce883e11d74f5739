"""What a map does not say of its cells: what is cut off from the flight, and walls that it cannot have seen."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, generate_binary_structure, label, maximum

from ullage.arrays import Floats
from ullage.grids import AMBIGUOUS, UNKNOWN, Grid
from ullage.kernels.occupancy_show import in_view

EYES, HIDE_M, GAP_M = 64, 0.25, 0.4
FAINT = 80  # below it two cells by themselves, as of one look, are no more of a wall than a single one


def without_cut_off(percent: NDArray[np.int8], corner: tuple[int, ...], grid: Grid, places: Floats) -> None:
    """Free cells that only a narrow gap joins to the flight become unknown; walls hidden by walls, ambiguous.

    Args:
        percent: the map's known part, changed in place.
        corner: its first cell.
        grid: of the whole map.
        places: (n, 3) where the sensors were [m].
    """
    free = (percent >= 0) & (percent < 50)
    solid = percent >= 50
    ball = generate_binary_structure(free.ndim, free.ndim)
    wide = max(1, round(GAP_M / 2 / grid.step_m))
    open_, count = label(free & ~binary_dilation(solid | (percent == AMBIGUOUS), ball, iterations=wide))
    if not count or not len(places):
        return
    cells, inside = grid.index(places)
    cells = cells[inside] - corner
    names = np.unique(open_[tuple(cells.T)])
    joined = binary_dilation(np.isin(open_, names[names > 0]), ball, iterations=wide + 1)
    percent[free & ~joined] = UNKNOWN
    suspects = np.argwhere(solid & ~binary_dilation(joined, ball, iterations=2))
    if len(suspects):
        eyes = cells[np.linspace(0, len(cells) - 1, min(EYES, len(cells))).astype(int)]
        seen = np.zeros(len(suspects), bool)
        deep = [np.pad(v.astype(float), ((0, 0), (3 - free.ndim, 0))) for v in (suspects, eyes)]
        in_view(solid.reshape((-1, *solid.shape[-2:])), *deep, HIDE_M / grid.step_m, seen)
        groups, _ = label(solid, ball)
        size = np.bincount(groups.ravel())
        faint = maximum(percent, groups, np.arange(len(size))) < FAINT
        alone = ((size == 1) | ((size == 2) & faint))[groups[tuple(suspects.T)]]
        percent[tuple(suspects[~seen | alone].T)] = AMBIGUOUS
