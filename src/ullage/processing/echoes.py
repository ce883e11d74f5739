"""Which bins of a profile hold echoes: one noise estimate, one level, one blind range and one kind of peak for all.

`ul.detect`, Elfes' grid and the full-profile mapper share them. Each profile is judged by itself, so that a recording
gives the same echoes whether it comes whole or piece by piece.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Bools, Floats
from ullage.data import Frames
from ullage.processing.baseband import envelope, is_amplitude

FALSE_ALARM = math.exp(-18.0)
"""Chance that one bin of noise alone exceeds the level: six sigma of one component, of complex Gaussian noise."""
DYNAMIC_RANGE_DB = 40.0
"""What lies further under the strongest echo of its profile may be a side lobe of that echo's pulse."""
BLIND_M = 0.45
"""Leakage and the device's own ringing lie nearer than this [m] [X4Recordings]."""
_LOWER_QUARTILE = math.sqrt(-2 * math.log(0.75))  # of a Rayleigh distribution, in sigmas of one component


def profile_noise(frames: Frames) -> Floats:
    """Noise of one component (n), from the quieter half of each profile's bins, in the frames' unit."""
    half = max(frames.samples.shape[1] // 2, 4)
    quiet = np.sort(envelope(frames), axis=1)[:, :half]
    return np.asarray(np.maximum(np.median(quiet, axis=1) / _LOWER_QUARTILE, 1e-30), np.float64)


def blind_m(frames: Frames) -> float:
    """Range below which no echo counts [m]: 0.45 m where the sensor leaks, the near limit of the thesis' sensor."""
    if is_amplitude(frames):
        return frames.spec.thesis.min_range_m
    noise = frames.spec.noise
    return BLIND_M if noise is not None and noise.leakage else 0.0


def echo_level(
    frames: Frames, *, false_alarm: float = FALSE_ALARM, dynamic_range_db: float = DYNAMIC_RANGE_DB
) -> Floats:
    """Amplitude above which a bin of each profile holds an echo (n), in the frames' unit.

    The thesis' amplitudes take the threshold of their sensor, 0.038 [Billdal2018, 5.3.3]. Other frames take the larger
    of two levels: what noise alone exceeds with probability `false_alarm` in a bin, and `dynamic_range_db` under the
    strongest echo of the profile. One profile's noise is known to 7 %, which multiplies a rate of 1e-3 by 1.5.

    Args:
        frames: one sensor's.
        false_alarm: probability for each bin.
        dynamic_range_db: how far under the strongest echo others count [dB].
    """
    if is_amplitude(frames):
        return np.full(len(frames), frames.spec.thesis.threshold)
    beyond = frames.range_m >= blind_m(frames)
    strongest = envelope(frames)[:, beyond].max(axis=1, initial=0.0)
    noise = math.sqrt(-2 * math.log(false_alarm)) * profile_noise(frames)
    return np.asarray(np.maximum(noise, 10 ** (-dynamic_range_db / 20) * strongest), np.float64)


def peaks(values: NDArray[np.floating]) -> Bools:
    """Local maxima along range (n, b); of a flat top the first bin, never the first or last bin of a frame."""
    out = np.zeros(values.shape, bool)
    out[:, 1:-1] = (values[:, 1:-1] > values[:, :-2]) & (values[:, 1:-1] >= values[:, 2:])
    return out


def first_echo(frames: Frames, *, threshold: float | None = None) -> tuple[Floats, Bools]:
    """Range of the bin of the first peak over the level (n) [m], and whether there is one (n).

    Args:
        frames: one sensor's.
        threshold: in the frames' unit; None: `echo_level`.
    """
    values = np.asarray(envelope(frames), np.float64)
    level = echo_level(frames) if threshold is None else np.full(len(frames), threshold)
    peak = peaks(values) & (values > level[:, None]) & (frames.range_m >= blind_m(frames))
    return frames.range_m[np.argmax(peak, axis=1)], np.asarray(peak.any(axis=1))
