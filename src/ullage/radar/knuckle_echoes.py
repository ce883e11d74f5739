"""Echoes of the knuckles of dished heads: their tori stand in for their facets."""

from __future__ import annotations

import numpy as np

from ullage.arrays import Bools, Complexes
from ullage.kernels.facets import TrianglePieces
from ullage.radar.context import AntennaPair, RadarContext, accumulate_triangles, transmission_to, triangles
from ullage.radar.echo_set import EchoSet, centroids
from ullage.radar.facets import Surfaces
from ullage.radar.knuckles import Knuckle
from ullage.radar.sphere_echoes import accumulate_spheres, smoothed
from ullage.radar.wall_bounces import PULL_M


def accumulate_heads(
    context: RadarContext, parts: list[Surfaces], antennas: AntennaPair, grids: Complexes
) -> tuple[list[EchoSet], tuple[Bools | None, Bools | None]]:
    """Adds the echoes of still balls, domes and knuckles to the delay grids, as `sphere_echoes.accumulate_spheres`."""
    out, (small, large) = accumulate_spheres(context, parts, antennas, grids)
    for knuckle in context.world.knuckles:
        if knuckle.widest < context.spec.wavelength_m / 2 or not smoothed(context, knuckle.object_id):
            continue
        out.append(_echoes_of(context, parts, knuckle, antennas, grids))
        small = knuckle.small if small is None else small | knuckle.small
        large = knuckle.planar if large is None else large | knuckle.planar
    return out, (small, large)


def _echoes_of(
    context: RadarContext, parts: list[Surfaces], knuckle: Knuckle, antennas: AntennaPair, grids: Complexes
) -> EchoSet:
    fine = knuckle.fine
    leaves, owner = triangles(context, fine, antennas)
    middles, normals = centroids(leaves), fine.normals[owner]
    side = np.sign(np.einsum("ni,ni->n", antennas.origins.mean(0) - middles, normals))
    between = transmission_to(context, parts, antennas, middles + (side * (knuckle.depth + PULL_M))[:, None] * normals)
    pieces = TrianglePieces(leaves, owner, np.zeros(len(owner), np.int64))
    return accumulate_triangles(context, pieces, context.lit(antennas, fine), between, grids)
