"""Loops of the receiver: the DAC window on a complex envelope."""

from __future__ import annotations

import math

import numpy as np

from ullage.arrays import Complexes
from ullage.kernels.loops import lean


@lean()
def limit_envelope(values: Complexes, limit: float) -> None:
    """Hard limiting of the carrier under a complex envelope (n, b), in place: what stays at the carrier frequency.

    The describing function of a limiter [GelbVanderVelde1968].
    """
    rows, bins = values.shape
    for f in range(rows):
        for k in range(bins):
            size = math.hypot(values[f, k].real, values[f, k].imag)
            if size > limit:
                x = limit / size
                values[f, k] *= 2 / np.pi * (math.asin(x) + x * math.sqrt(1 - x * x))
