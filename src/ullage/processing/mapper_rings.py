"""The ring of directions that one stretch of track leaves open, and how other stretches bear out each of them."""

from __future__ import annotations

import numpy as np

from ullage.arrays import Floats
from ullage.kernels.rolls import AHEAD, COSINE, RANGE, TRACK, WIDE, weigh_rolls

ROLLS = 72
RANGE_SIGMA_M, WANDER = 0.02, 0.01
OUTLIER = 0.06  # chance that a leg has no echo of a surface
UNLIT, UNHEARD, BEHIND = 0.3, 0.02, -0.3  # chance of an echo from beside the beam, from behind, from where on
SURE = 0.9
UPRIGHT, EDGES, EDGE_BETTER = 0.26, 8, 1.0  # ways so level may be of upright edges; slopes; [nat]


def cone(row: Floats) -> Floats:
    """Unit vectors (ROLLS, 3) at a stretch's cosine to its track."""
    track, cosine = row[TRACK : TRACK + 3], float(row[COSINE])
    level = np.cross(track, [0.0, 0.0, 1.0] if abs(track[2]) < 0.9 else [0.0, 1.0, 0.0])
    level /= np.linalg.norm(level)
    turn = np.arange(ROLLS)[:, None] * (2 * np.pi / ROLLS)
    off = np.sqrt(max(1 - cosine**2, 0.0))
    return np.asarray(cosine * track + off * (np.cos(turn) * level + np.sin(turn) * np.cross(level, track)))


def beam_odds(me: Floats, ways: Floats) -> Floats:
    """Log of the chance (w) that a sensor hears an echo from these ways (w, 3) as its beam lies."""
    lit = ways @ me[AHEAD : AHEAD + 3]
    return np.asarray(np.log(np.where(lit > me[WIDE], 1.0, np.where(lit > BEHIND, UNLIT, UNHEARD))))


def weigh(
    me: Floats, others: Floats, ways: Floats, axes: Floats | None = None, focal: Floats | None = None,
    doubt: Floats | None = None,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Log-likelihood of surfaces of these directions (w, 3), and the legs that bear each out; both (w).

    Flat ones, or with lines (w, 3) so far ahead (w) on which their normals meet, and their doubt in bend (w).
    """
    odds, legs = np.zeros((2, len(ways)))
    doubts = np.concatenate([[RANGE_SIGMA_M, WANDER], np.zeros(len(ways)) if doubt is None else doubt])
    lines = np.zeros_like(ways) if axes is None else np.ascontiguousarray(axes)
    ahead = np.zeros(len(ways)) if focal is None else focal
    weigh_rolls(me, others, ways, doubts, lines, ahead, OUTLIER, odds, legs)
    return odds, legs


def one_side(odds: Floats, ways: Floats, best: int, narrow: float) -> Floats | None:
    """The mean (3) of ways (w, 3) about the best, by their odds (w), if nearly all likelihood lies there."""
    share = np.exp(odds - odds[best])
    side = share * (ways @ ways[best] > narrow)
    if side.sum() < SURE * share.sum():
        return None
    mean = side @ ways
    return np.asarray(mean / np.linalg.norm(mean))


def is_edge(me: Floats, others: Floats, near: Floats, surface: float) -> bool:
    """Whether a straight edge explains what all stretches around hear better than the surface that is told.

    An edge is heard as a wall is from places beside each other along it. So each stretch should count, as a leg,
    not each leg by its best one.

    Args:
        me: the stretch (22).
        others: those around (m, 22), ordered by what counts once.
        near: (n, 3) about the one that is told: here edges of all slopes are tried, upright and level ones all round.
        surface: log-likelihood of what is told.
    """
    ways, edges = _edges(cone(me), near)
    edge = weigh(me, others, ways, edges, np.full(len(ways), me[RANGE]))[0].max()
    return bool(edge > surface + EDGE_BETTER)


def _edges(ring: Floats, near: Floats) -> tuple[Floats, Floats]:
    """Ways (e, 3) to edges and their directions (e, 3): of all slopes near a way, upright and level on the ring."""
    level = np.cross(near, [0.0, 0.0, 1.0] if abs(near.mean(axis=0)[2]) < 0.9 else [1.0, 0.0, 0.0])
    level /= np.linalg.norm(level, axis=1)[:, None]
    turn = (np.arange(EDGES) * (np.pi / EDGES))[:, None, None]
    sloped = (np.cos(turn) * level + np.sin(turn) * np.cross(level, near)).reshape(-1, 3)
    flat = np.cross(ring, [0.0, 0.0, 1.0])
    long_ = np.linalg.norm(flat, axis=1) > 0.1
    flat = flat[long_] / np.linalg.norm(flat[long_], axis=1)[:, None]
    upright = np.concatenate([ring, near])
    upright = upright[abs(upright[:, 2]) < UPRIGHT]
    ways = np.concatenate([np.tile(near, (EDGES, 1)), ring[long_], upright])
    return ways, np.concatenate([sloped, flat, np.tile([0.0, 0.0, 1.0], (len(upright), 1))])


def about(me: Floats, way: Floats) -> Floats:
    """Unit vectors (15, 3) within some degrees of a way, round the track and along it."""
    track = me[TRACK : TRACK + 3]
    aside = way - (way @ track) * track
    aside /= max(float(np.linalg.norm(aside)), 1e-9)
    across = np.cross(track, aside)
    cosine = np.clip(way @ track + np.array([-0.02, 0.0, 0.02]), -1.0, 1.0)[:, None, None]
    roll = np.radians([-4.0, -2.0, 0.0, 2.0, 4.0])[None, :, None]
    out = cosine * track + np.sqrt(1 - cosine**2) * (np.cos(roll) * aside + np.sin(roll) * across)
    return np.asarray(out.reshape(-1, 3))
