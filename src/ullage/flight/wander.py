"""Smooth random motion with a set size and pace, the same for the same seed, at any time, in any order."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from ullage.arrays import Floats
from ullage.specs import Spec

_WAVES = 64


def philox(seed: int, component: int, counter: int = 0) -> np.random.Generator:
    """Return the counter-based generator of a flight's random component, at a place of its stream [SalmonEtAl2011]."""
    key = np.array([seed % 2**64, component], np.uint64)
    return np.random.Generator(np.random.Philox(key=key, counter=[0, counter % 2**64, 0, 0]))


class SmoothNoise:
    """A stationary random function of time, near Gaussian, with a Gaussian spectrum and all derivatives.

    It is a sum of cosines of random frequency and phase [ShinozukaDeodatis1991], so any time can be asked for by
    itself. The correlation over a lag s is exp(-(s / pace_s)^2 / 2).

    Args:
        rms: root mean square over time.
        pace_s: correlation time [s].
        seed, component: which random function.
    """

    def __init__(self, rms: float, pace_s: float, *, seed: int, component: int) -> None:
        draw = philox(seed, component)
        self._omega = np.abs(draw.standard_normal(_WAVES)) / pace_s
        self._phase = draw.uniform(0, 2 * np.pi, _WAVES)
        self._size = rms * np.sqrt(2 / _WAVES)

    def at(self, t_s: ArrayLike, *, derivatives: int = 0) -> Floats:
        """Value and derivatives (derivatives + 1, n) at times (n) [s]."""
        times = np.atleast_1d(np.asarray(t_s, float))
        out = np.zeros((derivatives + 1, len(times)))
        if self._size == 0:
            return out
        for start in range(0, len(times), 4096):  # bounds the memory of long flights
            part = slice(start, start + 4096)
            angle = times[part, None] * self._omega + self._phase
            cos, sin = np.cos(angle), np.sin(angle)
            for k in range(derivatives + 1):
                wave = (cos, -sin, -cos, sin)[k % 4]
                out[k, part] = self._size * (wave @ self._omega**k)
        return out


class Wander(Spec):
    """Deviation of a human pilot from the intended track: smooth, slow, seeded.

    The pace is that of a human in a position loop, well below the crossover near 0.5 Hz [McRuerJex1967].
    """

    lateral_m: float = Field(0.12, ge=0, le=5, description="rms, along each of x and y")
    vertical_m: float = Field(0.06, ge=0, le=5, description="rms")
    yaw_deg: float = Field(5.0, ge=0, le=90, description="rms")
    pace_s: float = Field(0.9, ge=0.2, le=60, description="correlation time")
    seed: int = Field(0, ge=0)

    def at(self, t_s: ArrayLike) -> Floats:
        """Offset in x, y, z [m] and yaw [rad] with three derivatives: (4 derivatives, n, 4 axes)."""
        sizes = (self.lateral_m, self.lateral_m, self.vertical_m, np.radians(self.yaw_deg))
        axes = [
            SmoothNoise(rms, self.pace_s, seed=self.seed, component=10 + k).at(t_s, derivatives=3)
            for k, rms in enumerate(sizes)
        ]
        return np.stack(axes, axis=-1)
