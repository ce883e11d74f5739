"""Closed bodies in a mesh, and which of their faces a radar outside of them cannot see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ullage.kernels import rims as kernel

Floats = NDArray[np.float64]

WELD_M = 1e-6
"""Corners nearer than this are one [m]."""
_CLEAR_M = 1e-3  # a radar this far outside a body's box is outside the body


@dataclass(frozen=True, slots=True, eq=False)
class Backs:
    """The outer sides of triangles or faces of closed bodies."""

    outward: Floats  # (n, 4) plane [normal, -offset] that is positive outside; 0 for faces of no closed body
    boxes: Floats  # (n, 2, 3) box around the body of each [m]

    def hidden(self, origins: Floats, opaque: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Which faces (n) turn their backs to all of the places (k, 3) outside their bodies, where opaque (n)."""
        out = np.empty(len(opaque), np.bool_)
        some = origins[:1] if (origins == origins[0]).all() else origins
        kernel.hidden(self.outward, self.boxes, some, opaque, _CLEAR_M, out)
        return out

    def take(self, index: NDArray[np.integer]) -> Backs:
        """Those of some of the faces."""
        return Backs(self.outward[index], self.boxes[index])


def backs(corners: Floats, normals: Floats, stuffs: NDArray[np.int32]) -> Backs:
    """The outer sides of triangles (f, 3, 3) that belong to closed bodies of one object, evenly turned.

    A body is closed where every edge is shared by two triangles that run along it in opposite ways.
    """
    count = len(corners)
    outward, boxes = np.zeros((count, 4)), np.zeros((count, 2, 3))
    if not count:
        return Backs(outward, boxes)
    _, ids = np.unique(np.round(corners.reshape(-1, 3) / WELD_M).astype(np.int64), axis=0, return_inverse=True)
    ids = ids.reshape(-1) + np.repeat(stuffs.astype(np.int64), 3) * (int(ids.max()) + 1)
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
    low, high = np.full((total, 3), np.inf), np.full((total, 3), -np.inf)
    np.minimum.at(low, body, corners.min(1))
    np.maximum.at(high, body, corners.max(1))
    sign = np.where(closed, np.sign(volume), 0.0)[body]
    outward[:, :3] = sign[:, None] * normals
    outward[:, 3] = -np.einsum("ni,ni->n", outward[:, :3], corners[:, 0])
    boxes[:, 0], boxes[:, 1] = low[body], high[body]
    return Backs(outward, boxes)
