"""Loops that draw surfaces and the space before them into the cells of a plane."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Bools, Floats
from ullage.kernels.loops import inner, loop

BEFORE_M = 0.1  # an echo is not hidden by what lies this near before it
BODY_M = 0.25  # radius about the sensor that is free
STRANDS = 5  # rays across an echo's path
STRAIGHT = 1e-6  # turn of a surface below which it is a line [rad]
PARTS = 3  # of the edge of a cell: a cell is free where all its parts are


class Views(NamedTuple):
    """Echoes of surfaces, one row for each keyframe that saw one."""

    position: NDArray[np.float64]  # (k, 2) of the keyframe [m]
    state: NDArray[np.float64]  # (k, 3) range [m], bearing [rad], curvature of the range [1/m]
    half_m: NDArray[np.float64]  # (k) half width of the surface that the echo shows
    bend: NDArray[np.float64]  # (k) curvature of the surface, above 0 where it bends away from the sensor [1/m]
    level: NDArray[np.float64]  # (k) amplitude times range [m]
    weight: NDArray[np.float64]  # (k) evidence of the echo


class Plane(NamedTuple):
    """Cells of a plane."""

    x: float  # lower corner [m]
    y: float
    step: float  # edge of a cell [m]
    rows: int
    columns: int


@inner()
def _cell(plane: Plane, x: float, y: float) -> int:
    """Flat index of the cell that holds a point, or -1."""
    column, row = math.floor((x - plane.x) / plane.step), math.floor((y - plane.y) / plane.step)
    if column < 0 or row < 0 or column >= plane.columns or row >= plane.rows:
        return -1
    return row * plane.columns + column


@inner()
def _point(views: Views, k: int, y: float) -> tuple[float, float]:
    """Point of a surface at a distance `y` along it from the specular point, on a circle."""
    c, s = math.cos(views.state[k, 1]), math.sin(views.state[k, 1])
    turn, aside, deep = y * views.bend[k], y, 0.0
    if abs(turn) > STRAIGHT:
        aside, deep = math.sin(turn) / views.bend[k], (1 - math.cos(turn)) / views.bend[k]
    deep += views.state[k, 0]
    return views.position[k, 0] + deep * c - aside * s, views.position[k, 1] + deep * s + aside * c


@loop()
def draw_surfaces(plane: Plane, views: Views, alive: Bools, evidence: Floats, level: Floats) -> None:
    """Add the evidence of each echo to the cells that it shows, once a cell.

    Args:
        plane: the cells.
        views: the echoes.
        alive: (k) which count.
        evidence: (cells) added to.
        level: (cells) raised to the level of the strongest echo.
    """
    for k in range(len(alive)):
        if not alive[k]:
            continue
        steps = math.ceil(2 * views.half_m[k] / (0.5 * plane.step))
        last = -1
        for i in range(steps + 1):
            y = views.half_m[k] * (2 * i / steps - 1) if steps > 0 else 0.0
            px, py = _point(views, k, y)
            cell = _cell(plane, px, py)
            if cell >= 0 and cell != last:
                evidence[cell] += views.weight[k]
                level[cell] = max(level[cell], views.level[k])
                last = cell


@loop()
def find_hidden(plane: Plane, views: Views, evidence: Floats, level: Floats, least: float, alive: Bools) -> None:
    """Drop echoes whose path crosses a surface that is surer than theirs and reflects at least as much.

    Args:
        plane: the cells.
        views: the echoes.
        evidence: (cells) of surfaces.
        level: (cells) of the strongest echo of each [m].
        least: evidence of an occupied cell.
        alive: (k) set to False where the path is blocked.
    """
    for k in range(len(alive)):
        if not alive[k]:
            continue
        c, s = math.cos(views.state[k, 1]), math.sin(views.state[k, 1])
        px, py = _point(views, k, 0.0)
        own = _cell(plane, px, py)
        bound = max(least, 0.5 * evidence[own] if own >= 0 else 0.0)
        for i in range(8, int((views.state[k, 0] - BEFORE_M) / (0.25 * plane.step))):
            far = 0.25 * plane.step * i
            cell = _cell(plane, views.position[k, 0] + far * c, views.position[k, 1] + far * s)
            if cell >= 0 and cell != own and evidence[cell] > bound and level[cell] > views.level[k]:
                alive[k] = False
                break


@loop()
def find_crossed(
    plane: Plane,
    views: Views,
    evidence: Floats,
    level: Floats,
    least: float,
    alive: Bools,
    widening: float,
    crossed: Floats,
) -> None:
    """Add up the weights of the echoes that came through each cell, though a surface fills their tube there.

    Such an echo contradicts an opaque surface in the plane. Only echoes stronger than the surface count, since a
    weaker one may be an image in it. Things narrower than the tube, such as poles, do not block an echo.

    Args:
        plane: the cells.
        views: the echoes.
        evidence: (cells) of surfaces.
        level: (cells) of the strongest echo of each [m].
        least: evidence of an occupied cell.
        alive: (k) which count.
        widening: half width of a tube over the root of the distance, where the surface is flat [sqrt(m)].
        crossed: (cells) added to.
    """
    met = np.empty(STRANDS, np.int64)
    for k in range(len(alive)):
        if not alive[k]:
            continue
        c, s = math.cos(views.state[k, 1]), math.sin(views.state[k, 1])
        met[:] = -1
        for i in range(int((views.state[k, 0] - BEFORE_M) / (0.4 * plane.step))):
            far = 0.4 * plane.step * i
            half = widening * math.sqrt(far * abs(1 - views.state[k, 2] * far))
            for j in range(STRANDS):
                if met[j] >= 0 or far <= BODY_M:
                    continue
                aside = half * (2 * j / (STRANDS - 1) - 1)
                x, y = views.position[k, 0] + far * c - aside * s, views.position[k, 1] + far * s + aside * c
                cell = _cell(plane, x, y)
                if cell >= 0 and evidence[cell] >= least and level[cell] < views.level[k]:
                    met[j] = cell
        if met.min() >= 0:
            for j in range(STRANDS):
                if j == 0 or met[j] != met[j - 1]:
                    crossed[met[j]] += views.weight[k]


class Tubes(NamedTuple):
    """The space that echoes show to be free."""

    width: NDArray[np.float64]  # (k) half width in radii of the first Fresnel zone; 0: none
    doubt: NDArray[np.float64]  # (k) standard deviation of the bearing, by which a tube is narrowed [rad]
    wavelength_m: float  # of the carrier [m]
    margin_m: float  # before the echo that is not free
    behind_m: float  # distance behind a possible extension of a surface from which an echo excludes it


@inner()
def _half(views: Views, tubes: Tubes, k: int, far: float) -> float:
    """Half width of a tube at a distance, less what the error of its bearing may shift it."""
    zone = math.sqrt(0.5 * tubes.wavelength_m * far * abs(1 - views.state[k, 2] * far))
    return tubes.width[k] * zone - tubes.doubt[k] * far


@loop()
def draw_tubes(plane: Plane, views: Views, tubes: Tubes, ends: Bools, extension: Floats, free: Bools) -> None:
    """Mark the parts of cells between each place and its specular point.

    A tube consists of rays side by side. Each ray ends at the first surface that it meets: no echo came through it. It
    passes a possible extension of a surface only where its own echo comes from behind that.

    Args:
        plane: the parts, `PARTS` times as fine as the cells.
        views: the echoes.
        tubes: how wide and long.
        ends: (cells) that hold a surface.
        extension: (cells, 3) outward normal of a surface that may go on in a cell, and its distance from the origin.
        free: (parts) set to True.
    """
    columns = plane.columns // PARTS
    for k in range(len(tubes.width)):
        c, s, range_m = math.cos(views.state[k, 1]), math.sin(views.state[k, 1]), views.state[k, 0]
        px, py = views.position[k, 0] + range_m * c, views.position[k, 1] + range_m * s
        steps = int((range_m - tubes.margin_m) / (0.4 * plane.step)) if tubes.width[k] > 0 else 0
        widest = 0.0
        for i in range(steps):
            widest = max(widest, _half(views, tubes, k, 0.4 * plane.step * i))
        strands = 2 * math.ceil(widest / (0.6 * plane.step)) + 1
        for j in range(strands):
            for i in range(steps):
                far = 0.4 * plane.step * i
                half = _half(views, tubes, k, far)
                if half < 0:
                    continue
                aside = half * (2 * j / (strands - 1) - 1) if strands > 1 else 0.0
                x, y = views.position[k, 0] + far * c - aside * s, views.position[k, 1] + far * s + aside * c
                part = _cell(plane, x, y)
                if part < 0:
                    continue
                cell = part // plane.columns // PARTS * columns + part % plane.columns // PARTS
                if ends[cell] and far > BODY_M:
                    break
                nx, ny = extension[cell, 0], extension[cell, 1]
                if nx * px + ny * py >= extension[cell, 2] + tubes.behind_m:
                    free[part] = True


@loop()
def draw_extensions(plane: Plane, views: Views, alive: Bools, extension_m: float, out: Floats) -> None:
    """Mark the cells in which surfaces may go on to both sides of what was seen.

    Args:
        plane: the cells.
        views: the echoes.
        alive: (k) which count.
        extension_m: how far [m].
        out: (cells, 3) set to the outward normal of the surface, and its distance from the origin along that [m].
    """
    for k in range(len(alive)):
        if not alive[k] or views.half_m[k] < 0.5 * plane.step:
            continue
        steps = math.ceil(2 * extension_m / (0.5 * plane.step))
        for i in range(steps + 1):
            y = extension_m * (2 * i / steps - 1)
            px, py = _point(views, k, y)
            cell = _cell(plane, px, py)
            if cell >= 0:
                turn = views.state[k, 1] - y * views.bend[k]
                out[cell, 0], out[cell, 1] = math.cos(turn), math.sin(turn)
                out[cell, 2] = out[cell, 0] * px + out[cell, 1] * py
