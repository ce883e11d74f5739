"""Surfaces of what moves: made ready once, where each thing starts, then carried along as rigid bodies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ullage.arrays import Bools, Floats, Ints
from ullage.geometry import invert
from ullage.radar.facets import PlanarPatches, Surfaces, gather, joined, only
from ullage.radar.solids import Backs, Boxes
from ullage.world.raycast import Raycaster
from ullage.world.scene import Scene


class Movers:
    """The faces of a scene that move.

    Args:
        scene: the world.
        faces: which of its faces move (f).
    """

    def __init__(self, scene: Scene, faces: Bools) -> None:
        owners = np.unique(scene.face_object[faces])
        parts = [gather(scene, faces & (scene.face_object == owner)) for owner in owners]
        solid = only(scene, np.isin(scene.face_object, owners))
        self._home = _together(parts, solid)
        self._start = np.stack([invert(pose) for pose in scene.poses()])

    def at(self, poses: Floats) -> Surfaces:
        """Where the objects have these poses (o, 4, 4)."""
        home, moves = self._home, poses @ self._start
        led = (
            home.object_ids[home.first[:-1]] if len(home.object_ids) else home.object_ids
        )  # a cluster is of one object
        return replace(
            home,
            corners=_carried(home.corners, moves, home.object_ids),
            normals=_turned(home.normals, moves, home.object_ids),
            spheres=_rolled(home.spheres, moves, led),
            backs=_backs(home.backs, moves, home.object_ids),
            planar=_planar(home.planar, moves),
            flat_backs=_backs(home.flat_backs, moves, home.planar.object_ids),
            rays=home.rays.standing(poses),
            split={},
            home=home,
            poses=poses,
        )


def _together(parts: Sequence[Surfaces], solid: Scene) -> Surfaces:
    def loose(of: Callable[[Surfaces], Any]) -> Any:
        return np.concatenate([of(part) for part in parts])

    ends = np.cumsum([0, *(len(part.corners) for part in parts)])
    first = [part.first[1:] + end for part, end in zip(parts, ends, strict=False)]
    backs = Backs.joined([part.backs for part in parts])
    flat_backs = Backs.joined([part.flat_backs for part in parts])
    return Surfaces(
        loose(lambda p: p.corners),
        loose(lambda p: p.normals),
        loose(lambda p: p.object_ids),
        loose(lambda p: p.spheres),
        np.concatenate([np.zeros(1, np.int32), *first]).astype(np.int32),
        backs,
        joined([p.planar for p in parts]),
        flat_backs,
        Raycaster(solid),
        solid,
    )


def _turned(rows: Floats, moves: Floats, owner: Ints) -> Floats:
    """Directions (n, ..., 3) of objects (n)."""
    return np.asarray(np.einsum("nij,n...j->n...i", moves[owner, :3, :3], rows))


def _carried(rows: Floats, moves: Floats, owner: Ints) -> Floats:
    """Points (n, ..., 3) of objects (n)."""
    shift = moves[owner, :3, 3].reshape(len(owner), *(1,) * (rows.ndim - 2), 3)
    return np.ascontiguousarray(_turned(rows, moves, owner) + shift)


def _rolled(spheres: Floats, moves: Floats, owner: Ints) -> Floats:
    return np.concatenate([_carried(spheres[:, :3], moves, owner), spheres[:, 3:]], 1)


def _backs(backs: Backs, moves: Floats, owner: Ints) -> Backs:
    """Planes and boxes as they lie now."""
    normals = _turned(backs.outward[:, :3], moves, owner)
    level = backs.outward[:, 3] - np.einsum("ni,ni->n", normals, moves[owner, :3, 3])
    boxes, object_ = backs.boxes, np.zeros(len(backs.boxes.centres), np.int32)
    object_[backs.body] = owner
    moved = Boxes(_carried(boxes.centres, moves, object_), _turned(boxes.axes, moves, object_), boxes.halves)
    return Backs(np.concatenate([normals, level[:, None]], 1), backs.body, moved)


def _planar(planar: PlanarPatches, moves: Floats) -> PlanarPatches:
    edge_of = np.repeat(planar.object_ids, np.diff(planar.first))
    normals = _turned(planar.normals, moves, planar.object_ids)
    return replace(
        planar,
        normals=normals,
        offsets=planar.offsets + np.einsum("ni,ni->n", normals, moves[planar.object_ids, :3, 3]),
        spheres=_rolled(planar.spheres, moves, planar.object_ids),
        starts=_carried(planar.starts, moves, edge_of),
        ends=_carried(planar.ends, moves, edge_of),
        mirrors=_carried(planar.mirrors, moves, planar.object_ids[planar.flat_of]),
        across=np.ascontiguousarray(_turned(planar.across, moves, planar.object_ids)),
    )
