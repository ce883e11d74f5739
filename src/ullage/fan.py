"""The fan of rays of the 2018 model [Billdal2018, ch. 4.3]: directions, spacing, range axis, moving average.

The simulator casts it, and processing needs the same fan to predict what a known surface returns.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Floats
from ullage.errors import InputError
from ullage.kernels.rays import smooth
from ullage.specs import RadarSpec, ThesisSpec

FULL_DEG = 360.0


def ray_spacing_m(azimuth_deg: float, n: int, range_m: float) -> float:
    """Distance between neighbouring rays of n over an opening, at a range [m] (eq. 4.3).

    Raises:
        InputError: fewer than two rays.
    """
    if n < 2:
        raise InputError(f"n is {n}", where="ray_spacing_m", allowed="n >= 2")
    return _apart_m(azimuth_deg / (n - 1), range_m)


def _apart_m(step_deg: float, range_m: float) -> float:
    return 2 * math.tan(math.radians(step_deg / 2)) * range_m


def rays_for(azimuth_deg: float, spacing_m: float, range_m: float) -> float:
    """Rays over an opening that stand `spacing_m` apart at a range; round it up (eq. 4.4).

    Eq. 4.5 evaluates it for 65 deg, 0.2 m at 10 m and finds 57.73, hence 58 x 58. It is misprinted there, with 0.4 in
    the place of 0.2 and without the + 1: as printed it would give 28.4.

    Raises:
        InputError: spacing or range is not above zero.
    """
    if not (spacing_m > 0 and range_m > 0):
        raise InputError(f"spacing_m {spacing_m}, range_m {range_m}", where="rays_for", allowed="> 0")
    return math.radians(azimuth_deg / 2) / math.atan(spacing_m / (2 * range_m)) + 1


def ray_fan(spec: ThesisSpec) -> Floats:
    """Unit directions (up * across, 3) in the sensor frame, elevation slowest."""
    up, left = (
        a.ravel() for a in np.meshgrid(*map(np.radians, (elevations_deg(spec), azimuths_deg(spec))), indexing="ij")
    )
    return np.stack([np.cos(up) * np.cos(left), np.cos(up) * np.sin(left), np.sin(up)], axis=1)


def drawn_rays(spec: RadarSpec, *, most: int = 225) -> Floats:
    """Ends (n, 3) of rays to draw, in the sensor frame at the maximum range [m]; evenly thinned to at most `most`."""
    up, across = fan_shape(spec.thesis)
    step = max(1, math.ceil(math.sqrt(up * across / most)))
    fan = ray_fan(spec.thesis).reshape(up, across, 3)
    return np.asarray(fan[step // 2 :: step, step // 2 :: step].reshape(-1, 3) * spec.thesis.max_range_m)


def fan_shape(spec: ThesisSpec) -> tuple[int, int]:
    """Rays one above the other, and rays across."""
    return len(elevations_deg(spec)), len(azimuths_deg(spec))


def elevations_deg(spec: ThesisSpec) -> Floats:
    """Elevation of each row of rays, lowest first [deg]."""
    half = (spec.elevation_deg or spec.fov_deg) / 2
    return np.linspace(-half, half, spec.rays_up or spec.rays_per_side)


def azimuths_deg(spec: ThesisSpec) -> Floats:
    """Azimuth of each ray of a row, rightmost first [deg]. A full circle has no ray twice."""
    if spec.ring_rays is not None:
        return _ring_deg(spec)[ring_section(spec)]
    n, half = spec.rays_per_side, spec.fov_deg / 2
    return np.linspace(-half, half, n, endpoint=spec.fov_deg < FULL_DEG)


def ring_section(spec: ThesisSpec) -> NDArray[np.intp]:
    """Which rays of the ring make the fan, rightmost first."""
    azimuth = _ring_deg(spec)
    inside = np.flatnonzero(np.abs(azimuth) <= spec.fov_deg / 2 + 1e-9)
    return inside[np.argsort(azimuth[inside])]


def _ring_deg(spec: ThesisSpec) -> Floats:
    """Azimuth of each ray of the ring, from -180 to 180, in the order of the ring [deg]."""
    count = spec.ring_rays or 0
    return np.asarray((spec.ring_start_deg + FULL_DEG * np.arange(count) / count + 180.0) % FULL_DEG - 180.0)


def ray_area(spec: ThesisSpec) -> float:
    """Area that one ray stands for at the maximum range [m2]."""
    if spec.ring_rays is not None:
        across = FULL_DEG / spec.ring_rays
    else:
        across = spec.fov_deg / (spec.rays_per_side - (spec.fov_deg < FULL_DEG))
    up = (spec.elevation_deg or spec.fov_deg) / ((spec.rays_up or spec.rays_per_side) - 1)
    return _apart_m(across, spec.max_range_m) * _apart_m(up, spec.max_range_m)


def window(spec: RadarSpec) -> Floats:
    """Weights of the moving average (odd length); on an RF axis it spans as many metres as on the baseband axis."""
    width = spec.thesis.smoothing_bins * (1 if spec.output == "baseband" else spec.decimation)
    weights = np.ones(width if width % 2 else width + 1)
    if width % 2 == 0:
        weights[[0, -1]] = 0.5  # an even window, kept centred
    return weights / spec.thesis.smoothing_bins


def smoothed(rows: Floats, spec: RadarSpec) -> Floats:
    """The moving average of profiles (n, b)."""
    out = np.empty_like(rows)
    smooth(rows, window(spec), out)
    return out


def reaching_max_range(spec: RadarSpec) -> RadarSpec:
    """The radar with enough bins for the ray model's maximum range R_max.

    The X4's own frame ends at 9.61 m, but the thesis' R_max is 10 m. Half a moving average is added, so that an echo at
    R_max is still a local maximum. A longer axis is kept.
    """
    spare = len(window(spec)) // 2 + 1
    needed = math.ceil((spec.thesis.max_range_m - spec.range_start_m) / spec.bin_m) + 1 + spare
    return spec if spec.bins >= needed else spec.but(bins=needed)
