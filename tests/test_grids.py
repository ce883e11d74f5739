"""Grids, images and maps: cells where they should be, states that do not overlap."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ullage as ul
from ullage.grids import MappedSurface


@given(st.floats(-50, 50), st.floats(0.1, 30), st.sampled_from([0.05, 0.1, 0.25, 0.5]))
def test_a_covering_grid_covers_and_every_centre_finds_its_cell(low: float, size: float, step: float) -> None:
    grid = ul.Grid.covering([[low, low, 0], [low + size, low + size / 2, 2]], step, dims=3)
    left, right, bottom, top = grid.extent_m
    assert left <= low + 1e-6
    assert right >= low + size - 1e-6
    assert top - bottom < size / 2 + 2 * step + 1e-6
    cell, inside = grid.index([[grid.x_m[-1], grid.y_m[0], grid.z_m[0]]])
    assert inside[0]
    assert cell[0].tolist() == [0, 0, grid.shape[2] - 1]


def test_a_plane_without_height_takes_one() -> None:
    grid = ul.Grid.covering([[0, 0, 0], [1, 1, 1]], 0.1)
    assert np.isnan(grid.z_m[0])
    assert grid.at_height(1.5).z_m[0] == 1.5


def test_the_states_of_a_map_do_not_overlap() -> None:
    grid = ul.Grid((0.0, 0.0, 0.0), 0.1, (1, 6))
    omap = ul.OccupancyMap(grid, np.array([[-2, -1, 0, 35, 65, 100]], np.int8))
    states = np.stack([omap.ambiguous, omap.unknown, omap.free, omap.occupied])
    assert states.sum(0).max() == 1
    assert omap.occupied.tolist() == [[False] * 4 + [True] * 2]


def test_the_peak_of_an_image_is_where_it_is() -> None:
    grid = ul.Grid((0.0, 0.0, 1.0), 0.5, (4, 6))
    values = np.zeros((4, 6), np.float32)
    values[2, 5] = 1
    assert np.allclose(ul.Image(grid, values).peak_m, [2.75, 1.25, 1.0])


@pytest.mark.parametrize("step", [0.0, -1.0, float("nan")])
def test_a_step_must_be_positive(step: float) -> None:
    with pytest.raises(ul.InputError, match="step_m"):
        ul.Grid.covering([[0, 0, 0], [1, 1, 1]], step)


@pytest.mark.parametrize("shape", [(16, 16), (37, 5), (1, 1), (8, 8, 8), (9, 17, 30)])
def test_blocks_lay_out_the_cells_they_were_made_of(shape):
    rng = np.random.default_rng(sum(shape))
    cells = np.repeat(rng.integers(-2, 101, (shape[0], 1)).astype(np.int8), int(np.prod(shape[1:])), axis=1)
    cells = cells.reshape(shape)
    cells[rng.random(shape) < 0.02] = 7
    omap = ul.OccupancyMap(ul.Grid((0, 0, 0), 0.1, shape), cells)
    np.testing.assert_array_equal(omap.percent, cells)
    assert omap.percent.dtype == np.int8


def test_a_map_of_one_value_takes_next_to_nothing_and_goes_through_pickle():
    import pickle

    grid = ul.Grid((0, 0, 0), 0.05, (1000, 1000))
    cells = np.full(grid.shape, -1, np.int8)
    cells[200:400, 300:310] = 90
    omap = ul.OccupancyMap(grid, cells, "ullage", 70, 20)
    assert omap.nbytes < 40_000
    twin = pickle.loads(pickle.dumps(omap))
    np.testing.assert_array_equal(twin.percent, cells)
    assert (twin.method, twin.occupied_from, twin.free_to) == ("ullage", 70, 20)


def test_a_map_does_not_change():
    omap = ul.OccupancyMap(ul.Grid((0, 0, 0), 0.1, (2, 2)), np.zeros((2, 2), np.int8))
    with pytest.raises(AttributeError, match="does not change: method"):
        omap.method = "else"
    with pytest.raises(ValueError, match="read-only"):
        omap.percent[0, 0] = 1


@pytest.mark.parametrize("shape", [(40, 50), (20, 30, 17)])
def test_patching_what_changed_gives_the_later_map(shape):
    grid, rng = ul.Grid((0, 0, 0), 0.1, shape), np.random.default_rng(4)
    before = np.full(shape, -1, np.int8)
    before[:17] = 3
    after = before.copy()
    after[tuple(rng.integers(0, 15, 3) for _ in shape)] = 88
    earlier, later = (ul.OccupancyMap(grid, cells) for cells in (before, after))
    changes = later.changes(earlier)
    patched = before.copy()
    for corner, values in changes:
        patched[tuple(slice(c, c + n) for c, n in zip(corner, values.shape, strict=True))] = values
    np.testing.assert_array_equal(patched, after)
    assert 0 < len(changes) < np.prod(later.tiles.place.shape)
    corner, values = changes.rectangle()
    box = tuple(slice(c, c + n) for c, n in zip(corner, values.shape, strict=True))
    assert box == changes.box
    outside = before != after
    outside[box] = False
    assert not outside.any()
    assert not later.changes(later)
    assert later.changes(later).rectangle() is None
    assert len(later.changes(None)) >= len(changes)
    with pytest.raises(ul.InputError, match="the earlier map has cells"):
        later.changes(ul.OccupancyMap(ul.Grid((0, 0, 0), 0.1, (3,) * len(shape)), np.zeros((3,) * len(shape), np.int8)))


def test_clearance_is_the_distance_to_what_is_not_surely_free() -> None:
    percent = np.zeros((21, 21), np.int8)
    percent[:, 10], percent[10, 5] = 80, 20
    omap = ul.OccupancyMap(ul.Grid((0.0, 0.0, 0.0), 0.1, percent.shape), percent)
    layer = omap.clearance()
    assert layer.distance_m[10, 7] == pytest.approx(0.25), "three cells from the wall, less half of its own"
    assert layer.distance_m[10, 10] == 0
    assert layer.distance_m[0, 3] == pytest.approx(0.05), "nothing is known off the grid"
    assert layer.sigma_m[10, 7] == pytest.approx(0.1 / np.sqrt(12))
    assert layer.sigma_m[0, 3] == 0
    sure = omap.clearance(chance=0.9)
    assert sure.distance_m[10, 6] == pytest.approx(0.05)
    assert (sure.distance_m <= layer.distance_m).all()
    for chance in (0.4, 1.01, np.nan):
        with pytest.raises(ul.errors.InputError, match="chance"):
            omap.clearance(chance=chance)


def test_clearance_is_as_uncertain_as_the_nearest_surface() -> None:
    percent = np.zeros((3, 21), np.int8)
    percent[:, [3, 17]] = 90
    walls = tuple(
        MappedSurface("plane", np.zeros(2), np.array([1.0, 0, 0, 1]), np.diag([sigma**2, 1e-6, 1e-6, 1e-6]), 40.0, 9,
                      True, np.array([[x, 0.15]]), np.array([[1.0, 0.0]]))
        for x, sigma in ((0.35, 0.03), (1.75, 0.4))
    )  # fmt: skip
    omap = ul.OccupancyMap(ul.Grid((0.0, 0.0, 0.0), 0.1, percent.shape), percent, surfaces=walls)
    sigma = omap.clearance().sigma_m[1]
    assert sigma[4] == pytest.approx(np.hypot(0.03, 0.1 / np.sqrt(12)))
    assert sigma[16] == pytest.approx(np.hypot(0.4, 0.1 / np.sqrt(12)))
