"""How far a wall goes on, from the level of its echoes, against the half plane of Fresnel's integrals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import fresnel

import ullage as ul
from ullage.antenna import boresight_pattern
from ullage.processing.mapper_rims import LEAST_RIM, MOST_RIM, rim_along, rim_of

WAVELENGTH_M, PATTERN = 0.041, boresight_pattern(ul.AntennaSpec())


def level_near_an_edge(parameter: np.ndarray) -> np.ndarray:
    """Level of a half plane's echo whose edge is at these Fresnel parameters off the foot, by Cornu's spiral."""
    s, c = fresnel(parameter)
    return np.asarray(abs((0.5 + c) + 1j * (0.5 + s)) / np.sqrt(2))


def abeam(reach: float, edge_m: float, *, span_m: float = 2.0) -> np.ndarray:
    """Echoes of a half plane along a track beside it, flown towards its edge, which is this far past the last foot."""
    x = np.linspace(-span_m, 0, 41)
    level = level_near_an_edge(2 * (edge_m - x) / np.sqrt(WAVELENGTH_M * reach))
    return np.column_stack([x, 0 * x, np.full(len(x), reach), level / reach, 0 * x, 0 * x + 1])


@pytest.mark.parametrize("nearest", [2.2, 2.6, 3.2])
def test_a_surface_is_never_drawn_past_its_edge(nearest):
    level = level_near_an_edge(np.linspace(nearest, nearest + 1.5, 48))
    assert rim_of(level, least=2.0, most=4.0) < nearest + 0.75


def test_a_steady_level_draws_a_wall_twice_as_far_as_one_that_ripples():
    assert rim_of(1 + 0.2 * np.linspace(0, 1, 48) ** 2, least=2.0, most=4.0) == 4.0
    assert rim_of(level_near_an_edge(np.linspace(-0.5, 2.0, 48)), least=2.0, most=4.0) == 2.0


@pytest.mark.parametrize("reach", [1.5, 3.0, 5.0])
@pytest.mark.parametrize("edge_m", [0.05, 0.2, 0.4])
def test_beside_a_plane_no_more_is_drawn_than_is_there(reach, edge_m):
    rim = rim_along(abeam(reach, edge_m), np.array([0.0, 1.0]), WAVELENGTH_M, PATTERN)
    least = 0.5 * LEAST_RIM * np.sqrt(WAVELENGTH_M * reach)
    assert 0.5 * rim * np.sqrt(WAVELENGTH_M * reach) <= max(edge_m, least) + 0.15


def test_beside_an_endless_wall_as_much_is_drawn_as_it_may_answer_for():
    assert rim_along(abeam(3.0, 50.0), np.array([0.0, 1.0]), WAVELENGTH_M, PATTERN) == MOST_RIM


def test_turning_the_antenna_past_a_wall_is_no_edge():
    rows = abeam(3.0, 50.0)
    turn = np.radians(20) * (1 + np.tanh((rows[:, 0] + 1) / 0.2))
    rows[:, 4:] = np.column_stack([np.sin(turn), np.cos(turn)])
    rows[:, 3] *= 10 ** (2 * (PATTERN.gain_dbi(turn) - PATTERN.gain_dbi(0.0)) / 20)
    assert rim_along(rows, np.array([0.0, 1.0]), WAVELENGTH_M, PATTERN) == MOST_RIM
    rows[:, 4:] = 0.0, 1.0
    assert rim_along(rows, np.array([0.0, 1.0]), WAVELENGTH_M, PATTERN) < 0.9 * MOST_RIM


def test_a_track_too_short_to_hear_an_edge_tells_of_none():
    steady = abeam(3.0, 50.0)
    assert rim_along(steady[:8], np.array([0.0, 1.0]), WAVELENGTH_M, PATTERN) == LEAST_RIM
    still = abeam(3.0, 50.0, span_m=0.05)
    assert rim_along(still, np.array([0.0, 1.0]), WAVELENGTH_M, PATTERN) == LEAST_RIM


def test_the_fold_of_a_corner_is_drawn_no_wider_than_an_edge_however_steady_it_is():
    x = np.linspace(-1, 1, 41)
    for way in (np.array([0.0, 1.0]), np.array([0.6, 0.8])):
        reach = np.linalg.norm(5.0 * way - np.column_stack([x, 0 * x]), axis=1)
        rows = np.column_stack([x, 0 * x, reach, 1 / reach, 0 * x + way[0], 0 * x + way[1]])
        assert rim_along(rows, way, WAVELENGTH_M, PATTERN) == LEAST_RIM
