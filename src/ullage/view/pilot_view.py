"""What a pilot sees in the terminal: height, speed, the nearest echo on each side, and the map in characters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.data import Detections, Frames, Trajectory, sensors_of
from ullage.flow import Sink
from ullage.geometry import quat_rpy
from ullage.grids import Grid, OccupancyMap

SIDES = ("front", "left", "back", "right")
HEADINGS = ">^<v"
CELLS = " .#"
"""Unknown, free, occupied."""
SLAB_M = 0.3
"""Cells of a volume within so much of the vehicle's height are shown [m]."""
FRESH_NS = 1_000_000_000
"""An echo is shown for so long [ns]."""


class PilotView(Sink):
    """Sink that keeps the last state, echoes and map of a flight, and gives them as lines of text.

    Args:
        columns: of the map, at most.
        rows: of the map, at most.
    """

    def __init__(self, *, columns: int = 60, rows: int = 16) -> None:
        self._columns, self._rows = columns, rows
        self._flown: Trajectory | None = None
        self._side: dict[str, str] = {}  # by sensor
        self._newest_ns = 0
        self._echoes: dict[str, tuple[int, float]] = {}  # by side: time [ns] and range [m]
        self._drawn: tuple[NDArray[np.int8], Grid, float] | None = None  # rows of characters, and the width of one [m]

    def write(self, item: Any) -> None:
        """Take the path, frames, detections and maps; all else is not shown."""
        if isinstance(item, Trajectory):
            self._flown = item[-1:]
        elif isinstance(item, Detections) and len(item):
            self._take(item)
        elif isinstance(item, Frames | Mapping):
            for part in sensors_of(item):
                self._side[part.sensor] = side_of(part.spec.mount.yaw_deg, part.spec.mount.pitch_deg)
                self._newest_ns = max(self._newest_ns, int(part.t_ns[-1]))
        elif isinstance(item, OccupancyMap):
            self._drawn = self._characters(item)

    def _take(self, found: Detections) -> None:
        newest = found.t_ns == found.t_ns.max()
        if side := self._side.get(found.sensor):
            self._echoes[side] = int(found.t_ns.max()), float(found.range_m[newest].min())

    def _characters(self, omap: OccupancyMap) -> tuple[NDArray[np.int8], Grid, float]:
        """Return the map as numbers of `CELLS`, north at the top; a character is twice as high as wide."""
        cells = omap.free.astype(np.int8) + 2 * omap.occupied
        if omap.grid.dims == 3:
            height_m = 0.0 if self._flown is None else float(self._flown.position[0, 2])
            away = np.abs(omap.grid.z_m - height_m)
            cells = cells[away <= max(SLAB_M, float(away.min()))].max(axis=0)
        ny, nx = cells.shape
        across = max(1, math.ceil(nx / self._columns), math.ceil(ny / (2 * self._rows)))
        full = np.pad(cells, ((0, -ny % (2 * across)), (0, -nx % across)))
        blocks = full.reshape(full.shape[0] // (2 * across), 2 * across, full.shape[1] // across, across)
        return blocks.max(axis=(1, 3))[::-1], omap.grid, across * omap.grid.step_m

    def lines(self) -> list[str]:
        """Return the lines to show now."""
        flown, out = self._flown, []
        if flown is not None:
            speed_m_s = float(np.linalg.norm(flown.rates[0][0]))
            out.append(f"height {flown.position[0, 2]:.2f} m   speed {speed_m_s:.2f} m/s")
        if self._side:
            sides = [side for side in (*SIDES, "up", "down") if side in self._side.values()]
            out.append("nearest echo [m]: " + "   ".join(f"{side} {self._range(side)}" for side in sides))
        return out + self._map_lines()

    def _range(self, side: str) -> str:
        t_ns, range_m = self._echoes.get(side, (0, math.inf))
        return f"{range_m:.2f}" if math.isfinite(range_m) and self._newest_ns - t_ns <= FRESH_NS else "-"

    def _map_lines(self) -> list[str]:
        if self._drawn is None:
            return []
        drawn, grid, wide_m = self._drawn
        rows = [[CELLS[cell] for cell in row] for row in drawn.tolist()]
        if self._flown is not None:
            x, y, _ = self._flown.position[0] - grid.origin_m
            column, row = int(x // wide_m), len(rows) - 1 - int(y // (2 * wide_m))
            if 0 <= row < len(rows) and 0 <= column < len(rows[0]):
                heading = float(quat_rpy(self._flown.quat_xyzw[0])[2])
                rows[row][column] = HEADINGS[round(heading / (math.pi / 2)) % 4]
        legend = f"# occupied   . free   {HEADINGS} drone   a character is {wide_m:g} m wide, {2 * wide_m:g} m high"
        return ["".join(row).rstrip() for row in rows] + [legend]


def side_of(yaw_deg: float, pitch_deg: float) -> str:
    """Return the side of the vehicle on which a radar looks; positive pitch looks down."""
    if abs(pitch_deg) > 45:
        return "down" if pitch_deg > 0 else "up"
    return SIDES[round(yaw_deg / 90) % 4]
