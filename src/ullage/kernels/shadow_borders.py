"""Loops that find shadow borders about mirror points, from what rays say is lit."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ullage.arrays import Bools, Floats, Longs
from ullage.kernels.edges import FaceOutlines
from ullage.kernels.loops import core, lean
from ullage.kernels.outlines import held
from ullage.kernels.shadows import ShadowBorders

PAST = 0.01
"""How far past the shadow of one triangle the next is sought, over the cell."""


class Directions(NamedTuple):
    """Directions (n) about mirror points (k), and where along them light is sampled (c)."""

    middles: Floats  # (k, 3) mirror points [m]
    faces: Longs  # (k) face of each
    units: Floats  # (k) distance at which the phase is 1 rad [m]
    across: Floats  # (p, 2, 3) unit vectors in the faces, at right angles
    turn: Floats  # (n, 2) cosine and sine of each direction
    cells: Floats  # (c) sampled distances over `units`, rising


class BorderCells(NamedTuple):
    """Cells (b) along directions in which light and shadow change."""

    point: Longs  # (b) mirror point
    direction: Longs  # (b)
    slot: Longs  # (b) which border along the direction it is
    low: Floats  # (b) between this distance, over `Directions.units`
    high: Floats  # (b) and this
    lit: Bools  # (b) whether the far end is lit


class TriangleHits(NamedTuple):
    """What hides the dark ends of cells (b)."""

    corners: Floats  # (b, 3, 3) of the triangle hit, NaN where they are not known [m]
    ratios: Floats  # (b) distance of the hit over that of the dark end

    def any(self) -> bool:
        """Whether anything is hit."""
        return bool((self.ratios < 1).any())

    def over(self, other: TriangleHits) -> TriangleHits:
        """Take another's hits where it has some, else these."""
        known = other.ratios < 1
        return TriangleHits(
            np.where(known[:, None, None], other.corners, self.corners), np.where(known, other.ratios, self.ratios)
        )


@core(nogil=True, error_model="numpy", forceinline=True)
def _place(directions, i, a, reach, out):  # type: ignore[no-untyped-def]
    """The place (3) so far along direction a about mirror point i."""
    p, size = directions.faces[i], reach * directions.units[i]
    x, y = size * directions.turn[a, 0], size * directions.turn[a, 1]
    for k in range(3):
        out[k] = directions.middles[i, k] + x * directions.across[p, 0, k] + y * directions.across[p, 1, k]


@lean(by_fields=True, nogil=True, error_model="numpy")
def sample(directions: Directions, faces: FaceOutlines, counts, out):  # type: ignore[no-untyped-def]
    """Find the places (m, 3) along all directions at which light is sampled, as far as the faces go.

    Args:
        directions: `Directions` (k, n, c).
        faces: `edges.FaceOutlines` (p).
        counts: (k, n) gets how many places there are along each.
        out: (k n c, 3) gets the places in order [m].

    Returns:
        How many there are.
    """
    row = 0
    for i in range(len(directions.middles)):
        p = directions.faces[i]
        for a in range(len(directions.turn)):
            counts[i, a] = 0
            for reach in directions.cells:
                _place(directions, i, a, reach, out[row])
                if not held(out[row], p, faces.normals, faces.first, faces.starts, faces.ends):
                    break
                counts[i, a] += 1
                row += 1
    return row


@lean(by_fields=True, nogil=True, error_model="numpy")
def changes(lit, counts, clear, reaches, most, cells: BorderCells):  # type: ignore[no-untyped-def]
    """Find the cells in which light and shadow change, at most so many along each direction.

    Args:
        lit: (k) whether the mirror points are lit.
        counts: (k, n) as `sample` gives them.
        clear: (m) whether the places are lit.
        reaches: (c) as `Directions.cells`.
        most: how many cells are kept along each direction.
        cells: `BorderCells`, written.

    Returns:
        How many there are.
    """
    row, found = 0, 0
    for i in range(len(lit)):
        for a in range(counts.shape[1]):
            before, slot = lit[i], 0
            for c in range(counts[i, a]):
                now = clear[row + c]
                if now != before and slot < most:
                    cells.point[found], cells.direction[found], cells.slot[found] = i, a, slot
                    cells.low[found] = reaches[c - 1] if c > 0 else 0.0
                    cells.high[found], cells.lit[found] = reaches[c], now
                    found += 1
                    slot += 1
                before = now
            row += counts[i, a]
    return found


@lean(by_fields=True, nogil=True, error_model="numpy")
def between(directions: Directions, cells: BorderCells, parts, out):  # type: ignore[no-untyped-def]
    """Find the places (b (parts - 1), 3) that cut cells (b) into so many parts [m]."""
    for b in range(len(cells.low)):
        for j in range(1, parts):
            reach = cells.low[b] + (cells.high[b] - cells.low[b]) * j / parts
            _place(directions, cells.point[b], cells.direction[b], reach, out[b * (parts - 1) + j - 1])


@lean(by_fields=True, nogil=True, error_model="numpy")
def narrow(clear, parts, cells: BorderCells):  # type: ignore[no-untyped-def]
    """Narrow cells (b) to the part in which light changes first; `clear`: whether the places `between` are lit."""
    for b in range(len(cells.low)):
        step, j = (cells.high[b] - cells.low[b]) / parts, 0
        while j < parts - 1 and clear[b * (parts - 1) + j] != cells.lit[b]:
            j += 1
        cells.low[b] += j * step
        cells.high[b] = cells.low[b] + step


@lean(by_fields=True, nogil=True, error_model="numpy")
def dark_ends(directions: Directions, cells: BorderCells, out):  # type: ignore[no-untyped-def]
    """Find the dark ends (b, 3) of cells (b) [m]."""
    for b in range(len(cells.low)):
        reach = cells.low[b] if cells.lit[b] else cells.high[b]
        _place(directions, cells.point[b], cells.direction[b], reach, out[b])


@lean(by_fields=True, nogil=True, error_model="numpy")
def keep_nearest(corners, origin, points, hits: TriangleHits):  # type: ignore[no-untyped-def]
    """Keep the triangles that rays to points hit, where they are nearer than what was hit before.

    Args:
        corners: (b, 3, 3) of the triangle hit first on the path to each point, NaN for none [m].
        origin: (3) [m].
        points: (b, 3) [m].
        hits: `TriangleHits` (b), written.
    """
    for b in range(len(corners)):
        above, passed = 0.0, 0.0
        for k in range(3):
            i, j = k - 2, k - 1
            normal = (corners[b, 1, i] - corners[b, 0, i]) * (corners[b, 2, j] - corners[b, 0, j])
            normal -= (corners[b, 1, j] - corners[b, 0, j]) * (corners[b, 2, i] - corners[b, 0, i])
            above += normal * (corners[b, 0, k] - origin[k])
            passed += normal * (points[b, k] - origin[k])
        ratio = above / passed
        if 0 < ratio < hits.ratios[b]:
            hits.ratios[b] = ratio
            for e in range(3):
                for k in range(3):
                    hits.corners[b, e, k] = corners[b, e, k]


@core(nogil=True, error_model="numpy")
def _silhouette(corners, eye, directions, i, a, lit, none, scratch):  # type: ignore[no-untyped-def]
    """Find where along a direction the shadow of a triangle ends on its lit side.

    Returns:
        Its distance over the unit, `none` if nowhere, which edge of the triangle it is, and how far off that edge is
        over the distance of its shadow.
    """
    ray, along, normal, crossed = scratch[0], scratch[1], scratch[2], scratch[3]
    _place(directions, i, a, 0.0, ray)
    _place(directions, i, a, 1.0, along)
    aa, ab, bb = 0.0, 0.0, 0.0
    for k in range(3):
        along[k] -= ray[k]
        ray[k] -= eye[k]
        aa, ab, bb = aa + ray[k] * ray[k], ab + ray[k] * along[k], bb + along[k] * along[k]
    for k in range(3):
        normal[k] = ray[k - 2] * along[k - 1] - ray[k - 1] * along[k - 2]
    best, edge, ratio = none, 0, 1.0
    for e in range(3):
        f, here, there = (e + 1) % 3, 0.0, 0.0
        for k in range(3):
            here += normal[k] * (corners[e, k] - eye[k])
            there += normal[k] * (corners[f, k] - eye[k])
        if not here * there < 0:
            continue
        xa, xb = 0.0, 0.0
        for k in range(3):
            crossed[k] = corners[e, k] + here / (here - there) * (corners[f, k] - corners[e, k]) - eye[k]
            xa, xb = xa + crossed[k] * ray[k], xb + crossed[k] * along[k]
        depth = xa * bb - xb * ab
        if depth <= 0:
            continue
        reach = (xb * aa - xa * ab) / depth
        if best == none or (reach > best) == lit:
            best, edge, ratio = reach, e, depth / (aa * bb - ab * ab)
    return best, edge, ratio


@core(nogil=True, error_model="numpy")
def _normal_to(corners, edge, eye, directions, i, out):  # type: ignore[no-untyped-def]
    """Unit normal (2) to the shadow of an edge of a triangle, along the first direction and across it."""
    p, f, x, y = directions.faces[i], (edge + 1) % 3, 0.0, 0.0
    for k in range(3):
        across = (corners[edge, k - 2] - eye[k - 2]) * (corners[f, k - 1] - eye[k - 1])
        across -= (corners[edge, k - 1] - eye[k - 1]) * (corners[f, k - 2] - eye[k - 2])
        x, y = x + across * directions.across[p, 0, k], y + across * directions.across[p, 1, k]
    size = math.sqrt(x * x + y * y)
    cosine, sine = directions.turn[0, 0], directions.turn[0, 1]
    out[0], out[1] = (x * cosine + y * sine) / size, (y * cosine - x * sine) / size


@lean(by_fields=True, nogil=True, error_model="numpy")
def past_triangles(directions: Directions, cells: BorderCells, hits: TriangleHits, eye, out, scratch):  # type: ignore[no-untyped-def]
    """Find places (b, 3) just past the shadows of the triangles that hide the dark ends: what hides these, adjoins.

    Args:
        directions: `Directions` (k, n, c).
        cells: `BorderCells` (b).
        hits: `TriangleHits` (b).
        eye: (3) from where the light comes [m].
        out: (b, 3) gets them; where the shadow does not end within its cell, the lit end [m].
        scratch: (4, 3).
    """
    for b in range(len(cells.low)):
        i, a, low, high = cells.point[b], cells.direction[b], cells.low[b], cells.high[b]
        reach = _silhouette(hits.corners[b], eye, directions, i, a, cells.lit[b], -math.inf, scratch)[0]
        reach += PAST * (high - low) * (1 if cells.lit[b] else -1)
        if not low < reach < high:
            reach = high if cells.lit[b] else low
        _place(directions, i, a, reach, out[b])


@lean(by_fields=True, nogil=True, error_model="numpy")
def place_borders(directions: Directions, cells: BorderCells, hits: TriangleHits, eye, borders: ShadowBorders, scratch):  # type: ignore[no-untyped-def]
    """Place borders within their cells: where the triangle that hides the dark side stops to hide, else in the middle.

    Args:
        directions: `Directions` (k, n, c).
        cells: `BorderCells` (b).
        hits: `TriangleHits` (b).
        eye: (3) from where the light comes [m].
        borders: `shadows.ShadowBorders` (k, n, m), of which all but `lit` is written.
        scratch: (4, 3).
    """
    turn = directions.turn
    for b in range(len(cells.low)):
        i, a, slot = cells.point[b], cells.direction[b], cells.slot[b]
        reach, edge, ratio = _silhouette(hits.corners[b], eye, directions, i, a, cells.lit[b], -math.inf, scratch)
        normal, slack = borders.normals[i, a, slot], 1e-3 * (cells.high[b] - cells.low[b])
        if cells.low[b] - slack <= reach <= cells.high[b] + slack:
            _normal_to(hits.corners[b], edge, eye, directions, i, normal)
            x = turn[a, 0] * turn[0, 0] + turn[a, 1] * turn[0, 1]
            y = turn[a, 1] * turn[0, 0] - turn[a, 0] * turn[0, 1]
            if normal[0] * x + normal[1] * y < 0:
                normal[0], normal[1] = -normal[0], -normal[1]
        else:
            reach, ratio = 0.5 * (cells.low[b] + cells.high[b]), hits.ratios[b]
            normal[0], normal[1] = math.nan, math.nan
        borders.counts[i, a] = max(borders.counts[i, a], slot + 1)
        borders.reach[i, a, slot] = reach
        borders.ratios[i, a, slot] = ratio / (2 - ratio)
