"""Echoes from one round body to another, balls and drums seen from outside, by geometrical optics.

Of each pair and order there is one path, the shortest that touches both; its spread is the determinant of the path's
second derivatives over both surfaces, of which an integral of stationary phase over both is made [BornWolf1999]. From
outside nothing focuses, so that is nowhere 0. What the ends of a drum leave of it is Fresnel's integral.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.special import fresnel

from ullage.arrays import Bools, Complexes, Floats, Ints, Longs
from ullage.geometry import C0
from ullage.kernels import flat_pairs as flat
from ullage.kernels import pairs as kernel
from ullage.radar.context import AntennaPair, RadarContext
from ullage.radar.echo_set import EchoSet
from ullage.radar.facets import Surfaces
from ullage.radar.mirrors import dot
from ullage.radar.multipath import choose_largest
from ullage.radar.quadrics import Quadric
from ullage.radar.real_paths import Real, free, turned
from ullage.radar.wall_bounces import PULL_M, accumulate

BODIES = 8
"""Between so many bodies waves go, those that look largest; each fades in."""
FAINT = 5e-4
"""Pairs that do not make this share of a frame's strongest echo are left out."""
_STEPS = 12  # of Newton's method, at the most


@dataclass(frozen=True, slots=True, eq=False)
class Bodies:
    """Balls and drums, one for each row."""

    centres: Floats  # (m, 3) middles [m]
    axes: Floats  # (m, 3, 3) rows: two across the axis, and the axis
    radii: Floats  # (m) [m]
    ends: Floats  # (m, 2) of drums along the axis, from the centre [m]
    is_sphere: Bools  # (m)
    depths: Floats  # (m) by so much facets lie off [m]
    object_ids: Ints  # (m)

    def take(self, which: Longs) -> Bodies:
        """Some of them."""
        return Bodies(*(getattr(self, row)[which] for row in self.__slots__))

    def gaps(self, points: Floats) -> Floats:
        """How far points (m, 3) or one of them lie from the centres of balls or the axes of drums (m) [m]."""
        away = points - self.centres
        along = dot(away, self.axes[:, 2])
        along = along - np.clip(along, self.ends[:, 0], self.ends[:, 1]) * ~self.is_sphere
        return np.asarray(np.sqrt(np.maximum(dot(away, away) - dot(away, self.axes[:, 2]) ** 2, 0.0) + along**2))


@lru_cache(maxsize=16)
def bodies_of(quadrics: tuple[Quadric, ...], narrow: float) -> Bodies:
    """Round bodies as rows, those whose facets are narrower than this [m]."""
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
    spread: Floats  # (m) what a source's wave is less at the end [1/m]; 0 where there is no such path
    bends: Floats  # (m, 2) second derivative of the path along either body's axis, all else as it fits [1/m]

    def take(self, which: Longs) -> Paths:
        """Some of them."""
        return Paths(self.corners[:, which], self.normals[:, which], self.length[which], self.spread[which],
                     self.bends[which])  # fmt: skip


def paths_over(start: Floats, stop: Floats, first: Bodies, last: Bodies) -> Paths:
    """The shortest paths from points (3) or (m, 3) over the first bodies (m) and then the last (m) to others."""
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


def accumulate_pairs(
    context: RadarContext, parts: list[Surfaces], quadrics: tuple[Quadric, ...], antennas: AntennaPair, grids: Complexes
) -> list[EchoSet]:
    """Adds the echoes over two round bodies to the delay grids, but for those too faint beside what these hold."""
    narrow = np.sqrt(context.spec.wavelength_m * context.gate[1] / 2)
    bodies, together = bodies_of(quadrics, narrow), antennas.monostatic
    if len(bodies.radii) < 2:
        return []
    which, weights, gaps = seen_bodies(context, bodies, antennas, BODIES)
    if len(which) < 2:
        return []
    one, other = np.repeat(which, len(which)), np.tile(which, len(which))
    between = apart(bodies.take(one), bodies.take(other))
    legs = np.stack([gaps[0, one] - bodies.radii[one], gaps[1, other] - bodies.radii[other],
                     between - bodies.radii[one] - bodies.radii[other]])  # fmt: skip
    most = bodies.radii[one] * bodies.radii[other] / (4 * np.maximum(legs, 1e-3).prod(0) * legs.sum(0))
    seen = replace(antennas, factor=2 * antennas.factor) if together else antennas
    least = FAINT * float(abs(grids).max())
    full = context.spec.wavelength_m / (4 * np.pi) * abs(seen.factor) * float(context.table.max()) ** 2
    loud = (most * full**2 > least**2) & ((one < other) if together else (one != other))
    if not loud.any():
        return []
    return _echoes_of(context, parts, seen, bodies, one[loud], other[loud], weights, least, grids)


def seen_bodies(
    context: RadarContext, bodies: Bodies, antennas: AntennaPair, count: int
) -> tuple[Longs, Floats, Floats]:
    """Which of all bodies (m) look largest, so many, what each counts, and how far both antennas are (2, m) [m]."""
    gaps = _gaps(bodies, antennas)
    look = np.where(gaps.min(0) < context.gate[1] + bodies.radii, bodies.radii / np.maximum(gaps.max(0), 1e-6), 0.0)
    return *choose_largest(look, count), gaps


@lru_cache(maxsize=8)  # asked twice in a frame
def _gaps(bodies: Bodies, antennas: AntennaPair) -> Floats:
    out = np.empty((2, len(bodies.radii)))
    flat.gaps(antennas.origins, bodies.centres, bodies.axes, bodies.ends, bodies.is_sphere, out)
    return out


def apart(first: Bodies, last: Bodies) -> Floats:
    """How far the middles or axes of bodies lie apart at the least (m) [m]; of parallel drums as far as they do."""
    lean = np.sqrt(np.maximum(1 - dot(first.axes[:, 2], last.axes[:, 2]) ** 2, 0.0)) * ~last.is_sphere
    return np.asarray(first.gaps(last.centres) - lean * last.ends[:, 1])


def _echoes_of(
    context: RadarContext,
    parts: list[Surfaces],
    antennas: AntennaPair,
    bodies: Bodies,
    one: Longs,
    other: Longs,
    weights: Floats,
    least: float,
    grids: Complexes,
) -> list[EchoSet]:
    """The echoes over pairs of bodies (m), but for those less than a path gain amplitude."""
    first, last = bodies.take(one), bodies.take(other)
    paths = paths_over(antennas.origins[0], antennas.origins[1], first, last)
    wavelength = context.spec.wavelength_m
    value = wavelength / (4 * np.pi) * antennas.factor * paths.spread * weights[one] * weights[other]
    value[(abs(value) * float(context.table.max()) ** 2 <= least) | (paths.length >= 2 * context.gate[1])] = 0
    near = np.flatnonzero(value)  # most are too faint now that their bends are known, and need not be followed
    if not len(near):
        return []
    paths, first, last = paths.take(near), first.take(near), last.take(near)
    path = _real(first, last, paths)
    value = value[near] * turned(context, antennas, path)
    for k, body in enumerate((first, last)):
        value = value * covered(body, paths.corners[1 + k], paths.bends[:, k], wavelength)
    value = value * (abs(value) > least) * free(parts, path)
    via = np.stack([first.object_ids, np.full(len(near), -1)], 1).astype(np.int64)
    echo = accumulate(context, paths.length / C0, value, grids, (0.0, 1.0))

    def again(factors: Complexes, others: Complexes) -> None:
        accumulate(context, paths.length / C0, value * factors, others, (0.0, 1.0))

    return [EchoSet(last.object_ids, paths.corners[2], echo, paths.length / C0, again, via)]


def _real(first: Bodies, last: Bodies, paths: Paths) -> Real:
    """Paths as they run, corners beyond the ends of drums drawn onto them."""
    corners = paths.corners.copy()
    for k, body in enumerate((first, last)):
        corners[1 + k] = drawn(body, corners[1 + k])
    return Real(
        corners,
        paths.normals,
        np.stack([first.depths, last.depths]),
        np.stack([first.object_ids, last.object_ids]),
        np.ones(len(paths.length), bool),
    )


def drawn(body: Bodies, points: Floats) -> Floats:
    """Points (m, 3) on bodies, those beyond the ends of drums drawn onto them."""
    up = dot(points - body.centres, body.axes[:, 2])
    inner = np.where(body.is_sphere, up, np.clip(up, body.ends[:, 0] + PULL_M, body.ends[:, 1] - PULL_M))
    return np.asarray(points + (inner - up)[:, None] * body.axes[:, 2])


def covered(body: Bodies, points: Floats, bends: Floats, wavelength: float) -> Complexes:
    """What the ends of drums leave of waves (m) at points (m, 3), by Fresnel's integral along the axis."""
    along = dot(points - body.centres, body.axes[:, 2])
    return ends_leave(body.ends, body.is_sphere, along, bends, wavelength)


def ends_leave(ends: Floats, is_sphere: Bools, along: Floats, bends: Floats, wavelength: float) -> Complexes:
    """What ends (m, 2) [m] leave of waves (m) at places along the axis [m] where paths bend so; balls have none."""
    sine, cosine = fresnel((ends - along[:, None]) * np.sqrt(2 * bends / wavelength)[:, None])
    out = np.diff(cosine - 1j * sine, axis=1)[:, 0] / (1 - 1j)
    return np.where(is_sphere, 1.0, out)
