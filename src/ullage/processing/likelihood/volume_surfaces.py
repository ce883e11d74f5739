"""Surfaces in space as sets of rivals: each rival is one direction and shape that explains all echoes so far.

Seen from a place p a reflector has a range r, a direction u and a curvature k, with A the projector on the directions
in which it bends: none for a plane, those across its axis for a cylinder. At the offset x the gradient of the range is
-a, with a = u - k A x, and the range is r + (k x'Ax - 2 u.x) / (|a| + 1).

A new echo leaves a ring of directions open, so it starts a rival for each. Every rival predicts the later echoes by
itself. Its evidence is the likelihood of what it predicted; rivals that fall behind are dropped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ullage.arrays import Bools, Floats, Longs
from ullage.kernels.directed_sums import weigh_levels
from ullage.processing.likelihood.directions import DirectedEchoes, across, ring
from ullage.processing.likelihood.spec import LikelihoodSpec
from ullage.processing.likelihood.surfaces import (
    FLAT,
    FORGET_M,
    GROWTH,
    MOST_BEHIND,
    NEAREST_M,
    NOISE,
    RANGE_GATE_M,
    WORST,
)

RIVALS = 24  # directions on the ring of a new echo, every 15 deg
STEPS = np.array([1e-4, 1e-5, 1e-5, 1e-4])  # of the numerical derivatives: m, rad, rad, 1/m
UPRIGHT = np.array(
    [0.3, 0.0, 0.3, 0.5]
)  # standard deviation of an upright cylinder before its first echo: m, rad; range
BENDS = np.array([-1.5, -0.5, 1.0, 2.0])  # its curvature times range, as a sum of Gaussians [AlspachSorenson1972]
ROUND_NATS = 5.0  # by which a plane is preferred to a cylinder at first
NEAR_M = 0.25  # a rival whose range differs by more does not predict an echo
SAME_RAD, GROUP_RAD = math.radians(3.0), math.radians(10.0)  # rivals this near are one; are one direction on the map
LEVEL_SHARE, LEVEL_BOUND = 0.12, 9.0  # error of a level by echoes at the same range; a sensor counts no more than this
LEVEL_WEIGHT = 0.4  # of levels: what disturbs them lasts over several views
MIRROR_DB, LEAST_DB = 2.0, 5.0  # error of the level against a mirror's, above and below what surfaces reflect
FAINTEST_DB = -26.0  # of a flat surface against a mirror [ITU-R-P2040]
EDGE = 0.3  # 1 - curvature x range, from which a surface bends less than an edge does
PLANE, CYLINDER = 0, 1
PROJECTORS = np.stack([np.zeros((3, 3)), np.diag([1.0, 1.0, 0.0])])
NOISES = np.array([NOISE[0], NOISE[1], NOISE[1], NOISE[2]])
GROWTHS = np.array([GROWTH[0], GROWTH[1], GROWTH[1], GROWTH[2]])
ODDS = 2.0  # least log-odds over those on a plane: a ring of rivals fits by chance more often than one bearing
PLACE_M = 0.06  # sightings from the same place replace each other


@dataclass(frozen=True, slots=True)
class SeenEcho:
    """One keyframe's echo of a surface."""

    position: tuple[float, float, float]  # of the keyframe [m]
    range_m: float
    direction: tuple[float, float, float]  # of the best rival then
    curvature: float  # of the range, of the best rival then [1/m]
    level: float  # amplitude times range, over the antenna's gain [m]
    nats: float


@dataclass(slots=True, eq=False)
class SpatialSurface:
    """A reflector in space with its rivals, one row each."""

    position: Floats  # (3) that the states refer to [m]
    states: Floats  # (k, 5) range [m], unit vector, curvature [1/m]
    frames: Floats  # (k, 2, 3) unit vectors across the direction
    covariances: Floats  # (k, 4, 4) of range, two angles along the frame, curvature
    evidence: Floats  # (k) log-likelihood
    shapes: Longs  # (k) row of `PROJECTORS`
    number: int
    given: bool = False  # known before the flight
    log_odds: float = 0.0
    seen_m: float = 0.0
    sightings: dict[tuple[int, ...], SeenEcho] = field(default_factory=dict)

    @property
    def leader(self) -> int:
        """The best rival."""
        return int(np.argmax(self.evidence))

    @property
    def kind(self) -> str:
        """Plane, edge (a centre of curvature at the surface) or cylinder."""
        range_m, curvature = self.states[self.leader, 0], self.states[self.leader, 4]
        doubt = 2 * math.sqrt(self.covariances[self.leader, 3, 3]) + FLAT
        if self.shapes[self.leader] == PLANE or abs(curvature) < doubt:
            return "plane"
        return "edge" if abs(curvature - 1 / range_m) < doubt else "cylinder"

    @property
    def share(self) -> float:
        """Posterior probability of the best rival's direction and those within 10 deg of it."""
        weight = np.exp(self.evidence - self.evidence.max())
        units = self.states[:, 1:4]
        near = units @ units[self.leader] > math.cos(GROUP_RAD)
        return float(weight[near].sum() / weight.sum())

    def keep(self, rows: Bools | Longs) -> None:
        """Drop all other rivals."""
        self.states, self.frames, self.covariances = self.states[rows], self.frames[rows], self.covariances[rows]
        self.evidence, self.shapes = self.evidence[rows], self.shapes[rows]


def transported(state: Floats, projector: Floats, step: Floats) -> Floats:
    """States (m, 5) as seen from places (m, 3) away [m]."""
    range_m, unit, curvature = state[:, 0], state[:, 1:4], state[:, 4]
    bent = np.einsum("mij,mj->mi", projector, step)
    gradient = unit - curvature[:, None] * bent
    size = np.maximum(np.linalg.norm(gradient, axis=1), 1e-3)
    change = (curvature * np.sum(bent * step, axis=1) - 2 * np.sum(unit * step, axis=1)) / (size + 1)
    return np.column_stack([range_m + change, gradient / size[:, None], curvature / size])


def _moved(state: Floats, frame: Floats, change: Floats) -> Floats:
    """States (m, 5) after changes (m, 4) of range, two angles and curvature."""
    unit = state[:, 1:4] + np.einsum("mk,mki->mi", change[:, 1:3], frame)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    return np.column_stack([state[:, 0] + change[:, 0], unit, state[:, 4] + change[:, 3]])


def _carried(frame: Floats, unit: Floats) -> Floats:
    """Frames (m, 2, 3) turned to be across other directions (m, 3)."""
    first = frame[:, 0] - np.sum(frame[:, 0] * unit, axis=1, keepdims=True) * unit
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-9)
    return np.stack([first, np.cross(unit, first)], axis=1)


def predicted(
    state: Floats, frame: Floats, covariance: Floats, shape: Longs, step: Floats
) -> tuple[Floats, Floats, Floats]:
    """States, frames and covariances (m) as seen from places (m, 3) away, without new noise."""
    projector = PROJECTORS[shape]
    new = transported(state, projector, step)
    turned = _carried(frame, new[:, 1:4])
    columns = []
    for k in range(4):
        change = np.zeros((len(state), 4))
        change[:, k] = STEPS[k]
        apart = transported(_moved(state, frame, change), projector, step)
        apart -= transported(_moved(state, frame, -change), projector, step)
        angles = np.einsum("mi,mki->mk", apart[:, 1:4], turned)
        columns.append(np.column_stack([apart[:, 0], angles, apart[:, 4]]) / (2 * STEPS[k]))
    jacobian = np.stack(columns, axis=2)
    return new, turned, jacobian @ covariance @ jacobian.transpose(0, 2, 1)


def level_floor(z_m: float, number: int) -> SpatialSurface:
    """A level floor of known height [m], without rivals."""
    down = np.array([0.0, 0.0, -1.0])
    state, frame = np.array([[1.0, *down, 0.0]]), across(down, np.array([1.0, 0.0, 0.0]))[None]
    covariance = np.zeros((1, 4, 4))
    above = np.array([0.0, 0.0, z_m + 1.0])
    return SpatialSurface(above, state, frame, covariance, np.zeros(1), np.array([PLANE]), number, given=True)


class SpatialTracker:
    """Associates echoes with surfaces, updates their rivals, and starts new ones.

    Args:
        spec: parameters.
        floor_z_m: height of a level floor, a known surface [m]; None: none is known.
    """

    def __init__(self, spec: LikelihoodSpec, floor_z_m: float | None = None) -> None:
        self._spec = spec
        self.surfaces: list[SpatialSurface] = [] if floor_z_m is None else [level_floor(floor_z_m, 0)]
        self._flown_m, self._born_count = 0.0, len(self.surfaces)
        self._last: Floats | None = None

    def predict(self, position: Floats) -> tuple[Floats, Floats, Floats, Longs]:
        """States, frames and covariances of all rivals as seen from a place, and the surface of each."""
        if not self.surfaces:
            return np.zeros((0, 5)), np.zeros((0, 2, 3)), np.zeros((0, 4, 4)), np.zeros(0, np.int64)
        owner = np.repeat(np.arange(len(self.surfaces)), [len(one.states) for one in self.surfaces])
        shape = np.concatenate([one.shapes for one in self.surfaces])
        step = (position - np.stack([one.position for one in self.surfaces]))[owner]
        state, frame, covariance = predicted(
            np.concatenate([one.states for one in self.surfaces]),
            np.concatenate([one.frames for one in self.surfaces]),
            np.concatenate([one.covariances for one in self.surfaces]),
            shape,
            step,
        )
        unseen_m = self._flown_m - np.array([one.seen_m for one in self.surfaces])[owner]
        growth = NOISES**2 * self._spec.process_noise * (1 + unseen_m[:, None] * GROWTHS)
        growth[shape == PLANE, 3] = 0.0
        growth[shape == CYLINDER, 1] = 0.0
        covariance[:, range(4), range(4)] += growth
        return state, frame, covariance, owner

    def known(self, position: Floats) -> Floats:
        """States (k, 5) of the leading rivals of surfaces of several sightings as seen from a place."""
        state, _, covariance, owner = self.predict(position)
        first = np.searchsorted(owner, np.arange(len(self.surfaces)))
        rows = [
            at + one.leader
            for at, one in zip(first, self.surfaces, strict=True)
            if one.given or len(one.sightings) >= self._spec.least_keyframes
        ]
        state, sigma = state[rows], covariance[rows, 0, 0]
        return np.asarray(state[(state[:, 0] > NEAREST_M) & (sigma < RANGE_GATE_M**2)])

    def update(self, echoes: DirectedEchoes, mirror_m: float) -> Longs:
        """Take the echoes of one keyframe.

        Args:
            echoes: of the keyframe.
            mirror_m: amplitude times range of a perfect mirror before an antenna of 0 dBi; infinite if unknown [m].

        Returns:
            Number (e) of the surface of each echo, or -1.
        """
        if self._last is not None:
            self._flown_m += float(np.linalg.norm(echoes.position - self._last))
        self._last = echoes.position
        levels = _Levels(echoes, mirror_m)
        number = np.full(len(echoes), -1)
        if self.surfaces and len(echoes):
            for surface, echo in self._matched(echoes, levels):
                number[echo] = surface.number
        for echo in np.flatnonzero((number < 0) & (echoes.coherence >= self._spec.least_coherence)).tolist():
            surface = self._born(echoes, echo, levels)
            self.surfaces.append(surface)
            self._see(surface, echoes, echo, levels)
            number[echo] = surface.number
        self._forget()
        return number

    def _born(self, echoes: DirectedEchoes, echo: int, levels: _Levels) -> SpatialSurface:
        """A surface of one echo, with a rival for each direction of its ring."""
        cosine = float(echoes.state[echo, 1:4] @ echoes.track)
        side = max(math.sqrt(max(1 - cosine**2, 0.0)), 0.1)
        flat, level = ring(echoes.track, cosine, RIVALS), _level_directions(echoes.track, cosine)
        units, range_m = np.concatenate([flat, np.repeat(level, len(BENDS), axis=0)]), float(echoes.state[echo, 0])
        shape = np.repeat([PLANE, CYLINDER], [len(flat), len(units) - len(flat)])
        state = np.column_stack([np.full(len(units), range_m), units, np.zeros(len(units))])
        state[shape == CYLINDER, 4] = np.tile(BENDS, len(level)) / range_m
        along = np.where(shape[:, None] == PLANE, echoes.track, [[0.0, 0.0, 1.0]])
        frame = np.stack([across(unit, one) for unit, one in zip(units, along, strict=True)])
        sigma = np.where(
            shape[:, None] == PLANE, [0.3, 0.3, 0.6 * 2 * math.pi * side / RIVALS, 0.0], UPRIGHT / [1, 1, 1, range_m]
        )
        covariance = sigma[:, :, None] ** 2 * np.eye(4)
        new, left, distance = _updated(state, frame, covariance, shape, echoes, np.full(len(units), echo))
        evidence = -0.5 * distance - ROUND_NATS * (shape == CYLINDER)
        surface = SpatialSurface(
            echoes.position, new, _carried(frame, new[:, 1:4]), left, evidence, shape, self._born_count,
            seen_m=self._flown_m,
        )  # fmt: skip
        self._born_count += 1
        surface.evidence = surface.evidence + levels.nats(echo, surface.states)
        surface.keep(surface.evidence > surface.evidence.max() - MOST_BEHIND)
        return surface

    def _matched(self, echoes: DirectedEchoes, levels: _Levels) -> list[tuple[SpatialSurface, int]]:
        """Pairs of surfaces and echoes, most likely first; the surfaces are updated."""
        state, frame, covariance, owner = self.predict(echoes.position)
        apart = np.abs(state[:, :1] - echoes.state[None, :, 0])
        sure = (state[:, 0] >= NEAREST_M) & (covariance[:, 0, 0] < RANGE_GATE_M**2)
        rival, echo = np.nonzero((apart < NEAR_M) & sure[:, None])
        shape = np.concatenate([one.shapes for one in self.surfaces])
        new, left, distance = _updated(state[rival], frame[rival], covariance[rival], shape[rival], echoes, echo)
        behind = np.concatenate([one.evidence.max() - one.evidence for one in self.surfaces])
        gate = self._spec.gate
        whole = np.full((len(self.surfaces), len(echoes)), np.inf)
        fits = distance <= gate
        np.minimum.at(whole, (owner[rival[fits]], echo[fits]), (distance + 2 * behind[rival])[fits])
        out: list[tuple[SpatialSurface, int]] = []
        taken = np.zeros(len(self.surfaces), bool), np.zeros(len(echoes), bool)
        first = np.searchsorted(owner, np.arange(len(self.surfaces) + 1))
        for flat in np.argsort(whole, axis=None, kind="stable"):
            s, e = divmod(int(flat), len(echoes))
            if not whole[s, e] <= gate + 2 * MOST_BEHIND:
                break
            if taken[0][s] or taken[1][e]:
                continue
            taken[0][s] = taken[1][e] = True
            surface, mine = self.surfaces[s], slice(first[s], first[s + 1])
            pairs = np.flatnonzero((owner[rival] == s) & (echo == e))
            cost = np.full(mine.stop - mine.start, WORST)
            surface.states, surface.frames, surface.covariances = state[mine], frame[mine], covariance[mine]
            surface.position = echoes.position
            cost[rival[pairs] - mine.start] = np.minimum(distance[pairs], WORST)
            close = pairs[distance[pairs] <= gate + 2 * MOST_BEHIND]
            at = rival[close] - mine.start
            surface.states[at], surface.covariances[at] = new[close], left[close]
            surface.frames[at] = _carried(surface.frames[at], new[close, 1:4])
            fresh = self._fresh(surface)
            surface.evidence = surface.evidence + fresh * (-0.5 * cost + levels.nats(e, surface.states))
            self._see(surface, echoes, e, levels)
            _pruned(surface)
            out.append((surface, e))
        return out

    def _fresh(self, surface: SpatialSurface) -> float:
        """Share by which a view counts that shares frames with the last one."""
        return min((self._flown_m - surface.seen_m) / self._spec.dependence_m + 0.1, 1.0) if surface.sightings else 1.0

    def _see(self, surface: SpatialSurface, echoes: DirectedEchoes, echo: int, levels: _Levels) -> None:
        nats = float(echoes.nats[echo])
        surface.log_odds += self._fresh(surface) * (nats - self._spec.echo_cost)
        surface.seen_m = self._flown_m
        best = surface.states[surface.leader]
        level = float(levels.level(echo, best[None])[0])
        key = tuple(np.floor(echoes.position / PLACE_M).astype(int).tolist())
        place, unit = tuple(echoes.position.tolist()), tuple(best[1:4].tolist())
        surface.sightings[key] = SeenEcho(place, float(echoes.state[echo, 0]), unit, float(best[4]), level, nats)

    def _forget(self) -> None:
        least, horizon = self._spec.least_keyframes, self._flown_m - FORGET_M
        self.surfaces = [
            one for one in self.surfaces if one.given or len(one.sightings) >= least or one.seen_m >= horizon
        ]

    def confirmed(self) -> list[SpatialSurface]:
        """The surfaces that are sure to exist, in order of their first echo."""
        spec = self._spec
        return [
            one
            for one in self.surfaces
            if len(one.sightings) >= spec.least_keyframes and one.log_odds >= ODDS * spec.least_odds
        ]


class _Levels:
    """Log-likelihood of the amplitudes of a keyframe's echoes, by direction."""

    def __init__(self, echoes: DirectedEchoes, mirror_m: float) -> None:
        self._echoes, self._mirror_m = echoes, mirror_m

    def _weighed(self, echo: int, units: Floats) -> tuple[Floats, Floats]:
        echoes, misfit, level = self._echoes, np.empty(len(units)), np.empty(len(units))
        amplitude = echoes.amplitude[echo]
        noise = echoes.noise / np.sqrt(np.maximum(echoes.rows, 0.5))
        sigma = np.sqrt((LEVEL_SHARE * amplitude.max()) ** 2 + noise**2)
        sigma[echoes.rows == 0] = 1e30
        units = np.ascontiguousarray(units)
        weigh_levels(echoes.patterns, units, amplitude, sigma, LEVEL_BOUND, misfit, level)
        return misfit, level * echoes.state[echo, 0]

    def level(self, echo: int, states: Floats) -> Floats:
        """Amplitude times range over the gain (k) [m]."""
        return self._weighed(echo, states[:, 1:4])[1]

    def nats(self, echo: int, states: Floats) -> Floats:
        """Log-likelihood (k) of an echo's amplitudes.

        No surface is stronger than a mirror, but for what a hollow one focuses. No flat one is 26 dB weaker.
        """
        misfit, level = self._weighed(echo, states[:, 1:4])
        if math.isfinite(self._mirror_m):
            flatness = np.abs(1 - states[:, 4] * states[:, 0])
            focus = np.sqrt(np.maximum(flatness, 0.05))
            level_db = 20 * np.log10(np.maximum(level / focus, 1e-30) / self._mirror_m)
            above = np.maximum(level_db, 0)
            below = np.where(flatness > EDGE, np.maximum(FAINTEST_DB - level_db, 0), 0)
            misfit = misfit + np.minimum((above / MIRROR_DB) ** 2 + (below / LEAST_DB) ** 2, 4 * LEVEL_BOUND)
        return np.asarray(-0.5 * LEVEL_WEIGHT * misfit)


def _level_directions(track: Floats, cosine: float) -> Floats:
    """Level directions (2, 3) of one cosine to the track, or the nearest to it."""
    level = max(float(np.hypot(*track[:2])), 1e-6)
    course, off = math.atan2(track[1], track[0]), math.acos(min(max(cosine / level, -1.0), 1.0))
    return np.array([[math.cos(course + sign * off), math.sin(course + sign * off), 0.0] for sign in (-1, 1)])


def _updated(
    state: Floats, frame: Floats, covariance: Floats, shape: Longs, echoes: DirectedEchoes, echo: Longs
) -> tuple[Floats, Floats, Floats]:
    """States (m, 5) and covariances after an echo each, and the squared distances (m) of the echoes."""
    cosine2 = (state[:, 1:4] @ echoes.track) ** 2
    bends = np.einsum("i,mij,j->m", echoes.track, PROJECTORS[shape], echoes.track) - cosine2
    seen = np.zeros((len(state), 5, 4))
    seen[:, 0, 0] = 1
    seen[:, 1:4, 1:3] = frame.transpose(0, 2, 1)
    seen[:, 4, 3] = np.maximum(bends, 0) / np.maximum(1 - cosine2, 0.05)
    apart = echoes.state[echo] - state
    apart[:, 4] = echoes.state[echo, 4] - seen[:, 4, 3] * state[:, 4]
    given = echoes.covariance[echo]
    total = seen @ covariance @ seen.transpose(0, 2, 1) + given
    inverse = np.linalg.inv(total)
    distance = np.einsum("mi,mij,mj->m", apart, inverse, apart)
    distance += np.linalg.slogdet(total)[1] - np.linalg.slogdet(echoes.covariance)[1][echo]
    gain = covariance @ seen.transpose(0, 2, 1) @ inverse
    new = _moved(state, frame, (gain @ apart[..., None])[..., 0])
    return new, (np.eye(4) - gain @ seen) @ covariance, distance


def _pruned(surface: SpatialSurface) -> None:
    """Drop rivals that are far behind, and those that came to the same direction and shape as a better one."""
    surface.keep(surface.evidence > surface.evidence.max() - MOST_BEHIND)
    if len(surface.states) > 1:
        order = np.argsort(-surface.evidence, kind="stable")
        kept: list[int] = []
        for row in order.tolist():
            unit, shape, bend = surface.states[row, 1:4], surface.shapes[row], surface.states[row, 4]
            same = [
                surface.shapes[one] == shape
                and surface.states[one, 1:4] @ unit > math.cos(SAME_RAD)
                and abs(surface.states[one, 4] - bend) <= math.sqrt(surface.covariances[one, 3, 3])
                for one in kept
            ]
            if not any(same):
                kept.append(row)
        surface.keep(np.sort(np.array(kept)))
