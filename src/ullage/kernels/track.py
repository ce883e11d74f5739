"""Energy along the hyperbolas that things at rest draw over slow time."""

from __future__ import annotations

import math

import numpy as np

from ullage.kernels.loops import loop


@loop(fastmath=True)
def along_hyperbolas(
    power: np.ndarray,
    along: np.ndarray,
    ranges: np.ndarray,
    cosines: np.ndarray,
    levels: np.ndarray,
    excess: np.ndarray,
    best: np.ndarray,
) -> None:
    """For each range, the greatest sum of power over its level, and the cosine that gave it.

    power: (m, b) of the frames at places `along` (m) [m] of a straight track, in units of the mean noise power. A thing
    at range r and cosine c from place 0 has range sqrt(r^2 + s^2 - 2 r s c) at place s. levels: (m + 1) what noise
    exceeds seldom enough in a sum of so many bins. excess, best: (b).
    """
    frames, bins = power.shape
    start, per_bin = ranges[0], (bins - 1) / (ranges[bins - 1] - ranges[0])
    for b in range(bins):
        r = ranges[b]
        excess[b] = -1e300
        for c in cosines:
            total, count = 0.0, 0
            for j in range(frames):
                s = along[j]
                k = int((math.sqrt(max(r * r + s * s - 2.0 * r * s * c, 0.0)) - start) * per_bin + 0.5)
                if 0 <= k < bins:
                    total += power[j, k]
                    count += 1
            over = total / levels[count] if count > 0 else 0.0
            if over > excess[b]:
                excess[b], best[b] = over, c
