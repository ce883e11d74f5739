"""Repair triangle meshes, and give them one form that depends on their surface and not on how it was cut.

Corners in one place become one, and faces that coincide one sheet. Triangles of one plane become flat faces again. The
corners of these are where creases and outlines turn or meet; each is cut anew by Delaunay's rule. Neighbours are wound
alike. Vertices and faces are sorted by place, so that their order in the file does not count either.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ullage.arrays import Bools, Floats, Ints, Longs
from ullage.world.smoothing import crosses, half_edges, linked

WELD = 1e-6
"""Corners nearer than this share of the mesh's size are one."""
SINGLE = 2.0**-24
"""Rounding of a coordinate in single precision, as a share of it: mesh files have no more."""
DIGITS = (6, 7)
"""Digits of coordinates in text files."""
BENDS_RAD = (1e-4, 1e-6, 1e-9)
"""Neighbours that bend by less are one flat face; by the next one where a face so grown bends as a whole."""
SLIVER = 1e-9
"""A triangle whose area is less than this share of its longest edge squared has none."""
FILLED = 1e-6
"""Areas and lengths that differ by a smaller share are equal."""


@dataclass(frozen=True, slots=True, eq=False)
class Repaired:
    """A mesh in its one form, and what was wrong with it."""

    vertices: Floats  # (v, 3) [m]
    faces: Ints  # (f, 3)
    corner_normals: Floats | None  # (f, 3, 3) unit vectors, zero where unknown
    given: int  # triangles before
    without_area: int  # triangles left out
    coincident: int  # triangles left out, since others lie in the same place
    turned: int  # triangles of closed bodies wound against most of their neighbours; a sheet has no outside
    shared: int  # edges of more than two faces

    @property
    def report(self) -> str:
        """What was wrong, in one line; empty if nothing was that may change the surface."""
        left_out = ((self.without_area, "degenerate"), (self.coincident, "coincident"))
        parts = [f"{n} {what} triangle{'s' * (n > 1)} of {self.given} left out" for n, what in left_out if n]
        parts += [f"{self.turned} of {self.given} triangles turned as their neighbours"] if self.turned else []
        parts += [f"{self.shared} edges of more than two faces split"] if self.shared and parts else []
        return "; ".join(parts)


def repaired(vertices: Floats, faces: Ints, corner_normals: Floats | None = None) -> Repaired:
    """Repair a mesh and give it its one form.

    Args:
        vertices: (v, 3) [m].
        faces: (f, 3).
        corner_normals: (f, 3, 3) of the true surface at the faces' corners, zero where unknown; None: all unknown.

    Returns:
        The mesh; it has no faces if none of those given has an area.
    """
    places, tri = _welded(np.asarray(vertices, np.float64), np.asarray(faces, np.int64))
    kept = np.flatnonzero(~without_area(places[tri]))
    tri, normals = _rolled(tri[kept], None if corner_normals is None else corner_normals[kept])
    once, twice = _single(tri)
    tri, normals = tri[once], None if normals is None else normals[once]
    a, b, body, shared = _split(places, tri)
    rounded = 4 * _rounding(places)
    flats = _flat_faces(places[tri], a, b, rounded)
    own, corner = np.unique(np.repeat(body, 3) * max(len(places), 1) + tri.ravel(), return_inverse=True)
    place, tri = own % max(len(places), 1), corner.reshape(-1, 3)  # corners of each body are its own from here on
    cut, owner = _retriangulated(places[place], tri, flats, rounded)
    normals = None if normals is None else _averaged_normals(normals, places[place], tri, flats.of, cut, owner)
    cut = place[cut]
    once, _ = _single(cut)
    cut, owner, normals = cut[once], owner[once], None if normals is None else normals[once]
    cut, normals, closed = _oriented(places, cut, normals)
    sides = np.zeros(len(flats.normals))
    sides[owner[closed]] = np.einsum("fi,fi->f", crosses(places[cut[closed]]), flats.normals[owner[closed]])
    turned = int((sides[flats.of] * flats.sides < 0)[~twice].sum())
    used, cut = np.unique(cut, return_inverse=True)
    cut, normals = _rolled(cut.reshape(-1, 3), normals)
    without, coincident = len(faces) - len(kept), len(kept) - len(flats.of)
    return Repaired(places[used], cut.astype(np.int32), normals, len(faces), without, coincident, turned, shared)


def without_area(corners: Floats) -> Bools:
    """Which triangles (f, 3, 3) are degenerate."""
    longest = ((np.roll(corners, -1, 1) - corners) ** 2).sum(2).max(1, initial=0.0)
    return np.asarray(np.linalg.norm(crosses(corners), axis=1) <= SLIVER * longest)


def _welded(vertices: Floats, faces: Longs) -> tuple[Floats, Longs]:
    """Vertices sorted by place, those nearer than `WELD` as one, and the faces by their numbers."""
    used, tri = np.unique(faces, return_inverse=True)
    places = vertices[used] + 0.0
    once, many, order = _rows(places)
    places, number = places[once], np.empty(len(order), np.int64)
    number[order] = np.repeat(np.arange(len(once)), many)
    near = cKDTree(places).query_pairs(WELD * float(np.linalg.norm(np.ptp(places, axis=0))), output_type="ndarray")
    if len(near):
        _, first, group = np.unique(linked(near[:, 0], near[:, 1], len(places)), return_index=True, return_inverse=True)
        places, number = places[np.sort(first)], np.searchsorted(np.sort(first), first[group])[number]
    return places, number[tri].reshape(-1, 3)


def _rounding(points: Floats) -> float:
    """How far rounding moves points (v, 3) [m]: that of text with six or seven digits, or of single precision."""
    size = abs(points).max(initial=0.0)
    unit = 10.0 ** np.floor(np.log10(np.maximum(abs(points), 1e-12 * size + 1e-300)))
    for digits in DIGITS:
        parts = points / unit * 10 ** (digits - 1)
        if (abs(parts - np.rint(parts)) < 0.05).all():
            return float(0.5 * unit.max(initial=0.0) * 10.0 ** (1 - digits))
    return float(SINGLE * np.linalg.norm(points, axis=1).max(initial=0.0))


def _rolled(tri: Longs, normals: Floats | None) -> tuple[Longs, Floats | None]:
    """Faces (f, 3), with normals at their corners, each from its lowest corner on, and sorted."""
    turn = (tri.argmin(1)[:, None] + np.arange(3)) % 3
    tri = np.take_along_axis(tri, turn, 1)
    order = np.lexsort(tri.T[::-1])
    return tri[order], None if normals is None else np.take_along_axis(normals, turn[..., None], 1)[order]


def _single(tri: Longs) -> tuple[Longs, Bools]:
    """Numbers (n) of faces, of several with the same three corners the first; whether (n) there were several."""
    once, many, _ = _rows(np.sort(tri, 1))
    order = np.argsort(once)
    return once[order], many[order] > 1


def _split(points: Floats, tri: Longs) -> tuple[Longs, Longs, Longs, int]:
    """Split faces (f, 3) into bodies along edges of more than two faces.

    There the two of one body are neighbours, then those that continue each other in one plane, if there are just two.

    Returns:
        Pairs of half edges of neighbours (n), (n); body (f) of each face; number of such edges.
    """
    order, first, many = half_edges(tri)
    a, b = order[first[many == 2]], order[first[many == 2] + 1]
    body = linked(a // 3, b // 3, len(tri))
    left, edge = order[np.repeat(many > 2, many)], np.repeat(first[many > 2], many[many > 2])
    c, d = _pairs_of_keys(edge * len(tri) + body[left // 3], left)
    rest = ~np.isin(left, np.concatenate([c, d]))
    e, f = _continued(points, tri, left[rest], edge[rest])
    a, b = np.concatenate([a, c, e]), np.concatenate([b, d, f])
    return a, b, linked(a // 3, b // 3, len(tri)), int((many > 2).sum())


def _pairs_of_keys(keys: Longs, values: Longs) -> tuple[Longs, Longs]:
    """Values whose key (n) just one other has, and those others."""
    order = np.argsort(keys, kind="stable")
    first = np.flatnonzero(np.diff(keys[order], prepend=-1))
    first = first[np.diff(np.r_[first, len(keys)]) == 2]
    return values[order[first]], values[order[first + 1]]


def _continued(points: Floats, tri: Longs, halves: Longs, edge: Longs) -> tuple[Longs, Longs]:
    """Half edges (n) of the same edge (n) whose faces continue each other in one plane, where these are just two."""
    many = np.diff(np.flatnonzero(np.diff(edge, prepend=-1, append=-1)))
    first = np.cumsum(many) - many
    found = [np.zeros((2, 0), np.int64)]
    for place in range(1, int(many.max(initial=0))):
        some = first[many > place]
        found += [np.stack([halves[some + before], halves[some + place]]) for before in range(place)]
    a, b = np.concatenate(found, 1)
    flat = _bends(points[tri], crosses(points[tri]), a, b)[0] < BENDS_RAD[0]
    a, b = a[flat], b[flat]
    count = np.bincount(np.concatenate([a, b]), minlength=3 * len(tri))
    alone = (count[a] == 1) & (count[b] == 1)
    return a[alone], b[alone]


@dataclass(frozen=True, slots=True, eq=False)
class _FlatFaces:
    """Flat faces that triangles (f) make."""

    of: Longs  # (f) face of each triangle
    normals: Floats  # (p, 3) of each face
    areas: Floats  # (p) twice the area [m2]
    sides: Floats  # (f) 1 or -1: whether each triangle is wound about its face's normal


def _flat_faces(corners: Floats, a: Longs, b: Longs, rounded: float) -> _FlatFaces:
    """Group triangles (f, 3, 3) that continue each other in one plane, but for the rounding of corners [m].

    Half edges `a` (n) and `b` (n) are of neighbours.
    """
    cross = crosses(corners)
    bend, gap = _bends(corners, cross, a, b)
    a, b = a // 3, b // 3
    joined, bent = (bend < BENDS_RAD[0]) | (gap < rounded), np.ones(len(corners), bool)
    for most in BENDS_RAD:
        joined = np.where(bent[a], joined & ((bend < most) | (most == BENDS_RAD[0])), joined)
        found = _planes(corners, cross, linked(a[joined], b[joined], len(corners)))
        off = corners - _centres(corners, cross, found.of)[found.of][:, None]
        reach = np.zeros(len(found.areas))
        np.maximum.at(reach, found.of, abs(np.einsum("fki,fi->fk", off, found.normals[found.of])).max(1, initial=0.0))
        bent = (reach > np.maximum(most * np.sqrt(found.areas), 2 * rounded))[found.of]
        if not bent.any():
            break
    return found


def _centres(corners: Floats, cross: Floats, of: Longs) -> Floats:
    """Centre of area (p, 3) of each face."""
    area = np.linalg.norm(cross, axis=1)
    total = np.stack([np.bincount(of, area * m) for m in corners.mean(1).T], 1)
    return np.asarray(total / np.bincount(of, area)[:, None])


def _planes(corners: Floats, cross: Floats, of: Longs) -> _FlatFaces:
    """Faces of which each has some triangles; their normals are those of the vector area, toward most of the area."""
    lead = np.unique(of, return_index=True)[1]
    sides = np.where(np.einsum("fi,fi->f", cross, cross[lead][of]) < 0, -1.0, 1.0)
    total: Floats = np.stack([np.bincount(of, sides * row) for row in cross.T], 1)
    most = np.bincount(of, sides * np.linalg.norm(cross, axis=1)) < 0
    areas = np.linalg.norm(total, axis=1)
    normals = np.where(most[:, None], -total, total) / np.maximum(areas, 1e-300)[:, None]
    return _FlatFaces(of, normals, areas, np.where(most[of], -sides, sides))


def _bends(corners: Floats, cross: Floats, a: Longs, b: Longs) -> tuple[Floats, Floats]:
    """Bend [rad] of surfaces over pairs of half edges, and by how much the lower triangle leaves the other's plane [m].

    Triangles on the same side of their edge bend by more than a right angle: they do not continue each other.
    """
    along = (np.roll(corners, -1, 1) - corners).reshape(-1, 3)
    length = np.maximum(np.linalg.norm(along, axis=1), 1e-300)
    height = np.repeat(np.linalg.norm(cross, axis=1), 3) / length
    inward = np.cross(np.repeat(cross, 3, 0), along)
    inward /= np.maximum(np.linalg.norm(inward, axis=1), 1e-300)[:, None]
    bend = 2 * np.arcsin(np.minimum(np.linalg.norm(inward[a] + inward[b], axis=1) / 2, 1.0))
    gap = np.minimum(height[a], height[b]) * np.sin(np.minimum(bend, np.pi / 2))
    return bend, np.where(bend < np.pi / 2, gap, np.inf)


def _retriangulated(points: Floats, tri: Longs, flats: _FlatFaces, rounded: float) -> tuple[Longs, Longs]:
    """Triangles (n, 3) of flat faces cut anew, wound about their normals, and the face (n) of each."""
    wound = np.where(flats.sides[:, None] > 0, tri, tri[:, ::-1])
    size = np.bincount(flats.of)
    rows = _outlines(points, tri, flats.of, rounded)
    around = np.bincount(rows[:, 0], np.linalg.norm(points[rows[:, 1]] - points[rows[:, 2]], axis=1), len(size))
    rows = rows[size[rows[:, 0]] > 1]
    first, many = np.unique(rows[:, 0], return_index=True, return_counts=True)[1:]
    three = first[many == 3]
    triangles = np.stack([rows[three, 1], rows[three, 2], rows[three + 1, 2]], 1), rows[three, 0]
    found = [triangles, _of_four(points, rows, first[many == 4], flats.normals)]
    done = np.concatenate([owner for _, owner in found])
    found.append(_of_many(points, rows[~np.isin(rows[:, 0], done)], flats.normals))
    cut, owner = (np.concatenate(parts) for parts in zip(*found, strict=True))
    down = np.einsum("fi,fi->f", crosses(points[cut]), flats.normals[owner]) < 0
    cut[down] = cut[down][:, ::-1]
    whole = np.bincount(owner, np.linalg.norm(crosses(points[cut]), axis=1), len(size))
    filled = (whole > 0) & (abs(whole - flats.areas) < FILLED * flats.areas + rounded * around)
    old, kept = ~filled[flats.of], filled[owner]
    return np.concatenate([wound[old], cut[kept]]), np.concatenate([flats.of[old], owner[kept]])


def _outlines(points: Floats, tri: Longs, of: Longs, rounded: float) -> Longs:
    """Edges (n, 3) of flat faces, sorted: the face, and both ends. Corners where nothing turns or meets are passed."""
    start, end, face = tri.ravel(), np.roll(tri, -1, 1).ravel(), np.repeat(of, 3)
    rows = np.stack([face, np.minimum(start, end), np.maximum(start, end)], 1)
    once, count, _ = _rows(rows)
    rows = rows[once[count % 2 == 1]]
    edge = rows[_rows(rows[:, 1:])[0], 1:]
    chain, exits = _straight(points, edge, rounded)
    ends, through = rows[:, 1:].copy(), chain[rows[:, 1:]].max(1, initial=-1)
    ends[through >= 0] = exits[through[through >= 0]]
    rows = np.column_stack([rows[:, 0], np.sort(ends, 1)])
    return rows[_rows(rows)[0]]


def _rows(rows: NDArray[Any]) -> tuple[Longs, Longs, Longs]:
    """Numbers of different rows (n, k), of equal ones the first, sorted; how often each is there; the order of all."""
    order = np.lexsort(rows.T[::-1])
    first = np.flatnonzero(np.r_[True, (np.diff(rows[order], axis=0) != 0).any(1)][: len(rows)])
    return order[first], np.diff(np.r_[first, len(rows)]), order


def _straight(points: Floats, edge: Longs, rounded: float) -> tuple[Longs, Longs]:
    """Chains of corners (v) at which just two edges (e, 2) meet in one line; -1 at others. Both ends (c, 2) of each."""
    count = len(points)
    degree = np.bincount(edge.ravel(), minlength=count)
    step = points[edge[:, 1]] - points[edge[:, 0]]
    length = np.linalg.norm(step, axis=1)
    unit = step / np.maximum(length, 1e-300)[:, None]
    turn = np.stack([np.bincount(edge[:, 0], u, count) - np.bincount(edge[:, 1], u, count) for u in unit.T], 1)
    shorter = np.full(count, np.finfo(float).max)
    np.minimum.at(shorter, edge, length[:, None])
    bend = np.linalg.norm(turn, axis=1)
    gone = (degree == 2) & ((bend < BENDS_RAD[0]) | (shorter < rounded / np.maximum(bend, 1e-300)) & (bend < 1))
    both, one = gone[edge].all(1), gone[edge].any(1)
    group = np.full(count, -1)
    names = linked(edge[both, 0], edge[both, 1], count)
    group[gone] = np.unique(names[gone], return_inverse=True)[1]
    leaves = edge[one & ~both]
    inner = gone[leaves].argmax(1)
    row = np.arange(len(leaves))
    chain, outer = group[leaves[row, inner]], leaves[row, 1 - inner]
    order = np.lexsort((outer, chain))
    exits = np.full((int(group.max(initial=-1)) + 1, 2), -1)
    place = np.r_[False, np.diff(chain[order]) == 0][: len(order)].astype(np.int64)
    exits[chain[order], place] = outer[order]
    middle = np.flatnonzero(gone)
    a, b = points[exits[group[middle]].T]
    chord = np.linalg.norm(b - a, axis=1)
    off = np.linalg.norm(np.cross(points[middle] - a, b - a), axis=1) / np.maximum(chord, 1e-300)
    bent = np.zeros(len(exits), bool)
    np.logical_or.at(bent, group[middle], off > np.maximum(BENDS_RAD[0] * chord, 2 * rounded))
    group[middle[bent[group[middle]]]] = -1
    return group, exits


def _of_four(points: Floats, rows: Longs, first: Longs, normals: Floats) -> tuple[Longs, Longs]:
    """Triangles of faces of four edges that begin at `first`, cut along the shorter diagonal, and their faces."""
    a, b, d = rows[first, 1], rows[first, 2], rows[first + 1, 2]  # the lowest corner, and its two neighbours
    c = (rows[first[:, None] + np.arange(4), 1:].sum((1, 2)) - 2 * (a + b + d)) // 2
    quad, up = np.stack([a, b, c, d], 1), normals[rows[first, 0]]
    one, other = quad[:, [[0, 1, 2], [0, 2, 3]]], quad[:, [[1, 2, 3], [1, 3, 0]]]
    least = [np.einsum("nti,ni->nt", np.stack([crosses(points[half[:, k]]) for k in range(2)], 1), up) for half in
             (one, other)]  # fmt: skip
    good = [(sides.prod(1) > 0) & (abs(sides).min(1) > FILLED * abs(sides).max(1)) for sides in least]
    diagonals = [np.linalg.norm(points[p] - points[q], axis=1) for p, q in ((a, c), (b, d))]
    use = good[0] & ~(good[1] & (diagonals[1] < (1 - FILLED) * diagonals[0]))
    kept = good[0] | good[1]
    return np.where(use[:, None, None], one, other)[kept].reshape(-1, 3), np.repeat(rows[first, 0][kept], 2)


def _of_many(points: Floats, rows: Longs, normals: Floats) -> tuple[Longs, Longs]:
    """Triangles of faces of any outline, with holes or without, and their faces: Delaunay's, in a plane of the axes."""
    import shapely

    if not len(rows):
        return np.zeros((0, 3), np.int64), np.zeros(0, np.int64)
    some, at = np.unique(rows[:, 0], return_inverse=True)
    drop = (abs(normals[some]) * [1.0, 1.01, 1.02]).argmax(1)
    keep = np.array([[1, 2], [2, 0], [0, 1]])[drop]
    flat = points[rows[:, 1:]][np.arange(len(rows))[:, None, None], np.arange(2)[:, None], keep[at][:, None]]
    lines = shapely.multilinestrings(shapely.linestrings(flat), indices=at)
    pieces, of = shapely.get_parts(shapely.constrained_delaunay_triangles(shapely.build_area(lines)), return_index=True)
    places = shapely.get_coordinates(pieces).reshape(-1, 4, 2)[:, :3]
    known = np.column_stack([np.repeat(at, 2), flat.reshape(-1, 2)])
    asked = np.column_stack([np.repeat(of, 3), places.reshape(-1, 2)])
    _, number = np.unique(np.concatenate([known, asked]) + 0.0, axis=0, return_inverse=True)
    number = number.reshape(-1)
    vertex = np.full(int(number.max()) + 1, -1)
    vertex[number[: len(known)]] = rows[:, 1:].ravel()
    cut = vertex[number[len(known) :]].reshape(-1, 3)
    whole = (cut >= 0).all(1)
    return cut[whole], some[of[whole]]


def _averaged_normals(normals: Floats, points: Floats, tri: Longs, of: Longs, cut: Longs, owner: Longs) -> Floats:
    """Normals (n, 3, 3) at the corners of the faces cut anew: means of those that their flat faces had there."""
    sides = np.roll(points[tri], -1, 1) - points[tri]
    sides /= np.maximum(np.linalg.norm(sides, axis=2, keepdims=True), 1e-300)
    angle = np.arccos(np.clip(-np.einsum("fki,fki->fk", sides, np.roll(sides, 1, 1)), -1, 1))
    wide = len(points)
    have, want = np.repeat(of, 3) * wide + tri.ravel(), np.repeat(owner, 3) * wide + cut.ravel()
    names, at = np.unique(have, return_inverse=True)
    weighted = (angle[..., None] * normals).reshape(-1, 3)
    total = np.stack([np.bincount(at, row, len(names)) for row in weighted.T], 1)
    out = total[np.searchsorted(names, want)].reshape(-1, 3, 3)
    return np.asarray(out / np.maximum(np.linalg.norm(out, axis=2, keepdims=True), 1e-300))


def _oriented(points: Floats, tri: Longs, normals: Floats | None) -> tuple[Longs, Floats | None, Bools]:
    """Faces (f, 3), with normals at their corners, wound as the most of their neighbours; whether they (f) close."""
    back, closed = _misoriented(points, tri)
    tri = np.where(back[:, None], tri[:, ::-1], tri)
    if normals is None:
        return tri, None, closed
    normals = np.where(back[:, None, None], normals[:, ::-1], normals)
    inward = np.einsum("fki,fi->fk", normals, crosses(points[tri])) < 0
    return tri, np.where(inward[..., None], -normals, normals), closed


def _misoriented(points: Floats, tri: Longs) -> tuple[Bools, Bools]:
    """Which faces (f) are wound against the most of their neighbours, and which are part of closed bodies.

    A body that is wound alike keeps its sides, as a room has that faces inward. One that is not is turned outward if
    it is closed; else the greater area decides, and over equals the axes.
    """
    count = len(tri)
    order, first, many = half_edges(tri)
    a, b = order[first[many == 2]], order[first[many == 2] + 1]
    alike = tri.ravel()[a] != tri.ravel()[b]
    a, b = a // 3, b // 3
    here, there = (
        np.concatenate([a, a + count]),
        np.concatenate([b + np.where(alike, 0, count), b + np.where(alike, count, 0)]),
    )
    one, other = linked(here, there, 2 * count).reshape(2, count)
    body, sign = np.minimum(one, other), np.where(one <= other, 1.0, -1.0)
    body = np.unique(body, return_inverse=True)[1].reshape(-1)
    cross = crosses(points[tri])
    area = np.linalg.norm(cross, axis=1)
    total, most = np.bincount(body, area), np.bincount(body, sign * area)
    volume = np.bincount(body, sign * np.einsum("fi,fi->f", cross, points[tri[:, 0]] - points.mean(0)))
    lone = order[np.repeat(many != 2, many)] // 3
    closed = np.ones(len(total), bool)
    closed[body[lone]] = False
    lead = np.unique(body, return_index=True)[1]
    axis = abs(cross[lead]).argmax(1)
    tie = sign[lead] * np.sign(cross[lead, axis])
    side = np.where(closed, np.sign(volume), np.where(abs(most) > FILLED * total, np.sign(most), tie))
    side = np.where(abs(most) > (1 - FILLED) * total, np.sign(most), side)
    return np.asarray(sign != side[body]), closed[body]
