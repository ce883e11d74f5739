"""The full-profile mapper's ear: peaks of profiles, their bearing from the range's slope, their coherence."""

from __future__ import annotations

import math

import numpy as np

from ullage.kernels.loops import inner, loop


@loop(fastmath=True)
def find_peaks(
    amplitude: np.ndarray,
    level: np.ndarray,
    first: int,
    start: float,
    step: float,
    counts: np.ndarray,
    ranges: np.ndarray,
    heights: np.ndarray,
    quiet: np.ndarray,
) -> None:
    """Local maxima over `level` (n) of each row (n, b), at most `ranges.shape[1]` of them, and the bins under it."""
    rows, bins = amplitude.shape
    for i in range(rows):
        found = 0
        for b in range(bins):
            value = amplitude[i, b]
            quiet[i, b] = value < level[i] and b >= first
            if b < max(first, 1) or b > bins - 2 or value < level[i]:
                continue
            left, right = amplitude[i, b - 1], amplitude[i, b + 1]
            if value > left and value >= right and found < ranges.shape[1]:
                bend = left - 2 * value + right
                shift = 0.5 * (left - right) / bend if bend < 0 else 0.0
                ranges[i, found] = start + (b + shift) * step
                heights[i, found] = value - 0.25 * (left - right) * shift
                found += 1
        counts[i] = found


@loop(fastmath=True)
def fit_bearings(
    centre: int,
    along: np.ndarray,
    counts: np.ndarray,
    ranges: np.ndarray,
    heights: np.ndarray,
    gate: float,
    least_sigma: float,
    out: np.ndarray,
) -> int:
    """Range, slope and their scatter of every peak of the window's centre frame.

    `along` (m) is each frame's way along the track from the centre. Rows of `out`: range, its sigma, cosine between
    track and target, its sigma, share of frames that hold the peak, height.
    """
    frames = len(along)
    for p in range(counts[centre]):
        reach, height = ranges[centre, p], heights[centre, p]
        best, best_score = 0.0, -1.0
        for k in range(-20, 21):
            cosine = 0.05 * k
            score = 0.0
            for j in range(frames):
                want = reach - along[j] * cosine + 0.25 * along[j] * along[j] / reach
                score += _nearest(want, height, counts[j], ranges[j], heights[j], gate)[1]
            if score > best_score:
                best, best_score = cosine, score
        offset, slope, scatter, spread, used = reach, best, gate, 0.0, 0.0
        for _ in range(3):
            n, sx, sy, sxx, sxy, syy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for j in range(frames):
                bow = 0.25 * along[j] * along[j] / reach
                got, weight = _nearest(offset - along[j] * slope + bow, height, counts[j], ranges[j], heights[j], gate)
                if weight < 0.1:
                    continue
                y = got - bow
                n += 1.0
                sx += along[j]
                sy += y
                sxx += along[j] * along[j]
                sxy += along[j] * y
                syy += y * y
            used = n / frames
            spread = sxx - sx * sx / n if n > 0 else 0.0
            if n < 4 or spread < 1e-4:
                break
            slope = -(sxy - sx * sy / n) / spread
            offset = (sy + slope * sx) / n
            rest = syy - sy * sy / n - slope * slope * spread
            scatter = math.sqrt(max(rest, 0.0) / (n - 2.0))
        scatter = max(scatter, least_sigma)
        out[p, 0], out[p, 1] = offset, scatter / math.sqrt(max(used * frames, 1.0))
        out[p, 2], out[p, 3] = slope, scatter / math.sqrt(max(spread, 1e-6))
        out[p, 4], out[p, 5] = used, height
    return int(counts[centre])


@loop(fastmath=True)
def focus_echoes(
    samples: np.ndarray,
    along: np.ndarray,
    start: float,
    step: float,
    wavenumber: float,
    echoes: np.ndarray,
    sharp: np.ndarray,
) -> None:
    """Coherence of each echo over the window, at the cosine near the fitted one that focuses it best.

    A flat wall's range is straight along the track, a point's is bowed: both, and half-way, are tried.
    `samples` (m, b) complex; rows of `sharp` take the coherence |sum|^2 / (m sum of |.|^2), that cosine, its sigma,
    and the coherence as a flat wall and as a point.
    """
    low, high = along.min(), along.max()
    pace = math.pi / (8.0 * wavenumber * max(high - low, 0.02))
    for p in range(len(echoes)):
        reach, cosine = echoes[p, 0], echoes[p, 2]
        tries = min(int(3.0 * echoes[p, 3] / pace) + 2, 40)
        best, best_cosine = -1.0, cosine
        for t in range(-tries, tries + 1):
            trial = cosine + t * pace
            got = _coherence(samples, along, start, step, wavenumber, reach, trial, 0.5)
            if got > best:
                best, best_cosine = got, trial
        middle = best_cosine
        for bow in range(2):
            top = -1.0
            for t in range(-2, 3):
                trial = middle + t * pace
                got = _coherence(samples, along, start, step, wavenumber, reach, trial, float(bow))
                top = max(top, got)
                if got > best:
                    best, best_cosine = got, trial
            sharp[p, 3 + bow] = top
        sharp[p, 0], sharp[p, 1], sharp[p, 2] = best, best_cosine, pace


@inner(fastmath=True)
def _coherence(
    samples: np.ndarray,
    along: np.ndarray,
    start: float,
    step: float,
    wavenumber: float,
    reach: float,
    cosine: float,
    bowed: float,
) -> float:
    frames, bins = samples.shape
    real, imag, power = 0.0, 0.0, 0.0
    bend = 0.5 * bowed * (1.0 - cosine * cosine) / reach
    for j in range(frames):
        r = reach - along[j] * cosine + bend * along[j] * along[j]
        b = int((r - start) / step + 0.5)
        if b < 0 or b >= bins:
            continue
        value = samples[j, b]
        phase = 2.0 * wavenumber * (r - reach)
        c, s = math.cos(phase), math.sin(phase)
        real += value.real * c - value.imag * s
        imag += value.real * s + value.imag * c
        power += value.real * value.real + value.imag * value.imag
    return float((real * real + imag * imag) / (frames * power + 1e-300))


@inner(fastmath=True)
def _nearest(
    want: float, height: float, count: int, ranges: np.ndarray, heights: np.ndarray, gate: float
) -> tuple[float, float]:
    best, weight = want, 0.0
    for k in range(count):
        miss = (ranges[k] - want) / gate
        value = math.exp(-0.5 * miss * miss)
        ratio = heights[k] / height
        if ratio > 3.2 or ratio < 0.31:
            value *= 0.3
        if value > weight:
            best, weight = ranges[k], value
    return best, weight
