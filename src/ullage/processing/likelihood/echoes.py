"""Echoes of one keyframe: the strongest reflector is found, refined and taken out of the samples; then the next.

The samples of all sensors in the aperture are summed coherently, each with the two-way gain of its antenna in the
direction of a hypothesis. The energy that the sum explains, over all energy along the same range, is the coherence of
the hypothesis. A wrong direction fails in phase along the track, and in level between the sensors. Straight up and down
are hypotheses as all others, so that floor and ceiling explain their own echoes.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass
from functools import partial
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Floats
from ullage.kernels.matched_sums import LEAST_GAIN, Aperture, refine, subtract
from ullage.processing.likelihood.direction_sums import DirectionSums
from ullage.processing.likelihood.folding import unfold
from ullage.processing.likelihood.keyframes import Keyframe
from ullage.processing.likelihood.lying import lying_share
from ullage.processing.likelihood.poses import AperturePoses, EchoPhases, MountErrors, PoseErrors, range_sigma
from ullage.processing.likelihood.rivals import APART, MOST_LEAD, MirrorLevel, ring_of, rivals_of, track_of
from ullage.processing.likelihood.spec import LikelihoodSpec

FAR_END_M = 0.3  # of the range axis that the search leaves out
LEAST_ROWS = 4  # of an aperture: range, bearing and curvature need three
BEARING_PRIOR_RAD, CURVATURE_PRIOR, COSINE_PRIOR = (
    0.5,
    1.0,
    2.0,
)  # standard deviation of what an aperture may leave open
MOST_COHERENCE = 0.995
COARSE, FINE = (1.5, 0.35, 0.5, 0.0), (0.5, 0.05, 0.25, 0.0)  # first steps: deg, 1/m, bins and cosine
FINE_LYING = (0.5, 0.05, 0.25, 0.02)
TILTED, SLOPES = (1.5, 0.2, 0.5, 0.04), (0.95, 0.87, 0.77, 0.64, 0.5)  # the same for slopes; their cosines
AS_IT_IS = (0.0, 0.0, 0.0, 0.0)  # no search
CLEAR = 0.97  # coherence of a level reflector from which no slope is tried
LEAST_CLEAR = 0.95  # coherence of a level reflector that speaks for the mounts
SAME_RANGE_M = 0.1  # within which an echo may be that of a known surface

Found = tuple[Floats, Floats, float, float, float]
Led = tuple[Floats, Floats, float, float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Echoes:
    """Level echoes of one keyframe, the strongest first."""

    position: Floats  # (2) of the keyframe [m]
    state: Floats  # (e, 4) range [m], bearing [rad], curvature of the range [1/m] and cosine of the elevation
    covariance: Floats  # (e, 4, 4)
    coherence: Floats  # (e) share of the energy that the echo explains
    level: Floats  # (e) amplitude times range, over the antenna's gain [m]
    nats: Floats  # (e) log-likelihood ratio of the echo against independent samples
    lead: Floats  # (e) nats by which its direction explains more than any rival on the ring about the track
    track: Floats  # (3) unit vector along the aperture
    height_m: float = 0.0  # of the keyframe

    def __len__(self) -> int:
        return len(self.state)


@dataclass(frozen=True, slots=True, eq=False)
class Left:
    """What the echoes of one keyframe leave in its samples."""

    directions: Floats  # (d, 3) level
    energy: NDArray[np.float32]  # (d, b) that a flat reflector in each direction and bin explains
    clutter: Floats  # (b) energy that noise and strong echoes leave behind
    low: int  # first bin that was searched
    high: int  # bin after the last


class EchoFinder:
    """Finds the echoes of keyframes; `left` is what those of the latest one do not explain."""

    def __init__(self, spec: LikelihoodSpec) -> None:
        self._spec = spec
        self.pose_errors, self.mount_errors = PoseErrors(), MountErrors()
        self.left: Left | None = None
        self._mirror = MirrorLevel()
        bearing = np.arange(spec.directions) * 2 * np.pi / spec.directions
        self._bearing = np.concatenate([bearing, [1.0, -1.0]])
        self._level = np.concatenate([np.ones(len(bearing)), [0.0, 0.0]])
        level = np.stack([np.cos(bearing), np.sin(bearing), 0 * bearing], axis=1)
        self._sums = DirectionSums(np.concatenate([level, [[0, 0, 1.0], [0, 0, -1.0]]]))
        self._slope_directions = np.concatenate([cosine * level for cosine in SLOPES])
        self._slopes = DirectionSums(self._slope_directions)

    def find(self, key: Keyframe, known: Floats | None = None) -> Echoes:
        """Find the echoes of a keyframe.

        Args:
            key: the keyframe.
            known: (s, 6) states that known surfaces have from its place, 1 for those that bend in the vertical plane
                through their direction only, and nats by which another state of the same surface is likelier. A known
                surface explains an echo unless another hypothesis explains clearly more of it.
        """
        work = self.steps(key, np.zeros((0, 6)) if known is None else known)
        while True:
            try:
                next(work)
            except StopIteration as done:
                return cast("Echoes", done.value)

    def steps(self, key: Keyframe, known: Floats) -> Generator[None, None, Echoes]:
        """The same in steps of work; one keyframe at a time."""
        aperture, bins = key.aperture, key.aperture.samples.shape[1]
        low, high = key.first_bin, bins - int(FAR_END_M / key.bin_m)
        found: list[Led] = []
        self.left = None
        if len(aperture.offset) >= LEAST_ROWS and low < high:
            self.mount_errors.expect(aperture, key.mount_sigma_m / key.bin_m)
            poses, samples = AperturePoses(aperture), aperture.samples.copy()
            poses.expect(self.pose_errors.sigma_m / key.bin_m)
            self._sums.begin(aperture)
            self._slopes.begin(aperture)
            found = yield from self._clean(key, low, high, known, poses, first=True)
            if poses.uncertain:  # all echoes together have shown the errors, so the samples are explained anew
                aperture.samples[:] = samples
                found = yield from self._clean(key, low, high, known, poses)
        state = np.array([row[0] for row in found]).reshape(-1, 4)
        covariance = np.array([row[1] for row in found]).reshape(-1, 4, 4)
        rest = np.array([row[2:] for row in found]).reshape(-1, 4)
        coherence, level, nats, lead = rest.T
        track = track_of(aperture) if len(found) else np.zeros(3)
        height_m = float(key.position[2])
        return Echoes(key.position[:2], state, covariance, coherence, level, nats, lead, track, height_m)

    def _clean(
        self, key: Keyframe, low: int, high: int, known: Floats, poses: AperturePoses, *, first: bool = False
    ) -> Generator[None, None, list[Led]]:
        """Take the echoes out one after the other, and list the level ones."""
        spec, aperture, noise = self._spec, key.aperture, key.noise**2
        bins = aperture.samples.shape[1]
        yield from self._sums.steps(low, high)
        floor, reach = np.ones(bins), 2 * int(3 * key.pulse) + 2
        out: list[Led] = []
        for _ in range(spec.most_echoes):
            best, d, k = self._sums.strongest(floor, low, high)
            if best <= spec.least_snr * noise:
                break
            start = np.array([self._level[d], self._bearing[d], 0.0, k, 0.0])
            start, fit, sums = self._refined(key, start, known)
            seen = unfold(key, sums, partial(self._explained, key, fit))
            if seen is not key:
                start, fit, sums = self._refined(seen, start, known)
            lead = 0.0
            if start[0] > 0:
                fit, sums, lead = self._led(seen, fit, sums, strongest=not out)
            if first and not out and aperture.phase:
                self._learn(seen, poses, start, fit)
                if k >= key.silent_bin and seen is key:  # an own echo comes from no direction
                    self._learn_mounts(key, k)
            fit, echo = self._explain(seen, poses, (fit, sums), (floor[k] - 1) * noise)
            if start[0] > 0:
                out.append((*echo, lead))
            places = fit[4] + np.unique(aperture.late)
            aperture.late[:] = 0.0
            for at in places.tolist():
                self._sums.sum(max(int(at) - reach, low), min(int(at) + reach, high))
                pulse = np.exp(-0.5 * ((np.arange(bins) - at) / key.pulse) ** 2)
                floor = np.maximum(floor, 1 + spec.model_error * pulse * fit[0] / max(noise, 1e-30))
            yield
        level = slice(spec.directions)
        self.left = Left(self._sums.directions[level], self._sums.energy[level], floor * max(noise, 1e-30), low, high)
        return out

    def _phases(self, key: Keyframe, poses: AperturePoses, fit: Floats) -> tuple[Floats, EchoPhases]:
        """Direction of an echo, and its phases."""
        unit = _unit(fit[5], fit[2])
        gains = gains_of(key.aperture, unit)
        return unit, poses.phases(unit, gains / gains.max(), fit[3], fit[4], lying=fit[6] > 0)

    def _learn(self, key: Keyframe, poses: AperturePoses, start: Floats, fit: Floats) -> None:
        """Learn from the strongest echo how large the errors of the poses are."""
        unit, phases = self._phases(key, poses, fit)
        expected, fitted = math.exp(-0.5 * poses.variance(unit)), 3 if start[0] > 0 else 2
        self.pose_errors.learn(phases, fitted, expected, 4 * math.pi / key.wavelength_m)
        poses.expect(self.pose_errors.sigma_m / key.bin_m)

    def _learn_mounts(self, key: Keyframe, at: int) -> None:
        """Learn how coherent the sensors are from the echo at a bin, searched for anew with free phases between them.

        A direction that was fitted to these phases would agree with them.
        """
        aperture, reach = key.aperture, int(key.pulse) + 2
        low, high = max(at - reach, 0), min(at + reach, aperture.samples.shape[1])
        together, aperture.together[0] = aperture.together[0], 0.0
        self._sums.sum(low, high)
        _, d, k = self._sums.strongest(1.0, low, high)
        fit, sums = self._fitted(key, np.array([self._level[d], self._bearing[d], 0.0, k, 0.0]), COARSE)
        if fit[0] > LEAST_CLEAR * fit[1]:
            self.mount_errors.learn(gains_of(aperture, _unit(fit[5], fit[2]))[key.first], key.of_radars(sums))
        aperture.together[0] = together
        self._sums.sum(low, high)

    def _explain(
        self, key: Keyframe, poses: AperturePoses, hypothesis: tuple[Floats, Floats], left: float
    ) -> tuple[Floats, Found]:
        """Take an echo out of the samples, with the phases that errors of the poses explain.

        Args:
            key: the keyframe.
            poses: of its aperture; the echo corrects them, and the first one shows how large their errors are.
            hypothesis: fit and sums.
            left: energy that stronger echoes may have left at its range.

        Returns:
            The fit at corrected phases, and the echo.
        """
        fit, sums = hypothesis
        if not poses.sigma:
            echo = self._echo(key, fit, sums, left)
            subtract(key.aperture, fit, sums, key.pulse)
            return fit, echo
        unit, phases = self._phases(key, poses, fit)
        turn = poses.expected(unit, phases)
        poses.shift(unit, turn)
        fit, sums = self._fitted(key, np.array([fit[5], *fit[2:5], fit[6]]), AS_IT_IS)
        echo = self._echo(key, fit, sums, left)
        subtract(key.aperture, fit, sums, key.pulse)
        poses.shift(unit, -turn)
        poses.correct(unit, phases)
        return fit, echo

    def _refined(self, key: Keyframe, start: Floats, known: Floats) -> tuple[Floats, Floats, Floats]:
        """Refine a first estimate, and rival it by the known surfaces at its range.

        Returns:
            Start, fit and sums of the hypothesis that explains the echo.
        """
        fit, sums = self._fitted(key, start, COARSE)
        at_m = key.start_m + key.bin_m * fit[4]
        best, best_nats = (start, fit, sums), self._nats(key, fit)
        if start[0] > 0 and fit[0] < CLEAR * fit[1]:
            rival = self._slope_near(key, fit)
            slope, sums = self._fitted(key, rival, TILTED)
            if self._gain(key, fit, slope) > self._spec.slope_nats:
                best, best_nats = (rival, slope, sums), self._nats(key, slope)
        for range_m, bearing, curvature, cosine, lying, behind in known[np.abs(known[:, 0] - at_m) < SAME_RANGE_M]:
            rival = np.array([cosine, bearing, curvature * key.bin_m, (range_m - key.start_m) / key.bin_m, lying])
            fit, sums = self._fitted(key, rival, FINE_LYING if lying else FINE)
            nats = self._nats(key, fit) + self._spec.known_nats - behind
            if nats > best_nats:
                best, best_nats = (rival, fit, sums), nats
        return best

    def _explained(self, key: Keyframe, fit: Floats) -> float:
        """Energy that a fit explains with the delays of the aperture."""
        return float(self._fitted(key, np.array([fit[5], *fit[2:5], fit[6]]), AS_IT_IS)[0][0])

    def _led(self, key: Keyframe, fit: Floats, sums: Floats, *, strongest: bool) -> tuple[Floats, Floats, float]:
        """Compare an echo's direction with all others on the ring about the track.

        The direction across the track replaces it where that explains the levels better.

        Returns:
            Fit, sums and lead of the direction [nat].
        """
        aperture = key.aperture
        track, flat = track_of(aperture), fit.copy()
        if fit[6]:
            flat[3] *= lying_share(fit[5], float(track @ _unit(1.0, fit[2])))
        ring = ring_of(track, fit[5], fit[2])
        by_sensor = gains_of(aperture, ring)
        gains, loudest = by_sensor.max(axis=1), loudest_of(by_sensor[0], sums)
        rivals = rivals_of(aperture, flat, ring)
        level = math.hypot(sums[loudest, 0], sums[loudest, 1]) / max(sums[loudest, 2], 1)
        level *= key.start_m + key.bin_m * fit[4]
        if strongest:
            self._mirror.learn(level / gains.max())
        rivals.left[0] = 1 - min(fit[0] / max(fit[1], 1e-30), 1.0)
        lost = self._lost(key) + 1 - MOST_COHERENCE
        nats = -len(aperture.offset) * np.log(rivals.left + lost) - self._mirror.excess_nats(level / gains)
        across = np.flatnonzero(rivals.cosine >= fit[5] - 1e-6)
        best = int(across[np.argmax(nats[across])])
        if best and nats[best] > nats[0]:
            start = np.array([min(rivals.cosine[best], 1.0), rivals.bearing[best], flat[3], fit[4], 0.0])
            fit, sums = self._fitted(key, start, FINE)
        else:
            best = 0
        others = np.flatnonzero(ring @ ring[best] < APART)
        lead = float(nats[best] - nats[others].max()) if len(others) else MOST_LEAD
        return fit, sums, min(max(lead, -MOST_LEAD), MOST_LEAD)

    def _lost(self, key: Keyframe) -> float:
        """Share of all energy that errors of the poses leave unexplained."""
        return 1 - math.exp(-((4 * math.pi / key.wavelength_m * self.pose_errors.sigma_m) ** 2))

    def _slope_near(self, key: Keyframe, fit: Floats) -> Floats:
        """Start (5) of the slope that explains most energy near the range of a fit."""
        at, reach = int(fit[4]), 2 * int(key.pulse) + 2
        low, high = max(at - reach, 0), min(at + reach, key.aperture.samples.shape[1])
        self._slopes.sum(low, high)
        _, d, k = self._slopes.strongest(1.0, low, high)
        x, y, _ = self._slope_directions[d]
        return np.array([math.hypot(x, y), math.atan2(y, x), 0.0, k, 0.0])

    def _fitted(self, key: Keyframe, start: Floats, steps: tuple[float, float, float, float]) -> tuple[Floats, Floats]:
        """Fit and sums of `refine` from a start, with first steps in degrees, 1/m, bins and cosine."""
        sums, fit = np.zeros((len(key.aperture.axes), 3)), np.zeros(7)
        size = np.array([math.radians(steps[0]), steps[1] * key.bin_m, steps[2], steps[3]])
        refine(key.aperture, start, size, self._spec.most_curvature * key.bin_m, sums, fit)
        return fit, sums

    def _nats(self, key: Keyframe, fit: Floats) -> float:
        """Log-likelihood ratio of a fit over all rows."""
        return len(key.aperture.offset) * -math.log(1 - min(fit[0] / max(fit[1], 1e-30), MOST_COHERENCE))

    def _gain(self, key: Keyframe, fit: Floats, other: Floats) -> float:
        """Nats by which another fit explains more, where errors of the poses leave part of all energy unexplained."""
        lost = self._lost(key)
        left = [1 - min(one[0] / max(one[1], 1e-30), MOST_COHERENCE) + lost for one in (fit, other)]
        return len(key.aperture.offset) * math.log(left[0] / left[1])

    def _echo(self, key: Keyframe, fit: Floats, sums: Floats, left: float) -> Found:
        """State, covariance, coherence, level and log-likelihood ratio of one echo.

        Args:
            key: the keyframe.
            fit: as of `refine`.
            sums: as of `refine`.
            left: energy that stronger echoes may have left at its range; it counts as not explained.
        """
        explained, energy, bearing, curvature, place, cosine, lying = fit
        coherence = min(explained / max(energy + left, 1e-30), MOST_COHERENCE)
        aperture = key.aperture
        ahead = np.array([math.cos(bearing), math.sin(bearing), 0.0])
        unit = cosine * ahead
        gains = gains_of(aperture, unit)
        gain = (gains / gains.max())[aperture.sensor]
        active = gain > LEAST_GAIN
        along = aperture.offset[active] @ ahead * key.bin_m
        across = aperture.offset[active] @ [-ahead[1], ahead[0], 0.0] * key.bin_m
        sigma = range_sigma(key, unit, coherence, self._spec) / gain[active]  # the noise of all sensors is alike
        if lying:
            curvature *= float(lying_share(cosine, float(track_of(aperture) @ ahead)))
        loudest = loudest_of(gains, sums)
        mean = math.hypot(sums[loudest, 0], sums[loudest, 1]) / max(sums[loudest, 2], 1)
        range_m = key.start_m + key.bin_m * place
        state = np.array([range_m, bearing, curvature / key.bin_m, cosine])
        nats = active.sum() * -math.log(1 - coherence)
        return (
            state,
            self._covariance(along, cosine * across, sigma),
            coherence,
            mean / gains[loudest] * range_m,
            nats,
        )

    def _covariance(self, along: Floats, across: Floats, sigma: Floats) -> Floats:
        """Covariance (4, 4) of range, bearing, curvature and cosine, by least squares on the ranges of the rows.

        Args:
            along: level offsets of the rows along the direction [m].
            across: offsets across it, times the cosine [m].
            sigma: standard deviations of the ranges of the rows [m].
        """
        spec = self._spec
        design = np.stack([np.ones_like(across), -across, 0.5 * across**2, -along], axis=1) / sigma[:, None]
        prior = np.diag([0.0, BEARING_PRIOR_RAD**-2, CURVATURE_PRIOR**-2, COSINE_PRIOR**-2])
        inverse = np.linalg.inv(design.T @ design + prior)
        bearing = math.radians(spec.bearing_sigma_deg)
        out = np.diag([spec.range_sigma_m**2, bearing**2, spec.curvature_sigma**2, spec.cosine_sigma**2])
        out[1:, 1:] += inverse[1:, 1:]
        return out


def _unit(cosine: float, bearing: float) -> Floats:
    """Level part (3) of the unit vector at a bearing [rad] and elevation; straight up or down where the cosine is 0."""
    if cosine > 0:
        return np.array([cosine * math.cos(bearing), cosine * math.sin(bearing), 0.0])
    return np.array([0.0, 0.0, math.copysign(1.0, bearing)])


def loudest_of(gains: Floats, sums: Floats) -> int:
    """The sensor that faces a direction best, of those whose rows reach the echo's range.

    Args:
        gains: (s) in the direction.
        sums: (s, 3) as of `refine`.
    """
    return int(np.argmax(np.where(sums[:, 2] > 0, gains, -1.0)))


def gains_of(aperture: Aperture, units: Floats) -> Floats:
    """Two-way amplitude gains (..., s) of the sensors in directions (..., 3), over those on boresight."""
    cells = aperture.gains.shape[1] - 1
    cell = np.clip((1 - units @ aperture.axes.T) * 0.5 * cells, 0, cells).astype(int)
    return np.asarray(aperture.gains[np.arange(len(aperture.axes)), cell])
