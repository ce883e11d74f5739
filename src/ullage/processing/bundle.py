"""Clock, range, place and direction of an antenna, and scale of its track, from scatterers that must agree.

The model of a scatterer is a point: its echo has the phase of its distance, the envelope of the pulse at its delay, and
an amplitude that varies slowly along the track. Its log-likelihood is the power that this model explains over the power
per independent sample that it leaves, on a window that stays as it was drawn. Phase and envelope depend on the same
distance, but only the envelope on the range offset: this is what determines the offset. Where the mount is known, the
level of an echo follows the antenna's pattern, which shows the boresight. The places of the scatterers are nuisances.
They are eliminated by the Schur complement, as in bundle adjustment [Triggs2000]. What they leave is the covariance of
nine quantities, each with the others unknown within their priors (`point_focus.path_slopes`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ullage.antenna import gain as antenna_gain
from ullage.arrays import Floats
from ullage.processing.point_focus import CLOCK, PARAMETERS, RANGE, VISIBLE_M, Echoes, Point, PointFocus
from ullage.specs import MountSpec, RadarSpec

STEPS, ROUNDS = 12, 4
LEAST_STEP = 0.05  # standard deviations at which the search ends
FREEDOM = 4.0  # of Student's t, by which scatterers that contradict the others lose weight [Lange1989]
DISPERSION = 4.0  # score variance over curvature that is expected of scatterers
DISPERSION_POINTS = 4.0  # how many scatterers this expectation is worth
SURVEY_SIGMA_M = 0.005  # of each coordinate of a surveyed place
LEVEL_SIGMA_DB = 2.0  # of how far levels stray from the antenna's pattern over VISIBLE_M of flight
DECIBEL = np.log(10) / 20  # of the logarithm of an amplitude


@dataclass(frozen=True, slots=True, eq=False)
class Bundle:
    """Scatterers on one path, and the parameters of that path."""

    theta: Floats  # (9), in the order of `path_slopes`
    covariance: Floats  # (9, 9)
    dispersion: float  # score variance of the scatterers over their curvature
    points: tuple[Point, ...]  # as the parameters place them


@dataclass(frozen=True, slots=True, eq=False)
class _Linear:
    """Slope (k, q) and curvature (k, q, q) of scatterers' log-likelihoods; the first three are their places."""

    slope: Floats
    curve: Floats

    def reduced(self) -> _Linear:
        """The same without the places: their best values are inserted."""
        inner = self.curve[:, :3, :3] + 1e-9 * np.trace(self.curve[:, :3, :3], axis1=1, axis2=2)[
            :, None, None
        ] * np.eye(3)
        right = np.concatenate([self.curve[:, :3, 3:], self.slope[:, :3, None]], axis=2)
        back = np.linalg.solve(inner + 1e-12 * np.eye(3), right)
        across = self.curve[:, 3:, :3]
        return _Linear(
            self.slope[:, 3:] - (across @ back[..., -1:])[..., 0], self.curve[:, 3:, 3:] - across @ back[..., :-1]
        )


def pattern_slopes(spec: RadarSpec, ahead: Floats) -> Floats:
    """Slope (n, 3) of the logarithm of an echo's amplitude over the direction (n, 3) in the antenna's frame."""
    step = 1e-4 * np.eye(3)
    each = [
        np.log(antenna_gain(spec.antenna, ahead + one) / antenna_gain(spec.antenna, ahead - one)) / 1e-4 for one in step
    ]
    return np.stack(each, axis=1)


def level_slopes(ray: Floats, distance: Floats, leant: Floats, lean: Floats, ahead: Floats) -> tuple[Floats, Floats]:
    """Slopes (..., 3) of the logarithm of an echo's amplitude over its place, and over a turn of the antenna.

    Args:
        ray: (..., 3) directions to the place, world.
        distance: (...) of the place [m].
        leant: (..., 3) slopes of the pattern, world.
        lean: (..., 3) the same in the antenna's frame.
        ahead: (..., 3) directions in the antenna's frame.
    """
    return (leant - 2 * ray) / distance[..., None], np.cross(lean, ahead)


def parameter_slopes(over: Floats, twist: Floats | None, place: Floats, turn: Floats) -> Floats:
    """Slopes (..., n, 9) over the nine quantities, from those (..., n, 3) over places and turns of the antenna."""
    out = -np.einsum("...ni,niq->...nq", over, place)
    return np.asarray(out if twist is None else out + np.einsum("...ni,niq->...nq", twist, turn))


class _Likelihood:
    """Scatterers with windows and noise that stay as they were drawn.

    Args:
        focus: of the recording.
        points: scatterers, with their amplitudes along the track.
        theta: parameters under which the points were drawn.
    """

    def __init__(self, focus: PointFocus, points: Sequence[Point], theta: Floats) -> None:
        self.focus = focus
        self.amplitude = np.array([one.amplitude for one in points])
        places = np.array([one.place for one in points])
        echo = self.echoes(places, theta)
        value = echo.value / echo.level
        self.weight = self.amplitude * focus.weight
        self.norm = np.maximum((self.amplitude * self.weight).sum(1), 1e-30)
        self.noise = np.ones(len(points))
        explained = self.gains(value)
        half = focus.wave_m / 2
        window = focus.weight * (self.amplitude > 0)
        energy = (window * np.abs(value) ** 2).sum(1) / half
        self.noise = np.maximum(energy - explained, 1e-3 * energy) / np.maximum(window.sum(1) / half, 1.0)
        spec = focus.spec  # directions are known on a mount that was set alone
        self.shows_boresight = spec.mount != MountSpec() and spec.antenna.kind != "isotropic" and len(points) > 0
        self.log_level = np.log(np.maximum(self.amplitude * echo.level, 1e-30))
        self.views = window / VISIBLE_M * DISPERSION / (LEVEL_SIGMA_DB * DECIBEL) ** 2  # as likelihoods are
        if self.shows_boresight:  # a recording's own levels may stray farther
            misfit = self._levels(echo.ray, places, theta, None)[2].sum()
            self.views /= max(1.0, 2 * float(misfit) / DISPERSION / (window.sum() / VISIBLE_M))
        self.weight = self.weight / echo.level  # as drawn: a level that follows the range would pull the envelope

    def echoes(self, places: Floats, theta: Floats) -> Echoes:
        """Echoes of places (k, 3) under parameters."""
        return self.focus.echoes(places, self.focus.bent(theta), float(theta[RANGE]))

    def gains(self, value: NDArray[np.complex128]) -> Floats:
        """Log-likelihoods (k) of the scatterers over noise."""
        power = np.abs((self.weight * value).sum(1)) ** 2 / self.norm
        return np.asarray(power / (self.focus.wave_m / 2) / np.maximum(self.noise, 1e-30))

    def linear(self, places: Floats, theta: Floats, *, only_places: bool) -> tuple[_Linear, Floats]:
        """Gauss-Newton terms in places and parameters, and log-likelihoods (k)."""
        focus, echo = self.focus, self.echoes(places, theta)
        moved = None if only_places else focus.bend(theta)
        gain, total = self.gains(echo.value), (self.weight * echo.value).sum(1)[:, None]
        back = self.weight * np.conj(total) / np.maximum(np.abs(total) ** 2, 1e-30)
        share = np.maximum((back * echo.value).real, 0.0)
        share = share / np.maximum(share.sum(1, keepdims=True), 1e-30)
        phase = echo.ray
        if moved is not None:
            phase = np.concatenate([phase, parameter_slopes(echo.ray, None, *moved)], axis=2)
        envelope = phase.copy()
        if moved is not None:
            envelope[..., 3 + RANGE] = -1.0
        mean = (share[..., None] * phase).sum(1)
        turned = np.swapaxes(phase * share[..., None], 1, 2)
        curve = focus.per_m_phase**2 * (turned @ phase - mean[:, :, None] * mean[:, None])
        curve = curve + focus.envelope_bend * (np.swapaxes(envelope * share[..., None], 1, 2) @ envelope)
        slope = -focus.per_m_phase * ((back * echo.value).imag[..., None] * phase).sum(1)
        slope = slope + ((back * echo.slope).real[..., None] * envelope).sum(1)
        scale = 2 * gain
        linear = _Linear(scale[:, None] * slope, scale[:, None, None] * curve)
        if self.shows_boresight:
            slope, curve, cost = self._levels(echo.ray, places, theta, moved)
            linear, gain = _Linear(linear.slope + slope, linear.curve + curve), gain - cost
        return linear, gain

    def _levels(
        self, ray: Floats, places: Floats, theta: Floats, moved: tuple[Floats, Floats] | None
    ) -> tuple[Floats, Floats, Floats]:
        """Slope, curvature and misfit (k) of levels that follow the antenna's pattern and the distance."""
        focus, antenna = self.focus, self.focus.antennas(theta)
        ahead = np.einsum("nij,kni->knj", antenna, ray)
        distance = np.linalg.norm(places[:, None] - focus.bent(theta), axis=2)
        flat = ahead.reshape(-1, 3)
        lean = pattern_slopes(focus.spec, flat).reshape(ahead.shape)
        expected = 2 * np.log(antenna_gain(focus.spec.antenna, flat).reshape(distance.shape)) - 2 * np.log(distance)
        over, twist = level_slopes(ray, distance, np.einsum("nij,knj->kni", antenna, lean), lean, ahead)
        if moved is not None:
            over = np.concatenate([over, parameter_slopes(over, twist, *moved)], axis=2)
        views = self.views / np.maximum(self.views.sum(1, keepdims=True), 1e-30)
        left = self.log_level - expected
        left = left - (views * left).sum(1, keepdims=True)  # of a scatterer of unknown size
        over = over - (views[..., None] * over).sum(1, keepdims=True)
        weighed = np.swapaxes(over * self.views[..., None], 1, 2)
        return (weighed @ left[..., None])[..., 0], weighed @ over, 0.5 * (self.views * left**2).sum(1)

    def placed(self, places: Floats, theta: Floats, *, steps: int = 8) -> tuple[Floats, Floats]:
        """Places (k, 3) nearby of greatest log-likelihood, by damped Gauss-Newton, and these log-likelihoods (k)."""
        places = places.copy()
        linear, best = self.linear(places, theta, only_places=True)
        damping = np.full(len(places), 1e-4)
        for _ in range(steps):
            trace = np.trace(linear.curve, axis1=1, axis2=2)
            damped = linear.curve + ((damping + 1e-9) * trace + 1e-12)[:, None, None] * np.eye(3)
            move = np.linalg.solve(damped, linear.slope[..., None])[..., 0]
            size = np.linalg.norm(move, axis=1)
            move = move * np.minimum(1.0, 0.66 * self.focus.wave_m / np.maximum(size, 1e-9))[:, None]
            tried, found = self.linear(places + move, theta, only_places=True)
            better = found >= best
            damping = np.where(better, damping / 3, damping * 10)
            places[better] += move[better]
            best = np.where(better, found, best)
            linear = _Linear(
                np.where(better[:, None], tried.slope, linear.slope),
                np.where(better[:, None, None], tried.curve, linear.curve),
            )
            if (size < 0.004 * self.focus.wave_m).all():
                break
        return places, best


def adjusted(focus: PointFocus, points: Sequence[Point], theta: Floats, mean: Floats, precision: Floats) -> Bundle:
    """Parameters that all scatterers ask for together, with their covariance.

    Args:
        focus: of the recording.
        points: scatterers, drawn under about these parameters.
        theta: (9) parameters to start from.
        mean: (9) of their normal prior.
        precision: (9) of their normal prior; 0: unknown.
    """
    for _ in range(ROUNDS):
        likelihood = _Likelihood(focus, points, theta)
        places = np.array([one.place for one in points])
        found, places, covariance, dispersion = _climbed(likelihood, places, theta, mean, precision)
        moved = np.abs(found - theta)
        theta = found
        points = focus.redrawn(places, theta)
        if (moved**2 < 0.01 * np.diag(covariance)).all() or not points:
            break
    return Bundle(theta, covariance, dispersion, tuple(points))


def held(focus: PointFocus, places: Floats, theta: Floats, precision: Floats) -> Bundle:
    """Covariance of clock and range found from surveyed places (k, 3), with the other parameters as they were assumed.

    The others are within a prior of this precision (9), and move what is found: consider analysis [Jazwinski1970].
    """
    points = focus.redrawn(places, theta)
    curve, covariance = np.zeros((PARAMETERS, PARAMETERS)), np.diag(1 / precision)
    if points:
        at = np.array([one.place for one in points])
        linear, _ = _Likelihood(focus, points, theta).linear(at, theta, only_places=False)
        linear.curve[:, range(3), range(3)] += DISPERSION / SURVEY_SIGMA_M**2
        curve = linear.reduced().curve.sum(0) / DISPERSION
    found = np.array([CLOCK, RANGE])
    own = np.linalg.inv((curve + np.diag(precision))[np.ix_(found, found)])
    pull = np.eye(PARAMETERS)
    pull[found] = -own @ curve[found]
    pull[:, found] = 0.0
    covariance = pull @ covariance @ pull.T
    covariance[np.ix_(found, found)] += own
    return Bundle(theta, covariance, DISPERSION, points)


def _climbed(
    likelihood: _Likelihood, places: Floats, theta: Floats, mean: Floats, precision: Floats
) -> tuple[Floats, Floats, Floats, float]:
    """Parameters of greatest posterior, places, covariance and dispersion, for windows as they are."""
    places, gain = likelihood.placed(places, theta)
    dispersion, damping = DISPERSION, 0.0
    for _ in range(STEPS):
        linear = likelihood.linear(places, theta, only_places=False)[0].reduced()
        share, dispersion = _shares(linear, precision, dispersion)
        curve = np.tensordot(share, linear.curve, 1) / dispersion
        slope = share @ linear.slope / dispersion - precision * (theta - mean)
        covariance = np.asarray(np.linalg.inv(curve + np.diag(precision) + 1e-12 * np.eye(PARAMETERS)), np.float64)
        damped = curve * (1 + damping * np.eye(PARAMETERS)) + np.diag(precision) + 1e-12 * np.eye(PARAMETERS)
        step = np.linalg.solve(damped, slope)
        if (step**2 < LEAST_STEP**2 * np.diag(covariance)).all():
            break
        tried, found = likelihood.placed(places, theta + step)
        if _value(found, share, dispersion, theta + step - mean, precision) > _value(
            gain, share, dispersion, theta - mean, precision
        ):
            theta, places, gain, damping = theta + step, tried, found, damping / 4
        else:
            damping = max(4 * damping, 0.3)
    return theta, places, covariance, dispersion


def _value(gain: Floats, share: Floats, dispersion: float, away: Floats, precision: Floats) -> float:
    return float(share @ gain) / dispersion - 0.5 * float(precision @ away**2)


def _shares(linear: _Linear, precision: Floats, dispersion: float) -> tuple[Floats, float]:
    """Weights (k) of scatterers by how well they agree with the others, and the dispersion of their likelihoods."""
    prior = np.diag(precision + 1e-9)
    count = len(linear.slope)
    share = np.ones(count)
    for _ in range(5):
        own = linear.curve / dispersion + prior
        away = np.linalg.solve(own, linear.slope[..., None] / dispersion)[..., 0]
        misfit = (away * linear.slope).sum(1) / dispersion  # of its likelihood, if all others are right
        share = (FREEDOM + 2) / (FREEDOM + np.maximum(misfit, 2.0))
        spread = (share**2)[:, None, None] * linear.slope[:, :, None] * linear.slope[:, None]
        whole = np.tensordot(share, linear.curve, 1)
        free = np.trace(np.linalg.solve(whole + dispersion * prior, whole))
        found = float(np.trace(np.linalg.solve(whole + dispersion * prior, spread.sum(0)))) / max(float(free), 0.1)
        found = found * count / max(count - 1, 1)
        dispersion = (count * found + DISPERSION_POINTS * DISPERSION) / (count + DISPERSION_POINTS)
    return share, dispersion
