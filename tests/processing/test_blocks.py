import numpy as np
import pytest

import ullage as ul
from ullage.kernels.occupancy import EMPTY, cell_index
from ullage.kernels.occupancy_reach import Beam
from ullage.processing.blocks import Blocks


def state(blocks):
    """Hits and silence of every cell, [z, y, x]."""
    pools, edge = blocks.pools, blocks.edge
    nx, ny, nz = pools.size
    hits, silent = np.zeros((nz, ny, nx), int), np.zeros((nz, ny, nx), int)
    for iz, iy, ix in np.ndindex(nz, ny, nx):
        block = (iz // edge if nz > 1 else 0, iy // edge, ix // edge)
        slot = pools.slots[block]
        silent[iz, iy, ix] = pools.common[block]
        if slot != EMPTY:
            cell = cell_index.py_func(ix, iy, iz, edge, nz)
            hits[iz, iy, ix] = pools.hits[slot, cell]
            silent[iz, iy, ix] |= pools.silent[slot, cell]
    return hits, silent


@pytest.mark.parametrize("dims", [2, 3])
def test_rays_pass_the_cells_that_fine_steps_along_them_pass(dims):
    grid = ul.Grid.covering([[-1.3, -1.1, -0.9], [1.4, 1.2, 0.8]], 0.1, z_m=0.0, dims=dims)
    rng = np.random.default_rng(3)
    eye, ends = np.array([0.03, -0.02, 0.01]), rng.uniform(-0.8, 0.8, (40, 3))
    if dims == 2:
        ends[:, 2] = eye[2]
    blocks = Blocks(grid)
    blocks.insert_rays(eye, ends)
    hits, silent = (a.reshape(grid.shape) for a in state(blocks))
    last, _ = grid.index(ends)
    np.testing.assert_array_equal(np.argwhere(hits > 0), np.unique(last, axis=0))
    walked = np.zeros(grid.shape, bool)
    for end in ends:
        points = eye + np.linspace(0, 1, 4000)[:, None] * (end - eye)
        cells, _ = grid.index(points)
        stop, _ = grid.index(end)
        walked[tuple(cells[(cells != stop).any(axis=1)].T)] = True
    assert (walked & (silent == 0)).sum() == 0
    assert ((silent != 0) & ~walked).sum() <= 3, "corners cut finer than the steps"


def test_a_ray_out_of_the_grid_stops_at_its_border():
    blocks = Blocks(ul.Grid((0, 0, 0), 0.1, (16, 16, 16)))
    blocks.insert_rays(np.array([0.85, 0.85, 0.85]), np.array([[5.0, 0.85, 0.85]]))
    hits, silent = state(blocks)
    assert hits.max() == 0
    assert np.argwhere(silent).tolist() == [[8, 8, k] for k in range(8, 16)]


def test_memory_never_outgrows_the_grid():
    blocks = Blocks(ul.Grid((0, 0, 0), 0.1, (40, 40, 40)))
    for _ in range(10):
        blocks.reserve(10_000)
    assert len(blocks.pools.hits) == blocks.pools.slots.size == 125


def test_only_what_is_held_occupied_bars_the_way():
    blocks = Blocks(ul.Grid.covering([[-1, -1, -1], [3, 1, 1]], 0.1, z_m=0.0))
    eye, ahead = np.array([0.05, 0.05, 0.0]), np.array([1.0, 0.0, 0.0])
    assert blocks.clear_to(eye, ahead, 2.0)
    blocks.lay(np.array([1.05, 0.05, 0.0]), ahead, (0.05, 0.04, 5.0))
    assert not blocks.clear_to(eye, ahead, 2.0)
    assert blocks.clear_to(eye, ahead, 1.0), "what stands there does not hide itself"
    aside = np.array([np.cos(0.5), np.sin(0.5), 0.0])
    assert blocks.clear_to(eye, aside, 2.0)
    assert blocks.clear_to(eye, -ahead, 5.0), "beyond the grid nothing is held"


def test_silence_ends_before_a_floor_wherever_in_a_sector_of_the_beam_that_meets_it():
    """A level beam grazes a floor: the near side of each of its sectors, not the middle, tells where that is met."""
    blocks = Blocks(ul.Grid.covering([[-0.5, -2.5, -1.5], [5.0, 2.5, 0.5]], 0.1, dims=3))
    lobe, (reach, hush) = (np.cos(np.radians(50)), np.sin(np.radians(50))), np.zeros((2, 28, 28))
    tangent = 1.09 * lobe[1] / lobe[0]
    beam = Beam(
        np.zeros(3),
        np.eye(3),
        reach,
        hush,
        tangent,
        lobe,
        lobe,
        0.25,
        5.0,
        0.0,
        0.05,
        np.arange(101),
        np.zeros((0, 10)),
    )
    next(blocks.insert_in_steps(beam, np.zeros((0, 5)), np.array([[0, 0, -1, 0.8, 0, 0, -0.8, 12.0]]), sure=1))
    below = tangent * (1 - 2 * np.arange(14) / 28)  # slope of the lower side of each sector that looks down
    middle = np.sqrt(1 + (tangent * (1 - 2 * (np.arange(14) + 0.5) / 28)) ** 2 + (tangent / 28) ** 2)
    fore = hush[:14, 14] / middle
    assert fore.max() > 1.0
    assert (fore * below).max() < 0.8 + 1e-6
