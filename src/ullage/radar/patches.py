"""Curved surfaces of any shape: point-normal triangles in place of coarse facets.

A facet that samples a curved surface lies off it by its sagitta, and the error of phase repeats from facet to facet:
the mesh echoes as a grating. Where no closed form stands for a surface (`balls`, `arcs`, `knuckles`), cubic patches
through its corners and normals [VlachosEtAl2001] take its place, cut until flat pieces follow them within `SHARE` of a
wave. The pieces echo by physical optics as all small triangles do (`patch_echoes`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ullage.radar.facets import Surfaces, strewn
from ullage.radar.solids import Backs, welded
from ullage.world import point_normal, smoothing
from ullage.world.notices import notify
from ullage.world.scene import Scene

Floats = NDArray[np.float64]
Longs = NDArray[np.int64]
Bools = NDArray[np.bool_]

SHARE = 1 / 128
"""Middles of edges lie so far off the curved surface at the most, over the wavelength.

A parabola of depth s differs from its mean by 0.3 s, which turns the phase there and back by 4 pi 0.3 s / wavelength:
0.03 rad, or -31 dB of the echo, spread over many directions. World files' own cylinders are finer and stay as they are.
"""
LEAST = 1 / 1024
"""Where some facets of a surface are cut, those that lie so far off it, over the wavelength, are shifted to it."""
SIGHT = 1 / 2
"""One ray asks what stands before all pieces of a facet in a cell of this size, over the wavelength."""
MOST = 200_000
"""So many pieces at the most stand for the curved surfaces of a scene."""


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """Curved surfaces that stand still, and the facets that they stand in for."""

    fine: Surfaces  # pieces of the curved surfaces
    depth: Floats  # (n) so far each piece lies off its facet at the most [m]
    sight: Longs  # (n) pieces of one number lie so near to each other that one ray is enough for them
    small: Bools  # (f) which small triangles of what stands still are done so
    flats: Bools  # (p) and which flat faces


def patches_of(
    scene: Scene, still: Surfaces, claimed: Bools, *, wavelength_m: float, widest_m: float
) -> Patches | None:
    """Cut the curved surfaces among what stands still; None where there are none.

    Args:
        scene: the world.
        still: what of it stands still.
        claimed: faces of the scene (s) that closed forms stand for.
        wavelength_m: of the radar [m].
        widest_m: facets wider than this are mirrors of their own [m].
    """
    faces = np.concatenate([still.faces, still.flat_faces])
    row = np.concatenate([np.arange(len(still.faces)), len(still.faces) + still.flat_at])  # small ones, then flats
    corners, stuffs = scene.corners()[faces], scene.face_object[faces]
    found = smoothing.hinges(corners, welded(corners), stuffs)
    if not len(found):
        return None
    given = None if scene.corner_normals is None else scene.corner_normals[faces]
    control = point_normal.displacements(corners, smoothing.corner_normals(corners, found, given), found)
    sagitta = point_normal.sagitta(control)
    count = np.ceil(np.sqrt(sagitta / (SHARE * wavelength_m)) - 1e-9).astype(np.int64)
    coarse = (count > 1) & ~claimed[faces]
    region, rows = found.regions(len(faces)), len(still.faces) + len(still.flats)
    coarse = (np.bincount(region, coarse)[region] > 0) & (sagitta > LEAST * wavelength_m)  # shifted, if not cut
    taken = np.bincount(row, coarse, rows) > 0
    taken &= np.bincount(row, claimed[faces] | (_widths(corners) >= widest_m), rows) == 0
    mine = np.flatnonzero(taken[row])
    if not len(mine):
        return None
    count = _bounded(np.maximum(count[mine], 1), sagitta[mine], scene.name)
    pieces, of, within = point_normal.cut(corners[mine], control[mine], count)
    normals, area = smoothing.face_normals(pieces)
    kept = area > 1e-12
    pieces, normals, parent, within = pieces[kept], normals[kept], mine[of[kept]], within[kept]
    lead = row[parent]
    turned = np.concatenate([still.backs.outward, still.flat_backs.outward])[lead, :3]
    outward = np.sign(np.einsum("ni,ni->n", turned, normals))[:, None] * normals
    body = np.concatenate([still.backs.body, still.flat_backs.body])[lead]
    level = -np.einsum("ni,ni->n", outward, pieces[:, 0])
    sides = Backs(np.column_stack([outward, level]), body, still.backs.boxes)
    fine, order = strewn(pieces, normals, stuffs[parent], sides, still)
    depth = 2 * sagitta[parent][order]  # the middle of a triangle bows out 4/3 as far as those of its edges
    sight = _sights(corners[parent], parent, within, SIGHT * wavelength_m)[order]
    return Patches(fine, depth, sight, taken[: len(still.faces)], taken[len(still.faces) :])


def _sights(facets: Floats, parent: Longs, within: Floats, size_m: float) -> Longs:
    """Number (n) the cells of each facet, so wide, by facets (n, 3, 3) of pieces and where they lie in them."""
    longest = np.linalg.norm(np.roll(facets, -1, 1) - facets, axis=2).max(1)
    cells = np.ceil(longest / size_m)
    i, j = (np.floor(within[:, k] * cells).astype(np.int64) for k in (1, 2))
    wide = int(cells.max()) + 1
    return np.asarray(np.unique((parent * wide + i) * wide + j, return_inverse=True)[1], np.int64)


def _widths(corners: Floats) -> Floats:
    """Smallest height (f) of triangles (f, 3, 3) [m]."""
    longest = np.linalg.norm(np.roll(corners, -1, 1) - corners, axis=2).max(1)
    return np.asarray(2 * smoothing.face_normals(corners)[1] / np.maximum(longest, 1e-300))


def _bounded(count: Longs, sagitta: Floats, where: str) -> Longs:
    """Pieces (n) along the edges of patches, fewer where all would be more than `MOST`, with a warning."""
    asked, coarser = int((count**2).sum()), 1.0
    while (count**2).sum() > MOST and (count > 1).any():
        coarser *= 1.2
        count = np.maximum(np.ceil(count / np.sqrt(1.2)).astype(np.int64), 1) if coarser < 1e3 else np.ones_like(count)
    if coarser > 1:
        off = 1e3 * float((sagitta / count**2).max())
        notify(f"{where}: curved surfaces would take {asked} pieces; cut into {int((count**2).sum())}, which lie off "
               f"them by up to {off:.2g} mm")  # fmt: skip
    return count
