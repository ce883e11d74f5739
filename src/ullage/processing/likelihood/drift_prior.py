"""Slow drift of a position as a Gaussian process in time whose precision is exactly sparse."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg import solve_continuous_lyapunov

from ullage.arrays import Floats

ORDER = 4  # numbers in a state: the drift and three derivatives, so its correlation is Matern 7/2
KNOTS = 5  # in one correlation time


class DriftPrior:
    """Prior of one axis of a drift: states at regular knots, which form a Markov chain [BarfootEtAl2014].

    The process is stationary, with a Matern correlation [Rasmussen2006] of the same variance and the same mean squared
    rate as sigma_m^2 exp(-(t / time_s)^2 / 2).

    Args:
        start_s: first time [s].
        end_s: last time [s].
        sigma_m: standard deviation [m].
        time_s: correlation time [s].
    """

    def __init__(self, start_s: float, end_s: float, sigma_m: float, time_s: float) -> None:
        self._start_s, self._time_s = start_s, time_s
        self._count = max(math.ceil((end_s - start_s) / time_s * KNOTS), 1) + 1
        self._rate = math.sqrt(2 * ORDER - 3)
        companion = np.diag(np.ones(ORDER - 1), 1)
        companion[-1] = [-math.comb(ORDER, k) * self._rate ** (ORDER - k) for k in range(ORDER)]
        drive = np.zeros((ORDER, ORDER))
        drive[-1, -1] = 1.0
        self._nilpotent = companion + self._rate * np.eye(ORDER)
        stationary = solve_continuous_lyapunov(companion, -drive)
        self._stationary = stationary * sigma_m**2 / stationary[0, 0]

    @property
    def time_s(self) -> float:
        """Correlation time [s]."""
        return self._time_s

    @property
    def size(self) -> int:
        """Numbers in the states of all knots."""
        return ORDER * self._count

    @property
    def knots_s(self) -> Floats:
        """Times of the knots [s]."""
        return np.asarray(self._start_s + np.arange(self._count) * (self._time_s / KNOTS), np.float64)

    def _steps(self, time: Floats) -> tuple[Floats, Floats]:
        """Transitions (t, ORDER, ORDER) over times in units of `time_s`, and the covariances of their noise."""
        series = sum(
            np.linalg.matrix_power(self._nilpotent, k) * (time[:, None, None] ** k / math.factorial(k))
            for k in range(ORDER)
        )
        transition = np.asarray(series * np.exp(-self._rate * time)[:, None, None])
        return transition, self._stationary - transition @ self._stationary @ transition.transpose(0, 2, 1)

    def precision(self) -> sparse.csc_matrix:
        """Inverse covariance (size, size) of the states."""
        transition, noise = self._steps(np.array([1 / KNOTS]))
        difference = sparse.eye(self.size) - sparse.kron(sparse.eye(self._count, k=-1), transition[0])
        blocks = [np.linalg.inv(self._stationary)] + [np.linalg.inv(noise[0])] * (self._count - 1)
        return sparse.csc_matrix(difference.T @ sparse.block_diag(blocks) @ difference)

    def basis(self, t_s: Floats, derivative: int = 0) -> sparse.csr_matrix:
        """Mean drift (t, size) at some times given the states, or its derivative [1/s]; constant beyond the ends."""
        place = np.clip((t_s - self._start_s) / self._time_s * KNOTS, 0, self._count - 1)
        knot = np.minimum(place.astype(int), self._count - 2)
        whole, noise = (part[0] for part in self._steps(np.array([1 / KNOTS])))
        before, spread = self._steps((place - knot) / KNOTS)
        after, _ = self._steps((1 - place + knot) / KNOTS)
        gain = spread @ after.transpose(0, 2, 1) @ np.linalg.inv(noise)
        rows = np.concatenate([before - gain @ whole, gain], axis=2)[:, derivative] / self._time_s**derivative
        column = ORDER * knot[:, None] + np.arange(2 * ORDER)
        row = np.repeat(np.arange(len(t_s)), 2 * ORDER)
        return sparse.csr_matrix((rows.ravel(), (row, column.ravel())), (len(t_s), self.size))


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """A drift of both horizontal axes, counted from its first moment."""

    prior: DriftPrior
    state: Floats  # (2, size) at the knots, of each axis

    def at(self, t_s: Floats, derivative: int = 0) -> Floats:
        """Drift (t, 2) [m] at some times, or its derivative."""
        return np.asarray(self.prior.basis(t_s, derivative) @ self.state.T)

    def under(self, prior: DriftPrior) -> Drift:
        """The same drift as states of another prior."""
        if prior is self.prior:
            return self
        knots, scale = prior.knots_s, prior.time_s ** np.arange(ORDER)
        states = np.stack([self.at(knots, k) * scale[k] for k in range(ORDER)], axis=1)
        return Drift(prior, np.asarray(states.transpose(2, 0, 1).reshape(2, -1)))
