"""Echoes over several surfaces: mirror images of the radar, beams clipped by every mirror, physical optics at the end.

A path of k bounces goes over k - 1 flat mirrors by geometrical optics; the part of the last face that the beam lights
is done by its clipped rim, as in single bounce, so corners, truncated mirrors and rooms come out of one rule.
Every ordered sequence of faces is followed once; delays are those of the image method [AllenBerkley1979].
A mirror that does not cover its Fresnel zone passes on only the part that it covers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ullage.arrays import Bools, Complexes, Floats, Longs
from ullage.kernels import beams as kernel
from ullage.kernels import bounces
from ullage.kernels import outlines as draw
from ullage.kernels.edges import CutLimits, FaceOutlines
from ullage.kernels.facets import LitFaces, Transmission
from ullage.radar.context import AntennaPair, RadarContext
from ullage.radar.echo_set import EchoSet
from ullage.radar.facets import PlanarPatches, Surfaces
from ullage.radar.mirrors import Beams, mirrored
from ullage.radar.planar import accumulate_outline, cut_outlines
from ullage.radar.visibility import between
from ullage.radar.zones import shares, strengths

MIRRORS = 32
"""At most so many mirrors are used, those that look largest from the radar."""
FADE = 0.1
"""Mirrors and end faces fade in over this share of the size at which they are taken, so that none comes at a stroke."""
FAINT = 1e-3
"""Beams over mirrors that cover less of their Fresnel zones than this are left out; all are less by as much."""
EXCESS_M = 0.5
"""Rims whose path exceeds the mirror path by more are left out [m]."""


def accumulate_bounces(
    context: RadarContext,
    parts: list[Surfaces],
    planar: PlanarPatches,
    antennas: AntennaPair,
    max_bounces: int,
    look: Floats,
    grids: Complexes,
) -> list[EchoSet]:
    """Adds the echoes of two and three bounces between flat faces, which look so large (p), to the delay grids.

    Mirrors come before the face that is integrated over. Antennas apart each send half: what one sends over a mirror
    and a face comes, by reciprocity, also over the face and then the mirror.
    """
    if len(planar) < 2:
        return []
    if antennas.monostatic:
        return _traced(context, parts, planar, antennas, max_bounces, look, grids)
    half = replace(antennas, factor=0.5 * antennas.factor)
    return [*_traced(context, parts, planar, half, max_bounces, look, grids),
            *map(_turned, _traced(context, parts, planar, half.swapped(), max_bounces, look, grids))]  # fmt: skip


def _turned(echoes: EchoSet) -> EchoSet:
    """Echoes traced from the receiver, as the wave runs: it meets the face at the end first, then the mirrors."""
    if echoes.via is None:
        return echoes
    via = np.where(echoes.via[:, 1:] >= 0, echoes.via[:, ::-1], echoes.via)
    return replace(echoes, via=via, before=np.zeros(len(via), np.int64))


def _traced(
    context: RadarContext,
    parts: list[Surfaces],
    planar: PlanarPatches,
    antennas: AntennaPair,
    max_bounces: int,
    look: Floats,
    grids: Complexes,
) -> list[EchoSet]:
    beams = beams_of(context, planar, antennas, max_bounces, look)
    return _accumulate(context, parts, planar, antennas, beams, grids) if len(beams) else []


def beams_of(
    context: RadarContext, planar: PlanarPatches, antennas: AntennaPair, max_bounces: int, look: Floats
) -> Beams:
    """All beams of two bounces up to as many as told, over the mirrors that look largest (p) from one pose."""
    chosen = _chosen(planar, look, context.gate[1], context.spec.wavelength_m)
    return trace(planar, antennas, max_bounces, context.gate[1], chosen)


@dataclass(frozen=True, slots=True, eq=False)
class Chosen:
    """Mirrors (convex parts) and faces where paths end, of all there are those that look largest."""

    mirrors: Longs  # (m)
    mirror_weights: Floats  # (c) of all convex parts, 0 where not chosen
    targets: Longs  # (t)
    target_weights: Floats  # (p) of all faces


def _chosen(planar: PlanarPatches, look: Floats, gate_m: float, wavelength_m: float) -> Chosen:
    """The mirrors and end faces to use: those that look largest, less what they lack of a Fresnel zone.

    Each has a weight that rises from 0 as it comes to look larger than the largest one left out, so that the choice,
    made anew at each pose, changes nothing suddenly along a track.
    """
    look = look * _wide(planar, np.sqrt(wavelength_m * gate_m / 2))
    mirrors, mirror_weights = most_looked(look[planar.flat_of])
    return Chosen(mirrors, mirror_weights, *most_looked(look))


@lru_cache(maxsize=8)
def _wide(planar: PlanarPatches, least_m: float) -> Bools:
    """Which faces (p) are no narrow facets of curved surfaces: those are done by `curves`, with one bounce at them."""
    return np.asarray(~(planar.smooth & (planar.widths.min(1, initial=np.inf) < least_m)))


def looks(context: RadarContext, planar: PlanarPatches, antennas: AntennaPair) -> Floats:
    """How large each face (p) looks from the antenna nearer to it, less what it lacks of a zone; 0 beyond the gate."""
    origins = antennas.origins[:1] if antennas.monostatic else antennas.origins
    out = np.empty(len(planar))
    kernel.looks(planar.spheres, planar.widths, origins, context.gate[1], context.spec.wavelength_m, out)
    return out


def most_looked(look: Floats, count: int | None = None) -> tuple[Longs, Floats]:
    """Which of all (n) look largest, `MIRRORS` or so many, and what each of all counts."""
    which, weights = np.empty(len(look), np.int64), np.empty(len(look))
    made = kernel.largest(look, FADE, np.empty((MIRRORS if count is None else count) + 1), which, weights)
    return which[:made], weights


def trace(planar: PlanarPatches, antennas: AntennaPair, bounces_: int, gate_m: float, chosen: Chosen) -> Beams:
    """All beams of two bounces up to as many as told within the gate."""
    rooms = [1024, 8192]
    mirrors = kernel.ConvexMirrors(chosen.mirrors, planar.mirrors, planar.sizes, planar.flat_of)
    faces = kernel.EndFaces(chosen.targets, planar.normals, planar.offsets, planar.spheres, planar.loop_of,
                            planar.loops, planar.starts)  # fmt: skip
    while True:
        out = kernel.BeamRows(np.empty((rooms[0], 3)), np.empty((rooms[0], 2), np.int64), np.empty(rooms[0], np.int64),
                              np.zeros(rooms[0] + 1, np.int32), np.empty((rooms[1], 2, 3)))  # fmt: skip
        made, used = kernel.trace(antennas.origins, bounces_, gate_m, mirrors, faces, out, kernel.scratch())
        if made <= rooms[0] and used <= rooms[1]:
            break
        rooms = [int(1.2 * made) + 64, int(1.2 * used) + 512]
    chain, on = out.chains[:made], out.ends_on[:made]
    weights = chosen.target_weights[on] * chosen.mirror_weights[chain[:, 0]]
    double = chain[:, 1] >= 0
    weights[double] *= chosen.mirror_weights[chain[double, 1]]
    over = np.where(chain >= 0, planar.flat_of[chain], -1).astype(np.int64)
    curved = planar.smooth.view(np.int8)
    weights[curved[on] + curved[over[:, 0]] + curved[over[:, 1]] * double == 1] = 0
    firsts = mirrored(antennas.origins[0], planar, over[:, 0]) if made else np.zeros((0, 3))
    return Beams(out.apexes[:made], firsts, over, on, out.first[: made + 1], out.edges[:used], weights)


def _accumulate(
    context: RadarContext,
    parts: list[Surfaces],
    planar: PlanarPatches,
    antennas: AntennaPair,
    beams: Beams,
    grids: Complexes,
) -> list[EchoSet]:
    gate = np.array(context.gate[1:])
    on, starts, ends = beams.ends_on, np.ascontiguousarray(beams.edges[:, 0]), np.ascontiguousarray(beams.edges[:, 1])
    normals, offsets, spheres = planar.normals.take(on, 0), planar.offsets[on], planar.spheres.take(on, 0)
    many, origins = len(beams), _radars(antennas, beams)
    middles = np.empty((many, 3))
    bounces.middles(beams.first, beams.edges, middles)
    weights = beams.weights * _both_paths(planar, beams)
    bounces.cover(_through(planar, antennas, beams, middles), beams.chains, planar.normals, planar.widths,
                  context.spec.wavelength_m, np.empty(3), weights)  # fmt: skip
    weights = np.maximum(weights - FAINT, 0)
    which = np.flatnonzero(weights)
    faces = FaceOutlines(spheres, normals, offsets, beams.first, starts, ends)
    follow = CutLimits(gate, EXCESS_M, context.pulse.omega, context.whole_outlines)
    outline = cut_outlines(which, faces, origins, antennas.aside, follow)
    points = np.empty((len(which), 9))
    count = draw.crossings(which, outline.windings, normals, offsets, origins, gate, points)
    points, which = points[:count], which[:count]
    lit = np.empty((many, 3))
    cut = bounces.EdgeParts(outline.pieces, outline.owner, outline.tips, outline.holders)
    bounces.stand_ins(middles, cut, points, which, np.empty(many), np.empty(many, np.bool_), lit)
    owner = np.concatenate([outline.owner, outline.holders, which])
    path, factor = _through(planar, antennas, beams, lit), np.zeros(many, complex)
    factor[owner] = weights[owner] * antennas.factor  # most beams hold nothing that echoes
    imaged = bounces.Orientations(np.empty((many, 2, 3, 3)), np.empty((many, 2, 3)))
    bounces.reflect(
        path, beams.chains, on, context.mirrors(planar), bounces.Orientations(antennas.frames, antennas.fields), factor,
        imaged, bounces.ReflectScratch(np.empty((3, 3)), np.empty(3, complex)),
    )  # fmt: skip
    strong = strengths(context, planar, antennas, beams, path, factor)
    factor *= shares(context, planar, antennas, beams, path, strong, lambda *asked: clear(parts, *asked))
    plain = np.full(many, len(context.gamma) - 1, np.int32)
    radars = context.antennas(antennas)._replace(
        origins=origins, frames=imaged.frames, fields=imaged.fields, factor=factor
    )
    between = Transmission((factor != 0).astype(complex)[owner], np.zeros(len(owner)))
    lit_faces = LitFaces(normals, plain, radars, context.reflection)
    echoes = accumulate_outline(outline, points, which, between, lit_faces, context.pulse_grid, grids)
    via = np.where(beams.chains >= 0, planar.object_ids[beams.chains], -1)
    return [replace(echoes, object_ids=planar.object_ids[on][owner], via=via[owner])]


def _radars(antennas: AntennaPair, beams: Beams) -> Floats:
    """The radars (b, 2, 3) of beams: the transmitter's images, and the receiver [m]."""
    out = np.empty((len(beams), 2, 3))
    out[:, 0], out[:, 1] = beams.images, antennas.origins[1]
    return out


def _both_paths(planar: PlanarPatches, beams: Beams) -> Floats:
    """How often each beam counts: a small face is no mirror, so its double bounces count twice from the large one.

    Mirror first or last is the same wave by reciprocity, if the antennas change places; physical optics belongs on the
    smaller face.
    """
    mirror, end = planar.spheres[beams.chains[:, 0], 3], planar.spheres[beams.ends_on, 3]
    share = np.where(mirror > 1.2 * end, 2.0, np.where(end > 1.2 * mirror, 0.0, 1.0))
    return np.where(beams.chains[:, 1] >= 0, 1.0, share)


def _through(planar: PlanarPatches, antennas: AntennaPair, beams: Beams, lit: Floats) -> Floats:
    """Corners (b, 5, 3) of each beam's path from transmitter to receiver over a point (b, 3) of its end."""
    path = np.empty((len(beams), 5, 3))
    bounces.legs(beams.paths, planar.normals, planar.offsets, antennas.origins, np.arange(len(beams)), lit, path)
    return path


def clear(parts: list[Surfaces], path: Floats, wanted: Floats) -> Bools:
    """Whether each path (b, 5, 3) that is wanted (not 0) is free on all its legs."""
    out = wanted != 0
    starts, ends = np.empty((2, 4 * len(path), 3))
    owner = np.empty(4 * len(path), np.int64)
    count = bounces.stretches(path, wanted, starts, ends, owner)
    out[owner[:count][~between(parts, starts[:count], ends[:count])]] = False
    return np.asarray(out)


def image_lengths(context: RadarContext, antennas: AntennaPair, order: int) -> Floats:
    """Path lengths there and back [m] of every mirror path of one order between flat faces, shadows aside."""
    planar = context.world.still.planar
    gate = np.array(context.gate[1:])
    if order == 1:
        on = np.arange(len(planar), dtype=np.int64)
        asked = np.ones(len(on), np.bool_)
        first, starts, ends = planar.first, planar.starts, planar.ends
        origins = antennas.origins[None]
    else:
        beams = beams_of(context, planar, antennas, order, looks(context, planar, antennas))
        on, first = beams.ends_on, beams.first
        asked = (beams.chains[:, 1] >= 0) == (order == 3)
        starts, ends = np.ascontiguousarray(beams.edges[:, 0]), np.ascontiguousarray(beams.edges[:, 1])
        origins = _radars(antennas, beams)
    normals, offsets, spheres = planar.normals[on], planar.offsets[on], planar.spheres[on]
    which = np.flatnonzero(asked)
    faces = FaceOutlines(spheres, normals, offsets, first, starts, ends)
    follow = CutLimits(gate, EXCESS_M, context.pulse.omega, False)
    outline = cut_outlines(which, faces, origins, antennas.aside, follow)
    points = np.empty((len(which), 9))
    count = draw.crossings(which, outline.windings, normals, offsets, origins, gate, points)
    return np.sort(points[:count, 3])
