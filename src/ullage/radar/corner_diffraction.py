"""Corners of conducting faces, where the wave that one edge diffracts along the face is diffracted by the next.

Off the principal planes no edge faces the radar, and the edges' own echoes come from their ends. There the waves from
edge to edge are as strong [Michaeli1986]. Those between parallel edges are in `double_diffraction`; this module adds
those between two edges that meet at a corner, of sheets and of solid bodies.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ullage.arrays import Bools, Floats, Ints, Longs
from ullage.radar.echo_set import Rows
from ullage.world.smoothing import welded

_LEAST_SINE = 0.1  # of the angle between the edges of a corner
_LEAST_BEND = 1e-3  # sine of the angle between two normals of a curved surface


@dataclass(frozen=True, slots=True, eq=False)
class Corners(Rows):
    """Corners between two edges of one face, in the frame of their objects."""

    POINTS, DIRECTIONS = ("places",), ("along", "normals")
    places: Floats  # (c, 3) [m]
    along: Floats  # (c, 2, 3) unit vectors from the corner along both edges
    lengths: Floats  # (c, 2) of both [m]
    angles: Floats  # (c, 2) of the free space about both, over pi
    normals: Floats  # (c, 3) unit normals of the face
    widths: Floats  # (c, 2, 2) of both faces of both edges, this face first [m]
    object_ids: Ints  # (c) object


def face_corners(
    starts: Floats,
    ends: Floats,
    angles: Floats,
    inward: Floats,
    normals: Floats,
    widths: Floats,
    object_ids: Ints,
    surfaces: Longs,
) -> Corners:
    """Find where two edges of one flat surface meet; arguments as the fields of `diffraction.Edges`."""
    edge, side = (a.ravel() for a in np.meshgrid(np.arange(len(angles)), [0, 1], indexing="ij"))
    keep = (side == 0) | (angles[edge] < 2 - 1e-6)  # both faces of a rim are one
    keep &= _flat(normals[edge, side], surfaces[edge, side])
    edge, side = np.tile(edge[keep], 2), np.tile(side[keep], 2)
    end = np.repeat([False, True], keep.sum())
    places, others = (np.where(end[:, None], a[edge], b[edge]) for a, b in ((ends, starts), (starts, ends)))
    ids = welded(np.repeat(places[:, None], 3, 1))[:, 0]
    order = np.lexsort((ids, surfaces[edge, side]))
    same = (np.diff(ids[order]) == 0) & (np.diff(surfaces[edge, side][order]) == 0)
    first = same & ~np.r_[False, same[:-1]] & ~np.r_[same[1:], False]  # two edges and no third
    both = np.stack([order[:-1][first], order[1:][first]], 1)  # (c, 2)
    along = others[both] - places[both]
    lengths = np.linalg.norm(along, axis=2)
    along /= np.maximum(lengths, 1e-12)[..., None]
    into = inward[edge[both], side[both]]
    turn = np.einsum("cei,cei->ce", along, into[:, ::-1])  # sines of the angle between both edges
    held = (turn > _LEAST_SINE).all(1) & (lengths > 1e-3).all(1)
    both, along, lengths = both[held], along[held], lengths[held]
    e, s = edge[both], side[both]
    return Corners(places[both[:, 0]], along, lengths, angles[e], normals[e[:, 0], s[:, 0]],
                   np.stack([widths[e, s], widths[e, 1 - s]], 2), object_ids[e[:, 0]])  # fmt: skip


def _flat(normals: Floats, surfaces: Longs) -> Bools:
    """Whether each surface has one normal at all its edges (n): a wave runs straight along it."""
    _, first, which = np.unique(surfaces, return_index=True, return_inverse=True)
    bent = np.zeros(len(first))
    np.maximum.at(bent, which, np.linalg.norm(np.cross(normals, normals[first][which]), axis=1))
    return np.asarray(bent[which] < _LEAST_BEND)


def at_wavelength(corners: Corners, narrow_m: float) -> tuple[Corners, Bools]:
    """Select the corners of faces that are wide enough [m]; edges of thin bodies become edges of sheets.

    Returns:
        The corners (c), and which of them are those of sheets, which have no thickness at all.
    """
    held = corners.take(np.asarray((corners.widths[:, :, 0] >= narrow_m).all(1)))
    sheet = held.angles > 2 - 1e-6
    thin = sheet | (held.widths[:, :, 1] < narrow_m)
    return replace(held, angles=np.where(thin, 2.0, held.angles)), np.asarray(sheet.all(1))
