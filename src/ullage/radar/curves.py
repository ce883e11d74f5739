"""Echoes of curved surfaces by way of large flat faces: a round tank's wall over its floor, a drum beside a wall.

A curved surface comes as many facets, each smaller than a Fresnel zone, so it is no mirror. But flat faces mirror the
radar, and from its images the facets are done by physical optics as from the radar itself: Kirchhoff's integral with
one end of the path at an image [AllenBerkley1979], [Balanis2012, ch. 7].
Polarisation and reflection are those of a mirror at each point that turns the wave there the way it goes on.
Of a facet counts what both legs reach: where they meet their faces within the rims, and are free.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ullage.geometry import C0
from ullage.kernels import edges, lit
from ullage.kernels import facets as triangle
from ullage.kernels import ways as kernel
from ullage.radar.facets import Flats, Surfaces
from ullage.radar.flats import Outlined, lay_parted, parted
from ullage.radar.mirrors import unit
from ullage.radar.physical import KAPPA, REACH, Bench, Laid, View, common, grown, lay_triangles
from ullage.radar.solids import Backs
from ullage.radar.ways import Ways, reached

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Ints = NDArray[np.int32]
Longs = NDArray[np.int64]

NUDGE_M = 5e-3
"""Points of facets are looked at so far within their rims [m]."""
_FAR_M = -1e9  # radius of a sphere that lies beyond any gate


@dataclass(frozen=True, slots=True, eq=False)
class Strips:
    """Facets as ways meet them, one for each way and facet: what their rims are done by."""

    of: Longs  # (m) way
    on: Longs  # (m) face
    shares: Floats  # (m) how much of it counts
    faces: Outlined  # (m)


def lay_curves(
    ready: Bench, parts: list[Surfaces], flats: Flats, view: View, ways: Ways, faint: float, grids: Complexes
) -> list[Laid]:
    """Adds the echoes of small triangles and of facets of curved surfaces over flat faces to the delay grids.

    What cannot return the path gain amplitude `faint` is left out.
    """
    if not len(ways):
        return []
    out: list[Laid] = []
    for part in parts:
        if len(part.corners):
            out += _lay_small(ready, parts, part, flats, view, ways, faint, grids)
    smooth = np.flatnonzero(flats.smooth)
    if len(smooth):
        out += _lay_strips(ready, parts, flats, view, ways, smooth, faint, grids)
    return out


@lru_cache(maxsize=8)
def _bare(ready: Bench) -> Bench:
    """The bench with everything reflecting 1, for paths whose coefficients are known otherwise."""
    count = len(ready.gamma)
    return replace(ready, gamma=ready.gamma[-1:].repeat(count, axis=0), lag=ready.lag[-1:].repeat(count, axis=0))


def _lay_small(
    ready: Bench, parts: list[Surfaces], part: Surfaces, flats: Flats, view: View, ways: Ways, faint: float,
    grids: Complexes,
) -> list[Laid]:  # fmt: skip
    out, bare, unlit = [], _bare(ready), np.empty(len(part.corners), np.bool_)
    gate, fresnel = np.array(ready.gate), KAPPA * ready.spec.wavelength_m
    for way in range(len(ways)):
        loud = dark(ready, part, ways, way, unlit)
        if loud <= faint:
            continue
        seen = ways.view(way, view, min(loud / faint - 1, 1.0) if faint else 1.0)
        leaves, owner = grown(8192, (3, 3), lambda pieces, of, seen=seen: triangle.split(  # type: ignore[misc]
            part.spheres, part.first, part.corners, unlit, seen.origins, gate, fresnel, REACH, pieces, of))  # fmt: skip
        of = np.full(len(leaves), way)
        factor = heard(ready, parts, flats, view, ways, of, leaves.mean(1), part.stuffs[owner])
        free = np.flatnonzero(factor)
        if len(free):
            pieces, between = (leaves[free], owner[free]), (factor[free], np.zeros(len(free)))
            laid = lay_triangles(bare, part.normals, part.stuffs, pieces, between, seen, grids)
            out.append(replace(laid, via=ways.via[of[free]]))
    return out


def dark(ready: Bench, part: Surfaces, ways: Ways, way: int, out: NDArray[np.bool_]) -> float:
    """Tells which small triangles (f) one way cannot reach, and what all others return at the most."""
    own = slice(way, way + 1)
    return float(lit.meet_triangles(
        ways.images[own], ways.frames[own], ways.planes[own], ways.counts[own], ways.weights[own], ready.gate[1],
        part.spheres, part.first, part.corners, part.normals, part.backs.outward, part.backs.boxes, ready.table,
        ready.spec.antenna.kind == "isotropic", out, np.empty((7, 5))))  # fmt: skip


def _lay_strips(
    ready: Bench, parts: list[Surfaces], flats: Flats, view: View, ways: Ways, smooth: Longs, faint: float,
    grids: Complexes,
) -> list[Laid]:  # fmt: skip
    backs = parts[0].flat_backs
    if len(parts) > 1:
        backs = Backs(*(np.concatenate([getattr(p.flat_backs, row) for p in parts]) for row in ("outward", "boxes")))
    strips = met(ready, flats, backs, ways, smooth, faint)
    if not len(strips.on):
        return []
    faces = strips.faces
    limits, many, ends = np.array(ready.gate[1:]), np.arange(len(strips.on)), ways.ends[strips.of]
    rim = parted(len(many), len(faces.starts), lambda *room: edges.cut(
        many, faces.spheres, faces.normals, faces.offsets, faces.first, faces.starts, faces.ends, ends, limits,
        1e9, ready.pulse.omega, ready.whole_rims, *room))  # fmt: skip
    if not (len(rim.pieces) or len(rim.tips) or (rim.windings > 0.5).any()):
        return []

    def shaded(points: Floats, owner: NDArray[np.integer]) -> tuple[Complexes, Floats]:
        inward = faces.spheres[owner, :3] - points  # where walls stand on floors, mirror points lie on their very rims
        points = points + NUDGE_M * unit(inward)
        stuffs = flats.stuffs[strips.on[owner]]
        return heard(ready, parts, flats, view, ways, strips.of[owner], points, stuffs), np.zeros(len(points))

    plain = np.full(len(many), len(ready.gamma) - 1, np.int32)
    fields = np.repeat(view.fields[None], len(many), 0)
    _, _, _, table, flat, factor, *rest = common(ready, view, grids)
    told = (faces.normals, plain, ends, ways.frames[strips.of], fields, table, flat,
            factor * ways.weights[strips.of] * strips.shares, *rest)  # fmt: skip
    laid, owner = lay_parted(ready, faces, many, rim, limits, shaded, told)
    return [replace(laid, stuffs=flats.stuffs[strips.on[owner]], via=ways.via[strips.of[owner]])]


def met(ready: Bench, flats: Flats, backs: Backs, ways: Ways, smooth: Longs, faint: float) -> Strips:
    """Those of some faces that ways meet within the gate."""
    size = 512
    while True:
        of, on, shares = np.empty(size, np.int64), np.empty(size, np.int64), np.empty(size)
        count = lit.meet_faces(ways.images, ways.frames, ways.planes, ways.counts, ways.weights, ready.gate[1], faint,
                               smooth, flats.spheres, flats.normals, flats.offsets, backs.outward, backs.boxes,
                               flats.first, flats.starts, ready.table, ready.spec.antenna.kind == "isotropic",
                               ready.pulse.omega / C0, of, on, shares, np.empty((7, 5)))  # fmt: skip
        if count <= size:
            break
        size = int(1.2 * count)
    of, on, shares = of[:count], on[:count], shares[:count]
    sides = flats.first[on + 1] - flats.first[on]
    first = np.concatenate([np.zeros(1, np.int32), np.cumsum(sides, dtype=np.int32)])
    edge = np.arange(first[-1]) + np.repeat(flats.first[on] - first[:-1], sides)
    faces = Outlined(flats.normals[on], flats.offsets[on], flats.spheres[on], flats.across[on], first,
                     flats.starts[edge], flats.ends[edge])  # fmt: skip
    return Strips(of, on, shares, faces)


def heard(
    ready: Bench, parts: list[Surfaces], flats: Flats, view: View, ways: Ways, of: Longs, points: Floats,
    stuffs: NDArray[np.integer],
) -> Complexes:  # fmt: skip
    """What all reflections of ways (m) over points (m, 3) of objects (m) make of the wave; 0 where it is blocked.

    The antennas' patterns and the spread of the wave are not in it.
    """
    stops, free = reached(parts, flats, ways, of, points)
    out = np.zeros(len(points), complex)
    kernel.weigh(stops, np.flatnonzero(free), of, ways.faces, view.fields, flats.normals, flats.stuffs, flats.widths,
                 ready.spec.wavelength_m, ready.gamma, stuffs, out, np.empty((3, 3)),
                 np.empty((2, 3), complex))  # fmt: skip
    return out
