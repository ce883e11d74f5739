"""Slow drift of the poses, found from the surfaces of the likelihood mapper."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ullage.arrays import Floats
from ullage.data import Frames, Recording, Trajectory, sensors_of
from ullage.errors import InputError
from ullage.processing.baseband import as_baseband
from ullage.processing.drift import HARMLESS_M, DriftCorrection, kept
from ullage.processing.likelihood.drift_prior import DriftPrior
from ullage.processing.likelihood.pose_graph import Estimate, PoseGraph, find_track
from ullage.processing.likelihood.spec import LikelihoodSpec

PASSES, CONVERGED_M = 5, 0.005  # echoes are found anew at corrected poses, until these change by less (rms)
MOST_LEFT = 0.5  # share of the prior variance: one flat wall determines one axis of two at best
MOST_OUTLIERS = 0.25  # share of echoes beyond the gate of their surface
MOST_CHANGE = 0.5  # by the last two passes, in standard deviations


def correct_drift_by_surfaces(frames: Recording, *, drift_m: float = 0.2, time_s: float = 5.0) -> DriftCorrection:
    """Correct the slow error of the horizontal positions of frames from the echoes of surfaces.

    The offset of the track is a Gaussian process [Rasmussen2006]. It is estimated together with all surfaces that echo,
    so that the echoes fit their surfaces (`processing.likelihood.pose_graph`). Echoes are then found anew at the
    corrected poses, and the estimate is repeated. No angle between walls is assumed.

    The offset counts from the first keyframe, because a shift of track and surfaces together changes no echo. A turn of
    both changes hardly any. The smoothness of the offset at corners of the flight limits it.

    The input is kept, with a warning, where the surfaces do not determine the offset:

    - At least half of the variance of the prior is left.
    - Over a quarter of the echoes do not fit their surfaces.
    - The offset is smaller than its standard deviation.
    - The last two passes changed it by over half of that.
    - The frames have no phase.

    The input is also kept where the offset is under 3 cm (rms).

    Args:
        frames: one sensor's, or several on one body, with poses.
        drift_m: sigma of the drift, of each axis [m].
        time_s: its correlation time [s].

    Returns:
        The frames, whether they were corrected and why, and the standard deviation of the error that is left.

    Raises:
        InputError: no poses, or a prior that is not above zero.
    """
    if not (math.isfinite(drift_m) and drift_m > 0 and math.isfinite(time_s) and time_s > 0):
        raise InputError(f"drift_m {drift_m}, time_s {time_s}", where="correct_drift_by_surfaces", allowed="> 0")
    parts = sensors_of(frames)
    by_name = {part.sensor: part for part in parts}
    times = np.concatenate([part.believed.t_ns for part in parts]) * 1e-9
    parts = [as_baseband(part) for part in parts]
    if not all(np.iscomplexobj(part.samples) for part in parts):
        return kept(by_name, "the frames have no phase", drift_m)
    if len({part.spec.wavelength_m for part in parts}) > 1:
        return kept(by_name, "the carriers of the sensors differ", drift_m)
    prior = DriftPrior(float(times.min()), float(times.max()), drift_m, time_s)
    found = _estimated(parts, prior)
    if found is None:
        return kept(by_name, "no surface is seen well", drift_m)
    return _decided(by_name, prior, found, drift_m)


class _Found(NamedTuple):
    """The estimate of the last pass."""

    t_s: Floats  # (k) of the keyframes
    graph: PoseGraph
    estimate: Estimate
    change_m: float  # of the offset by the last two passes, the larger one (rms)


def _estimated(parts: list[Frames], prior: DriftPrior) -> _Found | None:
    spec, start = LikelihoodSpec(), np.zeros((2, prior.size))
    found, before = None, math.inf
    for _ in range(PASSES):
        track = find_track([_moved(part, prior, start) for part in parts], spec)
        if len(track.t_s) < 2:
            return found
        graph = PoseGraph(track, prior, spec, start)
        estimate = graph.solve()
        if estimate is None:
            return found
        change = prior.basis(track.t_s) @ (estimate.drift - start).T
        now = _rms(change - change[0])
        found = _Found(track.t_s, graph, estimate, now if now < CONVERGED_M else max(now, before))
        if now < CONVERGED_M:
            break
        start, before = estimate.drift, now
    return found


def _rms(offset: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum(offset**2, axis=1))))


def _decided(frames: dict[str, Frames], prior: DriftPrior, found: _Found, drift_m: float) -> DriftCorrection:
    """Return the frames moved by an offset, or kept if the offset is unsure or negligible."""
    t_s, drift = found.t_s, found.estimate.drift
    offset = np.asarray(prior.basis(t_s) @ drift.T)
    offset = offset - offset[0]
    variance, before = found.graph.variance(found.estimate), found.graph.prior_variance()
    sigma = np.sqrt(variance)
    size, doubt, left = _rms(offset), _rms(sigma), float(variance.sum() / before.sum())
    outliers = float(np.mean(found.estimate.distance > LikelihoodSpec().gate))
    if left >= MOST_LEFT:
        return kept(frames, f"surfaces leave {100 * left:.0f} % of the variance of the offset", drift_m)
    if outliers > MOST_OUTLIERS:
        return kept(frames, f"{100 * outliers:.0f} % of the echoes do not fit their surfaces", drift_m)
    if size < HARMLESS_M:
        reason = f"the poses are within {1e3 * size:.0f} mm of the surfaces"
        return DriftCorrection(frames, False, reason, t_s, 0 * offset, sigma + size)
    if size < doubt:
        return kept(frames, f"an offset of {1e3 * size:.0f} mm is known to {1e3 * doubt:.0f} mm only", drift_m)
    if found.change_m > MOST_CHANGE * doubt:
        return kept(frames, f"the estimate still changes by {1e3 * found.change_m:.0f} mm", drift_m)
    done = f"moved by {1e3 * size:.0f} mm (rms), known to {1e3 * doubt:.0f} mm"
    moved = {name: _moved(part, prior, drift, since_s=float(t_s[0])) for name, part in frames.items()}
    return DriftCorrection(moved, True, done, t_s, offset, sigma)


def _moved(frames: Frames, prior: DriftPrior, drift: Floats, *, since_s: float | None = None) -> Frames:
    """Frames at positions moved by a drift (2, size), or by what it changed since a time."""
    path = frames.believed
    shift = prior.basis(np.asarray(path.t_ns * 1e-9, np.float64)) @ drift.T
    if since_s is not None:
        shift = shift - prior.basis(np.array([since_s])) @ drift.T
    position = path.position + np.column_stack([shift, np.zeros(len(shift))])
    return replace(frames, poses=Trajectory(path.t_ns, position, path.quat_xyzw))
