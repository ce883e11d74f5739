"""Ideal point targets, written from the echo convention alone: no part of ullage's radar engine."""

import numpy as np

import ullage as ul
from ullage.geometry import C0, quat_matrix


def pulse(spec, delay_s):
    return np.exp(-(delay_s**2) / (2 * spec.pulse_sigma_s**2))


def frames_of_points(points, path, *, spec=None, output="baseband", gain=None, noise=0.0, seed=0, believed=None):
    """Frames of unit echoes at points (p, 3), seen from every pose with no spreading loss."""
    spec = spec or ul.RadarSpec.preset("x4m05", antenna={"kind": "isotropic"}, noise=None, output=output)
    delay = 2 * spec.range_m / C0
    reach = np.linalg.norm(np.asarray(points, float)[None] - path.position[:, None], axis=2)
    tau = 2 * reach / C0
    level = np.ones(reach.shape) if gain is None else gain(path, points)
    shape = pulse(spec, delay[None, None, :] - tau[:, :, None]) * level[:, :, None]
    if spec.output == "rf":
        phase = 2 * np.pi * spec.center_hz * (delay[None, None, :] - tau[:, :, None])
        samples = (shape * np.cos(phase)).sum(1)
    else:
        samples = (shape * np.exp(-2j * np.pi * spec.center_hz * tau)[:, :, None]).sum(1)
    rng = np.random.default_rng(seed)
    if noise:
        samples = samples + noise * rng.standard_normal(samples.shape)
        if spec.output != "rf":
            samples = (samples + 1j * noise * rng.standard_normal(samples.shape)) / 1
    return ul.Frames(samples, spec.range_m, path.t_ns, spec, poses=believed or path)


def bearing(path, points):
    """Unit vectors (n, p, 3) in the sensor's frame."""
    to = np.asarray(points, float)[None] - path.position[:, None]
    to = to / np.linalg.norm(to, axis=2, keepdims=True)
    return np.einsum("nji,npj->npi", quat_matrix(path.quat_xyzw), to)


def width(x, power, drop_db=3.0):
    """Full width of the main lobe where the power has fallen by `drop_db`, linear between samples."""
    top = int(np.argmax(power))
    level = power[top] * 10 ** (-drop_db / 10)
    right = top + np.argmax(power[top:] < level)
    left = top - np.argmax(power[top::-1] < level)
    a = np.interp(level, [power[left], power[left + 1]], [x[left], x[left + 1]])
    b = np.interp(level, [power[right], power[right - 1]], [x[right], x[right - 1]])
    return b - a
