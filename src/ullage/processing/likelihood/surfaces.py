"""Surfaces as hypotheses: each explains the echoes of all keyframes that fit its range, bearing and curvature.

Every smooth reflector that a monostatic radar sees lies about a centre of curvature. Seen from one place its state is
the range to the specular point, the bearing to it, and the curvature of the range across that bearing: 0 for a flat
wall, 1 / range for an edge or pole, less than 0 inside a round tank, less than 1 / range for a pillar. The fourth
number is the cosine of the elevation of its direction: 1 for upright surfaces, less for slopes and for things above or
below the plane. From the state at one place follows that at any other place.

Two rivals track each surface: upright, and of any elevation. Both predict the same echoes, so their evidence decides.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ullage.arrays import Floats
from ullage.processing.likelihood.echoes import Echoes
from ullage.processing.likelihood.spec import LikelihoodSpec

STEPS = np.array([1e-4, 1e-5, 1e-4, 1e-4])  # of the numerical derivatives: m, rad, 1/m, cosine
NOISE = np.array([6e-4, math.radians(0.1), 0.015, 0.01])  # that a surface may bend in a keyframe: m, rad, 1/m, cosine
GROWTH = np.array([20.0, 20.0, 5.0, 5.0])  # of that variance, for each metre of track that did not see the surface
RANGE_GATE_M = 0.3  # a surface whose predicted range is less sure than this takes no echo
NEAREST_M = 0.2  # predicted ranges below it are behind the sensor
FOOT_M, VIEW_M = 0.05, 0.15  # a specular point seen from nearly the same place again replaces the earlier one
FORGET_M = 1.5  # track after which a surface that is not sure is forgotten
CONSISTENT_M = 0.03  # a smoothed range this near to the measured one replaces it
SLOPE, SLOPE_SIGMA = 0.85, 0.2  # cosine of the elevation of a slope, before any echo has shown it
FLAT = 0.05  # curvature that a plane may have [1/m]
LEAST_COSINE = 0.1  # bound of the cosine
MOST_BEHIND = 20.0  # nats by which a rival may be behind and still take an echo
WORST = 60.0  # bound on the squared distance that counts against a rival


@dataclass(frozen=True, slots=True)
class Sighting:
    """One keyframe's echo of a surface, with the state of the surface after it."""

    position: tuple[float, float]  # of the keyframe [m]
    state: tuple[float, float, float, float]  # range [m], bearing [rad], curvature [1/m], cosine of the elevation
    level: float  # amplitude times range, over the antenna's gain [m]
    nats: float
    share: float = 1.0  # of a full echo that the views of this place have counted
    odds: float = 0.0  # log-odds that they gave


NOTHING = Sighting((0.0, 0.0), (0.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0)


@dataclass(slots=True, eq=False)
class Surface:
    """A reflector: its state as seen from one place, how sure that is, and the keyframes that saw it."""

    position: Floats  # (2) that the states refer to [m]
    states: Floats  # (2, 4) of both rivals: range [m], bearing [rad], curvature [1/m], cosine of the elevation
    covariances: Floats  # (2, 4, 4)
    evidence: Floats  # (2) log-likelihood of each rival, with its prior
    log_odds: float = 0.0
    lead: float = 0.0  # of its direction over rivals on the rings about the track [nat]
    seen_m: float = 0.0  # track flown when it was last seen
    sightings: dict[tuple[int, ...], Sighting] = field(default_factory=dict)

    @property
    def sloped(self) -> bool:
        """Whether its direction leaves the plane."""
        return bool(self.evidence[1] > self.evidence[0])

    @property
    def kind(self) -> str:
        """Slope, plane, edge (a centre of curvature at the surface) or cylinder."""
        range_m, _, curvature, _ = self.state
        doubt = 2 * math.sqrt(self.covariance[2, 2]) + FLAT
        if self.sloped:
            return "slope"
        if abs(curvature) < doubt:
            return "plane"
        return "edge" if abs(curvature - 1 / range_m) < doubt else "cylinder"

    @property
    def state(self) -> Floats:
        """State (4) of the better rival."""
        return np.asarray(self.states[int(self.sloped)])

    @property
    def covariance(self) -> Floats:
        """Covariance (4, 4) of the better rival."""
        return np.asarray(self.covariances[int(self.sloped)])


def transported(state: Floats, step: Floats) -> Floats:
    """States (m, 4) as seen from places (m, 2) away [m]."""
    range_m, bearing, curvature, cosine = state.T
    c, s = np.cos(bearing), np.sin(bearing)
    along, across = step[:, 0] * c + step[:, 1] * s, step[:, 1] * c - step[:, 0] * s
    ahead, aside = cosine - curvature * along, curvature * across
    size = np.maximum(np.sqrt(ahead**2 + aside**2 + np.maximum(1 - cosine**2, 0)), 1e-3)
    change = (curvature * (along**2 + across**2) - 2 * cosine * along) / (size + 1)
    level = np.clip(np.hypot(ahead, aside) / size, LEAST_COSINE, 1.0)
    return np.stack([range_m + change, bearing - np.arctan2(aside, ahead), curvature / size, level], axis=1)


def _jacobian(state: Floats, step: Floats) -> Floats:
    """Derivatives (m, 4, 4) of the transported states by the states."""
    columns = [
        (transported(state + np.eye(4)[k] * STEPS[k], step) - transported(state - np.eye(4)[k] * STEPS[k], step))
        / (2 * STEPS[k])
        for k in range(4)
    ]
    return np.stack(columns, axis=2)


class SurfaceTracker:
    """Associates echoes with surfaces, refines these by an information filter, and starts new ones."""

    def __init__(self, spec: LikelihoodSpec) -> None:
        self._spec = spec
        self.surfaces: list[Surface] = []
        self._holders: dict[tuple[int, ...], Surface] = {}  # surface that shows a specular point in a view
        self._flown_m = 0.0
        self._last: Floats | None = None

    def update(self, echoes: Echoes) -> None:
        """Take the echoes of one keyframe."""
        if self._last is not None:
            self._flown_m += float(np.linalg.norm(echoes.position - self._last))
        self._last = echoes.position
        free = np.ones(len(echoes), bool)
        if self.surfaces and len(echoes):
            for surface, echo, rivals in self._matches(echoes):
                free[echo] = False
                surface.position, surface.states, surface.covariances = echoes.position, rivals[0], rivals[1]
                self._see(surface, echoes, echo, rivals[2])
        for echo in np.flatnonzero(free & (echoes.coherence >= self._spec.least_coherence)).tolist():
            surface = self._born(echoes, echo)
            self.surfaces.append(surface)
            self._see(surface, echoes, echo, np.zeros(2))
        self._forget()

    def _born(self, echoes: Echoes, echo: int) -> Surface:
        """A surface of one echo, with both rivals."""
        states, covariances = np.tile(echoes.state[echo], (2, 1)), np.tile(echoes.covariance[echo], (2, 1, 1))
        evidence = np.array([0.0, -self._spec.upright_nats])
        for rival, (cosine, sigma) in enumerate([(1.0, 1e-6), (SLOPE, SLOPE_SIGMA)]):
            covariance = covariances[rival]
            apart, total = cosine - states[rival, 3], covariance[3, 3] + sigma**2
            evidence[rival] -= 0.5 * apart**2 / total + 0.5 * math.log(total)
            gain = covariance[:, 3] / total
            states[rival] += gain * apart
            covariances[rival] = covariance - np.outer(gain, covariance[3])
        states[0, 3] = 1.0
        states[1, 3] = min(max(states[1, 3], LEAST_COSINE), 1.0)
        covariances[0, 3] = covariances[0, :, 3] = 0.0
        return Surface(echoes.position, states, covariances, evidence, seen_m=self._flown_m)

    def _predicted(self, position: Floats) -> tuple[Floats, Floats]:
        """States (2 s, 4) and covariances of both rivals of all surfaces as seen from a place."""
        state = np.concatenate([one.states for one in self.surfaces])
        step = np.repeat(position - np.stack([one.position for one in self.surfaces]), 2, axis=0)
        unseen_m = np.repeat(self._flown_m - np.array([one.seen_m for one in self.surfaces]), 2)
        jacobian = _jacobian(state, step)
        covariance = jacobian @ np.concatenate([one.covariances for one in self.surfaces]) @ jacobian.transpose(0, 2, 1)
        growth = NOISE**2 * self._spec.process_noise * (1 + unseen_m[:, None] * GROWTH)
        growth[::2, 3] = 0.0
        covariance[:, range(4), range(4)] += growth
        state = transported(state, step)
        state[::2, 3] = 1.0
        covariance[::2, 3] = covariance[::2, :, 3] = 0.0
        return state, covariance

    def known(self, position: Floats) -> Floats:
        """States (s, 4) of the surfaces of several sightings as seen from a place (2)."""
        if not self.surfaces:
            return np.zeros((0, 4))
        state, covariance = self._predicted(position)
        better = 2 * np.arange(len(self.surfaces)) + [one.sloped for one in self.surfaces]
        state, sigma = state[better], covariance[better, 0, 0]
        sure = np.array([len(one.sightings) >= self._spec.least_keyframes for one in self.surfaces])
        return np.asarray(state[sure & (state[:, 0] > NEAREST_M) & (sigma < RANGE_GATE_M**2)])

    def _matches(self, echoes: Echoes) -> list[tuple[Surface, int, tuple[Floats, Floats, Floats]]]:
        """Pairs of surfaces and echoes, most likely first, with states, covariances and evidence of the rivals."""
        state, covariance = self._predicted(echoes.position)
        apart = echoes.state[None] - state[:, None]
        apart[..., 1] = (apart[..., 1] + np.pi) % (2 * np.pi) - np.pi
        total = covariance[:, None] + echoes.covariance[None]
        inverse = np.linalg.inv(total)
        distance = np.einsum("sei,seij,sej->se", apart, inverse, apart)
        distance += np.log(np.linalg.det(total) / np.linalg.det(echoes.covariance))
        possible = (state[:, 0] >= NEAREST_M)[:, None] & (total[..., 0, 0] <= RANGE_GATE_M**2)
        behind = np.stack([one.evidence.max() - one.evidence for one in self.surfaces]).reshape(-1, 1)
        whole = np.where(possible & (distance <= self._spec.gate), distance + 2 * behind, np.inf)
        best = np.minimum(whole[::2], whole[1::2])
        out: list[tuple[Surface, int, tuple[Floats, Floats, Floats]]] = []
        taken = np.zeros(len(self.surfaces), bool), np.zeros(len(echoes), bool)
        for flat in np.argsort(best, axis=None, kind="stable"):
            s, e = divmod(int(flat), len(echoes))
            if best[s, e] > self._spec.gate + 2 * MOST_BEHIND:
                break
            if taken[0][s] or taken[1][e]:
                continue
            taken[0][s] = taken[1][e] = True
            both = slice(2 * s, 2 * s + 2)
            gain = covariance[both] @ inverse[both, e]
            new = state[both] + (gain @ apart[both, e, :, None])[..., 0]
            new[1, 3] = min(max(new[1, 3], LEAST_COSINE), 1.0)
            left = (np.eye(4) - gain) @ covariance[both]
            out.append((self.surfaces[s], e, (new, left, -0.5 * np.minimum(distance[both, e], WORST))))
        return out

    def _see(self, surface: Surface, echoes: Echoes, echo: int, evidence: Floats) -> None:
        """Count an echo for a surface; views that share frames count in part, and each place in full at most once."""
        spec = self._spec
        fresh = min((self._flown_m - surface.seen_m) / spec.dependence_m + 0.1, 1.0) if surface.sightings else 1.0
        surface.evidence = surface.evidence + fresh * evidence
        surface.lead += fresh * float(echoes.lead[echo])
        surface.seen_m = self._flown_m
        range_m, bearing, curvature, cosine = (float(value) for value in surface.state)
        x, y = (float(value) for value in echoes.position)
        far, ahead = (float(value) for value in echoes.state[echo, :2])
        foot = x + far * math.cos(ahead), y + far * math.sin(ahead)
        key = (*(round(value / FOOT_M) for value in foot), *(round(value / VIEW_M) for value in (x, y)))
        state = range_m, bearing, curvature, cosine
        before, nats = self._taken(surface, key), float(echoes.nats[echo])
        share = min(fresh, 1.0 - before.share)
        gained = share * (nats - spec.echo_cost)
        surface.log_odds += gained
        counted = before.share + share, before.odds + gained
        surface.sightings[key] = Sighting((x, y), state, float(echoes.level[echo]), nats, *counted)

    def _taken(self, surface: Surface, key: tuple[int, ...]) -> Sighting:
        """Take a specular point from the surface that showed it before: one view of one place is one reflector.

        Returns:
            What the surface itself has counted there.
        """
        holder = self._holders.get(key)
        self._holders[key] = surface
        if holder is surface:
            return surface.sightings[key]
        if holder is not None:
            holder.log_odds -= holder.sightings.pop(key).odds
        return NOTHING

    def _forget(self) -> None:
        """Drop surfaces that were not seen again before they were sure."""
        horizon = self._flown_m - FORGET_M
        kept: list[Surface] = []
        for one in self.surfaces:
            if self._sure(one) or one.seen_m >= horizon:
                kept.append(one)
                continue
            for key in one.sightings:
                del self._holders[key]
        self.surfaces = kept

    def _sure(self, one: Surface) -> bool:
        spec, seen = self._spec, len(one.sightings) >= self._spec.least_keyframes
        return seen and one.log_odds >= spec.least_odds and one.lead >= spec.least_lead

    def confirmed(self) -> list[Surface]:
        """The surfaces that are sure enough for the map."""
        return [one for one in self.surfaces if self._sure(one)]


def smoothed(surface: Surface) -> tuple[Floats, Floats]:
    """States of a surface at all its sightings, by what is known of it in the end where that fits.

    Returns:
        States (k, 4), and the standard deviation of each curvature (k) [1/m].
    """
    seen = list(surface.sightings.values())
    place, state = np.array([one.position for one in seen]), np.array([one.state for one in seen])
    back = transported(np.repeat(surface.state[None], len(seen), 0), place - surface.position)
    fits = np.abs(back[:, 0] - state[:, 0]) < CONSISTENT_M
    sigma = np.where(fits, math.sqrt(surface.covariance[2, 2]), 0.3)
    out = np.where(fits[:, None], back, state)
    if not surface.sloped:
        out[:, 3] = 1.0
    return out, sigma
