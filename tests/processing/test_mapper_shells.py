"""Round walls are told by ranges alone, from parallel legs and level rounds, and rooms hold none."""

from __future__ import annotations

import numpy as np
import pytest

from ullage.kernels.rolls import AHEAD, COLUMNS, COSINE, LEG, NORMAL, PLACE, RANGE, TRACK, WIDE
from ullage.processing.mapper_shells import shell_of

RADIUS_M = 2.0
LANES = ((-0.8, -0.6), (0.8, -0.5), (0.7, 0.5), (-0.8, 0.6), (-0.2, 0.1))
EAST, UP = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
SIDES = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])


def stretch(place, track, ahead, leg: int, heard) -> np.ndarray:
    """One stretch (22) of a leg whose sensor heard a range, which fell by so much for each metre."""
    row = np.zeros(COLUMNS)
    row[PLACE : PLACE + 3], row[TRACK : TRACK + 3], row[AHEAD : AHEAD + 3] = place, track, ahead
    row[RANGE], row[COSINE], row[LEG], row[WIDE] = *heard, leg, 0.64
    return row


def lanes_in(wall, lanes=LANES, *, scatter_m: float = 0.003) -> np.ndarray:
    """Stretches (m, 22) of parallel lanes, each heard to both sides, by the ranges and falls that `wall` gives."""
    rng, rows = np.random.default_rng(5), []
    for leg, (y, z) in enumerate(lanes):
        for x in (-0.8, 0.0, 0.8):
            for ahead in SIDES:
                for reach, cosine in wall(np.array([x, y, z]), EAST, ahead):
                    rows.append(stretch((x, y, z), EAST, ahead, leg, (reach + rng.normal(0, scatter_m), cosine)))
    return np.array(rows)


def pipe(centre, axis):
    """Ranges of a round wall of 2 m about a line through a place, as a sensor inside hears them."""
    axis = np.asarray(axis, float) / np.linalg.norm(axis)

    def heard(at, track, ahead):
        gap = at - centre
        gap = gap - (gap @ axis) * axis
        off = float(np.linalg.norm(gap))
        for side in (1.0, -1.0):
            if side * gap @ ahead > 0.64 * off:
                yield RADIUS_M - side * off, float(side * gap @ track) / off

    return heard


def room(half_y: float, half_z: float):
    """Ranges of the walls abeam, the floor and ceiling at the beam's rim, and corners of a room."""

    def heard(at, track, ahead):
        side = half_y - ahead[1] * at[1]
        yield side, 0.0
        for rise in (half_z - at[2], half_z + at[2]):
            yield float(np.hypot(side, rise)), 0.0
            yield rise, 0.0

    return heard


@pytest.mark.parametrize("lean", [(0.0, 0.0), (0.03, -0.02)])
@pytest.mark.parametrize("centre", [(0.0, 0.0), (0.2, -0.3)])
def test_parallel_lanes_tell_a_lying_tank_by_ranges_alone(centre, lean):
    axis = np.array([1.0, *lean])
    rows = lanes_in(pipe(np.array([0.0, *centre]), axis))
    for me in rows[::7]:
        hollow, ways = shell_of(me, rows, EAST)
        assert hollow.radius_m == pytest.approx(RADIUS_M, abs=0.01)
        there = hollow.centre - (hollow.centre[0] / hollow.axis[0]) * hollow.axis
        assert there[1:] == pytest.approx(centre, abs=0.02)
        assert abs(hollow.axis @ axis) / np.linalg.norm(axis) > np.cos(0.015)
        feet = rows[:, PLACE : PLACE + 3] + rows[:, [RANGE]] * ways
        off = feet - hollow.centre
        off -= (off @ hollow.axis)[:, None] * hollow.axis
        assert np.linalg.norm(off, axis=1) == pytest.approx(RADIUS_M, abs=0.02)


def test_a_level_round_tells_an_upright_tank():
    rows, turn = [], np.arange(0, 2 * np.pi, np.pi / 12)
    wall = pipe(np.array([0.1, -0.2, 0.0]), UP)
    for k, phi in enumerate(turn):
        at, track = np.array([np.cos(phi), np.sin(phi), 0.01 * k]), np.array([-np.sin(phi), np.cos(phi), 0.0])
        for ahead in (at * [1, 1, 0], -at * [1, 1, 0]):
            rows += [stretch(at, track, ahead, k // 6, one) for one in [*wall(at, track, ahead), (1.8, 0.0)]]
    rows = np.array(rows)
    hollow, ways = shell_of(rows[0], rows, UP)
    assert hollow.radius_m == pytest.approx(RADIUS_M, abs=0.01)
    assert hollow.centre[:2] == pytest.approx((0.1, -0.2), abs=0.02)
    assert (ways.any(axis=1) == (abs(rows[:, RANGE] - 1.8) > 1e-9)).all(), "floor and ceiling are of no wall"


@pytest.mark.parametrize("half", [(1.5, 1.5), (2.0, 1.2), (1.2, 2.0), (3.0, 1.6)])
def test_a_room_holds_no_round_wall(half):
    rng = np.random.default_rng(9)
    for _ in range(6):
        lanes = rng.uniform(-0.9, 0.9, (int(rng.integers(4, 8)), 2))
        rows = lanes_in(room(*half), lanes)
        assert all(shell_of(me, rows, axis) is None for me in rows[::5] for axis in (EAST, UP))


def test_what_is_heard_without_order_is_no_round_wall():
    rng = np.random.default_rng(3)
    for many in (2, 6):
        rows = lanes_in(lambda *_, many=many: [(r, 0.0) for r in rng.uniform(0.6, 3.4, many)])
        assert all(shell_of(me, rows, EAST) is None for me in rows)


def test_lanes_on_one_line_and_few_lanes_leave_it_open():
    wall = pipe(np.zeros(3), EAST)
    assert all(shell_of(me, rows, EAST) is None for rows in [lanes_in(wall, LANES[:3])] for me in rows)
    for last in (0.5, 0.65):  # beyond the axis the same ranges would come from its mirror image, but for one lane
        line = [(-0.9, 0.5), (-0.5, 0.5), (-0.1, 0.5), (0.4, 0.5), (0.8, last)]
        assert all(shell_of(me, rows, EAST) is None for rows in [lanes_in(wall, line)] for me in rows)


def test_walls_told_to_be_elsewhere_speak_against_it():
    rows = lanes_in(pipe(np.zeros(3), EAST))
    assert shell_of(rows[0], rows, EAST) is not None
    rows[:, NORMAL : NORMAL + 3] = UP
    assert shell_of(rows[0], rows, EAST) is None
