"""Coarse balls and domes echo as the spheres through their corners do, not as gratings of facets."""

from __future__ import annotations

import numpy as np
import pytest
from radar_worlds import dished

import ullage as ul
from ullage.geometry import C0, rpy_quat
from ullage.radar import physical, sphere_echoes
from ullage.radar.context import antenna_pair, radar_context, radar_frame
from ullage.radar.explain import explain
from ullage.radar.prepared import prepare
from ullage.world import shapes
from ullage.world.scene import Scene

SPEC = ul.RadarSpec.preset("x4m05")
EVEN = SPEC.but(antenna={"kind": "isotropic"})
TURN = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]


def bowl(level: float, edge_m: float = 0.1) -> tuple[Scene, float]:
    """What of a ball of 1 m about the origin lies below a level; where its rim runs."""
    vertices, faces = shapes.capsule(1.0, 1.0, segment_m=edge_m)
    vertices = vertices + np.array([0, 0, 0.5])
    below = vertices[faces][..., 2].max(1) < min(level, 1e-6) + 1e-6
    outline = float(vertices[faces[below]][..., 2].max())
    return Scene.of_mesh(vertices, faces[below], name="bowl", made_of="pec"), outline


def kirchhoff(eye: np.ndarray, outline: float, step: float = 0.004) -> complex:
    """Path gain over all of a ball of 1 m below a rim, point by point, both sides lit."""
    wave, total = 2 * np.pi * EVEN.center_hz / C0, 0j
    for angle in (np.arange(int(np.pi / step)) + 0.5) * np.pi / int(np.pi / step):
        count = max(int(2 * np.pi * np.sin(angle) / step), 8)
        around = (np.arange(count) + 0.5) * 2 * np.pi / count
        ring = np.sin(angle) * np.array([np.cos(around), np.sin(around), np.full(count, 1 / np.tan(angle))])
        out = ring.T @ TURN
        out = out[out[:, 2] <= outline]
        paths = out - eye
        far = np.linalg.norm(paths, axis=1)
        area = 2 * np.sin(angle) * np.sin(np.pi / int(np.pi / step) / 2) * 2 * np.pi / count
        total += (abs((paths * out).sum(1)) / far**3 * np.exp(-2j * wave * far)).sum() * area
    return complex(-1j / (4 * np.pi) * total)


@pytest.mark.parametrize(
    ("level", "eye"),
    [(1.0, (0.3, 0.2, 0.1)), (1.0, (0.6, -0.3, 0.5)), (1.0, (0.02, 0.01, 0.0)), (0.0, (0.3, 0.2, 0.1)),
     (0.0, (0.0, 0.0, 2.0)), (0.0, (0.3, 0.1, -2.0)), (-0.38, (0.02, 0.01, 0.0)), (-0.38, (0.3, 0.2, 1.5)),
     (-0.38, (0.6, -0.3, 0.5))],
)  # fmt: skip
def test_a_ball_or_a_bowl_is_what_the_integral_over_it_says(level, eye):
    scene, outline = (ul.scenes.sphere(1.0, 0.0, edge_m=0.15), 1.0) if level == 1 else bowl(level)
    here = ul.Trajectory.stationary(eye, n=1)
    mine, true = physical.path_gain_cw(scene, here, EVEN, edges=False)[0], kirchhoff(np.array(eye), outline)
    assert abs(mine - true) < 0.02 * abs(true)


def test_the_middle_of_a_ball_sends_back_no_more_than_was_sent():
    scene = ul.scenes.sphere(1.0, 0.0, edge_m=0.15)
    gains = [abs(physical.path_gain_cw(scene, ul.Trajectory.stationary((x, 0, 0), n=1), EVEN)[0])
             for x in (0.0, 1e-7, 1e-4, 2e-3)]  # fmt: skip
    assert max(gains) < 1
    assert np.ptp(gains[:3]) < 1e-3


@pytest.mark.parametrize(("distance_m", "most_db"), [(0.0, -55), (2.3, -55)])
def test_meshes_of_a_ball_are_one_ball(distance_m, most_db):
    places = np.array([[0.0, y, 0.1] for y in (0.1, 0.4, 0.6)])
    path = ul.Trajectory(np.arange(3) * 10**9, places, np.tile(rpy_quat(0, 0, 0), (3, 1)))
    coarse, fine = (physical.echoes(ul.scenes.sphere(1.0, distance_m, edge_m=edge), path, SPEC) for edge in (0.2, 0.06))
    assert 20 * np.log10((abs(coarse - fine).max(1) / abs(fine).max(1)).max()) < most_db  # -6 dB and more of facets


def test_between_its_near_wall_and_its_far_one_a_ball_is_silent():
    path = ul.Trajectory.stationary((1.1, 0.2, 0.1), n=1)
    found = abs(physical.echoes(ul.scenes.sphere(3.0, 0.0, edge_m=0.3), path, EVEN)[0])
    walls = 3 - np.linalg.norm([1.1, 0.2, 0.1]), 3 + np.linalg.norm([1.1, 0.2, 0.1])
    between = (SPEC.range_m > walls[0] + 0.4) & (SPEC.range_m < walls[1] - 0.4)
    assert found[between].max() < 1e-2 * found.max()


def test_which_surfaces_are_balls():
    def of(vertices: np.ndarray, faces: np.ndarray) -> list[tuple[float, int, bool]]:
        found = prepare(Scene.of_mesh(vertices, faces, name="thing", made_of="pec")).spheres
        return [
            (round(sphere.radius, 6), len(sphere.caps), bool(sphere.planar.any() or sphere.small.any()))
            for sphere in found
        ]

    sphere = shapes.sphere(1.0, edge_m=0.2)
    assert of(*sphere) == [(1.0, 0, True)]
    assert of(*shapes.capsule(0.7, 1.5, segment_m=0.1)) == [(0.7, 1, True)] * 2
    assert of(*shapes.cylinder(0.7, 1.5, segment_m=0.1)) == []
    assert of(*shapes.cylinder(2.0, 0.8, segment_m=0.1)) == []  # its rims lie on a ball
    assert of(*shapes.cone(2.0, 0.2, segment_m=0.1)) == []
    assert of(*shapes.ellipsoid((1.0, 1.0, 0.9), edge_m=0.1)) == []
    torn = np.delete(sphere[1], np.arange(0, len(sphere[1]), 50), 0)  # holes of all kinds: facets stay facets
    assert of(sphere[0], torn) == []


def test_where_a_head_goes_over_into_its_wall_there_is_no_edge():
    """Seen from the head the rims of the dome and of the wall cancel: what is left is that the wall bends less."""
    tank = Scene.of_mesh(*shapes.capsule(1.5, 3.0, segment_m=0.15), name="tank", made_of="pec")
    found = abs(physical.echoes(tank, ul.Trajectory.stationary((0.1, 0.15, 2.1), n=1), EVEN)[0])
    outline = (SPEC.range_m > 1.35) & (SPEC.range_m < 1.9)
    assert found[outline].max() < 3e-3 * found.max()


def test_the_crowns_of_dished_heads_are_found_and_the_wall_between_them():
    world = prepare(Scene.of_mesh(*dished(1.5, 3.0, 0.3, 1.0, steps=(14, 5)), name="vessel", made_of="pec"))
    outline = 3.0 * np.cos(np.arcsin(1.2 / 2.7))
    assert [sphere.radius for sphere in world.spheres] == pytest.approx([3.0, 3.0])
    assert [sphere.caps[0, 3] for sphere in world.spheres] == pytest.approx([-outline, -outline])
    (wall,) = world.quadrics
    assert (wall.radius, wall.high - wall.low) == pytest.approx((1.5, 2.0))


def test_all_facets_of_a_ball_are_done_and_no_others():
    capsule = Scene.of_mesh(*shapes.capsule(0.7, 1.5, segment_m=0.1), name="tank", made_of="pec")
    world = prepare(capsule)
    still, heads = world.still, world.spheres
    middles = still.planar.spheres[:, :3]
    assert np.array_equal(heads[0].planar | heads[1].planar, abs(middles[:, 2]) > 0.75)
    assert np.array_equal(heads[0].small | heads[1].small, abs(still.corners.mean(1)[:, 2]) > 0.75)
    assert not (heads[0].planar & heads[1].planar).any()


def test_what_stands_before_a_ball_hides_it():
    sphere, box = ul.scenes.sphere(1.0, 0.0, edge_m=0.15), ul.scenes.sphere(0.3, 0.0, edge_m=0.02)
    path = ul.Trajectory.stationary((0.0, 0.0, 0.0), n=1)
    context = radar_context(Scene.union([sphere, box]), SPEC)
    frame = radar_frame(context, antenna_pair(SPEC, path.position[0], np.eye(3)))
    assert sphere_echoes.accumulate_spheres(frame)[0] == []


@pytest.mark.filterwarnings("ignore:sphere")
def test_echoes_of_a_ball_add_up_to_the_frame():
    scene = ul.scenes.sphere(1.0, 0.0, edge_m=0.15)
    path = ul.Trajectory.stationary((0.3, 0.1, 0.0), n=1)
    frames = ul.simulate(scene, path, EVEN.but(noise=None))
    told = explain(frames, 0, count=None)
    total = sum(echo.samples for echo in told)
    assert abs(total - frames.samples[0]).max() < 1e-3 * abs(frames.samples[0]).max()
    near, far = 1 - np.hypot(0.3, 0.1), 1 + np.hypot(0.3, 0.1)
    loud = [echo.range_m for echo in told if echo.path_gain_db > told[0].path_gain_db - 25]
    assert sorted(loud) == pytest.approx([near, far], abs=0.02)
