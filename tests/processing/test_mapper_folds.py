import numpy as np
import pytest

import ullage as ul
from ullage.antenna import boresight_pattern
from ullage.processing.blocks import Blocks
from ullage.processing.mapper_folds import Fold, alike, is_hidden
from ullage.processing.mapper_looks import Heard, Look

FOLD_M, REACH_M, WAVE_M = 9.87, 3.0, 0.041
PATTERN = boresight_pattern(ul.AntennaSpec())
NORTH = np.array([0.0, 1.0, 0.0])


def blocks_with(*strips, north_m=15.0, dims=2):
    """A map that holds level strips, in a volume discs: how far north of the origin, and half how wide [m]."""
    box = [[-4, -4, -1 if dims == 3 else 0], [4, north_m, 1 if dims == 3 else 0]]
    blocks = Blocks(ul.Grid.covering(box, 0.1, dims=dims, z_m=0.0 if dims == 2 else None))
    for far, half in strips:
        blocks.lay(far * NORTH, NORTH, (0.04, half, 6.0))
    return blocks


def folds(blocks, *, height=1.0, loudest_m=np.inf):
    """Whether an echo straight to the north of an eastward flight may be folded."""
    fold = Fold(least=0.64, pattern=PATTERN, wave_m=WAVE_M, fold_m=FOLD_M, loudest_m=loudest_m)
    usual = REACH_M + FOLD_M  # an echo of height 1 is as loud as the usual at the farther range
    if blocks.grid.dims == 3:
        return fold.may_be(np.zeros(3), NORTH, NORTH, (REACH_M, height), blocks, usual=usual)
    axes = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    heard = Heard(0, np.zeros(3), axes, 1, np.zeros(16), np.zeros(16), np.ones(8, bool), None)
    echo = np.array([[REACH_M, 0.001, 0.0, 0.01, 1.0, height]])
    look = Look(heard, np.array([1.0, 0.0, 0.0]), echo, np.zeros((1, 5)))
    return bool(fold.among(look, np.zeros(1), blocks, usual=usual)[0])


@pytest.mark.parametrize("dims", [2, 3])
def test_an_echo_may_come_from_one_fold_farther_off_while_nothing_tells(dims):
    assert folds(blocks_with(dims=dims))
    assert not folds(blocks_with(north_m=12.0, dims=dims)), "no room"
    assert not folds(blocks_with(dims=dims), height=2.1), "too loud for so far"


@pytest.mark.parametrize("dims", [2, 3])
def test_in_a_volume_no_wall_is_too_loud_for_being_louder_than_what_was_heard_faintly(dims):
    loudest = 3 * (REACH_M + FOLD_M)  # three times as loud as the usual
    assert folds(blocks_with(dims=dims), height=2.5, loudest_m=loudest) == (dims == 3)
    assert not folds(blocks_with(dims=dims), height=3.1, loudest_m=loudest)


def test_in_a_volume_a_way_that_is_in_doubt_may_lead_to_a_wall_on_the_grid():
    fold = Fold(least=0.64, pattern=PATTERN, wave_m=WAVE_M, fold_m=FOLD_M, loudest_m=np.inf)
    far, top = REACH_M + FOLD_M, 1.0
    for off_rad, folded in ((0.09, True), (0.25, False)):
        rise = np.arctan2(top, far) + off_rad
        way = np.array([0.0, np.cos(rise), np.sin(rise)])
        assert far * way[2] > top, "off the grid"
        assert fold.may_be(np.zeros(3), NORTH, way, (REACH_M, 1.0), blocks_with(dims=3), usual=far) == folded


@pytest.mark.parametrize("dims", [2, 3])
@pytest.mark.parametrize(("half_m", "hidden"), [(0.08, False), (0.15, False), (1.0, True)])
def test_only_what_covers_its_fresnel_zone_hides_a_far_wall(half_m, hidden, dims):
    assert np.sqrt(WAVE_M * (REACH_M + FOLD_M) / 2) * 8 / (REACH_M + FOLD_M) > 0.25  # half the fan, 8 m off
    assert folds(blocks_with((8.0, half_m), dims=dims)) != hidden


@pytest.mark.parametrize("dims", [2, 3])
def test_a_line_that_folded_echoes_have_drawn_does_not_vouch_for_them(dims):
    line = (REACH_M, 2.0)
    assert folds(blocks_with(line, dims=dims))
    assert folds(blocks_with(line, (2.0, 2.0), dims=dims)) == (dims == 3), "a wall before both"
    assert not folds(blocks_with(line, (5.0, 2.0), dims=dims)), "a wall between them"


def test_what_stands_close_before_a_far_wall_belongs_to_it():
    assert folds(blocks_with((REACH_M + FOLD_M - 0.4, 2.0)))
    assert folds(blocks_with((REACH_M + FOLD_M, 2.0)))
    assert not folds(blocks_with((REACH_M + FOLD_M - 2.0, 2.0)))


@pytest.mark.parametrize("dims", [2, 3])
def test_a_wall_is_hidden_by_what_covers_its_fresnel_zone_and_not_by_less(dims):
    assert is_hidden(blocks_with((3.0, 1.0), dims=dims), np.zeros(3), NORTH, 6.0, WAVE_M)
    assert not is_hidden(blocks_with((3.0, 0.1), dims=dims), np.zeros(3), NORTH, 6.0, WAVE_M), "a stray cell"
    aside = np.array([-1.0, 0.0, 0.0])
    assert not is_hidden(blocks_with((3.0, 1.0), dims=dims), aside, NORTH, 6.0, WAVE_M), "its rim"
    assert not is_hidden(blocks_with((6.0, 1.0), dims=dims), np.zeros(3), NORTH, 6.0, WAVE_M), "itself"
    assert is_hidden(blocks_with((5.5, 0.1), dims=dims), np.zeros(3), NORTH, 6.0, WAVE_M), (
        "the wall itself, told in part"
    )


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_way_near_the_track_is_not_told_from_it(sign):
    near = np.array([np.sin(0.15), sign * np.cos(0.15), 0.0])
    ways = list(alike(near, NORTH))
    assert len(ways) == 2
    assert ways[1] == pytest.approx(sign * NORTH)
    assert len(list(alike(np.array([np.sin(0.4), np.cos(0.4), 0.0]), NORTH))) == 1
