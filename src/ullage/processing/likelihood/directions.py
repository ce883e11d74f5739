"""Echoes of one keyframe in space: directions round the track, and the antennas' levels that weigh them.

A short straight aperture fixes the range of an echo and its cosine to the track. All directions on that ring explain
its phases alike. The levels of the sensors weigh the ring, and an aperture that bends or climbs breaks it. Thus an echo
is a Gaussian over range, direction and curvature, wide along the ring, with its level at each sensor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ullage.arrays import Floats, Singles
from ullage.kernels.directed_sums import (
    Patterns,
    refine_direction,
    strongest_direction,
    subtract_directed,
    sum_toward,
)
from ullage.processing.likelihood.echoes import FAR_END_M, LEAST_ROWS, MOST_COHERENCE, SAME_RANGE_M
from ullage.processing.likelihood.keyframes import Keyframe
from ullage.processing.likelihood.spec import LikelihoodSpec

COSINE_STEP, ROLLS = 0.04, 12  # of the first search: a lobe of the aperture, and half a beam of the antennas
COARSE, FINE = (2.0, 8.0, 0.35, 0.5), (0.5, 2.0, 0.05, 0.25)  # first steps: deg along and round the track, 1/m, bins
OPEN = np.diag([0.0, 0.01, 0.01, 0.01, 1.0])  # inverse variance that keeps what an aperture leaves open finite


@dataclass(frozen=True, slots=True, eq=False)
class DirectedEchoes:
    """Echoes of one keyframe, the strongest first."""

    position: Floats  # (3) of the keyframe [m]
    track: Floats  # (3) unit vector along the aperture
    patterns: Patterns  # of the sensors
    rows: Floats  # (s) frames of each sensor
    silent: Singles  # (b) energy that an echo must explain to be found, in each bin
    start_m: float  # range of bin 0
    bin_m: float
    noise: float
    state: Floats  # (e, 5) range [m], unit vector, curvature of the range [1/m]
    covariance: Floats  # (e, 5, 5)
    coherence: Floats  # (e) share of the energy that the echo explains
    nats: Floats  # (e) log-likelihood ratio against independent samples
    amplitude: Floats  # (e, s) at each sensor
    energy: Floats  # (e) that the echo explains

    def __len__(self) -> int:
        return len(self.state)


def across(unit: Floats, along: Floats) -> Floats:
    """Two unit vectors (2, 3) across a direction (3): in its plane with another one, and out of it."""
    first = along - (along @ unit) * unit
    if np.linalg.norm(first) < 1e-6:
        first = np.eye(3)[int(np.argmin(np.abs(unit)))]
        first = first - (first @ unit) * unit
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(unit, first)])


def ring(along: Floats, cosine: float, count: int) -> Floats:
    """Directions (count, 3) of one cosine to a direction (3)."""
    first, second = across(along, np.array([0.0, 0.0, 1.0]))
    turn = 2 * np.pi * (np.arange(count) + 0.5) / count
    side = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
    return np.asarray(cosine * along + math.sqrt(max(1 - cosine**2, 0.0)) * side)


class DirectionFinder:
    """Finds the echoes of keyframes in all directions."""

    def __init__(self, spec: LikelihoodSpec) -> None:
        self._spec = spec
        cosines = np.linspace(-1, 1, round(2 / COSINE_STEP) + 1)
        x = np.array([1.0, 0.0, 0.0])
        self._turned = np.concatenate([ring(x, c, max(round(ROLLS * math.sqrt(1 - c * c)), 1)) for c in cosines])

    def find(self, key: Keyframe, cubes: Floats, known: Floats) -> DirectedEchoes:
        """Find the echoes of a keyframe.

        Args:
            key: the keyframe; its samples change.
            cubes: (s, 6, m, m) one-way amplitude gains of the sensors.
            known: (k, 5) states of known surfaces as seen from its place. A known surface explains an echo unless
                another hypothesis explains clearly more of it.
        """
        spec, aperture, noise = self._spec, key.aperture, key.noise**2
        bins = aperture.samples.shape[1]
        low, high = key.first_bin, bins - int(FAR_END_M / key.bin_m)
        patterns = Patterns(cubes, np.ascontiguousarray(key.turns))
        track = _track_of(aperture.offset, aperture.sensor)
        floor, reach = np.ones(bins), 2 * int(3 * key.pulse) + 2
        found = []
        if len(aperture.offset) >= LEAST_ROWS and low < high:
            directions = np.ascontiguousarray(self._turned @ np.concatenate([track[None], across(track, np.eye(3)[2])]))
            energy = np.zeros((len(directions), bins), np.float32)
            sum_toward(aperture, patterns, directions, low, high, energy)
            for _ in range(spec.most_echoes):
                best, (d, k) = strongest_direction(energy, floor, low, high)
                if best <= spec.least_snr * noise:
                    break
                fit, sums = self._refined(key, patterns, track, np.array([*directions[d], 0.0, k]), known)
                found.append(self._echo(key, fit, sums, (floor[k] - 1) * noise))
                subtract_directed(aperture, fit, sums, key.pulse)
                at = int(fit[6])
                first, last = max(at - reach, low), min(at + reach, high)
                sum_toward(aperture, patterns, directions, first, last, energy)
                pulse = np.exp(-0.5 * ((np.arange(bins) - fit[6]) / key.pulse) ** 2)
                floor = np.maximum(floor, 1 + spec.model_error * pulse * fit[0] / max(noise, 1e-30))
        sensors = len(aperture.axes)
        silent = np.full(bins, np.inf, np.float32)
        silent[low:high] = floor[low:high] * spec.least_snr * noise
        return DirectedEchoes(
            key.position, track, patterns, np.bincount(aperture.sensor, minlength=sensors).astype(float), silent,
            key.start_m, key.bin_m, key.noise,
            np.array([one[0] for one in found]).reshape(-1, 5), np.array([one[1] for one in found]).reshape(-1, 5, 5),
            np.array([one[2] for one in found]), np.array([one[3] for one in found]),
            np.array([one[4] for one in found]).reshape(-1, sensors), np.array([one[5] for one in found]),
        )  # fmt: skip

    def _refined(
        self, key: Keyframe, patterns: Patterns, track: Floats, start: Floats, known: Floats
    ) -> tuple[Floats, Floats]:
        """Fit and sums of a first estimate (5), or of a known surface at its range that explains as much."""
        best = self._fitted(key, patterns, track, start, COARSE)
        at_m, nats = key.start_m + key.bin_m * best[0][6], self._nats(key, best[0])
        for state in known[np.abs(known[:, 0] - at_m) < SAME_RANGE_M]:
            rival = np.array([*state[1:4], state[4] * key.bin_m, (state[0] - key.start_m) / key.bin_m])
            fit = self._fitted(key, patterns, track, rival, FINE)
            if self._nats(key, fit[0]) + self._spec.known_nats > nats:
                best, nats = fit, self._nats(key, fit[0]) + self._spec.known_nats
        return best

    def _fitted(
        self,
        key: Keyframe,
        patterns: Patterns,
        track: Floats,
        start: Floats,
        steps: tuple[float, float, float, float],
    ) -> tuple[Floats, Floats]:
        sums, fit = np.zeros((len(key.aperture.axes), 4)), np.zeros(7)
        size = np.array([math.radians(steps[0]), math.radians(steps[1]), steps[2] * key.bin_m, steps[3]])
        most = self._spec.most_curvature * key.bin_m
        refine_direction(key.aperture, patterns, start, across(start[:3], track), size, most, sums, fit)
        return fit, sums

    def _nats(self, key: Keyframe, fit: Floats) -> float:
        return len(key.aperture.offset) * -math.log(1 - min(fit[0] / max(fit[1], 1e-30), MOST_COHERENCE))

    def _echo(
        self, key: Keyframe, fit: Floats, sums: Floats, left: float
    ) -> tuple[Floats, Floats, float, float, Floats, float]:
        """State, covariance, coherence, log-likelihood ratio and amplitudes of one echo."""
        spec, aperture, unit = self._spec, key.aperture, fit[2:5]
        coherence = min(fit[0] / max(fit[1] + left, 1e-30), MOST_COHERENCE)
        weight = sums[aperture.sensor, 3] ** 2
        sigma = spec.phase_sigma_rad / aperture.phase * key.bin_m * math.sqrt(max(1 - coherence, 0.02) / 0.02)
        x = aperture.offset * key.bin_m
        bend = 0.5 * ((x**2).sum(axis=1) - (x @ unit) ** 2)
        design = np.column_stack([np.ones(len(x)), -x, bend]) * (np.sqrt(weight) / sigma)[:, None]
        covariance = np.linalg.inv(design.T @ design + OPEN)
        bearing = math.radians(spec.bearing_sigma_deg) ** 2
        covariance += np.diag([spec.range_sigma_m**2, bearing, bearing, bearing, spec.curvature_sigma**2])
        state = np.array([key.start_m + key.bin_m * fit[6], *unit, fit[5] / key.bin_m])
        nats = (weight > 0.01).sum() * -math.log(1 - coherence)
        amplitude = np.hypot(sums[:, 0], sums[:, 1]) / np.maximum(sums[:, 2], 1)
        return state, covariance, coherence, nats, amplitude, float(fit[0])


def _track_of(offset: Floats, sensor: np.ndarray) -> Floats:
    """Unit vector (3) along which most of an aperture lies."""
    mine = np.zeros((sensor.max() + 1, 3))
    np.add.at(mine, sensor, offset)
    away = offset - (mine / np.maximum(np.bincount(sensor), 1)[:, None])[sensor]
    return np.asarray(np.linalg.eigh(away.T @ away)[1][:, 2])
