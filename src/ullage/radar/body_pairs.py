"""Echoes over two curved bodies, spheres and drums seen from outside, by geometrical optics.

Each ordered pair has one path, the shortest that touches both bodies. Its spreading factor follows from the integral
over both surfaces by stationary phase [BornWolf1999]: the determinant of the second derivatives of the path length.
From outside nothing focuses, so the determinant is nowhere 0. A Fresnel integral gives the truncation by the ends of a
drum.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.special import fresnel

from ullage.arrays import Bools, Complexes, Floats, Ints, Longs
from ullage.geometry import C0
from ullage.kernels import mirrored_pairs as flat
from ullage.kernels import pairs as kernel
from ullage.radar.context import AntennaPair, RadarContext
from ullage.radar.echo_set import EchoSet
from ullage.radar.facets import Surfaces
from ullage.radar.mirrors import dot
from ullage.radar.multipath import choose_largest
from ullage.radar.quadrics import Quadric
from ullage.radar.reflected_paths import ReflectedPaths, free, reflection_gains
from ullage.radar.wall_bounces import PULL_M, accumulate

BODIES = 8
"""Number of bodies with the largest apparent sizes that form pairs; each fades in."""
FAINT = 5e-4
"""Least amplitude of a pair, as a share of the strongest echo in the frame."""
_STEPS = 12  # most steps of Newton's method


@dataclass(frozen=True, slots=True, eq=False)
class Bodies:
    """Spheres and drums, one per row."""

    centres: Floats  # (m, 3) middles [m]
    axes: Floats  # (m, 3, 3) rows: two across the axis, and the axis
    radii: Floats  # (m) [m]
    ends: Floats  # (m, 2) of drums along the axis, from the centre [m]
    is_sphere: Bools  # (m)
    depths: Floats  # (m) largest distance of facets from the surface [m]
    object_ids: Ints  # (m)

    def take(self, which: Longs) -> Bodies:
        """Select some of the bodies."""
        return Bodies(*(getattr(self, row)[which] for row in self.__slots__))

    def gaps(self, points: Floats) -> Floats:
        """Return the distances of points (m, 3), or of one, from the centres of spheres or axes of drums (m) [m]."""
        away = points - self.centres
        along = dot(away, self.axes[:, 2])
        along = along - np.clip(along, self.ends[:, 0], self.ends[:, 1]) * ~self.is_sphere
        return np.asarray(np.sqrt(np.maximum(dot(away, away) - dot(away, self.axes[:, 2]) ** 2, 0.0) + along**2))


@lru_cache(maxsize=16)
def bodies_of(quadrics: tuple[Quadric, ...], narrow: float) -> Bodies:
    """Collect the bodies with facets narrower than `narrow` [m] as rows."""
    quadrics = tuple(r for r in quadrics if r.widest < narrow)
    half = np.array([(r.high - r.low) / 2 for r in quadrics])
    return Bodies(
        centres=np.array([r.centre + (r.low + r.high) / 2 * r.axes[2] for r in quadrics]),
        axes=np.array([r.axes for r in quadrics]),
        radii=np.array([r.radius for r in quadrics]),
        ends=np.stack([-half, half], 1),
        is_sphere=np.array([r.is_sphere for r in quadrics]),
        depths=np.array([r.depth for r in quadrics]),
        object_ids=np.array([r.object_id for r in quadrics], np.int32),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Paths:
    """Shortest paths over two bodies each."""

    corners: Floats  # (4, m, 3) from the transmitter to the receiver [m]
    normals: Floats  # (2, m, 3)
    length: Floats  # (m) [m]
    spread: Floats  # (m) spreading factor of a point source's wave [1/m]; 0 where no path exists
    bends: Floats  # (m, 2) second derivative of the path length along each body's axis, minimised over the rest [1/m]

    def take(self, which: Longs) -> Paths:
        """Select some of the paths."""
        return Paths(self.corners[:, which], self.normals[:, which], self.length[which], self.spread[which],
                     self.bends[which])  # fmt: skip


def paths_over(start: Floats, stop: Floats, first: Bodies, last: Bodies) -> Paths:
    """Find the shortest paths from points (3) or (m, 3) over the first bodies (m) and then the last (m) to others."""
    many = len(first.radii)
    ends = [np.array(np.broadcast_to(point, (many, 3)), float, order="C") for point in (start, stop)]
    both = kernel.BodyPairs(np.stack([first.centres, last.centres]), np.stack([first.axes, last.axes]),
                            np.stack([first.radii, last.radii]),
                            np.stack([first.is_sphere, last.is_sphere]))  # fmt: skip
    return shortest(ends[0], ends[1], both)


def shortest(starts: Floats, stops: Floats, bodies: kernel.BodyPairs) -> Paths:
    """Find the shortest paths from points (m, 3) over two bodies each to others."""
    many = len(starts)
    corners, normals = np.empty((4, many, 3)), np.empty((2, many, 3))
    lengths, spreads, bends = np.empty(many), np.empty(many), np.empty((many, 2))
    found = kernel.PairPaths(corners, normals, lengths, spreads, bends)
    kernel.shortest(starts, stops, bodies, _STEPS, found, np.empty(76))
    return Paths(corners, normals, lengths, spreads, bends)


def accumulate_body_pairs(
    context: RadarContext, parts: list[Surfaces], quadrics: tuple[Quadric, ...], antennas: AntennaPair, grids: Complexes
) -> list[EchoSet]:
    """Add the echoes over two bodies to the delay grids, unless they are too weak against the echoes in these."""
    narrow = np.sqrt(context.spec.wavelength_m * context.gate[1] / 2)
    bodies, together = bodies_of(quadrics, narrow), antennas.monostatic
    if len(bodies.radii) < 2:
        return []
    which, weights, gaps = largest_bodies(context, bodies, antennas, BODIES)
    if len(which) < 2:
        return []
    one, other = np.repeat(which, len(which)), np.tile(which, len(which))
    between = apart(bodies.take(one), bodies.take(other))
    segments = np.stack([gaps[0, one] - bodies.radii[one], gaps[1, other] - bodies.radii[other],
                     between - bodies.radii[one] - bodies.radii[other]])  # fmt: skip
    most = bodies.radii[one] * bodies.radii[other] / (4 * np.maximum(segments, 1e-3).prod(0) * segments.sum(0))
    seen = replace(antennas, factor=2 * antennas.factor) if together else antennas
    least = FAINT * float(abs(grids).max())
    full = context.spec.wavelength_m / (4 * np.pi) * abs(seen.factor) * float(context.table.max()) ** 2
    loud = (most * full**2 > least**2) & ((one < other) if together else (one != other))
    if not loud.any():
        return []
    return _echoes_of(context, parts, seen, bodies, np.stack([one[loud], other[loud]]), weights, least, grids)


def largest_bodies(
    context: RadarContext, bodies: Bodies, antennas: AntennaPair, count: int
) -> tuple[Longs, Floats, Floats]:
    """Select the `count` bodies of the largest apparent sizes; also return weights and distances (2, m) [m]."""
    gaps = _gaps(bodies, antennas)
    sizes = np.where(gaps.min(0) < context.gate[1] + bodies.radii, bodies.radii / np.maximum(gaps.max(0), 1e-6), 0.0)
    return *choose_largest(sizes, count), gaps


@lru_cache(maxsize=8)  # used twice in a frame
def _gaps(bodies: Bodies, antennas: AntennaPair) -> Floats:
    out = np.empty((2, len(bodies.radii)))
    flat.gaps(antennas.origins, bodies.centres, bodies.axes, bodies.ends, bodies.is_sphere, out)
    return out


def apart(first: Bodies, last: Bodies) -> Floats:
    """Bound the distances (m) between the middles or axes of bodies from below [m]; exact for parallel drums."""
    lean = np.sqrt(np.maximum(1 - dot(first.axes[:, 2], last.axes[:, 2]) ** 2, 0.0)) * ~last.is_sphere
    return np.asarray(first.gaps(last.centres) - lean * last.ends[:, 1])


def _echoes_of(
    context: RadarContext,
    parts: list[Surfaces],
    antennas: AntennaPair,
    bodies: Bodies,
    pairs: Longs,
    weights: Floats,
    least: float,
    grids: Complexes,
) -> list[EchoSet]:
    """Add the echoes over pairs of bodies (2, m) whose path gain amplitude exceeds `least`."""
    one, other = pairs
    first, last = bodies.take(one), bodies.take(other)
    paths = paths_over(antennas.origins[0], antennas.origins[1], first, last)
    wavelength = context.spec.wavelength_m
    value = wavelength / (4 * np.pi) * antennas.factor * paths.spread * weights[one] * weights[other]
    value[(abs(value) * float(context.table.max()) ** 2 <= least) | (paths.length >= 2 * context.gate[1])] = 0
    near = np.flatnonzero(value)  # most are too weak once their curvature is known, and need no visibility test
    if not len(near):
        return []
    paths, first, last = paths.take(near), first.take(near), last.take(near)
    path = _reflected_paths(first, last, paths)
    value = value[near] * reflection_gains(context, antennas, path)
    for k, body in enumerate((first, last)):
        value = value * end_factor(body, paths.corners[1 + k], paths.bends[:, k], wavelength)
    value = value * (abs(value) > least) * free(parts, path)
    via = np.stack([first.object_ids, np.full(len(near), -1)], 1).astype(np.int64)
    echo = accumulate(context, paths.length / C0, value, grids, (0.0, 1.0))

    def again(factors: Complexes, others: Complexes) -> None:
        accumulate(context, paths.length / C0, value * factors, others, (0.0, 1.0))

    return [EchoSet(last.object_ids, paths.corners[2], echo, paths.length / C0, again, via)]


def _reflected_paths(first: Bodies, last: Bodies, paths: Paths) -> ReflectedPaths:
    """Return the geometric paths, with corners past the ends of drums moved onto the drums."""
    corners = paths.corners.copy()
    for k, body in enumerate((first, last)):
        corners[1 + k] = clamped(body, corners[1 + k])
    return ReflectedPaths(
        corners,
        paths.normals,
        np.stack([first.depths, last.depths]),
        np.stack([first.object_ids, last.object_ids]),
        np.ones(len(paths.length), bool),
    )


def clamped(body: Bodies, points: Floats) -> Floats:
    """Return points (m, 3) on bodies, with those past the ends of drums moved onto the drums."""
    up = dot(points - body.centres, body.axes[:, 2])
    inner = np.where(body.is_sphere, up, np.clip(up, body.ends[:, 0] + PULL_M, body.ends[:, 1] - PULL_M))
    return np.asarray(points + (inner - up)[:, None] * body.axes[:, 2])


def end_factor(body: Bodies, points: Floats, bends: Floats, wavelength: float) -> Complexes:
    """Compute the factors (m) of the ends of drums at points (m, 3), by Fresnel integrals along the axes."""
    along = dot(points - body.centres, body.axes[:, 2])
    return truncation(body.ends, body.is_sphere, along, bends, wavelength)


def truncation(ends: Floats, is_sphere: Bools, along: Floats, bends: Floats, wavelength: float) -> Complexes:
    """Compute the factors (m) of ends (m, 2) [m] for waves at places `along` the axis [m]; spheres have no ends."""
    sine, cosine = fresnel((ends - along[:, None]) * np.sqrt(2 * bends / wavelength)[:, None])
    out = np.diff(cosine - 1j * sine, axis=1)[:, 0] / (1 - 1j)
    return np.where(is_sphere, 1.0, out)
