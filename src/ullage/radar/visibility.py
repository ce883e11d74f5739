"""What the radar sees: one ray to the middle of every piece of surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ullage.radar.facets import Surfaces

Floats = NDArray[np.float64]

SLACK_M = 2e-3
"""Two surfaces nearer than this along a ray count as one [m]; Embree's float32 and shared edges need it."""


def seen(parts: Sequence[Surfaces], origin: Floats, points: Floats) -> NDArray[np.bool_]:
    """Whether nothing stands between the origin (3) and each point (n, 3) on a surface."""
    ray = points - origin
    length = np.sqrt(np.einsum("ni,ni->n", ray, ray))
    ray /= np.maximum(length, 1e-9)[:, None]
    clear = np.ones(len(points), bool)
    for part in parts:
        _, distance = part.rays.hits(origin, ray)
        clear &= distance >= length - SLACK_M
    return clear


def between(parts: Sequence[Surfaces], a: Floats, b: Floats) -> NDArray[np.bool_]:
    """Whether nothing stands between the points a (n, 3) and b (n, 3), which may lie on surfaces."""
    ray = b - a
    length = np.sqrt(np.einsum("ni,ni->n", ray, ray))
    ray /= np.maximum(length, 1e-9)[:, None]
    clear = np.ones(len(a), bool)
    for part in parts:
        _, distance = part.rays.hits(a + SLACK_M * ray, ray)
        clear &= distance >= length - 2 * SLACK_M
    return clear | (length < 4 * SLACK_M)
