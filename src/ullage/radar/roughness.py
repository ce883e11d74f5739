"""What rough surfaces send back beside their weakened mirror echo: scatterers fixed to them.

A Gaussian height of variance s^2 turns the reflected phase by 2 k s cos. Its mean keeps exp(-g) of the power, with
g = (2 k s cos)^2; the rest, 1 - exp(-g), leaves in a lobe whose strength straight back follows from the heights'
correlation, here exp(-d / length), term by term [BeckmannSpizzichino1963]. It is laid down as scatterers strewn over
the surface, with random complex amplitudes that belong to them: from every pose, every time, the same spot answers
with the same phase, as a real surface does, so that apertures focus it to speckle.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ullage.arrays import Complexes, Floats, Ints, Longs
from ullage.geometry import C0
from ullage.kernels import diffuse_scatterers as kernel
from ullage.kernels.facets import EchoSums, Transmission
from ullage.radar.context import RadarContext, RadarFrame
from ullage.radar.echo_set import EchoSet, OnObjects, echo_set
from ullage.radar.penetration import COSINES, reflection_tables
from ullage.radar.prepared import Prepared
from ullage.specs import RadarSpec
from ullage.world.materials import Material
from ullage.world.scene import Scene
from ullage.world.smoothing import face_normals

SPACING_M = 0.05
"""Mean distance between scatterers [m]; several to every range bin and beam."""
MOST = 200_000
"""At most about so many scatterers; larger worlds have them farther apart."""
TILE_M = 0.3
"""Scatterers within so much are seen or hidden together [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class DiffuseScatterers(OnObjects):
    """Scatterers of a scene's rough surfaces, tile by tile, in the frame of their objects."""

    POINTS, DIRECTIONS = ("points",), ("normals",)
    points: Floats  # (n, 3) [m]
    normals: Floats  # (n, 3)
    weights: Complexes  # (n) root of the area each stands for, times its random amplitude [m]
    object_ids: Ints  # (n) object
    first: Longs  # (t + 1) first of each tile
    middles: Longs  # (t) the scatterer that speaks for each tile

    def __len__(self) -> int:
        return len(self.weights)


def diffuse_scatterers_of(world: Prepared, seed: int) -> DiffuseScatterers:
    """The scatterers of a scene for a seed; kept with it."""
    if seed not in world.diffuse_scatterers:
        world.diffuse_scatterers[seed] = strewn(world.scene, seed)
    known: DiffuseScatterers = world.diffuse_scatterers[seed]
    return known


def strewn(scene: Scene, seed: int) -> DiffuseScatterers:
    """Strews scatterers over every rough object, evenly by area; the same for the same mesh wherever it stands."""
    rough = [i for i, o in enumerate(scene.objects) if o.material.roughness_m > 0]
    corners = scene.corners()
    area = face_normals(corners)[1]
    whole = float(area[np.isin(scene.face_object, rough)].sum())
    spacing = max(SPACING_M, np.sqrt(whole / MOST))
    parts = [_on_object(corners[mine], area[mine], spacing, [seed, i, zlib.crc32(scene.objects[i].name.encode())])
             for i in rough if (mine := scene.face_object == i).any()]  # fmt: skip
    if not parts:
        none = np.zeros((0, 3))
        return DiffuseScatterers(
            none, none, np.zeros(0, complex), np.zeros(0, np.int32), np.zeros(1, np.int64), np.zeros(0, np.int64)
        )
    points, normals, weights = (np.concatenate([p[k] for p in parts]) for k in range(3))
    object_ids = np.concatenate([np.full(len(p[0]), i, np.int32) for p, i in zip(parts, rough, strict=True)])
    return _tiled(points, normals, weights, object_ids)


def _on_object(corners: Floats, area: Floats, spacing: float, key: list[int]) -> tuple[Floats, Floats, Complexes]:
    rng = np.random.default_rng(key)
    count = max(round(float(area.sum()) / spacing**2), 1)
    reach = np.cumsum(area)
    face = np.searchsorted(reach, (np.arange(count) + rng.random(count)) / count * reach[-1] * (1 - 1e-12))
    u, v = rng.random((2, count))
    fold = u + v > 1
    u, v = np.where(fold, 1 - u, u), np.where(fold, 1 - v, v)
    a, b, c = (corners[face, k] for k in range(3))
    points = a + u[:, None] * (b - a) + v[:, None] * (c - a)
    normals = face_normals(corners)[0][face]
    amplitude = rng.standard_normal((2, count)) * np.sqrt(0.5)
    return points, normals, (amplitude[0] + 1j * amplitude[1]) * np.sqrt(area.sum() / count)


def _tiled(points: Floats, normals: Floats, weights: Complexes, object_ids: Ints) -> DiffuseScatterers:
    cell = np.floor((points + 1e-4) / TILE_M)
    key = np.concatenate([object_ids[:, None], np.round(4 * normals), cell], 1).astype(np.int64)
    _, tile = np.unique(key, axis=0, return_inverse=True)
    order = np.argsort(tile.ravel(), kind="stable")
    tile = tile.ravel()[order]
    first = np.searchsorted(tile, np.arange(tile[-1] + 2)).astype(np.int64)
    points = points[order]
    mean = np.add.reduceat(points, first[:-1]) / np.diff(first)[:, None]
    gap = np.linalg.norm(points - mean[tile], axis=1)
    rank = np.lexsort((gap, tile))
    return DiffuseScatterers(
        points, normals[order], weights[order], object_ids[order], first, rank[first[:-1]].astype(np.int64)
    )


@lru_cache(maxsize=256)
def lobe(material: Material, center_hz: float, bandwidth_hz: float) -> Floats:
    """Amplitude straight back per root area (2, COSINES) over cos(incidence), TE and TM, before 1 / 4 pi [1/m]."""
    c = np.linspace(0, 1, COSINES)
    smooth = RadarSpec(center_hz=center_hz, bandwidth_hz=bandwidth_hz)
    *_, bounce = reflection_tables([material.but(roughness_m=0.0)], smooth)
    return np.asarray(abs(bounce[0, 0]) * c * np.sqrt(spectrum(material, 2 * np.pi * center_hz / C0, c)))


def spectrum(material: Material, wave: float, cosine: Floats, sine: Floats | None = None) -> Floats:
    """Power of a rough surface's diffuse phase straight back, per area (n) [m^2].

    Args:
        material: with its height and correlation length.
        wave: wave number [1/m].
        cosine: (n) of the incidence, which the phase's variance follows.
        sine: (n) of the angle that is looked from; None: the same incidence.
    """
    across = np.sqrt(1 - cosine * cosine) if sine is None else sine
    variance = np.maximum((2 * wave * material.roughness_m * cosine) ** 2, 1e-12)
    length = material.correlation
    terms = int(variance.max() + 10 * np.sqrt(variance.max()) + 12)
    return np.array([kernel.lobe(float(g), 2 * wave * length, float(s), terms) * length**2
                     for g, s in zip(variance, across, strict=True)])  # fmt: skip


def accumulate_diffuse_scatterers(frame: RadarFrame) -> EchoSet:
    """Add the echoes of rough surfaces' scatterers to the delay grids."""
    context, radar = frame.context, frame.radar
    diffuse_scatterers = diffuse_scatterers_of(context.world, context.seed).placed(frame.poses)
    at = diffuse_scatterers.points[diffuse_scatterers.middles]
    gap = np.linalg.norm(at - frame.antennas.origins.mean(0), axis=1)
    near = np.flatnonzero((gap > context.gate[0] - TILE_M) & (gap < context.gate[1] + TILE_M))
    transmission, extra = np.zeros(len(at), complex), np.zeros(len(at))
    if len(near):
        transmission[near], extra[near] = frame.transmission_to(at[near])
    tiles = kernel.ScattererTiles(diffuse_scatterers.points, diffuse_scatterers.normals, diffuse_scatterers.weights,
                                  diffuse_scatterers.object_ids, diffuse_scatterers.first)  # fmt: skip
    lobes = _lobes(context)

    def put(between: Transmission, sums: EchoSums) -> None:
        kernel.accumulate_diffuse_scatterers(tiles, lobes, between, radar, context.pulse_grid, sums)

    between = Transmission(transmission, extra)
    return echo_set(put, between, frame.grids, diffuse_scatterers.object_ids[diffuse_scatterers.middles], at)


def _lobes(context: RadarContext) -> Floats:
    spec = context.spec
    return np.stack([lobe(m, spec.center_hz, spec.bandwidth_hz) if m.roughness_m else np.zeros((2, COSINES))
                     for m in context.world.materials])  # fmt: skip
