"""Frames of reference and rigid motion: world ENU, body FLU (REP-103), sensor x along its boresight.

A transform `a_from_b` is a (4, 4) float64 matrix that takes points of frame b into frame a.
Quaternions are xyzw, scalar last, as in ROS and scipy.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ullage.arrays import Floats

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

C0 = 299_792_458.0
"""Speed of light in vacuum [m/s]."""
GRAVITY_M_S2 = 9.81
"""Standard value used by every flight model here [m/s^2]."""


def rotations() -> type[Rotation]:
    """Rotation of scipy, loaded when first used: it brings half of scipy along."""
    from scipy.spatial.transform import Rotation

    return Rotation


def wavelength_m(frequency_hz: float) -> float:
    """Free-space wavelength [m]."""
    return C0 / frequency_hz


def rpy_quat(roll_rad: ArrayLike, pitch_rad: ArrayLike, yaw_rad: ArrayLike) -> Floats:
    """Quaternion xyzw (..., 4) of fixed-axis roll, pitch, yaw [rad] (URDF and SDF order)."""
    angles = np.stack(np.broadcast_arrays(roll_rad, pitch_rad, yaw_rad), axis=-1).astype(float)
    flat = rotations().from_euler("xyz", angles.reshape(-1, 3)).as_quat()
    return np.asarray(flat).reshape((*angles.shape[:-1], 4))


def quat_rpy(quat_xyzw: ArrayLike) -> Floats:
    """Roll, pitch, yaw [rad] (..., 3) of quaternions xyzw (..., 4)."""
    quat = np.asarray(quat_xyzw, float)
    return np.asarray(rotations().from_quat(quat.reshape(-1, 4)).as_euler("xyz")).reshape((*quat.shape[:-1], 3))


def quat_matrix(quat_xyzw: ArrayLike) -> Floats:
    """Rotation matrices (..., 3, 3) of quaternions xyzw (..., 4)."""
    quat = np.asarray(quat_xyzw, float)
    return np.asarray(rotations().from_quat(quat.reshape(-1, 4)).as_matrix()).reshape((*quat.shape[:-1], 3, 3))


def matrix_quat(matrix: ArrayLike) -> Floats:
    """Quaternions xyzw (..., 4) of rotation matrices (..., 3, 3)."""
    rot = np.asarray(matrix, float)
    return np.asarray(rotations().from_matrix(rot.reshape(-1, 3, 3)).as_quat()).reshape((*rot.shape[:-2], 4))


def transform(position_m: ArrayLike = (0, 0, 0), rpy_rad: ArrayLike = (0, 0, 0)) -> Floats:
    """The (4, 4) transform with this translation [m] and fixed-axis roll, pitch, yaw [rad]."""
    out = np.eye(4)
    out[:3, :3] = rotations().from_euler("xyz", np.asarray(rpy_rad, float)).as_matrix()
    out[:3, 3] = position_m
    return out


def invert(a_from_b: Floats) -> Floats:
    """The inverse `b_from_a` of a rigid transform (..., 4, 4)."""
    rot_t = np.swapaxes(a_from_b[..., :3, :3], -1, -2)
    out = np.zeros_like(a_from_b)
    out[..., :3, :3] = rot_t
    out[..., :3, 3] = -(rot_t @ a_from_b[..., :3, 3:])[..., 0]
    out[..., 3, 3] = 1.0
    return out


def apply(a_from_b: Floats, points_b: ArrayLike) -> Floats:
    """Points (n, 3) of frame b, in frame a [m]."""
    return np.asarray(points_b, float) @ a_from_b[:3, :3].T + a_from_b[:3, 3]
