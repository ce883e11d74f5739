"""The vehicle meets the world: it is stopped, told of, and refused a place inside it."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.optimize import minimize

import ullage as ul
from ullage.flight.airframe import airframe
from ullage.flight.obstacles import Solids, bodies
from ullage.flight.vehicle import Collision, fly_log
from ullage.kernels.proximity import nearest_points
from ullage.world.scene import Scene
from ullage.world.shapes import box, sphere

HECTOR = airframe("hector")


def _wall(x, *, half=3.0, cells=1, name="wall"):
    """A sheet across the way, of 2 cells^2 triangles."""
    edge = np.linspace(-half, half, cells + 1)
    y, z = np.meshgrid(edge, edge, indexing="ij")
    vertices = np.stack([np.full(y.size, x), y.ravel(), z.ravel()], axis=1)
    i = np.arange(y.size).reshape(y.shape)
    quads = np.stack([i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]], axis=-1).reshape(-1, 4)
    return Scene.of_mesh(vertices, np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]]).astype(np.int32), name=name)


def _block(centre, size, name="block"):
    vertices, faces = box(size)
    return Scene.of_mesh(vertices + np.asarray(centre), faces, name=name)


@pytest.mark.parametrize(("speed", "cells"), [(0.5, 1), (0.5, 24), (3.0, 1)])
def test_a_wall_stops_the_vehicle_and_is_reported_with_place_and_time(speed, cells):
    way = ul.Waypoints([(0, 0, 0), (4, 0, 0)], speed, yaw=0.0, acceleration_m_s2=3.0)
    with pytest.warns(ul.UllageWarning, match=r"hit 'wall' at t = .* s at \(2\.0"):
        flown, log = fly_log(way, scene=_wall(2.0, cells=cells), rate_hz=250)
    tip = flown.position[:, 0] + HECTOR.radius_m
    # Pressed on, it may end flat against the wall, but never in it.
    assert flown.position[:, 0].max() < 2.0 - 0.95 * min(HECTOR.core_m) / 2
    first = log.contacts[0]
    assert first.object == "wall"
    assert first.point[0] == pytest.approx(2.0, abs=0.02)
    reached = flown.t_ns[np.argmax(tip > 1.99)]
    assert first.t_ns == pytest.approx(reached, abs=0.05e9)
    assert first.speed_m_s == pytest.approx(speed, rel=0.15)
    assert first.until_ns >= first.t_ns


def test_a_hit_can_end_the_flight():
    with pytest.raises(Collision, match="hit 'wall' at t ="):
        ul.fly([(0, 0, 0), (4, 0, 0)], scene=_wall(2.0), on_contact="raise")


def test_a_clear_flight_is_the_same_bits_with_and_without_the_world():
    points = [(0, 0, 0), (1.2, 0, 0), (1.2, 1, 0)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        among, log = fly_log(points, scene=_wall(1.75, cells=8))
    assert not log.contacts
    np.testing.assert_allclose(among.position, ul.fly(points).position, atol=1e-12)


def test_a_wire_is_hit():
    wire = Scene.of_wires(np.array([[1.5, -2, 0.03]]), np.array([[1.5, 2, 0.03]]), 0.0015, name="stay")
    with pytest.warns(ul.UllageWarning, match="'stay'"):
        flown, log = fly_log(ul.Waypoints([(0, 0, 0), (3, 0, 0)], yaw=0.0), scene=wire)
    assert log.contacts[0].point[0] == pytest.approx(1.5, abs=0.02)
    assert flown.position[np.searchsorted(flown.t_ns, log.contacts[0].t_ns) - 1, 0] < 1.5 - HECTOR.radius_m + 0.05


def test_a_falling_vehicle_lands_on_the_floor():
    floor = _wall(0.0, half=5)
    turned = Scene.of_mesh(floor.vertices[:, [1, 2, 0]], floor.faces, name="floor")
    dead = HECTOR.but(rotor_max_rad_s=0.5 * HECTOR.hover_rad_s)
    with pytest.warns(ul.UllageWarning, match="'floor'"):
        flown = ul.fly(ul.Waypoints([(0, 0, 0.6)], hold_s=3.0), dead, scene=turned)
    assert flown.position[-1, 2] == pytest.approx(HECTOR.core_m[2] / 2, abs=0.02)
    assert np.linalg.norm(flown.rates[0][-1]) < 0.02


def test_a_concave_object_is_not_filled():
    """Through a frame of four blocks that are one object; a convex hull would close it."""
    parts = [
        ((0, 1, 0), (0.2, 0.4, 2.4)),
        ((0, -1, 0), (0.2, 0.4, 2.4)),
        ((0, 0, 1), (0.2, 1.6, 0.4)),
        ((0, 0, -1), (0.2, 1.6, 0.4)),
    ]
    merged = Scene.union([_block(*part) for part in parts])
    frame = Scene.of_mesh(merged.vertices, merged.faces, name="frame")
    _, log = fly_log(ul.Waypoints([(-2, 0, 0), (2, 0, 0)]), scene=frame)
    assert not log.contacts
    with pytest.warns(ul.UllageWarning, match="'frame'"):
        ul.fly(ul.Waypoints([(-2, 0.5, 0), (2, 0.5, 0)]), scene=frame)


def test_a_moving_object_hits_the_hovering_vehicle():
    vertices, faces = box((0.5, 0.5, 0.5))
    motion = ul.Trajectory.line((3, 0, 0), (0, 0, 0), 0.5, 10)
    trolley = Scene.of_mesh(vertices, faces, name="trolley", motion=motion)
    with pytest.warns(ul.UllageWarning, match="'trolley'"):
        flown, log = fly_log(ul.Waypoints([(0, 0, 0)], hold_s=6.0), scene=trolley, rate_hz=50)
    # The face meets the blades when the trolley's centre is at radius + 0.25 m.
    assert log.contacts[0].t_ns * 1e-9 == pytest.approx((3 - 0.25 - HECTOR.radius_m) / 0.5, abs=0.1)
    assert flown.position[-1, 0] < -0.1


# What is refused before take-off.


@pytest.mark.parametrize(
    ("points", "start", "words"),
    [
        ([(0, 0, 0), (2.0, 0.1, 0)], None, ["waypoint 1", "2.00, 0.10, 0.00", "inside 'block'"]),
        ([(0, 0, 0), (1.35, 0, 0)], None, ["waypoint 1", "0.15 m from 'block'", "0.40 m to the side"]),
        ([(0, 0, 0)], (2.2, 0, 0), ["the start", "inside 'block'"]),
        ([(2.0, 0, 0.58)], None, ["waypoint 0", "0.08 m from 'block'", "up and down"]),
    ],
)
def test_places_in_or_near_solids_are_refused(points, start, words):
    with pytest.raises(ul.InputError) as caught:
        ul.fly(points, scene=_block((2, 0, 0), (1, 1, 1)), start=start)
    for word in words:
        assert word in str(caught.value)
    assert "\n" not in str(caught.value)


def test_places_just_clear_are_accepted():
    scene = _block((2, 0, 0), (1, 1, 1))
    for clear in ((1.5 - HECTOR.radius_m - 0.01, 0, 0), (2.0, 0, 0.5 + HECTOR.half_height_m + 0.01)):
        assert np.allclose(ul.fly([clear], scene=scene).position[0], clear, atol=0.05)


def test_a_waypoint_on_a_wire_is_refused():
    wire = Scene.of_wires(np.array([[1, -2, 0]]), np.array([[1, 2, 0]]), 0.0015, name="stay")
    with pytest.raises(ul.InputError, match=r"waypoint 0 .* 0\.1\d m from 'stay'"):
        ul.fly([(1.13, 0.3, 0)], scene=wire)


def test_a_closed_hull_around_the_whole_flight_is_a_tank():
    vertices, faces = box((4, 4, 4))
    outward = Scene.of_mesh(vertices, faces, name="tank")
    with pytest.warns(ul.UllageWarning, match="inside tank"):
        path = ul.fly([(0, 0, 0), (0.5, 0, 0)], scene=outward)
    assert path.position[-1] == pytest.approx([0.5, 0, 0], abs=0.05)
    inward = Scene.of_mesh(vertices, faces[:, ::-1], name="tank")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        same = ul.fly([(0, 0, 0), (0.5, 0, 0)], scene=inward)
    np.testing.assert_array_equal(same.position, path.position)


def test_solids_hold_what_is_inside_them_and_open_shells_hold_nothing():
    vertices, faces = sphere(1.0, edge_m=0.3)
    rng = np.random.default_rng(0)
    points = rng.uniform(-1.2, 1.2, (200, 3))
    radius = np.linalg.norm(points, axis=1)
    closed = Solids(bodies(Scene.of_mesh(vertices, faces, name="ball"))[0])
    held = np.array([bool(closed.holding(p)) for p in points])
    assert held[radius < 0.9].all()
    assert not held[radius > 1.0].any()
    opened = Solids(bodies(Scene.of_mesh(vertices, faces[1:], name="bowl"))[0])
    assert not any(opened.holding(p) for p in points)


def test_nearest_points_agree_with_a_search():
    rng = np.random.default_rng(1)
    corners = rng.normal(size=(40, 3, 3))
    corners[0] = corners[0, :1]  # a point
    corners[1, 2] = (corners[1, 0] + corners[1, 1]) / 2  # a line
    point = rng.normal(size=3)
    found = np.empty((40, 3))
    nearest_points(point, corners, found)
    for triangle, spot in zip(corners, found, strict=True):

        def away(w, triangle=triangle):
            return ((w[0] * triangle[0] + w[1] * triangle[1] + (1 - w[0] - w[1]) * triangle[2] - point) ** 2).sum()

        limits = {"type": "ineq", "fun": lambda w: np.array([w[0], w[1], 1 - w[0] - w[1]])}
        best = min(
            minimize(away, w, constraints=limits, method="SLSQP", options={"ftol": 1e-14}).fun
            for w in ([0.3, 0.3], [0.9, 0.05], [0.05, 0.9], [0.05, 0.05])
        )
        assert ((spot - point) ** 2).sum() == pytest.approx(best, abs=1e-5)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"wind_m_s": (1, 2)}, "wind_m_s"),
        ({"wind_m_s": (np.nan, 0, 0)}, "wind_m_s"),
        ({"gust_m_s": -1}, "gust_m_s"),
        ({"rate_hz": 0}, "rate_hz"),
        ({"rate_hz": -5}, "rate_hz"),
        ({"start": (0, 0)}, "start"),
        ({"start": (0, 0, np.inf)}, "start"),
        ({"on_contact": "ignore"}, "on_contact"),
        ({"vehicle": "zeppelin"}, "hector"),
    ],
)
def test_bad_settings_are_refused(change, words):
    with pytest.raises(ul.InputError, match=words):
        ul.fly([(0, 0, 1), (1, 0, 1)], **change)
