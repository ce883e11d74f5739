"""Scatterers that stay coherent along a track, as places in the world and on maps.

A single profile hides a weak reflector in clutter. Along a track of many wavelengths its phase follows its range, and
nothing else does by chance. Only frames whose poses are known to match their phases can show this: those that
`ul.calibrate` has put on a track.

Each recording sets its own threshold. Surrogates of it keep the spectrum along the track in every range bin and the
relation between range bins, but have random phases [Theiler1992]: clutter stays as strong and as slow, and no echo
follows the track. The highest log-likelihoods found in surrogates have an exponential tail [Coles2001, ch. 4]. It
gives the probability that clutter alone reaches a log-likelihood.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ullage import checks
from ullage.arrays import Floats
from ullage.data import Frames
from ullage.errors import InputError
from ullage.grids import OccupancyMap
from ullage.processing.baseband import as_baseband
from ullage.processing.point_focus import Point, PointFocus

PFA = 0.01
"""Probability that the clutter of a recording alone gives one scatterer or more."""
SURROGATES, PEAKS = 4, 5  # recordings that the tail is taken from, and how many peaks of each on average
LEAST_POSES = 8
PRIOR = -3.5  # log-odds that a cell of which nothing is known is occupied
LEAST_CHANCE = 1e-12  # the tail is not believed farther
MOST_LOG_ODDS = 6.9  # of what a map holds in whole per cent
LEVEL_RAD = 0.1  # steepest straight track whose scatterers are moved to a chosen height


@dataclass(frozen=True, slots=True, eq=False)
class Scatterer:
    """A place that the radar received from coherently."""

    place: Floats  # (3) world [m]
    gain: float  # log-likelihood of a steady point over noise
    height_known: bool  # False: the track is straight, and the height was assumed
    chance: float = PFA  # probability that clutter alone gives so high a log-likelihood anywhere
    in_front: bool = True  # of the antenna, where it is received best


@dataclass(frozen=True, slots=True)
class Tail:
    """How high the log-likelihoods of clutter reach: peaks over a level, with an exponential tail."""

    level: float  # exceeded by PEAKS peaks of a recording on average
    excess: float  # mean excess over the level

    def chance(self, gain: float) -> float:
        """Probability that one peak of clutter or more reaches this log-likelihood."""
        if self.excess <= 0:
            return LEAST_CHANCE if gain > self.level else 1.0
        return float(max(-np.expm1(-PEAKS * np.exp(-max(gain - self.level, 0.0) / self.excess)), LEAST_CHANCE))


def find_scatterers(
    frames: Frames, *, z_m: float | None = None, pfa: float = PFA, everywhere: bool = False
) -> list[Scatterer]:
    """Find the places that reflect coherently along a calibrated track, best first.

    A track that turns or climbs gives places in three dimensions. A straight one leaves a circle about the track; the
    place on it at height `z_m` in front of the antenna is given. Places behind the antenna are left out.

    Args:
        frames: with poses whose clock and range offset are right, and without the radar's own echo.
        z_m: height of scatterers seen from a straight track [m]; None: the height of the track.
        pfa: probability that the clutter of this recording alone gives one scatterer or more.
        everywhere: keep places behind the antenna, where the track is not straight.

    Raises:
        InputError: `pfa` is not between 0 and 1.
    """
    if not 0 < checks.number("pfa", pfa, "find_scatterers", allowed="between 0 and 1") < 1:
        raise InputError(f"pfa is {pfa}", where="find_scatterers", allowed="between 0 and 1")
    frames = as_baseband(frames)  # removes noise outside the band
    focus = PointFocus(frames, frames.believed, 0.0)
    points = _points(focus) if len(focus.t_s) >= LEAST_POSES else []
    if not points:
        return []
    tail = clutter_tail(focus)
    path, ahead = focus.path(0.0), _boresight(frames, focus.t_s)
    spread = np.linalg.svd(path - path.mean(0), compute_uv=False) / np.sqrt(len(path))
    straight = bool(spread[1] < focus.wave_m)
    out = []
    for point in points:
        place = _on_circle(point.place, path, ahead.mean(0), z_m) if straight else point.place
        chance = tail.chance(point.gain)
        if chance > pfa or place is None:
            continue
        in_front = _in_front(place, point.amplitude, path, ahead)
        if everywhere or in_front:
            out.append(Scatterer(place, point.gain, not straight, chance, in_front))
    return out


def with_scatterers(omap: OccupancyMap, found: Sequence[Scatterer]) -> OccupancyMap:
    """Add the evidence of scatterers to their cells: log-odds of -ln(chance) to what the map holds.

    Cells of which nothing is known start from 3 % (log-odds of -3.5), and so do cells freed by silence, which the same
    frames showed. Cells that the vehicle flew through need stronger evidence. A plane shows scatterers of every height,
    a volume those of known height.

    Args:
        omap: of the other echoes.
        found: the scatterers.
    """
    shown = [one for one in found if omap.grid.dims == 2 or one.height_known]
    if not shown:
        return omap
    percent = np.array(omap.percent)
    index, inside = omap.grid.index(np.array([one.place for one in shown]))
    for one, cell, there in zip(shown, map(tuple, index), inside, strict=True):
        if there:
            share = percent[cell] / 100
            held = float(np.log(max(share, 1e-9) / max(1 - share, 1e-9)))
            held = held if share == 0 else max(held, PRIOR)  # 0: flown through; below 0: unknown
            odds = np.clip(held, -MOST_LOG_ODDS, MOST_LOG_ODDS) - np.log(one.chance)
            percent[cell] = round(100 / (1 + float(np.exp(-odds))))
    return OccupancyMap(omap.grid, percent, omap.method, omap.occupied_from, omap.free_to, surfaces=omap.surfaces)


def clutter_tail(focus: PointFocus, *, surrogates: int = SURROGATES) -> Tail:
    """The tail of the log-likelihoods that this recording's clutter reaches, from surrogates of it."""
    gains = [point.gain for seed in range(surrogates) for point in _points(_surrogate(focus, seed))]
    count = surrogates * PEAKS
    high = np.sort(np.concatenate([gains, np.zeros(count + 1)]))[::-1]
    return Tail(float(high[count]), float(np.mean(high[:count] - high[count])))


def _points(focus: PointFocus) -> list[Point]:
    """The points that focus, each echo once, highest log-likelihood first."""
    points = focus.drawn(focus.starts(0.0, 0.0), 0.0, 0.0)
    return [points[k] for k in focus.distinct(points, 0.0)]


def _surrogate(focus: PointFocus, seed: int) -> PointFocus:
    """The same echoes with random phases of their spectrum along the track, equal ones in all range bins."""
    out = copy.copy(focus)
    turn = np.exp(2j * np.pi * np.random.default_rng(seed).random(len(focus.fine)))
    out.fine = np.fft.ifft(np.fft.fft(focus.fine, axis=0) * turn[:, None], axis=0).astype(np.complex64)
    return out


def _boresight(frames: Frames, t_s: NDArray[np.floating]) -> Floats:
    """Direction of the antenna (n, 3) at these times [s]."""
    kept = np.searchsorted(frames.t_ns * 1e-9, t_s).clip(0, len(frames) - 1)
    return np.asarray(frames.believed.world_from_body[kept, :3, 0])


def _in_front(place: Floats, amplitude: Floats, path: Floats, ahead: Floats) -> bool:
    """Return whether a place is in the half space that the antenna faces, when its echo is strongest."""
    direction = place - path
    cosine = (direction * ahead).sum(1) / np.maximum(np.linalg.norm(direction, axis=1), 1e-9)
    return bool((amplitude * cosine).sum() > 0)


def _on_circle(place: Floats, path: Floats, ahead: Floats, z_m: float | None) -> Floats | None:
    """Return the place at a height, in front of the antenna, that a straight level track cannot separate from this.

    None where the circle about the track does not reach that height.
    """
    middle = path.mean(0)
    along = np.linalg.svd(path - middle, full_matrices=False)[2][0]
    across = np.array([-along[1], along[0], 0.0])
    if abs(along[2]) > LEVEL_RAD or not across @ ahead:
        return place
    foot = middle + along * ((place - middle) @ along)
    rise = (place[2] if z_m is None else z_m) - foot[2]
    wide = (place - foot) @ (place - foot) - rise**2
    if wide <= 0:
        return None
    side = across * np.sign(across @ ahead) / np.linalg.norm(across)
    return np.asarray(foot + side * np.sqrt(wide) + [0, 0, rise])
