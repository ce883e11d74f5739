"""What curved surfaces echo in place of their facets: spheres in closed form, all others by patches."""

from __future__ import annotations

import numpy as np

from ullage.arrays import Bools, Complexes, Floats, Ints
from ullage.kernels.facets import Transmission, TrianglePieces
from ullage.radar.context import AntennaPair, RadarContext, accumulate_triangles, transmission_to, triangles
from ullage.radar.echo_set import EchoSet, centroids
from ullage.radar.facets import Surfaces
from ullage.radar.patches import Patches
from ullage.radar.reflectors import PULL_M
from ullage.radar.sphere_echoes import accumulate_spheres


def accumulate_curved(
    context: RadarContext, parts: list[Surfaces], antennas: AntennaPair, poses: Floats | None, grids: Complexes
) -> tuple[list[EchoSet], list[tuple[Bools | None, Bools | None]]]:
    """Add to the delay grids what curved surfaces echo.

    Args:
        context: radar and scene.
        parts: what stands still and what moves.
        antennas: where the radar is.
        poses: (o, 4, 4) of the objects where any moves.
        grids: (3, g) complex, added to.

    Returns:
        What was added; of each part which small triangles (f) and which flat faces (p) are done so.
    """
    out, spheres = accumulate_spheres(context, parts, antennas, grids)
    wavelength = context.spec.wavelength_m
    widest = float(np.sqrt(wavelength * context.gate[1] / 2))
    done = [spheres, *[(None, None)] * (len(parts) - 1)]
    for k, patches in enumerate(context.world.patches(wavelength, widest, poses)):
        if patches is not None:
            out.append(_echoes_of(context, parts, patches, antennas, grids))
            small, planar = done[k]
            done[k] = (patches.small if small is None else small | patches.small,
                       patches.planar if planar is None else planar | patches.planar)  # fmt: skip
    return out, done


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
