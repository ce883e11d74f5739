"""Obstacles of a drone: their distance, and whether a point is inside a solid."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ullage.arrays import Floats, Longs
from ullage.world.scene import Motion, Scene


@dataclass(frozen=True)
class Body:
    """Triangles and wires that move together, in their own frame: all static objects, or one moving object."""

    corners: Floats  # (f, 3, 3) [m]
    owner: Longs  # (f) object of each triangle
    wires: Floats  # (w, 2, 3) ends [m]
    wire_radius: Floats  # (w) [m]
    wire_owner: Longs  # (w) object of each wire
    motion: Motion | None = None  # world_from_body; None: static

    @cached_property
    def _balls(self) -> tuple[Floats, Floats]:
        centre = self.corners.mean(1)
        return centre, np.linalg.norm(self.corners - centre[:, None], axis=2).max(1, initial=0.0)

    def gaps(self, point: Floats, reach_m: float, *, squash: float = 1.0) -> tuple[Longs, Floats, Floats]:
        """Triangles nearer than `reach_m` or nearest of all, then wires by index past the triangles.

        Args:
            point: (3) in the body's frame [m].
            reach_m: radius of the search [m].
            squash: heights count this many times; above one, the ball looked in becomes a flat ellipsoid.

        Returns:
            Indices (k), distances (k) [m] and nearest points (k, 3).
        """
        from ullage.kernels.proximity import nearest_points

        scale = np.array([1.0, 1.0, squash])
        centre, radius = self._balls
        away = np.linalg.norm((centre - point) * scale, axis=1)
        near = np.flatnonzero(away - squash * radius <= max(reach_m, np.min(away + squash * radius, initial=np.inf)))
        found = np.empty((len(near), 3))
        nearest_points(point * scale, np.ascontiguousarray(self.corners[near] * scale), found)
        along = self.wires[:, 1] - self.wires[:, 0]
        share = np.einsum("wi,wi->w", point - self.wires[:, 0], along) / np.maximum((along**2).sum(1), 1e-12)
        on_wire = (self.wires[:, 0] + np.clip(share, 0, 1)[:, None] * along) * scale
        spots = np.concatenate([found, on_wire])
        gap = np.linalg.norm(spots - point * scale, axis=1)
        gap[len(near) :] = np.maximum(gap[len(near) :] - self.wire_radius, 0.0)
        index = np.concatenate([near, len(self.corners) + np.arange(len(self.wires))])
        return index, gap, spots / scale

    def owner_of(self, index: int) -> int:
        """Object of a triangle, or of a wire counted past the triangles."""
        count = len(self.corners)
        return int(self.owner[index] if index < count else self.wire_owner[index - count])


def bodies(scene: Scene) -> list[Body]:
    """Return the scene as bodies: first all static objects, then each moving one, without triangles of no area."""
    corners = scene.vertices[scene.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    real = np.linalg.norm(cross, axis=1) > 1e-12
    owner = scene.face_object.astype(np.int64)
    wire_owner = scene.wires.object_id.astype(np.int64)
    wires = np.stack([scene.wires.start, scene.wires.end], axis=1).reshape(-1, 2, 3)
    moving = np.array([thing.motion is not None for thing in scene.objects], bool)
    out = []
    for which in [-1, *np.flatnonzero(moving).tolist()]:
        mine = (owner == which) if which >= 0 else ~moving[owner]
        strung = (wire_owner == which) if which >= 0 else ~moving[wire_owner]
        motion = scene.objects[which].motion if which >= 0 else None
        out.append(
            Body(corners[mine & real], owner[mine & real], wires[strung], scene.wires.radius_m[strung],
                 wire_owner[strung], motion)
        )  # fmt: skip
    return out


def into(body: Body, point: Floats, t_ns: int) -> Floats:
    """A world point (3) in a body's own frame at a time [m]."""
    if body.motion is None:
        return point
    pose = body.motion.at(int(np.clip(t_ns, body.motion.t_ns[0], body.motion.t_ns[-1]))).world_from_body[0]
    return np.asarray(pose[:3, :3].T @ (point - pose[:3, 3]))


class Solids:
    """The closed surfaces of a scene, and which of them hold a point.

    A surface counts when every edge joins exactly two of its triangles and they face outwards. Open shells, and closed
    ones that face inwards (a tank seen from inside), hold nothing: one flies in them.
    """

    def __init__(self, body: Body) -> None:
        self._parts: list[tuple[Floats, int]] = []
        if not len(body.corners):
            return
        keys = np.round(body.corners.reshape(-1, 3), 6) + 0.0  # no minus zero
        _, vertex = np.unique(np.hstack([keys, np.repeat(body.owner, 3)[:, None]]), axis=0, return_inverse=True)
        faces = vertex.reshape(-1, 3)
        edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        _, edge, uses = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
        sound = (uses[edge.ravel()] == 2).reshape(-1, 3).all(1)
        links = coo_array(
            (np.ones(2 * len(faces)), (faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel())),
            shape=(vertex.max() + 1,) * 2,
        )
        part = connected_components(links, directed=False)[1][faces[:, 0]]
        order = np.argsort(part, kind="stable")
        for mine in np.split(order, np.flatnonzero(np.diff(part[order])) + 1):
            shape = body.corners[mine]
            volume = np.einsum("fi,fi->", shape[:, 0], np.cross(shape[:, 1], shape[:, 2])) / 6
            if sound[mine].all() and volume > 1e-9:
                self._parts.append((shape, int(body.owner[mine[0]])))

    def holding(self, point: Floats) -> set[tuple[int, int]]:
        """The closed surfaces around a point (3), each as its number and its object."""
        return {(k, owner) for k, (shape, owner) in enumerate(self._parts) if _winding(shape, point) > 0.5}

    def size_m(self, number: int) -> Floats:
        """Edges (3) of the box around a closed surface, by the number that `holding` gives [m]."""
        corners, _ = self._parts[number]
        return np.asarray(np.ptp(corners.reshape(-1, 3), axis=0))


def _winding(corners: Floats, point: Floats) -> float:
    """How often a surface winds around a point: the sum of its triangles' solid angles [VanOosteromStrackee1983]."""
    low, high = corners.min((0, 1)), corners.max((0, 1))
    if np.any(point < low) or np.any(point > high):
        return 0.0
    a, b, c = np.moveaxis(corners - point, 1, 0)
    na, nb, nc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    top = np.einsum("fi,fi->f", a, np.cross(b, c))
    low_part = na * nb * nc + (a * b).sum(1) * nc + (b * c).sum(1) * na + (c * a).sum(1) * nb
    return float(np.arctan2(top, low_part).sum() / (2 * np.pi))
