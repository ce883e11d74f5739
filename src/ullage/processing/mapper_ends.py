"""Where a wall on a plane may go on unseen: silence that no wall there would have broken frees nothing.

A smooth wall answers only from the foot of the perpendicular. In line with what is known of it, cells that no sensor
has passed are silent whether it goes on there or not, from however many places on one side they were looked at. A bent
wall answers from its own normal at each place, which is not known to the few degrees that matter: between two pieces of
one only a flight through proves a gap.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree

from ullage.arrays import Bools, Floats, Longs
from ullage.grids import UNKNOWN
from ullage.kernels.occupancy import EMPTY
from ullage.processing.blocks import Blocks

WINDOW_M, FARTHEST_M = 0.6, 3.0
LEAST_CELLS, FLAT_CELLS = 4, 0.9  # of a line: how many, and one sigma across it at most
SQUARE_DEG, STRAIGHT_DEG, BENT_DEG = 5.0, 6.0, 30.0


def without_ends(percent: NDArray[np.int8], corner: tuple[int, ...], blocks: Blocks, least: int) -> None:
    """Free cells in line with a wall, as far again as it is known, become unknown unless a sensor has passed them.

    Args:
        percent: the map's known part (y, x), changed in place.
        corner: its first cell.
        blocks: what is known of each cell.
        least: percent from which on a cell is wall.
    """
    solid = np.argwhere(percent >= least)
    if len(solid) < LEAST_CELLS:
        return
    way, on = _lines(solid, WINDOW_M / blocks.grid.step_m)
    wall, most = binary_dilation(percent >= least, np.ones((3, 3), bool)), round(FARTHEST_M / blocks.grid.step_m)
    ends = _ends(wall, solid[on], way[on])
    cells, along = _free(percent, *_onward(wall, *ends, most))
    percent[tuple(cells[~_passed(_silent(blocks, cells + np.array(corner)), along)].T)] = UNKNOWN
    cells, along = _free(percent, *_around(*ends, most))
    percent[tuple(cells[~_silent(blocks, cells + np.array(corner)).all(axis=1)].T)] = UNKNOWN


def _free(percent: NDArray[np.int8], cells: Longs, along: Floats) -> tuple[Longs, Floats]:
    """Those of cells (c, 2), and the ways there, that are on a map and free."""
    inside = np.all((cells >= 0) & (cells < percent.shape), axis=1)
    cells, along = cells[inside], along[inside]
    free = (percent[tuple(cells.T)] >= 0) & (percent[tuple(cells.T)] < 50)
    return cells[free], along[free]


def _lines(solid: Longs, window: float) -> tuple[Floats, Bools]:
    """Of each wall cell (s, 2: y, x) the direction (s, 2) of the line about it, and whether there is one."""
    pairs = cKDTree(solid).query_pairs(window, output_type="ndarray")
    pairs = np.concatenate([pairs, pairs[:, ::-1], np.repeat(np.arange(len(solid))[:, None], 2, axis=1)])
    y, x = (solid[pairs[:, 1]] - solid[pairs[:, 0]]).T
    count = np.bincount(pairs[:, 0])
    my, mx, yy, xx, yx = (np.bincount(pairs[:, 0], v) / count for v in (y, x, y * y, x * x, y * x))
    yy, xx, yx = yy - my * my, xx - mx * mx, yx - my * mx
    turn = 0.5 * np.arctan2(2 * yx, xx - yy)  # of the longer axis, from x to y
    narrow = 0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), yx)
    return np.column_stack([np.sin(turn), np.cos(turn)]), (count >= LEAST_CELLS) & (narrow < FLAT_CELLS**2)


def _ends(wall: Bools, solid: Longs, way: Floats) -> tuple[Longs, Floats]:
    """Where lines of wall cells (s, 2) end (e, 2), and the ways out of them (e, 2)."""
    cells, ways = np.concatenate([solid, solid]), np.concatenate([way, -way])
    end = ~np.all([_at(wall, cells + k * ways) for k in (2, 4, 6, 8)], axis=0)
    return cells[end], ways[end]


def _onward(wall: Bools, last: Longs, on: Floats, most: int) -> tuple[Longs, Floats]:
    """Cells (c, 2) in line with ends (e, 2) of walls, as far on as they run back from there; and the ways there."""
    cells, ways = [np.zeros((0, 2), np.int64)], [np.zeros((0, 2))]
    for k in range(1, most + 1):
        known = _at(wall, last - k * on)
        last, on = last[known], on[known]
        cells.append(np.rint(last + k * on).astype(np.int64))
        ways.append(on)
    return np.concatenate(cells), np.concatenate(ways)


def _around(last: Longs, on: Floats, most: int) -> tuple[Longs, Floats]:
    """Cells (c, 2) of curves from each end (e, 2) of a wall to others that it bends to, and their ways there.

    A round wall goes on so from one known piece to the next. Straight ones and corners are not joined.
    """
    pairs = cKDTree(last).query_pairs(most, output_type="ndarray")
    gap = (last[pairs[:, 1]] - last[pairs[:, 0]]).astype(float)
    apart = np.linalg.norm(gap, axis=1)
    fair = np.cos(np.radians(BENT_DEG)) * apart
    one, other = (on[pairs[:, k]] for k in (0, 1))
    bent = -(one * other).sum(1) < np.cos(np.radians(STRAIGHT_DEG))
    met = (apart > 1) & bent & ((gap * one).sum(1) > fair) & (-(gap * other).sum(1) > fair)
    first, gap, apart = last[pairs[met, 0]], gap[met], apart[met, None]
    start, stop = one[met] * apart, -other[met] * apart
    cells, ways = [np.zeros((0, 2), np.int64)], [np.zeros((0, 2))]
    for t in np.linspace(0, 1, 2 * most + 1)[1:-1]:  # Hermite's cubic
        place = (3 * t**2 - 2 * t**3) * gap + (t**3 - 2 * t**2 + t) * start + (t**3 - t**2) * stop
        way = 6 * (t - t**2) * gap + (3 * t**2 - 4 * t + 1) * start + (3 * t**2 - 2 * t) * stop
        way /= np.linalg.norm(way, axis=1)[:, None]
        for aside in (-1, 0, 1):
            cells.append(np.rint(first + place + aside * way[:, ::-1] * [1, -1]).astype(np.int64))
            ways.append(way)
    return np.concatenate(cells), np.concatenate(ways)


def _at(mask: Bools, places: Floats) -> Bools:
    """What a mask (ny, nx) holds at places (p, 2) in cells; False off it."""
    cells = np.rint(places).astype(np.int64)
    inside = np.all((cells >= 0) & (cells < mask.shape), axis=1)
    inside[inside] = mask[tuple(cells[inside].T)]
    return np.asarray(inside)


def _silent(blocks: Blocks, cells: Longs) -> Bools:
    """From which directions (c, 16) cells (c, 2: y, x) of a plane were silent."""
    pools, edge = blocks.pools, blocks.edge
    y, x = cells.T
    slot = pools.slots[0, y // edge, x // edge]
    held = np.where(slot == EMPTY, 0, pools.silent[slot, (y % edge) * edge + x % edge])
    bits = (held | pools.common[0, y // edge, x // edge])[:, None] >> np.arange(16)
    return np.asarray(bits & 1 == 1)


def _passed(silent: Bools, along: Floats) -> Bools:
    """Whether cells (c) were silent, of the directions (c, 16), on either hand of the normal to a way (c, 2)."""
    onward, across = along @ SIDES.T, np.column_stack([along[:, 1], -along[:, 0]]) @ SIDES.T
    least = -np.sin(np.radians(SQUARE_DEG))
    out = np.zeros(len(silent), bool)
    for face in (across > 0, across < 0):
        fore, aft = (np.any(silent & face & (hand > least), axis=1) for hand in (onward, -onward))
        out |= fore & aft
    return out


def _sides() -> Floats:
    """The middle (16, 2: y, x) of each direction of `side_of` on a plane, which counts along a square on its corner."""
    turn = (np.arange(16) + 0.5) / 4.0
    middle = np.column_stack([1.0 - abs((turn + 1.0) % 4.0 - 2.0), abs(turn - 2.0) - 1.0])
    return np.asarray(middle / np.linalg.norm(middle, axis=1)[:, None])


SIDES = _sides()
