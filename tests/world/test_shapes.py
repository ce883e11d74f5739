"""Primitives: volume, area and bounds against formulas, closed, outward, on the surface."""

from math import pi

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from ullage.errors import InputError
from ullage.world import shapes


def closed(shape):
    """The mesh; each of its directed edges has exactly one opposite."""
    mesh = trimesh.Trimesh(*shape, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    return mesh


SOLIDS = {
    "box": (shapes.box((1, 2, 3)), 6.0, 22.0),
    "cylinder": (shapes.cylinder(0.5, 2, segment_m=0.02), pi * 0.25 * 2, 2 * pi * 0.25 + 2 * pi * 0.5 * 2),
    "cone": (shapes.cone(0.5, 1.2, segment_m=0.02), pi * 0.25 * 1.2 / 3, pi * 0.25 + pi * 0.5 * 1.3),
    "sphere": (shapes.sphere(0.7, edge_m=0.03), 4 / 3 * pi * 0.343, 4 * pi * 0.49),
    "capsule": (shapes.capsule(0.3, 1, segment_m=0.02), 4 / 3 * pi * 0.027 + pi * 0.09, 4 * pi * 0.09 + 2 * pi * 0.3),
    "tube": (shapes.tube(0.5, 0.4, 2, segment_m=0.02), pi * 0.09 * 2, 2 * pi * 0.09 + 2 * pi * 0.9 * 2),
    "half tube": (shapes.tube(0.5, 0.4, 2, segment_m=0.02, turn_rad=pi), pi * 0.09, pi * 0.09 + pi * 0.9 * 2 + 0.4),
    "extrusion": (
        shapes.extrude([[(0, 0), (4, 0), (4, 4), (0, 4)], [(1, 1), (3, 1), (3, 3), (1, 3)]], 0.5), 6.0, 24 + 12,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SOLIDS)
def test_solids_are_closed_outward_and_have_their_volume_and_area(name):
    shape, want_volume, want_area = SOLIDS[name]
    mesh = closed(shape)
    assert mesh.volume == pytest.approx(want_volume, rel=3e-3)
    assert mesh.area == pytest.approx(want_area, rel=3e-3)
    assert shape[0].dtype == np.float64
    assert shape[1].dtype == np.int32
    assert len(np.unique(shape[1])) == len(shape[0])


def test_bounds_are_exact():
    for name, half in {"cylinder": (0.5, 0.5, 1), "capsule": (0.3, 0.3, 0.8), "box": (0.5, 1, 1.5)}.items():
        np.testing.assert_allclose(SOLIDS[name][0][0].max(0), half, atol=1e-12)
        np.testing.assert_allclose(SOLIDS[name][0][0].min(0), np.negative(half), atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(st.floats(0.05, 20), st.floats(0.1, 1))
def test_sphere_vertices_lie_on_it_and_edges_stay_short(radius, part):
    vertices, faces = shapes.sphere(radius, edge_m=part * radius)
    np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), radius, rtol=1e-12)
    edges = np.linalg.norm(vertices[faces] - vertices[np.roll(faces, 1, axis=1)], axis=2)
    assert edges.max() <= max(part, 0.66) * radius * (1 + 1e-9)
    closed((vertices, faces))


def test_ellipsoid_vertices_lie_on_it():
    vertices, faces = shapes.ellipsoid((0.5, 1, 2), edge_m=0.1)
    np.testing.assert_allclose(((vertices / [0.5, 1, 2]) ** 2).sum(1), 1, rtol=1e-12)
    assert closed((vertices, faces)).volume == pytest.approx(4 / 3 * pi, rel=1e-2)


@pytest.mark.parametrize("radius", [0.02, 0.3, 4.0])
def test_the_sagitta_is_kept(radius):
    segment = shapes.sagitta_segment_m(radius, 2.5e-4)
    vertices, faces = shapes.cylinder(radius, 1, segment_m=segment)
    middle = (vertices[faces] + vertices[np.roll(faces, 1, axis=1)]) / 2
    outside = np.linalg.norm(vertices[faces][:, :, :2], axis=2).min(1) > radius / 2
    assert radius - np.linalg.norm(middle[outside][:, :, :2], axis=2).min() <= 2.5e-4 * 1.01


def test_plane_faces_its_normal():
    for normal in ((0, 0, 1), (0, 0, -2), (1, 1, 0), (0.2, -0.5, -0.9)):
        vertices, faces = shapes.plane((2, 3), normal=normal)
        a, b, c = (vertices[faces[:, k]] for k in range(3))
        cross = np.cross(b - a, c - a)
        up = np.asarray(normal) / np.linalg.norm(normal)
        np.testing.assert_allclose(cross / np.linalg.norm(cross, axis=1)[:, None], [up, up], atol=1e-12)
        assert trimesh.Trimesh(vertices, faces, process=False).area == pytest.approx(6)


def test_terrain_stands_right():
    heights = np.array([[0, 0, 5], [0, 0, 0.0]])  # the peak lies at +x, +y
    vertices, faces = shapes.terrain(heights, (2, 4))
    np.testing.assert_allclose(vertices[np.argmax(vertices[:, 2])], (1, 2, 5))
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: shapes.box((1, 0, 1)), "box size"),
        (lambda: shapes.cylinder(-1, 1, segment_m=0.1), "above zero"),
        (lambda: shapes.sphere(float("nan"), edge_m=0.1), "sphere radius"),
        (lambda: shapes.sphere(1e6, edge_m=0.01), "at most"),
        (lambda: shapes.cylinder(1e6, 1, segment_m=0.001), "at most"),
        (lambda: shapes.plane((1, 1), normal=(0, 0, 0)), "no direction"),
        (lambda: shapes.extrude([[(0, 0), (1, 1), (1, 0), (0, 1)]], 1), "crosses itself"),
        (lambda: shapes.extrude([[(0, 0), (1, 1)]], 1), "no area"),
        (lambda: shapes.tube(1, 2, 1, segment_m=0.1), "inner < outer"),
        (lambda: shapes.terrain(np.zeros((1, 5)), (1, 1)), "2 x 2"),
    ],
)
def test_nonsense_is_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()
