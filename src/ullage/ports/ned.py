"""North-east-down and forward-right-down, which autopilots and DUNE use; ENU and FLU everywhere else (REP-103)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ullage.arrays import Floats
from ullage.geometry import matrix_quat, quat_matrix

FLIP = np.diag([1.0, -1.0, -1.0])  # forward-left-up to forward-right-down and back
SWAP = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # east-north-up to north-east-down and back


def enu_position(ned_m: ArrayLike) -> Floats:
    """Position (3) in east-north-up of a position (3) in north-east-down [m]."""
    return np.asarray(SWAP @ np.asarray(ned_m, float))


def enu_quat(ned_from_frd_xyzw: ArrayLike) -> Floats:
    """Quaternion xyzw (..., 4) from FLU to ENU of one from FRD to NED."""
    return matrix_quat(SWAP @ quat_matrix(ned_from_frd_xyzw) @ FLIP)
