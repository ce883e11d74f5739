"""Loops that find shadow borders about mirror points, from what rays say is lit."""

from __future__ import annotations

import math
from typing import NamedTuple

from ullage.arrays import Bools, Floats, Longs
from ullage.kernels.edges import FaceOutlines
from ullage.kernels.loops import core, lean
from ullage.kernels.outlines import held
from ullage.kernels.shadows import ShadowBorders

STEPS = 32
"""So many triangles of a surface are followed at the most to the end of its shadow."""
ROUNDING = 1e-9
"""A silhouette may lie so far behind its shadow, over the distance of that: it lies on the face."""


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


class ShadowLines(NamedTuple):
    """The lines through mirror points on which borders (b) lie, from the eye."""

    middles: Floats  # (b, 3) to the mirror point [m]
    along: Floats  # (b, 3) one unit along the line [m]
    lit: Bools  # (b) whether the far end of the border's cell is lit


class ShadowEnds(NamedTuple):
    """Where on lines (b) the shadow of the surface that hides the dark end of a cell stops."""

    nearest: Floats  # (b) distance of what is hit first over that of the dark end; 1 where nothing is
    reach: Floats  # (b) where the shadow stops, over the unit; infinite where that is not known
    ratio: Floats  # (b) distance of the silhouette over that of its shadow
    edges: Floats  # (b, 2, 3) ends of that edge of the silhouette, from the eye [m]


class FollowedMesh(NamedTuple):
    """Triangles (f) of a body, in its own frame."""

    corners: Floats  # (f, 3, 3) [m]
    neighbours: Longs  # (f, 3) triangle across the edge from corner e to the next; -1 where there is none
    turn: Floats  # (3, 3) world_from_body


@core(error_model="numpy", forceinline=True)
def _place(directions: Directions, i: int, a: int, reach: float, out: Floats) -> None:
    """The place (3) so far along direction a about mirror point i."""
    p, size = directions.faces[i], reach * directions.units[i]
    x, y = size * directions.turn[a, 0], size * directions.turn[a, 1]
    for k in range(3):
        out[k] = directions.middles[i, k] + x * directions.across[p, 0, k] + y * directions.across[p, 1, k]


@lean(error_model="numpy")
def sample(directions: Directions, faces: FaceOutlines, counts: Longs, out: Floats) -> int:
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


@lean(error_model="numpy")
def changes(lit: Bools, counts: Longs, clear: Bools, reaches: Floats, most: int, cells: BorderCells) -> int:
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


@lean(error_model="numpy")
def between(directions: Directions, cells: BorderCells, parts: int, out: Floats) -> None:
    """Find the places (b (parts - 1), 3) that cut cells (b) into so many parts [m]."""
    for b in range(len(cells.low)):
        for j in range(1, parts):
            reach = cells.low[b] + (cells.high[b] - cells.low[b]) * j / parts
            _place(directions, cells.point[b], cells.direction[b], reach, out[b * (parts - 1) + j - 1])


@lean(error_model="numpy")
def narrow(clear: Bools, parts: int, cells: BorderCells) -> None:
    """Narrow cells (b) to the part in which light changes first; `clear`: whether the places `between` are lit."""
    for b in range(len(cells.low)):
        step, j = (cells.high[b] - cells.low[b]) / parts, 0
        while j < parts - 1 and clear[b * (parts - 1) + j] != cells.lit[b]:
            j += 1
        cells.low[b] += j * step
        cells.high[b] = cells.low[b] + step


@lean(error_model="numpy")
def dark_ends(directions: Directions, cells: BorderCells, eye: Floats, lines: ShadowLines, out: Floats) -> None:
    """Find the dark ends (b, 3) of cells (b) [m], and the lines on which they lie.

    Args:
        directions: `Directions` (k, n, c).
        cells: `BorderCells` (b).
        eye: (3) from where the light comes [m].
        lines: `ShadowLines` (b), written.
        out: (b, 3) gets the dark ends [m].
    """
    for b in range(len(cells.low)):
        i, a = cells.point[b], cells.direction[b]
        _place(directions, i, a, 0.0, lines.middles[b])
        _place(directions, i, a, 1.0, lines.along[b])
        _place(directions, i, a, cells.low[b] if cells.lit[b] else cells.high[b], out[b])
        lines.lit[b] = cells.lit[b]
        for k in range(3):
            lines.along[b, k] -= lines.middles[b, k]
            lines.middles[b, k] -= eye[k]


@core(error_model="numpy")
def _shadow_end(corners: Floats, eye: Floats, lines: ShadowLines, b: int, scratch: Floats) -> tuple[float, int, float]:
    """Find where on line b the shadow of a triangle stops on its lit side.

    Returns:
        Its distance over the unit, infinite if nowhere, which edge of the triangle casts it, and how far off that edge
        is over the distance of its shadow.
    """
    ray, along, normal, crossed = lines.middles[b], lines.along[b], scratch[0], scratch[1]
    aa, ab, bb = 0.0, 0.0, 0.0
    for k in range(3):
        aa, ab, bb = aa + ray[k] * ray[k], ab + ray[k] * along[k], bb + along[k] * along[k]
        normal[k] = ray[k - 2] * along[k - 1] - ray[k - 1] * along[k - 2]
    best, edge, ratio = -math.inf, 0, 1.0
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
        if best == -math.inf or (reach > best) == lines.lit[b]:
            best, edge, ratio = reach, e, depth / (aa * bb - ab * ab)
    return best, edge, ratio


@core(error_model="numpy")
def _hit(corners: Floats, eye: Floats, ray: Floats) -> float:
    """How far off a triangle's plane is along a ray, over the ray's length."""
    above, passed = 0.0, 0.0
    for k in range(3):
        i, j = k - 2, k - 1
        normal = (corners[1, i] - corners[0, i]) * (corners[2, j] - corners[0, j])
        normal -= (corners[2, i] - corners[0, i]) * (corners[1, j] - corners[0, j])
        above += normal * (corners[0, k] - eye[k])
        passed += normal * ray[k]
    return above / passed


@lean(error_model="numpy")
def follow(
    mesh: FollowedMesh, faces: Longs, eye: Floats, rays: Floats, lines: ShadowLines, ends: ShadowEnds, scratch: Floats
) -> None:
    """Follow surfaces from the triangles that rays hit to where their shadows stop, if nothing was hit nearer before.

    The triangle that a ray hits first depends on rounding where two adjoin; where their common shadow stops does not.

    Args:
        mesh: `FollowedMesh` (f).
        faces: (b) triangle that the ray to each dark end hits, -1 for none.
        eye: (3) from where the light comes, in the body's frame [m].
        rays: (b, 3) from there to the dark ends [m].
        lines: `ShadowLines` (b), in the body's frame.
        ends: `ShadowEnds` (b), written; in the world's axes.
        scratch: (2, 3).
    """
    for b in range(len(faces)):
        if faces[b] < 0:
            continue
        distance = _hit(mesh.corners[faces[b]], eye, rays[b])
        if not 0 < distance < ends.nearest[b]:
            continue
        ends.nearest[b] = distance
        face = faces[b]
        reach, edge, ratio = _shadow_end(mesh.corners[face], eye, lines, b, scratch)
        for _ in range(STEPS):
            beside = mesh.neighbours[face, edge]
            if beside < 0 or reach == -math.inf:
                break
            further, next_edge, next_ratio = _shadow_end(mesh.corners[beside], eye, lines, b, scratch)
            if further == -math.inf or not (further > reach if lines.lit[b] else further < reach):
                break
            face, reach, edge, ratio = beside, further, next_edge, next_ratio
        ends.reach[b], ends.ratio[b] = reach, ratio
        for end in range(2):
            for k in range(3):
                corner = mesh.corners[face, (edge + end) % 3]
                ends.edges[b, end, k] = 0.0
                for m in range(3):
                    ends.edges[b, end, k] += mesh.turn[k, m] * (corner[m] - eye[m])


@core(error_model="numpy")
def _normal_to(ends: ShadowEnds, b: int, directions: Directions, i: int, out: Floats) -> None:
    """Unit normal (2) to the shadow of an edge, along the first direction and across it."""
    p, x, y, edge = directions.faces[i], 0.0, 0.0, ends.edges[b]
    for k in range(3):
        across = edge[0, k - 2] * edge[1, k - 1] - edge[0, k - 1] * edge[1, k - 2]
        x, y = x + across * directions.across[p, 0, k], y + across * directions.across[p, 1, k]
    size = math.sqrt(x * x + y * y)
    cosine, sine = directions.turn[0, 0], directions.turn[0, 1]
    out[0], out[1] = (x * cosine + y * sine) / size, (y * cosine - x * sine) / size


@lean(error_model="numpy")
def place_borders(directions: Directions, cells: BorderCells, ends: ShadowEnds, borders: ShadowBorders) -> None:
    """Place borders within their cells: where the surface that hides the dark side stops to hide, else in the middle.

    A silhouette behind its shadow, as an eye almost in the plane of a face may find, is none.

    Args:
        directions: `Directions` (k, n, c).
        cells: `BorderCells` (b).
        ends: `ShadowEnds` (b).
        borders: `shadows.ShadowBorders` (k, n, m), of which all but `lit` is written.
    """
    turn = directions.turn
    for b in range(len(cells.low)):
        i, a, slot = cells.point[b], cells.direction[b], cells.slot[b]
        reach, ratio = ends.reach[b], ends.ratio[b]
        normal, slack = borders.normals[i, a, slot], 1e-3 * (cells.high[b] - cells.low[b])
        if 0 <= ratio <= 1 + ROUNDING and cells.low[b] - slack <= reach <= cells.high[b] + slack:
            _normal_to(ends, b, directions, i, normal)
            x = turn[a, 0] * turn[0, 0] + turn[a, 1] * turn[0, 1]
            y = turn[a, 1] * turn[0, 0] - turn[a, 0] * turn[0, 1]
            if normal[0] * x + normal[1] * y < 0:
                normal[0], normal[1] = -normal[0], -normal[1]
        else:
            reach, ratio = 0.5 * (cells.low[b] + cells.high[b]), ends.nearest[b]
            normal[0], normal[1] = math.nan, math.nan
        borders.counts[i, a] = max(borders.counts[i, a], slot + 1)
        borders.reach[i, a, slot] = reach
        borders.ratios[i, a, slot] = ratio / (2 - ratio)
