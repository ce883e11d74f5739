"""Silence aslant frees nothing behind walls that were told since, nor beyond all that is told."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

import ullage as ul
from ullage.grids import UNKNOWN
from ullage.kernels.rolls import COLUMNS, LEG, NORMAL, PLACE, RANGE, TRACK
from ullage.processing.mapper_barrels import barrel_of
from ullage.processing.mapper_beyond import Zones, without_behind, without_beyond
from ullage.processing.mapper_bows import Hollow
from ullage.processing.mapper_hollows import Hollows

LANES = np.array([(-0.8, -0.6), (0.0, -0.9), (0.8, -0.5), (0.7, 0.5), (0.0, 0.8), (-0.8, 0.6)])
GRID = ul.Grid((-3.0, -3.0, -3.0), 0.1, (60, 60, 60))


def told(places: np.ndarray, normals: np.ndarray, ranges: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Stretches flown along x, each place a leg, their normals off by some degrees."""
    rows = np.zeros((len(places), COLUMNS))
    rows[:, PLACE : PLACE + 3], rows[:, TRACK], rows[:, LEG] = places, 1.0, np.arange(len(places))
    off = normals + rng.normal(0, 0.04, normals.shape)
    rows[:, NORMAL : NORMAL + 3] = off / np.linalg.norm(off, axis=1)[:, None]
    rows[:, RANGE] = ranges + rng.normal(0, 0.005, len(ranges))
    return rows


def along(lanes: np.ndarray) -> np.ndarray:
    return np.concatenate([np.column_stack([np.full(len(lanes), x), lanes]) for x in (-0.6, 0.0, 0.6)])


@pytest.mark.parametrize("seed", range(4))
def test_pieces_of_a_lying_tank_touch_one_cylinder(seed):
    places = along(LANES)
    away = np.linalg.norm(places[:, 1:], axis=1)
    near = np.column_stack([np.zeros(len(places)), places[:, 1:] / away[:, None]])
    far = np.random.default_rng(seed).random(len(places)) < 0.4
    rows = told(
        places, np.where(far[:, None], -near, near), 2.0 - np.where(far, -away, away), np.random.default_rng(seed)
    )
    hollow, on = barrel_of(rows[0], rows)
    assert hollow.radius_m == pytest.approx(2.0, abs=0.06)
    assert np.hypot(*hollow.centre[1:]) < 0.08
    assert abs(hollow.axis[0]) > 0.995
    assert on.mean() > 0.9


@pytest.mark.parametrize("seed", range(4))
def test_walls_floor_and_roof_of_a_hall_touch_none(seed):
    rng = np.random.default_rng(seed)
    places = np.repeat(along(LANES), 4, axis=0)
    normals = np.tile([(0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], (len(places) // 4, 1)).astype(float)
    ranges = 2.0 - np.sum(places * normals, axis=1)
    rows = told(places, normals, ranges, rng)
    assert all(barrel_of(row, rows) is None for row in rows[:8])


def test_nothing_is_free_behind_a_hollow_wall_that_is_told():
    percent = np.zeros(GRID.shape, np.int8)
    wall = Hollow(np.zeros(3), np.array([1.0, 0.0, 0.0]), 2.0)
    without_behind(percent, (0, 0, 0), GRID, [(wall, np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 2.0]))])
    assert percent[29, 30, 30] == 0, "within it"
    assert percent[49, 30, 30] == percent[55, 30, 30] == UNKNOWN, "at its crown and over it"
    assert percent[5, 30, 30] == 0, "on the other side"
    assert percent[55, 30, 50] == 0, "farther along it than it was heard"


def test_a_long_wall_is_remembered_all_along():
    hollows, wall = Hollows(), Hollow(np.zeros(3), np.array([1.0, 0.0, 0.0]), 2.0, 6)
    for x in np.arange(0.0, 150.0, 1.5):
        hollows.go_on(wall, np.array([0.0, 0.0, 1.0]), np.array([x, 0.0, 0.5]))
    assert len(hollows.told) < len(hollows.pieces) == 100
    better = Hollow(np.zeros(3), np.array([1.0, 0.0, 0.0]), 2.05, 9)
    hollows.go_on(better, np.array([0.0, 0.0, 1.0]), np.array([148.5, 0.0, 0.5]))
    assert len(hollows.pieces) == 100, "in the place of what more pieces tell better"
    assert hollows.pieces[-1][0] is better


def test_a_surface_is_told_where_it_was_heard_if_the_map_holds_it():
    percent, zones = np.full(GRID.shape, UNKNOWN), Zones()
    percent[30, 50, 30] = 80
    zones.add(np.array([0.05, 2.05, 0.05]), np.array([0.0, 1.0, 0.0]), 0.3, GRID)
    zones.add(np.array([0.05, -2.05, 0.05]), np.array([0.0, -1.0, 0.0]), 0.3, GRID)
    rims = zones.rims(percent, (0, 0, 0), GRID)
    assert np.linalg.norm(rims - [0.05, 2.05, 0.05], axis=1) == pytest.approx(0.3)
    assert rims[:, 1] == pytest.approx(2.05)
    part = zones.rims(percent[20:, 40:, 10:], (20, 40, 10), GRID)
    assert part == pytest.approx(rims), "though less of the map is known"


def test_what_is_free_lies_in_the_hull_of_what_is_told():
    percent = np.zeros(GRID.shape, np.int8)
    percent[:, 10, 20:40] = 80
    told = np.array([(x, y, z) for x, z in product((-1.0, 1.0), (-0.5, 0.5)) for y in (-2.0, 2.0)])
    flown = np.array([[0.0, 0.0, 0.0]])
    without_beyond(percent, (0, 0, 0), GRID, told, flown, 0.25)
    assert percent[30, 20, 30] == 0, "between the flight and a wall"
    assert percent[30, 45, 30] == 0, "before the other"
    assert percent[31, 31, 31] == 0, "where it was"
    assert percent[30, 54, 30] == UNKNOWN, "behind that"
    assert percent[30, 8, 30] == UNKNOWN, "behind the first, which is drawn farther up and down than it was heard"
    assert percent[38, 11, 30] == UNKNOWN, "before the first, but beside where it was heard"
    assert percent[30, 35, 50] == UNKNOWN, "aside of all"


@pytest.mark.slow
def test_a_lying_tank_flown_along_is_not_open():
    scene = ul.scenes.cylinder(2.0, 7.0, 0.0, 90.0, material="steel", edge_m=0.1)
    lanes = [(e, *lane) for k, lane in enumerate(LANES) for e in ((-2.4, 2.4) if k % 2 == 0 else (2.4, -2.4))]
    path = ul.fly(ul.Waypoints(np.array(lanes)[:, [1, 0, 2]], speed_m_s=0.5, stop=True), rate_hz=12.5)
    with pytest.warns(ul.UllageWarning, match="is inside"):
        frames = ul.simulate(scene, path, ul.Rig.preset("thesis-4"), seed=0, max_bounces=1)
    grid = ul.Grid.covering(scene.bounds, 0.1, dims=3, margin_m=0.5)
    percent = ul.map_occupancy(frames, grid, method="rules").percent
    z, y, x = np.indices(percent.shape) * 0.1 + 0.05 + np.asarray(grid.origin_m)[::-1, None, None, None]
    free, away = (percent >= 0) & (percent < 50), np.hypot(x, z)
    assert (free & (away > 2.1)).sum() < 0.01 * free.sum(), "4 % were"
    assert free[(away < 0.8) & (abs(y) < 1.5)].mean() > 0.9
