"""Closed bodies in a mesh, and which of their faces a radar outside of them cannot see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ullage.arrays import Bools, Floats, Ints, Longs
from ullage.kernels import outlines as kernel

WELD_M = 1e-6
"""Corners nearer than this are one [m]."""
EVEN = 1e-6
"""Sizes that differ by a smaller share are equal: no rounding of coordinates chooses between them."""
_CLEAR_M = 1e-3  # a radar this far outside a body's box is outside the body


def welded(corners: Floats) -> Longs:
    """Numbers (f, 3) of the corners of triangles (f, 3, 3), the same for corners in one place."""
    places = np.round(corners.reshape(-1, 3) / WELD_M).astype(np.int64)
    ids = np.zeros(len(places), np.int64)
    for k in range(3):  # one coordinate after the other: sorting numbers is ten times faster than sorting rows
        _, row = np.unique(places[:, k], return_inverse=True)
        _, ids = np.unique(ids * (int(row.max(initial=0)) + 1) + row, return_inverse=True)
    return np.asarray(ids.reshape(-1, 3), np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Boxes:
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
        boxes = Boxes(
            *(np.concatenate([getattr(p.boxes, row) for p in parts]) for row in ("centres", "axes", "halves"))
        )
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
    links = coo_array((np.ones(good.sum(), np.int8), (face[good], face[twin[good]])), shape=(count, count))
    total, body = connected_components(links, directed=False)
    closed = np.ones(total, bool)
    closed[body[face[~good]]] = False
    volume = np.bincount(body, np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])), total)
    sign = np.where(closed, np.sign(volume), 0.0)[body]
    outward[:, :3] = sign[:, None] * normals
    outward[:, 3] = -np.einsum("ni,ni->n", outward[:, :3], corners[:, 0])
    return Backs(outward, body.astype(np.int32), _boxes(corners, normals, body, total))


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
