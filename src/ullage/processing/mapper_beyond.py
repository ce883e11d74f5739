"""Free space of a volume ends at walls that were told since, and where nothing that is told lies farther out.

A smooth surface is silent but about the foot of the perpendicular. So silence aslant says nothing of a surface that
turns waves away from wherever the drone was, as the crown of a lying tank does that is flown beside its axis: each
place hears the wall beside it and, across the axis, the wall on the other side. What waves did cross is the space
between the flight and the surfaces that echoed, and the way straight ahead of each sensor up to the first echo: what
lies in the convex hull of these is told, the rest is not.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from ullage.grids import UNKNOWN, Grid
from ullage.processing.mapper_bows import Hollow

Floats = NDArray[np.float64]

EDGE = 8  # of the blocks that are asked in one go
AROUND, ALONG_M = float(np.cos(np.radians(60.0))), 1.0  # of where a hollow wall was heard
AT_ONCE = 4096  # places asked in one go
CELL = 0.75  # of one lies to a side of its middle, or a little more
CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))


def cell_of(place: Floats, grid: Grid) -> tuple[int, ...]:
    """A place (3) [m] in steps of a grid."""
    return tuple(np.rint(place / grid.step_m).astype(int).tolist())


def without_beyond(
    percent: NDArray[np.int8],
    corner: tuple[int, ...],
    grid: Grid,
    ends: list[tuple[int, ...]],
    flown: Floats,
    clear_m: float,
) -> None:
    """Free cells of a volume outside the hull of what is told become unknown.

    Args:
        percent: the map's known part (z, y, x), changed in place.
        corner: its first cell.
        grid: of the whole map.
        ends: how far silence goes straight ahead of the sensors [steps].
        flown: (m, 3) where they were [m].
        clear_m: how far around that is free [m].
    """
    origin = np.asarray(grid.origin_m) + np.asarray(corner)[::-1] * grid.step_m
    told = origin + (np.argwhere(percent >= 50)[:, ::-1] + 0.5) * grid.step_m
    around = (flown[:, None] + clear_m * CORNERS).reshape(-1, 3)
    if not len(flown):
        return
    points = np.concatenate([told, np.array(ends, float).reshape(-1, 3) * grid.step_m, around])
    middle = points.mean(axis=0)
    planes = np.unique(np.round(ConvexHull(points - middle).equations, 2), axis=0)  # 2 cm off 4 m away, but many fewer
    free = np.argwhere((percent >= 0) & (percent < 50))
    block, which = np.unique(free // EDGE, axis=0, return_inverse=True)
    half = 0.5 * EDGE * grid.step_m
    off = _outside(origin + (block[:, ::-1] + 0.5) * EDGE * grid.step_m - middle, planes)
    asked = (abs(off) < half * np.sqrt(3.0))[which.ravel()]
    beyond = (off > 0)[which.ravel()]
    beyond[asked] = _outside(origin + (free[asked][:, ::-1] + 0.5) * grid.step_m - middle, planes) > -0.5 * grid.step_m
    percent[tuple(free[beyond].T)] = UNKNOWN


def without_behind(
    percent: NDArray[np.int8], corner: tuple[int, ...], grid: Grid, pieces: list[tuple[Hollow, Floats, Floats]]
) -> None:
    """Free cells on and behind hollow walls become unknown: silence freed some before the wall was told.

    Args:
        percent: the map's known part (z, y, x), changed in place.
        corner: its first cell.
        grid: of the whole map.
        pieces: walls, unit vectors (3) to where they were heard, and places (3) there [m].
    """
    free = np.argwhere((percent >= 0) & (percent < 50))
    at = np.asarray(grid.origin_m) + (free[:, ::-1] + np.asarray(corner)[::-1] + 0.5) * grid.step_m
    gone = np.zeros(len(free), bool)
    for hollow, way, foot in pieces:
        if hollow.radius_m > 0:
            near = np.flatnonzero(abs((at - foot) @ hollow.axis) < ALONG_M)
            off = at[near] - hollow.centre
            off -= (off @ hollow.axis)[:, None] * hollow.axis
            away = np.linalg.norm(off, axis=1)
            gone[near] |= (off @ way > AROUND * away) & (away > hollow.radius_m - CELL * grid.step_m)
    percent[tuple(free[gone].T)] = UNKNOWN


def _outside(places: Floats, planes: Floats) -> Floats:
    """How far places (n, 3) lie outside the nearest of a hull's planes (p, 4), less than nothing inside [m]."""
    out = np.full(len(places), -np.inf)
    for first in range(0, len(places), AT_ONCE):
        some = slice(first, first + AT_ONCE)
        out[some] = (places[some] @ planes[:, :3].T + planes[:, 3]).max(axis=1)
    return out
