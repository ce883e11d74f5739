"""Remove unwanted parts of frames: background, direct path, the floor's echo, common phase noise."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ullage.antenna import gain
from ullage.arrays import Floats, Singles
from ullage.data import Frames
from ullage.errors import InputError
from ullage.fan import ray_area, ray_fan, smoothed
from ullage.geometry import C0, quat_matrix
from ullage.processing.baseband import envelope, is_amplitude
from ullage.specs import ThesisSpec


def remove_background(
    frames: Frames,
    *,
    method: Literal["mean", "exponential", "svd"] = "mean",
    time_constant_s: float = 10.0,
    rank: int = 1,
) -> Frames:
    """Frames without what does not change: the direct path, ringing, and all of a scene seen from a standing sensor.

    Args:
        frames: one sensor's frames, any kind of samples.
        method: "mean" of all frames; "exponential" average of the frames before, for streams; "svd" leaves out the
            `rank` strongest common profiles, which may change in strength from frame to frame.
        time_constant_s: memory of the exponential average [s].
        rank: how many profiles "svd" leaves out.

    Raises:
        InputError: unknown method, or a number out of bounds.
    """
    samples = frames.samples
    if method == "mean":
        return replace(frames, samples=samples - samples.mean(0, dtype=_wide(frames)).astype(samples.dtype))
    if method == "exponential":
        if not time_constant_s > 0:
            raise InputError(f"time_constant_s is {time_constant_s}", where="remove_background", allowed="> 0")
        return replace(frames, samples=samples - _recent(frames, time_constant_s))
    if method == "svd":
        if not 1 <= rank < len(frames):
            raise InputError(f"rank is {rank}", where="remove_background", allowed=f"1 .. {len(frames) - 1}")
        u, s, vh = np.linalg.svd(samples, full_matrices=False)
        return _with(frames, (u[:, rank:] * s[rank:]) @ vh[rank:])
    raise InputError(f"no method {method!r}", where="remove_background", allowed="mean, exponential, svd")


def _with(frames: Frames, samples: NDArray[Any]) -> Frames:
    kept: Any = samples.astype(frames.samples.dtype)
    return replace(frames, samples=kept)


def _wide(frames: Frames) -> type[np.complex128] | type[np.float64]:
    return np.complex128 if np.iscomplexobj(frames.samples) else np.float64


def _recent(frames: Frames, time_constant_s: float) -> NDArray[np.complex64] | Singles:
    """The exponential average of the frames before each frame; the first frame is its own background."""
    out = np.empty_like(frames.samples)
    state = frames.samples[0].astype(_wide(frames))
    keep = np.exp(-np.diff(frames.t_ns, prepend=frames.t_ns[0]) * 1e-9 / time_constant_s)
    for n, sample in enumerate(frames.samples):
        out[n] = state
        state = keep[n] * state + (1 - keep[n]) * sample
    return out


def remove_direct_path(frames: Frames, *, until_m: float = 0.45) -> Frames:
    """Frames whose bins nearer than `until_m` [m] are zero: leakage and ringing of the device itself."""
    return _with(frames, np.where(frames.range_m < until_m, 0, frames.samples))


def suppress_floor(frames: Frames, *, floor_m: float = 0.0, depth_db: float = 30.0) -> Frames:
    """Remove the echo of a flat floor, whose place follows from the height, the attitude and the antenna.

    The floor answers twice. Straight below is its mirror echo, in any attitude: a notch as wide as the pulse follows
    the height. Beyond, each range has a ring of floor in the lobe, and the ring scatters back. `floor_trace` predicts
    the shape of that second part. Its strength is the median ratio of received to predicted amplitude, one number for
    all frames. The prediction is subtracted from the amplitude, and the phase is kept. Objects at the same range lose
    as much amplitude as the floor has there, and no more.

    Args:
        frames: frames with poses.
        floor_m: height of the floor [m].
        depth_db: no amplitude is lowered by more than this [dB].

    Raises:
        InputError: no poses, or a sensor under the floor.
    """
    height = frames.believed.position[:, 2] - floor_m
    if np.any(height <= 0):
        raise InputError(f"sensor {float(-height.min()):.2f} m under the floor", where="suppress_floor")
    trace, least = floor_trace(frames, floor_m=floor_m), 10 ** (-depth_db / 20)
    received = envelope(frames).astype(np.float64)
    clear = trace > 0.05 * trace.max(initial=0.0)
    strength = float(np.median(received[clear] / trace[clear])) if clear.any() else 0.0
    kept = np.maximum(1 - strength * trace / np.maximum(received, 1e-30), least)
    if not is_amplitude(frames):
        width = 2 * frames.spec.pulse_sigma_s * C0 / 2
        shape = np.exp(-(((frames.range_m[None, :] - height[:, None]) / width) ** 2) / 2)
        kept = np.minimum(kept, least ** np.minimum(1.5 * shape, 1.0))
    return _with(frames, frames.samples * kept)


def floor_trace(frames: Frames, *, floor_m: float = 0.0) -> Floats:
    """Amplitude (n, b) of a flat floor in each frame, without its mirror echo, for a reflection coefficient of one.

    Amplitudes of the ray model are those of its own fan: the rays that go down meet the floor where they must, with the
    intensity of eq. 4.2. Coherent frames take the radar equation of a floor that scatters by Lambert's law: a solid
    angle dO at range r and incidence t returns the power G^2 cos(t) dO / r^2. There the values are relative.

    Args:
        frames: frames with poses.
        floor_m: height of the floor [m].
    """
    rays = is_amplitude(frames)
    thesis = frames.spec.thesis
    fan = ray_fan(thesis if rays else ThesisSpec(fov_deg=HEMISPHERE_DEG, rays_per_side=90))
    path, out = frames.believed, np.zeros((len(frames), len(frames.range_m)))
    step = (frames.range_m[-1] - frames.range_m[0]) / (len(frames.range_m) - 1)
    for i, rotation in enumerate(quat_matrix(path.quat_xyzw)):
        down = -(fan @ rotation[2])
        with np.errstate(divide="ignore"):
            reach = np.where(down > 1e-6, (path.position[i, 2] - floor_m) / down, np.inf)
        bins = np.floor((np.where(np.isfinite(reach), reach, -1e6) - frames.range_m[0]) / step + 0.5).astype(np.int64)
        met = (bins >= 0) & (bins < out.shape[1])
        if rays:
            met &= (reach >= thesis.min_range_m) & (reach <= thesis.max_range_m)
            weight = ray_area(thesis) * down[met] * (reach[met] / thesis.max_range_m) ** 2
        else:
            area = np.hypot(fan[met, 0], fan[met, 1])  # of the cell of directions, even in both angles
            weight = area * gain(frames.spec.antenna, fan[met]) ** 4 * down[met] / reach[met] ** 2
        out[i] = np.bincount(bins[met], weight, minlength=out.shape[1])
    return smoothed(out, frames.spec) if rays else np.sqrt(_blurred(out, frames))


HEMISPHERE_DEG = 179.0
"""Opening over which a coherent frame's floor is summed: the antenna weighs the directions [deg]."""


def _blurred(power: Floats, frames: Frames) -> Floats:
    """Power over range, seen through the pulse."""
    from scipy.ndimage import gaussian_filter1d

    width = frames.spec.pulse_sigma_s * C0 / 2 / np.sqrt(2) / float(np.diff(frames.range_m).mean())
    return np.asarray(gaussian_filter1d(power, max(width, 1.0), axis=1, mode="constant"))


def smooth(frames: Frames, *, bins: int = 5) -> Frames:
    """Frames with a centred moving average over range bins, as the thesis smooths its amplitudes [Billdal2018, 4.4].

    Raises:
        InputError: `bins` is not an odd number above zero.
    """
    if bins < 1 or bins % 2 == 0:
        raise InputError(f"bins is {bins}", where="smooth", allowed="an odd number >= 1")
    if (
        not is_amplitude(frames)
        and bins * frames.spec.bin_m > C0 / frames.spec.center_hz
        and frames.spec.output == "rf"
    ):
        raise InputError(f"{bins} bins of RF are longer than a wave", where="smooth", allowed="baseband or amplitudes")
    total = np.cumsum(np.pad(frames.samples.astype(_wide(frames)), ((0, 0), (bins // 2 + 1, bins // 2))), axis=1)
    return _with(frames, (total[:, bins:] - total[:, :-bins]) / bins)
