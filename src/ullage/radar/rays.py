"""The ray model of 2018, kept as the baseline [Billdal2018, ch. 4].

A square fan of n x n rays, even in azimuth and elevation, brings back range, hit normal and the object's reflection
coefficient I_m. Eq. 4.1 and 4.2 give each ray the intensity I_R = I_m cos(theta) (|v_r| / R_max)^2; a histogram over
range, white noise and a moving average make a profile of it.

The equation grows with range. It makes sense once the rays are summed: neighbouring rays stand x_n = 2 tan(fov / 2 /
(n - 1)) |v_r| apart (eq. 4.3), so (|v_r| / R_max)^2 is the area across the ray that it stands for, as a share of a
ray's footprint at R_max. The thesis does not print how its amplitudes were scaled. Here they are multiplied by that
footprint, which makes a bin's amplitude the lit area in it [m2], as seen from the radar, times cos(theta) and I_m,
averaged over `smoothing_bins`: it depends neither on the number of rays nor on R_max, and the thesis' threshold of
0.038 is then the footprint of a single ray of 30 x 30 at 5 m (0.195 m squared), the range at which the thesis calls
the resolution acceptable. A facing wall of I_m = 1 gives about 0.32 per metre of distance, a 0.5 m plate 0.08.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ullage.data import Trajectory
from ullage.errors import InputError
from ullage.geometry import quat_matrix
from ullage.kernels.rays import deposit, smooth, turn_fan
from ullage.specs import RadarSpec, ThesisSpec
from ullage.world.raycast import Raycaster
from ullage.world.scene import Scene

Floats = NDArray[np.float64]


def ray_spacing_m(azimuth_deg: float, n: int, range_m: float) -> float:
    """Distance between neighbouring rays of n over an opening, at a range [m] (eq. 4.3).

    Raises:
        InputError: fewer than two rays.
    """
    if n < 2:
        raise InputError(f"n is {n}", where="ray_spacing_m", allowed="n >= 2")
    return 2 * math.tan(math.radians(azimuth_deg / 2) / (n - 1)) * range_m


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
    """Unit directions (n * n, 3) in the sensor frame, elevation slowest."""
    angles = np.radians(np.linspace(-spec.fov_deg / 2, spec.fov_deg / 2, spec.rays_per_side))
    up, left = (a.ravel() for a in np.meshgrid(angles, angles, indexing="ij"))
    return np.stack([np.cos(up) * np.cos(left), np.cos(up) * np.sin(left), np.sin(up)], axis=1)


def ray_area(spec: ThesisSpec) -> float:
    """Area that one ray stands for at the maximum range [m2]."""
    return ray_spacing_m(spec.fov_deg, spec.rays_per_side, spec.max_range_m) ** 2


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


def echoes_thesis(
    scene: Scene, path: Trajectory, spec: RadarSpec, *, caster: Raycaster | None = None
) -> NDArray[np.float32]:
    """Noise-free amplitude profiles of the ray model.

    Args:
        scene: what the rays meet; reflection coefficients come from its materials, moving objects stand where they
            are at the time of each frame.
        path: the sensor's trajectory, one frame per sample.
        spec: range axis and `thesis` settings.
        caster: rays already built for this scene, with wires.

    Returns:
        Amplitudes (n, b).
    """
    rays = caster or Raycaster(scene, wires=True)
    fan = ray_fan(spec.thesis)
    coefficient = np.array([thing.material.reflection for thing in scene.objects], float)[rays.owner]
    out = np.zeros((len(path), spec.bins))
    step = max(1, 65536 // len(fan))
    for first in range(0, len(path), step):
        part = slice(first, min(first + step, len(path)))
        _cast(rays, fan, coefficient, path.position[part], path.quat_xyzw[part], path.t_ns[part], spec, out[part])
    return smoothed(out * ray_area(spec.thesis), spec).astype(np.float32)


def _cast(
    rays: Raycaster,
    fan: Floats,
    coefficient: Floats,
    position: Floats,
    quat_xyzw: Floats,
    t_ns: NDArray[np.int64],
    spec: RadarSpec,
    out: Floats,
) -> None:
    directions = np.empty((len(position), *fan.shape))
    turn_fan(fan, quat_matrix(quat_xyzw), directions)
    starts = np.repeat(position, len(fan), axis=0)
    times = np.repeat(t_ns, len(fan)) if rays.moving else None
    found = rays.trace(starts, directions.reshape(-1, 3), t_ns=times)
    face, distance, cosine = (a.reshape(directions.shape[:2]) for a in found)
    thesis = spec.thesis
    deposit(
        face, distance, cosine, coefficient, thesis.min_range_m, thesis.max_range_m, spec.range_start_m, spec.bin_m, out
    )
