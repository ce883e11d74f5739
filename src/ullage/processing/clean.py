"""What is not of interest taken out of frames: background, direct path, the floor's echo, common phase noise."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ullage.data import Frames
from ullage.errors import InputError
from ullage.geometry import C0, quat_matrix
from ullage.processing.baseband import is_amplitude, to_baseband

Floats = NDArray[np.float64]


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


def _recent(frames: Frames, time_constant_s: float) -> NDArray[np.complex64] | NDArray[np.float32]:
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


def reference_to_direct_path(frames: Frames, *, until_m: float = 0.45) -> Frames:
    """Frames rid of the phase and amplitude noise that all bins of a frame share.

    Every frame is scaled by the one complex number that lays its direct path (bins nearer than `until_m` [m]) on
    the mean direct path; takes strong bins down to the additive noise on real recordings [X4Recordings].

    Raises:
        InputError: amplitudes without phase, or no bins within `until_m`.
    """
    values = to_baseband(frames)
    near = frames.range_m < until_m
    if not near.any():
        raise InputError(
            f"no bins within {until_m} m", where=frames.sensor, allowed="a range axis with the direct path"
        )
    mean = values[:, near].mean(0)
    ratio = values[:, near] @ mean.conj() / float(np.vdot(mean, mean).real or 1.0)
    steady = values / np.where(abs(ratio) > 0.1, ratio, 1.0)[:, None]
    spec = frames.spec if frames.spec.output == "baseband" else frames.spec.but(output="baseband", decimation=1)
    return replace(frames, samples=steady.astype(np.complex64), spec=spec)


def suppress_floor(frames: Frames, *, floor_m: float = 0.0, depth_db: float = 30.0) -> Frames:
    """Frames whose echo from straight below is weakened, at the range the known height says.

    The floor's echo comes from the foot of the perpendicular, whatever the attitude; a notch as wide as the pulse
    moves with the height. What else lies at that range is weakened with it.

    Args:
        frames: frames with poses.
        floor_m: height of the floor [m].
        depth_db: how far the centre of the notch is pressed down [dB].

    Raises:
        InputError: no poses, or a sensor under the floor.
    """
    height = frames.believed.position[:, 2] - floor_m
    if np.any(height <= 0):
        raise InputError(f"sensor {float(-height.min()):.2f} m under the floor", where="suppress_floor")
    width = 2 * frames.spec.pulse_sigma_s * C0 / 2
    shape = np.exp(-(((frames.range_m[None, :] - height[:, None]) / width) ** 2) / 2)
    gain = 10 ** (-depth_db / 20 * np.minimum(1.5 * shape, 1.0))
    return _with(frames, frames.samples * gain)


def looks_down(frames: Frames, opening_deg: float = 65.0) -> NDArray[np.bool_]:
    """Whether each frame's antenna sees the floor straight below it (n)."""
    ahead = quat_matrix(frames.believed.quat_xyzw)[:, :, 0]
    return np.asarray(-ahead[:, 2] >= np.cos(np.radians(opening_deg / 2)))


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
