"""Cells of a map in sparse blocks: nothing is kept for unknown ones, one number for one that is free throughout."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ullage.errors import InputError
from ullage.grids import EDGE, Grid
from ullage.kernels.occupancy import (
    EMPTY,
    MOST_HITS,
    NOWHERE,
    WALL_TENTHS,
    Pools,
    collapse_blocks,
    mark_flown,
    share_echoes,
)
from ullage.kernels.occupancy_cone import hear_blocks, survey_blocks
from ullage.kernels.occupancy_reach import Beam, cast_reach
from ullage.kernels.occupancy_strip import is_clear, lay_strip

MOST_BYTES = 2 * 1024**3
GROWTH = 16
PRIOR = -3.5
FREE_NATS = np.array([0, 0.3, 0.7, 1.2, 2.0, 2.7] + [3.5] * 11)
HAZE_PER_M = 0.12
STRIDE = {2: 1, 3: 4}
MOST_FOUND = 60_000
COLLAPSED_EVERY, ROWS_A_STEP = 64, 48
RAY_TENTHS = 20
NO_WALLS = np.zeros((0, 8))


class Blocks:
    """What is known of each cell, in blocks of 16 x 16 or 8 x 8 x 8.

    Args:
        grid: where the cells are.

    Raises:
        InputError: the table of blocks alone would not fit in memory; says how large it would be.
    """

    def __init__(self, grid: Grid) -> None:
        self.grid, self.edge = grid, EDGE[grid.dims]
        shape = grid.shape if grid.dims == 3 else (1, *grid.shape)
        table = tuple(-(-n // (self.edge if grid.dims == 3 or axis else 1)) for axis, n in enumerate(shape))
        bytes_needed = 6.0 * float(np.prod(np.asarray(table, float)))
        if bytes_needed > MOST_BYTES or grid.size > 2**40:
            raise InputError(
                f"the grid has {grid.size:.3g} cells; its table of blocks alone takes {bytes_needed / 1e9:.1f} GB",
                where="grid",
                allowed=f"at most {MOST_BYTES / 1e9:.1f} GB; a coarser step or a smaller box",
            )
        self.cells = self.edge**grid.dims
        self.pools = Pools(
            slots=np.full(table, EMPTY, np.int32),
            common=np.zeros(table, np.uint16),
            hits=np.zeros((0, self.cells), np.int8),
            silent=np.zeros((0, self.cells), np.uint16),
            facing=np.zeros((0, self.cells), np.uint8),
            loud=np.zeros(0, np.uint8),
            free_slots=np.zeros(0, np.int32),
            free_count=np.zeros(1, np.int64),
            size=np.array(shape[::-1], np.int64),
            origin=np.nan_to_num(np.asarray(grid.origin_m, float)),
        )
        self._held_by = chances()
        most = MOST_FOUND if grid.dims == 2 else 0  # in a volume no arc names a place
        self._found, self._chance = np.zeros((most, 5), np.int32), np.zeros(most)
        self._turn = 0

    def insert_in_steps(
        self, beam: Beam, ways: NDArray[np.float64], walls: NDArray[np.float64] = NO_WALLS, *, sure: int = 0
    ) -> Iterator[int]:
        """Add one look, a step each time that the next is asked for; nothing else may be added before the last.

        Each step gives how much work the next is, in such as the silence of some blocks takes.

        Args:
            beam: the sensor, its echoes and its silence; `reach` and `hush` are filled in.
            ways: (m, 5) direction and range of surfaces known to lie square to the look, and how far they shade.
            walls: (p, 8) normal, distance, centre and radius of flat surfaces that nothing is learned of.
            sure: how many of these there are; of what lies behind the others, only silence tells nothing.
        """
        step, stride = self.grid.step_m, STRIDE[self.grid.dims]
        self._turn += 1
        met = _met(beam, walls)
        walls, sure = walls[met], int(np.count_nonzero(met[:sure]))
        farthest = cast_reach(self.pools, step, self.edge, beam, ways, walls, sure, HAZE_PER_M * step)
        farthest = min(farthest + step, beam.far)
        yield 1
        rows = survey_blocks(self.pools, step, self.edge, beam, farthest, self._turn, stride)
        found, most = 0, ROWS_A_STEP if self.grid.dims == 3 else max(len(rows), 1)
        for first in range(0, len(rows), most):
            yield 1
            some = rows[first : first + most]
            self.reserve(int(np.count_nonzero(self.pools.slots[some[:, 0], some[:, 1], some[:, 2]] == EMPTY)))
            found = hear_blocks(self.pools, step, self.edge, beam, farthest, some, self._found, self._chance)
        if found:
            share_echoes(self.pools, beam.arcs, self._found, self._chance, found, self._held_by)
        if self._turn % COLLAPSED_EVERY == 0:
            yield 1
            self.collapse()

    def lay(self, foot: NDArray[np.float64], way: NDArray[np.float64], strip: tuple[float, float, float]) -> None:
        """Add an echo's evidence to the strip or disc of surface, square to its way, that made it.

        Args:
            foot: (3) foot of the perpendicular [m].
            way: (3) unit vector to it, level on a plane.
            strip: doubt in range [m], half length [m], gain on the strip [nat].
        """
        sigma, half, gain = strip
        self.reserve(int(2 * (half + 3 * sigma) / (self.edge * self.grid.step_m) + 3) ** self.grid.dims)
        lay_strip(self.pools, self.grid.step_m, self.edge, foot, way, sigma, half, gain)

    def clear_to(self, eye: NDArray[np.float64], way: NDArray[np.float64], range_m: float) -> bool:
        """Whether the map holds nothing occupied between a place and what lies at a range in a direction."""
        return bool(is_clear(self.pools, self.grid.step_m, self.edge, eye, way, range_m, WALL_TENTHS))

    def clear(self, position: NDArray[np.float64], radius_m: float) -> None:
        """Nothing stands within a radius of a place where the drone was."""
        self.reserve(
            min(int(2 * radius_m / (self.edge * self.grid.step_m) + 3) ** self.grid.dims, self.pools.slots.size)
        )
        mark_flown(self.pools, self.grid.step_m, self.edge, position, radius_m)

    def insert_rays(self, eye: NDArray[np.float64], ends: NDArray[np.float64]) -> None:
        """Add what a sensor of single directions says, as a lidar: nothing up to where each ray (n, 3) ends."""
        from ullage.kernels.occupancy_rays import insert_rays

        box = np.stack([np.minimum(ends.min(axis=0), eye), np.maximum(ends.max(axis=0), eye)]) - self.pools.origin
        wide = np.ceil((box[1] - box[0]) / (self.edge * self.grid.step_m))[: self.grid.dims] + 1
        self.reserve(int(min(np.prod(wide), self.pools.slots.size)))
        insert_rays(self.pools, self.grid.step_m, self.edge, eye, ends, RAY_TENTHS)

    def reserve(self, count: int) -> None:
        """Have room for this many more blocks."""
        old, free = len(self.pools.hits), self.pools.free_slots[: int(self.pools.free_count[0])]
        lacking = min(count - len(free), self.pools.slots.size - old)
        if lacking <= 0:
            return
        extra = min(max(lacking, GROWTH, old // 16), self.pools.slots.size - old)
        grown = {
            name: np.concatenate([pool, np.full((extra, *pool.shape[1:]), fill, pool.dtype)])
            for name, fill in (("hits", 0), ("silent", 0), ("facing", NOWHERE), ("loud", 0))
            for pool in [getattr(self.pools, name)]
        }
        fresh = np.arange(old + extra - 1, old - 1, -1, dtype=np.int32)
        stack = np.concatenate([fresh, free, np.zeros(old - len(free), np.int32)])
        self.pools.free_count[0] = len(free) + extra
        self.pools = self.pools._replace(free_slots=stack, **grown)

    def collapse(self) -> int:
        """Keep one number for each block without echoes that is free, or alike, throughout; returns how many."""
        return int(collapse_blocks(self.pools))

    def known(self) -> tuple[slice, ...] | None:
        """The smallest box of whole blocks, in cells, that holds all that is known; None: nothing is."""
        heard = (self.pools.slots != EMPTY) | (self.pools.common != 0)
        out = []
        for axis in range(3):
            along = np.flatnonzero(heard.any(axis=tuple(k for k in range(3) if k != axis)))
            if not len(along):
                return None
            edge = self.edge if self.grid.dims == 3 or axis else 1
            out.append(slice(int(along[0]) * edge, min(int(along[-1] + 1) * edge, int(self.pools.size[2 - axis]))))
        return tuple(out)

    @property
    def nbytes(self) -> int:
        """Memory held, room kept for more blocks included [byte]."""
        return sum(pool.nbytes for pool in self.pools)

    @property
    def used(self) -> tuple[int, int]:
        """Blocks kept cell by cell, and blocks kept as one number."""
        kept = self.pools.slots != EMPTY
        return int(kept.sum()), int(((self.pools.common != 0) & ~kept).sum())


def chances() -> NDArray[np.float64]:
    """Chance that a cell is occupied, by its hits and the number of directions from which it was silent."""
    odds = PRIOR + np.arange(MOST_HITS + 1)[:, None] / 10.0 - FREE_NATS
    return np.asarray(1 / (1 + np.exp(-odds)))


def _met(beam: Beam, walls: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which walls (p) some direction of a look can meet at all: near enough, and not beside its cone."""
    gap = walls[:, 4:7] - beam.eye
    distance, radius = np.sqrt(np.einsum("ni,ni->n", gap, gap)), walls[:, 7]
    level = abs(walls[:, 3] - walls[:, :3] @ beam.eye)
    met = (level < beam.far) & (distance < beam.far + radius + 1e-6)
    if len(beam.reach) > 1:  # on a plane directions are made level, and so may leave the cone
        half = np.arctan(np.sqrt(2.0) * beam.tangent) + 1e-6
        off = np.arccos(np.clip(gap @ beam.axes[:, 0] / np.maximum(distance, 1e-9), -1.0, 1.0))
        met &= (distance <= radius) | (off < half + np.arcsin(np.minimum(radius / np.maximum(distance, 1e-9), 1.0)))
    return np.asarray(met)
