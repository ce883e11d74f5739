"""Inertial unit and altimeter of a flight controller, simulated along a path."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ndtri

from ullage import checks
from ullage.arrays import Floats, Longs
from ullage.data import Height, Imu, Trajectory, even_times
from ullage.errors import InputError
from ullage.flight.wander import philox
from ullage.geometry import GRAVITY_M_S2, quat_matrix, rotations
from ullage.specs import ImuSpec

_IMU, _BIAS, _HEIGHT = 0x494D55, 0x494D56, 0x494D57  # components of the noise


MPU6000 = ImuSpec(
    gyro_noise_deg_s=0.005 / math.sqrt(2), accel_noise_ug=400 / math.sqrt(2), gyro_bias_deg_s=0, accel_bias_mg=0,
    gyro_walk_deg_s=0, accel_walk_ug=0,
)  # fmt: skip
"""White noise alone: the data sheet's densities, 0.005 deg/s and 400 ug/sqrt(Hz), are one-sided [MPU6000]."""


def simulate_imu(
    path: Trajectory, spec: ImuSpec | None = None, *, still_s: float = 2.0, seed: int = 0, begun_ns: int | None = None
) -> Imu:
    """Simulate the readings of an inertial unit at the body's origin.

    A reading is the mean since the one before it, as units give it that integrate in between. The noise of a reading
    depends on the seed and its time alone, so cutting a flight changes no bit of it.

    Args:
        path: true poses of the body.
        spec: the unit; None: a BMI088.
        still_s: the body rests at its first pose for so long before the path begins; readings then come before it [s].
        seed: of noise and offsets.
        begun_ns: start of the flight that the path is a piece of, for the offsets; None: that of the path [ns].

    Raises:
        InputError: the path is no trajectory of two poses or more, or a number is out of bounds.
    """
    if not isinstance(path, Trajectory) or len(path) < 2:
        raise InputError("path is no trajectory to fly along", where="simulate_imu", allowed="two poses or more")
    if checks.number("still_s", still_s, "simulate_imu", allowed=">= 0") < 0:
        raise InputError(f"still_s is {still_s}", where="simulate_imu", allowed=">= 0")
    spec, seed = spec or ImuSpec(), checks.whole("seed", seed, "simulate_imu", low=0)
    count = int(still_s * spec.rate_hz)
    first = int(path.t_ns[0])
    moving = even_times(spec.rate_hz, t0_ns=first, t1_ns=int(path.t_ns[-1]))
    still = first - even_times(spec.rate_hz, count=count + 1)[:0:-1]
    rate, force = _true_readings(path.at(moving))
    turn = quat_matrix(path.quat_xyzw[0])
    rate = np.concatenate([np.zeros((count, 3)), rate])
    force = np.concatenate([np.tile(GRAVITY_M_S2 * turn[2], (count, 1)), force])
    t_ns = np.concatenate([still, moving])
    turned, pushed = white_noise(t_ns, spec, seed=seed)
    bias = _bias(t_ns - (first if begun_ns is None else begun_ns), spec, seed)
    return Imu(t_ns, rate + bias[:, :3] + turned, force + bias[:, 3:] + pushed)


def white_noise(t_ns: Longs, spec: ImuSpec, *, seed: int) -> tuple[Floats, Floats]:
    """Return white noise (n, 3) of turn rate [rad/s] and specific force [m/s2], by seed and time of a reading alone."""
    noise = _noise(t_ns, seed, _IMU, 6) * math.sqrt(spec.rate_hz)
    return spec.gyro_noise * noise[:, :3], spec.accel_noise * noise[:, 3:]


def simulate_height(path: Trajectory, *, sigma_m: float = 0.1, rate_hz: float = 10.0, seed: int = 0) -> Height:
    """Simulate heights of the body over z = 0 with white noise, as an altimeter gives them.

    Args:
        path: true poses of the body.
        sigma_m: of the noise [m].
        rate_hz: readings a second.
        seed: of the noise.

    Raises:
        InputError: a number is out of bounds.
    """
    checks.number("sigma_m", sigma_m, "simulate_height", above=0.0, allowed="> 0")
    t_ns = even_times(rate_hz, t0_ns=int(path.t_ns[0]), t1_ns=int(path.t_ns[-1]))
    noise = _noise(t_ns, checks.whole("seed", seed, "simulate_height", low=0), _HEIGHT, 1)[:, 0]
    return Height(t_ns, path.at(t_ns).position[:, 2] + sigma_m * noise, sigma_m)


def _true_readings(path: Trajectory) -> tuple[Floats, Floats]:
    """Mean turn rate and specific force (n, 3) in the body since the pose before; the first one repeats the second."""
    if len(path) < 2:
        return np.zeros((1, 3)), GRAVITY_M_S2 * quat_matrix(path.quat_xyzw)[:, 2]
    turn, dt = rotations().from_quat(path.quat_xyzw), np.diff(path.t_ns)[:, None] * 1e-9
    step = (turn[:-1].inv() * turn[1:]).as_rotvec()
    middle = turn[:-1] * rotations().from_rotvec(step / 2)
    push = np.diff(path.rates[0], axis=0) / dt + np.array([0.0, 0.0, GRAVITY_M_S2])
    rate, force = step / dt, middle.inv().apply(push)
    return np.concatenate([rate[:1], rate]), np.concatenate([force[:1], force])


def _noise(t_ns: Longs, seed: int, component: int, columns: int) -> Floats:
    """Standard normal numbers (n, columns), keyed by time."""
    bits = np.stack([philox(seed, component, int(t)).bit_generator.random_raw(8)[:columns] for t in t_ns])
    return np.asarray(ndtri(((bits >> np.uint64(11)).astype(float) + 0.5) * 2.0**-53))


def _bias(since_ns: Longs, spec: ImuSpec, seed: int) -> Floats:
    """Offsets (n, 6) at times since the start of the path: random walks with a knot each second."""
    last = int(np.ceil(max(since_ns[-1] * 1e-9, 0))) + 1
    steps = np.stack([philox(seed, _BIAS, k).standard_normal(6) for k in range(last + 1)])
    sizes = np.repeat(np.array([spec.bias, spec.walk]), 3, axis=1)
    steps *= np.where(np.arange(last + 1)[:, None] == 0, sizes[0], sizes[1])
    walk, second = np.cumsum(steps, axis=0), np.clip(since_ns * 1e-9, 0, last)
    return np.stack([np.interp(second, np.arange(last + 1), column) for column in walk.T], axis=1)
