"""Find spheres and domes in a mesh, with the circular openings in them.

A mesh describes a gas tank, the head of a vessel or a bowl by flat triangles or quadrangles. Facets whose corners lie
on one sphere are replaced by that sphere, less a cap at each circular rim. `sphere_echoes` computes the echoes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ullage.arrays import Bools, Floats, Longs
from ullage.radar.facets import Surfaces
from ullage.radar.quadrics import LEAST_M, OFF_M, SmoothSurface, along_axis, connected_parts, sphere_through
from ullage.world.smoothing import linked, welded

_FEWEST = 16  # triangles
_DEEP = 0.05  # largest depth of facets inside the sphere, as a share of its radius
_FLAT = 0.1  # the same of whole balls of any size
_WHOLE = 0.01  # facets must fill the sphere less its openings, to this share of it
_SEEDS = 12  # facets of a surface from which domes are grown
_PATCH = 2.0  # a dome starts from facets whose middles lie within this many longest sides of the seed facet
_TRUE_M = 5e-4  # largest distance of the corners of a grown dome from its sphere [m]
_WIDE_M = 1.0  # smaller surfaces are no vessels, and are not searched for domes
_INNER = 4  # least number of corners off the rims
_LEAST_SHARE = 0.02  # least share of a whole sphere: a smaller part does not determine the radius


@dataclass(frozen=True, slots=True, eq=False)
class Sphere:
    """A sphere, whole or with circular openings."""

    centre: Floats  # (3) [m]
    radius: float  # through the facets' corners [m]
    depth: float  # distance of the facets' middles inside the sphere [m]
    widest: float  # smallest side of the widest facet [m]
    object_id: int  # object
    caps: Floats  # (k, 4) openings: unit vector from the centre, and how far out along it each begins [m]
    faces: Longs  # (n) faces of the scene that lie on it
    planar: Bools = field(default_factory=lambda: np.zeros(0, bool))  # (p) flat faces at rest that the sphere replaces
    small: Bools = field(default_factory=lambda: np.zeros(0, bool))  # (f) small triangles at rest, likewise

    def holds(self, points: Floats) -> Bools:
        """Return which points (..., 3) on the sphere, relative to its centre [m], lie in no opening."""
        return np.asarray((points @ self.caps[:, :3].T <= self.caps[:, 3] + OFF_M).all(-1))

    def moved(self, move: Floats) -> Sphere:
        """Return a whole sphere after a rigid motion (4, 4)."""
        return replace(self, centre=move[:3, :3] @ self.centre + move[:3, 3])


def spheres_of(surfaces: Sequence[SmoothSurface], still: Surfaces) -> tuple[Sphere, ...]:
    """Find the spheres and domes among smooth surfaces at rest, and the faces that each replaces."""
    found: list[Sphere] = []
    for surface in surfaces:
        whole = _fit_whole(surface)
        if whole is not None:
            found.append(whole)
        if whole is not None or np.linalg.norm(np.ptp(surface.corners.reshape(-1, 3), axis=0)) < _WIDE_M:
            continue
        bent = np.flatnonzero(~along_axis(surface.normals, surface.area))
        found += _grow_domes(surface.take(bent)) if len(bent) >= _FEWEST else []
    return tuple(_with_masks(sphere, still) for sphere in found)


def balls_of(surfaces: Sequence[SmoothSurface]) -> tuple[Sphere, ...]:
    """Find the whole spheres of any radius among smooth surfaces."""
    out = []
    for surface in surfaces:
        ball, off = _through(surface)
        round_ = max(off, ball.depth) < _FLAT * ball.radius and off < 2 * OFF_M
        if round_ and abs(_solid_angles(surface.corners - ball.centre).sum() / (4 * np.pi) - 1) < _WHOLE:
            out.append(ball)
    return tuple(out)


def _grow_domes(surface: SmoothSurface) -> list[Sphere]:
    """Grow domes from some of the facets, where a dome continues smoothly into another surface."""
    middles, sides = surface.corners.mean(1), np.linalg.norm(surface.corners - surface.corners[:, [1, 2, 0]], axis=2)
    found, open_ = [], np.ones(len(middles), bool)
    for seed in np.linspace(0, len(middles) - 1, _SEEDS).astype(np.int64):
        mine = np.flatnonzero(np.linalg.norm(middles - middles[seed], axis=1) < _PATCH * sides[seed].max())
        for _ in range(2):  # fit the first few facets, then all facets near that sphere
            centre, radius, off = sphere_through(surface.corners[mine].reshape(-1, 3))
            if not open_[seed] or off > _TRUE_M:
                break
            on = (abs(np.linalg.norm(surface.corners - centre, axis=2) - radius) < _TRUE_M).all(1) & open_
            mine = np.flatnonzero(on)
            if len(mine) < _FEWEST or not on[seed]:
                break
            mine = next((mine[part] for part in connected_parts(surface.take(mine)) if seed in mine[part]), mine[:0])
        else:
            open_[mine] = False
            sphere = _fit_whole(surface.take(mine)) if len(mine) >= _FEWEST else None
            found += [sphere] if sphere is not None else []
    return found


def _through(surface: SmoothSurface) -> tuple[Sphere, float]:
    """Return the sphere through the corners of a surface, and the largest spread of their distances [m]."""
    centre, radius, off = sphere_through(surface.corners.reshape(-1, 3))
    local = surface.corners - centre
    depth = radius - float(abs(np.einsum("ni,ni->n", local[:, 0], surface.normals)).min())
    widest = float(np.linalg.norm(np.roll(local, 1, 1) - local, axis=2).min(1).max())
    return Sphere(centre, radius, depth, widest, surface.object_id, np.zeros((0, 4)), surface.faces), off


def _fit_whole(surface: SmoothSurface) -> Sphere | None:
    """Fit a sphere or dome to a whole surface, if it is one."""
    sphere, off = _through(surface)
    radius, local = sphere.radius, surface.corners - sphere.centre
    if off > 2 * OFF_M or radius < LEAST_M or sphere.depth > _DEEP * radius:
        return None
    caps = _openings(local)
    if caps is None or (caps[:, 3] < -radius).any():
        return None
    share = 1 - ((1 - caps[:, 3] / radius) / 2).sum()
    filled = _solid_angles(local).sum() / (4 * np.pi)
    return replace(sphere, caps=caps) if share >= _LEAST_SHARE and abs(filled - share) <= _WHOLE * share else None


def _openings(local: Floats) -> Floats | None:
    """Find the caps (k, 4) that the rims of triangles (n, 3, 3) around the origin cut off.

    Returns None where a rim is no circle, or where nearly all corners lie on rims: rims of drums and cones also lie on
    spheres.
    """
    tri = welded(local)
    edge = np.sort(np.stack([tri, np.roll(tri, -1, 1)], -1), -1).reshape(-1, 2)
    _, first, count = np.unique(edge, axis=0, return_index=True, return_counts=True)
    single = first[count == 1]
    if not len(single):
        return np.zeros((0, 4))
    ends, size = edge[single], int(tri.max()) + 1
    loop = linked(ends[:, 0], ends[:, 1], size)[ends[:, 0]]
    places = np.empty((size, 3))
    places[tri.ravel()] = local.reshape(-1, 3)
    caps = []
    for name in np.unique(loop):
        outline, inner = places[np.unique(ends[loop == name])], local[single[loop == name] // 3].mean((0, 1))
        middle = outline.mean(0)
        _, _, axes = np.linalg.svd(outline - middle)
        out = axes[2] * (1 if (middle - inner) @ axes[2] > 0 else -1)
        level = float(middle @ out)
        if len(outline) < 3 or abs(outline @ out - level).max() > OFF_M:
            return None
        caps.append([*out, level])
    return np.array(caps) if size - len(np.unique(ends)) >= _INNER else None


def _solid_angles(local: Floats) -> Floats:
    """Compute the solid angles of triangles (n, 3, 3) at the origin [sr] by van Oosterom and Strackee's formula."""
    a, b, c = (unit / np.linalg.norm(unit, axis=1, keepdims=True) for unit in np.moveaxis(local, 1, 0))
    triple = abs(np.einsum("ni,ni->n", a, np.cross(b, c)))
    ab, bc, ca = ((one * other).sum(1) for one, other in ((a, b), (b, c), (c, a)))
    return np.asarray(2 * np.arctan2(triple, 1 + ab + bc + ca))


def _with_masks(sphere: Sphere, still: Surfaces) -> Sphere:
    """Return the sphere with the flat faces and small triangles at rest that are made of its faces."""
    planar = np.bincount(still.flat_at, np.isin(still.flat_faces, sphere.faces), len(still.planar)) > 0
    return replace(sphere, planar=planar, small=np.isin(still.faces, sphere.faces))
