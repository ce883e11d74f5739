"""How far each direction of one look of the full-profile mapper reaches: to what is solid, or hidden, or unknown."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ullage.kernels.loops import inner, loop
from ullage.kernels.occupancy import EMPTY, Pools, bit_count, cell_index


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
    wall: int,
    haze: float,
) -> float:
    """How far each sector sees: to the first cell held occupied, into so much unknown, or to an echo's own shade.

    Nothing is learned behind an echo of known bearing, even before the map holds it. Rows of `ways` (m, 5): direction
    and range of a surface square to it, and the cosine of the angle to which it shades. Rows of `walls` (p, 8): normal
    and distance of flat surfaces, centre and radius of where they stand; nothing is learned of them, nor behind. Those
    from `sure` on are only possible: they end silence, but not echoes. Returns the farthest.
    """
    up, left = beam.reach.shape
    size, origin, axes, eye = pools.size, pools.origin, beam.axes, beam.eye
    inverse, farthest, flat = 1.0 / step, 0.0, size[2] == 1
    shift = 0
    while (1 << shift) < edge:
        shift += 1
    for e in range(up):
        for a in range(left):
            y = (2.0 * (a + 0.5) / left - 1.0) * beam.tangent
            z = (2.0 * (e + 0.5) / up - 1.0) * beam.tangent if up > 1 else 0.0
            scale = 1.0 / math.sqrt(1.0 + y * y + z * z)
            dx = (axes[0, 0] + y * axes[0, 1] + z * axes[0, 2]) * scale
            dy = (axes[1, 0] + y * axes[1, 1] + z * axes[1, 2]) * scale
            dz = (axes[2, 0] + y * axes[2, 1] + z * axes[2, 2]) * scale
            if flat:
                level = math.sqrt(dx * dx + dy * dy)
                dx, dy, dz = dx / level, dy / level, 0.0
            limit, hush = _limit_of(dx, dy, dz, step, beam, ways, walls, sure)
            fog, r = 0.0, 0.0
            while r < limit and fog < 1.0:
                r += step
                x, y_, z_ = eye[0] + r * dx - origin[0], eye[1] + r * dy - origin[1], eye[2] + r * dz - origin[2]
                if x < 0.0 or y_ < 0.0 or (z_ < 0.0 and not flat):
                    break
                ix, iy, iz = int(x * inverse), int(y_ * inverse), 0 if flat else int(z_ * inverse)
                if ix >= size[0] or iy >= size[1] or iz >= size[2]:
                    break
                bz = 0 if flat else iz >> shift
                slot, common = pools.slots[bz, iy >> shift, ix >> shift], pools.common[bz, iy >> shift, ix >> shift]
                if slot == EMPTY:
                    over = _steps_through(x, y_, z_, dx, dy, 0.0 if flat else dz, edge * step, step)
                    if bit_count(common) < 3:
                        over = min(over, int((1.0 - fog) / haze))
                        fog += haze * (over + 1)
                    r += over * step
                    continue
                cell = cell_index(ix, iy, iz, edge, size[2])
                if pools.hits[slot, cell] >= wall:
                    break
                if bit_count(pools.silent[slot, cell] | common) < 3:
                    fog += haze
            r = min(r, limit)
            beam.reach[e, a], beam.hush[e, a] = r, min(r, hush)
            farthest = max(farthest, r)
    return farthest


@inner(fastmath=True)
def _limit_of(
    dx: float, dy: float, dz: float, step: float, beam: Beam, ways: np.ndarray, walls: np.ndarray, sure: int
) -> tuple[float, float]:
    """Range at which echoes and known walls end what a look learns in one direction, and at which they end silence."""
    eye, arcs, slack = beam.eye, beam.arcs, 2.0 * step
    limit, hush = beam.far, beam.far
    for k in range(len(arcs)):
        cosine = dx * arcs[k, 2] + dy * arcs[k, 3] + dz * arcs[k, 4]
        if arcs[k, 8] > 0 and abs(cosine - arcs[k, 5]) < 2.5 * arcs[k, 6] + 0.05:
            limit = min(limit, arcs[k, 0] + slack)
    for k in range(len(ways)):
        turn = dx * ways[k, 0] + dy * ways[k, 1] + dz * ways[k, 2]
        if turn > ways[k, 4]:
            limit = min(limit, ways[k, 3] / turn + slack)
    for k in range(len(walls)):
        turn = dx * walls[k, 0] + dy * walls[k, 1] + dz * walls[k, 2]
        away = walls[k, 3] - eye[0] * walls[k, 0] - eye[1] * walls[k, 1] - eye[2] * walls[k, 2]
        if away < 0.0:
            turn, away = -turn, -away
        if turn * (limit if k < sure else hush) <= away:
            continue
        way = away / turn
        u = eye[0] + way * dx - walls[k, 4]
        v = eye[1] + way * dy - walls[k, 5]
        w = eye[2] + way * dz - walls[k, 6]
        if u * u + v * v + w * w < walls[k, 7] * walls[k, 7]:
            way = max(way - step / max(turn, 0.2), 0.0)
            hush = min(hush, way)
            limit = way if k < sure else limit
    return limit, hush


@inner(fastmath=True)
def _steps_through(x: float, y: float, z: float, dx: float, dy: float, dz: float, wide: float, step: float) -> int:
    """Steps that a ray at a point, from the map's corner, can take before it leaves the block."""
    out = 1e9
    for at, way in ((x, dx), (y, dy), (z, dz)):
        inside = at - wide * math.floor(at / wide)
        if way > 1e-9:
            out = min(out, (wide - inside) / way)
        elif way < -1e-9:
            out = min(out, -inside / way)
    return int(out / step)
