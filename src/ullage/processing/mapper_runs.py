"""On a plane, echoes followed from look to look: over a metre the ranges tell a wall from an edge, and where it is.

Along a track a wall's range falls evenly, that of an edge, a pole or a corner along a hyperbola. A look's own window is
too short to tell them apart beyond a few metres, and its bearing is wrong by more than its scatter where two echoes
overlap; the same echo a metre before and after is not so easily mistaken.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ullage.arrays import Bools, Floats
from ullage.processing.mapper_looks import Look, lit_ways

LINK_M, LINK_PATH_M, LINK_NS = 0.05, 0.25, 1_000_000_000
LINK_COSINE, LOUDER = 0.3, 5.0
MOST_ECHOES, LEAST_ECHOES, LEAST_SPAN_M = 49, 9, 0.4
REACH_M = 1.2
ROUNDS, OUTLIER_M, VAGUE_RAD = 6, 0.012, 0.3
RANGE_SIGMA_M = 0.006
TOLD_APART, FITS_M, LEAST_TRUST, SURE = 0.7, 0.012, 0.3, 0.93
OTHER_SIDE, OTHER_SIDE_M = 2.0, 0.002


@dataclass(slots=True, eq=False)
class Run:
    """The echoes of one reflector."""

    t_ns: list[int] = field(default_factory=list)
    rows: list[tuple[float, ...]] = field(default_factory=list)  # position x, y, range [m], height, boresight x, y
    last: tuple[Floats, Floats, float, float, float] | None = None  # position, track, range, cosine, height

    def miss(self, at: Floats, track: Floats, echo: tuple[float, float, float, float]) -> float:
        """By how much a range misses what this one's is by now, infinite where it cannot be the same [m]."""
        if self.last is None:
            return np.inf
        here, way, reach, cosine, height = self.last
        turn = float(np.sign(track @ way))
        if abs(echo[1] * turn - cosine) > LINK_COSINE + 2 * echo[2]:
            return np.inf
        if not 1 / LOUDER < echo[3] / max(height, 1e-30) < LOUDER:
            return np.inf
        middle = 0.5 * (cosine + echo[1] * turn)
        return abs(echo[0] - reach + middle * float(way @ (at - here)))


class EchoRuns:
    """Follows the echoes of each sensor on a plane."""

    def __init__(self) -> None:
        self._open: dict[str, list[Run]] = {}

    def follow(self, name: str, look: Look, cosine: Floats, sigma: Floats, trust: Floats) -> list[Run]:
        """The run to which each echo of a look belongs, in their order."""
        here, now, ahead = look.heard.position, look.heard.t_ns, look.heard.axes[:2, 0].tolist()
        held = [
            one
            for one in self._open.get(name, [])
            if one.last is not None and now - one.t_ns[-1] < LINK_NS
            and np.linalg.norm(here - one.last[0]) < LINK_PATH_M
        ]  # fmt: skip
        free, out = list(held), [Run() for _ in cosine]
        for k in np.argsort(-trust):
            reach, height = float(look.echoes[k, 0]), float(look.echoes[k, 5])
            misses = [one.miss(here, look.track, (reach, cosine[k], sigma[k], height)) for one in free]
            if misses and min(misses) < LINK_M:
                out[k] = free.pop(int(np.argmin(misses)))
            else:
                held.append(out[k])
            run = out[k]
            run.t_ns.append(now)
            run.rows.append((float(here[0]), float(here[1]), reach, height, *ahead))
            run.last = here, look.track, reach, float(cosine[k]), height
            del run.t_ns[: -2 * MOST_ECHOES], run.rows[: -2 * MOST_ECHOES]
        self._open[name] = held
        return out


def edges_among(
    look: Look, weighed: tuple[Floats, Floats, Floats], runs: list[Run], least: float
) -> tuple[tuple[Floats, Floats, Floats], Bools]:
    """Cosine, sigma and trust of a look's echoes, mended for those that their runs show to be edges; and which are.

    A wall's echo keeps what its own window said: its bearing is as good there, and its Fresnel zone is wide anyway.

    Args:
        look: a look that has waited until its echoes went on.
        weighed: cosine to the track, its sigma and the chance that it is true (k each).
        runs: the run of each echo.
        least: cosine to boresight in which echoes are looked for.
    """
    cosine, sigma, trust = weighed
    way, doubt = np.zeros((len(runs), 2)), np.zeros(len(runs))
    found = np.zeros(len(runs), bool)
    at, use = _along(look, runs)
    span = np.hypot(*np.ptp(at[:, :, :2], axis=1).T)
    owner, start = [], []
    for k in np.flatnonzero((use.sum(1) >= LEAST_ECHOES) & (span >= LEAST_SPAN_M) & (trust > LEAST_TRUST)):
        for lit in lit_ways(look.heard.axes, look.track, float(np.clip(cosine[k], -1, 1)), least):
            owner.append(k)
            start.append(lit[:2])
    if not owner:
        return weighed, found
    mine, begin = np.array(owner), np.array(start)
    reach = look.echoes[mine, 0]
    walls = fit_walls(at[mine], use[mine], reach, begin)
    ways, doubts, edges = fit_edges(at[mine], use[mine], reach, begin)
    for k in np.unique(mine):
        rows = np.flatnonzero(mine == k)
        best = rows[np.argmin(edges[rows])]
        either = np.minimum(walls[rows], edges[rows])
        one_side = len(rows) == 1 or either.max() > OTHER_SIDE * either.min() + OTHER_SIDE_M
        found[k] = one_side and edges[best] < min(TOLD_APART * walls[rows].min(), FITS_M)
        way[k], doubt[k] = ways[best], doubts[best]
    turn = way @ look.track[:2]
    turn, doubt = np.where(found, turn, cosine), np.where(found, np.minimum(sigma, doubt), sigma)
    return (turn, doubt, np.where(found, np.maximum(trust, SURE), trust)), found


def _along(look: Look, runs: list[Run]) -> tuple[Floats, Floats]:
    """Positions from the look's own and ranges (k, n, 3) of each echo's run near it, and which of them are there."""
    at, use = np.zeros((len(runs), MOST_ECHOES, 3)), np.zeros((len(runs), MOST_ECHOES))
    for k, run in enumerate(runs):
        rows = near(run, look)
        at[k, : len(rows)], use[k, : len(rows)] = rows[:, :3], 1
    return at, use


def near(run: Run, look: Look) -> Floats:
    """Position from a look's own, range [m], height and boresight (n, 6) of its run's echoes within 1.2 m of it."""
    if look.heard.t_ns not in run.t_ns:
        return np.zeros((0, 6))
    middle, half = run.t_ns.index(look.heard.t_ns), MOST_ECHOES // 2
    rows = np.array(run.rows[max(middle - half, 0) : middle + half + 1])
    rows[:, :2] -= look.heard.position[:2]
    return np.asarray(rows[np.hypot(rows[:, 0], rows[:, 1]) < REACH_M])


def fit_walls(at: Floats, use: Floats, reach: Floats, start: Floats) -> Floats:
    """Scatter (k) of ranges about the wall that explains them best [m].

    Args:
        at: positions from the look's own, and ranges (k, n, 3) [m].
        use: 1 where there is one (k, n).
        reach: range of the look's echo (k) [m].
        start: unit vector to it (k, 2), roughly known.
    """
    prior = np.arctan2(start[:, 1], start[:, 0])
    angle, offset = prior.copy(), reach.copy()
    x, y, r = np.moveaxis(at, 2, 0)
    for turn in range(ROUNDS):
        c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
        miss = r - offset[:, None] + c * x + s * y
        slope = s * x - c * y
        weight = use / (1 + (miss / (OUTLIER_M * (4 if turn < 2 else 1))) ** 2) / RANGE_SIGMA_M**2
        a, b, d = (weight * slope**2).sum(1) + 1 / VAGUE_RAD**2, (weight * slope).sum(1), weight.sum(1)
        u, v = (weight * slope * miss).sum(1) - (angle - prior) / VAGUE_RAD**2, (weight * miss).sum(1)
        det = np.maximum(a * d - b * b, 1e-12)
        angle, offset = angle + np.clip((d * u - b * v) / det, -0.2, 0.2), offset + (a * v - b * u) / det
    return scatter_of(r - offset[:, None] + np.cos(angle)[:, None] * x + np.sin(angle)[:, None] * y, use)


def fit_edges(at: Floats, use: Floats, reach: Floats, start: Floats) -> tuple[Floats, Floats, Floats]:
    """Unit vector (k, 2) to the upright edge or pole that explains ranges best, its sigma [rad], their scatter [m]."""
    prior = reach[:, None] * start
    place = prior.copy()
    x, y, r = np.moveaxis(at, 2, 0)
    weak = 1 / (VAGUE_RAD * reach) ** 2
    for turn in range(ROUNDS):
        u, v = place[:, :1] - x, place[:, 1:] - y
        away = np.maximum(np.hypot(u, v), 1e-3)
        miss, u, v = r - away, u / away, v / away
        weight = use / (1 + (miss / (OUTLIER_M * (4 if turn < 2 else 1))) ** 2) / RANGE_SIGMA_M**2
        a, b, d = (weight * u * u).sum(1) + weak, (weight * u * v).sum(1), (weight * v * v).sum(1) + weak
        held = weak[:, None] * (prior - place)
        p, q = (weight * u * miss).sum(1) + held[:, 0], (weight * v * miss).sum(1) + held[:, 1]
        det = np.maximum(a * d - b * b, 1e-12)
        place = place + np.stack([(d * p - b * q) / det, (a * q - b * p) / det], 1)
    miss = r - np.hypot(place[:, :1] - x, place[:, 1:] - y)
    far = np.maximum(np.hypot(*place.T), 1e-3)
    way = place / far[:, None]
    cross = a * way[:, 1] ** 2 - 2 * b * way[:, 0] * way[:, 1] + d * way[:, 0] ** 2
    return way, 1 / np.sqrt(np.maximum(cross, 1e-9)) / far, scatter_of(miss, use)


def scatter_of(miss: Floats, use: Floats) -> Floats:
    """Robust scatter (k) of residuals: the root of their mean capped square [m]."""
    return np.asarray(np.sqrt((use * np.minimum(miss**2, 9 * OUTLIER_M**2)).sum(1) / np.maximum(use.sum(1) - 2, 1)))
