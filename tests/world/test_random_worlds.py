"""Random worlds and flights: the same for the same seed, clear of everything, closed where they should be."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

import ullage as ul
from ullage.errors import InputError
from ullage.world.library import WORLDS
from ullage.world.random_worlds import plan
from ullage.world.raycast import Raycaster

SEEDS = (0, 1)


def surface_points(scene: ul.Scene, count: int = 20_000) -> np.ndarray:
    """Points spread over all triangles (count, 3) [m]."""
    corners = scene.corners()
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    rng = np.random.default_rng(0)
    face = rng.choice(len(corners), count, p=area / area.sum())
    weight = rng.dirichlet((1, 1, 1), count)
    return np.einsum("pk,pkx->px", weight, corners[face])


@pytest.mark.parametrize("kind", ul.worlds.KINDS)
def test_a_flight_keeps_clear_of_the_world_it_is_drawn_for(kind):
    for seed in SEEDS:
        tree = cKDTree(surface_points(ul.worlds.random(kind, seed)))
        for volume in (False, True):
            path = ul.worlds.flight(kind, seed, volume=volume)
            assert tree.query(path.position)[0].min() > 0.2, (kind, seed, volume)


@pytest.mark.parametrize("kind", ["web-frames", "tunnel"])
def test_every_seed_leaves_a_way_from_end_to_end(kind):
    for seed in range(20):
        made = plan(kind, seed)
        area, whole = made.open_area.buffer(-0.7), made.footprint.buffer(-0.7)
        assert area.geom_type == "Polygon", seed  # the openings of all web frames join the bays
        assert area.bounds == pytest.approx(whole.bounds)
        assert len(ul.worlds.flight(kind, seed)) > 50


@pytest.mark.parametrize("kind", ul.worlds.KINDS)
def test_frames_lie_two_to_ten_centimetres_apart(kind):
    for seed in SEEDS:
        path = ul.worlds.flight(kind, seed)
        steps = np.linalg.norm(np.diff(path.position[:, :2], axis=0), axis=1)
        assert 0.015 < np.median(steps) < 0.11
        assert steps.sum() > 6.0


@pytest.mark.parametrize("kind", sorted(set(ul.worlds.KINDS) - {"open"}))
def test_a_closed_world_has_no_way_out(kind):
    for seed in SEEDS:
        scene, path = ul.worlds.random(kind, seed), ul.worlds.flight(kind, seed)
        ray = np.random.default_rng(seed).normal(size=(4000, 3))
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        eye = np.repeat(path.position[len(path) // 2][None], len(ray), 0)
        distance = Raycaster(scene).distances(eye, ray)
        assert np.isfinite(distance).all(), kind


def test_an_open_world_lets_rays_out():
    scene, path = ul.worlds.random("open", 0), ul.worlds.flight("open", 0)
    turn = np.linspace(0, 2 * np.pi, 72)
    ray = np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1)
    distance = Raycaster(scene).distances(np.repeat(path.position[:1], len(ray), 0), ray)
    assert 0.1 < np.isfinite(distance).mean() < 0.95


@pytest.mark.parametrize("kind", ["machines", "office"])
def test_the_same_seed_gives_the_same_world_and_another_seed_another(kind):
    first, path = ul.worlds.random(kind, 5), ul.worlds.flight(kind, 5)
    for seed in range(20, 32):  # others, so that nothing of the first is kept
        ul.worlds.random(kind, seed)
    again = ul.worlds.random(kind, 5)
    assert np.array_equal(first.vertices, again.vertices)
    assert [thing.name for thing in first.objects] == [thing.name for thing in again.objects]
    assert np.array_equal(path.position, ul.worlds.flight(kind, 5).position)
    other = ul.worlds.random(kind, 6)
    assert first.vertices.shape != other.vertices.shape or not np.allclose(first.vertices, other.vertices)


def test_a_flight_through_a_volume_changes_height():
    level, climbing = (ul.worlds.flight("hopper", 1, volume=volume) for volume in (False, True))
    assert np.ptp(level.position[:, 2]) < 0.1
    assert np.ptp(climbing.position[:, 2]) > 0.5
    assert np.array_equal(level.position[:, :2], climbing.position[:, :2])


def test_tuning_and_testing_share_no_kind():
    assert not set(ul.worlds.TUNING) & set(ul.worlds.TESTING)
    assert set(ul.worlds.KINDS) == {*ul.worlds.TUNING, *ul.worlds.TESTING}


@pytest.mark.parametrize(("kind", "seed", "words"), [
    ("rooom", 0, "did you mean 'room'"), ("", 0, "no kind of world"),
    ("room", -1, "seed is -1"), ("room", 1.5, "seed is 1.5"),
])  # fmt: skip
def test_what_cannot_be_drawn_is_refused_in_one_line(kind, seed, words):
    with pytest.raises(InputError, match=words):
        ul.worlds.random(kind, seed)


def test_a_world_file_varies_in_materials_and_objects_and_keeps_its_shape():
    file = str(WORLDS["ntnu-room"].path)
    scene, plain = ul.worlds.random(file, 1), ul.load_scene(file)
    path = ul.worlds.flight(file, 1)
    assert np.array_equal(scene.vertices[: len(plain.vertices)], plain.vertices)
    assert [thing.material.name for thing in scene.objects] != [thing.material.name for thing in plain.objects]
    assert cKDTree(surface_points(scene)).query(path.position)[0].min() > 0.2
    assert not np.array_equal(path.position, ul.worlds.flight(file, 2).position)
