"""Waves that run over a conducting face from one edge to the edge opposite, and back to the radar.

With the electric field across the edges, the wave that one edge bends along the face is bent again by the other. On a
plate of a few wavelengths, turned away, that is as strong as either edge alone. Keller's coefficients are taken twice
[Keller1962], with the uniform theory's transition where the face is seen edge on [KouyoumjianPathak1974]. Only pairs
of parallel edges whose face lies between them, at most `WIDEST_M` apart.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np

from ullage.arrays import Bools, Floats, Ints, Longs
from ullage.radar.wires import moved

WIDEST_M = 1.0
"""Greatest distance of two edges between which a wave is followed [m]."""
_AT_ONCE = 100_000  # pairs: all of a large mesh would fill the memory


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Parallel edges of one face, in the frame of their objects."""

    starts: Floats  # (p, 3) of the first edge, as far as the second lies beside it [m]
    ends: Floats  # (p, 3) [m]
    gaps: Floats  # (p, 3) from the first edge to the second [m]
    angles: Floats  # (p, 2) of the free space about both, over pi
    inward: Floats  # (p, 2, 3) from each edge into the face
    normals: Floats  # (p, 3) of the face
    others: Floats  # (p, 2) widths of the faces beyond both edges [m]
    object_ids: Ints  # (p) object

    def __len__(self) -> int:
        return len(self.object_ids)

    def take(self, index: Bools | Longs) -> Pairs:
        """Select some of them."""
        return Pairs(*(getattr(self, f.name)[index] for f in fields(self)))


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
    held = high - low > 1e-3
    out = Pairs(starts[a] + low[:, None] * along, starts[a] + high[:, None] * along, apart[:, None] * xa,
                np.stack([angles[a], angles[b]], 1), np.stack([xa, inward[b, sb]], 1), n,
                np.stack([widths[a, 1 - sa], widths[b, 1 - sb]], 1), object_ids[a])  # fmt: skip
    return out.take(held)


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


def strung(parts: list[Pairs]) -> Pairs:
    """Join the pairs of several bodies."""
    return Pairs(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Pairs)))


def at_wavelength(pairs: Pairs, narrow_m: float) -> tuple[Pairs, Bools, Bools]:
    """Select the pairs that are wide enough [m]; edges of thin bodies become edges of sheets.

    Returns:
        The pairs (p), whether the wave of each runs over both sides, and which of them are sheets.
    """
    held = pairs.take(np.linalg.norm(pairs.gaps, axis=1) >= narrow_m)
    transmissive = held.angles > 2 - 1e-6
    thin = (held.others < narrow_m) | transmissive
    return (
        replace(held, angles=np.where(thin, 2.0, held.angles)),
        np.asarray(thin.all(1)),
        np.asarray(transmissive.all(1)),
    )


def placed(pairs: Pairs, poses: Floats | None) -> Pairs:
    """Place the pairs in the world where the objects have these poses (o, 4, 4); None: nothing moves."""
    if poses is None:
        return pairs
    starts, ends = moved((pairs.starts, pairs.ends), pairs.object_ids, poses)
    gaps, one, two, normals = moved(
        (pairs.gaps, pairs.inward[:, 0], pairs.inward[:, 1], pairs.normals), pairs.object_ids, poses, turn_only=True
    )
    return replace(pairs, starts=starts, ends=ends, gaps=gaps, inward=np.stack([one, two], 1), normals=normals)
