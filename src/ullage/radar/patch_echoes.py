"""What curved surfaces echo in place of their facets: balls and knuckles in closed form, all others by patches."""

from __future__ import annotations

import numpy as np

from ullage.arrays import Bools, Complexes, Floats, Ints
from ullage.radar.context import Bench, View, common, lay_triangles, shading, triangles
from ullage.radar.facets import Surfaces
from ullage.radar.knuckle_echoes import lay_heads
from ullage.radar.laid import Laid, centroids
from ullage.radar.patches import Patches
from ullage.radar.wall_bounces import PULL_M


def lay_curved(
    ready: Bench, parts: list[Surfaces], view: View, grids: Complexes
) -> tuple[list[Laid], tuple[Bools | None, Bools | None]]:
    """Add to the delay grids what curved surfaces that stand still echo; as `knuckles.lay_heads`."""
    out, (small, large) = lay_heads(ready, parts, view, grids)
    wavelength = ready.spec.wavelength_m
    patches = ready.world.patches(wavelength, float(np.sqrt(wavelength * ready.gate[1] / 2)))
    if patches is None:
        return out, (small, large)
    out.append(_laid(ready, parts, patches, view, grids))
    small = patches.small if small is None else small | patches.small
    large = patches.flats if large is None else large | patches.flats
    return out, (small, large)


def _laid(ready: Bench, parts: list[Surfaces], patches: Patches, view: View, grids: Complexes) -> Laid:
    """Lay the pieces; rays ask what stands before them from just before their facets, on the radar's side."""
    fine = patches.fine
    leaves, owner = triangles(ready, fine, view)
    between = _before(ready, parts, patches, view, leaves, owner)
    pieces = leaves, owner, np.zeros(len(owner), np.int64)
    return lay_triangles(fine.normals, fine.stuffs, pieces, between, common(ready, view, grids))


def _before(
    ready: Bench, parts: list[Surfaces], patches: Patches, view: View, leaves: Floats, owner: Ints
) -> tuple[Complexes, Floats]:
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
    side = np.sign(np.einsum("ni,ni->n", view.origins.mean(0) - middles, normals))
    shade, late = shading(ready, parts, view, middles + (side * (depth + PULL_M))[:, None] * normals)
    return shade[row], late[row]
