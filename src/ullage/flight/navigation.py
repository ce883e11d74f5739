"""Estimate of the drone's own motion: the truth with white noise, smooth drift and a yaw error."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import ndtri

from ullage import checks
from ullage.arrays import Floats
from ullage.data import Trajectory
from ullage.errors import InputError
from ullage.flight.wander import SmoothNoise, philox


def navigate(
    flown: Trajectory,
    *,
    noise_m: float = 0.0,
    drift_m: float = 0.0,
    drift_time_s: float = 20.0,
    yaw_deg: float = 0.0,
    seed: int = 0,
) -> Trajectory:
    """Return the drone's estimate of the flown path.

    All errors depend on the time of a sample alone, not on its place in the array, so cutting a flight changes no bit.

    Args:
        flown: the true path.
        noise_m: standard deviation of white noise on each axis of the position [m].
        drift_m: rms of a smooth random drift of each axis of the position [m].
        drift_time_s: correlation time of the drift and of the slow yaw error [s].
        yaw_deg: rms of the heading error [deg]: half its variance constant, half slow.
        seed: which errors.

    Raises:
        InputError: a size is negative or not finite, or the correlation time not above zero.
    """
    if not isinstance(flown, Trajectory):
        raise InputError(f"flown is a {type(flown).__name__}", where="navigate", allowed="a Trajectory")
    checks.whole("seed", seed, "navigate", low=0)
    _check(noise_m=noise_m, drift_m=drift_m, yaw_deg=yaw_deg, drift_time_s=drift_time_s)
    t_s = flown.t_ns * 1e-9
    velocity, spin = flown.rates
    position, quat = flown.position, flown.quat_xyzw
    if drift_m > 0:
        drift = [
            SmoothNoise(drift_m, drift_time_s, seed=seed, component=20 + k).at(t_s, derivatives=1) for k in range(3)
        ]
        offset = np.stack(drift, axis=-1)
        position, velocity = position + offset[0], velocity + offset[1]
    if noise_m > 0:
        position = position + noise_m * _white(flown, seed)
    if yaw_deg > 0:
        each = math.radians(yaw_deg) / math.sqrt(2)
        constant = each * float(philox(seed, 30).standard_normal())
        slow = SmoothNoise(each, drift_time_s, seed=seed, component=31).at(t_s, derivatives=1)
        truth = Rotation.from_quat(quat)
        quat = (Rotation.from_rotvec(np.outer(constant + slow[0], (0.0, 0.0, 1.0))) * truth).as_quat()
        spin = spin + truth.inv().apply(np.outer(slow[1], (0.0, 0.0, 1.0)))
    return Trajectory(flown.t_ns, position, quat, velocity, spin)


def _check(*, drift_time_s: float, **sizes: float) -> None:
    for name, value in sizes.items():
        if checks.number(name, value, "navigate", allowed=">= 0") < 0:
            raise InputError(f"{name} is {value}", where="navigate", allowed=">= 0")
    checks.number("drift_time_s", drift_time_s, "navigate", above=0.0, allowed="> 0")


def _white(flown: Trajectory, seed: int) -> Floats:
    """Standard normal numbers (n, 3), keyed by the sample's time."""
    bits = np.stack([philox(seed, 21, int(t)).bit_generator.random_raw(4)[:3] for t in flown.t_ns])
    return np.asarray(ndtri(((bits >> np.uint64(11)).astype(float) + 0.5) * 2.0**-53))
