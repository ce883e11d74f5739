"""Offsets of clock and range from scatterers that one path must explain together.

The model of a scatterer is a point: its echo has the phase of its distance, the envelope of the pulse at its delay, and
an amplitude that varies slowly along the track. Its log-likelihood is the power that this model explains over the power
per independent sample that it leaves, on a window that stays as it was drawn. Phase and envelope depend on the same
distance, but only the envelope on the range offset: this is what determines the offset. The places of the scatterers
are nuisances. They are eliminated by the Schur complement, as in bundle adjustment [Triggs2000].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Floats
from ullage.processing.point_focus import Echoes, Point, PointFocus

CLOCK, RANGE, RATE = range(3)  # the parameters: offsets [s] and [m], and the rate of the clock
PARAMETERS = 3
STEPS, ROUNDS = 12, 4
LEAST_STEP = 0.05  # standard deviations at which the search ends
FREEDOM = 4.0  # of Student's t, by which scatterers that contradict the others lose weight [Lange1989]
DISPERSION = 4.0  # score variance over curvature that is expected of scatterers
DISPERSION_POINTS = 4.0  # how many scatterers this expectation is worth


@dataclass(frozen=True, slots=True, eq=False)
class Bundle:
    """Scatterers on one path, and the parameters of that path."""

    theta: Floats  # (3) clock offset [s], range offset [m], clock rate
    covariance: Floats  # (3, 3)
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
        focus = self.focus
        bend, echo = None if only_places else focus.bend(theta), self.echoes(places, theta)
        gain, total = self.gains(echo.value), (self.weight * echo.value).sum(1)[:, None]
        back = self.weight * np.conj(total) / np.maximum(np.abs(total) ** 2, 1e-30)
        share = np.maximum((back * echo.value).real, 0.0)
        share = share / np.maximum(share.sum(1, keepdims=True), 1e-30)
        phase = (
            echo.ray if bend is None else np.concatenate([echo.ray, -np.einsum("kni,niq->knq", echo.ray, bend)], axis=2)
        )
        envelope = phase.copy()
        if bend is not None:
            envelope[..., 3 + RANGE] = -1.0
        mean = (share[..., None] * phase).sum(1)
        turned = np.swapaxes(phase * share[..., None], 1, 2)
        curve = focus.per_m_phase**2 * (turned @ phase - mean[:, :, None] * mean[:, None])
        curve = curve + focus.envelope_bend * (np.swapaxes(envelope * share[..., None], 1, 2) @ envelope)
        slope = -focus.per_m_phase * ((back * echo.value).imag[..., None] * phase).sum(1)
        slope = slope + ((back * echo.slope).real[..., None] * envelope).sum(1)
        scale = 2 * gain
        return _Linear(scale[:, None] * slope, scale[:, None, None] * curve), gain

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
        theta: (3) parameters to start from.
        mean: (3) of their normal prior.
        precision: (3) of their normal prior; 0: unknown.
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
