"""Places and attitudes: WGS-84, north-east-down and forward-right-down on the wire; ENU and FLU within.

IMC gives a place as latitude, longitude and height of a reference and a north-east-down offset in the plane that
touches the ellipsoid there. References differ between systems and change in flight, so offsets are carried over
exactly, through earth-centred coordinates [WGS84].
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ullage.data import Trajectory
from ullage.geometry import matrix_quat, quat_matrix, quat_rpy, rpy_quat
from ullage.ports.geodetic import Geodetic
from ullage.ports.ned import FLIP, SWAP
from ullage.ports.pose_events import BodyState

TRONDHEIM = Geodetic.degrees(63.4185, 10.4009)
"""Origin of a world without a geodetic place: the campus of the thesis."""


def pose_of(state: Mapping[str, Any], t_ns: int, origin: Geodetic) -> BodyState:
    """Return the pose of an EstimatedState or SimulatedState in the world with this origin."""
    here = Geodetic(state["lat"], state["lon"], state["height"])
    offset = np.array([state["x"], state["y"], state["z"]], float)
    if here == origin:
        turn, place = np.eye(3), offset
    else:
        turn = origin.earth_from_ned.T @ here.earth_from_ned
        place = origin.earth_from_ned.T @ (here.earth_centred - origin.earth_centred) + turn @ offset
    ned_from_frd = quat_matrix(rpy_quat(state["phi"], state["theta"], state["psi"]))
    if "vx" in state:
        velocity = turn @ np.array([state["vx"], state["vy"], state["vz"]], float)
    else:
        velocity = turn @ ned_from_frd @ np.array([state["u"], state["v"], state["w"]], float)
    return BodyState(
        t_ns,
        SWAP @ place,
        matrix_quat(SWAP @ turn @ ned_from_frd @ FLIP),
        SWAP @ velocity,
        FLIP @ np.array([state["p"], state["q"], state["r"]], float),
    )


def state_of(pose: BodyState, origin: Geodetic) -> dict[str, float]:
    """Return the fields of an EstimatedState for a pose; altitude is the height over the world's z = 0."""
    ned_from_frd = SWAP @ quat_matrix(pose.quat_xyzw) @ FLIP
    phi, theta, psi = (float(a) for a in quat_rpy(matrix_quat(ned_from_frd)))
    x, y, z = (float(v) for v in SWAP @ pose.position)
    vx, vy, vz = (float(v) for v in SWAP @ pose.velocity)
    u, v, w = (float(k) for k in ned_from_frd.T @ (SWAP @ pose.velocity))
    p, q, r = (float(k) for k in FLIP @ pose.spin)
    return {
        "lat": origin.lat_rad, "lon": origin.lon_rad, "height": origin.height_m, "x": x, "y": y, "z": z,
        "phi": phi, "theta": theta, "psi": psi, "u": u, "v": v, "w": w, "vx": vx, "vy": vy, "vz": vz,
        "p": p, "q": q, "r": r, "depth": -1.0, "alt": float(pose.position[2]),
    }  # fmt: skip


def poses_along(path: Trajectory) -> list[BodyState]:
    """Return each sample of a trajectory as a pose."""
    velocity, spin = path.rates
    columns = zip(path.t_ns, path.position, path.quat_xyzw, velocity, spin, strict=True)
    return [BodyState(int(t), *rest) for t, *rest in columns]
