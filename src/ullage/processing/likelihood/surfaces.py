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
from dataclasses import dataclass, field, replace

import numpy as np

from ullage.arrays import Bools, Floats
from ullage.processing.likelihood.echoes import Echoes
from ullage.processing.likelihood.lying import lying_share
from ullage.processing.likelihood.spec import LikelihoodSpec

STEPS = np.array([1e-4, 1e-5, 1e-4, 1e-4])  # of the numerical derivatives: m, rad, 1/m, cosine
NOISE = np.array([6e-4, math.radians(0.1), 0.015, 0.01])  # that a surface may bend in a keyframe: m, rad, 1/m, cosine
GROWTH = np.array([20.0, 20.0, 5.0, 5.0])  # of that variance, for each metre of track that did not see the surface
RANGE_GATE_M = 0.3  # a surface whose predicted range is less sure than this takes no echo
NEAREST_M = 0.2  # predicted ranges below it are behind the sensor
FOOT_M, VIEW_M = 0.05, 0.15  # a specular point seen from nearly the same place again replaces the earlier one
FORGET_M = 1.5  # track after which a surface that is not sure is forgotten
CONSISTENT_M = 0.03  # a smoothed range this near to the measured one replaces it
LYING_CONSISTENT_M = 0.1  # the same of lying cylinders, whose ranges change as the flight climbs
SAME_M, SAME_SHARE = 0.1, 0.5  # how well a lying cylinder predicts the ranges of a copy of it, and for how many
UNFIT_SIGMA = 0.3  # standard deviation of the curvature where it does not [1/m]
SLOPE, SLOPE_SIGMA = 0.85, 0.2  # cosine of the elevation of a slope, before any echo has shown it
FLAT = 0.05  # curvature that a plane may have [1/m]
LEAST_COSINE = 0.1  # bound of the cosine
MOST_BEHIND = 20.0  # nats by which a rival may be behind and still take an echo
WORST = 60.0  # bound on the squared distance that counts against a rival


UPRIGHT, SLOPED, LYING = range(3)  # rivals
RIVALS = 3
KNOWN_NATS = 3.0  # by which the other side of a known lying cylinder is preferred to an upright surface
BEND_SIGMA = 1.0  # prior standard deviation of the curvature of a lying cylinder [1/m]


@dataclass(frozen=True, slots=True)
class Sighting:
    """One keyframe's echo of a surface, with the state of the surface after it."""

    position: tuple[float, float]  # of the keyframe [m]
    state: tuple[float, float, float, float]  # range [m], bearing [rad], curvature [1/m], cosine of the elevation
    bearing_sigma: float  # of that bearing [rad]
    level: float  # amplitude times range, over the antenna's gain [m]
    nats: float
    share: float = 1.0  # of a full echo that the views of this place have counted
    odds: float = 0.0  # log-odds that they gave


NOTHING = Sighting((0.0, 0.0), (0.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, 0.0)


@dataclass(slots=True, eq=False)
class Surface:
    """A reflector: its state as seen from one place, how sure that is, and the keyframes that saw it."""

    position: Floats  # (2) that the states refer to [m]
    states: Floats  # (RIVALS, 4) range [m], bearing [rad], curvature [1/m], cosine of the elevation
    covariances: Floats  # (RIVALS, 4, 4)
    evidence: Floats  # (RIVALS) log-likelihood of each rival, with its prior
    log_odds: float = 0.0
    height_m: float = 0.0  # of the sensor at that place
    lead: float = 0.0  # of its direction over rivals on the rings about the track [nat]
    seen_m: float = 0.0  # track flown when it was last seen
    sightings: dict[tuple[int, ...], Sighting] = field(default_factory=dict)

    @property
    def best(self) -> int:
        """The better rival."""
        return int(np.argmax(self.evidence))

    @property
    def sloped(self) -> bool:
        """Whether its direction leaves the plane."""
        return self.best != UPRIGHT

    @property
    def lying(self) -> bool:
        """Whether it is a cylinder whose axis is level."""
        return self.best == LYING

    @property
    def kind(self) -> str:
        """Slope, lying cylinder, plane, edge (a centre of curvature at the surface) or cylinder."""
        range_m, _, curvature, _ = self.state
        doubt = 2 * math.sqrt(self.covariance[2, 2]) + FLAT
        if self.sloped:
            return "lying" if self.lying and abs(curvature) > doubt else "slope"
        if abs(curvature) < doubt:
            return "plane"
        return "edge" if abs(curvature - 1 / range_m) < doubt else "cylinder"

    @property
    def state(self) -> Floats:
        """State (4) of the better rival."""
        return np.asarray(self.states[self.best])

    @property
    def covariance(self) -> Floats:
        """Covariance (4, 4) of the better rival."""
        return np.asarray(self.covariances[self.best])


def transported(state: Floats, step: Floats, lying: Bools | None = None) -> Floats:
    """States (m, 4) as seen from places (m, 2) away [m].

    Args:
        state: from here.
        step: to there [m].
        lying: (m) which are cylinders with a level axis. Their cosine is below 0 where the step goes across the axis.
    """
    range_m, bearing, curvature, cosine = state.T
    c, s = np.cos(bearing), np.sin(bearing)
    along, across = step[:, 0] * c + step[:, 1] * s, step[:, 1] * c - step[:, 0] * s
    if lying is not None:
        across = np.where(lying, 0.0, across)
    ahead, aside = cosine - curvature * along, curvature * across
    size = np.maximum(np.sqrt(ahead**2 + aside**2 + np.maximum(1 - cosine**2, 0)), 1e-3)
    change = (curvature * (along**2 + across**2) - 2 * cosine * along) / (size + 1)
    level, turned = np.clip(np.hypot(ahead, aside) / size, LEAST_COSINE, 1.0), np.arctan2(aside, ahead)
    if lying is not None:
        level, turned = np.where(lying, ahead / size, level), np.where(lying, 0.0, turned)
    return np.stack([range_m + change, bearing - turned, curvature / size, level], axis=1)


def _jacobian(state: Floats, step: Floats, lying: Bools) -> Floats:
    """Derivatives (m, 4, 4) of the transported states by the states."""
    columns = [
        (
            transported(state + np.eye(4)[k] * STEPS[k], step, lying)
            - transported(state - np.eye(4)[k] * STEPS[k], step, lying)
        )
        / (2 * STEPS[k])
        for k in range(4)
    ]
    return np.stack(columns, axis=2)


def _share(track: Floats, state: Floats) -> Floats:
    """Share of the curvature of lying cylinders (m) that an aperture along a track shows."""
    along = track[0] * np.cos(state[:, 1]) + track[1] * np.sin(state[:, 1])
    return lying_share(np.minimum(np.abs(state[:, 3]), 1.0), along)


def _faced(state: Floats, covariance: Floats) -> None:
    """Turn the bearings (m) of lying cylinders round whose cosine is below 0; the arguments change."""
    behind = state[:, 3] < 0
    state[behind, 1] += np.pi
    state[behind, 3] *= -1
    covariance[behind, 3] *= -1
    covariance[behind, :, 3] *= -1


class SurfaceTracker:
    """Associates echoes with surfaces, refines these by a Kalman filter, and starts new ones."""

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
        free, through = np.ones(len(echoes), bool), (np.zeros((0, 4)), np.zeros((0, 4, 4)))
        if self.surfaces and len(echoes):
            predicted = self._predicted(echoes.position, echoes.height_m)
            through = self._through_axes(*predicted)
            for surface, echo, rivals in self._matches(echoes, *predicted):
                free[echo] = False
                surface.position, surface.height_m = echoes.position, echoes.height_m
                surface.states, surface.covariances = rivals[0], rivals[1]
                self._see(surface, echoes, echo, rivals[2])
        for echo in np.flatnonzero(free & (echoes.coherence >= self._spec.least_coherence)).tolist():
            surface = self._born(echoes, echo)
            self._known_cylinder(surface, echoes, echo, *through)
            self.surfaces.append(surface)
            self._see(surface, echoes, echo, np.zeros(RIVALS))
        self._forget()

    def _born(self, echoes: Echoes, echo: int) -> Surface:
        """A surface of one echo, with all rivals."""
        seen, noise = echoes.state[echo], echoes.covariance[echo]
        states, covariances = np.tile(seen, (RIVALS, 1)), np.tile(noise, (RIVALS, 1, 1))
        evidence = np.array([0.0, -self._spec.upright_nats, -self._spec.upright_nats])
        for rival, (cosine, sigma) in enumerate([(1.0, 1e-6), (SLOPE, SLOPE_SIGMA), (SLOPE, SLOPE_SIGMA)]):
            covariance = covariances[rival]
            apart, total = cosine - states[rival, 3], covariance[3, 3] + sigma**2
            evidence[rival] -= 0.5 * apart**2 / total + 0.5 * math.log(total)
            gain = covariance[:, 3] / total
            states[rival] += gain * apart
            covariances[rival] = covariance - np.outer(gain, covariance[3])
        states[UPRIGHT, 3] = 1.0
        states[SLOPED:, 3] = np.clip(states[SLOPED:, 3], LEAST_COSINE, 1.0)
        covariances[UPRIGHT, 3] = covariances[UPRIGHT, :, 3] = 0.0
        self._bend(echoes.track, states[LYING], covariances[LYING])
        return Surface(echoes.position, states, covariances, evidence, height_m=echoes.height_m, seen_m=self._flown_m)

    def _known_cylinder(self, surface: Surface, echoes: Echoes, echo: int, state: Floats, covariance: Floats) -> None:
        """Take the other side of a known lying cylinder as the lying rival of a new surface, where it fits the echo."""
        if not len(state):
            return
        shows = np.ones_like(state)
        shows[:, 2] = _share(echoes.track, state)
        apart = echoes.state[echo] - shows * state
        apart[:, 1] = (apart[:, 1] + np.pi) % (2 * np.pi) - np.pi
        total = shows[:, :, None] * covariance * shows[:, None] + echoes.covariance[echo]
        inverse = np.linalg.inv(total)
        distance = np.einsum("mi,mij,mj->m", apart, inverse, apart)
        best = int(np.argmin(distance))
        if distance[best] > self._spec.gate:
            return
        gain = covariance[best] @ (shows[best, :, None] * inverse[best])
        surface.states[LYING] = state[best] + gain @ apart[best]
        surface.states[LYING, 3] = min(surface.states[LYING, 3], 1.0)
        surface.covariances[LYING] = (np.eye(4) - gain * shows[best]) @ covariance[best]
        _faced(surface.states[LYING:], surface.covariances[LYING:])
        surface.evidence[LYING] = max(float(surface.evidence.max()), 0.0) + KNOWN_NATS

    def _bend(self, track: Floats, state: Floats, covariance: Floats) -> None:
        """Turn the curvature that an aperture along a track shows into that of a lying cylinder, with its prior."""
        share = _share(track, state[None])[0]
        total = share**2 * BEND_SIGMA**2 + covariance[2, 2]
        gain = share * BEND_SIGMA**2 / total
        state[2] *= gain
        covariance[2] *= gain
        covariance[:, 2] *= gain
        covariance[2, 2] = BEND_SIGMA**2 * (1 - share * gain)

    def _predicted(self, position: Floats, height_m: float) -> tuple[Floats, Floats]:
        """States (RIVALS s, 4) and covariances of the rivals of all surfaces as seen from a place.

        A climb changes the ranges of what is not level, and nothing tells whether its direction leads up or down.
        """
        state = np.concatenate([one.states for one in self.surfaces])
        step = np.repeat(position - np.stack([one.position for one in self.surfaces]), RIVALS, axis=0)
        unseen_m = np.repeat(self._flown_m - np.array([one.seen_m for one in self.surfaces]), RIVALS)
        lying = np.tile(np.arange(RIVALS) == LYING, len(self.surfaces))
        jacobian = _jacobian(state, step, lying)
        covariance = jacobian @ np.concatenate([one.covariances for one in self.surfaces]) @ jacobian.transpose(0, 2, 1)
        growth = NOISE**2 * self._spec.process_noise * (1 + unseen_m[:, None] * GROWTH)
        growth[UPRIGHT::RIVALS, 3] = 0.0
        climb = np.repeat(height_m - np.array([one.height_m for one in self.surfaces]), RIVALS)
        growth[:, 0] += climb**2 * np.maximum(1 - state[:, 3] ** 2, 0.0)
        covariance[:, range(4), range(4)] += growth
        state = transported(state, step, lying)
        state[UPRIGHT::RIVALS, 3] = 1.0
        covariance[UPRIGHT::RIVALS, 3] = covariance[UPRIGHT::RIVALS, :, 3] = 0.0
        _faced(state[LYING::RIVALS], covariance[LYING::RIVALS])
        return state, covariance

    def known(self, position: Floats) -> Floats:
        """States of the surfaces of several sightings as seen from a place (3).

        Returns:
            (s, 6) states, 1 for lying cylinders, and nats by which another rival of the same surface is ahead.
        """
        if not self.surfaces:
            return np.zeros((0, 6))
        state, covariance = self._predicted(position[:2], float(position[2]))
        evidence = np.stack([one.evidence for one in self.surfaces])
        best = evidence.max(axis=1, keepdims=True)
        offered = evidence == best
        offered[:, LYING] |= evidence[:, LYING] > best[:, 0] - MOST_BEHIND
        offered &= np.array([len(one.sightings) >= self._spec.least_keyframes for one in self.surfaces])[:, None]
        lying = np.tile(np.arange(RIVALS) == LYING, len(self.surfaces))
        near = (state[:, 0] > NEAREST_M) & (covariance[:, 0, 0] < RANGE_GATE_M**2) & offered.ravel()
        known = np.column_stack([state, lying, (best - evidence).ravel()])[near]
        through, _ = self._through_axes(state, covariance)
        return np.concatenate([known, np.column_stack([through, np.ones(len(through)), np.zeros(len(through))])])

    def _through_axes(self, state: Floats, covariance: Floats) -> tuple[Floats, Floats]:
        """States (m, 4) and covariances of the other sides of lying cylinders: their echoes come through the axis.

        Args:
            state: as of `_predicted`.
            covariance: as of `_predicted`.
        """
        sure = [one.lying and len(one.sightings) >= self._spec.least_keyframes for one in self.surfaces]
        near, spread = state[LYING::RIVALS][sure], covariance[LYING::RIVALS][sure]
        bent = np.abs(near[:, 2]) > 2 * np.sqrt(spread[:, 2, 2]) + FLAT
        near, spread = near[bent], spread[bent]
        other = near * [1.0, 1.0, -1.0, 1.0] + [0.0, np.pi, 0.0, 0.0]
        other[:, 0] -= 2 / near[:, 2]
        turn = np.tile(np.diag([1.0, 1.0, -1.0, 1.0]), (len(near), 1, 1))
        turn[:, 0, 2] = 2 / near[:, 2] ** 2
        spread = turn @ spread @ turn.transpose(0, 2, 1)
        met = (other[:, 0] > NEAREST_M) & (spread[:, 0, 0] < RANGE_GATE_M**2)
        return other[met], spread[met]

    def _matches(
        self, echoes: Echoes, state: Floats, covariance: Floats
    ) -> list[tuple[Surface, int, tuple[Floats, Floats, Floats]]]:
        """Pairs of surfaces and echoes, most likely first, with states, covariances and evidence of the rivals.

        Args:
            echoes: of one keyframe.
            state: as of `_predicted`.
            covariance: as of `_predicted`.
        """
        shows = np.ones_like(state)  # of a lying cylinder an echo shows part of the curvature only
        shows[LYING::RIVALS, 2] = _share(echoes.track, state[LYING::RIVALS])
        apart = echoes.state[None] - (shows * state)[:, None]
        apart[..., 1] = (apart[..., 1] + np.pi) % (2 * np.pi) - np.pi
        total = (shows[:, :, None] * covariance * shows[:, None])[:, None] + echoes.covariance[None]
        inverse = np.linalg.inv(total)
        distance = np.einsum("sei,seij,sej->se", apart, inverse, apart)
        wider = np.linalg.det(total) / np.linalg.det(echoes.covariance)
        distance += np.where(wider > 0, np.log(np.maximum(wider, 1e-30)), np.inf)  # rounding may spoil a covariance
        possible = (state[:, 0] >= NEAREST_M)[:, None] & (total[..., 0, 0] <= RANGE_GATE_M**2)
        behind = np.stack([one.evidence.max() - one.evidence for one in self.surfaces]).reshape(-1, 1)
        whole = np.where(possible & (distance <= self._spec.gate), distance + 2 * behind, np.inf)
        best = whole.reshape(-1, RIVALS, len(echoes)).min(axis=1)
        out: list[tuple[Surface, int, tuple[Floats, Floats, Floats]]] = []
        taken = np.zeros(len(self.surfaces), bool), np.zeros(len(echoes), bool)
        for flat in np.argsort(best, axis=None, kind="stable"):
            s, e = divmod(int(flat), len(echoes))
            if best[s, e] > self._spec.gate + 2 * MOST_BEHIND:
                break
            if taken[0][s] or taken[1][e]:
                continue
            taken[0][s] = taken[1][e] = True
            mine = slice(RIVALS * s, RIVALS * s + RIVALS)
            gain = covariance[mine] @ (shows[mine, :, None] * inverse[mine, e])
            new = state[mine] + (gain @ apart[mine, e, :, None])[..., 0]
            new[SLOPED, 3] = min(max(new[SLOPED, 3], LEAST_COSINE), 1.0)
            new[LYING, 3] = min(max(new[LYING, 3], -1.0), 1.0)
            left = (np.eye(4) - gain * shows[mine, None]) @ covariance[mine]
            _faced(new[LYING:], left[LYING:])
            out.append((self.surfaces[s], e, (new, left, -0.5 * np.minimum(distance[mine, e], WORST))))
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
        sigma = math.sqrt(surface.covariance[1, 1])
        counted = before.share + share, before.odds + gained
        surface.sightings[key] = Sighting((x, y), state, sigma, float(echoes.level[echo]), nats, *counted)

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
        return merged([one for one in self.surfaces if self._sure(one)])


def merged(surfaces: list[Surface]) -> list[Surface]:
    """Surfaces with those merged into lying cylinders whose ranges these predict.

    A flight along the axis shows no elevation, so a lying cylinder may begin as an upright wall or as a slope.
    """
    out, gone = list(surfaces), set()
    order = sorted(range(len(out)), key=lambda index: -len(out[index].sightings))
    for place, index in enumerate(order):
        if out[index].kind != "lying" or index in gone:  # one whose bend is open predicts ranges of level walls too
            continue
        for other in order[place + 1 :]:
            fits = [] if other in gone else _explained(out[index], surfaces[other])
            if len(fits) > SAME_SHARE * len(surfaces[other].sightings):
                taken = {key: surfaces[other].sightings[key] for key in fits}
                out[index] = replace(out[index], sightings={**out[index].sightings, **taken})
                gone.add(other)
    return [one for index, one in enumerate(out) if index not in gone]


def _explained(surface: Surface, other: Surface) -> list[tuple[int, ...]]:
    """Sightings of another surface whose ranges a lying cylinder predicts."""
    place = np.array([one.position for one in other.sightings.values()])
    range_m = np.array([one.state[0] for one in other.sightings.values()])
    state = np.repeat(surface.state[None], len(place), 0)
    there = transported(state, place - surface.position, np.ones(len(place), bool))
    near = np.abs(there[:, 0] - range_m) < SAME_M
    return [key for key, fits in zip(other.sightings, near, strict=True) if fits]


def smoothed(surface: Surface) -> tuple[Floats, Floats]:
    """States of a surface at all its sightings, by what is known of it in the end where that fits.

    Else they are as they were at the time of the sighting.

    Returns:
        States (k, 4), and the standard deviations (2, k) of curvature [1/m] and bearing [rad].
    """
    seen = list(surface.sightings.values())
    place, state = np.array([one.position for one in seen]), np.array([one.state for one in seen])
    lying = np.full(len(seen), surface.lying)
    back = transported(np.repeat(surface.state[None], len(seen), 0), place - surface.position, lying)
    back[:, 1] += np.where(back[:, 3] < 0, np.pi, 0.0)
    back[:, 3] = np.abs(back[:, 3])
    fits = np.abs(back[:, 0] - state[:, 0]) < (LYING_CONSISTENT_M if surface.lying else CONSISTENT_M)
    now = np.sqrt(np.diag(surface.covariance))[[2, 1], None]
    then = np.array([(UNFIT_SIGMA, one.bearing_sigma) for one in seen]).T
    sigma = np.where(fits, now, then)
    out = np.where(fits[:, None], back, state)
    if not surface.sloped:
        out[:, 3] = 1.0
    return out, sigma
