"""Surfaces as hypotheses: each explains the echoes of all keyframes that fit its range, bearing and curvature.

Every smooth reflector that a monostatic radar sees lies about a centre of curvature. Seen from one place its state is
the range to the specular point, the bearing to it, and the curvature of the range across that bearing: 0 for a flat
wall, 1 / range for an edge or pole, less than 0 inside a round tank, less than 1 / range for a pillar. From the state
at one place follows that at any other place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ullage.arrays import Floats
from ullage.processing.likelihood.echoes import Echoes
from ullage.processing.likelihood.spec import LikelihoodSpec

STEPS = np.array([1e-4, 1e-5, 1e-4])  # of the numerical derivatives: m, rad, 1/m
NOISE = np.array([6e-4, math.radians(0.1), 0.015])  # that a surface may bend in a keyframe: m, rad, 1/m
RANGE_GATE_M = 0.3  # a surface whose predicted range is less sure than this takes no echo
NEAREST_M = 0.2  # predicted ranges below it are behind the sensor
FOOT_M, VIEW_M = 0.05, 0.15  # a specular point seen from nearly the same place again replaces the earlier one
FORGET_M = 1.5  # track after which a surface of few echoes is forgotten
CONSISTENT_M = 0.03  # a smoothed range this near to the measured one replaces it


@dataclass(frozen=True, slots=True)
class Sighting:
    """One keyframe's echo of a surface, with the state of the surface after it."""

    position: tuple[float, float]  # of the keyframe [m]
    state: tuple[float, float, float]  # range [m], bearing [rad], curvature [1/m]
    level: float  # amplitude times range, over the antenna's gain [m]
    nats: float


@dataclass(slots=True, eq=False)
class Surface:
    """A reflector: its state as seen from one place, how sure that is, and the keyframes that saw it."""

    position: Floats  # (2) that the state refers to [m]
    state: Floats  # (3) range [m], bearing [rad], curvature [1/m]
    covariance: Floats  # (3, 3)
    log_odds: float = 0.0
    seen_m: float = 0.0  # track flown when it was last seen
    sightings: dict[tuple[int, ...], Sighting] = field(default_factory=dict)

    @property
    def centre(self) -> Floats:
        """Centre of curvature (2) [m]; not finite for a flat wall."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(
                self.position + np.array([math.cos(self.state[1]), math.sin(self.state[1])]) / self.state[2]
            )


def transported(state: Floats, step: Floats) -> Floats:
    """States (m, 3) as seen from places (m, 2) away [m]."""
    range_m, bearing, curvature = state.T
    c, s = np.cos(bearing), np.sin(bearing)
    along, across = step[:, 0] * c + step[:, 1] * s, step[:, 1] * c - step[:, 0] * s
    ahead = 1 - curvature * along
    size = np.maximum(np.hypot(ahead, curvature * across), 1e-3)
    change = (curvature * (along**2 + across**2) - 2 * along) / (size + 1)
    return np.stack([range_m + change, bearing - np.arctan2(curvature * across, ahead), curvature / size], axis=1)


def _jacobian(state: Floats, step: Floats) -> Floats:
    """Derivatives (m, 3, 3) of the transported states by the states."""
    columns = [
        (transported(state + np.eye(3)[k] * STEPS[k], step) - transported(state - np.eye(3)[k] * STEPS[k], step))
        / (2 * STEPS[k])
        for k in range(3)
    ]
    return np.stack(columns, axis=2)


class SurfaceTracker:
    """Associates echoes with surfaces, refines these by an information filter, and starts new ones."""

    def __init__(self, spec: LikelihoodSpec) -> None:
        self._spec = spec
        self.surfaces: list[Surface] = []
        self._flown_m = 0.0
        self._last: Floats | None = None

    def update(self, echoes: Echoes) -> None:
        """Take the echoes of one keyframe."""
        if self._last is not None:
            self._flown_m += float(np.linalg.norm(echoes.position - self._last))
        self._last = echoes.position
        free = np.ones(len(echoes), bool)
        if self.surfaces and len(echoes):
            for surface, echo, state, covariance in self._matches(echoes):
                free[echo] = False
                surface.position, surface.state, surface.covariance = echoes.position, state, covariance
                self._see(surface, echoes, echo)
        for echo in np.flatnonzero(free & (echoes.coherence >= self._spec.least_coherence)).tolist():
            surface = Surface(echoes.position, echoes.state[echo], echoes.covariance[echo], seen_m=self._flown_m)
            self.surfaces.append(surface)
            self._see(surface, echoes, echo)
        self._forget()

    def _predicted(self, position: Floats) -> tuple[Floats, Floats]:
        """States and covariances of all surfaces as seen from a place."""
        state = np.stack([one.state for one in self.surfaces])
        step = position - np.stack([one.position for one in self.surfaces])
        unseen_m = self._flown_m - np.array([one.seen_m for one in self.surfaces])
        jacobian = _jacobian(state, step)
        covariance = jacobian @ np.stack([one.covariance for one in self.surfaces]) @ jacobian.transpose(0, 2, 1)
        growth = self._spec.process_noise * (1 + unseen_m[:, None] * [20.0, 20.0, 5.0])
        covariance[:, range(3), range(3)] += NOISE**2 * growth
        return transported(state, step), covariance

    def known(self, position: Floats) -> Floats:
        """States (s, 3) of the surfaces of several sightings as seen from a place (2)."""
        if not self.surfaces:
            return np.zeros((0, 3))
        state, covariance = self._predicted(position)
        sure = np.array([len(one.sightings) >= self._spec.least_keyframes for one in self.surfaces])
        return state[sure & (state[:, 0] > NEAREST_M) & (covariance[:, 0, 0] < RANGE_GATE_M**2)]

    def _matches(self, echoes: Echoes) -> list[tuple[Surface, int, Floats, Floats]]:
        """Pairs of surfaces and echoes, most likely first, with the states after them."""
        state, covariance = self._predicted(echoes.position)
        apart = echoes.state[None] - state[:, None]
        apart[..., 1] = (apart[..., 1] + np.pi) % (2 * np.pi) - np.pi
        total = covariance[:, None] + echoes.covariance[None]
        inverse = np.linalg.inv(total)
        distance = np.einsum("sei,seij,sej->se", apart, inverse, apart)
        distance += np.log(np.linalg.det(total) / np.linalg.det(echoes.covariance))
        distance[(state[:, 0] < NEAREST_M)[:, None] | (total[..., 0, 0] > RANGE_GATE_M**2)] = np.inf
        out: list[tuple[Surface, int, Floats, Floats]] = []
        taken = np.zeros(len(self.surfaces), bool), np.zeros(len(echoes), bool)
        for flat in np.argsort(distance, axis=None, kind="stable"):
            s, e = divmod(int(flat), len(echoes))
            if distance[s, e] > self._spec.gate:
                break
            if taken[0][s] or taken[1][e]:
                continue
            taken[0][s] = taken[1][e] = True
            gain = covariance[s] @ inverse[s, e]
            new = state[s] + gain @ apart[s, e]
            out.append((self.surfaces[s], e, new, (np.eye(3) - gain) @ covariance[s]))
        return out

    def _see(self, surface: Surface, echoes: Echoes, echo: int) -> None:
        """Count an echo for a surface; views that share frames count in part."""
        spec = self._spec
        fresh = min((self._flown_m - surface.seen_m) / spec.dependence_m + 0.1, 1.0) if surface.sightings else 1.0
        nats = float(echoes.nats[echo])
        surface.log_odds += fresh * (nats - spec.echo_cost)
        surface.seen_m = self._flown_m
        range_m, bearing, curvature = (float(value) for value in surface.state)
        x, y = (float(value) for value in echoes.position)
        foot = x + range_m * math.cos(bearing), y + range_m * math.sin(bearing)
        key = (*(round(value / FOOT_M) for value in foot), *(round(value / VIEW_M) for value in (x, y)))
        surface.sightings[key] = Sighting((x, y), (range_m, bearing, curvature), float(echoes.level[echo]), nats)

    def _forget(self) -> None:
        """Drop surfaces of few echoes that were not seen again."""
        least, horizon = self._spec.least_keyframes, self._flown_m - FORGET_M
        self.surfaces = [one for one in self.surfaces if len(one.sightings) >= least or one.seen_m >= horizon]

    def confirmed(self) -> list[Surface]:
        """The surfaces that are sure enough for the map."""
        spec = self._spec
        return [
            one
            for one in self.surfaces
            if len(one.sightings) >= spec.least_keyframes and one.log_odds >= spec.least_odds
        ]


def smoothed(surface: Surface) -> tuple[Floats, Floats]:
    """States of a surface at all its sightings, by what is known of it in the end where that fits.

    Returns:
        States (k, 3), and the standard deviation of each curvature (k) [1/m].
    """
    seen = list(surface.sightings.values())
    place, state = np.array([one.position for one in seen]), np.array([one.state for one in seen])
    back = transported(np.repeat(surface.state[None], len(seen), 0), place - surface.position)
    fits = np.abs(back[:, 0] - state[:, 0]) < CONSISTENT_M
    sigma = np.where(fits, math.sqrt(surface.covariance[2, 2]), 0.3)
    return np.where(fits[:, None], back, state), sigma
