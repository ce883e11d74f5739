"""Which echoes are objects."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, overload

import numpy as np
from numpy.typing import NDArray

from ullage.data import Detections, Frames
from ullage.errors import InputError
from ullage.processing.baseband import checked, envelope, is_amplitude, noise_sigma

Floats = NDArray[np.float64]
Method = Literal["first_peak", "peaks"]

THESIS_THRESHOLD = 0.038
_SIGMAS = 5.0
_FLOOR = 10 ** (-50 / 20)


@overload
def detect(frames: Frames, *, method: Method = ..., threshold: float | None = ...) -> Detections: ...
@overload
def detect(
    frames: Mapping[str, Frames], *, method: Method = ..., threshold: float | None = ...
) -> dict[str, Detections]: ...


def detect(
    frames: Frames | Mapping[str, Frames], *, method: Method = "first_peak", threshold: float | None = None
) -> Detections | dict[str, Detections]:
    """Echoes judged to be objects, in each frame.

    Raises:
        InputError: unknown method, a threshold that is not above zero, or a sample that is not finite.
    """
    if isinstance(frames, Mapping):
        return {name: detect(part, method=method, threshold=threshold) for name, part in frames.items()}
    checked(frames)
    sigma = noise_sigma(frames)
    values = np.asarray(envelope(frames), np.float64)
    level = default_threshold(frames, sigma, values) if threshold is None else float(threshold)
    if not level > 0:
        raise InputError(f"threshold is {threshold}", where="detect", allowed="> 0")
    if method not in ("first_peak", "peaks"):
        raise InputError(f"no method {method!r}", where="detect", allowed="first_peak, peaks")
    frame, bin_ = np.nonzero(peaks(values) & (values > level))
    if method == "first_peak":
        frame, first = np.unique(frame, return_index=True)
        bin_ = bin_[first]
    return _at_peaks(frames, values, frame, bin_, sigma)


def default_threshold(frames: Frames, sigma: float, values: Floats) -> float:
    """0.038 for the thesis' amplitudes; else 5 times the noise, or 50 dB under the strongest echo if that is more."""
    if is_amplitude(frames):
        return THESIS_THRESHOLD
    return max(_SIGMAS * sigma, _FLOOR * float(values.max()), 1e-30)


def peaks(values: Floats) -> NDArray[np.bool_]:
    """Local maxima along range (n, b); of a flat top the first bin, never the first or last bin of a frame."""
    out = np.zeros(values.shape, bool)
    out[:, 1:-1] = (values[:, 1:-1] > values[:, :-2]) & (values[:, 1:-1] >= values[:, 2:])
    return out


def _at_peaks(
    frames: Frames, values: Floats, frame: NDArray[np.int64], bin_: NDArray[np.int64], sigma: float
) -> Detections:
    a, b, c = (values[frame, bin_ + k] for k in (-1, 0, 1))
    bend = a - 2 * b + c
    shift = np.where(bend < 0, 0.5 * (a - c) / np.where(bend < 0, bend, 1.0), 0.0)
    amplitude = b - 0.25 * (a - c) * shift
    with np.errstate(divide="ignore"):
        snr = 20 * np.log10(amplitude / sigma) if sigma > 0 else np.full(len(frame), np.nan)
    step = float(np.diff(frames.range_m).mean())
    return Detections(
        frame.astype(np.int64),
        frames.t_ns[frame],
        frames.range_m[bin_] + shift * step,
        amplitude,
        snr,
        np.full((len(frame), 3), np.nan),
        frames.sensor,
    )
