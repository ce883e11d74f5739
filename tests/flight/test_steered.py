"""A vehicle steered on the way: it does what it is asked, as physics allows."""

from __future__ import annotations

import math

import numpy as np
import pytest

import ullage as ul
from ullage.errors import InputError
from ullage.flight.airframe import airframe
from ullage.flight.live import Steered, Wish


def flown(vehicle: Steered, seconds: float, rate_hz: float = 50.0) -> np.ndarray:
    start, out = vehicle.t_ns, []
    for k in range(1, int(seconds * rate_hz) + 1):
        vehicle.advance(start + round(k * 1e9 / rate_hz))
        out.append(vehicle.position)
    return np.array(out)


def test_it_hovers_where_it_began() -> None:
    vehicle = Steered(start=(1, 2, 3, 30))
    path = flown(vehicle, 3)
    assert np.abs(path - (1, 2, 3)).max() < 1e-6
    assert ul.geometry.quat_rpy(vehicle.quat_xyzw)[2] == pytest.approx(math.radians(30))


def test_a_step_of_height_is_taken_without_overshoot_and_leaves_the_rest_alone() -> None:
    vehicle = Steered(start=(0, 0, 1))
    vehicle.ask(Wish(height_m=2.0))
    path = flown(vehicle, 10)
    assert path[-1, 2] == pytest.approx(2.0, abs=0.005)
    assert path[:, 2].max() < 2.02
    assert np.abs(path[:, :2]).max() < 1e-6


def test_speed_goes_where_it_looks() -> None:
    vehicle = Steered(start=(0, 0, 1))
    vehicle.ask(Wish(heading_rad=math.pi / 2))
    flown(vehicle, 5)
    vehicle.ask(Wish(velocity_m_s=(0.5, 0.0)))
    path = flown(vehicle, 6)
    assert vehicle.velocity == pytest.approx([0, 0.5, 0], abs=0.01)
    assert np.abs(path[:, 0]).max() < 0.02


def test_a_force_accelerates_the_mass() -> None:
    vehicle = Steered(start=(0, 0, 5))
    mass = airframe("hector").mass_kg
    vehicle.ask(Wish(force_n=(0.0, 0.0, 0.2 * mass)))
    flown(vehicle, 1.0)
    # the rotors lag 75 ms; drag of 0.08 N/(m/s)^2 is nothing yet
    assert vehicle.velocity[2] == pytest.approx(0.2 * (1.0 - 0.075), rel=0.1)
    vehicle.ask(Wish(height_m=5.0))
    assert vehicle.wish.force_n is None


def test_it_hits_what_stands_in_its_way() -> None:
    vehicle = Steered(scene=ul.scenes.room(size_m=(4, 4, 3)), start=(0, 0, 0))
    vehicle.ask(Wish(velocity_m_s=(1.0, 0.0)))
    path = flown(vehicle, 5)
    assert vehicle.touched >= 1
    assert path[:, 0].max() < 2.0


def test_a_start_that_is_none_is_refused() -> None:
    with pytest.raises(InputError, match=r"start is \(1, 2\).*yaw"):
        Steered(start=(1, 2))
