"""Grids, images and maps: cells where they should be, states that do not overlap."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ullage as ul


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
