"""Elfes' occupancy grid as the thesis uses it: first peak, four steps, one plane [Elfes1987] [Billdal2018]."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage import checks
from ullage.arrays import Longs
from ullage.data import Frames, Recording
from ullage.errors import InputError
from ullage.geometry import quat_matrix
from ullage.grids import UNKNOWN, Changes, Grid, OccupancyMap
from ullage.kernels.elfes import Cells, Lobe, Reading, insert_reading, lobe_box
from ullage.processing.echoes import first_echo
from ullage.processing.intake import in_order, plane_of

LOBE_DEG = 65.0
SPREAD_M = 0.15


class ElfesMapper:
    """Streaming Elfes grid; updating with pieces gives the map of the whole, since frames are taken by their stamps.

    The four steps: readings outside the range limits are rejected; each cell of the lobe gets a chance to be empty
    (f_e) or occupied (f_o); cells hold 0..100 or unknown; readings are added with `a + b - a b`, after each reading's
    f_o is weakened by the known emptiness and normalised along the arc. That last step makes ghosts while hovering.

    Args:
        grid: a plane; without a height it takes that of the first frames.
        threshold: amplitude of the first peak; None: 0.038 for frames of the thesis model, else over the noise.
        lobe_deg: full opening of the lobe.
        spread_m: half thickness of the arc; at least one cell.
        bits: 32 keeps emptiness and occupancy of a cell as float32; 8 keeps one byte a cell, as thesis 5.3.1 asks. The
            byte is occupancy less emptiness in whole percent, rounded after every reading. A cell that was seen both
            empty and occupied keeps the difference only. A change of less than half a percent is lost, so a value
            stops growing while readings are weak.
        certain: the most that emptiness and occupancy may reach. At 1, as in the formulas, a cell that was seen empty
            often enough rounds to 1, and no later reading can make it occupied. At 0.99 some 200 readings can.
        kernel: blends one reading into emptiness and occupancy, with the arguments of `kernels.elfes.insert_reading`;
            None: that one.

    Raises:
        InputError: the grid is a volume or too large, no such number of bits, or a number out of bounds.
    """

    def __init__(
        self,
        grid: Grid,
        *,
        threshold: float | None = None,
        lobe_deg: float = LOBE_DEG,
        spread_m: float = SPREAD_M,
        bits: float = 32,
        certain: float = 1.0,
        kernel: Callable[..., None] | None = None,
    ) -> None:
        checks.number("lobe_deg", lobe_deg, "elfes", above=0.0, allowed="> 0")
        checks.number("spread_m", spread_m, "elfes", above=0.0, allowed="> 0")
        if threshold is not None:
            checks.number("threshold", threshold, "elfes", above=0.0, allowed="> 0")
        if not 0.5 < certain <= 1:
            raise InputError(f"certain is {certain}", where="elfes", allowed="above 0.5, at most 1")
        if bits not in (8, 32):
            raise InputError(f"bits is {bits:g}", where="elfes", allowed="8 or 32")
        if grid.dims != 2:
            raise InputError(
                "the Elfes grid is a plane", where="grid", allowed="a grid with dims=2, or method='ullage'"
            )
        grid.check_memory(1 if bits == 8 else 8, "the map")
        self.grid = grid
        self._threshold = threshold
        self._cells = Cells(float(grid.origin_m[0]), float(grid.origin_m[1]), float(grid.step_m))
        self._lobe = Lobe(half=float(np.radians(lobe_deg) / 2), spread=float(max(spread_m, grid.step_m)))
        self._certain = certain
        self._kernel = insert_reading if kernel is None else kernel
        self._layers = (  # emptiness and occupancy; or one layer of their difference in percent
            [np.zeros(grid.shape, np.int8)] if bits == 8 else [np.zeros(grid.shape, np.float32) for _ in range(2)]
        )
        self.traversed: tuple[slice, slice] | None = None  # square of cells that the last reading looked at
        self._published: OccupancyMap | None = None

    @property
    def nbytes(self) -> int:
        """Memory of all cells [byte]."""
        return sum(layer.nbytes for layer in self._layers)

    def update(self, frames: Recording) -> None:
        """Add frames of one or several sensors.

        Raises:
            InputError: no poses, a sample that is not finite, or a flight that leaves the grid.
        """
        parts = in_order(frames, self.grid)
        self.grid = plane_of(self.grid, parts)
        readings = [found for part in parts for found in self._readings(part)]
        box = np.zeros(4, np.int64)
        for _, _, reading in sorted(
            readings, key=lambda found: found[:2]
        ):  # each reading changes what the next one does
            self._blend(reading, box)
            self.traversed = slice(int(box[0]), int(box[1])), slice(int(box[2]), int(box[3]))

    def _readings(self, frames: Frames) -> Iterator[tuple[int, str, Reading]]:
        """Time, sensor and reading of each frame within the range limits."""
        reach, found = first_echo(frames, threshold=self._threshold)
        near = max(frames.spec.thesis.min_range_m, float(frames.range_m[0]))
        last = min(float(frames.range_m[-1]), frames.ray_model.max_range_m if frames.ray_model else np.inf)
        path = frames.believed
        ahead = quat_matrix(path.quat_xyzw)[:, :2, 0]
        times, positions = frames.t_ns.tolist(), path.position[:, :2].tolist()
        for i in range(len(frames)):
            level = float(np.hypot(*ahead[i]))
            if level < np.sin(np.radians(20)) or (found[i] and not near < reach[i] < last):
                continue
            (x, y), yaw = positions[i], float(np.arctan2(ahead[i, 1], ahead[i, 0]))
            reading = Reading(x, y, yaw, near, float(reach[i]) if found[i] else last, bool(found[i]))
            yield times[i], frames.sensor, reading

    def _blend(self, reading: Reading, box: Longs) -> None:
        """Add one reading; `box` takes the rows and columns that it reached."""
        if len(self._layers) == 1:
            self._blend_byte(self._layers[0], reading, box)
            return
        empty, occupied = self._layers
        self._kernel(empty, occupied, self._cells, reading, self._lobe, box)
        if self._certain < 1:
            for layer in self._layers:
                part = layer[box[0] : box[1], box[2] : box[3]]
                np.minimum(part, self._certain, out=part)

    def _blend_byte(self, layer: NDArray[Any], reading: Reading, box: Longs) -> None:
        """Add one reading to cells of one byte; only what the lobe can reach is unpacked."""
        lobe_box(self._cells, reading, self._lobe, layer.shape, box)
        square = slice(box[0], box[1]), slice(box[2], box[3])
        signed = layer[square].astype(np.float32) / 100
        empty, occupied = np.maximum(-signed, 0), np.maximum(signed, 0)
        step = self._cells.step
        cells = Cells(self._cells.x0 + int(box[2]) * step, self._cells.y0 + int(box[0]) * step, step)
        self._kernel(empty, occupied, cells, reading, self._lobe, np.zeros(4, np.int64))
        layer[square] = np.rint(100 * np.clip(occupied - empty, -self._certain, self._certain)).astype(np.int8)

    def map(self) -> OccupancyMap:
        """The map so far: 50 + 50 Occ where Occ >= Emp, else 50 - 50 Emp, unknown where neither is known."""
        if len(self._layers) == 1:
            signed = self._layers[0].astype(np.float32) / 100
        else:
            empty, occupied = self._layers
            signed = np.where(occupied >= empty, occupied, -empty)
        unknown = signed == 0
        signed *= 50  # in place: a node publishes the whole map five times a second
        signed += 50
        percent = np.rint(signed, out=signed).astype(np.int8)
        percent[unknown] = UNKNOWN
        return OccupancyMap(self.grid, percent, "elfes")

    def changed(self) -> Changes:
        """The blocks in which the map differs from that of the last call."""
        now = self.map()
        out = now.changes(self._published)
        self._published = now
        return out

    def finish(self) -> None:
        """Nothing is held back."""
