"""What paths meet: round bodies, flat faces, points and lines, one per row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ullage.arrays import Bools, Floats, Longs
from ullage.kernels import fermat as kernel
from ullage.radar.facets import PlanarPatches
from ullage.radar.quadrics import Quadric

PULL_M = 4e-3
"""Distance of visibility tests from the facets of curved bodies [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class ReflectorSet:
    """Reflectors (r) with what their meshes and materials add."""

    surfaces: kernel.Reflectors
    depths: Floats  # (r) largest distance of facets from the surface [m]
    object_ids: Longs  # (r)

    def __len__(self) -> int:
        return len(self.depths)

    @property
    def flat(self) -> Bools:
        """Tell which are flat faces (r)."""
        return np.asarray(self.surfaces.kinds == kernel.PLANE)

    def take(self, which: Longs) -> ReflectorSet:
        """Select some reflectors."""
        kinds, centres, axes, radii, extents = self.surfaces
        surfaces = kernel.Reflectors(kinds[which], centres[which], axes[which], radii[which], extents[which])
        return ReflectorSet(surfaces, self.depths[which], self.object_ids[which])

    def gaps(self, points: Floats) -> Floats:
        """Return the distances (p, r) of points (p, 3) from the centres of spheres or the axes of drums [m]."""
        _, centres, axes, _, ends = self.surfaces
        away = points[:, None] - centres
        along = (away * axes[:, 2]).sum(2)
        past_end = along - np.clip(along, ends[:, 0], ends[:, 1])
        return np.asarray(np.sqrt(np.maximum((away * away).sum(2) - along**2, 0.0) + past_end**2))


@lru_cache(maxsize=16)
def bodies_of(quadrics: tuple[Quadric, ...]) -> ReflectorSet:
    """Collect quadrics as rows; spheres have no ends."""
    half = np.array([0.0 if r.is_sphere else (r.high - r.low) / 2 for r in quadrics])
    surfaces = kernel.Reflectors(
        kinds=np.array([kernel.SPHERE if r.is_sphere else kernel.CYLINDER for r in quadrics], np.int64),
        centres=np.array([r.centre + (r.low + r.high) / 2 * r.axes[2] for r in quadrics]).reshape(-1, 3),
        axes=np.array([r.axes for r in quadrics]).reshape(-1, 3, 3),
        radii=np.array([r.radius for r in quadrics]),
        extents=np.stack([-half, half], 1),
    )
    object_ids = np.array([r.object_id for r in quadrics], np.int64)
    return ReflectorSet(surfaces, np.array([r.depth for r in quadrics]), object_ids)


def points_of(points: Floats) -> ReflectorSet:
    """Return points (n, 3) as reflectors, where paths begin and end."""
    many = len(points)
    surfaces = kernel.Reflectors(np.full(many, kernel.SPHERE), points, np.tile(np.eye(3), (many, 1, 1)), np.zeros(many),
                                 np.zeros((many, 2)))  # fmt: skip
    return ReflectorSet(surfaces, np.zeros(many), np.full(many, -1))


@lru_cache(maxsize=8)
def faces_of(planar: PlanarPatches) -> ReflectorSet:
    """Return flat faces as reflectors."""
    return plane_set(
        planar.offsets[:, None] * planar.normals, planar.normals, planar.widths, planar.object_ids.astype(np.int64)
    )


def plane_set(points: Floats, normals: Floats, widths: Floats, object_ids: Longs) -> ReflectorSet:
    """Return planes through points (n, 3) [m], of widths (n, 2) [m], as reflectors."""
    across = np.cross(normals, np.eye(3)[abs(normals).argmin(1)])
    across /= np.linalg.norm(across, axis=1)[:, None]
    axes, many = np.stack([across, np.cross(normals, across), normals], 1), len(points)
    surfaces = kernel.Reflectors(np.full(many, kernel.PLANE), points, axes, np.zeros(many), widths)
    return ReflectorSet(surfaces, np.zeros(many), object_ids)


def joined(parts: Sequence[ReflectorSet]) -> ReflectorSet:
    """Join lists of reflectors."""
    surfaces = kernel.Reflectors(*(np.concatenate(rows) for rows in zip(*(p.surfaces for p in parts), strict=True)))
    return ReflectorSet(surfaces, np.concatenate([p.depths for p in parts]),
                        np.concatenate([p.object_ids for p in parts]))  # fmt: skip
