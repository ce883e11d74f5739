"""Closed bodies and their backs."""

import numpy as np
import pytest

import ullage as ul
from ullage.radar.solids import backs, welded
from ullage.world import shapes
from ullage.world.scene import Scene

EVERY = np.ones(12, bool)


def sides(vertices, faces):
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = cross / np.linalg.norm(cross, axis=1, keepdims=True)
    return backs(corners, normals, np.zeros(len(faces), np.int32))


@pytest.mark.parametrize("inside_out", [False, True])
def test_a_radar_beside_a_box_sees_one_side_of_it(inside_out):
    vertices, faces = shapes.box((1.0, 1.0, 1.0))
    both = sides(vertices, faces[:, ::-1] if inside_out else faces)
    hidden = both.hidden(np.array([[3.0, 0.1, 0.2]] * 2), EVERY)
    front = (vertices[faces][:, :, 0] == 0.5).all(1)
    np.testing.assert_array_equal(hidden, ~front)


def test_nothing_is_hidden_from_within_or_in_open_or_thin_bodies():
    vertices, faces = shapes.box((1.0, 1.0, 1.0))
    out = np.array([[3.0, 0.1, 0.2]] * 2)
    assert not sides(vertices, faces).hidden(np.zeros((2, 3)), EVERY).any()
    assert not sides(vertices, faces).hidden(out, ~EVERY).any()
    assert not sides(vertices, faces[1:]).hidden(out, EVERY[1:]).any()
    turned = faces.copy()
    turned[3] = turned[3, ::-1]
    assert not sides(vertices, turned).hidden(out, EVERY).any()


def test_what_is_left_out_would_not_have_echoed(monkeypatch):
    vertices, faces = shapes.box((0.6, 0.5, 0.4))
    scene = Scene.of_mesh(vertices + np.array([2.0, 0.2, 0.1]), faces, name="crate")
    radar = ul.RadarSpec.preset("x4m05", noise=None)
    path = ul.Trajectory.line((0, 0, 0), (0.2, 0.3, 0.4), 0.5, 10)
    with_cull = ul.simulate(scene, path, radar).samples
    monkeypatch.setattr("ullage.radar.solids.Backs.hidden", lambda self, origins, opaque: np.zeros(len(opaque), bool))
    without = ul.simulate(scene, path, radar).samples
    assert abs(with_cull).max() > 1e-6
    np.testing.assert_allclose(with_cull, without, atol=1e-9 * abs(without).max())


def test_a_radar_beside_an_oblique_plate_does_not_hear_its_back():
    """It stands in the plate's box along the world's axes, but not in the plate."""
    vertices, faces = shapes.box((0.003, 1.0, 1.0))
    radar = ul.RadarSpec.preset("x4m05", noise=None)
    here = ul.Trajectory.stationary((-0.4, 0.05, 0.1))
    straight = ul.simulate(Scene.of_mesh(vertices, faces, name="plate"), here, radar).samples
    turn = np.array([[1, -1, 0], [1, 1, 0], [0, 0, np.sqrt(2)]]) / np.sqrt(2)
    beside = ul.Trajectory.stationary(turn @ here.position[0], yaw_deg=45)
    oblique = ul.simulate(Scene.of_mesh(vertices @ turn.T, faces, name="plate"), beside, radar).samples
    assert abs(oblique - straight).max() < 1e-3 * abs(straight).max()


def test_corners_in_one_place_are_one():
    rng = np.random.default_rng(4)
    places = rng.integers(-3, 3, (200, 3, 3)) * 0.5
    tri = welded(places + rng.uniform(-4e-7, 4e-7, places.shape))
    _, want = np.unique(places.reshape(-1, 3), axis=0, return_inverse=True)
    np.testing.assert_array_equal(tri.ravel(), want.ravel())
    assert welded(np.zeros((0, 3, 3))).shape == (0, 3)
