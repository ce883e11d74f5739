"""Simulate the frames of a radar that moves while it sums one frame.

A real X4 sums its `iterations` sweeps over the whole frame [NoveldaXTAN13]; a target that moves meanwhile turns the
phase, and the sum loses amplitude.
"""

from __future__ import annotations

import numpy as np

from ullage.arrays import Floats
from ullage.data import Frames, Trajectory
from ullage.radar.simulate import simulate
from ullage.specs import RadarSpec, Rig
from ullage.world.scene import Scene


def blind_speed_m_s(spec: RadarSpec) -> float:
    """Return the radial speed at which one frame sums a full turn of the phase [m/s]."""
    return spec.wavelength_m / (2 * spec.sweeps_s)


def loss_db(radial_m_s: Floats | float, spec: RadarSpec) -> Floats:
    """Return an echo's level at a radial speed relative to rest: a sinc of Doppler shift times duration [dB]."""
    turns = 2 * np.asarray(radial_m_s, float) * spec.sweeps_s / spec.wavelength_m
    return np.asarray(20 * np.log10(np.maximum(abs(np.sinc(turns)), 1e-6)))


def fly_at(
    scene: Scene,
    path: Trajectory,
    rig: Rig,
    *,
    speed_m_s: float,
    path_speed_m_s: float,
    seed: int = 0,
    integrate: bool = True,
) -> dict[str, Frames]:
    """Simulate the flight of a path at another speed, with frames that integrate while the radar moves.

    Args:
        scene: the world.
        path: of the body at `path_speed_m_s`.
        rig: radars of one kind, at their frame rate.
        speed_m_s: speed to fly at [m/s].
        path_speed_m_s: speed of the path as given [m/s].
        seed: of the noise.
        integrate: False evaluates each frame at its middle instant.
    """
    spec = next(iter(rig.sensors.values()))
    ratio, span = speed_m_s / path_speed_m_s, spec.sweeps_s
    middles = np.arange(0, path.duration_s / ratio - span, 1 / spec.fps) + span / 2
    at = path.at(path.t_ns[0] + np.rint(middles * ratio * 1e9).astype(np.int64))
    velocity, spin = at.rates
    body = Trajectory(np.rint(middles * 1e9), at.position, at.quat_xyzw, velocity * ratio, spin * ratio)
    summed = {key: one.but(integration_s=span if integrate else 0.0) for key, one in rig.sensors.items()}
    return simulate(scene, body, Rig(sensors=summed), seed=seed)
