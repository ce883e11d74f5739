"""Surfaces of what moves: made ready once, where each thing starts, then carried along as rigid bodies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ullage.arrays import Bools, Floats, Ints
from ullage.geometry import invert
from ullage.radar.facets import PlanarPatches, Surfaces, gather, joined, only
from ullage.radar.patches import Patches
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
        self.home = _together(parts, solid)  # the faces where they start
        self._start = np.stack([invert(pose) for pose in scene.poses()])

    def at(self, poses: Floats) -> Surfaces:
        """Where the objects have these poses (o, 4, 4)."""
        home, moves = self.home, poses @ self._start
        return replace(
            _moved(home, moves),
            planar=_planar(home.planar, moves),
            flat_backs=_backs(home.flat_backs, moves, home.planar.object_ids),
            rays=home.rays.standing(poses),
            split={},
            home=home,
            poses=poses,
        )

    def patches_at(self, patches: Patches, poses: Floats) -> Patches:
        """Curved patches of these faces, cut where they start, where the objects have these poses (o, 4, 4)."""
        moves = poses @ self._start
        return replace(
            patches,
            fine=_moved(patches.fine, moves),
            middles=_carried(patches.middles, moves, patches.owner),
            facing=_turned(patches.facing, moves, patches.owner),
        )


def _moved(home: Surfaces, moves: Floats) -> Surfaces:
    """Surfaces whose triangles, and no flat faces, have gone along with their objects."""
    led = home.object_ids[home.first[:-1]] if len(home.object_ids) else home.object_ids  # a cluster is of one object
    return replace(
        home,
        corners=_carried(home.corners, moves, home.object_ids),
        normals=_turned(home.normals, moves, home.object_ids),
        spheres=_rolled(home.spheres, moves, led),
        backs=_backs(home.backs, moves, home.object_ids),
    )


def _together(parts: Sequence[Surfaces], solid: Scene) -> Surfaces:
    def loose(of: Callable[[Surfaces], Any]) -> Any:
        return np.concatenate([of(part) for part in parts])

    ends = np.cumsum([0, *(len(part.corners) for part in parts)])
    first = [part.first[1:] + end for part, end in zip(parts, ends, strict=False)]
    ahead = np.cumsum([0, *(len(part.planar) for part in parts)])
    flat_at = [part.flat_at + count for part, count in zip(parts, ahead, strict=False)]
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
        loose(lambda p: p.faces),
        loose(lambda p: p.flat_faces),
        np.concatenate(flat_at),
    )


def _turned(rows: Floats, moves: Floats, owner: Ints) -> Floats:
    """Directions (n, ..., 3) of objects (n)."""
    return _by_object(rows, moves, owner, 0.0)


def _carried(rows: Floats, moves: Floats, owner: Ints) -> Floats:
    """Points (n, ..., 3) of objects (n)."""
    return _by_object(rows, moves, owner, 1.0)


def _by_object(rows: Floats, moves: Floats, owner: Ints, shift: float) -> Floats:
    """Turn rows (n, ..., 3) of objects (n) as these move, and shift them by so many times what these go."""
    things = np.flatnonzero(np.bincount(owner))
    if len(things) == 1:
        return _along(rows, moves[things[0]], shift)
    out = np.empty(rows.shape)
    for k in things:  # one product for each object: few things move
        mine = np.flatnonzero(owner == k)
        out[mine] = _along(rows.take(mine, 0), moves[k], shift)
    return out


def _along(rows: Floats, move: Floats, shift: float) -> Floats:
    x, y, z = rows.reshape(-1, 3).T  # by columns: BLAS would start threads for so little
    return np.stack([a * x + b * y + c * z + shift * d for a, b, c, d in move[:3]], -1).reshape(rows.shape)


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
