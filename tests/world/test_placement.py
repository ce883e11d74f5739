"""Scenes put together: shapes added at a place, scenes and objects moved."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ullage as ul
from ullage.errors import InputError

metres, degrees = st.floats(-20, 20), st.floats(-180, 180)
places = st.tuples(metres, metres, metres)
RADAR = ul.RadarSpec.preset("x4m05", noise=None)


def drive(velocity=(1.0, 0.0, 0.0)):
    return ul.Trajectory.line((0, 0, 0), velocity, speed_m_s=1.0)


def walker(name="walker"):
    """A scene of a still plate and of a ball that moves, whose faces share corners with nothing."""
    ball = ul.scenes.sphere(0.2, name=name)
    going = replace(ball, objects=(replace(ball.objects[0], motion=drive()),))
    return ul.scenes.plate(0.5, 0.5, 2.0).add(going)


def same(one, other):
    assert [o.name for o in one.objects] == [o.name for o in other.objects]
    for t_ns in (None, 0, 500_000_000):
        np.testing.assert_allclose(one.corners(t_ns), other.corners(t_ns), atol=1e-9)
    np.testing.assert_allclose(one.wires.start, other.wires.start, atol=1e-9)
    np.testing.assert_allclose(one.wires.end, other.wires.end, atol=1e-9)


@settings(max_examples=25, deadline=None)
@given(at=places, yaw=degrees, by=places, turn=degrees)
def test_adding_then_moving_is_moving_then_adding_at_the_moved_pose(at, yaw, by, turn):
    world, shape = walker(), ul.scenes.wire(0.001, 1.0, tilt_deg=20).add(ul.scenes.dihedral(0.3))
    angle = np.radians(turn)
    x, y, z = at
    there = np.add((np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y, z), by)
    one = world.add(shape, at=at, yaw_deg=yaw).moved(by, yaw_deg=turn)
    same(one, world.moved(by, yaw_deg=turn).add(shape, at=there, yaw_deg=yaw + turn))


@settings(max_examples=25, deadline=None)
@given(by=places, about=places, turns=st.tuples(degrees, st.floats(-80, 80), degrees))
def test_a_move_keeps_all_distances_and_the_point_it_turns_about(by, about, turns):
    world = walker().add(ul.scenes.wire(0.001, 1.0), at=(0, 1, 0))
    roll, pitch, yaw = turns
    out = world.moved(by, roll_deg=roll, pitch_deg=pitch, yaw_deg=yaw, about=about)
    before, after = (s.corners(300_000_000).reshape(-1, 3) for s in (world, out))
    np.testing.assert_allclose(
        np.linalg.norm(after - np.add(about, by), axis=1), np.linalg.norm(before - about, axis=1), atol=1e-9
    )
    np.testing.assert_allclose(
        np.linalg.norm(np.diff(after, axis=0), axis=1), np.linalg.norm(np.diff(before, axis=0), axis=1), atol=1e-9
    )


def test_a_ball_that_is_added_echoes_as_one_made_there():
    here = ul.Trajectory.stationary()
    made = ul.simulate(ul.scenes.sphere(0.3, distance_m=3.0), here, RADAR)
    added = ul.simulate(ul.Scene.empty().add(ul.scenes.sphere(0.3), at=(3.0, 0.0, 0.0)), here, RADAR)
    assert np.abs(added.samples - made.samples).max() < 1e-6 * np.abs(made.samples).max()
    aside = ul.Scene.empty().add(ul.scenes.sphere(0.3), at=(0.0, 3.0, 0.0))
    turned = ul.simulate(aside, ul.Trajectory.stationary(yaw_deg=90), RADAR)
    assert np.abs(turned.samples - made.samples).max() < 1e-3 * np.abs(made.samples).max()


def test_adding_keeps_names_materials_wires_motion_and_rigs():
    world = ul.load_scene(ul.worlds.__path__[0] + "/cargo-hold.sdf")
    out = world.add(ul.scenes.plate(0.5, 0.5, material="wood"), at=(1, 2, 3), yaw_deg=30, name="board")
    assert [o.name for o in out.objects] == [*(o.name for o in world.objects), "board"]
    assert out.objects[-1].material.name == "wood"
    assert out.objects[: len(world.objects)] == world.objects
    assert (out.rigs, out.ray_rigs, out.name) == (world.rigs, world.ray_rigs, world.name)
    assert set(out.models) == set(world.models)
    assert np.array_equal(out.wires.start, world.wires.start)
    assert np.array_equal(out.corners()[: len(world.faces)], world.corners())
    np.testing.assert_allclose(out.corners()[len(world.faces) :].reshape(-1, 3).mean(0), (1, 2, 3), atol=1e-12)
    assert len(world.objects) + 1 == len(out.objects)


def test_moving_things_move_on_from_their_new_place():
    out = walker().moved((0, 0, 1), yaw_deg=90)
    path = out.objects[1].motion.at([0, 500_000_000])
    np.testing.assert_allclose(path.position[:2], [(0, 0, 1), (0, 0.5, 1)], atol=1e-9)
    np.testing.assert_allclose(path.velocity[0], (0, 1, 0), atol=1e-9)


def test_one_object_moves_and_the_rest_stays():
    room = ul.scenes.room()
    out = room.moved((0, 0, 0.5), name="floor")
    floor = room.object("floor")
    assert np.array_equal(out.corners()[room.face_object != floor], room.corners()[room.face_object != floor])
    np.testing.assert_allclose(
        out.corners()[room.face_object == floor], room.corners()[room.face_object == floor] + (0, 0, 0.5)
    )


def test_an_object_that_shares_corners_leaves_its_neighbour_in_place():
    both = replace(
        ul.scenes.plate(1, 1), face_object=np.array([0, 1], np.int32), objects=ul.scenes.plate(1, 1).objects * 2
    )
    both = replace(both, objects=(both.objects[0], replace(both.objects[1], name="other")))
    out = both.moved((5, 0, 0), name="other")
    assert np.array_equal(out.corners()[0], both.corners()[0])
    np.testing.assert_allclose(out.corners()[1], both.corners()[1] + (5, 0, 0))


def test_a_name_that_is_taken_gets_a_number():
    out = ul.scenes.sphere(0.1).add(ul.scenes.sphere(0.1), at=(1, 0, 0)).add(ul.scenes.sphere(0.1), at=(2, 0, 0))
    assert [o.name for o in out.objects] == ["sphere", "sphere_2", "sphere_3"]
    pair = ul.Scene.empty().add(out, name="row")
    assert [o.name for o in pair.objects] == ["row::sphere", "row::sphere_2", "row::sphere_3"]
    assert pair.has("row")


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda s: s.add("sphere"), "shape is str (allowed: a Scene"),
        (lambda s: s.add(s, at=(1, 2)), "add: at is (1, 2) (allowed: x, y, z in metres)"),
        (lambda s: s.add(s, at=(1, 2, float("nan"))), "add: at is nan"),
        (lambda s: s.add(s, yaw_deg=float("inf")), "moved: yaw_deg is inf"),
        (lambda s: s.moved(by="far"), "moved: by is 'far'"),
        (lambda s: s.moved((0, 0, 1), name="roof"), "no object 'roof' (allowed: plate)"),
    ],
)
def test_what_cannot_be_placed_is_refused_in_one_line(call, words):
    with pytest.raises(InputError) as refused:
        call(ul.scenes.plate(1, 1))
    assert words in str(refused.value)
