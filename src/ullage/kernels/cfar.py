"""Order statistics over sliding windows."""

from __future__ import annotations

import numpy as np

from ullage.arrays import Floats
from ullage.kernels.loops import loop


@loop(nogil=True)
def windowed_order(power: Floats, guard: int, train: int, rank: int, out: Floats) -> None:
    """The `rank`-th smallest [0 = least] of the `train` cells on either side of each cell, past `guard` cells.

    power, out: (n, b). Near the ends the window lacks one side and takes as many cells more from the other.
    """
    bins = power.shape[1]
    cells = np.empty(2 * train, power.dtype)
    for n in range(power.shape[0]):
        for b in range(bins):
            left = min(max(b - guard, 0), train)
            right = min(max(bins - 1 - b - guard, 0), train)
            left, right = max(left, 2 * train - right), max(right, 2 * train - left)
            count = 0
            for k in range(1, left + 1):
                j = b - guard - k
                if j >= 0 and count < 2 * train:
                    cells[count] = power[n, j]
                    count += 1
            for k in range(1, right + 1):
                j = b + guard + k
                if j < bins and count < 2 * train:
                    cells[count] = power[n, j]
                    count += 1
            if count == 0:
                out[n, b] = np.inf
                continue
            out[n, b] = np.partition(cells[:count], min(rank, count - 1))[min(rank, count - 1)]
