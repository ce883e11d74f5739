"""Cells of a map in sparse blocks: nothing is kept for unknown ones, one number for one that is free throughout."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ullage.errors import InputError
from ullage.grids import EDGE, Grid
from ullage.kernels.occupancy import CLEAR, EMPTY, NOWHERE, collapse_clear

MOST_BYTES = 2 * 1024**3
GROWTH = 64


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
        bytes_needed = 4.0 * float(np.prod(np.asarray(table, float)))
        if bytes_needed > MOST_BYTES or grid.size > 2**40:
            raise InputError(
                f"the grid has {grid.size:.3g} cells; its table of blocks alone takes {bytes_needed / 1e9:.1f} GB",
                where="grid",
                allowed=f"at most {MOST_BYTES / 1e9:.1f} GB; a coarser step or a smaller box",
            )
        self.size = np.array(shape[::-1], np.int64)
        self.origin = np.nan_to_num(np.asarray(grid.origin_m, float))
        self.slots = np.full(table, EMPTY, np.int32)
        self.cells = self.edge**grid.dims
        self.hits = np.zeros((0, self.cells), np.int8)
        self.silent = np.zeros((0, self.cells), np.uint16)
        self.facing = np.zeros((0, self.cells), np.uint8)
        self.free_slots = np.zeros(0, np.int32)
        self.free_count = np.zeros(1, np.int64)

    def reserve(self, count: int) -> None:
        """Have room for this many more blocks."""
        lacking = min(count, self.slots.size) - int(self.free_count[0])
        if lacking <= 0:
            return
        old = len(self.hits)
        extra = max(lacking, GROWTH, old // 4)
        for name, fill in (("hits", 0), ("silent", 0), ("facing", NOWHERE)):
            pool: NDArray[np.generic] = getattr(self, name)
            setattr(self, name, np.concatenate([pool, np.full((extra, self.cells), fill, pool.dtype)]))
        held = self.free_slots[: int(self.free_count[0])]
        fresh = np.arange(old + extra - 1, old - 1, -1, dtype=np.int32)
        self.free_slots = np.concatenate([fresh, held, np.zeros(old, np.int32)])[: old + extra].copy()
        self.free_count[0] = len(held) + extra

    def collapse(self, enough: int) -> int:
        """Keep one value for each block that is free throughout; returns how many were collapsed."""
        return int(collapse_clear(self.slots, self.free_slots, self.free_count, self.hits, self.silent, enough))

    @property
    def nbytes(self) -> int:
        """Memory held, room kept for more blocks included [byte]."""
        pools = (self.slots, self.hits, self.silent, self.facing, self.free_slots)
        return sum(pool.nbytes for pool in pools)

    @property
    def used(self) -> tuple[int, int]:
        """Blocks kept cell by cell, and blocks kept as one value."""
        return int((self.slots >= 0).sum()), int((self.slots == CLEAR).sum())
