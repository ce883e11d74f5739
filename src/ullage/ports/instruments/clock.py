"""Put the scans of an instrument on this computer's clock by the counter of the instrument [BarShalomEtAl2001]."""

from __future__ import annotations

import math

DRIFT = 1e-3
"""One sigma of how much faster the instrument's clock runs: its frame rate may be rounded."""
DRIFT_WALK, OFFSET_WALK_S = 1e-8, 1e-6
"""What drift and offset change in a second."""
FIRST_JITTER_S = 5e-3
MEMORY = 0.02
"""Weight of a new scan in the jitter."""
LATE_SIGMAS = 3.0
"""A scan that comes later than this weighs less: an operating system delays, but never hurries."""


class InstrumentClock:
    """Estimate this computer's time less the instrument's, and its drift, by a Kalman filter.

    A scan comes when the system hands it over, with a jitter of milliseconds. The instrument counts evenly. So the
    counter gives the distances between scans, and their arrivals the offset.
    """

    def __init__(self) -> None:
        self.jitter_s = FIRST_JITTER_S
        """Standard deviation of the arrivals about the estimate [s]."""
        self._device_s: float | None = None
        self._offset_s = self._drift = 0.0
        self._p = (1.0, 0.0, DRIFT**2)  # variances of offset and drift, and in the middle their covariance

    @property
    def drift_ppm(self) -> float:
        """How much faster this computer's clock runs [ppm]."""
        return self._drift * 1e6

    def at(self, device_s: float, arrived_s: float) -> float:
        """Return a scan's time on this computer's clock [s].

        Args:
            device_s: its time on the instrument's clock [s]; one that lies behind starts the estimate anew.
            arrived_s: when it came, on this computer's clock [s].
        """
        if self._device_s is None or device_s < self._device_s:
            self._offset_s, self._drift, self._p = arrived_s - device_s, 0.0, (self.jitter_s**2, 0.0, DRIFT**2)
            self._device_s = device_s
            return arrived_s
        step_s, self._device_s = device_s - self._device_s, device_s
        a, b, c = self._p
        a += step_s * (2 * b + step_s * c) + OFFSET_WALK_S**2 * step_s
        b, c = b + step_s * c, c + DRIFT_WALK**2 * step_s
        self._offset_s += self._drift * step_s
        wrong_s = arrived_s - device_s - self._offset_s
        spread = a + self.jitter_s**2
        late = max(wrong_s / (LATE_SIGMAS * math.sqrt(spread)), 1.0)
        gain_a, gain_b = a / (a + (late * self.jitter_s) ** 2), b / (a + (late * self.jitter_s) ** 2)
        self._offset_s += gain_a * wrong_s
        self._drift += gain_b * wrong_s
        self._p = ((1 - gain_a) * a, (1 - gain_a) * b, c - gain_b * b)
        self.jitter_s = math.sqrt((1 - MEMORY) * self.jitter_s**2 + MEMORY * (wrong_s / late) ** 2)
        return device_s + self._offset_s
