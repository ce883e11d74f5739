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

from ullage.arrays import Bools, Complexes, Floats, Ints, Longs
from ullage.kernels import beams as kernel
from ullage.kernels import bounces, edges
from ullage.kernels import rims as draw
from ullage.radar.context import Bench, View, common
from ullage.radar.facets import Flats, Surfaces
from ullage.radar.flats import lay_rim, parted
from ullage.radar.laid import Laid
from ullage.radar.mirrors import mirrored
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


@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """Bundles of paths, each over its one or two mirrors to the lit part of its last face."""

    images: Floats  # (b, 3) the transmitter's last image [m]
    firsts: Floats  # (b, 3) its first image [m]
    chains: Longs  # (b, 2) flat faces that mirror, -1 for none
    ends_on: Longs  # (b) face at the end
    first: Ints  # (b + 1) first edge of each
    edges: Floats  # (e, 2, 3) outlines of the lit parts [m]
    weights: Floats  # (b) how much of each counts

    def __len__(self) -> int:
        return len(self.ends_on)


def lay_bounces(
    ready: Bench, parts: list[Surfaces], flats: Flats, view: View, max_bounces: int, look: Floats, grids: Complexes
) -> list[Laid]:
    """Adds the echoes of two and three bounces between flat faces, which look so large (p), to the delay grids.

    Mirrors come before the face that is integrated over. Antennas apart each send half: what one sends over a mirror
    and a face comes, by reciprocity, also over the face and then the mirror.
    """
    if len(flats) < 2:
        return []
    if (view.origins[0] == view.origins[1]).all():
        return _traced(ready, parts, flats, view, max_bounces, look, grids)
    half = replace(view, factor=0.5 * view.factor)
    back = replace(half, **{row: getattr(view, row)[::-1].copy() for row in ("origins", "frames", "fields")})
    return [*_traced(ready, parts, flats, half, max_bounces, look, grids),
            *map(_turned, _traced(ready, parts, flats, back, max_bounces, look, grids))]  # fmt: skip


def _turned(laid: Laid) -> Laid:
    """Echoes traced from the receiver, as the wave runs: it meets the face at the end first, then the mirrors."""
    if laid.via is None:
        return laid
    via = np.where(laid.via[:, 1:] >= 0, laid.via[:, ::-1], laid.via)
    return replace(laid, via=via, before=np.zeros(len(via), np.int64))


def _traced(
    ready: Bench, parts: list[Surfaces], flats: Flats, view: View, max_bounces: int, look: Floats, grids: Complexes
) -> list[Laid]:
    beams = beams_of(ready, flats, view, max_bounces, look)
    return _lay(ready, parts, flats, view, beams, grids) if len(beams) else []


def beams_of(ready: Bench, flats: Flats, view: View, max_bounces: int, look: Floats) -> Beams:
    """All beams of two bounces up to as many as told, over the mirrors that look largest (p) from one pose."""
    chosen = _chosen(flats, look, ready.gate[1], ready.spec.wavelength_m)
    return trace(flats, view, max_bounces, ready.gate[1], chosen)


@dataclass(frozen=True, slots=True, eq=False)
class Chosen:
    """Mirrors (convex parts) and faces where paths end, of all there are those that look largest."""

    mirrors: Longs  # (m)
    mirror_weights: Floats  # (c) of all convex parts, 0 where not chosen
    targets: Longs  # (t)
    target_weights: Floats  # (p) of all faces


def _chosen(flats: Flats, look: Floats, gate_m: float, wavelength_m: float) -> Chosen:
    """The mirrors and end faces to use: those that look largest, less what they lack of a Fresnel zone.

    Each has a weight that rises from 0 as it comes to look larger than the largest one left out, so that the choice,
    made anew at each pose, changes nothing suddenly along a track.
    """
    look = look * _wide(flats, np.sqrt(wavelength_m * gate_m / 2))
    mirrors, mirror_weights = most_looked(look[flats.flat_of])
    return Chosen(mirrors, mirror_weights, *most_looked(look))


@lru_cache(maxsize=8)
def _wide(flats: Flats, least_m: float) -> Bools:
    """Which faces (p) are no narrow facets of curved surfaces: those are done by `curves`, with one bounce at them."""
    return np.asarray(~(flats.smooth & (flats.widths.min(1, initial=np.inf) < least_m)))


def looks(ready: Bench, flats: Flats, view: View) -> Floats:
    """How large each face (p) looks from the antenna nearer to it, less what it lacks of a zone; 0 beyond the gate."""
    origins = view.origins[:1] if (view.origins[0] == view.origins[1]).all() else view.origins
    out = np.empty(len(flats))
    kernel.looks(flats.spheres, flats.widths, origins, ready.gate[1], ready.spec.wavelength_m, out)
    return out


def most_looked(look: Floats, count: int | None = None) -> tuple[Longs, Floats]:
    """Which of all (n) look largest, `MIRRORS` or so many, and what each of all counts."""
    which, weights = np.empty(len(look), np.int64), np.empty(len(look))
    made = kernel.largest(look, FADE, np.empty((MIRRORS if count is None else count) + 1), which, weights)
    return which[:made], weights


def trace(flats: Flats, view: View, bounces_: int, gate_m: float, chosen: Chosen) -> Beams:
    """All beams of two bounces up to as many as told within the gate."""
    rooms = [1024, 8192]
    while True:
        apex, chain, on = np.empty((rooms[0], 3)), np.empty((rooms[0], 2), np.int64), np.empty(rooms[0], np.int64)
        first, edges = np.zeros(rooms[0] + 1, np.int32), np.empty((rooms[1], 2, 3))
        made, used = kernel.trace(view.origins, bounces_, gate_m, chosen.mirrors, flats.mirrors, flats.sizes,
                                  flats.flat_of, flats.normals, flats.offsets, flats.spheres, flats.loop_of,
                                  flats.loops, flats.starts, chosen.targets, apex, chain, on, first, edges,
                                  *kernel.scratch())  # fmt: skip
        if made <= rooms[0] and used <= rooms[1]:
            break
        rooms = [int(1.2 * made) + 64, int(1.2 * used) + 512]
    chain, on = chain[:made], on[:made]
    weights = chosen.target_weights[on] * chosen.mirror_weights[chain[:, 0]]
    double = chain[:, 1] >= 0
    weights[double] *= chosen.mirror_weights[chain[double, 1]]
    faces = np.where(chain >= 0, flats.flat_of[chain], -1).astype(np.int64)
    curved = flats.smooth.view(np.int8)
    weights[curved[on] + curved[faces[:, 0]] + curved[faces[:, 1]] * double == 1] = 0
    firsts = mirrored(view.origins[0], flats, faces[:, 0]) if made else np.zeros((0, 3))
    return Beams(apex[:made], firsts, faces, on, first[: made + 1], edges[:used], weights)


def _lay(ready: Bench, parts: list[Surfaces], flats: Flats, view: View, beams: Beams, grids: Complexes) -> list[Laid]:
    gate = np.array(ready.gate[1:])
    on, starts, ends = beams.ends_on, np.ascontiguousarray(beams.edges[:, 0]), np.ascontiguousarray(beams.edges[:, 1])
    normals, offsets, spheres = flats.normals.take(on, 0), flats.offsets[on], flats.spheres.take(on, 0)
    many, origins = len(beams), _radars(view, beams)
    middles = np.empty((many, 3))
    bounces.middles(beams.first, beams.edges, middles)
    weights = beams.weights * _both_ways(flats, beams)
    bounces.cover(_through(flats, view, beams, middles), beams.chains, flats.normals, flats.widths,
                  ready.spec.wavelength_m, np.empty(3), weights)  # fmt: skip
    weights = np.maximum(weights - FAINT, 0)
    which = np.flatnonzero(weights)
    rim = parted(len(which), len(starts), lambda *room: edges.cut(
        which, spheres, normals, offsets, beams.first, starts, ends, origins, view.aside, gate, EXCESS_M,
        ready.pulse.omega, ready.whole_rims, *room))  # fmt: skip
    points = np.empty((len(which), 9))
    count = draw.crossings(which, rim.windings, normals, offsets, origins, gate, points)
    points, which = points[:count], which[:count]
    lit = np.empty((many, 3))
    bounces.stand_ins(middles, rim.pieces, rim.owner, rim.tips, rim.holders, points, which, np.empty(many),
                      np.empty(many, np.bool_), lit)  # fmt: skip
    owner = np.concatenate([rim.owner, rim.holders, which])
    path, factor = _through(flats, view, beams, lit), np.zeros(many, complex)
    factor[owner] = weights[owner] * view.factor  # most beams hold nothing that echoes
    frames, fields = np.empty((many, 2, 3, 3)), np.empty((many, 2, 3))
    bounces.reflect(path, beams.chains, on, flats.normals, flats.stuffs, ready.gamma, view.frames, view.fields,
                    factor, frames, fields, np.empty((3, 3)), np.empty(3, complex))  # fmt: skip
    strong = strengths(ready, flats, view, beams, path, factor)
    factor *= shares(ready, flats, view, beams, path, strong, lambda *asked: clear(parts, *asked))
    plain = np.full(many, len(ready.gamma) - 1, np.int32)
    _, _, _, table, flat, _, *rest = common(ready, view, grids)
    told = normals, plain, origins, frames, fields, table, flat, factor, *rest
    free = (factor != 0).astype(complex)
    via = np.where(beams.chains >= 0, flats.stuffs[beams.chains], -1)
    return [lay_rim(rim, points, which, free[owner], np.zeros(len(owner)), told, stuffs=flats.stuffs[on][owner],
                    via=via[owner])]  # fmt: skip


def _radars(view: View, beams: Beams) -> Floats:
    """The radars (b, 2, 3) of beams: the transmitter's images, and the receiver [m]."""
    out = np.empty((len(beams), 2, 3))
    out[:, 0], out[:, 1] = beams.images, view.origins[1]
    return out


def _both_ways(flats: Flats, beams: Beams) -> Floats:
    """How often each beam counts: a small face is no mirror, so its double bounces count twice from the large one.

    Mirror first or last is the same wave by reciprocity, if the antennas change places; physical optics belongs on the
    smaller face.
    """
    mirror, end = flats.spheres[beams.chains[:, 0], 3], flats.spheres[beams.ends_on, 3]
    share = np.where(mirror > 1.2 * end, 2.0, np.where(end > 1.2 * mirror, 0.0, 1.0))
    return np.where(beams.chains[:, 1] >= 0, 1.0, share)


def _through(flats: Flats, view: View, beams: Beams, lit: Floats) -> Floats:
    """Corners (b, 5, 3) of each beam's path from transmitter to receiver over a point (b, 3) of its end."""
    path = np.empty((len(beams), 5, 3))
    bounces.legs(beams.images, beams.firsts, beams.chains, flats.normals, flats.offsets, view.origins,
                 np.arange(len(beams)), lit, path)  # fmt: skip
    return path


def clear(parts: list[Surfaces], path: Floats, wanted: Floats) -> Bools:
    """Whether each path (b, 5, 3) that is wanted (not 0) is free on all its legs."""
    out = wanted != 0
    starts, ends = np.empty((2, 4 * len(path), 3))
    owner = np.empty(4 * len(path), np.int64)
    count = bounces.stretches(path, wanted, starts, ends, owner)
    out[owner[:count][~between(parts, starts[:count], ends[:count])]] = False
    return np.asarray(out)


def image_lengths(ready: Bench, view: View, order: int) -> Floats:
    """Path lengths there and back [m] of every mirror path of one order between flat faces, shadows aside."""
    flats = ready.world.still.flats
    gate = np.array(ready.gate[1:])
    if order == 1:
        on = np.arange(len(flats), dtype=np.int64)
        asked = np.ones(len(on), np.bool_)
        first, starts, ends = flats.first, flats.starts, flats.ends
        origins = view.origins[None]
    else:
        beams = beams_of(ready, flats, view, order, looks(ready, flats, view))
        on, first = beams.ends_on, beams.first
        asked = (beams.chains[:, 1] >= 0) == (order == 3)
        starts, ends = np.ascontiguousarray(beams.edges[:, 0]), np.ascontiguousarray(beams.edges[:, 1])
        origins = _radars(view, beams)
    normals, offsets, spheres = flats.normals[on], flats.offsets[on], flats.spheres[on]
    which = np.flatnonzero(asked)
    rim = parted(len(which), len(starts), lambda *room: edges.cut(
        which, spheres, normals, offsets, first, starts, ends, origins, view.aside, gate, EXCESS_M,
        ready.pulse.omega, False, *room))  # fmt: skip
    points = np.empty((len(which), 9))
    count = draw.crossings(which, rim.windings, normals, offsets, origins, gate, points)
    return np.sort(points[:count, 3])
