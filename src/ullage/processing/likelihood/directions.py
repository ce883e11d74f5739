"""Echoes of one keyframe in space: directions round the track, and the antennas' levels that weigh them.

A short straight aperture fixes the range of an echo and its cosine to the track. All directions on that ring explain
its phases alike. The levels of the sensors weigh the ring, and an aperture that bends or climbs breaks it. Thus an echo
is a Gaussian over range, direction and curvature, wide along the ring, with its level at each sensor.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from ullage.arrays import Floats, Singles
from ullage.kernels.directed_sums import Patterns, gains_toward, refine_direction, subtract_directed, turn_rows_by
from ullage.kernels.matched_sums import LEAST_GAIN
from ullage.processing.likelihood.direction_sums import DirectionSums
from ullage.processing.likelihood.echoes import FAR_END_M, LEAST_ROWS, MOST_COHERENCE, SAME_RANGE_M
from ullage.processing.likelihood.folding import unfold
from ullage.processing.likelihood.keyframes import Keyframe
from ullage.processing.likelihood.poses import AperturePoses, EchoPhases, MountErrors, PoseErrors, range_sigma
from ullage.processing.likelihood.spec import LikelihoodSpec

COSINE_STEP, ROLLS = 0.04, 12  # of the first search: a lobe of the aperture, and half a beam of the antennas
COARSE, FINE = (2.0, 8.0, 0.35, 0.5), (0.5, 2.0, 0.05, 0.25)  # first steps: deg along and round the track, 1/m, bins
AS_IT_IS = (0.0, 0.0, 0.0, 0.0)  # no search
FITTED = 3  # parameters of an echo that its phases show: the cosine to the track, curvature and range
OPEN = np.diag([0.0, 0.01, 0.01, 0.01, 1.0])  # inverse variance that keeps what an aperture leaves open finite


@dataclass(frozen=True, slots=True, eq=False)
class DirectedEchoes:
    """Echoes of one keyframe, the strongest first."""

    position: Floats  # (3) of the keyframe [m]
    track: Floats  # (3) unit vector along the aperture
    patterns: Patterns  # of the radars
    rows: Floats  # (r) frames of each radar
    silent: Singles  # (b) energy that an echo must explain to be found, in each bin
    start_m: float  # range of bin 0
    bin_m: float
    noise: float
    state: Floats  # (e, 5) range [m], unit vector, curvature of the range [1/m]
    covariance: Floats  # (e, 5, 5)
    coherence: Floats  # (e) share of the energy that the echo explains
    nats: Floats  # (e) log-likelihood ratio against independent samples
    amplitude: Floats  # (e, r) at each radar
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
    (x, y, z), (u, v, w) = unit, first  # np.cross would take ten times as long
    return np.array([first, [y * w - z * v, z * u - x * w, x * v - y * u]])


def ring(along: Floats, cosine: float, count: int) -> Floats:
    """Directions (count, 3) of one cosine to a direction (3)."""
    first, second = across(along, np.array([0.0, 0.0, 1.0]))
    turn = 2 * np.pi * (np.arange(count) + 0.5) / count
    side = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
    return np.asarray(cosine * along + math.sqrt(max(1 - cosine**2, 0.0)) * side)


class _Aperture(NamedTuple):
    """A keyframe as the search sees it."""

    key: Keyframe
    patterns: Patterns
    track: Floats  # (3) unit vector along it
    known: Floats  # (k, 5) states of known surfaces as seen from its place
    poses: AperturePoses

    def gains(self, unit: Floats) -> Floats:
        """Two-way amplitude gain (s) of each sensor in a direction, over that of the one that sees it best."""
        out = np.empty(len(self.patterns.turns))
        gains_toward(self.patterns, np.ascontiguousarray(unit), out)
        return out


class _Hypothesis(NamedTuple):
    """A reflector fitted to the samples of an aperture."""

    fit: Floats  # (7) energy explained, all energy, unit vector, curvature [1/bin] and range [bin]
    sums: Floats  # (s, 3) real and imaginary part of each sensor's sum, and its rows


class _Echo(NamedTuple):
    """What an echo says, as in `DirectedEchoes`."""

    state: Floats
    covariance: Floats
    coherence: float
    nats: float
    amplitude: Floats
    energy: float


class DirectionFinder:
    """Finds the echoes of keyframes in all directions."""

    def __init__(self, spec: LikelihoodSpec) -> None:
        self._spec = spec
        self.pose_errors, self.mount_errors = PoseErrors(), MountErrors()
        cosines = np.linspace(-1, 1, round(2 / COSINE_STEP) + 1)
        x = np.array([1.0, 0.0, 0.0])
        self._turned = np.concatenate([ring(x, c, max(round(ROLLS * math.sqrt(1 - c * c)), 1)) for c in cosines])

    def steps(self, key: Keyframe, cubes: Floats, known: Floats) -> Generator[None, None, DirectedEchoes]:
        """Find the echoes of a keyframe, in steps of work; one keyframe at a time.

        Args:
            key: the keyframe; its samples change.
            cubes: (r, 6, m, m) one-way amplitude gains of the radars.
            known: (k, 5) states of known surfaces as seen from its place. A known surface explains an echo unless
                another hypothesis explains clearly more of it.
        """
        spec, aperture, noise = self._spec, key.aperture, key.noise**2
        bins, radars = aperture.samples.shape[1], key.radar[-1] + 1
        low, high = key.silent_bin, bins - int(FAR_END_M / key.bin_m)
        track = _track_of(aperture.offset, aperture.sensor)
        floor, left, found = np.ones(bins), np.zeros(bins), list[_Echo]()
        patterns = Patterns(cubes[key.radar], np.ascontiguousarray(key.turns))
        if len(aperture.offset) >= LEAST_ROWS and low < high:
            self.mount_errors.expect(aperture, key.mount_sigma_m / key.bin_m)
            poses, samples = AperturePoses(aperture), aperture.samples.copy()
            poses.expect(self.pose_errors.sigma_m / key.bin_m)
            directions = self._turned @ np.concatenate([track[None], across(track, np.eye(3)[2])])
            sums = DirectionSums(np.ascontiguousarray(directions), partial(turn_rows_by, patterns))
            sums.begin(aperture)
            seen = _Aperture(key, patterns, track, known, poses)
            found = yield from self._clean(seen, sums, floor, first=True)
            if poses.uncertain:  # all echoes together have shown the errors, so the samples are explained anew
                aperture.samples[:], floor[:] = samples, 1.0
                found = yield from self._clean(seen, sums, floor)
            left = sums.peak.astype(float)  # what a search that stops early leaves
        silent = np.full(bins, np.inf, np.float32)
        silent[low:high] = np.maximum(floor * spec.least_snr * noise, left)[low:high]
        return DirectedEchoes(
            key.position, track, Patterns(cubes[:radars], np.ascontiguousarray(key.turns[key.first])),
            np.bincount(key.radar[aperture.sensor], minlength=radars).astype(float), silent,
            key.start_m, key.bin_m, key.noise,
            np.array([one.state for one in found]).reshape(-1, 5),
            np.array([one.covariance for one in found]).reshape(-1, 5, 5),
            np.array([one.coherence for one in found]), np.array([one.nats for one in found]),
            np.array([one.amplitude for one in found]).reshape(-1, radars), np.array([one.energy for one in found]),
        )  # fmt: skip

    def _clean(
        self, seen: _Aperture, sums: DirectionSums, floor: Floats, *, first: bool = False
    ) -> Generator[None, None, list[_Echo]]:
        """Take the echoes out one after the other; `floor` (b) becomes what they leave behind, over the noise."""
        spec, key, noise, bins = self._spec, seen.key, seen.key.noise**2, len(floor)
        low, high = key.silent_bin, bins - int(FAR_END_M / key.bin_m)
        yield from sums.steps(low, high)
        reach, out = 2 * int(3 * key.pulse) + 2, list[_Echo]()
        for _ in range(spec.most_echoes):
            best, d, k = sums.strongest(floor, low, high)
            if best <= spec.least_snr * noise:
                break
            found = self._refined(seen, np.array([*sums.directions[d], 0.0, k]))
            mine = seen._replace(key=unfold(key, found.sums, partial(self._explained, seen, found.fit)))
            if mine.key is not key:
                found = self._refined(mine, found.fit[2:])
            if first and not out and key.aperture.phase:
                self._learn(mine, found.fit)
            found, echo = self._explain(mine, found, (floor[k] - 1) * noise)
            out.append(echo)
            places = found.fit[6] + np.unique(key.aperture.late)
            key.aperture.late[:] = 0.0
            for at in places.tolist():
                sums.sum(max(int(at) - reach, low), min(int(at) + reach, high))
                pulse = np.exp(-0.5 * ((np.arange(bins) - at) / key.pulse) ** 2)
                floor[:] = np.maximum(floor, 1 + spec.model_error * pulse * found.fit[0] / max(noise, 1e-30))
            yield
        return out

    def _phases(self, seen: _Aperture, fit: Floats) -> EchoPhases:
        return seen.poses.phases(fit[2:5], seen.gains(fit[2:5]), fit[5], fit[6])

    def _learn(self, seen: _Aperture, fit: Floats) -> None:
        """Learn from the strongest echo how large the errors of the poses are."""
        key, poses = seen.key, seen.poses
        expected = math.exp(-0.5 * poses.variance(fit[2:5]))
        self.pose_errors.learn(self._phases(seen, fit), FITTED, expected, 4 * math.pi / key.wavelength_m)
        poses.expect(self.pose_errors.sigma_m / key.bin_m)

    def _explain(self, seen: _Aperture, found: _Hypothesis, left: float) -> tuple[_Hypothesis, _Echo]:
        """Take an echo out of the samples, with the phases that errors of the poses explain; it corrects these.

        Args:
            seen: the aperture.
            found: the echo.
            left: energy that stronger echoes may have left at its range.

        Returns:
            The echo at corrected phases, and what it says.
        """
        aperture, poses = seen.key.aperture, seen.poses
        if not poses.sigma:
            subtract_directed(aperture, *found, seen.key.pulse)
            return found, self._echo(seen, found, left)
        unit, phases = found.fit[2:5], self._phases(seen, found.fit)
        turn = poses.expected(unit, phases)
        poses.shift(unit, turn)
        found = self._fitted(seen, found.fit[2:], AS_IT_IS)
        echo = self._echo(seen, found, left)
        subtract_directed(aperture, *found, seen.key.pulse)
        poses.shift(unit, -turn)
        poses.correct(unit, phases)
        return found, echo

    def _refined(self, seen: _Aperture, start: Floats) -> _Hypothesis:
        """Refine a first estimate (5), or take a known surface at its range that explains as much."""
        key, known = seen.key, seen.known
        best = self._fitted(seen, start, COARSE)
        at_m, nats = key.start_m + key.bin_m * best.fit[6], self._nats(key, best.fit)
        for state in known[np.abs(known[:, 0] - at_m) < SAME_RANGE_M]:
            rival = np.array([*state[1:4], state[4] * key.bin_m, (state[0] - key.start_m) / key.bin_m])
            other = self._fitted(seen, rival, FINE)
            if self._nats(key, other.fit) + self._spec.known_nats > nats:
                best, nats = other, self._nats(key, other.fit) + self._spec.known_nats
        return best

    def _explained(self, seen: _Aperture, fit: Floats) -> float:
        """Energy that a fit explains with the delays of the aperture."""
        return float(self._fitted(seen, fit[2:], AS_IT_IS).fit[0])

    def _fitted(self, seen: _Aperture, start: Floats, steps: tuple[float, float, float, float]) -> _Hypothesis:
        """Search about a start (5), with first steps in degrees along and round the track, 1/m and bins."""
        key, sums, fit = seen.key, np.zeros((len(seen.key.aperture.axes), 3)), np.zeros(7)
        size = np.array([math.radians(steps[0]), math.radians(steps[1]), steps[2] * key.bin_m, steps[3]])
        frame, most = across(start[:3], seen.track), self._spec.most_curvature * key.bin_m
        refine_direction(key.aperture, seen.patterns, start, frame, size, most, sums, fit)
        return _Hypothesis(fit, sums)

    def _nats(self, key: Keyframe, fit: Floats) -> float:
        return len(key.aperture.offset) * -math.log(1 - min(fit[0] / max(fit[1], 1e-30), MOST_COHERENCE))

    def _echo(self, seen: _Aperture, found: _Hypothesis, left: float) -> _Echo:
        """What an echo says, where stronger ones may have left energy at its range."""
        spec, key, (fit, sums) = self._spec, seen.key, found
        aperture, unit = key.aperture, fit[2:5]
        coherence = min(fit[0] / max(fit[1] + left, 1e-30), MOST_COHERENCE)
        weight = seen.gains(unit)[aperture.sensor] ** 2
        sigma = range_sigma(key, unit, coherence, spec)
        x = aperture.offset * key.bin_m
        bend = 0.5 * ((x**2).sum(axis=1) - (x @ unit) ** 2)
        design = np.column_stack([np.ones(len(x)), -x, bend]) * (np.sqrt(weight) / sigma)[:, None]
        covariance = np.linalg.inv(design.T @ design + OPEN)
        bearing = math.radians(spec.bearing_sigma_deg) ** 2
        covariance += np.diag([spec.range_sigma_m**2, bearing, bearing, bearing, spec.curvature_sigma**2])
        state = np.array([key.start_m + key.bin_m * fit[6], *unit, fit[5] / key.bin_m])
        nats = (weight > LEAST_GAIN**2).sum() * -math.log(1 - coherence)
        total = key.of_radars(sums)
        amplitude = np.hypot(total[:, 0], total[:, 1]) / np.maximum(total[:, 2], 1)
        return _Echo(state, np.asarray(covariance, float), coherence, nats, amplitude, float(fit[0]))


def _track_of(offset: Floats, sensor: np.ndarray) -> Floats:
    """Unit vector (3) along which most of an aperture lies."""
    mine = np.zeros((sensor.max() + 1, 3))
    np.add.at(mine, sensor, offset)
    away = offset - (mine / np.maximum(np.bincount(sensor), 1)[:, None])[sensor]
    return np.asarray(np.linalg.eigh(away.T @ away)[1][:, 2])
