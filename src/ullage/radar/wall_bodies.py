"""Echoes over the wall of a cylindrical tank and a sphere or drum inside it.

A concave wall gives up to three paths of stationary phase and focuses. A body seen from outside gives one path and
spreads the wave. So geometrical optics treats the body, separately for each line along the wall: one path over the line
and the body is the shortest, and its second derivatives give the spreading [BornWolf1999]. Kirchhoff's integral across
those lines is the sum over them [LingChouLee1989]. It is finite everywhere and includes all paths.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ullage.arrays import Bools, Complexes, Floats, Longs
from ullage.kernels import chains as kernel
from ullage.kernels.fermat import LINE, Reflectors
from ullage.radar.context import AntennaPair, RadarContext
from ullage.radar.echo_set import EchoSet
from ullage.radar.facets import PlanarPatches, Surfaces
from ullage.radar.fermat import SELECTIONS, fermat_paths
from ullage.radar.multipath import choose_largest
from ullage.radar.quadrics import Quadric
from ullage.radar.reflected_paths import (
    PathSum,
    ReflectedPaths,
    accumulate_paths,
    end_factors,
    free,
    reflection_gains,
    stationary,
)
from ullage.radar.reflectors import PULL_M, ReflectorSet, bodies_of, joined, points_of
from ullage.radar.wall_bounces import ZONES, Plane, around, both_sides, planes_of, reflectors_in

Turn = tuple[Plane, int] | None

WALL_FIRST = (True, False)
TO_AND_FRO = (False, True, False)
"""Order of the surfaces of a path: True for the wall, False for the body."""
_TURN = 0.8  # largest phase difference between neighbouring places [rad]
_CLOSE = 0.3  # spacing of lines along the wall for a point 1 m in front of it [m]; less for a nearer one
_FEWEST, _MOST = 64, 720  # number of lines


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """The order in which a path meets wall, body and plane."""

    antennas: AntennaPair
    back: bool  # traced from the receiver
    walls: tuple[bool, ...]  # order of wall and body
    turn: Turn = None  # plane across the axis, and the end of the path at which it is met


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Paths over lines along the wall, around the whole circle."""

    walls: Bools  # (s) whether each surface is the wall
    corners: Floats  # (s + 2, n, 3) [m]
    normals: Floats  # (s, n, 3) of the surfaces, towards the waves
    length: Floats  # (n) [m]
    slope: Floats  # (n) derivative of the length along the wall
    spread: Floats  # (n) spreading factor without the integral across the lines [m^-1.5]
    bends: Floats  # (s, n) second derivative along the axis of each surface, minimised over the rest [1/m]
    near: float  # harmonic sum of the shortest legs before and after the wall [m]


def accumulate_wall_bodies(
    context: RadarContext,
    parts: list[Surfaces],
    quadrics: tuple[Quadric, ...],
    planar: PlanarPatches,
    antennas: AntennaPair,
    most: int,
    sizes: Floats,
    grids: Complexes,
) -> list[EchoSet]:
    """Add the echoes over the wall of a tank that contains the radar and one body in it to the delay grids.

    Paths have two bounces. With three, the additional bounce is at a floor or a roof across the axis among those of the
    largest apparent `sizes` (p), or the path goes from the body to the wall and back. Echoes that are too weak against
    those in the grids are left out.
    """
    out: list[EchoSet] = []
    least = SELECTIONS[2].faint * float(abs(grids).max())
    for wall in around(context, quadrics, antennas):
        planes = planes_of(planar, wall, sizes) if most > 2 else []
        for body, weight in _within(context, quadrics, wall, antennas):
            pair = replace(antennas, factor=weight * antennas.factor)
            chains = [Chain(side, back > 0, WALL_FIRST, turn) for back, side in enumerate(both_sides(pair))
                      for turn in _turns(planes)]  # fmt: skip
            chains += [Chain(pair, False, TO_AND_FRO)] if most > 2 else []
            for chain in chains:
                echoes = _over(context, parts, chain, wall, body, least, grids)
                out += [] if echoes is None else [echoes]
    return out


def _turns(planes: list[Plane]) -> list[Turn]:
    """List the turns: no plane, and each plane at either end of the path."""
    return [None, *((plane, end) for plane in planes for end in (0, 1))]


def _within(
    context: RadarContext, quadrics: tuple[Quadric, ...], wall: Quadric, antennas: AntennaPair
) -> Iterator[tuple[Quadric, float]]:
    """Find the bodies inside a wall with both antennas outside them, of the largest apparent sizes, with weights."""
    narrow = np.sqrt(context.spec.wavelength_m * context.gate[1] / 2)
    bodies = [b for b in quadrics if b is not wall and b.widest < narrow and wall.holds(b) and _outside(b, antennas)]
    gaps = np.array([np.linalg.norm(antennas.origins - body.centre, axis=1).max() for body in bodies])
    which, weights = choose_largest(np.array([body.radius for body in bodies]) / gaps, SELECTIONS[2].bodies)
    for k in which:
        yield bodies[k], float(weights[k])


def _outside(body: Quadric, antennas: AntennaPair) -> bool:
    x, y, z = body.local(antennas.origins).T
    away = np.sqrt(x * x + y * y + (z * z if body.is_sphere else 0.0))
    return bool((away > body.radius + body.depth + PULL_M).all())


def lines_over(wall: Quadric, body: Quadric, ends: Floats, walls: tuple[bool, ...]) -> Lines:
    """Find the shortest paths from one point (2, 3) [m] over each line along a wall, and a body, to another."""
    many = len(walls)
    x, y, _ = wall.local(np.concatenate([ends, body.centre[None]])).T
    gaps = wall.radius - np.hypot(x, y) - [0.0, 0.0, body.radius]
    close = (
        _CLOSE * max(float(gaps.min()), 0.1) ** 0.75
    )  # a cubic between lines is then right to a fraction of a wavelength
    count = int(np.clip(2 * np.pi * wall.radius / close, _FEWEST, _MOST))
    out, lines = _lines(wall, count)
    kinds, at = np.array(walls), walls.index(True)
    surfaces = joined([points_of(ends), bodies_of((body,)), lines]).surfaces
    rows = np.empty((count, many + 2), np.int64)
    rows[:, 0], rows[:, -1], rows[:, 1:-1] = 0, 1, np.where(kinds, 3 + np.arange(count)[:, None], 2)
    found, least = fermat_paths(surfaces, rows, follow=True), np.empty(2)
    slope = np.empty(count)
    kernel.beside(found.corners, at, out, wall.axes[2], found.spreads, slope, least, np.empty((3, 3)))
    found.normals[at] = -out
    return Lines(kinds, found.corners, found.normals, found.lengths, slope, found.spreads, found.bends,
                 float(1 / max((1 / least).sum(), 1e-12)))  # fmt: skip


@lru_cache(maxsize=32)
def _lines(wall: Quadric, count: int) -> tuple[Floats, ReflectorSet]:
    """Return unit vectors (n, 3) from the axis of a wall, and the lines along the wall there, level with its centre."""
    angle = (np.arange(count) + 0.5) * (2 * np.pi / count)
    out = np.stack([np.cos(angle), np.sin(angle)], 1) @ wall.axes[:2]
    axes = np.tile(wall.axes, (count, 1, 1))
    lines = Reflectors(np.full(count, LINE), wall.centre + wall.radius * out, axes, np.zeros(count),
                       np.tile([wall.low, wall.high], (count, 1)))  # fmt: skip
    return out, ReflectorSet(lines, np.zeros(count), np.full(count, wall.object_id))


def _over(
    context: RadarContext,
    parts: list[Surfaces],
    chain: Chain,
    wall: Quadric,
    body: Quadric,
    least: float,
    grids: Complexes,
) -> EchoSet | None:
    """Add the echo over one chain of surfaces, with or without a bounce at a plane across the axis."""
    antennas, turn = chain.antennas, chain.turn
    ends = antennas.origins
    if turn is not None:
        heights = wall.local(ends)[:, 2] - turn[0].level
        if heights[0] * heights[1] <= 0:
            return None
        ends = ends.copy()
        ends[turn[1]] = turn[0].image(wall, ends[turn[1]])
    lines, wave = lines_over(wall, body, ends, chain.walls), 2 * np.pi / context.spec.wavelength_m
    near = lines.length < 2 * context.gate[1]
    value = lines.spread * near * antennas.factor / (2 * wave) * np.sqrt(0.5j * wave / np.pi)
    around_ = _sampled(lines, wall.radius, wave, value != 0)
    if around_ is None:
        return None
    first, _, weights = around_
    loud = np.abs(value[first]) * weights
    if loud.sum() * float(context.table.max()) ** 2 < least:
        return None
    wanted = np.zeros(len(value), np.bool_)
    wanted[first] = wanted[(first + 1) % len(value)] = True
    wanted_lines = np.flatnonzero(wanted)
    path = _paths(lines, wall, body, turn, wanted_lines)
    left = end_factors(path, context.spec.wavelength_m)
    path = path.within_ends()
    seen = np.zeros(len(value), complex)
    seen[wanted_lines] = value[wanted_lines] * left * free(parts, path) * reflection_gains(context, antennas, path)
    parts_of, at = _summed(lines, 2 * np.pi * wall.radius / len(value), around_, seen)
    path = path.take(np.searchsorted(wanted_lines, at))
    return accumulate_paths(context, path.reversed() if chain.back else path, parts_of, grids)


def _sampled(lines: Lines, radius: float, wave: float, there: Bools) -> tuple[Longs, Floats, Floats] | None:
    """Choose places for the sum along the wall: line before each, share of the distance to the next line, and weight.

    They surround the points of stationary phase, to a phase of at least half of `ZONES`.
    """
    count = len(lines.length)
    step, cut = 2 * np.pi * radius / count, min(float(np.sqrt(ZONES / (wave * lines.near))), 2.0)
    many = int(step * wave * cut / _TURN) + 2
    first, (share, weights) = np.empty(count * many, np.int64), np.empty((2, count * many))
    places = kernel.WallPlaces(first, share, weights)
    made = kernel.sampled(lines.length, lines.slope, there, step, cut, many, places)
    return (first[:made], share[:made], weights[:made]) if made else None


def _paths(lines: Lines, wall: Quadric, body: Quadric, turn: Turn, wanted_lines: Longs) -> ReflectedPaths:
    """Return some geometric paths (n), reflected at a plane if there is one."""
    plane, end = turn or (None, 0)
    above = plane is None or wall.local(lines.corners[-1 if end == 0 else 0, 0])[2] > plane.level
    reflectors = reflectors_in(wall, (body,), plane, above=above, goes_on=bool(lines.walls[-end]))
    on = np.repeat(np.where(lines.walls, 0, 1)[:, None], len(wanted_lines), 1)
    path = ReflectedPaths(lines.corners[:, wanted_lines], lines.normals[:, wanted_lines], on,
                          lines.bends[:, wanted_lines], reflectors, np.ones(len(wanted_lines), bool))  # fmt: skip
    if plane is None:
        return path
    path = (path.reversed() if end else path).folded(2, on[:: -1 if end else 1] == 0)
    return path.reversed() if end else path


def _summed(lines: Lines, step: float, places: tuple[Longs, Floats, Floats], seen: Complexes) -> tuple[PathSum, Longs]:
    """Return the sum over places along the wall, from line to line so far [m], and the lines before those that lead."""
    first, share, _ = places
    value, (length, slope) = np.empty(len(first), complex), np.empty((2, len(first)))
    kernel.summed(lines.length, lines.slope, step, seen, kernel.WallPlaces(*places), value, length, slope)
    leads, led = stationary((first + share) / len(seen), slope, 1 / len(seen))
    return PathSum(length, value, leads, led, (0.5, 0.5)), first[leads]
