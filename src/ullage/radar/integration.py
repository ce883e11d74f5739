"""Motion within a frame: a radar sums its pulses over a time in which it, and other things, move.

A frame is the mean of echoes over `RadarSpec.integration_s` about its stamp. The mean is a Gauss-Legendre sum over a
few instants. Within a frame the radar goes and turns evenly, at the velocities that its trajectory has at the stamp;
other objects follow their own motion. An echo ahead loses sinc(2 v T / lambda) at a speed v.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from ullage.arrays import Floats
from ullage.data import Samples, Trajectory
from ullage.geometry import rotations
from ullage.specs import RadarSpec
from ullage.world.scene import Scene

ERROR = 1e-4
"""Largest error of the sum, as a share of the echo at rest."""
PART = 16.0
"""Half a turn of the phase [rad] beyond which a frame is summed in parts: rules of many nodes take long to find."""


def integrated(
    echoes: Callable[[Trajectory], Samples], path: Trajectory, spec: RadarSpec, scene: Scene, *, bounces: int = 1
) -> Samples:
    """Average echoes over the time in which a radar sums each frame.

    Args:
        echoes: samples (k, b) at some poses of the sensor (k).
        path: of the sensor, at the stamps of the frames (n).
        spec: the radar; with an `integration_s` of 0 its frames are those of one instant.
        scene: the world.
        bounces: largest number of reflections.

    Returns:
        Samples (n, b).
    """
    if not spec.integration_s or not len(path):
        return echoes(path)
    return np.concatenate([_mean(echoes, path[i : i + 1], spec, scene, bounces) for i in range(len(path))])


def _mean(
    echoes: Callable[[Trajectory], Samples], pose: Trajectory, spec: RadarSpec, scene: Scene, bounces: int
) -> Samples:
    speed = _speed(pose, spec) + bounces * _fastest(scene, int(pose.t_ns[0]), spec.integration_s)
    # half of what the phase 4 pi r / lambda of the band's upper edge turns within the frame
    turn = 2 * np.pi * speed * spec.integration_s / spec.wavelength_m * (1 + spec.bandwidth_hz / (2 * spec.center_hz))
    nodes, weights = _rule(turn)
    if len(nodes) == 1:
        return echoes(pose)
    samples = echoes(instants(pose, nodes * (spec.integration_s / 2)))
    samples[0] = weights @ samples
    return samples[:1]


def instants(pose: Trajectory, after_s: Floats) -> Trajectory:
    """Continue one pose evenly to times (k) before and after it [s], strictly rising."""
    velocity, spin = pose.rates
    turned = rotations().from_quat(pose.quat_xyzw[0]) * rotations().from_rotvec(after_s[:, None] * spin)
    still = np.zeros((len(after_s), 3))
    return Trajectory(
        pose.t_ns + np.rint(after_s * 1e9).astype(np.int64),
        pose.position + after_s[:, None] * velocity,
        turned.as_quat(),
        still + velocity,
        still + spin,
    )


@lru_cache(maxsize=256)
def _rule(turn: float) -> tuple[Floats, Floats]:
    """Return nodes in [-1, 1] and weights of the mean of e^{j turn x}: few, in even parts, within `ERROR`.

    The remainder of n nodes is at most 2^(2n) (n!)^4 turn^(2n) / ((2n + 1) (2n)!^3) [AbramowitzStegun1964, 25.4.30].
    """
    parts, count = math.ceil(turn / PART) or 1, 1
    log_turn = math.log(max(2 * turn / parts, 1e-300))
    while (2 * count * log_turn + 4 * math.lgamma(count + 1) - 3 * math.lgamma(2 * count + 1)
           > math.log(ERROR * (2 * count + 1))):  # fmt: skip
        count += 1
    nodes, weights = np.polynomial.legendre.leggauss(count)
    starts = np.arange(parts)[:, None]
    return ((2 * starts + 1 + nodes) / parts - 1).ravel(), np.tile(weights / (2 * parts), parts)


def _speed(pose: Trajectory, spec: RadarSpec) -> float:
    """Return the speed of a radar's antennas [m/s], with that of the edge of an aperture as wide as its beam tells."""
    velocity, spin = pose.rates
    beam = math.radians(min(spec.antenna.azimuth_deg, spec.antenna.elevation_deg))
    arm = (spec.antenna_offset_m + spec.wavelength_m / beam) / 2
    return float(np.linalg.norm(velocity[0]) + np.linalg.norm(spin[0]) * arm)


def _fastest(scene: Scene, t_ns: int, within_s: float) -> float:
    """Return the speed of the fastest point of all objects at the start, the middle and the end of a frame [m/s]."""
    times = t_ns + np.rint(within_s * 1e9 * np.array([-0.5, 0.0, 0.5])).astype(np.int64)
    speeds = [0.0]
    for thing, reach_m in zip(scene.objects, _reaches(scene), strict=True):
        if thing.motion is not None:
            known = np.unique(np.clip(times, *thing.motion.t_ns[[0, -1]]))
            velocity, spin = thing.motion.at(known).rates
            speeds += (np.linalg.norm(velocity, axis=1) + reach_m * np.linalg.norm(spin, axis=1)).tolist()
    return max(speeds)


@lru_cache(maxsize=8)
def _reaches(scene: Scene) -> Floats:
    """Return the distance of each object's (o) farthest point from its own origin [m]."""
    out, wires = np.zeros(len(scene.objects)), scene.wires
    far = np.linalg.norm(scene.vertices, axis=1)
    np.maximum.at(out, scene.face_object, far[scene.faces].max(1, initial=0.0))
    for ends in (wires.start, wires.end):
        np.maximum.at(out, wires.object_id, np.linalg.norm(ends, axis=1))
    return out
