"""How far each direction of one look of the full-profile mapper reaches: to what is solid, or hidden, or unknown."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ullage.kernels.loops import inner, loop
from ullage.kernels.occupancy import EMPTY, LOUD_WALL, RING, WALL_TENTHS, Pools, bit_count, cell_index


class Beam(NamedTuple):
    """One look's sensor and what its profile holds."""

    eye: NDArray[np.float64]  # (3) [m]
    axes: NDArray[np.float64]  # (3, 3) world_from_sensor
    reach: NDArray[np.float64]  # (ne, na) how far each sector sees [m]
    hush: NDArray[np.float64]  # (ne, na) how far its silence counts [m]
    tangent: float  # of the sectors' half width
    hit: tuple[float, float]  # cosine and sine of the half angle in which echoes are looked for
    free: tuple[float, float]  # the same in which silence counts
    near: float  # range that says nothing [m]
    far: float  # of the last bin [m]
    start: float  # of the first bin [m]
    bin_m: float
    quiet: NDArray[np.int64]  # (b + 1) quiet bins before each
    arcs: NDArray[np.float64]  # (k, 10) range, sigma, track (3), cosine, its sigma, detection, has bearing, false


@loop(fastmath=True)
def cast_reach(
    pools: Pools,
    step: float,
    edge: int,
    beam: Beam,
    ways: np.ndarray,
    walls: np.ndarray,
    sure: int,
    haze: float,
) -> float:
    """How far each sector sees: to the first cell held occupied, into so much unknown, or to an echo's own shade.

    Nothing is learned behind an echo of known bearing, even before the map holds it. Rows of `ways` (m, 5): direction
    and range of a surface square to it, and the cosine of the angle to which it shades. Rows of `walls` (p, 8): normal
    and distance of flat surfaces, centre and radius of where they stand; nothing is learned of them, nor behind. Those
    from `sure` on are only possible: they end silence, but not echoes. Returns the farthest.
    """
    way = _sector_ways(beam, pools.size[2] == 1)
    limit, hush = np.empty(way.shape[1]), np.empty(way.shape[1])
    limit[:], hush[:] = beam.far, beam.far
    _stop_at_echoes(way, beam, ways, 2.0 * step, limit, hush)
    _stop_at_walls(way, beam, walls, sure, step, limit, hush)
    asked = 0.0
    for arc in beam.arcs:
        asked = max(asked, arc[0] + 2.5 * arc[1] + step)
    need = np.empty(len(limit))
    for k in range(len(limit)):
        need[k] = min(max(asked, hush[k]), limit[k])  # farther off, neither an echo nor silence is looked for
    seen = need.copy()
    _march(pools, step, edge, beam.eye, way, _first_walls(pools, step, edge, beam), haze, seen)
    left, farthest = beam.reach.shape[1], 0.0
    for k in range(len(limit)):
        r = limit[k] if seen[k] >= need[k] else seen[k]
        beam.reach[k // left, k % left], beam.hush[k // left, k % left] = r, min(r, hush[k])
        farthest = max(farthest, r)
    return farthest


@inner(fastmath=True)
def _first_walls(pools: Pools, step: float, edge: int, beam: Beam) -> np.ndarray:
    """Range (ne * na) up to which no block in a sector holds a cell held occupied."""
    up, left = beam.reach.shape
    first, flat, axes = np.full(up * left, 1e9), pools.size[2] == 1, beam.axes
    half = 0.5 * edge * step
    radius = half * (1.4143 if flat else 1.7321) + step
    for bz in range(pools.slots.shape[0]):
        dz = 0.0 if flat else pools.origin[2] + bz * edge * step + half - beam.eye[2]
        for by in range(pools.slots.shape[1]):
            dy = pools.origin[1] + by * edge * step + half - beam.eye[1]
            for bx in range(pools.slots.shape[2]):
                slot = pools.slots[bz, by, bx]
                if slot == EMPTY or pools.loud[slot] < LOUD_WALL:
                    continue
                dx = pools.origin[0] + bx * edge * step + half - beam.eye[0]
                near = math.sqrt(dx * dx + dy * dy + dz * dz) - radius
                if near < beam.far:
                    fore = dx * axes[0, 0] + dy * axes[1, 0] + dz * axes[2, 0]
                    side = dx * axes[0, 1] + dy * axes[1, 1] + dz * axes[2, 1]
                    rise = dx * axes[0, 2] + dy * axes[1, 2] + dz * axes[2, 2]
                    a0, a1, e0, e1 = sectors_of(side, rise, fore, radius, beam.tangent, left, up)
                    for e in range(e0, e1 + 1):
                        for a in range(a0, a1 + 1):
                            first[e * left + a] = min(first[e * left + a], near)
    return first


@inner(fastmath=True)
def sectors_of(
    side: float, rise: float, fore: float, radius: float, tangent: float, left: int, up: int
) -> tuple[int, int, int, int]:
    """First and last sector across and up that a ball lies in, its middle given along the sensor's axes.

    All sectors where it is near.
    """
    if fore < 1.2 * radius:
        return (0, left - 1, 0, up - 1) if fore > -radius else (0, -1, 0, -1)
    y, z = side / fore, rise / fore
    wide_y = radius * math.sqrt(1.0 + y * y) / (fore - radius)
    wide_z = radius * math.sqrt(1.0 + z * z) / (fore - radius)
    a0 = max(int(((y - wide_y) / tangent + 1.0) * 0.5 * left), 0)
    a1 = min(int(((y + wide_y) / tangent + 1.0) * 0.5 * left), left - 1)
    e0 = max(int(((z - wide_z) / tangent + 1.0) * 0.5 * up), 0) if up > 1 else 0
    e1 = min(int(((z + wide_z) / tangent + 1.0) * 0.5 * up), up - 1) if up > 1 else 0
    return a0, a1, e0, e1


@inner(fastmath=True)
def _sector_ways(beam: Beam, flat: bool) -> np.ndarray:
    """Unit vectors (3, ne * na) of the sectors; level on a plane."""
    up, left = beam.reach.shape
    axes, way = beam.axes, np.empty((3, up * left))
    for e in range(up):
        for a in range(left):
            y = (2.0 * (a + 0.5) / left - 1.0) * beam.tangent
            z = (2.0 * (e + 0.5) / up - 1.0) * beam.tangent if up > 1 else 0.0
            scale = 1.0 / math.sqrt(1.0 + y * y + z * z)
            k = e * left + a
            for d in range(3):
                way[d, k] = (axes[d, 0] + y * axes[d, 1] + z * axes[d, 2]) * scale
            if flat:
                level = math.sqrt(way[0, k] * way[0, k] + way[1, k] * way[1, k])
                way[0, k], way[1, k], way[2, k] = way[0, k] / level, way[1, k] / level, 0.0
    return way


@inner(fastmath=True)
def _stop_at_echoes(
    way: np.ndarray, beam: Beam, ways: np.ndarray, slack: float, limit: np.ndarray, hush: np.ndarray
) -> None:
    """End what is learned a little behind each echo with a bearing, and behind surfaces square to the look.

    An echo that names a ring of places may stand anywhere on it: it ends silence, but hides no other echo.
    """
    for arc in beam.arcs:
        if arc[8] > 0:
            wide, ring = 2.5 * arc[6] + 0.05, arc[8] == RING
            for k in range(len(limit)):
                cosine = way[0, k] * arc[2] + way[1, k] * arc[3] + way[2, k] * arc[4]
                near = abs(cosine - arc[5]) < wide
                hush[k] = min(hush[k], arc[0] + slack) if near else hush[k]
                limit[k] = min(limit[k], arc[0] + slack) if near and not ring else limit[k]
    for one in ways:
        for k in range(len(limit)):
            turn = way[0, k] * one[0] + way[1, k] * one[1] + way[2, k] * one[2]
            limit[k] = min(limit[k], one[3] / max(turn, 0.01) + slack) if turn > one[4] else limit[k]


@inner(fastmath=True)
def _stop_at_walls(
    way: np.ndarray, beam: Beam, walls: np.ndarray, sure: int, step: float, limit: np.ndarray, hush: np.ndarray
) -> None:
    """End silence a cell before each wall, and before those that are sure all that is learned.

    All sectors are asked of one wall at a time, without a branch, so that processors take several at once. A wall that
    is met at a grazing angle ends a sector where the near side of that meets it, half a sector off the middle.
    """
    eye, half = beam.eye, beam.tangent / beam.reach.shape[1]
    for p in range(len(walls)):
        wall = walls[p]
        away = wall[3] - eye[0] * wall[0] - eye[1] * wall[1] - eye[2] * wall[2]
        sign = -1.0 if away < 0.0 else 1.0
        nx, ny, nz, away = sign * wall[0], sign * wall[1], sign * wall[2], sign * away
        cx, cy, cz = eye[0] - wall[4], eye[1] - wall[5], eye[2] - wall[6]
        wide = wall[7] * wall[7]
        for k in range(len(hush)):
            turn = way[0, k] * nx + way[1, k] * ny + way[2, k] * nz
            inverse = 1.0 / max(turn + half * (1.0 - turn * turn), 1e-6)
            r = away * inverse
            u, v, w = cx + r * way[0, k], cy + r * way[1, k], cz + r * way[2, k]
            met = (r < (limit[k] if p < sure else hush[k])) & (u * u + v * v + w * w < wide)
            r = max(r - step * min(inverse, 5.0), 0.0)
            hush[k] = min(hush[k], r) if met else hush[k]
            limit[k] = r if met and p < sure else limit[k]


@inner(fastmath=True)
def _march(
    pools: Pools,
    step: float,
    edge: int,
    eye: np.ndarray,
    way: np.ndarray,
    first: np.ndarray,
    haze: float,
    seen: np.ndarray,
) -> None:
    """End `seen` (ne * na) at a wall, none of which is before `first`, or behind so much that is unknown."""
    slots, common, hits, silent, loud = pools.slots, pools.common, pools.hits, pools.silent, pools.loud
    size, flat, inverse, wide = pools.size, pools.size[2] == 1, 1.0 / step, edge * step
    x0, y0, z0 = eye[0] - pools.origin[0], eye[1] - pools.origin[1], 0.5 * step if flat else eye[2] - pools.origin[2]
    shift = 0
    while (1 << shift) < edge:
        shift += 1
    for k in range(len(seen)):
        limit, dx, dy, dz = seen[k], way[0, k], way[1, k], way[2, k]
        over_x, over_y, over_z = _over(dx), _over(dy), _over(dz)
        clear = haze * limit < step  # so near, the unknown alone never ends it
        if clear and first[k] > limit:
            out = min(
                ((dx > 0) * size[0] * step - x0) * over_x,
                ((dy > 0) * size[1] * step - y0) * over_y,
                ((dz > 0) * size[2] * step - z0) * over_z,
            )
            seen[k] = limit if out > limit else min(step * math.ceil(out * inverse), limit)
            continue
        fog, r = 0.0, step * max(int(first[k] * inverse) - 1, 0) if clear else 0.0
        while r < limit and fog < 1.0:
            r += step
            x, y, z = x0 + r * dx, y0 + r * dy, z0 + r * dz
            if x < 0.0 or y < 0.0 or z < 0.0:
                break
            ix, iy, iz = int(x * inverse), int(y * inverse), int(z * inverse)
            if ix >= size[0] or iy >= size[1] or iz >= size[2]:
                break
            bz, by, bx = iz >> shift, iy >> shift, ix >> shift
            slot, alike = slots[bz, by, bx], common[bz, by, bx]
            if slot == EMPTY or (clear and loud[slot] < LOUD_WALL):
                out = min(
                    ((bx + (dx > 0)) * wide - x) * over_x,
                    ((by + (dy > 0)) * wide - y) * over_y,
                    ((bz + (dz > 0)) * wide - z) * over_z,
                )
                over = int(out * inverse)
                if not clear and bit_count(alike) < 3:
                    over = min(over, int((1.0 - fog) / haze))
                    fog += haze * (over + 1)
                r += over * step
                continue
            cell = cell_index(ix, iy, iz, edge, size[2])
            if hits[slot, cell] >= WALL_TENTHS:
                break
            if not clear and bit_count(silent[slot, cell] | alike) < 3:
                fog += haze
        seen[k] = min(r, limit)


@inner(fastmath=True)
def _over(way: float) -> float:
    """One over a direction's component; so great that it never counts where that is nothing."""
    return 1.0 / way if abs(way) > 1e-9 else -1e18
