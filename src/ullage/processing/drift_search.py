"""Search for the drift at whose poses surfaces predict the echoes best."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ullage.arrays import Floats
from ullage.data import Frames, Trajectory
from ullage.processing.likelihood.drift_prior import Drift, DriftPrior
from ullage.processing.likelihood.pose_graph import Estimate, PoseGraph, Track, find_track
from ullage.processing.likelihood.spec import LikelihoodSpec

PASSES = 12  # at most; most flights settle after 3 to 6
BEAM = 2  # priors that later passes try
KNOWN_SIGMA_M = 0.001  # of the drift of poses that are taken as they are


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A drift, and the evidence for it from the echoes at the poses that it corrects."""

    drift: Drift
    track: Track  # keyframes and surfaces at the corrected poses
    estimate: Estimate  # the drift that the same echoes show when all are weighed together
    nats: float  # evidence
    offset: Floats  # (k, 2) since the first keyframe, to be added to the positions [m]
    variance: Floats  # (k, 2) of it [m^2]
    left: float  # share of the prior's variance

    @property
    def t_s(self) -> Floats:
        """Times (k) of the keyframes."""
        return self.track.t_s


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """What a search found."""

    kept: Solution  # the poses as they are
    tried: list[Solution]
    settled: bool  # whether the last pass found no better drift than the one before

    @property
    def best(self) -> Solution:
        """The solution with most evidence."""
        return max(self.tried, key=lambda one: one.nats)


def search_drift(parts: list[Frames], priors: list[DriftPrior]) -> Search | None:
    """Search for the drift with most evidence.

    Every pass estimates drift and surfaces together from the echoes of the pass before, under each prior. It then finds
    echoes and surfaces anew at each result. Solutions differ in which echoes belong to which surface. Their evidence
    compares, because each counts how much better its surfaces predict their echoes than chance does
    (`PoseGraph.evidence`).

    Args:
        parts: frames with poses, of one carrier.
        priors: of the drift, as likely as each other, the slowest first.

    Returns:
        What was found, or None where no surface is seen well.
    """
    times = np.concatenate([part.believed.t_ns for part in parts]) * 1e-9
    known = DriftPrior(float(times.min()), float(times.max()), KNOWN_SIGMA_M, priors[0].time_s)
    kept = _evaluated(parts, Drift(known, np.zeros((2, known.size))))
    if kept is None:
        return None
    now, tried, settled = kept, list[Solution](), False
    for _ in range(PASSES):
        drifts = [_refitted(now, prior) for prior in priors]
        found = [one for drift in drifts if drift is not None and (one := _evaluated(parts, drift)) is not None]
        if not found:
            break
        found.sort(key=lambda one: -one.nats)
        settled = bool(tried) and found[0].nats <= now.nats
        tried += found
        if settled:
            break
        now, priors = found[0], list(dict.fromkeys(one.drift.prior for one in found))[:BEAM]
    return Search(kept, tried, settled) if tried else None


def _refitted(start: Solution, prior: DriftPrior) -> Drift | None:
    """The drift by the echoes of a solution under a prior; None where no surface is seen well."""
    if start.drift.prior is prior:
        return start.estimate.drift
    estimate = PoseGraph(start.track, prior, LikelihoodSpec(), start.drift).solve()
    return None if estimate is None else estimate.drift


def _evaluated(parts: list[Frames], drift: Drift) -> Solution | None:
    """Find echoes and surfaces at the poses that a drift corrects; None where no surface is seen well."""
    spec, first = LikelihoodSpec(), min(float(part.believed.t_ns[0]) for part in parts) * 1e-9
    track = find_track([moved(part, drift, first) for part in parts], spec)
    if len(track.t_s) < 2:
        return None
    graph = PoseGraph(track, drift.prior, spec, drift)
    estimate = graph.solve()
    if estimate is None:
        return None
    variance, offset = graph.variance(estimate), drift.at(track.t_s)
    left = float(variance.sum() / graph.prior_variance().sum())
    return Solution(drift, track, estimate, graph.evidence(estimate), offset - offset[0], variance, left)


def moved(frames: Frames, drift: Drift, since_s: float) -> Frames:
    """Frames at positions moved by what a drift changed since a time."""
    path = frames.believed
    shift = drift.at(np.asarray(path.t_ns * 1e-9, np.float64)) - drift.at(np.array([since_s]))
    position = path.position + np.column_stack([shift, np.zeros(len(shift))])
    return replace(frames, poses=Trajectory(path.t_ns, position, path.quat_xyzw))
