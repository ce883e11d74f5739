"""What one echo off a smooth surface says: a strip square to the way, its first Fresnel zone, stands there."""

from __future__ import annotations

import math

import numpy as np

from ullage.kernels.loops import loop
from ullage.kernels.occupancy import (
    EMPTY,
    LOUD,
    LOUD_WALL,
    MOST_HITS,
    SCALE,
    WALL_TENTHS,
    Pools,
    cell_index,
    side_of,
    take_block,
)


@loop(fastmath=True)
def lay_strip(
    pools: Pools, step: float, edge: int, foot: np.ndarray, way: np.ndarray, sigma: float, half: float, gain: float
) -> None:
    """Add up to `gain` [nat] to the cells within `half` of the foot square to the way, less the farther off.

    `way` is the unit vector from the sensor to the foot of the perpendicular, level on a plane; `sigma` the doubt in
    range [m]. On a plane a cell that the strip's end cuts takes its share, lest the map hang on how looks fall in
    cells.
    """
    reach = half + 3.0 * sigma + step
    flat = pools.size[2] == 1
    low, high = np.zeros(3, np.int64), np.zeros(3, np.int64)
    for d in range(2 if flat else 3):
        low[d] = max(math.floor((foot[d] - reach - pools.origin[d]) / step), 0)
        high[d] = min(math.floor((foot[d] + reach - pools.origin[d]) / step), pools.size[d] - 1)
    side = side_of(-way[0], -way[1], -way[2], flat)
    for iz in range(low[2], high[2] + 1):
        dz = 0.0 if flat else pools.origin[2] + (iz + 0.5) * step - foot[2]
        for iy in range(low[1], high[1] + 1):
            dy = pools.origin[1] + (iy + 0.5) * step - foot[1]
            for ix in range(low[0], high[0] + 1):
                dx = pools.origin[0] + (ix + 0.5) * step - foot[0]
                off = dx * way[0] + dy * way[1] + dz * way[2]
                deep = off / sigma
                aside = math.sqrt(max(dx * dx + dy * dy + dz * dz - off * off, 0.0))
                share = min((half - aside) / step + 0.5, 1.0) if flat else (1.0 if aside <= half else 0.0)
                if share <= 0.0 or abs(deep) > 2.5:
                    continue
                tenths = int(gain * share * math.exp(-0.5 * deep * deep) * SCALE + 0.5)
                if tenths < 1:
                    continue
                bz, by, bx = 0 if flat else iz // edge, iy // edge, ix // edge
                slot = pools.slots[bz, by, bx]
                if slot == EMPTY:
                    slot = take_block(pools, bz, by, bx)
                cell = cell_index(ix, iy, iz, edge, pools.size[2])
                pools.hits[slot, cell] = min(pools.hits[slot, cell] + tenths, MOST_HITS)
                pools.loud[slot] = max(pools.loud[slot], LOUD_WALL if pools.hits[slot, cell] >= WALL_TENTHS else LOUD)
                pools.facing[slot, cell] = side


@loop(fastmath=True)
def is_clear(pools: Pools, step: float, edge: int, eye: np.ndarray, way: np.ndarray, range_m: float, wall: int) -> bool:
    """Whether no cell of `wall` hits or more lies on the way, but for the last two cells before the range."""
    flat = pools.size[2] == 1
    r = step
    while r < range_m - 2.0 * step:
        ix = math.floor((eye[0] + r * way[0] - pools.origin[0]) / step)
        iy = math.floor((eye[1] + r * way[1] - pools.origin[1]) / step)
        iz = 0 if flat else math.floor((eye[2] + r * way[2] - pools.origin[2]) / step)
        inside = 0 <= ix < pools.size[0] and 0 <= iy < pools.size[1] and 0 <= iz < pools.size[2]
        slot = pools.slots[0 if flat else iz // edge, iy // edge, ix // edge] if inside else EMPTY
        if slot != EMPTY and pools.hits[slot, cell_index(ix, iy, iz, edge, pools.size[2])] >= wall:
            return False
        r += 0.5 * step
    return True
