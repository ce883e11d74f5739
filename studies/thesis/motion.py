"""Simulate the frames of a radar that moves while it integrates one frame.

`simulate` evaluates each frame at one instant. A real X4 sums its `iterations` sweeps over the whole frame
[NoveldaXTAN13]; a target that moves meanwhile turns the phase, and the sum loses amplitude. Here a frame is split into
groups of sweeps, each simulated where the radar then is, and the groups are averaged.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ullage.arrays import Floats
from ullage.data import Frames, Trajectory
from ullage.radar.simulate import simulate
from ullage.specs import RadarSpec, Rig
from ullage.world.scene import Scene


def integration_s(spec: RadarSpec) -> float:
    """Return the time in which the X4 sums one frame: pulses of all DAC steps over the pulse rate [s]."""
    return spec.counts * (spec.dac_max - spec.dac_min + 1) / spec.prf_hz


def blind_speed_m_s(spec: RadarSpec) -> float:
    """Return the radial speed at which one frame sums a full turn of the phase [m/s]."""
    return spec.wavelength_m / (2 * integration_s(spec))


def loss_db(radial_m_s: Floats | float, spec: RadarSpec) -> Floats:
    """Return an echo's level at a radial speed relative to rest: a sinc of Doppler shift times duration [dB]."""
    turns = 2 * np.asarray(radial_m_s, float) * integration_s(spec) / spec.wavelength_m
    return np.asarray(20 * np.log10(np.maximum(abs(np.sinc(turns)), 1e-6)))


def groups_of(speed_m_s: float, spec: RadarSpec) -> int:
    """Return the number of groups of sweeps such that the phase turns at most an eighth in each (0.2 dB at most)."""
    moved = abs(speed_m_s) * integration_s(spec)
    wanted = 16 * moved / spec.wavelength_m
    return int(min(2 ** np.ceil(np.log2(max(wanted, 1))), spec.iterations))


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
        integrate: False evaluates each frame at its middle instant, as `simulate` does.
    """
    spec = next(iter(rig.sensors.values()))
    groups = groups_of(speed_m_s, spec) if integrate else 1
    part = Rig(sensors={key: one.but(iterations=one.iterations // groups) for key, one in rig.sensors.items()})
    ratio, span = speed_m_s / path_speed_m_s, integration_s(spec)
    starts = np.arange(0, path.duration_s / ratio - span, 1 / spec.fps)
    inside = (np.arange(groups) + 0.5) / groups * span
    offset_ns = path.t_ns[0] + np.rint((starts[:, None] + inside).ravel() * ratio * 1e9).astype(np.int64)
    middle_ns = path.t_ns[0] + np.rint((starts + span / 2) * ratio * 1e9).astype(np.int64)
    received = simulate(scene, path.at(offset_ns), part, seed=seed)
    at = path.at(middle_ns)
    times = np.rint((starts + span / 2) * 1e9).astype(np.int64)
    return {key: _averaged(frames, groups, rig.sensors[key], Trajectory(times, at.position, at.quat_xyzw))
            for key, frames in received.items()}  # fmt: skip


def _averaged(frames: Frames, groups: int, spec: RadarSpec, body: Trajectory) -> Frames:
    mean = frames.samples.reshape(-1, groups, frames.samples.shape[1]).mean(1).astype(frames.samples.dtype)
    poses = body.mounted(spec.mount.body_from_sensor())
    return replace(frames, samples=mean, t_ns=poses.t_ns, poses=poses, truth=poses, track=None, spec=spec)
