"""Clock and range offsets between a radar and a track, with its mount, from one likelihood over all frames."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import overload

import numpy as np
from numpy.typing import ArrayLike

from ullage.arrays import Floats
from ullage.data import Calibration, Frames, Trajectory, one_sensor
from ullage.errors import CalibrationError, InputError, UllageWarning
from ullage.geometry import quat_matrix
from ullage.processing.baseband import checked
from ullage.processing.bundle import Bundle, adjusted, held
from ullage.processing.floor import floor_echo
from ullage.processing.motion_match import Gains, MotionMatch
from ullage.processing.own_echo import without_own_echo
from ullage.processing.point_focus import (
    ARM,
    BORESIGHT,
    CLOCK,
    PARAMETERS,
    RANGE,
    RATE,
    SCALE,
    Point,
    PointFocus,
    Start,
)
from ullage.processing.track_check import DECISIVE, LEAST_PROBABILITY, track_axes, track_scale
from ullage.specs import MountSpec

Progress = Callable[[float], None]
Guess = Sequence[float] | Calibration

LEAST_TRACK_M = 0.15
COARSE_S, FINE_S, MODE_S = 0.1, 0.02, 0.15  # steps of the clock search, and half the width of a mode
ROUGH_FRAMES, LIKELY = 100, 40  # frames of the first search of the clock, and how many offsets get four times as many
LEAST_OVERLAP = 0.2  # of the shorter of track and recording
DISPERSION = 20.0  # of the motion likelihood, until it has been estimated
POINT_DISPERSION = 5.0  # of the points' likelihood: side lobes and noise of neighbouring positions depend on each other
LEVER_ARM_SIGMA_M, ANGLE_SIGMA_DEG = 0.05, 90.0  # of an antenna whose mount was not set
LEAST_LEVER_SIGMA_M, LEAST_ANGLE_DEG = 1e-5, 0.01
RATE_SIGMA, SCALE_SIGMA = 5e-5, 1e-3  # of the radar's clock rate, and of the metre of motion capture
SURVEY_S = 0.15  # search for surveyed places around the clock offset from motion [s]
LEAST_PER_SAMPLE = 1.2  # the same per independent sample, on tracks so long that chance finds more
LOCAL_M = 0.5  # half the part of the track from which scatterers are fitted first
DRAWN_S, RANGE_STEP_M, REDRAWN_M = 0.06, 0.06, 0.2
TAIL, TAIL_M = 1e-5, 0.5  # share and width of the range prior's tail: cables get exchanged
MOST_SPEED_M_S = 50.0
CONTRADICTION = 3.0  # standard deviations: of the floor's echo from the range offset, of the antenna from its mount
LEAST_GAIN = 200.0  # of the three most coherent points: 227 to 545 on real recordings, 175 with the track of another


@overload
def calibrate(
    frames: Frames,
    *,
    guess: Guess | None = ...,
    t_span_s: float | None = ...,
    range_span_m: float = ...,
    reflectors: ArrayLike | None = ...,
    lever_arm_sigma_m: float | None = ...,
    floor_z_m: float | None = ...,
    progress: Progress | None = ...,
) -> Frames: ...
@overload
def calibrate(
    frames: Mapping[str, Frames],
    *,
    guess: Guess | None = ...,
    t_span_s: float | None = ...,
    range_span_m: float = ...,
    reflectors: ArrayLike | None = ...,
    lever_arm_sigma_m: float | None = ...,
    floor_z_m: float | None = ...,
    progress: Progress | None = ...,
) -> dict[str, Frames]: ...


def calibrate(
    frames: Frames | Mapping[str, Frames],
    *,
    guess: Guess | None = None,
    t_span_s: float | None = None,
    range_span_m: float = 1.0,
    reflectors: ArrayLike | None = None,
    lever_arm_sigma_m: float | None = None,
    floor_z_m: float | None = None,
    progress: Progress | None = None,
) -> Frames | dict[str, Frames]:
    """Put frames on the track's clock and correct their range axis; refuse where the recording does not decide.

    The clock is found first: with the right one, the track predicts how echoes change from frame to frame. The
    likelihood of that prediction is evaluated at every offset for which track and recording overlap, over the same
    frames (`MotionMatch`). Then the strongest scatterers settle clock and range together (`PointFocus`). The radar's
    own range zero (`RadarSpec.range_zero_m`), its mount and `guess` are priors. Scene, antenna and mounting may
    be unknown.

    `frames.calibration` of the result holds offsets, standard deviations, probability and the other candidates, and
    `estimates` of nine quantities with their covariance. Clock and range offsets alone are applied.

    Args:
        frames: one radar's frames, or several by name (each is calibrated for itself), with `track` or `poses`.
        guess: prior: (clock offset, sigma) [s], or these and (range offset, sigma) [m], or a Calibration.
        t_span_s: search clock offsets of at most this, of either sign [s]; None: all at which track and frames overlap.
        range_span_m: search range offsets of at most this, positive or negative [m].
        reflectors: (r, 3) surveyed places of reflectors, world [m]; these alone then settle clock and range.
        lever_arm_sigma_m: how far the antenna may be from where the mount puts it, one sigma of each axis [m]; None:
            as the mount says, and 0.05 m where it sets no place.
        floor_z_m: height of a level floor [m]. Where its echo contradicts the range offset, the floor becomes the range
            zero. Not used with `reflectors`.
        progress: called with the share of the work done.

    Raises:
        CalibrationError: no clock offset has a probability of 95 %, the echoes do not follow the track, or they fit one
            of another scale.
        InputError: no poses, no phase, a track that does not move or does not overlap, or unusable places or guesses.
    """
    if isinstance(frames, Mapping):
        return {
            name: calibrate(
                part,
                guess=guess,
                t_span_s=t_span_s,
                range_span_m=range_span_m,
                reflectors=reflectors,
                lever_arm_sigma_m=lever_arm_sigma_m,
                floor_z_m=floor_z_m,
                progress=progress,
            )
            for name, part in frames.items()
        }
    frames = one_sensor(frames, "calibrate")
    track = frames.track if frames.track is not None else frames.believed
    _check_track(track, frames.sensor)
    mount = frames.spec.mount
    if lever_arm_sigma_m is None:
        placed = (mount.position_m, mount.position_sigma_m) != (MountSpec().position_m, MountSpec().position_sigma_m)
        lever_arm_sigma_m = mount.position_sigma_m if placed else LEVER_ARM_SIGMA_M
    if not 0 <= lever_arm_sigma_m < np.inf:
        raise InputError(f"lever_arm_sigma_m is {lever_arm_sigma_m}", where="calibrate", allowed="metres, 0 or more")
    angle_deg = ANGLE_SIGMA_DEG if mount == MountSpec() else max(mount.angle_sigma_deg, LEAST_ANGLE_DEG)
    prior = replace(
        _Prior.of(guess, frames, range_span_m), lever_sigma_m=lever_arm_sigma_m, angle_sigma_rad=np.radians(angle_deg)
    )
    places, zero = None if reflectors is None else _places(reflectors), prior
    if places is not None and (guess is None or (not isinstance(guess, Calibration) and len(guess) < 4)):
        prior = replace(prior, range_m=0.0, range_sigma_m=np.inf)  # the survey takes the place of the radar's own zero
    match = MotionMatch(checked(frames), track)
    clock = _ClockSearch.over(match, _clock_range(frames, track, t_span_s), prior, progress)
    found = _settle(frames, track, clock, prior, places)
    if places is None and floor_z_m is not None:
        floor = _floor_zero(prior, found, _corrected(frames, track, found), floor_z_m)
        if floor != prior:
            zero = floor
            found = _settle(frames, track, clock, floor, None)
    found = _sized(frames, track, found, zero)
    if progress:
        progress(1.0)
    out = _corrected(frames, track, found)
    if len(out) < len(frames):
        outside = len(frames) - len(out)
        warnings.warn(f"{outside} frames outside the track are left out", UllageWarning, stacklevel=2)
    return out


def _floor_zero(prior: _Prior, found: Calibration, frames: Frames, floor_z_m: float) -> _Prior:
    """Return the prior with the floor as range zero where the floor's echo contradicts the range offset found."""
    floor = floor_echo(without_own_echo(frames)[0], floor_z_m)
    if floor is None or abs(floor.long_m) < CONTRADICTION * float(np.hypot(floor.sigma_m, found.range_sigma_m)):
        return prior
    range_m = found.range_offset_m - floor.long_m
    return replace(prior, range_m=range_m, range_sigma_m=floor.sigma_m, zero="the floor's echo")


def _check_track(track: Trajectory, where: str) -> None:
    """Refuse a track that does not move or that cannot be in metres."""
    spread = float(np.linalg.norm(np.ptp(track.position, axis=0)))
    if spread < LEAST_TRACK_M:
        raise InputError(f"the track spans {spread:.2f} m", where=where, allowed=f">= {LEAST_TRACK_M} m")
    speed = np.linalg.norm(track.rates[0], axis=1)
    fast = float(np.quantile(speed, 0.9))
    if fast > MOST_SPEED_M_S:
        raise InputError(
            f"the track moves at {fast:.0f} m/s; its positions may be in millimetres",
            where=where,
            allowed=f"metres, at most {MOST_SPEED_M_S:.0f} m/s",
        )
    up = 1 - 2 * (track.quat_xyzw[:, :2] ** 2).sum(1)  # world z of the body's z axis
    if float(np.median(np.abs(up))) < 0.5:
        warnings.warn(
            f"{where}: the body's z axis lies level for most of the track; the track's axes may be swapped",
            UllageWarning,
            stacklevel=3,
        )


def _places(reflectors: ArrayLike) -> Floats:
    places = np.atleast_2d(np.asarray(reflectors, float))
    if places.ndim != 2 or places.shape[1] != 3 or not len(places) or not np.isfinite(places).all():
        raise InputError(f"reflectors of shape {places.shape}", where="calibrate", allowed="(r, 3) finite metres")
    return places


@dataclass(frozen=True, slots=True)
class _Prior:
    """Prior of the offsets."""

    t_s: float | None
    t_sigma_s: float
    range_m: float
    range_sigma_m: float  # infinite: unknown
    span_m: float
    lever_sigma_m: float = 0.0  # of the antenna's place; along the line of sight it moves echoes as range does
    angle_sigma_rad: float = np.pi / 2  # of the boresight
    zero: str = ""  # what the range is known from

    @classmethod
    def of(cls, guess: Guess | None, frames: Frames, span_m: float) -> _Prior:
        """The guess; where it is silent on range, the radar's own zero."""
        zero = frames.spec.range_zero_m if frames.unit == "normalised" else None
        known = (0.0, np.inf) if zero is None else (-zero, frames.spec.range_zero_sigma_m)
        name = "" if zero is None else "the radar's range_zero_m"
        if guess is None:
            return cls(None, np.inf, *known, span_m, zero=name)
        if isinstance(guess, Calibration):
            guess = (guess.t_offset_s, guess.t_sigma_s, guess.range_offset_m, guess.range_sigma_m)
        values = [float(value) for value in guess]
        if len(values) not in (2, 4) or not np.isfinite(values).all() or min(values[1::2]) <= 0:
            raise InputError(
                f"guess is {tuple(values)}",
                where="calibrate",
                allowed="(clock, sigma) [s], with (range, sigma) [m] after it or not; sigmas > 0",
            )
        if len(values) == 4:
            known, name = (values[2], values[3]), "the guess"
        return cls(values[0], values[1], *known, span_m, zero=name)

    def of_clock(self, offset_s: Floats) -> Floats:
        """Logarithm of the prior density of clock offsets."""
        if self.t_s is None:
            return np.zeros_like(offset_s)
        return np.asarray(-0.5 * ((offset_s - self.t_s) / self.t_sigma_s) ** 2)

    def with_range(self, range_m: float, sigma_m: float) -> tuple[float, float]:
        """Posterior mean and sigma of the range offset."""
        at = np.linspace(-1, 1, 20001) * self.span_m
        log_density = -0.5 * ((at - range_m) / sigma_m) ** 2 + self.of_range(at, self.range_sigma_m)
        density = np.exp(log_density - log_density.max())
        density /= density.sum()
        mean = float(density @ at)
        return mean, float(np.sqrt(density @ (at - mean) ** 2))

    @property
    def spread_m(self) -> float:
        """Standard deviation of the range offset at which echoes focus [m]."""
        return float(np.hypot(self.range_sigma_m, self.lever_sigma_m))

    def of_range(self, range_m: Floats, sigma_m: float) -> Floats:
        """Logarithm of the prior density of range offsets; it has wide tails, since cables get exchanged."""
        if not np.isfinite(sigma_m):
            return np.zeros_like(range_m)
        away = range_m - self.range_m
        core = (1 - TAIL) / sigma_m * np.exp(-0.5 * (away / sigma_m) ** 2)
        return np.asarray(np.log(core + TAIL / TAIL_M * np.exp(-0.5 * (away / TAIL_M) ** 2)))

    def of_bundle(self, mode_s: float, range_m: float) -> tuple[Floats, Floats]:
        """Mean and precision (9) of the parameters of a bundle that starts at these offsets."""
        mean, precision = np.zeros(PARAMETERS), np.zeros(PARAMETERS)
        weight = np.array([1 / MODE_S**2, 0.0 if self.t_s is None else 1 / self.t_sigma_s**2])
        mean[CLOCK] = weight @ [mode_s, self.t_s or 0.0] / weight.sum()
        precision[CLOCK] = weight.sum()
        near = np.isfinite(self.range_sigma_m) and abs(range_m - self.range_m) < 4 * self.spread_m
        mean[RANGE] = self.range_m if near else range_m
        precision[RANGE] = 1 / self.spread_m**2 if near else 1 / self.span_m**2
        precision[RATE], precision[SCALE] = 1 / RATE_SIGMA**2, 1 / SCALE_SIGMA**2
        precision[ARM] = 1 / max(self.lever_sigma_m, LEAST_LEVER_SIGMA_M) ** 2
        precision[BORESIGHT] = 1 / self.angle_sigma_rad**2
        return mean, precision

    def with_focus(self, range_m: float, sigma_m: float, precision: float) -> tuple[float, float]:
        """Posterior of the range offset from the one at which echoes focus, fitted under a prior of `precision`.

        The place of the antenna has its prior here, not its estimate: on a real rail that made the sigma too small.
        """
        own = max(1 / sigma_m**2 - precision, 1e-6)  # of the echoes alone
        prior_m = self.range_m if np.isfinite(self.range_sigma_m) else range_m
        near = np.isfinite(self.range_sigma_m) and abs(range_m - self.range_m) < 4 * self.spread_m
        alone_m = range_m + (range_m - prior_m) * precision / own if near else range_m
        return self.with_range(alone_m, float(np.hypot(1 / np.sqrt(own), self.lever_sigma_m)))

    @property
    def centre_m(self) -> float:
        """Range offset to start from [m]."""
        return float(np.clip(self.range_m, -self.span_m, self.span_m)) if np.isfinite(self.range_sigma_m) else 0.0

    def ranges(self) -> Floats:
        """Range offsets to search [m]: all of the span, since the prior may be wrong."""
        return self.span_m * np.linspace(-1, 1, 2 * max(1, int(np.ceil(self.span_m / RANGE_STEP_M))) + 1)


def _clock_range(frames: Frames, track: Trajectory, span_s: float | None) -> tuple[float, float]:
    """Least and greatest clock offset at which track and frames overlap enough [s]."""
    duration = float(frames.t_ns[-1] - frames.t_ns[0]) * 1e-9
    overlap = LEAST_OVERLAP * min(duration, track.duration_s)
    low = float(track.t_ns[0] - frames.t_ns[-1]) * 1e-9 + overlap
    high = float(track.t_ns[-1] - frames.t_ns[0]) * 1e-9 - overlap
    if span_s is not None:
        low, high = max(low, -span_s), min(high, span_s)
    if low > high:
        raise InputError(
            f"track and frames do not overlap within {span_s:.1f} s of clock offset",
            where=frames.sensor,
            allowed="a larger t_span_s, or a track of the same flight",
        )
    return low, high


@dataclass(frozen=True, slots=True, eq=False)
class _ClockSearch:
    """The posterior of the clock from motion alone."""

    match: MotionMatch
    offset_s: Floats  # (k) rising
    log_posterior: Floats  # (k)
    modes: list[float]  # most likely first [s]

    @classmethod
    def over(
        cls, match: MotionMatch, span: tuple[float, float], prior: _Prior, progress: Progress | None
    ) -> _ClockSearch:
        """Evaluate all of the span on few frames, the best of it on more, and the best candidates finely."""
        offset = np.arange(span[0], span[1] + COARSE_S, COARSE_S)
        share = None if progress is None else lambda done: progress(0.7 * done)
        value = _scan(match, offset, ROUGH_FRAMES, share)
        likely = np.sort(np.argsort(-(value / DISPERSION + prior.of_clock(offset)))[:LIKELY])
        offset, value = _refined(offset, value, offset[likely], _scan(match, offset[likely], 4 * ROUGH_FRAMES))
        order = _peaks(offset, value / DISPERSION + prior.of_clock(offset), apart_s=2.5 * COARSE_S)[:4]
        fine = np.unique(np.concatenate([one + FINE_S * np.arange(-7, 8) for one in order]).round(6))
        exact = _scan(match, fine, 8 * ROUGH_FRAMES)
        dispersion = match.dispersion(float(fine[np.argmax(exact)]))
        offset, value = _refined(offset, value, fine, exact)
        value = value / float(np.clip(dispersion, DISPERSION / 4, 4 * DISPERSION)) + prior.of_clock(offset)
        return cls(match, offset, value - value.max(), _peaks(offset, value, apart_s=2 * MODE_S))

    def mass(self, mode_s: float) -> float:
        """Posterior probability within the width of a mode."""
        density = np.exp(self.log_posterior)
        step = np.gradient(self.offset_s)
        near = np.abs(self.offset_s - mode_s) <= MODE_S
        return float((density * step)[near].sum() / (density * step).sum())


def _scan(match: MotionMatch, offset_s: Floats, frames: int, progress: Progress | None = None) -> Floats:
    """Log-likelihood (k) of clock offsets from so many frames, as if from all."""
    return match.scan(offset_s, targets=frames, progress=progress) * max(1.0, len(match.t_s) / frames)


def _refined(offset: Floats, value: Floats, finer: Floats, better: Floats) -> tuple[Floats, Floats]:
    """Values at rising offsets, with better ones near some of these; the others are shifted to agree with them."""
    shift = np.median(better - np.interp(finer, offset, value))
    kept = np.min(np.abs(offset[:, None] - finer), axis=1) > FINE_S
    offset, value = np.concatenate([offset[kept], finer]), np.concatenate([(value + shift)[kept], better])
    rising = np.argsort(offset)
    return offset[rising], value[rising]


def _peaks(offset: Floats, value: Floats, *, apart_s: float) -> list[float]:
    out: list[float] = []
    for k in np.argsort(-value):
        if all(abs(offset[k] - other) > apart_s for other in out):
            out.append(float(offset[k]))
        if len(out) == 6:
            break
    return out


@dataclass(frozen=True, slots=True, eq=False)
class _Focus:
    """The posterior of both offsets around one mode of the clock."""

    mean: Floats  # (2) clock [s], range [m]
    sigma: Floats  # (2)
    evidence: float  # log-likelihood of the points at its best, over its dispersion
    gain: float  # log-likelihood per independent sample over the frames as they came
    points: int
    strongest: float  # log-likelihood of the three most coherent points
    found: tuple[Bundle, PointFocus] | None = None  # None: no points


def _settle(
    frames: Frames, track: Trajectory, clock: _ClockSearch, prior: _Prior, places: Floats | None
) -> Calibration:
    """Judge the modes of the clock by focus, and take the best if it is probable enough."""
    masses = [clock.mass(mode) for mode in clock.modes]
    tried = [(mode, mass) for mode, mass in zip(clock.modes, masses, strict=True) if mass > 1e-4][:3]
    focused = [_focus(frames, track, mode, prior, places) for mode, _ in tried]
    top = max(one.evidence for one in focused)
    weight = np.array([mass * np.exp(one.evidence - top) for (_, mass), one in zip(tried, focused, strict=True)])
    rest = max(1 - sum(mass for _, mass in tried), 0.0)
    share = weight / (weight.sum() + rest * weight.max() / max(mass for _, mass in tried))
    order = np.argsort(-share)
    best, probability = focused[order[0]], float(share[order[0]])
    modes = tuple((float(focused[k].mean[0]), float(focused[k].mean[1]), float(share[k])) for k in order)
    if not best.points and places is not None:
        raise CalibrationError(
            "no surveyed reflector stays coherent along the track",
            where=frames.sensor,
            allowed="reflectors that the radar sees, in the track's frame of reference",
        )
    gains = clock.match.gains(float(best.mean[0]))
    _refuse(frames.sensor, gains, modes, probability, best.strongest)
    estimates, covariance = _estimates(best, prior)
    return Calibration(
        float(best.mean[0]),
        float(best.mean[1]),
        float(best.sigma[0]),
        float(best.sigma[1]),
        10 / np.log(10) * best.gain,
        _method(prior, places, best.points),
        probability,
        modes,
        _thinned(clock.offset_s, clock.log_posterior),
        message="" if places is not None else _unchecked(frames, track, best, prior),
        estimates=estimates,
        covariance=covariance,
    )


_Rows = tuple[tuple[float, ...], ...]


def _estimates(best: _Focus, prior: _Prior) -> tuple[_Rows, _Rows]:
    """The nine quantities, each with its sigma and that of its prior, and their covariance."""
    if best.found is None:
        return (), ()
    theta, covariance = best.found[0].theta, best.found[0].covariance
    known = 1 / np.sqrt(prior.of_bundle(float(theta[CLOCK]), prior.range_m)[1])
    known[RANGE] = min(prior.range_sigma_m, prior.span_m)
    rows = np.column_stack([theta, np.sqrt(np.diag(covariance)), known])
    return tuple(map(tuple, rows.tolist())), tuple(map(tuple, covariance.tolist()))


def _sized(frames: Frames, track: Trajectory, found: Calibration, prior: _Prior) -> Calibration:
    """The same with the scale of the track; raise where it is not that of the radar's ranges."""
    ranges = prior.ranges()
    size = track_scale(frames, track, found.t_offset_s, ranges, prior.of_range(ranges, prior.spread_m))
    if size.off > DECISIVE:
        raise CalibrationError(
            f"the echoes fit a track {size.scale:.2f} times as large (one sigma {size.sigma:.2f})",
            where=frames.sensor,
            allowed="positions in metres, and the radar's own range_zero_m or None",
        )
    said = "; ".join(filter(None, (found.message, size.words)))
    return replace(found, scale=size.scale, scale_sigma=size.sigma, message=said)


def _unchecked(frames: Frames, track: Trajectory, best: _Focus, prior: _Prior) -> str:
    """What the echoes say about the track's axes and the antenna, and whether they show the rate of the clock."""
    if best.found is None:
        return ""
    bundle, focus = best.found
    near = np.searchsorted(track.t_ns, (focus.t_s + bundle.theta[CLOCK]) * 1e9).clip(0, len(track) - 1)
    rotation = quat_matrix(track.quat_xyzw[near])
    axes = track_axes(focus.bent(bundle.theta), rotation, bundle.points, focus.weight, frames.spec)
    open_rate = bundle.covariance[RATE, RATE] > RATE_SIGMA**2 / 2  # echoes tell less than the prior
    rate = (
        f"the rate of the clock is unchecked, and taken as right within {1e6 * RATE_SIGMA:g} ppm" if open_rate else ""
    )
    return "; ".join(filter(None, (axes, rate, _elsewhere(bundle, prior))))


def _elsewhere(bundle: Bundle, prior: _Prior) -> str:
    """What contradicts the antenna's place on the body: clock and lever arm trade, and the prior holds the arm back.

    If the prior is true, its variance less that of the posterior is the variance of the posterior's mean [Kay1998].
    """
    if not prior.lever_sigma_m:
        return ""
    spread = np.sqrt(np.maximum(prior.lever_sigma_m**2 - np.diag(bundle.covariance)[ARM], LEAST_LEVER_SIGMA_M**2))
    sigmas = float(np.max(np.abs(bundle.theta[ARM]) / spread))
    if sigmas < CONTRADICTION:
        return ""
    return f"the antenna seems to be elsewhere on the body ({sigmas:.1f} sigma), which can mislead the clock"


def _method(prior: _Prior, places: Floats | None, points: int) -> str:
    if places is not None:
        return f"motion and {points} surveyed reflectors"
    return f"motion and coherence of {points} points" + (f" and {prior.zero}" if prior.zero else "")


def _refuse(
    sensor: str, gains: Gains, modes: tuple[tuple[float, float, float], ...], probability: float, strongest: float
) -> None:
    """Raise where no mode is probable enough, or where echoes do not follow the track at the best one."""
    moving = gains.total.sum(0)[gains.moving]
    least = -DISPERSION * DECISIVE  # below it a radar of unknown motion is decisively likelier than one on the track
    unlike = np.isfinite(strongest) and moving.sum() < least
    if len(moving) < 20 or strongest < LEAST_GAIN or unlike:
        raise CalibrationError(
            f"the echoes do not follow the track at any clock offset: at the best, {modes[0][0]:+.2f} s, it explains "
            f"{int((moving > 0).sum())} of {len(moving)} frames in motion with a log-likelihood of {moving.sum():.0f}, "
            f"and its three most coherent points have one of {strongest:.0f}",
            where=sensor,
            allowed=f"above {least:.0f}, and {LEAST_GAIN:.0f}; a track of the same flight, in motion while both record",
        )
    if probability < LEAST_PROBABILITY:
        others = ", ".join(f"{t:+.2f} s ({100 * p:.0f} %)" for t, _, p in modes[:3])
        raise CalibrationError(
            f"no clock offset is certain: {others}",
            where=sensor,
            allowed=f"a probability of {100 * LEAST_PROBABILITY:.0f} %; fly unevenly, with halts, or give guess=",
        )


def _thinned(offset_s: Floats, log_posterior: Floats) -> tuple[tuple[float, float], ...]:
    """The posterior as pairs of offset and natural logarithm, for figures; hopeless offsets are cut off at -50."""
    return tuple(
        (round(float(t), 3), round(float(max(p, -50.0)), 2)) for t, p in zip(offset_s, log_posterior, strict=True)
    )


def _focus(frames: Frames, track: Trajectory, mode_s: float, prior: _Prior, places: Floats | None) -> _Focus:
    """The posterior of clock and range around one mode of the clock."""
    focus = PointFocus(frames, track, mode_s)
    if places is not None:
        return _surveyed(focus, mode_s, prior, places)
    kept, clock_s, range_m = _searched(focus, mode_s, prior)
    points = focus.drawn(kept, clock_s, range_m)
    distinct = focus.distinct(points, clock_s)
    points, near = [points[k] for k in distinct], [_local(focus, points[k], kept[k]) for k in distinct]
    if not points:
        return _Focus(np.array([mode_s, range_m]), np.array([MODE_S, prior.span_m]), 0.0, 0.0, 0, 0.0)
    mean, precision = prior.of_bundle(mode_s, range_m)
    theta = _start(clock_s, range_m)
    found = max(  # the posterior has several optima
        (adjusted(focus, one, theta, mean, precision) for one in (points, near)),
        key=lambda one: _total(one.points) - 0.5 * float(precision @ (one.theta - mean) ** 2),
    )
    return _judged(focus, found, prior, precision)


def _searched(focus: PointFocus, mode_s: float, prior: _Prior) -> tuple[list[Start], float, float]:
    """Scatterers of different echoes, and the clock and range offsets at which they are most coherent, on a grid.

    Scatterers that were drawn at a wrong clock favour it. So they are drawn at several, and others than those of the
    clock from motion are kept if they are decisively more coherent.
    """
    range_m, ranges = prior.centre_m, prior.ranges()
    drawn = [(_drawn(focus, t, range_m), t) for t in mode_s + DRAWN_S * np.array([0, -2, -1, 1, 2])]
    value = np.array([_total(focus.drawn(*one, range_m)) for one in drawn])
    kept, clock_s = drawn[int(value.argmax()) if value.max() > value[0] + DECISIVE else 0]
    for _ in range(2):  # once more where they were drawn far from where they focus
        value = prior.of_range(ranges, prior.spread_m) + [_total(focus.drawn(kept, clock_s, float(r))) for r in ranges]
        best_m = float(ranges[np.argmax(value)])
        clocks = clock_s + FINE_S * np.arange(-4.0, 5.0)
        best_s = float(clocks[np.argmax([_total(focus.drawn(kept, float(t), best_m)) for t in clocks])])
        near = abs(best_m - range_m) < REDRAWN_M and abs(best_s - clock_s) < DRAWN_S / 2
        clock_s, range_m = best_s, best_m
        if near:
            break
        kept = _drawn(focus, clock_s, range_m)
    return kept, clock_s, range_m


def _drawn(focus: PointFocus, clock_s: float, range_m: float) -> list[Start]:
    """Scatterers of different echoes that focus under these offsets."""
    starts = focus.starts(clock_s, range_m)
    return [starts[k] for k in focus.distinct(focus.drawn(starts, clock_s, range_m), clock_s)]


def _local(focus: PointFocus, point: Point, start: Start) -> Point:
    """The scatterer as seen from near its start: an antenna elsewhere than the mount says blurs long parts first."""
    near = np.exp(-(((focus.along - start.along_m) / LOCAL_M) ** 2))
    return replace(point, amplitude=point.amplitude * near)


def _start(clock_s: float, range_m: float) -> Floats:
    """The nine quantities, with these offsets."""
    theta = np.zeros(PARAMETERS)
    theta[CLOCK], theta[RANGE] = clock_s, range_m
    return theta


def _total(points: Sequence[Point]) -> float:
    return sum(one.gain for one in points) / POINT_DISPERSION


def _judged(focus: PointFocus, found: Bundle, prior: _Prior, precision: Floats) -> _Focus:
    """Offsets with the range prior, and how coherent the scatterers are."""
    sigma = np.sqrt(np.diag(found.covariance))
    range_m, sigma_m = prior.with_focus(float(found.theta[RANGE]), float(sigma[RANGE]), float(precision[RANGE]))
    theta, wider = found.theta.copy(), np.ones(PARAMETERS)
    theta[RANGE], wider[RANGE] = range_m, sigma_m / sigma[RANGE]
    found = replace(found, theta=theta, covariance=found.covariance * np.outer(wider, wider))
    samples = sum((focus.weight * (one.amplitude > 0)).sum() for one in found.points) / (focus.wave_m / 2)
    total = sum(one.gain for one in found.points)
    raw = focus.redrawn(np.array([one.place for one in found.points]).reshape(-1, 3), np.zeros(PARAMETERS))
    gain = float((total - sum(one.gain for one in raw)) / max(samples, 1e-9))
    whole = float(focus.weight.sum()) / (focus.wave_m / 2)  # independent samples of the track
    strongest = sum(sorted(one.gain for one in found.points)[-3:]) / max(1.0, LEAST_PER_SAMPLE * whole / LEAST_GAIN)
    mean = np.array([found.theta[CLOCK], range_m])
    sigmas = np.array([sigma[CLOCK], sigma_m])
    return _Focus(mean, sigmas, total / POINT_DISPERSION, gain, len(found.points), strongest, (found, focus))


def _surveyed(focus: PointFocus, mode_s: float, prior: _Prior, places: Floats) -> _Focus:
    """Return the posterior from known places: try all offsets near the mode, then those near the best."""
    clocks, ranges = mode_s + SURVEY_S * np.linspace(-1, 1, 41), prior.ranges()
    for _ in range(3):
        each = np.array([focus.brightness(places, float(t), ranges) for t in clocks])  # (clocks, ranges, places)
        value = each.sum(2) / POINT_DISPERSION - 0.5 * ((ranges - prior.range_m) / prior.range_sigma_m) ** 2
        density = np.exp(value - value.max())
        density /= density.sum()
        by_clock, by_range = density.sum(1), density.sum(0)
        mean = np.array([by_clock @ clocks, by_range @ ranges])
        best = np.array(np.unravel_index(int(value.argmax()), value.shape))
        top = np.array([clocks[best[0]], ranges[best[1]]])
        sigma = np.sqrt([by_clock @ (clocks - mean[0]) ** 2, by_range @ (ranges - mean[1]) ** 2])
        half = np.maximum(3 * sigma, 2 * np.array([clocks[1] - clocks[0], ranges[1] - ranges[0]]))
        clocks, ranges = (top[k] + half[k] * np.linspace(-1, 1, 25) for k in range(2))
    seen = int((each[best[0], best[1]] > 0).sum())
    raw = float(focus.brightness(places, 0.0, np.zeros(1)).sum())
    gain = np.log(max(float(each[best[0], best[1]].sum()), 1e-9) / max(raw, 1e-9))
    _, precision = prior.of_bundle(mode_s, float(mean[1]))
    found = held(focus, places, _start(*mean.tolist()), precision)  # the mount may be wrong: clock and lever arm trade
    wide = np.sqrt(np.diag(found.covariance))[[CLOCK, RANGE]]
    sigma = np.maximum(np.maximum(sigma, half / 25), wide)
    return _Focus(mean, sigma, float(value.max()), float(gain), seen, np.inf, (found, focus))


def _corrected(frames: Frames, track: Trajectory, found: Calibration) -> Frames:
    t_ns = frames.t_ns + round(found.t_offset_s * 1e9)
    inside = (t_ns >= track.t_ns[0]) & (t_ns <= track.t_ns[-1])
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
