"""What curved surfaces echo in place of their facets: balls and knuckles in closed form, all others by patches."""

from __future__ import annotations

import numpy as np

from ullage.arrays import Bools, Complexes, Floats, Ints
from ullage.kernels.facets import Transmission, TrianglePieces
from ullage.radar.context import AntennaPair, RadarContext, accumulate_triangles, transmission_to, triangles
from ullage.radar.echo_set import EchoSet, centroids
from ullage.radar.facets import Surfaces
from ullage.radar.knuckle_echoes import accumulate_heads
from ullage.radar.patches import Patches
from ullage.radar.wall_bounces import PULL_M


def accumulate_curved(
    context: RadarContext, parts: list[Surfaces], antennas: AntennaPair, grids: Complexes
) -> tuple[list[EchoSet], tuple[Bools | None, Bools | None]]:
    """Add to the delay grids what curved surfaces that stand still echo; as `knuckles.accumulate_heads`."""
    out, (small, large) = accumulate_heads(context, parts, antennas, grids)
    wavelength = context.spec.wavelength_m
    patches = context.world.patches(wavelength, float(np.sqrt(wavelength * context.gate[1] / 2)))
    if patches is None:
        return out, (small, large)
    out.append(_echoes_of(context, parts, patches, antennas, grids))
    small = patches.small if small is None else small | patches.small
    large = patches.planar if large is None else large | patches.planar
    return out, (small, large)


def _echoes_of(
    context: RadarContext, parts: list[Surfaces], patches: Patches, antennas: AntennaPair, grids: Complexes
) -> EchoSet:
    """Lay the pieces; rays ask what stands before them from just before their facets, on the radar's side."""
    fine = patches.fine
    leaves, owner = triangles(context, fine, antennas)
    between = _before(context, parts, patches, antennas, leaves, owner)
    pieces = TrianglePieces(leaves, owner, np.zeros(len(owner), np.int64))
    return accumulate_triangles(context, pieces, context.lit(antennas, fine), between, grids)


def _before(
    context: RadarContext, parts: list[Surfaces], patches: Patches, antennas: AntennaPair, leaves: Floats, owner: Ints
) -> Transmission:
    """Factor and delay [s] of what stands before leaves (m) of pieces: a ray for each cell, or leaf of a long piece."""
    cell = patches.cell[owner]
    alone, shared = np.flatnonzero(cell < 0), np.flatnonzero(cell >= 0)
    asked = np.zeros(len(patches.deep), bool)
    asked[cell[shared]] = True
    row = np.empty(len(cell), np.int64)
    row[shared] = (np.cumsum(asked) - 1)[cell[shared]]
    row[alone] = int(asked.sum()) + np.arange(len(alone))
    middles = np.concatenate([patches.middles[asked], centroids(leaves[alone])])
    normals = np.concatenate([patches.facing[asked], patches.fine.normals[owner[alone]]])
    depth = np.concatenate([patches.deep[asked], patches.depth[owner[alone]]])
    side = np.sign(np.einsum("ni,ni->n", antennas.origins.mean(0) - middles, normals))
    transmission, late = transmission_to(
        context, parts, antennas, middles + (side * (depth + PULL_M))[:, None] * normals
    )
    return Transmission(transmission[row], late[row])
