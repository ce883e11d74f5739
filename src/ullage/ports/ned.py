"""North-east-down and forward-right-down, which autopilots and DUNE use; ENU and FLU everywhere else (REP-103).

Places on the earth are in WGS-84, and in the plane that touches it at a place [WGS84].
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ullage.arrays import Floats
from ullage.errors import InputError
from ullage.geometry import matrix_quat, quat_matrix

FLIP = np.diag([1.0, -1.0, -1.0])  # forward-left-up to forward-right-down and back
SWAP = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # east-north-up to north-east-down and back


def enu_position(ned_m: ArrayLike) -> Floats:
    """Position (3) in east-north-up of a position (3) in north-east-down [m]."""
    return np.asarray(SWAP @ np.asarray(ned_m, float))


def enu_quat(ned_from_frd_xyzw: ArrayLike) -> Floats:
    """Quaternion xyzw (..., 4) from FLU to ENU of one from FRD to NED."""
    return matrix_quat(SWAP @ quat_matrix(ned_from_frd_xyzw) @ FLIP)


MAJOR_M, FLATTENING = 6_378_137.0, 1 / 298.257223563
ECCENTRICITY2 = FLATTENING * (2 - FLATTENING)
MOST_HEIGHT_M = 1e5


@dataclass(frozen=True, slots=True)
class Geodetic:
    """A point on or near the earth."""

    lat_rad: float
    lon_rad: float
    height_m: float = 0.0  # over the ellipsoid

    @classmethod
    def degrees(cls, lat_deg: float, lon_deg: float, height_m: float = 0.0) -> Geodetic:
        """From latitude and longitude in degrees."""
        return cls(math.radians(lat_deg), math.radians(lon_deg), height_m)

    @property
    def earth_centred(self) -> Floats:
        """Place (3) in the frame that turns with the earth [m]."""
        sin = math.sin(self.lat_rad)
        normal = MAJOR_M / math.sqrt(1 - ECCENTRICITY2 * sin * sin)
        side = (normal + self.height_m) * math.cos(self.lat_rad)
        up = (normal * (1 - ECCENTRICITY2) + self.height_m) * sin
        return np.array([side * math.cos(self.lon_rad), side * math.sin(self.lon_rad), up])

    @property
    def earth_from_ned(self) -> Floats:
        """Rotation (3, 3) from north, east, down here to the earth-centred frame."""
        sin, cos = math.sin(self.lat_rad), math.cos(self.lat_rad)
        sin_lon, cos_lon = math.sin(self.lon_rad), math.cos(self.lon_rad)
        return np.array([
            [-sin * cos_lon, -sin_lon, -cos * cos_lon],
            [-sin * sin_lon, cos_lon, -cos * sin_lon],
            [cos, 0.0, -sin],
        ])  # fmt: skip

    def moved(self, ned_m: Floats) -> Geodetic:
        """Return the point at this offset north, east and down [m]."""
        x, y, z = self.earth_centred + self.earth_from_ned @ np.asarray(ned_m, float)
        side = math.hypot(x, y)
        lat, height = math.atan2(z, side * (1 - ECCENTRICITY2)), 0.0
        for _ in range(6):  # contracts by a factor of 300 a round
            sin = math.sin(lat)
            normal = MAJOR_M / math.sqrt(1 - ECCENTRICITY2 * sin * sin)
            height = side * math.cos(lat) + z * sin - MAJOR_M * math.sqrt(1 - ECCENTRICITY2 * sin * sin)
            lat = math.atan2(z, side * (1 - ECCENTRICITY2 * normal / (normal + height)))
        return Geodetic(lat, math.atan2(y, x), height)

    def local(self, lat_deg: ArrayLike, lon_deg: ArrayLike, height_m: ArrayLike) -> Floats:
        """Places (n, 3) east, north and up of this one [m]."""
        points = zip(*(np.ravel(np.asarray(one, float)) for one in (lat_deg, lon_deg, height_m)), strict=True)
        earth = np.array([Geodetic.degrees(*point).earth_centred for point in points]).reshape(-1, 3)
        return np.asarray((earth - self.earth_centred) @ self.earth_from_ned @ SWAP.T)


TRONDHEIM = Geodetic.degrees(63.4185, 10.4009)
"""Origin of a world without a geodetic place: the campus of the thesis."""


def datum_of(text: object, option: str = "datum") -> Geodetic:
    """The place in `latitude,longitude` or `latitude,longitude,height` [deg, m] that an option gives.

    Raises:
        InputError: it is none.
    """
    try:
        values = [float(part) for part in str(text).split(",")]
        within = zip(map(abs, values), (90, 180, MOST_HEIGHT_M), strict=False)
        if len(values) in (2, 3) and all(value <= most for value, most in within):
            return Geodetic.degrees(*values)
    except ValueError:
        pass
    raise InputError(f"{option} is {str(text)!r}", where=option, allowed="latitude,longitude or with ,height_m")
