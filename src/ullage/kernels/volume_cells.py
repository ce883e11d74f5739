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
HIDDEN, IN_SIGHT, QUIET, STILL = 0, 1, 2, 3  # what a keyframe sees of a place, by what it would have received there:
# nothing, an occluder (quiet), or even the edge of a surface (still)
LEVEL = 0.02  # upward part of the normal of an upright surface, or of one less that part of a level surface
RIM_M = 0.3  # of height, within which a surface ends at upright edges only; and half width of the least surface


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
    edge_m: float  # the same of an edge, times the root of the range [m^1.5]
    plane: NDArray[np.float64]  # (k, q, 4) unit vector and distance of the known surfaces; distance 0: none


class Hearing(NamedTuple):
    """Where surfaces would have been received, on a lattice of coarse cells."""

    lattice: Box
    position: NDArray[np.float64]  # (k, 3) of the keyframes [m]
    heard: NDArray[np.bool_]  # (k, 2 n, b) whether a wall across each normal, and across its opposite, was excluded
    step_m: float  # of range
    quiet: NDArray[np.bool_]  # (cells) in which no occluder stands
    still: NDArray[np.bool_]  # (cells) in which no surface ends


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
                    edge = power * (silence.edge_m / far) ** 2 / far
                    masked = silence.masked[k, n]
                    view[face, i, j, n] = (
                        STILL if masked <= min(edge, energy) else QUIET if masked <= energy else IN_SIGHT
                    )


@loop()
def count_silence(
    box: Box, lattice: Box, silence: Silence, normals: Floats, occupied: Bools, looks: Ints, heard: Bools
) -> None:
    """Count the keyframes that would have received an occluder, and an edge, in each cell, and did not.

    Args:
        box: the cells.
        lattice: coarser cells that cover them.
        silence: what the keyframes did not receive.
        normals: (n, 3) unit vectors.
        occupied: (cells) that end a line of sight.
        looks: (2, cells of the lattice) int32, added to: occluders, edges.
        heard: (k, 2 n, b) set to whether a wall across each normal, or its opposite, would have been received at each
            step of range.
    """
    steps, count = silence.masked.shape[1], len(normals)
    view = np.empty((6, SIDE, SIDE, steps), np.uint8)
    reach, unit = steps * silence.step_m, np.empty(3)
    corner, cells = (lattice.z, lattice.y, lattice.x), (lattice.levels, lattice.rows, lattice.columns)
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for k in range(len(silence.position)):
        _listen(box, silence, k, occupied, view)
        p = silence.position[k]
        for n in range(2 * count):
            unit[:] = normals[n] if n < count else -normals[n - count]
            face, a, b = _cube_cell(unit[0], unit[1], unit[2])
            power = _power(silence, k, unit)
            for i in range(steps):
                far = (i + 0.5) * silence.step_m
                seen = view[face, a, b, i] != HIDDEN and silence.masked[k, i] <= power * (silence.wall_m / far) ** 2
                heard[k, n, i] = seen or far < BODY_M
        for d in range(3):
            low[d] = max(int((p[2 - d] - reach - corner[d]) / lattice.step), 0)
            high[d] = min(int((p[2 - d] + reach - corner[d]) / lattice.step) + 1, cells[d])
        for i in range(low[0], high[0]):
            z = lattice.z + (i + 0.5) * lattice.step - p[2]
            for j in range(low[1], high[1]):
                y = lattice.y + (j + 0.5) * lattice.step - p[1]
                for m in range(low[2], high[2]):
                    x = lattice.x + (m + 0.5) * lattice.step - p[0]
                    far = math.sqrt(x * x + y * y + z * z)
                    n = int(far / silence.step_m)
                    if n < steps:
                        face, a, b = _cube_cell(x, y, z)
                        seen = STILL if far < BODY_M else view[face, a, b, n]
                        cell = (i * lattice.rows + j) * lattice.columns + m
                        looks[0, cell] += seen >= QUIET
                        looks[1, cell] += seen == STILL


@inner()
def _must_reach_foot(hearing: Hearing, x: float, y: float, z: float, place: Floats, normal: Floats, far: float) -> bool:
    """Whether a flat surface through a cell must reach its foot, the point nearest to a keyframe at a distance `far`.

    If it ended before, its edge would have been received.
    """
    lattice = hearing.lattice
    own = _cell(lattice, x, y, z)
    foot_x, foot_y, foot_z = place[0] + far * normal[0], place[1] + far * normal[1], place[2] + far * normal[2]
    away = math.sqrt((x - foot_x) ** 2 + (y - foot_y) ** 2 + (z - foot_z) ** 2)
    steps = int(away / (0.5 * lattice.step)) + 1
    for i in range(steps):
        u = i / steps
        px, py, pz = foot_x + u * (x - foot_x), foot_y + u * (y - foot_y), foot_z + u * (z - foot_z)
        if (px - place[0]) ** 2 + (py - place[1]) ** 2 + (pz - place[2]) ** 2 < BODY_M * BODY_M:
            continue
        cell = _cell(lattice, px, py, pz)
        if cell == own:
            return True
        if cell < 0 or not hearing.still[cell]:
            return False
    return True


@inner()
def _excluding_keyframe(hearing: Hearing, x: float, y: float, z: float, normal: Floats, n: int, first: int) -> int:
    """A keyframe that would have received a flat surface through a point at its foot, from `first` on, or -1.

    Upright and level surfaces may end at rims above or below, as boxes and tables do. A rim may return nothing in one
    polarisation [Keller1962], so the foot must lie at the height of the point, or near it.
    """
    steps, count = hearing.heard.shape[2], hearing.heard.shape[1] // 2
    rims = abs(normal[2]) < LEVEL or abs(normal[2]) > 1 - LEVEL
    for m in range(len(hearing.position)):
        k = (first + m) % len(hearing.position)
        p = hearing.position[k]
        dx, dy, dz = x - p[0], y - p[1], z - p[2]
        far = dx * normal[0] + dy * normal[1] + dz * normal[2]
        i = int(abs(far) / hearing.step_m)
        if i >= steps or not hearing.heard[k, n if far >= 0 else n + count, i]:
            continue
        if rims and abs(far * normal[2] - dz) > RIM_M and dx * dx + dy * dy + dz * dz - far * far > RIM_M * RIM_M:
            continue
        if _must_reach_foot(hearing, x, y, z, p, normal, far):
            return k
    return -1


@loop()
def exclude_surfaces(hearing: Hearing, normals: Floats, prior: Floats, most: float, free: Bools) -> None:
    """Find the cells in which no surface stands, however it is turned.

    Args:
        hearing: where surfaces would have been received.
        normals: (n, 3) unit vectors of surfaces over half the sphere, the most probable first.
        prior: (n) share of the surfaces that have each normal.
        most: share that may be left.
        free: (cells of the lattice) set; those that are not free to begin with stay so.
    """
    lattice, last = hearing.lattice, np.zeros(len(normals), np.int64)  # keyframes that excluded each in cells before
    for i in range(lattice.levels):
        for j in range(lattice.rows):
            for m in range(lattice.columns):
                cell = (i * lattice.rows + j) * lattice.columns + m
                free[cell] &= hearing.quiet[cell]
                left, n = 0.0, 0
                x, y, z = (m + 0.5) * lattice.step, (j + 0.5) * lattice.step, (i + 0.5) * lattice.step
                while free[cell] and n < len(normals):
                    k = _excluding_keyframe(
                        hearing, lattice.x + x, lattice.y + y, lattice.z + z, normals[n], n, last[n]
                    )
                    if k >= 0:
                        last[n] = k
                    else:
                        left += prior[n]
                        free[cell] = left <= most
                    n += 1
