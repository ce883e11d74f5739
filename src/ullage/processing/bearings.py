"""Where the echoes of range tracks may come from: a posterior over directions for each track.

One radar measures no direction. Several kinds of evidence do, and one grid of directions holds them all:

- Levels. A reflector in direction u would reach radar j at the level of track i plus the difference of their two-way
  gains, and at its range plus the difference of their lever arms. A peak of radar j there is evidence for u. Noise and
  louder echoes hide what is weaker, which is evidence for nothing. A gap there is evidence against u.
- Motion. The range r to a plane at rest changes by -u . dp while its radar moves by dp. That to a point p bends:
  r^2 - |x|^2 + 2 p . x is the same at all places x of the radar. Weighted sums over the last half metre hold both. So
  the direction of an edge or a pole is where it is now, not where it was on the way. A part of all things moves by
  itself, at an unknown speed.
- The level itself. Strong reflectors are rarer than weak ones, and none exceeds a perfect mirror. Floors and ceilings
  are frequent.
- The height over the floor, where it is known.

The directions reported are a credible set: the fewest cells that hold 99 % of the posterior [GelmanEtAl2013].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import ndtr

from ullage.arrays import Bools, Floats

AZIMUTHS = 72
"""Cells of a row, 5 degrees apart, counter-clockwise from forward."""
_ROWS_DEG = (-60.0, -30.0, 0.0, 30.0, 60.0)
_HALF_ROW_DEG = 15.0
CREDIBLE = 0.99
LEVEL_DB = 3.0  # sigma of a level against the pattern: data sheet, polarisation, other echoes in the same bin
_PLACE_M = 0.02  # sigma of the range between two radars
_OTHERS = 0.1  # density of other echoes [1 / (m dB)]
_WINDOW_M, _MOST = 0.35, 4  # within it, so many of the strongest echoes of another radar may be the same reflector's
_STRAY = 1e-4  # likelihood that no model explains: one radar alone excludes no direction for good
_FLOORS = 10.0  # a floor or a ceiling is there more often than anything in a solid angle elsewhere
_RARER_DB = 10.0  # reflectors that much stronger are rarer by a factor of e
_KNOWN_HEIGHT = 1e4  # how much likelier an echo at the known height over the floor is the floor's
_HEIGHT_SIGMA_M = 0.1
_MEMORY_M, _STEP_M = 0.5, 0.03  # path that the sums remember; frames so far apart count fully
_INDEPENDENT, _RANGE_SIGMA_M = 3.0, 0.02  # errors of range on that path
_CELL_ERROR = 0.06  # of a cosine within a cell
_MOVES, _SPEED_M_S = 0.1, 1.0  # chance that a thing moves by itself, and its speed, sigma


def _grid() -> tuple[Floats, Floats, Bools]:
    """Unit vectors (n, 3) forward, left, up; how often obstacles lie there (n); which of them are level (n)."""
    turn = 2 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
    half, units, areas, level = math.radians(_HALF_ROW_DEG), [], [], []
    for row_deg in _ROWS_DEG:
        height = math.radians(row_deg)
        units.append(np.stack([np.cos(height) * np.cos(turn), np.cos(height) * np.sin(turn),
                               np.full(AZIMUTHS, np.sin(height))], 1))  # fmt: skip
        band = (math.sin(height + half) - math.sin(height - half)) * 2 * np.pi / AZIMUTHS
        areas.append(np.full(AZIMUTHS, band))
        level.append(np.full(AZIMUTHS, abs(row_deg) < 45.0))
    cap = 2 * np.pi * (1 - math.sin(math.radians(75.0)))
    units.append(np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]))
    cap *= _FLOORS
    return np.concatenate(units), np.concatenate([*areas, [cap, cap]]), np.concatenate([*level, [False, False]])


CELLS, _OFTEN, LEVEL = _grid()
_FLAT = np.column_stack([CELLS[:, :2], np.hypot(CELLS[:, 0], CELLS[:, 1])])


@dataclass(slots=True)
class PathSums:
    """Weighted mean and covariance of a radar's place x (3), the time, the range r of a track, and r^2 - |x|^2."""

    mean: Floats = field(default_factory=lambda: np.zeros(6))
    cov: Floats = field(default_factory=lambda: np.zeros((6, 6)))
    weight: float = 0.0
    level_db: float = math.nan
    _place: Floats | None = None

    def add(self, place: Floats, t_s: float, range_m: float, level_db: float) -> None:
        """Take one detection: place of the radar (3) [m], time [s], range [m] and level [dB]."""
        new = np.array([*place, t_s, range_m, range_m**2 - float(place @ place)])
        moved = math.inf if self._place is None else float(np.linalg.norm(place - self._place))
        kept = 0.0 if self._place is None else self.weight * math.exp(-moved / _MEMORY_M)
        more = min(moved / _STEP_M, 1.0)
        self._place = place
        self.level_db = level_db if math.isnan(self.level_db) else self.level_db + 0.3 * (level_db - self.level_db)
        if more <= 0.0:  # a hover teaches nothing, and forgets nothing
            return
        self.weight = kept + more
        share, off = more / self.weight, new - self.mean
        self.mean = self.mean + share * off
        self.cov = (1 - share) * (self.cov + share * np.outer(off, off))


@dataclass(frozen=True, slots=True, eq=False)
class RadarView:
    """What one radar last received, and how it stands; all in a frame that is level and turned with the body."""

    gain_db: Floats  # (n) two-way gain towards the cells [dB]
    arm: Floats  # (3) from the body's origin [m]
    range_m: Floats  # (b) [m]
    level_db: Floats  # (b) of its last profile [dB]
    peak_m: Floats  # (q) ranges of the peaks in it [m]
    peak_db: Floats  # (q) their levels [dB]
    noise_db: float
    mirror_db: float  # level of a perfect mirror at 1 m before 0 dBi; inf where the unit hides it [dB]
    blind_m: float
    t_s: float  # of its last profile [s]
    height_m: float = math.nan  # over the floor, where it is known [m]


@dataclass(frozen=True, slots=True, eq=False)
class Echoes:
    """The tracks (m) of all radars at one time."""

    radar: Sequence[int]  # (m) index of the radar that has it
    range_m: Floats  # (m) at the last profile of that radar [m]
    rate_m_s: Floats  # (m) of the range [m/s]
    sums: Sequence[PathSums]  # (m)
    place: Floats  # (m, 3) of that radar in the world [m]


def posterior(echoes: Echoes, views: Sequence[RadarView | None], yaw_rad: float) -> Floats:
    """Return the probability (m, n) of each cell for each track.

    Args:
        echoes: the tracks.
        views: of each radar; None: it has nothing to say.
        yaw_rad: heading of the body in the world in which the sums were taken.
    """
    if not len(echoes.range_m):
        return np.zeros((0, len(CELLS)))
    level = np.array([one.level_db for one in echoes.sums])
    prior, out = np.zeros((len(level), len(CELLS))), _by_motion(echoes, yaw_rad)
    for i, view in enumerate(views):
        mine = np.flatnonzero(np.asarray(echoes.radar) == i)
        if view is None or not len(mine):
            continue
        at, loud = echoes.range_m[mine, None], level[mine, None]
        alone = _by_itself(at, loud, view)
        prior[mine] = _normal(_OFTEN * np.exp(alone - alone.max(axis=1, keepdims=True)))
        for j, other in enumerate(views):
            if j != i and other is not None:
                out[mine] += _by_another(at + echoes.rate_m_s[mine, None] * (other.t_s - view.t_s), loud, view, other)
    out = np.exp(out - out.max(axis=1, keepdims=True))
    return _normal(out * (prior + _louder(echoes, level) @ _normal(out * prior)))


def _normal(chance: Floats) -> Floats:
    return np.asarray(chance / np.maximum(chance.sum(axis=1, keepdims=True), 1e-300))


def _louder(echoes: Echoes, level_db: Floats) -> Floats:
    """Which louder tracks (m, m) of other radars may be of the same reflector: as likely as a reflector of its own."""
    radar, at = np.asarray(echoes.radar), echoes.range_m
    same = (radar[:, None] != radar) & (np.abs(at[:, None] - at) < _WINDOW_M) & (level_db[:, None] < level_db)
    return np.asarray(same.astype(float))


def credible(chance: Floats) -> Bools:
    """Return the fewest cells (m, n) that together hold `CREDIBLE` of the probability (m, n)."""
    order = np.argsort(-chance, axis=1, kind="stable")
    before = np.cumsum(np.take_along_axis(chance, order, 1), axis=1) - np.take_along_axis(chance, order, 1)
    out = np.zeros(chance.shape, bool)
    np.put_along_axis(out, order, before < CREDIBLE, 1)
    return out


def azimuth(chance: Floats) -> tuple[Floats, Floats]:
    """Return the mean azimuth (m) of each posterior (m, n) and its circular standard deviation (m) [rad]."""
    # one small product: BLAS would share larger vectors among threads, which wait for each other
    ahead, left, flat = (chance @ _FLAT).T
    return np.arctan2(left, ahead), np.sqrt(
        -2 * np.log(np.clip(np.hypot(ahead, left) / np.maximum(flat, 1e-12), 1e-12, 1))
    )


def _by_motion(echoes: Echoes, yaw_rad: float) -> Floats:
    """Log likelihood (m, n) of the ranges along the path, of planes or points at rest, or things that move."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    unit = CELLS @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])  # in the world
    cov = np.stack([one.cov for one in echoes.sums])
    place, apart_t, apart_r = cov[:, :3, :3], cov[:, :3, 3], cov[:, :3, 4]
    along = np.einsum("na,mab,nb->mn", unit, place, unit, optimize=True)
    var = np.maximum(cov[:, 4, 4, None] + 2 * apart_r @ unit.T + along, 0.0)
    with_t = cov[:, 3, 4, None] + apart_t @ unit.T
    noise = (_RANGE_SIGMA_M**2 + _CELL_ERROR**2 * np.trace(place, axis1=1, axis2=2))[:, None] / _INDEPENDENT
    times = cov[:, 3, 3, None]
    moving = with_t**2 / (times + noise / _SPEED_M_S**2)
    slope = -0.5 * np.log1p(_SPEED_M_S**2 * times / noise)
    rest = np.logaddexp(-0.5 * var / noise, -0.5 * _bent(echoes, cov, unit, along) / noise)
    moves = math.log(_MOVES) - 0.5 * np.maximum(var - moving, 0.0) / noise + slope
    return np.asarray(np.logaddexp(math.log((1 - _MOVES) / 2) + rest, moves))


def _bent(echoes: Echoes, cov: Floats, unit: Floats, along: Floats) -> Floats:
    """Variance (m, n) of the ranges about those to a point at rest in each cell, as the radar is placed now [m^2]."""
    here, range_m = echoes.place[:, :, None], echoes.range_m[:, None]
    turned = cov[:, :3, :3] @ here
    apart = (cov[:, :3, 5, None] + 2 * turned)[..., 0]
    level = cov[:, 5, 5, None] + (4 * cov[:, 5, None, :3] @ here + 4 * here.transpose(0, 2, 1) @ turned)[..., 0]
    var = level + 4 * range_m * (apart @ unit.T) + 4 * range_m**2 * along
    mean = np.array([one.mean[4] for one in echoes.sums])[:, None]
    return np.asarray(np.maximum(var, 0.0) / np.maximum(4 * mean**2, 1e-12))


def _by_itself(range_m: Floats, level_db: Floats, view: RadarView) -> Floats:
    """Log prior (m, n) of the reflectors that a track of this range and level (m, 1) needs in each cell."""
    weaker = view.gain_db.max() - view.gain_db
    mirror = view.mirror_db - 20 * np.log10(np.maximum(range_m, 0.1)) + view.gain_db
    excess = np.maximum(level_db - mirror, 0.0)
    out = -weaker / _RARER_DB - 0.5 * (excess / LEVEL_DB) ** 2
    if math.isfinite(view.height_m):
        off = (range_m - view.height_m) / _HEIGHT_SIGMA_M
        out = out + np.log1p(_KNOWN_HEIGHT * np.exp(-0.5 * off**2)) * (CELLS[:, 2] == -1.0)
    return np.asarray(out)


def _by_another(range_m: Floats, level_db: Floats, view: RadarView, other: RadarView) -> Floats:
    """Log likelihood ratio (m, n) of what another radar received, with each cell's reflector to without it."""
    at = range_m + CELLS @ (view.arm - other.arm)
    due = level_db + other.gain_db - view.gain_db
    hidden = ndtr((np.maximum(np.interp(at, other.range_m, other.level_db), other.noise_db) - due) / LEVEL_DB)
    near = np.where(np.abs(other.peak_m - range_m) < _WINDOW_M, other.peak_db, -np.inf)
    found = np.zeros_like(due)
    for column in np.argsort(-near, axis=1)[:, :_MOST].T:
        sigmas = ((other.peak_db[column, None] - due) / LEVEL_DB) ** 2
        sigmas += ((other.peak_m[column, None] - at) / _PLACE_M) ** 2
        found += np.exp(-0.5 * sigmas)
    found /= 2 * math.pi * LEVEL_DB * _PLACE_M * _OTHERS
    silent = (at < max(other.blind_m, float(other.range_m[0]))) | (at > other.range_m[-1])
    return np.asarray(np.where(silent, 0.0, np.log(found + hidden + _STRAY)))


def peaks_of(range_m: Floats, level_db: Floats) -> tuple[Floats, Floats]:
    """Return ranges (q) [m] and levels (q) [dB] of the peaks of a profile (b), by parabolas: the pulse is Gaussian."""
    a, b, c = level_db[:-2], level_db[1:-1], level_db[2:]
    at = np.flatnonzero((b > a) & (b >= c))
    a, b, c = a[at], b[at], c[at]
    shift = 0.5 * (a - c) / (a - 2 * b + c)
    return range_m[at + 1] + shift * (range_m[1] - range_m[0]), b - 0.25 * (a - c) * shift
