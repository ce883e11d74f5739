"""How a map is drawn: unknown clear, walls two cells wide, ambiguous cells pale and striped."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from matplotlib.image import imread

import ullage as ul
from ullage.view import figures
from ullage.view.map_picture import PIXELS, map_picture


def drawn(percent: object) -> np.ndarray:
    cells = np.array(percent, np.int8)
    return map_picture(ul.OccupancyMap(ul.Grid((0, 0, 0), 0.5, cells.shape), cells), free_alpha=140)


def cell(picture: np.ndarray, row: int, column: int) -> np.ndarray:
    """Pixels (PIXELS, PIXELS, 4) of one cell."""
    return picture[PIXELS * row : PIXELS * (row + 1), PIXELS * column : PIXELS * (column + 1)]


def test_each_kind_of_cell_is_drawn_as_its_own() -> None:
    free, unknown, ambiguous = (cell(drawn([[0, 0, -1, -1, -2, -2]]), 0, k) for k in (1, 2, 4))
    assert (free == [255, 255, 255, 140]).all()
    assert (unknown[..., 3] == 0).all()
    assert len(np.unique(ambiguous[..., 3])) == 2  # stripes on a pale ground
    assert 0 < ambiguous[..., 3].min() < 100 < ambiguous[..., 3].max() < 255


def test_a_wall_of_one_cell_is_drawn_two_cells_wide_about_its_middle() -> None:
    percent = np.zeros((5, 7), np.int8)
    percent[:, 3] = 100
    dark = drawn(percent)[..., 0] < 20
    assert (dark.sum(axis=1) == 2 * PIXELS).all()
    columns = np.flatnonzero(dark[0])
    assert columns.mean() == (3.5 * PIXELS) - 0.5
    assert (drawn(percent)[dark][:, 3] == 255).all()


def test_a_thick_wall_stays_as_wide_as_it_is() -> None:
    percent = np.zeros((5, 9), np.int8)
    percent[:, 3:6] = 100
    assert ((drawn(percent)[..., 0] < 20).sum(axis=1) == 3 * PIXELS).all()


def test_neither_unknown_nor_ambiguous_cells_hide_a_wall() -> None:
    for other in (-1, -2):
        percent = np.full((3, 5), other, np.int8)
        percent[1, :] = 90
        assert ((drawn(percent)[..., 3] > 220).sum(axis=0) == 2 * PIXELS).all()


def test_a_volume_is_drawn_by_its_highest_chance_or_by_one_level() -> None:
    percent = np.full((2, 2, 2), -1, np.int8)
    percent[0], percent[1, 0, 0] = 0, 100
    omap = ul.OccupancyMap(ul.Grid((0, 0, 0), 0.5, percent.shape), percent)
    assert map_picture(omap)[0, 0].tolist() == [0, 0, 0, 255]
    assert map_picture(omap, level=0)[0, 0].tolist() == [255, 255, 255, 255]


def test_a_figure_draws_a_map_by_the_same_picture(tmp_path: Path) -> None:
    percent = np.full((40, 40), -1, np.int8)
    percent[10:30, 10:30], percent[20, 10:30] = 0, 100
    omap = ul.OccupancyMap(ul.Grid((0, 0, 0), 0.1, percent.shape), percent)
    pixels = imread(figures.map_figure(tmp_path / "map.png", omap, title="a wall"))[..., :3]
    middle = pixels[:, pixels.shape[1] // 3]
    dark = np.flatnonzero((middle < 0.2).all(axis=1))
    white = np.flatnonzero((middle > 0.99).all(axis=1) & (np.arange(len(middle)) > dark[0] - 60))
    assert len(dark) >= 2 * 0.8 * (pixels.shape[0] * 0.6 / 30)
    assert len(white) > len(dark)


def test_a_figure_is_as_wide_as_the_part_of_the_map_that_it_draws(tmp_path: Path) -> None:
    percent = np.full((120, 200), -1, np.int8)
    percent[10:110, 90:120] = 0
    omap = ul.OccupancyMap(ul.Grid((0, 0, 0), 0.1, percent.shape), percent)
    ink = imread(figures.map_figure(tmp_path / "map.png", omap, title="tall"))[..., :3].min(axis=(0, 2)) < 0.9
    first, last = np.flatnonzero(ink)[[0, -1]]
    assert first < 0.1 * len(ink)
    assert last > 0.9 * len(ink)


def test_a_map_without_walls_and_a_single_frame_are_drawn_without_a_warning(tmp_path: Path) -> None:
    grid = ul.Grid((-1.0, -1.0, 0.0), 0.1, (20, 20))
    omap = ul.OccupancyMap(grid, np.full(grid.shape, -1, np.int8))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        drawn = [
            figures.map_figure(tmp_path / "map.png", omap, title="nothing"),
            figures.image_figure(
                tmp_path / "image.png", ul.Image(grid, np.ones(grid.shape, np.complex64)), title="flat"
            ),
            figures.range_time_figure(
                tmp_path / "one.png",
                [("front", np.array([1.7e9]), np.arange(3.0), np.ones((1, 3)))],
                unit="path_gain",
                title="one frame by the wall clock",
            ),
        ]
    assert all(np.ptp(imread(path)) > 0.5 for path in drawn)
