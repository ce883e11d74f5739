"""Folds of a staggered pulse interval, told from obstacles by the levels of two frames."""

from __future__ import annotations

import math

import numpy as np
import pytest

import ullage as ul
from ullage.arrays import Floats
from ullage.data import Trajectory
from ullage.processing.fold_levels import FoldErrors, errors_of
from ullage.processing.obstacles import ObstacleStage
from ullage.processing.range_tracks import TrackerSpec
from ullage.world import shapes
from ullage.world.scene import Scene

SPEC = ul.RadarSpec.preset("x4m05", stagger_div=17)
AXIS_M = SPEC.range_m
JUMP_M = SPEC.unambiguous_range_m / 16
SURE = math.log(TrackerSpec().odds)


def profile(echoes: list[tuple[float, float]]) -> Floats:
    """Levels of Gaussian pulses at (range [m], level [dB]) over a floor of 0 dB."""
    pulses = [level - (AXIS_M - place) ** 2 / (2 * 0.1**2) * 8.7 for place, level in echoes]
    return np.asarray(np.maximum(0.0, np.max(pulses, axis=0)))


def odds(frames: list[list[tuple[float, float]]], place_m: float) -> float:
    """Log odds of a fold after detections at one range in frames of alternating intervals."""
    errors, profiles = FoldErrors(), [profile(echoes) for echoes in frames]
    for number in range(1, len(profiles)):
        levels = profiles[number], profiles[number - 1]
        found = errors_of(SPEC, number, (place_m, place_m), levels, AXIS_M, 0.3)
        assert found is not None
        errors.add(*found)
    return errors.log_odds


def far(number: int, *echoes: tuple[float, float]) -> list[tuple[float, float]]:
    """Where echoes from beyond one interval appear in a frame."""
    return [(place - SPEC.unambiguous_range_m - JUMP_M * (number % 2), level) for place, level in echoes]


@pytest.mark.parametrize("parity", [0, 1])
def test_two_folds_at_one_place_are_a_fold_of_either_phase(parity: int) -> None:
    """Two paths that differ by the jump: an echo at 3 m in every frame, of 25 and of 17 dB in turn."""
    two = (3.0 + SPEC.unambiguous_range_m, 25.0), (3.0 + SPEC.unambiguous_range_m + JUMP_M, 17.0)
    frames = [far(number + parity, *two) for number in range(12)]
    assert odds(frames, 3.0) > SURE


def test_an_obstacle_is_none_whatever_folds_are_beside_it() -> None:
    """Its level stays, and fluctuates by 4 dB; folds of the same level lie where it would jump to."""
    rng = np.random.default_rng(4)
    for _ in range(50):
        places = SPEC.unambiguous_range_m + rng.uniform(0.5, 6.0, 8)
        folds = list(zip(places.tolist(), rng.uniform(5, 25, 8).tolist(), strict=True))
        frames = [[(3.0, 22.0 + rng.normal(0, 4.0)), *far(number, *folds)] for number in range(12)]
        assert odds(frames, 3.0) < SURE


def test_folds_of_one_level_are_not_told_from_an_obstacle() -> None:
    two = [(3.0 + SPEC.unambiguous_range_m + k * JUMP_M, 20.0) for k in range(2)]
    assert odds([far(number, *two) for number in range(12)], 3.0) < SURE


def test_a_louder_echo_where_the_fold_would_be_says_nothing_of_it() -> None:
    found = errors_of(SPEC, 1, (3.0, 3.0), (profile([(3.0, 15.0)]), profile([(3.0 + JUMP_M, 40.0)])), AXIS_M, 0.3)
    assert found is not None
    assert np.isnan(found[1]).any()


@pytest.mark.parametrize("before_m", [AXIS_M[0] - 1.0, AXIS_M[0] - 0.1, AXIS_M[-1] + 0.1, AXIS_M[-1] + 1.0])
def test_an_obstacle_that_was_outside_the_profile_before_predicts_no_level(before_m: float) -> None:
    """As of a fast track after a gap between frames."""
    level = profile([(3.0, 15.0)])
    assert errors_of(SPEC, 1, (3.0, before_m), (level, level), AXIS_M, 0.3) is None


def test_one_pulse_interval_has_no_such_evidence() -> None:
    level = profile([(3.0, 20.0)])
    assert errors_of(SPEC.but(stagger_div=None), 1, (3.0, 3.0), (level, level), AXIS_M, 0.3) is None


@pytest.fixture(scope="module")
def tunnel() -> Scene:
    """A steel tunnel, 9 by 5 m, with a wall 12 m ahead: echoes of many paths fold to near ranges."""
    floor, side = shapes.plane((30, 9)), shapes.plane((30, 5))
    upright = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
    parts = [
        Scene.of_mesh(floor[0] + [0, 0, -2.5], floor[1], name="floor"),
        Scene.of_mesh(floor[0] + [0, 0, 2.5], floor[1], name="ceiling"),
        Scene.of_mesh(side[0] @ upright.T + [0, -4.5, 0], side[1], name="right"),
        Scene.of_mesh(side[0] @ upright.T + [0, 4.5, 0], side[1], name="left"),
        Scene.of_mesh(shapes.box((0.1, 9.0, 5.0))[0] + [8.0, 0, 0], shapes.box((0.1, 9.0, 5.0))[1], name="end"),
    ]
    return Scene.union(parts)


def test_folds_of_many_paths_in_a_tunnel_leave_the_way_free(tunnel: Scene) -> None:
    """Without levels a false echo stays for the whole flight, and comes as near as 0.6 m before the front radar."""
    path = Trajectory.line((-4, 0, 0), (-2.2, 0, 0), 0.43, 10.0)
    rig = ul.Rig.preset("thesis-4", stagger_div=17)
    frames = ul.simulate(tunnel, path, rig, seed=0)
    stage, ahead = ObstacleStage(), list[float]()
    for row in range(len(path)):
        for found in stage.update({name: part[row : row + 1] for name, part in frames.items()}):
            ahead.append(found.distance_m[found.sensors.index("front")])
    assert np.sum(np.array(ahead) < 2.2) <= 7  # until its levels have told, 0.7 s
    assert min(ahead) > 1.7
