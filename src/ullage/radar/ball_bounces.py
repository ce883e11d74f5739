"""Echoes from wall to wall inside a ball, by rays that bounce and physical optics at the last wall.

From a place off the centre every ray stays in one plane through the centre, so rays are those inside a circle
(`wall_bounces.fan_of`), turned about the line to the centre. Across their plane a tube is as wide as it is away from
that line, and has passed a caustic wherever it crosses it [KravtsovOrlov1993]. Kirchhoff's integral over the last wall
is the sum over the rays of all planes [LingChouLee1989]: each counts by the root of its tube's area, so that nothing
is infinite where rays of all planes meet. In the middle all of the wall focuses.
"""

from __future__ import annotations

import numpy as np

from ullage.arrays import Complexes, Floats
from ullage.geometry import C0
from ullage.radar.ball_echoes import apart_rad
from ullage.radar.balls import Ball
from ullage.radar.context import AntennaPair, RadarContext
from ullage.radar.echo_set import EchoSet
from ullage.radar.facets import Surfaces
from ullage.radar.real_paths import Real, free, turned
from ullage.radar.wall_bounces import LEAST_M, PULL_M, Fan, accumulate, fan_of

_PLANES = 8  # through the line from the centre to the radar
_WHOLE = 0.9  # less of a ball is a bowl: what its rim leaves of a wave is not known
_NEAR_M = 0.05  # nearer to the wall the wave is no ray


def accumulate_inside(
    context: RadarContext, parts: list[Surfaces], antennas: AntennaPair, max_bounces: int, grids: Complexes
) -> list[EchoSet]:
    """Adds the echoes from wall to wall of the balls that the radar is in to the delay grids, two bounces and three."""
    out = []
    for ball in context.world.balls:
        if _within(context, antennas, ball):
            for bounces in range(2, max_bounces + 1):
                told = _echoes_of(context, parts, antennas, ball, bounces, grids)
                if told is not None:
                    out.append(told)
    return out


def _within(context: RadarContext, antennas: AntennaPair, ball: Ball) -> bool:
    """Whether both antennas are in a ball, and near enough to each other to be one."""
    whole = 1 - ((1 - ball.caps[:, 3] / ball.radius) / 2).sum() > _WHOLE
    narrow = ball.widest < np.sqrt(context.spec.wavelength_m * context.gate[1] / 2)
    if not whole or not narrow or not LEAST_M < ball.radius < context.gate[1]:
        return False
    room = ball.radius - ball.depth - PULL_M - float(np.linalg.norm(antennas.origins - ball.centre, axis=1).max())
    return room > _NEAR_M and apart_rad(context, antennas) < room


def _echoes_of(
    context: RadarContext, parts: list[Surfaces], antennas: AntennaPair, ball: Ball, bounces: int, grids: Complexes
) -> EchoSet | None:
    gap = antennas.origins.mean(0) - ball.centre
    away = float(np.linalg.norm(gap))
    fan = fan_of(
        ball.radius, np.array([away, 0.0]), np.array([away, 0.0]), bounces, 2 * np.pi / context.spec.wavelength_m
    )
    length = fan.along[-1]
    if length.min(initial=np.inf) > 2 * context.gate[1]:
        return None
    looked = fan.some()
    real = _turned_about(ball, antennas, looked, gap, away)
    seen = (free(parts, real) * turned(context, antennas, real)).reshape(len(looked.names), _PLANES)
    if not seen.any():
        return None
    value = 2 * antennas.factor * fan_weights(fan) * np.interp(fan.names, looked.names, seen.mean(1))
    echo = accumulate(context, length / C0, value, grids, (1.0, 0.0))
    leads, count = fan.leads, len(fan.leads)
    via = np.full((count, 2), -1, np.int64)
    via[:, : bounces - 1] = ball.object_id
    next_to = abs(looked.names[:, None] - fan.names[leads]).argmin(0)
    points = real.corners[-2].reshape(len(looked.names), _PLANES, 3)[next_to, abs(seen[next_to]).argmax(1)]
    total = np.bincount(fan.led, echo.real, count) + 1j * np.bincount(fan.led, echo.imag, count)

    def again(factors: Complexes, others: Complexes) -> None:
        accumulate(context, length / C0, value * factors[fan.led], others, (1.0, 0.0))

    return EchoSet(np.full(count, ball.object_id, np.int32), points, total, length[leads] / C0, again, via)


def fan_weights(fan: Fan) -> Complexes:
    """What the rays (n) of a fan from a place on its first axis count for in a ball, all planes together.

    Of both ends, from which each path may be done, this is the share of one.
    """
    aside, legs = fan.points[..., 1], np.diff(fan.along, axis=0)
    across = np.sqrt(abs(fan.paths[0, :, 1] * aside[-1]) / (legs[-1] * fan.along[-1]))
    crossed = (aside[1:] * aside[:-1] < 0).sum(0)
    return np.asarray(fan.weights * across * (0.25j / np.sqrt(0.5j / np.pi)) * 1j ** (crossed % 4))


def _turned_about(ball: Ball, antennas: AntennaPair, fan: Fan, gap: Floats, away: float) -> Real:
    """The rays (n) of a fan in all planes (m) through the centre and the radar, one after the other (n m)."""
    _, _, axes = np.linalg.svd(gap[None] + 1e-12 * np.array([1.0, 2.0, 3.0]))
    axes[0] *= np.sign(axes[0] @ gap) or 1.0
    turn = (np.arange(_PLANES) + 0.5) * np.pi / _PLANES
    sides = np.cos(turn)[:, None] * axes[1] + np.sin(turn)[:, None] * axes[2]
    out = (fan.points[..., :1] * axes[0])[:, :, None] + fan.points[..., 1][..., None, None] * sides
    stops = out.reshape(len(fan.points), -1, 3)
    ends = [np.broadcast_to(origin, (1, *stops.shape[1:])) for origin in antennas.origins]
    shape = stops.shape[:2]
    return Real(np.concatenate([ends[0], ball.centre + stops, ends[1]]), -stops / ball.radius,
                np.full(shape, ball.depth), np.full(shape, ball.object_id), np.ones(shape[1], bool))  # fmt: skip
