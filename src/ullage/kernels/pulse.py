"""The loop from delay grids to range bins."""

from __future__ import annotations

import numpy as np

from ullage.arrays import Complexes
from ullage.kernels.loops import loop


@loop(fastmath=True, error_model="numpy")
def convolve(grids: Complexes, taps: Complexes, every: int, shift: int, out: Complexes) -> None:
    """Bins from delay grids: out[m] = sum over kinds and places of taps * grid, `every` places per bin.

    Args:
        grids: (3, g) complex.
        taps: (3, h) complex pulse of each kind, centred on index (h - 1) / 2.
        every: grid places per bin.
        shift: grid place of bin 0.
        out: (b) complex, added to.
    """
    half = (taps.shape[1] - 1) // 2
    size, long = grids.shape[1], taps.shape[1]
    real, imag = np.empty(size), np.empty(size)  # apart, so that the sums below are done several at a time
    turned, leaned = np.empty(long), np.empty(long)
    for kind in range(3):
        low, high = 0, size
        while low < size and grids[kind, low] == 0:
            low += 1
        while high > low and grids[kind, high - 1] == 0:
            high -= 1
        for g in range(low, high):
            real[g], imag[g] = grids[kind, g].real, grids[kind, g].imag
        for h in range(long):
            turned[h], leaned[h] = taps[kind, long - 1 - h].real, taps[kind, long - 1 - h].imag
        for m in range(len(out)):
            first = m * every + shift - half
            start, stop = max(low - first, 0), min(high - first, long)
            x, y = 0.0, 0.0
            for h in range(start, stop):
                at, tap = (
                    np.uint64(first + h),
                    np.uint64(h),
                )  # never negative: numbers that may be negative cost a test each
                x += real[at] * turned[tap] - imag[at] * leaned[tap]
                y += real[at] * leaned[tap] + imag[at] * turned[tap]
            out[m] += complex(x, y)
