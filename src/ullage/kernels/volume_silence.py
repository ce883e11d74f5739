"""Loops that say where the silence of keyframes in a volume leaves no obstacle and no surface.

A keyframe sees along the directions of a cube, up to the first cell that ends a line of sight. What it has seen is kept
between maps: a change of cells moves only the ends of the lines that pass them, and a changed end counts only the
places beside it. So the counts are those of a new start, to the bit.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Bools, Floats, Ints, Longs
from ullage.kernels.directed_sums import Patterns, cube_place, pattern_gain
from ullage.kernels.loops import inner, loop
from ullage.kernels.volume_cells import BODY_M, Box, cell_of

SIDE = 24  # cells along each side of the cube of directions in which silence is kept
IN_SIGHT, QUIET, STILL = 0, 1, 2  # what a keyframe would have received at a place in its sight: nothing, an occluder
# (quiet), or even the edge of a surface (still)
LEVEL = 0.02  # upward part of the normal of an upright surface, or of one less that part of a level surface
RIM_M = 0.3  # of height, within which a surface ends at upright edges only; and half width of the least surface
LEAST_M = 1e-6  # by which the parts of a line of sight overlap
DEAR = 30  # places of one part of a line of sight, at most; a keyframe with more changes is counted anew

Ends = NDArray[np.int16]  # steps of range after which lines of sight end


class Silence(NamedTuple):
    """What keyframes did not receive."""

    position: NDArray[np.float64]  # (k, 3) [m]
    power: NDArray[np.float64]  # (k, d) two-way power gain in each direction, summed over the frames
    masked: NDArray[np.float64]  # (k, b) energy below which an echo stays unseen at each step of range
    step_m: float  # of range
    occluder_m: float  # amplitude times range of the least occluder before an antenna of 0 dBi [m]
    edge_m: float  # the same of an edge, times the root of the range [m^1.5]


class Cube(NamedTuple):
    """Directions of lines of sight: the middles of the cells of a cube."""

    unit: NDArray[np.float64]  # (d, 3)
    low: NDArray[np.float64]  # (d, 3) least components of the directions of each cell
    high: NDArray[np.float64]  # (d, 3)


class Hearing(NamedTuple):
    """Where surfaces would have been received, on a lattice of coarse cells."""

    lattice: Box
    position: NDArray[np.float64]  # (k, 3) of the keyframes [m]
    along: NDArray[np.float64]  # (n, k) of the same along each normal [m]
    heard: NDArray[np.bool_]  # (2 n, k, b) whether a wall across each normal, or its opposite, was excluded
    step_m: float  # of range
    quiet: NDArray[np.bool_]  # (cells) in which no occluder stands
    still: NDArray[np.bool_]  # (cells) in which no surface ends


@inner()
def _sight(x: float, y: float, z: float) -> int:
    """Number of the line of sight whose cell of the cube holds a direction."""
    face, a, b = cube_place(x, y, z)
    i, j = int((a + 1) * 0.5 * SIDE), int((b + 1) * 0.5 * SIDE)
    return (face * SIDE + min(i, SIDE - 1)) * SIDE + min(j, SIDE - 1)


@loop()
def find_sights(unit: Floats, number: Longs) -> None:
    """Set the number (n) of the line of sight beside each direction (n, 3)."""
    for n in range(len(unit)):
        number[n] = _sight(unit[n, 0], unit[n, 1], unit[n, 2])


@loop()
def add_power(patterns: Patterns, rows: Floats, unit: Floats, power: Floats) -> None:
    """Set the two-way power gain (d) in directions, summed over the frames of a keyframe.

    Args:
        patterns: of the sensors.
        rows: (s) frames of each sensor.
        unit: (d, 3) directions.
        power: (d) set.
    """
    for d in range(len(unit)):
        power[d] = 0.0
        for s in range(len(rows)):
            power[d] += rows[s] * pattern_gain(patterns.cubes[s], patterns.turns[s], unit[d]) ** 2


@inner()
def _end(box: Box, p: Floats, unit: Floats, step_m: float, steps: int, blocked: Bools, first: int) -> int:
    """Step of range at which a line of sight ends, from a step on."""
    for n in range(first, steps):
        far = (n + 0.5) * step_m
        cell = cell_of(box, p[0] + far * unit[0], p[1] + far * unit[1], p[2] + far * unit[2])
        if cell < 0 or (blocked[cell] and far > BODY_M):
            return n
    return steps


@loop()
def look(box: Box, silence: Silence, cube: Cube, blocked: Bools, which: Longs, end: Ends) -> None:
    """Set where the lines of sight of some keyframes end (k, d), by the cells that end them."""
    for k in which:
        for d in range(len(cube.unit)):
            end[k, d] = _end(
                box, silence.position[k], cube.unit[d], silence.step_m, silence.masked.shape[1], blocked, 0
            )


@inner()
def _span(low: float, high: float, near: float, far: float) -> tuple[int, int]:
    """Cells of the cube whose middles an interval meets, seen from a distance between two: the first, and after."""
    least, most = low / (far if low > 0 else near), high / (near if high > 0 else far)
    if least > 1 or most < -1:
        return 0, 0
    first = math.ceil((max(least, -1.0) + 1) * 0.5 * SIDE - 0.5 - LEAST_M)
    last = math.floor((min(most, 1.0) + 1) * 0.5 * SIDE - 0.5 + LEAST_M)
    return max(first, 0), min(last, SIDE - 1) + 1


@inner()
def _move_end(
    box: Box, silence: Silence, unit: Floats, k: int, corners: tuple[Floats, Floats], part: tuple[int, int],
    blocked: Bools, end: int,
) -> int:  # fmt: skip
    """Step at which a line of sight ends, after cells between two corners changed, which a part of its steps meets."""
    (low, high), (n, far), p = corners, part, silence.position[k]
    while n < far and n <= end:
        away = (n + 0.5) * silence.step_m
        x, y, z = p[0] + away * unit[0], p[1] + away * unit[1], p[2] + away * unit[2]
        if low[0] <= x < high[0] and low[1] <= y < high[1] and low[2] <= z < high[2]:
            cell = cell_of(box, x, y, z)
            if cell >= 0 and blocked[cell] and away > BODY_M:
                end = n
            elif cell >= 0 and n == end:
                end = _end(box, p, unit, silence.step_m, silence.masked.shape[1], blocked, n + 1)
        n += 1
    return end


@loop()
def look_again(
    box: Box, lattice: Box, silence: Silence, cube: Cube, blocked: Bools, changed: Longs, which: Longs, end: Ends
) -> None:
    """Move the ends (k, d) of the lines of sight of some keyframes (m), where cells of the lattice (c) changed."""
    low, high, most = np.empty(3), np.empty(3), silence.masked.shape[1]
    for k in which:
        p = silence.position[k]
        for c in changed:
            i, j, m = c // (lattice.rows * lattice.columns), (c // lattice.columns) % lattice.rows, c % lattice.columns
            low[0], low[1], low[2] = (
                lattice.x + m * lattice.step, lattice.y + j * lattice.step, lattice.z + i * lattice.step
            )  # fmt: skip
            least = 0.0
            for axis in range(3):
                low[axis] -= LEAST_M
                high[axis] = low[axis] + lattice.step + 2 * LEAST_M
                least += max(low[axis] - p[axis], p[axis] - high[axis], 0.0) ** 2
            near = max(int(math.sqrt(least) / silence.step_m - 0.5) - 1, 0)
            if near >= most:
                continue
            far = min(near + int(math.sqrt(3.0) * lattice.step / silence.step_m) + 4, most)
            for face in range(6):
                axis, side = face // 2, 1.0 if face % 2 == 0 else -1.0
                one, two = (1 if axis == 0 else 0), (1 if axis == 2 else 2)
                u = (low[axis] - p[axis], high[axis] - p[axis])
                nearest, farthest = (u[0], u[1]) if side > 0 else (-u[1], -u[0])
                if farthest <= 0:
                    continue
                nearest = max(nearest, 1e-9)
                a0, a1 = _span(low[one] - p[one], high[one] - p[one], nearest, farthest)
                b0, b1 = _span(low[two] - p[two], high[two] - p[two], nearest, farthest)
                for a in range(a0, a1):
                    for b in range(b0, b1):
                        d = (face * SIDE + a) * SIDE + b
                        if end[k, d] >= near:
                            end[k, d] = _move_end(
                                box, silence, cube.unit[d], k, (low, high), (near, far), blocked, end[k, d]
                            )


@loop()
def limit(silence: Silence, cube: Cube, plane: Floats, open_energy: Floats, which: Longs, most: Ends) -> None:
    """Set where known surfaces and echoes of open direction end the lines of sight of some keyframes.

    Args:
        silence: what they did not receive.
        cube: the lines of sight.
        plane: (k, q, 4) unit vector and distance of the known surfaces; distance 0: none.
        open_energy: (k, b) energy of echoes of unknown direction.
        which: (m) keyframes.
        most: (k, d) set.
    """
    steps, step_m = silence.masked.shape[1], silence.step_m
    far = np.empty(len(cube.unit))
    for k in which:
        far[:] = steps * step_m
        for q in range(plane.shape[1]):
            x, y, z, distance = plane[k, q]
            if distance > 0:
                for d in range(len(far)):
                    along = x * cube.unit[d, 0] + y * cube.unit[d, 1] + z * cube.unit[d, 2]
                    if along * far[d] > distance and along > 0.02:
                        far[d] = distance / along
        for d in range(len(far)):
            n = max(int(far[d] / step_m - 0.5), 0)
            while n < steps and (n + 0.5) * step_m < far[d]:
                n += 1
            most[k, d] = min(n, steps)
        for n in range(steps - 1, -1, -1):
            if open_energy[k, n] > 0:
                bound = open_energy[k, n] / (silence.occluder_m / ((n + 0.5) * step_m)) ** 2
                for d in range(len(far)):
                    if silence.power[k, d] < bound:
                        most[k, d] = min(most[k, d], n)


@inner()
def _received(silence: Silence, k: int, d: int, n: int) -> int:
    """What a keyframe would have received at a step of a line of sight."""
    far = (n + 0.5) * silence.step_m
    energy = silence.power[k, d] * (silence.occluder_m / far) ** 2
    edge = silence.power[k, d] * (silence.edge_m / far) ** 2 / far
    masked = silence.masked[k, n]
    return STILL if masked <= min(edge, energy) else QUIET if masked <= energy else IN_SIGHT


@inner()
def _count_box(
    lattice: Box, silence: Silence, k: int, corners: tuple[Floats, Floats], part: tuple[int, int], before: Ends,
    after: Ends, looks: Ints,
) -> None:  # fmt: skip
    """Count the places between two corners, seen from a keyframe: of all lines of sight, or one of one at one step."""
    (low, high), (only, step) = corners, part
    x0, x1 = _cells(low[0], high[0], silence.position[k, 0] - lattice.x, lattice.step, lattice.columns)
    y0, y1 = _cells(low[1], high[1], silence.position[k, 1] - lattice.y, lattice.step, lattice.rows)
    z0, z1 = _cells(low[2], high[2], silence.position[k, 2] - lattice.z, lattice.step, lattice.levels)
    for i in range(z0, z1):
        z = lattice.z + (i + 0.5) * lattice.step - silence.position[k, 2]
        for j in range(y0, y1):
            y = lattice.y + (j + 0.5) * lattice.step - silence.position[k, 1]
            for m in range(x0, x1):
                x = lattice.x + (m + 0.5) * lattice.step - silence.position[k, 0]
                far = math.sqrt(x * x + y * y + z * z)
                n = int(far / silence.step_m)
                if n >= silence.masked.shape[1] or far < BODY_M or (only >= 0 and n != step):
                    continue
                d = _sight(x, y, z)
                if (only >= 0 and d != only) or (n < before[d]) == (n < after[d]):
                    continue
                seen, more = _received(silence, k, d, n), 1 if n < after[d] else -1
                cell = (i * lattice.rows + j) * lattice.columns + m
                looks[0, cell] += more * (seen >= QUIET)
                looks[1, cell] += more * (seen == STILL)


@inner()
def _cells(low: float, high: float, offset: float, step: float, count: int) -> tuple[int, int]:
    """Cells whose middles an interval may hold: the first, and after the last."""
    first = math.ceil((low + offset - LEAST_M) / step - 0.5)
    return max(first, 0), min(math.floor((high + offset + LEAST_M) / step - 0.5) + 1, count)


@loop()
def count_silence(lattice: Box, silence: Silence, cube: Cube, before: Ends, after: Ends, looks: Ints) -> None:
    """Count in each cell the keyframes that would have received an occluder, and an edge, and did not.

    Args:
        lattice: coarse cells.
        silence: what the keyframes did not receive.
        cube: the lines of sight.
        before: (k, d) ends of these as counted; those of a new keyframe are 0.
        after: (k, d) ends as they are.
        looks: (2, cells) int32, changed: occluders, edges.
    """
    steps, step_m = silence.masked.shape[1], silence.step_m
    low, high = np.empty(3), np.empty(3)
    for k in range(len(before)):
        total = 0
        for d in range(before.shape[1]):
            total += abs(after[k, d] - before[k, d])
        if DEAR * total > 8 * (steps * step_m / lattice.step) ** 3 or DEAR * total > looks.shape[1]:
            low[:], high[:] = -steps * step_m, steps * step_m
            _count_box(lattice, silence, k, (low, high), (-1, 0), before[k], after[k], looks)
            continue
        for d in range(before.shape[1]):
            for n in range(min(before[k, d], after[k, d]), max(before[k, d], after[k, d])):
                near, far = n * step_m, (n + 1) * step_m
                for axis in range(3):
                    low[axis] = cube.low[d, axis] * (near if cube.low[d, axis] > 0 else far)
                    high[axis] = cube.high[d, axis] * (far if cube.high[d, axis] > 0 else near)
                _count_box(lattice, silence, k, (low, high), (d, n), before[k], after[k], looks)


@loop()
def count_body(lattice: Box, position: Floats, more: int, looks: Ints) -> None:
    """Count a keyframe (3) in the cells (2, cells) about the sensor, which are free of all, or take it back (-1)."""
    x0, x1 = _cells(-BODY_M, BODY_M, position[0] - lattice.x, lattice.step, lattice.columns)
    y0, y1 = _cells(-BODY_M, BODY_M, position[1] - lattice.y, lattice.step, lattice.rows)
    z0, z1 = _cells(-BODY_M, BODY_M, position[2] - lattice.z, lattice.step, lattice.levels)
    for i in range(z0, z1):
        for j in range(y0, y1):
            for m in range(x0, x1):
                x = lattice.x + (m + 0.5) * lattice.step - position[0]
                y = lattice.y + (j + 0.5) * lattice.step - position[1]
                z = lattice.z + (i + 0.5) * lattice.step - position[2]
                if math.sqrt(x * x + y * y + z * z) < BODY_M:
                    looks[:, (i * lattice.rows + j) * lattice.columns + m] += more


@inner()
def _must_reach_foot(hearing: Hearing, x: float, y: float, z: float, place: Floats, normal: Floats, far: float) -> bool:
    """Whether a flat surface through a cell must reach its foot, the point nearest to a keyframe at a distance `far`.

    If it ended before, its edge would have been received.
    """
    lattice = hearing.lattice
    own = cell_of(lattice, x, y, z)
    foot_x, foot_y, foot_z = place[0] + far * normal[0], place[1] + far * normal[1], place[2] + far * normal[2]
    away = math.sqrt((x - foot_x) ** 2 + (y - foot_y) ** 2 + (z - foot_z) ** 2)
    steps = int(away / (0.5 * lattice.step)) + 1
    for i in range(steps - 1, -1, -1):  # most that end do so near the cell
        u = i / steps
        px, py, pz = foot_x + u * (x - foot_x), foot_y + u * (y - foot_y), foot_z + u * (z - foot_z)
        if (px - place[0]) ** 2 + (py - place[1]) ** 2 + (pz - place[2]) ** 2 < BODY_M * BODY_M:
            continue
        cell = cell_of(lattice, px, py, pz)
        if cell != own and (cell < 0 or not hearing.still[cell]):
            return False
    return True


@inner()
def _excluding_keyframe(hearing: Hearing, x: float, y: float, z: float, normal: Floats, n: int, first: int) -> int:
    """A keyframe that would have received a flat surface through a point at its foot, from `first` on, or -1.

    Upright and level surfaces may end at rims above or below, as boxes and tables do. A rim may return nothing in one
    polarisation [Keller1962], so the foot must lie at the height of the point, or near it.
    """
    count, keyframes, steps = len(hearing.along), len(hearing.position), hearing.heard.shape[2]
    rims = abs(normal[2]) < LEVEL or abs(normal[2]) > 1 - LEVEL
    here = x * normal[0] + y * normal[1] + z * normal[2]
    for m in range(keyframes):
        k = first + m if first + m < keyframes else first + m - keyframes
        far = here - hearing.along[n, k]
        i = int(abs(far) / hearing.step_m)
        if i >= steps or not hearing.heard[n if far >= 0 else n + count, k, i]:
            continue
        p = hearing.position[k]
        dx, dy, dz = x - p[0], y - p[1], z - p[2]
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
