"""Echoes from one round body to another, balls and drums seen from outside, by geometrical optics.

Of each pair and order there is one path, the shortest that touches both; its spread is the determinant of the path's
second derivatives over both surfaces, of which an integral of stationary phase over both is made [BornWolf1999]. From
outside nothing focuses, so that is nowhere 0. What the ends of a drum leave of it is Fresnel's integral.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import fresnel

from ullage.geometry import C0
from ullage.kernels import pairs as kernel
from ullage.radar.antenna import gain
from ullage.radar.facets import Surfaces
from ullage.radar.laid import Laid
from ullage.radar.mirrors import across, dot, reflected, unit
from ullage.radar.multipath import most_looked
from ullage.radar.physical import Bench, View
from ullage.radar.rounds import Round
from ullage.radar.visibility import between
from ullage.radar.wall_bounces import deposit

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Longs = NDArray[np.int64]

BODIES = 8
"""Between so many bodies waves go, those that look largest; each fades in."""
FAINT = 5e-4
"""Pairs that do not make this share of a frame's strongest echo are left out."""
_STEPS = 12  # of Newton's method, at the most
_PULL_M = 4e-3  # points on bodies are looked at so far outside of their facets


@dataclass(frozen=True, slots=True, eq=False)
class Bodies:
    """Balls and drums, one for each row."""

    centres: Floats  # (m, 3) [m]
    axes: Floats  # (m, 3, 3) rows: two across the axis, and the axis
    radii: Floats  # (m) [m]
    ends: Floats  # (m, 2) of drums along the axis, from the centre [m]
    balls: NDArray[np.bool_]  # (m)
    depths: Floats  # (m) by so much facets lie off [m]
    stuffs: NDArray[np.int32]  # (m)

    def take(self, which: Longs) -> Bodies:
        """Some of them."""
        return Bodies(*(getattr(self, row)[which] for row in self.__slots__))


@lru_cache(maxsize=16)
def bodies_of(rounds: tuple[Round, ...], narrow: float) -> Bodies:
    """Round bodies as rows, those whose facets are narrower than this [m]."""
    rounds = tuple(r for r in rounds if r.widest < narrow)
    return Bodies(np.array([r.centre for r in rounds]), np.array([r.axes for r in rounds]),
                  np.array([r.radius for r in rounds]), np.array([(r.low, r.high) for r in rounds]),
                  np.array([r.ball for r in rounds]), np.array([r.depth for r in rounds]),
                  np.array([r.stuff for r in rounds], np.int32))  # fmt: skip


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
    """The shortest paths from one point (3) over the first bodies (m) and then the last (m) to another (3)."""
    many = len(first.radii)
    both = [np.stack([getattr(first, row), getattr(last, row)]) for row in ("centres", "axes", "radii", "balls")]
    corners, normals = np.empty((4, many, 3)), np.empty((2, many, 3))
    lengths, spreads, bends = np.empty(many), np.empty(many), np.empty((many, 2))
    kernel.shortest(start, stop, *both, _STEPS, corners, normals, lengths, spreads, bends, np.empty(76))
    return Paths(corners, normals, lengths, spreads, bends)


def lay_pairs(
    ready: Bench, parts: list[Surfaces], rounds: tuple[Round, ...], view: View, grids: Complexes
) -> list[Laid]:
    """Adds the echoes over two round bodies to the delay grids, but for those too faint beside what these hold."""
    narrow = np.sqrt(ready.spec.wavelength_m * ready.gate[1] / 2)
    bodies, together = bodies_of(rounds, narrow), bool((view.origins[0] == view.origins[1]).all())
    if len(bodies.radii) < 2:
        return []
    gaps = np.array([np.linalg.norm(bodies.centres - origin, axis=1) for origin in view.origins])
    look = np.where(gaps.min(0) < ready.gate[1] + bodies.radii, bodies.radii / gaps.max(0), 0.0)
    which, weights = most_looked(look, BODIES)
    if len(which) < 2:
        return []
    one, other = np.repeat(which, len(which)), np.tile(which, len(which))
    apart = np.linalg.norm(bodies.centres[one] - bodies.centres[other], axis=1)
    legs = np.stack([gaps[0, one] - bodies.radii[one], gaps[1, other] - bodies.radii[other],
                     apart - bodies.radii[one] - bodies.radii[other]])  # fmt: skip
    most = bodies.radii[one] * bodies.radii[other] / (4 * np.maximum(legs, 1e-3).prod(0) * legs.sum(0))
    seen = replace(view, factor=2 * view.factor) if together else view
    least = FAINT * float(abs(grids).max())
    full = ready.spec.wavelength_m / (4 * np.pi) * abs(seen.factor) * float(ready.table.max()) ** 2
    loud = (most * full**2 > least**2) & ((one < other) if together else (one != other))
    if not loud.any():
        return []
    return _laid(ready, parts, seen, bodies, one[loud], other[loud], weights, least, grids)


def _laid(
    ready: Bench, parts: list[Surfaces], view: View, bodies: Bodies, one: Longs, other: Longs, weights: Floats,
    least: float, grids: Complexes,
) -> list[Laid]:  # fmt: skip
    """The echoes over pairs of bodies (m), but for those less than a path gain amplitude."""
    first, last = bodies.take(one), bodies.take(other)
    paths = paths_over(view.origins[0], view.origins[1], first, last)
    wavelength = ready.spec.wavelength_m
    value = wavelength / (4 * np.pi) * view.factor * paths.spread * weights[one] * weights[other]
    value[(abs(value) * float(ready.table.max()) ** 2 <= least) | (paths.length >= 2 * ready.gate[1])] = 0
    near = np.flatnonzero(value)  # most are too faint now that their bends are known, and need not be followed
    if not len(near):
        return []
    paths, first, last = paths.take(near), first.take(near), last.take(near)
    value = value[near] * _turned(ready, view, first, last, paths)
    for k, body in enumerate((first, last)):
        value = value * _covered(body, paths.corners[1 + k], paths.bends[:, k], wavelength)
    value = value * (abs(value) > least) * _free(parts, first, last, paths)
    via = np.stack([first.stuffs, np.full(len(near), -1)], 1).astype(np.int64)
    echo = deposit(ready, paths.length / C0, value, grids, (0.0, 1.0))

    def again(factors: Complexes, others: Complexes) -> None:
        deposit(ready, paths.length / C0, value * factors, others, (0.0, 1.0))

    return [Laid(last.stuffs, paths.corners[2], echo, paths.length / C0, again, via)]


def _covered(body: Bodies, points: Floats, bends: Floats, wavelength: float) -> Complexes:
    """What the ends of drums leave of waves (m) at points (m, 3), by Fresnel's integral along the axis."""
    along = dot(points - body.centres, body.axes[:, 2])
    sine, cosine = fresnel((body.ends - along[:, None]) * np.sqrt(2 * bends / wavelength)[:, None])
    out = np.diff(cosine - 1j * sine, axis=1)[:, 0] / (1 - 1j)
    return np.where(body.balls, 1.0, out)


def _free(parts: list[Surfaces], first: Bodies, last: Bodies, paths: Paths) -> NDArray[np.bool_]:
    """Which paths (m) are free, and touch what is there."""
    stops = paths.corners[1:3].copy()
    for k, body in enumerate((first, last)):
        up = dot(stops[k] - body.centres, body.axes[:, 2])
        inner = np.where(body.balls, up, np.clip(up, body.ends[:, 0] + _PULL_M, body.ends[:, 1] - _PULL_M))
        stops[k] += (inner - up)[:, None] * body.axes[:, 2]
    lift = paths.normals * (np.stack([first.depths, last.depths]) + _PULL_M)[..., None]
    corners = np.concatenate([paths.corners[:1], stops + lift, paths.corners[3:]])
    here, there = np.concatenate([corners[:3], stops + lift]), np.concatenate([corners[1:], stops - lift])
    clear = between(parts, here.reshape(-1, 3), there.reshape(-1, 3)).reshape(5, -1)
    return np.asarray(clear[:3].all(0) & ~clear[3:].any(0))


def _turned(ready: Bench, view: View, first: Bodies, last: Bodies, paths: Paths) -> Complexes:
    """What the antennas and both reflections make of the waves (m)."""
    ways = np.stack([unit(way) for way in np.diff(paths.corners, axis=0)])
    field = across(view.fields[:1], ways[0]).astype(complex)
    for k, body in enumerate((first, last)):
        field = reflected(ready.gamma, body.stuffs, field, ways[k], paths.normals[k])
    total = gain(ready.spec.antenna, ways[0] @ view.frames[0].T) * gain(ready.spec.antenna, -ways[2] @ view.frames[1].T)
    return np.asarray(total * dot(field, across(view.fields[1:], ways[2])))
