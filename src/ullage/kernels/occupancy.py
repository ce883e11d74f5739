"""The full-profile mapper's update of cells in blocks.

Blocks have `edge` cells a side; `slots` holds for each its place in the pools, EMPTY, or CLEAR for one that is free
throughout. A cell has `hits`, log-odds gained from echoes in tenths; `silent`, one bit for each of 16 directions from
which it was looked at without an echo; and `facing`, the direction of its last echo.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

EMPTY, CLEAR = -1, -2
SCALE = 10.0
MOST_HITS = 120
FULL = 0xFFFF
NOWHERE = 255


@njit(cache=True, fastmath=True)
def cast_reach(
    slots: np.ndarray,
    hits: np.ndarray,
    silent: np.ndarray,
    origin: np.ndarray,
    step: float,
    edge: int,
    size: np.ndarray,
    position: np.ndarray,
    axes: np.ndarray,
    tangent: float,
    far: float,
    wall: int,
    haze: float,
    reach: np.ndarray,
) -> None:
    """How far each sector (ne, na) of the beam sees: to the first cell held occupied, or into so much unknown."""
    up, left = reach.shape
    for e in range(up):
        for a in range(left):
            y = (2.0 * (a + 0.5) / left - 1.0) * tangent
            z = (2.0 * (e + 0.5) / up - 1.0) * tangent if up > 1 else 0.0
            scale = 1.0 / math.sqrt(1.0 + y * y + z * z)
            dx = (axes[0, 0] + y * axes[0, 1] + z * axes[0, 2]) * scale
            dy = (axes[1, 0] + y * axes[1, 1] + z * axes[1, 2]) * scale
            dz = (axes[2, 0] + y * axes[2, 1] + z * axes[2, 2]) * scale
            if size[2] == 1:
                flat = math.sqrt(dx * dx + dy * dy)
                dx, dy, dz = dx / flat, dy / flat, 0.0
            fog, r = 0.0, 0.0
            while r < far and fog < 1.0:
                r += step
                ix = int((position[0] + r * dx - origin[0]) / step)
                iy = int((position[1] + r * dy - origin[1]) / step)
                iz = int((position[2] + r * dz - origin[2]) / step) if size[2] > 1 else 0
                if ix < 0 or iy < 0 or iz < 0 or ix >= size[0] or iy >= size[1] or iz >= size[2]:
                    break
                slot = slots[iz // edge, iy // edge, ix // edge]
                if slot == CLEAR:
                    continue
                if slot == EMPTY:
                    fog += haze
                    continue
                cell = cell_index(ix, iy, iz, edge, size[2])
                if hits[slot, cell] >= wall:
                    break
                if bit_count(silent[slot, cell]) < 3:
                    fog += haze
            reach[e, a] = r


@njit(cache=True)
def cell_index(ix: int, iy: int, iz: int, edge: int, tall: int) -> int:
    """Place of a cell in its block."""
    flat = (iy % edge) * edge + ix % edge
    return flat if tall == 1 else (iz % edge) * edge * edge + flat


@njit(cache=True)
def bit_count(mask: int) -> int:
    """Number of bits set."""
    count = 0
    while mask:
        mask &= mask - 1
        count += 1
    return count


@njit(cache=True, fastmath=True)
def _side(dx: float, dy: float, dz: float, flat: bool) -> int:
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


@njit(cache=True, fastmath=True)
def update_cells(
    slots: np.ndarray,
    free_slots: np.ndarray,
    free_count: np.ndarray,
    hits: np.ndarray,
    silent: np.ndarray,
    facing: np.ndarray,
    origin: np.ndarray,
    step: float,
    edge: int,
    size: np.ndarray,
    position: np.ndarray,
    axes: np.ndarray,
    cos_hit: float,
    cos_free: float,
    tangent: float,
    reach: np.ndarray,
    quiet: np.ndarray,
    start: float,
    bin_m: float,
    near: float,
    far: float,
    arcs: np.ndarray,
    free_nats: np.ndarray,
    prior: float,
    found: np.ndarray,
    chance: np.ndarray,
    box: np.ndarray,
) -> int:
    """One look: mark silence, gather the cells of each arc, then share each echo among its cells.

    Rows of `arcs`: range, sigma, track direction (3), cosine, its sigma, chance of detection, 1 with a bearing, chance
    that nothing on the arc made the echo.
    Returns the number of candidate cells, capped by the room in `found`.
    """
    up, left = reach.shape
    flat = size[2] == 1
    reach_most = 0.0
    for e in range(up):
        for a in range(left):
            reach_most = max(reach_most, reach[e, a])
    farthest = min(far, reach_most + step)
    candidates = 0
    low, high = np.zeros(3, np.int64), np.zeros(3, np.int64)
    _bounds(position, axes, farthest, cos_hit, origin, step, size, low, high)
    for d in range(3):
        box[d, 0], box[d, 1] = low[d], high[d] + 1
    half = 0.5 * edge * step
    radius = half * (1.4143 if flat else 1.7321)
    for bz in range(low[2] // edge, high[2] // edge + 1):
        for by in range(low[1] // edge, high[1] // edge + 1):
            for bx in range(low[0] // edge, high[0] // edge + 1):
                cx = origin[0] + (bx * edge) * step + half - position[0]
                cy = origin[1] + (by * edge) * step + half - position[1]
                cz = 0.0 if flat else origin[2] + (bz * edge) * step + half - position[2]
                middle = math.sqrt(cx * cx + cy * cy + cz * cz)
                if middle - radius > farthest:
                    continue
                ahead = cx * axes[0, 0] + cy * axes[1, 0] + cz * axes[2, 0]
                if ahead < cos_hit * middle - radius * 1.2:
                    continue
                slot = slots[bz, by, bx]
                if slot == CLEAR and not _near_arc(middle, radius, arcs):
                    continue
                for iz in range(bz * edge, min((bz + 1) * edge, size[2])):
                    dz = 0.0 if flat else origin[2] + (iz + 0.5) * step - position[2]
                    for iy in range(by * edge, min((by + 1) * edge, size[1])):
                        dy = origin[1] + (iy + 0.5) * step - position[1]
                        for ix in range(bx * edge, min((bx + 1) * edge, size[0])):
                            dx = origin[0] + (ix + 0.5) * step - position[0]
                            r2 = dx * dx + dy * dy + dz * dz
                            if r2 < near * near or r2 > farthest * farthest:
                                continue
                            fore = dx * axes[0, 0] + dy * axes[1, 0] + dz * axes[2, 0]
                            r = math.sqrt(r2)
                            if fore < cos_hit * r:
                                continue
                            side = dx * axes[0, 1] + dy * axes[1, 1] + dz * axes[2, 1]
                            rise = dx * axes[0, 2] + dy * axes[1, 2] + dz * axes[2, 2]
                            a = int((side / (fore * tangent) + 1.0) * 0.5 * left)
                            e = int((rise / (fore * tangent) + 1.0) * 0.5 * up) if up > 1 else 0
                            if a < 0 or e < 0 or a >= left or e >= up or r > reach[e, a] + 0.5 * step:
                                continue
                            b = int((r - start) / bin_m + 0.5)
                            if b < 0 or b >= len(quiet):
                                continue
                            cell = cell_index(ix, iy, iz, edge, size[2])
                            if quiet[b]:
                                if fore < cos_free * r or slot == CLEAR:
                                    continue
                                if slot == EMPTY:
                                    slot = _take(slots, free_slots, free_count, hits, silent, facing, bz, by, bx)
                                way = _side(-dx, -dy, -dz, flat)
                                if facing[slot, cell] == way:
                                    hits[slot, cell] = max(hits[slot, cell] - 4, 0)
                                silent[slot, cell] |= np.uint16(1 << way)
                                continue
                            for k in range(len(arcs)):
                                miss = (r - arcs[k, 0]) / arcs[k, 1]
                                if miss > 2.5 or miss < -2.5:
                                    continue
                                cosine = (dx * arcs[k, 2] + dy * arcs[k, 3] + dz * arcs[k, 4]) / r
                                turn = (cosine - arcs[k, 5]) / arcs[k, 6]
                                if turn > 3.0 or turn < -3.0 or candidates >= len(found):
                                    continue
                                if slot < 0:
                                    slot = _take(slots, free_slots, free_count, hits, silent, facing, bz, by, bx)
                                found[candidates, 0], found[candidates, 1] = slot, cell
                                found[candidates, 2] = k
                                found[candidates, 3] = _side(-dx, -dy, -dz, flat)
                                chance[candidates] = arcs[k, 7] * math.exp(-0.5 * (miss * miss + turn * turn))
                                candidates += 1
    _share(arcs, found, chance, candidates, hits, silent, facing, free_nats, prior)
    return candidates


@njit(cache=True)
def _near_arc(middle: float, radius: float, arcs: np.ndarray) -> bool:
    for k in range(len(arcs)):  # noqa: SIM110 - numba wants the loop
        if arcs[k, 8] > 0 and abs(middle - arcs[k, 0]) < radius + 2.5 * arcs[k, 1]:
            return True
    return False


@njit(cache=True)
def _take(
    slots: np.ndarray,
    free_slots: np.ndarray,
    free_count: np.ndarray,
    hits: np.ndarray,
    silent: np.ndarray,
    facing: np.ndarray,
    bz: int,
    by: int,
    bx: int,
) -> int:
    """Give the block a place in the pools, unknown or clear throughout as it was."""
    free_count[0] -= 1
    slot = free_slots[free_count[0]]
    hits[slot, :] = 0
    silent[slot, :] = FULL if slots[bz, by, bx] == CLEAR else 0
    facing[slot, :] = NOWHERE
    slots[bz, by, bx] = slot
    return int(slot)


@njit(cache=True, fastmath=True)
def _bounds(
    position: np.ndarray,
    axes: np.ndarray,
    far: float,
    cos_half: float,
    origin: np.ndarray,
    step: float,
    size: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> None:
    """First and last cell of the box around the cone, along x, y, z."""
    half = math.acos(cos_half)
    for d in range(3):
        lean = math.acos(min(max(axes[d, 0], -1.0), 1.0))
        top = far * math.cos(max(lean - half, 0.0))
        bottom = far * math.cos(min(lean + half, math.pi))
        a = math.floor((position[d] + min(bottom, 0.0) - origin[d]) / step)
        b = math.floor((position[d] + max(top, 0.0) - origin[d]) / step)
        low[d], high[d] = min(max(a, 0), size[d] - 1), min(max(b, 0), size[d] - 1)
    if size[2] == 1:
        low[2], high[2] = 0, 0


@njit(cache=True, fastmath=True)
def _share(
    arcs: np.ndarray,
    found: np.ndarray,
    chance: np.ndarray,
    candidates: int,
    hits: np.ndarray,
    silent: np.ndarray,
    facing: np.ndarray,
    free_nats: np.ndarray,
    prior: float,
) -> None:
    """At least one cell of each arc made its echo: the gain of a cell falls with what explains the echo already."""
    none = np.log(1.0 - arcs[:, 9])
    held = np.empty(candidates)
    for i in range(candidates):
        slot, cell = found[i, 0], found[i, 1]
        odds = prior + hits[slot, cell] / SCALE - free_nats[bit_count(silent[slot, cell])]
        held[i] = 1.0 / (1.0 + math.exp(-odds))
        none[found[i, 2]] += math.log(1.0 - chance[i] * held[i])
    for i in range(candidates):
        slot, cell, k = found[i, 0], found[i, 1], found[i, 2]
        others = math.exp(none[k]) / (1.0 - chance[i] * held[i])
        gain = math.log((1.0 - (1.0 - chance[i]) * others) / (1.0 - others))
        tenths = int(gain * SCALE + 0.5)
        if arcs[k, 8] == 0:
            tenths = 1 if hits[slot, cell] < 3 else 0
        if tenths > 0:
            hits[slot, cell] = min(hits[slot, cell] + tenths, MOST_HITS)
            if arcs[k, 8] > 0 and tenths >= 5:
                facing[slot, cell] = found[i, 3]


@njit(cache=True)
def collapse_clear(
    slots: np.ndarray,
    free_slots: np.ndarray,
    free_count: np.ndarray,
    hits: np.ndarray,
    silent: np.ndarray,
    enough: int,
) -> int:
    """Turn blocks that are free throughout into one value each; returns how many."""
    done = 0
    for bz in range(slots.shape[0]):
        for by in range(slots.shape[1]):
            for bx in range(slots.shape[2]):
                slot = slots[bz, by, bx]
                if slot < 0:
                    continue
                clear = True
                for cell in range(hits.shape[1]):
                    if hits[slot, cell] > 0 or bit_count(silent[slot, cell]) < enough:
                        clear = False
                        break
                if clear:
                    slots[bz, by, bx] = CLEAR
                    free_slots[free_count[0]] = slot
                    free_count[0] += 1
                    done += 1
    return done


@njit(cache=True)
def mark_flown(
    slots: np.ndarray,
    free_slots: np.ndarray,
    free_count: np.ndarray,
    hits: np.ndarray,
    silent: np.ndarray,
    facing: np.ndarray,
    origin: np.ndarray,
    step: float,
    edge: int,
    size: np.ndarray,
    position: np.ndarray,
    radius: float,
) -> None:
    """Where the drone was, nothing stands."""
    reach = int(radius / step) + 1
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
                if dx * dx + dy * dy + dz * dz > radius * radius:
                    continue
                bz, by, bx = iz // edge, iy // edge, ix // edge
                if slots[bz, by, bx] == CLEAR:
                    continue
                slot = slots[bz, by, bx]
                if slot == EMPTY:
                    slot = _take(slots, free_slots, free_count, hits, silent, facing, bz, by, bx)
                cell = cell_index(ix, iy, iz, edge, size[2])
                silent[slot, cell] = FULL
                hits[slot, cell] = 0
