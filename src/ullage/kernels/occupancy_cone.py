"""One look of the full-profile mapper: which blocks it says something of, and what it says.

A look goes from coarse to fine, so that far and near cost alike: blocks and then parts of four cells a side are passed
over, or found silent, whole; only parts on the border of silence and near echoes are taken cell by cell.
"""

from __future__ import annotations

import math

import numpy as np

from ullage.kernels.loops import inner, loop
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
from ullage.kernels.occupancy_reach import Beam, sectors_of

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
    most = extent[0] * extent[1] * extent[2]
    rows, at, verdicts = np.empty((most, 4), np.int32), np.empty((most, 3)), np.empty(most, np.int64)
    half, count = 0.5 * edge * step, 0
    for bz in range(first[2], last[2]):
        for by in range(first[1], last[1]):
            for bx in range(first[0], last[0]):
                rows[count, 0], rows[count, 1], rows[count, 2] = bz, by, bx
                at[count, 0] = pools.origin[0] + bx * edge * step + half - beam.eye[0]
                at[count, 1] = pools.origin[1] + by * edge * step + half - beam.eye[1]
                at[count, 2] = 0.0 if flat else pools.origin[2] + bz * edge * step + half - beam.eye[2]
                count += 1
    _judge(at[:count], half * (1.4143 if flat else 1.7321), step, farthest, beam, False, verdicts)
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
    tall, each = 1 if flat else edge, (edge // PART) ** (2 if flat else 3)
    half = 0.5 * PART * step
    parts, at = np.empty((len(rows) * each, 6), np.int64), np.empty((len(rows) * each, 3))
    verdicts, count = np.empty(len(at), np.int64), 0
    for row in range(len(rows)):
        for pz in range(0, tall, PART):
            for py in range(0, edge, PART):
                for px in range(0, edge, PART):
                    x, y = rows[row, 2] * edge + px, rows[row, 1] * edge + py
                    z = 0 if flat else rows[row, 0] * edge + pz
                    parts[count, 0], parts[count, 1], parts[count, 2], parts[count, 3] = row, z, y, x
                    at[count, 0] = pools.origin[0] + x * step + half - beam.eye[0]
                    at[count, 1] = pools.origin[1] + y * step + half - beam.eye[1]
                    at[count, 2] = 0.0 if flat else pools.origin[2] + z * step + half - beam.eye[2]
                    count += 1
    _judge(at, half * (1.4143 if flat else 1.7321), step, farthest, beam, not flat, verdicts)
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


@inner(fastmath=True)
def _judge(
    at: np.ndarray, radius: float, step: float, farthest: float, beam: Beam, fine: bool, out: np.ndarray
) -> None:
    """What the look says of balls around points (n, 3) from the eye: NOTHING, WHOLE silent, PARTLY, ARC or both.

    A `fine` one on the border of the beam, or of what it reaches, goes by its middle.
    """
    arcs, quiet, reach, hush, tangent = beam.arcs, beam.quiet, beam.reach, beam.hush, beam.tangent
    axes = beam.axes
    ax, ay, az = axes[0, 0], axes[1, 0], axes[2, 0]
    bx, by, bz = axes[0, 1], axes[1, 1], axes[2, 1]
    cx, cy, cz = axes[0, 2], axes[1, 2], axes[2, 2]
    (cos_hit, sin_hit), (cos_free, sin_free) = beam.hit, beam.free
    up, left = reach.shape
    bins, start, per_bin = len(quiet) - 1, beam.start, 1.0 / beam.bin_m
    for i in range(len(at)):
        out[i] = NOTHING
        dx, dy, dz = at[i, 0], at[i, 1], at[i, 2]
        middle = math.sqrt(dx * dx + dy * dy + dz * dz)
        if middle - radius > farthest or middle + radius < beam.near:
            continue
        fore = dx * ax + dy * ay + dz * az
        across = math.sqrt(max(middle * middle - fore * fore, 0.0))
        if across * cos_hit - fore * sin_hit > radius:
            continue
        verdict = NOTHING
        for k in range(len(arcs)):
            if abs(middle - arcs[k, 0]) < radius + 2.5 * arcs[k, 1]:
                cosine = (dx * arcs[k, 2] + dy * arcs[k, 3] + dz * arcs[k, 4]) / middle
                if abs(cosine - arcs[k, 5]) < 3.0 * arcs[k, 6] + radius / max(middle - radius, 1e-3):
                    verdict = ARC
                    break
        first = int((max(middle - radius, start) - start) * per_bin + 0.5)
        last = min(int((max(middle + radius, start) - start) * per_bin + 0.5), bins - 1)
        silent = quiet[last + 1] - quiet[min(first, bins)]
        outside = across * cos_free - fore * sin_free
        heard = silent > 0 and outside <= radius
        if verdict == NOTHING and not heard:
            continue
        side, rise = dx * bx + dy * by + dz * bz, dx * cx + dy * cy + dz * cz
        a0, a1, e0, e1 = sectors_of(side, rise, fore, radius, tangent, left, up)
        least, most = 1e9, 0.0
        if fore < 1.2 * radius:
            least, most = 0.0, 1e9
        else:
            for e in range(e0, e1 + 1):
                for a in range(a0, a1 + 1):
                    least, most = min(least, hush[e, a]), max(most, reach[e, a])
        if middle - radius > most + 0.5 * step:
            continue
        if not heard:
            out[i] = verdict
            continue
        if silent < last + 1 - first or verdict != NOTHING or middle < 2.0 * radius:
            out[i] = verdict | PARTLY
            continue
        inside = beam.near + radius < middle < farthest - radius
        if fine:
            a = int((side / (fore * tangent) + 1.0) * 0.5 * left)
            e = int((rise / (fore * tangent) + 1.0) * 0.5 * up)
            ends = hush[e, a] if 0 <= a < left and 0 <= e < up else 0.0
            out[i] = WHOLE if inside and outside < 0.0 and middle + 0.5 * radius < ends else NOTHING
        else:
            out[i] = WHOLE if inside and outside < -radius and middle + radius < least else PARTLY


@inner()
def _soften(pools: Pools, slot: int, way: int) -> None:
    """Silence takes back a little of what echoes from the same direction said."""
    for cell in range(pools.hits.shape[1]):
        if pools.facing[slot, cell] == way:
            pools.hits[slot, cell] = max(pools.hits[slot, cell] - 4, 0)


@inner(fastmath=True)
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
    slots_hits, silents, facing, loud = pools.hits, pools.silent, pools.facing, pools.loud
    arcs, quiet, reach, hush = beam.arcs, beam.quiet, beam.reach, beam.hush
    axes = beam.axes
    ax, ay, az = axes[0, 0], axes[1, 0], axes[2, 0]
    bx, by, bz = axes[0, 1], axes[1, 1], axes[2, 1]
    cx, cy, cz = axes[0, 2], axes[1, 2], axes[2, 2]
    up, left = reach.shape
    ox, oy, oz = pools.origin[0] - beam.eye[0], pools.origin[1] - beam.eye[1], pools.origin[2] - beam.eye[2]
    nx, ny, nz = pools.size[0], pools.size[1], pools.size[2]
    flat, near, start, per_bin, bins = nz == 1, beam.near, beam.start, 1.0 / beam.bin_m, len(quiet) - 1
    cos_hit, cos_free, wide, high = beam.hit[0], beam.free[0], 0.5 * left / beam.tangent, 0.5 * up / beam.tangent
    candidates, vague = 0, True
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
                        r = math.sqrt(dx * dx + dy * dy + dz * dz)
                        fore = dx * ax + dy * ay + dz * az
                        b = int((r - start) * per_bin + 0.5)
                        if r < near or r > farthest or fore < cos_hit * r or b < 0 or b >= bins:
                            continue
                        silent = quiet[b + 1] > quiet[b]
                        if silent and (verdict & PARTLY == 0 or fore < cos_free * r):
                            continue
                        if not silent and (verdict & ARC == 0 or (vague and slots_hits[slot, cell] >= VAGUE)):
                            continue
                        ahead = 1.0 / fore
                        a = int((dx * bx + dy * by + dz * bz) * ahead * wide + 0.5 * left)
                        e = int((dx * cx + dy * cy + dz * cz) * ahead * high + 0.5 * up) if up > 1 else 0
                        if a < 0 or e < 0 or a >= left or e >= up:
                            continue
                        if r > (hush[e, a] if silent else reach[e, a]) + 0.5 * step:
                            continue
                        way = side_of(-dx, -dy, -dz, flat)
                        if not silent:
                            for k in range(len(arcs)):
                                miss = (r - arcs[k, 0]) / arcs[k, 1]
                                if miss > 2.5 or miss < -2.5:
                                    continue
                                cosine = (dx * arcs[k, 2] + dy * arcs[k, 3] + dz * arcs[k, 4]) / r
                                turn = (cosine - arcs[k, 5]) / arcs[k, 6]
                                if turn > 3.0 or turn < -3.0:
                                    continue
                                if vague:
                                    if slots_hits[slot, cell] < VAGUE:
                                        slots_hits[slot, cell] += 1
                                        loud[slot] = max(loud[slot], LOUD)
                                elif candidates < len(found):
                                    found[candidates, 0], found[candidates, 1], found[candidates, 2] = slot, cell, k
                                    found[candidates, 3] = way
                                    found[candidates, 4] = bit_count(silents[slot, cell] | parts[p, 5])
                                    chance[candidates] = arcs[k, 7] * math.exp(-0.5 * (miss * miss + turn * turn))
                                    candidates += 1
                            continue
                    if facing[slot, cell] == way:
                        slots_hits[slot, cell] = max(slots_hits[slot, cell] - 4, 0)
                    silents[slot, cell] |= np.uint16(1 << way)
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
