"""Corner normals of triangle meshes: which facets sample a curved surface, and the surface's normals there.

Two facets belong to one smooth surface where they meet at less than the crease of their object (`CREASES_DEG`) and lie
off it by less than `COARSE_M`, in a region of `FEWEST` facets or more. This rule alone parts curves from edges. The
normal at a corner is the mean over the facets around it, weighted so that it is exact on spheres [Max1999]. A wide
facet beside narrow ones is a tangent plane, as of a plate beside its rounded edge: its normal stays its own, and the
narrow ones take it over.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ullage.arrays import Bools, Floats, Longs

Smooth = Literal["auto", "yes", "no"]
"""Whether facets of an object stand for a curved surface: by rule, wherever they may, or nowhere."""
CREASES_DEG: dict[Smooth, float] = {"auto": 40.0, "yes": 75.0, "no": 1.0}
"""Facets that meet at more than this keep a crease between them [deg].

Below it a conducting edge is taken for smooth and diffracts nothing, so one limit parts curves from edges. By rule a
pipe of 10 sides (36 deg) is round; a prism of 8 (45 deg) keeps its edges. Under a degree no facet is worth an edge.
"""
FEWEST: dict[Smooth, int] = {"auto": 16, "yes": 2, "no": 16}
"""A curved surface has at least so many triangles: less is a bevel or a bay window."""
WELD_M = 1e-6
"""Corners nearer than this are one [m]."""
BENT_RAD = 1e-3
"""Facets that bend by less are one flat face."""
COARSE_M: dict[Smooth, float] = {"auto": 0.02, "yes": np.inf, "no": 0.02}
"""Facets farther off the curve through their edges than this stand for flat walls [m]: half a wave."""
UNEVEN = 3.0
"""Across an edge, a facet so many times wider than its neighbour is not a sample of the same curve."""
GIVEN_DEG = 12.5
"""Normals of a file count where they differ by less than this from those of the facets [deg]."""


class Taken(Protocol):
    """An object that is taken as curved or not."""

    @property
    def smooth(self) -> Smooth:
        """How."""


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
        return linked(self.faces[:, 0], self.faces[:, 1], count)


class Creases(NamedTuple):
    """What parts curved surfaces from flat facets in each object (o)."""

    deg: Floats  # (o) `CREASES_DEG`
    cosine: Floats  # (o) its cosine
    fewest: Longs  # (o) `FEWEST`
    coarse_m: Floats  # (o) `COARSE_M`


def creases(objects: Iterable[Taken]) -> Creases:
    """Return the limits of objects that are taken as curved or not (o)."""
    modes = [thing.smooth for thing in objects]
    deg = np.array([CREASES_DEG[mode] for mode in modes])
    fewest, coarse = np.array([FEWEST[mode] for mode in modes], np.int64), np.array([COARSE_M[mode] for mode in modes])
    return Creases(deg, np.cos(np.deg2rad(deg)), fewest, coarse)


def welded(corners: Floats) -> Longs:
    """Numbers (f, 3) of the corners of triangles (f, 3, 3), the same for corners in one place."""
    places = np.round(corners.reshape(-1, 3) / WELD_M).astype(np.int64)
    ids = np.zeros(len(places), np.int64)
    for k in range(3):  # one coordinate after the other: sorting numbers is ten times faster than sorting rows
        _, row = np.unique(places[:, k], return_inverse=True)
        _, ids = np.unique(ids * (int(row.max(initial=0)) + 1) + row, return_inverse=True)
    return np.asarray(ids.reshape(-1, 3), np.int64)


def linked(a: NDArray[np.integer], b: NDArray[np.integer], count: int) -> Longs:
    """Number (count) the groups that links from a (n) to b (n) make."""
    links = coo_array((np.ones(len(a), np.int8), (a, b)), shape=(count, count))
    return np.asarray(connected_components(links, directed=False)[1], np.int64)


def half_edges(ids: Longs) -> tuple[Longs, Longs, Longs]:
    """Sort the half edges (3 f) of triangles with corners (f, 3) by the edges they lie on.

    Returns:
        The half edges in the order of the edges; where each edge begins in that; how many half edges it has.
    """
    start, end = ids.ravel(), np.roll(ids, -1, 1).ravel()
    key = np.minimum(start, end) * (int(ids.max(initial=0)) + 1) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    return order, first, np.diff(np.r_[first, len(order)])


def crosses(corners: Floats) -> Floats:
    """Normals (f, 3) of triangles (f, 3, 3), as long as twice their area [m2]."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def face_normals(corners: Floats) -> tuple[Floats, Floats]:
    """Unit normals (f, 3) and areas (f) [m2] of triangles (f, 3, 3); 0 where there is no area."""
    cross = crosses(corners)
    size = np.linalg.norm(cross, axis=1)
    return cross / np.maximum(size, 1e-300)[:, None], size / 2


def goes_on(corners: Floats, a: Longs, b: Longs, objects: NDArray[np.integer], limits: Creases) -> Bools:
    """Which triangles go over into each other smoothly at the edges they share, whichever way they are wound.

    Args:
        corners: triangles (f, 3, 3) [m].
        a: half edges (n): triangle times 3, and the corner it begins at.
        b: the half edges (n) of their neighbours.
        objects: object (f) of each triangle.
        limits: of the objects (o).
    """
    along, normals = (np.roll(corners, -1, 1) - corners).reshape(-1, 3), face_normals(corners)[0]
    inward, widths = np.empty((2, len(a), 3)), np.empty((2, len(a)))
    for k, half in enumerate((a, b)):
        length = np.maximum(np.linalg.norm(along[half], axis=1), 1e-300)
        inward[k] = np.cross(normals[half // 3], along[half]) / length[:, None]
        widths[k] = np.einsum("ni,ni->n", inward[k], corners[half // 3, (half + 2) % 3] - corners[half // 3, half % 3])
    cosine = -np.einsum("ni,ni->n", *inward)
    off = widths.min(0) * np.arccos(np.clip(cosine, -1, 1)) / 8  # of an arc from its chord
    mine = objects[a // 3]
    return np.asarray((cosine > limits.cosine[mine]) & (off <= limits.coarse_m[mine]))


def hinges(corners: Floats, ids: Longs, objects: NDArray[np.integer], limits: Creases) -> Hinges:
    """Find the edges at which triangles go over into each other smoothly.

    Args:
        corners: triangles (f, 3, 3) [m].
        ids: numbers (f, 3) of their corners, the same for corners in one place.
        objects: object (f) of each.
        limits: of the objects (o).
    """
    _, area = face_normals(corners)
    start, end = ids.ravel(), np.roll(ids, -1, 1).ravel()
    order, first, many = half_edges(ids)
    one, other = order[first[many == 2]], order[first[many == 2] + 1]
    kept = (start[one] == end[other]) & (objects[one // 3] == objects[other // 3])
    kept &= goes_on(corners, one, other, objects, limits)
    one, other = one[kept], other[kept]
    a, b = one // 3, other // 3
    k, m = one % 3, other % 3
    length = np.linalg.norm(corners[a, (k + 1) % 3] - corners[a, k], axis=1)
    widths = 2 * np.stack([area[a], area[b]], 1) / np.maximum(length, 1e-300)[:, None]
    found = Hinges(np.stack([a, b], 1), np.stack([k, (m + 1) % 3], 1), np.stack([(k + 1) % 3, m], 1), widths)
    region = found.regions(len(corners))
    a = found.faces[:, 0]
    return found.take(np.bincount(region)[region[a]] >= limits.fewest[objects[a]])


def curved(corners: Floats, objects: NDArray[np.integer], limits: Creases) -> Bools:
    """Which triangles (f, 3, 3) of objects (f) are taken as parts of a curved surface."""
    found = hinges(corners, welded(corners), objects, limits)
    normals, _ = face_normals(corners)
    a, b = found.faces.T
    bent = np.einsum("ei,ei->e", normals[a], normals[b]) < np.cos(BENT_RAD)
    return np.bincount(found.faces[bent].ravel(), minlength=len(corners)) > 0


def corner_normals(
    corners: Floats, found: Hinges, given: Floats | None = None, known: Floats | None = None, *,
    crease_deg: Floats | float = CREASES_DEG["auto"],
) -> Floats:  # fmt: skip
    """Estimate the normals (f, 3, 3) of a smooth surface at the corners of its triangles.

    Args:
        corners: triangles (f, 3, 3) [m].
        found: the edges at which they go over into each other.
        given: normals (f, 3, 3) from elsewhere, such as a file; zero where unknown. Each counts where it agrees with
            the facets within `GIVEN_DEG`.
        known: normals (f, 3, 3) of surfaces whose shape is known; zero elsewhere. All facets around a corner take
            them that bend from them by less than half of a crease, as a smooth surface does from its facets.
        crease_deg: of all triangles, or of each (f), as `Creases.deg` [deg].
    """
    normals, area = face_normals(corners)
    crease = np.deg2rad(crease_deg)[..., None]
    even = found.widths.max(1) < UNEVEN * (1 + 1e-6) * found.widths.min(1)  # no rounding decides over equals
    groups, mean = _fans(corners, normals, area, found.take(even))
    _take_over(mean, groups, found.take(~even))
    out = mean[groups].reshape(-1, 3, 3)
    off = np.einsum("fki,fi->fk", out, normals) < np.cos(crease)  # a cone's tip has no normal
    out = np.where(off[..., None], normals[:, None], out)
    if given is not None:
        agrees = np.einsum("fki,fki->fk", given, out) > np.cos(np.deg2rad(GIVEN_DEG))
        out = np.where(agrees[..., None], given, out)
    if known is not None:
        known = _spread(known, groups)
        bends = np.einsum("fki,fi->fk", known, normals) < np.cos(crease / 2)
        out = np.where(bends[..., None], out, known)
    return out


def _fans(corners: Floats, normals: Floats, area: Floats, even: Hinges) -> tuple[Longs, Floats]:
    """Group (3 f) of each corner with those around the same point of the same surface; mean normals (g, 3)."""
    pairs = [3 * even.faces + even.starts, 3 * even.faces + even.ends]
    rows, columns = np.concatenate(pairs).T if len(even) else np.zeros((2, 0), np.int64)
    groups = linked(rows, columns, 3 * len(corners))
    square = ((np.roll(corners, -1, 1) - corners) ** 2).sum(2)
    weight = area[:, None] / np.maximum(square * np.roll(square, 1, 1), 1e-300)
    rows = (weight[..., None] * normals[:, None]).reshape(-1, 3)
    mean = np.stack([np.bincount(groups, row) for row in rows.T], 1)
    return groups, mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-300)


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
