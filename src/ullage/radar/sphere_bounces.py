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
from ullage.kernels import fermat as kernel
from ullage.radar.context import AntennaPair, RadarContext
from ullage.radar.echo_set import EchoSet
from ullage.radar.facets import Surfaces
from ullage.radar.reflected_paths import PathSum, ReflectedPaths, accumulate_paths, free, reflection_gains
from ullage.radar.reflectors import PULL_M, ReflectorSet
from ullage.radar.sphere_echoes import bistatic_phase_rad
from ullage.radar.spheres import Sphere
from ullage.radar.wall_bounces import LEAST_M, Fan, fan_of

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
    next_to = sampled.nearest(fan.names[fan.leads])
    leads = real.take(next_to * _PLANES + abs(seen[next_to]).argmax(1))
    return accumulate_paths(context, leads, PathSum(length, value, fan.leads, fan.led, (1.0, 0.0)), grids)


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
    one = kernel.Reflectors(np.array([kernel.SPHERE]), sphere.centre[None], np.eye(3)[None], np.array([sphere.radius]),
                            np.zeros((1, 2)))  # fmt: skip
    wall = ReflectorSet(one, np.array([sphere.depth]), np.array([sphere.object_id]))
    return ReflectedPaths(np.concatenate([ends[0], sphere.centre + stops, ends[1]]), -stops / sphere.radius,
                          np.zeros(stops.shape[:2], np.int64), np.zeros(stops.shape[:2]), wall,
                          np.ones(stops.shape[1], bool))  # fmt: skip
