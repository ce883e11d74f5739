"""Loops that draw surfaces and silence into the cells of a volume."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Bools, Floats, Ints
from ullage.kernels.directed_sums import pattern_gain
from ullage.kernels.loops import inner, loop

BEFORE_M = 0.1  # an echo is not hidden by what lies this near before it
BODY_M = 0.25  # radius about the sensor that is free
RINGS, SPOKES = 2, 8  # rays across the path of an echo, besides the middle one
SIDE = 24  # cells along each side of the cube of directions in which silence is kept
HIDDEN, IN_SIGHT, QUIET = 0, 1, 2  # what a keyframe sees of a place; quiet: it would have received an occluder there


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


class Silence(NamedTuple):
    """What keyframes did not receive."""

    position: NDArray[np.float64]  # (k, 3) [m]
    turns: NDArray[np.float64]  # (k, s, 3, 3) world from sensor
    rows: NDArray[np.float64]  # (k, s) frames of each sensor
    masked: NDArray[np.float64]  # (k, b) energy below which an echo stays unseen at each step of range
    blocked: NDArray[np.float64]  # (k, b) energy of echoes of unknown direction
    step_m: float  # of range
    cubes: NDArray[np.float64]  # (s, 6, m, m) one-way amplitude gains
    occluder_m: float  # amplitude times range of the least occluder before an antenna of 0 dBi [m]
    wall_m: float  # the same of the weakest wall, seen square
    plane: NDArray[np.float64]  # (k, q, 4) unit vector and distance of the known surfaces; distance 0: none


@inner()
def _cell(box: Box, x: float, y: float, z: float) -> int:
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
    return _cell(
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
        mark: (cells) int32, overwritten.
    """
    mark[:] = -1
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
                if cell >= 0 and mark[cell] != k:
                    mark[cell] = k
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
def _blocked(
    box: Box, views: SpatialViews, evidence: Floats, level: Floats, k: int, bound: float, own: int, zone: float, j: int
) -> bool:
    """Whether one ray of a path crosses a surface that reflects at least as much."""
    range_m = views.range_m[k]
    for i in range(8, int((range_m - BEFORE_M) / (0.25 * box.step))):
        far = 0.25 * box.step * i
        a, b = _strand(j, zone * math.sqrt(far * (1 - far / range_m)))
        cell = _at(box, views, k, far, a, b)
        if cell >= 0 and cell != own and evidence[cell] > bound and level[cell] > views.level[k]:
            return True
    return False


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
        if not alive[k]:
            continue
        own = _at(box, views, k, views.range_m[k], 0.0, 0.0)
        bound = max(least, 0.5 * evidence[own] if own >= 0 else 0.0)
        j = 0
        while j < 1 + RINGS * SPOKES and _blocked(box, views, evidence, level, k, bound, own, zone[k], j):
            j += 1
        alive[k] = j < 1 + RINGS * SPOKES


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


@inner()
def _cube_cell(x: float, y: float, z: float) -> tuple[int, int, int]:
    """Face and cells of a direction on the cube of directions."""
    size = max(abs(x), abs(y), abs(z), 1e-12)
    if abs(x) >= abs(y) and abs(x) >= abs(z):
        face, a, b = (0 if x > 0 else 1), y, z
    elif abs(y) >= abs(z):
        face, a, b = (2 if y > 0 else 3), x, z
    else:
        face, a, b = (4 if z > 0 else 5), x, y
    i, j = int((a / size + 1) * 0.5 * SIDE), int((b / size + 1) * 0.5 * SIDE)
    return face, min(i, SIDE - 1), min(j, SIDE - 1)


@inner()
def _power(silence: Silence, k: int, unit: Floats) -> float:
    """Two-way power gain in a direction, summed over the frames of a keyframe."""
    power = 0.0
    for s in range(len(silence.cubes)):
        power += silence.rows[k, s] * pattern_gain(silence.cubes[s], silence.turns[k, s], unit) ** 2
    return power


@inner()
def _listen(box: Box, silence: Silence, k: int, occupied: Bools, view: NDArray[np.uint8]) -> None:
    """Set what one keyframe sees at each step of range, by direction of the cube (6, SIDE, SIDE, b)."""
    unit, steps = np.empty(3), silence.masked.shape[1]
    p = silence.position[k]
    view[:] = HIDDEN
    for face in range(6):
        for i in range(SIDE):
            for j in range(SIDE):
                a, b = 2 * (i + 0.5) / SIDE - 1, 2 * (j + 0.5) / SIDE - 1
                size, side = 1 / math.sqrt(1 + a * a + b * b), (1.0 if face % 2 == 0 else -1.0)
                if face < 2:
                    unit[0], unit[1], unit[2] = side * size, a * size, b * size
                elif face < 4:
                    unit[0], unit[1], unit[2] = a * size, side * size, b * size
                else:
                    unit[0], unit[1], unit[2] = a * size, b * size, side * size
                power = _power(silence, k, unit)
                end = 1e9
                for q in range(silence.plane.shape[1]):
                    plane = silence.plane[k, q]
                    along = plane[0] * unit[0] + plane[1] * unit[1] + plane[2] * unit[2]
                    if plane[3] > 0 and along > 0.02:
                        end = min(end, plane[3] / along)
                for n in range(steps):
                    far = (n + 0.5) * silence.step_m
                    if far >= end:
                        break
                    energy = power * (silence.occluder_m / far) ** 2
                    if silence.blocked[k, n] > energy:
                        break
                    cell = _cell(box, p[0] + far * unit[0], p[1] + far * unit[1], p[2] + far * unit[2])
                    if cell < 0 or (occupied[cell] and far > BODY_M):
                        break
                    view[face, i, j, n] = QUIET if silence.masked[k, n] <= energy else IN_SIGHT


@loop()
def count_silence(
    box: Box, lattice: Box, silence: Silence, normals: Floats, occupied: Bools, looks: Ints, reach_m: Floats
) -> None:
    """Count the keyframes that would have received an occluder in each cell, and did not.

    Args:
        box: the cells.
        lattice: coarser cells that cover them.
        silence: what the keyframes did not receive.
        normals: (n, 3) unit vectors.
        occupied: (cells) that hold a surface.
        looks: (cells of the lattice) int32, added to.
        reach_m: (k, n) set to the distance up to which a wall across each normal would have been received [m].
    """
    steps = silence.masked.shape[1]
    view = np.empty((6, SIDE, SIDE, steps), np.uint8)
    reach = steps * silence.step_m
    corner, count = (lattice.z, lattice.y, lattice.x), (lattice.levels, lattice.rows, lattice.columns)
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for k in range(len(silence.position)):
        _listen(box, silence, k, occupied, view)
        p = silence.position[k]
        for n in range(len(normals)):
            face, a, b = _cube_cell(normals[n, 0], normals[n, 1], normals[n, 2])
            power = _power(silence, k, normals[n])
            reach_m[k, n] = 0.0
            for i in range(steps):
                far = (i + 0.5) * silence.step_m
                if view[face, a, b, i] == HIDDEN:
                    break
                if silence.masked[k, i] <= power * (silence.wall_m / far) ** 2:
                    reach_m[k, n] = far
        for d in range(3):
            low[d] = max(int((p[2 - d] - reach - corner[d]) / lattice.step), 0)
            high[d] = min(int((p[2 - d] + reach - corner[d]) / lattice.step) + 1, count[d])
        for i in range(low[0], high[0]):
            z = lattice.z + (i + 0.5) * lattice.step - p[2]
            for j in range(low[1], high[1]):
                y = lattice.y + (j + 0.5) * lattice.step - p[1]
                for m in range(low[2], high[2]):
                    x = lattice.x + (m + 0.5) * lattice.step - p[0]
                    n = int(math.sqrt(x * x + y * y + z * z) / silence.step_m)
                    if n < steps:
                        face, a, b = _cube_cell(x, y, z)
                        if view[face, a, b, n] == QUIET:
                            looks[(i * lattice.rows + j) * lattice.columns + m] += 1
