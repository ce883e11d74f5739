"""Search for the drift at whose poses the likelihood mapper explains most."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ullage.arrays import Floats
from ullage.data import Frames, Trajectory
from ullage.processing.drift_walls import Offset
from ullage.processing.likelihood.drift_prior import Drift, DriftPrior
from ullage.processing.likelihood.pose_graph import PoseGraph, Track, find_track
from ullage.processing.likelihood.spec import LikelihoodSpec

PASSES = 12  # at most; most flights settle after 3 to 6
BEAM = 2  # priors that later passes try
WALLS_SIGMA_M = 0.005  # to which a drift follows the offset that flat walls show


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A drift, and what the mapper explains at the poses that it corrects."""

    drift: Drift
    track: Track  # keyframes and surfaces at the corrected poses
    nats: float  # log-likelihood ratio of the samples, with the prior of the drift and the volume that it may take
    t_s: Floats  # (k) of the keyframes
    offset: Floats  # (k, 2) since the first keyframe, to be added to the positions [m]
    variance: Floats  # (k, 2) of it [m^2]
    left: float  # share of the prior's variance


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """What a search found."""

    kept: Solution  # the poses as they are
    tried: list[Solution]
    settled: bool  # whether the last pass explained no more than the one before

    @property
    def best(self) -> Solution:
        """The solution that explains most."""
        return max(self.tried, key=lambda one: one.nats)


def search_drift(parts: list[Frames], priors: list[DriftPrior], walls: Offset | None = None) -> Search:
    """Search for the drift that explains the samples best.

    Every pass estimates drift and surfaces together from the echoes of the pass before, under each prior. It then finds
    echoes and surfaces anew at each result. Candidates differ in which echoes belong to which surface, so their own
    costs do not compare. The samples are the same for all: what sure surfaces explain of them decides. A drift also
    pays for its prior, and gains by the volume that the echoes leave it, by Laplace's method [MacKay2003].

    Args:
        parts: frames with poses, of one carrier.
        priors: of the drift, as likely as each other, the slowest first.
        walls: an offset that flat walls show, one of the candidates of the first pass.
    """
    spec = LikelihoodSpec()
    track = find_track(parts, spec)
    nothing = np.zeros((len(track.t_s), 2))
    none = Drift(priors[0], np.zeros((2, priors[0].size)))
    kept = now = Solution(none, track, track.nats, track.t_s, nothing, nothing, 1.0)
    tried = list[Solution]()
    for _ in range(PASSES if len(track.t_s) > 1 else 0):
        found = [one for prior in priors if (one := _solved(parts, now, prior, spec)) is not None]
        if walls is not None and not tried and (one := _by_walls(parts, now.track, priors[-1], walls)) is not None:
            found.append(one)
        if not found:
            break
        found.sort(key=lambda one: -one.nats)
        settled = bool(tried) and found[0].nats <= now.nats
        tried += found
        if settled:
            return Search(kept, tried, True)
        now, priors = found[0], list(dict.fromkeys(one.drift.prior for one in found))[:BEAM]
    return Search(kept, tried, False)


def _solved(parts: list[Frames], start: Solution, prior: DriftPrior, spec: LikelihoodSpec) -> Solution | None:
    """The drift by the echoes of a solution, and what it explains; None where no surface is seen well."""
    graph = PoseGraph(start.track, prior, spec, start.drift)
    estimate = graph.solve()
    if estimate is None:
        return None
    t_s, drift = start.track.t_s, estimate.drift
    offset, variance = drift.at(t_s), graph.variance(estimate)
    track = find_track([moved(part, drift, float(t_s[0])) for part in parts], spec)
    left = float(variance.sum() / graph.prior_variance().sum())
    return Solution(drift, track, track.nats + graph.occam(estimate), t_s, offset - offset[0], variance, left)


def _by_walls(parts: list[Frames], track: Track, prior: DriftPrior, walls: Offset) -> Solution | None:
    """The offset that flat walls show, and what the mapper explains with it."""
    spec, t_s = LikelihoodSpec(), track.t_s
    drift = prior.fitted(t_s, walls.at(t_s), WALLS_SIGMA_M)
    track = find_track([moved(part, drift, float(t_s[0])) for part in parts], spec)
    graph = PoseGraph(track, prior, spec, drift)
    estimate = graph.solve()
    if estimate is None:
        return None
    variance, offset = graph.variance(estimate), drift.at(track.t_s)
    left = float(variance.sum() / graph.prior_variance().sum())
    return Solution(drift, track, track.nats + graph.occam(estimate), track.t_s, offset - offset[0], variance, left)


def moved(frames: Frames, drift: Drift, since_s: float) -> Frames:
    """Frames at positions moved by what a drift changed since a time."""
    path = frames.believed
    shift = drift.at(np.asarray(path.t_ns * 1e-9, np.float64)) - drift.at(np.array([since_s]))
    position = path.position + np.column_stack([shift, np.zeros(len(shift))])
    return replace(frames, poses=Trajectory(path.t_ns, position, path.quat_xyzw))
