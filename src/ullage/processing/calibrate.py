"""Clock and range offsets found by focus alone."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ullage.data import Calibration, Frames, Trajectory
from ullage.errors import InputError, UllageWarning
from ullage.geometry import quat_matrix
from ullage.grids import Grid
from ullage.processing.backprojection import oversampled, oversampling
from ullage.processing.baseband import checked, to_baseband
from ullage.specs import RadarSpec

Floats = NDArray[np.float64]
Pair = tuple[float, float]  # clock [s], range [m]
Singles = NDArray[np.float32]
_MAX_CELLS, _MAX_REACH_M, _LEAST_TRACK_M = 16_000, 8.0, 0.15
_CONTRADICTS = 3.0  # sigmas between focus and a measured zero at which the zero is somebody else's
_LOOKS = 20  # parts of an aperture over which path errors are taken as independent


@overload
def calibrate(
    frames: Frames,
    *,
    t_span_s: float | None = ...,
    range_span_m: float = ...,
    bounds: Floats | None = ...,
    reflectors: ArrayLike | None = ...,
) -> Frames: ...
@overload
def calibrate(
    frames: Mapping[str, Frames],
    *,
    t_span_s: float | None = ...,
    range_span_m: float = ...,
    bounds: Floats | None = ...,
    reflectors: ArrayLike | None = ...,
) -> dict[str, Frames]: ...


def calibrate(
    frames: Frames | Mapping[str, Frames],
    *,
    t_span_s: float | None = None,
    range_span_m: float = 1.0,
    bounds: Floats | None = None,
    reflectors: ArrayLike | None = None,
) -> Frames | dict[str, Frames]:
    """Frames on the poses' clock and with true ranges: the two offsets that make the sharpest image.

    Where the echoes change and the track moves are matched first, over all of the track; the best few matches are
    then tried by back-projection, and that of least image entropy kept. The strongest echoes that stay coherent along
    the track then settle both offsets: those that make them most coherent, sum log(1 - coherence) least, which is the
    likelihood of steady points in noise. Nothing need be known of what stands where.

    What is known is used: where the radar's own range zero has been measured (`RadarSpec.range_zero_m`), it and the
    focus are weighed by their sigmas, unless they contradict each other; where reflectors have been surveyed, the
    offsets are those that make their places brightest.
    `frames.calibration` of the result says what was found and how sure that is.

    Args:
        frames: one sensor's frames, or several by name (each is calibrated for itself), with `track` or `poses`.
        t_span_s: search clock offsets of at most this, either way [s]; None: wherever the frames fit on the track,
            and 2 s either way.
        range_span_m: search range offsets of at most this, either way [m].
        bounds: (2, 3) where to look for echoes [m]; None: what the beam saw.
        reflectors: (r, 3) surveyed places of reflectors, world [m].

    Raises:
        InputError: no poses, no phase, a track that moves too little to tell, or places that are none.
    """
    if isinstance(frames, Mapping):
        named = frames.items()
        options: Any = {"t_span_s": t_span_s, "range_span_m": range_span_m, "bounds": bounds, "reflectors": reflectors}
        return {name: calibrate(part, **options) for name, part in named}
    track = frames.track if frames.track is not None else frames.believed
    spread = float(np.linalg.norm(np.ptp(track.position, axis=0)))
    if spread < _LEAST_TRACK_M:
        raise InputError(f"the track spans {spread:.2f} m", where="calibrate", allowed=f">= {_LEAST_TRACK_M} m")
    places = None if reflectors is None else _places(reflectors)
    search = _Search.over(checked(frames), track, bounds)
    start = search.entropy(0.0, 0.0)
    clock = _clock_candidates(frames, track, t_span_s)
    best = search.coarse(clock, range_span_m)
    best, sigma, points = search.fine(best, range_span_m)
    method = "coherence of the strongest points"
    if places is not None:
        best, sigma = search.surveyed(best, places)
        method = "brightness of the surveyed reflectors"
    elif frames.spec.range_zero_m is not None and frames.unit == "normalised":
        best, sigma, method = search.with_zero(best, sigma, points, frames.spec)
    end = search.entropy(*best)
    gain_db = 10 / np.log(10) * (start - end) if np.isfinite(start) else float("nan")
    found = Calibration(best[0], best[1], *sigma, float(gain_db), method)
    return _corrected(frames, track, found)


def _places(reflectors: ArrayLike) -> Floats:
    places = np.atleast_2d(np.asarray(reflectors, float))
    if places.ndim != 2 or places.shape[1] != 3 or not len(places) or not np.isfinite(places).all():
        raise InputError(f"reflectors of shape {places.shape}", where="calibrate", allowed="(r, 3) finite metres")
    return places


def _corrected(frames: Frames, track: Trajectory, found: Calibration) -> Frames:
    t_ns = frames.t_ns + round(found.t_offset_s * 1e9)
    inside = (t_ns >= track.t_ns[0]) & (t_ns <= track.t_ns[-1])
    if not inside.all():
        warnings.warn(f"{int((~inside).sum())} frames outside the track are left out", UllageWarning, stacklevel=3)
    kept = t_ns[inside]
    truth = None if frames.truth is None else replace(frames.truth[inside], t_ns=kept)
    return replace(
        frames,
        samples=frames.samples[inside],
        t_ns=kept,
        range_m=frames.range_m + found.range_offset_m,
        poses=track.at(kept),
        truth=truth,
        track=track,
        calibration=found,
    )


def _clock_candidates(frames: Frames, track: Trajectory, span_s: float | None, *, count: int = 4) -> list[float]:
    """Clock offsets at which the echoes change when the track moves, best first; 0 is always one of them."""
    low = (track.t_ns[0] - frames.t_ns[0]) * 1e-9
    high = (track.t_ns[-1] - frames.t_ns[-1]) * 1e-9
    low, high = min(low, high, -2.0), max(low, high, 2.0)
    if span_s is not None:
        low, high = max(low, -span_s), min(high, span_s)
    offsets = np.arange(low, high + 0.02, 0.04)
    lag = max(1, min(round(0.1 / max(float(np.median(np.diff(frames.t_ns))) * 1e-9, 1e-6)), len(frames) // 4))
    change = np.linalg.norm(np.diff(frames.samples.astype(np.complex64), axis=0), axis=1)
    change = np.convolve(change, np.ones(lag) / lag, "valid")
    score = np.array([_match(change, frames, track, dt, lag) for dt in offsets])
    out: list[float] = []
    for k in np.argsort(-score):
        if all(abs(offsets[k] - other) > 0.4 for other in out):
            out.append(float(offsets[k]))
        if len(out) == count:
            break
    return out if any(abs(dt) < 0.2 for dt in out) or not low <= 0 <= high else [*out, 0.0]


def _match(change: Floats, frames: Frames, track: Trajectory, dt_s: float, lag: int) -> float:
    """Correlation of how much the echoes change within `lag` frames with how far the track moved meanwhile."""
    t_ns = frames.t_ns + round(dt_s * 1e9)
    inside = (t_ns >= track.t_ns[0]) & (t_ns <= track.t_ns[-1])
    ok = inside[lag:] & inside[:-lag]
    if ok.mean() < 0.6:
        return -1.0
    time, known = (t_ns - track.t_ns[0]) * 1e-9, (track.t_ns - track.t_ns[0]) * 1e-9
    place = np.stack([np.interp(time, known, track.position[:, k]) for k in range(3)], axis=1)
    moved = np.linalg.norm(place[lag:] - place[:-lag], axis=1)[ok]
    moved = 1 - np.exp(
        -((8 * moved / (lag * frames.spec.wavelength_m)) ** 2)
    )  # echoes no longer alike after a wave / 8
    if moved.std() < 1e-6 or change[ok].std() <= 0:
        return 0.0
    return float(np.corrcoef(change[ok], moved)[0, 1])


@dataclass(frozen=True, slots=True)
class _Search:
    """Images of the same echoes under different offsets."""

    track: Trajectory
    t_ns: NDArray[np.int64]
    re: NDArray[np.float32]
    im: NDArray[np.float32]
    first_m: float
    per_m: float
    wave_m: float
    grid: Grid

    @classmethod
    def over(cls, frames: Frames, track: Trajectory, bounds: Floats | None) -> _Search:
        """Prepares profiles, thinned to a quarter wave of motion, without their mean."""
        speed = np.linalg.norm(track.rates[0], axis=1)
        period = float(np.median(np.diff(frames.t_ns))) * 1e-9 if len(frames) > 1 else 1.0
        thin = int(np.clip(frames.spec.wavelength_m / 4 / max(np.quantile(speed, 0.9) * period, 1e-6), 1, 8))
        values = to_baseband(frames)[::thin]
        values = values - values.mean(0)
        bin_m = float(np.diff(frames.range_m).mean())
        factor = oversampling(frames.spec, bin_m)
        fine = oversampled(values, factor)
        re, im = np.ascontiguousarray(fine.real), np.ascontiguousarray(fine.imag)
        grid = _region(track, frames, values, bounds)
        per_m = factor / bin_m
        return cls(track, frames.t_ns[::thin], re, im, float(frames.range_m[0]), per_m, frames.spec.wavelength_m, grid)

    def sums(self, dt_s: float, dr_m: float, grid: Grid, *, every: int = 1) -> Singles | None:
        """Back-projected sums (ny, 5, nx), or None where the track does not move enough within the frames' time."""
        from ullage.kernels.backprojection import backproject_rows

        t_ns = self.t_ns[::every] + round(dt_s * 1e9)
        inside = np.flatnonzero((t_ns >= self.track.t_ns[0]) & (t_ns <= self.track.t_ns[-1]))
        if len(inside) < max(8, 0.5 * len(t_ns)):
            return None
        path = self.track.at(t_ns[inside])
        if np.linalg.norm(np.ptp(path.position, axis=0)) < _LEAST_TRACK_M:
            return None
        weight = np.minimum(np.linalg.norm(np.gradient(path.position, axis=0), axis=1), self.wave_m / 2)
        used = weight > 0.03 * weight.max()
        rows = inside[used] * every
        axis = np.array([self.per_m, (self.first_m + dr_m) * self.per_m, 2 / self.wave_m], np.float32)
        out = np.zeros((grid.shape[0], 5, grid.shape[1]), np.float32)
        backproject_rows(
            grid.y_m, np.full(grid.shape[0], grid.origin_m[2]), float(grid.x_m[0]), grid.step_m, self.re[rows],
            self.im[rows], axis, np.zeros(3, np.float32), np.ascontiguousarray(path.position[used]),
            quat_matrix(path.quat_xyzw[used]), (weight[used] / weight[used].sum()).astype(np.float32), out,
        )  # fmt: skip
        return out

    def entropy(self, dt_s: float, dr_m: float) -> float:
        """Entropy of the image [nats]; infinite where there is none."""
        sums = self.sums(dt_s, dr_m, self.grid, every=2)
        return np.inf if sums is None else _entropy(sums[:, 0].astype(float) ** 2 + sums[:, 1].astype(float) ** 2)

    def coarse(self, clock: list[float], span_m: float) -> tuple[float, float]:
        """The best of a few clock offsets and a comb of range offsets, then a finer comb in both."""
        ranges = np.linspace(-span_m, span_m, 2 * max(1, int(np.ceil(span_m / 0.2))) + 1)
        tried = sorted((self.entropy(dt, dr), dt, float(dr)) for dt in clock for dr in ranges)
        _, dt, dr = min(
            (self.entropy(t + k, r), t + k, r) for _, t, r in tried[:2] for k in np.arange(-0.15, 0.16, 0.05)
        )
        near = ranges[abs(ranges - dr) < 0.45]
        _, dr = min((self.entropy(dt, float(r)), float(r)) for r in np.sort(np.r_[near, near + 0.1]))
        return float(dt), dr

    def points(self, dt_s: float, dr_m: float, *, most: int = 6) -> Floats:
        """Places (k, 3) of the strongest echoes that stay coherent along the track [m]."""
        sums = self.sums(dt_s, dr_m, self.grid)
        if sums is None:
            return np.zeros((0, 3))
        power = sums[:, 0] ** 2 + sums[:, 1] ** 2
        score = power * power / np.maximum(sums[:, 2] * sums[:, 3], 1e-30)
        y, x = np.meshgrid(self.grid.y_m, self.grid.x_m, indexing="ij")
        out: list[list[float]] = []
        best = float(score.max())
        while len(out) < most and score.max() > 0.03 * best > 0:
            row, col = np.unravel_index(int(score.argmax()), score.shape)
            out.append([x[row, col], y[row, col], self.grid.origin_m[2]])
            score[np.hypot(x - out[-1][0], y - out[-1][1]) < 0.6] = 0
        return np.array(out).reshape(-1, 3)

    def loss(self, dt_s: float, dr_m: float, points: Floats, drawn_dr_m: float) -> Floats:
        """log(1 - coherence) of each point (k), found again near where it was drawn with another range offset."""
        centre = self.track.position.mean(0)
        ray = (points - centre) / np.maximum(np.linalg.norm(points - centre, axis=1, keepdims=True), 1e-9)
        out = []
        for x, y, z in points + ray * (dr_m - drawn_dr_m):
            sums = self.sums(dt_s, dr_m, Grid((x - 0.21, y - 0.21, z), 0.03, (14, 14)))
            if sums is None:
                return np.zeros(len(points))
            bottom = np.maximum(sums[:, 2] * sums[:, 3], 1e-30)
            coherence = ((sums[:, 0] ** 2 + sums[:, 1] ** 2) / bottom).astype(float)
            soft = float((coherence**24).mean() ** (1 / 24))  # smooth stand-in for the greatest
            out.append(np.log(1 - min(soft, 0.9999)))
        return np.array(out)

    def fine(self, start: Pair, span_m: float) -> tuple[Pair, Pair, Floats]:
        """The offsets that make the points most coherent, to 1 ms and 1 mm, one sigma of each, and the points."""
        from scipy.optimize import minimize

        best = np.array(start)
        points = np.zeros((0, 3))
        for width in (0.1, 0.04):  # the points are drawn again once the offsets are better known
            points, drawn = self.points(best[0], best[1]), float(best[1])
            options: Any = {
                "initial_simplex": best + np.array([[0.3, -1], [-0.3, -1], [0, 1]]) * width,
                "xatol": 1e-3, "fatol": 1e-4, "maxiter": 60,
            }  # fmt: skip
            total: Any = lambda v, p=points, d=drawn: float(self.loss(v[0], v[1], p, d).sum())  # noqa: E731
            best = np.asarray(minimize(total, best, method="Nelder-Mead", options=options).x)
            best[1] = np.clip(best[1], -span_m, span_m)
        return (float(best[0]), float(best[1])), self.spread(best, points, drawn), points

    def with_zero(self, best: Pair, sigma: Pair, points: Floats, spec: RadarSpec) -> tuple[Pair, Pair, str]:
        """Weighs the range offset against the radar's own measured zero, then finds the clock that goes with it."""
        from scipy.optimize import minimize_scalar

        zero, zero_sigma = -float(spec.range_zero_m or 0.0), spec.range_zero_sigma_m
        apart = abs(best[1] - zero) / np.hypot(sigma[1], zero_sigma)
        if apart > _CONTRADICTS:
            warnings.warn(
                f"focus finds a range offset of {best[1]:+.3f} m, {apart:.1f} sigma from the radar's range_zero_m of "
                f"{-zero:.3f} m, which is left out",
                UllageWarning,
                stacklevel=3,
            )
            return best, sigma, "coherence of the strongest points"
        share = zero_sigma**-2 / (zero_sigma**-2 + sigma[1] ** -2)
        dr = share * zero + (1 - share) * best[1]
        span = (best[0] - 3 * sigma[0], best[0] + 3 * sigma[0])

        def total(dt: float) -> float:
            return float(self.loss(float(dt), dr, points, best[1]).sum())

        dt = float(minimize_scalar(total, bounds=span, method="bounded", options={"xatol": 1e-3}).x)
        both = (zero_sigma**-2 + sigma[1] ** -2) ** -0.5
        return (dt, dr), (sigma[0], float(both)), "coherence of the strongest points and the radar's range_zero_m"

    def surveyed(self, best: Pair, places: Floats) -> tuple[Pair, Pair]:
        """The offsets near these that make known places brightest, and one sigma of each, from how places disagree."""
        from scipy.optimize import minimize

        def darkness(v: Floats, known: Floats) -> float:
            sums = [
                self.sums(float(v[0]), float(v[1]), Grid((x - 5e-4, y - 5e-4, z), 1e-3, (1, 1))) for x, y, z in known
            ]
            return -sum(0.0 if one is None else float(np.hypot(one[0, 0, 0], one[0, 1, 0])) for one in sums)

        def brightest(known: Floats) -> Floats:
            comb = best[1] + np.arange(-0.4, 0.41, 0.02)
            start = np.array([best[0], comb[np.argmin([darkness(np.array([best[0], dr]), known) for dr in comb])]])
            simplex = start + np.array([[0.01, -0.02], [-0.01, -0.02], [0.0, 0.02]])
            options: Any = {"initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-9, "maxiter": 60}
            return np.asarray(minimize(darkness, start, args=(known,), method="Nelder-Mead", options=options).x)

        both = brightest(places)
        each = np.array([brightest(place[None]) for place in places]) - both
        sigma = np.maximum(np.sqrt((each**2).mean(0) / max(len(places) - 1, 1)), (0.005, 0.01))
        return (float(both[0]), float(both[1])), (float(sigma[0]), float(sigma[1]))

    def spread(self, best: Floats, points: Floats, drawn: float) -> Pair:
        """One sigma of both offsets: how far single points disagree on them, or from the curvature if that is more."""
        reach = np.array([0.02, 0.06])
        stencil = np.array([(a, b) for a in (-1.0, 0.0, 1.0) for b in (-1.0, 0.0, 1.0)])
        tried = best + stencil * reach
        losses = np.array([self.loss(float(dt), float(dr), points, drawn) for dt, dr in tried])
        sure = np.linalg.inv(_bend(stencil, _LOOKS * losses.sum(1)) + 1e-3 * np.eye(2))
        out = np.sqrt(np.maximum(np.diag(sure), 0))
        if len(points) > 1:
            each = np.array([_vertex(stencil, one) for one in losses.T])
            out = np.maximum(out, each.std(0, ddof=1) / np.sqrt(len(points)))
        sigma = out * reach
        return float(sigma[0]), float(sigma[1])


def _entropy(power: Floats) -> float:
    total = float(power.sum())
    if not total > 0:
        return 0.0
    share = power / total
    return float(-(share * np.log(share + 1e-30)).sum())


def _paraboloid(at: Floats, value: Floats) -> Floats:
    a, b = at.T
    return np.asarray(np.linalg.lstsq(np.stack([np.ones_like(a), a, b, a * a, a * b, b * b], 1), value, rcond=None)[0])


def _bend(at: Floats, value: Floats) -> Floats:
    """Second derivatives (2, 2), with negative curvature taken as none."""
    c = _paraboloid(at, value)
    size, way = np.linalg.eigh(np.array([[2 * c[3], c[4]], [c[4], 2 * c[5]]]))
    return np.asarray((way * np.maximum(size, 0)) @ way.T)


def _vertex(at: Floats, value: Floats) -> Floats:
    """Where a paraboloid through values has its lowest point, within two steps of the stencil."""
    c = _paraboloid(at, value)
    bend = np.array([[2 * c[3], c[4]], [c[4], 2 * c[5]]])
    if np.any(np.linalg.eigvalsh(bend) <= 1e-9):
        return np.array([2.0, 2.0])
    return np.asarray(np.clip(np.linalg.solve(bend, -c[1:3]), -2, 2))


def _region(track: Trajectory, frames: Frames, values: NDArray[np.complex64], bounds: Floats | None) -> Grid:
    """A plane at the sensors' height over what the beam saw; any plane focuses echoes of a straight level track."""
    height = float(track.position[:, 2].mean())
    if bounds is None:
        power = np.cumsum((np.abs(values) ** 2).mean(0) * np.maximum(frames.range_m, 0) ** 2)
        far = float(frames.range_m[np.searchsorted(power, 0.9 * power[-1])])
        reach = min(max(far, 2.0), _MAX_REACH_M)
        ahead = quat_matrix(track.quat_xyzw[:: max(1, len(track) // 50)])
        start = track.position[:: max(1, len(track) // 50)]
        half = min(frames.spec.antenna.azimuth_deg / 2, 50.0)
        fan = np.radians(np.linspace(-half, half, 7))
        rays = np.stack([np.cos(fan), np.sin(fan), np.zeros(7)])
        tips = start[:, None, :] + reach * np.einsum("nij,jk->nki", ahead, rays)
        near = start[:, None, :] + 0.6 * np.einsum("nij,jk->nki", ahead, rays)
        points = np.concatenate([tips.reshape(-1, 3), near.reshape(-1, 3)])
        bounds = np.stack([points.min(0), points.max(0)])
    area = float(np.prod(np.maximum(np.ptp(np.asarray(bounds)[:, :2], axis=0), 0.1)))
    return Grid.covering(bounds, max(0.03, np.sqrt(area / _MAX_CELLS)), z_m=height)
