"""Drift of the positions and all surfaces, estimated together by least squares on the echoes of the surfaces.

An aperture moves by the believed velocity v, and by the rate w of the drift. Its phases show the cosine of the angle
between the echo and the motion, so they show u (v + w) / |v|, and not the bearing itself. The range, the curvature and
this cosine are the factors of an echo. Its bearing only chooses the side of the track.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from ullage.arrays import Bools, Floats, Longs
from ullage.data import Frames
from ullage.processing.likelihood.drift_prior import Drift, DriftPrior
from ullage.processing.likelihood.echoes import Echoes, EchoFinder
from ullage.processing.likelihood.keyframes import KeyframeSelector
from ullage.processing.likelihood.spec import LikelihoodSpec
from ullage.processing.likelihood.surfaces import LYING, Surface, SurfaceTracker, transported

ROWS = 5  # of an echo: range, bearing, curvature, cosine of the elevation, cosine of the angle to the motion
SHARE = 0.25  # variance of an echo over that which the tracker uses: the drift explains the rest of it
MODEL = np.array([0.0, 0.5, 0.04, 0.1, 0.005])  # sigma of the model itself in each row: m, rad, 1/m
LEAST_ECHOES, MOST_GAP = 5, 4  # echoes of a run; keyframes without one that end it
LEAST_SPEED_M_S = 0.05
WORST, MOST_OUTLIERS = 5.0, 0.3  # median squared distance of the echoes of a run, and share of them beyond the gate
SIGMAS = {"plane": (0.005, 0.003), "edge": (0.02, 0.003), "free": (1.0, 0.003), "slope": (1.0, 0.3)}
SURE_CURVATURE, SURE_EDGE, FLAT, SHARP = 0.1, 0.2, 0.01, 0.05  # from which a kind is decided; what it leaves open
STEP = 1e-5  # of the numerical derivatives
MOST_CHANGE = np.array([0.5, 0.3, 0.3, 0.1])  # of a state in one step: m, rad, 1/m, cosine
SHORTER = (1.0, 0.5, 0.25, 0.06)  # parts of a step that are tried
STEPS, ENOUGH_NATS = 8, 0.01  # of Gauss-Newton; gain below which it stops
SAME = np.array([0.01, 0.02, 0.05, 0.02])  # by which one surface may differ from itself elsewhere
MOST_APART, LEAST_NATS = 16.0, 2.0  # squared distance of two surfaces that may be one; evidence for it
SHARED = 0.1  # share of keyframes that saw both of two surfaces, up to which they may be one
SPREAD = 8.0 * 2 * math.pi  # ranges and bearings over which surfaces spread [m rad]
MEASURED = [0, 2, 3, 4]  # rows of an echo that its evidence counts: range, curvature and both cosines
SPREAD_ECHO = 8.0 * 2.0 * 1.0 * 2.0  # over which these spread for echoes of no surface: m, 1/m, 1, 1


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Keyframes of a flight and their echoes."""

    t_s: Floats  # (k)
    echoes: list[Echoes]  # of each keyframe
    runs: list[Run]  # echoes that a tracker gave to one surface

    @property
    def position(self) -> Floats:
        """Positions (k, 2) [m]."""
        return np.array([one.position for one in self.echoes]).reshape(-1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """Echoes of one surface, without a gap."""

    pairs: Longs  # (n, 2) keyframe and echo
    sloped: bool


class _RunTracker(SurfaceTracker):
    """A tracker that keeps which echo it gave to which surface.

    Lying cylinders are no rivals in it, since the graph has no factor for them.
    """

    def __init__(self, spec: LikelihoodSpec) -> None:
        super().__init__(spec)
        self.seen: dict[int, tuple[Surface, list[tuple[int, int]]]] = {}
        self.keyframe = 0

    def _born(self, echoes: Echoes, echo: int) -> Surface:
        born = super()._born(echoes, echo)
        born.evidence[LYING] = -np.inf
        return born

    def _see(self, surface: Surface, echoes: Echoes, echo: int, evidence: Floats) -> None:
        super()._see(surface, echoes, echo, evidence)
        self.seen.setdefault(id(surface), (surface, []))[1].append((self.keyframe, echo))


def find_track(parts: list[Frames], spec: LikelihoodSpec) -> Track:
    """Find the echoes of all keyframes of a recording with phase, and the runs of echoes of one surface."""
    selector, finder, tracker = KeyframeSelector(spec), EchoFinder(spec), _RunTracker(spec)
    for part in parts:
        selector.add(part)
    t_s: list[float] = []
    found: list[Echoes] = []
    for tracker.keyframe, key in enumerate(selector.ready(finish=True)):
        found.append(finder.find(key, tracker.known(key.position)))
        tracker.update(found[-1])
        t_s.append(key.t_ns * 1e-9)
    runs: list[Run] = []
    for surface, seen in tracker.seen.values():
        pairs = np.array(seen)
        sure = np.array([found[k].coherence[e] >= spec.least_coherence for k, e in seen])
        ends = np.flatnonzero(np.diff(pairs[:, 0]) > MOST_GAP) + 1
        for rows in np.split(np.arange(len(pairs)), ends):
            run = pairs[rows[sure[rows]]]
            if len(run) >= LEAST_ECHOES:
                runs.append(Run(run, surface.sloped))
    return Track(np.array(t_s), found, runs)


@dataclass(frozen=True, slots=True, eq=False)
class _Factors:
    """Echoes (n) and their surfaces (s)."""

    key: Longs  # (n) keyframe
    owner: Longs  # (n) surface
    seen: Floats  # (n, ROWS)
    weight: Floats  # (n, ROWS) inverse variance
    place: Floats  # (s, 2) that the states refer to [m]
    kind: tuple[str, ...]  # (s)
    label: tuple[int, ...]  # (s) first run


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Drift and surfaces, with the factorised information matrix about them."""

    drift: Drift
    state: Floats  # (s, 4) of the surfaces
    distance: Floats  # (n) squared distance of each echo
    cost: float  # negative log-likelihood with the prior [nats]
    factor: SuperLU
    factors: _Factors


class PoseGraph:
    """Offset of the track and all surfaces as one sparse problem [KaessEtAl2012].

    Args:
        track: keyframes and echoes, found at poses that `start` corrected.
        prior: of the offset, on each axis.
        spec: parameters of the mapper.
        start: drift by which the track is corrected since its first moment.
    """

    def __init__(self, track: Track, prior: DriftPrior, spec: LikelihoodSpec, start: Drift) -> None:
        self._track, self._spec, self._prior = track, spec, prior
        self._basis, self._rates = prior.basis(track.t_s), prior.basis(track.t_s, 1)
        self._precision = prior.precision()
        self._start = start.under(prior).state
        self._started, self._start_rates = track.position, start.at(track.t_s, 1)
        self._position = track.position - start.at(track.t_s)
        velocity = np.stack([np.gradient(track.position[:, axis], track.t_s) for axis in (0, 1)], axis=1)
        self._speed = np.maximum(np.linalg.norm(velocity, axis=1), LEAST_SPEED_M_S)
        self._ahead = velocity / self._speed[:, None]
        self._independent = spec.keyframe_m / spec.dependence_m  # share of an echo that no earlier keyframe holds

    def solve(self) -> Estimate | None:
        """Estimate drift and surfaces; surfaces that were seen apart are merged where they agree.

        Returns:
            The estimate, or None where no surface is seen well.
        """
        kept: list[Run] = []
        kinds: list[str] = []
        for run in self._track.runs:
            alone, state = self._factors([run], ["slope" if run.sloped else "free"])
            fit = self._improved(alone, self._start, state)
            outliers = np.mean(fit.distance > self._spec.gate)
            if np.median(fit.distance) <= WORST and outliers <= MOST_OUTLIERS:
                kept.append(run)
                kinds.append(self._kind(alone.kind[0], fit))
        if not kept:
            return None
        factors, state = self._factors(kept, kinds)
        estimate = self._improved(factors, self._start, state)
        return self._merged(factors, estimate)

    def evidence(self, estimate: Estimate) -> float:
        """Log-likelihood ratio of all echoes with a drift against echoes of no surface [nat].

        Drift and surfaces are integrated out by Laplace's method [MacKay2003], so both pay for the volume of their
        priors that the echoes exclude. An echo of no surface may have any range, curvature and cosine. An echo of a
        surface counts by how much better the surface predicts it [Sittler1964]. So much energy does not make up for a
        poor prediction.

        Before any echo a surface has any range and bearing, and one of the kinds as likely as another. Its kind gives
        the prior of its curvature and elevation.
        """
        factors, drift, state = estimate.factors, estimate.drift.state, estimate.state
        whole = self._normal(factors, drift, state)[0]
        peak = 0.5 * np.sum(np.log(factors.weight[:, MEASURED] / (2 * np.pi)), axis=1)
        echoes = self._independent * float(np.sum(peak + math.log(SPREAD_ECHO)))
        sigma = np.array([SIGMAS[kind] for kind in factors.kind])
        edges = np.array([kind == "edge" for kind in factors.kind])
        prior = -float(np.sum(np.log(sigma * math.sqrt(2 * np.pi)))) + float(np.sum(np.log(state[edges, 0])))
        prior -= len(state) * math.log(SPREAD * len(SIGMAS))
        volume = 2 * len(state) * math.log(2 * np.pi) + _log_det(splu(self._precision)) - 0.5 * _log_det(splu(whole))
        return echoes - estimate.cost + prior + volume

    @staticmethod
    def _misfit(factors: _Factors, predicted: Floats) -> Floats:
        left = factors.seen - predicted
        left[:, 1] = (left[:, 1] + np.pi) % (2 * np.pi) - np.pi
        return left

    def variance(self, estimate: Estimate) -> Floats:
        """Variance (k, 2) of the offset at the keyframes against that at the first one [m^2]."""
        return self._variance(estimate.factor, len(estimate.state))

    def prior_variance(self) -> Floats:
        """The same before any echo."""
        return self._variance(splu(sparse.block_diag([self._precision] * 2, format="csc")), 0)

    def _variance(self, factor: SuperLU, surfaces: int) -> Floats:
        since = self._basis.toarray()
        since -= since[:1]
        size, out = since.shape[1], np.zeros((len(since), 2))
        for axis in (0, 1):
            rows = np.zeros((2 * size + 4 * surfaces, len(since)))
            rows[axis * size : (axis + 1) * size] = since.T
            out[:, axis] = np.sum(rows * factor.solve(rows), axis=0)
        return out

    def _factors(self, runs: list[Run], kinds: list[str]) -> tuple[_Factors, Floats]:
        """The echoes of runs, each of a surface of its own, and the first states (s, 4) of these."""
        pairs = np.concatenate([run.pairs for run in runs])
        owner = np.repeat(np.arange(len(runs)), [len(run.pairs) for run in runs])
        key = pairs[:, 0]
        state = np.array([self._track.echoes[k].state[e] for k, e in pairs])
        variance = SHARE * np.array([np.diag(self._track.echoes[k].covariance[e]) for k, e in pairs])
        along, across = _along(state[:, 1], self._ahead[key])
        turned = across**2 * variance[:, 1] + along**2 * variance[:, 3]
        seen = np.column_stack([state, state[:, 3] * along])
        weight = 1 / (np.column_stack([variance, turned]) + MODEL**2)
        flattest = [rows[np.argmin(np.abs(state[rows, 2]))] for rows in _rows_of(owner, len(runs))]
        place = self._started[key[flattest]]
        return _Factors(key, owner, seen, weight, place, tuple(kinds), tuple(range(len(runs)))), state[flattest]

    def _predicted(self, factors: _Factors, drift: Floats, state: Floats) -> tuple[Floats, list[Floats]]:
        """What each echo should show (n, ROWS), and its derivatives by its surface's state, by the step, by the rate.

        Returns:
            The rows, and their derivatives (n, ROWS, 4), (n, ROWS, 2) and (n, ROWS, 2).
        """
        key, owner = factors.key, factors.owner
        step = self._position[key] + (self._basis @ drift.T)[key] - factors.place[owner]
        own, speed = state[owner], self._speed[key, None]
        motion = self._ahead[key] + (self._rates @ drift.T - self._start_rates)[key] / speed
        here = transported(own, step)
        by_state = [transported(own + STEP * e, step) - transported(own - STEP * e, step) for e in np.eye(4)]
        by_step = [transported(own, step + STEP * e) - transported(own, step - STEP * e) for e in np.eye(2)]
        along, across = _along(here[:, 1], motion)
        slopes = []
        for columns in (by_state, by_step):
            slope = np.stack(columns, axis=2) / (2 * STEP)
            last = (here[:, 3] * across)[:, None] * slope[:, 1] + along[:, None] * slope[:, 3]
            slopes.append(np.concatenate([slope, last[:, None]], axis=1))
        by_rate = np.zeros((len(key), ROWS, 2))
        by_rate[:, 4] = np.stack([np.cos(here[:, 1]), np.sin(here[:, 1])], axis=1) * here[:, 3:] / speed
        return np.column_stack([here, here[:, 3] * along]), [*slopes, by_rate]

    def _normal(
        self, factors: _Factors, drift: Floats, state: Floats
    ) -> tuple[sparse.csc_matrix, Floats, Floats, float]:
        """Information, gradient, squared distances of the echoes, and cost; outliers hardly count [Triggs2000]."""
        predicted, (by_state, by_step, by_rate) = self._predicted(factors, drift, state)
        left = self._misfit(factors, predicted)
        distance = np.sum(factors.weight * left**2, axis=1)
        robust = self._independent / (1 + distance / self._spec.gate) ** 2
        weight = (factors.weight * robust[:, None]).ravel()
        count, surfaces, size = len(left), len(state), drift.size
        row = np.arange(ROWS * count)
        owner = np.repeat(factors.owner, ROWS)
        spread = sparse.csr_matrix(
            (np.ones(len(row)), (row, np.repeat(factors.key, ROWS))), (len(row), len(self._speed))
        )
        at, rates = spread @ self._basis, spread @ self._rates
        columns = (4 * owner[:, None] + np.arange(4)).ravel()
        states = sparse.csr_matrix((by_state.ravel(), (np.repeat(row, 4), columns)), (len(row), 4 * surfaces))
        axes = [
            sparse.diags(by_step[..., axis].ravel()) @ at + sparse.diags(by_rate[..., axis].ravel()) @ rates
            for axis in (0, 1)
        ]
        slope = sparse.csr_matrix(sparse.hstack([*axes, states]))
        kinds, apart, sure = _kind_factors(factors.kind, state)
        shape = sparse.csr_matrix(sparse.hstack([sparse.csr_matrix((2 * surfaces, size)), sparse.block_diag(kinds)]))
        whole = sparse.block_diag([self._precision, self._precision, 1e-6 * sparse.eye(4 * surfaces)])
        matrix = slope.T @ sparse.diags(weight) @ slope + shape.T @ sparse.diags(sure.ravel()) @ shape + whole
        before = whole @ np.concatenate([drift.ravel(), np.zeros(4 * surfaces)])
        right = slope.T @ (weight * left.ravel()) + shape.T @ (sure * apart).ravel() - before
        echoes = self._independent * np.sum(distance / (1 + distance / self._spec.gate))
        cost = 0.5 * float(echoes + np.sum(sure * apart**2) + before[:size] @ drift.ravel())
        return sparse.csc_matrix(matrix), right, distance, cost

    def _improved(self, factors: _Factors, drift: Floats, state: Floats) -> Estimate:
        """Estimate by Gauss-Newton; a step that raises the cost is shortened."""
        matrix, right, distance, cost = self._normal(factors, drift, state)
        factor = splu(matrix)
        for _ in range(STEPS):
            step = factor.solve(right)
            turn, bend = step[: drift.size].reshape(2, -1), step[drift.size :].reshape(-1, 4)
            for share in SHORTER:
                new = state + np.clip(share * bend, -MOST_CHANGE, MOST_CHANGE)
                new[:, 3] = np.clip(new[:, 3], 0.1, 1.0)
                tried = self._normal(factors, drift + share * turn, new)
                if tried[3] < cost:
                    break
            else:
                break
            gain = cost - tried[3]
            drift, state = drift + share * turn, new
            matrix, right, distance, cost = tried
            factor = splu(matrix)
            if gain < ENOUGH_NATS:
                break
        return Estimate(Drift(self._prior, drift), state, distance, cost, factor, factors)

    def _covariance(self, estimate: Estimate) -> Floats:
        """Covariance (4 s, 4 s) of the states of all surfaces."""
        size, count = 2 * self._prior.size, estimate.state.size
        columns = np.zeros((size + count, count))
        columns[size:] = np.eye(count)
        return np.asarray(estimate.factor.solve(columns)[size:])

    def _kind(self, kind: str, fit: Estimate) -> str:
        """Kind of a surface that was fitted alone, as far as its curvature and elevation are sure."""
        covariance = self._covariance(fit)
        range_m, _, curvature, cosine = fit.state[0]
        sigma = np.sqrt(np.diag(covariance))
        if kind == "slope" and 1 - cosine > 3 * sigma[3]:
            return "slope"
        if abs(curvature) < 2 * sigma[2] + FLAT:
            return "plane" if sigma[2] < SURE_CURVATURE else "free"
        slope = np.array([curvature, 0.0, range_m, 0.0])
        doubt = math.sqrt(slope @ covariance @ slope)
        return "edge" if abs(curvature * range_m - 1) < 2 * doubt + SHARP and doubt < SURE_EDGE else "free"

    def _merged(self, factors: _Factors, estimate: Estimate) -> Estimate:
        """Merge surfaces, those that agree best first, as long as one surface explains the echoes of both."""
        apart: set[tuple[int, int]] = set()
        merged = True
        while merged:
            touched: set[int] = set()
            for first, second, prior in self._candidates(factors, estimate, apart):
                if first in touched or second in touched:
                    continue
                a, b = factors.label.index(first), factors.label.index(second)
                less, more = sorted((a, b), key=lambda s: int(np.sum(factors.owner == s)))
                keep = np.arange(len(estimate.state)) != less
                owner = np.where(factors.owner == less, more, factors.owner)
                joint = _only(replace(factors, owner=owner), keep)
                tried = self._improved(joint, estimate.drift.state, estimate.state[keep])
                if tried.cost - estimate.cost < prior - LEAST_NATS:
                    factors, estimate = joint, tried
                    touched |= {first, second}
                else:
                    apart.add((first, second))
            merged = bool(touched)
        return estimate

    def _candidates(
        self, factors: _Factors, estimate: Estimate, apart: set[tuple[int, int]]
    ) -> list[tuple[int, int, float]]:
        """Pairs of surfaces that may be one, best first: labels, and what the evidence was before their distance."""
        count, keyframes = len(estimate.state), len(self._speed)
        seen = np.zeros((count, keyframes))
        seen[factors.owner, factors.key] = 1.0
        a, b = np.triu_indices(count, 1)
        both, views = (seen @ seen.T)[a, b], seen.sum(1)
        known = np.array([(factors.label[i], factors.label[j]) in apart for i, j in zip(a, b, strict=True)], bool)
        pairs = np.stack([a, b], axis=1)[~known & (both <= SHARED * np.minimum(views[a], views[b]))]
        if not len(pairs):
            return []
        place = self._middles(seen > 0, pairs, estimate) - factors.place[pairs]
        index = (4 * pairs[:, :, None] + np.arange(4)).reshape(-1, 8)
        covariance = self._covariance(estimate)[index[:, :, None], index[:, None, :]]
        distance, spread = _apart(estimate.state[pairs], place, covariance)
        area = np.linalg.det(2 * np.pi * spread[:, :2, :2])
        prior = math.log(SPREAD / count) - 0.5 * np.log(area)
        good = (distance < MOST_APART) & (prior - 0.5 * distance > LEAST_NATS)
        order = np.argsort(0.5 * distance - prior, kind="stable")
        labels = np.array(factors.label)[pairs]
        return [(int(labels[k, 0]), int(labels[k, 1]), float(prior[k])) for k in order if good[k]]

    def _middles(self, seen: Bools, pairs: Longs, estimate: Estimate) -> Floats:
        """Place (p, 1, 2) between the nearest keyframes that saw either surface of each pair."""
        at = self._position + self._basis @ estimate.drift.state.T
        gap = np.linalg.norm(at[:, None] - at, axis=2)
        keys = [np.flatnonzero(row) for row in seen]
        out = np.zeros((len(pairs), 1, 2))
        for row, (a, b) in enumerate(pairs):
            near = gap[np.ix_(keys[a], keys[b])]
            i, j = divmod(int(np.argmin(near)), near.shape[1])
            out[row, 0] = 0.5 * (at[keys[a][i]] + at[keys[b][j]])
        return out


def _log_det(factor: SuperLU) -> float:
    return float(np.sum(np.log(np.abs(factor.U.diagonal()))))


def _along(bearing: Floats, motion: Floats) -> tuple[Floats, Floats]:
    """Parts (n) of motions (n, 2) along bearings (n), and across them."""
    c, s = np.cos(bearing), np.sin(bearing)
    return c * motion[:, 0] + s * motion[:, 1], c * motion[:, 1] - s * motion[:, 0]


def _rows_of(owner: Longs, count: int) -> list[Longs]:
    """Rows of each surface."""
    return [np.flatnonzero(owner == s) for s in range(count)]


def _only(factors: _Factors, keep: Bools) -> _Factors:
    """The surfaces to keep, numbered anew; all echoes must be theirs."""
    owner = (np.cumsum(keep) - 1)[factors.owner]
    kind, label = (tuple(np.array(part)[keep].tolist()) for part in (factors.kind, factors.label))
    return replace(factors, owner=owner, place=factors.place[keep], kind=kind, label=label)


def _kind_factors(kinds: tuple[str, ...], state: Floats) -> tuple[Floats, Floats, Floats]:
    """What the kinds say of curvatures and cosines: slopes (s, 2, 4), misfits (s, 2) and inverse variances (s, 2)."""
    rows, left = np.zeros((len(state), 2, 4)), np.zeros((len(state), 2))
    edge = np.array([kind == "edge" for kind in kinds])
    range_m, _, curvature, cosine = state.T
    rows[:, 0, 2], rows[:, 0, 0] = np.where(edge, range_m, 1.0), np.where(edge, curvature, 0.0)
    rows[:, 1, 3] = 1.0
    left[:, 0] = np.where(edge, 1 - curvature * range_m, -curvature)
    left[:, 1] = 1 - cosine
    return rows, left, np.array([SIGMAS[kind] for kind in kinds]) ** -2


def _apart(states: Floats, steps: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Squared distances (p) of pairs of surfaces as seen from one place, and covariances (p, 4, 4) of the difference.

    Args:
        states: (p, 2, 4) of both surfaces.
        steps: (p, 2, 2) from where the states refer to, to that place [m].
        covariance: (p, 8, 8) of both.
    """
    count = len(states)
    tries = states[:, :, None] + STEP * np.concatenate([np.eye(4), -np.eye(4), np.zeros((1, 4))])
    moved = transported(tries.reshape(-1, 4), np.repeat(steps.reshape(-1, 2), 9, axis=0)).reshape(count, 2, 9, 4)
    slopes = ((moved[:, :, :4] - moved[:, :, 4:8]) / (2 * STEP)).transpose(0, 1, 3, 2)
    apart = moved[:, 0, 8] - moved[:, 1, 8]
    apart[:, 1] = (apart[:, 1] + np.pi) % (2 * np.pi) - np.pi
    slope = np.concatenate([slopes[:, 0], -slopes[:, 1]], axis=2)
    spread = slope @ covariance @ slope.transpose(0, 2, 1) + np.diag(SAME**2)
    return np.einsum("pi,pij,pj->p", apart, np.linalg.inv(spread), apart), spread
