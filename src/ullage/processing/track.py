"""Track before detect: integrate weak echoes of objects at rest along their hyperbolas over slow time.

In noise alone the power of a bin over its mean is exponential, and that of different frames independent, so the sum
over m frames is Gamma(m) [Marcum1960]. It exceeds its level with probability pfa / t, with t hyperbolas tried for each
bin, so a bin alarms with at most pfa.
"""

from __future__ import annotations

import numpy as np

from ullage import checks
from ullage.arrays import Bools, Floats, Longs
from ullage.data import Frames, Trajectory
from ullage.errors import InputError
from ullage.processing.baseband import has_phase, to_baseband

BEND_M = 0.02
MOST_FRAMES = 41
LEAST_FRAMES = 3
COSINES = 33
OUTSTANDING = 4.0  # times their median: of frames of noise alone one in sixteen has so much power


def tracked(
    frames: Frames, sigma: float, *, pfa: float, window_m: float, min_range_m: float
) -> tuple[Longs, Floats, Floats, Floats]:
    """Frame, range [m], amplitude (root of the mean power along the track) and signal to noise [dB] of each detection.

    Args:
        frames: complex baseband or RF, with poses.
        sigma: root of the mean noise power of a bin.
        pfa: false alarm probability of a bin.
        window_m: length of track over which power is added [m].
        min_range_m: nothing nearer counts [m].

    Raises:
        InputError: amplitudes without noise to judge by, no poses, or a number out of bounds.
    """
    from ullage.kernels.track import along_hyperbolas

    if not has_phase(frames) or not sigma > 0:
        raise InputError("no exponential noise to judge by", where="track", allowed="frames with noise; threshold")
    if not 0 < checks.number("pfa", pfa, "track", allowed="0 .. 0.5") < 0.5:
        raise InputError(f"pfa is {pfa}", where="track", allowed="0 .. 0.5")
    window_m = checks.number("window_m", window_m, "track", above=0.0, allowed="> 0")
    path = frames.believed
    power = np.abs(np.asarray(to_baseband(frames), np.complex128)) ** 2 / sigma**2
    levels = level_of_sums(pfa / COSINES)
    cosines = np.linspace(-1, 1, COSINES)
    excess, best = np.empty(power.shape[1]), np.empty(power.shape[1])
    out: list[tuple[int, float, float, float]] = []
    for i in range(len(frames)):
        rows, along = window(path, i, window_m)
        along_hyperbolas(power[rows], along, frames.range_m, cosines, levels, excess, best)
        m = len(rows)
        over = excess > 1
        top = np.flatnonzero(over[1:-1] & (excess[1:-1] > excess[:-2]) & (excess[1:-1] >= excess[2:])) + 1
        top = top[frames.range_m[top] >= min_range_m]
        for b in top[present_along_track(power[rows], along, frames.range_m, top, best, levels)]:
            mean = float(excess[b] * levels[m] / m)
            left, middle, right = excess[b - 1], excess[b], excess[b + 1]
            shift = 0.5 * (left - right) / (left - 2 * middle + right)
            place = float(frames.range_m[b] + shift * (frames.range_m[1] - frames.range_m[0]))
            out.append((i, place, sigma * np.sqrt(mean), 10 * np.log10(max(mean - 1, 1e-3))))
    columns = np.array(out, float).reshape(-1, 4)
    return columns[:, 0].astype(np.int64), columns[:, 1], columns[:, 2], columns[:, 3]


def present_along_track(
    power: Floats, along: Floats, range_m: Floats, top: Longs, cosine: Floats, levels: Floats
) -> Bools:
    """Which peaks (k) most frames hold: not those of a few in which they cross what a strong echo draws.

    A hyperbola of the wrong bearing meets that of a strong echo near an end of the track, and those frames alone may
    lift its sum over the level. So none counts for more than OUTSTANDING times the median of all.

    Args:
        power: (m, b) in units of the mean noise power.
        along: (m) places on the track [m].
        range_m: of the bins (b) [m].
        top: bins of the peaks (k).
        cosine: to the track, of the best hyperbola at each bin (b).
        levels: what noise exceeds seldom enough in a sum of so many frames.
    """
    r, c = range_m[top, None], cosine[top, None]
    runs = np.sqrt(np.maximum(r**2 + along**2 - 2 * r * along * c, 0.0))
    bins = np.floor((runs - range_m[0]) / (range_m[1] - range_m[0]) + 0.5).astype(int)
    there = (bins >= 0) & (bins < len(range_m))
    mine = np.where(there, power[np.arange(len(along)), np.where(there, bins, 0)], np.nan)
    most = OUTSTANDING * np.nanmedian(mine, axis=1, keepdims=True)
    return np.asarray(np.nansum(np.minimum(mine, most), axis=1) > levels[there.sum(1)])


def level_of_sums(pfa: float) -> Floats:
    """What the sum of 0 .. MOST_FRAMES unit exponentials exceeds with probability pfa."""
    from scipy.special import gammainccinv

    return np.concatenate([[np.inf], gammainccinv(np.arange(1, MOST_FRAMES + 1), pfa)])


def window(path: Trajectory, index: int, window_m: float) -> tuple[Longs, Floats]:
    """Return the frames around one, up to a bend of the track, and their distance along it [m]; or only that frame."""
    away = path.position - path.position[index]
    gap = np.linalg.norm(away, axis=1)
    out = gap > window_m / 2
    first = index - int(np.argmax(out[:index][::-1])) if out[:index].any() else 0
    last = index + int(np.argmax(out[index:])) if out[index:].any() else len(path)
    span = last - first
    rows = np.unique(np.append(np.arange(first, last, max(1, -(-span // (MOST_FRAMES - 1)))), index))
    far = rows[np.argmax(gap[rows])]
    if gap[far] < 1e-3:
        return np.array([index]), np.zeros(1)
    ahead = away[far] / gap[far]
    along = away[rows] @ ahead
    bent = np.flatnonzero(np.linalg.norm(away[rows] - along[:, None] * ahead, axis=1) >= BEND_M)
    here = int(np.flatnonzero(rows == index)[0])
    part = slice(bent[bent < here].max(initial=-1) + 1, bent[bent > here].min(initial=len(rows)))
    rows, along = rows[part], along[part]
    return (rows, along) if len(rows) >= LEAST_FRAMES else (np.array([index]), np.zeros(1))
