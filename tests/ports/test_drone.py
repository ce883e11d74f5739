"""A drone of others is flown by velocities or set-points; here it is a point without a network."""

from __future__ import annotations

import math
import time
from types import SimpleNamespace

import numpy as np
import pytest

from ullage.flight.live import Wish
from ullage.flight.pilot import HOVER, Velocity
from ullage.geometry import quat_matrix, quat_rpy, rpy_quat
from ullage.ports.drone import COMMAND_S, STALE_S, Guided, Limits, state_of
from ullage.ports.intake import Counters
from ullage.ports.pose_events import BodyState


class Point:
    """Follows what it is told at once; knows nothing of ullage's control."""

    def __init__(self, place=(0.0, 0.0, 1.0), yaw=0.5):
        self.counters = Counters()
        self.place, self.yaw = np.array(place), yaw
        self.velocity, self.goal = HOVER, None
        self.sent, self.t_s, self.mute, self.closed = [], 0.0, False, False

    def states(self):
        if self.mute:
            return []
        quat = rpy_quat(0.0, 0.0, self.yaw)
        return [BodyState(round(self.t_s * 1e9), self.place.copy(), quat, np.zeros(3), np.zeros(3))]

    def steer(self, velocity):
        self.velocity = velocity
        self.sent.append(velocity)

    def go_to(self, position, heading_rad):
        self.goal = (position, heading_rad)
        self.sent.append(self.goal)

    def step(self, dt):
        self.t_s += dt
        if self.goal is not None:
            away = np.array(self.goal[0]) - self.place
            self.place = self.place + away * min(1.0, dt / 0.3)
            self.yaw += math.remainder(self.goal[1] - self.yaw, math.tau) * min(1.0, dt / 0.3)
            return
        v = self.velocity
        self.place = self.place + quat_matrix(rpy_quat(0, 0, self.yaw)) @ np.array(v[:3]) * dt
        self.yaw += v.turn_rad_s * dt

    def close(self):
        self.closed = True


def guided(point, takes="velocity", said=None, **limits):
    return Guided(point, takes, Limits(**limits), log=(said if said is not None else []).append, now=lambda: point.t_s)


def fly(drone, point, seconds):
    """Positions on the path."""
    out = []
    for _ in range(round(seconds / 0.02)):
        drone.fly()
        point.step(0.02)
        out.append(point.place.copy())
    return np.array(out)


@pytest.mark.parametrize("takes", ["velocity", "pose"])
def test_nothing_is_commanded_before_somebody_asks(takes):
    point = Point()
    drone = guided(point, takes)
    fly(drone, point, 2.0)
    drone.close()
    assert point.sent == []
    assert point.closed


@pytest.mark.parametrize("takes", ["velocity", "pose"])
def test_a_place_is_reached_and_a_heading_taken(takes):
    point = Point()
    drone = guided(point, takes)
    drone.fly()
    drone.ask(Wish(position_m=(3.0, -2.0, 2.5)))
    drone.ask(Wish(heading_rad=math.pi - 0.1))
    fly(drone, point, 12.0)
    assert point.place == pytest.approx([3.0, -2.0, 2.5], abs=0.02)
    assert math.remainder(point.yaw - (math.pi - 0.1), math.tau) == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize("takes", ["velocity", "pose"])
def test_a_velocity_is_in_the_frame_of_the_heading_and_within_the_limits(takes):
    point = Point(yaw=math.pi / 2)
    drone = guided(point, takes, level_m_s=0.5)
    drone.fly()
    drone.ask(Wish(velocity_m_s=(5.0, 0.0)))
    path = fly(drone, point, 6.0)
    assert path[-1] - path[-101] == pytest.approx([0.0, 1.0, 0.0], abs=0.02)  # north, 0.5 m/s for 2 s
    assert point.yaw == pytest.approx(math.pi / 2, abs=0.01)


@pytest.mark.parametrize("takes", ["velocity", "pose"])
def test_a_height_leaves_the_place(takes):
    point = Point(place=(1.0, 2.0, 1.0))
    drone = guided(point, takes)
    drone.fly()
    drone.ask(Wish(height_m=3.0))
    fly(drone, point, 8.0)
    assert point.place == pytest.approx([1.0, 2.0, 3.0], abs=0.02)


def test_a_path_is_followed_and_not_cut():
    """From beside the path: the drone joins it and stays on it."""
    point = Point(place=(0.0, 1.5, 1.0))
    drone = guided(point)
    drone.fly()
    drone.ask(Wish(position_m=(10.0, 0.0, 1.0), from_m=(0.0, 0.0, 1.0), speed_m_s=0.8))
    path = fly(drone, point, 20.0)
    aside = np.abs(path[path[:, 0] > 5.0, 1])
    assert aside.max() < 0.06  # straight to the goal it would be 0.75 m at x = 5
    assert path[-1] == pytest.approx([10.0, 0.0, 1.0], abs=0.02)
    speed = np.linalg.norm(np.diff(path, axis=0), axis=1) / 0.02
    assert speed.max() < 0.82


def test_without_a_state_the_drone_hovers_and_goes_on_when_it_comes_back():
    said, point = [], Point()
    drone = guided(point, said=said)
    drone.fly()
    drone.ask(Wish(velocity_m_s=(0.5, 0.0)))
    fly(drone, point, 1.0)
    assert point.velocity.forward_m_s == pytest.approx(0.5)
    point.mute = True
    fly(drone, point, STALE_S + 2 * COMMAND_S)
    assert point.velocity == HOVER
    assert said == ["no state of the drone for 1 s: hovering"]
    point.mute = False
    fly(drone, point, 1.0)
    assert point.velocity.forward_m_s == pytest.approx(0.5)
    drone.close()
    assert point.velocity == HOVER


def test_forces_are_left_out_and_said_once():
    said, point = [], Point()
    drone = guided(point, said=said)
    drone.fly()
    for _ in range(3):
        drone.ask(Wish(force_n=(0.0, 0.0, 1.0)))
    fly(drone, point, 1.0)
    assert point.sent == []
    assert said == ["the drone takes no forces: DesiredControl is left out"]


def test_a_state_has_its_velocity_in_the_world():
    left = tuple(rpy_quat(0.0, 0.0, math.pi / 2))

    def state(at=(0, 0, 0), turn=left, linear=(0, 0, 0)):
        point, level = (SimpleNamespace(**dict(zip("xyz", part, strict=True))) for part in (at, linear))
        pose = SimpleNamespace(position=point, orientation=SimpleNamespace(**dict(zip("xyzw", turn, strict=True))))
        return state_of(5, pose, SimpleNamespace(linear=level, angular=SimpleNamespace(x=0.0, y=0.0, z=0.1)))

    found = state((1.0, 2.0, 3.0), linear=(1.0, 0.0, 0.5))
    assert found.velocity == pytest.approx([0.0, 1.0, 0.5])
    assert float(quat_rpy(found.quat_xyzw)[2]) == pytest.approx(math.pi / 2)
    assert abs(found.t_ns * 1e-9 - time.time()) < 60  # 5 ns after 1970 is a simulator's clock
    assert state((math.nan, 0, 0)) == "position is not finite"
    assert state(turn=(0, 0, 0, 0)) == "quaternion is not of unit length"
    assert state(linear=(math.inf, 0, 0)) == "twist is not finite"


def test_commands_come_ten_times_a_second():
    point = Point()
    drone = guided(point)
    drone.fly()
    drone.ask(Wish(velocity_m_s=(0.2, 0.1)))
    fly(drone, point, 3.0)
    assert len(point.sent) == pytest.approx(30, abs=4)
    assert point.sent[-1] == Velocity(pytest.approx(0.2), pytest.approx(0.1), pytest.approx(0.0), 0.0)


def test_a_set_point_runs_ahead_as_far_as_the_velocity_goes_in_a_second_and_stops_where_the_drone_is():
    point = Point()
    drone = guided(point, "pose")
    drone.fly()
    for speed in (0.6, 0.1):
        drone.ask(Wish(velocity_m_s=(speed, 0.0)))
        point.goal = None  # it does not move, so the set-point runs ahead
        for _ in range(60):
            drone.fly()
            point.t_s += 0.05
        ahead = np.array(point.goal[0]) - point.place
        assert np.linalg.norm(ahead) == pytest.approx(speed, abs=1e-9)
    drone.ask(Wish(velocity_m_s=(0.0, 0.0)))
    point.place = stop = point.place + np.array((0.2, 0.0, 0.0))
    for blown in ([0.0, 0.0, 0.0], [0.3, 0.1, 0.0]):  # it comes back to where it stopped
        point.place = stop + blown
        point.t_s += 0.2
        drone.fly()
        assert np.array(point.goal[0]) == pytest.approx(stop)
