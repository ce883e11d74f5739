"""Things that move as we watch: poses between those that came, and a scene's model that is moved."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ullage as ul
from ullage.geometry import apply, quat_matrix
from ullage.world.moving import LiveMotion
from ullage.world.raycast import Raycaster

AHEAD = (0.0, 0.0, 0.0, 1.0)
TURNED = (0.0, 0.0, np.sin(0.25), np.cos(0.25))  # half a radian to the left

WORLD = """<sdf version="1.6"><world name="w">
<model name="plate"><static>true</static><pose>3 0.5 0 0 0 0.3</pose><link name="l"><collision name="c">
  <geometry><box><size>0.02 1 1</size></box></geometry></collision></link></model>
<model name="rail"><pose>2 -1 0 0.2 0 0</pose><link name="l"><collision name="c">
  <geometry><cylinder><radius>0.002</radius><length>1</length></cylinder></geometry></collision></link></model>
<model name="wall"><pose>5 0 0 0 0 0</pose><link name="l"><collision name="c">
  <geometry><box><size>0.1 4 4</size></box></geometry></collision></link></model></world></sdf>"""


@pytest.fixture
def world(tmp_path):
    (tmp_path / "w.sdf").write_text(WORLD)
    return ul.load_scene(tmp_path / "w.sdf")


def test_between_two_poses_it_goes_straight_and_turns_evenly_and_else_it_stands():
    motion = LiveMotion((1, 0, 0), AHEAD)
    assert motion.at(5).position[0].tolist() == [1, 0, 0]
    motion.see(100, (1, 0, 0), AHEAD)
    motion.see(200, (3, 2, 0), TURNED)
    found = motion.at([0, 100, 150, 200, 900])
    np.testing.assert_allclose(found.position[:, 0], [1, 1, 2, 3, 3])
    angle = 2 * np.arcsin(found.quat_xyzw[:, 2])
    np.testing.assert_allclose(angle, [0, 0, 0.25, 0.5, 0.5], atol=1e-12)


def test_what_stood_for_long_does_not_glide():
    motion = LiveMotion((0, 0, 0), AHEAD)
    motion.see(0, (0, 0, 0), AHEAD)
    motion.stand_until(9000)
    motion.see(9100, (1, 0, 0), AHEAD)
    np.testing.assert_allclose(motion.at([5000, 9000, 9050, 9100]).position[:, 0], [0, 0, 0.5, 1], atol=1e-12)


def test_a_pose_that_came_late_counts_unless_a_later_one_is_known():
    motion = LiveMotion((0, 0, 0), AHEAD)
    motion.stand_until(100)
    motion.stand_until(200)
    motion.see(150, (1, 0, 0), AHEAD)
    motion.see(120, (7, 0, 0), AHEAD)
    assert motion.at(200).position[0, 0] == 1
    assert motion.t_ns.tolist() == [100, 150]


@given(st.lists(st.integers(0, 1000), min_size=1, max_size=20, unique=True), st.integers(0, 1000))
def test_what_is_forgotten_is_not_missed(times, now):
    motion = LiveMotion((0, 0, 0), AHEAD)
    for t in sorted(times):
        motion.see(t, (np.sin(t), 0, 0), AHEAD)
    later = np.arange(now, 1001)
    before = motion.at(later).position
    motion.forget(now)
    np.testing.assert_array_equal(motion.at(later).position, before)
    assert (motion.t_ns < now).sum() <= 2


def test_a_model_is_moved_whole_and_the_others_stay(world):
    here = world.models["plate"]
    turn, at = quat_matrix(np.array([TURNED]))[0], np.array([1.0, 2.0, 3.0])
    motion = LiveMotion(at, TURNED)
    moved = world.driven("plate", motion)
    mine = world.face_object == world.object("plate")
    in_model = apply(np.linalg.inv(here), world.corners()[mine])
    np.testing.assert_allclose(moved.corners()[mine], in_model @ turn.T + at, atol=1e-12)
    np.testing.assert_array_equal(moved.corners()[~mine], world.corners()[~mine])
    home = LiveMotion(here[:3, 3], (0, 0, np.sin(0.15), np.cos(0.15)))
    np.testing.assert_allclose(world.driven("plate", home).corners(), world.corners(), atol=1e-12)


def test_wires_move_with_their_model(world):
    moved = world.driven("rail", LiveMotion((7.0, 0.0, 0.0), AHEAD))  # upright now
    np.testing.assert_allclose(moved.bounds[1], [7.002, 2, 2], atol=2e-3)
    face, distance = Raycaster(moved, wires=True).hits([7.0, -1.0, 0.0], [[0.0, 1.0, 0.0]])
    assert face[0] == len(moved.faces)
    assert distance[0] == pytest.approx(0.998, abs=1e-9)


def test_a_model_that_is_not_there_cannot_be_moved(world):
    with pytest.raises(ul.InputError, match=r"no model 'door' \(allowed: plate, rail, wall"):
        world.driven("door", LiveMotion((0, 0, 0), AHEAD))
