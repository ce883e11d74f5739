"""Flight by hand: velocities that go stale, set-points, and limits."""

from __future__ import annotations

import math

import numpy as np
import pytest

import ullage as ul
from ullage.flight.live import Steered, Wish
from ullage.flight.pilot import HOVER, Pilot, PilotOptions, Velocity


def fly(vehicle: Steered, pilot: Pilot, start_s: float, end_s: float) -> np.ndarray:
    """Let the vehicle fly by the pilot's requests; positions at 50 Hz."""
    out = []
    for now_s in np.arange(start_s, end_s, 0.02):
        if (wish := pilot.request(float(now_s))) is not None:
            vehicle.ask(wish)
        vehicle.advance(round((now_s + 0.02) * 1e9))
        out.append(vehicle.position)
    return np.array(out)


def test_a_velocity_moves_all_four_axes_in_the_frame_of_the_heading() -> None:
    vehicle, pilot = Steered(start=(0, 0, 2, 90)), Pilot(PilotOptions(timeout_s=10))
    assert pilot.command(Velocity(0.5, 0.2, 0.3, 0.0), 0.0)
    fly(vehicle, pilot, 0, 4)
    assert vehicle.velocity == pytest.approx([-0.2, 0.5, 0.3], abs=0.02)
    pilot.command(Velocity(turn_rad_s=0.5), 4.0)
    fly(vehicle, pilot, 4, 6)
    assert vehicle.spin[2] == pytest.approx(0.5, abs=0.02)


def test_a_lost_stream_of_commands_hovers_after_half_a_second() -> None:
    vehicle, pilot = Steered(start=(0, 0, 2)), Pilot(PilotOptions())
    pilot.command(Velocity(1.0, 0.0, 0.2, 0.4), 0.0)
    assert pilot.request(0.49) is not None
    assert pilot.request(0.499) is None
    hover = pilot.request(0.5)
    assert hover == Wish(velocity_m_s=(0.0, 0.0), climb_m_s=0.0, turn_rad_s=0.0)
    assert pilot.stale == 1
    pilot.command(Velocity(1.0, 0.0, 0.2, 0.4), 0.0)
    path = fly(vehicle, pilot, 0, 6)
    assert vehicle.velocity == pytest.approx([0, 0, 0], abs=0.01)
    assert np.linalg.norm(path[-1] - path[-50]) < 0.005
    assert 0.2 < path[-1, 0] < 1.2
    assert path[-1, 2] < 2.3


def test_an_order_to_hover_is_no_lost_stream() -> None:
    pilot = Pilot(PilotOptions())
    pilot.command(HOVER, 0.0)
    assert pilot.request(0.1) is not None
    assert pilot.request(5.0) is None
    assert pilot.stale == 0


def test_a_set_point_is_reached_and_held_without_further_commands() -> None:
    vehicle, pilot = Steered(start=(0, 0, 2)), Pilot(PilotOptions())
    assert pilot.go_to((2.0, -1.0, 3.0), math.pi / 2)
    path = fly(vehicle, pilot, 0, 12)
    assert path[-1] == pytest.approx([2, -1, 3], abs=0.01)
    assert ul.geometry.quat_rpy(vehicle.quat_xyzw)[2] == pytest.approx(math.pi / 2, abs=0.01)
    assert np.linalg.norm(path - path[-1], axis=1)[-100:].max() < 0.02
    pilot.command(Velocity(0.5), 12.0)
    fly(vehicle, pilot, 12, 13)
    assert vehicle.wish.position_m is None
    assert vehicle.position[2] == pytest.approx(3, abs=0.05)


def test_commands_beyond_the_limits_are_scaled_and_those_without_sense_left() -> None:
    pilot = Pilot(PilotOptions(speed_m_s=0.5, turn_deg_s=10))
    assert pilot.command(Velocity(30.0, 40.0, -9.0, 3.0), 0.0)
    asked = pilot.request(0.0)
    assert asked is not None
    assert asked.velocity_m_s == pytest.approx((0.3, 0.4))
    assert asked.climb_m_s == -1.0
    assert asked.turn_rad_s == pytest.approx(math.radians(10))
    assert not pilot.command(Velocity(math.nan), 0.0)
    assert not pilot.go_to((0.0, math.inf, 0.0))
    assert pilot.request(0.0) is None


def test_a_position_gives_way_to_a_velocity_at_the_same_height() -> None:
    there = Wish(position_m=(1.0, 2.0, 3.0))
    assert Wish(height_m=1.0, velocity_m_s=(1.0, 0.0)).then(there).height_m is None
    later = there.then(Wish(velocity_m_s=(0.1, 0.0)))
    assert (later.position_m, later.height_m) == (None, 3.0)
    assert Wish(force_n=(1.0, 0.0, 0.0)).then(there).force_n is None
