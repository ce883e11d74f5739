"""Echoes of spheres and domes: Kirchhoff's integral over the sphere through the corners of a mesh, ring by ring.

Flat facets of a sphere lie inside it by a depth that repeats from facet to facet, so they echo like a grating. The
sphere itself has a simple integral. Its points at one range r from the radar form a ring around the line to the centre.
A ring has the area R r / d dr per angle, with the radar at distance d from the centre. Around a ring the antenna gain,
the reflection and the transmission of other objects change slowly, so a short Fourier series represents them. Circular
openings remove arcs from the rings. One integral over range is left [Balanis2012, ch. 7]. Its ends are the echoes of
the near and the far wall. It needs no rays, and it stays finite where the whole wall focuses.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ullage.arrays import Bools, Complexes, Floats
from ullage.geometry import C0
from ullage.radar.context import AntennaPair, RadarContext, RadarFrame
from ullage.radar.echo_set import EchoSet
from ullage.radar.reflected_paths import accumulate, scattered
from ullage.radar.reflectors import PULL_M
from ullage.radar.spheres import Sphere

LEAST_M = 0.05
"""Least distance to a sphere [m]: closer by, its facets echo by themselves."""
_RINGS, _AROUND = 24, 16  # samples of the slowly varying factor: along range, and around each ring
_MOST = 5  # largest order of the Fourier series
_NODES, _SHARES = np.polynomial.legendre.leggauss(3)


@dataclass(frozen=True, slots=True, eq=False)
class SpherePart:
    """An interval of ranges over which the radar sees a sphere from one side."""

    sphere: Sphere
    away: float  # distance of the radar from the centre [m]
    axes: Floats  # (3, 3) rows: the unit vector to the radar, and two across it
    low: float  # nearest range [m]
    high: float  # farthest [m]
    inner: bool  # seen from inside

    def points(self, ranges: Floats, around: Floats) -> Floats:
        """Return points (n, m, 3) of the sphere at ranges (n) [m] and angles (m) around the line to the radar [rad]."""
        radius, away = self.sphere.radius, self.away
        x = np.clip((radius**2 + away**2 - ranges**2) / (2 * radius * away), -1, 1)[:, None]
        y = np.sqrt(1 - x * x)
        places = np.stack(np.broadcast_arrays(x, y * np.cos(around), y * np.sin(around)), -1)
        return np.asarray(radius * places @ self.axes)


def visible_parts(context: RadarContext, antennas: AntennaPair) -> list[SpherePart]:
    """Select the spheres and domes that echo instead of their facets, part by part."""
    middle, out = antennas.origins.mean(0), []
    apart = bistatic_phase_rad(context, antennas)
    for sphere in context.world.spheres:
        coarse = (
            context.spec.wavelength_m / 2 < sphere.widest < context.widest_m
        )  # finer facets are no grating, coarser ones are mirrors
        if coarse and smoothed(context, sphere.object_id):
            parts = _parts(sphere, middle)
            near = min(part.low for part in parts)
            clear = (
                parts[0].inner or parts[0].away > sphere.radius or not sphere.holds(parts[0].axes[0] * sphere.radius)
            )
            if clear and near > max(LEAST_M, apart):
                out += [part for part in parts if part.low < context.gate[1]]
    return out


def smoothed(context: RadarContext, object_id: int) -> bool:
    """Return whether fitted surfaces replace an object's facets: only without echoes from its inside."""
    return bool((context.lag[object_id, 1:, 0] < 0).all() and not context.transmissive.thin[object_id])


def bistatic_phase_rad(context: RadarContext, antennas: AntennaPair) -> float:
    """Bound the phase error [rad] times range [m] of one antenna midway between transmitter and receiver."""
    return float(((antennas.origins[1] - antennas.origins[0]) ** 2).sum()) / 4 * 2 * np.pi / context.spec.wavelength_m


def _parts(sphere: Sphere, origin: Floats) -> list[SpherePart]:
    """Find the intervals of ranges over which the radar sees a sphere from inside or from outside."""
    gap = origin - sphere.centre
    away = max(float(np.linalg.norm(gap)), 1e-6)
    _, _, axes = np.linalg.svd(gap[None] + 1e-12 * np.array([1.0, 2.0, 3.0]))
    axes[0] *= np.sign(axes[0] @ gap) or 1.0
    low, high = _reach(sphere, away, axes[0])
    if away < sphere.radius:
        return [SpherePart(sphere, away, axes, low, high, True)]
    edge = np.sqrt(away**2 - sphere.radius**2)
    parts = [SpherePart(sphere, away, axes, low, min(edge, high), False)] if low < edge else []
    if len(sphere.caps) and high > edge:
        parts.append(SpherePart(sphere, away, axes, max(low, edge), high, True))
    return parts


def _reach(sphere: Sphere, away: float, axis: Floats) -> tuple[float, float]:
    """Bound the ranges of a sphere's points [m], by its largest opening."""
    low, high = 0.0, np.pi
    if len(sphere.caps):
        cap = sphere.caps[sphere.caps[:, 3].argmin()]
        half = np.arccos(np.clip(-cap[3] / sphere.radius, -1, 1))  # half angle of the rest
        middle = np.arccos(np.clip(-cap[:3] @ axis, -1, 1))
        low, high = max(middle - half, 0.0), min(middle + half, np.pi)
    near, far = (
        np.sqrt(sphere.radius**2 + away**2 - 2 * sphere.radius * away * np.cos(angle)) for angle in (low, high)
    )
    return float(near), float(far)


def accumulate_spheres(frame: RadarFrame) -> tuple[list[EchoSet], tuple[Bools | None, Bools | None]]:
    """Add the echoes of spheres and domes at rest to the delay grids.

    Returns:
        The echoes, and masks of the small triangles (f) and flat faces (p) at rest that they replace.
    """
    visible = visible_parts(frame.context, frame.antennas) if frame.context.world.spheres else []
    if not visible:
        return [], (None, None)
    echoes = [echo for part in visible if (echo := _echoes_of(frame, part)) is not None]
    small = np.logical_or.reduce([part.sphere.small for part in visible])
    return echoes, (small, np.logical_or.reduce([part.sphere.planar for part in visible]))


def _echoes_of(frame: RadarFrame, part: SpherePart) -> EchoSet | None:
    context, sphere, wavelength = frame.context, part.sphere, frame.context.spec.wavelength_m
    rings = _ring_ranges(part.low, part.high)
    around = np.asarray((np.arange(_AROUND) + 0.5) * (2 * np.pi / _AROUND), np.float64)
    points = part.points(rings, around)
    present = sphere.holds(points)
    integrand = _integrand(frame, part, sphere.centre + points)
    series = np.fft.fft(integrand, axis=1)[:, np.arange(-_MOST, _MOST + 1)] / _AROUND
    series = series * np.exp(-1j * np.arange(-_MOST, _MOST + 1) * around[0])
    size = np.asarray(abs(integrand), np.float64)
    free, late = _transmission(frame, part, points, present, size)
    if not free.any():
        return None
    ranges, weights = _panels(part, wavelength / 4)
    mean = _sum_rings(part, ranges, _interpolate(rings, series * free[:, None], ranges))
    delay = 2 * ranges / C0 + np.interp(ranges, rings, late)
    value = 1j / (4 * np.pi) * frame.antennas.factor * weights * sphere.radius / part.away * ranges * mean
    echo = accumulate(context, delay, value, frame.grids, (1.0, 0.0))
    at = np.clip(np.searchsorted(rings, ranges) - 1, 0, len(rings) - 2)
    up = (ranges - rings[at]) / np.maximum(rings[at + 1] - rings[at], 1e-12)
    up = up * up * (3 - 2 * up)  # blend the rings, since hard ends would echo

    def again(factors: Complexes, others: Complexes) -> None:
        accumulate(context, delay, value * (factors[at] * (1 - up) + factors[at + 1] * up), others, (1.0, 0.0))

    total = np.zeros(len(rings), complex)
    np.add.at(total, at, echo * (1 - up))
    np.add.at(total, at + 1, echo * up)
    best = (size * np.where(present, 1.0, 1e-9)).argmax(1)
    places = sphere.centre + points[np.arange(len(rings)), best]
    return EchoSet(np.full(len(rings), sphere.object_id, np.int32), places, total, 2 * rings / C0 + late, again)


def _ring_ranges(low: float, high: float) -> Floats:
    """Choose the sampled ranges: in the logarithm, close together at both ends, where the echoes arise."""
    share = (1 - np.cos(np.pi * np.arange(_RINGS) / (_RINGS - 1))) / 2
    return np.asarray(low * (high / low) ** share)


def _integrand(frame: RadarFrame, part: SpherePart, points: Floats) -> Complexes:
    """Compute the integrand (n, m) at points (n, m, 3) of a sphere, without the phase of the two-way path [1/m2]."""
    flat, origins = points.reshape(-1, 3), frame.antennas.origins
    ranges = np.linalg.norm(flat - origins[:, None], axis=2)
    inward, ids = (part.sphere.centre - flat) / part.sphere.radius, np.full(len(flat), part.sphere.object_id)
    value = scattered(frame, ids, flat, inward) / ranges.prod(0)
    if (origins[0] != origins[1]).any():
        one = np.linalg.norm(flat - origins.mean(0), axis=1)
        value *= np.exp(-2j * np.pi / frame.context.spec.wavelength_m * (ranges.sum(0) - 2 * one))
    return np.asarray(value.reshape(points.shape[:2]))


def _transmission(
    frame: RadarFrame, part: SpherePart, points: Floats, present: Bools, weights: Floats
) -> tuple[Complexes, Floats]:
    """Average the transmission (n) to each ring's points (n, m, 3) that are present (n, m), and its delay [s]."""
    sphere = part.sphere
    scale = 1 - (sphere.depth + PULL_M) / sphere.radius if part.inner else 1 + PULL_M / sphere.radius
    seen, late = np.zeros(present.shape, complex), np.zeros(present.shape)
    seen[present], late[present] = frame.transmission_to(sphere.centre + scale * points[present])
    share = np.where(present, weights + 1e-12 * weights.max(), 0.0)
    share = share / np.maximum(share.sum(1, keepdims=True), 1e-300)
    some = np.flatnonzero(present.any(1))
    if not len(some):
        return np.zeros(len(present), complex), np.zeros(len(present))
    nearest = some[abs(np.arange(len(present))[:, None] - some).argmin(1)]  # empty rings take their neighbour
    return (share * seen).sum(1)[nearest], (share * late).sum(1)[nearest]


def _panels(part: SpherePart, width: float) -> tuple[Floats, Floats]:
    """Return Gauss points (n) over the ranges of a part, split where a ring touches an opening, and weights [m]."""
    sphere, breaks = part.sphere, [part.low, part.high]
    for cap in sphere.caps:
        tilt, half = np.arccos(np.clip(cap[:3] @ part.axes[0], -1, 1)), np.arccos(cap[3] / sphere.radius)
        angles = np.array([tilt - half, tilt + half])
        breaks += list(np.sqrt(sphere.radius**2 + part.away**2 - 2 * sphere.radius * part.away * np.cos(angles)))
    ends = np.unique(np.clip(breaks, part.low, part.high))
    pieces = [_gauss_points(a, b, width, curved=len(sphere.caps) > 0) for a, b in pairwise(ends)]
    ranges, weights = (np.concatenate(rows) for rows in zip(*pieces, strict=True))
    return ranges, weights


def _gauss_points(low: float, high: float, width: float, *, curved: bool) -> tuple[Floats, Floats]:
    """Return Gauss points and weights from `low` to `high` in panels of at most `width` [m].

    Arcs that openings cut off grow as square roots at the ends: `curved` integrates over an angle instead.
    """
    middle, half = (low + high) / 2, (high - low) / 2
    count = int(np.ceil((np.pi / 2 if curved else 1.0) * 2 * half / width))
    panel = 1 / count
    t = ((2 * np.arange(count) + 1 - count) * panel)[:, None] + panel * _NODES
    weights = np.broadcast_to(panel * _SHARES, t.shape)
    if curved:
        t, weights = np.sin(np.pi / 2 * t), weights * (np.pi / 2) * np.cos(np.pi / 2 * t)
    return (middle + half * t).ravel(), (half * weights).ravel()


def _interpolate(known: Floats, rows: Complexes, wanted: Floats) -> Complexes:
    """Interpolate rows (n, m) at ranges (n) to other ranges (k, m): Hermite cubics in the logarithm of range."""
    u, x = np.log(known), np.log(wanted)
    slopes = np.gradient(rows, u, axis=0) if len(u) > 2 else np.zeros_like(rows)
    i = np.clip(np.searchsorted(u, x) - 1, 0, len(u) - 2)
    step = np.maximum(u[i + 1] - u[i], 1e-12)
    t = ((x - u[i]) / step)[:, None]
    left = (1 + 2 * t) * rows[i] + t * step[:, None] * slopes[i]
    right = (3 - 2 * t) * rows[i + 1] + (t - 1) * step[:, None] * slopes[i + 1]
    return np.asarray((1 - t) ** 2 * left + t**2 * right)


def _sum_rings(part: SpherePart, ranges: Floats, series: Complexes) -> Complexes:
    """Integrate the Fourier series (n, 2 k + 1) of rings at ranges (n) around each ring, less the openings."""
    sphere, total = part.sphere, 2 * np.pi * series[:, _MOST]
    if not len(sphere.caps):
        return total
    x = (sphere.radius**2 + part.away**2 - ranges**2) / (2 * sphere.radius * part.away)
    y = np.sqrt(np.maximum(1 - x * x, 1e-18))
    orders = np.arange(-_MOST, _MOST + 1)
    for cap in sphere.caps:
        along, one, other = part.axes @ cap[:3]
        level = cap[3] / sphere.radius - x * along
        half = np.arccos(np.clip(level / (y * np.maximum(np.hypot(one, other), 1e-12)), -1, 1))[:, None]
        arc = 2 * half * np.sinc(orders * half / np.pi)
        total = total - (series * arc * np.exp(1j * orders * np.arctan2(other, one))).sum(1)
    return total
