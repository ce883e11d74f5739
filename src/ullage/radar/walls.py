"""Echoes over the walls inside round tanks and balls, and over bodies in tanks.

A concave wall gives several paths of stationary phase and focuses. So Kirchhoff's integral over the last wall of a path
is a sum over lines along the wall [LingChouLee1989]. It is finite everywhere and includes all paths. Each line has one
path:

1. Rays leave one antenna all round the axis. Geometrical optics reflects them at the walls before the last
   [Deschamps1972] and follows the width of each ray tube and the caustics that it passes [KravtsovOrlov1993]. To the
   line the wave comes from a point straight behind the last wall, as far as the ray is long.
2. The path from there over the line, and over a body, is the shortest, and its second derivatives give the spreading
   [BornWolf1999]. A body before the wall is met in the same way.
3. Where a tube has no width on the last wall, the integral is wrong. It may equally run over the first wall, from the
   other antenna. So each path is shared between both integrals, by the width of its tube and the distance of the
   antenna at each.

A floor or roof across the axis reverses the path along the axis. It adds one bounce, at the height given by its image.
In a ball each ray from a point off the centre stays in one plane through the centre. So the rays are those inside a
circle, rotated about the line to the centre. Across the plane the width of a tube is its distance from that line.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product

import numpy as np

from ullage.arrays import Bools, Complexes, Floats, Longs
from ullage.kernels import chains as kernel
from ullage.kernels import fermat
from ullage.radar.context import AntennaPair, RadarContext, RadarFrame
from ullage.radar.echo_set import EchoSet
from ullage.radar.facets import PlanarPatches
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
from ullage.radar.reflectors import PULL_M, ReflectorSet, bodies_of, joined, plane_set, points_of
from ullage.radar.sphere_echoes import bistatic_phase_rad
from ullage.radar.spheres import Sphere

LEAST_M = 0.25
"""Least radius [m]: narrower pipes are wave guides, not mirrors."""
ZONES = 50.0
"""Twice the phase at which the sum over a wall fades out [rad]."""
FLOORS = 2
"""Most planes across the axis that reflect, in the order of their faces' apparent sizes."""
SAME_M = 0.01
"""Planes that are closer than this count as one [m]."""
WALL_FIRST = (True, False)
TO_AND_FRO = (False, True, False)
"""Order of the surfaces of a path: True for the wall, False for the body."""
_TURN = 0.8  # largest phase difference between neighbouring places [rad]
_CLOSE = 0.3  # spacing of lines along the wall for a point 1 m in front of it [m]; less for a nearer one
_FEWEST, _MOST = 64, 720  # number of lines
_PLANES = 8  # through the line from the centre of a ball to the radar
_WHOLE = 0.9  # least share of a whole sphere: no model here covers the rim of a bowl
_NEAR_M = 0.05  # least distance to the wall of a ball for rays [m]
_EVERY = 4  # in balls, visibility and fields are computed for one of this many rays


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A floor or a roof across the axis of a cylinder."""

    level: float  # along the axis [m]
    object_id: int  # object

    def image(self, wall: Quadric, point: Floats) -> Floats:
        """Return the mirror image of a point (3) [m]."""
        return np.asarray(point + 2 * (self.level - wall.local(point)[2]) * wall.axes[2])


Turn = tuple[Plane, int] | None


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """The order in which a path meets walls, body and plane."""

    antennas: AntennaPair
    back: bool  # traced from the receiver
    walls: tuple[bool, ...]  # order of walls and body
    turn: Turn = None  # plane across the axis, and the end of the path at which it is met


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Paths over lines along the last wall, around the whole circle or in the order of the rays that lead there."""

    walls: Bools  # (s) whether each surface is the wall
    corners: Floats  # (s + 2, n, 3) [m]
    normals: Floats  # (s, n, 3) of the surfaces, towards the waves
    length: Floats  # (n) [m]
    slope: Floats  # (n) derivative of the length along the wall
    rate: Floats  # (n) how far apart lines are, over what equal steps around the circle would make
    spread: Complexes  # (n) spreading factor without the integral across the lines, times the rate [m^-1.5]
    bends: Floats  # (s, n) second derivative along the axis of each surface, minimised over the rest [1/m]
    near: Floats  # (n) harmonic sum of the legs, or the shortest ones, before and after the wall [m]


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """Rays (n) in all directions around the axis of a circle, up to their last wall."""

    points: Floats  # (b, n, 3) reflection points, from the axis [m]
    along: Floats  # (b, n) path length up to each, across the axis [m]
    rate: Floats  # (n) as of `Lines`
    factor: Complexes  # (n) what becomes of the spread of a wave from a point as far away, times the rate


def accumulate_walls(frame: RadarFrame) -> list[EchoSet]:
    """Add the echoes over the walls of tanks around the radar, and over a body in them, to the delay grids.

    Paths have two bounces. With three, the additional bounce is at the wall, at a floor or a roof among those of the
    largest apparent sizes, or the path goes from the body to the wall and back. Echoes that are too weak against
    those in the grids are left out.
    """
    least = SELECTIONS[2].faint * float(abs(frame.grids).max())
    echoes = [_over(frame, chain, wall, body, least)
              for wall in _around(frame)
              for body, chain in _chains(frame, wall)]  # fmt: skip
    return [echo for echo in echoes if echo is not None]


def _chains(frame: RadarFrame, wall: Quadric) -> Iterator[tuple[Quadric | None, Chain]]:
    """List the chains over a wall, with the body that each meets."""
    most, antennas = frame.max_bounces, frame.antennas
    planes = planes_of(frame.planar, wall, frame.sizes) if most > 2 else []
    for back, side in enumerate(_both_sides(antennas)):
        for bounces in range(2, most + 1):
            yield None, Chain(side, back > 0, (True,) * bounces)
        for plane in planes:  # from the other side it is met at the other end
            yield None, Chain(side, back > 0, (True, True), (plane, 0))
    for body, weight in _within(frame, wall):
        pair = replace(antennas, factor=weight * antennas.factor)
        for back, side in enumerate(_both_sides(pair)):
            for turn in (None, *product(planes, (0, 1))):
                yield body, Chain(side, back > 0, WALL_FIRST, turn)
        if most > 2:
            yield body, Chain(pair, False, TO_AND_FRO)


def _both_sides(antennas: AntennaPair) -> list[AntennaPair]:
    """List the radar and the one that sends from its receiver; they are one, twice as strong, if they do not differ."""
    if antennas.reversible:
        return [replace(antennas, factor=2 * antennas.factor)]
    return [antennas, antennas.swapped()]


def _around(frame: RadarFrame) -> Iterator[Quadric]:
    """Find the walls around both antennas with their far side within the gate and facets too narrow for mirrors."""
    gate_m, narrow = frame.context.gate[1], frame.context.widest_m
    for wall in frame.quadrics:
        if not wall.is_sphere and wall.radius > LEAST_M and wall.widest < narrow and 2 * wall.radius < gate_m:
            places = wall.local(frame.antennas.origins)
            if (np.hypot(places[:, 0], places[:, 1]) < wall.radius - wall.depth - PULL_M).all():
                yield wall


def planes_of(planar: PlanarPatches, wall: Quadric, sizes: Floats) -> list[Plane]:
    """Find floors and roofs: planes of faces across the axis, in the order of apparent sizes (p)."""
    level = np.flatnonzero((abs(planar.normals @ wall.axes[2]) > 1 - 1e-6) & (sizes > 0))
    found: list[Plane] = []
    for face in level[np.argsort(-sizes[level], kind="stable")]:
        height = float(wall.local(planar.starts[planar.first[face]])[2])
        if all(abs(height - plane.level) > SAME_M for plane in found):
            found.append(Plane(height, int(planar.object_ids[face])))
        if len(found) == FLOORS:
            break
    return found


def _within(frame: RadarFrame, wall: Quadric) -> Iterator[tuple[Quadric, float]]:
    """Find the bodies inside a wall with both antennas outside them, of the largest apparent sizes, with weights."""
    narrow, antennas = frame.context.widest_m, frame.antennas
    bodies = [
        b for b in frame.quadrics if b is not wall and b.widest < narrow and wall.holds(b) and _outside(b, antennas)
    ]
    gaps = np.array([np.linalg.norm(antennas.origins - body.centre, axis=1).max() for body in bodies])
    which, weights = choose_largest(np.array([body.radius for body in bodies]) / gaps, SELECTIONS[2].bodies)
    for k in which:
        yield bodies[k], float(weights[k])


def _outside(body: Quadric, antennas: AntennaPair) -> bool:
    away = np.linalg.norm(body.radial(antennas.origins), axis=1)
    return bool((away > body.radius + body.depth + PULL_M).all())


def lines_over(
    wall: Quadric, body: Quadric | None, ends: Floats, walls: tuple[bool, ...], count: int | None = None
) -> Lines:
    """Find the shortest paths from one point (2, 3) [m] over each line along a wall, and a body, to another.

    Walls before the last are met by rays. There are `count` lines, or so many that a cubic between them is right to a
    fraction of a wavelength.
    """
    kinds, at, bodies = np.array(walls), int(np.flatnonzero(walls)[-1]), () if body is None else (body,)
    before = sum(walls[:at])
    if count is None:  # close to a wall rays spread over all of it, and are as even as from afar
        count = (1 + before) * min(_count(wall, bodies, ends), 2 * _FEWEST if before else _MOST)
    if before:
        rays, starts = _rays(wall, ends, before + 1, count)
        out, lines = _lines(wall, rays.points[-1])
    else:
        starts = ends[:1]
        out, lines = _even_lines(wall, count)
    # rows of reflectors: where the paths start, where they end, the body, and the lines
    surfaces = joined([points_of(np.concatenate([starts, ends[1:]])), bodies_of(bodies), lines]).surfaces
    rows = np.empty((count, len(walls) - before + 2), np.int64)
    rows[:, 0], rows[:, -1] = np.arange(count) if before else 0, len(starts)
    rows[:, 1:-1] = len(surfaces.kinds) - count + np.where(kinds[before:], np.arange(count)[:, None], -1)
    found, least, slope = fermat_paths(surfaces, rows, follow=True), np.empty(2), np.empty(count)
    kernel.beside(found.corners, at - before, out, wall.axes[2], found.spreads, slope, least, np.empty((3, 3)))
    found.normals[at - before] = -out
    if before:
        return _with_rays(wall, rays, ends[0], kinds, found, slope)
    spread, near = found.spreads.astype(complex), np.full(count, 1 / max((1 / least).sum(), 1e-12))
    return Lines(kinds, found.corners, found.normals, found.lengths, slope, np.ones(count), spread, found.bends, near)


def _count(wall: Quadric, bodies: tuple[Quadric, ...], ends: Floats) -> int:
    """Choose the number of lines by the least gap between a wall and what is in it."""
    gaps = [wall.radius - np.hypot(*wall.local(place)[:2]) for place in ends]
    gaps += [wall.radius - np.hypot(*wall.local(body.centre)[:2]) - body.radius for body in bodies]
    close = _CLOSE * max(float(min(gaps)), 0.1) ** 0.75
    return int(np.clip(2 * np.pi * wall.radius / close, _FEWEST, _MOST))


@lru_cache(maxsize=32)
def _even_lines(wall: Quadric, count: int) -> tuple[Floats, ReflectorSet]:
    """Return `_lines` at equal steps around a wall."""
    angle = (np.arange(count) + 0.5) * (2 * np.pi / count)
    return _lines(wall, wall.radius * np.stack([np.cos(angle), np.sin(angle)], 1) @ wall.axes[:2])


def _lines(wall: Quadric, places: Floats) -> tuple[Floats, ReflectorSet]:
    """Return unit vectors (n, 3) to places (n, 3) from the axis of a wall, and lines there, level with its centre."""
    count = len(places)
    lines = fermat.Reflectors(np.full(count, fermat.LINE), wall.centre + places, np.tile(wall.axes, (count, 1, 1)),
                              np.zeros(count), np.tile([wall.low, wall.high], (count, 1)))  # fmt: skip
    return places / wall.radius, ReflectorSet(lines, np.zeros(count), np.full(count, wall.object_id))


def _rays(wall: Quadric, ends: Floats, walls: int, count: int) -> tuple[Rays, Floats]:
    """Trace rays from the first of two points (2, 3) over so many walls; return the points (n, 3) behind the last."""
    radius, ((x, y, z), (to_x, to_y, _)) = wall.radius, wall.local(ends)
    angle = (np.arange(count) + 0.5) * (2 * np.pi / count)
    points, legs, slopes = np.empty((walls, count, 2)), np.empty((walls, count)), np.empty((walls, count))
    u, v, slope = np.cos(angle), np.sin(angle), np.zeros(count)
    width, bend, caustics = np.zeros(count), np.ones(count), np.zeros(count, np.int64)
    for k in range(walls):
        if k:
            u, v, bend = u - 2 * slope * x / radius, v - 2 * slope * y / radius, bend - 2 * width / (radius * slope)
        along = x * u + y * v
        leg = np.sqrt(np.maximum(along * along + radius**2 - x * x - y * y, 0.0)) - along
        x, y = x + leg * u, y + leg * v
        slope = np.maximum((x * u + y * v) / radius, 1e-3)
        wider = width + leg * bend
        caustics += wider * width < 0
        width = wider
        points[k, :, 0], points[k, :, 1], legs[k], slopes[k] = x, y, leg, slope
    last = np.hypot(to_x - x, to_y - y)
    back, bend = last, np.ones(count)  # the width on the first wall of a tube from the other end
    for leg, lean in zip(legs[:0:-1], slopes[:0:-1], strict=True):
        bend = bend - 2 * back / (radius * lean)
        back = back + leg * bend
    here, there, along = (width * last) ** 2, (back * legs[0]) ** 2, legs.cumsum(0)
    factor = np.sqrt(along[-1] * abs(width)) / (slope * radius) * here / (here + there) * 1j ** (caustics % 4)
    rate = (-1) ** (walls - 1) * width / (slope * radius)
    behind = np.stack([x - along[-1] * u, y - along[-1] * v], 1) @ wall.axes[:2] + z * wall.axes[2]
    return Rays(points @ wall.axes[:2], along, rate, factor), wall.centre + behind


def _with_rays(
    wall: Quadric, rays: Rays, begin: Floats, kinds: Bools, found: fermat.FermatPaths, slope: Floats
) -> Lines:
    """Return the paths that begin as rays, of which those from a point behind the last wall are known."""
    along, whole, axis, out = rays.along[:-1], rays.along[-1], wall.axes[2], rays.points[:-1]
    climb = (found.corners[1] - found.corners[0]) @ axis
    height = wall.local(begin)[2] + climb * along / whole
    corners = np.concatenate([np.broadcast_to(begin, (1, *found.corners.shape[1:])),
                              wall.centre + out + height[..., None] * axis, found.corners[1:]])  # fmt: skip
    # along the axis legs are springs: those before and after a reflection add, and those behind each other in series
    stiff = (whole / np.hypot(whole, climb)) ** 3
    onto = np.linalg.norm(found.corners[2] - found.corners[1], axis=1)
    onward = 1 / ((whole - along) / stiff + 1 / (found.bends[0] - stiff / whole))
    return Lines(kinds, corners, np.concatenate([-out / wall.radius, found.normals]), found.lengths, slope, rays.rate,
                 found.spreads * rays.factor, np.concatenate([stiff / along + onward, found.bends]),
                 1 / (1 / wall.radius + 1 / onto))  # fmt: skip


def reflectors_in(
    wall: Quadric, bodies: tuple[Quadric, ...], plane: Plane | None, *, above: bool = True, goes_on: bool = True
) -> ReflectorSet:
    """Return a wall, bodies in it and last a plane across its axis, with the radar above or below, as reflectors.

    At the plane the wall ends, or goes on as its own image.
    """
    found = bodies_of((wall, *bodies))
    if plane is None:
        return found
    ends, extents = np.array([wall.low, wall.high]), found.surfaces.extents.copy()
    near, far = (0, 1) if above else (1, 0)
    ends[near] = 2 * plane.level - ends[far] if goes_on else plane.level
    extents[0] = ends - (wall.low + wall.high) / 2
    found = replace(found, surfaces=found.surfaces._replace(extents=extents))
    axis = wall.axes[2:]
    return joined([found, plane_set(wall.centre + plane.level * axis, axis, np.zeros((1, 2)),
                                    np.array([plane.object_id]))])  # fmt: skip


def _over(frame: RadarFrame, chain: Chain, wall: Quadric, body: Quadric | None, least: float) -> EchoSet | None:
    """Add the echo over one chain of surfaces, with or without a bounce at a plane across the axis."""
    context, antennas, turn = frame.context, chain.antennas, chain.turn
    ends = antennas.origins
    if turn is not None:
        heights = wall.local(ends)[:, 2] - turn[0].level
        if heights[0] * heights[1] <= 0:
            return None
        ends = ends.copy()
        ends[turn[1]] = turn[0].image(wall, ends[turn[1]])
    lines, wave = lines_over(wall, body, ends, chain.walls), 2 * np.pi / context.spec.wavelength_m
    if lines.length.min() > 2 * context.gate[1]:
        return None
    value = lines.spread * antennas.factor / (2 * wave) * np.sqrt(0.5j * wave / np.pi)
    places = sampled(lines, wall.radius, wave, value != 0)
    if not len(places.first) or (abs(value[places.first]) * places.weights).sum() * context.loudest < least:
        return None
    wanted = _wanted(places, len(value))
    path = _paths(lines, wall, body, turn, wanted)
    left = end_factors(path, context.spec.wavelength_m)
    path = path.within_ends()
    seen = np.zeros(len(value), complex)
    seen[wanted] = value[wanted] * left * free(frame.parts, path) * reflection_gains(context, antennas, path)
    if not seen.any():
        return None
    sums, at = summed(lines, wall.radius, places, seen, (0.5, 0.5))
    path = path.take(np.searchsorted(wanted, at))
    return accumulate_paths(frame, path.reversed() if chain.back else path, sums)


def sampled(lines: Lines, radius: float, wave: float, there: Bools) -> kernel.WallPlaces:
    """Choose places for the sum along the wall: line before each, share of the way to the next line, and weight.

    They surround the points of stationary phase, to a phase of at least half of `ZONES`.
    """
    even, many = _even(lines, radius, wave), 2 * np.pi * radius / len(there) * wave / _TURN
    room = len(there) * (int(many * even.cuts.max() * abs(lines.rate).max()) + 1)
    first, (share, weights) = np.empty(room, np.int64), np.empty((2, room))
    made = kernel.sampled(even, there, many, kernel.WallPlaces(first, share, weights))
    return kernel.WallPlaces(first[:made], share[:made], weights[:made])


def _even(lines: Lines, radius: float, wave: float) -> kernel.WallLines:
    """Return lines as kernels take them, with the greatest slopes that count for a wave number [1/m]."""
    cuts = np.minimum(np.sqrt(ZONES / (wave * lines.near)), 2.0)
    return kernel.WallLines(lines.length, lines.slope, lines.rate, cuts, 2 * np.pi * radius / len(cuts))


def _wanted(places: kernel.WallPlaces, count: int) -> Longs:
    """Return the lines, of so many, before and after places."""
    wanted = np.zeros(count, np.bool_)
    wanted[places.first] = wanted[(places.first + 1) % count] = True
    return np.flatnonzero(wanted)


def _paths(lines: Lines, wall: Quadric, body: Quadric | None, turn: Turn, wanted: Longs) -> ReflectedPaths:
    """Return some geometric paths (n), reflected at a plane if there is one."""
    plane, end = turn or (None, 0)
    above = plane is None or wall.local(lines.corners[-1 if end == 0 else 0, 0])[2] > plane.level
    reflectors = reflectors_in(wall, () if body is None else (body,), plane, above=above,
                               goes_on=bool(lines.walls[-end]))  # fmt: skip
    on = np.repeat(np.where(lines.walls, 0, 1)[:, None], len(wanted), 1)
    path = ReflectedPaths(lines.corners[:, wanted], lines.normals[:, wanted], on, lines.bends[:, wanted], reflectors,
                          np.ones(len(wanted), bool))  # fmt: skip
    if plane is None:
        return path
    path = (path.reversed() if end else path).folded(len(reflectors) - 1, on[:: -1 if end else 1] == 0)
    return path.reversed() if end else path


def summed(
    lines: Lines, radius: float, places: kernel.WallPlaces, seen: Complexes, shares: tuple[float, float]
) -> tuple[PathSum, Longs]:
    """Return the sum over places along the wall, and the lines before those that lead; `shares` as of `PathSum`."""
    first, count = places.first, len(seen)
    value, (length, slope) = np.empty(len(first), complex), np.empty((2, len(first)))
    kernel.summed(_even(lines, radius, 1.0), seen, places, value, length, slope)
    leads, led = stationary((first + places.share) / count, slope, 1 / count)
    return PathSum(length, value, leads, led, shares), first[leads]


def accumulate_inside(frame: RadarFrame) -> list[EchoSet]:
    """Add the echoes of two bounces and more inside spheres that contain the radar to the delay grids."""
    echoes = [_in_ball(frame, sphere, bounces)
              for sphere in frame.context.world.spheres if _holds(frame.context, frame.antennas, sphere)
              for bounces in range(2, frame.max_bounces + 1)]  # fmt: skip
    return [echo for echo in echoes if echo is not None]


def _holds(context: RadarContext, antennas: AntennaPair, sphere: Sphere) -> bool:
    """Return whether both antennas are inside a sphere, and close enough to count as one."""
    whole = 1 - ((1 - sphere.caps[:, 3] / sphere.radius) / 2).sum() > _WHOLE
    if not whole or sphere.widest >= context.widest_m or not LEAST_M < sphere.radius < context.gate[1]:
        return False
    room = sphere.radius - sphere.depth - PULL_M - float(np.linalg.norm(antennas.origins - sphere.centre, axis=1).max())
    return room > _NEAR_M and bistatic_phase_rad(context, antennas) < room


def ball_lines(radius: float, away: float, bounces: int, wave: float) -> tuple[Lines, Complexes]:
    """Return the paths from a point so far from the centre of a ball back to it, in one plane, and their values (n).

    The values are for all planes and both ends together, without antennas and reflections; `wave`: number [1/m].
    """
    circle = Quadric(np.zeros(3), np.eye(3), radius, -np.inf, np.inf, 0.0, 0.0, -1)
    count = int(2 * wave * radius * min(np.sqrt(ZONES / (wave * radius)), 1.2) * bounces) + 64
    lines = lines_over(circle, None, np.array([[away, 0.0, 0.0]] * 2), (True,) * bounces, count)
    legs, aside = np.diff(lines.corners, axis=0), lines.corners[1:-1, :, 1]
    first, last = (np.linalg.norm(leg, axis=1) for leg in (legs[0], legs[-1]))
    across = np.sqrt(abs(legs[0, :, 1] / first * aside[-1]) * lines.length / last)
    crossed = (aside[1:] * aside[:-1] < 0).sum(0)
    return lines, 0.5j * lines.spread * across * 1j ** (crossed % 4)


def _in_ball(frame: RadarFrame, sphere: Sphere, bounces: int) -> EchoSet | None:
    context, antennas = frame.context, frame.antennas
    gap = antennas.origins.mean(0) - sphere.centre
    wave = 2 * np.pi / context.spec.wavelength_m
    lines, value = ball_lines(sphere.radius, float(np.linalg.norm(gap)), bounces, wave)
    places = sampled(lines, sphere.radius, wave, value != 0)
    if lines.length.min() > 2 * context.gate[1] or not len(places.first):
        return None
    wanted = _wanted(places, len(value))
    some = np.append(wanted[:-1:_EVERY], wanted[-1])
    path = _in_all_planes(sphere, antennas, lines.corners[1:-1, some, :2], gap)
    share = (free(frame.parts, path) * reflection_gains(context, antennas, path)).reshape(len(some), _PLANES)
    if not share.any():
        return None
    seen = np.zeros(len(value), complex)
    seen[wanted] = value[wanted] * antennas.factor * np.interp(wanted, some, share.mean(1))
    sums, at = summed(lines, sphere.radius, places, seen, (1.0, 0.0))
    next_to = abs(some[:, None] - at).argmin(0)
    return accumulate_paths(frame, path.take(next_to * _PLANES + abs(share[next_to]).argmax(1)), sums)


def _in_all_planes(sphere: Sphere, antennas: AntennaPair, points: Floats, gap: Floats) -> ReflectedPaths:
    """Rotate points (b, n, 2) of rays into all planes (m) through the centre and the radar, flattened to (n m)."""
    _, _, axes = np.linalg.svd(gap[None] + 1e-12 * np.array([1.0, 2.0, 3.0]))
    axes[0] *= np.sign(axes[0] @ gap) or 1.0
    turn = (np.arange(_PLANES) + 0.5) * np.pi / _PLANES
    sides = np.cos(turn)[:, None] * axes[1] + np.sin(turn)[:, None] * axes[2]
    out = (points[..., :1] * axes[0])[:, :, None] + points[..., 1][..., None, None] * sides
    stops = out.reshape(len(points), -1, 3)
    ends = [np.broadcast_to(origin, (1, *stops.shape[1:])) for origin in antennas.origins]
    one = fermat.Reflectors(np.array([fermat.SPHERE]), sphere.centre[None], np.eye(3)[None], np.array([sphere.radius]),
                            np.zeros((1, 2)))  # fmt: skip
    wall = ReflectorSet(one, np.array([sphere.depth]), np.array([sphere.object_id]))
    return ReflectedPaths(np.concatenate([ends[0], sphere.centre + stops, ends[1]]), -stops / sphere.radius,
                          np.zeros(stops.shape[:2], np.int64), np.zeros(stops.shape[:2]), wall,
                          np.ones(stops.shape[1], bool))  # fmt: skip
