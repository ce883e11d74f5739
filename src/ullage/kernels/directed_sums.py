"""Loops that fit reflectors of any direction to the samples of an aperture, and take them out."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Floats
from ullage.kernels.loops import inner, loop
from ullage.kernels.matched_sums import ROUNDS, SHRINK, STEPS, Aperture, Turns, _fit_at, _take_out, _turn_rows


class Patterns(NamedTuple):
    """Antennas of the sensors, as they were turned at a keyframe."""

    cubes: NDArray[np.float64]  # (s, 6, m, m) one-way amplitude gain on a cube of directions; faces +x -x +y -y +z -z
    turns: NDArray[np.float64]  # (s, 3, 3) world from sensor


@inner()
def cube_place(x: float, y: float, z: float) -> tuple[int, float, float]:
    """Face that a direction meets on the cube of directions, +x -x +y -y +z -z, and its place there, -1 to 1."""
    size = max(abs(x), abs(y), abs(z), 1e-12)
    if abs(x) >= abs(y) and abs(x) >= abs(z):
        return (0 if x > 0 else 1), y / size, z / size
    if abs(y) >= abs(z):
        return (2 if y > 0 else 3), x / size, z / size
    return (4 if z > 0 else 5), x / size, y / size


@inner()
def pattern_gain(cube: Floats, turn: Floats, unit: Floats) -> float:
    """Two-way amplitude gain of a sensor in a direction of the world.

    Args:
        cube: (6, m, m) one-way amplitude gain on a cube of directions; faces +x -x +y -y +z -z.
        turn: (3, 3) world from sensor.
        unit: (3) direction.
    """
    x = turn[0, 0] * unit[0] + turn[1, 0] * unit[1] + turn[2, 0] * unit[2]
    y = turn[0, 1] * unit[0] + turn[1, 1] * unit[1] + turn[2, 1] * unit[2]
    z = turn[0, 2] * unit[0] + turn[1, 2] * unit[1] + turn[2, 2] * unit[2]
    half = 0.5 * (cube.shape[1] - 1)
    if max(abs(x), abs(y), abs(z)) < 1e-9:
        return 0.0
    face, a, b = cube_place(x, y, z)
    one = cube[face, int((a + 1) * half + 0.5), int((b + 1) * half + 0.5)]
    return one * one


@inner()
def _toward(patterns: Patterns, unit: Floats, gain: Floats) -> None:
    """Gain of each sensor in a direction, over that of the one that sees it best."""
    best = 1e-12
    for s in range(len(gain)):
        gain[s] = pattern_gain(patterns.cubes[s], patterns.turns[s], unit)
        best = max(best, gain[s])
    for s in range(len(gain)):
        gain[s] /= best


@loop(fastmath=True)
def turn_rows_by(patterns: Patterns, aperture: Aperture, curvature: float, start: int, stop: int, turns: Turns) -> None:
    """As `matched_sums.turn_rows`, by the patterns of the sensors.

    Args:
        patterns: of the sensors.
        aperture: the rows.
        curvature: of the range along the aperture [1/bin].
        start: first direction.
        stop: direction after the last.
        turns: of all directions; set.
    """
    gain = np.empty(len(patterns.turns))
    for d in range(start, stop):
        _toward(patterns, turns.directions[d], gain)
        _turn_rows(aperture, gain, curvature, d, turns)


@inner(fastmath=True)
def _fitted(
    aperture: Aperture,
    patterns: Patterns,
    unit: Floats,
    curvature: float,
    place: float,
    gain: Floats,
    sums: Floats,
    parts: Floats,
) -> tuple[float, float]:
    """Energy that a reflector explains, and all energy along its range, by the patterns of the sensors."""
    _toward(patterns, unit, gain)
    return _fit_at(aperture, unit, (0.0, curvature, place, 1.0, 0.0), gain, sums, parts)


@inner()
def _directed(start: Floats, frame: Floats, trial: Floats, unit: Floats) -> None:
    """Unit vector at two angles from a direction, along the two vectors of a frame."""
    size = 0.0
    for i in range(3):
        unit[i] = start[i] + trial[0] * frame[0, i] + trial[1] * frame[1, i]
        size += unit[i] * unit[i]
    size = math.sqrt(size)
    for i in range(3):
        unit[i] /= size


@loop(fastmath=True)
def refine_direction(
    aperture: Aperture,
    patterns: Patterns,
    start: Floats,
    frame: Floats,
    steps: Floats,
    most_curvature: float,
    sums: Floats,
    found: Floats,
) -> None:
    """Search for the reflector that explains most energy near a first estimate, one parameter at a time.

    Args:
        aperture: the rows.
        patterns: of the sensors.
        start: (5) unit vector, curvature [1/bin] and range [bin].
        frame: (2, 3) unit vectors across that direction.
        steps: (4) of the two angles, curvature and range in the first round; 0 keeps a parameter.
        most_curvature: bound on its size [1/bin].
        sums: (s, 3) set to real and imaginary part of each sensor's sum, and its rows.
        found: (7) set to energy explained, all energy, unit vector, curvature and range.
    """
    unit, gain = np.empty(3), np.empty(len(patterns.turns))
    parts = np.empty((aperture.moment.max() + 1, 2))
    now, trial, size = np.zeros(4), np.empty(4), np.empty(4)
    now[2], now[3] = start[3], start[4]
    for p in range(4):
        size[p] = steps[p]
    _directed(start, frame, now, unit)
    best, _ = _fitted(aperture, patterns, unit, now[2], now[3], gain, sums, parts)
    for _ in range(ROUNDS):
        for _ in range(STEPS):
            better = False
            for move in range(8):
                p = move // 2
                if size[p] <= 0:
                    continue
                for other in range(4):
                    trial[other] = now[other]
                trial[p] += size[p] if move % 2 == 0 else -size[p]
                trial[2] = min(max(trial[2], -most_curvature), most_curvature)
                _directed(start, frame, trial, unit)
                value, _ = _fitted(aperture, patterns, unit, trial[2], trial[3], gain, sums, parts)
                if value > best * 1.0005:
                    best, better = value, True
                    for other in range(4):
                        now[other] = trial[other]
            if not better:
                break
        for p in range(4):
            size[p] *= SHRINK
    _directed(start, frame, now, unit)
    found[0], found[1] = _fitted(aperture, patterns, unit, now[2], now[3], gain, sums, parts)
    for i in range(3):
        found[2 + i] = unit[i]
    found[5], found[6] = now[2], now[3]


@loop(fastmath=True)
def subtract_directed(aperture: Aperture, found: Floats, sums: Floats, pulse: float) -> None:
    """Take a reflector out of the samples: each sensor's mean amplitude along it, times a Gaussian pulse.

    Args:
        aperture: the rows; their samples change.
        found: (7) as `refine_direction` gave it.
        sums: (s, 3) as `refine_direction` gave it.
        pulse: standard deviation of the pulse's envelope [bin].
    """
    _take_out(aperture, found[2:5], (0.0, found[5], found[6], 1.0, 0.0), sums, pulse)


@loop()
def gains_toward(patterns: Patterns, unit: Floats, gain: Floats) -> None:
    """Set the two-way amplitude gain (s) of each sensor in a direction (3), over that of the one that sees it best."""
    _toward(patterns, unit, gain)


@loop()
def weigh_levels(
    patterns: Patterns, units: Floats, amplitude: Floats, sigma: Floats, bound: float, misfit: Floats, level: Floats
) -> None:
    """Compare the amplitudes of an echo at all sensors with the antennas' patterns in each direction.

    Args:
        patterns: of the sensors.
        units: (d, 3) directions.
        amplitude: (s) of the echo.
        sigma: (s) standard deviation of each.
        bound: greatest misfit of one sensor that counts.
        misfit: (d) set to the sum of squared normalised differences.
        level: (d) set to the amplitude that an antenna of gain 1 would have received.
    """
    gain = np.empty(len(amplitude))
    for d in range(len(units)):
        top = bottom = 0.0
        for s in range(len(gain)):
            gain[s] = pattern_gain(patterns.cubes[s], patterns.turns[s], units[d])
            weight = 1.0 / (sigma[s] * sigma[s])
            top += weight * gain[s] * amplitude[s]
            bottom += weight * gain[s] * gain[s]
        level[d] = top / max(bottom, 1e-30)
        misfit[d] = 0.0
        for s in range(len(gain)):
            misfit[d] += min(((amplitude[s] - level[d] * gain[s]) / sigma[s]) ** 2, bound)
