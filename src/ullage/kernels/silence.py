"""Loops over the cells of a plane in which nothing was received."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Bools, Floats, Singles
from ullage.kernels.loops import inner, loop
from ullage.kernels.surface_cells import BODY_M, Plane

NEAR_BINS = 2  # about the range of a cell: half its diagonal
LEAST_NATS, MOST_NATS = -2.0, 4.0  # that one keyframe may say, since an obstacle may be weaker than its law
NOISE = 3.0  # the largest of several bins and directions over the mean of one


class Residual(NamedTuple):
    """What a keyframe received beyond the echoes that it explains."""

    energy: NDArray[np.float32]  # (d, b) that a reflector in each direction and bin explains; the first one is at 0 rad
    clutter: NDArray[np.float64]  # (b) energy that noise and strong echoes leave behind
    expected: NDArray[np.float64]  # (d) energy of a flat mirror at 1 m
    low: int  # first bin that was searched
    high: int  # bin after the last
    start_m: float  # range of bin 0
    bin_m: float
    near: int  # bins to each side in which an obstacle may appear


@inner()
def _log_ratio(energy: float, clutter: float, expected: float) -> float:
    """Log-likelihood of an energy without an obstacle over that with one; both are exponential [Kay1998]."""
    both = clutter + expected
    return math.log(both / clutter) - energy * (1 / clutter - 1 / both)


@inner()
def _received(residual: Residual, d: int, far: float) -> tuple[int, float]:
    """Bin of a range, and the most energy about it; -1 where nothing there would be received."""
    k, near = round((far - residual.start_m) / residual.bin_m), residual.near
    if k < residual.low + near or k >= residual.high - near:
        return -1, 0.0
    energy = 0.0
    for i in range(k - near, k + near + 1):
        energy = max(energy, residual.energy[d, i])
    return k, energy


@loop()
def hear(residual: Residual, noise: float, step_m: float, out: Singles) -> None:
    """Set how far a mirror, seen square in a direction and at a range, would exceed all that was received there.

    Args:
        residual: what a keyframe received.
        noise: its energy in one bin.
        step_m: between ranges.
        out: (n, m) ratio of energies by direction over the circle, and by range; 0 where nothing would be received.
    """
    count, directions = out.shape[0], residual.energy.shape[0]
    for n in range(count):
        d = round((n + 0.5) / count * directions) % directions
        for m in range(out.shape[1]):
            far = (m + 0.5) * step_m
            k, energy = _received(residual, d, far)
            out[n, m] = residual.expected[d] / (far * far) / (energy + NOISE * noise) if k >= 0 else 0.0


@loop()
def listen(
    plane: Plane, place: Floats, residual: Residual, radius_m: float, defocus_m: float, weight: float, out: Floats
) -> None:
    """Add to each cell the evidence of one keyframe that no upright pole stands there.

    Args:
        plane: the cells.
        place: (2) of the keyframe [m].
        residual: what it received.
        radius_m: of the pole.
        defocus_m: range below which the sum for a flat mirror loses energy of a pole.
        weight: of one keyframe.
        out: (cells) added to [nat].
    """
    directions = residual.energy.shape[0]
    reach = residual.start_m + residual.bin_m * residual.high
    left = max(math.floor((place[0] - reach - plane.x) / plane.step), 0)
    right = min(math.ceil((place[0] + reach - plane.x) / plane.step), plane.columns)
    low = max(math.floor((place[1] - reach - plane.y) / plane.step), 0)
    high = min(math.ceil((place[1] + reach - plane.y) / plane.step), plane.rows)
    for row in range(low, high):
        for column in range(left, right):
            x = plane.x + plane.step * (column + 0.5) - place[0]
            y = plane.y + plane.step * (row + 0.5) - place[1]
            far = math.hypot(x, y)
            d = round(math.atan2(y, x) / (2 * math.pi) * directions) % directions
            k, energy = _received(residual, d, far)
            if k < 0:
                continue
            expected = residual.expected[d] / (far * far) * radius_m / (radius_m + far)
            expected /= math.sqrt(1 + (defocus_m / far) ** 2)
            nats = _log_ratio(energy, NOISE * residual.clutter[k], expected)
            out[row * plane.columns + column] += weight * min(max(nats, LEAST_NATS), MOST_NATS)


class Sight(NamedTuple):
    """Places from which surfaces are seen, and what blocks the view."""

    places: NDArray[np.float64]  # (f, 2) of the track [m]
    heard: NDArray[np.bool_]  # (f, n, m) whether a wall square to a direction would be received from there, by range
    step_m: float  # between these ranges
    blocked: NDArray[np.bool_]  # (cells) that end a line of sight
    half_m: float  # half length of the shortest surface


class Continuations(NamedTuple):
    """How surfaces of each normal and bend go on from a cell, to one side and then to the other (c)."""

    first: NDArray[np.int64]  # (c + 1) places of each in the rows below; normal by normal, bend by bend
    steps: NDArray[np.int32]  # (k, 3) rows and columns from the cell, and the normal there


class Walls(NamedTuple):
    """What is known of surfaces in the cells of a plane."""

    sight: Sight
    square: NDArray[np.bool_]  # (cells, n) normals of surfaces that do not stand there; they cover half a turn
    known: NDArray[np.bool_]  # (cells) whose normals are set
    end: NDArray[np.bool_]  # (cells) in which a surface may end, or belong to a known one
    continuations: Continuations


@inner()
def _is_seen(plane: Plane, sight: Sight, i: int, dx: float, dy: float, far: float) -> bool:
    """Whether nothing ends the line from a place."""
    steps = int(far / (0.5 * plane.step))
    for j in range(int(BODY_M / (0.5 * plane.step)), steps):
        column = math.floor((sight.places[i, 0] + dx * j / steps - plane.x) / plane.step)
        row = math.floor((sight.places[i, 1] + dy * j / steps - plane.y) / plane.step)
        inside = 0 <= row < plane.rows and 0 <= column < plane.columns
        if inside and sight.blocked[row * plane.columns + column]:
            return False
    return True


@inner()
def _set_normals(plane: Plane, walls: Walls, cell: int, seen: Bools) -> None:
    """Set the normals of surfaces that would have been seen square from one of several places, in one cell."""
    sight, normals = walls.sight, len(seen)
    seen[:] = False
    x = plane.x + plane.step * (cell % plane.columns + 0.5)
    y = plane.y + plane.step * (cell // plane.columns + 0.5)
    for i in range(len(sight.places)):
        dx, dy = x - sight.places[i, 0], y - sight.places[i, 1]
        far = math.hypot(dx, dy)
        m = math.floor(far / sight.step_m)
        if far < BODY_M or m >= sight.heard.shape[2]:
            continue
        middle = math.atan2(dy, dx) / math.pi * normals
        if not sight.heard[i, math.floor(middle) % (2 * normals), m]:
            continue
        if seen[math.floor(middle) % normals] or not _is_seen(plane, sight, i, dx, dy, far):
            continue
        wide = sight.half_m / far / math.pi * normals
        for n in range(math.floor(middle - wide), math.floor(middle + wide) + 1):
            seen[n % normals] = True
    for n in range(normals):  # normals are no surer than their step
        walls.square[cell, n] = seen[n] and seen[n - 1] and seen[(n + 1) % normals]
    walls.known[cell] = True


@inner()
def _is_received(plane: Plane, walls: Walls, cell: int, which: int, seen: Bools) -> bool:
    """Whether a surface through a cell would have been received, to one side of it or the other."""
    first, steps = walls.continuations.first, walls.continuations.steps
    here, there = cell // plane.columns, cell % plane.columns
    for one in range(2 * which, 2 * which + 2):
        for k in range(first[one], first[one + 1]):
            row, column = here + steps[k, 0], there + steps[k, 1]
            if column < 0 or row < 0 or column >= plane.columns or row >= plane.rows:
                break
            met = row * plane.columns + column
            if not walls.known[met]:
                _set_normals(plane, walls, met, seen)
            if walls.square[met, steps[k, 2]]:
                return True
            if walls.end[met]:
                break
    return False


@loop()
def exclude(plane: Plane, walls: Walls, out: Bools) -> None:
    """Drop the cells through which a surface may go.

    A surface goes on from a cell to both sides. Where it may neither end nor go on, it does not stand there.

    Args:
        plane: the cells.
        walls: what is known of surfaces; cells that are examined become known.
        out: (cells) set to False.
    """
    normals = walls.square.shape[1]
    seen, bends = np.empty(normals, np.bool_), len(walls.continuations.first) // (2 * normals)
    for cell in range(plane.rows * plane.columns):
        if out[cell] and not walls.known[cell]:
            _set_normals(plane, walls, cell, seen)
        for n in range(normals if out[cell] else 0):
            if walls.square[cell, n] or not out[cell]:
                continue
            for which in range(n * bends, (n + 1) * bends):
                if not _is_received(plane, walls, cell, which, seen):
                    out[cell] = False
                    break
