"""Echoes between the walls inside a sphere: reflected rays, and physical optics at the last wall.

Each ray from a point off the centre stays in one plane through the centre. So the rays are those inside a circle
(`wall_bounces.fan_of`), rotated about the line to the centre. Across that plane the width of a ray tube is its distance
from the line, and the tube passes a caustic at each crossing [KravtsovOrlov1993]. Kirchhoff's integral over the last
wall becomes a sum over the rays of all planes [LingChouLee1989]. Each ray counts with the square root of its tube's
area, so the sum stays finite where rays of all planes meet. At the centre, the whole wall focuses.
"""

from __future__ import annotations

import numpy as np

from ullage.arrays import Complexes, Floats
from ullage.geometry import C0
from ullage.radar.context import AntennaPair, RadarContext
from ullage.radar.echo_set import EchoSet
from ullage.radar.facets import Surfaces
from ullage.radar.reflected_paths import ReflectedPaths, free, reflection_gains
from ullage.radar.sphere_echoes import bistatic_phase_rad
from ullage.radar.spheres import Sphere
from ullage.radar.wall_bounces import LEAST_M, PULL_M, Fan, accumulate, fan_of

_PLANES = 8  # through the line from the centre to the radar
_WHOLE = 0.9  # least share of a whole sphere: no model here covers the rim of a bowl
_NEAR_M = 0.05  # least distance to the wall for rays [m]


def accumulate_inside(
    context: RadarContext, parts: list[Surfaces], antennas: AntennaPair, max_bounces: int, grids: Complexes
) -> list[EchoSet]:
    """Add the echoes of two and three bounces inside spheres that contain the radar to the delay grids."""
    out = []
    for sphere in context.world.spheres:
        if _within(context, antennas, sphere):
            for bounces in range(2, max_bounces + 1):
                echo = _echoes_of(context, parts, antennas, sphere, bounces, grids)
                if echo is not None:
                    out.append(echo)
    return out


def _within(context: RadarContext, antennas: AntennaPair, sphere: Sphere) -> bool:
    """Return whether both antennas are inside a sphere, and close enough to count as one."""
    whole = 1 - ((1 - sphere.caps[:, 3] / sphere.radius) / 2).sum() > _WHOLE
    narrow = sphere.widest < np.sqrt(context.spec.wavelength_m * context.gate[1] / 2)
    if not whole or not narrow or not LEAST_M < sphere.radius < context.gate[1]:
        return False
    room = sphere.radius - sphere.depth - PULL_M - float(np.linalg.norm(antennas.origins - sphere.centre, axis=1).max())
    return room > _NEAR_M and bistatic_phase_rad(context, antennas) < room


def _echoes_of(
    context: RadarContext, parts: list[Surfaces], antennas: AntennaPair, sphere: Sphere, bounces: int, grids: Complexes
) -> EchoSet | None:
    gap = antennas.origins.mean(0) - sphere.centre
    away = float(np.linalg.norm(gap))
    fan = fan_of(
        sphere.radius, np.array([away, 0.0]), np.array([away, 0.0]), bounces, 2 * np.pi / context.spec.wavelength_m
    )
    length = fan.along[-1]
    if length.min(initial=np.inf) > 2 * context.gate[1]:
        return None
    sampled = fan.some()
    real = _in_all_planes(sphere, antennas, sampled, gap, away)
    seen = (free(parts, real) * reflection_gains(context, antennas, real)).reshape(len(sampled.names), _PLANES)
    if not seen.any():
        return None
    value = 2 * antennas.factor * fan_weights(fan) * np.interp(fan.names, sampled.names, seen.mean(1))
    echo = accumulate(context, length / C0, value, grids, (1.0, 0.0))
    leads, count = fan.leads, len(fan.leads)
    via = np.full((count, 2), -1, np.int64)
    via[:, : bounces - 1] = sphere.object_id
    next_to = abs(sampled.names[:, None] - fan.names[leads]).argmin(0)
    points = real.corners[-2].reshape(len(sampled.names), _PLANES, 3)[next_to, abs(seen[next_to]).argmax(1)]
    total = np.bincount(fan.led, echo.real, count) + 1j * np.bincount(fan.led, echo.imag, count)

    def again(factors: Complexes, others: Complexes) -> None:
        accumulate(context, length / C0, value * factors[fan.led], others, (1.0, 0.0))

    return EchoSet(np.full(count, sphere.object_id, np.int32), points, total, length[leads] / C0, again, via)


def fan_weights(fan: Fan) -> Complexes:
    """Compute the weights of the rays (n) of a fan from a point on its first axis, for all planes of a sphere together.

    Each path can be computed from both ends; a weight is the share of one end.
    """
    aside, legs = fan.points[..., 1], np.diff(fan.along, axis=0)
    across = np.sqrt(abs(fan.paths[0, :, 1] * aside[-1]) / (legs[-1] * fan.along[-1]))
    crossed = (aside[1:] * aside[:-1] < 0).sum(0)
    return np.asarray(fan.weights * across * (0.25j / np.sqrt(0.5j / np.pi)) * 1j ** (crossed % 4))


def _in_all_planes(sphere: Sphere, antennas: AntennaPair, fan: Fan, gap: Floats, away: float) -> ReflectedPaths:
    """Rotate the rays (n) of a fan into all planes (m) through the centre and the radar, flattened to (n m)."""
    _, _, axes = np.linalg.svd(gap[None] + 1e-12 * np.array([1.0, 2.0, 3.0]))
    axes[0] *= np.sign(axes[0] @ gap) or 1.0
    turn = (np.arange(_PLANES) + 0.5) * np.pi / _PLANES
    sides = np.cos(turn)[:, None] * axes[1] + np.sin(turn)[:, None] * axes[2]
    out = (fan.points[..., :1] * axes[0])[:, :, None] + fan.points[..., 1][..., None, None] * sides
    stops = out.reshape(len(fan.points), -1, 3)
    ends = [np.broadcast_to(origin, (1, *stops.shape[1:])) for origin in antennas.origins]
    shape = stops.shape[:2]
    return ReflectedPaths(np.concatenate([ends[0], sphere.centre + stops, ends[1]]), -stops / sphere.radius,
                np.full(shape, sphere.depth), np.full(shape, sphere.object_id), np.ones(shape[1], bool))  # fmt: skip
