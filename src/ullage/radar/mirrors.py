"""Waves at flat mirrors: images, where ways over them cross, and what a bounce makes of a field."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Complexes, Floats, Longs
from ullage.radar.facets import PlanarPatches


def mirrored(point: Floats, planar: PlanarPatches, faces: Longs) -> Floats:
    """Images (n, 3) of a point (3) in faces (n)."""
    n = planar.normals[faces]
    return np.asarray(point - 2 * (n @ point - planar.offsets[faces])[:, None] * n)


def reflected(
    gamma: Complexes, object_ids: NDArray[np.integer], field: NDArray[Any], u: Floats, normals: Floats
) -> Complexes:
    """Fields (m, 3) of waves along u (m, 3) after a bounce at mirrors with unit normals (m, 3).

    Args:
        gamma: (s, taps, 2, c) reflection over cos(incidence), TE and TM; only the first tap bounces.
        object_ids: (m) material of each mirror.
        field: (m, 3) before the bounce.
        u: (m, 3) unit vectors of travel.
        normals: (m, 3).
    """
    place = np.minimum(abs(dot(u, normals)), 1) * (gamma.shape[3] - 1)
    low = np.minimum(place.astype(np.int64), gamma.shape[3] - 2)
    share = place - low
    rows = gamma[object_ids, 0]
    many = np.arange(len(u))
    te, tm = ((rows[many, k, low] * (1 - share) + rows[many, k, low + 1] * share)[:, None] for k in range(2))
    side = unit(np.cross(u, normals))
    out = tm * field + (te - tm) * dot(side, field)[:, None] * side
    return np.asarray(out - 2 * dot(out, normals)[:, None] * normals)


def dot(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    """Products (n) of vectors (n, 3), nothing conjugated."""
    return np.asarray(np.einsum("ni,ni->n", a, b))


def across(vectors: Floats, u: Floats) -> Floats:
    """Unit vectors along those parts of some that stand across u."""
    return unit(vectors - dot(vectors, u)[:, None] * u)


def unit(vectors: Floats) -> Floats:
    """Vectors (n, 3) brought to length 1."""
    return np.asarray(vectors / np.maximum(np.sqrt(dot(vectors, vectors)), 1e-12)[:, None])
