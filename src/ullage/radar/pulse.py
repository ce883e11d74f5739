"""The pulse as it leaves the receiver's filter, tabulated for quick sums of many echoes.

Convention: signals are analytic with e^{+j 2 pi f t}; after down-conversion at the centre frequency f_c a unit echo
at delay tau is p(t - tau) e^{-j 2 pi f_c tau}, with p real, even and 1 at its peak.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ullage.antenna import PatternPair
from ullage.arrays import Complexes, Floats
from ullage.errors import InputError
from ullage.geometry import C0
from ullage.specs import RadarSpec

_OVERSAMPLING = 14.0  # grid rate over pulse bandwidth; a cubic B-spline then errs by less than 1e-6
_RAISED = 2.5116  # length of a raised cosine times the width of its spectrum at -10 dB
_FLOOR = 1e-6  # where the pulse's tails are cut, relative to the peak


@dataclass(frozen=True, slots=True, eq=False)
class Pulse:
    """Impulse responses of the three spectral kinds of echo, and the delay grid they are meant for."""

    taps: Complexes  # (3, h) response of kind n, spectrum ~ (f_c / f)^n, at grid steps, centred
    step_s: float  # grid step [s]
    every: int  # grid steps per output bin
    omega: float  # carrier [rad/s]

    @property
    def half(self) -> int:
        """Grid steps from the middle of the pulse to its cut tail."""
        return int(self.taps.shape[1] - 1) // 2

    @property
    def half_m(self) -> float:
        """Range from the middle of the pulse to its cut tail [m]."""
        return self.half * self.step_s * C0 / 2


def filtered(spec: RadarSpec) -> bool:
    """Return whether the X4's on-chip filter shapes the output: decimated baseband only."""
    return spec.output == "baseband" and spec.decimation == 8


def chip_taps(decimation: int = 8) -> Floats:
    """Compute the taps of the on-chip low-pass, Hamming-windowed, four output bins long [X4Recordings].

    32 taps of 0.5 GHz at 23.328 GS/s reproduce the measured pulse width and correlation between bins; other rates scale
    with it.
    """
    length = 4 * decimation
    n = np.arange(length) - (length - 1) / 2
    cutoff = 2 * 0.5e9 / 23.328e9 * 8 / decimation
    taps = np.sinc(cutoff * n) * (0.54 + 0.46 * np.cos(2 * np.pi * n / (length - 1)))
    return np.asarray(taps / taps.sum())


def chip_filter(frequency_hz: Floats, sampling_hz: float) -> Floats:
    """Compute the response of the X4's on-chip low-pass at offsets from the carrier, without its delay, 1 at 0."""
    turn = np.multiply.outer(frequency_hz / sampling_hz, np.arange(32) - 15.5)
    return np.asarray(np.cos(2 * np.pi * turn) @ chip_taps())


def spectrum(spec: RadarSpec, frequency_hz: Floats) -> Floats:
    """Compute the amplitude spectrum of the received pulse at offsets from the carrier [Hz], 1 at the carrier."""
    if spec.pulse == "raised-cosine":
        out = _raised_cosine(frequency_hz * _RAISED / spec.bandwidth_hz)
    else:
        out = np.exp(-0.5 * (2 * np.pi * frequency_hz * spec.pulse_sigma_s) ** 2)
    return out * chip_filter(frequency_hz, spec.sampling_hz) if filtered(spec) else out


def _raised_cosine(x: Floats) -> Floats:
    """Compute the spectrum of the envelope cos^2(pi t / T), |t| < T / 2, over x = f T [Harris1978]."""
    return np.asarray(0.5 * np.sinc(x - 1) + np.sinc(x) + 0.5 * np.sinc(x + 1))


def envelope(spec: RadarSpec, t_s: Floats) -> Floats:
    """Compute the pulse p(t) of a point echo, 1 at its peak."""
    offsets, weight = _quadrature(spec)
    return np.asarray(np.cos(2 * np.pi * np.multiply.outer(t_s, offsets)) @ weight)


def _quadrature(spec: RadarSpec) -> tuple[Floats, Floats]:
    reach = 6 / (2 * np.pi * spec.pulse_sigma_s)
    offsets = np.linspace(-reach, reach, 1201)
    weight = spectrum(spec, offsets)
    return offsets, weight / weight.sum()


@lru_cache(maxsize=64)
def _tabulated(spec: RadarSpec, patterns: PatternPair | None) -> Pulse:
    every = max(1, math.ceil(_OVERSAMPLING * spec.bandwidth_hz * spec.step_s))
    step = spec.step_s / every
    offsets, weight = _quadrature(spec)
    passed: Floats | Complexes = weight
    spline = np.sinc(offsets * step) ** 4
    ratio = spec.center_hz / np.maximum(spec.center_hz + offsets, 0.05 * spec.center_hz)
    longest = 8 * spec.pulse_sigma_s + (32 / spec.sampling_hz if filtered(spec) else 0)
    if patterns and patterns.transfer:
        passed, longest = weight * patterns.transfer(spec.center_hz + offsets), longest + patterns.tail_s
    t = np.arange(0, math.ceil(longest / step) + 1) * step
    phase = np.exp(2j * np.pi * np.multiply.outer(t, offsets))
    phase = np.concatenate([phase[:0:-1].conj(), phase])  # from -t to t
    taps = np.stack([phase @ (passed * ratio**n / spline) for n in range(3)])
    loud = np.flatnonzero(abs(taps).max(0) > _FLOOR)
    half = len(t) - 1
    keep = max(half - loud[0], loud[-1] - half)
    return Pulse(np.ascontiguousarray(taps[:, half - keep : half + keep + 1]), step, every, 2 * np.pi * spec.center_hz)


def tabulate(spec: RadarSpec, patterns: PatternPair | None = None) -> Pulse:
    """Tabulate the radar's pulse, as a pair of patterns passes it, for `kernels.pulse.convolve`.

    Raises:
        InputError: the pulse is wider than the frame.
    """
    width = 2.355 * spec.pulse_sigma_s * C0 / 2
    frame = spec.bins * spec.bin_m
    if width > frame:
        raise InputError(f"the pulse is {width:.3g} m wide, the frame only {frame:.3g} m", where=spec.name,
                         allowed="a wider bandwidth_hz or more bins")  # fmt: skip
    bare = RadarSpec(**{n: getattr(spec, n) for n in _SHAPING})
    return _tabulated(bare, patterns if patterns and patterns.transfer else None)


_SHAPING = ("center_hz", "bandwidth_hz", "pulse", "sampling_hz", "decimation", "output")
