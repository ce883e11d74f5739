"""Convert all kinds of samples to complex baseband, and estimate their noise.

An echo of delay tau has phase -2 pi f_c tau at its bin for every sensor output.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Complexes, Floats, SingleComplexes, Singles
from ullage.data import Frames
from ullage.errors import InputError
from ullage.geometry import C0
from ullage.specs import RadarSpec

_LN2 = float(np.log(2.0))


def is_amplitude(frames: Frames) -> bool:
    """Whether the samples are amplitudes without phase, as the thesis' model gives them."""
    return not np.iscomplexobj(frames.samples) and frames.ray_model is not None


def has_phase(frames: Frames) -> bool:
    """Whether the samples have phase: complex ones, and real ones that are RF.

    Real samples of a sensor whose output is baseband are its envelope.
    """
    return np.iscomplexobj(frames.samples) or (frames.spec.output == "rf" and not is_amplitude(frames))


def checked(frames: Frames) -> Frames:
    """The same frames, if every sample is a number.

    Raises:
        InputError: a sample is NaN or infinite.
    """
    if not np.isfinite(frames.samples).all():
        row, bin_ = np.argwhere(~np.isfinite(frames.samples))[0]
        raise InputError(f"sample of frame {row}, bin {bin_} is not finite", where=frames.sensor)
    return frames


def to_baseband(frames: Frames) -> SingleComplexes:
    """Complex baseband (n, b): RF becomes its analytic signal, mixed down by the carrier.

    Raises:
        InputError: the samples are amplitudes without phase.
    """
    if np.iscomplexobj(frames.samples):
        return np.asarray(frames.samples, np.complex64)
    if not has_phase(frames):
        raise InputError(
            "amplitudes have no phase", where=frames.sensor, allowed='baseband or RF samples; method="summation" here'
        )
    return _mixed_down(np.asarray(frames.samples, np.float32), frames.range_m, frames.spec.center_hz)


def as_baseband(frames: Frames) -> Frames:
    """RF frames as complex baseband with two bins in c / (2 bandwidth); all other frames as they are.

    A low-pass filter keeps noise from outside the radar's band out of the fewer bins. The range axis stays in place.
    """
    if np.iscomplexobj(frames.samples) or not has_phase(frames) or len(frames.range_m) < 2:
        return frames
    from scipy.signal import resample_poly

    bin_m = float(frames.range_m[-1] - frames.range_m[0]) / (len(frames.range_m) - 1)
    every = max(1, int(C0 / (4 * frames.spec.bandwidth_hz) / bin_m))
    values = resample_poly(to_baseband(frames), 1, every, axis=1).astype(np.complex64)
    rate_hz = frames.spec.sampling_hz / every
    spec = frames.spec.but(output="baseband", decimation=1, sampling_hz=rate_hz, bins=values.shape[1])
    return replace(frames, samples=values, range_m=frames.range_m[::every], spec=spec)


def _mixed_down(rf: Singles, range_m: Floats, center_hz: float) -> SingleComplexes:
    from scipy.fft import fft, ifft, next_fast_len

    size = next_fast_len(rf.shape[1] + 64)  # a silent tail keeps the far end from leaking into the near one
    spectrum = fft(rf, size, axis=1)
    spectrum[:, 1 : (size + 1) // 2] *= 2
    spectrum[:, size // 2 + 1 :] = 0
    carrier = np.exp(-4j * np.pi * center_hz / C0 * range_m).astype(np.complex64)
    return np.asarray(ifft(spectrum, axis=1)[:, : rf.shape[1]] * carrier, np.complex64)


def envelope(frames: Frames) -> Singles:
    """Amplitude of each bin (n, b), in the frames' unit: of RF the envelope, of amplitudes the samples."""
    if not has_phase(frames):
        return np.asarray(frames.samples, np.float32)
    return np.abs(to_baseband(frames))


def noise_sigma(frames: Frames) -> float:
    """Root of the mean noise power of one bin, robust against echoes.

    The smaller of two estimates: from the quieter half of all bins, and from what changes between neighbouring
    frames, which static clutter leaves alone. 0 for frames without noise.
    """
    if not has_phase(frames):
        values = np.asarray(frames.samples, np.float64)
        return float(min(_of_reals(values - np.median(values)), _of_reals(np.diff(values, axis=0) / np.sqrt(2))))
    values = np.asarray(to_baseband(frames))
    return float(min(_of_complexes(values), _of_complexes(np.diff(values, axis=0) / np.sqrt(2))))


def _of_complexes(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.median(np.abs(values) ** 2) / _LN2)) if values.size else np.inf


def _of_reals(values: NDArray[Any]) -> float:
    return float(1.4826 * np.median(np.abs(values))) if values.size else np.inf


def noise_correlation(spec: RadarSpec, lags: int = 8) -> Complexes:
    """Correlation of the noise of neighbouring bins, lags 0 .. `lags` - 1.

    White RF noise through the X4's 32-tap filter and decimation (0.63, 0.15, 0.01 measured) [X4Recordings]; of RF
    output that of the analytic signal.
    """
    if spec.output == "rf":
        k = np.arange(1, lags)
        return np.concatenate([[1.0], (1 - (-1.0) ** k) / (1j * np.pi * k)])
    if spec.decimation == 1:
        return np.concatenate([[1.0], np.zeros(lags - 1)]).astype(np.complex128)
    from scipy.signal import firwin

    taps = firwin(32, 0.5e9, fs=spec.sampling_hz)
    full = np.correlate(taps, taps, "full")[len(taps) - 1 :: spec.decimation][:lags] / (taps @ taps)
    return np.concatenate([full, np.zeros(lags - len(full))]).astype(np.complex128)
