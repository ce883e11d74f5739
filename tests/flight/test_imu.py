"""What an inertial unit must read along a path, by the laws of motion."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ullage as ul

IDEAL = ul.ImuSpec(
    gyro_noise_deg_s=0, accel_noise_ug=0, gyro_bias_deg_s=0, accel_bias_mg=0, gyro_walk_deg_s=0, accel_walk_ug=0
)
G_M_S2 = 9.81


def _curve() -> ul.Trajectory:
    t_s = np.arange(0, 8, 0.02)
    quat = Rotation.from_euler("ZYX", np.stack([0.4 * t_s, 0.1 * np.sin(t_s), 0.2 * np.cos(t_s)], 1)).as_quat()
    place = np.stack([np.sin(t_s), t_s**2 / 20, 0.3 * np.cos(2 * t_s)], 1)
    speed = np.stack([np.cos(t_s), t_s / 10, -0.6 * np.sin(2 * t_s)], 1)
    return ul.Trajectory(np.rint(t_s * 1e9).astype(np.int64), place, quat, speed)


def test_a_unit_at_rest_reads_gravity_upward_and_no_turn() -> None:
    read = ul.simulate_imu(ul.Trajectory.stationary((1, 2, 3), yaw_deg=30, n=40), IDEAL)
    assert np.allclose(read.specific_force, [0, 0, G_M_S2])
    assert np.allclose(read.angular_velocity, 0)
    assert read.t_ns[0] == -2_000_000_000


def test_integrated_readings_give_the_path_back() -> None:
    path = _curve()
    read = ul.simulate_imu(path, IDEAL, still_s=0.0)
    turn, place, speed = Rotation.from_quat(path.quat_xyzw[0]), path.position[0].copy(), path.rates[0][0].copy()
    for k in range(1, len(read)):
        dt = (read.t_ns[k] - read.t_ns[k - 1]) * 1e-9
        step = read.angular_velocity[k] * dt
        push = (turn * Rotation.from_rotvec(step / 2)).apply(read.specific_force[k]) - [0, 0, G_M_S2]
        place, speed, turn = place + speed * dt + push * dt**2 / 2, speed + push * dt, turn * Rotation.from_rotvec(step)
    assert np.linalg.norm(place - path.at(read.t_ns[-1]).position[0]) < 1e-3


def test_noise_and_bias_have_their_sizes() -> None:
    spec = ul.ImuSpec(gyro_walk_deg_s=0, accel_walk_ug=0)
    still = ul.Trajectory.stationary(n=10)
    reads = [ul.simulate_imu(still, spec, still_s=10, seed=seed) for seed in range(8)]
    white = np.std([read.angular_velocity - read.angular_velocity.mean(0) for read in reads[:1]])
    assert white == pytest.approx(np.radians(0.014) * np.sqrt(200), rel=0.05)
    bias = np.array([read.angular_velocity.mean(0) for read in reads])
    assert 0.6 < bias.std() / np.radians(1.0) < 1.5


def test_the_seed_and_the_time_alone_make_the_noise() -> None:
    path = _curve()
    whole = ul.simulate_imu(path, seed=4)
    assert np.array_equal(whole.specific_force, ul.simulate_imu(path, seed=4).specific_force)
    assert not np.allclose(whole.specific_force, ul.simulate_imu(path, seed=5).specific_force)
    part = ul.simulate_imu(path[:200], seed=4)
    assert np.array_equal(part.angular_velocity[:-2], whole.angular_velocity[: len(part) - 2])


@pytest.mark.parametrize(("changes", "said"), [({"still_s": -1.0}, "still_s"), ({"seed": -1}, "seed")])
def test_a_setting_out_of_bounds_is_refused(changes: dict[str, float], said: str) -> None:
    with pytest.raises(ul.InputError, match=said):
        ul.simulate_imu(_curve(), **changes)
