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

from ullage.arrays import Bools, Complexes, Floats, Longs
from ullage.geometry import C0
from ullage.kernels import edges, lit
from ullage.kernels import facets as triangle
from ullage.kernels import ways as kernel
from ullage.radar.context import KAPPA, REACH, Bench, View, common, grown, lay_triangles
from ullage.radar.facets import Flats, Surfaces
from ullage.radar.flats import Outlined, Rim, lay_parted, parted
from ullage.radar.laid import Laid, centroids
from ullage.radar.mirrors import unit
from ullage.radar.solids import Backs
from ullage.radar.ways import Ways, reached

NUDGE_M = 5e-3
"""Points of facets are looked at so far within their rims [m]."""
FACETS = 1.5e-2
"""What facets that are left out would make within a pulse's length at the most, with phases at random, is no more than
this of a frame's strongest echo. What they make turns out to be far less: most are hidden, or cancel."""
REST = 4e-3
"""So much for parts of the rims of the facets that are left."""
MANY = 25.0
"""So many would have to be in phase to make that: one that makes more than so small a share is not left out."""
_LEVELS = 40  # loudness in steps of 3 dB


@dataclass(frozen=True, slots=True, eq=False)
class Strips:
    """Facets as ways meet them, one for each way and facet: what their rims are done by."""

    of: Longs  # (m) way
    on: Longs  # (m) face
    gains: Floats  # (m) the antennas' gains there, times what the way counts
    faces: Outlined  # (m)


def lay_curves(
    ready: Bench, parts: list[Surfaces], flats: Flats, view: View, ways: Ways, peak: float, grids: Complexes
) -> list[Laid]:
    """Adds the echoes of small triangles and of facets of curved surfaces over flat faces to the delay grids.

    Facets, and parts of their rims, that are too faint beside the path gain amplitude `peak` are left out.
    """
    if not len(ways):
        return []
    out: list[Laid] = []
    for part in parts:
        if len(part.corners):
            out += _lay_small(ready, parts, part, flats, view, ways, grids)
    smooth = np.flatnonzero(flats.smooth)
    if len(smooth):
        out += _lay_strips(ready, parts, flats, view, ways, smooth, peak, grids)
    return out


@lru_cache(maxsize=8)
def _bare(ready: Bench) -> Bench:
    """The bench with everything reflecting 1, for paths whose coefficients are known otherwise."""
    count = len(ready.gamma)
    return replace(ready, gamma=ready.gamma[-1:].repeat(count, axis=0), lag=ready.lag[-1:].repeat(count, axis=0))


@lru_cache(maxsize=8)
def _most(ready: Bench) -> Floats:
    """The larger of both reflection coefficients of each object over cos(incidence)."""
    return np.ascontiguousarray(abs(ready.gamma[:, 0]).max(1))


def _lay_small(
    ready: Bench, parts: list[Surfaces], part: Surfaces, flats: Flats, view: View, ways: Ways, grids: Complexes
) -> list[Laid]:
    reach = lit_by(ready, part, ways)
    if not reach.any():
        return []
    gate, fresnel = np.array(ready.gate), KAPPA * ready.spec.wavelength_m
    dark = ~reach.any(0)
    leaves, owner = grown(2048, (3, 3), lambda pieces, of: triangle.split(
        part.spheres, part.first, part.corners, dark, view.origins, gate, fresnel, REACH, pieces, of,
        np.empty((96, 3, 3))))  # fmt: skip
    of, at = np.empty((2, len(ways) * len(owner)), np.int64)
    count = lit.pair_up(reach, owner, of, at)
    of, at = of[:count], at[:count]
    factor = heard(ready, parts, flats, view, ways, of, centroids(leaves), part.stuffs[owner[at]], at)
    free = np.flatnonzero(factor)
    if not len(free):
        return []
    of, at = of[free], at[free]
    pieces, between = (leaves.take(at, 0), owner[at], of), (factor[free], np.zeros(len(free)))
    told = ways.end(view, common(_bare(ready), view, grids))
    return [ways.told(lay_triangles(part.normals, part.stuffs, pieces, between, told), of)]


def lit_by(ready: Bench, part: Surfaces, ways: Ways) -> Bools:
    """Which small triangles each way can reach (n, f), if nothing stands between."""
    out = np.zeros((len(ways), len(part.corners)), np.bool_)
    inside = part.backs.inside(ways.images[:1, :, 0].reshape(-1, 3))
    lit.meet_triangles(ways.images, ways.planes, ways.counts, ready.gate[1], part.spheres, part.first, part.corners,
                       part.normals, part.backs.outward, inside, out)  # fmt: skip
    return out


def audible(ready: Bench, loud: Floats, paths: Floats, rest: float) -> Bools:
    """Which of some echoes (n) of amplitudes `loud` at mean ranges `paths` [m] count.

    All the others within a pulse's length make, with phases at random, at most a path gain amplitude of `rest`, and
    none of them makes more than its `MANY`th.
    """
    if rest <= 0:
        return np.asarray(loud != 0)
    long, out = 2 * ready.pulse.half_m, np.empty(len(loud), np.bool_)
    sums = np.zeros((int(paths.max(initial=0.0) / long) + 1, _LEVELS + 1))
    lit.sift(loud, paths, long, rest, rest / MANY, sums, out)
    return out


def _lay_strips(
    ready: Bench, parts: list[Surfaces], flats: Flats, view: View, ways: Ways, smooth: Longs, peak: float,
    grids: Complexes,
) -> list[Laid]:  # fmt: skip
    backs = parts[0].flat_backs
    if len(parts) > 1:
        backs = Backs.joined([part.flat_backs for part in parts])
    strips = met(ready, flats, backs, ways, smooth, peak)
    if not len(strips.on):
        return []
    faces = strips.faces
    limits, many, ends = np.array(ready.gate[1:]), np.arange(len(strips.on)), ways.ends[strips.of]
    rim = parted(len(many), len(faces.starts), lambda *room: edges.cut(
        many, faces.spheres, faces.normals, faces.offsets, faces.first, faces.starts, faces.ends, ends,
        view.aside, limits, 1e9, ready.pulse.omega, ready.whole_rims, *room))  # fmt: skip
    if not (len(rim.pieces) or len(rim.tips) or (rim.windings > 0.5).any()):
        return []

    loud = rims_heard(ready, rim, strips.gains, REST * peak)

    def shaded(points: Floats, owner: NDArray[np.integer]) -> tuple[Complexes, Floats]:
        out = np.zeros(len(points), complex)
        wanted = np.concatenate([np.flatnonzero(loud), np.arange(len(loud), len(points))])
        points, owner = points.take(wanted, 0), owner[wanted]
        inward = faces.spheres[owner, :3] - points  # where walls stand on floors, mirror points lie on their very rims
        points = points + NUDGE_M * unit(inward)
        stuffs = flats.stuffs[strips.on[owner]]
        out[wanted] = heard(ready, parts, flats, view, ways, strips.of[owner], points, stuffs)
        return out, np.zeros(len(out))

    plain = np.full(len(many), len(ready.gamma) - 1, np.int32)
    told = faces.normals, plain, *ways.end(view, common(ready, view, grids), strips.of)
    laid, owner = lay_parted(ready, faces, many, rim, limits, shaded, told)
    return [ways.told(replace(laid, stuffs=flats.stuffs[strips.on[owner]]), strips.of[owner])]


def rims_heard(ready: Bench, rim: Rim, gains: Floats, rest: float) -> Bools:
    """Which pieces of rims and which ends without one count, of faces (k) with so much gain."""
    louds, paths = np.empty((2, len(rim.pieces) + len(rim.tips)))
    count = lit.rim_louds(rim.pieces, rim.owner, rim.tips, rim.holders, rim.ties, gains,
                          ready.spec.wavelength_m / (16 * np.pi**2), louds, paths)  # fmt: skip
    return audible(ready, louds[:count], paths[:count], rest)


def met(ready: Bench, flats: Flats, backs: Backs, ways: Ways, smooth: Longs, peak: float) -> Strips:
    """Those of some faces that ways meet within the gate, but for what is too faint."""
    size, inside = min(len(ways) * len(smooth), 8192), backs.inside(ways.images[:1, :, 0].reshape(-1, 3))
    while True:
        of, on = np.empty(size, np.int64), np.empty(size, np.int64)
        gains, louds, paths = np.empty((3, size))
        count = lit.meet_faces(ways.images, ways.frames, ways.faces, ways.planes, ways.counts, ways.weights,
                               ready.gate[1], smooth, flats.spheres, flats.normals, flats.offsets, flats.stuffs,
                               backs.outward, inside, flats.first, flats.starts, ready.table,
                               ready.spec.antenna.kind == "isotropic", _most(ready), ready.pulse.omega / C0, of, on,
                               gains, louds, paths, np.empty((7, 6)))  # fmt: skip
        if count <= size:
            break
        size = int(1.2 * count)
    loud = np.flatnonzero(audible(ready, louds[:count], paths[:count], FACETS * peak))
    of, on, gains = of[loud], on[loud], gains[loud]
    sides = flats.first[on + 1] - flats.first[on]
    first = np.concatenate([np.zeros(1, np.int32), np.cumsum(sides, dtype=np.int32)])
    edge = np.arange(first[-1]) + np.repeat(flats.first[on] - first[:-1], sides)
    faces = Outlined(flats.normals.take(on, 0), flats.offsets[on], flats.spheres.take(on, 0), flats.across.take(on, 0),
                     first, flats.starts.take(edge, 0), flats.ends.take(edge, 0))  # fmt: skip
    return Strips(of, on, gains, faces)


def heard(
    ready: Bench, parts: list[Surfaces], flats: Flats, view: View, ways: Ways, of: Longs, points: Floats,
    stuffs: NDArray[np.integer], at: Longs | None = None,
) -> Complexes:  # fmt: skip
    """What all reflections of ways (m) over points of objects (m) make of the wave; 0 where it is blocked.

    The points (m, 3) [m] are those of each, or those that `at` (m) names.
    The antennas' patterns and the spread of the wave are not in it.
    """
    known = reached(parts, flats, ways, of, points, at)
    out = np.zeros(len(of), complex)
    kernel.weigh(known.stops, known.rows, np.flatnonzero(known.free), of, ways.faces, view.fields, flats.normals,
                 flats.stuffs, flats.widths, ready.spec.wavelength_m, ready.gamma, stuffs, out, np.empty((3, 3)),
                 np.empty((2, 3), complex))  # fmt: skip
    return out
