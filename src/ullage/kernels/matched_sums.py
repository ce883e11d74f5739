"""Loops over matched sums: how well the samples of a synthetic aperture fit one reflector."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Floats, Longs, Singles
from ullage.kernels.loops import inner, loop

LEAST_GAIN = 0.1  # amplitude against the sensor that faces the direction best; weaker sensors add noise only
ROUNDS, STEPS = 5, 6  # of the search: each round has smaller steps
SHRINK = 0.45
COHERENT = 0.95  # expected coherence from which the sizes of the moments' sums are left out
TOGETHER = 0.9  # the same of the sensors' sums: exact mounts show that much
LEAST_COSINE = 0.2  # of the elevation that the search tries
LEAST_LYING = 0.01  # the same of lying cylinders, whose bearing stays known straight above and below
GAIN_CELLS = 2000  # cells of the table of gains, even in 1 - cosine


class Aperture(NamedTuple):
    """Frames of several sensors about one place, as rows."""

    samples: NDArray[np.float32]  # (m, b, 2) baseband, real and imaginary part
    offset: NDArray[np.float64]  # (m, 3) of the sensor from the place [bin]
    sensor: NDArray[np.int64]  # (m) row of `axes`; the frames of one sensor follow one another
    axes: NDArray[np.float64]  # (s, 3) boresights
    gains: NDArray[np.float64]  # (s, GAIN_CELLS + 1) two-way amplitude gain, against 1 - cosine
    phase: float  # of one bin of range [rad]; 0 where samples are envelopes
    moment: NDArray[np.int64]  # (m) index of the time of each row
    spread: NDArray[np.float64]  # (3, 3) covariance of the errors of a moment's position [bin^2]
    together: NDArray[np.float64]  # (1) expected coherence between sensors, under the errors of their mounts
    late: NDArray[np.float64]  # (s) by which an echo is later for each sensor, folded by another pulse interval [bin]


@inner(fastmath=True)
def _delay(offset: Floats, unit: Floats, curvature: float) -> float:
    """Range of a reflector less its range from the place [bin]."""
    along = offset[0] * unit[0] + offset[1] * unit[1] + offset[2] * unit[2]
    square = offset[0] ** 2 + offset[1] ** 2 + offset[2] ** 2
    return 0.5 * curvature * (square - along * along) - along


@inner(fastmath=True)
def _delay_level(offset: Floats, unit: Floats, cosine: float, curvature: float) -> float:
    """The same of a reflector that bends in the vertical plane through its direction only, by its exact law [bin]."""
    along = (offset[0] * unit[0] + offset[1] * unit[1]) / cosine
    ahead = cosine - curvature * along
    return (curvature * along - 2 * cosine) * along / (math.sqrt(ahead * ahead + 1 - cosine * cosine) + 1)


@inner(fastmath=True)
def _range(offset: Floats, unit: Floats, cosine: float, curvature: float, lying: float) -> float:
    """Range of a reflector of either kind less its range from the place [bin]."""
    if lying > 0 and cosine > 0:
        return _delay_level(offset, unit, cosine, curvature)
    return _delay(offset, unit, curvature)


@inner(fastmath=True)
def _gains(aperture: Aperture, unit: Floats, out: Floats) -> None:
    """Gain of each sensor in a direction, over that of the one that faces it best."""
    best = 1e-12
    for s in range(len(out)):
        axis = aperture.axes[s]
        cosine = unit[0] * axis[0] + unit[1] * axis[1] + unit[2] * axis[2]
        out[s] = aperture.gains[s, min(max(int((1 - cosine) * 0.5 * GAIN_CELLS), 0), GAIN_CELLS)]
        best = max(best, out[s])
    for s in range(len(out)):
        out[s] /= best


@inner(fastmath=True)
def _expected_coherence(aperture: Aperture, unit: Floats) -> float:
    """Share of the energy that stays coherent over moments, under the errors of the positions in a direction."""
    variance = 0.0
    for i in range(3):
        for j in range(3):
            variance += unit[i] * aperture.spread[i, j] * unit[j]
    return math.exp(-variance * aperture.phase * aperture.phase)


@inner(fastmath=True)
def _square(aperture: Aperture, real: float, imag: float) -> float:
    """Energy of a sum; sums of envelopes have no phase, and below zero they explain nothing."""
    if aperture.phase == 0 and real < 0:
        return np.float32(0.0) * real  # type: ignore[return-value]
    return real * real + imag * imag


@inner(fastmath=True)
def _cos_sin(angle: float) -> tuple[float, float]:
    """Cosine and sine of an angle [rad] within 1e-6, by power series of its half: compilers can vectorise it."""
    turn = angle * (0.5 / math.pi)
    half = math.pi * (turn - math.floor(turn + 0.5))
    x = half * half
    s = half * (1 - x / 6 * (1 - x / 20 * (1 - x / 42 * (1 - x / 72 * (1 - x / 110)))))
    c = 1 - x / 2 * (1 - x / 12 * (1 - x / 30 * (1 - x / 56 * (1 - x / 90 * (1 - x / 132)))))
    return 1 - 2 * s * s, 2 * s * c


class Turns(NamedTuple):
    """Where each row is sampled under hypotheses of one curvature, and its weight; rows of little gain are left out."""

    directions: NDArray[np.float64]  # (d, 3) unit vectors
    counted: NDArray[np.int64]  # (d) rows that count
    row: NDArray[np.int32]  # (d, m)
    first: NDArray[np.int32]  # (d, m) bin that is sampled for bin 0
    weight: NDArray[np.float32]  # (d, m, 3) share of the next bin; gain times cosine and sine of the phase
    total: NDArray[np.float64]  # (d) sum of squared gains


@loop(fastmath=True)
def turn_rows(aperture: Aperture, curvature: float, start: int, stop: int, turns: Turns) -> None:
    """Fill in the rows of some directions.

    Args:
        aperture: the rows.
        curvature: of the range along the aperture [1/bin].
        start: first direction.
        stop: direction after the last.
        turns: of all directions; set.
    """
    gain = np.empty(len(aperture.axes))
    for d in range(start, stop):
        _gains(aperture, turns.directions[d], gain)
        _turn_rows(aperture, gain, curvature, d, turns)


@inner(fastmath=True)
def _turn_rows(aperture: Aperture, gain: Floats, curvature: float, d: int, turns: Turns) -> None:
    """Fill in the rows of one direction, at a gain of each sensor."""
    unit = turns.directions[d]
    n, total = 0, 0.0
    for i in range(len(aperture.sensor)):
        g = gain[aperture.sensor[i]]
        if g <= LEAST_GAIN:
            continue
        delay = _delay(aperture.offset[i], unit, curvature) + aperture.late[aperture.sensor[i]]
        first = math.floor(delay)
        c, s = _cos_sin(aperture.phase * delay)
        turns.row[d, n], turns.first[d, n] = i, first
        turns.weight[d, n, 0] = delay - first
        turns.weight[d, n, 1], turns.weight[d, n, 2] = c * g, s * g
        total += g * g
        n += 1
    turns.counted[d], turns.total[d] = n, max(total, 1e-9)


@loop(fastmath=True)
def sum_turned(
    aperture: Aperture, turns: Turns, curvature: float, start: int, stop: int, low: int, high: int, out: Singles
) -> None:
    """Energy that one reflector in each direction and bin explains.

    The sum over rows of gain times sample, turned by the phase of the delay, squared, over the sum of squared gains.
    Where the positions have errors, the sums of the moments count by their sizes as far as their phases are unknown;
    where the mounts have errors, those of the sensors.

    Args:
        aperture: the rows.
        turns: as `turn_rows` filled them in.
        curvature: as of `turn_rows`.
        start: first direction.
        stop: direction after the last.
        low: first bin.
        high: bin after the last.
        out: (d, b) float32, set from `start` to `stop` and `low` to `high`.
    """
    rows, bins = aperture.samples.shape[0], aperture.samples.shape[1]
    real, imag = np.empty(high - low, np.float32), np.empty(high - low, np.float32)
    one, reach = np.uint64(1), 0.0
    for i in range(rows):
        o = aperture.offset[i]
        reach = max(reach, o[0] * o[0] + o[1] * o[1] + o[2] * o[2])
    reach = math.sqrt(reach) * (1 + abs(curvature) * math.sqrt(reach)) + np.max(np.abs(aperture.late))
    before, after = max(low - int(reach) - 2, 0), min(high + int(reach) + 3, bins)
    x, y = np.empty((rows, after - before), np.float32), np.empty((rows, after - before), np.float32)
    for i in range(rows):
        for k in range(after - before):
            x[i, k], y[i, k] = aperture.samples[i, before + k, 0], aperture.samples[i, before + k, 1]
    moments = aperture.moment.max() + 1
    parts = np.empty((2, moments, high - low), np.float32)
    before_it, size = np.empty((2, high - low), np.float32), np.empty(high - low, np.float32)
    every = np.empty(high - low, np.float32)
    together = np.float32(aperture.together[0])
    alone = together < TOGETHER and aperture.phase != 0
    for d in range(start, stop):
        coherence = _expected_coherence(aperture, turns.directions[d])
        apart = coherence < COHERENT
        real[:] = 0.0
        imag[:] = 0.0
        before_it[:] = 0.0
        size[:] = 0.0
        every[:] = 0.0
        if apart:
            parts[:] = 0.0
        for n in range(turns.counted[d]):
            i, first = turns.row[d, n], turns.first[d, n]
            share, c, s = turns.weight[d, n, 0], turns.weight[d, n, 1], turns.weight[d, n, 2]
            rest = np.float32(1.0) - share
            begin, end = max(low, -first), min(high, bins - 1 - first)
            at = np.uint64(begin + first - before)
            for k in range(np.uint64(begin - low), np.uint64(max(end, begin) - low)):
                u = x[i, at] * rest + x[i, at + one] * share
                v = y[i, at] * rest + y[i, at + one] * share
                real[k] += u * c - v * s
                imag[k] += u * s + v * c
                at += one
            if apart:
                t, at = aperture.moment[i], np.uint64(begin + first - before)
                for k in range(np.uint64(begin - low), np.uint64(max(end, begin) - low)):
                    u = x[i, at] * rest + x[i, at + one] * share
                    v = y[i, at] * rest + y[i, at + one] * share
                    p, q = u * c - v * s, u * s + v * c
                    parts[0, t, k] += p
                    parts[1, t, k] += q
                    every[k] += math.sqrt(p * p + q * q)
                    at += one
            if alone and (n + 1 == turns.counted[d] or aperture.sensor[turns.row[d, n + 1]] != aperture.sensor[i]):
                for k in range(high - low):
                    x_one, y_one = real[k] - before_it[0, k], imag[k] - before_it[1, k]
                    size[k] += math.sqrt(x_one * x_one + y_one * y_one)
                    before_it[0, k], before_it[1, k] = real[k], imag[k]
        scale = np.float32(1 / turns.total[d])
        for k in range(high - low):
            out[d, low + k] = _square(aperture, real[k], imag[k]) * scale
        if apart:
            for k in range(high - low):
                sizes = np.float32(0.0)
                for t in range(moments):
                    sizes += math.sqrt(parts[0, t, k] * parts[0, t, k] + parts[1, t, k] * parts[1, t, k])
                out[d, low + k] = coherence * out[d, low + k] + (1 - coherence) * sizes * sizes * scale
        if alone:
            share = np.float32(coherence if apart else 1.0)
            for k in range(high - low):
                explained = share * size[k] * size[k] + (1 - share) * every[k] * every[k]
                out[d, low + k] = together * out[d, low + k] + (1 - together) * explained * scale


@loop()
def find_peaks(energy: Singles, low: int, high: int, peak: Singles, where: Longs) -> None:
    """Largest energy of each bin.

    Args:
        energy: (d, b) explained energy of each direction and bin.
        low: first bin.
        high: bin after the last.
        peak: (b) float32, set from `low` to `high`.
        where: (b) set to its direction.
    """
    for k in range(low, high):
        peak[k], where[k] = energy[0, k], 0
    for d in range(1, len(energy)):
        for k in range(low, high):
            if energy[d, k] > peak[k]:
                peak[k], where[k] = energy[d, k], d


@inner(fastmath=True)
def _fit(
    aperture: Aperture, unit: Floats, reflector: Floats, gain: Floats, sums: Floats, parts: Floats
) -> tuple[float, float]:
    """Energy that a reflector explains, and all energy along its range; `sums` takes the sum of each sensor."""
    _gains(aperture, unit, gain)
    return _fit_at(aperture, unit, reflector, gain, sums, parts)


@inner(fastmath=True)
def _fit_at(
    aperture: Aperture, unit: Floats, reflector: Floats | tuple[float, ...], gain: Floats, sums: Floats, parts: Floats
) -> tuple[float, float]:
    """The same at a gain of each sensor."""
    samples = aperture.samples
    for s in range(len(gain)):
        sums[s, 0] = 0.0
        sums[s, 1] = 0.0
        sums[s, 2] = 0.0
    energy = total = every = 0.0
    parts[:] = 0.0
    curvature, place, cosine, lying = reflector[1], reflector[2], reflector[3], reflector[4]
    for i in range(samples.shape[0]):
        mine = aperture.sensor[i]
        delay = _range(aperture.offset[i], unit, cosine, curvature, lying) + aperture.late[mine]
        at = delay + place
        k = math.floor(at)
        if k < 0 or k >= samples.shape[1] - 1:
            continue
        share = at - k
        x = samples[i, k, 0] * (1 - share) + samples[i, k + 1, 0] * share
        y = samples[i, k, 1] * (1 - share) + samples[i, k + 1, 1] * share
        real, imag = _cos_sin(aperture.phase * delay)
        sums[mine, 0] += x * real - y * imag
        sums[mine, 1] += x * imag + y * real
        sums[mine, 2] += 1
        parts[aperture.moment[i], 0] += gain[mine] * (x * real - y * imag)
        parts[aperture.moment[i], 1] += gain[mine] * (x * imag + y * real)
        energy += x * x + y * y
        every += gain[mine] * math.sqrt(x * x + y * y)
        total += gain[mine] ** 2
    real, imag, alone = 0.0, 0.0, 0.0
    for s in range(len(gain)):
        real += gain[s] * sums[s, 0]
        imag += gain[s] * sums[s, 1]
        alone += gain[s] * math.sqrt(sums[s, 0] * sums[s, 0] + sums[s, 1] * sums[s, 1])
    coherence, together = _expected_coherence(aperture, unit), aperture.together[0]
    whole = _square(aperture, real, imag)
    if coherence < COHERENT:
        size = 0.0
        for t in range(len(parts)):
            size += math.sqrt(parts[t, 0] * parts[t, 0] + parts[t, 1] * parts[t, 1])
        whole = coherence * whole + (1 - coherence) * size * size
    if together < TOGETHER and aperture.phase != 0:
        share = coherence if coherence < COHERENT else 1.0
        alone = share * alone * alone + (1 - share) * every * every
        whole = together * whole + (1 - together) * alone
    return whole / max(total, 1e-9), energy


@inner()
def _turn(cosine: float, bearing: float, unit: Floats) -> None:
    """Level part of the unit vector at a bearing [rad] and an elevation; straight up or down where the cosine is 0."""
    if cosine > 0:
        unit[0], unit[1], unit[2] = cosine * math.cos(bearing), cosine * math.sin(bearing), 0.0
    else:
        unit[0], unit[1], unit[2] = 0.0, 0.0, math.copysign(1.0, bearing)


@loop(fastmath=True)
def refine(
    aperture: Aperture, start: Floats, steps: Floats, most_curvature: float, sums: Floats, found: Floats
) -> None:
    """Search for the reflector that explains most energy near a first estimate, one parameter at a time.

    Args:
        aperture: the rows.
        start: (5) cosine of the elevation (0: straight up or down), bearing [rad], curvature [1/bin], range [bin], and
            1 where it bends in the vertical plane through its direction only, 0 where it bends on all sides.
        steps: (4) of bearing, curvature, range and cosine in the first round; 0 keeps a parameter.
        most_curvature: bound on its size [1/bin].
        sums: (s, 3) set to real and imaginary part of each sensor's sum, and its rows.
        found: (7) set to energy explained, all energy, bearing, curvature, range, cosine, and how it bends.
    """
    unit, gain = np.empty(3), np.empty(len(aperture.axes))
    parts = np.empty((aperture.moment.max() + 1, 2))
    now, trial, size = np.empty(5), np.empty(5), np.empty(4)
    now[4] = trial[4] = found[6] = start[4]
    for p in range(4):
        now[p] = start[(p + 1) % 4]
        size[p] = steps[p]
    if start[0] <= 0:
        size[0] = size[3] = 0.0
    _turn(now[3], now[0], unit)
    best, energy = _fit(aperture, unit, now, gain, sums, parts)
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
                trial[1] = min(max(trial[1], -most_curvature), most_curvature)
                if size[3] > 0:
                    trial[3] = min(max(trial[3], LEAST_COSINE if start[4] == 0 else LEAST_LYING), 1.0)
                _turn(trial[3], trial[0], unit)
                value, all_energy = _fit(aperture, unit, trial, gain, sums, parts)
                if value > best * 1.0005:
                    best, energy, better = value, all_energy, True
                    for other in range(4):
                        now[other] = trial[other]
            if not better:
                break
        for p in range(4):
            size[p] *= SHRINK
    _turn(now[3], now[0], unit)
    best, energy = _fit(aperture, unit, now, gain, sums, parts)
    found[0], found[1] = best, energy
    for p in range(4):
        found[2 + p] = now[p]


@loop(fastmath=True)
def explain(aperture: Aperture, directions: Floats, reflector: Floats, shares: Floats) -> None:
    """Share of the energy that a reflector explains in each of some directions.

    Args:
        aperture: the rows.
        directions: (m, 2) cosine of the elevation and bearing [rad], as of `refine`.
        reflector: (2) curvature [1/bin] and range [bin].
        shares: (m) set.
    """
    unit, gain, sums = np.empty(3), np.empty(len(aperture.axes)), np.empty((len(aperture.axes), 3))
    parts = np.empty((aperture.moment.max() + 1, 2))
    now = np.array([0.0, reflector[0], reflector[1], 0.0, 0.0])
    for m in range(len(directions)):
        now[3], now[0] = directions[m, 0], directions[m, 1]
        _turn(now[3], now[0], unit)
        explained, energy = _fit(aperture, unit, now, gain, sums, parts)
        shares[m] = min(explained / max(energy, 1e-30), 1.0)


@loop(fastmath=True)
def subtract(aperture: Aperture, found: Floats, sums: Floats, pulse: float) -> None:
    """Take a reflector out of the samples: each sensor's mean amplitude along it, times a Gaussian pulse.

    Args:
        aperture: the rows; their samples change.
        found: (7) as `refine` gave it.
        sums: (s, 3) as `refine` gave it.
        pulse: standard deviation of the pulse's envelope [bin].
    """
    unit = np.empty(3)
    _turn(found[5], found[2], unit)
    _take_out(aperture, unit, found[2:], sums, pulse)


@inner(fastmath=True)
def _take_out(
    aperture: Aperture, unit: Floats, reflector: Floats | tuple[float, ...], sums: Floats, pulse: float
) -> None:
    """The same of a reflector in a direction."""
    samples = aperture.samples
    curvature, place, cosine, lying = reflector[1], reflector[2], reflector[3], reflector[4]
    reach = int(3 * pulse) + 1
    for i in range(samples.shape[0]):
        mine = aperture.sensor[i]
        rows = max(sums[mine, 2], 1.0)
        x, y = sums[mine, 0] / rows, sums[mine, 1] / rows
        delay = _range(aperture.offset[i], unit, cosine, curvature, lying) + aperture.late[mine]
        at = delay + place
        c, s = math.cos(aperture.phase * delay), math.sin(aperture.phase * delay)
        real, imag = x * c + y * s, y * c - x * s
        for k in range(max(int(at) - reach, 0), min(int(at) + reach + 2, samples.shape[1])):
            level = math.exp(-0.5 * ((k - at) / pulse) ** 2)
            samples[i, k, 0] -= real * level
            samples[i, k, 1] -= imag * level
