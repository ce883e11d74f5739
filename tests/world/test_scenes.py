"""Parametric scenes: sizes, places, closed surfaces, and bad numbers refused by name."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

import ullage as ul
from ullage.world.scene import Scene

SIZES = st.floats(0.02, 3.0)
FAR = st.floats(-20.0, 20.0)
ANGLES = st.floats(-180.0, 180.0)


def mesh(scene: Scene) -> trimesh.Trimesh:
    return trimesh.Trimesh(scene.vertices, scene.faces, process=False)


def normals(scene: Scene) -> np.ndarray:
    corners = scene.corners()
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return cross / np.linalg.norm(cross, axis=1, keepdims=True)


@given(SIZES, SIZES, FAR, ANGLES)
def test_plate_has_its_area_centre_and_normal(width, height, distance, yaw):
    scene = ul.scenes.plate(width_m=width, height_m=height, distance_m=distance, yaw_deg=yaw)
    assert len(scene.faces) == 2
    assert mesh(scene).area == pytest.approx(width * height)
    assert scene.vertices.mean(0) == pytest.approx([distance, 0, 0], abs=1e-9)
    turn = math.radians(yaw)
    assert abs(normals(scene) @ [math.cos(turn), math.sin(turn), 0]) == pytest.approx(1)
    assert np.ptp(scene.vertices[:, 2]) == pytest.approx(height)


def test_plate_yaw_turns_to_the_left():
    scene = ul.scenes.plate(1.0, 1.0, 3.0, 45)
    left = scene.vertices[np.argmax(scene.vertices[:, 1])]
    assert left[0] == pytest.approx(3 - math.sqrt(0.5) / 2)


@settings(deadline=None, max_examples=20)
@given(st.floats(0.05, 1.0), FAR)
def test_sphere_is_closed_and_nearly_full(radius, distance):
    scene = ul.scenes.sphere(radius_m=radius, distance_m=distance)
    body = mesh(scene)
    assert body.is_watertight
    assert body.volume == pytest.approx(4 / 3 * math.pi * radius**3, rel=0.01)
    assert np.linalg.norm(scene.vertices - [distance, 0, 0], axis=1) == pytest.approx(radius)
    assert body.edges_unique_length.max() <= 0.03
    assert scene.bounds == pytest.approx(
        np.array([[distance - radius, -radius, -radius], [distance + radius, *[radius] * 2]])
    )


def test_sphere_facets_stay_within_a_quarter_millimetre():
    for radius in (0.05, 0.3, 2.0):
        scene = ul.scenes.sphere(radius, 0.0)
        depth = radius - abs(np.einsum("fi,fi->f", normals(scene), scene.corners()[:, 0]))
        assert 0 < depth.max() <= 2.6e-4


def test_cylinder_is_closed_stands_and_tilts():
    upright = ul.scenes.cylinder(radius_m=0.2, height_m=1.0, distance_m=3.0)
    body = mesh(upright)
    assert body.is_watertight
    assert body.volume == pytest.approx(math.pi * 0.04, rel=0.005)
    assert upright.bounds == pytest.approx(np.array([[2.8, -0.2, -0.5], [3.2, 0.2, 0.5]]))
    lying = ul.scenes.cylinder(0.2, 1.0, 3.0, tilt_deg=90)
    assert lying.bounds == pytest.approx(np.array([[2.8, -0.5, -0.2], [3.2, 0.5, 0.2]]))


@given(SIZES, FAR, ANGLES)
def test_wire_tilts_about_the_line_of_sight(span, distance, tilt):
    scene = ul.scenes.wire(radius_m=0.001, length_m=span, distance_m=distance, tilt_deg=tilt)
    assert len(scene.faces) == 0
    assert len(scene.wires) == 1
    along = scene.wires.end[0] - scene.wires.start[0]
    assert np.linalg.norm(along) == pytest.approx(span)
    assert along[0] == pytest.approx(0, abs=1e-9)
    assert math.atan2(-along[1], along[2]) == pytest.approx(math.radians(tilt), abs=1e-6)
    assert (scene.wires.end[0] + scene.wires.start[0]) / 2 == pytest.approx([distance, 0, 0], abs=1e-9)


def test_wire_and_cylinder_tilt_the_same_way():
    thin = ul.scenes.cylinder(0.01, 1.0, 3.0, tilt_deg=30)
    line = ul.scenes.wire(0.01, 1.0, 3.0, tilt_deg=30)
    top = thin.vertices[thin.vertices[:, 2].argmax()]
    assert np.linalg.norm(top - line.wires.end[0]) < 0.011


def test_dihedral_sends_a_level_ray_back():
    scene = ul.scenes.dihedral(edge_m=0.3, distance_m=3.0)
    assert mesh(scene).area == pytest.approx(2 * 0.09)
    assert scene.bounds[1, 0] == pytest.approx(3.0)
    left, right = (normals(scene)[k] for k in (0, 2))
    assert left @ right == pytest.approx(0, abs=1e-12)
    for normal in (left, right):  # level, at 45 deg to the line of sight
        assert abs(normal[0]) == pytest.approx(math.sqrt(0.5))
        assert normal[2] == pytest.approx(0, abs=1e-12)


def test_trihedral_is_square_and_opens_toward_the_radar():
    scene = ul.scenes.trihedral(edge_m=0.3, distance_m=3.0)
    n = normals(scene)
    assert abs(n @ n.T) == pytest.approx(np.eye(3), abs=1e-12)
    assert abs(n[:, 0]) == pytest.approx(1 / math.sqrt(3))
    assert mesh(scene).area == pytest.approx(3 * 0.045)
    apex = scene.vertices[scene.vertices[:, 0].argmax()]
    assert apex == pytest.approx([3, 0, 0])
    others = scene.vertices[scene.vertices[:, 0] < 3 - 1e-9]
    assert np.linalg.norm(others - apex, axis=1) == pytest.approx(0.3)


def test_room_is_closed_named_and_holds_its_plate():
    scene = ul.scenes.room(size_m=(6, 4, 3), plate={"width_m": 0.5, "height_m": 0.4, "distance_m": 2.0, "yaw_deg": 20})
    names = [thing.name for thing in scene.objects]
    assert names == ["floor", "ceiling", "wall_north", "wall_south", "wall_east", "wall_west", "plate"]
    assert [scene.objects[i].material.name for i in (0, 6)] == ["concrete", "pec"]
    walls = scene.face_object < 6
    shell = trimesh.Trimesh(scene.vertices, scene.faces[walls], process=True)
    shell.merge_vertices()
    assert shell.is_watertight
    assert abs(shell.volume) == pytest.approx(72)
    assert scene.bounds == pytest.approx(np.array([[-3, -2, -1.5], [3, 2, 1.5]]))
    east = scene.face_object == scene.object("wall_east")
    assert scene.corners()[east][..., 0] == pytest.approx(3.0)
    centre = scene.corners().mean(1)
    inward = np.einsum("fi,fi->f", normals(scene)[walls], centre[walls])
    assert (inward < 0).all()


def test_tank_is_round_upright_and_open():
    tank = ul.scenes.tank(2.0, 1.5, strips=60)
    assert [o.name for o in tank.objects] == ["floor", "wall"]
    corners = tank.corners()
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    wall = tank.face_object == 1
    assert area[wall].sum() == pytest.approx(60 * 4 * np.sin(np.pi / 60) * 1.5)
    assert area[~wall].sum() == pytest.approx(30 * 4 * np.sin(2 * np.pi / 60))
    np.testing.assert_allclose(np.hypot(*tank.vertices[:, :2].T), 2.0)
    np.testing.assert_allclose(tank.bounds[:, 2], [0, 1.5])


def test_floor_lies_level():
    scene = ul.scenes.floor((4, 2), -1.2)
    assert scene.bounds == pytest.approx(np.array([[-2, -1, -1.2], [2, 1, -1.2]]))
    assert normals(scene)[:, 2] == pytest.approx(1)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: ul.scenes.plate(0, 1, 3), "plate: width_m"),
        (lambda: ul.scenes.plate(1, float("nan"), 3), "plate: height_m is nan"),
        (lambda: ul.scenes.plate(1, 1, float("inf")), "plate: distance_m is inf"),
        (lambda: ul.scenes.plate(1, 1, 3, "left"), "plate: yaw_deg is 'left'"),
        (lambda: ul.scenes.plate(1, 1, 3, material="cheese"), "no material 'cheese'"),
        (lambda: ul.scenes.sphere(-1, 3), "sphere: radius_m is -1"),
        (lambda: ul.scenes.sphere(1, 3, edge_m=1e-5), "sphere: edge_m"),
        (lambda: ul.scenes.cylinder(0.1, None, 3), "cylinder: height_m is None"),
        (lambda: ul.scenes.wire(0.001, True, 3), "wire: length_m is True"),
        (lambda: ul.scenes.dihedral(0.3, 3, opening_deg=190), "dihedral: opening_deg is 190"),
        (lambda: ul.scenes.trihedral([1], 3), "trihedral: edge_m"),
        (lambda: ul.scenes.room((6, 4)), "room: size_m"),
        (lambda: ul.scenes.room((6, 4, -3)), r"room: size_m\[2\] is -3"),
        (lambda: ul.scenes.room(plate={"width_m": 1}), "room: plate has no height_m"),
        (
            lambda: ul.scenes.room(plate={"width_m": 1, "height_m": 1, "distance_m": 2, "colour": 1}),
            "room: plate takes no 'colour'",
        ),
        (lambda: ul.scenes.room(plate={"width_m": 1, "height_m": 1, "distance_m": 3.5}), "reaches through a wall"),
        (lambda: ul.scenes.floor("ab"), "floor: size_m"),
        (lambda: ul.scenes.tank(0), "tank: radius_m is 0"),
        (lambda: ul.scenes.tank(strips=2), "tank: strips is 2"),
    ],
)
def test_bad_numbers_are_refused_by_name(call, words):
    with pytest.raises(ul.InputError, match=words) as error:
        call()
    assert "\n" not in str(error.value)


def test_unknown_scene_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'moon_base'"):
        _ = ul.scenes.moon_base
