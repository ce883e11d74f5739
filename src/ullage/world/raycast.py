"""First hits of rays on a scene: ids from Embree (float32), distances recomputed in float64 [Embree].

Static geometry is built once; each moving object keeps its own tree in its own frame, and rays are brought to it,
so that time may differ from ray to ray and nothing is rebuilt. A built caster may be used from several threads.
Meshes that share vertices are tight along their edges (Embree's robust mode); of rays aimed exactly at a vertex 0.6 %
slip through.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ullage.arrays import Bools, Floats, Ints, Longs, Singles
from ullage.errors import InputError
from ullage.kernels.rays import EmbreeHits, MeshFaces, NearestHits, Rays, RoundWires, aim, refine_faces, refine_wires
from ullage.world.scene import Motion, Scene
from ullage.world.smoothing import face_normals, half_edges

_SIDES = 8
"""Sides of the prism that stands for a round wire in Embree."""
_PER_WIRE = 2 * _SIDES + 2 * (_SIDES - 2)


class FirstFaces(NamedTuple):
    """What rays (n) meet first of one body."""

    faces: Longs  # (n) face, -1 where nothing is met
    corners: Floats  # (f, 3, 3) of all faces, in the body's frame [m]
    neighbours: Longs  # (f, 3) face across the edge from each corner to the next; -1 where there is none
    pose: Floats | None  # (4, 4) world_from_body; None: the body is in the world's frame


class Raycaster:
    """Casts rays into a scene.

    Faces are numbered as in the scene. With `wires`, wire `w` has the number `len(scene.faces) + w`.

    Args:
        scene: what can be hit.
        wires: whether rays meet wires, with their true radius.
    """

    def __init__(self, scene: Scene, *, wires: bool = False) -> None:
        self.corners: Floats = scene.corners()
        self.normals: Floats = face_normals(self.corners)[0]
        ids = np.concatenate([scene.face_object, scene.wires.object_id if wires else np.zeros(0, np.int32)])
        self.owner: Ints = ids.astype(np.int32)
        """Object index of each face, then of each wire."""
        self._bodies = tuple(_bodies(scene, wires=wires))
        self._own_corners = scene.vertices[scene.faces] if self.moving else self.corners  # as bodies know them
        self._found_neighbours: list[Longs] = []  # shared with copies of this caster, found when first asked for

    @property
    def moving(self) -> bool:
        """Whether anything moves."""
        return any(body.motion is not None for body in self._bodies)

    def hits(self, origins: ArrayLike, directions: ArrayLike, *, t_ns: ArrayLike | None = None) -> tuple[Ints, Floats]:
        """First face each ray meets.

        Args:
            origins: (n, 3) or (3) [m].
            directions: (n, 3) unit vectors.
            t_ns: time of each ray (n), or of all; None: their start, or the time of a live motion.

        Returns:
            Face ids (n), -1 where nothing is hit, and distances (n) [m], inf there.
        """
        face, distance, _ = self.trace(origins, directions, t_ns=t_ns)
        return face, distance

    def trace(
        self, origins: ArrayLike, directions: ArrayLike, *, t_ns: ArrayLike | None = None
    ) -> tuple[Ints, Floats, Floats]:
        """As `hits`, and |cos| of the angle between ray and surface normal (n), 0 where nothing is hit."""
        start, rays = _rays(origins, directions)
        face = np.full(len(rays), -1, np.int32)
        distance, cosine = np.full(len(rays), np.inf), np.zeros(len(rays))
        for body in self._bodies:
            body.meet(*self._seen_by(body, start, rays, t_ns), face, distance, cosine)
        return face, distance, cosine

    def distances(self, origins: ArrayLike, directions: ArrayLike, *, t_ns: ArrayLike | None = None) -> Floats:
        """Distance along each ray to the first hit [m], inf where none, to about a millionth of the scene's size."""
        start, rays = _rays(origins, directions)
        reach = np.full(len(rays), np.float32(_FAR))
        for body in self._bodies:
            reach = body.query(*self._seen_by(body, start, rays, t_ns), "DISTANCE", reach)
        return np.where(reach < _FAR, reach.astype(np.float64), np.inf)

    def visible(
        self,
        origin: ArrayLike,
        targets: ArrayLike,
        *,
        slack_m: float = 1e-3,
        leave_m: float = 0.0,
        t_ns: ArrayLike | None = None,
    ) -> Bools:
        """Return whether the line from origin (3) or (n, 3) to each target (n, 3) is free.

        Surfaces within `slack_m` of the target or `leave_m` of the origin do not count.
        """
        ends = np.ascontiguousarray(np.asarray(targets, np.float64).reshape(-1, 3))
        starts = np.ascontiguousarray(np.asarray(origin, np.float64).reshape(-1, 3))
        clear = None
        for body in self._bodies:
            here, there = starts, ends
            if body.motion is not None:
                here, there = (self._seen_by(body, p, p, t_ns)[0] for p in (np.broadcast_to(starts, ends.shape), ends))
            open_ = body.open(here, there, leave_m, slack_m)
            clear = open_ if clear is None else clear & open_
        return np.ones(len(ends), bool) if clear is None else clear

    def first_faces(
        self, origin: Floats, targets: Floats, *, leave_m: float = 0.0, slack_m: float = 1e-3
    ) -> Iterator[FirstFaces]:
        """Find what of each body stands first between an origin (3) and targets (n, 3).

        What stands within `slack_m` of the target or `leave_m` of the origin does not count.
        """
        for body in self._bodies:
            here, there, pose = origin.reshape(1, 3), targets, None
            if body.motion is not None:
                pose = body.pose if body.pose is not None else body.motion.at(body.motion.t_ns[:1]).world_from_body[0]
                here, there = (np.ascontiguousarray((p - pose[:3, 3]) @ pose[:3, :3]) for p in (here, there))
            faces = body.first(here, there, leave_m, slack_m)
            yield FirstFaces(faces, self._own_corners, self._neighbours(), pose)

    def _neighbours(self) -> Longs:
        if not self._found_neighbours:
            self._found_neighbours.append(_neighbours(self._own_corners))
        return self._found_neighbours[0]

    def standing(self, poses: Floats) -> Raycaster:
        """Return the caster with every object fixed at poses (o, 4, 4); `corners` and `normals` stay."""
        out = copy(self)
        out._bodies = tuple(replace(b, pose=None if b.motion is None else poses[b.thing]) for b in self._bodies)
        return out

    def _seen_by(self, body: _Body, start: Floats, rays: Floats, t_ns: ArrayLike | None) -> tuple[Floats, Floats]:
        if body.motion is None:
            return start, rays
        if body.pose is not None and t_ns is None:
            turn = body.pose[:3, :3]
            return np.einsum("ji,nj->ni", turn, start - body.pose[:3, 3]), np.einsum("ji,nj->ni", turn, rays)
        known = body.motion.t_ns
        when = known[0] if t_ns is None else t_ns
        times, which = np.unique(np.clip(np.asarray(when, np.int64), known[0], known[-1]), return_inverse=True)
        pose = body.motion.at(times).world_from_body[np.broadcast_to(which.reshape(-1), len(rays))]
        turn = pose[:, :3, :3]
        return np.einsum("nji,nj->ni", turn, start - pose[:, :3, 3]), np.einsum("nji,nj->ni", turn, rays)


_FAR = 1e30


@dataclass(frozen=True, slots=True, eq=False)
class _Body:
    """Rigid group: an Embree scene about `centre`, and its exact geometry."""

    motion: Motion | None
    thing: int  # object that it is; -1: many that stand still
    pose: Floats | None  # (4, 4) world_from_body where it is known to stand
    tree: Any
    centre: Floats  # (3) subtracted before float32, so that far coordinates keep their precision
    corner: Floats  # (k, 3) one corner of each face
    normal: Floats  # (k, 3)
    face_id: Ints  # (k)
    wire_start: Floats  # (w, 3)
    wire_axis: Floats  # (w, 3) unit
    wire_length: Floats  # (w)
    wire_radius: Floats  # (w)
    wire_id: Ints  # (w)

    def query(self, start: Floats, rays: Floats, query: str, reach: Singles) -> NDArray[Any]:
        near = np.subtract(start, self.centre, dtype=np.float64).astype(np.float32)
        return np.asarray(self.tree.run(near, rays.astype(np.float32), dists=reach.copy(), query=query))

    def open(self, starts: Floats, ends: Floats, before_m: float, after_m: float) -> Bools:
        """Return whether this body leaves the lines between points free, except for given lengths at both ends."""
        if not len(ends):  # an empty Embree query takes as long as a hundred rays
            return np.ones(0, bool)
        return self._between(starts, ends, before_m, after_m, "OCCLUDED") < 0

    def first(self, starts: Floats, ends: Floats, before_m: float, after_m: float) -> Longs:
        """First face of this body between points, but for the first and last metres given; -1 where there is none."""
        found = self._between(starts, ends, before_m, after_m, "INTERSECT")
        known = (found >= 0) & (found < len(self.face_id))
        return np.where(known, self.face_id.take(found, mode="clip"), -1).astype(np.int64)

    def _between(self, starts: Floats, ends: Floats, before_m: float, after_m: float, query: str) -> NDArray[Any]:
        origin, ray = np.empty(ends.shape, np.float32), np.empty(ends.shape, np.float32)
        reach = np.empty(len(ends), np.float32)
        aim(starts, ends, self.centre, float(before_m), float(after_m), origin, ray, reach)
        return np.asarray(self.tree.run(origin, ray, dists=reach, query=query))

    def meet(self, start: Floats, rays: Floats, face: Ints, distance: Floats, cosine: Floats) -> None:
        near = (start - self.centre).astype(np.float32)
        reach = np.minimum(distance * (1 + 1e-6) + 1e-6, _FAR).astype(np.float32)
        found = self.tree.run(near, rays.astype(np.float32), dists=reach, query="INTERSECT", output=True)
        hits, aimed = EmbreeHits(found["primID"], found["tfar"]), Rays(start, rays)
        nearest = NearestHits(face, distance, cosine)
        refine_faces(hits, aimed, MeshFaces(self.corner, self.normal, self.face_id), nearest)
        if len(self.wire_id):
            wires = RoundWires(len(self.corner), _PER_WIRE, self.wire_start, self.wire_axis, self.wire_length,
                               self.wire_radius, self.wire_id)  # fmt: skip
            refine_wires(hits, aimed, wires, nearest)


def _rays(origins: ArrayLike, directions: ArrayLike) -> tuple[Floats, Floats]:
    rays = np.ascontiguousarray(directions, np.float64)
    if rays.ndim != 2 or rays.shape[1] != 3:
        raise InputError(f"directions have shape {rays.shape}", where="rays", allowed="(n, 3)")
    start = np.ascontiguousarray(np.broadcast_to(np.asarray(origins, np.float64), rays.shape))
    return start, rays


def _neighbours(corners: Floats) -> Longs:
    """Find the face across each edge (f, 3) of triangles (f, 3, 3); -1 where there is none, or more than one."""
    _, vertex = np.unique(np.ascontiguousarray(corners.reshape(-1, 3) + 0.0).view("V24"), return_inverse=True)
    order, first, many = half_edges(vertex.reshape(-1, 3).astype(np.int64))
    pair = first[many == 2]
    out = np.full(len(order), -1)
    out[order[pair]], out[order[pair + 1]] = order[pair + 1] // 3, order[pair] // 3
    return out.reshape(-1, 3)


def _bodies(scene: Scene, *, wires: bool) -> Iterator[_Body]:
    moves = np.array([thing.motion is not None for thing in scene.objects], bool)
    face_moves = moves[scene.face_object] if len(scene.face_object) else np.zeros(0, bool)
    wire_moves = moves[scene.wires.object_id] if len(scene.wires) else np.zeros(0, bool)
    groups: list[tuple[int, Bools, Bools]] = [(-1, ~face_moves, ~wire_moves)]
    groups += [(int(k), scene.face_object == k, scene.wires.object_id == k) for k in np.flatnonzero(moves)]
    for thing, of_face, of_wire in groups:
        body = _body(scene, thing, np.flatnonzero(of_face), np.flatnonzero(of_wire) if wires else np.zeros(0, int))
        if body is not None:
            yield body


def _body(scene: Scene, thing: int, faces: NDArray[Any], wires: NDArray[Any]) -> _Body | None:
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    lines = scene.wires
    start, along = lines.start[wires], (lines.end - lines.start)[wires]
    length = np.linalg.norm(along, axis=1)
    axis = along / np.maximum(length, 1e-12)[:, None]
    corners = scene.vertices[scene.faces[faces]]
    solid = np.concatenate([corners, _prisms(start, axis, length, lines.radius_m[wires])])
    if not len(solid):
        return None
    centre = (solid.min((0, 1)) + solid.max((0, 1))) / 2
    tree = EmbreeScene(robust=True)
    TriangleMesh(tree, (solid - centre).astype(np.float32))
    nothing = np.zeros((1, 3), np.float32)
    tree.run(nothing, nothing + np.float32(1), query="OCCLUDED")  # builds the tree now, before threads use it
    motion = None if thing < 0 else scene.objects[thing].motion
    return _Body(
        motion, thing, None, tree, centre, np.ascontiguousarray(corners[:, 0]), face_normals(corners)[0],
        faces.astype(np.int32), start, axis, length, lines.radius_m[wires], (len(scene.faces) + wires).astype(np.int32),
    )  # fmt: skip


def _prisms(start: Floats, axis: Floats, length: Floats, radius: Floats) -> Floats:
    """Triangles (w * _PER_WIRE, 3, 3) of closed prisms whose mean width over all sides is that of the round wire."""
    if not len(start):
        return np.zeros((0, 3, 3))
    least = np.eye(3)[np.argmin(abs(axis), axis=1)]
    side = np.cross(axis, least)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(axis, side)
    turn = 2 * np.pi * (np.arange(_SIDES) + 0.5) / _SIDES
    spread = radius * np.pi / (_SIDES * np.sin(np.pi / _SIDES))
    ring = spread[:, None, None] * (
        np.cos(turn)[None, :, None] * side[:, None] + np.sin(turn)[None, :, None] * other[:, None]
    )
    low = start[:, None] + ring
    high = low + (axis * length[:, None])[:, None]
    nxt = np.roll(np.arange(_SIDES), -1)
    walls = [np.stack([low, low[:, nxt], high], 2), np.stack([high, low[:, nxt], high[:, nxt]], 2)]
    middle = np.arange(1, _SIDES - 1)
    caps = [
        np.stack([np.broadcast_to(end[:, :1], end[:, middle].shape), end[:, middle], end[:, middle + 1]], 2)
        for end in (low, high)
    ]
    return np.asarray(np.concatenate([*walls, *caps], axis=1).reshape(-1, 3, 3))
