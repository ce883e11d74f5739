import numpy as np
import pytest

import ullage as ul
from ullage.grids import UNKNOWN
from ullage.processing.blocks import Blocks
from ullage.processing.mapper_ends import without_ends

FREE, WALL = 5, 90
GRID = ul.Grid.covering([[-4.0, -3.0, 0.0], [4.0, 4.0, 0.0]], 0.1, z_m=0.0)


def looked_from(places):
    """Cells that rays all round from each of these places were silent in."""
    blocks, turn = Blocks(GRID), np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    for place in places:
        eye = np.array([*place, 0.0])
        blocks.insert_rays(eye, eye + 20 * np.column_stack([np.cos(turn), np.sin(turn), 0 * turn]))
    return blocks


def map_of(start, end):
    """Free throughout, but for a wall two cells thick between two places."""
    percent = np.full(GRID.shape, FREE, np.int8)
    start, end = np.array(start), np.array(end)
    across = np.array([start[1] - end[1], end[0] - start[0]]) / np.linalg.norm(end - start)
    for beside in (0.0, 0.09):
        at = start + beside * across + np.linspace(0, 1, 400)[:, None] * (end - start)
        percent[tuple(GRID.index(np.column_stack([at, np.zeros(400)]))[0].T)] = WALL
    return percent


def lost(percent, blocks):
    """Where (n, 2) free cells became unknown [m]."""
    out = percent.copy()
    without_ends(out, (0, 0), blocks, 65)
    np.testing.assert_array_equal(out[percent == WALL], WALL)
    cells = np.argwhere(out != percent)
    assert np.all(out[tuple(cells.T)] == UNKNOWN)
    return np.array(GRID.origin_m[:2]) + (cells[:, ::-1] + 0.5) * GRID.step_m


@pytest.mark.parametrize("turn_deg", [0, 12, 22.5, 30])
def test_a_wall_may_go_on_where_nobody_has_passed(turn_deg):
    # The sensor went from -2.5 to -0.5 along a wall known from -2.5 to -0.5: what is past that end, it saw only aslant.
    along = np.array([np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))])
    across = np.array([-along[1], along[0]])
    way = [s * along + 1.2 * across for s in np.linspace(-2.5, -0.5, 15)]
    where = lost(map_of(-2.5 * along, -0.5 * along), looked_from(way))
    s, aside = where @ along, where @ across
    assert np.all(abs(aside) < 0.4), "nothing is lost off the wall's own line"
    on = np.sort(s[s > -0.4])
    assert on[0] < 0.0
    assert np.all(np.diff(on) < 0.15)
    assert 1.0 < on[-1] < 1.8
    assert np.all((s > -0.7) | (s < -2.3)), "and nothing beside the wall itself"


def test_a_door_that_a_sensor_passed_stays_free():
    way = [(s, 1.2) for s in np.linspace(-2.5, 2.5, 30)]
    percent = map_of((-2.5, 0.0), (-0.5, 0.0))
    percent = np.maximum(percent, map_of((0.5, 0.0), (2.5, 0.0)))
    where = lost(percent, looked_from(way))
    assert not len(where) or abs(where[:, 0]).min() > 2.4, "but for what is past the ends of the way"


def test_a_wall_is_held_to_go_on_no_farther_than_it_is_known():
    way = [(s, 1.2) for s in np.linspace(-3.5, -3.0, 8)]
    where = lost(map_of((-3.5, 0.0), (-2.9, 0.0)), looked_from(way))
    assert -2.5 < where[:, 0].max() < -2.0


def test_a_post_goes_on_nowhere():
    blocks = looked_from([(-2.0, 1.2), (-1.8, 1.2)])
    assert not len(lost(map_of((0.0, 0.0), (0.09, 0.0)), blocks))
    empty = np.full(GRID.shape, FREE, np.int8)
    assert not len(lost(empty, blocks))


def arc_of(*pieces_deg):
    """Free throughout, but for pieces of a round wall of 2.5 m about the origin, two cells thick."""
    percent = np.full(GRID.shape, FREE, np.int8)
    for low, high in pieces_deg:
        turn = np.radians(np.linspace(low, high, 400))
        for radius in (2.45, 2.55):
            at = radius * np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
            percent[tuple(GRID.index(at)[0].T)] = WALL
    return percent


def test_a_round_wall_goes_on_from_one_piece_to_the_next():
    # It was passed within, and silent from 4 of 16 directions: none of them need be the normal.
    turn = np.radians(np.linspace(0, 90, 30))
    where = lost(arc_of((-30, 30), (55, 115)), looked_from(np.column_stack([np.cos(turn), np.sin(turn)])))
    angle, away = np.degrees(np.arctan2(where[:, 1], where[:, 0])), np.linalg.norm(where, axis=1)
    gap = (angle > 33) & (angle < 52)
    assert set(np.round(angle[gap & (abs(away - 2.5) < 0.08)] / 3)) >= set(range(12, 17))
    assert np.all(abs(away[gap] - 2.5) < 0.5)


def test_a_gap_of_a_round_wall_that_was_flown_through_stays_free():
    blocks = looked_from([(np.cos(t), np.sin(t)) for t in np.radians(np.linspace(0, 90, 30))])
    out = np.array([np.cos(np.radians(42)), np.sin(np.radians(42)), 0.0])
    for s in np.arange(1.0, 3.5, 0.1):
        blocks.clear(s * out, 0.4)
    where = lost(arc_of((-30, 30), (55, 115)), blocks)
    assert np.all(np.linalg.norm(np.cross(np.column_stack([where, 0 * where[:, 0]]), out), axis=1) > 0.35)
