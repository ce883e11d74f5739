"""Paths over mirrors and round bodies as they run: what stands in their way, and what becomes of the field."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Bools, Complexes, Floats
from ullage.kernels import impulses as kernel
from ullage.radar.context import AntennaPair, RadarContext
from ullage.radar.facets import Surfaces
from ullage.radar.visibility import between
from ullage.radar.wall_bounces import PULL_M


@dataclass(frozen=True, slots=True, eq=False)
class Real:
    """Paths from antenna to antenna over as many surfaces each."""

    corners: Floats  # (s + 2, n, 3) [m]
    normals: Floats  # (s, n, 3) to where the waves are
    depths: Floats  # (s, n) by so much facets lie off [m]
    object_ids: NDArray[np.integer]  # (s, n)
    there: Bools  # (n) whether there is such a path


def free(parts: list[Surfaces], path: Real) -> Bools:
    """Which paths (n) are free, and touch what is there."""
    stops, lift = path.corners[1:-1], path.normals * (path.depths + PULL_M)[..., None]
    corners = np.concatenate([path.corners[:1], stops + lift, path.corners[-1:]])
    here, there = np.concatenate([corners[:-1], stops + lift]), np.concatenate([corners[1:], stops - lift])
    clear = between(parts, here.reshape(-1, 3), there.reshape(-1, 3)).reshape(len(here), -1)
    legs = len(corners) - 1
    return np.asarray(path.there & clear[:legs].all(0) & ~clear[legs:].any(0))


def turned(context: RadarContext, antennas: AntennaPair, path: Real) -> Complexes:
    """What the antennas and all reflections make of the waves (n); the pattern is interpolated, to 3e-4."""
    out = np.empty(len(path.there), complex)
    corners, normals = (np.ascontiguousarray(row) for row in (path.corners, path.normals))
    paths = kernel.ReflectedPaths(corners, normals, path.object_ids.astype(np.int64))
    scratch = kernel.FieldScratch(np.empty((2, 3)), np.empty(3, complex))
    kernel.polarised(paths, context.bounce, context.antennas(antennas), scratch, out)
    return out
