"""Echoes of the knuckles of dished heads: their tori stand in for their facets."""

from __future__ import annotations

import numpy as np

from ullage.arrays import Bools, Complexes
from ullage.radar.ball_echoes import lay_balls, smoothed
from ullage.radar.context import Bench, View, common, lay_triangles, shading, triangles
from ullage.radar.facets import Surfaces
from ullage.radar.knuckles import Knuckle
from ullage.radar.laid import Laid, centroids
from ullage.radar.wall_bounces import PULL_M


def lay_heads(
    ready: Bench, parts: list[Surfaces], view: View, grids: Complexes
) -> tuple[list[Laid], tuple[Bools | None, Bools | None]]:
    """Adds to the delay grids what balls, domes and knuckles that stand still echo; as `ball_echoes.lay_balls`."""
    out, (small, large) = lay_balls(ready, parts, view, grids)
    for knuckle in ready.world.knuckles:
        if knuckle.widest < ready.spec.wavelength_m / 2 or not smoothed(ready, knuckle.stuff):
            continue
        out.append(_laid(ready, parts, knuckle, view, grids))
        small = knuckle.small if small is None else small | knuckle.small
        large = knuckle.flats if large is None else large | knuckle.flats
    return out, (small, large)


def _laid(ready: Bench, parts: list[Surfaces], knuckle: Knuckle, view: View, grids: Complexes) -> Laid:
    fine = knuckle.fine
    leaves, owner = triangles(ready, fine, view)
    middles, normals = centroids(leaves), fine.normals[owner]
    side = np.sign(np.einsum("ni,ni->n", view.origins.mean(0) - middles, normals))
    between = shading(ready, parts, view, middles + (side * (knuckle.depth + PULL_M))[:, None] * normals)
    pieces = leaves, owner, np.zeros(len(owner), np.int64)
    return lay_triangles(fine.normals, fine.stuffs, pieces, between, common(ready, view, grids))
