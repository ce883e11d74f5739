"""Bows of ranges tell how far ahead the line is on which a surface's normals meet, and hollow walls stand about it."""

from __future__ import annotations

import numpy as np
import pytest

from ullage.processing.mapper_bows import Hollow, bow_of, hollow_of, lines_of
from ullage.processing.mapper_echoes import Echo

UP = np.array([0.0, 0.0, 1.0])


def echoes_of(at: np.ndarray, reach: np.ndarray) -> list[Echo]:
    track = np.gradient(at, axis=0)
    track /= np.linalg.norm(track, axis=1)[:, None]
    return [Echo(j, at[j], track[j], reach[j], 0.0, 1e-3, 0.02, 0.9) for j in range(len(at))]


def straight(middle, way, half_m: float = 0.6) -> np.ndarray:
    return np.asarray(middle) + np.linspace(-half_m, half_m, 25)[:, None] * np.asarray(way)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("aside", [0.0, 0.5])
def test_the_line_of_a_tanks_wall_is_its_axis_before_and_past_the_focus(sign, aside):
    at = straight((aside, 1.2, 0.1), (1.0, 0.0, 0.0))
    away = np.hypot(at[:, 0], at[:, 1])
    bow = bow_of(echoes_of(at, 3.2 + sign * away))
    out = np.array([aside, 1.2, 0]) / np.hypot(aside, 1.2)
    assert bow.bent(-sign * out[None])[0]
    hollow = hollow_of(bow, -sign * out, UP)
    assert np.hypot(*hollow.centre[:2]) < 0.06, "the fourth order of distances is taken out"
    assert hollow.radius_m == pytest.approx(3.2, abs=0.06)


def test_a_turning_track_along_a_flat_wall_is_no_bow_that_way():
    turn = np.linspace(-0.4, 0.4, 25)
    at = np.column_stack([1.5 * np.sin(turn), 1.5 * np.cos(turn), np.zeros(25)])
    bow = bow_of(echoes_of(at, 3.0 - at[:, 1]))
    ahead = np.array([[0.0, 1.0, 0.0]])
    assert abs(bow.bend(ahead)[0]) < 0.02
    assert not bow.bent(ahead)[0]
    assert bow.bend(-ahead)[0] == pytest.approx(2 / 1.5, rel=0.1), "a wall behind would have to be hollow"


def test_lines_of_all_slopes_make_the_same_bow():
    at = straight((0.0, 1.2, 0.0), (0.98, 0.0, 0.199))
    bow = bow_of(echoes_of(at, 3.2 - np.hypot(at[:, 0], at[:, 1])))
    way = np.array([[0.0, 1.0, 0.0]])
    which, axes, focal, doubt = lines_of(bow, way)
    assert len(which) >= 3
    assert (which == 0).all()
    assert (doubt > 0).all()
    for axis, ahead in zip(axes, focal, strict=True):
        wall = Hollow(bow.place + ahead * way[0], axis, bow.range_m - ahead)
        assert wall.ranges(at, wall.ways(at, way[0])) == pytest.approx(3.2 - np.hypot(at[:, 0], at[:, 1]), abs=0.02)


def test_too_short_or_too_crooked_a_stretch_tells_no_bow():
    assert bow_of(echoes_of(straight((0, 1, 0), (1, 0, 0), 0.2), np.full(25, 2.0))) is None
    at = straight((0, 1, 0), (1, 0, 0))
    at[:, 2] += 0.05 * np.sin(20 * at[:, 0])
    assert bow_of(echoes_of(at, np.full(25, 2.0))) is None


def test_planes_that_touch_a_hollow_wall_lie_behind_it_all_round():
    wall = Hollow(np.zeros(3), UP, 3.0)
    planes = wall.tangents(np.array([1.0, 0, 0]), np.array([2.0, 0, 0.4]))
    turn = np.linspace(-1.0, 1.0, 50)
    on = 3 * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(50)])
    beyond = np.column_stack([planes[:, 3] - on @ planes[:, :3].T, 3.0 - on[:, 0]])
    assert (beyond > -1e-9).all()
    assert beyond.min(axis=1).max() < 0.06
    assert planes[:, 6] == pytest.approx(0.4)
