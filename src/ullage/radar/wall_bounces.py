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
from scipy.special import fresnel

from ullage.antenna import gain
from ullage.arrays import Bools, Complexes, Floats, Longs
from ullage.geometry import C0
from ullage.kernels import impulses as kernel
from ullage.radar.context import AntennaPair, RadarContext
from ullage.radar.echo_set import EchoSet
from ullage.radar.facets import PlanarPatches, Surfaces
from ullage.radar.mirrors import across, dot, reflected
from ullage.radar.quadrics import Quadric
from ullage.radar.visibility import between

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
PULL_M = 4e-3
"""Distance of visibility tests from the facets of curved bodies [m]."""


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


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A floor or a roof across the axis of a cylinder."""

    level: float  # along the axis [m]
    object_id: int  # object


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
    one = antennas.monostatic and bool((antennas.fields[0] == antennas.fields[1]).all())
    sides = [replace(antennas, factor=2 * antennas.factor)] if one else [antennas, swapped(antennas)]
    for wall in around(context, quadrics, antennas):
        planes = planes_of(planar, wall, sizes) if max_bounces > 2 else []
        for side in sides:
            for bounces in range(2, max_bounces + 1):
                out += _echoes_of(context, parts, side, wall, bounces, planes if bounces == 2 else [], grids)
    return out


def swapped(antennas: AntennaPair) -> AntennaPair:
    """Exchange transmitter and receiver."""
    return replace(antennas, **{row: getattr(antennas, row)[::-1].copy() for row in ("origins", "frames", "fields")})


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
               weights, kept, *_leads(kept, turn[kept], len(turn)))  # fmt: skip


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


def _leads(names: Longs, turn: Floats, count: int) -> tuple[Longs, Longs]:
    """Find the rays (n), out of `count`, with stationary path length along the wall, and the nearest for each ray."""
    after = np.roll(np.arange(len(names)), -1)
    here = np.flatnonzero((turn * turn[after] <= 0) & ((names[after] - names) % count == 1))
    leads = np.where(abs(turn[here]) < abs(turn[after[here]]), here, after[here])
    if not len(leads):
        leads = np.array([abs(turn).argmin()])
    gap = abs((names[:, None] - names[leads] + count // 2) % count - count // 2)
    return leads, gap.argmin(1)


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
    (_, _, begin), (_, _, end) = wall.local(antennas.origins)
    rise = (end if plane is None else 2 * plane.level - end) - begin
    path = np.sqrt(fan.along[-1] ** 2 + rise**2)
    if path.min(initial=np.inf) > 2 * context.gate[1]:
        return None
    sampled = fan.some()
    met = _climb(wall, sampled, plane, begin, rise)
    free = _free(parts, antennas, wall, sampled, met, plane)
    if not free.any():
        return None
    seen = free * _end_factors(wall, plane, met, sampled.along, context.spec.wavelength_m)
    seen *= _turned(context, antennas, wall, sampled, plane, met)
    wavelength = context.spec.wavelength_m
    value = antennas.factor * np.sqrt(wavelength * fan.along[-1] / (8 * np.pi * path)) / path * fan.weights
    value *= np.interp(fan.names, sampled.names, seen)
    echo = accumulate(context, path / C0, value, grids, (0.5, 0.5))
    leads, count = fan.leads, len(fan.leads)
    via = np.full((count, 2), -1, np.int64)
    via[:, : len(fan.points) - 1] = wall.object_id
    if plane is not None:
        via[:, 1] = plane.object_id
    points = np.stack([np.interp(fan.names[leads], sampled.names, row) for row in met.stops[-1].T], 1)
    total = np.bincount(fan.led, echo.real, count) + 1j * np.bincount(fan.led, echo.imag, count)

    def again(factors: Complexes, others: Complexes) -> None:
        accumulate(context, path / C0, value * factors[fan.led], others, (0.5, 0.5))

    return EchoSet(np.full(count, wall.object_id, np.int32), points, total, path[leads] / C0, again, via)


@dataclass(frozen=True, slots=True, eq=False)
class Met:
    """Reflection points of the rays of a fan on the wall, with their heights along the axis."""

    stops: Floats  # (b, n, 3) just inside the facets [m]
    heights: Floats  # (b, n) along the axis [m]
    level: Floats  # (n) cosine between path and cross-section
    climb: Floats  # (n) cosine between path and axis, at first
    leg: Longs  # (n) leg that meets the plane; past the last one without a plane


def _climb(wall: Quadric, fan: Fan, plane: Plane | None, begin: float, rise: float) -> Met:
    path = np.sqrt(fan.along[-1] ** 2 + rise**2)
    heights = begin + rise * fan.along[:-1] / fan.along[-1]
    leg = np.full(len(path), len(fan.paths))
    if plane is not None:
        after = (heights - plane.level) * (begin - plane.level) < 0
        heights = np.where(after, 2 * plane.level - heights, heights)
        leg = (~after).sum(0)
    inner = np.minimum(np.maximum(heights, wall.low + PULL_M), wall.high - PULL_M)
    pulled = fan.points * (1 - (wall.depth + PULL_M) / wall.radius)
    stops = wall.centre + pulled @ wall.axes[:2] + inner[..., None] * wall.axes[2]
    return Met(stops, heights, fan.along[-1] / path, rise / path, leg)


def _end_factors(wall: Quadric, plane: Plane | None, met: Met, along: Floats, wavelength: float) -> Complexes:
    """Compute the factors (n) of the wall's ends along its axis, by Fresnel integrals at the bounces.

    An end on the plane does not count: past it the wall continues as its image.
    """
    zone = np.sqrt(wavelength * along[:-1] * (1 - along[:-1] / along[-1]) / met.level**3)
    ends = [np.full(zone.shape, -0.5 + 0.5j), np.full(zone.shape, 0.5 - 0.5j)]
    for k, end in enumerate((wall.low, wall.high)):
        if plane is None or abs(end - plane.level) > SAME_M:
            sine, cosine = fresnel(np.sqrt(2) * (end - met.heights) / zone)
            ends[k] = cosine - 1j * sine
    return np.asarray(((ends[1] - ends[0]) / (1 - 1j)).prod(0))


def _free(
    parts: list[Surfaces], antennas: AntennaPair, wall: Quadric, fan: Fan, met: Met, plane: Plane | None
) -> Bools:
    """Return which rays (n) have free legs and existing reflection points: walls have gaps, floors end."""
    stops, count = met.stops, len(met.leg)
    ends = [np.broadcast_to(origin, (1, count, 3)) for origin in antennas.origins]
    corners = np.concatenate([ends[0], stops, ends[1]])
    outward = fan.points @ (wall.axes[:2] * 2 * (wall.depth + PULL_M) / wall.radius)
    legs, holds = [corners[:-1], corners[1:].copy()], [stops, stops + outward]
    if plane is not None:
        rows, normal = np.arange(count), wall.axes[2]
        a, b = corners[met.leg, rows], corners[met.leg + 1, rows]
        gap, opposite = ((point - wall.centre) @ normal - plane.level for point in (a, b))
        image = b - 2 * opposite[:, None] * normal
        hit = a + (gap / (gap + opposite))[:, None] * (image - a)
        lift = np.sign(gap)[:, None] * PULL_M * normal
        legs[1][met.leg, rows] = hit + lift
        legs = [np.concatenate([legs[0], (hit + lift)[None]]), np.concatenate([legs[1], b[None]])]
        holds = [np.concatenate([here, (hit + side)[None]]) for here, side in zip(holds, (lift, -lift), strict=True)]
    both = [np.concatenate(rows).reshape(-1, 3) for rows in zip(legs, holds, strict=True)]
    clear = between(parts, *both).reshape(-1, count)
    return np.asarray(clear[: len(legs[0])].all(0) & ~clear[len(legs[0]) :].any(0))


def _turned(
    context: RadarContext, antennas: AntennaPair, wall: Quadric, fan: Fan, plane: Plane | None, met: Met
) -> Complexes:
    """Compute the product (n) of antenna gains and reflections, with polarisation."""
    paths, climb = fan.paths @ wall.axes[:2] * met.level[:, None], met.climb[:, None] * wall.axes[2]
    normals, object_ids = fan.points @ wall.axes[:2] / wall.radius, np.full(len(climb), wall.object_id)
    u = paths[0] + climb
    field = across(antennas.fields[:1], u).astype(complex)
    total = gain(context.spec.antenna, u @ antennas.frames[0].T)
    for leg in range(len(paths)):
        mine = np.flatnonzero(met.leg == leg)
        if plane is not None and len(mine):
            axis, floor = np.broadcast_to(wall.axes[2], (len(mine), 3)), np.full(len(mine), plane.object_id)
            field[mine] = reflected(context.bounce, floor, field[mine], (paths[leg] + climb)[mine], axis)
            climb = climb.copy()
            climb[mine] *= -1
        u = paths[leg] + climb
        if leg < len(normals):
            field = reflected(context.bounce, object_ids, field, u, normals[leg])
    back = gain(context.spec.antenna, -u @ antennas.frames[1].T)
    return np.asarray(total * back * dot(field, across(antennas.fields[1:], u)))


def accumulate(
    context: RadarContext, delay: Floats, value: Complexes, grids: Complexes, shares: tuple[float, float]
) -> Complexes:
    """Add impulses (n) at their delays [s] to the grids; return their values at the carrier.

    `shares` are the parts that are constant in frequency and that fall as 1 / f. A mirror echo falls as 1 / f. Points
    whose sum along a line makes a mirror echo fall as its square root, which is half of each.
    """
    echo = np.empty(len(value), complex)
    kernel.impulses(np.asarray(delay, float), np.asarray(value, complex), context.pulse_grid, shares, grids, echo)
    return echo
