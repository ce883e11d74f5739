"""Obstacle distances as MAVLink messages: OBSTACLE_DISTANCE by sector, DISTANCE_SENSOR for each radar."""

from __future__ import annotations

import math
import re
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Floats
from ullage.geometry import quat_matrix, rpy_quat
from ullage.ports.mavlink.wire import mavlink
from ullage.ports.ned import FLIP
from ullage.processing.obstacles import ObstacleSectors

CUSTOM = 100
"""MAV_SENSOR_ROTATION_CUSTOM: the quaternion says how the sensor is mounted."""
SECTORS, SECTOR_DEG = 72, 5
UNKNOWN = 65535
"""UINT16_MAX: nothing is known of this sector."""
MOST_CM = 65533  # so that "nothing there", one more, is not UNKNOWN
UNKNOWN_COVARIANCE = 255
HALF_STEPS = 2 * SECTORS
"""Directions for which the coverage of a radar is tested, 2.5 degrees apart."""


class Limits(NamedTuple):
    """Least and greatest distance that all messages name [cm]."""

    least: int
    most: int


def limits_of(sectors: ObstacleSectors) -> Limits:
    """The limits of all radars together: every one of them sees from the first to the second.

    PX4 merges what several sensors say of one direction by their greatest distance, so all messages name the same.
    """
    least = math.ceil(100 * max(float(np.max(sectors.least_m, initial=0.0)), 0.0))
    most = math.floor(100 * min(float(np.min(sectors.reach_m, initial=np.inf)), MOST_CM / 100))
    return Limits(min(least, MOST_CM - 2), max(most, least + 2))


def centimetres(distance_m: Floats, limits: Limits) -> NDArray[np.int64]:
    """Distances as both autopilots expect them [cm]: rounded down, and never below the least.

    PX4 and ArduPilot ignore readings below `min_distance`, so an obstacle that is nearer is said to be at it.
    NaN becomes UNKNOWN; what lies beyond the greatest distance, or nowhere, becomes one more than that.
    """
    known = np.nan_to_num(distance_m, nan=np.inf, posinf=np.inf)
    cm = np.floor(np.clip(100 * known, limits.least + 1, limits.most + 1))
    return np.where(np.isnan(distance_m), UNKNOWN, cm).astype(np.int64)


def sector_distances(sectors: ObstacleSectors) -> Floats:
    """The nearest obstacle (72) in each 5 degrees, clockwise from forward [m]; +inf: nothing there; NaN: unknown.

    ArduPilot centres element j on 5 j degrees, PX4 begins it there. An element covers both, from 5 j - 2.5 to 5 j + 5
    degrees. An obstacle in any part of it counts. Only where working radars cover all of it is it free.
    """
    angle = -np.radians(360 / HALF_STEPS) * np.arange(HALF_STEPS)
    level = np.stack([np.cos(angle), np.sin(angle), np.zeros(HALF_STEPS)])
    apart = np.arccos(np.clip(sectors.boresight @ level, -1, 1))
    covered = apart <= sectors.width_rad[:, None] / 2 + 1e-9
    part = (2 * np.arange(SECTORS)[:, None] + np.array([-1, 0, 1, 2])) % HALF_STEPS
    broken = (covered[:, part].any(axis=2) & ~sectors.valid[:, None]).any(axis=0)
    free = (covered & sectors.valid[:, None]).any(axis=0)[part].all(axis=1) & ~broken
    cells = sectors.nearest_m()[-np.arange(SECTORS)]  # clockwise; a cell reaches 2.5 degrees to both sides
    nearest = np.minimum(cells, np.roll(cells, -1))
    return np.where(np.isfinite(nearest), nearest, np.where(free, np.inf, np.nan))


def obstacle_distance(sectors: ObstacleSectors, time_us: int) -> Any:
    """OBSTACLE_DISTANCE in the body's frame, forward-right-down.

    Args:
        sectors: what the radars detect.
        time_us: of the autopilot's clock, or since 1970 [us].
    """
    d, limits = mavlink(), limits_of(sectors)
    cm = centimetres(sector_distances(sectors), limits)
    return d.MAVLink_obstacle_distance_message(
        max(time_us, 0), d.MAV_DISTANCE_SENSOR_RADAR, cm.tolist(), SECTOR_DEG, limits.least, limits.most,
        float(SECTOR_DEG), 0.0, d.MAV_FRAME_BODY_FRD,
    )  # fmt: skip


def distance_sensors(sectors: ObstacleSectors, time_ms: int) -> list[Any]:
    """DISTANCE_SENSOR of each radar that works; without one the autopilot forgets the others after its time limit.

    Args:
        sectors: what the radars detect.
        time_ms: of the autopilot's clock [ms].
    """
    limits = limits_of(sectors)
    cm = centimetres(sectors.distance_m, limits)
    return [_distance_sensor(sectors, k, int(cm[k]), limits, time_ms) for k in range(len(sectors)) if sectors.valid[k]]


@cache
def rotations() -> dict[int, Floats]:
    """Boresights (3), forward-right-down, by number of MAV_SENSOR_ROTATION; CUSTOM is left out."""
    out = {}
    for number, entry in mavlink().enums["MAV_SENSOR_ORIENTATION"].items():
        if not entry.name.startswith("MAV_SENSOR_ROTATION") or number == CUSTOM:
            continue
        turns = dict(re.findall(r"(ROLL|PITCH|YAW)_(\d+)", entry.name))
        roll, pitch, yaw = (math.radians(float(turns.get(name, 0))) for name in ("ROLL", "PITCH", "YAW"))
        out[int(number)] = quat_matrix(rpy_quat(roll, pitch, yaw))[:, 0]
    return out


def orientation_of(boresight_frd: Floats, *, tolerance_deg: float = 1.0) -> int:
    """The first MAV_SENSOR_ROTATION whose boresight is this one (3), forward-right-down; else CUSTOM.

    A distance has no roll about the boresight, so the rotation with the lowest number stands for all.
    """
    least = math.cos(math.radians(tolerance_deg))
    found = (number for number, axis in sorted(rotations().items()) if float(np.dot(axis, boresight_frd)) >= least)
    return next(found, CUSTOM)


def _distance_sensor(sectors: ObstacleSectors, k: int, cm: int, limits: Limits, time_ms: int) -> Any:
    d = mavlink()
    bore = FLIP @ sectors.boresight[k]
    orientation = orientation_of(bore)
    quat = [0.0, 0.0, 0.0, 0.0]  # not used
    if orientation == CUSTOM:
        x, y, z, w = rpy_quat(0.0, -math.asin(float(np.clip(bore[2], -1, 1))), math.atan2(bore[1], bore[0])).tolist()
        quat = [w, x, y, z]
    width = float(sectors.width_rad[k])
    return d.MAVLink_distance_sensor_message(
        time_ms & 0xFFFFFFFF, limits.least, limits.most, cm, d.MAV_DISTANCE_SENSOR_RADAR, k, orientation,
        _covariance(float(sectors.sigma_m[k])), width, width, quat, _quality(sectors, k),
    )  # fmt: skip


def _covariance(sigma_m: float) -> int:
    """Variance [cm^2], at least 1; 255 where it is unknown or does not fit."""
    if not math.isfinite(sigma_m) or 100 * sigma_m >= math.sqrt(UNKNOWN_COVARIANCE - 1):
        return UNKNOWN_COVARIANCE
    return max(math.ceil((100 * sigma_m) ** 2), 1)


def _quality(sectors: ObstacleSectors, k: int) -> int:
    """The part of the nearest echo's amplitude that is not noise, 2 to 100; 0 without an obstacle: unknown."""
    tracks = sectors.tracks
    rows = np.flatnonzero((tracks.sensor == k) & ~tracks.outside)
    if not rows.size:
        return 0
    return int(np.clip(round(100 * (1 - 10 ** (-float(tracks.snr_db[rows[0]]) / 20))), 2, 100))
