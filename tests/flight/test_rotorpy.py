"""Flights against rotorpy, an independent simulator and controller, on the same parameters [RotorPy]."""

from __future__ import annotations

import numpy as np
import pytest

from ullage.flight.airframe import airframe
from ullage.flight.control import Tables
from ullage.flight.physics import CONTROL_HZ, CollisionModel
from ullage.flight.reference import Reference
from ullage.flight.vehicle import integrate
from ullage.kernels.flight import command

pytest.importorskip("rotorpy")

# rotorpy knows no rotor inertia, no friction in the rotor's torque and no rotational drag; both fly without them here.
FRAME = airframe("hector").but(rotor_inertia_kg_m2=0.0, torque_nm_s=0.0, torque_m=0.006, drag_nm_s2=(0, 0, 0))
DT = 1 / CONTROL_HZ


def _parameters(frame):
    k = frame.thrust_n_s2
    return {
        "mass": frame.mass_kg, "Ixx": frame.inertia_kg_m2[0], "Iyy": frame.inertia_kg_m2[1],
        "Izz": frame.inertia_kg_m2[2], "Ixy": 0.0, "Iyz": 0.0, "Ixz": 0.0, "num_rotors": 4,
        "rotor_pos": {f"r{i}": np.asarray(p) for i, p in enumerate(frame.rotor_position_m)},
        "rotor_directions": np.asarray(frame.rotor_spin), "rI": np.zeros(3),
        "c_Dx": frame.drag_n_s2_m2[0], "c_Dy": frame.drag_n_s2_m2[1], "c_Dz": frame.drag_n_s2_m2[2],
        "k_eta": k, "k_m": frame.torque_m * k, "k_d": 0.0, "k_z": -frame.inflow_n_s2_m, "k_h": 0.0, "k_flap": 0.0,
        "tau_m": frame.rotor_time_s, "rotor_speed_min": 0, "rotor_speed_max": frame.rotor_max_rad_s,
        "motor_noise_std": 0.0,
    }  # fmt: skip


def _theirs(frame, track, control, wind):
    """States of rotorpy's vehicle under `control(row, state)`, which gives rotor commands."""
    from rotorpy.vehicles.multirotor import Multirotor

    state = {
        "x": track[0, :3].copy(), "v": np.zeros(3), "q": np.array([0, 0, 0, 1.0]), "w": np.zeros(3),
        "wind": np.asarray(wind, float), "rotor_speeds": np.full(4, frame.hover_rad_s),
    }  # fmt: skip
    vehicle = Multirotor(_parameters(frame), state, integrator_kwargs={"rtol": 1e-6, "atol": 1e-8})
    path = []
    for row in range(len(track)):
        path.append(np.concatenate([state["x"], state["v"], state["q"]]))
        state = vehicle.step(state, {"cmd_motor_speeds": control(row, state)}, DT)
        state["wind"] = np.asarray(wind, float)
    return np.asarray(path)


def _ours(frame, track, wind=(0, 0, 0)):
    blowing = np.tile(np.asarray(wind, float), (len(track), 1))
    return integrate(
        frame, Reference(CONTROL_HZ, track), blowing, CollisionModel(frame, [], len(track)), None, "record", None
    )


def _our_controller(frame, track):
    tables = Tables.of(frame)
    memory = tables.memory(frame.hover_rad_s)

    def control(row, state):
        memory[7:] = state["rotor_speeds"]
        pose = np.concatenate([state["x"], state["q"][[3, 0, 1, 2]]])
        rates = np.concatenate([state["v"], state["w"]])
        command(tables.vehicle(pose, rates, memory), track, row, DT)
        return memory[3:7].copy()

    return control


def _their_controller(frame, track):
    from rotorpy.controllers.quadrotor_control import SE3Control

    g = frame.gains
    pilot = SE3Control(_parameters(frame) | {"kp_att": g.attitude_s2, "kd_att": g.rate_s})
    pilot.kp_pos, pilot.kd_pos = np.full(3, g.position_s2), np.full(3, g.velocity_s)

    def control(row, state):
        want = track[row]
        flat = {
            "x": want[:3], "x_dot": want[3:6], "x_ddot": want[6:9], "x_dddot": want[9:12], "x_ddddot": np.zeros(3),
            "yaw": want[12], "yaw_dot": want[13], "yaw_ddot": 0.0,
        }  # fmt: skip
        return np.clip(pilot.update(row * DT, state, flat)["cmd_motor_speeds"], 0, frame.rotor_max_rad_s)

    return control


def _step_track(seconds=3.0):
    track = np.zeros((round(seconds * CONTROL_HZ), 14))
    track[:, 0], track[:, 2] = 1.0, 1.0
    track[0, 0] = 0.0
    return track


def _eight(seconds=9.0):
    """A figure of eight of 4 x 1 m, a turn in `seconds`, begun at speed zero by easing in over the first second."""
    t = np.arange(round(seconds * CONTROL_HZ)) * DT
    rate = 2 * np.pi / 8
    phase = rate * np.where(t < 1, t**3 - t**4 / 2, t - 0.5)
    xyz = np.stack([2 * np.sin(phase), np.sin(2 * phase) / 2, 1 + 0 * t], axis=1)
    parts = [xyz]
    for _ in range(3):
        parts.append(np.gradient(parts[-1], DT, axis=0))
    return np.concatenate([*parts, np.zeros((len(t), 2))], axis=1)


def _rise_and_overshoot(x):
    return (np.argmax(x > 0.9) - np.argmax(x > 0.1)) * DT, x.max() - 1


def test_the_same_commands_move_both_vehicles_alike():
    """Our controller flies rotorpy's vehicle: any difference is the dynamics, MuJoCo's against theirs."""
    track, wind = _eight(5.0), (2.0, -1.0, 0.3)
    theirs = _theirs(FRAME, track, _our_controller(FRAME, track), wind)
    ours = _ours(FRAME, track, wind)
    assert np.abs(ours[:, :3] - theirs[:, :3]).max() < 0.5e-3
    assert np.abs(ours[:, 7:10] - theirs[:, 3:6]).max() < 2e-3
    assert np.abs(ours[:, [4, 5, 6, 3]] - theirs[:, 6:10]).max() < 2e-3


# Their controller has no integral and no rotor feedback, so ours goes without; the lag is that of a governed rotor.
GAINS = FRAME.gains.but(integral_s3=0.0, rotor=0.0, error_m=10.0, yaw_s2=120.0, yaw_rate_s=20.0, tilt_deg=60.0)
PLAIN = FRAME.but(rotor_time_s=0.015, gains=GAINS)


def test_a_step_of_one_metre_rises_and_overshoots_as_in_rotorpy():
    track = _step_track()
    ours, theirs = _ours(PLAIN, track)[:, 0], _theirs(PLAIN, track, _their_controller(PLAIN, track), (0, 0, 0))[:, 0]
    ours[0] = theirs[0] = 0.0
    (rise, over), (their_rise, their_over) = _rise_and_overshoot(ours), _rise_and_overshoot(theirs)
    assert rise == pytest.approx(their_rise, abs=0.01)
    assert over == pytest.approx(their_over, abs=0.005)
    assert 0.5 < rise < 1.0
    assert -0.01 <= over < 0.06


@pytest.mark.slow
def test_a_figure_of_eight_is_tracked_as_by_rotorpy_and_better_with_jerk_feedforward():
    track = _eight()
    blind = track.copy()
    blind[:, 9:12] = 0.0  # their controller takes no turn rate from jerk
    theirs = _theirs(PLAIN, track, _their_controller(PLAIN, track), (0, 0, 0))
    assert np.abs(_ours(PLAIN, blind)[:, :3] - theirs[:, :3]).max() < 1e-3

    def rms(path):
        return np.sqrt(((path[:, :3] - track[:, :3]) ** 2).sum(1).mean())

    assert rms(theirs) == pytest.approx(0.047, abs=0.005)
    assert rms(_ours(PLAIN, track)) < 0.02
    assert rms(_ours(airframe("hector"), track)) < 0.025  # the vehicle as it is flown: lag, drag torque, integral
