"""The vehicle obeys mechanics: what a physicist would check on a bench and in the air."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import ullage as ul
from ullage.flight.airframe import AIRFRAMES, airframe
from ullage.flight.vehicle import fly_log
from ullage.geometry import GRAVITY_M_S2

from .bench import let_go

HECTOR = airframe("hector")
BARE = HECTOR.but(
    drag_n_s2_m2=(0, 0, 0), drag_nm_s2=(0, 0, 0), inflow_n_s2_m=0.0, rotor_inertia_kg_m2=0.0, torque_nm_s=0.0
)
DT = 1 / 500


def test_falls_freely_without_thrust():
    pose, velocity, _ = let_go(BARE, 2.0, velocity=(1.0, -0.5, 3.0))
    t = np.arange(len(pose)) * DT
    np.testing.assert_allclose(pose[:, 2], 3.0 * t - GRAVITY_M_S2 * t**2 / 2, atol=1e-9)
    np.testing.assert_allclose(pose[:, 0], t, atol=1e-9)
    np.testing.assert_allclose(velocity[:, 2], 3.0 - GRAVITY_M_S2 * t, atol=1e-9)


def test_drag_makes_the_fall_approach_terminal_velocity():
    _, velocity, _ = let_go(HECTOR, 6.0)
    t = np.arange(len(velocity)) * DT
    final = np.sqrt(HECTOR.weight_n / HECTOR.drag_n_s2_m2[2])
    np.testing.assert_allclose(-velocity[:, 2], final * np.tanh(GRAVITY_M_S2 * t / final), atol=0.01)
    assert -velocity[-1, 2] > 0.99 * final


def test_energy_lost_in_a_fall_is_the_work_of_drag():
    pose, velocity, _ = let_go(HECTOR, 3.0, velocity=(4, 0, 0))
    speed = np.linalg.norm(velocity[:, :3], axis=1)
    energy = HECTOR.mass_kg * (speed**2 / 2 + GRAVITY_M_S2 * pose[:, 2])
    power = HECTOR.drag_n_s2_m2[0] * speed**3
    work = np.concatenate([[0], np.cumsum((power[1:] + power[:-1]) / 2 * DT)])
    np.testing.assert_allclose(energy[0] - energy, work, atol=2e-3 * work[-1])


def test_a_tumbling_body_keeps_its_angular_momentum_and_energy():
    frame = BARE.but(inertia_kg_m2=(0.010, 0.016, 0.022))
    pose, velocity, _ = let_go(frame, 3.0, spin=(0.3, 4.0, -0.2))
    inertia = np.asarray(frame.inertia_kg_m2)
    rot = Rotation.from_quat(pose[:, [4, 5, 6, 3]])
    momentum = rot.apply(inertia * velocity[:, 3:])
    energy = (inertia * velocity[:, 3:] ** 2).sum(1) / 2
    assert np.ptp(velocity[:, 4]) > 4  # the middle axis is unstable: it does tumble
    np.testing.assert_allclose(momentum, np.tile(momentum[0], (len(momentum), 1)), atol=1e-6)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-5)


def test_thrust_of_hovering_rotors_equals_weight():
    _, log = fly_log(ul.Waypoints([(0, 0, 1)], hold_s=4.0))
    assert log.error_m.max() < 1e-6
    thrust = HECTOR.thrust_n_s2 * (log.rotor_rad_s**2).sum(1)
    np.testing.assert_allclose(thrust, HECTOR.weight_n, rtol=1e-6)


def test_uneven_rotors_yaw_at_torque_over_inertia():
    base = BARE.hover_rad_s
    speed = np.array([1.1, 0.9, 1.1, 0.9]) * base
    _, velocity, _ = let_go(BARE, 0.5, rotors=speed)
    torque = BARE.torque_m * BARE.thrust_n_s2 * (np.asarray(BARE.rotor_spin) * speed**2).sum()
    np.testing.assert_allclose(velocity[-1, 5], torque / BARE.inertia_kg_m2[2] * (0.5 - DT), rtol=1e-6)
    assert torque > 0  # rotors 1 and 3 drag the body to the left


@pytest.mark.parametrize(("stronger", "axis", "sign"), [(0, 4, -1), (1, 3, -1), (2, 4, 1), (3, 3, 1)])
def test_each_rotor_tips_the_body_away_from_itself(stronger, axis, sign):
    speed = np.full(4, BARE.hover_rad_s)
    speed[stronger] *= 1.05
    _, velocity, _ = let_go(BARE, 0.1, rotors=speed)
    assert sign * velocity[-1, axis] > 0.05


def test_rotors_answer_with_their_time_constant():
    _, _, rotors = let_go(HECTOR, 0.5, rotors=400.0, asked=np.full(4, 500.0))
    t = np.arange(len(rotors)) * DT
    np.testing.assert_allclose(rotors[:, 0], 500 - 100 * np.exp(-t / HECTOR.rotor_time_s), atol=1e-9)


def test_hectors_lag_and_top_speed_follow_from_its_published_motor():
    """[HectorQuadrotor], motorspeed.m with robbe_2827-34_epp1045.yaml, linearised at hover."""
    psi, j, r, alpha, beta = (
        0.007242179827506,
        2.573048063300000e-5,
        0.201084219222241,
        0.104863758313889,
        0.549262344777900,
    )

    def change(speed, volt):
        half = (volt * beta - psi * speed) / (2 * r)
        current = half + np.sqrt(half**2 + volt * alpha / r)
        load = HECTOR.torque_m * HECTOR.thrust_n_s2 * speed**2 + HECTOR.torque_nm_s * speed
        return (psi * current - load) / j

    hover = HECTOR.hover_rad_s
    volt = brentq(lambda u: change(hover, u), 1, 14.8)
    pole = (change(hover + 0.01, volt) - change(hover - 0.01, volt)) / 0.02
    assert HECTOR.rotor_time_s == pytest.approx(-1 / pole, rel=0.002)
    assert HECTOR.rotor_max_rad_s == pytest.approx(brentq(lambda w: change(w, 14.8), 100, 5000), rel=0.001)


def test_a_steady_wind_is_leaned_against_and_its_drift_removed():
    wind = 4.0
    flown, log = fly_log(ul.Waypoints([(0, 0, 1)], hold_s=20.0), wind_m_s=(wind, 0, 0))
    assert log.error_m.max() > 0.03  # the wind does push
    assert log.error_m[-25:].max() < 0.005
    up = flown.world_from_body[-1, :3, 2]
    lean = np.arctan2(-up[0], up[2])
    assert lean == pytest.approx(np.arctan(HECTOR.drag_n_s2_m2[0] * wind**2 / HECTOR.weight_n), rel=0.02)


def test_a_mirrored_vehicle_on_a_mirrored_mission_flies_the_mirror_image():
    points = np.array([(0, 0, 1), (2, 1, 1.5), (3, -1, 1)])
    flip = np.array([1, -1, 1])
    mirrored = HECTOR.but(rotor_spin=tuple(-s for s in HECTOR.rotor_spin))
    one = ul.fly(points, wind_m_s=(1, 2, 0))
    two = ul.fly(points * flip, mirrored, wind_m_s=(1, -2, 0))
    np.testing.assert_allclose(two.position, one.position * flip, atol=1e-8)


def test_a_turned_mission_flies_turned():
    points = np.array([(0, 0, 1), (2, 1, 1.5), (3, -1, 1)])
    turn = Rotation.from_euler("z", 130, degrees=True)
    one = ul.fly(points, wind_m_s=(1, 2, 0))
    two = ul.fly(turn.apply(points), wind_m_s=tuple(turn.apply((1, 2, 0))))
    np.testing.assert_allclose(two.position, turn.apply(one.position), atol=1e-8)


def test_rates_of_the_path_are_those_of_its_positions_and_attitudes():
    flown = ul.fly(ul.Waypoints([(0, 0, 1), (2, 0, 1), (2, 2, 1)]), rate_hz=100)
    velocity, spin = flown.rates
    slope = np.gradient(flown.position, 0.01, axis=0)
    np.testing.assert_allclose(velocity[1:-1], slope[1:-1], atol=2e-3)
    bare = ul.Trajectory(flown.t_ns, flown.position, flown.quat_xyzw)
    np.testing.assert_allclose(spin[2:-2], bare.rates[1][2:-2], atol=0.02)
    assert np.abs(spin[:, 2]).max() > 0.3


def test_too_weak_motors_cannot_climb():
    weak = HECTOR.but(rotor_max_rad_s=0.95 * HECTOR.hover_rad_s)
    flown = ul.fly(ul.Waypoints([(0, 0, 50), (1, 0, 50)]), weak)
    assert flown.position[-1, 2] < 48
    assert flown.rates[0][-1, 2] < -0.5


@pytest.mark.parametrize("name", list(AIRFRAMES))
def test_every_vehicle_can_hover_and_turn(name):
    frame = AIRFRAMES[name]
    assert frame.hover_rad_s < 0.8 * frame.rotor_max_rad_s
    effect = np.linalg.pinv(frame.mixer())
    np.testing.assert_allclose(effect @ frame.mixer(), np.eye(4), atol=1e-9)
