"""Triangulated primitives: vertices on the true surface, wound outward, centred on the origin, axis along z.

`segment_m` and `edge_m` are the longest side that a facet may have along a curved direction [m]; `sagitta_segment_m`
gives the one that keeps facets within a distance of the true surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, pi, sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ullage.arrays import Floats, Ints, Longs
from ullage.errors import InputError

Shape = tuple[Floats, Ints]

MOST_FACES = 4_000_000
"""A primitive that would need more faces is refused."""

_QUADS = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))


def sagitta_segment_m(radius_m: float, sagitta_m: float) -> float:
    """Length of a chord that bows out by at most `sagitta_m` on a circle of this radius [m]."""
    return min(sqrt(8 * radius_m * sagitta_m), 2 * radius_m)


def box(size_m: ArrayLike) -> Shape:
    """A box of these full sizes (3) [m].

    Raises:
        InputError: a size is not above zero.
    """
    size = _positive("box size", size_m, 3)
    corner = np.array([[x, y, z] for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
    return corner * size, _triangles(np.array(_QUADS))


def plane(size_m: ArrayLike, *, normal: ArrayLike = (0, 0, 1)) -> Shape:
    """A flat rectangle (2) [m] through the origin, facing `normal` (3).

    Raises:
        InputError: a size is not above zero, or the normal has no length.
    """
    size = _positive("plane size", size_m, 2)
    up = np.asarray(normal, float)
    length = np.linalg.norm(up)
    if not (np.isfinite(length) and length > 0):
        raise InputError(f"plane normal {up.tolist()} has no direction")
    flat = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]]) * [*size, 0]
    return flat @ _turn_z_to(up / length).T, np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def cylinder(radius_m: float, length_m: float, *, segment_m: float) -> Shape:
    """A closed round cylinder.

    Raises:
        InputError: a size is not above zero.
    """
    r, h, s = _positive("cylinder radius, length and segment", (radius_m, length_m, segment_m), 3)
    return _revolve([(0, -h / 2), (r, -h / 2), (r, h / 2), (0, h / 2)], _around(r, s))


def cone(radius_m: float, length_m: float, *, segment_m: float) -> Shape:
    """A closed cone: base at -length / 2, tip at +length / 2.

    Raises:
        InputError: a size is not above zero.
    """
    r, h, s = _positive("cone radius, length and segment", (radius_m, length_m, segment_m), 3)
    return _revolve([(0, -h / 2), (r, -h / 2), (0, h / 2)], _around(r, s))


def capsule(radius_m: float, length_m: float, *, segment_m: float) -> Shape:
    """A cylinder of this length with a half sphere on each end (whole length: length + 2 radius).

    Raises:
        InputError: a size is not above zero.
    """
    r, h, s = _positive("capsule radius, length and segment", (radius_m, length_m, segment_m), 3)
    angle = np.linspace(0, pi / 2, max(4, ceil(pi / 2 * r / s)) + 1)
    cap = np.stack([r * np.sin(angle), -h / 2 - r * np.cos(angle)], axis=1)
    cap[0, 0] = 0.0
    return _revolve(np.concatenate([cap, cap[::-1] * [1, -1]]), _around(r, s))


def tube(
    radius_m: float, inner_radius_m: float, length_m: float, *, segment_m: float, turn_rad: float = 2 * pi
) -> Shape:
    """A pipe with a wall; `turn_rad` below 2 pi cuts it lengthwise (pi: a half-pipe from +x over +y to -x).

    Raises:
        InputError: a size is not above zero, the hole is not smaller than the pipe, or the turn is out of (0, 2 pi].
    """
    r, q, h, s = _positive("tube radii, length and segment", (radius_m, inner_radius_m, length_m, segment_m), 4)
    if q >= r or not 0 < turn_rad <= 2 * pi:
        raise InputError(
            f"tube of radii {r:g} and {q:g} m over {turn_rad:g} rad", allowed="inner < outer, 0 < turn <= 2 pi"
        )
    profile = [(r, -h / 2), (r, h / 2), (q, h / 2), (q, -h / 2), (r, -h / 2)]
    return _revolve(profile, _around(r, s, turn_rad), turn_rad=turn_rad)


def sphere(radius_m: float, *, edge_m: float) -> Shape:
    """A ball of nearly equal triangles: an icosahedron divided and pushed onto the sphere.

    Raises:
        InputError: a size is not above zero.
    """
    r, s = _positive("sphere radius and edge", (radius_m, edge_m), 2)
    return _ball(2 * ceil(1.325 * r / s / 2), r)  # an even number: vertices on the axes; no edge is over 1.325 r / n


def ellipsoid(radii_m: ArrayLike, *, edge_m: float) -> Shape:
    """An ellipsoid with these half axes (3) [m].

    Raises:
        InputError: a size is not above zero.
    """
    radii = _positive("ellipsoid radii", radii_m, 3)
    unit, faces = sphere(1.0, edge_m=float(_positive("ellipsoid edge", (edge_m,), 1)[0] / radii.max()))
    return unit * radii, faces


def extrude(rings: Sequence[ArrayLike], height_m: float) -> Shape:
    """A prism over closed outlines in the xy plane, from z = 0 up to `height_m`.

    Args:
        rings: outlines (k, 2) [m]; what lies inside an even number of them is a hole.
        height_m: above zero [m].

    Raises:
        InputError: an outline has no area or crosses itself.
    """
    from shapely import Polygon, get_parts
    from shapely.geometry.polygon import orient

    (height,) = _positive("extrusion height", (height_m,), 1)
    area = Polygon()
    for number, ring in enumerate(rings):
        points = np.asarray(ring, float)
        outline = Polygon(points) if len(points) >= 3 and np.isfinite(points).all() else Polygon()
        if not (outline.is_valid and outline.area > 0):
            raise InputError(
                f"outline {number} has no area or crosses itself", allowed="3 or more points around an area"
            )
        area = area.symmetric_difference(outline)
    parts = [_prism(orient(part), float(height)) for part in get_parts(area) if part.area > 0]
    if not parts:
        raise InputError("the outlines leave nothing", allowed="outlines around an area")
    shift = np.cumsum([0, *(len(v) for v, _ in parts)])[:-1]
    faces = np.concatenate([f + s for (_, f), s in zip(parts, shift, strict=True)])
    return np.concatenate([v for v, _ in parts]), faces.astype(np.int32)


def terrain(heights_m: Floats, size_m: ArrayLike) -> Shape:
    """A height field (rows, columns) over a rectangle (2) [m]; row 0 lies at +y, column 0 at -x.

    Raises:
        InputError: fewer than 2 x 2 heights, or a size is not above zero.
    """
    size = _positive("terrain size", size_m, 2)
    z = np.asarray(heights_m, float)
    if z.ndim != 2 or min(z.shape) < 2:
        raise InputError(f"terrain of shape {z.shape}", allowed="2 x 2 heights or more")
    rows, columns = z.shape
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, columns) * size[0], np.linspace(0.5, -0.5, rows) * size[1])
    index = np.arange(z.size).reshape(rows, columns)
    quads = np.stack([index[1:, :-1], index[1:, 1:], index[:-1, 1:], index[:-1, :-1]], axis=-1)
    return np.stack([x, y, z], axis=-1).reshape(-1, 3), _triangles(quads.reshape(-1, 4))


def _positive(what: str, value: ArrayLike, count: int) -> Floats:
    out = np.asarray(value, float)
    if out.shape != (count,) or not (np.isfinite(out).all() and (out > 0).all()):
        raise InputError(f"{what} {out.tolist()}", allowed=f"{count} finite number{'s' * (count > 1)} above zero")
    return out


def _triangles(quads: NDArray[np.integer]) -> Ints:
    return np.ascontiguousarray(quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3), np.int32)


def _around(radius_m: float, segment_m: float, turn_rad: float = 2 * pi) -> int:
    """Segments of an arc: at least 8 a turn, and a multiple of 4 so that the extreme points lie on the axes."""
    return 4 * max(2, ceil(turn_rad * radius_m / segment_m / 4))


def _revolve(profile: ArrayLike, count: int, *, turn_rad: float = 2 * pi) -> Shape:
    """Turn a profile (k, 2) of radius and z, running up on the outside, about z."""
    line = np.asarray(profile, float)
    whole = turn_rad >= 2 * pi
    if count * len(line) * 2 > MOST_FACES:
        raise InputError(
            f"a shape needs {count * len(line) * 2} faces", allowed=f"at most {MOST_FACES}; a longer segment"
        )
    angle = np.arange(count if whole else count + 1) * (turn_rad / count)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    wide = np.concatenate(
        [line[:, None, :1] * ring, np.broadcast_to(line[:, None, 1:], (len(line), len(ring), 1))], axis=2
    )
    index = np.arange(wide.shape[0] * wide.shape[1]).reshape(wide.shape[:2])
    here, there = (index, np.roll(index, -1, axis=1)) if whole else (index[:, :-1], index[:, 1:])
    quads = np.stack([here[:-1], there[:-1], there[1:], here[1:]], axis=-1).reshape(-1, 4)
    faces = [_triangles(quads)]
    if not whole:  # the two cut faces of a closed rectangular profile
        faces.append(_triangles(np.stack([index[:4, 0], index[3::-1, -1]])))
    return _welded(wide.reshape(-1, 3), np.concatenate(faces))


def _welded(vertices: Floats, faces: Ints) -> Shape:
    """Merge equal vertices, drop faces that lost a corner by it and vertices that no face uses."""
    merged, where = np.unique(vertices, axis=0, return_inverse=True)
    out = where.reshape(-1)[faces]
    whole = (out[:, 0] != out[:, 1]) & (out[:, 1] != out[:, 2]) & (out[:, 2] != out[:, 0])
    return merged, out[whole].astype(np.int32)


def _ball(parts: int, radius_m: float) -> Shape:
    if 20 * parts**2 > MOST_FACES:
        raise InputError(f"a sphere needs {20 * parts**2} faces", allowed=f"at most {MOST_FACES}; a longer edge")
    g = (1 + sqrt(5)) / 2
    corner = np.array([[s * a, t * b, 0] for a, b in ((1, g),) for s in (-1, 1) for t in (-1, 1)])
    corner = np.concatenate([corner, np.roll(corner, 1, axis=1), np.roll(corner, 2, axis=1)])
    gap = np.linalg.norm(corner[:, None] - corner[None], axis=2)
    near = (gap < 2.01) & (gap > 0)
    top = [(i, j, k) for i in range(12) for j in range(i) for k in range(j) if near[i, j] and near[j, k] and near[i, k]]
    abc = corner[np.array(top)]
    inward = np.einsum("fi,fi->f", np.cross(abc[:, 1] - abc[:, 0], abc[:, 2] - abc[:, 0]), abc[:, 0]) < 0
    abc[inward] = abc[inward][:, ::-1]
    u, v = (a.reshape(-1) for a in np.mgrid[: parts + 1, : parts + 1])
    keep = u + v <= parts
    u, v = u[keep], v[keep]
    number = np.full((parts + 2, parts + 2), -1)
    number[u, v] = np.arange(len(u))
    i, j = u[u + v < parts], v[u + v < parts]
    up = np.stack([number[i, j], number[i + 1, j], number[i, j + 1]], axis=1)
    i, j = u[u + v < parts - 1], v[u + v < parts - 1]
    down = np.stack([number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]], axis=1)
    weight = np.stack([parts - u - v, u, v], axis=1) / parts
    points = np.einsum("wk,fkx->fwx", weight, abc).reshape(-1, 3)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    faces = (np.concatenate([up, down]) + len(u) * np.arange(20)[:, None, None]).reshape(-1, 3)
    # equal corners of neighbouring faces differ in the last bits: compare rounded
    _, first, where = np.unique(np.round(points, 9) + 0.0, axis=0, return_index=True, return_inverse=True)
    return points[first] * radius_m, where.reshape(-1)[faces].astype(np.int32)


def earcut(polygon: Any) -> tuple[list[Floats], Longs, Floats]:
    """Cut a shapely polygon into triangles.

    Returns:
        Its rings (k, 2), the outline first; the triangles (t, 3) by their points, all turning left; twice their areas.
    """
    import mapbox_earcut

    rings = [np.asarray(ring.coords)[:-1] for ring in (polygon.exterior, *polygon.interiors)]
    points, ends = np.concatenate(rings), np.cumsum([len(ring) for ring in rings]).astype(np.uint32)
    tri = mapbox_earcut.triangulate_float64(points, ends).reshape(-1, 3).astype(np.int64)
    a, b, c = (points[tri[:, k]] for k in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    tri[area < 0] = tri[area < 0][:, ::-1]
    return rings, tri, abs(area)


def _prism(polygon: Any, height_m: float) -> Shape:
    rings, lid, _ = earcut(polygon)
    flat = np.concatenate(rings)
    n = len(flat)
    ends = np.cumsum([len(r) for r in rings])
    next_index = np.concatenate([np.roll(np.arange(e - len(r), e), -1) for r, e in zip(rings, ends, strict=True)])
    here = np.arange(n)
    sides = _triangles(np.stack([here, next_index, next_index + n, here + n], axis=1))
    vertices = np.concatenate([np.c_[flat, np.zeros(n)], np.c_[flat, np.full(n, height_m)]])
    return vertices, np.concatenate([sides, lid + n, lid[:, ::-1]]).astype(np.int32)


def _turn_z_to(up: Floats) -> Floats:
    """The smallest rotation (3, 3) that takes z to the unit vector `up`."""
    from scipy.spatial.transform import Rotation

    axis = np.cross([0.0, 0.0, 1.0], up)
    sine = np.linalg.norm(axis)
    if sine < 1e-12:
        return np.eye(3) if up[2] > 0 else np.diag([1.0, -1.0, -1.0])
    return np.asarray(Rotation.from_rotvec(axis / sine * np.arctan2(sine, up[2])).as_matrix())
