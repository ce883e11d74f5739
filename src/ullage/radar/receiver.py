"""The X4 receiver: the effects on clean echoes, in the order in which they occur.

Direct path, then phase and amplitude common to a whole frame, the DAC window, additive noise through the on-chip
filter, and the lattice of the counts. The values are those of real recordings [X4Recordings]; names of settings and
the normalisation of counts are the maker's [NoveldaXTAN13], [NoveldaX4Driver]. Clean echoes come and go in units of
sqrt(received / transmitted power); in between they are in the sensor's normalised units.

Every random number of frame i comes from a counter-based generator keyed by (seed, component, i) [SalmonEtAl2011].
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Complexes, Floats, Longs, Singles
from ullage.data import Samples
from ullage.errors import InputError
from ullage.fan import smoothed
from ullage.geometry import C0
from ullage.kernels.receiver import limit_envelope
from ullage.radar.leakage import leakage
from ullage.radar.pulse import chip_taps
from ullage.specs import NoiseSpec, RadarSpec

THERMAL, COMMON, THESIS = 0, 1, 2
"""Components that draw random numbers of their own."""

SIGMA_RATIO = 0.3455
"""Measured sigma of the baseband noise (complex) over that of the RF noise."""
FILTER_SCALE = 306
"""Baseband values lie on a lattice this much finer than the counts: the scale of the on-chip filter's integer taps."""


class Draws:
    """Random numbers of one component: those of a frame are the same however the frames are cut."""

    def __init__(self, seed: int, component: int) -> None:
        self._bits = np.random.Philox(key=[seed, component])
        self._numbers = np.random.Generator(self._bits)
        self._state = self._bits.state  # putting a state back costs a fifth of making a new generator

    def of(self, frame: int) -> np.random.Generator:
        """Return the generator at the start of a frame; the next call moves it."""
        self._state["state"]["counter"] = np.array([0, 0, 0, frame], np.uint64)
        self._bits.state = self._state
        return self._numbers


def normalised(count: Floats, spec: RadarSpec) -> Floats:
    """Return the counts of one RF sample in the sensor's normalised units [NoveldaX4Driver]."""
    return np.asarray(np.asarray(count) * lattice(spec) - dac_limit(spec))


def counted(value: Floats, spec: RadarSpec) -> Longs:
    """Convert a normalised RF value to counts, between none and all of them."""
    count = np.rint((np.asarray(value) + dac_limit(spec)) / lattice(spec))
    return np.clip(count, 0, round(2 * dac_limit(spec) / lattice(spec))).astype(np.int64)


def dac_limit(spec: RadarSpec) -> float:
    """Return the largest RF amplitude that the DAC window holds, in normalised units."""
    return (spec.dac_max - spec.dac_min + 1) / 2048


def lattice(spec: RadarSpec) -> float:
    """Return the step between possible RF values, in normalised units."""
    return float(2**spec.dac_step / (1024 * spec.counts))


def noise_sigma(spec: RadarSpec) -> float:
    """Return the sigma of the additive noise of one output sample in normalised units: of |c| at baseband, of x at RF.

    It falls with the root of the counts. A coarser DAC step leaves out thresholds, each with noise of its own.
    """
    if spec.noise is None:
        return 0.0
    rf = spec.noise.thermal * float(np.sqrt(2.0**spec.dac_step / spec.counts))
    return rf if spec.output == "rf" else rf * SIGMA_RATIO


def unit(spec: RadarSpec) -> float:
    """Return the normalised units of the output per unit of sqrt(path gain)."""
    noise = spec.noise or NoiseSpec()
    return noise.unit_gain * (noise.baseband_gain if spec.output == "baseband" else 1.0)


def phase_sigma(spec: RadarSpec) -> float:
    """Return the sigma of a frame's common phase [rad]: a floor, and a part that falls with the root of the counts."""
    if spec.noise is None:
        return 0.0
    return float(np.hypot(spec.noise.phase_rad, spec.noise.phase_thermal_rad / np.sqrt(spec.counts)))


def fold(profile: NDArray[Any], spec: RadarSpec) -> NDArray[Any]:
    """Add echoes from beyond the unambiguous range to the frame.

    Args:
        profile: clean echoes (n, b') on the radar's bins and on as many more beyond them as there are.
        spec: the radar.

    Returns:
        Echoes (n, bins); what falls between the end of the frame and the next pulse is lost.

    Raises:
        InputError: fewer bins than the radar has.
    """
    if profile.shape[-1] < spec.bins:
        raise InputError(f"{profile.shape[-1]} bins", where="fold", allowed=f"{spec.bins} or more")
    out = profile[..., : spec.bins].copy()
    shift = spec.unambiguous_range_m / spec.bin_m
    for turn in range(1, int(profile.shape[-1] / shift) + 1):
        first = turn * shift
        places = np.arange(spec.bins) + first
        low = np.floor(places + 1e-9).astype(int)
        share = np.maximum(places - low, 0.0)
        share[share < 1e-6] = 0.0
        wide = np.concatenate([profile, np.zeros((*profile.shape[:-1], 2), profile.dtype)], axis=-1)
        low = np.minimum(low, profile.shape[-1])
        late = (1 - share) * wide[..., low] + share * wide[..., low + 1]
        if spec.output == "baseband":
            late = late * np.exp(2j * np.pi * spec.center_hz / spec.prf_hz * turn)
        out += late.astype(profile.dtype)
    return out


def receive(clean: NDArray[Any], spec: RadarSpec, *, seed: int, first_frame: int = 0) -> Samples:
    """Apply the receiver to clean echoes.

    Args:
        clean: complex baseband (n, b), or real RF when `spec.output` is "rf", in sqrt(received / transmitted power);
            with more bins than the radar has, those beyond the unambiguous range fold back in.
        spec: the radar; with `noise=None` the echoes pass unchanged.
        seed: of the noise.
        first_frame: number of the first row; frame i has the same noise in every cut.

    Returns:
        Samples (n, bins) in the same unit, complex64 or float32.

    Raises:
        InputError: too few bins.
    """
    kept = clean if clean.shape[-1] == spec.bins else fold(clean, spec)
    if spec.noise is None:
        return kept.astype(np.float32, copy=False) if spec.output == "rf" else kept.astype(np.complex64, copy=False)
    frames = range(first_frame, first_frame + len(kept))
    draws = Draws(seed, COMMON)
    common = np.array([draws.of(i).standard_normal(2) for i in frames]).reshape(-1, 2)
    phase, gain = phase_sigma(spec) * common[:, 0], 1 + spec.noise.amplitude * common[:, 1]
    if spec.output == "rf":
        return _receive_rf(kept.astype(np.float64) * unit(spec), spec, spec.noise, phase, gain, seed, frames)
    return _receive_baseband(kept.astype(np.complex128) * unit(spec), spec, spec.noise, phase, gain, seed, frames)


def _receive_baseband(
    echoes: Complexes, spec: RadarSpec, noise: NoiseSpec, phase: Floats, gain: Floats, seed: int, frames: range
) -> Samples:
    signal = echoes / noise.baseband_gain
    if noise.leakage:
        signal = signal + leakage(spec)
    signal = signal * (gain * np.exp(1j * phase))[:, None]
    if noise.clip:
        limit_envelope(signal, dac_limit(spec))
    signal *= noise.baseband_gain
    signal += baseband_noise(spec, seed, frames)
    if noise.lattice:
        step = lattice(spec) / FILTER_SCALE
        signal = (np.rint(signal.real / step) + 1j * np.rint(signal.imag / step)) * step
    return np.asarray(signal / unit(spec), np.complex64)


def _receive_rf(
    echoes: Floats, spec: RadarSpec, noise: NoiseSpec, phase: Floats, gain: Floats, seed: int, frames: range
) -> Samples:
    signal = echoes
    if noise.leakage:
        carrier = np.exp(2j * np.pi * spec.center_hz * (2 / C0) * spec.range_m)
        signal = signal + (leakage(spec) * carrier).real
    signal = np.stack([_turned(row, p) for row, p in zip(signal, phase, strict=True)]) * gain[:, None]
    sigma, draws = noise_sigma(spec), Draws(seed, THERMAL)
    signal += np.stack([sigma * draws.of(i).standard_normal(spec.bins) for i in frames])
    if noise.clip:
        signal = np.clip(signal, -dac_limit(spec), dac_limit(spec))
    if noise.lattice:
        step = lattice(spec)
        signal = np.rint((signal + dac_limit(spec)) / step) * step - dac_limit(spec)
    return np.asarray(signal / unit(spec), np.float32)


def _turned(row: Floats, phase: float) -> Floats:
    """Turn the carrier of one RF profile by a phase [rad]: all its frequencies, through its analytic signal."""
    turned = np.fft.rfft(row)
    turned[1:] *= np.exp(1j * phase)
    return np.fft.irfft(turned, len(row))


@lru_cache(maxsize=8)
def short_filter(decimation: int = 8) -> Floats:
    """Compute four real taps that give white noise at the bins the covariance that the on-chip filter leaves there.

    The filter is four bins long, so its output, mixed down, is correlated over three neighbours: a moving average of
    that order, found by spectral factorisation (roots inside the unit circle), is the same process for a quarter of
    the random numbers. Sigma is 1.
    """
    taps = chip_taps(decimation)
    covariance = np.array([taps[: len(taps) - k] @ taps[k:] for k in range(0, len(taps), decimation)])
    roots = np.roots(np.concatenate([covariance[:0:-1], covariance]))
    short = np.poly(roots[abs(roots) < 1]).real
    return np.asarray(short / np.linalg.norm(short))


def baseband_noise(spec: RadarSpec, seed: int, frames: range) -> Complexes:
    """Draw additive noise (n, bins) at baseband, normalised, correlated over bins as the on-chip filter leaves it."""
    taps = short_filter(spec.decimation)
    draws = Draws(seed, THERMAL)
    white = np.stack([draws.of(i).standard_normal((spec.bins + len(taps) - 1, 2)) for i in frames])
    pairs = white[..., 0] + 1j * white[..., 1]
    total = np.zeros((len(white), spec.bins), np.complex128)
    for k, tap in enumerate(taps):
        total += tap * pairs[:, k : k + spec.bins]
    return np.asarray(total * (noise_sigma(spec) / np.sqrt(2)))


def receive_thesis(clean: NDArray[Any], spec: RadarSpec, *, seed: int, first_frame: int = 0) -> Singles:
    """Apply the receiver of the ray model: white noise on each bin, then the moving average of clean profiles.

    Args:
        clean: amplitudes (n, b) from `echoes_thesis`.
        spec: the radar; with `noise=None` the profiles pass unchanged.
        seed: of the noise.
        first_frame: number of the first row.

    Returns:
        Amplitudes (n, b).
    """
    if spec.noise is None:
        return clean.astype(np.float32, copy=False)
    draws = Draws(seed, THESIS)
    white = np.stack([draws.of(first_frame + i).standard_normal(spec.bins) for i in range(len(clean))])
    return np.asarray(clean + smoothed(spec.thesis.noise_sigma * white, spec), np.float32)
