"""Loops that draw surfaces into the cells of a volume."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Bools, Floats, Ints
from ullage.kernels.loops import inner, loop

BEFORE_M = 0.1  # an echo is not hidden by what lies this near before it
BODY_M = 0.25  # radius about the sensor that is free
RINGS, SPOKES = 2, 8  # rays across the path of an echo, besides the middle one


class Box(NamedTuple):
    """Cells of a volume."""

    x: float  # lower corner [m]
    y: float
    z: float
    step: float  # edge of a cell [m]
    levels: int
    rows: int
    columns: int


class SpatialViews(NamedTuple):
    """Echoes of surfaces, one row for each keyframe that saw one."""

    position: NDArray[np.float64]  # (k, 3) of the keyframe [m]
    unit: NDArray[np.float64]  # (k, 3) direction
    frame: NDArray[np.float64]  # (k, 2, 3) unit vectors across it
    range_m: NDArray[np.float64]  # (k)
    half_m: NDArray[np.float64]  # (k, 2) half widths of the surface that the echo shows, along the frame
    bend: NDArray[np.float64]  # (k, 2) curvature of the surface, above 0 where it bends away from the sensor [1/m]
    level: NDArray[np.float64]  # (k) amplitude times range [m]
    weight: NDArray[np.float64]  # (k) evidence of the echo


@inner()
def cell_of(box: Box, x: float, y: float, z: float) -> int:
    """Flat index of the cell that holds a point, or -1."""
    i = math.floor((z - box.z) / box.step)
    j = math.floor((y - box.y) / box.step)
    k = math.floor((x - box.x) / box.step)
    if i < 0 or j < 0 or k < 0 or i >= box.levels or j >= box.rows or k >= box.columns:
        return -1
    return (i * box.rows + j) * box.columns + k


@inner()
def _at(box: Box, views: SpatialViews, k: int, far: float, a: float, b: float) -> int:
    """Cell at a distance along the direction of an echo, and at two distances across it."""
    p, u, f = views.position[k], views.unit[k], views.frame[k]
    return cell_of(
        box,
        p[0] + far * u[0] + a * f[0, 0] + b * f[1, 0],
        p[1] + far * u[1] + a * f[0, 1] + b * f[1, 1],
        p[2] + far * u[2] + a * f[0, 2] + b * f[1, 2],
    )


@loop()
def draw_discs(
    box: Box, views: SpatialViews, alive: Bools, widening: float, evidence: Floats, level: Floats, mark: Ints
) -> None:
    """Add the evidence of each echo to the cells that it shows, once a cell.

    Args:
        box: the cells.
        views: the echoes.
        alive: (k) which count.
        widening: factor on the half widths.
        evidence: (cells) added to.
        level: (cells) raised to the level of the strongest echo.
        mark: (cells) int32, zeros; set to the number of the last echo.
    """
    for k in range(len(alive)):
        if not alive[k]:
            continue
        one, two = widening * views.half_m[k, 0], widening * views.half_m[k, 1]
        m, n = math.ceil(one / (0.5 * box.step)), math.ceil(two / (0.5 * box.step))
        for i in range(-m, m + 1):
            for j in range(-n, n + 1):
                a, b = one * i / max(m, 1), two * j / max(n, 1)
                if m > 0 and n > 0 and (i / m) ** 2 + (j / n) ** 2 > 1.0001:
                    continue
                deep = views.range_m[k] + 0.5 * (a * a * views.bend[k, 0] + b * b * views.bend[k, 1])
                cell = _at(box, views, k, deep, a, b)
                if cell >= 0 and mark[cell] != k + 1:
                    mark[cell] = k + 1
                    evidence[cell] += views.weight[k]
                    level[cell] = max(level[cell], views.level[k])


@inner()
def _strand(j: int, half: float) -> tuple[float, float]:
    """Distances of a ray across the middle of a path."""
    if j == 0:
        return 0.0, 0.0
    radius, turn = half * (1 + (j - 1) // SPOKES) / RINGS, 2 * math.pi * ((j - 1) % SPOKES) / SPOKES
    return radius * math.cos(turn), radius * math.sin(turn)


@inner()
def _blocked(box: Box, views: SpatialViews, evidence: Floats, level: Floats, k: int, least: float, zone: float) -> bool:
    """Whether every ray of a path crosses a surface that reflects at least as much."""
    range_m, own = views.range_m[k], _at(box, views, k, views.range_m[k], 0.0, 0.0)
    bound = max(least, 0.5 * evidence[own] if own >= 0 else 0.0)
    for j in range(1 + RINGS * SPOKES):
        crosses = False
        for i in range(8, int((range_m - BEFORE_M) / (0.25 * box.step))):
            far = 0.25 * box.step * i
            a, b = _strand(j, zone * math.sqrt(far * (1 - far / range_m)))
            cell = _at(box, views, k, far, a, b)
            if cell >= 0 and cell != own and evidence[cell] > bound and level[cell] > views.level[k]:
                crosses = True
                break
        if not crosses:
            return False
    return True


@loop()
def find_hidden(
    box: Box, views: SpatialViews, evidence: Floats, level: Floats, least: float, zone: Floats, alive: Bools
) -> None:
    """Drop echoes whose path a surface blocks that is surer than theirs and reflects at least as much.

    Args:
        box: the cells.
        views: the echoes.
        evidence: (cells) of surfaces.
        level: (cells) of the strongest echo of each [m].
        least: evidence of an occupied cell.
        zone: (k) half width that blocks an echo of such a level, over the root of the distance [sqrt(m)].
        alive: (k) set to False where the path is blocked.
    """
    for k in range(len(alive)):
        if alive[k]:
            alive[k] = not _blocked(box, views, evidence, level, k, least, zone[k])


@loop()
def find_crossed(
    box: Box,
    views: SpatialViews,
    evidence: Floats,
    level: Floats,
    least: float,
    alive: Bools,
    tube: float,
    crossed: Floats,
) -> None:
    """Add up the weights of the echoes that came through each cell, though a surface fills their path there.

    Such an echo contradicts an opaque surface. Only echoes stronger than the surface count, since a weaker one may be
    an image in it. Things narrower than the path, such as poles, do not block an echo.

    Args:
        box: the cells.
        views: the echoes.
        evidence: (cells) of surfaces.
        level: (cells) of the strongest echo of each [m].
        least: evidence of an occupied cell.
        alive: (k) which count.
        tube: half width of a path over the root of the distance [sqrt(m)].
        crossed: (cells) added to.
    """
    met = np.empty(1 + RINGS * SPOKES, np.int64)
    for k in range(len(alive)):
        if not alive[k]:
            continue
        met[:] = -1
        for j in range(len(met)):
            for i in range(int((views.range_m[k] - BEFORE_M) / (0.4 * box.step))):
                far = 0.4 * box.step * i
                if far <= BODY_M:
                    continue
                a, b = _strand(j, tube * math.sqrt(far))
                cell = _at(box, views, k, far, a, b)
                if cell >= 0 and evidence[cell] >= least and level[cell] < views.level[k]:
                    met[j] = cell
                    break
            if met[j] < 0:
                break
        if met.min() >= 0:
            for j in range(len(met)):
                fresh = True
                for i in range(j):
                    fresh = fresh and met[i] != met[j]
                if fresh:
                    crossed[met[j]] += views.weight[k]
