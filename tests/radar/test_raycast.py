"""Rays against a plain float64 twin, far from the origin, at edges, on wires and on moving things."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ullage as ul
from ullage.data import Trajectory
from ullage.errors import InputError
from ullage.geometry import rpy_quat
from ullage.world.raycast import Raycaster
from ullage.world.scene import Scene
from ullage.world.shapes import box


def twin(corners, origin, direction):
    """Nearest of all triangles by Moeller and Trumbore's test, one ray at a time."""
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(direction, edge2)
    det = np.einsum("ni,ni->n", edge1, p)
    with np.errstate(all="ignore"):
        s = origin - corners[:, 0]
        u = np.einsum("ni,ni->n", s, p) / det
        q = np.cross(s, edge1)
        v = q @ direction / det
        t = np.einsum("ni,ni->n", edge2, q) / det
    t = np.where((abs(det) > 1e-14) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf)
    return int(np.argmin(t)) if np.isfinite(t.min()) else -1, t.min()


def soup(seed, count=60, size=2.0):
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-3, 3, (count, 1, 3)) + rng.uniform(-size, size, (count, 3, 3))
    return Scene.of_mesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), name="soup")


def directions(seed, n):
    d = np.random.default_rng(seed).normal(size=(n, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def test_agrees_with_the_plain_twin():
    scene, rays = soup(1), directions(2, 400)
    face, distance, cosine = Raycaster(scene).trace((0.1, -0.2, 0.3), rays)
    for i, ray in enumerate(rays):
        want, t = twin(scene.corners(), np.array([0.1, -0.2, 0.3]), ray)
        assert face[i] == want
        assert distance[i] == pytest.approx(t, abs=1e-12)
        if want >= 0:
            e = scene.corners()[want]
            n = np.cross(e[1] - e[0], e[2] - e[0])
            assert cosine[i] == pytest.approx(abs(n @ ray) / np.linalg.norm(n), abs=1e-12)
    assert 0 < np.sum(face >= 0) < 400


@pytest.mark.parametrize("shift", [(0, 0, 0), (500_000.0, -6_000_000.0, 100.0)])
def test_distance_is_exact_far_from_the_origin(shift):
    scene = ul.scenes.plate(width_m=2, height_m=2, distance_m=3.0)
    moved = Scene(scene.vertices + shift, scene.faces, scene.face_object, scene.objects)
    aim = np.array([[1.0, 0.02, 0.03]]) / np.linalg.norm([1.0, 0.02, 0.03])
    _, distance = Raycaster(moved).hits(np.asarray(shift, float), aim)
    assert distance[0] == pytest.approx(3.0 / aim[0, 0], abs=2e-9)


@given(seed=st.integers(0, 10_000), at=st.tuples(*[st.floats(-0.45, 0.45)] * 3))
@settings(max_examples=25, deadline=None)
def test_nothing_leaks_out_of_a_closed_box(seed, at):
    vertices, faces = box((1.0, 1.0, 1.0))
    caster = Raycaster(Scene.of_mesh(vertices, faces, name="box"))
    rays = directions(seed, 300)
    corner = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) - at
    rays = np.concatenate([rays, corner / np.linalg.norm(corner, axis=1, keepdims=True)])  # into the very corners
    face, distance = caster.hits(at, rays)
    assert (face >= 0).all()
    assert abs(abs(np.asarray(at) + distance[:, None] * rays).max(1) - 0.5).max() < 1e-6


def test_a_ray_along_a_face_or_from_it_is_neither_lost_nor_negative():
    scene = ul.scenes.plate(width_m=2, height_m=2, distance_m=3.0)
    caster = Raycaster(scene)
    for tilt in (1e-3, 1e-5, 1e-7):
        ray = np.array([[np.sin(tilt), 0.0, np.cos(tilt)]])
        _, distance = caster.hits((3.0 - 0.5 * np.tan(tilt), 0, -0.25), ray)
        assert np.isinf(distance[0]) or 0 <= distance[0] < 3
    _, distance = caster.hits((3.0, 0.3, 0.1), np.array([[1.0, 0, 0]]))
    assert np.isinf(distance[0]) or distance[0] == 0


def test_an_empty_scene_is_all_misses():
    caster = Raycaster(Scene.empty(), wires=True)
    face, distance = caster.hits((0, 0, 0), directions(0, 5))
    assert (face == -1).all()
    assert np.isinf(distance).all()
    assert np.isinf(caster.distances((0, 0, 0), directions(0, 5))).all()
    assert caster.visible((0, 0, 0), np.ones((2, 3))).all()
    assert len(caster.hits((0, 0, 0), np.zeros((0, 3)))[0]) == 0


def test_distances_and_visibility_follow_the_hits():
    scene, rays = soup(3), directions(4, 500)
    caster = Raycaster(scene)
    _, distance = caster.hits((0, 0, 0), rays)
    assert np.allclose(caster.distances((0, 0, 0), rays), distance, rtol=1e-5)
    hit = np.isfinite(distance)
    points = rays[hit] * distance[hit, None]
    assert caster.visible((0, 0, 0), points).all()
    assert not caster.visible((0, 0, 0), points * 1.01 + 0.0, slack_m=1e-4)[distance[hit] > 0.05].any()
    assert caster.visible(np.zeros_like(points), points * 0.99).all()


def test_wires_are_met_at_their_round_surface():
    scene = ul.scenes.wire(radius_m=0.05, length_m=2.0, distance_m=2.0)
    caster = Raycaster(scene, wires=True)
    offset = np.array([0.0, 0.02, -0.03, 0.046])
    start = np.stack([np.zeros(4), offset, np.full(4, 0.1)], 1)
    face, distance, cosine = caster.trace(start, np.tile([1.0, 0, 0], (4, 1)))
    depth = np.sqrt(0.05**2 - offset**2)
    assert (face == len(scene.faces)).all()
    assert distance == pytest.approx(2.0 - depth, abs=1e-9)
    assert cosine == pytest.approx(depth / 0.05, abs=1e-9)
    assert scene.objects[caster.owner[face[0]]].name
    assert np.isinf(Raycaster(scene).hits(start, np.tile([1.0, 0, 0], (4, 1)))[1]).all()


@pytest.mark.parametrize("radius", [1e-4, 2e-3, 0.05])
def test_as_many_rays_meet_a_wire_as_its_width_asks(radius):
    scene = ul.scenes.wire(radius_m=radius, length_m=1.0, distance_m=3.0)
    y = (np.arange(4001) - 2000) / 2000 * 2 * radius
    face, _ = Raycaster(scene, wires=True).hits(
        np.stack([np.zeros_like(y), y, np.zeros_like(y)], 1), np.tile([1.0, 0, 0], (len(y), 1))
    )
    assert np.mean(face >= 0) * 4 * radius == pytest.approx(2 * radius, rel=0.06)  # an octagon's width varies by 8 %


def test_the_end_of_a_pipe_is_closed():
    scene = Scene.of_wires([[2, 0, 0]], [[3, 0, 0]], 0.1, name="pipe")
    face, distance, cosine = Raycaster(scene, wires=True).trace((0, 0.03, 0), np.array([[1.0, 0, 0]]))
    assert face[0] == 0
    assert distance[0] == pytest.approx(2.0, abs=1e-5)
    assert cosine[0] == pytest.approx(1.0)


def sliding(scene, speed=1.0):
    t = np.arange(0, 11) * 100_000_000
    way = np.stack([speed * t * 1e-9, 0 * t, 0 * t], 1)
    turn = rpy_quat(0, 0, 0.2 * t * 1e-9)
    thing = scene.objects[0]
    moving = type(thing)(thing.name, thing.material, Trajectory(t, way, turn))
    return Scene(scene.vertices, scene.faces, scene.face_object, (moving,))


def test_a_moving_object_is_met_where_it_is_at_each_rays_time():
    scene = sliding(ul.scenes.plate(width_m=1, height_m=1, distance_m=3.0))
    caster = Raycaster(scene)
    assert caster.moving
    rays = directions(5, 200)
    rays[:, 0] = abs(rays[:, 0]) + 3
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    times = np.random.default_rng(6).integers(0, 1_000_000_000, 200)
    face, distance, _ = caster.trace((0, 0, 0), rays, t_ns=times)
    for i in range(200):
        want, t = twin(scene.corners(int(times[i])), np.zeros(3), rays[i])
        assert (face[i] >= 0) == (want >= 0)
        assert distance[i] == pytest.approx(t, abs=1e-9)
    still = Raycaster(scene).standing(scene.poses(700_000_000))
    assert np.array_equal(still.hits((0, 0, 0), rays)[1], caster.hits((0, 0, 0), rays, t_ns=700_000_000)[1])
    assert not still.visible((0, 0, 0), [[4.5, 0, 0]])[0]
    assert still.visible((0, 0, 0), [[3.5, 0, 0]])[0]


def test_the_nearer_of_still_and_moving_things_is_met():
    moving = sliding(ul.scenes.plate(width_m=1, height_m=1, distance_m=2.5))  # 2.5 m at first, 3.5 m after a second
    caster = Raycaster(Scene.union([ul.scenes.plate(width_m=9, height_m=9, distance_m=3.0), moving]))
    face, distance = caster.hits((0, 0, 0), np.tile([1.0, 0, 0], (2, 1)), t_ns=[0, 1_000_000_000])
    assert distance == pytest.approx([2.5, 3.0])
    assert list(caster.owner[face]) == [1, 0]


def test_threads_share_one_caster():
    caster, rays = Raycaster(soup(7), wires=True), directions(8, 20_000)
    alone = caster.hits((0, 0, 0), rays)[1]
    with ThreadPoolExecutor(4) as pool:
        parts = list(pool.map(lambda k: caster.hits((0, 0, 0), rays[k : k + 1000])[1], range(0, 20_000, 1000)))
    assert np.array_equal(np.concatenate(parts), alone)


def test_directions_of_the_wrong_shape_are_refused():
    with pytest.raises(InputError, match=r"directions have shape \(3,\)"):
        Raycaster(soup(1)).hits((0, 0, 0), np.array([1.0, 0, 0]))
