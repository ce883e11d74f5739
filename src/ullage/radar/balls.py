"""Balls and domes in a mesh: facets whose corners lie on one sphere, and the round openings that they leave in it.

Each comes as flat triangles or quadrangles. All of them together stand for the sphere through their corners, less a
round cap wherever a rim runs: a tank for gas, the heads of a vessel, a bowl. What they echo is told by `ball_echoes`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ullage.arrays import Bools, Floats
from ullage.radar.facets import Surfaces
from ullage.radar.quadrics import LEAST_M, OFF_M, SmoothSurface, along_axis, connected_parts
from ullage.radar.solids import welded

_FEWEST = 16  # triangles
_DEEP = 0.05  # by more than this share of their radius facets do not lie within a ball
_WHOLE = 0.01  # facets must fill all that the rims leave of the ball, to this share of it
_SEEDS = 12  # facets of a surface from which domes are grown
_PATCH = 2.0  # of a facet's longest side lie the middles of those from which one is begun
_TRUE_M = 5e-4  # so far corners of a dome that is grown lie off it at the most [m]
_WIDE_M = 1.0  # smaller surfaces are no vessels, and are not searched for domes
_INNER = 4  # corners off rims
_LEAST_SHARE = 0.02  # of a whole ball: less tells no radius


@dataclass(frozen=True, slots=True, eq=False)
class Ball:
    """A sphere, or what round openings leave of it."""

    centre: Floats  # (3) [m]
    radius: float  # through the facets' corners [m]
    depth: float  # by so much their middles lie nearer to the centre [m]
    widest: float  # smallest side of the widest facet [m]
    object_id: int  # object
    caps: Floats  # (k, 4) openings: unit vector from the centre, and how far out along it each begins [m]
    planar: Bools = field(
        default_factory=lambda: np.zeros(0, bool)
    )  # (p) which flat faces of what stands still are its
    small: Bools = field(default_factory=lambda: np.zeros(0, bool))  # (f) and which small triangles

    def holds(self, points: Floats) -> Bools:
        """Which points (..., 3) on the sphere, seen from its centre [m], lie in no opening."""
        return np.asarray((points @ self.caps[:, :3].T <= self.caps[:, 3] + OFF_M).all(-1))


def balls_of(surfaces: Sequence[SmoothSurface], still: Surfaces) -> tuple[Ball, ...]:
    """The balls and domes among smooth surfaces that stand still, and which faces each is made of."""
    found: list[Ball] = []
    for surface in surfaces:
        whole = _fitted(surface)
        if whole is not None:
            found.append(whole)
        if whole is not None or np.linalg.norm(np.ptp(surface.corners.reshape(-1, 3), axis=0)) < _WIDE_M:
            continue
        level = along_axis(surface.normals, surface.area)
        if level.all():
            continue
        closing = [ball for part in _leftovers(surface, level) if (ball := _fitted(part)) is not None]
        found += closing or _crowns(surface)
    return tuple(_claimed(ball, still) for ball in found)


def _leftovers(surface: SmoothSurface, level: Bools) -> list[SmoothSurface]:
    """What closes a cylinder smoothly: parts of a surface that are left when facets along its axis (n) are taken."""
    if not level.any():
        return []
    rest_of = surface.take(np.flatnonzero(~level))
    return [rest_of.take(mine) for mine in connected_parts(rest_of) if len(mine) >= _FEWEST]


def _crowns(surface: SmoothSurface) -> list[Ball]:
    """Domes that go over into something else as smoothly as into themselves, grown from some of the facets."""
    middles, sides = surface.corners.mean(1), np.linalg.norm(surface.corners - surface.corners[:, [1, 2, 0]], axis=2)
    found, open_ = [], np.ones(len(middles), bool)
    for seed in np.linspace(0, len(middles) - 1, _SEEDS).astype(np.int64):
        mine = np.flatnonzero(np.linalg.norm(middles - middles[seed], axis=1) < _PATCH * sides[seed].max())
        for _ in range(2):  # what the first few tell, and what all of those tell
            centre, radius, off = _sphere(surface.corners[mine].reshape(-1, 3))
            if not open_[seed] or off > _TRUE_M:
                break
            on = (abs(np.linalg.norm(surface.corners - centre, axis=2) - radius) < _TRUE_M).all(1) & open_
            mine = np.flatnonzero(on)
            if len(mine) < _FEWEST or not on[seed]:
                break
            mine = next((mine[part] for part in connected_parts(surface.take(mine)) if seed in mine[part]), mine[:0])
        else:
            open_[mine] = False
            ball = _fitted(surface.take(mine)) if len(mine) >= _FEWEST else None
            found += [ball] if ball is not None else []
    return found


def _sphere(points: Floats) -> tuple[Floats, float, float]:
    """Centre and radius of the sphere through points (n, 3), and how far they lie off it at the most [m]."""
    middle = points.mean(0)
    told = np.column_stack([2 * (points - middle), np.ones(len(points))])
    (x, y, z, _), *_, rank, _ = np.linalg.lstsq(told, ((points - middle) ** 2).sum(1), rcond=1e-9)
    centre = middle + np.array([x, y, z])
    away = np.linalg.norm(points - centre, axis=1)
    return centre, float(away.mean()), float(np.ptp(away)) if rank == 4 else np.inf


def _fitted(surface: SmoothSurface) -> Ball | None:
    """The ball or dome that a surface is, if it is one."""
    centre, radius, off = _sphere(surface.corners.reshape(-1, 3))
    if off > 2 * OFF_M or radius < LEAST_M:
        return None
    local = surface.corners - centre
    sides = np.linalg.norm(np.roll(local, 1, 1) - local, axis=2)
    depth = radius - float(abs(np.einsum("ni,ni->n", local[:, 0], surface.normals)).min())
    caps = _openings(local)
    if caps is None or depth > _DEEP * radius or (caps[:, 3] < -radius).any():
        return None
    share = 1 - ((1 - caps[:, 3] / radius) / 2).sum()
    filled = _solid_angles(local).sum() / (4 * np.pi)
    if share < _LEAST_SHARE or abs(filled - share) > _WHOLE * share:
        return None
    return Ball(centre, radius, depth, float(sides.min(1).max()), surface.object_id, caps)


def _openings(local: Floats) -> Floats | None:
    """Caps (k, 4) that the rims of triangles (n, 3, 3) about the origin cut off.

    None where a rim is no circle, or where hardly a corner lies off rims: those of drums and cones lie on balls, too.
    """
    tri = welded(local)
    edge = np.sort(np.stack([tri, np.roll(tri, -1, 1)], -1), -1).reshape(-1, 2)
    _, first, count = np.unique(edge, axis=0, return_index=True, return_counts=True)
    single = first[count == 1]
    if not len(single):
        return np.zeros((0, 4))
    ends, size = edge[single], int(tri.max()) + 1
    links = coo_array((np.ones(len(ends), np.int8), (ends[:, 0], ends[:, 1])), shape=(size, size))
    loop = connected_components(links, directed=False)[1][ends[:, 0]]
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
    """What triangles (n, 3, 3) fill of the sphere about the origin [sr] (van Oosterom and Strackee's tangent)."""
    a, b, c = (unit / np.linalg.norm(unit, axis=1, keepdims=True) for unit in np.moveaxis(local, 1, 0))
    triple = abs(np.einsum("ni,ni->n", a, np.cross(b, c)))
    ab, bc, ca = ((one * other).sum(1) for one, other in ((a, b), (b, c), (c, a)))
    return np.asarray(2 * np.arctan2(triple, 1 + ab + bc + ca))


def _claimed(ball: Ball, still: Surfaces) -> Ball:
    """The ball with the flat faces and small triangles of what stands still that lie on it."""
    planar, least = still.planar, ball.radius - ball.depth - OFF_M
    small = _on(ball, still.corners).all(1) & (still.object_ids == ball.object_id)
    small &= abs(np.einsum("ni,ni->n", still.normals, still.corners[:, 0] - ball.centre)) > least
    small &= ball.holds(still.corners.mean(1) - ball.centre)
    if not len(planar):
        return replace(ball, planar=np.zeros(0, bool), small=small)
    begin = planar.first[:-1]
    large = np.logical_and.reduceat(_on(ball, planar.starts), begin) & (planar.object_ids == ball.object_id)
    large &= abs(planar.normals @ ball.centre - planar.offsets) > least
    middles = np.add.reduceat(planar.starts, begin) / np.diff(planar.first)[:, None]
    return replace(ball, planar=large & ball.holds(middles - ball.centre), small=small)


def _on(ball: Ball, points: Floats) -> Bools:
    return np.asarray(abs(np.linalg.norm(points - ball.centre, axis=-1) - ball.radius) < 2 * OFF_M)
