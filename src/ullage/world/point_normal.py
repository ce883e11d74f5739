"""Point-normal triangles: cubic patches through the corners of a mesh, square to its corner normals there.

Each triangle becomes a cubic Bezier triangle [VlachosEtAl2001], kept here as its displacement from the flat triangle.
Two things differ from that source. Along an edge the slopes at both ends are limited against each other, so that
straight lines of a cone or cylinder stay straight and one wrong normal does not raise a bump (as for monotone cubics
[FritschCarlson1980]). Tangents are as long as those of a circle's cubic, so that edges on a ball are arcs of it.
"""

from __future__ import annotations

import numpy as np

from ullage.arrays import Floats, Longs
from ullage.world.smoothing import Hinges

STEEPEST = 3.0
"""At one end of an edge the patch leaves the chord at most so many times as steeply as at the other."""


def displacements(corners: Floats, normals: Floats, found: Hinges) -> Floats:
    """Displacement of the patches' control points from flat triangles (f, 7, 3) [m].

    Two for each edge, from corner k to the next one, at a third and at two thirds; the last is that of the middle.

    Args:
        corners: triangles (f, 3, 3) [m].
        normals: at their corners (f, 3, 3).
        found: edges at which triangles go over into each other; there both share one curve.
    """
    ends = np.stack([normals, np.roll(normals, -1, 1)], 2)  # (f, edge, end, 3)
    a, b, k, m = found.faces[:, 0], found.faces[:, 1], found.starts[:, 0], found.ends[:, 1]
    both = ends[a, k] + ends[b, m, ::-1]
    both /= np.maximum(np.linalg.norm(both, axis=2, keepdims=True), 1e-300)
    ends[a, k], ends[b, m] = both, both[:, ::-1]
    chord = np.roll(corners, -1, 1) - corners
    rise = np.einsum("fei,feni->fen", chord, ends) * [-1.0, 1.0]
    least = abs(rise).min(2, keepdims=True)
    rise = np.where((rise.prod(2) > 0)[..., None], np.clip(rise, -STEEPEST * least, STEEPEST * least), 0.0)
    # tangents at the ends, as long as makes a circle of an edge with equal slopes at both: 4/3 tan of a quarter turn
    square = np.maximum((chord**2).sum(2), 1e-300)[..., None]
    cosine = np.sqrt(np.maximum(1 - rise**2 / square, 0.25))
    ahead = np.stack([chord, -chord], 2)
    tangent = 2 / (cosine * (1 + cosine))[..., None] * (ahead + rise[..., None] * ends)
    sides = ((tangent - ahead) / 3).reshape(-1, 6, 3)
    return np.concatenate([sides, sides.sum(1, keepdims=True) / 4], 1)


def follow_rims(control: Floats, corners: Floats, ids: Longs, faces: Longs, starts: Longs) -> None:
    """Bend edges at which patches end along the smooth curves that they sample, such as circles; changes `control`.

    A curve's tangent at a corner halves the angle of the two edges that meet there.

    Args:
        control: displacements (f, 7, 3) as of `displacements` [m].
        corners: flat triangles (f, 3, 3) [m].
        ids: numbers (f, 3) of their corners, the same for corners in one place.
        faces: triangle (e) of each such edge.
        starts: corner (e), 0 to 2, at which it begins there.
    """
    nexts = (starts + 1) % 3
    chord = corners[faces, nexts] - corners[faces, starts]
    size = np.maximum(np.linalg.norm(chord, axis=1), 1e-300)[:, None]
    both = np.stack([ids[faces, starts], ids[faces, nexts]], 1)
    tangents = np.zeros((int(ids.max(initial=0)) + 1, 3))
    np.add.at(tangents, both, (chord / size)[:, None])
    tangents /= np.maximum(np.linalg.norm(tangents, axis=1), 1e-300)[:, None]
    for corner, sign, at in zip(both.T, (1, -1), (2 * starts, 2 * starts + 1), strict=True):
        turn = tangents[corner]
        cosine = np.maximum(np.einsum("ei,ei->e", turn, chord)[:, None] / size, 0.5)
        control[faces, at] = sign * (2 / (1 + cosine) * size * turn - chord) / 3
    control[faces, 6] = control[faces, :6].sum(1) / 4


def sagitta(control: Floats) -> Floats:
    """Greatest distance (f) of the middles of a patch's edges from the flat triangle [m]."""
    middles = 3 / 8 * (control[:, 0:6:2] + control[:, 1:6:2])
    return np.asarray(np.linalg.norm(middles, axis=2).max(1))


def rise(control: Floats, shares: Floats) -> Floats:
    """Displacement (f, p, 3) of patches (f, 7, 3) from flat triangles at points (p, 3), shares of the corners [m]."""
    u, v, w = shares.T
    basis = 3 * np.stack([u * u * v, u * v * v, v * v * w, v * w * w, w * w * u, w * u * u, 2 * u * v * w], 1)
    return np.asarray(np.einsum("pc,fci->fpi", basis, control))


def cut(corners: Floats, control: Floats, count: Longs) -> tuple[Floats, Longs, Floats]:
    """Cut patches into flat triangles.

    Each lies on its patch in the mean: it is shifted by the mean of what the middles of its edges lack, as a parabola
    has it.

    Args:
        corners: flat triangles (f, 3, 3) [m].
        control: displacements (f, 7, 3) [m].
        count: pieces (f) along each edge.

    Returns:
        The triangles (m, 3, 3) [m], the patch (m) of each, and where in it their middles lie (m, 3), as shares of its
        corners.
    """
    out, of, within = [], [], []
    for many in np.unique(count):
        mine = np.flatnonzero(count == many)
        shares = pieces(int(many))
        middles = (shares + np.roll(shares, 1, 1)) / 2
        at = np.einsum("pcb,nbi->npci", shares, corners[mine])
        up, between = (rise(control[mine], row.reshape(-1, 3)).reshape(at.shape) for row in (shares, middles))
        lack = between.mean(2, keepdims=True) - up.mean(2, keepdims=True)
        out.append((at + up + lack).reshape(-1, 3, 3))
        of.append(np.repeat(mine, len(shares)))
        within.append(np.tile(shares.mean(1), (len(mine), 1)))
    return np.concatenate(out), np.concatenate(of), np.concatenate(within)


def pieces(many: int) -> Floats:
    """Cut a triangle into (p, 3, 3) with `many` along each side, in barycentric coordinates."""
    i, j = (row.ravel() for row in np.meshgrid(np.arange(many), np.arange(many), indexing="ij"))
    up, down = i + j < many, i + j < many - 1
    one = np.stack([np.stack([i, j], 1), np.stack([i + 1, j], 1), np.stack([i, j + 1], 1)], 1)[up]
    other = np.stack([np.stack([i + 1, j], 1), np.stack([i + 1, j + 1], 1), np.stack([i, j + 1], 1)], 1)[down]
    share = np.concatenate([one, other]) / many
    return np.concatenate([1 - share.sum(2, keepdims=True), share], 2)
