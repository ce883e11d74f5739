"""Echoes of spheres, domes and tori, which replace their facets."""

from __future__ import annotations

import numpy as np

from ullage.arrays import Bools, Complexes
from ullage.kernels.facets import TrianglePieces
from ullage.radar.context import AntennaPair, RadarContext, accumulate_triangles, transmission_to, triangles
from ullage.radar.echo_set import EchoSet, centroids
from ullage.radar.facets import Surfaces
from ullage.radar.sphere_echoes import accumulate_spheres, smoothed
from ullage.radar.tori import Torus
from ullage.radar.wall_bounces import PULL_M


def accumulate_heads(
    context: RadarContext, parts: list[Surfaces], antennas: AntennaPair, grids: Complexes
) -> tuple[list[EchoSet], tuple[Bools | None, Bools | None]]:
    """Add the echoes of spheres, domes and tori at rest to the delay grids, as `sphere_echoes.accumulate_spheres`."""
    out, (small, large) = accumulate_spheres(context, parts, antennas, grids)
    for torus in context.world.tori:
        if torus.widest < context.spec.wavelength_m / 2 or not smoothed(context, torus.object_id):
            continue
        out.append(_echoes_of(context, parts, torus, antennas, grids))
        small = torus.small if small is None else small | torus.small
        large = torus.planar if large is None else large | torus.planar
    return out, (small, large)


def _echoes_of(
    context: RadarContext, parts: list[Surfaces], torus: Torus, antennas: AntennaPair, grids: Complexes
) -> EchoSet:
    fine = torus.fine
    leaves, owner = triangles(context, fine, antennas)
    middles, normals = centroids(leaves), fine.normals[owner]
    side = np.sign(np.einsum("ni,ni->n", antennas.origins.mean(0) - middles, normals))
    between = transmission_to(context, parts, antennas, middles + (side * (torus.depth + PULL_M))[:, None] * normals)
    pieces = TrianglePieces(leaves, owner, np.zeros(len(owner), np.int64))
    return accumulate_triangles(context, pieces, context.lit(antennas, fine), between, grids)
