"""What the full-profile mapper keeps of each cell, in blocks, and what flight and echoes do to it.

Blocks have `edge` cells a side, a power of two. `common` holds for each block one bit for each of 16 directions from
which all of it was looked at without an echo; `slots` its place in the pools, or EMPTY where that one number says all.
A cell there has `hits`, log-odds gained from echoes in tenths; `silent`, directions as above; and `facing`, the
direction of its last echo.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ullage.kernels.loops import inner, loop

EMPTY = -1
SCALE = 10.0
MOST_HITS = 120
FULL = 0xFFFF
CLEAR_SIDES = 6
TORN, TORN_HITS = 3, 7  # of an arc that two places far apart may have made: neither becomes a wall by it
RING = 2  # of an arc in a volume: its bearing names no place
NOWHERE = 255
WALL_TENTHS = 20  # hits of a cell that is held occupied
VAGUE = 3  # most hits that arcs which name no place give a cell
LOUD, LOUD_WALL = 1, 2


class Pools(NamedTuple):
    """The arrays behind a map in blocks."""

    slots: NDArray[np.int32]  # (bz, by, bx)
    common: NDArray[np.uint16]  # (bz, by, bx)
    hits: NDArray[np.int8]  # (pool, cells of a block)
    silent: NDArray[np.uint16]  # (pool, cells of a block)
    facing: NDArray[np.uint8]  # (pool, cells of a block)
    loud: NDArray[np.uint8]  # (pool) LOUD where a cell has hits, LOUD_WALL where one may be held occupied
    free_slots: NDArray[np.int32]  # stack of places not taken
    free_count: NDArray[np.int64]  # (1)
    size: NDArray[np.int64]  # (3) cells along x, y, z; one along z for a plane
    origin: NDArray[np.float64]  # (3) [m]


@loop()
def cell_index(ix: int, iy: int, iz: int, edge: int, tall: int) -> int:
    """Place of a cell in its block."""
    mask = edge - 1
    flat = (iy & mask) * edge + (ix & mask)
    return flat if tall == 1 else (iz & mask) * edge * edge + flat


@inner()
def bit_count(mask: int) -> int:
    """Number of bits set of 16."""
    mask = mask - ((mask >> 1) & 0x5555)
    mask = (mask & 0x3333) + ((mask >> 2) & 0x3333)
    mask = (mask + (mask >> 4)) & 0x0F0F
    return (mask + (mask >> 8)) & 0x1F


@inner(fastmath=True)
def side_of(dx: float, dy: float, dz: float, flat: bool) -> int:
    """Number 0..15 of the direction: 16 around for a plane; 8 around, 4 above and 4 below for a volume."""
    turn = dy / (abs(dx) + abs(dy) + 1e-12)
    if dx < 0:
        turn = 2.0 - turn
    elif dy < 0:
        turn = 4.0 + turn
    if flat:
        return min(int(turn * 4.0), 15)
    rise = dz / math.sqrt(dx * dx + dy * dy + 1e-12)
    if rise > 0.5:
        return 8 + min(int(turn), 3)
    if rise < -0.5:
        return 12 + min(int(turn), 3)
    return min(int(turn * 2.0), 7)


@inner()
def take_block(pools: Pools, bz: int, by: int, bx: int) -> int:
    """Give the block a place in the pools; what all its cells have in common stays where it is."""
    pools.free_count[0] -= 1
    slot = pools.free_slots[pools.free_count[0]]
    pools.hits[slot, :] = 0
    pools.silent[slot, :] = 0
    pools.facing[slot, :] = NOWHERE
    pools.loud[slot] = 0
    pools.slots[bz, by, bx] = slot
    return int(slot)


@loop(fastmath=True)
def share_echoes(
    pools: Pools,
    arcs: np.ndarray,
    found: np.ndarray,
    chance: np.ndarray,
    candidates: int,
    held_by: np.ndarray,
) -> None:
    """At least one cell of each arc made its echo: the gain of a cell falls with what explains the echo already.

    Rows of `found`: place, cell, arc, direction, silent directions. `held_by` (hits, silent directions) is the chance
    that a cell is occupied.
    """
    hits = pools.hits
    none = np.log(1.0 - arcs[:, 9])
    for i in range(candidates):
        held = held_by[hits[found[i, 0], found[i, 1]], found[i, 4]]
        none[found[i, 2]] += math.log(1.0 - chance[i] * held)
    for k in range(len(none)):
        none[k] = math.exp(none[k])
    for i in range(candidates):
        slot, cell, k = found[i, 0], found[i, 1], found[i, 2]
        if arcs[k, 8] != 1 and arcs[k, 8] != TORN:
            tenths = 1 if hits[slot, cell] < VAGUE else 0
        else:
            others = none[k] / (1.0 - chance[i] * held_by[hits[slot, cell], found[i, 4]])
            tenths = int(math.log((1.0 - (1.0 - chance[i]) * others) / (1.0 - others)) * SCALE + 0.5)
            if arcs[k, 8] == TORN:
                tenths = min(tenths, TORN_HITS - hits[slot, cell])
        if tenths > 0:
            hits[slot, cell] = min(hits[slot, cell] + tenths, MOST_HITS)
            pools.loud[slot] = max(pools.loud[slot], LOUD_WALL if hits[slot, cell] >= WALL_TENTHS else LOUD)
            if arcs[k, 8] == 1 and tenths >= 5:
                pools.facing[slot, cell] = found[i, 3]


@loop()
def collapse_blocks(pools: Pools) -> int:
    """Give back the places of blocks without echoes that are free, or alike, throughout; returns how many."""
    done = 0
    for bz in range(pools.slots.shape[0]):
        for by in range(pools.slots.shape[1]):
            for bx in range(pools.slots.shape[2]):
                slot = pools.slots[bz, by, bx]
                if slot < 0:
                    continue
                common = pools.common[bz, by, bx]
                every, some, least, most = FULL, 0, 16, 0
                for cell in range(pools.hits.shape[1]):
                    mask = pools.silent[slot, cell] | common
                    most = max(most, pools.hits[slot, cell])
                    every, some, least = every & mask, some | mask, min(least, bit_count(mask))
                pools.loud[slot] = LOUD_WALL if most >= WALL_TENTHS else LOUD if most > 0 else 0
                if most == 0 and (least >= CLEAR_SIDES or every == some):
                    pools.common[bz, by, bx] = FULL if least >= CLEAR_SIDES else every
                    pools.slots[bz, by, bx] = EMPTY
                    pools.free_slots[pools.free_count[0]] = slot
                    pools.free_count[0] += 1
                    done += 1
    return done


@loop()
def mark_flown(pools: Pools, step: float, edge: int, position: np.ndarray, radius: float) -> None:
    """Where the drone was, nothing stands."""
    reach = int(radius / step) + 1
    size, origin = pools.size, pools.origin
    centre = np.empty(3, np.int64)
    for d in range(3):
        centre[d] = math.floor((position[d] - origin[d]) / step)
    tall = 0 if size[2] == 1 else reach
    for iz in range(max(centre[2] - tall, 0) if tall else 0, min(centre[2] + tall + 1, size[2]) if tall else 1):
        for iy in range(max(centre[1] - reach, 0), min(centre[1] + reach + 1, size[1])):
            for ix in range(max(centre[0] - reach, 0), min(centre[0] + reach + 1, size[0])):
                dx = origin[0] + (ix + 0.5) * step - position[0]
                dy = origin[1] + (iy + 0.5) * step - position[1]
                dz = origin[2] + (iz + 0.5) * step - position[2] if tall else 0.0
                bz, by, bx = iz // edge, iy // edge, ix // edge
                slot = pools.slots[bz, by, bx]
                inside = dx * dx + dy * dy + dz * dz <= radius * radius
                if not inside or (slot == EMPTY and pools.common[bz, by, bx] == FULL):
                    continue
                if slot == EMPTY:
                    slot = take_block(pools, bz, by, bx)
                cell = cell_index(ix, iy, iz, edge, size[2])
                pools.silent[slot, cell] = FULL
                pools.hits[slot, cell] = 0
