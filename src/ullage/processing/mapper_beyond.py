"""Free space of a volume ends at walls that were told since, and where nothing that is told lies farther out.

A smooth surface is silent but about the foot of the perpendicular. So silence aslant says nothing of a surface that
turns waves away from wherever the drone was, as the crown of a lying tank does that is flown beside its axis: each
place hears the wall beside it and, across the axis, the wall on the other side, which lies nearer straight ahead. What
waves did cross is the space between the flight and the surfaces that echoed: what lies in the convex hull of these is
told, the rest is not. A surface echoes from its first Fresnel zone [BornWolf1999, 8.2]; that it goes on from there,
as a flat one would, is a guess, which may draw it but frees nothing.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from ullage.arrays import Bools, Floats, Longs
from ullage.grids import UNKNOWN, Grid
from ullage.processing.mapper_hollows import Piece

EDGE = 8  # of the blocks that are asked in one go
AROUND, ALONG_M = float(np.cos(np.radians(60.0))), 1.0  # of where a hollow wall was heard
AT_ONCE = 4096  # places asked in one go
CELL = 0.75  # of one lies to a side of its middle, or a little more
CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
TURNS = np.arange(8) * (np.pi / 4)


class Zones:
    """First Fresnel zones of the surfaces that were heard, one for each cell of a map in which they have their foot."""

    def __init__(self) -> None:
        self._discs: dict[tuple[int, ...], Floats] = {}

    def add(self, foot: Floats, way: Floats, radius_m: float, grid: Grid) -> None:
        """Keep the zone of a surface about its foot (3) [m], square to the way there (3)."""
        cell = np.floor((foot - np.asarray(grid.origin_m)) / grid.step_m).astype(int)
        self._discs[tuple(cell.tolist())] = np.array([*way, radius_m], np.float32)

    def rims(self, percent: NDArray[np.int8], corner: tuple[int, ...], grid: Grid) -> Floats:
        """Places (n, 3) round the zones whose foot a map holds to be occupied [m]: `percent` from cell `corner` on."""
        if not self._discs:
            return np.zeros((0, 3))
        cell, disc = np.array(list(self._discs)), np.array(list(self._discs.values()), float)
        here = cell[:, ::-1] - np.asarray(corner)
        inside = ((here >= 0) & (here < percent.shape)).all(axis=1)
        inside[inside] = percent[tuple(here[inside].T)] >= 50
        centre, way = np.asarray(grid.origin_m) + (cell[inside] + 0.5) * grid.step_m, disc[inside, :3]
        one = np.cross(way, np.where(abs(way[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
        one *= (disc[inside, 3] / np.linalg.norm(one, axis=1))[:, None]
        other = np.cross(way, one)
        return np.concatenate([centre + np.cos(turn) * one + np.sin(turn) * other for turn in TURNS])


def cell_of(place: Floats, grid: Grid) -> tuple[int, ...]:
    """A place (3) [m] in steps of a grid."""
    return tuple(np.rint(place / grid.step_m).astype(int).tolist())


def without_beyond(
    percent: NDArray[np.int8],
    corner: tuple[int, ...],
    grid: Grid,
    told: Floats,
    flown: Floats,
    clear_m: float,
) -> None:
    """Free cells of a volume outside the hull of what is told become unknown.

    Args:
        percent: the map's known part (z, y, x), changed in place.
        corner: its first cell.
        grid: of the whole map.
        told: (n, 3) where surfaces were heard [m].
        flown: (m, 3) where they were [m].
        clear_m: how far around that is free [m].
    """
    origin = np.asarray(grid.origin_m) + np.asarray(corner)[::-1] * grid.step_m
    around = (flown[:, None] + clear_m * CORNERS).reshape(-1, 3)
    if not len(flown):
        return
    points = np.concatenate([told, around])
    middle = points.mean(axis=0)
    planes = np.unique(np.round(ConvexHull(points - middle).equations, 2), axis=0)  # 2 cm off 4 m away, but many fewer
    free = np.argwhere((percent >= 0) & (percent < 50))
    centres, which, half = _blocks(free, origin, grid.step_m)
    off = _outside(centres - middle, planes)
    asked, beyond = (abs(off) < half)[which], (off > 0)[which]
    beyond[asked] = _outside(origin + (free[asked][:, ::-1] + 0.5) * grid.step_m - middle, planes) > -0.5 * grid.step_m
    percent[tuple(free[beyond].T)] = UNKNOWN


def without_behind(percent: NDArray[np.int8], corner: tuple[int, ...], grid: Grid, pieces: list[Piece]) -> None:
    """Free cells on and behind hollow walls become unknown: silence freed some before the wall was told.

    Args:
        percent: the map's known part (z, y, x), changed in place.
        corner: its first cell.
        grid: of the whole map.
        pieces: walls, unit vectors (3) to where they were heard, and places (3) there [m].
    """
    if not pieces:
        return
    free = np.argwhere((percent >= 0) & (percent < 50))
    origin = np.asarray(grid.origin_m) + np.asarray(corner)[::-1] * grid.step_m
    centres, which, half = _blocks(free, origin, grid.step_m)
    in_block = np.split(np.argsort(which, kind="stable"), np.cumsum(np.bincount(which))[:-1])
    gone = np.zeros(len(free), bool)
    for piece in pieces:
        near = np.flatnonzero(_behind(piece, centres, half))
        if len(near):
            cells = np.concatenate([in_block[k] for k in near])
            at = origin + (free[cells, ::-1] + 0.5) * grid.step_m
            gone[cells] |= _behind(piece, at, CELL * grid.step_m, around=AROUND)
    percent[tuple(free[gone].T)] = UNKNOWN


def _blocks(cells: Longs, origin: Floats, step_m: float) -> tuple[Floats, Longs, float]:
    """Centres (b, 3) of blocks of cells, to which of them each cell (n, 3) belongs (n), how far corners lie off [m]."""
    block = cells // EDGE
    shape = tuple(block.max(axis=0, initial=0) + 1)
    number, which = np.unique(np.ravel_multi_index(tuple(block.T), shape), return_inverse=True)
    centres = origin + (np.column_stack(np.unravel_index(number, shape))[:, ::-1] + 0.5) * EDGE * step_m
    return centres, which, 0.5 * np.sqrt(3.0) * EDGE * step_m


def _behind(piece: Piece, places: Floats, slack_m: float, around: float = -1.0) -> Bools:
    """Whether places (n, 3) lie behind a hollow wall, no farther on round it than a cosine, or so much before it."""
    hollow, way, foot = piece
    off = places - hollow.centre
    off -= (off @ hollow.axis)[:, None] * hollow.axis
    away = np.linalg.norm(off, axis=1)
    near = abs((places - foot) @ hollow.axis) < ALONG_M + slack_m
    return np.asarray((hollow.radius_m > 0) & near & (off @ way >= around * away) & (away > hollow.radius_m - slack_m))


def _outside(places: Floats, planes: Floats) -> Floats:
    """How far places (n, 3) lie outside the nearest of a hull's planes (p, 4), less than nothing inside [m]."""
    out = np.full(len(places), -np.inf)
    for first in range(0, len(places), AT_ONCE):
        some = slice(first, first + AT_ONCE)
        out[some] = (places[some] @ planes[:, :3].T + planes[:, 3]).max(axis=1)
    return out
