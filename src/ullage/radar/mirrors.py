"""Beams over flat mirrors, and small things done with many vectors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Floats, Ints, Longs
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


def dot(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    """Products (n) of vectors (n, 3), nothing conjugated."""
    return np.asarray(np.einsum("ni,ni->n", a, b))


def across(vectors: Floats, u: Floats) -> Floats:
    """Unit vectors along those parts of some that stand across u."""
    return unit(vectors - dot(vectors, u)[:, None] * u)


def unit(vectors: Floats) -> Floats:
    """Vectors (n, 3) brought to length 1."""
    return np.asarray(vectors / np.maximum(np.sqrt(dot(vectors, vectors)), 1e-12)[:, None])
