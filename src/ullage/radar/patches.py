"""Curved surfaces of any shape: point-normal triangles in place of coarse facets.

A facet that samples a curved surface lies off it by its sagitta, and the error of phase repeats from facet to facet:
the mesh echoes as a grating. Where no closed form stands for a surface (`spheres`, `cylinder_correction`), cubic
patches through its corners and normals [VlachosEtAl2001] take its place, cut until flat pieces follow them within
`SHARE` of a wave. Next to a closed form they are square to its own normals, so the knuckle of a vessel continues its
crown and its wall without a bend. The pieces echo by physical optics as all small triangles do (`patch_echoes`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ullage.arrays import Bools, Floats, Ints, Longs
from ullage.radar.facets import Surfaces, strewn
from ullage.radar.solids import Backs
from ullage.world import point_normal, smoothing
from ullage.world.notices import notify
from ullage.world.scene import Scene
from ullage.world.smoothing import welded

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
    """Curved surfaces among what stands still, or among what moves, and the facets that they stand in for."""

    fine: Surfaces  # pieces of the curved surfaces
    depth: Floats  # (n) so far each piece lies off its facet at the most [m]
    cell: Longs  # (n) cell of each piece, whose pieces share a ray; -1: it is too long to share one
    middles: Floats  # (c, 3) of cells [m]
    facing: Floats  # (c, 3) their unit normals
    deep: Floats  # (c) as `depth`, of cells [m]
    owner: Ints  # (c) object of each cell
    small: Bools  # (f) which small triangles are done so
    planar: Bools  # (p) and which flat faces


@dataclass(frozen=True, slots=True, eq=False)
class Curved:
    """Facets of curved surfaces, and the patches through them."""

    corners: Floats  # (n, 3, 3) [m]
    object_ids: Ints  # (n) object
    control: Floats  # (n, 7, 3) as in `point_normal.displacements` [m]
    sagitta: Floats  # (n) [m]
    row: Longs  # (n) which small triangle each is, or counted on after these which flat face it belongs to


def curved_of(scene: Scene, part: Surfaces, known: Floats) -> tuple[Curved, Bools, Longs] | None:
    """Fit patches to the facets of curved surfaces; None where there are none.

    Args:
        scene: the world.
        part: what of it stands still, or what moves, where it starts.
        known: normals (s, 3, 3) of closed forms at the corners of the faces of the scene that they stand for; zero at
            other faces.

    Returns:
        All facets (n) of the part; which closed forms stand for; the surface that each belongs to.
    """
    faces = np.concatenate([part.faces, part.flat_faces])
    row = np.concatenate([np.arange(len(part.faces)), len(part.faces) + part.flat_at])  # small ones, then flats
    corners, object_ids = scene.corners()[faces], scene.face_object[faces]
    claimed, ids = known[faces].any((1, 2)), welded(corners)
    limits = smoothing.creases(scene.objects)
    found = smoothing.hinges(corners, ids, object_ids, limits)
    if claimed.all() or not len(found):
        return None
    given = None if scene.corner_normals is None else scene.corner_normals[faces]
    normals = smoothing.corner_normals(corners, found, given, known[faces], crease_deg=limits.deg[object_ids])
    control = point_normal.displacements(corners, normals, found)
    edge, side = np.nonzero(~claimed[found.faces] & claimed[found.faces[:, ::-1]])
    begin = np.stack([found.starts[:, 0], found.ends[:, 1]], 1)
    point_normal.follow_rims(control, corners, ids, found.faces[edge, side], begin[edge, side])
    facets = Curved(corners, object_ids, control, point_normal.sagitta(control), row)
    return facets, claimed, found.regions(len(faces))


def patches_of(
    curved: tuple[Curved, Bools, Longs], part: Surfaces, *, wavelength_m: float, widest_m: float, world: str
) -> Patches | None:
    """Cut the curved surfaces of a part as finely as a wavelength needs; None where facets are fine enough.

    Args:
        curved: as `curved_of` returns it.
        part: of the world.
        wavelength_m: of the radar [m].
        widest_m: facets wider than this are mirrors of their own [m].
        world: its name, for notices.
    """
    facets, claimed, region = curved
    rows = len(part.faces) + len(part.planar)
    coarse = (_counts(facets.sagitta, SHARE * wavelength_m) > 1) & ~claimed
    coarse = (np.bincount(region, coarse)[region] > 0) & (facets.sagitta > LEAST * wavelength_m)  # shifted, if not cut
    taken = np.bincount(facets.row, coarse, rows) > 0
    taken &= np.bincount(facets.row, claimed | (_widths(facets.corners) >= widest_m), rows) == 0
    mine = np.flatnonzero(taken[facets.row])
    if not len(mine):
        return None
    chosen = Curved(facets.corners[mine], facets.object_ids[mine], facets.control[mine], facets.sagitta[mine],
                    facets.row[mine])  # fmt: skip
    count = _bounded(chosen.sagitta, SHARE * wavelength_m, world)
    return _cut(chosen, count, part, taken, SIGHT * wavelength_m)


def _cut(curved: Curved, count: Longs, part: Surfaces, taken: Bools, cell_m: float) -> Patches:
    """Make pieces, so many (n) along each edge, that stand in for rows `taken` (f + p); cells of rays are so wide."""
    pieces, of, within = point_normal.cut(curved.corners, curved.control, count)
    normals, area = smoothing.face_normals(pieces)
    kept = area > 1e-12
    pieces, normals, of, within = pieces[kept], normals[kept], of[kept], within[kept]
    fine, order = strewn(pieces, normals, curved.object_ids[of], _sides(pieces, normals, curved.row[of], part), part)
    depth = 2 * curved.sagitta[of][order]  # the middle of a triangle bows out 4/3 as far as those of its edges
    cell = _cells(curved.corners[of], of, within, cell_m)[order]
    cell[_longest(fine.corners) > 2 * cell_m] = -1
    of_pieces = np.column_stack([fine.corners.mean(1), fine.normals, depth])
    middles, facing, deep = np.split(_means(of_pieces, cell), [3, 6], axis=1)
    facing = facing / np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-300)
    owner = np.zeros(len(middles), np.int32)
    owner[cell[cell >= 0]] = fine.object_ids[cell >= 0]
    small, planar = taken[: len(part.faces)], taken[len(part.faces) :]
    return Patches(fine, depth, cell, middles, facing, deep[:, 0], owner, small, planar)


def _sides(pieces: Floats, normals: Floats, row: Longs, part: Surfaces) -> Backs:
    """Outer sides of pieces (n, 3, 3), turned as what they stand in for: a small triangle, or after these a flat."""
    turned = np.concatenate([part.backs.outward, part.flat_backs.outward])[row, :3]
    outward = np.sign(np.einsum("ni,ni->n", turned, normals))[:, None] * normals
    body = np.concatenate([part.backs.body, part.flat_backs.body])[row]
    level = -np.einsum("ni,ni->n", outward, pieces[:, 0])
    return Backs(np.column_stack([outward, level]), body, part.backs.boxes)


def _means(rows: Floats, cell: Longs) -> Floats:
    """Means (c, k) of rows (n, k) over cells (n); rows of cell -1 are left out."""
    shared = np.flatnonzero(cell >= 0)
    out = np.zeros((int(cell.max(initial=-1)) + 1, rows.shape[1]))
    np.add.at(out, cell[shared], rows[shared])
    return np.asarray(out / np.maximum(np.bincount(cell[shared], minlength=len(out)), 1)[:, None])


def _cells(facets: Floats, parent: Longs, within: Floats, size_m: float) -> Longs:
    """Number (n) the cells of each facet, so wide, by facets (n, 3, 3) of pieces and where they lie in them."""
    cells = np.ceil(_longest(facets) / size_m)
    i, j = (np.floor(within[:, k] * cells).astype(np.int64) for k in (1, 2))
    wide = int(cells.max()) + 1
    return np.asarray(np.unique((parent * wide + i) * wide + j, return_inverse=True)[1], np.int64)


def _longest(triangles: Floats) -> Floats:
    """Longest side (f) of triangles (f, 3, 3) [m]."""
    return np.asarray(np.linalg.norm(np.roll(triangles, -1, 1) - triangles, axis=2).max(1))


def _widths(corners: Floats) -> Floats:
    """Smallest height (f) of triangles (f, 3, 3) [m]."""
    return np.asarray(2 * smoothing.face_normals(corners)[1] / np.maximum(_longest(corners), 1e-300))


def _counts(sagitta: Floats, most_m: float) -> Longs:
    """Pieces (n) along the edges of patches that leave at most so much of their sagittas (n) [m]."""
    return np.maximum(np.ceil(np.sqrt(sagitta / most_m) - 1e-9).astype(np.int64), 1)


def _bounded(sagitta: Floats, most_m: float, where: str) -> Longs:
    """As `_counts`, but where all pieces would be more than `MOST` for a coarser bound, with a warning."""
    asked = int((_counts(sagitta, most_m) ** 2).sum())
    while ((count := _counts(sagitta, most_m)) ** 2).sum() > MOST and count.max() > 1:
        most_m *= 1.1
    made = int((count**2).sum())
    if made < asked:
        off = 1e3 * float((sagitta / count**2).max())
        notify(f"{where}: curved surfaces would take {asked} pieces; cut into {made}, which lie off them by up to "
               f"{off:.2g} mm")  # fmt: skip
    return count
