"""Order statistics over sliding windows."""

from __future__ import annotations

import numpy as np

from ullage.arrays import Floats
from ullage.kernels.loops import loop


@loop()
def _changed(cells: Floats, count: int, row: Floats, first: int, end: int, step: int) -> int:
    """Put the cells `first` to `end` of a row into a sorted list (step 1), or take them out (-1); return its length."""
    for j in range(first, end):
        value, low, high = row[j], 0, count
        while low < high:
            middle = (low + high) // 2
            if cells[middle] < value:
                low = middle + 1
            else:
                high = middle
        if step > 0:
            for k in range(count, low, -1):
                cells[k] = cells[k - 1]
            cells[low] = value
        else:
            for k in range(low, count - 1):
                cells[k] = cells[k + 1]
        count += step
    return count


@loop()
def windowed_order(power: Floats, guard: int, train: int, rank: int, out: Floats) -> None:
    """The `rank`-th smallest [0 = least] of the `train` cells on either side of each cell, past `guard` cells.

    power, out: (n, b). Near the ends the window lacks one side and takes as many cells more from the other. The window
    is kept sorted as it slides.
    """
    bins = power.shape[1]
    cells = np.empty(2 * train, power.dtype)
    for n in range(power.shape[0]):
        row, count = power[n], 0
        a, b, c, d = 0, 0, 0, 0  # it holds the cells a to b and c to d
        for at in range(bins):
            left = min(max(at - guard, 0), train)
            right = min(max(bins - 1 - at - guard, 0), train)
            left, right = max(left, 2 * train - right), max(right, 2 * train - left)
            low, low_end = max(at - guard - left, 0), max(at - guard, 0)
            up, up_end = min(at + guard + 1, bins), min(at + guard + 1 + right, bins)
            count = _changed(cells, count, row, a, min(b, low), -1)
            count = _changed(cells, count, row, max(a, low_end), b, -1)
            count = _changed(cells, count, row, c, min(d, up), -1)
            count = _changed(cells, count, row, max(c, up_end), d, -1)
            count = _changed(cells, count, row, low, min(low_end, a), 1)
            count = _changed(cells, count, row, max(b, low), low_end, 1)
            count = _changed(cells, count, row, up, min(up_end, c), 1)
            count = _changed(cells, count, row, max(d, up), up_end, 1)
            a, b, c, d = low, low_end, up, up_end
            out[n, at] = cells[min(rank, count - 1)] if count else np.inf
