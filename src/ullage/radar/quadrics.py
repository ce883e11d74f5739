"""Fit cylinders and spheres to the facets of a mesh.

A mesh describes a curved wall or body by flat strips or small triangles. A reflection depends on the curvature, which a
single facet lacks. So the cylinder or the sphere through the facets is fitted once for each world.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ullage.arrays import Bools, Floats, Ints, Longs
from ullage.radar.facets import twin_edges
from ullage.world.scene import Scene
from ullage.world.smoothing import CREASES_DEG, Creases, creases, face_normals, goes_on, linked

OFF_M = 2.5e-3
"""Largest distance of facet corners from the cylinder [m]: a sixteenth of a wavelength."""
LEAST_M = 0.08
"""Least radius and length of a fitted surface [m]: two wavelengths; smaller ones do not reflect like mirrors."""
_LEVEL = 0.02  # facets whose normals have a larger component along the axis belong to an end cap
_MOST = 0.35  # a cylinder needs this share of the smooth surface: the belt of a sphere has less
_DEEP = 0.05  # facets of a sphere lie inside it by less than this share of its radius
_BENT = np.cos(np.deg2rad(CREASES_DEG["auto"]))  # facets of a sphere are square to its radii so far
_ONE = Creases(np.array([75.0]), np.array([np.cos(np.deg2rad(75.0))]), np.array([2]), np.array([np.inf]))
"""Of a surface that is smooth already."""
_ARC_DEG = 100.0  # a smaller arc of a circle reflects nothing to its own opposite side
_FEWEST = 16  # triangles
_AROUND = 0.04  # facets of a rod have the area of the cylinder, to this share of it
_SAME_RAD = 1e-4  # lines along the axis that are closer than this count as one
_FILLED = 0.02  # share of a whole strip that may be missing, for rounding and chords


@dataclass(frozen=True, slots=True, eq=False)
class Quadric:
    """A surface that is part of one circular cylinder or one sphere."""

    centre: Floats  # (3) a point of the axis [m]
    axes: Floats  # (3, 3) rows: two unit vectors across the axis, and the axis
    radius: float  # of a cylinder at the facets' corners, of a sphere the mean over the facets [m]
    low: float  # lower end along the axis, from the centre [m]
    high: float  # upper end [m]
    depth: float  # largest distance between facets and the fitted surface [m]
    widest: float  # smaller extent of the widest facet [m]
    object_id: int  # object
    is_sphere: bool = False
    strips: Floats = field(default_factory=lambda: np.zeros((0, 4)))  # (s, 4) angle, half width [rad], low, high [m]
    caps: Floats = field(default_factory=lambda: np.zeros((0, 2)))  # (s, 2) flat face at either end: 1, at holes -1
    faces: Longs = field(default_factory=lambda: np.zeros(0, np.int64))  # (n) faces of the scene that lie on it

    def local(self, points: Floats) -> Floats:
        """Convert points (..., 3) to coordinates along the axes, from the centre [m]."""
        return np.asarray(((points - self.centre).reshape(-1, 3) @ self.axes.T).reshape(points.shape))

    def radial(self, points: Floats) -> Floats:
        """Return vectors (..., 3) to points (..., 3) from the centre of a sphere, or square from the axis [m]."""
        out = points - self.centre
        return out if self.is_sphere else out - (out @ self.axes[2])[..., None] * self.axes[2]

    def holds(self, other: Quadric) -> bool:
        """Return whether the middle of another body lies inside this wall."""
        x, y, z = self.local(other.centre + 0.5 * (other.low + other.high) * other.axes[2])
        return bool(not self.is_sphere and np.hypot(x, y) + other.radius < self.radius and self.low < z < self.high)

    def moved(self, move: Floats) -> Quadric:
        """Return the same surface after a rigid motion (4, 4)."""
        turn = move[:3, :3]
        return replace(self, centre=turn @ self.centre + move[:3, 3], axes=self.axes @ turn.T)


@dataclass(frozen=True, slots=True, eq=False)
class SmoothSurface:
    """Connected triangles of one object whose normals change little from each to the next."""

    corners: Floats  # (n, 3, 3) [m]
    normals: Floats  # (n, 3)
    area: Floats  # (n) [m2]
    object_id: int  # object
    faces: Longs = field(default_factory=lambda: np.zeros(0, np.int64))  # (n) of the scene

    def take(self, which: NDArray[np.integer]) -> SmoothSurface:
        """Select some of the triangles."""
        return SmoothSurface(
            self.corners[which], self.normals[which], self.area[which], self.object_id, self.faces[which]
        )


def smooth_surfaces_of(scene: Scene, faces: Bools) -> list[SmoothSurface]:
    """Find the smooth surfaces among some faces (f) of a scene, at their initial poses."""
    corners = scene.corners()[faces]
    normals, area = face_normals(corners)
    kept = area > 1e-12
    corners, area, normals, index = corners[kept], area[kept], normals[kept], np.flatnonzero(faces)[kept]
    object_ids = scene.face_object[index]
    return [SmoothSurface(corners[mine], normals[mine], area[mine], int(object_ids[mine[0]]), index[mine])
            for mine in _connected(corners, object_ids, creases(scene.objects))]  # fmt: skip


def walls_of(surfaces: Sequence[SmoothSurface]) -> list[Quadric | None]:
    """Fit a cylinder of any size to each smooth surface, where it lies on one."""
    return [_fit_cylinder(s.corners, s.normals, s.area, s.object_id) for s in surfaces]


def quadrics_of(surfaces: Sequence[SmoothSurface], walls: Sequence[Quadric | None]) -> tuple[Quadric, ...]:
    """Take the cylinders and spheres of smooth surfaces that are large enough to reflect as mirrors."""
    found = []
    for surface, fitted in zip(surfaces, walls, strict=True):
        large = fitted is not None and min(fitted.radius, fitted.high - fitted.low) >= LEAST_M
        wall = fitted if large else None
        sphere = _fit_sphere(surface.corners, surface.normals, surface.area, surface.object_id)
        if sphere is not None and (
            wall is None or sphere.depth < 2 * wall.depth
        ):  # the rims of a drum also lie on a sphere
            found.append(replace(sphere, faces=surface.faces))
        elif wall is not None:
            found.append(replace(wall, faces=surface.faces[along_axis(surface.normals, surface.area)]))
    return tuple(found)


def rods_of(surfaces: Sequence[SmoothSurface], walls: Sequence[Quadric | None]) -> list[Quadric]:
    """Take the cylinders of smooth surfaces that go all the way around one, and not beyond its ends."""
    return [
        wall
        for surface, wall in zip(surfaces, walls, strict=True)
        if wall is not None
        and abs(surface.area.sum() / (2 * np.pi * wall.radius * (wall.high - wall.low)) - 1) < _AROUND
    ]


def with_caps(walls: Sequence[Quadric], scene: Scene) -> tuple[Quadric, ...]:
    """Return the walls with their `caps`: the strip ends at which flat faces square to the axis end."""
    corners, out = scene.corners(), list(walls)
    striped = [k for k, wall in enumerate(walls) if len(wall.strips)]
    for object_id in np.unique([walls[k].object_id for k in striped]):
        mine = corners[scene.face_object == object_id]
        sides = cKDTree(((mine + np.roll(mine, -1, 1)) / 2).reshape(-1, 3), balanced_tree=False, compact_nodes=False)
        for k in striped:
            if walls[k].object_id == object_id:
                out[k] = replace(walls[k], caps=_caps(walls[k], mine, sides))
    return tuple(out)


def _caps(wall: Quadric, triangles: Floats, sides: cKDTree) -> Floats:
    """Find flat faces (s, 2) at the ends of a wall's strips, among triangles (n, 3, 3); `sides`: their midpoints."""
    angle, half, *ends = wall.strips.T
    across = wall.radius * np.cos(half)
    chords = np.stack([across * np.cos(angle), across * np.sin(angle)], 1)
    wanted = np.concatenate([np.column_stack([chords, end]) for end in ends])
    size = np.tile(2 * wall.radius * np.sin(half), 2)
    near: list[list[int]] = list(sides.query_ball_point(wall.centre + wanted @ wall.axes, OFF_M))  # type: ignore[arg-type]
    at = np.repeat(np.arange(len(wanted)), [len(row) for row in near])
    side = np.concatenate([np.asarray(row, np.int64) for row in near])
    corners = wall.local(triangles[side // 3])
    row, first = np.arange(len(side)), side % 3
    begin, end = corners[row, first], corners[row, (first + 1) % 3]
    apart = np.linalg.norm((begin + end) / 2 - wanted[at], axis=1)
    on = np.ptp(corners[..., 2], axis=1) < OFF_M
    on &= abs(np.linalg.norm(end - begin, axis=1) - size[at]) < OFF_M
    rank = np.lexsort((apart, side))
    on[rank[1:]] &= np.diff(side[rank]) > 0  # a side lies on the nearest chord only
    inside = (corners.mean(1)[on, :2] * wanted[at[on], :2]).sum(1) < (wanted[at[on], :2] ** 2).sum(1)
    caps = np.zeros(len(wanted))
    np.add.at(caps, at[on], np.where(inside, 1.0, -1.0))
    return caps.reshape(2, -1).T


def connected_parts(surface: SmoothSurface) -> list[Longs]:
    """Split a surface into its connected parts."""
    return _connected(surface.corners, np.zeros(len(surface.area), np.int32), _ONE)


def _connected(corners: Floats, object_ids: Ints, limits: Creases) -> list[Longs]:
    """Group triangles (f, 3, 3) of one object into surfaces without creases."""
    if not len(corners):
        return []
    a, b = twin_edges(corners)
    smooth = (object_ids[a // 3] == object_ids[b // 3]) & goes_on(corners, a, b, object_ids, limits)
    a, b = a[smooth] // 3, b[smooth] // 3
    name = linked(a, b, len(corners))
    groups = np.split(np.argsort(name, kind="stable"), np.cumsum(np.bincount(name))[:-1])
    return [group for group in groups if len(group) >= _FEWEST]


def _fit_cylinder(corners: Floats, normals: Floats, area: Floats, object_id: int) -> Quadric | None:
    """Fit a cylinder to triangles (n, 3, 3), if they lie on one; caps that close it smoothly are left out."""
    kept, turn, settled = _search_axis(normals, area)
    axis = turn[:, 0]
    if area[kept].sum() < _MOST * area.sum() or not settled:
        return None
    climb = np.diff((corners[kept][0] @ axis)[[0, 1, 2, 0]])
    axis = axis * np.sign(climb[(abs(climb) > 0.1 * abs(climb).max()).argmax()])  # sign of the mesh, not of the world
    axes = np.stack([turn[:, 2], np.cross(axis, turn[:, 2]), axis])
    points = corners[kept] @ axes.T
    flat = points[..., :2].reshape(-1, 2)
    middle = flat.mean(0)
    equations = np.column_stack([2 * (flat - middle), np.ones(len(flat))])
    (x, y, _), *_ = np.linalg.lstsq(equations, ((flat - middle) ** 2).sum(1), rcond=None)
    centre = middle + np.array([x, y])
    away = np.linalg.norm(flat - centre, axis=1)
    off = np.ptp(away)
    if off > min(2 * OFF_M, _DEEP * away.mean()) or _angle_covered(flat - centre) < np.deg2rad(_ARC_DEG):
        return None
    # angles start opposite a corner of the mesh: they turn with it, and no strip crosses the seam
    turned = -_rows_towards(flat[0] - centre)
    axes = np.concatenate([turned @ axes[:2], axes[2:]])
    points[..., :2], centre = points[..., :2] @ turned.T, turned @ centre
    halves = (points + np.roll(points, 1, 1))[..., :2] / 2 - centre  # of sides: exact for squares
    gaps = np.linalg.norm(halves, axis=2)
    radius = float(away.mean())
    least, most = points[..., 2].min(), points[..., 2].max()
    return Quadric(np.append(centre, 0.0) @ axes, axes, radius, float(least), float(most),
                 float(max(away.max() - radius, radius - gaps.min())), _widest_extent(points), object_id,
                 strips=_strips(points, centre, area[kept]))  # fmt: skip


def _rows_towards(direction: Floats) -> Floats:
    """Return rows (2, 2): a direction (2) as a unit vector, and that vector turned by 90 deg."""
    x, y = direction / np.linalg.norm(direction)
    return np.array([[x, y], [-y, x]])


def _search_axis(normals: Floats, area: Floats) -> tuple[Bools, Floats, bool]:
    """Search the axis of facets: those along it (n), columns (3, 3) with the axis first, whether this converged."""
    kept = np.ones(len(area), bool)
    for search in range(4):
        _, turn = np.linalg.eigh(np.einsum("n,ni,nj->ij", area[kept], normals[kept], normals[kept]))
        if search == 0:  # in a vessel with flat heads many normals lie along the axis
            walls = area @ (abs(normals @ turn) < _LEVEL)
            turn = np.roll(turn, -int(walls.argmax()), axis=1)
        level = abs(normals @ turn[:, 0]) < _LEVEL
        if (level == kept).all() or not level.any():
            break
        kept = level
    return kept, turn, bool((level == kept).all())


def along_axis(normals: Floats, area: Floats) -> Bools:
    """Select the facets (n) of a surface that lie along the axis of its cylinder, if it has one."""
    kept, _, settled = _search_axis(normals, area)
    return kept if settled else np.zeros(len(area), bool)


def _strips(points: Floats, centre: Floats, area: Floats) -> Floats:
    """Find strips (s, 4) along the axis that triangles (n, 3, 3) fill: angle, half width [rad], low, high.

    Strips with gaps and strips that are not rectangles are left out.
    """
    x, y = np.moveaxis(points[..., :2] - centre, 2, 0)
    angle = np.arctan2(y, x)
    first = angle[:, :1]
    turned = (angle - first + np.pi) % (2 * np.pi) - np.pi
    low, high = first[:, 0] + turned.min(1), first[:, 0] + turned.max(1)
    middle, half = ((low + high) / 2 + np.pi) % (2 * np.pi) - np.pi, (high - low) / 2
    order = np.lexsort((half, middle))
    apart = (np.diff(middle[order]) > _SAME_RAD) | (abs(np.diff(half[order])) > _SAME_RAD)
    out = []
    for mine in np.split(order, np.flatnonzero(apart) + 1):
        heights, width = points[mine][..., 2], 2 * half[mine[0]] * np.hypot(x[mine[0], 0], y[mine[0], 0])
        bottom, top = heights.min(), heights.max()
        if abs(area[mine].sum() - width * (top - bottom)) < _FILLED * width * (top - bottom):
            out.append((middle[mine[0]], half[mine[0]], bottom, top))
    return np.array(out).reshape(-1, 4)


def sphere_through(points: Floats) -> tuple[Floats, float, float]:
    """Fit a sphere to points (n, 3) by least squares: centre, radius and largest spread of the distances from it [m].

    The spread is infinite where the points do not determine a sphere, such as points of one plane.
    """
    middle = points.mean(0)
    equations = np.column_stack([2 * (points - middle), np.ones(len(points))])
    (x, y, z, _), *_, rank, _ = np.linalg.lstsq(equations, ((points - middle) ** 2).sum(1), rcond=1e-9)
    centre = middle + np.array([x, y, z])
    away = np.linalg.norm(points - centre, axis=1)
    return (centre, float(away.mean()), float(np.ptp(away))) if rank == 4 else (np.zeros(3), 0.0, np.inf)


def _fit_sphere(corners: Floats, normals: Floats, area: Floats, object_id: int) -> Quadric | None:
    """Fit a sphere to triangles (n, 3, 3), if they lie on one."""
    centre, mean, off = sphere_through(corners.reshape(-1, 3))
    if off > 2 * OFF_M or mean < LEAST_M or area.sum() < _MOST * 4 * np.pi * mean**2:
        return None
    out = corners.mean(1) - centre
    if (abs((out * normals).sum(1)) < _BENT * np.linalg.norm(out, axis=1)).any():
        return None
    gaps = np.linalg.norm((corners + np.roll(corners, 1, 1)) / 2 - centre, axis=2)
    radius = float(np.sum(area * gaps.mean(1)) / area.sum())
    sides = np.linalg.norm(np.roll(corners, 1, 1) - corners, axis=2)
    depth = float(max(np.linalg.norm(corners - centre, axis=2).max() - radius, radius - gaps.min()))
    if depth > _DEEP * radius:
        return None
    return Quadric(
        centre, np.eye(3), radius, -radius, radius, depth, float(sides.min(1).max()), object_id, is_sphere=True
    )


def _angle_covered(points: Floats) -> float:
    """Measure the angle that points (n, 2) cover around the origin [rad]."""
    angle = np.sort(np.arctan2(points[:, 1], points[:, 0]))
    return float(2 * np.pi - np.diff(np.append(angle, angle[0] + 2 * np.pi)).max())


def _widest_extent(points: Floats) -> float:
    """Measure the smaller extent, around or along, of the widest of triangles (n, 3, 3) [m]."""
    sides = np.roll(points, 1, 1) - points
    around = np.linalg.norm(sides[..., :2], axis=2).max(1)
    return float(np.minimum(around, np.ptp(points[..., 2], axis=1)).max())
