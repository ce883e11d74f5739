"""What one echo off a smooth surface says: a strip square to the way, its first Fresnel zone, stands there."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ullage.kernels.occupancy import EMPTY, MOST_HITS, SCALE, Pools, cell_index, side_of, take_block


@njit(cache=True, fastmath=True)
def lay_strip(
    pools: Pools, step: float, edge: int, foot: np.ndarray, way: np.ndarray, sigma: float, half: float, gain: float
) -> None:
    """Add up to `gain` [nat] to the cells of a plane map within `half` of the foot, less the farther off the strip.

    `way` is the level unit vector from the sensor to the foot of the perpendicular; `sigma` the doubt in range [m].
    """
    reach = half + 3.0 * sigma + step
    low_x = max(math.floor((foot[0] - reach - pools.origin[0]) / step), 0)
    low_y = max(math.floor((foot[1] - reach - pools.origin[1]) / step), 0)
    high_x = min(math.floor((foot[0] + reach - pools.origin[0]) / step), pools.size[0] - 1)
    high_y = min(math.floor((foot[1] + reach - pools.origin[1]) / step), pools.size[1] - 1)
    side = side_of(-way[0], -way[1], 0.0, True)
    for iy in range(low_y, high_y + 1):
        dy = pools.origin[1] + (iy + 0.5) * step - foot[1]
        for ix in range(low_x, high_x + 1):
            dx = pools.origin[0] + (ix + 0.5) * step - foot[0]
            deep = (dx * way[0] + dy * way[1]) / sigma
            if abs(dx * way[1] - dy * way[0]) > half or abs(deep) > 2.5:
                continue
            tenths = int(gain * math.exp(-0.5 * deep * deep) * SCALE + 0.5)
            if tenths < 1:
                continue
            slot = pools.slots[0, iy // edge, ix // edge]
            if slot == EMPTY:
                slot = take_block(pools, 0, iy // edge, ix // edge)
            cell = cell_index(ix, iy, 0, edge, 1)
            pools.loud[slot] = 1
            pools.hits[slot, cell] = min(pools.hits[slot, cell] + tenths, MOST_HITS)
            pools.facing[slot, cell] = side
