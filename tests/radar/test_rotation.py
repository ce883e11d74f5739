"""A world and the radar in it, turned together: nothing that the radar receives may depend on the world's axes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ullage as ul
from ullage.radar.physical import echoes
from ullage.world.library import WORLDS

RADAR = ul.RadarSpec.preset("x4m05", noise=None)


def turned(scene: ul.Scene, path: ul.Trajectory, seed: int) -> tuple[ul.Scene, ul.Trajectory]:
    """Both after one random rotation and a shift."""
    turn, shift = Rotation.random(random_state=seed), np.array([0.3, -0.2, 0.1]) * seed
    wires = scene.wires
    ends = {name: turn.apply(getattr(wires, name)) + shift for name in ("start", "end") if len(wires)}
    return (
        replace(scene, vertices=turn.apply(scene.vertices) + shift, wires=replace(wires, **ends)),
        replace(
            path,
            position=turn.apply(path.position) + shift,
            quat_xyzw=(turn * Rotation.from_quat(path.quat_xyzw)).as_quat(),
        ),
    )


def poses_in(scene: ul.Scene, count: int, seed: int = 3) -> ul.Trajectory:
    """Random poses in the middle of a scene."""
    rng, (low, high) = np.random.default_rng(seed), scene.bounds
    position = low + (high - low) * (0.2 + 0.6 * rng.random((count, 3)))
    angles = np.column_stack([rng.uniform(-180, 180, count), rng.uniform(-20, 20, count), np.zeros(count)])
    quat = Rotation.from_euler("zyx", angles, degrees=True).as_quat()
    none = np.zeros((count, 3))
    return ul.Trajectory(np.arange(count) * 10**7, position, quat, none, none)


def change_db(name: str, seeds: range, count: int, bounces: int) -> np.ndarray:
    """By how much frames change when all is turned, over the highest sample of each frame [dB]."""
    scene = ul.load_scene(WORLDS[name].path)
    path = poses_in(scene, count)
    still = echoes(scene, path, RADAR, max_bounces=bounces)
    out = [abs(echoes(*turned(scene, path, seed), RADAR, max_bounces=bounces) - still).max(1) for seed in seeds]
    return np.asarray(20 * np.log10(np.array(out) / abs(still).max(1) + 1e-12))


def test_turning_the_world_changes_no_sample():
    """Ties are the danger: shares of zones, lines through corners, edges that touch, things as large as each other.

    The oracle `turned_worlds` turns the hold and the plate.
    """
    assert change_db("cluttered-room", range(1, 2), 3, 3).max() < -60


@pytest.mark.parametrize("bounces", [1, 2])
def test_turning_triangles_at_the_end_of_the_frame_changes_no_sample(bounces):
    """What lies just beyond the gate folds to the start of the frame, or not; the world's axes must not decide that."""
    rng = np.random.default_rng(5)
    corners = rng.normal([9.9, 0.0, 0.0], [0.2, 1.0, 1.0], (400, 1, 3)) + rng.normal(0, 0.04, (400, 3, 3))
    cloud = ul.scenes.plate(1, 1, 1)
    faces = np.arange(1200, dtype=np.int32).reshape(-1, 3)
    cloud = replace(cloud, vertices=corners.reshape(-1, 3), faces=faces, face_object=np.zeros(400, np.int32))
    floor = ul.scenes.plate(16, 16, 1.5, name="floor")
    floor = replace(floor, vertices=Rotation.from_euler("y", 90, degrees=True).apply(floor.vertices))
    scene, path = ul.Scene.union([cloud, floor]), ul.Trajectory.stationary((0, 0, 0), 0.0, 1)
    still = echoes(scene, path, RADAR, max_bounces=bounces)
    for seed in (1, 2, 3):
        change = abs(echoes(*turned(scene, path, seed), RADAR, max_bounces=bounces) - still)
        assert 20 * np.log10(change.max() / abs(still).max() + 1e-12) < -100


OPEN = pytest.mark.xfail(strict=True, reason="-77 dB at one bounce: a plate's echo beside bars that stand on it")


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param(n, marks=OPEN if n == "ballast-tank" else ()) for n in sorted(WORLDS)])
def test_turning_any_shipped_world_changes_no_sample(name):
    assert change_db(name, range(1, 4), 16, 1).max() < -80
    change = change_db(name, range(1, 4), 16, 3)
    assert np.median(change) < -80
    # in 1 of 48 poses a ray to one piece passes an edge 0.2 um from it, which Embree's single precision cannot tell
    assert change.max() < (-50 if name == "cluttered-room" else -60)
