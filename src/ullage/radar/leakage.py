"""The direct path from transmitter to receiver, as the X4 recordings show it [X4Recordings].

About eight baseband bins at the start of every frame, 50 dB over the noise at four counts, then a null. The amplitudes
are those of the recording; the first 0.25 m of them lies inside the device. They were recorded behind the DAC window,
which flattens the strongest two bins; the usual window 949-1100 is assumed and undone here, so that the receiver's own
window shows the recorded values again.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ullage.geometry import C0
from ullage.specs import NoiseSpec, RadarSpec

_BIN_M = C0 / 2 * 8 / 23.328e9
_START = -2
_AMPLITUDE = (0.0, 0.035, 0.0665, 0.0682, 0.0534, 0.0491, 0.0552, 0.0472, 0.0309, 0.0183, 0.0075, 0.0, 0.0)
"""Baseband magnitudes from bin -2 on, in the sensor's normalised units; bin -1 is our guess, it was never recorded."""
_PHASE = (0.66, 0.37, 0.0794, -0.2112, -0.8275, -1.9959, -2.8541, -3.4091, -3.9933, -4.6656, -5.2820, -5.9, -6.5)
"""Baseband phases [rad]."""
_WINDOW = 152 / 2048
"""Half width of the usual DAC window in normalised units."""


def unlimited(amplitude: NDArray[np.float64], limit: float) -> NDArray[np.float64]:
    """Amplitudes of a carrier that hard limiting at `limit` turns into these (each below 4 / pi of the limit)."""
    low, high = np.zeros_like(amplitude), np.full_like(amplitude, 100 * limit)
    for _ in range(80):
        middle = (low + high) / 2
        x = np.minimum(limit / np.maximum(middle, 1e-300), 1.0)
        seen = np.where(middle <= limit, middle, 2 / np.pi * middle * (np.arcsin(x) + x * np.sqrt(1 - x * x)))
        low, high = np.where(seen < amplitude, middle, low), np.where(seen < amplitude, high, middle)
    return (low + high) / 2


@lru_cache(maxsize=64)
def _profile(noise: NoiseSpec, limit: float, range_start_m: float, bin_m: float, bins: int) -> NDArray[np.complex128]:
    from scipy.interpolate import CubicSpline  # a tenth of a second, for simulated radars only

    place, values = _measured(noise, limit)
    want = range_start_m + bin_m * np.arange(bins)
    inside = (want >= place[0]) & (want <= place[-1])
    spline = CubicSpline(place, values, bc_type="clamped")
    return np.asarray(np.where(inside, spline(np.clip(want, place[0], place[-1])), 0))


def _measured(noise: NoiseSpec, limit: float) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    """Ranges [m] and complex envelope at RF of the direct path, before the DAC window, in normalised units."""
    if noise.direct_path is None:
        usual = unlimited(np.array(_AMPLITUDE) / noise.baseband_gain, _WINDOW)
        values = np.asarray(usual * np.exp(1j * np.array(_PHASE)), np.complex128)
        return _BIN_M * np.arange(_START, _START + len(usual), dtype=np.float64), values
    known = noise.direct_path
    values = np.asarray(np.array(known.in_phase) + 1j * np.array(known.quadrature), np.complex128)
    place = known.range_start_m + known.step_m * np.arange(len(values))
    if noise.clip:
        size = np.abs(values)
        values *= unlimited(np.minimum(size, 0.999 * 4 / np.pi * limit), limit) / np.maximum(size, 1e-300)
    return np.asarray(place), values


def leakage(spec: RadarSpec) -> NDArray[np.complex128]:
    """Complex envelope of the direct path at each bin (b), at RF, before the DAC window, in normalised units."""
    limit = (spec.dac_max - spec.dac_min + 1) / 2048
    start_m = spec.range_start_m + spec.frame_area_offset_m
    return _profile(spec.noise or NoiseSpec(), limit, start_m, spec.bin_m, spec.bins)
