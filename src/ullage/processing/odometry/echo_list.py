"""Echoes of one frame with range, phase, and how far a single pulse explains each."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ullage.arrays import Floats
from ullage.data import Frames
from ullage.geometry import C0
from ullage.processing.baseband import to_baseband
from ullage.processing.bearings import RadarView, peaks_of
from ullage.processing.echoes import echo_level, profile_noise
from ullage.processing.inverse_sensor import mirror_m

_REACH = 2  # bins on each side of a peak that must look like the pulse


class EchoList(NamedTuple):
    """Echoes (q) of one frame, nearest first."""

    range_m: Floats
    phase: Floats  # [rad]
    spoilt: Floats  # share of the amplitude about it that a single pulse does not explain
    level_db: Floats


def echo_lists(part: Frames) -> list[tuple[EchoList, Floats, float]]:
    """Echoes, levels (b) of the profile and the noise [dB] of every frame."""
    values = to_baseband(part)
    level = 20 * np.log10(np.maximum(np.abs(values).astype(np.float64), 1e-30))
    least, noise = 20 * np.log10(echo_level(part)), 20 * np.log10(profile_noise(part) * math.sqrt(2))
    bin_m = float(part.range_m[1] - part.range_m[0])
    sigma = part.spec.pulse_sigma_s * C0 / 2 / bin_m
    out = []
    for row in range(len(part)):
        at, peak = peaks_of(part.range_m, level[row])
        kept = (peak > least[row]) & (at > part.spec.own_echo_m) & (at < part.range_m[-1] - 2 * _REACH * bin_m)
        at, peak = at[kept], peak[kept]
        place = (at - part.range_m[0]) / bin_m
        bins = np.rint(place).astype(int)[:, None] + np.arange(-_REACH, _REACH + 1)
        pulse = np.exp(-0.5 * ((bins - place[:, None]) / sigma) ** 2)
        near = values[row][np.clip(bins, 0, len(part.range_m) - 1)]
        size = (near * pulse).sum(1) / (pulse**2).sum(1)
        left = np.abs(near - size[:, None] * pulse) ** 2
        spoilt = np.sqrt(left.sum(1) / np.maximum((np.abs(near) ** 2).sum(1), 1e-300))
        out.append((EchoList(at, np.angle(size), spoilt, peak), level[row], float(noise[row])))
    return out


def view_of(part: Frames, gain_db: Floats, arm: Floats, level_db: Floats, noise_db: float, t_s: float) -> RadarView:
    """What `bearings` needs to know of a radar at one frame."""
    peaks = peaks_of(part.range_m, level_db)
    mirror = 20 * math.log10(mirror_m(part)) if math.isfinite(mirror_m(part)) else math.inf
    return RadarView(gain_db, arm, part.range_m, level_db, *peaks, noise_db, mirror, part.spec.own_echo_m, t_s)
