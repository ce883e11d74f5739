"""Radar profiles from somebody else's rays: the thesis' processing of the ranges and intensities of a lidar.

As in `rays`, but the fan was cast by Gazebo's ray or lidar sensor [Billdal2018, ch. 4.3]: its intensity, `laser_retro`,
is the reflection coefficient I_m. A scan does not tell the angle at which a ray meets a surface, so that is taken from
where the neighbouring rays end: of the two on either side, the one that ends at the more similar range.
"""

from __future__ import annotations

import numpy as np

from ullage.arrays import Floats, Singles
from ullage.errors import InputError
from ullage.fan import fan_shape, ray_area, ray_fan, smoothed
from ullage.kernels.rays import NearestHits, RangeBins, accumulate
from ullage.specs import RadarSpec


def echoes_of_scans(range_m: Floats, intensity: Floats, spec: RadarSpec) -> Singles:
    """Noise-free amplitude profiles of scans with the fan of `spec.thesis`.

    Args:
        range_m: of each ray (n, up, across), lowest and rightmost first; not finite where it met nothing [m].
        intensity: reflection coefficient of what each ray met (n, up, across).
        spec: range axis and `thesis` settings.

    Returns:
        Amplitudes (n, b).

    Raises:
        InputError: the scans are not of that fan.
    """
    shape = fan_shape(spec.thesis)
    ranges, strength = np.asarray(range_m, float), np.asarray(intensity, float)
    if ranges.ndim != 3 or ranges.shape[1:] != shape or strength.shape != ranges.shape:
        given = f"{ranges.shape} ranges and {strength.shape} intensities"
        raise InputError(f"scans of {given}", where="echoes_of_scans", allowed=f"(n, {shape[0]}, {shape[1]})")
    fan = ray_fan(spec.thesis).reshape(*shape, 3)
    far, near, out = spec.thesis.max_range_m, spec.thesis.min_range_m, np.zeros((len(ranges), spec.bins))
    for k, (distance, coefficient) in enumerate(zip(ranges, strength, strict=True)):
        met = np.isfinite(distance)
        ray = np.where(met, np.arange(shape[0] * shape[1]).reshape(shape), -1).astype(np.int32)
        cosine = facing(np.where(met, distance, np.nan), fan)
        flat = [np.ascontiguousarray(a).reshape(1, -1) for a in (ray, np.where(met, distance, 0.0), cosine)]
        window = RangeBins(near, far, spec.range_start_m, spec.bin_m)
        accumulate(NearestHits(*flat), coefficient.ravel(), window, out[k : k + 1])
    return smoothed(out * ray_area(spec.thesis), spec).astype(np.float32)


def facing(distance: Floats, fan: Floats) -> Floats:
    """Cosine of the angle between each ray (up, across) and the surface's normal; 1 where neighbours do not tell.

    Args:
        distance: along each ray, NaN where it met nothing [m].
        fan: directions (up, across, 3).
    """
    points = distance[..., None] * fan
    up, left = _slope(points, distance, 0), _slope(points, distance, 1)
    normal = np.cross(left, up)
    length = np.linalg.norm(normal, axis=-1)
    along = np.abs(np.einsum("ijk,ijk->ij", np.nan_to_num(normal), fan))
    known = np.isfinite(length) & (length > 0)
    return np.where(known, np.minimum(along / np.where(known, length, 1.0), 1.0), 1.0)


def _slope(points: Floats, distance: Floats, axis: int) -> Floats:
    """From each point to the next or from the one before, whichever is at the more similar range; NaN without one."""
    step = np.diff(points, axis=axis)
    jump = np.abs(np.diff(distance, axis=axis))
    pad = [(0, 0)] * 3
    pad[axis] = (0, 1)
    after, after_jump = np.pad(step, pad, constant_values=np.nan), np.pad(jump, pad[:2], constant_values=np.nan)
    pad[axis] = (1, 0)
    before, before_jump = np.pad(step, pad, constant_values=np.nan), np.pad(jump, pad[:2], constant_values=np.nan)
    nearer = np.nan_to_num(after_jump, nan=np.inf) <= np.nan_to_num(before_jump, nan=np.inf)
    return np.where(nearer[..., None], after, before)
