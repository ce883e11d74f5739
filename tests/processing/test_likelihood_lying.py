"""Lying cylinders in the likelihood mapper: laws first, then flights in and past them."""

from itertools import pairwise

import numpy as np
import pytest
from test_likelihood import GRID, centres, flown, mapped, wall

import ullage as ul
from ullage.data import Trajectory
from ullage.ports.encode import surfaces_message
from ullage.processing.likelihood.lying import cuts, in_plane
from ullage.processing.likelihood.poses import delays
from ullage.processing.likelihood.surfaces import transported

RADIUS_M, HEIGHT_M = 1.8, 0.5  # of a tank along x, and of the flight over its axis


def seen(y, radius_m, height_m, *, far):
    """State of a tank along x from inside, at offsets y (n) from its axis: that of the near or the far side."""
    away = np.hypot(y, height_m)
    side = np.where((y > 0) ^ far, np.pi / 2, -np.pi / 2)
    turn = 1 if far else -1
    return np.stack([radius_m + turn * away, side, turn / away, np.abs(y) / away], axis=1)


def tank(radius_m, height_m):
    """Echoes of both sides of a tank along x, as `flown` takes them; its wall focuses."""

    def echo(at, *, far):
        away = np.hypot(at[:, 1], height_m)
        turn = 1 if far else -1
        across = -turn * at[:, 1] / away
        return radius_m + turn * away, np.stack([0 * across, across], axis=1), 0.4 * np.sqrt(radius_m / away)

    return lambda at: echo(at, far=False), lambda at: echo(at, far=True)


def zigzag():
    """A flight that crosses the axis again and again."""
    x, y = np.array([-2.0, -1.2, -0.4, 0.4, 1.2, 2.0]), 0.95
    corners = np.stack([x, np.where(np.arange(len(x)) % 2, y, -y)], axis=1)
    parts = [a + np.arange(0, 1, 0.06 / np.hypot(*(b - a)))[:, None] * (b - a) for a, b in pairwise(corners)]
    xy = np.concatenate(parts)
    quat = np.tile([0, 0, 0, 1.0], (len(xy), 1))
    return Trajectory(np.arange(len(xy)) * 120_000_000, np.column_stack([xy, 0 * xy[:, 0]]), quat)


@pytest.mark.parametrize("far", [False, True])
def test_a_state_moves_across_the_axis_by_the_law_of_a_level_cylinder(far):
    start, stop = np.array([0.9, 0.4, -0.7]), np.array([0.2, -0.6, -1.1])
    state, step = seen(start, RADIUS_M, HEIGHT_M, far=far), np.stack([[0.3, -2.0, 0.7], stop - start], axis=1)
    there = transported(state, step, np.ones(3, bool))
    behind = there[:, 3] < 0
    assert behind.tolist() == [False, True, False]
    there[behind, 1] += np.pi
    there[:, 3] = np.abs(there[:, 3])
    there[:, 1] = (there[:, 1] + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(there, seen(stop, RADIUS_M, HEIGHT_M, far=far), atol=1e-9)


@pytest.mark.parametrize("far", [False, True])
def test_rows_of_an_aperture_follow_the_same_law(far):
    rng = np.random.default_rng(1)
    offset = np.column_stack([rng.uniform(-0.3, 0.3, (20, 2)), np.zeros(20)])
    ((range_m, bearing, curvature, cosine),) = seen(np.array([0.6]), RADIUS_M, HEIGHT_M, far=far)
    unit = cosine * np.array([np.cos(bearing), np.sin(bearing), 0.0])
    got = delays(offset, unit, curvature, lying=True)
    true = seen(0.6 + offset[:, 1], RADIUS_M, HEIGHT_M, far=far)[:, 0] - range_m
    np.testing.assert_allclose(got, true, atol=1e-9)


def test_the_plane_cuts_a_tank_beside_its_specular_points():
    y = np.array([0.9, 0.3, -0.5])
    half = np.sqrt(RADIUS_M**2 - HEIGHT_M**2)
    turn = np.arccos(half / RADIUS_M)
    for far in (False, True):
        cut = cuts(seen(y, RADIUS_M, HEIGHT_M, far=far))
        np.testing.assert_allclose(cut.distance_m, half + (np.abs(y) if far else -np.abs(y)), atol=1e-9)
        elevation = np.arccos(np.abs(y) / np.hypot(y, HEIGHT_M))
        arc = RADIUS_M * (elevation + turn if far else elevation - turn)
        np.testing.assert_allclose(cut.arc_m, arc, atol=1e-6)


@pytest.mark.parametrize(("above_m", "meets"), [(0.2, True), (0.5, False)])
def test_a_level_pipe_is_cut_only_where_it_reaches_the_plane(above_m, meets):
    radius_m, beside_m = 0.3, 1.5
    away = np.hypot(beside_m, above_m)
    state = np.array([[away - radius_m, np.pi / 2, 1 / away, beside_m / away]])
    cut = cuts(state)
    assert np.isfinite(cut.arc_m[0]) == meets
    if meets:
        assert cut.distance_m[0] == pytest.approx(beside_m - np.sqrt(radius_m**2 - above_m**2))


def test_a_side_that_was_never_seen_near_the_plane_is_only_possible():
    steep = seen(np.array([0.1, 0.15, 0.2, 0.25]), 3.0, 0.4, far=False)
    got = in_plane(steep, np.ones(4, bool), 1.0, 3)
    assert not got.confirmed.any()
    assert got.possible[:4].all()


@pytest.fixture(scope="module")
def inside():
    """The mapper of a flight in a lying tank."""
    return mapped(flown(zigzag(), *tank(RADIUS_M, HEIGHT_M)))


def test_a_lying_tank_has_its_radius_and_axis(inside):
    found = max(inside.surfaces(), key=lambda one: one.seen)
    assert found.kind == "lying"
    range_m, bearing, curvature, cosine = found.state
    centre = 1 / curvature
    assert abs(range_m - centre) == pytest.approx(RADIUS_M, abs=0.05)
    assert abs(centre) * np.sqrt(1 - cosine**2) == pytest.approx(HEIGHT_M, abs=0.05)
    assert found.position[1] + centre * cosine * np.sin(bearing) == pytest.approx(0.0, abs=0.05)
    assert abs(np.cos(bearing)) < np.sin(np.radians(2.0))


def test_its_wall_stands_where_the_plane_cuts_it_and_nothing_is_free_beyond(inside):
    omap, half = inside.map(), np.sqrt(RADIUS_M**2 - HEIGHT_M**2)
    shown = centres(omap)
    off = np.abs(np.abs(shown[:, 1]) - half)
    assert np.percentile(off, 95) < 0.11
    assert off.max() < 0.2  # the first metre is drawn before the tank is known
    for side in (-1, 1):
        x = np.unique(shown[shown[:, 1] * side > 0, 0].round(2))
        assert x.min() < -1.2
        assert x.max() > 1.2
        assert len(x) > 0.9 * (x.max() - x.min()) / 0.1
    _, row = np.meshgrid(GRID.x_m, GRID.y_m)
    assert not omap.free[np.abs(row) > half + 0.06].any()
    assert omap.free[np.abs(row) < 0.8].mean() > 0.3


def test_surfaces_of_lying_tanks_are_sent(inside):
    omap = inside.map()
    found = next(one for one in omap.surfaces if one.on_map and one.kind == "lying")
    half = np.sqrt(RADIUS_M**2 - HEIGHT_M**2)
    assert np.median(np.abs(np.abs(found.points[:, 1]) - half)) < 0.1
    assert b"lying" in surfaces_message(omap, 0)


def test_an_upright_wall_is_no_lying_tank():
    omap = ul.map_occupancy(flown(zigzag(), wall(90, 2.2)), GRID, method="likelihood")
    assert [one.kind for one in omap.surfaces] == ["plane"]
