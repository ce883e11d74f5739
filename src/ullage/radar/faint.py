"""Which of many echoes are too faint to be heard beside the strongest of a frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ullage.kernels import lit
from ullage.radar.physical import Bench

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

MANY = 25.0
"""So many would have to be in phase to make that: one that makes more than so small a share is not left out."""
_LEVELS = 40  # loudness in steps of 3 dB


def audible(ready: Bench, loud: Floats, paths: Floats, rest: float) -> Bools:
    """Which of some echoes (n) of amplitudes `loud` at mean ranges `paths` [m] count.

    All the others within a pulse's length make, with phases at random, at most a path gain amplitude of `rest`, and
    none of them makes more than its `MANY`th.
    """
    if rest <= 0:
        return np.asarray(loud != 0)
    long, out = 2 * ready.pulse.half_m, np.empty(len(loud), np.bool_)
    sums = np.zeros((int(paths.max(initial=0.0) / long) + 1, _LEVELS + 1))
    lit.sift(loud, paths, long, rest, rest / MANY, sums, out)
    return out
