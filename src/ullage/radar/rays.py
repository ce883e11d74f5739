"""The ray model of 2018, kept as the baseline [Billdal2018, ch. 4].

A fan of rays, even in azimuth and elevation, brings back range, hit normal and the object's reflection coefficient I_m.
It is a square one of n x n rays, or the section of a ring of 360 deg that several radars share (`Rig.cut_from_ring`).
Eq. 4.1 and 4.2 give each ray the intensity I_R = I_m cos(theta) (|v_r| / R_max)^2; a histogram over range, white noise
and a moving average make a profile of it.

The equation grows with range. It makes sense once the rays are summed: neighbouring rays stand x_n = 2 tan(fov / 2 /
(n - 1)) |v_r| apart (eq. 4.3), so (|v_r| / R_max)^2 is the area across the ray that it stands for, as a share of a
ray's footprint at R_max. The thesis does not print how its amplitudes were scaled. Here they are multiplied by that
footprint. A bin's amplitude is then the lit area in it [m2], as seen from the radar, times cos(theta) and I_m, averaged
over `smoothing_bins`. It depends neither on the number of rays nor on R_max. A facing wall of I_m = 1 gives about 0.32
per metre of distance, a 0.5 m plate 0.08.

The threshold of 0.038 is the thesis' own, found by testing. On this scale one ray of 30 x 30 gives its footprint over
three bins: 0.0127 at 5 m, 0.051 at 10 m. So one ray alone passes the threshold beyond 8.6 m only; at 5 m it takes three
rays within three bins. The range axis of a frame reaches R_max (`reaching_max_range`).
"""

from __future__ import annotations

import numpy as np

from ullage.arrays import Floats, Longs, Singles
from ullage.data import Trajectory
from ullage.fan import ray_area, ray_fan, smoothed
from ullage.geometry import quat_matrix
from ullage.kernels.rays import NearestHits, RangeBins, accumulate, turn_fan
from ullage.specs import RadarSpec
from ullage.world.raycast import Raycaster
from ullage.world.scene import Scene


def echoes_thesis(scene: Scene, path: Trajectory, spec: RadarSpec, *, caster: Raycaster | None = None) -> Singles:
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
    t_ns: Longs,
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
    ranges = RangeBins(thesis.min_range_m, thesis.max_range_m, spec.range_start_m, spec.bin_m)
    accumulate(NearestHits(face, distance, cosine), coefficient, ranges, out)
