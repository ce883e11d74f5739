"""Geometric paths over flat faces and curved bodies: planes on the way, visibility, reflection, and the echoes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import fresnel

from ullage.arrays import Bools, Complexes, Floats, Longs
from ullage.geometry import C0
from ullage.kernels import impulses as kernel
from ullage.kernels.facets import LitFaces
from ullage.kernels.fermat import CYLINDER
from ullage.kernels.outlines import weigh
from ullage.radar.context import AntennaPair, RadarContext, RadarFrame
from ullage.radar.echo_set import EchoSet
from ullage.radar.facets import Surfaces
from ullage.radar.reflectors import PULL_M, ReflectorSet
from ullage.radar.visibility import between


@dataclass(frozen=True, slots=True, eq=False)
class ReflectedPaths:
    """Paths (n) from antenna to antenna over the same number of reflectors (s) each."""

    corners: Floats  # (s + 2, n, 3) [m]
    normals: Floats  # (s, n, 3) towards the waves
    on: Longs  # (s, n) row of each reflector
    bends: Floats  # (s, n) second derivative of the length along its axis, stationary over the rest [1/m]
    reflectors: ReflectorSet
    there: Bools  # (n) whether the path exists

    def take(self, which: NDArray[np.generic]) -> ReflectedPaths:
        """Select some paths."""
        return replace(self, corners=self.corners[:, which], normals=self.normals[:, which], on=self.on[:, which],
                       bends=self.bends[:, which], there=self.there[which])  # fmt: skip

    def reversed(self) -> ReflectedPaths:
        """Return the same paths from the other antenna."""
        return replace(self, corners=self.corners[::-1], normals=self.normals[::-1], on=self.on[::-1],
                       bends=self.bends[::-1])  # fmt: skip

    def along(self) -> Floats:
        """Return where along the axes of the reflectors the paths meet them (s, n) [m]."""
        _, centres, axes, *_ = self.reflectors.surfaces
        return np.asarray(((self.corners[1:-1] - centres[self.on]) * axes[self.on, 2]).sum(2))

    def within_ends(self) -> ReflectedPaths:
        """Move corners past the ends of drums and walls onto these."""
        kinds, _, axes, _, extents = self.reflectors.surfaces
        along, ends = self.along(), extents[self.on]
        inner = np.clip(along, ends[..., 0] + PULL_M, ends[..., 1] - PULL_M)
        corners = self.corners.copy()
        corners[1:-1] += np.where(kinds[self.on] == CYLINDER, inner - along, 0.0)[..., None] * axes[self.on, 2]
        return replace(self, corners=corners)

    def folded(self, plane: int, mirrored: Bools) -> ReflectedPaths:
        """Reflect paths that begin at an image behind a plane where they come through it; this adds a corner.

        Args:
            plane: row of the plane.
            mirrored: (s, n) whether reflectors have images: those that stand square on the plane.
        """
        rows, last = np.arange(len(self.there)), len(self.corners) - 1
        normal, point = self.reflectors.surfaces.axes[plane, 2], self.reflectors.surfaces.centres[plane]
        gaps = (self.corners - point) @ normal
        axis = normal * np.sign(gaps[-1])[:, None]
        gaps = gaps * np.sign(gaps[-1])
        behind = gaps < 0
        first = np.clip(behind.argmin(0), 1, last)  # corner in front of the plane
        a, b, gap, then = *(self.corners[k, rows] for k in (first - 1, first)), gaps[first - 1, rows], gaps[first, rows]
        crossing = a + (gap / np.where(gap < then, gap - then, -1.0))[:, None] * (b - a)
        order = np.arange(last + 2)[:, None]
        order = order - (order > first)
        corners = np.take_along_axis(self.corners - 2 * (gaps * behind)[..., None] * axis, order[..., None], 0)
        inner = np.minimum(order[1:-1] - 1, last - 2)
        normals = np.take_along_axis(self.normals, inner[..., None], 0)
        on, bends = np.take_along_axis(self.on, inner, 0), np.take_along_axis(self.bends, inner, 0)
        corners[first, rows], normals[first - 1, rows], on[first - 1, rows] = crossing, axis, plane
        there = self.there & behind[0] & (behind.sum(0) == first) & (mirrored | ~behind[1:-1]).all(0)
        return replace(self, corners=corners, normals=normals, on=on, bends=bends, there=there)


def end_factors(path: ReflectedPaths, wavelength: float) -> Complexes:
    """Compute what the ends of drums and walls leave of waves (n), by Fresnel integrals along the axes.

    Paths may run past the ends, and walls without ends have infinite ones.
    """
    kinds, *_, extents = path.reflectors.surfaces
    ended = kinds[path.on] == CYLINDER
    root = np.sqrt(np.where(ended, np.maximum(2 * path.bends, 0.0), 0.0) / wavelength)
    gaps = extents[path.on] - path.along()[..., None]
    sine, cosine = fresnel(np.where(np.isinf(gaps), gaps, gaps * root[..., None]))
    return np.asarray(np.where(ended, np.diff(cosine - 1j * sine, axis=2)[..., 0] / (1 - 1j), 1.0).prod(0))


def free(parts: list[Surfaces], path: ReflectedPaths) -> Bools:
    """Return which paths (n) are free and touch existing surfaces: one may have a hole or end."""
    stops, lift = path.corners[1:-1], path.normals * (path.reflectors.depths[path.on] + PULL_M)[..., None]
    corners = np.concatenate([path.corners[:1], stops + lift, path.corners[-1:]])
    here, there = np.concatenate([corners[:-1], stops + lift]), np.concatenate([corners[1:], stops - lift])
    clear = between(parts, here.reshape(-1, 3), there.reshape(-1, 3)).reshape(len(here), -1)
    legs = len(corners) - 1
    return np.asarray(path.there & clear[:legs].all(0) & ~clear[legs:].any(0))


def reflection_gains(context: RadarContext, antennas: AntennaPair, path: ReflectedPaths) -> Complexes:
    """Compute the products (n) of antenna gains and reflections; the pattern is interpolated, to 3e-4."""
    out = np.empty(len(path.there), complex)
    corners, normals = (np.ascontiguousarray(row) for row in (path.corners, path.normals))
    paths = kernel.ReflectedPaths(corners, normals, np.ascontiguousarray(path.reflectors.object_ids[path.on]))
    scratch = kernel.FieldScratch(np.empty((2, 3)), np.empty(3, complex))
    kernel.polarised(paths, context.bounce, context.antennas(antennas), scratch, out)
    return out


def scattered(frame: RadarFrame, object_ids: Longs, points: Floats, normals: Floats) -> Complexes:
    """Compute the products (n) of antenna gains, reflection and cos(incidence) at points (n, 3) of surfaces [m]."""
    reflection = frame.context.reflection._replace(gamma=frame.context.bounce)
    lit = LitFaces(np.ascontiguousarray(normals), object_ids.astype(np.int32), frame.radar, reflection)
    out = np.empty(len(points), complex)
    weigh(points, lit, out)
    return out


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


def stationary(places: Floats, slopes: Floats, step: float) -> tuple[Longs, Longs]:
    """Find the paths (m) that are stationary among neighbours around a wall, and the nearest of them for each path (n).

    Args:
        places: where each path meets the wall (n), in rising order, as shares of its circumference.
        slopes: derivatives of the lengths along the wall (n).
        step: distance of neighbours; paths further apart have none in between.
    """
    after = np.roll(np.arange(len(places)), -1)
    near = (places[after] - places) % 1 < 1.5 * step
    here = np.flatnonzero((slopes * slopes[after] <= 0) & near)
    leads = np.where(abs(slopes[here]) < abs(slopes[after[here]]), here, after[here])
    if not len(leads):
        leads = np.array([abs(slopes).argmin()])
    apart = abs(places[:, None] - places[leads])
    return leads, np.minimum(apart, 1 - apart).argmin(1)


@dataclass(frozen=True, slots=True, eq=False)
class PathSum:
    """Parts (n) of a sum over paths, of which some are stationary and lead the parts next to them."""

    lengths: Floats  # (n) [m]
    values: Complexes  # (n)
    leads: Longs  # (m) parts that lead
    led: Longs  # (n) which of these leads each part
    shares: tuple[float, float]  # as of `accumulate`


def accumulate_paths(frame: RadarFrame, paths: ReflectedPaths, parts: PathSum) -> EchoSet:
    """Add a sum over paths to the grids; return one echo for each path (m) that leads.

    The last reflector that is no flat face scatters the wave, and the others are on the way.
    """
    delay, count, many = parts.lengths / C0, len(parts.leads), len(paths.on)
    echo, each = accumulate(frame.context, delay, parts.values, frame.grids, parts.shares), np.arange(len(parts.leads))
    total = np.bincount(parts.led, echo.real, count) + 1j * np.bincount(parts.led, echo.imag, count)
    at = many - 1 - (~paths.reflectors.flat[paths.on[::-1]]).argmax(0)
    object_ids = paths.reflectors.object_ids[paths.on]
    via = np.full((count, max(many - 1, 2)), -1, np.int64)
    for s in range(many - 1):
        via[:, s] = object_ids[np.where(at <= s, s + 1, s), each]

    def again(factors: Complexes, others: Complexes) -> None:
        accumulate(frame.context, delay, parts.values * factors[parts.led], others, parts.shares)

    return EchoSet(object_ids[at, each].astype(np.int32), paths.corners[1 + at, each], total, delay[parts.leads],
                   again, via, at)  # fmt: skip
