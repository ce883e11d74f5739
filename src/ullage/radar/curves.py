"""Echoes of curved surfaces by way of large flat faces: a round tank's wall over its floor, a drum beside a wall.

A curved surface comes as many facets, each smaller than a Fresnel zone, so it is no mirror. But flat faces mirror the
radar, and from its images the facets are done by physical optics as from the radar itself: Kirchhoff's integral with
one end of the path at an image [AllenBerkley1979], [Balanis2012, ch. 7]. Such paths go over one or two flat faces,
before the facet, after it, or one each; a path and its reverse are one wave twice where the antennas are in one place.
Polarisation and reflection are those of a mirror at each point that turns the wave there the way it goes on.
Of a facet counts what both legs reach: where they meet their faces within the rims, and are free.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ullage.kernels import rims as draw
from ullage.kernels import ways as kernel
from ullage.radar.facets import Flats, Surfaces
from ullage.radar.flats import Shading, lay_parted, rims
from ullage.radar.mirrors import mirrored, unit
from ullage.radar.multipath import PLAIN, looks, most_looked
from ullage.radar.physical import Bench, Laid, View, lay_triangles, triangles
from ullage.radar.visibility import between

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Longs = NDArray[np.int64]
Bools = NDArray[np.bool_]

FACES = 3
"""Only so many flat faces, those that look largest, pass on waves to curved surfaces."""
NUDGE_M = 5e-3
"""Points of facets are looked at so far within their rims [m]."""
PAIRS = 2
"""So many where a wave goes over two of them."""
_CHAINS: dict[int, tuple[tuple[int, int], ...]] = {2: ((1, 0), (0, 1)), 3: ((1, 1), (2, 0), (0, 2))}


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """One way between an antenna and a curved surface, over none, one or two faces."""

    faces: tuple[int, ...]  # from the antenna on
    images: tuple[Floats, ...]  # the antenna, then its images in them, one after the other


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """There and back."""

    legs: tuple[Leg, Leg]
    weight: float

    def view(self, flats: Flats, view: View) -> View:
        """The radar as the curved surface sees it: its antennas' last images, mirrored."""
        frames = view.frames.copy()
        for side, leg in enumerate(self.legs):
            for face in leg.faces:
                n = flats.normals[face]
                frames[side] -= 2 * np.outer(frames[side] @ n, n)
        origins = np.stack([leg.images[-1] for leg in self.legs])
        return View(origins, frames, view.fields, view.factor * self.weight)


def lay_curves(
    ready: Bench, parts: list[Surfaces], flats: Flats, view: View, max_bounces: int, grids: Complexes
) -> list[Laid]:
    """Adds the echoes of small triangles and of facets of curved surfaces over flat faces to the delay grids."""
    plain = int((~flats.smooth).sum())
    if not 0 < plain <= PLAIN or not (flats.smooth.any() or any(len(part.corners) for part in parts)):
        return []
    out: list[Laid] = []
    bare = _bare(ready)
    for way in _ways(ready, flats, view, max_bounces):
        seen = way.view(flats, view)
        shading = _shading(ready, parts, flats, view, way)
        laid = [_lay_small(bare, part, seen, shading, grids) for part in parts if len(part.corners)]
        if flats.smooth.any():
            laid += _lay_strips(bare, flats, seen, shading, grids)
        over = [int(flats.stuffs[face]) for leg in way.legs for face in leg.faces]
        via = np.array([*over, -1][:2], np.int64)
        out += [replace(part, via=np.tile(via, (len(part.echo), 1))) for part in laid]
    return out


def _shading(ready: Bench, parts: list[Surfaces], flats: Flats, view: View, way: Way) -> Shading:
    def shading(points: Floats, stuffs: NDArray[np.integer]) -> tuple[Complexes, Floats]:
        return heard(ready, parts, flats, view, way, points, stuffs), np.zeros(len(points))

    return shading


def _bare(ready: Bench) -> Bench:
    """The bench with everything reflecting 1, for paths whose coefficients are known otherwise."""
    count = len(ready.gamma)
    return replace(ready, gamma=ready.gamma[-1:].repeat(count, axis=0), lag=ready.lag[-1:].repeat(count, axis=0))


def _ways(ready: Bench, flats: Flats, view: View, most: int) -> Iterator[Way]:
    """Ways over the faces that look largest, those that fade in as mirrors do (`multipath.FADE`)."""
    look = looks(flats, view, ready.gate[1], ready.spec.wavelength_m) * ~flats.smooth
    one = bool((view.origins[0] == view.origins[1]).all())  # there over faces and back over them are one wave, twice
    for bounces in range(2, most + 1):
        faces, weights = most_looked(look, FACES if bounces == 2 else PAIRS)
        for chains in _CHAINS[bounces]:
            if one and chains[0] < chains[1]:
                continue
            for over in _picks(faces, chains, one):
                legs = tuple(_leg(flats, view.origins[s], over[s]) for s in range(2))
                reach = sum(_least(flats, leg) for leg in legs) / 2
                twice = 2.0 if one and over[0] != over[1] else 1.0
                if reach <= ready.gate[1]:
                    yield Way((legs[0], legs[1]), twice * float(np.prod(weights[list(over[0] + over[1])])))


def _picks(faces: Longs, chains: tuple[int, int], one: bool) -> Iterator[tuple[tuple[int, ...], tuple[int, ...]]]:
    """Faces for both legs, as many as `chains` says; where antennas are in one place no path and its reverse."""
    ids = [int(f) for f in faces]
    if chains == (1, 1):
        for i, a in enumerate(ids):
            yield from (((a,), (b,)) for b in (ids[i:] if one else ids))
        return
    long = max(chains)
    rows = [(a,) for a in ids] if long == 1 else [(a, b) for a in ids for b in ids if a != b]
    for row in rows:
        yield (row, ()) if chains[0] else ((), row)


def _leg(flats: Flats, origin: Floats, faces: tuple[int, ...]) -> Leg:
    images = [origin]
    for face in faces:
        images.append(mirrored(images[-1], flats, np.array([face]))[0])
    return Leg(faces, tuple(images))


def _least(flats: Flats, leg: Leg) -> float:
    """How far it is to anything over these faces at the least [m]."""
    if not leg.faces:
        return 0.0
    face = leg.faces[-1]
    gap = float(np.linalg.norm(flats.spheres[face, :3] - leg.images[-1]) - flats.spheres[face, 3])
    return max(gap, abs(float(flats.normals[face] @ leg.images[-1] - flats.offsets[face])))


def _lay_small(bare: Bench, part: Surfaces, seen: View, shading: Shading, grids: Complexes) -> Laid:
    leaves, owner = triangles(bare, part, seen)
    factor, late = shading(leaves.mean(1), part.stuffs[owner])
    free = np.flatnonzero(factor)
    pieces = np.ascontiguousarray(leaves[free]), owner[free]
    return lay_triangles(bare, part.normals, part.stuffs, pieces, (factor[free], late[free]), seen, grids)


def _lay_strips(bare: Bench, flats: Flats, seen: View, shading: Shading, grids: Complexes) -> list[Laid]:
    side = seen.origins @ flats.normals.T - flats.offsets
    which = np.flatnonzero(flats.smooth & (side[0] * side[1] > 1e-9))
    if not len(which):
        return []
    limits = np.full(len(flats), bare.gate[1])
    rim = rims(bare, flats, seen, which, limits)

    def shaded(points: Floats, on: NDArray[np.integer]) -> tuple[Complexes, Floats]:
        inward = flats.spheres[on, :3] - points  # where walls stand on floors, mirror points lie on their very rims
        return shading(points + NUDGE_M * unit(inward), flats.stuffs[on])

    return [lay_parted(bare, flats, seen, which, rim, limits, shaded, grids)]


def heard(
    ready: Bench, parts: list[Surfaces], flats: Flats, view: View, way: Way, points: Floats,
    stuffs: NDArray[np.integer],
) -> Complexes:  # fmt: skip
    """What all reflections of a way over points (m, 3) of given objects (m) make of the wave; 0 where it is blocked.

    The antennas' patterns and the spread of the wave are not in it.
    """
    faces, images = np.full((2, 2), -1, np.int64), np.empty((2, 3, 3))
    for side, leg in enumerate(way.legs):
        faces[side, : len(leg.faces)], images[side, : len(leg.images)] = leg.faces, leg.images
    stops, free = np.empty((2, 4, len(points), 3)), np.empty(len(points), np.bool_)
    kernel.corners(points, faces, images, flats.normals, flats.offsets, stops, free)
    for side, leg in enumerate(way.legs):
        for step, face in enumerate(leg.faces):
            _kept(free, lambda at, k=face: _within(flats, k, at), stops[side, step + 1])
    for side, leg in enumerate(way.legs):
        for step in range(len(leg.images)):
            _kept(free, lambda a, b: between(parts, a, b), stops[side, step], stops[side, step + 1])
    out = np.zeros(len(points), complex)
    kernel.weigh(stops, np.flatnonzero(free), faces, view.fields, flats.normals, flats.stuffs, flats.widths,
                 ready.spec.wavelength_m, ready.gamma, stuffs, out)  # fmt: skip
    return out


def _kept(free: Bools, test: Callable[..., Bools], *rows: Floats) -> None:
    """Of what is free keeps what passes a test of its rows."""
    todo = np.flatnonzero(free)
    if len(todo):
        free[todo] = test(*(row[todo] for row in rows))


def _within(flats: Flats, face: int, points: Floats) -> Bools:
    """Whether points (m, 3) of one face's plane lie within its rim."""
    out = np.empty(len(points), np.bool_)
    draw.inside(points, np.full(len(points), face), flats.normals, flats.first, flats.starts, flats.ends, out)
    return out
