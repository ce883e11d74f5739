"""How well echoes of other legs bear out each direction that the echo of a straight leg leaves open."""

from __future__ import annotations

import math

import numpy as np

from ullage.kernels.loops import inner, loop

# columns of a stretch of track: place (3), direction (3), range, cosine, its sigma, leg, boresight (3), normal (3; zero
# while it is open), cosine to boresight in which echoes are looked for, fall of the cosine for each metre, its doubt
# (nothing where it is not known), bend of the track (3)
PLACE, TRACK, RANGE, COSINE, DOUBT, LEG, AHEAD, NORMAL, WIDE, BEND, BEND_DOUBT, CURL, COLUMNS = (
    0, 3, 6, 7, 8, 9, 10, 13, 16, 17, 18, 19, 22,
)  # fmt: skip
LOOSE = 0.1  # share of a bend by which a wall may be bent otherwise elsewhere

MOST_TURN = 0.7  # of a normal between two places that one bend describes [rad]
TURNED = math.cos(MOST_TURN)


@loop(fastmath=True)
def weigh_rolls(
    me: np.ndarray,
    others: np.ndarray,
    ways: np.ndarray,
    doubts: np.ndarray,
    axes: np.ndarray,
    focal: np.ndarray,
    outlier: float,
    out: np.ndarray,
    heard: np.ndarray,
) -> None:
    """Log-likelihood (w) of each way to a surface, and by how many legs it is borne out (w).

    A distance to a surface obeys the eikonal equation: its gradient is the unit normal. Two places off one plane so
    differ in range by n . (p1 - p2). Off a surface that is bent one way they differ as their distances to the line on
    which its normals meet; on that line itself lies a straight edge, and past it ranges grow again [BornWolf1999].
    Each leg counts once, by that of its stretches which fits best.

    Args:
        me: the stretch (22) that is asked about.
        others: those around (m, 22), ordered by leg.
        ways: unit vectors (w, 3) on its cone.
        doubts: of ranges [m], what it grows by for each metre between places, and of bends (w) [1/m]: (2 + w).
        axes: directions (w, 3) of the lines on which normals meet; zero for a plane.
        focal: how far ahead these lines are (w), less than nothing behind, as of a wall nearer than its focus [m].
        outlier: chance that a leg has no echo of the surface.
        out: the logarithm (w).
        heard: number of legs (w).
    """
    for w in range(len(ways)):
        total, legs, best, leg = 0.0, 0.0, 0.0, -1.0
        for k in range(len(others)):
            if others[k, LEG] != leg:
                if leg >= 0.0:
                    total += math.log(outlier + (1.0 - outlier) * best)
                    legs += best
                leg, best = others[k, LEG], 0.0
            best = max(best, _fit(me, others[k], ways[w], axes[w], focal[w], doubts[0], doubts[1], doubts[2 + w]))
        if leg >= 0.0:
            total += math.log(outlier + (1.0 - outlier) * best)
            legs += best
        out[w], heard[w] = total, legs


@inner(fastmath=True)
def _fit(
    me: np.ndarray, other: np.ndarray, way: np.ndarray, axis: np.ndarray, focal: float,
    range_sigma: float, wander: float, bend_sigma: float,
) -> float:  # fmt: skip
    """How well range and cosine of another stretch fit a surface, 1 at best."""
    dx, dy, dz = other[0] - me[0], other[1] - me[1], other[2] - me[2]
    mx, my, mz, aside, bend = way[0], way[1], way[2], 0.0, 0.0
    reach = me[RANGE] - mx * dx - my * dy - mz * dz
    if axis[0] != 0.0 or axis[1] != 0.0 or axis[2] != 0.0:
        x, y, z = focal * mx - dx, focal * my - dy, focal * mz - dz
        on = x * axis[0] + y * axis[1] + z * axis[2]
        x, y, z = x - on * axis[0], y - on * axis[1], z - on * axis[2]
        away = math.sqrt(max(x * x + y * y + z * z, 1e-12))
        toward = (x * mx + y * my + z * mz) / away
        edge = focal == me[RANGE]
        if not edge and abs(toward) < TURNED:
            return 0.0
        away = away if edge or toward > 0.0 else -away
        mx, my, mz = x / away, y / away, z / away
        if not edge and mx * other[AHEAD] + my * other[AHEAD + 1] + mz * other[AHEAD + 2] < other[WIDE]:
            return 0.0
        reach = me[RANGE] - focal + away
        aside = 0.0 if edge else abs(away) * math.sqrt(max(1.0 - toward * toward, 0.0))
        bend = mx * other[3] + my * other[4] + mz * other[5]
        on = axis[0] * other[3] + axis[1] * other[4] + axis[2] * other[5]
        bend = (1.0 - bend * bend - on * on) / away
    cosine = mx * other[3] + my * other[4] + mz * other[5]
    turn = (cosine - other[COSINE]) / (other[DOUBT] + bend_sigma * aside)
    if abs(turn) > 3.0:
        return 0.0
    if other[BEND_DOUBT] > 0.0:
        bow = other[BEND] + mx * other[CURL] + my * other[CURL + 1] + mz * other[CURL + 2]
        off = (bend - bow) / (other[BEND_DOUBT] + bend_sigma + LOOSE * abs(bend))
        if abs(off) > 3.0:
            return 0.0
        turn = math.hypot(turn, off)
    bow = 0.5 * bend_sigma * aside * aside
    gap = dx * dx + dy * dy + dz * dz
    miss = (reach - other[RANGE]) / math.sqrt(range_sigma**2 + wander**2 * gap + bow * bow)
    return math.exp(-0.5 * (miss * miss + turn * turn)) if abs(miss) < 3.0 else 0.0
