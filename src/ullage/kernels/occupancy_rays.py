"""Rays of a sensor that measures one direction at a time, as a lidar does, into the full-profile mapper's blocks."""

from __future__ import annotations

import math

import numpy as np

from ullage.kernels.loops import loop
from ullage.kernels.occupancy import EMPTY, LOUD_WALL, MOST_HITS, Pools, cell_index, side_of, take_block


@loop()
def insert_rays(pools: Pools, step: float, edge: int, eye: np.ndarray, ends: np.ndarray, gain: int) -> None:
    """Mark the cells each ray (n, 3) passes as silent and add `gain` tenths to that where it ends [Amanatides1987]."""
    size, origin, flat = pools.size, pools.origin, pools.size[2] == 1
    at, last, turn = np.empty(3, np.int64), np.empty(3, np.int64), np.empty(3, np.int64)
    due, pace = np.empty(3), np.empty(3)
    shift = round(math.log2(edge))
    for n in range(len(ends)):
        for d in range(3):
            way = 0.0 if flat and d == 2 else ends[n, d] - eye[d]
            at[d] = 0 if flat and d == 2 else math.floor((eye[d] - origin[d]) / step)
            last[d] = at[d] if way == 0.0 else math.floor((ends[n, d] - origin[d]) / step)
            turn[d] = 1 if way > 0 else -1
            pace[d] = step / abs(way) if way != 0.0 else np.inf
            border = origin[d] + (at[d] + (1 if way > 0 else 0)) * step
            due[d] = (border - eye[d]) / way if way != 0.0 else np.inf
        side = side_of(eye[0] - ends[n, 0], eye[1] - ends[n, 1], eye[2] - ends[n, 2], flat)
        bit = np.uint16(1 << side)
        left = abs(last[0] - at[0]) + abs(last[1] - at[1]) + abs(last[2] - at[2])
        while left >= 0 and 0 <= at[0] < size[0] and 0 <= at[1] < size[1] and 0 <= at[2] < size[2]:
            bz, by, bx = 0 if flat else at[2] >> shift, at[1] >> shift, at[0] >> shift
            slot = pools.slots[bz, by, bx]
            if slot == EMPTY and (left == 0 or pools.common[bz, by, bx] & bit == 0):
                slot = take_block(pools, bz, by, bx)
            if slot != EMPTY:
                cell = cell_index(at[0], at[1], at[2], edge, size[2])
                if left == 0:
                    pools.hits[slot, cell] = min(pools.hits[slot, cell] + gain, MOST_HITS)
                    pools.facing[slot, cell], pools.loud[slot] = side, LOUD_WALL
                else:
                    pools.silent[slot, cell] |= bit
            d = 0 if due[0] <= due[1] and due[0] <= due[2] else 1 if due[1] <= due[2] else 2
            at[d] += turn[d]
            due[d] += pace[d]
            left -= 1
