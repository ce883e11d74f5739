"""Add the echoes of paths over several flat faces.

A path of k bounces is reflected by k - 1 flat mirrors by geometrical optics. Physical optics then gives the echo of the
part of the last face that the beam lights, from its clipped outline, as for a single bounce. Corners, truncated
mirrors and rooms need no other rule. Every ordered sequence of faces is followed once. Delays are those of the image
method [AllenBerkley1979]. A mirror that does not cover its first Fresnel zone reflects only the part that it covers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ullage.arrays import Bools, Floats, Longs
from ullage.kernels import beams as kernel
from ullage.kernels import bounces
from ullage.kernels import outlines as draw
from ullage.kernels.edges import CutLimits, FaceOutlines
from ullage.kernels.facets import LitFaces, Transmission
from ullage.radar.context import AntennaPair, RadarFrame
from ullage.radar.echo_set import EchoSet
from ullage.radar.facets import PlanarPatches, Surfaces
from ullage.radar.mirrors import Beams
from ullage.radar.planar import accumulate_outline, cut_outlines
from ullage.radar.visibility import between
from ullage.radar.zones import shares, strengths

MIRRORS = 32
"""Greatest number of mirrors of a frame: those of the largest apparent size."""
FADE = 0.1
"""Mirrors and end faces fade in over this share of the size at which they are chosen, so that none appears at once."""
FAINT = 1e-3
"""Beams whose mirrors cover less of their Fresnel zones are left out; the weights of all are reduced by it."""
EXCESS_M = 0.5
"""Edges whose path exceeds the mirror path by more are left out [m]."""


def accumulate_bounces(frame: RadarFrame) -> list[EchoSet]:
    """Add the echoes of two bounces and more over flat faces to the delay grids."""
    antennas = frame.antennas
    if len(frame.planar) < 2:
        return []
    half = replace(antennas, factor=0.5 * antennas.factor)
    out: list[EchoSet] = []
    for radar, back in ((antennas, False),) if antennas.reversible else ((half, False), (half.swapped(), True)):
        beams = beams_of(frame, radar)
        if len(beams):
            echoes = _accumulate(frame, radar, beams)
            out.append(_reversed(echoes) if back else echoes)
    return out


def _reversed(echoes: EchoSet) -> EchoSet:
    """Reverse echoes traced from the receiver: the wave meets the face at the end first, then the mirrors."""
    if echoes.via is None:
        return echoes
    count = (echoes.via >= 0).sum(1)[:, None]
    place = np.arange(echoes.via.shape[1])
    via = np.take_along_axis(echoes.via, np.where(place < count, count - 1 - place, place), 1)
    return replace(echoes, via=via, before=np.zeros(len(via), np.int64))


def beams_of(frame: RadarFrame, antennas: AntennaPair) -> Beams:
    """Trace all beams of two bounces and more over the mirrors of the largest apparent sizes."""
    planar, gate_m = frame.planar, frame.context.gate[1]
    chosen = _chosen(planar, frame.sizes, gate_m, frame.context.spec.wavelength_m)
    return trace(planar, antennas, frame.max_bounces, gate_m, chosen)


@dataclass(frozen=True, slots=True, eq=False)
class Chosen:
    """Mirrors (convex parts) and faces where paths end, those of the largest apparent sizes."""

    mirrors: Longs  # (m)
    mirror_weights: Floats  # (c) of all convex parts, 0 where not chosen
    targets: Longs  # (t)
    target_weights: Floats  # (p) of all faces


def _chosen(planar: PlanarPatches, sizes: Floats, gate_m: float, wavelength_m: float) -> Chosen:
    """Choose the mirrors and end faces of the largest apparent sizes (p).

    The choice is made anew at each pose. The weight of a face rises from 0 as its size exceeds the largest one left
    out, so that nothing changes suddenly along a track. Whole faces are chosen: the convex parts of one with holes
    would take the places of other mirrors.
    """
    sizes = sizes * _wide(planar, np.sqrt(wavelength_m * gate_m / 2))
    faces, weights = choose_largest(sizes)
    mirror_weights = weights[planar.flat_of]
    return Chosen(np.flatnonzero(mirror_weights), mirror_weights, faces, weights)


@lru_cache(maxsize=8)
def _wide(planar: PlanarPatches, least_m: float) -> Bools:
    """Find the faces (p) that are no narrow facets of curved surfaces; `curves` adds the echoes of those."""
    return np.asarray(~(planar.smooth & (planar.widths.min(1, initial=np.inf) < least_m)))


def choose_largest(sizes: Floats, count: int | None = None) -> tuple[Longs, Floats]:
    """Choose the largest of some sizes (n), fewer than `count` (`MIRRORS`), and weigh all of them (n)."""
    which, weights = np.empty(len(sizes), np.int64), np.empty(len(sizes))
    made = kernel.largest(sizes, FADE, np.empty((MIRRORS if count is None else count) + 1), which, weights)
    return which[:made], weights


def trace(planar: PlanarPatches, antennas: AntennaPair, bounces_: int, gate_m: float, chosen: Chosen) -> Beams:
    """Trace all beams of two to `bounces_` bounces within the gate [m]."""
    rooms, over = [1024, 8192], max(bounces_ - 1, 2)
    mirrors = kernel.ConvexMirrors(chosen.mirrors, planar.mirrors, planar.sizes, planar.flat_of)
    faces = kernel.EndFaces(chosen.targets, planar.normals, planar.offsets, planar.spheres, planar.loop_of,
                            planar.loops, planar.starts)  # fmt: skip
    while True:
        out = kernel.BeamRows(np.empty((rooms[0], over, 3)), np.empty((rooms[0], over), np.int64),
                              np.empty(rooms[0], np.int64), np.zeros(rooms[0] + 1, np.int32),
                              np.empty((rooms[1], 2, 3)))  # fmt: skip
        made, used = kernel.trace(antennas.origins, bounces_, gate_m, mirrors, faces, out, kernel.scratch(over))
        if made <= rooms[0] and used <= rooms[1]:
            break
        rooms = [int(1.2 * made) + 64, int(1.2 * used) + 512]
    chain, on = out.chains[:made], out.ends_on[:made]
    there = chain >= 0
    weights = chosen.target_weights[on] * np.where(there, chosen.mirror_weights[chain], 1.0).prod(1)
    faces_ = np.where(there, planar.flat_of[chain], -1).astype(np.int64)
    weights[planar.smooth[on] + (planar.smooth[faces_] & there).sum(1) == 1] = 0
    return Beams(out.images[:made], faces_, on, out.first[: made + 1], out.edges[:used], weights)


def _accumulate(frame: RadarFrame, antennas: AntennaPair, beams: Beams) -> EchoSet:
    """Add the echoes of beams (b) to the delay grids."""
    context, planar = frame.context, frame.planar
    gate = np.array(context.gate[1:])
    on, starts, ends = beams.ends_on, np.ascontiguousarray(beams.edges[:, 0]), np.ascontiguousarray(beams.edges[:, 1])
    normals, offsets, spheres = planar.normals.take(on, 0), planar.offsets[on], planar.spheres.take(on, 0)
    many, origins = len(beams), _radars(antennas, beams)
    middles = np.empty((many, 3))
    bounces.middles(beams.first, beams.edges, middles)
    weights = beams.weights * _both_paths(planar, beams)
    bounces.cover(_through(planar, antennas, beams, middles), beams.chains, planar.normals, planar.widths,
                  context.spec.wavelength_m, np.empty(beams.chains.shape[1] + 1), weights)  # fmt: skip
    weights = np.maximum(weights - FAINT, 0)
    which = np.flatnonzero(weights)
    faces = FaceOutlines(spheres, normals, offsets, beams.first, starts, ends)
    follow = CutLimits(gate, EXCESS_M, context.pulse.omega, context.whole_outlines)
    outline = cut_outlines(which, faces, origins, antennas.aside, follow)
    points = np.empty((len(which), 9))
    count = draw.crossings(which, outline.windings, normals, offsets, origins, gate, points)
    points, which = points[:count], which[:count]
    lit = np.empty((many, 3))
    bounces.stand_ins(middles, outline, points, which, np.empty(many), np.empty(many, np.bool_), lit)
    owner = np.concatenate([outline.owner, outline.holders, which])
    path, factor = _through(planar, antennas, beams, lit), np.zeros(many, complex)
    factor[owner] = weights[owner] * antennas.factor  # most beams hold nothing that echoes
    imaged = bounces.Orientations(np.empty((many, 2, 3, 3)), np.empty((many, 2, 3)))
    bounces.reflect(
        path, beams.chains, on, context.mirrors(planar), bounces.Orientations(antennas.frames, antennas.fields), factor,
        imaged, bounces.ReflectScratch(np.empty((2, 3)), np.empty(3, complex)),
    )  # fmt: skip
    strong = strengths(context, planar, antennas, beams, path, factor)
    factor *= shares(context, planar, antennas, beams, path, strong, lambda *asked: clear(frame.parts, *asked))
    plain = np.full(many, len(context.gamma) - 1, np.int32)
    radars = context.antennas(antennas)._replace(
        origins=origins, frames=imaged.frames, fields=imaged.fields, factor=factor
    )
    between = Transmission((factor != 0).astype(complex)[owner], np.zeros(len(owner)))
    lit_faces = LitFaces(normals, plain, radars, context.reflection)
    echoes = accumulate_outline(frame, outline, points, which, between, lit_faces)
    via = np.where(beams.chains >= 0, planar.object_ids[beams.chains], -1)
    return replace(echoes, object_ids=planar.object_ids[on][owner], via=via[owner])


def _radars(antennas: AntennaPair, beams: Beams) -> Floats:
    """Return the radars (b, 2, 3) of beams: the transmitter's images, and the receiver [m]."""
    out = np.empty((len(beams), 2, 3))
    out[:, 0], out[:, 1] = beams.images, antennas.origins[1]
    return out


def _both_paths(planar: PlanarPatches, beams: Beams) -> Floats:
    """Return how often each beam (b) counts: 0, 1 or 2 times.

    By reciprocity a double bounce is the same wave with the mirror first or last, if the antennas change places. It
    counts twice with physical optics on the smaller face, and not at all with physical optics on the larger one.
    """
    mirror, end = planar.spheres[beams.chains[:, 0], 3], planar.spheres[beams.ends_on, 3]
    share = np.where(mirror > 1.2 * end, 2.0, np.where(end > 1.2 * mirror, 0.0, 1.0))
    return np.where(beams.chains[:, 1] >= 0, 1.0, share)


def _through(planar: PlanarPatches, antennas: AntennaPair, beams: Beams, lit: Floats) -> Floats:
    """Find the corners (b, d + 3, 3) of each beam's path from antenna to antenna over a point (b, 3) of its end."""
    path = np.empty((len(beams), beams.chains.shape[1] + 3, 3))
    bounces.legs(beams.paths, planar.normals, planar.offsets, antennas.origins, np.arange(len(beams)), lit, path)
    return path


def clear(parts: list[Surfaces], path: Floats, wanted: Floats) -> Bools:
    """Find which paths (b, d, 3) that are wanted (not 0) are free all along."""
    out = wanted != 0
    legs = len(path) * (path.shape[1] - 1)
    (starts, ends), owner = np.empty((2, legs, 3)), np.empty(legs, np.int64)
    count = bounces.stretches(path, wanted, starts, ends, owner)
    out[owner[:count][~between(parts, starts[:count], ends[:count])]] = False
    return np.asarray(out)
