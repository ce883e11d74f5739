"""Geometric paths over flat faces and curved bodies: visibility, reflection and polarisation."""

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
class ReflectedPaths:
    """Paths (n) from antenna to antenna over the same number of surfaces (s) each."""

    corners: Floats  # (s + 2, n, 3) [m]
    normals: Floats  # (s, n, 3) towards the waves
    depths: Floats  # (s, n) largest distance of facets from the surfaces [m]
    object_ids: NDArray[np.integer]  # (s, n)
    there: Bools  # (n) whether the path exists


def free(parts: list[Surfaces], path: ReflectedPaths) -> Bools:
    """Return which paths (n) are free and touch existing surfaces: one may have a hole or end."""
    stops, lift = path.corners[1:-1], path.normals * (path.depths + PULL_M)[..., None]
    corners = np.concatenate([path.corners[:1], stops + lift, path.corners[-1:]])
    here, there = np.concatenate([corners[:-1], stops + lift]), np.concatenate([corners[1:], stops - lift])
    clear = between(parts, here.reshape(-1, 3), there.reshape(-1, 3)).reshape(len(here), -1)
    legs = len(corners) - 1
    return np.asarray(path.there & clear[:legs].all(0) & ~clear[legs:].any(0))


def reflection_gains(context: RadarContext, antennas: AntennaPair, path: ReflectedPaths) -> Complexes:
    """Compute the products (n) of antenna gains and reflections; the pattern is interpolated, to 3e-4."""
    out = np.empty(len(path.there), complex)
    corners, normals = (np.ascontiguousarray(row) for row in (path.corners, path.normals))
    paths = kernel.ReflectedPaths(corners, normals, path.object_ids.astype(np.int64))
    scratch = kernel.FieldScratch(np.empty((2, 3)), np.empty(3, complex))
    kernel.polarised(paths, context.bounce, context.antennas(antennas), scratch, out)
    return out
