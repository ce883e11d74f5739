"""Clock offset of a radar against a track: displacements predict how echoes change from frame to frame.

The model is a Gaussian process over the sensor's positions. Echoes that arrive from direction u with power w(u) give
two frames, displaced by d, the correlation sum_u w(u) exp(j 4 pi u.d / wavelength). Each frame is predicted from a few
earlier ones (Vecchia's approximation [Vecchia1988]). The log-likelihood of that prediction is compared between clock
offsets. Directions and their powers are fitted for every offset, so scene and antenna may be unknown.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Bools, Complexes, Floats, Longs, Singles
from ullage.data import Frames, Trajectory
from ullage.geometry import quat_matrix
from ullage.processing.baseband import to_baseband

BANDS = 4  # of range, each with its own directions
DIRECTIONS = 160
LAGS = (1, 2, 4, 8, 16)  # frames before each one that predict it
LAG_S = 0.02  # least spacing of these frames [s]
REACH_WAVELENGTHS = 2.0  # displacement over which one direction holds for a whole band
NUGGET = 0.005  # share of the power that no displacement explains: thermal noise and jitter
LEAST_VARIANCE = 0.003
OUTLIER = 0.02  # probability that a frame follows no track: a lost packet, a person who passes by
BLOCK = 12  # frames whose prediction errors depend on each other
MOVING = 0.03  # predicted share of change from which a frame counts as moved


@dataclass(frozen=True, slots=True, eq=False)
class Gains:
    """Log-likelihood over a model without track, by range band and frame."""

    total: Floats  # (bands, n)
    moving: Bools  # (n) whether the track moves enough to change the echoes
    power: Floats  # (bands, directions)


class MotionMatch:
    """The likelihood of clock offsets over one fixed set of frames.

    Args:
        frames: of one radar, with its own clock.
        track: world_from_sensor in the wanted clock.
    """

    def __init__(self, frames: Frames, track: Trajectory) -> None:
        self.t_s: Floats = np.asarray(frames.t_ns * 1e-9, np.float64)
        self.known_s, self.position = track.t_ns * 1e-9, track.position
        self.rotation = quat_matrix(track.quat_xyzw)
        self.per_m = 4 * np.pi / frames.spec.wavelength_m
        self.reach_m = REACH_WAVELENGTHS * frames.spec.wavelength_m
        self.directions = _sphere(DIRECTIONS)
        self._whiten(to_baseband(frames), whole_frames(frames))
        period = float(np.median(np.diff(self.t_s))) if len(self.t_s) > 1 else 1.0
        self.lags = np.array([0, *LAGS]) * max(1, round(LAG_S / max(period, 1e-6)))
        self.first, self.second = np.triu_indices(len(self.lags), 1)
        self._cache: dict[int, tuple[Longs, Bools, Complexes, Floats]] = {}

    def _whiten(self, values: NDArray[np.complex64], good: Bools) -> None:
        """Profiles without what stands still in range, every bin of one power; how many of them are independent."""
        values = np.where(good[:, None], values, 0)
        weight = change_weights(values, good)
        echoes = (values - weight @ values / weight.sum()).astype(np.complex64)
        power = np.sqrt(weight @ np.abs(echoes) ** 2 / weight.sum())
        live = power > 1e-6 * power.max(initial=0)
        echoes = echoes[:, live] / power[live]
        lags = min(40, echoes.shape[1] - 1)
        shared = np.array([abs(np.vdot(echoes[:, : echoes.shape[1] - k], echoes[:, k:])) for k in range(lags)])
        shared = shared / max(shared[0], 1e-30)
        self.bins = np.array_split(np.arange(echoes.shape[1]), BANDS)
        self.samples = np.array([len(part) for part in self.bins]) / (1 + 2 * (shared[1:] ** 2).sum())
        self.echoes, self.good = echoes, good

    def _prepared(self, targets: int) -> tuple[Longs, Bools, Complexes, Floats]:
        """Frames (n, m) that predict one another, which are missing, correlations, and the likelihood without track."""
        if targets not in self._cache:
            chosen = np.unique(np.linspace(0, len(self.t_s) - 1, min(targets, len(self.t_s))).astype(int))
            index = chosen[:, None] - self.lags
            missing = (index < 0) | ~self.good[np.maximum(index, 0)]
            index = np.maximum(index, 0)
            both = np.array([self._correlations(index, part) for part in self.bins])
            self._cache[targets] = index, missing, both, self._without_track(missing, both)
        return self._cache[targets]

    def _correlations(self, index: Longs, part: Longs) -> Complexes:
        echoes = self.echoes[:, part]
        echoes = echoes / np.maximum(np.linalg.norm(echoes, axis=1, keepdims=True), 1e-30)
        return np.array([echoes[row] @ echoes[row].conj().T for row in index], complex)

    def _without_track(self, missing: Bools, both: Complexes) -> Floats:
        """Log-likelihood (bands, n) of a radar that moves as it does on average: correlation by lag alone."""
        away = missing[:, self.first] | missing[:, self.second]
        lag = self.lags[self.second] - self.lags[self.first]
        out = []
        for band, found in enumerate(both):
            pairs = found[:, self.first, self.second]
            mean = np.zeros_like(pairs)
            for one in np.unique(lag):
                here = (lag == one)[None] & ~away
                mean[:, lag == one] = pairs[here].mean() if here.any() else 0
            mean[away] = 0
            out.append(self._likelihood((1 - NUGGET) * mean, found, band)[0])
        return np.array(out)

    def _likelihood(self, pairs: Complexes, found: Complexes, band: int) -> tuple[Floats, Floats]:
        """Log-likelihood (n) of each frame given those before, and the predicted share of change (n)."""
        size = len(self.lags)
        model = np.zeros((len(pairs), size, size), complex)
        model[:, self.first, self.second], model[:, self.second, self.first] = pairs, pairs.conj()
        model[:, np.arange(size), np.arange(size)] = 1
        cross = model[:, 0, 1:]
        gain = np.linalg.solve(np.swapaxes(model[:, 1:, 1:], 1, 2), cross[..., None])[..., 0]
        variance = np.maximum(1 - (gain * cross.conj()).sum(1).real, LEAST_VARIANCE)
        error = 1 - 2 * (gain.conj() * found[:, 0, 1:]).sum(1).real
        error = error + np.einsum("ni,nij,nj->n", gain, found[:, 1:, 1:], gain.conj()).real
        return -self.samples[band] * (np.log(variance) + np.maximum(error, 0) / variance), variance

    def gains(self, offset_s: float, *, targets: int = 800) -> Gains:
        """Log-likelihood that the radar's clock is `offset_s` behind the track's, over a radar of unknown motion."""
        index, missing, both, null = self._prepared(targets)
        when: Floats = np.asarray(self.t_s + offset_s, np.float64)
        inside = (when >= self.known_s[0]) & (when <= self.known_s[-1])
        away = missing | ~inside[index]
        away = away[:, self.first] | away[:, self.second]
        phase, reach = self._displacements(when, index)
        taper = np.where(away, 0, np.exp(-((reach / self.reach_m) ** 2)))
        use = ~away & (self.first == 0) & (reach < self.reach_m)
        if use.sum() < 50:
            return Gains(np.zeros_like(null), np.zeros(len(index), bool), np.zeros((len(both), DIRECTIONS)))
        cos, sin = np.cos(phase), np.sin(phase)
        fit = _DirectionFit(cos[use], sin[use], taper[use])
        share = np.array([fit.powers(found[:, self.first, self.second][use]) for found in both])
        small = share.astype(np.float32)
        models = cos @ small[:, :-1].T + small[:, -1] + 1j * (sin @ small[:, :-1].T)  # (n, pairs, bands)
        total, change = np.empty_like(null), np.zeros(len(index))
        for band, found in enumerate(both):
            likely, variance = self._likelihood(taper * models[:, :, band], found, band)
            total[band] = np.logaddexp(likely + np.log(1 - OUTLIER), null[band] + np.log(OUTLIER)) - null[band]
            change = change + variance / len(both)
        known = inside[index[:, 0]] & ~missing[:, 0]
        return Gains(np.where(known, total, 0), known & (change > MOVING), share[:, :-1])

    def _displacements(self, when: Floats, index: Longs) -> tuple[Singles, Floats]:
        """Phases (n, pairs, directions) between frames, and displacements (n, pairs) [m]."""
        place = np.stack([np.interp(when, self.known_s, self.position[:, k]) for k in range(3)], axis=1)
        near = np.clip(np.searchsorted(self.known_s, when[index[:, 0]]), 0, len(self.known_s) - 1)
        moved = place[index[:, self.first]] - place[index[:, self.second]]
        moved = moved @ self.rotation[near]
        phase = moved.astype(np.float32) @ (self.per_m * self.directions.T).astype(np.float32)
        return phase, np.linalg.norm(moved, axis=2)

    def scan(self, offsets: Floats, *, targets: int, progress: Callable[[float], None] | None = None) -> Floats:
        """Log-likelihood of each offset (k)."""
        out = np.zeros(len(offsets))
        for k, offset in enumerate(offsets):
            out[k] = self.gains(float(offset), targets=targets).total.sum()
            if progress:
                progress((k + 1) / len(offsets))
        return out

    def dispersion(self, offset_s: float, *, step_s: float = 0.02, targets: int = 800) -> float:
        """By how much prediction errors that depend on each other overstate the likelihood: score variance / curvature.

        The factor by which a composite likelihood is divided [Pauli2011].
        """
        offsets = offset_s + step_s * np.arange(-2, 3)
        gains = np.array([self.gains(float(dt), targets=targets).total for dt in offsets])
        blocks = np.add.reduceat(gains, np.arange(0, gains.shape[2], BLOCK), axis=2).reshape(len(offsets), -1)
        bend, slope, _ = np.polyfit(offsets - offset_s, blocks, 2)
        curvature = -2 * float(bend.sum())
        if curvature <= 0:
            return float("inf")
        centre = np.clip(slope.sum() / curvature, -2 * step_s, 2 * step_s)
        return float(((slope + 2 * bend * centre) ** 2).sum() / curvature)


class _DirectionFit:
    """Powers of directions, not negative, that reproduce correlations best in least squares."""

    def __init__(self, cos: Singles, sin: Singles, taper: Floats) -> None:
        count, weight = len(cos), taper.astype(np.float32)
        self.design = np.zeros((2 * count, cos.shape[1] + 1), np.float32)
        np.multiply(cos, weight[:, None], out=self.design[:count, :-1])
        np.multiply(sin, weight[:, None], out=self.design[count:, :-1])
        self.design[:count, -1] = weight
        normal = (self.design.T @ self.design).astype(float)
        self.root = np.linalg.cholesky(normal + 1e-3 * 2 * count * np.eye(len(normal)))

    def powers(self, correlation: Complexes) -> Floats:
        """Powers (directions + 1), the last that of echoes which do not change; their sum is below 1."""
        from scipy.linalg import solve_triangular
        from scipy.optimize import nnls

        right = self.design.T @ np.concatenate([correlation.real, correlation.imag]).astype(np.float32)
        share, _ = nnls(self.root.T, solve_triangular(self.root, right, lower=True))
        return np.asarray(share * min(1.0, (1 - NUGGET) / max(float(share.sum()), 1e-9)))


def whole_frames(frames: Frames) -> Bools:
    """Frames (n) without lost packets, which leave zeros."""
    zeros = (frames.samples == 0).mean(axis=1)
    return np.asarray(zeros <= np.median(zeros) + 0.02)


def change_weights(values: NDArray[np.complex64], good: Bools) -> Floats:
    """Weights (n) that are high where echoes change, so that a long halt counts little in a mean over positions."""
    change = np.linalg.norm(np.diff(values, axis=0), axis=1)
    pair = good[1:] & good[:-1]
    change = np.where(pair, change, 0.0)
    if not pair.any() or change.max() <= 0:
        return good.astype(float) + 1e-9
    low, high = np.quantile(change[pair], [0.02, 0.9])
    weight = np.clip(np.r_[change[:1], change] - low, 0, max(high - low, 1e-30)) + 1e-3 * (high + 1e-30)
    return np.asarray(weight * good + 1e-30)


def _sphere(count: int) -> Floats:
    """Unit vectors (count, 3), evenly spread."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)
