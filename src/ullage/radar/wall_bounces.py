"""Echoes between the walls inside a cylindrical tank: reflected rays, and physical optics at the last wall.

Rays leave one antenna in all directions around the axis. Geometrical optics reflects them [Deschamps1972] and follows
the width of each ray tube and the caustics that it passes [KravtsovOrlov1993]. Kirchhoff's integral over the last wall
to the other antenna becomes the sum over the rays [LingChouLee1989]. In a cylinder it is a sum over one angle: along
the axis the wall is straight, so the integral there follows by stationary phase. A tube counts with the square root of
its width, so the sum stays finite where walls focus. The integral is wrong where a tube has zero width on the last
wall. It may equally run over the first wall, from the other antenna. So each path is shared between both integrals, by
the width of its tube and the distance of the antenna at each.

A floor or roof across the axis reverses the path along the axis. It adds one bounce, at the height given by its image.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ullage.arrays import Complexes, Floats, Longs
from ullage.radar.context import AntennaPair, RadarContext
from ullage.radar.echo_set import EchoSet
from ullage.radar.facets import PlanarPatches, Surfaces
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
from ullage.radar.reflectors import PULL_M, ReflectorSet, bodies_of, joined, plane_set

LEAST_M = 0.25
"""Least radius [m]: narrower pipes are wave guides, not mirrors."""
ZONES = 50.0
"""Twice the phase at which the sum over a wall fades out [rad]."""
ALIAS = 4.0
"""Phase difference between neighbouring rays at which the sum also fades out [rad]."""
FAINT = 1e-3
"""Least weight of a ray, as a share of the largest weight."""
FLOORS = 2
"""Most planes across the axis that reflect, in the order of their faces' apparent sizes."""
EVERY = 8
"""Visibility and fields are computed for one of this many rays: neighbours are only 1 or 2 cm apart."""
SAME_M = 0.01
"""Planes that are closer than this count as one [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Fan:
    """Rays across the axis of a cylinder, from wall to wall and to their end; rays of small weight are left out."""

    points: Floats  # (b, n, 2) reflection points on the wall [m]
    paths: Floats  # (b + 1, n, 2) unit vectors of travel
    along: Floats  # (b + 1, n) path length up to each wall, and to the end [m]
    weights: Complexes  # (n) weight in the sum, without the root of the wave number across the axis
    names: Longs  # (n) number of each among all rays around the axis
    leads: Longs  # (m) rays that are specular at the last wall
    led: Longs  # (n) the nearest of these

    def some(self) -> Fan:
        """Select every `EVERY`th ray."""
        which = np.append(np.arange(0, len(self.names) - 1, EVERY), len(self.names) - 1)
        return replace(self, points=self.points[:, which], paths=self.paths[:, which], along=self.along[:, which],
                       weights=self.weights[which], names=self.names[which])  # fmt: skip

    def nearest(self, names: Longs) -> Longs:
        """Return which rays are next to others with these numbers (m)."""
        return np.asarray(abs(self.names[:, None] - names).argmin(0))


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A floor or a roof across the axis of a cylinder."""

    level: float  # along the axis [m]
    object_id: int  # object

    def image(self, wall: Quadric, point: Floats) -> Floats:
        """Return the mirror image of a point (3) [m]."""
        return np.asarray(point + 2 * (self.level - wall.local(point)[2]) * wall.axes[2])


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


def accumulate_walls(
    context: RadarContext,
    parts: list[Surfaces],
    quadrics: tuple[Quadric, ...],
    planar: PlanarPatches,
    antennas: AntennaPair,
    max_bounces: int,
    sizes: Floats,
    grids: Complexes,
) -> list[EchoSet]:
    """Add the echoes from wall to wall of the cylindrical tanks that contain the radar to the delay grids.

    Paths have two bounces. With three, the additional bounce is at the wall, or at a floor or a roof among those of the
    largest apparent `sizes` (p).
    """
    out: list[EchoSet] = []
    for wall in around(context, quadrics, antennas):
        planes = planes_of(planar, wall, sizes) if max_bounces > 2 else []
        for side in both_sides(antennas):
            for bounces in range(2, max_bounces + 1):
                out += _echoes_of(context, parts, side, wall, bounces, planes if bounces == 2 else [], grids)
    return out


def both_sides(antennas: AntennaPair) -> list[AntennaPair]:
    """List the radar and the one that sends from its receiver; they are one, twice as strong, if they do not differ."""
    if antennas.reversible:
        return [replace(antennas, factor=2 * antennas.factor)]
    return [antennas, antennas.swapped()]


def around(context: RadarContext, quadrics: tuple[Quadric, ...], antennas: AntennaPair) -> Iterator[Quadric]:
    """Find the walls around both antennas with their far side within the gate and facets too narrow for mirrors."""
    narrow = np.sqrt(context.spec.wavelength_m * context.gate[1] / 2)
    for wall in quadrics:
        if not wall.is_sphere and wall.radius > LEAST_M and wall.widest < narrow and 2 * wall.radius < context.gate[1]:
            places = wall.local(antennas.origins)
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


def _echoes_of(
    context: RadarContext,
    parts: list[Surfaces],
    antennas: AntennaPair,
    wall: Quadric,
    bounces: int,
    planes: list[Plane],
    grids: Complexes,
) -> list[EchoSet]:
    start, stop = wall.local(antennas.origins)
    fan = fan_of(wall.radius, start[:2], stop[:2], bounces, 2 * np.pi / context.spec.wavelength_m)
    out = []
    for plane in (None, *planes):
        if plane is not None and (start[2] - plane.level) * (stop[2] - plane.level) <= 0:
            continue
        echo = _over(context, parts, antennas, wall, fan, plane, grids)
        if echo is not None:
            out.append(echo)
    return out


def fan_of(radius: float, start: Floats, stop: Floats, bounces: int, wave: float) -> Fan:
    """Trace rays from one point (2) inside a circle over its wall to another (2), in any direction at the last wall.

    Args:
        radius: of the circle [m].
        start: first point, from the centre [m].
        stop: last point [m].
        bounces: 2 or more.
        wave: wave number [1/m].
    """
    least = min(np.sqrt(ZONES / (wave * radius)), 1.2)
    step = 2 * np.pi / (int(4 * wave * radius * least * bounces) + 64)
    shot = _shot(radius, start, bounces, step)
    (x, y), (u, v), slope, width = shot.points[-1], shot.paths[-1], shot.slopes[-1], shot.width
    on, off = stop[0] - x, stop[1] - y
    last = np.sqrt(on * on + off * off)
    on, off = on / last, off / last
    turn = (y * (on - u) - x * (off - v)) / radius  # derivative of the path length along the wall
    back = np.maximum(-(on * x + off * y) / radius, 0.0)
    path = shot.legs.sum(0) + last
    weights = np.sqrt(abs(width) / last * path) * (slope + back) / (2 * slope) * _share(shot, last, radius)
    weights *= _fade(turn, last, width / slope, radius, wave, step)
    kept = np.flatnonzero(weights > FAINT * weights.max(initial=1e-30))
    weights = weights[kept] * (step * np.sqrt(0.5j / np.pi)) * 1j ** (shot.caustics[kept] % 4)
    paths = np.concatenate([shot.paths, np.stack([on, off])[None]])[..., kept].transpose(0, 2, 1)
    along = np.concatenate([shot.legs.cumsum(0), path[None]])[:, kept]
    return Fan(np.ascontiguousarray(shot.points[..., kept].transpose(0, 2, 1)), np.ascontiguousarray(paths), along,
               weights, kept, *stationary(kept / len(turn), turn[kept], 1 / len(turn)))  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """Rays in all directions around the axis, up to their last wall."""

    points: Floats  # (b, 2, n) reflection points [m]
    paths: Floats  # (b, 2, n) directions of arrival
    legs: Floats  # (b, n) from wall to wall [m]
    slopes: Floats  # (b, n) cos(incidence)
    width: Floats  # (n) width of the tube at the last wall over the angle between rays, negative past a caustic [m]
    caustics: Longs  # (n) number of caustics passed


def _shot(radius: float, start: Floats, bounces: int, step: float) -> Shot:
    angle = (np.arange(round(2 * np.pi / step)) + 0.5) * step
    count = len(angle)
    points, paths, legs, slopes = *np.empty((2, bounces, 2, count)), *np.empty((2, bounces, count))
    (x, y), u, v = (np.full(count, c) for c in start), np.cos(angle), np.sin(angle)
    width, bend, caustics = np.zeros(count), np.ones(count), np.zeros(count, np.int64)
    for bounce in range(bounces):
        along = x * u + y * v
        leg = np.sqrt(np.maximum(along * along + radius**2 - x * x - y * y, 0.0)) - along
        x, y = x + leg * u, y + leg * v
        slope = np.maximum((x * u + y * v) / radius, 1e-3)
        wider = width + leg * bend
        caustics += wider * width < 0
        points[bounce], paths[bounce], legs[bounce], slopes[bounce] = (x, y), (u, v), leg, slope
        width, bend = wider, bend - 2 * wider / (radius * slope)
        u, v = u - 2 * slope * x / radius, v - 2 * slope * y / radius
    return Shot(points, paths, legs, slopes, width, caustics)


def _fade(turn: Floats, last: Floats, width: Floats, radius: float, wave: float, step: float) -> Floats:
    """Weigh rays (n) by the derivative `turn` of their path along the last wall: fading off stationary phase."""
    length = last * radius / (last + radius)
    reach = np.sqrt(turn * turn * (wave * length / ZONES + (wave * width * step / ALIAS) ** 2))
    return np.asarray(np.sin(np.pi * np.clip(1 - reach, 0, 0.5)) ** 2)


def _share(shot: Shot, last: Floats, radius: float) -> Floats:
    """Compute the share (n) of the integral over the last wall; the rest belongs to that over the first."""
    width, bend = last, np.ones(len(last))
    for leg, slope in zip(shot.legs[:0:-1], shot.slopes[:0:-1], strict=True):
        bend = bend - 2 * width / (radius * slope)
        width = width + leg * bend
    here, there = (shot.width * last) ** 2, (width * shot.legs[0]) ** 2
    return np.asarray(here / (here + there))


def _over(
    context: RadarContext,
    parts: list[Surfaces],
    antennas: AntennaPair,
    wall: Quadric,
    fan: Fan,
    plane: Plane | None,
    grids: Complexes,
) -> EchoSet | None:
    """Add the echo over one fan, with or without a bounce at a plane across the axis."""
    begin, end = antennas.origins
    if plane is not None:
        begin = plane.image(wall, begin)
    wavelength, length = context.spec.wavelength_m, np.hypot(fan.along[-1], (end - begin) @ wall.axes[2])
    if length.min(initial=np.inf) > 2 * context.gate[1]:
        return None
    sampled = fan.some()
    above = plane is None or wall.local(end)[2] > plane.level
    path = _climb(wall, sampled, begin, end, reflectors_in(wall, (), plane, above=above))
    if plane is not None:
        path = path.folded(len(path.reflectors) - 1, np.ones(path.on.shape, bool))
    seen = end_factors(path, wavelength)
    path = path.within_ends()
    seen *= free(parts, path)
    if not seen.any():
        return None
    seen *= reflection_gains(context, antennas, path)
    value = antennas.factor * np.sqrt(wavelength * fan.along[-1] / (8 * np.pi * length)) / length * fan.weights
    value *= np.interp(fan.names, sampled.names, seen)
    leads = path.take(sampled.nearest(fan.names[fan.leads]))
    return accumulate_paths(context, leads, PathSum(length, value, fan.leads, fan.led, (0.5, 0.5)), grids)


def _climb(wall: Quadric, fan: Fan, begin: Floats, end: Floats, reflectors: ReflectorSet) -> ReflectedPaths:
    """Return the paths of rays (n) that climb along the axis from one point to another."""
    shares, climb, ends = fan.along / fan.along[-1], (end - begin) @ wall.axes[2], wall.local(begin)[2]
    heights = ends + climb * shares[:-1]
    stops = wall.centre + fan.points @ wall.axes[:2] + heights[..., None] * wall.axes[2]
    corners = np.concatenate([np.broadcast_to(begin, stops[:1].shape), stops, np.broadcast_to(end, stops[:1].shape)])
    level = fan.along[-1] / np.hypot(fan.along[-1], climb)
    bends = level**3 / (fan.along[:-1] * (1 - shares[:-1]))
    return ReflectedPaths(corners, fan.points @ wall.axes[:2] / -wall.radius, np.zeros(bends.shape, np.int64), bends,
                          reflectors, np.ones(len(level), bool))  # fmt: skip
