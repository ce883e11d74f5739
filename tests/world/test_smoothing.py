"""Corner normals of bare triangles: true on curved surfaces, none across creases, and no facet bent that is flat."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from ullage.arrays import Floats, Ints
from ullage.world import point_normal, shapes, smoothing
from ullage.world.materials import material
from ullage.world.scene import SceneObject

AUTO = smoothing.creases([SceneObject("thing", material("pec"))])


def bent(mesh: tuple[Floats, Ints]) -> tuple[Floats, Floats, Floats]:
    """Corners, corner normals and displacements of a mesh whose vertices are welded."""
    vertices, faces = mesh
    corners, ids = np.asarray(vertices, float)[faces], np.asarray(faces, np.int64)
    found = smoothing.hinges(corners, ids, np.zeros(len(faces), np.int32), AUTO)
    normals = smoothing.corner_normals(corners, found)
    return corners, normals, point_normal.displacements(corners, normals, found)


def strip(profile: list[tuple[float, float]], width_m: float = 1.0) -> tuple[Floats, Ints]:
    """Quads between the points of a profile, spread over y."""
    x, z = np.array(profile, float).T
    line = np.stack([x, np.zeros(len(x)), z], 1)
    vertices = np.concatenate([line, line + np.array([0, width_m, 0])])
    k, n = np.arange(len(x) - 1), len(x)
    faces = np.concatenate([np.stack([k, k + 1, k + n], 1), np.stack([k + 1, k + n + 1, k + n], 1)])
    return vertices, faces.astype(np.int32)


def arc(count: int, *, turn_deg: float = 90.0, radius_m: float = 0.02) -> list[tuple[float, float]]:
    angle = np.deg2rad(np.linspace(0, turn_deg, count + 1))
    return [(radius_m * np.sin(a), radius_m * np.cos(a)) for a in angle]


def test_normals_of_a_ball_are_exact():
    corners, normals, _ = bent(shapes.sphere(0.3, edge_m=0.15))
    assert np.allclose(normals, corners / 0.3, atol=1e-9)


def test_pieces_of_a_ball_lie_on_it():
    corners, _, control = bent(shapes.sphere(0.3, edge_m=0.15))
    pieces, of, _ = point_normal.cut(corners, control, np.full(len(corners), 8))
    assert len(pieces) == 64 * len(corners)
    assert np.array_equal(np.bincount(of), np.full(len(corners), 64))
    assert abs(np.linalg.norm(pieces.mean(1), axis=1) - 0.3).max() < 5e-4  # facets: 14 mm
    a, b, c = pieces.transpose(1, 0, 2)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 == pytest.approx(4 * np.pi * 0.09, rel=3e-3)


@pytest.mark.parametrize("mesh", [
    shapes.box((1, 2, 3)),
    trimesh.creation.box((1, 1, 1)).subdivide().subdivide(),
    trimesh.creation.cylinder(0.3, 1.0, sections=8),
    trimesh.creation.icosahedron(),
], ids=["box", "cut box", "octagonal prism", "icosahedron"])  # fmt: skip
def test_a_body_with_edges_keeps_its_facets(mesh):
    mesh = (mesh.vertices, mesh.faces) if isinstance(mesh, trimesh.Trimesh) else mesh
    corners, normals, control = bent(mesh)
    flat = smoothing.face_normals(corners)[0]
    assert np.allclose(normals, flat[:, None], atol=1e-12)
    assert abs(control).max() < 1e-12


def test_a_bay_window_is_not_round():
    turn = np.deg2rad([-25, 0, 25])
    line = np.cumsum(np.concatenate([[(0, 0)], np.stack([np.cos(turn), -np.sin(turn)], 1)]), 0)
    assert abs(bent(strip([tuple(p) for p in line]))[2]).max() < 1e-12


def test_a_zigzag_stays_one():
    profile = [(0.1 * k, 0.015 * (k % 2)) for k in range(20)]
    assert abs(bent(strip(profile))[2]).max() < 1e-12


def test_a_plate_with_a_rounded_edge_stays_flat_and_its_edge_is_round():
    rounded = arc(4)
    corners, normals, control = bent(strip([(-1.0, 0.02), *rounded, *[(0.02, -0.3 * k) for k in (1, 2, 3, 4)]]))
    plate = corners[..., 0].min(1) < -0.5
    assert np.allclose(normals[plate], [0, 0, 1], atol=1e-9)
    assert abs(control[plate]).max() < 1e-12
    round_ = (corners[..., 0].min(1) > -1e-9) & (corners[..., 2].min(1) > -1e-9)
    middles = corners[round_][:, :, [0, 2]] / 0.02
    assert np.allclose(normals[round_][..., [0, 2]], middles, atol=1e-6)
    assert point_normal.sagitta(control[round_]).min() == pytest.approx(0.02 * (1 - np.cos(np.pi / 16)), rel=0.02)


def test_a_cone_is_straight_along_and_round_across():
    cone = trimesh.creation.cone(0.3, 0.6, sections=32)
    corners, _, control = bent((cone.vertices, cone.faces))
    pieces, of, _ = point_normal.cut(corners, control, np.full(len(corners), 4))
    wall = corners[..., 2].max(1) > 0.5
    middles = pieces[wall[of]].mean(1)
    away, height = np.hypot(middles[:, 0], middles[:, 1]), middles[:, 2]
    assert abs(away - 0.3 * (1 - height / 0.6)).max() < 4e-4  # facets: 1.4 mm
    assert abs(control[~wall]).max() < 1e-12


def test_normals_given_count_where_the_facets_agree():
    vertices, faces = shapes.sphere(0.3, edge_m=0.15)
    corners, ids = vertices[faces], faces.astype(np.int64)
    found = smoothing.hinges(corners, ids, np.zeros(len(faces), np.int32), AUTO)
    tilted = corners / 0.3 + [0.1, 0.0, 0.0]
    tilted /= np.linalg.norm(tilted, axis=2, keepdims=True)
    assert np.array_equal(smoothing.corner_normals(corners, found, tilted), tilted)
    wrong = np.broadcast_to([0.0, 0.0, 1.0], corners.shape)
    mixed = smoothing.corner_normals(corners, found, wrong)
    near = corners[..., 2] / 0.3 > np.cos(np.deg2rad(smoothing.GIVEN_DEG))
    assert np.array_equal(mixed[near], wrong[near])
    assert np.allclose(mixed[~near], corners[~near] / 0.3, atol=1e-9)


def test_facets_beside_a_known_shape_take_its_normals_where_they_continue_it():
    vertices, faces = shapes.sphere(0.3, edge_m=0.15)
    corners, ids = vertices[faces], faces.astype(np.int64)
    found = smoothing.hinges(corners, ids, np.zeros(len(faces), np.int32), AUTO)
    for tilt, taken in ((0.1, True), (0.9, False)):
        truth = corners / 0.3 + [tilt, 0.0, 0.0]
        truth /= np.linalg.norm(truth, axis=2, keepdims=True)
        upper = (corners[..., 2] > -1e-9).all(1)
        known = np.where(upper[:, None, None], truth, 0.0)
        normals = smoothing.corner_normals(corners, found, known=known)
        beside = ~upper[:, None] & np.isin(ids, ids[upper])
        assert beside.any()
        assert np.allclose(normals[beside], truth[beside]) == taken
        assert np.allclose(normals[~np.isin(ids, ids[upper])], corners[~np.isin(ids, ids[upper])] / 0.3, atol=1e-9)


def test_rims_of_patches_follow_the_circle_that_they_sample():
    turn = np.arange(12) * np.pi / 6
    outline = 0.3 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1)
    ids = np.stack([np.arange(12), (np.arange(12) + 1) % 12, np.full(12, 12)], 1)
    corners = np.concatenate([outline, np.zeros((1, 3))])[ids]
    control = np.zeros((12, 7, 3))
    point_normal.follow_rims(control, corners, ids, np.arange(12), np.zeros(12, np.int64))
    share = np.linspace(0, 1, 9)
    side = np.stack([1 - share, share, 0 * share], 1)
    points = np.einsum("pc,fci->fpi", side, corners) + point_normal.rise(control, side)
    assert np.linalg.norm(points, axis=2) == pytest.approx(np.full((12, 9), 0.3), abs=2e-6)  # chords: 10 mm


@pytest.mark.parametrize("seed", range(3))
def test_no_mesh_is_too_broken(seed):
    rng = np.random.default_rng(seed)
    vertices, faces = shapes.sphere(0.3, edge_m=0.1)
    faces = faces.copy()
    flipped = rng.random(len(faces)) < 0.2
    faces[flipped] = faces[flipped][:, ::-1]
    faces = faces[rng.random(len(faces)) < 0.9]  # holes
    faces = np.concatenate([faces, faces[:40], rng.integers(0, len(vertices), (60, 3))])  # twice, fins, no area
    corners, normals, control = bent((vertices, faces.astype(np.int32)))
    assert np.isfinite(normals).all()
    assert np.isfinite(control).all()
    longest = np.linalg.norm(np.roll(corners, -1, 1) - corners, axis=2).max(1)
    assert (point_normal.sagitta(control) <= 0.15 * longest + 1e-12).all()
