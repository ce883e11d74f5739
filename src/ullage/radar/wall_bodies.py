"""Echoes over the wall of a round tank and a ball or drum that stands in it.

A concave wall gives up to three paths of stationary phase and focuses; a body seen from outside gives one path and
spreads. So the body is done by geometrical optics, for each line along the wall by itself: of the ways over the line
and the body there is one that is shortest, and its second derivatives are its spread [BornWolf1999]. Kirchhoff's
integral across those lines is the sum over them [LingChouLee1989], which is infinite nowhere and has all paths in it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.special import fresnel

from ullage.arrays import Bools, Complexes, Floats, Longs
from ullage.geometry import C0
from ullage.kernels import chains as kernel
from ullage.radar.body_pairs import BODIES, FAINT
from ullage.radar.context import AntennaPair, RadarContext
from ullage.radar.echo_set import EchoSet
from ullage.radar.facets import PlanarPatches, Surfaces
from ullage.radar.multipath import choose_largest
from ullage.radar.quadrics import Quadric
from ullage.radar.real_paths import Real, free, turned
from ullage.radar.wall_bounces import PULL_M, SAME_M, ZONES, Plane, accumulate, around, planes_of, swapped

Turn = tuple[Plane, int] | None
Chain = tuple[AntennaPair, bool, tuple[bool, ...], Turn]

WALL_FIRST = (True, False)
TO_AND_FRO = (False, True, False)
"""Which surfaces of a chain are the wall."""
_STEPS = 12  # of Newton's method, at the most
_TURN = 0.8  # the phase turns by no more from place to place [rad]
_CLOSE = 0.3  # lines along the wall lie this apart for a point a metre before it, closer for a nearer one
_FEWEST, _MOST = 64, 720  # so many lines


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Paths over each of some lines along the wall, all round."""

    walls: Bools  # (s) which surfaces are the wall
    corners: Floats  # (s + 2, n, 3) [m]
    normals: Floats  # (s, n, 3) of the surfaces, to where the waves are
    length: Floats  # (n) [m]
    slope: Floats  # (n) how fast that grows along the wall
    spread: Floats  # (n) what a source's wave is less at the end, but for the integral across the lines [m^-1.5]
    bends: Floats  # (s, n) second derivative along the axis of each surface, all else as it fits [1/m]
    near: float  # how far off the wall the nearer leg begins, both as one [m]


def accumulate_wall_bodies(
    context: RadarContext,
    parts: list[Surfaces],
    quadrics: tuple[Quadric, ...],
    planar: PlanarPatches,
    antennas: AntennaPair,
    most: int,
    look: Floats,
    grids: Complexes,
) -> list[EchoSet]:
    """Adds the echoes over the wall of a tank that the radar is in and one body in it to the delay grids.

    Two bounces; with three, another one at a floor or a roof across the axis, those that look largest (p), or from the
    body to the wall and back. What is too faint beside what the grids hold is left out.
    """
    out: list[EchoSet] = []
    one = antennas.monostatic and bool((antennas.fields[0] == antennas.fields[1]).all())
    least = FAINT * float(abs(grids).max())
    for wall in around(context, quadrics, antennas):
        planes = planes_of(planar, wall, look) if most > 2 else []
        for body, weight in _within(context, quadrics, wall, antennas):
            told = replace(antennas, factor=weight * antennas.factor)
            sides = [(replace(told, factor=2 * told.factor), False)] if one else [(told, False), (swapped(told), True)]
            chains: list[Chain] = [(side, back, WALL_FIRST, turn) for side, back in sides for turn in _turns(planes)]
            chains += [(told, False, TO_AND_FRO, None)] if most > 2 else []
            for side, back, walls, turn in chains:
                echoes = _over(context, parts, side, wall, body, walls, turn, least, grids)
                out += [] if echoes is None else [_reversed(echoes) if back else echoes]
    return out


def _turns(planes: list[Plane]) -> list[Turn]:
    """No plane at all; each of some, met before the body or after it."""
    return [None, *((plane, end) for plane in planes for end in (0, 1))]


def _within(
    context: RadarContext, quadrics: tuple[Quadric, ...], wall: Quadric, antennas: AntennaPair
) -> Iterator[tuple[Quadric, float]]:
    """The bodies within a wall that have both antennas outside, those that look largest, and what each counts."""
    narrow = np.sqrt(context.spec.wavelength_m * context.gate[1] / 2)
    bodies = [b for b in quadrics if b is not wall and b.widest < narrow and wall.holds(b) and _outside(b, antennas)]
    gaps = np.array([np.linalg.norm(antennas.origins - body.centre, axis=1).max() for body in bodies])
    which, weights = choose_largest(np.array([body.radius for body in bodies]) / gaps, BODIES)
    for k in which:
        yield bodies[k], float(weights[k])


def _outside(body: Quadric, antennas: AntennaPair) -> bool:
    x, y, z = body.local(antennas.origins).T
    away = np.sqrt(x * x + y * y + (z * z if body.is_sphere else 0.0))
    return bool((away > body.radius + body.depth + PULL_M).all())


def lines_over(wall: Quadric, body: Quadric, ends: Floats, walls: tuple[bool, ...]) -> Lines:
    """The shortest paths from one point (2, 3) [m] over each of many lines along a wall, and a body, to another."""
    many = len(walls)
    x, y, _ = wall.local(np.concatenate([ends, body.centre[None]])).T
    gaps = wall.radius - np.hypot(x, y) - [0.0, 0.0, body.radius]
    close = _CLOSE * max(float(gaps.min()), 0.1) ** 0.75  # so is a cubic between them right to a fraction of a wave
    count = int(np.clip(2 * np.pi * wall.radius / close, _FEWEST, _MOST))
    out, feet = _feet(wall, count)
    kinds, at = np.array(walls), walls.index(True)
    corners, normals = np.empty((many + 2, count, 3)), np.empty((many, count, 3))
    length, spread, slope, bends = *np.empty((3, count)), np.empty((many, count))
    rows, least = np.empty((16, 3)), np.empty(2)
    kernel.over_lines(
        ends, kernel.WallLines(kinds, feet, wall.axes[2]),
        kernel.RoundBody(body.centre, body.axes, body.radius, body.is_sphere), _STEPS,
        kernel.LinePaths(corners, normals, length, spread, bends), kernel.LineScratch(rows, np.empty((5, 9))),
    )  # fmt: skip
    kernel.beside(corners, at, out, wall.axes[2], spread, slope, least, rows)
    normals[at] = -out
    return Lines(kinds, corners, normals, length, slope, spread, bends, float(1 / (1 / least).sum()))


@lru_cache(maxsize=32)
def _feet(wall: Quadric, count: int) -> tuple[Floats, Floats]:
    """Unit vectors (n, 3) out from the axis all round a wall, and lines there, where they are level with its centre."""
    angle = (np.arange(count) + 0.5) * (2 * np.pi / count)
    out = np.stack([np.cos(angle), np.sin(angle)], 1) @ wall.axes[:2]
    return out, wall.centre + wall.radius * out


def _over(
    context: RadarContext,
    parts: list[Surfaces],
    antennas: AntennaPair,
    wall: Quadric,
    body: Quadric,
    walls: tuple[bool, ...],
    turn: Turn,
    least: float,
    grids: Complexes,
) -> EchoSet | None:
    """Lays the echo over one chain of surfaces, with a bounce at a plane across the axis or without."""
    ends = antennas.origins
    if turn is not None:
        heights = wall.local(ends)[:, 2] - turn[0].level
        if heights[0] * heights[1] <= 0:
            return None
        ends = ends.copy()
        ends[turn[1]] -= 2 * heights[turn[1]] * wall.axes[2]
    lines, wave = lines_over(wall, body, ends, walls), 2 * np.pi / context.spec.wavelength_m
    near = lines.length < 2 * context.gate[1]
    value = lines.spread * near * antennas.factor / (2 * wave) * np.sqrt(0.5j * wave / np.pi)
    around_ = _sampled(lines, wall.radius, wave, value != 0)
    if around_ is None:
        return None
    first, share, weights = around_
    loud = np.abs(value[first]) * weights
    if loud.sum() * float(context.table.max()) ** 2 < least:
        return None
    wanted = np.zeros(len(value), np.bool_)
    wanted[first] = wanted[(first + 1) % len(value)] = True
    asked = np.flatnonzero(wanted)
    path = _real(lines, wall, body, antennas.origins, turn, asked)
    seen = np.zeros(len(value), complex)
    seen[asked] = value[asked] * free(parts, path) * turned(context, antennas, path)
    seen[asked] *= _covered(lines, wall, body, asked, turn, context.spec.wavelength_m)
    return _deposited(context, lines, wall, path, asked, (first, share, weights), seen, grids)


def _sampled(lines: Lines, radius: float, wave: float, there: Bools) -> tuple[Longs, Floats, Floats] | None:
    """Places for the sum along the wall: after which line, by what share of the way to the next, and what each counts.

    All about points of stationary phase, as far as the phase runs ahead by half of `ZONES` at the least.
    """
    count = len(lines.length)
    step, cut = 2 * np.pi * radius / count, min(float(np.sqrt(ZONES / (wave * lines.near))), 2.0)
    many = int(step * wave * cut / _TURN) + 2
    first, (share, weights) = np.empty(count * many, np.int64), np.empty((2, count * many))
    places = kernel.WallPlaces(first, share, weights)
    made = kernel.sampled(lines.length, lines.slope, there, step, cut, many, places)
    return (first[:made], share[:made], weights[:made]) if made else None


def _real(lines: Lines, wall: Quadric, body: Quadric, origins: Floats, turn: Turn, asked: Longs) -> Real:
    """Some paths (n), what lies beyond a plane brought back; corners beyond ends of round things drawn onto them."""
    corners, normals = lines.corners[:, asked], lines.normals[:, asked]
    kinds = np.repeat(np.where(lines.walls, 0, 1)[:, None], len(asked), 1)  # wall, body, plane
    there, plane_object_id = np.ones(len(asked), bool), -1
    if turn is not None:
        plane, end = turn
        back = slice(None, None, -1 if end else 1)  # as seen from the end that is an image
        side = float(np.sign(wall.local(origins[end])[2] - plane.level))
        corners, normals, kinds, there = _unfolded(wall, plane, side, corners[back], normals[back], kinds[back])
        corners, normals, kinds, plane_object_id = corners[back], normals[back], kinds[back], plane.object_id
    corners = corners.copy()
    for kind, thing in enumerate((wall, body)):
        if not thing.is_sphere:
            up = (corners[1:-1] - thing.centre) @ thing.axes[2]
            inner = np.clip(up, thing.low + PULL_M, thing.high - PULL_M)
            corners[1:-1] += np.where(kinds == kind, inner - up, 0.0)[..., None] * thing.axes[2]
    depths, object_ids = (
        np.array([wall.depth, body.depth, 0.0]),
        np.array([wall.object_id, body.object_id, plane_object_id]),
    )
    return Real(corners, normals, depths[kinds], object_ids[kinds], there)


def _unfolded(
    wall: Quadric, plane: Plane, side: float, corners: Floats, normals: Floats, kinds: Longs
) -> tuple[Floats, Floats, Longs, Bools]:
    """Paths (n) that begin beyond a plane across the axis as they run, turned back at it, and whether that may be."""
    axis = side * wall.axes[2]
    gaps = (corners - wall.centre) @ axis - side * plane.level
    late = (gaps[1] < 0) & (kinds[0] == 0)  # the wall's own image is met first
    a, b = (np.where(late[:, None], corners[k + 1], corners[k]) for k in (0, 1))
    gap, then = (np.where(late, gaps[k + 1], gaps[k]) for k in (0, 1))
    foot = a + (gap / np.where(gap < then, gap - then, -1.0))[:, None] * (b - a)
    begin, first = (corners[k] - 2 * gaps[k][:, None] * axis for k in (0, 1))
    swap, flat = late[:, None], np.broadcast_to(axis, foot.shape)
    stops = [np.where(swap, first, foot), np.where(swap, foot, corners[1]), *corners[2:]]
    faces = [np.where(swap, normals[0], flat), np.where(swap, flat, normals[0]), *normals[1:]]
    floor = np.full(len(late), 2)
    which = [np.where(late, kinds[0], floor), np.where(late, floor, kinds[0]), *kinds[1:]]
    there = (gap < 0) & (then > 0) & (gaps[2:] > 0).all(0)
    return np.stack([begin, *stops]), np.stack(faces), np.stack(which), there


def _covered(lines: Lines, wall: Quadric, body: Quadric, asked: Longs, turn: Turn, wavelength: float) -> Complexes:
    """What the ends of wall and drum leave of the waves (n), by Fresnel's integral along their axes.

    The wall's end that stands on a plane which is met beside the wall is none: beyond it the wall's image goes on.
    """
    total = np.ones(len(asked), complex)
    for s, on_wall in enumerate(lines.walls):
        thing = wall if on_wall else body
        if thing.is_sphere:
            continue
        along = (lines.corners[1 + s, asked] - thing.centre) @ thing.axes[2]
        root, ends = np.sqrt(np.maximum(2 * lines.bends[s, asked], 0.0) / wavelength), []
        for sign, end in ((-1, thing.low), (1, thing.high)):
            beside = on_wall and turn is not None and s == (0, len(lines.walls) - 1)[turn[1]]
            if beside and turn is not None and abs(end - turn[0].level) < SAME_M:
                ends.append(np.full(len(along), sign * (0.5 - 0.5j)))
            else:
                sine, cosine = fresnel((end - along) * root)
                ends.append(cosine - 1j * sine)
        total *= (ends[1] - ends[0]) / (1 - 1j)
    return total


def _deposited(
    context: RadarContext, lines: Lines, wall: Quadric, path: Real, asked: Longs, places: tuple[Longs, Floats, Floats],
    seen: Complexes, grids: Complexes,
) -> EchoSet:  # fmt: skip
    """Lays the sum over places along the wall; told as one echo for each point of stationary phase."""
    first, share, _ = places
    value, (length, slope) = np.empty(len(first), complex), np.empty((2, len(first)))
    step = 2 * np.pi * wall.radius / len(seen)
    kernel.summed(lines.length, lines.slope, step, seen, kernel.WallPlaces(*places), value, length, slope)
    echo = accumulate(context, length / C0, value, grids, (0.5, 0.5))
    leads = np.flatnonzero((slope[:-1] * slope[1:] <= 0) & ((first[1:] - first[:-1]) % len(seen) <= 1))
    leads = leads if len(leads) else np.array([abs(slope).argmin()])
    count = len(leads)
    led, total = np.empty(len(first), np.int64), np.empty(count, complex)
    kernel.gathered(first, share, leads, len(seen), echo, led, total)
    at = np.searchsorted(asked, first[leads])
    names = path.object_ids[:, at]
    via = np.full((count, 2), -1, np.int64)
    via[:, : len(names) - 1] = names[:-1].T

    def again(factors: Complexes, others: Complexes) -> None:
        accumulate(context, length / C0, value * factors[led], others, (0.5, 0.5))

    return EchoSet(names[-1].astype(np.int32), path.corners[-2, at], total, length[leads] / C0, again, via)


def _reversed(echoes: EchoSet) -> EchoSet:
    """Echoes traced from the receiver, as the wave runs: it meets last what was traced first."""
    via = np.array([[b, a] if b >= 0 else [a, b] for a, b in np.asarray(echoes.via)], np.int64)
    return replace(echoes, via=via, before=np.zeros(len(via), np.int64))
