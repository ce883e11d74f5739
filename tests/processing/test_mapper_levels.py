"""What is floor or ceiling by its constancy, and what is a wall beside the way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ullage.processing.mapper_levels import RETURNING, LevelFinder
from ullage.processing.mapper_looks import Heard, Look

FLOOR_M, WALL_M, HEIGHT_M = 1.1, 3.0, 1.1


def look(number: int, *, heading_rad: float, abeam: bool, wall: float) -> Look:
    """A look that hears floor (1.4e-4 at 1 m) and, at as constant a range, something as loud as `wall` at 1 m."""
    track = np.array([np.cos(heading_rad), np.sin(heading_rad), 0.0])
    side = np.array([-track[1], track[0], 0.0])
    ahead, left = (side, -track) if abeam else (track, side)
    axes = np.column_stack([ahead, left, [0, 0, 1]])
    position = 0.05 * number * track + [0, 0, HEIGHT_M]
    heard = Heard(number, position, axes, 2, np.zeros(16), np.zeros(16), np.zeros(8, bool), None)
    echoes = np.array(
        [[FLOOR_M, 0.003, 0, 0.01, 1, 1.4e-4 / FLOOR_M], [WALL_M, 0.003, 0, 0.01, 1, wall / WALL_M]], float
    )
    return Look(heard, track, echoes, np.zeros((2, 5)))


def left_of(looks: list[Look]) -> list[float]:
    """Ranges left of the last look, once the levels are known from all."""
    finder = LevelFinder()
    for each in looks:
        finder.hear(each)
    assert finder.ready
    return finder.without_levels(looks[-1]).echoes[:, 0].tolist()


def test_wall_abeam_of_one_straight_flight_is_no_floor():
    assert left_of([look(k, heading_rad=0.3, abeam=True, wall=2.5e-3) for k in range(80)]) == [WALL_M]


def test_there_and_back_is_still_one_heading():
    there = [look(k, heading_rad=0.3, abeam=True, wall=2.5e-3) for k in range(40)]
    back = [look(k, heading_rad=0.3 + np.pi, abeam=True, wall=2.5e-3) for k in range(40)]
    assert left_of([*there, *back]) == [WALL_M]


def test_what_keeps_its_range_on_all_headings_is_a_level_however_loud():
    assert left_of([look(k, heading_rad=0.05 * k, abeam=True, wall=2.5e-3) for k in range(80)]) == []


def test_what_sensors_ahead_hear_square_to_the_way_is_a_level():
    assert left_of([look(k, heading_rad=0.3, abeam=k % 2 == 0, wall=1.4e-4) for k in range(80)]) == []


def test_what_is_louder_than_a_mirror_at_the_rim_is_a_wall_on_all_headings_too():
    """One radar that looks left along the walls of a room, a quarter turn at each corner."""
    finder = LevelFinder()
    finder.rim_m = 8e-4
    looks = [look(k, heading_rad=np.pi / 2 * (k // 40), abeam=True, wall=2.5e-3) for k in range(160)]
    for each in looks:
        finder.hear(each)
    assert finder.without_levels(looks[-1]).echoes[:, 0].tolist() == [WALL_M]


def test_a_ceiling_that_is_neared_later_stays_one():
    finder = LevelFinder()
    finder.rim_m = 3e-4  # a mirror there; the ceiling is half as good, and eight times as near as at first
    ceiling_m = 2.4
    for k in range(800):
        rise = 0.0 if k < 200 else 2.1  # the first round low, the others high
        one = look(k, heading_rad=0.05 * k, abeam=True, wall=0.0)
        away = ceiling_m - rise
        echoes = np.array([[away, 0.003, 0, 0.01, 1, 1.5e-4 / away]])
        heard = replace(one.heard, position=one.heard.position + np.array([0, 0, rise]))
        finder.hear(Look(heard, one.track, echoes, np.zeros((1, 5))))
    found = [height for sign, height in finder.levels() if sign > 0]
    assert found == [pytest.approx(HEIGHT_M + ceiling_m, abs=0.05)]


def crowded(number: int, *, share: float, loud: float) -> Look:
    """A look on a turn: of every ten, `share` hear the floor clearly; in the others its bearing is a wall's."""
    one = look(number, heading_rad=0.1 * number, abeam=True, wall=2.5e-3)
    one.echoes[0, 5] *= loud
    one.echoes[1, 2] = 0.9
    if number % 10 >= 10 * share:
        one.echoes[0, 2] = 0.6
    return one


def heard_clearly(looks: list[Look]) -> Look:
    return next(one for one in reversed(looks) if one.echoes[0, 2] == 0)


def test_a_level_that_a_third_of_all_headings_hear_alike_is_one():
    looks = [crowded(k, share=0.4, loud=1.0) for k in range(200)]
    finder = LevelFinder()
    for each in looks:
        finder.hear(each)
    assert finder.without_levels(heard_clearly(looks)).echoes[:, 0].tolist() == [WALL_M]


def test_what_turning_sensors_hear_louder_and_weaker_is_a_wall():
    looks = [crowded(k, share=0.4, loud=10.0 if k % 2 else 1.0) for k in range(200)]
    finder = LevelFinder()
    for each in looks:
        finder.hear(each)
    assert finder.without_levels(heard_clearly(looks)).echoes[:, 0].tolist() == [FLOOR_M, WALL_M]


def test_what_some_looks_hear_may_be_a_level_and_is_none():
    finder = LevelFinder()
    for k in range(200):
        finder.hear(crowded(k, share=0.4, loud=10.0 if k % 2 else 1.0))
    assert finder.levels() == []
    assert any(sign == -1 and abs(height) < 0.1 for sign, height in finder.levels(least=RETURNING))


def past_corner(number: int, *, ranges: tuple[float, ...]) -> Look:
    """A look, flown along x, at things whose plan distance is that of a corner at (4, 3), so far below or above it."""
    position, track = np.array([0.05 * number, 0, HEIGHT_M]), np.array([1.0, 0, 0])
    along, plan = 4 - position[0], np.hypot(4 - position[0], 3)
    axes = np.column_stack([[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 1.0]])
    heard = Heard(number, position, axes, 1, np.zeros(16), np.zeros(16), np.zeros(8, bool), None)
    reach = np.hypot(plan, ranges)
    rows = [[r, 0.003, along / r, 0.01, 1, 2e-4 / r] for r in reach]
    return Look(heard, track, np.array(rows), np.zeros((len(rows), 5)))


def finder_of_a_floor() -> LevelFinder:
    finder = LevelFinder()
    for k in range(80):
        finder.hear(look(k, heading_rad=0.05 * k, abeam=True, wall=1.4e-4))
    assert any(sign < 0 and abs(height) < 0.05 for sign, height in finder.levels())
    return finder


def test_the_foot_of_a_corner_is_no_other_corner():
    here = past_corner(0, ranges=(0.0, FLOOR_M))
    assert finder_of_a_floor().feet_and_heads(here, [here]).tolist() == [False, True]


def test_it_is_none_either_while_what_hides_the_corner_leaves_its_foot():
    hidden, later = past_corner(0, ranges=(FLOOR_M,)), past_corner(10, ranges=(0.0, FLOOR_M))
    finder = finder_of_a_floor()
    assert finder.feet_and_heads(hidden, [hidden]).tolist() == [False], "nothing tells"
    assert finder.feet_and_heads(hidden, [hidden, later]).tolist() == [True]


def test_what_stands_elsewhere_stays():
    here = past_corner(0, ranges=(0.0, FLOOR_M))
    finder = finder_of_a_floor()
    farther = past_corner(0, ranges=(0.0, 1.5 * FLOOR_M))
    assert finder.feet_and_heads(farther, [farther]).tolist() == [False, False], "no floor is so deep"
    here.echoes[1, 2] -= 0.1
    assert finder.feet_and_heads(here, [here]).tolist() == [False, False], "half a metre farther back"
    here = past_corner(0, ranges=(0.0, FLOOR_M))
    here.echoes[1, 5] *= 10
    assert finder.feet_and_heads(here, [here]).tolist() == [False, False], "far louder than what it would belong to"
