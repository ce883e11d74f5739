"""Waves that run over a conducting face from one edge to the edge opposite, and back to the radar.

With the electric field across the edges, the wave that one edge bends along the face is bent again by the other. On a
plate of a few wavelengths, turned away, that is as strong as either edge alone. Keller's coefficients are taken twice
[Keller1962], with the uniform theory's transition where the face is seen edge on [KouyoumjianPathak1974]. Only pairs
of parallel edges whose face lies between them, at most `WIDEST_M` apart.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ullage.radar.wires import moved

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Longs = NDArray[np.int64]

WIDEST_M = 1.0
"""Edges farther apart than this know nothing of each other [m]."""


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
    stuffs: Ints  # (p) object

    def __len__(self) -> int:
        return len(self.stuffs)

    def take(self, index: NDArray[np.bool_] | Longs) -> Pairs:
        """Some of them."""
        return Pairs(*(getattr(self, f.name)[index] for f in fields(self)))


def facing_pairs(
    starts: Floats,
    ends: Floats,
    angles: Floats,
    inward: Floats,
    normals: Floats,
    widths: Floats,
    stuffs: Ints,
    surfaces: Longs,
) -> Pairs:
    """Pairs among edges that bound the same smooth surface; arguments as the fields of `diffraction.Edges`."""
    edge = np.repeat(np.arange(len(angles)), 2)
    side = np.tile([0, 1], len(angles))
    keep = (side == 0) | (angles[edge] < 2 - 1e-6)  # both faces of a rim are one
    edge, side = edge[keep], side[keep]
    order = np.argsort(surfaces[edge, side], kind="stable")
    edge, side = edge[order], side[order]
    bound = np.flatnonzero(np.r_[True, np.diff(surfaces[edge, side]) != 0, True])
    i, j = _within(bound)
    a, b, sa, sb = edge[i], edge[j], side[i], side[j]
    xa, xb, n = inward[a, sa], inward[b, sb], normals[a, sa]
    apart = np.einsum("ni,ni->n", starts[b] - starts[a], xa)
    level = abs(np.einsum("ni,ni->n", starts[b] - starts[a], n))
    near = (np.einsum("ni,ni->n", xa, xb) < -0.9999) & (apart > 0) & (apart < WIDEST_M * (1 + 1e-6)) & (level < 1e-4)
    near &= abs(np.einsum("ni,ni->n", n, normals[b, sb])) > 0.9999
    near &= (abs(widths[a, sa] - apart) < 0.01 * apart) & (abs(widths[b, sb] - apart) < 0.01 * apart)
    a, b, sa, sb, xa, n, apart = (v[near] for v in (a, b, sa, sb, xa, n, apart))
    along = ends[a] - starts[a]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    along /= np.maximum(length, 1e-12)
    one, two = (np.einsum("ni,ni->n", p[b] - starts[a], along) for p in (starts, ends))
    low, high = np.maximum(np.minimum(one, two), 0), np.minimum(np.maximum(one, two), length[:, 0])
    held = high - low > 1e-3
    out = Pairs(starts[a] + low[:, None] * along, starts[a] + high[:, None] * along, apart[:, None] * xa,
                np.stack([angles[a], angles[b]], 1), np.stack([xa, inward[b, sb]], 1), n,
                np.stack([widths[a, 1 - sa], widths[b, 1 - sb]], 1), stuffs[a])  # fmt: skip
    return out.take(held)


def _within(bound: Longs) -> tuple[Longs, Longs]:
    """All pairs i < j within each run of rows."""
    out = [np.stack(np.triu_indices(b - a, 1)) + a for a, b in pairwise(bound) if b - a > 1]
    both = np.concatenate(out, axis=1) if out else np.zeros((2, 0), int)
    return both[0], both[1]


def strung(parts: list[Pairs]) -> Pairs:
    """The pairs of several bodies as one."""
    return Pairs(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Pairs)))


def at_wavelength(pairs: Pairs, narrow_m: float) -> tuple[Pairs, NDArray[np.bool_], NDArray[np.bool_]]:
    """Pairs wide enough, edges of thin bodies as rims; whether the wave runs over both sides; which are sheets."""
    held = pairs.take(np.linalg.norm(pairs.gaps, axis=1) >= narrow_m)
    sheets = held.angles > 2 - 1e-6
    thin = (held.others < narrow_m) | sheets
    return replace(held, angles=np.where(thin, 2.0, held.angles)), np.asarray(thin.all(1)), np.asarray(sheets.all(1))


def placed(pairs: Pairs, poses: Floats | None) -> Pairs:
    """The pairs in the world where the objects have these poses (o, 4, 4); None: nothing moves."""
    if poses is None:
        return pairs
    starts, ends = moved((pairs.starts, pairs.ends), pairs.stuffs, poses)
    gaps, one, two, normals = moved((pairs.gaps, pairs.inward[:, 0], pairs.inward[:, 1], pairs.normals), pairs.stuffs,
                                    poses, turn_only=True)  # fmt: skip
    return replace(pairs, starts=starts, ends=ends, gaps=gaps, inward=np.stack([one, two], 1), normals=normals)
