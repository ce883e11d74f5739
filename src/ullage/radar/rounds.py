"""Round walls and bodies in a mesh: which facets lie on one cylinder, and where its axis runs, or on one ball.

They come as flat strips or small triangles. What a wave makes of them on the way to another bounce hangs on their
curvature, which no single facet has, so the cylinder or the ball through them is found once for a world.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ullage.arrays import Bools, Floats, Ints, Longs
from ullage.radar.facets import SMOOTH_DEG, twins
from ullage.world.scene import Scene

OFF_M = 2.5e-3
"""Corners of facets may lie so far off the cylinder [m]: a sixteenth of a wave."""
LEAST_M = 0.08
"""Narrower or shorter things are no mirrors, but two waves in size [m]."""
_LEVEL = 0.02  # facets whose normal leans more along the axis belong to an end cap
_MOST = 0.35  # less of a smooth surface is no wall between caps but the belt of a ball
_DEEP = 0.05  # facets that bend by `SMOOTH_DEG` lie by half of this share of a ball's radius within it
_ARC_DEG = 100.0  # less of a circle mirrors nothing to its own other side
_FEWEST = 16  # triangles
_SAME_RAD = 1e-4  # lines along the axis nearer to each other than this are one
_FILLED = 0.02  # gaps of a strip that is whole, for rounding and chords


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """A surface that is part of one circular cylinder or one ball."""

    centre: Floats  # (3) a point of the axis [m]
    axes: Floats  # (3, 3) rows: two unit vectors across the axis, and the axis
    radius: float  # of a cylinder at the facets' corners, of a ball the mean over the facets [m]
    low: float  # where the wall begins along the axis, from the centre [m]
    high: float  # and where it ends [m]
    depth: float  # by so much facets lie nearer to the axis or farther from it [m]
    widest: float  # smaller extent of the widest facet [m]
    object_id: int  # object
    ball: bool = False
    strips: Floats = field(default_factory=lambda: np.zeros((0, 4)))  # (s, 4) angle, half width [rad], low, high [m]
    caps: Floats = field(default_factory=lambda: np.zeros((0, 2)))  # (s, 2) flat face at either end: 1, at holes -1
    faces: Longs = field(default_factory=lambda: np.zeros(0, np.int64))  # (n) faces of the scene that lie on it

    def local(self, points: Floats) -> Floats:
        """Points (..., 3) as seen from the centre along the axes [m]."""
        return np.asarray(((points - self.centre).reshape(-1, 3) @ self.axes.T).reshape(points.shape))

    def holds(self, other: Round) -> bool:
        """Whether another body stands within this wall, as far as its middle tells."""
        x, y, z = self.local(other.centre + 0.5 * (other.low + other.high) * other.axes[2])
        return bool(not self.ball and np.hypot(x, y) + other.radius < self.radius and self.low < z < self.high)

    def moved(self, move: Floats) -> Round:
        """The same after a rigid motion (4, 4)."""
        turn = move[:3, :3]
        return replace(self, centre=turn @ self.centre + move[:3, 3], axes=self.axes @ turn.T)


@dataclass(frozen=True, slots=True, eq=False)
class Shell:
    """Triangles of one object that go on from each to the next with hardly a bend."""

    corners: Floats  # (n, 3, 3) [m]
    normals: Floats  # (n, 3)
    area: Floats  # (n) [m2]
    object_id: int  # object
    faces: Longs = field(default_factory=lambda: np.zeros(0, np.int64))  # (n) of the scene

    def take(self, which: NDArray[np.integer]) -> Shell:
        """Some of them."""
        return Shell(self.corners[which], self.normals[which], self.area[which], self.object_id, self.faces[which])


def shells_of(scene: Scene, faces: Bools) -> list[Shell]:
    """The smooth surfaces among some faces (f) of a scene, as they stand at its start."""
    corners = scene.corners()[faces]
    object_ids = scene.face_object[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1) / 2
    kept = area > 1e-12
    corners, object_ids, area, normals = (
        corners[kept],
        object_ids[kept],
        area[kept],
        normals[kept] / (2 * area[kept, None]),
    )
    index = np.flatnonzero(faces)[kept]
    return [Shell(corners[mine], normals[mine], area[mine], int(object_ids[mine[0]]), index[mine])
            for mine in _connected(corners, normals, object_ids)]  # fmt: skip


def rounds_of(shells: Sequence[Shell]) -> tuple[Round, ...]:
    """The round walls and bodies among smooth surfaces."""
    found = []
    for shell in shells:
        told = shell.corners, shell.normals, shell.area, shell.object_id
        ball, wall = _ball(*told), _fitted(*told)
        if ball is not None and (wall is None or ball.depth < 2 * wall.depth):  # the rims of a drum lie on a ball, too
            found.append(replace(ball, faces=shell.faces))
        elif wall is not None:
            found.append(replace(wall, faces=shell.faces[leveled(shell.normals, shell.area)]))
    return tuple(found)


def capped(walls: Sequence[Round], scene: Scene) -> tuple[Round, ...]:
    """The walls, each knowing at which ends of its strips flat faces of its object end, square to the axis."""
    corners, out = scene.corners(), list(walls)
    striped = [k for k, wall in enumerate(walls) if len(wall.strips)]
    for object_id in np.unique([walls[k].object_id for k in striped]):
        mine = corners[scene.face_object == object_id]
        sides = cKDTree(((mine + np.roll(mine, -1, 1)) / 2).reshape(-1, 3), balanced_tree=False, compact_nodes=False)
        for k in striped:
            if walls[k].object_id == object_id:
                out[k] = replace(walls[k], caps=_caps(walls[k], mine, sides))
    return tuple(out)


def _caps(wall: Round, triangles: Floats, sides: cKDTree) -> Floats:
    """Flat faces (s, 2) at the ends of a wall's strips, of triangles (n, 3, 3) and the middles of their sides."""
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


def linked(shell: Shell) -> list[Longs]:
    """The parts of a surface that has come apart."""
    return _connected(shell.corners, shell.normals, np.full(len(shell.area), shell.object_id, np.int32))


def _connected(corners: Floats, normals: Floats, object_ids: Ints) -> list[Longs]:
    """Triangles (f, 3, 3) of one object that go on from each to the next with hardly a bend, surface by surface."""
    if not len(corners):
        return []
    a, b = twins(corners)
    on = (object_ids[a] == object_ids[b]) & (
        abs(np.einsum("ni,ni->n", normals[a], normals[b])) > np.cos(np.deg2rad(SMOOTH_DEG))
    )
    links = coo_array((np.ones(on.sum(), np.int8), (a[on], b[on])), shape=(len(corners), len(corners)))
    count, name = connected_components(links, directed=False)
    order = np.argsort(name, kind="stable")
    groups = np.split(order, np.cumsum(np.bincount(name, minlength=count))[:-1])
    return [group for group in groups if len(group) >= _FEWEST]


def _fitted(corners: Floats, normals: Floats, area: Floats, object_id: int) -> Round | None:
    """The cylinder that triangles (n, 3, 3) lie on, if they do; caps that close it smoothly are left off."""
    kept, turn, settled = _leveled(normals, area)
    axis = turn[:, 0]
    if area[kept].sum() < _MOST * area.sum() or not settled:
        return None
    climb = np.diff((corners[kept][0] @ axis)[[0, 1, 2, 0]])
    axis = axis * np.sign(climb[(abs(climb) > 0.1 * abs(climb).max()).argmax()])  # as the mesh is turned, not the world
    axes = np.stack([turn[:, 2], np.cross(axis, turn[:, 2]), axis])
    points = corners[kept] @ axes.T
    flat = points[..., :2].reshape(-1, 2)
    middle = flat.mean(0)
    told = np.column_stack([2 * (flat - middle), np.ones(len(flat))])
    (x, y, _), *_ = np.linalg.lstsq(told, ((flat - middle) ** 2).sum(1), rcond=None)
    centre = middle + np.array([x, y])
    away = np.linalg.norm(flat - centre, axis=1)
    if np.ptp(away) > 2 * OFF_M or away.mean() < LEAST_M or _arc(flat - centre) < np.deg2rad(_ARC_DEG):
        return None
    # angles begin opposite a corner of the mesh: they turn with it, and no strip lies across their seam
    turned = -_about(flat[0] - centre)
    axes = np.concatenate([turned @ axes[:2], axes[2:]])
    points[..., :2], centre = points[..., :2] @ turned.T, turned @ centre
    halves = (points + np.roll(points, 1, 1))[..., :2] / 2 - centre  # of sides: exact for squares
    gaps = np.linalg.norm(halves, axis=2)
    radius = float(away.mean())
    least, most = points[..., 2].min(), points[..., 2].max()
    if most - least < LEAST_M:
        return None
    return Round(np.append(centre, 0.0) @ axes, axes, radius, float(least), float(most),
                 float(max(away.max() - radius, radius - gaps.min())), _widest(points, centre), object_id,
                 strips=_strips(points, centre, area[kept]))  # fmt: skip


def _about(direction: Floats) -> Floats:
    """Rows (2, 2): a direction (2) as a unit vector, and the one a quarter turn on."""
    x, y = direction / np.linalg.norm(direction)
    return np.array([[x, y], [-y, x]])


def _leveled(normals: Floats, area: Floats) -> tuple[Bools, Floats, bool]:
    """Which facets (n) lie along an axis; columns (3, 3), the axis first; whether the search for it has settled."""
    kept = np.ones(len(area), bool)
    for search in range(4):
        _, turn = np.linalg.eigh(np.einsum("n,ni,nj->ij", area[kept], normals[kept], normals[kept]))
        if search == 0:  # of a vessel with flat heads the axis is not what fewest facets look along
            walls = area @ (abs(normals @ turn) < _LEVEL)
            turn = np.roll(turn, -int(walls.argmax()), axis=1)
        level = abs(normals @ turn[:, 0]) < _LEVEL
        if (level == kept).all() or not level.any():
            break
        kept = level
    return kept, turn, bool((level == kept).all())


def leveled(normals: Floats, area: Floats) -> Bools:
    """Which facets (n) of a surface are a cylinder's, if it has one: those along the axis."""
    kept, _, settled = _leveled(normals, area)
    return kept if settled else np.zeros(len(area), bool)


def _strips(points: Floats, centre: Floats, area: Floats) -> Floats:
    """Strips (s, 4) between lines along the axis that triangles (n, 3, 3) fill: angle, half width [rad], low, high.

    Those with gaps are left out, and those that are not rectangles.
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


def _ball(corners: Floats, normals: Floats, area: Floats, object_id: int) -> Round | None:
    """The ball that triangles (n, 3, 3) lie on, if they do."""
    points = corners.reshape(-1, 3)
    middle = points.mean(0)
    told = np.column_stack([2 * (points - middle), np.ones(len(points))])
    (x, y, z, _), *_, rank, _ = np.linalg.lstsq(told, ((points - middle) ** 2).sum(1), rcond=1e-9)
    centre = middle + np.array([x, y, z])
    away = np.linalg.norm(points - centre, axis=1)
    whole = 4 * np.pi * away.mean() ** 2
    if rank < 4 or np.ptp(away) > 2 * OFF_M or away.mean() < LEAST_M or area.sum() < _MOST * whole:
        return None
    out = corners.mean(1) - centre
    if (abs((out * normals).sum(1)) < np.cos(np.deg2rad(SMOOTH_DEG)) * np.linalg.norm(out, axis=1)).any():
        return None
    gaps = np.linalg.norm((corners + np.roll(corners, 1, 1)) / 2 - centre, axis=2)
    radius = float(np.sum(area * gaps.mean(1)) / area.sum())
    sides = np.linalg.norm(np.roll(corners, 1, 1) - corners, axis=2)
    depth = float(max(away.max() - radius, radius - gaps.min()))
    if depth > _DEEP * radius:
        return None
    return Round(centre, np.eye(3), radius, -radius, radius, depth, float(sides.min(1).max()), object_id, ball=True)


def _arc(points: Floats) -> float:
    """How much of a circle points (n, 2) about the origin go round [rad]."""
    angle = np.sort(np.arctan2(points[:, 1], points[:, 0]))
    return float(2 * np.pi - np.diff(np.append(angle, angle[0] + 2 * np.pi)).max())


def _widest(points: Floats, centre: Floats) -> float:
    """The smaller extent, around or along, of the widest of triangles (n, 3, 3) [m]."""
    sides = np.roll(points, 1, 1) - points
    around = np.linalg.norm(sides[..., :2], axis=2).max(1)
    return float(np.minimum(around, np.ptp(points[..., 2], axis=1)).max())
