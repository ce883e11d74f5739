"""Errors of the poses inside one aperture: how large they are, and where each echo shows them.

A pose error turns the phase of every echo at that moment, by 4 pi / wavelength times its part along the echo's
direction. The strongest echo shows this part at each moment. Its posterior mean corrects the aperture for the next
echoes, and the covariance that is left says how coherent an echo from another direction can be.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from ullage.arrays import Complexes, Floats, Longs
from ullage.kernels.matched_sums import Aperture
from ullage.processing.likelihood.keyframes import Keyframe
from ullage.processing.likelihood.spec import LikelihoodSpec

KEPT = 161  # estimates of the variance; their median counts
LEAST_VARIANCE = 1e-3  # of a phase, that the model itself leaves [rad^2]
LEAST_SHARE = 0.8  # of its energy that an echo must explain at free phases to speak for the poses
LEAST_COHERENCE = 1e-3  # bounds the variance of phases that have nothing in common
LEAST_PRIOR = 0.01  # variance of a phase from which the poses are worth a second pass [rad^2]
MOUNT_WEIGHT = 1.0  # of the belief that mounts are as stated: as one echo that two sensors receive equally
LEAST_SIDE_GAIN = 0.1  # two-way, of boresight: what a sensor receives from further aside, others may cover
WRAPS = 2 * np.pi * np.arange(-3, 4)


def range_sigma(key: Keyframe, unit: Floats, coherence: float, spec: LikelihoodSpec) -> float:
    """Standard deviation of one row's range, from its phase as far as the poses keep that coherent [m].

    The envelope of the pulse gives the rest. What an echo does not explain adds to both.

    Args:
        key: the keyframe.
        unit: direction (3) of the echo.
        coherence: share of the energy that it explains.
        spec: parameters.
    """
    aperture, unexplained = key.aperture, math.sqrt(max(1 - coherence, 0.02) / 0.02)
    pose = float(unit @ aperture.spread @ unit)
    envelope = spec.envelope_sigma * key.pulse * unexplained
    if not aperture.phase:
        return key.bin_m * math.hypot(envelope, math.sqrt(pose))
    share = math.exp(-pose * aperture.phase**2)
    phase = spec.phase_sigma_rad / aperture.phase * unexplained
    weight = share / (phase**2 + pose) + (1 - share) / (envelope**2 + pose)
    return key.bin_m / math.sqrt(weight)


class PoseErrors:
    """Estimate of the poses' white errors over the flight, from the phases of the strongest echoes."""

    def __init__(self) -> None:
        self._variance_m2: deque[float] = deque(maxlen=KEPT)

    @property
    def sigma_m(self) -> float:
        """Standard deviation of one coordinate of a position [m]; 0 as long as no echo shows it."""
        return math.sqrt(float(np.median(self._variance_m2))) if self._variance_m2 else 0.0

    def learn(self, phases: EchoPhases, fitted: int, expected: float, rad_per_m: float) -> None:
        """Take the phases of an echo that no earlier echo corrected.

        Random phases leave the coherence 1 / T over T moments. A search that trusts phases adds up to 1 / T for each
        parameter that it fits to them. In simulated flights with random phases this share went as the root of the
        coherence that the search expected.

        Args:
            phases: of the echo.
            fitted: parameters that were fitted to them.
            expected: coherence of the amplitudes that the search expected; how far it trusted phases.
            rad_per_m: phase that a metre of range turns.
        """
        random = (1 + fitted * math.sqrt(expected)) / len(phases.turn)
        if random < 1 and phases.share > LEAST_SHARE:
            coherence = (phases.coherence**2 - random) / (1 - random)
            variance = -math.log(max(coherence, LEAST_COHERENCE))
            self._variance_m2.append(max(variance - phases.variance, 0.0) / rad_per_m**2)


class MountErrors:
    """Estimate of how coherent the sensors are with each other, from the strongest echo of each keyframe.

    A mount that is off by a millimetre turns the phases of its sensor by 17 deg at 7.3 GHz.

    Attributes:
        coherence: mean over pairs of sensors; 1 where all mounts are as stated.
    """

    def __init__(self) -> None:
        self.coherence = 1.0
        self._pairs: deque[tuple[float, float]] = deque(maxlen=KEPT)

    def expect(self, aperture: Aperture, sigma: float) -> None:
        """Set the coherence that a stated accuracy of the mounts (standard deviation) [bin] and the echoes show."""
        stated = math.exp(-((aperture.phase * sigma) ** 2))
        agreed, pairs = np.sum(self._pairs, axis=0) if self._pairs else (0.0, 0.0)
        self.coherence = min(max((MOUNT_WEIGHT * stated + agreed) / (MOUNT_WEIGHT + pairs), 0.0), 1.0)
        aperture.together[0] = self.coherence

    def learn(self, gains: Floats, sums: Floats) -> None:
        """Take an echo that was fitted with free phases between the sensors.

        Args:
            gains: (s) two-way amplitude gains of the sensors, over those on boresight.
            sums: (s, 3) real and imaginary part of each sensor's sum, and its rows.
        """
        weighted = np.where(gains > LEAST_SIDE_GAIN, gains, 0.0) * (sums[:, 0] + 1j * sums[:, 1])
        total, own = float(np.abs(weighted).sum()) ** 2, float((np.abs(weighted) ** 2).sum())
        if total > own:
            self._pairs.append(((float(abs(weighted.sum())) ** 2 - own) / total, (total - own) / total))


class EchoPhases:
    """Phases of one echo at the moments of an aperture, against the model.

    Attributes:
        turn: (t) phase at each moment [rad].
        coherence: size of the mean over moments, over the mean size.
        share: of the energy that the echo explains at free phases.
        variance: of a phase by what the echo does not explain [rad^2].
    """

    def __init__(self, rows: Complexes, gain: Floats, moment: Longs) -> None:
        weighted = gain * rows
        sums = np.bincount(moment, weighted.real) + 1j * np.bincount(moment, weighted.imag)
        size = np.abs(sums)
        total, energy = max(float(size.sum()), 1e-30), max(float((np.abs(rows) ** 2).sum()), 1e-30)
        self.turn = np.angle(sums * np.conj(sums.sum()))
        self.coherence = float(abs(sums.sum())) / total
        self.share = min(total**2 / max(float((gain**2).sum()), 1e-9) / energy, 1.0)
        self.variance = LEAST_VARIANCE + (1 - self.share) / (2 * self.share)


class AperturePoses:
    """Positions of one aperture with the covariance of their errors; each echo corrects them.

    Args:
        aperture: its offsets and their covariance change.
    """

    def __init__(self, aperture: Aperture) -> None:
        self._aperture, self._moment, self._covariance = aperture, aperture.moment, aperture.spread
        self.sigma = 0.0

    def expect(self, sigma: float) -> None:
        """Expect errors of this standard deviation in each coordinate [bin], before any correction."""
        self.sigma = sigma
        self._covariance[:] = sigma**2 * np.eye(3)

    @property
    def uncertain(self) -> bool:
        """Whether the errors were expected to turn phases by more than the model itself does."""
        return (self.sigma * self._aperture.phase) ** 2 > LEAST_PRIOR

    def variance(self, unit: Floats) -> float:
        """Variance of a phase in a direction [rad^2]."""
        return float(unit @ self._covariance @ unit) * self._aperture.phase**2

    def phases(self, unit: Floats, gains: Floats, curvature: float, place: float, *, lying: bool = False) -> EchoPhases:
        """Phases of an echo.

        Args:
            unit: direction (3).
            gains: (s) of the sensors.
            curvature: of the range [1/bin].
            place: range [bin].
            lying: whether it bends in the vertical plane through its direction only.
        """
        aperture = self._aperture
        delay = delays(aperture.offset, unit, curvature, lying=lying) + aperture.late[aperture.sensor]
        at = np.clip(delay + place, 0, aperture.samples.shape[1] - 1.001)
        low, row = at.astype(int), np.arange(len(at))
        share = (at - low)[:, None]
        pair = aperture.samples[row, low] * (1 - share) + aperture.samples[row, low + 1] * share
        rows = (pair[:, 0] + 1j * pair[:, 1]) * np.exp(1j * aperture.phase * delay)
        return EchoPhases(rows, gains[aperture.sensor], self._moment)

    def expected(self, unit: Floats, phases: EchoPhases) -> Floats:
        """Part of an echo's phases (t) that the poses' errors explain [rad]: none at exact poses, all at poor ones."""
        prior = self.variance(unit)
        return np.asarray(phases.turn * prior / (prior + phases.variance))

    def shift(self, unit: Floats, turn: Floats) -> None:
        """Move the positions along a direction, by what takes these phases (t) from its echo [rad]."""
        if self._aperture.phase:
            self._aperture.offset[:] += (turn / self._aperture.phase)[self._moment, None] * unit

    def correct(self, unit: Floats, phases: EchoPhases) -> None:
        """Take an echo's phases as measurements of the positions along its direction.

        A phase leaves open how many half wavelengths the error holds. The mean over all of them counts, each with its
        probability, so that a large error corrects nothing.
        """
        total = self.variance(unit) + phases.variance
        turns = phases.turn[:, None] + WRAPS
        weight = np.exp(-0.5 * (turns**2 - phases.turn[:, None] ** 2) / total)
        weight /= weight.sum(axis=1, keepdims=True)
        mean = (weight * turns).sum(axis=1)
        spread = float(((weight * turns**2).sum(axis=1) - mean**2).mean())
        gain = self._covariance @ unit * self._aperture.phase / total
        self._aperture.offset[:] += mean[self._moment, None] * gain
        self._covariance[:] -= np.outer(gain, gain) * max(total - spread, 0.0)


def delays(offset: Floats, unit: Floats, curvature: float, *, lying: bool) -> Floats:
    """Ranges (m) of a reflector from offsets (m, 3), less that from the place; all in one unit of length.

    Args:
        offset: of the sensor.
        unit: level part (3) of the direction.
        curvature: of the range.
        lying: whether it bends in the vertical plane through its direction only; else it bends on all sides.
    """
    along, cosine = offset @ unit, float(np.linalg.norm(unit[:2]))
    if lying and cosine > 0:
        ahead = along / cosine
        size = np.sqrt((cosine - curvature * ahead) ** 2 + max(1 - cosine**2, 0.0))
        return np.asarray((curvature * ahead - 2 * cosine) * ahead / (size + 1))
    return np.asarray(0.5 * curvature * ((offset**2).sum(axis=1) - along**2) - along)
