"""Elfes' occupancy grid as the thesis uses it: first peak, four steps, one plane [Elfes1987] [Billdal2018]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ullage.data import Frames, Recording
from ullage.errors import InputError
from ullage.geometry import quat_matrix
from ullage.grids import UNKNOWN, Changes, Grid, OccupancyMap
from ullage.kernels.elfes import insert_reading
from ullage.processing.echoes import first_echo
from ullage.processing.mapper_door import in_order, plane_of

Floats = NDArray[np.float64]
LOBE_DEG = 65.0
SPREAD_M = 0.15


class ElfesMapper:
    """Streaming Elfes grid; updating with pieces gives the map of the whole.

    The four steps: readings outside the range limits are rejected; each cell of the lobe gets a chance to be empty
    (f_e) or occupied (f_o); cells hold 0..100 or unknown; readings are added with `a + b - a b`, after each reading's
    f_o is weakened by the known emptiness and normalised along the arc. That last step makes ghosts while hovering.

    Args:
        grid: a plane; without a height it takes that of the first frames.
        threshold: amplitude of the first peak; None: 0.038 for frames of the thesis model, else over the noise.
        lobe_deg: full opening of the lobe.
        spread_m: half thickness of the arc; at least one cell.
    """

    def __init__(
        self, grid: Grid, *, threshold: float | None = None, lobe_deg: float = LOBE_DEG, spread_m: float = SPREAD_M
    ) -> None:
        if grid.dims != 2:
            raise InputError(
                "the Elfes grid is a plane", where="grid", allowed="a grid with dims=2, or method='ullage'"
            )
        self.grid = grid
        self._threshold, self._half = threshold, np.radians(lobe_deg) / 2
        self._spread = max(spread_m, grid.step_m)
        self._empty = np.zeros(grid.shape, np.float32)
        self._occupied = np.zeros(grid.shape, np.float32)
        self.traversed: tuple[slice, slice] | None = None  # square of cells that the last reading looked at
        self._published: OccupancyMap | None = None

    def update(self, frames: Recording) -> None:
        """Add frames of one or several sensors.

        Raises:
            InputError: no poses, a sample that is not finite, or a flight that leaves the grid.
        """
        parts = in_order(frames, self.grid)
        self.grid = plane_of(self.grid, parts)
        for part in parts:
            self._insert(part)

    def _insert(self, frames: Frames) -> None:
        reach, found = first_echo(frames, threshold=self._threshold)
        near = max(frames.spec.thesis.min_range_m, float(frames.range_m[0]))
        last = float(frames.range_m[-1])
        path = frames.believed
        ahead = quat_matrix(path.quat_xyzw)[:, :2, 0]
        box = np.zeros(4, np.int64)
        for i in range(len(frames)):
            level = float(np.hypot(*ahead[i]))
            if level < np.sin(np.radians(20)) or (found[i] and not near < reach[i] < last):
                continue
            insert_reading(
                self._empty, self._occupied, *self.grid.origin_m[:2], self.grid.step_m, *path.position[i, :2],
                float(np.arctan2(ahead[i, 1], ahead[i, 0])), near, float(reach[i]) if found[i] else last,
                self._spread, bool(found[i]), self._half, box,
            )  # fmt: skip
            self.traversed = slice(int(box[0]), int(box[1])), slice(int(box[2]), int(box[3]))

    def map(self) -> OccupancyMap:
        """The map so far: 50 + 50 Occ where Occ >= Emp, else 50 - 50 Emp, unknown where neither is known."""
        signed = np.where(self._occupied >= self._empty, self._occupied, -self._empty)
        percent = np.rint(50 + 50 * signed).astype(np.int8)
        percent[(self._occupied == 0) & (self._empty == 0)] = UNKNOWN
        return OccupancyMap(self.grid, percent, "elfes")

    def changed(self) -> Changes:
        """The blocks in which the map differs from that of the last call."""
        now = self.map()
        out = now.changes(self._published)
        self._published = now
        return out

    def finish(self) -> None:
        """Nothing is held back."""
