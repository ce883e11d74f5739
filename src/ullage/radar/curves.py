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
from ullage.kernels import lit
from ullage.kernels import paths as kernel
from ullage.kernels.edges import CutLimits, Outline
from ullage.kernels.facets import LitFaces, Reflection, Transmission, TriangleClusters, TrianglePieces
from ullage.radar.context import RadarContext, RadarFrame, split
from ullage.radar.echo_set import EchoSet, centroids
from ullage.radar.facets import PlanarPatches, Surfaces
from ullage.radar.mirrors import unit
from ullage.radar.paths import PathSet, reached
from ullage.radar.planar import Outlined, Shading, accumulate_parted, cut_outlines, face_outlines
from ullage.radar.solids import Backs

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


@dataclass(frozen=True, slots=True, eq=False)
class Targets:
    """Points that ways lead to, one for each of (m) pairs."""

    of: Longs  # (m) way
    points: Floats  # (m, 3) [m], or those that `at` names
    object_ids: NDArray[np.integer]  # (m)
    at: Longs | None = None  # (m) row of the points


def accumulate_curves(frame: RadarFrame, paths: PathSet, peak: float) -> list[EchoSet]:
    """Adds the echoes of small triangles and of facets of curved surfaces over flat faces to the delay grids.

    Facets, and parts of their rims, that are too faint beside the path gain amplitude `peak` are left out.
    """
    if not len(paths):
        return []
    out: list[EchoSet] = []
    for part in frame.parts:
        if len(part.corners):
            out += _accumulate_small(frame, part, paths)
    if frame.planar.smooth.any():
        out += _accumulate_strips(frame, paths, peak)
    return out


@lru_cache(maxsize=8)
def _bare(context: RadarContext) -> Reflection:
    """Tables with everything reflecting 1, for paths whose coefficients are known otherwise."""
    count = len(context.gamma)
    return Reflection(context.gamma[-1:].repeat(count, axis=0), context.lag[-1:].repeat(count, axis=0))


@lru_cache(maxsize=8)
def _most(context: RadarContext) -> Floats:
    """The larger of both reflection coefficients of each object over cos(incidence)."""
    return np.ascontiguousarray(abs(context.bounce[:, 0]).max(1))


def _accumulate_small(frame: RadarFrame, part: Surfaces, paths: PathSet) -> list[EchoSet]:
    reach = lit_by(frame.context, part, paths)
    if not reach.any():
        return []
    leaves, owner = split(frame, part, np.asarray(~reach.any(0)), 2048)
    of, at = np.empty((2, len(paths) * len(owner)), np.int64)
    count = lit.pair_up(reach, owner, of, at)
    of, at = of[:count], at[:count]
    targets = Targets(of, centroids(leaves), part.object_ids[owner[at]], at)
    factor = heard(frame, paths, targets)
    free = np.flatnonzero(factor)
    if not len(free):
        return []
    of, at = of[free], at[free]
    pieces, between = TrianglePieces(leaves.take(at, 0), owner[at], of), Transmission(factor[free], np.zeros(len(free)))
    seen = LitFaces(part.normals, part.object_ids, paths.antennas(frame.radar), _bare(frame.context))
    return [paths.with_paths(frame.accumulate_triangles(pieces, seen, between), of)]


def lit_by(context: RadarContext, part: Surfaces, paths: PathSet) -> Bools:
    """Which small triangles each way can reach (n, f), if nothing stands between."""
    out = np.zeros((len(paths), len(part.corners)), np.bool_)
    inside = part.backs.inside(paths.images[:1, :, 0].reshape(-1, 3))
    clusters = TriangleClusters(part.spheres, part.first, part.corners)
    sides = lit.FaceSides(part.backs.outward, inside)
    lit.meet_triangles(paths.mirrors, context.gate[1], clusters, part.normals, sides, out)
    return out


def audible(context: RadarContext, loud: Floats, paths: Floats, rest: float) -> Bools:
    """Which of some echoes (n) of amplitudes `loud` at mean ranges `paths` [m] count.

    All the others within a pulse's length make, with phases at random, at most a path gain amplitude of `rest`, and
    none of them makes more than its `MANY`th.
    """
    if rest <= 0:
        return np.asarray(loud != 0)
    long, out = 2 * context.pulse.half_m, np.empty(len(loud), np.bool_)
    sums = np.zeros((int(paths.max(initial=0.0) / long) + 1, _LEVELS + 1))
    lit.sift(loud, paths, long, rest, rest / MANY, sums, out)
    return out


def _accumulate_strips(frame: RadarFrame, paths: PathSet, peak: float) -> list[EchoSet]:
    context, parts, planar = frame.context, frame.parts, frame.planar
    backs = parts[0].flat_backs
    if len(parts) > 1:
        backs = Backs.joined([part.flat_backs for part in parts])
    strips = met(context, planar, backs, paths, peak)
    if not len(strips.on):
        return []
    faces = strips.faces
    limits, many, ends = np.array(context.gate[1:]), np.arange(len(strips.on)), paths.ends[strips.of]
    follow = CutLimits(limits, 1e9, context.pulse.omega, context.whole_outlines)
    outline = cut_outlines(many, face_outlines(faces), ends, frame.antennas.aside, follow)
    if not (len(outline.pieces) or len(outline.tips) or (outline.windings > 0.5).any()):
        return []

    loud = outlines_heard(context, outline, strips.gains, REST * peak)

    def shaded(points: Floats, owner: NDArray[np.integer]) -> tuple[Complexes, Floats]:
        out = np.zeros(len(points), complex)
        wanted = np.concatenate([np.flatnonzero(loud), np.arange(len(loud), len(points))])
        points, owner = points.take(wanted, 0), owner[wanted]
        inward = faces.spheres[owner, :3] - points  # where walls stand on floors, mirror points lie on their very rims
        points = points + NUDGE_M * unit(inward)
        object_ids = planar.object_ids[strips.on[owner]]
        targets = Targets(strips.of[owner], points, object_ids)
        out[wanted] = heard(frame, paths, targets)
        return out, np.zeros(len(out))

    plain = np.full(len(many), len(context.gamma) - 1, np.int32)
    seen = LitFaces(faces.normals, plain, paths.antennas(frame.radar, strips.of), context.reflection)
    echoes, owner = accumulate_parted(frame, faces, many, outline, limits, Shading(shaded), seen)
    return [paths.with_paths(replace(echoes, object_ids=planar.object_ids[strips.on[owner]]), strips.of[owner])]


def outlines_heard(context: RadarContext, outline: Outline, gains: Floats, rest: float) -> Bools:
    """Which pieces of rims and which ends without one count, of faces (k) with so much gain."""
    louds, lengths = np.empty((2, len(outline.pieces) + len(outline.tips)))
    count = lit.outline_louds(outline, gains, context.spec.wavelength_m / (16 * np.pi**2), louds, lengths)
    return audible(context, louds[:count], lengths[:count], rest)


def met(context: RadarContext, planar: PlanarPatches, backs: Backs, paths: PathSet, peak: float) -> Strips:
    """Those of the facets of curved surfaces that ways meet within the gate, but for what is too faint."""
    smooth = np.flatnonzero(planar.smooth)
    size, inside = min(len(paths) * len(smooth), 8192), backs.inside(paths.images[:1, :, 0].reshape(-1, 3))
    turned, outlined = lit.FaceSides(backs.outward, inside), face_outlines(planar)
    bounds = lit.EchoBounds(context.gate[1], context.pulse.omega / C0, context.magnitudes,
                            context.spec.antenna.kind == "isotropic", _most(context), planar.object_ids)  # fmt: skip
    scratch = lit.BoundScratch(np.empty((3, 3)), np.empty((3, 3)), np.empty(6))
    while True:
        of, on = np.empty(size, np.int64), np.empty(size, np.int64)
        gains, louds, lengths = np.empty((3, size))
        found = lit.MetFaces(of, on, gains, louds, lengths)
        count = lit.meet_faces(paths.mirrors, smooth, outlined, turned, bounds, found, scratch)
        if count <= size:
            break
        size = int(1.2 * count)
    loud = np.flatnonzero(audible(context, louds[:count], lengths[:count], FACETS * peak))
    of, on, gains = of[loud], on[loud], gains[loud]
    sides = planar.first[on + 1] - planar.first[on]
    first = np.concatenate([np.zeros(1, np.int32), np.cumsum(sides, dtype=np.int32)])
    edge = np.arange(first[-1]) + np.repeat(planar.first[on] - first[:-1], sides)
    faces = Outlined(
        planar.normals.take(on, 0),
        planar.offsets[on],
        planar.spheres.take(on, 0),
        planar.across.take(on, 0),
        first,
        planar.starts.take(edge, 0),
        planar.ends.take(edge, 0),
    )
    return Strips(of, on, gains, faces)


def heard(frame: RadarFrame, paths: PathSet, targets: Targets) -> Complexes:
    """What all reflections of ways over points of objects make of the wave (m); 0 where it is blocked.

    The antennas' patterns and the spread of the wave are not in it.
    """
    known = reached(frame, paths, targets.of, targets.points, targets.at)
    out = np.zeros(len(targets.of), complex)
    pairs = kernel.Weighed(known.stops, known.rows, np.flatnonzero(known.free), targets.of, targets.object_ids)
    scratch = kernel.FieldScratch(np.empty((3, 3)), np.empty((2, 3), complex))
    kernel.weigh(pairs, paths.faces, frame.antennas.fields, frame.context.mirrors(frame.planar), scratch, out)
    return out
