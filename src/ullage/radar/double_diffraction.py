"""Waves that run over a conducting face from one edge to the edge opposite, and back to the radar.

With the electric field across the edges, the wave that one edge bends along the face is bent again by the other. On a
plate of a few wavelengths, turned away, that is as strong as either edge alone. Keller's coefficients are taken twice
[Keller1962], with the uniform theory's transition where the face is seen edge on [KouyoumjianPathak1974]. Only pairs
of parallel edges whose face lies between them, at most `WIDEST_M` apart. On a sheet whose four edges are free,
the wave also turns at the edge between both.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ullage.arrays import Bools, Floats, Ints, Longs
from ullage.radar.echo_set import Rows
from ullage.world.smoothing import welded

WIDEST_M = 1.0
"""Greatest distance of two edges between which a wave is followed [m]."""
_APART_M = 1e-4  # corners of one face that lie nearer are one
_AT_ONCE = 100_000  # pairs: all of a large mesh would fill the memory


@dataclass(frozen=True, slots=True, eq=False)
class Pairs(Rows):
    """Parallel edges of one face, in the frame of their objects."""

    POINTS, DIRECTIONS = ("starts", "ends"), ("gaps", "inward", "normals")
    starts: Floats  # (p, 3) of the first edge, as far as the second lies beside it [m]
    ends: Floats  # (p, 3) [m]
    gaps: Floats  # (p, 3) from the first edge to the second [m]
    angles: Floats  # (p, 2) of the free space about both, over pi
    inward: Floats  # (p, 2, 3) from each edge into the face
    normals: Floats  # (p, 3) of the face
    others: Floats  # (p, 2) widths of the faces beyond both edges [m]
    closing: Floats  # (p, 2) free space about the edge from start to start, and from end to end, over pi; 0: no edge
    closing_others: Floats  # (p, 2) widths of the faces beyond those edges [m]
    lengths: Floats  # (p) of the first edge [m]
    object_ids: Ints  # (p) object


def facing_pairs(
    starts: Floats,
    ends: Floats,
    angles: Floats,
    inward: Floats,
    normals: Floats,
    widths: Floats,
    object_ids: Ints,
    surfaces: Longs,
) -> Pairs:
    """Find pairs of edges that bound the same smooth surface; arguments as the fields of `diffraction.Edges`."""
    edge = np.repeat(np.arange(len(angles)), 2)
    side = np.tile([0, 1], len(angles))
    keep = (side == 0) | (angles[edge] < 2 - 1e-6)  # both faces of a rim are one
    edge, side = edge[keep], side[keep]
    order = np.argsort(surfaces[edge, side], kind="stable")
    edge, side = edge[order], side[order]
    bound = np.flatnonzero(np.r_[True, np.diff(surfaces[edge, side]) != 0, True])
    near = [np.zeros((0, 2), np.int64)]
    for one, two in _within(bound):
        into = inward[edge[one], side[one]], inward[edge[two], side[two]]
        held = np.flatnonzero(np.einsum("ni,ni->n", *into) < -0.9999)
        i, j = one[held], two[held]
        a, b, sa, sb = edge[i], edge[j], side[i], side[j]
        n, gap = normals[a, sa], starts[b] - starts[a]
        apart = np.einsum("ni,ni->n", gap, inward[a, sa])
        kept = (apart > 0) & (apart < WIDEST_M * (1 + 1e-6)) & (abs(np.einsum("ni,ni->n", gap, n)) < 1e-4)
        kept &= abs(np.einsum("ni,ni->n", n, normals[b, sb])) > 0.9999
        kept &= (abs(widths[a, sa] - apart) < 0.01 * apart) & (abs(widths[b, sb] - apart) < 0.01 * apart)
        near.append(np.column_stack([i, j])[kept])
    i, j = np.concatenate(near).T
    a, b, sa, sb = edge[i], edge[j], side[i], side[j]
    xa, n = inward[a, sa], normals[a, sa]
    apart = np.einsum("ni,ni->n", starts[b] - starts[a], xa)
    along = ends[a] - starts[a]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    along /= np.maximum(length, 1e-12)
    one, two = (np.einsum("ni,ni->n", p[b] - starts[a], along) for p in (starts, ends))
    low, high = np.maximum(np.minimum(one, two), 0), np.minimum(np.maximum(one, two), length[:, 0])
    first, last, gaps = starts[a] + low[:, None] * along, starts[a] + high[:, None] * along, apart[:, None] * xa
    row = _closing(starts[edge], ends[edge], surfaces[edge, side], first, last, gaps, surfaces[a, sa])
    found = row >= 0
    out = Pairs(first, last, gaps,
                np.stack([angles[a], angles[b]], 1), np.stack([xa, inward[b, sb]], 1), n,
                np.stack([widths[a, 1 - sa], widths[b, 1 - sb]], 1),
                np.where(found, angles[edge[row]], 0.0), np.where(found, widths[edge[row], 1 - side[row]], 0.0),
                high - low, object_ids[a])  # fmt: skip
    return out.take(high - low > 1e-3)


def _closing(
    starts: Floats, ends: Floats, surfaces: Longs, first: Floats, last: Floats, gaps: Floats, of: Longs
) -> Longs:
    """Find the edges that close the faces of pairs at both ends.

    Args:
        starts: (e, 3) of the edges of faces [m].
        ends: (e, 3) of the same [m].
        surfaces: (e) face of each.
        first: (p, 3) start of the first edge of each pair [m].
        last: (p, 3) its end [m].
        gaps: (p, 3) from the first edge to the second [m].
        of: (p) face of each pair.

    Returns:
        Row of the edge from start to start, and of that from end to end (p, 2), -1 for none.
    """
    if not len(first):
        return np.full((0, 2), -1)
    from scipy.spatial import cKDTree

    corners = np.concatenate([starts, ends])
    ids = welded(np.repeat(corners[:, None], 3, 1))[:, 0]
    count, one, two = ids.max() + 2, ids[: len(starts)], ids[len(starts) :]
    apart, near = cKDTree(corners).query(
        np.stack([first, last, first + gaps, last + gaps]), distance_upper_bound=_APART_M
    )
    a, b, c, d = np.where(np.isfinite(apart), ids[np.minimum(near, len(ids) - 1)], count - 1)

    def key(face: Longs, i: Longs, j: Longs) -> Longs:
        return np.asarray((face * count + np.minimum(i, j)) * count + np.maximum(i, j))

    have = key(surfaces, one, two)
    order = np.argsort(have, kind="stable")
    want = np.stack([key(of, a, c), key(of, b, d)], 1)
    row = order[np.minimum(np.searchsorted(have[order], want), len(have) - 1)]
    return np.asarray(np.where(have[row] == want, row, -1))


def _within(bound: Longs) -> Iterator[tuple[Longs, Longs]]:
    """Yield all pairs i < j within each run of rows, about `_AT_ONCE` at a time."""
    row = np.arange(bound[-1])
    count = np.repeat(bound[1:], np.diff(bound)) - row - 1
    total = np.cumsum(count)
    cuts = np.searchsorted(total, np.arange(_AT_ONCE, total[-1] if len(total) else 0, _AT_ONCE))
    for rows in np.split(row, np.unique(cuts)):
        many = count[rows]
        i = np.repeat(rows, many)
        yield i, i + 1 + np.arange(len(i)) - np.repeat(np.cumsum(many) - many, many)


def at_wavelength(pairs: Pairs, narrow_m: float) -> tuple[Pairs, Bools, Bools, Bools]:
    """Select the pairs that are wide enough [m]; edges of thin bodies become edges of sheets.

    Returns:
        The pairs (p), whether the wave of each runs over both sides, which of them are sheets, and which are thin and
        have free edges all around.
    """
    held = pairs.take(np.linalg.norm(pairs.gaps, axis=1) >= narrow_m)
    transmissive = held.angles > 2 - 1e-6
    thin = (held.others < narrow_m) | transmissive
    closed = (held.closing > 2 - 1e-6) | ((held.closing > 0) & (held.closing_others < narrow_m))
    return (
        replace(held, angles=np.where(thin, 2.0, held.angles)),
        np.asarray(thin.all(1)),
        np.asarray(transmissive.all(1)),
        np.asarray((thin & closed).all(1)),
    )


@lru_cache(maxsize=8)
def halfway(pairs: Pairs) -> tuple[Floats, Floats]:
    """Starts and ends (p, 3) of the lines halfway between the edges of each pair [m]."""
    return np.asarray(pairs.starts + pairs.gaps / 2), np.asarray(pairs.ends + pairs.gaps / 2)
