"""Find the knuckles of dished heads: facets on the torus that joins a cylindrical wall to a crown.

A knuckle is curved in both directions, and each of its coarse facets would echo as a mirror. Where facets lie on one
torus around the axis of a cylinder, tangent to its wall, finer triangles on that torus echo in their place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ullage.arrays import Bools, Floats, Longs
from ullage.radar.facets import SMOOTH_DEG, PlanarPatches, Surfaces, strewn
from ullage.radar.quadrics import OFF_M, Quadric, SmoothSurface
from ullage.radar.solids import Backs
from ullage.world import point_normal

EDGE_M = 0.03
"""Longest edge of the triangles that represent a torus [m]."""
_TRUE_M = 5e-4  # largest distance of a knuckle's corners from its torus [m]
_LEAST_M = 0.03  # least radius of a tube [m]: a smaller one is an edge
_WHOLE = 0.95  # largest radius of a tube, as a share of the wall's: a wider one is a sphere


@dataclass(frozen=True, slots=True, eq=False)
class Torus:
    """A torus tangent to a cylindrical wall, and the facets that it replaces."""

    fine: Surfaces  # the torus, in small triangles
    depth: float  # largest distance of facets from it [m]
    widest: float  # smallest side of the widest facet [m]
    object_id: int  # object
    planar: Bools  # (p) flat faces at rest that it replaces
    small: Bools  # (f) small triangles at rest, likewise


@dataclass(frozen=True, slots=True, eq=False)
class Tube:
    """Dimensions of a torus around the axis of a wall, past one of its ends."""

    wall: Quadric
    end: float  # start of the torus along the axis, from the wall's centre [m]
    side: int  # 1 where the wall ends above, -1 below
    radius: float  # of the tube [m]

    def about(self, points: Floats) -> tuple[Floats, Floats]:
        """Return coordinates of points (..., 3) from the middle of the tube: radially out, and along the axis [m]."""
        x, y, z = np.moveaxis(self.wall.local(points), -1, 0)
        return np.hypot(x, y) - self.wall.radius + self.radius, self.side * (z - self.end)

    def holds(self, points: Floats) -> Bools:
        """Return which points (..., 3) lie on the outer quarter of the tube."""
        out, along = self.about(points)
        near = abs(np.hypot(out, along) - self.radius) < _TRUE_M
        return np.asarray(near & (out > -_TRUE_M) & (along > -OFF_M))

    def angles(self, points: Floats) -> tuple[Floats, Floats]:
        """Return angles around the tube, and around the axis from the first of every three points (n, 3, 3) [rad]."""
        out, along = self.about(points)
        x, y, _ = np.moveaxis(self.wall.local(points), -1, 0)
        turn = np.arctan2(y, x)
        return np.arctan2(along, out), turn[:, :1] + (turn - turn[:, :1] + np.pi) % (2 * np.pi) - np.pi

    def points(self, around: Floats, turn: Floats) -> Floats:
        """Return the points (..., 3) at these angles [m]."""
        away = self.wall.radius - self.radius + self.radius * np.cos(around)
        along = self.end + self.side * self.radius * np.sin(around)
        local = np.stack([away * np.cos(turn), away * np.sin(turn), along], -1)
        return np.asarray(self.wall.centre + local @ self.wall.axes)


def tori_of(surfaces: Sequence[SmoothSurface], walls: Sequence[Quadric], still: Surfaces) -> tuple[Torus, ...]:
    """Find the tori among smooth surfaces at rest, next to cylindrical walls."""
    low, high = (np.array([of(s.corners, axis=(0, 1)) for s in surfaces]).reshape(-1, 3) for of in (np.min, np.max))
    object_ids, found = np.array([surface.object_id for surface in surfaces]), []
    for wall in walls:
        for end, side in () if wall.is_sphere else ((wall.low, -1), (wall.high, 1)):
            # every point of a tube lies within this reach of the middle of the wall's end
            middle, reach = wall.centre + end * wall.axes[2], np.sqrt(2) * wall.radius + OFF_M
            apart = np.maximum(np.maximum(low - middle, middle - high), 0.0)
            mine = np.flatnonzero((object_ids == wall.object_id) & (np.linalg.norm(apart, axis=1) < reach)).tolist()
            if not mine:
                continue
            corners, normals, area, faces = (np.concatenate([getattr(surfaces[k], row) for k in mine])
                                             for row in ("corners", "normals", "area", "faces"))  # fmt: skip
            whole = SmoothSurface(
                corners, normals, area, wall.object_id, faces
            )  # a coarse knuckle splits into several smooth surfaces
            tube = _fit_tube(whole, wall, end, side)
            found += [] if tube is None else [_torus(whole, tube, still)]
    return tuple(found)


def _fit_tube(surface: SmoothSurface, wall: Quadric, end: float, side: int) -> Tube | None:
    """Fit the tube by which a surface continues from the end of a wall without a bend, if it does."""
    x, y, z = np.moveaxis(wall.local(surface.corners), 2, 0)
    inward, along = wall.radius - np.hypot(x, y), side * (z - end)
    outline = (abs(inward) < OFF_M) & (abs(along) < OFF_M)
    next_ = outline.any(1) & (along > -OFF_M).all(1) & ~outline.all(1)
    off = ~outline[next_] & (inward[next_] > _TRUE_M)
    if not off.any():
        return None
    h, d = along[next_][off], inward[next_][off]
    radius = float(np.median((h * h + d * d) / (2 * d)))
    if not _LEAST_M < radius < _WHOLE * wall.radius:
        return None
    tube = Tube(wall, end, side, radius)
    return tube if _lie_on(surface, tube).any() else None


def _lie_on(surface: SmoothSurface, tube: Tube) -> Bools:
    """Return which triangles (n) of a surface lie on a tube."""
    out, along = tube.about(surface.corners.mean(1))
    size = np.maximum(np.hypot(out, along), 1e-9)
    x, y, z = tube.wall.local(surface.normals + tube.wall.centre).T
    px, py, _ = tube.wall.local(surface.corners.mean(1)).T
    across = (x * px + y * py) / np.maximum(np.hypot(px, py), 1e-9)
    level = abs(across * out + tube.side * z * along) / size > np.cos(np.deg2rad(SMOOTH_DEG))
    return np.asarray(tube.holds(surface.corners).all(1) & level)


def _torus(surface: SmoothSurface, tube: Tube, still: Surfaces) -> Torus:
    mine = np.flatnonzero(_lie_on(surface, tube))
    corners, parent = _refined(surface.corners[mine], tube)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    kept = area > 1e-12
    corners, parent, normals = corners[kept], parent[kept], cross[kept] / area[kept, None]
    facets = surface.corners[mine], surface.normals[mine]
    depth = abs(np.einsum("nki,ni->nk", corners - facets[0][parent, :1], facets[1][parent])).max()
    object_ids = np.full(len(corners), surface.object_id, np.int32)
    sides = np.linalg.norm(facets[0] - np.roll(facets[0], 1, 1), axis=2)
    planar, small = _faces_on(still, tube, surface.object_id)
    fine, _ = strewn(corners, normals, object_ids, _backs(facets[0].mean(1), still, parent, corners, normals), still)
    return Torus(fine, float(depth), float(sides.min(1).max()), surface.object_id, planar, small)


def _refined(corners: Floats, tube: Tube) -> tuple[Floats, Longs]:
    """Cut triangles (n, 3, 3) into finer ones (m, 3, 3) on the tube, evenly in its angles; return each one's parent."""
    angles = np.stack(tube.angles(corners), -1)
    count = np.ceil(np.linalg.norm(corners - np.roll(corners, 1, 1), axis=2).max(1) / EDGE_M).astype(np.int64)
    cut, of = [], []
    for many in np.unique(count):
        mine = np.flatnonzero(count == many)
        shares = point_normal.pieces(int(many))
        turned = np.einsum("pcb,nba->npca", shares, angles[mine]).reshape(-1, 3, 2)
        points, halves = tube.points(turned[..., 0], turned[..., 1]), (turned + np.roll(turned, 1, 1)) / 2
        rise = tube.points(halves[..., 0], halves[..., 1]) - (points + np.roll(points, 1, 1)) / 2
        cut.append(points + rise.mean(1, keepdims=True))  # on the torus in the mean
        of.append(np.repeat(mine, len(shares)))
    return np.concatenate(cut), np.concatenate(of)


def _faces_on(still: Surfaces, tube: Tube, object_id: int) -> tuple[Bools, Bools]:
    """Return which flat faces (p) and small triangles (f) at rest lie on a tube."""
    planar: PlanarPatches = still.planar
    small = tube.holds(still.corners).all(1) & (still.object_ids == object_id)
    large = np.zeros(len(planar), bool)
    if len(planar):
        large = np.logical_and.reduceat(tube.holds(planar.starts), planar.first[:-1]) & (planar.object_ids == object_id)
    return large, small


def _backs(middles: Floats, still: Surfaces, parent: Longs, corners: Floats, normals: Floats) -> Backs:
    """Find the outer sides of triangles (m, 3, 3) from the faces nearest to their parents' middles (n, 3)."""
    planar = still.planar
    centres = np.concatenate([still.corners.mean(1), planar.spheres[:, :3]])
    sides = np.concatenate([still.backs.outward, still.flat_backs.outward])
    body = np.concatenate([still.backs.body, still.flat_backs.body])
    nearest = np.asarray(cKDTree(centres).query(middles)[1], np.int64)[parent]
    sign = np.sign(np.einsum("ni,ni->n", sides[nearest, :3], normals))
    outward = sign[:, None] * normals
    return Backs(np.column_stack([outward, -np.einsum("ni,ni->n", outward, corners[:, 0])]), body[nearest],
                 still.backs.boxes)  # fmt: skip
