"""A quick stand-in for the radar: sheets answer where their mirror point lies, upright edges answer as thin lines."""

from dataclasses import replace

import numpy as np

import ullage as ul
from ullage.data import Frames, Trajectory
from ullage.geometry import quat_matrix

SPEC = ul.RadarSpec.preset("x4m05")


def box_plan(x0, x1, y0, y1):
    p = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    return [(p[i], p[(i + 1) % 4]) for i in range(4)]


def blocked(eye, target, segments, skip):
    """Whether a segment other than `skip` cuts the way from each eye to each target (n, 2)."""
    out = np.zeros(len(eye), bool)
    d = target - eye
    for k, (a, b) in enumerate(segments):
        if k == skip:
            continue
        e = b - a
        det = d[:, 0] * -e[1] + d[:, 1] * e[0]
        with np.errstate(divide="ignore", invalid="ignore"):
            s = ((a[0] - eye[:, 0]) * -e[1] + (a[1] - eye[:, 1]) * e[0]) / det
            u = (d[:, 0] * (a[1] - eye[:, 1]) - d[:, 1] * (a[0] - eye[:, 0])) / det
        out |= (s > 1e-6) & (s < 1 - 1e-4) & (u >= 0) & (u <= 1)
    return out


def pattern(cosine):
    """One-way amplitude of a 65 deg patch: -3 dB at 32.5 deg, -14 dB at the sides and behind."""
    gain = 10 ** (5.97 / 20)
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return gain * np.maximum(10 ** (-3 * (angle / 32.5) ** 2 / 20), 10 ** (-14 / 20))


def listen(
    path,
    segments,
    *,
    poles=(),
    heights=(),
    sheets=(),
    seed=0,
    sensor="front",
    mount=None,
    believed=None,
    noise=5.4e-6,
    edge=0.15,
    spec=SPEC,
):
    """Frames of one sensor in the plan world; `heights` are level sheets (floor, ceiling).

    `sheets` are endless ones of any slope: unit normal away from the flight, and distance from the origin.
    """
    true = path if mount is None else path.mounted(mount)
    poses = true if believed is None else believed if mount is None else believed.mounted(mount)
    eye, ahead = true.position, quat_matrix(true.quat_xyzw)[:, :, 0]
    segments = np.asarray(segments, float)
    axis, k = spec.range_m, 2 * np.pi / spec.wavelength_m
    out = np.zeros((len(eye), len(axis)), complex)
    sigma = spec.pulse_sigma_s * ul.C0 / 2

    def add(point, amplitude, alive):
        ray = point - eye
        r = np.linalg.norm(ray, axis=1)
        g = pattern(np.einsum("ij,ij->i", ray, ahead) / r) ** 2
        a = amplitude(r) * g * alive
        out[:] += (a * np.exp(-2j * k * r))[:, None] * np.exp(-0.5 * ((axis[None] - r[:, None]) / sigma) ** 2)

    def mirror(r):
        return 0.45 * spec.wavelength_m / (8 * np.pi * r)

    for index, (a, b) in enumerate(segments):
        along = (b - a) / np.linalg.norm(b - a)
        way = (eye[:, :2] - a) @ along
        foot = np.column_stack([a + way[:, None] * along, eye[:, 2]])
        on = (way > 0) & (way < np.linalg.norm(b - a))
        add(foot, mirror, on & ~blocked(eye[:, :2], foot[:, :2], segments, index))
    corners = np.unique(np.round(segments.reshape(-1, 2), 6), axis=0)
    for c in corners:
        at = np.column_stack([np.tile(c, (len(eye), 1)), eye[:, 2]])
        near = np.tile(c, (len(eye), 1)) + 1e-3 * (eye[:, :2] - c)
        add(at, lambda r: edge * mirror(r), ~blocked(eye[:, :2], near, segments, -1))
    for x, y, strength in poles:
        at = np.column_stack([np.tile([x, y], (len(eye), 1)), eye[:, 2]])
        add(at, lambda r, s=strength: s * mirror(r) / np.sqrt(r), ~blocked(eye[:, :2], at[:, :2], segments, -1))
    for z in heights:
        add(np.column_stack([eye[:, :2], np.full(len(eye), z)]), mirror, np.ones(len(eye)))
    for normal, distance in sheets:
        away = distance - eye @ np.asarray(normal)
        add(eye + away[:, None] * np.asarray(normal), mirror, away > 0)
    rng = np.random.default_rng([seed, abs(hash(sensor)) % 2**31 if isinstance(sensor, int) else sum(map(ord, sensor))])
    out += noise * (rng.normal(size=out.shape) + 1j * rng.normal(size=out.shape))
    return Frames(out.astype(np.complex64), axis, true.t_ns, spec, poses=poses, truth=true, sensor=sensor)


def rig(path, segments, **options):
    preset = ul.Rig.preset("thesis-4").sensors
    return {
        name: listen(path, segments, sensor=name, mount=spec.mount.body_from_sensor(), spec=spec, **options)
        for name, spec in preset.items()
    }


def reflected(path, reflectors, *, axes, seed=0, spec=None):
    """Frames of four sensors; a reflector gives range (n), direction (n, axes) and strength from places (n, axes)."""
    out = {}
    for number, (name, mounted) in enumerate(ul.Rig.preset("thesis-4").sensors.items()):
        true = path.mounted(mounted.mount.body_from_sensor())
        radar = spec or mounted
        ahead = quat_matrix(true.quat_xyzw)[:, :axes, 0]
        rng = np.random.default_rng([seed, number])
        shape = (len(true), len(radar.range_m))
        samples = 5.4e-6 * (rng.normal(size=shape) + 1j * rng.normal(size=shape)) / np.sqrt(2)
        for reflector in reflectors:
            range_m, direction, strength = reflector(true.position[:, :axes])
            gain = pattern(np.einsum("ij,ij->i", direction, ahead)) ** 2
            level = strength * gain * radar.wavelength_m / (8 * np.pi * range_m)
            phase = np.exp(-4j * np.pi / radar.wavelength_m * range_m)
            pulse = np.exp(-0.5 * ((radar.range_m - range_m[:, None]) / (radar.pulse_sigma_s * ul.C0 / 2)) ** 2)
            samples += (level * phase)[:, None] * pulse
        out[name] = Frames(samples.astype(np.complex64), radar.range_m, true.t_ns, radar, true, true, name)
    return out


def shaken(frames, sigma_m, seed=0):
    """Frames with white errors of their positions, the same for all sensors."""
    error = np.random.default_rng(seed).normal(size=(len(next(iter(frames.values()))), 3)) * sigma_m
    return {
        name: replace(part, poses=Trajectory(part.t_ns, part.poses.position + error, part.poses.quat_xyzw))
        for name, part in frames.items()
    }
