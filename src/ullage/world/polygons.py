"""Cut the polygons of mesh files into triangles that stay inside them.

Readers cut a polygon into a fan about its first corner. The fan of a concave polygon, such as the floor of an L-shaped
room, covers ground outside of it. Concave polygons are cut by their ears instead.
"""

from __future__ import annotations

import re

import numpy as np

from ullage.arrays import Bools, Floats, Longs

_POLYGON = re.compile(rb"^f(?:[ \t]+[^\s]+){4}", re.MULTILINE)
_RELATIVE = re.compile(rb"^f[ \t][^\n]*-", re.MULTILINE)
_ZERO = re.compile(rb"^f[ \t](?:[^\n]*[ \t])?0(?=[/\s]|\Z)", re.MULTILINE)
_BESIDE = re.compile(rb"/\S*")
_VERTEX, _FACE = (b"v ", b"v\t"), (b"f ", b"f\t")
_FLAT = 1e-6
"""Share of a polygon's area by which a corner must turn back."""


def triangle_corners(counts: Longs, places: Floats) -> Longs:
    """Return the corners of the triangles of polygons, in the polygons' order.

    Args:
        counts: (p) corners of each polygon; one of fewer than three gives no triangle.
        places: (c, 3) place of every corner, polygon after polygon.

    Returns:
        (t, 3) numbers of corners.
    """
    starts = np.cumsum(counts) - counts
    triangles, owners = [np.zeros((0, 3), np.int64)], [np.zeros(0, np.int64)]
    for size in np.unique(counts[counts > 2]).tolist():
        which = np.flatnonzero(counts == size)
        corners = starts[which, None] + np.arange(size)
        fan = np.stack([np.repeat(corners[:, :1], size - 2, axis=1), corners[:, 1:-1], corners[:, 2:]], axis=-1)
        for row in np.flatnonzero(_are_concave(places[corners])).tolist():
            ears = _ears(places[corners[row]])
            if len(ears) == size - 2:
                fan[row] = corners[row][ears]
        triangles.append(fan.reshape(-1, 3))
        owners.append(np.repeat(which, size - 2))
    return np.concatenate(triangles)[np.argsort(np.concatenate(owners), kind="stable")]


def plain_obj(obj: bytes) -> bytes:
    """Return the text of an OBJ file with absolute numbers in its faces and no concave face, all else as it was.

    Raises:
        ValueError: a face names vertex 0, or one before the first.
    """
    if _ZERO.search(obj):
        raise ValueError("a face names vertex 0; the first is 1")
    if _RELATIVE.search(obj):
        obj = _absolute(obj)
    return _without_concave_faces(obj) if _POLYGON.search(obj) else obj


def _absolute(obj: bytes) -> bytes:
    """Count faces from the first vertex; a file may count them back from the vertex before the face."""
    known, lines = {b"v": 0, b"vt": 0, b"vn": 0}, _lines(obj)

    def number(text: bytes, kind: bytes) -> bytes:
        if not text.startswith(b"-"):
            return text
        if (found := known[kind] + 1 + int(text)) < 1:
            raise ValueError(f"a face names number {text.decode()} of {known[kind]}")
        return b"%d" % found

    for row, line in enumerate(lines):
        kind, *words = line.split() or [b""]
        if kind in known:
            known[kind] += 1
        elif kind == b"f":
            corners = [b"/".join(map(number, word.split(b"/"), known)) for word in words]
            lines[row] = b" ".join([b"f", *corners])
    return b"\n".join(lines)


def _lines(obj: bytes) -> list[bytes]:
    return obj.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").split(b"\n")


def _without_concave_faces(obj: bytes) -> bytes:
    lines = _lines(obj)
    vertices = np.array([line[:2] in _VERTEX for line in lines])
    rows = [k for k, line in enumerate(lines) if line[:2] in _FACE and len(line.split()) > 4]
    counts = np.array([len(lines[k].split()) - 1 for k in rows], np.int64)
    coordinates = b" ".join(b" ".join(lines[k].split()[1:4]) for k in np.flatnonzero(vertices).tolist())
    places = np.array(coordinates.split()).astype(np.float64).reshape(-1, 3)
    numbers = np.array(_BESIDE.sub(b"", b" ".join(lines[k][2:] for k in rows)).split()).astype(np.int64)
    if len(numbers) != counts.sum() or numbers.max() > len(places):
        return obj  # the reader reports it
    numbers -= 1
    corners, first = triangle_corners(counts, places[numbers]), 0
    for k, start, size in zip(rows, (np.cumsum(counts) - counts).tolist(), counts.tolist(), strict=True):
        mine, first = corners[first : first + size - 2], first + size - 2
        if (mine[:, 0] != start).any():
            words = lines[k].split()[1:]
            lines[k] = b"\n".join(b"f " + b" ".join(words[one] for one in row) for row in (mine - start).tolist())
    return b"\n".join(lines)


def _are_concave(places: Floats) -> Bools:
    """Whether polygons (m, k, 3) turn back at a corner."""
    edge = np.roll(places, -1, axis=1) - places
    turn = np.cross(np.roll(edge, 1, axis=1), edge)
    normal = np.cross(places - places[:, :1], np.roll(places, -1, axis=1) - places[:, :1]).sum(1)  # twice the area
    area = np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
    return np.asarray((np.einsum("mkc,mc->mk", turn, normal) < -_FLAT * area[:, None] ** 2).any(1))


def _ears(places: Floats) -> Longs:
    """Triangles (t, 3) of one polygon (k, 3), which turn as it does."""
    import mapbox_earcut

    normal = np.cross(places - places[0], np.roll(places, -1, axis=0) - places[0]).sum(0)
    axis = int(np.argmax(np.abs(normal)))
    flat = np.ascontiguousarray(places[:, [(axis + 1) % 3, (axis + 2) % 3]])
    found = mapbox_earcut.triangulate_float64(flat, np.array([len(flat)], np.uint32)).reshape(-1, 3).astype(np.int64)
    a, b, c = (places[found[:, k]] for k in range(3))
    away = np.cross(b - a, c - a) @ normal < 0
    found[away] = found[away][:, ::-1]
    return np.asarray(found)
