"""One look of the full-profile mapper: which blocks it says something of, and what it says.

A look goes from coarse to fine, so that far and near cost alike: blocks and then parts of four cells a side are passed
over, or found silent, whole; only parts on the border of silence and near echoes are taken cell by cell.
"""

from __future__ import annotations

import math

import numpy as np

from ullage.kernels.loops import inner, loop
from ullage.kernels.occupancy import CLEAR_SIDES, EMPTY, Pools, bit_count, cell_index, side_of, take_block
from ullage.kernels.occupancy_reach import Beam

PART = 4
NOTHING, WHOLE, PARTLY, ARC = 0, 1, 2, 4


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
    rows, count = np.empty((extent[0] * extent[1] * extent[2], 4), np.int32), 0
    half = 0.5 * edge * step
    radius = half * (1.4143 if flat else 1.7321)
    for bz in range(first[2], last[2]):
        dz = 0.0 if flat else pools.origin[2] + bz * edge * step + half - beam.eye[2]
        for by in range(first[1], last[1]):
            dy = pools.origin[1] + by * edge * step + half - beam.eye[1]
            for bx in range(first[0], last[0]):
                dx = pools.origin[0] + bx * edge * step + half - beam.eye[0]
                verdict = _judge(dx, dy, dz, radius, step, farthest, beam, False)
                slot = pools.slots[bz, by, bx]
                if verdict == WHOLE:
                    way = side_of(-dx, -dy, -dz, flat)
                    pools.common[bz, by, bx] |= np.uint16(1 << way)
                    if slot != EMPTY and pools.loud[slot]:
                        _soften(pools, slot, way)
                    continue
                if verdict & PARTLY and (bx + by + bz + turn) % stride and (slot == EMPTY or not pools.loud[slot]):
                    verdict &= ARC
                if slot == EMPTY and bit_count(pools.common[bz, by, bx]) >= CLEAR_SIDES:
                    verdict &= ARC if len(beam.arcs) and beam.arcs[0, 8] > 0 else NOTHING
                if verdict & (PARTLY | ARC):
                    rows[count, 0], rows[count, 1], rows[count, 2], rows[count, 3] = bz, by, bx, verdict
                    count += 1
    return rows[:count]


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
    half = 0.5 * PART * step
    radius = half * (1.4143 if flat else 1.7321)
    candidates = 0
    corner = np.zeros(3, np.int64)
    for row in range(len(rows)):
        bz, by, bx, wanted = rows[row, 0], rows[row, 1], rows[row, 2], rows[row, 3]
        for pz in range(0, 1 if flat else edge, PART):
            corner[2] = bz * edge + pz if not flat else 0
            dz = 0.0 if flat else pools.origin[2] + corner[2] * step + half - beam.eye[2]
            for py in range(0, edge, PART):
                corner[1] = by * edge + py
                dy = pools.origin[1] + corner[1] * step + half - beam.eye[1]
                for px in range(0, edge, PART):
                    corner[0] = bx * edge + px
                    dx = pools.origin[0] + corner[0] * step + half - beam.eye[0]
                    verdict = _judge(dx, dy, dz, radius, step, farthest, beam, not flat) & (
                        wanted | (WHOLE if wanted & PARTLY else 0)
                    )
                    if verdict == NOTHING:
                        continue
                    slot = pools.slots[bz, by, bx]
                    if slot == EMPTY:
                        if verdict & ARC == 0 and bit_count(pools.common[bz, by, bx]) >= CLEAR_SIDES:
                            continue
                        slot = take_block(pools, bz, by, bx)
                    if verdict == WHOLE:
                        _silence_part(pools, slot, corner, edge, side_of(-dx, -dy, -dz, flat))
                        continue
                    common = pools.common[bz, by, bx]
                    candidates = _hear_cells(
                        pools, step, edge, beam, farthest, slot, common, corner, verdict, found, chance, candidates
                    )
    return candidates


@inner(fastmath=True)
def _judge(dx: float, dy: float, dz: float, radius: float, step: float, farthest: float, beam: Beam, fine: bool) -> int:
    """What the look says of a ball around a point given from the eye: NOTHING, WHOLE silent, PARTLY, ARC or both.

    A `fine` one on the border of the beam, or of what it reaches, goes by its middle.
    """
    middle = math.sqrt(dx * dx + dy * dy + dz * dz)
    if middle - radius > farthest or middle + radius < beam.near:
        return NOTHING
    axes, arcs = beam.axes, beam.arcs
    fore = dx * axes[0, 0] + dy * axes[1, 0] + dz * axes[2, 0]
    across = math.sqrt(max(middle * middle - fore * fore, 0.0))
    least, most = _reach_of(dx, dy, dz, fore, radius, beam)
    if across * beam.hit[0] - fore * beam.hit[1] > radius or middle - radius > most + 0.5 * step:
        return NOTHING
    verdict = NOTHING
    for k in range(len(arcs)):
        if abs(middle - arcs[k, 0]) < radius + 2.5 * arcs[k, 1]:
            cosine = (dx * arcs[k, 2] + dy * arcs[k, 3] + dz * arcs[k, 4]) / middle
            if abs(cosine - arcs[k, 5]) < 3.0 * arcs[k, 6] + radius / max(middle - radius, 1e-3):
                verdict = ARC
                break
    bins = len(beam.quiet) - 1
    first = int((max(middle - radius, beam.start) - beam.start) / beam.bin_m + 0.5)
    last = min(int((max(middle + radius, beam.start) - beam.start) / beam.bin_m + 0.5), bins - 1)
    silent = beam.quiet[last + 1] - beam.quiet[min(first, bins)]
    outside = across * beam.free[0] - fore * beam.free[1]
    if silent == 0 or outside > radius:
        return verdict
    if silent < last + 1 - first or verdict != NOTHING or middle < 2.0 * radius:
        return verdict | PARTLY
    inside = beam.near + radius < middle < farthest - radius
    if fine:
        return (
            WHOLE if inside and outside < 0.0 and middle + 0.5 * radius < _reach_at(dx, dy, dz, fore, beam) else NOTHING
        )
    return WHOLE if inside and outside < -radius and middle + radius < least else PARTLY


@inner(fastmath=True)
def _reach_of(dx: float, dy: float, dz: float, fore: float, radius: float, beam: Beam) -> tuple[float, float]:
    """How far silence counts at least, and echoes at most, in the sectors that the ball lies in."""
    up, left = beam.reach.shape
    if fore < 1.2 * radius:
        return 0.0, 1e9
    axes = beam.axes
    y = (dx * axes[0, 1] + dy * axes[1, 1] + dz * axes[2, 1]) / fore
    z = (dx * axes[0, 2] + dy * axes[1, 2] + dz * axes[2, 2]) / fore
    wide_y = radius * math.sqrt(1.0 + y * y) / (fore - radius)
    wide_z = radius * math.sqrt(1.0 + z * z) / (fore - radius)
    a0 = max(int(((y - wide_y) / beam.tangent + 1.0) * 0.5 * left), 0)
    a1 = min(int(((y + wide_y) / beam.tangent + 1.0) * 0.5 * left), left - 1)
    e0 = max(int(((z - wide_z) / beam.tangent + 1.0) * 0.5 * up), 0) if up > 1 else 0
    e1 = min(int(((z + wide_z) / beam.tangent + 1.0) * 0.5 * up), up - 1) if up > 1 else 0
    least, most = 1e9, 0.0
    for e in range(e0, e1 + 1):
        for a in range(a0, a1 + 1):
            least, most = min(least, beam.hush[e, a]), max(most, beam.reach[e, a])
    return least, most


@inner(fastmath=True)
def _reach_at(dx: float, dy: float, dz: float, fore: float, beam: Beam) -> float:
    up, left = beam.reach.shape
    y = (dx * beam.axes[0, 1] + dy * beam.axes[1, 1] + dz * beam.axes[2, 1]) / (fore * beam.tangent)
    z = (dx * beam.axes[0, 2] + dy * beam.axes[1, 2] + dz * beam.axes[2, 2]) / (fore * beam.tangent)
    a, e = int((y + 1.0) * 0.5 * left), int((z + 1.0) * 0.5 * up) if up > 1 else 0
    return float(beam.hush[e, a]) if 0 <= a < left and 0 <= e < up else 0.0


@inner()
def _soften(pools: Pools, slot: int, way: int) -> None:
    """Silence takes back a little of what echoes from the same direction said."""
    for cell in range(pools.hits.shape[1]):
        if pools.facing[slot, cell] == way:
            pools.hits[slot, cell] = max(pools.hits[slot, cell] - 4, 0)


@inner()
def _silence_part(pools: Pools, slot: int, corner: np.ndarray, edge: int, way: int) -> None:
    bit = np.uint16(1 << way)
    size = pools.size
    for iz in range(corner[2], min(corner[2] + PART, size[2])):
        for iy in range(corner[1], min(corner[1] + PART, size[1])):
            for ix in range(corner[0], min(corner[0] + PART, size[0])):
                cell = cell_index(ix, iy, iz, edge, size[2])
                pools.silent[slot, cell] |= bit
                if pools.facing[slot, cell] == way:
                    pools.hits[slot, cell] = max(pools.hits[slot, cell] - 4, 0)


@inner(fastmath=True)
def _hear_cells(
    pools: Pools,
    step: float,
    edge: int,
    beam: Beam,
    farthest: float,
    slot: int,
    common: int,
    corner: np.ndarray,
    verdict: int,
    found: np.ndarray,
    chance: np.ndarray,
    candidates: int,
) -> int:
    """The cells of one part, one by one."""
    up, left = beam.reach.shape
    axes, arcs, size, origin, eye = beam.axes, beam.arcs, pools.size, pools.origin, beam.eye
    flat = size[2] == 1
    cos_hit, cos_free, per_bin = beam.hit[0], beam.free[0], 1.0 / beam.bin_m
    wide, high = 0.5 * left / beam.tangent, 0.5 * up / beam.tangent
    for iz in range(corner[2], min(corner[2] + PART, size[2])):
        dz = 0.0 if flat else origin[2] + (iz + 0.5) * step - eye[2]
        for iy in range(corner[1], min(corner[1] + PART, size[1])):
            dy = origin[1] + (iy + 0.5) * step - eye[1]
            for ix in range(corner[0], min(corner[0] + PART, size[0])):
                dx = origin[0] + (ix + 0.5) * step - eye[0]
                r = math.sqrt(dx * dx + dy * dy + dz * dz)
                fore = dx * axes[0, 0] + dy * axes[1, 0] + dz * axes[2, 0]
                b = int((r - beam.start) * per_bin + 0.5)
                if r < beam.near or r > farthest or fore < cos_hit * r or b < 0 or b >= len(beam.quiet) - 1:
                    continue
                silent = beam.quiet[b + 1] > beam.quiet[b]
                if (silent and (verdict & PARTLY == 0 or fore < cos_free * r)) or (not silent and verdict & ARC == 0):
                    continue
                ahead = 1.0 / fore
                side = dx * axes[0, 1] + dy * axes[1, 1] + dz * axes[2, 1]
                rise = dx * axes[0, 2] + dy * axes[1, 2] + dz * axes[2, 2]
                a = int(side * ahead * wide + 0.5 * left)
                e = int(rise * ahead * high + 0.5 * up) if up > 1 else 0
                if a < 0 or e < 0 or a >= left or e >= up:
                    continue
                if r > (beam.hush[e, a] if silent else beam.reach[e, a]) + 0.5 * step:
                    continue
                cell = cell_index(ix, iy, iz, edge, size[2])
                if silent:
                    way = side_of(-dx, -dy, -dz, flat)
                    if pools.facing[slot, cell] == way:
                        pools.hits[slot, cell] = max(pools.hits[slot, cell] - 4, 0)
                    pools.silent[slot, cell] |= np.uint16(1 << way)
                    continue
                for k in range(len(arcs)):
                    miss = (r - arcs[k, 0]) / arcs[k, 1]
                    if miss > 2.5 or miss < -2.5 or candidates >= len(found):
                        continue
                    cosine = (dx * arcs[k, 2] + dy * arcs[k, 3] + dz * arcs[k, 4]) / r
                    turn = (cosine - arcs[k, 5]) / arcs[k, 6]
                    if turn > 3.0 or turn < -3.0:
                        continue
                    found[candidates, 0], found[candidates, 1], found[candidates, 2] = slot, cell, k
                    found[candidates, 3] = side_of(-dx, -dy, -dz, flat)
                    found[candidates, 4] = bit_count(pools.silent[slot, cell] | common)
                    chance[candidates] = arcs[k, 7] * math.exp(-0.5 * (miss * miss + turn * turn))
                    candidates += 1
    return candidates


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
