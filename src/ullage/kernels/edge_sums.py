"""Loop that sums the samples of an aperture at one range of each direction."""

from __future__ import annotations

import math

import numpy as np

from ullage.arrays import Floats, Longs
from ullage.kernels.directed_sums import Patterns, pattern_gain
from ullage.kernels.loops import loop
from ullage.kernels.matched_sums import Aperture, _delay

NEAR = 1  # bins about the range


@loop(fastmath=True)
def sum_edges(
    aperture: Aperture, patterns: Patterns, directions: Floats, bins: Longs, rows: Longs, energy: Floats, power: Floats
) -> None:
    """Energy that a reflector in each direction explains at one range.

    Args:
        aperture: the rows.
        patterns: of the sensors.
        directions: (d, 3) unit vectors.
        bins: (d) bin of the range of each.
        rows: (s) frames of each sensor.
        energy: (d) set to the largest energy within a bin of it.
        power: (d) set to the energy of an echo of amplitude 1 before antennas of gain 1.
    """
    samples, gain = aperture.samples, np.empty(len(rows))
    for d in range(len(directions)):
        power[d] = energy[d] = total = 0.0
        for s in range(len(rows)):
            gain[s] = pattern_gain(patterns.cubes[s], patterns.turns[s], directions[d])
            power[d] += rows[s] * gain[s] ** 2
        for i in range(len(samples)):
            total += gain[aperture.sensor[i]] ** 2
        for near in range(-NEAR, NEAR + 1):
            real = imag = 0.0
            for i in range(len(samples)):
                delay = _delay(aperture.offset[i], directions[d], 0.0)
                k = math.floor(delay + bins[d] + near)
                if k < 0 or k >= samples.shape[1] - 1:
                    continue
                share, g = delay + bins[d] + near - k, gain[aperture.sensor[i]]
                x = samples[i, k, 0] * (1 - share) + samples[i, k + 1, 0] * share
                y = samples[i, k, 1] * (1 - share) + samples[i, k + 1, 1] * share
                c, q = math.cos(aperture.phase * delay), math.sin(aperture.phase * delay)
                real += g * (x * c - y * q)
                imag += g * (x * q + y * c)
            energy[d] = max(energy[d], (real * real + imag * imag) / max(total, 1e-30))
