"""Energy that reflectors in a set of directions explain, kept up to date while echoes are taken out of the samples."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator

import numpy as np

from ullage.arrays import Floats
from ullage.kernels.matched_sums import Aperture, Turns, find_peaks, sum_turned, turn_rows

CHUNK = 28  # directions that are summed over all bins in one step of work


class DirectionSums:
    """Matched sums of flat reflectors; `refine` finds their curvature.

    Args:
        directions: (d, 3) unit vectors.
        turn: function like `turn_rows`, which finds the gains of the sensors.
    """

    def __init__(self, directions: Floats, turn: Callable[..., None] = turn_rows) -> None:
        self.directions, self._turn = directions, turn
        self._turned = np.zeros((0, 4))

    def begin(self, aperture: Aperture) -> None:
        """Take another aperture."""
        rows, bins = aperture.samples.shape[:2]
        count = len(self.directions)
        self._aperture, self._turned = aperture, np.zeros((0, 4))
        self._turns = Turns(
            self.directions,
            np.zeros(count, np.int64),
            np.empty((count, rows), np.int32),
            np.empty((count, rows), np.int32),
            np.empty((count, rows, 3), np.float32),
            np.zeros(count),
        )
        self.energy = np.zeros((count, bins), np.float32)
        self.peak, self._where = np.zeros(bins, np.float32), np.zeros(bins, np.int64)

    def sum(self, low: int, high: int) -> None:
        """Sum anew from bin `low` to `high`."""
        deque(self.steps(low, high), maxlen=0)

    def steps(self, low: int, high: int) -> Iterator[None]:
        """The same in steps of work."""
        if low >= high:
            return
        count = len(self.directions)
        chunk = min(max(CHUNK * len(self.peak) // (high - low), 1), count)
        now = np.column_stack([self._aperture.offset, self._aperture.late[self._aperture.sensor]])
        moved = not np.array_equal(self._turned, now)
        for start in range(0, count, chunk):
            stop = min(start + chunk, count)
            if moved:
                self._turn(self._aperture, 0.0, start, stop, self._turns)
            sum_turned(self._aperture, self._turns, 0.0, start, stop, low, high, self.energy)
            yield
        self._turned = now
        find_peaks(self.energy, low, high, self.peak, self._where)

    def strongest(self, floor: Floats | float, low: int, high: int) -> tuple[float, int, int]:
        """Largest energy over the floor of its bin, with its direction and bin.

        Args:
            floor: (b) factor that an energy must exceed; what stronger echoes leave behind.
            low: first bin.
            high: bin after the last.
        """
        over = (self.peak / floor)[low:high]
        k = low + int(np.argmax(over))
        return float(over[k - low]), int(self._where[k]), k
