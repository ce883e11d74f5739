"""How well echoes of other legs bear out each direction that the echo of a straight leg leaves open."""

from __future__ import annotations

import math

import numpy as np

from ullage.kernels.loops import inner, loop

# columns of a stretch of track: place (3), direction (3), range, cosine, its sigma, leg, boresight (3), normal (3; zero
# while it is open), cosine to boresight in which echoes are looked for
PLACE, TRACK, RANGE, COSINE, DOUBT, LEG, AHEAD, NORMAL, WIDE, COLUMNS = 0, 3, 6, 7, 8, 9, 10, 13, 16, 17

MOST_TURN = 0.7  # of a normal between two places that one bend describes [rad]


@loop(fastmath=True)
def weigh_rolls(
    me: np.ndarray,
    others: np.ndarray,
    ways: np.ndarray,
    range_sigma: float,
    wander: float,
    bends: np.ndarray,
    edges: np.ndarray,
    outlier: float,
    out: np.ndarray,
    heard: np.ndarray,
) -> None:
    """Log-likelihood (w) of each way to a surface, and by how many legs it is borne out (w).

    A distance to a surface obeys the eikonal equation: its gradient is the unit normal. Two places off one plane so
    differ in range by n . (p1 - p2), off a surface of some curvature by the mean of both normals on that way. Each leg
    counts once, by that of its stretches which fits best.

    Args:
        me: the stretch (17) that is asked about.
        others: those around (m, 17), ordered by leg.
        ways: unit vectors (w, 3) on its cone.
        range_sigma: doubt of ranges [m].
        wander: what it grows by for each metre between places.
        bends: turn (w) of each way along the track, as the stretch's own ranges tell [rad/m]; zero for a plane.
        edges: directions (w, 3) of straight edges there, in place of surfaces; zero for a surface.
        outlier: chance that a leg has no echo of the surface.
        out: the logarithm (w).
        heard: number of legs (w).
    """
    for w in range(len(ways)):
        nx, ny, nz = ways[w, 0], ways[w, 1], ways[w, 2]
        along = nx * me[3] + ny * me[4] + nz * me[5]
        scale = 1.0 / math.sqrt(max(1.0 - along * along, 1e-3))
        ux, uy, uz = scale * (me[3] - along * nx), scale * (me[4] - along * ny), scale * (me[5] - along * nz)
        total, legs, best, leg = 0.0, 0.0, 0.0, -1.0
        for k in range(len(others)):
            other = others[k]
            if other[LEG] != leg:
                if leg >= 0.0:
                    total += math.log(outlier + (1.0 - outlier) * best)
                    legs += best
                leg, best = other[LEG], 0.0
            dx, dy, dz = other[0] - me[0], other[1] - me[1], other[2] - me[2]
            if edges[w, 0] != 0.0 or edges[w, 1] != 0.0 or edges[w, 2] != 0.0:
                mx, my, mz, away = _to_edge(me[RANGE] * nx - dx, me[RANGE] * ny - dy, me[RANGE] * nz - dz, edges[w])
                fall, on = me[RANGE] - away, 0.0
            else:
                on = (dx * ux + dy * uy + dz * uz) * bends[w]
                mx, my, mz = nx + on * ux, ny + on * uy, nz + on * uz
                scale = 1.0 / math.sqrt(1.0 + on * on)
                mx, my, mz = scale * mx, scale * my, scale * mz
                fall = 0.5 * ((nx + mx) * dx + (ny + my) * dy + (nz + mz) * dz)
            turn = (mx * other[3] + my * other[4] + mz * other[5] - other[COSINE]) / (other[DOUBT] + 0.1 * abs(on))
            if abs(turn) > 3.0 or abs(on) > MOST_TURN:
                continue
            gap = dx * dx + dy * dy + dz * dz
            miss = (me[RANGE] - fall - other[RANGE]) / math.sqrt(range_sigma**2 + wander**2 * gap)
            if abs(miss) > 3.0:
                continue
            best = max(best, math.exp(-0.5 * (miss * miss + turn * turn)))
        if leg >= 0.0:
            total += math.log(outlier + (1.0 - outlier) * best)
            legs += best
        out[w], heard[w] = total, legs


@inner(fastmath=True)
def _to_edge(x: float, y: float, z: float, edge: np.ndarray) -> tuple[float, float, float, float]:
    """Unit vector to the nearest place of a straight edge and how far that is, from the way to any place of it."""
    along = x * edge[0] + y * edge[1] + z * edge[2]
    x, y, z = x - along * edge[0], y - along * edge[1], z - along * edge[2]
    away = math.sqrt(max(x * x + y * y + z * z, 1e-12))
    return x / away, y / away, z / away, away
