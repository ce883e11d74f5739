"""Which echoes are objects: the thesis' first peak, all peaks, CFAR, and CLEAN."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal, get_args, overload

import numpy as np
from numpy.typing import ArrayLike

from ullage import checks
from ullage.arrays import Bools, Floats, Longs
from ullage.data import Detections, Frames, one_sensor
from ullage.errors import InputError
from ullage.geometry import C0
from ullage.processing.baseband import checked, envelope, has_phase, noise_sigma, to_baseband
from ullage.processing.cfar import cfar_threshold
from ullage.processing.echoes import blind_m, echo_level, peaks
from ullage.processing.own_echo import own_echo
from ullage.processing.track import tracked

Method = Literal["first_peak", "peaks", "cfar", "os-cfar", "clean", "track"]


@overload
def detect(
    frames: Frames,
    *,
    method: Method = ...,
    threshold: float | None = ...,
    min_range_m: float | None = ...,
    pfa: float = ...,
    guard: int = ...,
    train: int = ...,
    quantile: float = ...,
    correlation: ArrayLike | None = ...,
    max_echoes: int = ...,
    window_m: float = ...,
    remove_own_echo: bool = ...,
) -> Detections: ...
@overload
def detect(
    frames: Mapping[str, Frames],
    *,
    method: Method = ...,
    threshold: float | None = ...,
    min_range_m: float | None = ...,
    pfa: float = ...,
    guard: int = ...,
    train: int = ...,
    quantile: float = ...,
    correlation: ArrayLike | None = ...,
    max_echoes: int = ...,
    window_m: float = ...,
    remove_own_echo: bool = ...,
) -> dict[str, Detections]: ...


def detect(
    frames: Frames | Mapping[str, Frames],
    *,
    method: Method = "first_peak",
    threshold: float | None = None,
    min_range_m: float | None = None,
    pfa: float = 1e-4,
    guard: int = 3,
    train: int = 16,
    quantile: float = 0.75,
    correlation: ArrayLike | None = None,
    max_echoes: int = 16,
    window_m: float = 0.6,
    remove_own_echo: bool = True,
) -> Detections | dict[str, Detections]:
    """Echoes judged to be objects, in each frame, with ranges finer than a bin (parabola through three bins).

    Args:
        frames: one sensor's frames, or several by name.
        method: "first_peak" takes the first local maximum over the threshold, as the thesis does; "peaks" all of
            them; "cfar" and "os-cfar" all that exceed a threshold found from the bins around; "clean" takes the
            strongest echo, subtracts its pulse, and repeats; "track" adds the power of the
            neighbouring frames along the hyperbolas of objects at rest, which shows wires that no single frame does.
        threshold: amplitude in the frames' unit. None: the level that the mapper uses (`processing.echoes`), 0.038 for
            the thesis' amplitudes. Not used by CFAR and track.
        min_range_m: nothing nearer is an object [m]; None: 0.45 m where the sensor leaks, 0.2 m for the thesis'
            sensor, else 0.
        pfa: false alarm probability of each bin (CFAR, track).
        guard: cells left out on either side (CFAR).
        train: cells used on either side (CFAR).
        quantile: share of those cells below the one that counts (os-cfar). A lower one finds echoes among many others.
        correlation: noise correlation between bins at lags 0, 1, ... (CFAR); None: what the receiver's filter gives.
        max_echoes: at most so many a frame (CLEAN).
        window_m: length of track over which power is added (track) [m].
        remove_own_echo: subtract the radar's own echo first (`processing.own_echo`).

    Raises:
        InputError: unknown method, a number out of bounds, or a sample that is not finite.
    """
    if isinstance(frames, Mapping):
        kept: dict[str, Any] = {
            "method": method, "threshold": threshold, "min_range_m": min_range_m, "pfa": pfa, "guard": guard,
            "train": train, "quantile": quantile, "correlation": correlation, "max_echoes": max_echoes,
            "window_m": window_m, "remove_own_echo": remove_own_echo,
        }  # fmt: skip
        return {name: detect(part, **kept) for name, part in frames.items()}
    frames = one_sensor(frames, "detect")
    _refuse_unknown(method, threshold)
    checks.whole("max_echoes", max_echoes, "detect", low=1, allowed=">= 1")
    if min_range_m is not None:
        min_range_m = checks.number("min_range_m", min_range_m, "detect")
    frames = own_echo(checked(frames)).removed_from(frames) if remove_own_echo else frames
    sigma = noise_sigma(checked(frames))
    least_m = blind_m(frames) if min_range_m is None else min_range_m
    if method == "track":
        frame, place, height, snr = tracked(frames, sigma, pfa=pfa, window_m=window_m, min_range_m=least_m)
        return replace(_detections(frames, frame, place, height, sigma), snr_db=snr)
    values = np.asarray(envelope(frames), np.float64)
    far = frames.range_m >= least_m
    if method in ("cfar", "os-cfar"):
        settings: dict[str, Any] = {"pfa": pfa, "guard": guard, "train": train, "correlation": correlation}
        over = values > cfar_threshold(frames, ordered=method == "os-cfar", quantile=quantile, **settings)
    else:
        level = echo_level(frames) if threshold is None else np.full(len(frames), float(threshold))
        if method == "clean":
            return _cleaned(frames, far, level, sigma, max_echoes)
        over = values > level[:, None]
    return _at_peaks(frames, values, peaks(values) & over & far, sigma, first=method == "first_peak")


def _refuse_unknown(method: str, threshold: float | None) -> None:
    if method not in get_args(Method):
        raise InputError(f"no method {method!r}", where="detect", allowed=", ".join(get_args(Method)))
    if threshold is not None:
        checks.number("threshold", threshold, "detect", above=0.0, allowed="> 0")


def _vertex(a: Floats, b: Floats, c: Floats) -> tuple[Floats, Floats]:
    """Place [bins from the middle] and height of the parabola through three values."""
    bend = a - 2 * b + c
    shift = np.where(bend < 0, 0.5 * (a - c) / np.where(bend < 0, bend, 1.0), 0.0)
    return shift, b - 0.25 * (a - c) * shift


def _at_peaks(frames: Frames, values: Floats, at: Bools, sigma: float, *, first: bool) -> Detections:
    frame, bin_ = np.nonzero(at)
    if first:
        frame, nearest = np.unique(frame, return_index=True)
        bin_ = bin_[nearest]
    shift, amplitude = _vertex(*(values[frame, bin_ + k] for k in (-1, 0, 1)))
    return _detections(frames, frame, frames.range_m[bin_] + shift * _bin_m(frames), amplitude, sigma)


def _bin_m(frames: Frames) -> float:
    return float(np.diff(frames.range_m).mean())


def _detections(frames: Frames, frame: Longs, range_m: Floats, amplitude: Floats, sigma: float) -> Detections:
    snr = 20 * np.log10(amplitude / sigma) if sigma > 0 else np.full(len(frame), np.nan)
    nowhere = np.full((len(frame), 3), np.nan)
    return Detections(frame.astype(np.int64), frames.t_ns[frame], range_m, amplitude, snr, nowhere, frames.sensor)


def _cleaned(frames: Frames, far: Bools, level: Floats, sigma: float, most: int) -> Detections:
    """CLEAN [Hogbom1974] with the Gaussian pulse as point response, all frames at once."""
    rest = (np.asarray(frames.samples, np.float64) if not has_phase(frames) else to_baseband(frames)).astype(
        np.complex128
    )
    width = frames.spec.pulse_sigma_s * C0 / 2
    rows, found = np.arange(len(frames)), []
    step, active = _bin_m(frames), np.ones(len(frames), bool)
    for _ in range(most):
        size = np.abs(rest) * far
        top = np.clip(size.argmax(1), 1, size.shape[1] - 2)
        shift, height = _vertex(*(size[rows, top + k] for k in (-1, 0, 1)))
        place = frames.range_m[top] + np.clip(shift, -0.5, 0.5) * step
        active = active & (size[rows, top] > level)
        if not active.any():
            break
        pulse = np.exp(-((frames.range_m[None, :] - place[:, None]) ** 2) / (2 * width**2))
        near = pulse > 0.5
        echo = (rest * pulse * near).sum(1) / np.maximum((pulse**2 * near).sum(1), 1e-12)
        rest = rest - np.where(active, echo, 0)[:, None] * pulse
        found.append((rows[active], place[active], np.abs(echo[active])))
    if not found:
        return _detections(frames, rows[:0], np.zeros(0), np.zeros(0), sigma)
    frame, place, height = (np.concatenate(part) for part in zip(*found, strict=True))
    order = np.lexsort((place, frame))
    return _detections(frames, frame[order], place[order], height[order], sigma)


def roc(
    frames_with: Frames,
    frames_without: Frames,
    range_m: float,
    *,
    gate_m: float = 0.15,
    thresholds: ArrayLike | None = None,
) -> tuple[Floats, Floats, Floats]:
    """Measure the detection rate of an object at a known range against the false alarm rate per bin.

    Args:
        frames_with: frames of a scene with the object.
        frames_without: frames of the same scene without it.
        range_m: the object's range [m].
        gate_m: a peak this near to it counts [m].
        thresholds: amplitudes to try; None: 200 from the least to the greatest that occur.

    Returns:
        Thresholds (k), probability of detection (k) and false alarms a bin (k), rising thresholds.

    Raises:
        InputError: no bins within the gate.
    """
    gate = np.abs(frames_with.range_m - range_m) <= gate_m
    if not gate.any():
        raise InputError(f"no bins within {gate_m} m of {range_m} m", where="roc")
    far = frames_without.range_m >= blind_m(frames_without)
    hit = np.where(gate, np.asarray(envelope(frames_with), np.float64), 0.0).max(1)
    false = np.sort(np.asarray(envelope(frames_without), np.float64)[:, far].ravel())
    low, high = max(float(false[0]), 1e-12), float(max(hit.max(), false[-1]))
    levels = np.geomspace(low, high * 1.01, 200) if thresholds is None else np.sort(np.asarray(thresholds, float))
    found = 1 - np.searchsorted(np.sort(hit), levels, "right") / len(hit)
    return levels, found, 1 - np.searchsorted(false, levels, "right") / len(false)
