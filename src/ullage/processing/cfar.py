"""Constant false alarm rate: thresholds from the bins around each bin, exact for complex Gaussian noise [Rohling1983].

The power of a noise bin is exponential. With training cells averaged to Z, a bin exceeds alpha Z with probability
E[exp(-alpha Z)], which for correlated cells is prod(1 / (1 + alpha lambda_i / N)) over the eigenvalues lambda_i of
the correlation of the N cells, and is solved for alpha. The same expectation, over drawn order statistics, serves
ordered-statistic CFAR.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ullage import checks
from ullage.arrays import Complexes, Floats
from ullage.data import Frames
from ullage.errors import InputError
from ullage.processing.baseband import has_phase, noise_correlation, to_baseband

_DRAWS = 40_000


def cell_average_factor(pfa: float, train: int, correlation: ArrayLike, guard: int = 0) -> float:
    """The factor alpha on the mean of 2 x `train` cells for a false alarm probability `pfa` a bin."""
    weights = np.linalg.eigvalsh(_covariance(train, correlation, guard)).clip(0) / (2 * train)

    def excess(alpha: float) -> float:
        return float(np.log1p(alpha * weights).sum() + np.log(pfa))

    return _solved(excess)


def ordered_factor(pfa: float, train: int, rank: int, correlation: ArrayLike, guard: int = 0) -> float:
    """The factor alpha on the `rank`-th smallest [0 = least] of 2 x `train` cells."""
    return _ordered_factor(pfa, train, rank, tuple(np.asarray(correlation, complex).tolist()), guard)


@lru_cache(maxsize=64)
def _ordered_factor(pfa: float, train: int, rank: int, correlation: tuple[complex, ...], guard: int) -> float:
    root = np.linalg.cholesky(_covariance(train, correlation, guard) + 1e-9 * np.eye(2 * train))
    rng = np.random.Generator(np.random.Philox(key=7))
    white = rng.standard_normal((_DRAWS, 2 * train, 2)) @ np.array([1, 1j]) / np.sqrt(2)
    ordered = np.partition(np.abs(white @ root.T) ** 2, rank, axis=1)[:, rank]
    least = float(ordered.min())  # taken out of the mean, which would underflow for a large alpha
    return _solved(lambda alpha: float(np.log(pfa) + alpha * least - np.log(np.exp(-alpha * (ordered - least)).mean())))


def _lags(correlation: ArrayLike) -> Complexes:
    lags = checks.array("correlation", correlation, np.complex128)
    if lags.ndim != 1 or not len(lags) or not np.isfinite(lags).all():
        raise InputError(f"correlation has shape {lags.shape}, or is not finite", where="cfar",
                         allowed="one finite number for each lag 0, 1, ...")  # fmt: skip
    return lags


def _covariance(train: int, correlation: ArrayLike, guard: int) -> Complexes:
    lags = np.asarray(correlation, np.complex128)
    cell = np.concatenate([np.arange(train), train + 2 * guard + 1 + np.arange(train)])
    gap = cell[:, None] - cell[None, :]
    known = np.where(np.abs(gap) < len(lags), lags[np.minimum(np.abs(gap), len(lags) - 1)], 0)
    return np.asarray(np.where(gap >= 0, known, known.conj()))


def _solved(rising: Callable[[float], float]) -> float:
    from scipy.optimize import brentq

    return float(brentq(rising, 1e-9, 1e9, xtol=1e-9, rtol=1e-9))


def cfar_threshold(
    frames: Frames,
    *,
    ordered: bool = False,
    pfa: float = 1e-4,
    guard: int = 3,
    train: int = 16,
    quantile: float = 0.75,
    correlation: ArrayLike | None = None,
) -> Floats:
    """Amplitude (n, b) that noise alone exceeds with probability `pfa` in each bin.

    Args:
        frames: complex baseband or RF.
        ordered: one of the ordered training cells counts (OS-CFAR, unmoved by a few other echoes among them); their
            mean otherwise (CA-CFAR).
        pfa: false alarm probability a bin.
        guard: cells left out on either side, at least the length of the pulse.
        train: cells used on either side.
        quantile: share of the training cells below the one that counts, if they are ordered. Echoes among the rest of
            them do not raise the threshold.
        correlation: of the noise between bins at lags 0, 1, ...; None: what the spec's receiver gives.

    Raises:
        InputError: a number out of bounds, more cells than bins, or amplitudes without phase.
    """
    if not 0 < checks.number("pfa", pfa, "cfar", allowed="0 .. 0.5") < 0.5:
        raise InputError(f"pfa is {pfa}", where="cfar", allowed="0 .. 0.5")
    checks.whole("guard", guard, "cfar", low=0, allowed="guard >= 0, train >= 2")
    checks.whole("train", train, "cfar", low=2, allowed="guard >= 0, train >= 2")
    if 2 * (guard + train) >= frames.samples.shape[1]:
        raise InputError(
            f"{guard} guard and {train} training cells a side do not fit {frames.samples.shape[1]} bins",
            where="cfar",
            allowed="guard >= 0, train >= 2",
        )
    if not 0 <= checks.number("quantile", quantile, "cfar", allowed=">= 0, < 1") < 1:
        raise InputError(f"quantile is {quantile}", where="cfar", allowed=">= 0, < 1")
    if not has_phase(frames):
        raise InputError("amplitudes without phase carry no exponential noise", where="cfar", allowed="threshold")
    power = np.abs(to_baseband(frames).astype(np.complex128)) ** 2
    lags = noise_correlation(frames.spec) if correlation is None else _lags(correlation)
    if not ordered:
        return np.sqrt(cell_average_factor(pfa, train, lags, guard) * _window_mean(power, guard, train))
    from ullage.kernels.cfar import windowed_order

    rank = min(int(quantile * 2 * train), 2 * train - 1)
    level = np.empty_like(power)
    windowed_order(power, guard, train, rank, level)
    return np.sqrt(ordered_factor(pfa, train, rank, lags, guard) * level)


def _window_mean(power: Floats, guard: int, train: int) -> Floats:
    """Mean of the training cells; a side that ends early takes as many cells more from the other side."""
    bins = power.shape[1]
    total = np.pad(np.cumsum(power, axis=1), ((0, 0), (1, 0)))
    bin_ = np.arange(bins)
    left = np.clip(bin_ - guard, 0, train)
    right = np.clip(bins - 1 - bin_ - guard, 0, train)
    left, right = np.maximum(left, 2 * train - right), np.maximum(right, 2 * train - left)
    low0, low1 = np.maximum(bin_ - guard - left, 0), np.maximum(bin_ - guard, 0)
    up0, up1 = np.minimum(bin_ + guard + 1, bins), np.minimum(bin_ + guard + 1 + right, bins)
    count = (low1 - low0) + (up1 - up0)
    return np.asarray((total[:, low1] - total[:, low0] + total[:, up1] - total[:, up0]) / count)
