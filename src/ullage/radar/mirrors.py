"""Waves at flat mirrors: images, beams over them, and the field after a bounce."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Complexes, Floats, Ints, Longs
from ullage.kernels import bounces


@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """Bundles of paths, each over its mirrors to the lit part of its last face."""

    over: Floats  # (b, d, 3) images of the transmitter over the first mirror, the first two and so on [m]
    chains: Longs  # (b, d) flat faces that mirror, -1 for none
    ends_on: Longs  # (b) face at the end
    first: Ints  # (b + 1) first edge of each
    edges: Floats  # (e, 2, 3) outlines of the lit parts [m]
    weights: Floats  # (b) how much of each counts

    def __len__(self) -> int:
        return len(self.ends_on)

    @property
    def paths(self) -> bounces.ImagePaths:
        """The transmitter's images, for kernels."""
        return bounces.ImagePaths(self.over, self.chains)

    @property
    def images(self) -> Floats:
        """The transmitter's last images (b, 3) [m]."""
        return np.ascontiguousarray(self.over[:, -1])


def reflected(
    gamma: Complexes, object_ids: NDArray[np.integer], field: NDArray[Any], u: Floats, normals: Floats
) -> Complexes:
    """Fields (m, 3) of waves along u (m, 3) after a bounce at mirrors with unit normals (m, 3).

    Args:
        gamma: (s, 1, 2, c) reflection over cos(incidence), TE and TM.
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
