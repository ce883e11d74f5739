"""Walls beyond the unambiguous range, told from near ones by pulse intervals that alternate."""

from functools import cache

import numpy as np
import pytest

import ullage as ul

ENDS_M, SIDES_M = 15.0, 4.0
SCENE = ul.scenes.room(size_m=(2 * ENDS_M, 2 * SIDES_M, 4), material="concrete")


@cache
def flown(stagger_div, climb_m=0.0):
    """A flight along the middle: both ends of the hall are farther than an X4 can tell, 9.87 m."""
    rig = ul.Rig.preset("thesis-4", radar=ul.RadarSpec.preset("x4m05", stagger_div=stagger_div))
    path = ul.Trajectory.line((1, 0.5, -climb_m / 2), (4, -0.5, climb_m / 2), speed_m_s=0.5, rate_hz=10)
    return ul.simulate(SCENE, path, rig, seed=3)


def plane():
    return ul.Grid.covering(SCENE.bounds, 0.1, z_m=0.0)


def ends(omap):
    """Distances along the hall of the surfaces of many echoes across it [m]."""
    points = [
        one.points.mean(axis=0) for one in omap.surfaces if one.seen >= 15 and abs(one.normals[:, 0].mean()) > 0.9
    ]
    return sorted(float(point[0]) for point in points)


def test_alternating_intervals_show_walls_beyond_them_where_they_are():
    omap = ul.map_occupancy(flown(17), plane(), method="ullage")
    found = ends(omap)
    assert found[0] == pytest.approx(-ENDS_M, abs=0.05)
    assert found[-1] == pytest.approx(ENDS_M, abs=0.1)
    assert len(found) == 2
    quality = ul.metrics.map_quality(omap, SCENE, flown(17))
    assert quality["f1"].value > 0.94
    assert quality["false_occupied"].value <= 2
    assert quality["surface_declared_free"].value < 0.002


def test_one_interval_leaves_them_folded():
    """Why the test above can fail: the same flight with one interval has a wall in the middle of the hall."""
    assert any(abs(place) < ENDS_M - 5 for place in ends(ul.map_occupancy(flown(None), plane(), method="ullage")))


@pytest.mark.parametrize("lost", ["the first", "every fifth", "some"])
def test_lost_frames_do_not_confuse_the_intervals(lost):
    frames = flown(17)
    count = len(frames["front"])
    rows = np.arange(count)
    rng = np.random.default_rng(5)
    kept = {"the first": rows[1:], "every fifth": rows[rows % 5 != 2], "some": rows[rng.random(count) > 0.2]}[lost]
    found = ends(ul.map_occupancy({name: part[kept] for name, part in frames.items()}, plane(), method="ullage"))
    assert found
    assert found[0] == pytest.approx(-ENDS_M, abs=0.1)
    assert found[-1] == pytest.approx(ENDS_M, abs=0.1)


def test_radars_that_start_with_different_intervals_agree():
    """Which interval a radar's first frame has is found from its echoes."""
    frames = {name: part[1:] if name == "front" else part[:-1] for name, part in flown(17).items()}
    found = ends(ul.map_occupancy(frames, plane(), method="ullage"))
    assert found[0] == pytest.approx(-ENDS_M, abs=0.1)
    assert found[-1] == pytest.approx(ENDS_M, abs=0.1)


def test_a_volume_knows_them_too():
    grid = ul.Grid.covering(SCENE.bounds, 0.2, dims=3)
    omap = ul.map_occupancy(flown(17, 1.0), grid, method="ullage")
    path = flown(17, 1.0)["front"].believed.position
    away = [
        float(np.linalg.norm(one.points.mean(axis=0) - path.mean(axis=0)))
        for one in omap.surfaces
        if one.seen >= 30 and abs(one.normals[:, 0].mean()) > 0.85
    ]
    assert len(away) == 2
    assert min(away) > 10.5
