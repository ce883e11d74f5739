"""Readings of a MEMS inertial unit on the simulated vehicle: true values and white noise [MPU6000]."""

from __future__ import annotations

import math

import numpy as np

from ullage.arrays import Floats
from ullage.flight.airframe import GRAVITY_M_S2

RATE_DENSITY = math.radians(0.005)
"""Of the gyroscopes [rad/s/sqrt(Hz)], one-sided."""
FORCE_DENSITY = 400e-6 * GRAVITY_M_S2
"""Of the accelerometers [m/s2/sqrt(Hz)], one-sided."""


class ImuNoise:
    """Adds white noise to readings of turn rate and specific force; a reading depends on its seed and number only.

    The band reaches to half the rate of the readings, so sigma is the density times sqrt(rate / 2). Offsets and their
    drift are left out.

    Args:
        rate_hz: readings a second.
        seed: of the noise.
    """

    def __init__(self, rate_hz: float, *, seed: int = 0) -> None:
        band = math.sqrt(rate_hz / 2)
        self.rate_sigma, self.force_sigma = RATE_DENSITY * band, FORCE_DENSITY * band  # [rad/s], [m/s2]
        self._seed = seed

    def add(self, number: int, rate_rad_s: Floats, force_m_s2: Floats) -> tuple[Floats, Floats]:
        """Turn rate (3) and specific force (3) with the noise of one reading.

        Args:
            number: of the reading, from 0.
            rate_rad_s: true turn rate in the body (3).
            force_m_s2: true specific force in the body (3).
        """
        bits = np.random.Philox(key=[self._seed, 0x696D75], counter=[0, number, 0, 0])
        noise = np.random.Generator(bits).standard_normal(6)
        return rate_rad_s + self.rate_sigma * noise[:3], force_m_s2 + self.force_sigma * noise[3:]
