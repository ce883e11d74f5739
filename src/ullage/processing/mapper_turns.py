"""A turn on the spot: each reflector keeps its range, so its bearing is told by how loud it is as the beam sweeps past.

The level of an echo follows the antenna's lobe about its bearing. Where a sensor stands off the axis of the turn its
range follows a cosine about the same bearing too. Both are fitted together over all headings that heard it. What is as
loud on all headings, as floor and ceiling are, or follows no lobe, has no bearing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from ullage.antenna import BoresightPattern
from ullage.arrays import Floats
from ullage.processing.mapper_looks import Look

Weighed = tuple[Floats, Floats, Floats]

FAST_M_RAD, SPOT_M = 0.5, 0.3  # way a turn on the spot makes in a step for its angle, and in all
LEAST_TURN_RAD, MOST_LOOKS = math.radians(120.0), 96
BEARINGS = np.radians(np.arange(-50.0, 50.1, 2.0))  # tried, from boresight
HEARD_RAD, SURE_RAD = np.radians(60.0), np.radians(30.0)
GATE_M, RANGE_SIGMA_M, LEVEL_SIGMA = 0.06, 0.012, 0.3
MISSED, CAPPED = 6.0, 9.0
MOST_SLIP_M = 0.02
LEAST_HEARD, LEAST_SPAN_RAD = 8, np.radians(36.0)
LEAST_BEND, MOST_SCATTER, OFF_PEAK_RAD = 0.6, 0.25, np.radians(12.0)
LEAST_FALL = 2 * MOST_SCATTER  # of the lobe over the angles received [neper]; an antenna without one gives no bearing
BEHIND_RAD, AS_LOUD, MOST_BEHIND = np.radians(70.0), math.log(10 ** (8 / 20)), 0.4
TRUST = 0.9


@dataclass(slots=True, eq=False)
class Stretch:
    """Looks of one sensor between which it turned much and moved little."""

    looks: list[Look] = field(default_factory=list)
    heading: list[float] = field(default_factory=list)  # unwrapped [rad]
    ended: bool = False

    @property
    def turned(self) -> bool:
        """Whether it is a turn on the spot rather than a corner of the way."""
        return max(self.heading) - min(self.heading) >= LEAST_TURN_RAD

    @property
    def open(self) -> bool:
        """Whether it may yet become one, or tell more."""
        return not self.ended and len(self.looks) < MOST_LOOKS


class Turns:
    """Finds the turns on the spot among each sensor's looks."""

    def __init__(self) -> None:
        self._last: dict[str, Stretch] = {}

    def hear(self, name: str, look: Look) -> Stretch:
        """The stretch to which a look belongs."""
        last, ahead = self._last.get(name), look.heard.axes[:2, 0]
        now = math.atan2(ahead[1], ahead[0])
        if last is not None:
            before = last.looks[-1].heard
            step = (now - last.heading[-1] + math.pi) % (2 * math.pi) - math.pi
            moved = float(np.linalg.norm(look.heard.position - before.position))
            all_ = float(np.linalg.norm(look.heard.position - last.looks[0].heard.position))
            if moved < FAST_M_RAD * abs(step) and all_ < SPOT_M and last.open:
                last.looks.append(look)
                last.heading.append(last.heading[-1] + step)
                return last
            last.ended = True
        self._last[name] = out = Stretch([look], [now])
        return out

    def end(self) -> None:
        """No look will come."""
        for one in self._last.values():
            one.ended = True


def bearings(look: Look, stretch: Stretch, pattern: BoresightPattern) -> tuple[Look, Weighed]:
    """A look of a turn on the spot, seen as one that flew across its boresight, and cosine, sigma, trust (k each).

    Args:
        look: one of the stretch.
        stretch: all looks of the turn so far.
        pattern: of the sensor's antenna.
    """
    mine = stretch.heading[next(k for k, one in enumerate(stretch.looks) if one is look)]
    heard = _gathered(stretch)
    count = len(look.echoes)
    cosine, sigma, trust = np.zeros(count), np.full(count, 1e3), np.zeros(count)
    for k, echo in enumerate(look.echoes):
        found = bearing_of(float(echo[0]), look.heard.position, mine, heard, pattern)
        if found is not None:
            cosine[k], sigma[k], trust[k] = math.sin(found[0] - mine), found[1], TRUST
    track = np.array([-math.sin(mine), math.cos(mine), 0.0])
    return replace(look, track=track, sharp=np.zeros_like(look.sharp)), (cosine, sigma, trust)


def _gathered(stretch: Stretch) -> tuple[Floats, Floats, Floats, Floats]:
    """Positions (n, 2), headings (n), ranges and log levels without spreading (n, e; infinite where there is none)."""
    most = max((len(one.echoes) for one in stretch.looks), default=0) or 1
    ranges, levels = np.full((2, len(stretch.looks), most), np.inf)
    for k, one in enumerate(stretch.looks):
        ranges[k, : len(one.echoes)] = one.echoes[:, 0]
        levels[k, : len(one.echoes)] = np.log(np.maximum(one.echoes[:, 5] * one.echoes[:, 0], 1e-30))
    at = np.array([one.heard.position[:2] for one in stretch.looks])
    return at, np.array(stretch.heading), ranges, levels


def bearing_of(
    reach: float,
    place: Floats,
    heading: float,
    heard: tuple[Floats, Floats, Floats, Floats],
    pattern: BoresightPattern,
) -> tuple[float, float] | None:
    """Bearing and its sigma [rad] of the reflector that a sensor at a place and heading heard at a range [m]."""
    at, headings, ranges, levels = heard
    tried = heading + BEARINGS
    way = np.stack([np.cos(tried), np.sin(tried)])
    off = (headings[None, :] - tried[:, None] + np.pi) % (2 * np.pi) - np.pi
    miss = ranges[None] - (reach - ((at - place[:2]) @ way).T)[:, :, None]
    nearest = np.argmin(abs(miss), axis=2)
    gap = np.take_along_axis(miss, nearest[:, :, None], 2)[:, :, 0]
    level = levels[np.arange(len(headings))[None, :], nearest]
    there = (abs(gap) < GATE_M) & (abs(off) < HEARD_RAD)
    flat = np.where(there, level + np.log(pattern.two_way_loss(np.cos(off))), np.nan)
    cost = np.full(len(tried), np.inf)
    for b in np.flatnonzero(there.sum(1) >= LEAST_HEARD):
        wrong = (flat[b] - np.nanmedian(flat[b])) / LEVEL_SIGMA
        each = np.where(there[b], np.minimum(wrong**2 + (gap[b] / RANGE_SIGMA_M) ** 2, CAPPED), 0.0)
        cost[b] = each[there[b]].sum() + MISSED * np.count_nonzero(~there[b] & (abs(off[b]) < SURE_RAD))
    best = int(np.argmin(cost))
    if not 0 < best < len(tried) - 1 or not np.isfinite(cost[best - 1 : best + 2]).all():
        return None
    mine = there[best]
    if np.std(gap[best, mine]) > MOST_SLIP_M or not _follows_lobe(off[best, mine], level[best, mine], pattern):
        return None
    aside = abs(off[best]) > BEHIND_RAD
    loud = (abs(gap[best]) < GATE_M) & (
        level[best] > np.median(level[best, mine & (abs(off[best]) < SURE_RAD)]) - AS_LOUD
    )
    if aside.sum() >= LEAST_HEARD and loud[aside].mean() > MOST_BEHIND:
        return None
    left, middle, right = cost[best - 1 : best + 2]
    step = float(BEARINGS[1] - BEARINGS[0])
    bend = max(left - 2 * middle + right, 1e-9)
    return float(tried[best] + step * 0.5 * (left - right) / bend), max(step * math.sqrt(2 / bend), 0.02)


def _follows_lobe(off: Floats, level: Floats, pattern: BoresightPattern) -> bool:
    """Whether log levels at angles from a bearing are highest there and fall on both sides about as the lobe does."""
    if np.ptp(off) < LEAST_SPAN_RAD or off.min() > -LEAST_SPAN_RAD / 4 or off.max() < LEAST_SPAN_RAD / 4:
        return False
    basis = np.stack([np.ones(len(off)), off, off**2], 1)
    loss = np.log(pattern.two_way_loss(np.cos(off)))
    if np.ptp(loss) < LEAST_FALL:
        return False
    fit, lobe = np.linalg.lstsq(basis, np.column_stack([level, -loss]), rcond=None)[0].T
    scatter = float(np.sqrt(np.mean((level - basis @ fit) ** 2)))
    bend = -float(fit[2])
    if bend <= 0 or abs(float(fit[1])) > 2 * bend * OFF_PEAK_RAD:
        return False
    return bool(bend > -LEAST_BEND * lobe[2] and scatter < MOST_SCATTER)
