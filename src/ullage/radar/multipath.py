"""Echoes over several surfaces: mirror images of the radar, beams clipped by every mirror, physical optics at the end.

A path of k bounces goes over k - 1 flat mirrors by geometrical optics; the part of the last face that the beam lights
is done by its clipped rim, as in single bounce, so corners, truncated mirrors and rooms come out of one rule.
Every ordered sequence of faces is followed once; delays are those of the image method [AllenBerkley1979].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ullage.kernels import beams as kernel
from ullage.kernels import edges as rim
from ullage.radar.facets import Flats, Surfaces
from ullage.radar.physical import Bench, Laid, View, common, grown
from ullage.radar.visibility import between

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Longs = NDArray[np.int64]

MIRRORS = 32
"""At most so many mirrors are used, those that look largest from the radar."""
EXCESS_M = 0.5
"""Rims whose path exceeds the mirror path by more are left out [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """Bundles of paths of one order: each over its mirrors to the lit part of its last face."""

    images: Floats  # (b, 3) the transmitter's last image [m]
    firsts: Floats  # (b, 3) its first image [m]
    chains: Longs  # (b, 2) flat faces that mirror, -1 for none
    ends_on: Longs  # (b) face at the end
    first: NDArray[np.int32]  # (b + 1) first edge of each
    edges: Floats  # (e, 2, 3) outlines of the lit parts [m]

    def __len__(self) -> int:
        return len(self.ends_on)


def lay_bounces(
    ready: Bench, parts: list[Surfaces], flats: Flats, view: View, max_bounces: int, grids: Complexes
) -> list[Laid]:
    """Adds the echoes of two and three bounces between flat faces to the delay grids."""
    out: list[Laid] = []
    if len(flats) < 2:
        return out
    mirrors, targets = _chosen(flats, view, ready.gate[1])
    for order in range(2, max_bounces + 1):
        beams = trace(flats, view, order, ready.gate[1], mirrors, targets)
        if len(beams):
            out += _lay(ready, parts, flats, view, beams, order, grids)
    return out


def _chosen(flats: Flats, view: View, gate_m: float) -> tuple[Longs, Longs]:
    """Mirrors (convex parts) and end faces, each the ones that look largest, in a fixed order."""

    def largest(spheres: Floats) -> Longs:
        gap = np.linalg.norm(spheres[:, :3] - view.origins[0], axis=1)
        near = np.flatnonzero(gap - spheres[:, 3] <= gate_m)
        rank = np.argsort(-(spheres[near, 3] / (gap[near] + 1e-3)), kind="stable")[:MIRRORS]
        return np.sort(near[rank]).astype(np.int64)

    return largest(flats.spheres[flats.flat_of]), largest(flats.spheres)


def trace(flats: Flats, view: View, order: int, gate_m: float, mirrors: Longs, targets: Longs) -> Beams:
    """All beams of one order within the gate."""
    rooms = [1024, 8192]
    while True:
        apex, chain, on = np.empty((rooms[0], 3)), np.empty((rooms[0], 2), np.int64), np.empty(rooms[0], np.int64)
        first, edges = np.zeros(rooms[0] + 1, np.int32), np.empty((rooms[1], 2, 3))
        made, used = kernel.trace(view.origins, order, gate_m, mirrors, flats.mirrors, flats.sizes, flats.flat_of,
                                  flats.normals, flats.offsets, flats.spheres, flats.loop_of, flats.loops,
                                  flats.starts, targets, apex, chain, on, first, edges)  # fmt: skip
        if made <= rooms[0] and used <= rooms[1]:
            break
        rooms = [int(1.2 * made) + 64, int(1.2 * used) + 512]
    faces = np.where(chain[:made] >= 0, flats.flat_of[np.maximum(chain[:made], 0)], -1).astype(np.int64)
    firsts = _mirrored(view.origins[0], flats, faces[:, 0]) if made else np.zeros((0, 3))
    return Beams(apex[:made], firsts, faces, on[:made], first[: made + 1], edges[:used])


def _mirrored(points: Floats, flats: Flats, faces: Longs) -> Floats:
    """Mirror images of points in faces; face -1 leaves a point where it is."""
    n = flats.normals[faces]
    gap = np.einsum("ni,ni->n", n, np.broadcast_to(points, n.shape)) - flats.offsets[faces]
    return np.asarray(np.where(faces[:, None] >= 0, points - 2 * gap[:, None] * n, points))


def _turned(flats: Flats, beams: Beams, vectors: Floats) -> Floats:
    """Vectors (3, k) fixed to the radar, as its images hold them: (b, 3, k)."""
    out = np.broadcast_to(vectors, (len(beams), *vectors.shape)).copy()
    for step in range(2):
        face = beams.chains[:, step]
        n = np.where(face[:, None] >= 0, flats.normals[face], 0.0)
        out -= 2 * n[:, :, None] * np.einsum("bi,bik->bk", n, out)[:, None]
    return out


def _lay(
    ready: Bench, parts: list[Surfaces], flats: Flats, view: View, beams: Beams, order: int, grids: Complexes
) -> list[Laid]:
    on, starts, ends = beams.ends_on, np.ascontiguousarray(beams.edges[:, 0]), np.ascontiguousarray(beams.edges[:, 1])
    normals, offsets, spheres = flats.normals[on], flats.offsets[on], flats.spheres[on]
    origins = np.stack([beams.images, np.broadcast_to(view.origins[1], beams.images.shape)], 1)
    which, windings = np.arange(len(beams), dtype=np.int64), np.empty(len(beams))
    pieces, owner = grown(8192, (12,), lambda out, of: rim.cut(
        which, spheres, normals, offsets, beams.first, starts, ends, origins, np.array(ready.gate), EXCESS_M,
        ready.pulse.omega, out, of, windings))  # fmt: skip
    points, lengths = np.empty((len(which), 3)), np.empty(len(which))
    count = rim.crossings(which, windings, normals, offsets, origins, points, lengths)
    points, lengths, which = points[:count], lengths[:count], which[:count]
    lit = _stand_ins(beams, pieces, owner, points, which)
    path = legs(flats, view, beams, lit)
    factor = coefficients(ready, flats, view, beams, path) * clear(parts, path) * _both_ways(flats, beams, order)
    images = _turned(flats, beams, np.concatenate([view.frames[0].T, view.fields[0][:, None]], 1))
    frames = np.stack([np.swapaxes(images[:, :, :3], 1, 2), np.broadcast_to(view.frames[1], (len(beams), 3, 3))], 1)
    fields = np.stack([images[:, :, 3], np.broadcast_to(view.fields[1], (len(beams), 3))], 1)
    plain = np.full(len(beams), len(ready.gamma) - 1, np.int32)
    _, _, _, table, flat, _, *rest = common(ready, view, grids)
    told = (normals, plain, np.ascontiguousarray(origins), np.ascontiguousarray(frames), np.ascontiguousarray(fields),
            table, flat, factor, *rest)  # fmt: skip
    echo, delay = np.empty(len(pieces), complex), np.empty(len(pieces))
    rim.lay_rims(pieces, owner, (factor[owner] != 0).astype(complex), np.zeros(len(pieces)), *told, echo, delay)
    bright, when = np.empty(count, complex), np.empty(count)
    rim.lay_images(points, which, lengths, np.ones(count, complex), np.zeros(count), *told, bright, when)
    middle = (pieces[:, :3] + pieces[:, 3:6]) / 2
    return [_told(flats, beams, owner, middle, echo, delay, order),
            _told(flats, beams, which, points, bright, when, order)]  # fmt: skip


def _both_ways(flats: Flats, beams: Beams, order: int) -> Floats:
    """How often each beam counts: a small face is no mirror, so its double bounces count twice from the large one.

    Mirror first or last is the same wave by reciprocity; physical optics belongs on the smaller face.
    """
    if order > 2:
        return np.ones(len(beams))
    mirror, end = flats.spheres[beams.chains[:, 0], 3], flats.spheres[beams.ends_on, 3]
    return np.where(mirror > 1.2 * end, 2.0, np.where(end > 1.2 * mirror, 0.0, 1.0))


def _told(
    flats: Flats, beams: Beams, owner: NDArray[np.integer], points: Floats, echo: Complexes, delay: Floats, order: int
) -> Laid:
    chain = beams.chains[owner]
    via = np.where(chain >= 0, flats.stuffs[chain], -1)
    return Laid(flats.stuffs[beams.ends_on[owner]], points, echo, delay, order, via)


def _stand_ins(beams: Beams, pieces: Floats, owner: NDArray[np.int32], points: Floats, which: Longs) -> Floats:
    """One point (b, 3) on each beam's lit part to speak for it: the mirror point, or where the rim's path is least."""
    count = np.diff(beams.first)
    sums = np.add.reduceat(beams.edges[:, 0], beams.first[:-1], axis=0)
    middle = sums / count[:, None]
    out = middle.copy()
    order = np.argsort(-(pieces[:, 6] + pieces[:, 7]), kind="stable")
    out[owner[order]] = (pieces[order, :3] + pieces[order, 3:6]) / 2
    out[which] = points
    toward = middle - out
    size = np.linalg.norm(toward, axis=1, keepdims=True)
    return np.asarray(out + toward * np.minimum(0.02 / np.maximum(size, 1e-9), 0.5))


def legs(flats: Flats, view: View, beams: Beams, lit: Floats) -> Floats:
    """Corners (b, 5, 3) of each path from transmitter to receiver; one mirror only: the first corner twice."""

    def crossing(image: Floats, target: Floats, faces: Longs) -> Floats:
        n, d = flats.normals[faces], flats.offsets[faces]
        here = np.einsum("ni,ni->n", n, image) - d
        there = np.einsum("ni,ni->n", n, target) - d
        span = here - there
        share = here / np.where(abs(span) > 1e-12, span, 1)
        return np.asarray(image + np.clip(share, 0, 1)[:, None] * (target - image))

    single = beams.chains[:, 1] < 0
    last = np.where(single, beams.chains[:, 0], beams.chains[:, 1])
    second = crossing(beams.images, lit, last)
    first = np.where(single[:, None], view.origins[0], crossing(beams.firsts, second, beams.chains[:, 0]))
    ends = [np.broadcast_to(view.origins[i], lit.shape) for i in range(2)]
    return np.stack([ends[0], first, second, lit, ends[1]], 1)


def clear(parts: list[Surfaces], path: Floats) -> NDArray[np.bool_]:
    """Whether each path (b, 5, 3) is free on all its legs."""
    out = np.ones(len(path), bool)
    for step in range(4):
        todo = np.flatnonzero(out)
        out[todo] = between(parts, path[todo, step], path[todo, step + 1])
    return out


def coefficients(ready: Bench, flats: Flats, view: View, beams: Beams, path: Floats) -> Complexes:
    """What all reflections along each path make of the transmitted field, as the receiver's polarisation takes it."""
    step = np.diff(path, axis=1)
    size = np.linalg.norm(step, axis=2, keepdims=True)
    unit = step / np.maximum(size, 1e-12)
    unit[:, 0] = np.where(size[:, 0] > 1e-9, unit[:, 0], unit[:, 1])
    field = _across(np.broadcast_to(view.fields[0], unit[:, 0].shape), unit[:, 0]).astype(complex)
    double = beams.chains[:, 1] >= 0
    stops = ((beams.chains[:, 0], 0, double), (np.where(double, beams.chains[:, 1], beams.chains[:, 0]), 1, None),
             (beams.ends_on, 2, None))  # fmt: skip
    for faces, leg, only in stops:
        bounced = _reflect(ready, flats, faces, unit[:, leg], field)
        field = bounced if only is None else np.where(only[:, None], bounced, field)
    taken = _across(np.broadcast_to(view.fields[1], unit[:, 3].shape), unit[:, 3])
    return np.asarray(np.einsum("ni,ni->n", field, taken) * view.factor)


def _across(field: Floats, unit: Floats) -> Floats:
    """The unit field across the direction of travel."""
    out = field - unit * np.einsum("ni,ni->n", field, unit)[:, None]
    return np.asarray(out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-9))


def _reflect(ready: Bench, flats: Flats, faces: Longs, unit: Floats, field: Complexes) -> Complexes:
    """The field after a bounce: Fresnel's coefficients across and along the plane of incidence, then mirrored."""
    n = flats.normals[faces]
    cosine = np.abs(np.einsum("ni,ni->n", n, unit))
    s = np.cross(unit, n)
    s /= np.maximum(np.linalg.norm(s, axis=1, keepdims=True), 1e-12)
    te, tm = reflection_at(ready, flats.stuffs[faces], cosine)
    out = tm[:, None] * field + ((te - tm) * np.einsum("ni,ni->n", s, field))[:, None] * s
    return np.asarray(out - 2 * n * np.einsum("ni,ni->n", n, out)[:, None])


def reflection_at(ready: Bench, stuffs: NDArray[np.int32], cosine: Floats) -> tuple[Complexes, Complexes]:
    """Reflection TE and TM (n) of objects at cos(incidence) (n)."""
    place = np.clip(cosine, 0, 1) * (ready.gamma.shape[3] - 1)
    i = np.minimum(place.astype(int), ready.gamma.shape[3] - 2)
    u = place - i
    rows = ready.gamma[stuffs, 0]
    k = np.arange(len(stuffs))
    both = rows[k, :, i] * (1 - u)[:, None] + rows[k, :, i + 1] * u[:, None]
    return both[:, 0], both[:, 1]


def image_lengths(ready: Bench, view: View, order: int) -> Floats:
    """Path lengths there and back [m] of every mirror path of one order between flat faces, shadows aside."""
    flats = ready.world.still.flats
    gate = np.array(ready.gate)
    if order == 1:
        on = np.arange(len(flats), dtype=np.int64)
        first, starts, ends = flats.first, flats.starts, flats.ends
        origins = view.origins[None]
    else:
        beams = trace(flats, view, order, ready.gate[1], *_chosen(flats, view, ready.gate[1]))
        on, first = beams.ends_on, beams.first
        starts, ends = np.ascontiguousarray(beams.edges[:, 0]), np.ascontiguousarray(beams.edges[:, 1])
        origins = np.stack([beams.images, np.broadcast_to(view.origins[1], beams.images.shape)], 1)
    normals, offsets, spheres = flats.normals[on], flats.offsets[on], flats.spheres[on]
    which, windings = np.arange(len(on), dtype=np.int64), np.empty(len(on))
    grown(8192, (12,), lambda out, of: rim.cut(
        which, spheres, normals, offsets, first, starts, ends, origins, gate, EXCESS_M, ready.pulse.omega, out, of,
        windings))  # fmt: skip
    points, lengths = np.empty((len(on), 3)), np.empty(len(on))
    count = rim.crossings(which, windings, normals, offsets, origins, points, lengths)
    return np.sort(lengths[:count])
