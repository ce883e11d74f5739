"""Poses by radars and an inertial unit: where they are right, what they do not read, where they must not be sure."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

import ullage as ul
from ullage.processing.odometry import solution
from ullage.processing.odometry.echo_list import EchoList
from ullage.processing.odometry.inertial import Block
from ullage.processing.odometry.jets import UP, Jet
from ullage.processing.odometry.odometry import bounded
from ullage.processing.odometry.solution import PoseEstimate

RIG = ul.Rig.preset("thesis-4")


@lru_cache(maxsize=4)
def _flight(kind: str, seed: int = 1):
    """Frames, inertial readings, heights and the true path of a short flight."""
    if kind == "room":
        scene = ul.scenes.room(size_m=(8, 6, 3))
        points = [(-2.5, -1.5, 1.1), (-0.5, -1.5, 1.1), (-0.5, 0.0, 1.1)]
    else:
        scene = ul.scenes.plate(width_m=30, height_m=6, distance_m=2.5)
        points = [(0, -2, 0.3), (0, 4, 0.3)]
    flown = ul.fly(ul.Waypoints(points, speed_m_s=0.5), rate_hz=17.0, seed=seed)
    frames = ul.simulate(scene, flown, RIG, seed=seed)
    return frames, ul.simulate_imu(flown, seed=seed), ul.simulate_height(flown, seed=seed), flown


@lru_cache(maxsize=4)
def _estimate(kind: str, count: int | None = None):
    """The poses by the first `count` frames of each radar, and the true path."""
    frames, imu, height, flown = _flight(kind)
    first = {name: part[:count] for name, part in frames.items()}
    return ul.odometry(first, imu, start=flown[:1], height=height), flown


def test_the_pose_in_a_room_is_right_and_knows_how_right_it_is() -> None:
    found, flown = _estimate("room")
    error = found.trajectory.position - flown.at(found.trajectory.t_ns).position
    assert np.sqrt((error**2).sum(1).mean()) < 0.15
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariance[:, :3, :3]), error)
    assert 0.1 < nees.mean() / 3 < 1.5
    assert not found.lost


def test_poses_and_truth_of_the_frames_are_not_read() -> None:
    frames, imu, height, flown = _flight("room")
    first, _ = _estimate("room", 60)
    still = ul.Trajectory.stationary(n=60)
    bare = {
        name: replace(part[:60], truth=None, poses=replace(still, t_ns=part.t_ns[:60])) for name, part in frames.items()
    }
    second = ul.odometry(bare, imu, start=flown[:1], height=height)
    assert np.array_equal(first.trajectory.position, second.trajectory.position)
    assert np.array_equal(first.sigma, second.sigma)


def test_a_stream_in_pieces_gives_the_same_poses() -> None:
    frames, imu, height, flown = _flight("room")
    whole, _ = _estimate("room", 60)
    work = ul.Odometry(start=flown[:1])
    work.add_height(height)
    middle = int(np.searchsorted(imu.t_ns, frames["front"].t_ns[30]))
    work.add_imu(imu[:middle])
    for part in (slice(0, 40), slice(40, 60)):
        work.add({name: one[part] for name, one in frames.items()})
    assert len(work.result().trajectory) < 60
    work.add_imu(imu[middle:])
    work.add({})
    assert work.pose is not None
    assert work.pose.t_ns == frames["front"].t_ns[59]
    # the own echo is estimated from the frames so far, so pieces differ by what it leaves
    assert np.abs(work.result().trajectory.position - whole.trajectory.position).max() < 0.02


def test_a_radar_that_misleads_is_covered_by_the_sigmas() -> None:
    """The front radar receives what it would on a flight 1.2 times as fast: its surfaces agree, and are wrong."""
    frames, imu, height, flown = _flight("room")
    true = flown[:85]
    faster = replace(true, position=true.position[0] + 1.2 * (true.position - true.position[0]))
    received = {name: part[:85] for name, part in frames.items()}
    received["front"] = ul.simulate(ul.scenes.room(size_m=(8, 6, 3)), faster, RIG, seed=1)["front"]
    found = ul.odometry(received, imu, start=flown[:1], height=height)
    error = np.abs(found.trajectory.position - true.position)
    assert not found.lost
    assert error.max() > 0.08
    assert (error / found.sigma[:, :3]).max() < 3


def test_the_bound_takes_the_solution_that_is_farthest_away() -> None:
    still = np.array([0.0, 0.0, 0.0, 1.0])
    whole = PoseEstimate(0, np.zeros(3), still, np.zeros(3), np.zeros(3), np.full(4, 0.1), np.eye(4) / 100, 1.0, 4, "")
    near = replace(whole, sigma=np.full(4, 0.2))
    far = replace(whole, position=np.array([0.6, 0.0, 0.0]), sigma=np.full(4, 0.15))
    found = bounded(whole, {"front": near, "back": far}, 1.0)
    assert np.allclose(found.sigma, [0.35, 0.2, 0.2, 0.2])
    assert np.allclose(found.covariance, np.diag(found.sigma**2))
    assert not found.lost
    assert "without back" in bounded(whole, {"front": near, "back": far}, 0.3).lost


def test_phases_that_fit_make_an_association_sure_and_those_of_another_echo_end_it() -> None:
    turn_m, sigma = 0.02, 0.001
    arc = solution._Arc(Block(), 0.0, 0, 0.0, 0.5)
    arc.weigh(0.0, sigma, turn_m, share=0.0)
    assert arc.chance == 0.5  # a hover teaches nothing
    for count in (4, 200):
        for _ in range(count):
            arc.weigh(sigma, sigma, turn_m, share=1.0)
        assert arc.sure
    for misfit in (0.3, -0.4, 0.2, 0.45):  # of a turn
        arc.weigh(misfit * turn_m, sigma, turn_m, share=1.0)
    assert arc.chance < 0.1
    for _ in range(8):
        arc.weigh(sigma, sigma, turn_m, share=1.0)
    assert arc.sure  # the echo is the surface's again


@pytest.mark.parametrize("proven", [False, True])
def test_a_range_of_an_association_that_is_not_sure_leaves_the_pose_alone(proven: bool) -> None:
    frames, imu, height, flown = _flight("room")
    work = ul.Odometry(start=flown[:1])
    work.add_imu(imu)
    work.add_height(height)
    work.add({name: part[:50] for name, part in frames.items()})
    state, radar = work._all._filter, work._all._radars["front"]
    arm, axis = state.turn @ radar.body_from_sensor[:3, 3], state.turn @ radar.body_from_sensor[:3, 0]
    asked = [solution._predict_echo(state, one, "front", radar, arm, axis) for one in work._all._surfaces]
    pair = next(one for one in asked if one is not None)
    surface, before = pair.surface, state.position.copy()
    surface.proven, surface.excess, surface.arcs, surface.ranged, pair.index = proven, 9.0, {}, {}, 0
    range_m = surface.block.jet.range_m
    found = EchoList(np.array([pair.range_m + 0.04]), np.zeros(1), np.zeros(1), np.zeros(1))
    work._all._update(state, [pair], {"front": found}, work._all._now_ns)
    assert np.array_equal(state.position, before)
    assert (surface.block.jet.range_m == range_m) == proven  # a new surface learns from it


def test_before_one_wall_the_way_along_it_is_said_to_be_lost() -> None:
    found, _ = _estimate("wall")
    assert found.lost
    assert "known to" in found.lost[0].why
    assert found.lost[0].to_ns == found.trajectory.t_ns[-1]


def test_without_inertial_readings_nothing_is_estimated() -> None:
    frames, imu, _, _ = _flight("room")
    with pytest.raises(ul.InputError, match="inertial"):
        ul.odometry(frames, imu[-1:])


@pytest.mark.parametrize("curvature", [0.0, 0.25, -0.3])
def test_a_jet_is_exact_for_planes_poles_and_tanks(curvature: float) -> None:
    unit = np.array([0.6, 0.8, 0.0])
    jet = Jet(np.array([1.0, -2.0, 0.5]), 3.0, unit, curvature)
    for place in np.random.default_rng(1).normal(size=(20, 3)):
        away = place - jet.anchor
        if curvature:
            centre = (unit / curvature)[:2]
            true = 3.0 + (np.linalg.norm(centre - away[:2]) - 1 / abs(curvature)) * np.sign(curvature)
        else:
            true = 3.0 - unit @ away
        assert jet.seen_from(place)[0] == pytest.approx(true, abs=1e-9)
        there, _ = jet.anchored(place)
        assert there.seen_from(jet.anchor)[0] == pytest.approx(3.0, abs=1e-9)


def test_a_shift_or_turn_of_all_the_world_changes_no_range() -> None:
    jet = Jet(np.array([1.0, -2.0, 0.5]), 3.0, np.array([0.6, 0.8, 0.0]), 0.2)
    place = np.array([1.4, -1.0, 0.7])
    _, slope, by_jet = jet.seen_from(place)
    shift, turn = by_jet @ jet.gauge()[:, :3], by_jet @ jet.gauge()[:, 3]
    assert np.allclose(slope + shift, 0, atol=1e-12)
    assert slope @ np.cross(UP, place) + turn == pytest.approx(0, abs=1e-12)
