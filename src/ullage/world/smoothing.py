"""Corner normals of triangle meshes: which facets sample a curved surface, and the surface's normals there.

Two facets belong to one smooth surface where they meet at less than `CREASE_DEG`, in a region of `FEWEST` facets or
more. The normal at a corner is the mean over the facets around it, weighted so that it is exact on spheres [Max1999].
A wide facet beside narrow ones is a tangent plane, as of a plate beside its rounded edge: its normal stays its own, and
the narrow ones take it over.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ullage.arrays import Floats, Longs

CREASE_DEG = 40.0
"""Facets that meet at more than this keep a crease between them [deg].

Below it a conducting edge is taken for smooth and diffracts nothing, so one limit parts curves from edges. A pipe of 10
sides (36 deg) is round; a prism of 8 (45 deg) keeps its edges.
"""
FEWEST = 16
"""A curved surface has at least so many triangles: less is a bevel or a bay window."""
UNEVEN = 3.0
"""Across an edge, a facet so many times wider than its neighbour is not a sample of the same curve."""
GIVEN_DEG = 12.5
"""Normals of a file count where they differ by less than this from those of the facets [deg]."""


@dataclass(frozen=True, slots=True, eq=False)
class Hinges:
    """Edges at which exactly two triangles of one object meet, both wound alike, and with hardly a bend."""

    faces: Longs  # (e, 2)
    starts: Longs  # (e, 2) corner, 0 to 2, at which the edge begins in the first face and ends in the second
    ends: Longs  # (e, 2) corner at which it ends in the first face and begins in the second
    widths: Floats  # (e, 2) of both triangles across the edge [m]

    def __len__(self) -> int:
        return len(self.faces)

    def take(self, which: NDArray[np.generic]) -> Hinges:
        """Return some of them."""
        return Hinges(self.faces[which], self.starts[which], self.ends[which], self.widths[which])

    def regions(self, count: int) -> Longs:
        """Number (f) the surfaces that they join so many triangles to."""
        links = coo_array((np.ones(len(self), np.int8), (self.faces[:, 0], self.faces[:, 1])), shape=(count, count))
        return np.asarray(connected_components(links, directed=False)[1], np.int64)


def face_normals(corners: Floats) -> tuple[Floats, Floats]:
    """Unit normals (f, 3) and areas (f) [m2] of triangles (f, 3, 3); 0 where there is no area."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(cross, axis=1)
    return cross / np.maximum(size, 1e-300)[:, None], size / 2


def hinges(corners: Floats, ids: Longs, objects: NDArray[np.integer]) -> Hinges:
    """Find the edges at which triangles go over into each other smoothly.

    Args:
        corners: triangles (f, 3, 3) [m].
        ids: numbers (f, 3) of their corners, the same for corners in one place.
        objects: object (f) of each.
    """
    normals, area = face_normals(corners)
    start, end = ids.ravel(), np.roll(ids, -1, 1).ravel()
    key = np.minimum(start, end) * (int(ids.max(initial=0)) + 1) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    many = np.diff(np.flatnonzero(np.diff(key[order], prepend=-1, append=-2)))
    first = np.cumsum(many) - many
    one, other = order[first[many == 2]], order[first[many == 2] + 1]
    a, b = one // 3, other // 3
    bend = np.einsum("ni,ni->n", normals[a], normals[b])
    kept = (start[one] == end[other]) & (objects[a] == objects[b]) & (bend > np.cos(np.deg2rad(CREASE_DEG)))
    one, other, a, b = one[kept], other[kept], a[kept], b[kept]
    k, m = one % 3, other % 3
    length = np.linalg.norm(corners[a, (k + 1) % 3] - corners[a, k], axis=1)
    widths = 2 * np.stack([area[a], area[b]], 1) / np.maximum(length, 1e-300)[:, None]
    found = Hinges(np.stack([a, b], 1), np.stack([k, (m + 1) % 3], 1), np.stack([(k + 1) % 3, m], 1), widths)
    region = found.regions(len(corners))
    return found.take(np.bincount(region)[region[found.faces[:, 0]]] >= FEWEST)


def corner_normals(corners: Floats, found: Hinges, given: Floats | None = None, known: Floats | None = None) -> Floats:
    """Estimate the normals (f, 3, 3) of a smooth surface at the corners of its triangles.

    Args:
        corners: triangles (f, 3, 3) [m].
        found: the edges at which they go over into each other.
        given: normals (f, 3, 3) from elsewhere, such as a file; zero where unknown. Each counts where it agrees with
            the facets within `GIVEN_DEG`.
        known: normals (f, 3, 3) of surfaces whose shape is known; zero elsewhere. All facets around a corner take
            them that bend from them by less than half of `CREASE_DEG`, as a smooth surface does from its facets.
    """
    normals, area = face_normals(corners)
    even = found.widths.max(1) < UNEVEN * (1 + 1e-6) * found.widths.min(1)  # no rounding decides over equals
    groups, mean = _fans(corners, normals, area, found.take(even))
    _take_over(mean, groups, found.take(~even))
    out = mean[groups].reshape(-1, 3, 3)
    off = np.einsum("fki,fi->fk", out, normals) < np.cos(np.deg2rad(CREASE_DEG))  # a cone's tip has no normal
    out = np.where(off[..., None], normals[:, None], out)
    if given is not None:
        agrees = np.einsum("fki,fki->fk", given, out) > np.cos(np.deg2rad(GIVEN_DEG))
        out = np.where(agrees[..., None], given, out)
    if known is not None:
        known = _spread(known, groups)
        bends = np.einsum("fki,fi->fk", known, normals) < np.cos(np.deg2rad(CREASE_DEG / 2))
        out = np.where(bends[..., None], out, known)
    return out


def _fans(corners: Floats, normals: Floats, area: Floats, even: Hinges) -> tuple[Longs, Floats]:
    """Group (3 f) of each corner with those around the same point of the same surface; mean normals (g, 3)."""
    pairs = [3 * even.faces + even.starts, 3 * even.faces + even.ends]
    rows, columns = np.concatenate(pairs).T if len(even) else np.zeros((2, 0), np.int64)
    count = 3 * len(corners)
    links = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(count, count))
    total, groups = connected_components(links, directed=False)
    square = ((np.roll(corners, -1, 1) - corners) ** 2).sum(2)
    weight = area[:, None] / np.maximum(square * np.roll(square, 1, 1), 1e-300)
    rows = (weight[..., None] * normals[:, None]).reshape(-1, 3)
    mean = np.stack([np.bincount(groups, row, total) for row in rows.T], 1)
    return groups.astype(np.int64), mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-300)


def _spread(known: Floats, groups: Longs) -> Floats:
    """Give all corners of each group (3 f) the mean of the normals (f, 3, 3) that are known there, or zero."""
    rows = known.reshape(-1, 3)
    total = np.stack([np.bincount(groups, row) for row in rows.T], 1)
    mean = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)
    return np.asarray(mean[groups].reshape(known.shape))


def _take_over(mean: Floats, groups: Longs, uneven: Hinges) -> None:
    """Give fans of narrow facets the normals of the wide facets beside them; changes `mean` (g, 3)."""
    row = np.arange(len(uneven))
    wide = uneven.widths.argmax(1)
    total = np.zeros_like(mean)
    for corner in (uneven.starts, uneven.ends):
        to = groups[3 * uneven.faces[row, 1 - wide] + corner[row, 1 - wide]]
        np.add.at(total, to, mean[groups[3 * uneven.faces[row, wide] + corner[row, wide]]])
    size = np.linalg.norm(total, axis=1)
    some = size > 0
    mean[some] = total[some] / size[some, None]
