"""What a ball or a dome echoes: Kirchhoff's integral over the sphere through its mesh's corners, ring by ring.

Flat facets of a ball differ from it by a depth that repeats from facet to facet, and so echo as a grating does. The
sphere itself is easier: seen from one place its points of one range r form a ring about the line to the centre,
and its area is R r / d dr per angle around it, d from the centre. Around a ring all but the range changes slowly (the
antenna, reflection, what stands before), so a few places make Fourier's series of that; round openings take arcs
out of the rings. What is left is one integral over the range [Balanis2012, ch. 7], whose ends are the echoes of the
near wall and the far one, with no ray to be found and nothing infinite where all of the wall focuses.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ullage.antenna import gain
from ullage.arrays import Bools, Complexes, Floats
from ullage.geometry import C0
from ullage.radar.arcs import reflection
from ullage.radar.balls import Ball
from ullage.radar.context import AntennaPair, RadarContext, transmission_to
from ullage.radar.echo_set import EchoSet
from ullage.radar.facets import Surfaces
from ullage.radar.wall_bounces import PULL_M, accumulate

LEAST_M = 0.05
"""Nearer to a ball the wave is no ray: its facets are done as they are [m]."""
_RINGS, _AROUND = 24, 16  # places at which the slow part is known: along the range, and around
_MOST = 5  # harmonics around
_NODES, _SHARES = np.polynomial.legendre.leggauss(3)


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A stretch of ranges over which a ball is seen from one side."""

    ball: Ball
    away: float  # of the radar from the centre [m]
    axes: Floats  # (3, 3) rows: the unit vector to the radar, and two across it
    low: float  # nearest range [m]
    high: float  # farthest [m]
    inner: bool  # seen from inside

    def points(self, ranges: Floats, around: Floats) -> Floats:
        """Points (n, m, 3) of the sphere at ranges (n) [m] and angles (m) around the line to the radar [rad]."""
        radius, away = self.ball.radius, self.away
        x = np.clip((radius**2 + away**2 - ranges**2) / (2 * radius * away), -1, 1)[:, None]
        y = np.sqrt(1 - x * x)
        places = np.stack(np.broadcast_arrays(x, y * np.cos(around), y * np.sin(around)), -1)
        return np.asarray(radius * places @ self.axes)


def taken(context: RadarContext, antennas: AntennaPair) -> list[Part]:
    """The balls and domes whose spheres echo instead of their facets, part by part."""
    wavelength = context.spec.wavelength_m
    most, out = np.sqrt(wavelength * context.gate[1] / 2), []
    middle = antennas.origins.mean(0)
    apart = apart_rad(context, antennas)
    for ball in context.world.balls:
        coarse = wavelength / 2 < ball.widest < most  # others are no grating, or mirrors of their own
        if coarse and smoothed(context, ball.object_id):
            parts = _parts(ball, middle)
            near = min(part.low for part in parts)
            clear = parts[0].inner or parts[0].away > ball.radius or not ball.holds(parts[0].axes[0] * ball.radius)
            if clear and near > max(LEAST_M, apart):
                out += [part for part in parts if part.low < context.gate[1]]
    return out


def smoothed(context: RadarContext, object_id: int) -> bool:
    """Whether an object's smooth surfaces echo instead of its facets: without echoes from within."""
    return bool((context.lag[object_id, 1:, 0] < 0).all() and not context.transmissive.thin[object_id])


def apart_rad(context: RadarContext, antennas: AntennaPair) -> float:
    """By so much, over the range [m], a path's phase changes at most if the antennas are one between them [rad]."""
    return float(((antennas.origins[1] - antennas.origins[0]) ** 2).sum()) / 4 * 2 * np.pi / context.spec.wavelength_m


def _parts(ball: Ball, origin: Floats) -> list[Part]:
    """Stretches of ranges over which a ball is seen from inside or from outside, near an opening from neither."""
    gap = origin - ball.centre
    away = max(float(np.linalg.norm(gap)), 1e-6)
    _, _, axes = np.linalg.svd(gap[None] + 1e-12 * np.array([1.0, 2.0, 3.0]))
    axes[0] *= np.sign(axes[0] @ gap) or 1.0
    low, high = _reach(ball, away, axes[0])
    if away < ball.radius:
        return [Part(ball, away, axes, low, high, True)]
    edge = np.sqrt(away**2 - ball.radius**2)
    parts = [Part(ball, away, axes, low, min(edge, high), False)] if low < edge else []
    if len(ball.caps) and high > edge:
        parts.append(Part(ball, away, axes, max(low, edge), high, True))
    return parts


def _reach(ball: Ball, away: float, axis: Floats) -> tuple[float, float]:
    """The ranges between which anything of a ball lies [m], by its largest opening."""
    low, high = 0.0, np.pi
    if len(ball.caps):
        cap = ball.caps[ball.caps[:, 3].argmin()]
        half = np.arccos(np.clip(-cap[3] / ball.radius, -1, 1))  # of what is left
        middle = np.arccos(np.clip(-cap[:3] @ axis, -1, 1))
        low, high = max(middle - half, 0.0), min(middle + half, np.pi)
    near, far = (np.sqrt(ball.radius**2 + away**2 - 2 * ball.radius * away * np.cos(angle)) for angle in (low, high))
    return float(near), float(far)


def accumulate_balls(
    context: RadarContext, parts: list[Surfaces], antennas: AntennaPair, grids: Complexes
) -> tuple[list[EchoSet], tuple[Bools | None, Bools | None]]:
    """Adds to the delay grids what balls and domes that stand still echo.

    Args:
        context: radar and scene.
        parts: what stands still and what moves.
        antennas: where the radar is.
        grids: (3, g) complex, added to.

    Returns:
        What was laid; which small triangles (f) and which flat faces (p) of what stands still are done so.
    """
    balls = taken(context, antennas) if context.world.balls else []
    if not balls:
        return [], (None, None)
    echoes = [told for part in balls if (told := _echoes_of(context, parts, part, antennas, grids)) is not None]
    small = np.logical_or.reduce([part.ball.small for part in balls])
    return echoes, (small, np.logical_or.reduce([part.ball.planar for part in balls]))


def _echoes_of(
    context: RadarContext, parts: list[Surfaces], part: Part, antennas: AntennaPair, grids: Complexes
) -> EchoSet | None:
    ball, wavelength = part.ball, context.spec.wavelength_m
    rings = _rings(part.low, part.high)
    around = np.asarray((np.arange(_AROUND) + 0.5) * (2 * np.pi / _AROUND), np.float64)
    points = part.points(rings, around)
    held = ball.holds(points)
    bare = _bare(context, antennas, part, ball.centre + points)
    series = np.fft.fft(bare, axis=1)[:, np.arange(-_MOST, _MOST + 1)] / _AROUND
    series = series * np.exp(-1j * np.arange(-_MOST, _MOST + 1) * around[0])
    size = np.asarray(abs(bare), np.float64)
    free, late = _free(context, parts, part, antennas, points, held, size)
    if not free.any():
        return None
    ranges, weights = _panels(part, wavelength / 4)
    mean = _summed(part, ranges, _between(rings, series * free[:, None], ranges))
    delay = 2 * ranges / C0 + np.interp(ranges, rings, late)
    value = 1j / (4 * np.pi) * antennas.factor * weights * ball.radius / part.away * ranges * mean
    echo = accumulate(context, delay, value, grids, (1.0, 0.0))
    at = np.clip(np.searchsorted(rings, ranges) - 1, 0, len(rings) - 2)
    up = (ranges - rings[at]) / np.maximum(rings[at + 1] - rings[at], 1e-12)
    up = up * up * (3 - 2 * up)  # rings fade into each other, or each would have echoes of its own ends

    def again(factors: Complexes, others: Complexes) -> None:
        accumulate(context, delay, value * (factors[at] * (1 - up) + factors[at + 1] * up), others, (1.0, 0.0))

    total = np.zeros(len(rings), complex)
    np.add.at(total, at, echo * (1 - up))
    np.add.at(total, at + 1, echo * up)
    best = (size * np.where(held, 1.0, 1e-9)).argmax(1)
    places = ball.centre + points[np.arange(len(rings)), best]
    return EchoSet(np.full(len(rings), ball.object_id, np.int32), places, total, 2 * rings / C0 + late, again)


def _rings(low: float, high: float) -> Floats:
    """Ranges at which the slow part is known: by their logarithm, close together at both ends, where echoes come."""
    share = (1 - np.cos(np.pi * np.arange(_RINGS) / (_RINGS - 1))) / 2
    return np.asarray(low * (high / low) ** share)


def _bare(context: RadarContext, antennas: AntennaPair, part: Part, points: Floats) -> Complexes:
    """The integrand (n, m) at points (n, m, 3) of a ball, but for the phase of the way there and back [1/m2]."""
    flat = points.reshape(-1, 3)
    paths = flat - antennas.origins[:, None]
    ranges = np.linalg.norm(paths, axis=2)
    paths /= ranges[..., None]
    inward = (part.ball.centre - flat) / part.ball.radius
    cosine = abs((paths * inward).sum(2)).mean(0)
    value = cosine * reflection(context, antennas, np.full(len(flat), part.ball.object_id), cosine, paths, inward)
    for way, frame, far in zip(paths, antennas.frames, ranges, strict=True):
        value *= gain(context.spec.antenna, way @ frame.T) / far
    if (antennas.origins[0] != antennas.origins[1]).any():
        one = np.linalg.norm(flat - antennas.origins.mean(0), axis=1)
        value *= np.exp(-2j * np.pi / context.spec.wavelength_m * (ranges.sum(0) - 2 * one))
    return np.asarray(value.reshape(points.shape[:2]))


def _free(
    context: RadarContext,
    parts: list[Surfaces],
    part: Part,
    antennas: AntennaPair,
    points: Floats,
    held: Bools,
    weights: Floats,
) -> tuple[Complexes, Floats]:
    """Mean factor (n) of what stands before each ring's points (n, m, 3) that are held (n, m), and its delay [s]."""
    ball = part.ball
    scale = 1 - (ball.depth + PULL_M) / ball.radius if part.inner else 1 + PULL_M / ball.radius
    seen, late = np.zeros(held.shape, complex), np.zeros(held.shape)
    seen[held], late[held] = transmission_to(context, parts, antennas, ball.centre + scale * points[held])
    share = np.where(held, weights + 1e-12 * weights.max(), 0.0)
    share = share / np.maximum(share.sum(1, keepdims=True), 1e-300)
    some = np.flatnonzero(held.any(1))
    if not len(some):
        return np.zeros(len(held), complex), np.zeros(len(held))
    nearest = some[abs(np.arange(len(held))[:, None] - some).argmin(1)]  # a ring of which so few places tell nothing
    return (share * seen).sum(1)[nearest], (share * late).sum(1)[nearest]


def _panels(part: Part, width: float) -> tuple[Floats, Floats]:
    """Gauss's points (n) over the ranges of a part, broken where a ring touches an opening, and their weights [m]."""
    ball, breaks = part.ball, [part.low, part.high]
    for cap in ball.caps:
        tilt, half = np.arccos(np.clip(cap[:3] @ part.axes[0], -1, 1)), np.arccos(cap[3] / ball.radius)
        angles = np.array([tilt - half, tilt + half])
        breaks += list(np.sqrt(ball.radius**2 + part.away**2 - 2 * ball.radius * part.away * np.cos(angles)))
    ends = np.unique(np.clip(breaks, part.low, part.high))
    told = [_stretch(a, b, width, curved=len(ball.caps) > 0) for a, b in pairwise(ends)]
    ranges, weights = (np.concatenate(rows) for rows in zip(*told, strict=True))
    return ranges, weights


def _stretch(low: float, high: float, width: float, *, curved: bool) -> tuple[Floats, Floats]:
    """Gauss's points from end to end, no panel wider than that; where arcs end as roots do, over an angle [m]."""
    middle, half = (low + high) / 2, (high - low) / 2
    count = int(np.ceil((np.pi / 2 if curved else 1.0) * 2 * half / width))
    panel = 1 / count
    t = ((2 * np.arange(count) + 1 - count) * panel)[:, None] + panel * _NODES
    weights = np.broadcast_to(panel * _SHARES, t.shape)
    if curved:
        t, weights = np.sin(np.pi / 2 * t), weights * (np.pi / 2) * np.cos(np.pi / 2 * t)
    return (middle + half * t).ravel(), (half * weights).ravel()


def _between(known: Floats, rows: Complexes, wanted: Floats) -> Complexes:
    """Rows (n, m) known at some ranges (n), between them (k, m): Hermite's cubics over the logarithm of the range."""
    u, x = np.log(known), np.log(wanted)
    slopes = np.gradient(rows, u, axis=0) if len(u) > 2 else np.zeros_like(rows)
    i = np.clip(np.searchsorted(u, x) - 1, 0, len(u) - 2)
    step = np.maximum(u[i + 1] - u[i], 1e-12)
    t = ((x - u[i]) / step)[:, None]
    left = (1 + 2 * t) * rows[i] + t * step[:, None] * slopes[i]
    right = (3 - 2 * t) * rows[i + 1] + (t - 1) * step[:, None] * slopes[i + 1]
    return np.asarray((1 - t) ** 2 * left + t**2 * right)


def _summed(part: Part, ranges: Floats, series: Complexes) -> Complexes:
    """What Fourier's series (n, 2 k + 1) of rings at ranges (n) amount to around what openings leave of them."""
    ball, total = part.ball, 2 * np.pi * series[:, _MOST]
    if not len(ball.caps):
        return total
    x = (ball.radius**2 + part.away**2 - ranges**2) / (2 * ball.radius * part.away)
    y = np.sqrt(np.maximum(1 - x * x, 1e-18))
    orders = np.arange(-_MOST, _MOST + 1)
    for cap in ball.caps:
        along, one, other = part.axes @ cap[:3]
        level = cap[3] / ball.radius - x * along
        half = np.arccos(np.clip(level / (y * np.maximum(np.hypot(one, other), 1e-12)), -1, 1))[:, None]
        arc = 2 * half * np.sinc(orders * half / np.pi)
        total = total - (series * arc * np.exp(1j * orders * np.arctan2(other, one))).sum(1)
    return total
