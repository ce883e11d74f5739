"""Tanks that only ranges tell: flown level, or in lanes along the axis far from the ends."""

from __future__ import annotations

import numpy as np
import pytest

import ullage as ul

LANES = ((-0.7, -0.5), (0.7, -0.4), (0.6, 0.5), (-0.65, 0.45), (0.1, 0.0))


def told_cells(scene, places) -> np.ndarray:
    """Centres (n, 3) of the cells that a flight through places (p, 3) tells to be occupied [m]."""
    path = ul.fly(ul.Waypoints(np.array(places, float), speed_m_s=0.5, stop=True, yaw="along"), rate_hz=12.5)
    frames = ul.simulate(scene, path, ul.Rig.preset("thesis-4"), seed=0, max_bounces=1)
    occupancy = ul.map_occupancy(frames, ul.Grid.covering(scene.bounds, 0.1, dims=3, margin_m=0.5), method="rules")
    cells = np.argwhere(occupancy.percent >= 50)[:, ::-1]
    return np.asarray(occupancy.grid.origin_m) + 0.1 * (cells + 0.5)


def round_share(cells: np.ndarray, off_m: np.ndarray, radius_m: float) -> tuple[float, float]:
    """Of cells about an axis (n, 2), the share on a circle, and the share of 10 degree sectors told."""
    on = abs(np.hypot(*off_m.T) - radius_m) < 0.15
    sectors = np.floor(np.degrees(np.arctan2(*off_m[on].T)) / 10)
    return float(on.mean()), len(np.unique(sectors)) / 36


@pytest.mark.slow
def test_a_level_round_tells_the_wall_of_a_small_tank():
    scene = ul.scenes.cylinder(2.5, 3.6, 0.0, material="steel", edge_m=0.1)
    loop = [(-0.9, -0.9, 0), (0.9, -0.85, 0.02), (0.9, 0.9, 0), (-0.95, 0.9, -0.02), (-0.9, -0.9, 0)]
    cells = told_cells(scene, loop)
    upright = cells[abs(cells[:, 2]) < 1.2]
    on, sectors = round_share(upright, upright[:, :2], 2.5)
    assert on > 0.98
    assert sectors > 0.7


@pytest.mark.slow
def test_lanes_tell_a_long_tank_far_from_its_ends():
    scene = ul.scenes.cylinder(1.6, 14.0, 0.0, 90.0, material="steel", edge_m=0.1)
    ends = [(5.6, -5.6) if k % 2 else (-5.6, 5.6) for k in range(len(LANES))]
    cells = told_cells(scene, [(x, y, z) for (x, z), there in zip(LANES, ends, strict=True) for y in there])
    middle = cells[abs(cells[:, 1]) < 2]
    on, sectors = round_share(middle, middle[:, [0, 2]], 1.6)
    assert on > 0.95
    assert sectors > 0.5, "what lies right above and below is out of the beam"


@pytest.mark.slow
@pytest.mark.parametrize("radius_m", [0.15, 0.025])
def test_a_pillar_and_a_pole_are_told_that_straight_legs_pass(radius_m):
    post = ul.scenes.cylinder(radius_m, 2.78, 0.3, material="steel", name="post")
    place = post.bounds.mean(axis=0)[:2]
    scene = ul.Scene.union([ul.scenes.room((6.0, 5.0, 2.8), material="concrete"), post])
    loop, heights = [(-1.7, -1.4), (1.7, -1.4), (1.7, 1.5), (-1.7, 1.5)], (-0.6, -0.2, 0.3, 0.6, 0.2, -0.3, -0.6)
    cells = told_cells(scene, [(*loop[k % 4], z) for k, z in enumerate(heights)])
    off = np.linalg.norm(cells[:, :2] - place, axis=1)
    near = cells[off < 0.6]
    assert len(near) > 8
    assert (abs(np.linalg.norm(near[:, :2] - place, axis=1) - radius_m) < 0.15).mean() > 0.95
    assert len(np.unique(np.round(near[:, 2], 1))) >= 7, "most of the heights that are flown"
