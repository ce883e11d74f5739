"""The full-profile mapper: every bin speaks, echoes look for the one cell that made them, silence frees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ullage.data import Recording
from ullage.grids import Grid, OccupancyMap
from ullage.kernels.occupancy import cast_reach, mark_flown, render_cells, update_cells
from ullage.processing.blocks import Blocks
from ullage.processing.mapper_door import ChangedRegion, in_order, plane_of
from ullage.processing.mapper_looks import Listener, Look

Floats = NDArray[np.float64]

PRIOR = -3.5
FALSE_ECHO = 0.1
DETECTION = 0.9
FREE_NATS = np.array([0, 0.3, 0.7, 1.2, 2.0, 2.7] + [3.5] * 11)
ENOUGH_SIDES = 4
VAGUE_TENTHS = 10
SOLID_ODDS = float(np.log(0.65 / 0.35))
WALL_TENTHS = 42
HAZE_PER_M = 0.2
HIT_BEAM, FREE_BEAM = np.cos(np.radians(50.0)), np.cos(np.radians(40.0))
TANGENT = 1.3
SECTORS = {2: (1, 96), 3: (28, 28)}
FLOWN_M = 0.25
LEAST_SHARE = 0.5


class UllageMapper:
    """Streaming full-profile mapper on a plane or a volume.

    Args:
        grid: holds the flight; a plane without a height takes that of the first frames.
    """

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self.blocks = Blocks(grid)
        self._listeners: dict[str, Listener] = {}
        self._axis: dict[str, tuple[float, float, float]] = {}
        self._region = ChangedRegion()
        self._found = np.zeros((60_000, 4), np.int32)
        self._chance = np.zeros(60_000)
        self._reach = np.zeros(SECTORS[grid.dims])
        self._looks = 0

    def update(self, frames: Recording) -> None:
        """Add frames of one or several sensors.

        Raises:
            InputError: no poses, a sample that is not finite, or a flight that leaves the grid.
        """
        parts = in_order(frames, self.grid)
        self.grid = self.blocks.grid = plane_of(self.grid, parts)
        looks: list[tuple[int, str, Look]] = []
        for part in parts:
            name = part.sensor
            step = float(part.range_m[-1] - part.range_m[0]) / (len(part.range_m) - 1)
            self._axis[name] = float(part.range_m[0]), step, float(part.range_m[-1])
            listener = self._listeners.setdefault(name, Listener())
            looks += [(look.heard.t_ns, name, look) for look in listener.hear(part)]
        self._insert_all(looks)

    def finish(self) -> None:
        """Use the looks that waited for frames to come."""
        self._insert_all(
            [(look.heard.t_ns, name, look) for name, one in self._listeners.items() for look in one.flush()]
        )
        self.blocks.collapse(ENOUGH_SIDES + 2)

    def _insert_all(self, looks: list[tuple[int, str, Look]]) -> None:
        for _, name, look in sorted(looks, key=lambda item: item[:2]):
            self._insert(name, look)

    def _insert(self, name: str, look: Look) -> None:
        start, bin_m, far = self._axis[name]
        blocks, heard, step = self.blocks, look.heard, self.grid.step_m
        arcs = self._arcs(look)
        edge_m = blocks.edge * step
        blocks.reserve(
            int(np.prod([2 * far / edge_m + 2] * 2 + ([2 * far / edge_m + 2] if self.grid.dims == 3 else [])))
        )
        pools = (blocks.slots, blocks.free_slots, blocks.free_count, blocks.hits, blocks.silent, blocks.facing)
        mark_flown(*pools, blocks.origin, step, blocks.edge, blocks.size, heard.position, max(FLOWN_M, step))
        cast_reach(
            blocks.slots, blocks.hits, blocks.silent, blocks.origin, step, blocks.edge, blocks.size, heard.position,
            heard.axes, TANGENT, far, WALL_TENTHS, HAZE_PER_M * step, self._reach,
        )  # fmt: skip
        self._shade(heard.axes, arcs)
        box = np.zeros((3, 2), np.int64)
        update_cells(
            *pools, blocks.origin, step, blocks.edge, blocks.size, heard.position, heard.axes, HIT_BEAM, FREE_BEAM,
            TANGENT, self._reach, heard.quiet, start, bin_m, FLOWN_M, far, arcs, FREE_NATS, PRIOR, FALSE_ECHO,
            self._found, self._chance, box,
        )  # fmt: skip
        self._region.add(tuple((int(a), int(b)) for a, b in box[::-1][3 - self.grid.dims :]))
        self._looks += 1
        if self._looks % 64 == 0:
            blocks.collapse(ENOUGH_SIDES + 2)

    def _arcs(self, look: Look) -> Floats:
        step = self.grid.step_m
        kept = look.echoes
        located = bool(look.track.any())
        if located:
            kept = kept[kept[:, 4] >= LEAST_SHARE]
        arcs = np.zeros((len(kept), 9))
        arcs[:, 0] = kept[:, 0]
        arcs[:, 1] = np.maximum(kept[:, 1], 0.35 * step)
        arcs[:, 2:5] = look.track
        if located:
            arcs[:, 5] = np.clip(kept[:, 2], -1, 1)
            blur = 0.35 * step / np.maximum(kept[:, 0], 0.1)
            arcs[:, 6] = np.sqrt(kept[:, 3] ** 2 + blur**2 + 0.01**2)
            arcs[:, 7] = DETECTION * kept[:, 4]
            arcs[:, 8] = 1
        else:
            arcs[:, 6], arcs[:, 7] = 1e3, 0.5
        return arcs

    def _shade(self, axes: Floats, arcs: Floats) -> None:
        """Nothing is learned behind an echo whose bearing is known, even before the map holds it."""
        up, left = self._reach.shape
        y = (2 * (np.arange(left) + 0.5) / left - 1) * TANGENT
        z = (2 * (np.arange(up) + 0.5) / up - 1) * TANGENT if up > 1 else np.zeros(1)
        ray = np.stack(np.broadcast_arrays(1.0, y[None, :], z[:, None]), axis=-1)
        ray = ray / np.linalg.norm(ray, axis=-1, keepdims=True) @ axes.T
        if up == 1:
            ray[..., 2] = 0
            ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
        for arc in arcs[arcs[:, 8] > 0]:
            behind = abs(ray @ arc[2:5] - arc[5]) < 2.5 * arc[6] + 0.05
            self._reach[behind] = np.minimum(self._reach[behind], arc[0] + 2 * self.grid.step_m)

    def map(self) -> OccupancyMap:
        """The map so far; free cells that no free way joins to the flight are unknown."""
        shape = self.grid.shape if self.grid.dims == 3 else (1, *self.grid.shape)
        percent = np.empty(shape, np.int8)
        box = np.array([[0, n] for n in shape[::-1]], np.int64)
        blocks = self.blocks
        render_cells(
            blocks.slots, blocks.hits, blocks.silent, blocks.edge, blocks.size, box, FREE_NATS, PRIOR, ENOUGH_SIDES,
            VAGUE_TENTHS, SOLID_ODDS, percent,
        )  # fmt: skip
        return OccupancyMap(self.grid, percent.reshape(self.grid.shape), "ullage")

    def changed(self) -> tuple[slice, ...] | None:
        """Index of the smallest box of cells touched since the last call; None: nothing was."""
        return self._region.take()
