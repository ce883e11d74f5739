"""Missions and the smooth reference through them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

import ullage as ul
from ullage.flight.missions import along_walls, erratic, hover, lawnmower, orbit
from ullage.flight.reference import plan

RATE = 250.0
NUMBER = st.floats(-5, 5, allow_nan=False).map(lambda v: round(v, 2))


def _plan(way, **more):
    return plan(way, rate_hz=RATE, **more).track


@settings(max_examples=25, deadline=None)
@given(
    points=st.lists(st.tuples(NUMBER, NUMBER, NUMBER), min_size=1, max_size=6),
    speed=st.floats(0.2, 3.0),
    stop=st.booleans(),
    yaw=st.sampled_from(["along", "hold", 30.0]),
)
def test_a_reference_is_smooth_slow_enough_and_stays_in_the_hull(points, speed, stop, yaw):
    way = ul.Waypoints(points, speed, stop=stop, yaw=yaw)
    track = _plan(way)
    np.testing.assert_allclose(track[0, :3], points[0], atol=1e-6)
    np.testing.assert_allclose(track[-1, :3], points[-1], atol=1e-6)
    assert np.linalg.norm(track[:, 3:6], axis=1).max(initial=0) <= speed * (1 + 1e-6)
    assert np.abs(track[-1, 3:12]).max() < 1e-4
    assert np.abs(track[:, 13]).max() <= np.radians(45) * (1 + 1e-6)
    for order in range(3):  # each derivative is the slope of the one before
        slope = np.gradient(track[:, 3 * order : 3 * order + 3], 1 / RATE, axis=0)[1:-1]
        limit = np.abs(np.diff(track[:, 3 * order + 3 : 3 * order + 6], axis=0)).max() + 1e-4
        assert np.abs(slope - track[1:-1, 3 * order + 3 : 3 * order + 6]).max() <= limit
    low, high = np.min(points, axis=0), np.max(points, axis=0)
    assert (track[:, :3] >= low - 1e-6).all()
    assert (track[:, :3] <= high + 1e-6).all()


def test_a_reference_stays_in_the_hull_of_its_points():
    rng = np.random.default_rng(0)
    points = rng.uniform(-3, 3, (8, 3))
    faces = ConvexHull(points).equations
    track = _plan(ul.Waypoints(points, 1.0))
    assert (track[::10, :3] @ faces[:, :3].T + faces[:, 3]).max() < 1e-6


def test_stops_pass_exactly_through_points_and_hold_there():
    points = np.array([(0, 0, 1), (2, 0, 1), (2, 2, 2.0)])
    track = _plan(ul.Waypoints(points, stop=True, hold_s=1.5))
    gap = np.linalg.norm(track[:, :3] - points[1], axis=1)
    assert (gap < 1e-6).sum() / RATE == pytest.approx(1.5 + 2.0, abs=2.1)  # the hold, and the turn to the next leg
    assert (gap < 1e-6).sum() / RATE >= 1.5


def test_corners_are_rounded_more_at_less_acceleration():
    points = np.array([(0, 0, 1), (3, 0, 1), (3, 3, 1)])
    cuts = [
        np.linalg.norm(_plan(ul.Waypoints(points, acceleration_m_s2=a))[:, :3] - points[1], axis=1).min()
        for a in (2.0, 0.8, 0.3)
    ]
    assert cuts[0] < cuts[1] < cuts[2]
    assert cuts[1] < 0.15


def test_acceleration_of_starts_and_corners_is_as_set():
    track = _plan(ul.Waypoints([(0, 0, 1), (3, 0, 1), (3, 3, 1)], 1.0, acceleration_m_s2=0.7))
    assert np.linalg.norm(track[:, 6:9], axis=1).max() == pytest.approx(0.7, rel=0.01)


def test_heading_follows_the_legs_or_the_list():
    points = [(0, 0, 1), (4, 0, 1), (4, 4, 1)]
    along = _plan(ul.Waypoints(points))
    assert along[0, 12] == pytest.approx(0)
    assert along[-1, 12] == pytest.approx(np.pi / 2)
    listed = _plan(ul.Waypoints([(*p, y) for p, y in zip(points, (0, 90, 350), strict=True)]))
    assert listed[-1, 12] == pytest.approx(np.radians(-10))  # the short way round
    held = _plan(ul.Waypoints(points, yaw="hold"), start=np.zeros(3), start_yaw_deg=40.0)
    np.testing.assert_allclose(held[:, 12], np.radians(40))


def test_a_turn_on_the_spot_takes_its_time():
    track = _plan(ul.Waypoints([(0, 0, 1, 0), (0, 0, 1, 170)], yaw_rate_deg_s=30))
    assert np.degrees(track[-1, 12]) == pytest.approx(170)
    assert np.degrees(np.abs(track[:, 13]).max()) <= 30.001
    assert len(track) / RATE > 170 / 30
    np.testing.assert_allclose(track[:, :3], [[0, 0, 1]] * len(track), atol=1e-12)


def test_missions_go_where_they_say():
    rows = lawnmower((0, 0, 2), (6, 2.0), 0.5).points
    assert sorted(set(rows[:, 1])) == pytest.approx([0, 0.5, 1.0, 1.5, 2.0])
    assert (rows[:, 2] == 2).all()
    assert np.ptp(rows[:, 0]) == 6
    ring = orbit((1, 2, 3), 2.0, turns=-1)
    np.testing.assert_allclose(np.linalg.norm(ring.points - (1, 2, 3), axis=1), 2.0)
    flown = ul.fly(ring)
    inward = np.array([1, 2]) - flown.position[:, :2]
    ahead = flown.world_from_body[:, :2, 0]
    cosine = (inward * ahead).sum(1) / np.linalg.norm(inward, axis=1) / np.linalg.norm(ahead, axis=1)
    assert cosine.min() > 0.97
    assert ul.fly(hover((0, 0, 1), 5.0)).duration_s == pytest.approx(5.0, abs=2.0)


def test_a_round_along_the_walls_keeps_its_distance():
    room = ul.scenes.room(size_m=(6, 4, 3))
    points = along_walls(room, 0.0, distance_m=0.8).points
    assert np.abs(points[:, 0]).max() == pytest.approx(2.2, abs=0.05)
    assert np.abs(points[:, 1]).max() == pytest.approx(1.2, abs=0.05)
    np.testing.assert_allclose(points[0], points[-1])
    flown = ul.fly(along_walls(room, 0.0, distance_m=0.8, look="wall"), scene=room)
    ahead = flown.world_from_body[:, :3, 0]
    toward = flown.position + 0.8 * ahead
    outside = (np.abs(toward[:, 0]) > 2.9) | (np.abs(toward[:, 1]) > 1.9)
    assert outside.mean() > 0.6  # but for the turns, the wall is ahead


def test_a_hand_strays_as_much_as_set_and_starts_at_rest():
    way = ul.Waypoints([(0, 0, 1)], hold_s=240.0, yaw=0.0)
    straight, strayed = _plan(way), _plan(erratic(way, 5, lateral_m=0.2, vertical_m=0.1, yaw_deg=8.0))
    offset = strayed - straight
    np.testing.assert_allclose(offset[:, :3].std(0), (0.2, 0.2, 0.1), rtol=0.15)
    assert np.degrees(offset[:, 12].std()) == pytest.approx(8, rel=0.15)
    assert np.abs(offset[[0, -1], :9]).max() < 1e-4
    other = _plan(erratic(way, 6, lateral_m=0.2))
    assert not np.allclose(other[:, :3], strayed[:, :3], atol=0.05)
    _, log = ul.flight.vehicle.fly_log(erratic(ul.Waypoints([(0, 0, 1), (3, 0, 1)]), 5))
    assert log.error_m.max() < 0.05  # human pace: the vehicle can follow


def test_a_finished_path_can_be_made_erratic():
    path = ul.Trajectory.line((0, 0, 0), (5, 0, 0), 0.5, 50)
    bent = erratic(path, 1)
    assert 0.02 < np.abs(bent.position - path.position).max() < 0.6
    slope = np.gradient(bent.position, 0.02, axis=0)
    np.testing.assert_allclose(bent.rates[0][1:-1], slope[1:-1], atol=2e-3)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ul.Waypoints([]), "at least one row"),
        (lambda: ul.Waypoints([(0, 0)]), "shape"),
        (lambda: ul.Waypoints([(0, 0, 1), (0, np.nan, 1)]), "waypoint 1 is not finite"),
        (lambda: ul.Waypoints([(0, 0, 1), (0, 1)]), "equal length"),
        (lambda: ul.Waypoints("abc"), "not numbers"),
        (lambda: ul.Waypoints([(0, 0, 1e9)]), "100 km"),
        (lambda: ul.Waypoints([(0, 0, 1)], 0), "speed_m_s is 0"),
        (lambda: ul.Waypoints([(0, 0, 1)], -1.0), "speed_m_s"),
        (lambda: ul.Waypoints([(0, 0, 1)], np.inf), "speed_m_s"),
        (lambda: ul.Waypoints([(0, 0, 1)], hold_s=-1), "hold_s"),
        (lambda: ul.Waypoints([(0, 0, 1)], yaw="sideways"), "along"),
        (lambda: ul.Waypoints([(0, 0, 1)], yaw=[0, 1]), "yaw has shape"),
        (lambda: ul.Waypoints([(0, 0, 1)], yaw=[np.nan]), "yaw is not finite"),
        (lambda: ul.Waypoints([(0, 0, 1, 5)], yaw="hold"), "yaw is given twice"),
        (lambda: lawnmower((0, 0, 1), (1, 1), 0), "spacing_m is 0"),
        (lambda: orbit((0, 0, 1), -1), "radius_m"),
        (lambda: hover((0, 0, 1), 0), "duration_s"),
        (lambda: along_walls(ul.Scene.empty(), 1.0), "nothing stands at height"),
        (lambda: along_walls(ul.scenes.room(size_m=(2, 2, 2)), 0.0, distance_m=3.0), "no room to fly"),
        (lambda: erratic(ul.Waypoints([(0, 0, 1)]), lateral_m=-1), "lateral_m"),
    ],
)
def test_bad_missions_are_refused_in_one_line(make, words):
    with pytest.raises(ul.InputError, match=words) as caught:
        make()
    assert "\n" not in str(caught.value)
