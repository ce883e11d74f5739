"""Warnings of the physical radar about meshes, poses and settings that make echoes doubtful."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from weakref import WeakSet

import numpy as np

from ullage.arrays import Bools, Floats, Longs
from ullage.data import Trajectory
from ullage.errors import UllageWarning
from ullage.radar.facets import only
from ullage.radar.folding import warn_of_folding
from ullage.radar.prepared import Prepared, prepare
from ullage.specs import RadarSpec
from ullage.world.raycast import Raycaster
from ullage.world.scene import Scene
from ullage.world.smoothing import welded

NEAREST_M = 0.05
"""Surfaces nearer than this to a sensor are not in its far field: a bit over a wavelength [m]."""
_POSES = 200  # largest number of checked poses along a track
_CHECKED: WeakSet[Prepared] = WeakSet()


def check(scene: Scene, path: Trajectory, sensors: Mapping[str, RadarSpec]) -> None:
    """Warn, in one line each, about meshes, poses and settings that make echoes doubtful.

    Args:
        scene: the world.
        path: the body's poses.
        sensors: its radars.
    """
    world = prepare(scene)
    if world not in _CHECKED:
        _CHECKED.add(world)
        _warn(_meshes(scene), scene.name)
    for spec in {s.name: s for s in sensors.values()}.values():
        warn_of_folding(spec)
    others = only(scene, ~world.own[scene.face_object])
    if len(others.faces) and len(path):
        step = max(1, len(path) // _POSES)
        for name, spec in sensors.items():
            at = path[::step].mounted(spec.mount.body_from_sensor())
            _warn(_places(others, at.position, at.t_ns, name), scene.name)


def _warn(lines: list[str], where: str) -> None:
    for line in lines:
        warnings.warn(f"{where}: {line}", UllageWarning, stacklevel=5)


def _meshes(scene: Scene) -> list[str]:
    """Describe the defects of the scene's meshes, by object."""
    out: list[str] = []
    if not len(scene.faces):
        return out
    corners = scene.corners()
    tri = welded(corners)
    ends = _edges(tri).outline  # open edges without a neighbour, such as a window's in its frame
    for index in np.unique(scene.face_object):
        mine = scene.face_object == index
        name, edges = scene.objects[index].name, _edges(tri[mine])
        if edges.flipped and not edges.open:  # a sheet has no outside
            out.append(
                f"{edges.flipped} edges of {name!r} join faces of opposite orientation; faces echo on both sides"
            )
        hole = corners[mine].reshape(-1, 3)[np.isin(tri[mine].ravel(), edges.outline)]
        # the outline of a sheet is as large as the sheet: that is no hole
        if np.isin(edges.outline, ends).any() and _size(hole) < 0.9 * _size(corners[mine].reshape(-1, 3)):
            out.append(f"the mesh of {name!r} is not closed: {edges.open} of its edges have one face only")
    low, middle, high = np.sort(tri, axis=1).T
    wide = int(tri.max()) + 1
    first, count = np.unique(low * wide + middle, return_counts=True)
    again = np.isin(low * wide + middle, first[count > 1])
    _, count = np.unique(np.stack([low, middle, high])[:, again], axis=1, return_counts=True)
    if (count > 1).any():
        out.append(f"{int((count - 1).sum())} faces coincide with others; each of them echoes")
    return out


def _size(points: Floats) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0)))


@dataclass(frozen=True, slots=True)
class _Edges:
    flipped: int  # between two faces of opposite orientation
    open: int  # with one face only
    outline: Longs  # corners of those


def _edges(tri: Longs) -> _Edges:
    ahead = np.stack([tri, np.roll(tri, -1, 1)], -1).reshape(-1, 2)
    ahead = ahead[ahead[:, 0] != ahead[:, 1]]
    wide = int(tri.max()) + 1
    key = np.minimum(*ahead.T) * wide + np.maximum(*ahead.T)
    both, index, count = np.unique(key, return_inverse=True, return_counts=True)
    up = np.bincount(index, ahead[:, 0] < ahead[:, 1], minlength=len(both))
    alone = both[count == 1]
    return _Edges(int(((count == 2) & (up != 1)).sum()), len(alone), np.unique(np.r_[alone // wide, alone % wide]))


def _places(scene: Scene, position: Floats, t_ns: Longs, name: str) -> list[str]:
    """Describe poses of a sensor inside a body or too near to a surface."""
    rays = Raycaster(scene)
    around = np.concatenate([np.eye(3), -np.eye(3)])
    start = np.repeat(position, len(around), axis=0)
    face, distance = rays.hits(start, np.tile(around, (len(position), 1)), t_ns=np.repeat(t_ns, len(around)))
    met = (face >= 0).reshape(len(position), -1)
    out = []
    near = distance.min(initial=np.inf)
    if near < NEAREST_M:
        k = int(distance.argmin())
        thing = scene.objects[rays.owner[face[k]]].name
        out.append(f"sensor {name!r} comes within {abs(near) * 1e3:.0f} mm of {thing!r}, nearer than a wave; its "
                   "echoes there are rough")  # fmt: skip
    solid = _solids(scene)
    owner = np.where(met, rays.owner[np.maximum(face, 0)].reshape(met.shape), -1)
    inside = met.all(1) & (owner == owner[:, :1]).all(1) & solid[np.maximum(owner[:, 0], 0)]
    return out + [f"sensor {name!r} is inside {scene.objects[k].name!r}: it sees its inner side"
                  for k in np.unique(owner[inside, 0])]  # fmt: skip


def _solids(scene: Scene) -> Bools:
    """Return which objects are closed with outward faces; rooms have inward faces."""
    out = np.zeros(max(len(scene.objects), 1), bool)
    corners = scene.corners()
    tri = welded(corners)
    for index in np.unique(scene.face_object):
        mine = scene.face_object == index
        edges = _edges(tri[mine])
        a, b, c = (corners[mine, k] - corners[mine].mean((0, 1)) for k in range(3))
        out[index] = not edges.flipped and not edges.open and np.einsum("ni,ni->n", a, np.cross(b, c)).sum() > 0
    return out
