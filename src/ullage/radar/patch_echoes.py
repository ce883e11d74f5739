"""What curved surfaces echo in place of their facets: spheres in closed form, all others by patches."""

from __future__ import annotations

import numpy as np

from ullage.arrays import Bools, Floats, Ints
from ullage.kernels.facets import Transmission, TrianglePieces
from ullage.radar.context import RadarFrame, triangles
from ullage.radar.echo_set import EchoSet, centroids
from ullage.radar.patches import Patches
from ullage.radar.reflectors import PULL_M
from ullage.radar.sphere_echoes import accumulate_spheres


def accumulate_curved(frame: RadarFrame) -> tuple[list[EchoSet], list[tuple[Bools | None, Bools | None]]]:
    """Add to the delay grids what curved surfaces echo.

    Returns:
        What was added; of each part which small triangles (f) and which flat faces (p) are done so.
    """
    out, spheres = accumulate_spheres(frame)
    context = frame.context
    done = [spheres, *[(None, None)] * (len(frame.parts) - 1)]
    for k, patches in enumerate(context.world.patches(context.spec.wavelength_m, context.widest_m, frame.poses)):
        if patches is not None:
            out.append(_echoes_of(frame, patches))
            small, planar = done[k]
            done[k] = (patches.small if small is None else small | patches.small,
                       patches.planar if planar is None else planar | patches.planar)  # fmt: skip
    return out, done


def _echoes_of(frame: RadarFrame, patches: Patches) -> EchoSet:
    """Lay the pieces; rays ask what stands before them from just before their facets, on the radar's side."""
    leaves, owner = triangles(frame, patches.fine)
    pieces = TrianglePieces(leaves, owner, np.zeros(len(owner), np.int64))
    return frame.accumulate_triangles(pieces, frame.lit(patches.fine), _before(frame, patches, leaves, owner))


def _before(frame: RadarFrame, patches: Patches, leaves: Floats, owner: Ints) -> Transmission:
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
    side = np.sign(np.einsum("ni,ni->n", frame.antennas.origins.mean(0) - middles, normals))
    transmission, late = frame.transmission_to(middles + (side * (depth + PULL_M))[:, None] * normals)
    return Transmission(transmission[row], late[row])
