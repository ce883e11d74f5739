"""The flights by which methods are judged: their tables' intervals, their errors of poses, and what they call true."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import ullage as ul
from studies.thesis import flights, images, volumes
from ullage.processing.metrics import map_quality
from ullage.world.raycast import Raycaster


def test_an_interval_is_students():
    assert flights.interval([1.0, 2.0, 3.0]) == "2.000 ± 2.484"  # t(0.975, 2) = 4.303, 1 / sqrt(3)
    assert flights.interval([0.5], scale=100, digits=1) == "50.0"
    assert flights.interval([]) == flights.interval([1.0, np.nan]) == "-"


def test_a_row_holds_the_mean_of_each_column_under_its_name():
    scores = {"mine": [{"a": 1.0, "b": 4.0}, {"a": 1.0, "b": 4.0}]}
    assert flights.rows_of(scores, {"b": "B", "a": "A"}) == [("mine", "4.000 ± 0.000", "1.000 ± 0.000")]
    assert flights.mean_of(scores, "mine", "b") == 4.0


def test_rounds_are_drawn_by_their_seed_and_rise_by_what_they_should():
    first, again, other = flights.level_round(0), flights.level_round(0), flights.level_round(1)
    assert np.array_equal(first.position, again.position)
    assert not np.array_equal(first.position[0], other.position[0])
    assert np.ptp(first.position[:, 2]) <= 0.1 + 1e-9
    assert np.ptp(flights.rising_round(0).position[:, 2]) == pytest.approx(2 * flights.RISE_M, abs=0.1)
    assert np.array_equal(flights.rising_round(0).position[:, :2], first.position[:, :2])


def test_believed_poses_are_off_and_the_truth_is_kept():
    path = flights.level_round(0)[:10]
    frames = flights.received(flights.judged_room(), path, 0, fidelity="thesis")
    off = flights.believed(frames, np.full((10, 3), 0.2))["left"]
    assert np.allclose(off.believed.position, frames["left"].believed.position + 0.2)
    assert off.truth is not None
    assert np.allclose(off.truth.position, frames["left"].believed.position)


def test_told_the_walls_makes_no_error_and_a_map_of_nothing_finds_nothing():
    scene, path = flights.judged_room(), flights.level_round(0)[:200:10]
    frames = flights.received(scene, path, 0, fidelity="thesis")
    told = flights.errorless_map(scene, frames, flights.plane_of(scene))
    assert map_quality(told, scene, frames)["precision"].value == 1.0
    assert told.occupied.any()


def test_beside_a_foot_lies_at_its_range_in_the_beam_above_and_below():
    caster, east = Raycaster(flights.judged_room()), np.array([1.0, 0.0, 0.0])
    eye, south = np.array([-1.0, 0.5, 0.0]), np.array([0.0, -1.0, 0.0])
    points = volumes.beside_foot(caster, eye, south, east, south, 3.0)
    assert np.allclose(np.linalg.norm(points - eye, axis=1), 3.5)  # the wall at y = -3
    assert np.allclose(points[:, 0], eye[0])
    off = np.degrees(np.arcsin(points[:, 2] / 3.5))
    assert np.allclose(np.sort(off), np.sort(np.degrees(volumes.ASIDE)))
    assert not len(volumes.beside_foot(caster, eye, -south, east, south, 3.0))  # out of the beam
    assert not len(volumes.beside_foot(caster, np.array([2.0, 0, 0]), east, -south, east, 4.0))  # behind the plate


def test_an_image_is_judged_by_the_pole_it_shows():
    _, frames, image = next(images.cases(0))
    path = frames.believed
    north = ul.Trajectory(path.t_ns, path.position + np.array([0, 0.05, 0]), path.quat_xyzw)
    aside = replace(frames, poses=north, truth=path)
    row = images.scored(frames, image, image)
    moved = images.scored(aside, ul.focus(aside, images.GRID), image)
    assert row["peak"] == 0
    assert row["error"] < 1
    assert moved["error"] == pytest.approx(5, abs=1)
