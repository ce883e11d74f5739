"""Closed bodies in a mesh, and which of their faces a radar outside of them cannot see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Bools, Floats, Ints, Longs
from ullage.kernels import outlines as kernel
from ullage.radar.echo_set import Rows
from ullage.world.raycast import Raycaster
from ullage.world.smoothing import linked, welded

SKIN_M = 2e-3
"""Two skins of one sheet are no farther apart [m]; it is the slack of rays."""
LEAVE_M = 1e-5
"""Surfaces nearer than this are in one place, but for rounding [m]."""
PARALLEL = 0.98
"""Least cosine between the normals of two skins."""
_SPREAD = np.concatenate([np.full((1, 3), 1 / 3), np.eye(3) * 0.94 + 0.02, 0.49 - np.eye(3) * 0.47])
"""Where triangles are asked for skins before them: the middle, near the corners, near the middles of the sides."""
EVEN = 1e-6
"""Sizes that differ by a smaller share are equal: no rounding of coordinates chooses between them."""
_CLEAR_M = 1e-3  # a radar this far outside a body's box is outside the body


class Faces(NamedTuple):
    """What triangles belong to."""

    patch: Longs  # (f) flat face of each
    object_ids: Ints  # (f) object of each


@dataclass(frozen=True, slots=True, eq=False)
class Boxes(Rows):
    """Boxes about bodies, along an axis of their own each: they turn as the bodies do."""

    centres: Floats  # (m, 3) [m]
    axes: Floats  # (m, 3, 3) rows: unit vectors
    halves: Floats  # (m, 3) half the extent along them [m]


@dataclass(frozen=True, slots=True, eq=False)
class Backs:
    """The outer sides of triangles or faces of closed bodies."""

    outward: Floats  # (n, 4) plane [normal, -offset] that is positive outside; 0 for faces of no closed body
    body: Ints  # (n) body of each
    boxes: Boxes  # about the bodies

    def hidden(self, origins: Floats, opaque: Bools) -> Bools:
        """Which faces (n) turn their backs to all of the places (k, 3) outside their bodies, where opaque (n)."""
        out = np.empty(len(opaque), np.bool_)
        some = origins[:1] if (origins == origins[0]).all() else origins
        kernel.hidden(self.outward, self.body, self._held(some), some, opaque, out)
        return out

    def inside(self, origins: Floats) -> Bools:
        """Which faces (n) are of bodies whose boxes hold all of the places (k, 3)."""
        return np.asarray(np.asarray(self._held(origins).all(1))[self.body])

    def take(self, index: NDArray[np.integer]) -> Backs:
        """Those of some of the faces."""
        return Backs(self.outward[index], self.body[index], self.boxes)

    @staticmethod
    def joined(parts: Sequence[Backs]) -> Backs:
        """Those of several parts as one."""
        ends = np.cumsum([0, *(len(part.boxes.centres) for part in parts)])
        boxes = Boxes.joined([part.boxes for part in parts])
        body = [part.body + end for part, end in zip(parts, ends, strict=False)]
        return Backs(np.concatenate([p.outward for p in parts]), np.concatenate(body).astype(np.int32), boxes)

    def _held(self, origins: Floats) -> Bools:
        """Which boxes (m) hold which places (k, 3), nearly: (m, k)."""
        out = np.empty((len(self.boxes.centres), len(origins)), np.bool_)
        places = np.ascontiguousarray(origins)  # the kernel is compiled for one layout
        kernel.held_by(self.boxes.centres, self.boxes.axes, self.boxes.halves, places, _CLEAR_M, out)
        return out


def backs(corners: Floats, normals: Floats, object_ids: Ints) -> Backs:
    """The outer sides of triangles (f, 3, 3) that belong to closed bodies of one object, evenly turned.

    A body is closed where every edge is shared by two triangles that run along it in opposite ways.
    """
    count = len(corners)
    outward = np.zeros((count, 4))
    if not count:
        return Backs(outward, np.zeros(0, np.int32), Boxes(np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3))))
    ids = welded(corners).reshape(-1)
    ids = ids + np.repeat(object_ids.astype(np.int64), 3) * (int(ids.max()) + 1)
    tri = ids.reshape(-1, 3)
    start, end = tri.ravel(), np.roll(tri, -1, 1).ravel()
    wide = int(ids.max()) + 1
    ahead, back = start * wide + end, end * wide + start
    order = np.argsort(ahead, kind="stable")
    place = np.minimum(np.searchsorted(ahead[order], back), len(order) - 1)
    twin = order[place]
    once = np.diff(np.searchsorted(ahead[order], np.stack([ahead, ahead + 1], 1)), axis=1)[:, 0] == 1
    good = (ahead[twin] == back) & once & once[twin]
    face = np.repeat(np.arange(count), 3)
    body = linked(face[good], face[twin[good]], count)
    total = int(body.max()) + 1
    closed = np.ones(total, bool)
    closed[body[face[~good]]] = False
    volume = np.bincount(body, np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])), total)
    sign = np.where(closed, np.sign(volume), 0.0)[body]
    outward[:, :3] = sign[:, None] * normals
    outward[:, 3] = -np.einsum("ni,ni->n", outward[:, :3], corners[:, 0])
    return Backs(outward, body.astype(np.int32), _boxes(corners, normals, body, total))


def behind_skins(sides: Backs, corners: Floats, normals: Floats, faces: Faces, rays: Raycaster) -> tuple[Backs, Bools]:
    """Find the triangles that others of their object cover within `SKIN_M`: skins of one sheet.

    Seen from the side of one skin the other is hidden, whatever the slack of rays.

    Args:
        sides: outer sides of the triangles (f), by closed bodies.
        corners: (f, 3, 3) [m].
        normals: (f, 3).
        faces: what the triangles belong to.
        rays: over all of them, by the same numbers.

    Returns:
        The outer sides, where skins have theirs too; which triangles (f) lie behind a skin of a lower number.
    """
    over, under = (_skins(corners, sign * normals, faces, rays) for sign in (1, -1))
    outer = np.einsum("fi,fi->f", sides.outward[:, :3], normals)  # 1, -1, or 0 for faces of no closed body
    covered = (over >= 0) & (outer >= 0), (under >= 0) & (outer <= 0)
    some = np.flatnonzero(covered[0] | covered[1])
    spare = np.zeros(len(corners), bool)
    if not len(some):
        return sides, spare
    spare[some] = (outer[some] == 0) & (np.maximum(over, under)[some] < some)
    outward, body = sides.outward.copy(), sides.body.copy()
    turn = covered[1][some].astype(float) - covered[0][some]
    outward[some, :3] = turn[:, None] * normals[some]
    outward[some, 3] = -np.einsum("ni,ni->n", outward[some, :3], corners[some, 0]) - (turn == 0)
    body[some] = len(sides.boxes.centres)
    nowhere = Boxes(np.zeros((1, 3)), np.eye(3)[None], np.full((1, 3), -1.0))
    return Backs(outward, body, Boxes.joined([sides.boxes, nowhere])), spare


def _skins(corners: Floats, normals: Floats, faces: Faces, rays: Raycaster) -> Longs:
    """Lowest face of the same object close before triangles (f, 3, 3), toward normals (f, 3); -1 where not all over."""
    out = np.full(len(corners), np.iinfo(np.int64).max)
    todo = np.arange(len(corners))
    for share in _SPREAD:
        points, ahead = np.einsum("k,nki->ni", share, corners[todo]), normals[todo]
        near = np.flatnonzero(~rays.visible(points, points + SKIN_M * ahead, slack_m=0.0, leave_m=LEAVE_M))
        met, far, cosine = rays.trace(points[near] + LEAVE_M * ahead[near], ahead[near])
        skin = (far < SKIN_M) & (faces.object_ids[met] == faces.object_ids[todo[near]]) & (cosine > PARALLEL)
        out[todo[near[skin]]] = np.minimum(out[todo[near[skin]]], met[skin])
        bare = np.delete(todo, near[skin])
        todo = todo[~np.isin(faces.patch[todo], faces.patch[bare])]
    kept = np.full(len(corners), -1)
    kept[todo] = out[todo]
    return kept


def _boxes(corners: Floats, normals: Floats, body: NDArray[np.integer], total: int) -> Boxes:
    """Boxes along the largest triangle of each of so many bodies and the shortest side of that: a box fits itself."""
    sides = np.roll(corners, -1, 1) - corners
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    most = np.zeros(total)
    np.maximum.at(most, body, area)
    large = np.flatnonzero(area >= (1 - EVEN) * most[body])
    lead = large[np.unique(body[large], return_index=True)[1]]
    size = np.linalg.norm(sides[lead], axis=2)
    short = (size <= (1 + EVEN) * size.min(1, keepdims=True)).argmax(1)
    along = sides[lead, short] / size[np.arange(total), short, None]
    axes = np.stack([along, np.cross(normals[lead], along), normals[lead]], 1)
    low, high = np.full((total, 3), np.inf), np.full((total, 3), -np.inf)
    for k in range(3):
        places = np.einsum("ni,nci->nc", axes[body, k], corners)
        np.minimum.at(low[:, k], body, places.min(1))
        np.maximum.at(high[:, k], body, places.max(1))
    return Boxes(np.einsum("mk,mki->mi", (low + high) / 2, axes), axes, (high - low) / 2)
