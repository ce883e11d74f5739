"""Slow drift of the poses, estimated together with all surfaces that echo."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass

import numpy as np

from ullage.arrays import Floats
from ullage.data import Frames, Recording, sensors_of
from ullage.errors import InputError, UllageWarning
from ullage.processing.baseband import as_baseband
from ullage.processing.drift_search import Search, Solution, moved, search_drift
from ullage.processing.likelihood.drift_prior import DriftPrior

TIMES = (1.0, 1 / 3, 1 / 9)  # correlation times that are tried, in lengths of the flight
LEAD_NATS = 50.0  # of evidence by which a drift must lead
APART = 3.0  # standard deviations from which two solutions differ
HARMLESS_M = 0.03  # a smaller drift is left alone (rms)
MOST_LEFT = 0.5  # share of the prior's variance from which the poses are not known to be good


@dataclass(frozen=True, slots=True, eq=False)
class DriftCorrection:
    """Frames with or without the slow error of their poses, and the estimate of that error."""

    frames: dict[str, Frames]
    corrected: bool  # whether the poses were moved
    reason: str  # for the user
    t_s: Floats  # (k) [s], of the frames' clock
    offset_m: Floats  # (k, 2) added to the horizontal positions; zero where the input is kept
    sigma_m: Floats  # (k, 2) standard deviation of the remaining error on each axis


def correct_drift_by_surfaces(
    frames: Recording, *, drift_m: float = 0.2, time_s: float | None = None
) -> DriftCorrection:
    """Correct the slow error of the horizontal positions of frames from the echoes of all surfaces.

    The offset of the track is a Gaussian process [Rasmussen2006]. It is estimated together with all surfaces that echo,
    so that the echoes fit their surfaces (`processing.likelihood.pose_graph`). Echoes are then found anew at the
    corrected poses, and the estimate is repeated as long as the evidence grows (`processing.drift_search`). No angle
    between walls is assumed.

    The offset counts from the first keyframe, because a shift of track and surfaces together changes no echo. A turn of
    both changes hardly any. The smoothness of the offset at corners of the flight limits it.

    The evidence decides. The input is kept, with a warning, where no drift leads by 50 nats over the poses as they are,
    where another drift comes as near as that to the best one, where the search does not settle, and where the carriers
    of the sensors differ. It is also kept where the best drift is under 3 cm (rms), without a warning if the surfaces
    show more than half of any drift.

    Args:
        frames: one sensor's, or several on one body, with poses.
        drift_m: sigma of the drift, of each axis [m].
        time_s: its correlation time [s]; None: the evidence chooses among the length of the flight, a third of it and a
            ninth of it.

    Returns:
        The frames, whether they were corrected and why, and the standard deviation of the error that is left.

    Raises:
        InputError: no poses, or a prior that is not above zero.
    """
    for name, value in (("drift_m", drift_m), ("time_s", 1.0 if time_s is None else time_s)):
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"{name} {value}", where="correct_drift_by_surfaces", allowed="> 0")
    parts = sensors_of(frames)
    by_name = {part.sensor: part for part in parts}
    if len({part.spec.wavelength_m for part in parts}) > 1:
        return _kept(by_name, "the carriers of the sensors differ", drift_m)
    times = np.concatenate([part.believed.t_ns for part in parts]) * 1e-9
    first, last = float(times.min()), float(times.max())
    if last <= first:
        return _kept(by_name, "one moment shows no drift", drift_m)
    scales = [(last - first) * share for share in TIMES] if time_s is None else [time_s]
    priors = [DriftPrior(first, last, drift_m, scale) for scale in scales]
    return _decided(by_name, search_drift([as_baseband(part) for part in parts], priors), drift_m)


def _kept(frames: dict[str, Frames], reason: str, drift_m: float) -> DriftCorrection:
    """Return the input unchanged, and warn with the reason."""
    warnings.warn(f"drift is not corrected: {reason}; the poses are kept", UllageWarning, stacklevel=4)
    path = next(iter(frames.values())).believed
    t_s = np.asarray(path.t_ns[[0, -1]] * 1e-9, np.float64)
    return DriftCorrection(frames, False, reason, t_s, np.zeros((2, 2)), np.full((2, 2), drift_m))


def _decided(frames: dict[str, Frames], search: Search | None, drift_m: float) -> DriftCorrection:
    """Return the frames moved by the best drift, or kept if it is negligible or does not lead."""
    if search is None:
        return _kept(frames, "no surface is seen well", drift_m)
    best = search.best
    sigma, size = np.sqrt(best.variance), _rms(best.offset)
    if size < HARMLESS_M and best.left < MOST_LEFT:
        return DriftCorrection(frames, False, _near(size), best.t_s, 0 * best.offset, sigma + size)
    if why := _why_kept(search):
        return _kept(frames, why, drift_m)
    done = f"moved by {1e3 * size:.0f} mm (rms), known to {1e3 * _rms(sigma):.0f} mm"
    out = {name: moved(part, best.drift, float(best.t_s[0])) for name, part in frames.items()}
    return DriftCorrection(out, True, done, best.t_s, best.offset, sigma)


def _near(size: float) -> str:
    return f"the poses are within {1e3 * size:.0f} mm of the surfaces"


def _why_kept(search: Search) -> str | None:
    """Say why the best drift is not to be believed; None where it is."""
    best = search.best
    size, lead = _rms(best.offset), best.nats - search.kept.nats
    if size < HARMLESS_M:
        return f"{_near(size)}, but these leave most of a drift open"
    if lead < LEAD_NATS:
        return f"an offset of {1e3 * size:.0f} mm leads by {lead:.0f} nats, {LEAD_NATS:g} wanted"
    if rival := next((one for one in search.tried if _rivals(one, best)), None):
        return f"two offsets that differ by {1e3 * _rms(_between(one=rival, best=best)):.0f} mm explain as much"
    return None if search.settled else f"an offset of {1e3 * size:.0f} mm has not settled"


def _between(*, one: Solution, best: Solution) -> Floats:
    """Difference (k, 2) of two offsets at the keyframes of the best one [m]."""
    return np.column_stack([np.interp(best.t_s, one.t_s, one.offset[:, axis]) for axis in (0, 1)]) - best.offset


def _rivals(one: Solution, best: Solution) -> bool:
    """Whether a solution explains as much as the best one and differs from it by more than their doubts."""
    if best.nats - one.nats >= LEAD_NATS:
        return False
    doubt = math.sqrt(float(best.variance.sum(1).mean() + one.variance.sum(1).mean()))
    return _rms(_between(one=one, best=best)) > APART * doubt


def _rms(offset: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum(offset**2, axis=1))))
