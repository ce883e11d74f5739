"""One look of the full-profile mapper: which blocks it says something of, and what it says.

A look goes from coarse to fine, so that far and near cost alike: blocks and then parts of four cells a side are passed
over, or found silent, whole; only parts on the border of silence and near echoes are taken cell by cell.
"""

from __future__ import annotations

import math

import numpy as np

from ullage.kernels.loops import core, inner, loop
from ullage.kernels.occupancy import (
    CLEAR_SIDES,
    EMPTY,
    LOUD,
    TORN,
    VAGUE,
    Pools,
    bit_count,
    cell_index,
    side_of,
    take_block,
)
from ullage.kernels.occupancy_reach import Beam
from ullage.kernels.occupancy_verdicts import ARC, NOTHING, PARTLY, WHOLE, columns_of, hear_cell, judge, scales_of

PART = 4


@loop(fastmath=True)
def survey_blocks(
    pools: Pools, step: float, edge: int, beam: Beam, farthest: float, turn: int, stride: int
) -> np.ndarray:
    """Mark the blocks that are silent throughout; rows (bz, by, bx, verdict) of those to be looked at in parts.

    The border of silence moves little from look to look: a block without echoes on it takes its turn every `stride`.
    """
    low, high = _bounds(pools, step, beam, farthest)
    flat = pools.size[2] == 1
    first, last = low // edge, high // edge + 1
    extent = last - first
    most = extent[0] * extent[1] * extent[2]
    rows, at, verdicts = np.empty((most, 4), np.int32), np.empty((most, 3)), np.empty(most, np.int64)
    half, count = 0.5 * edge * step, _middles(pools, edge * step, beam.eye, first, last, rows, at)
    judge(at[:count], half * (1.4143 if flat else 1.7321), step, farthest, beam, False, verdicts)
    located = len(beam.arcs) > 0 and beam.arcs[0, 8] > 0
    kept = 0
    for k in range(count):
        verdict, bz, by, bx = verdicts[k], rows[k, 0], rows[k, 1], rows[k, 2]
        if verdict == NOTHING:
            continue
        slot = pools.slots[bz, by, bx]
        loud = slot != EMPTY and pools.loud[slot] > 0
        if verdict == WHOLE:
            way = side_of(-at[k, 0], -at[k, 1], -at[k, 2], flat)
            pools.common[bz, by, bx] |= np.uint16(1 << way)
            if loud:
                _soften(pools, slot, way)
            continue
        if verdict & PARTLY and (bx + by + bz + turn) % stride and not loud:
            verdict &= ARC
        if slot == EMPTY and bit_count(pools.common[bz, by, bx]) >= CLEAR_SIDES:
            verdict &= ARC if located else NOTHING
        if verdict & (PARTLY | ARC):
            rows[kept, 0], rows[kept, 1], rows[kept, 2], rows[kept, 3] = bz, by, bx, verdict
            kept += 1
    return rows[:kept]


@loop(fastmath=True)
def hear_blocks(
    pools: Pools,
    step: float,
    edge: int,
    beam: Beam,
    farthest: float,
    rows: np.ndarray,
    found: np.ndarray,
    chance: np.ndarray,
) -> int:
    """Mark silence in the parts of these blocks and gather the cells of each arc; returns how many were gathered."""
    flat = pools.size[2] == 1
    half, each = 0.5 * PART * step, (edge // PART) ** (2 if flat else 3)
    parts, at = np.empty((len(rows) * each, 6), np.int64), np.empty((len(rows) * each, 3))
    verdicts, count = np.empty(len(at), np.int64), _part_middles(pools, step, edge, beam.eye, rows, parts, at)
    judge(at, half * (1.4143 if flat else 1.7321), step, farthest, beam, not flat, verdicts)
    kept = 0
    for k in range(count):
        bz, by, bx, wanted = rows[parts[k, 0], 0], rows[parts[k, 0], 1], rows[parts[k, 0], 2], rows[parts[k, 0], 3]
        verdict = verdicts[k] & (wanted | (WHOLE if wanted & PARTLY else 0))
        if verdict == NOTHING:
            continue
        slot = pools.slots[bz, by, bx]
        if slot == EMPTY:
            if verdict & ARC == 0 and bit_count(pools.common[bz, by, bx]) >= CLEAR_SIDES:
                continue
            slot = take_block(pools, bz, by, bx)
        parts[kept, 1], parts[kept, 2], parts[kept, 3] = parts[k, 1], parts[k, 2], parts[k, 3]
        parts[kept, 0], parts[kept, 4], parts[kept, 5] = slot, verdict, pools.common[bz, by, bx]
        if verdict == WHOLE:
            parts[kept, 4] = -1 - side_of(-at[k, 0], -at[k, 1], -at[k, 2], flat)
        kept += 1
    return int(_hear_parts(pools, step, edge, beam, farthest, parts[:kept], found, chance))


@core(fastmath=True)
def _middles(
    pools: Pools, size: float, eye: np.ndarray, first: np.ndarray, last: np.ndarray, rows: np.ndarray, at: np.ndarray
) -> int:
    """Fill `rows` (n, 4: bz, by, bx) and `at` (n, 3: middle from the eye) with a box of blocks; how many there are."""
    flat, half, count = pools.size[2] == 1, 0.5 * size, 0
    for bz in range(first[2], last[2]):
        for by in range(first[1], last[1]):
            for bx in range(first[0], last[0]):
                rows[count, 0], rows[count, 1], rows[count, 2] = bz, by, bx
                at[count, 0] = pools.origin[0] + bx * size + half - eye[0]
                at[count, 1] = pools.origin[1] + by * size + half - eye[1]
                at[count, 2] = 0.0 if flat else pools.origin[2] + bz * size + half - eye[2]
                count += 1
    return count


@core(fastmath=True)
def _part_middles(
    pools: Pools, step: float, edge: int, eye: np.ndarray, rows: np.ndarray, parts: np.ndarray, at: np.ndarray
) -> int:
    """Fill `parts` (n, 6: row, corner z, y, x) and `at` (n, 3: middle from the eye) with those of blocks; how many."""
    flat, half, count = pools.size[2] == 1, 0.5 * PART * step, 0
    for row in range(len(rows)):
        for pz in range(0, 1 if flat else edge, PART):
            for py in range(0, edge, PART):
                for px in range(0, edge, PART):
                    x, y = rows[row, 2] * edge + px, rows[row, 1] * edge + py
                    z = 0 if flat else rows[row, 0] * edge + pz
                    parts[count, 0], parts[count, 1], parts[count, 2], parts[count, 3] = row, z, y, x
                    at[count, 0] = pools.origin[0] + x * step + half - eye[0]
                    at[count, 1] = pools.origin[1] + y * step + half - eye[1]
                    at[count, 2] = 0.0 if flat else pools.origin[2] + z * step + half - eye[2]
                    count += 1
    return count


@core()
def _soften(pools: Pools, slot: int, way: int) -> None:
    """Silence takes back a little of what echoes from the same direction said."""
    for cell in range(pools.hits.shape[1]):
        if pools.facing[slot, cell] == way:
            pools.hits[slot, cell] = max(pools.hits[slot, cell] - 4, 0)


@core(fastmath=True)
def _hear_parts(
    pools: Pools,
    step: float,
    edge: int,
    beam: Beam,
    farthest: float,
    parts: np.ndarray,
    found: np.ndarray,
    chance: np.ndarray,
) -> int:
    """The cells of parts (n, 6: slot, corner z, y, x, verdict or silent side, what the block has in common).

    Returns how many lie on arcs. Where no arc of the look names a place, they are marked at once and none is gathered.
    """
    axes, scales, arcs = columns_of(beam.axes), scales_of(beam), beam.arcs
    ox, oy, oz = pools.origin[0] - beam.eye[0], pools.origin[1] - beam.eye[1], pools.origin[2] - beam.eye[2]
    nx, ny, nz = pools.size[0], pools.size[1], pools.size[2]
    flat, candidates, vague = nz == 1, 0, True
    for k in range(len(arcs)):
        vague = vague and arcs[k, 8] != 1 and arcs[k, 8] != TORN
    for p in range(len(parts)):
        slot, verdict = parts[p, 0], parts[p, 4]
        for iz in range(parts[p, 1], min(parts[p, 1] + PART, nz)):
            dz = 0.0 if flat else oz + (iz + 0.5) * step
            for iy in range(parts[p, 2], min(parts[p, 2] + PART, ny)):
                dy = oy + (iy + 0.5) * step
                for ix in range(parts[p, 3], min(parts[p, 3] + PART, nx)):
                    cell = cell_index(ix, iy, iz, edge, nz)
                    way = -1 - verdict
                    if verdict > 0:
                        dx = ox + (ix + 0.5) * step
                        wanted = verdict & ~ARC if vague and pools.hits[slot, cell] >= VAGUE else verdict
                        r = math.sqrt(dx * dx + dy * dy + dz * dz)
                        said = hear_cell(dx, dy, dz, r, wanted, 0.5 * step, farthest, axes, scales, beam)
                        if said == NOTHING:
                            continue
                        way = side_of(-dx, -dy, -dz, flat)
                        if said == ARC:
                            row = slot, cell, way, parts[p, 5]
                            candidates = _lay_on_arcs(pools, dx, dy, dz, r, vague, row, arcs, candidates, found, chance)
                            continue
                    _hush(pools, slot, cell, way)
    return candidates


@core(fastmath=True, forceinline=True)
def _lay_on_arcs(
    pools: Pools,
    dx: float,
    dy: float,
    dz: float,
    r: float,
    vague: bool,
    row: tuple[int, int, int, int],
    arcs: np.ndarray,
    candidates: int,
    found: np.ndarray,
    chance: np.ndarray,
) -> int:
    """Gather a cell, its middle given from the eye, for each arc that passes it; returns how many are gathered by now.

    Its `row` is slot, cell, direction, and what its block has in common. Where arcs are `vague`, it is marked at once.
    """
    slot, cell, way, common = row
    for k in range(len(arcs)):
        miss = (r - arcs[k, 0]) / arcs[k, 1]
        if miss > 2.5 or miss < -2.5:
            continue
        cosine = (dx * arcs[k, 2] + dy * arcs[k, 3] + dz * arcs[k, 4]) / r
        turn = (cosine - arcs[k, 5]) / arcs[k, 6]
        if turn > 3.0 or turn < -3.0:
            continue
        if vague:
            if pools.hits[slot, cell] < VAGUE:
                pools.hits[slot, cell] += 1
                pools.loud[slot] = max(pools.loud[slot], LOUD)
        elif candidates < len(found):
            found[candidates, 0], found[candidates, 1], found[candidates, 2] = slot, cell, k
            found[candidates, 3] = way
            found[candidates, 4] = bit_count(pools.silent[slot, cell] | common)
            chance[candidates] = arcs[k, 7] * math.exp(-0.5 * (miss * miss + turn * turn))
            candidates += 1
    return candidates


@core(forceinline=True)
def _hush(pools: Pools, slot: int, cell: int, way: int) -> None:
    """Mark a cell silent from a direction, which takes back a little of what echoes from there said."""
    if pools.facing[slot, cell] == way:
        pools.hits[slot, cell] = max(pools.hits[slot, cell] - 4, 0)
    pools.silent[slot, cell] |= np.uint16(1 << way)


@inner(fastmath=True)
def _bounds(pools: Pools, step: float, beam: Beam, far: float) -> tuple[np.ndarray, np.ndarray]:
    """First and last cell of the box around the cone, along x, y, z."""
    low, high = np.zeros(3, np.int64), np.zeros(3, np.int64)
    half = math.acos(beam.hit[0])
    for d in range(3):
        lean = math.acos(min(max(beam.axes[d, 0], -1.0), 1.0))
        top = far * math.cos(max(lean - half, 0.0))
        bottom = far * math.cos(min(lean + half, math.pi))
        a = math.floor((beam.eye[d] + min(bottom, 0.0) - pools.origin[d]) / step)
        b = math.floor((beam.eye[d] + max(top, 0.0) - pools.origin[d]) / step)
        low[d], high[d] = min(max(a, 0), pools.size[d] - 1), min(max(b, 0), pools.size[d] - 1)
    if pools.size[2] == 1:
        low[2], high[2] = 0, 0
    return low, high
