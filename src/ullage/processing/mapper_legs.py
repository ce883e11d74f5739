"""Where the echoes of straight legs come from in a volume: rings of different legs are joined to one surface.

An echo of range r whose range falls by a for each metre flown lies on a ring about its track: every normal n with
n . t = a will do. What range a place p hears of a smooth surface is its distance, which obeys the eikonal equation
|grad r| = 1 with grad r = -n [BornWolf1999]. The same surface heard at p' is nearer by n . (p' - p) where it is flat,
and by the mean of both normals on that way where it is bent a little, as the bow of a stretch's own ranges tells. Each
other leg that hears it so bears out some part of the ring, and what several bear out is the normal. A ring that stays
open on two sides, as those of legs in one plane do (each direction's mirror image in that plane fits them as well), is
left open.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ullage.kernels.rolls import AHEAD, COLUMNS, COSINE, DOUBT, LEG, NORMAL, PLACE, RANGE, TRACK, WIDE, weigh_rolls

if TYPE_CHECKING:
    from ullage.processing.mapper_tracks import Traced

Floats = NDArray[np.float64]

STRETCH_M, LEAST_ECHOES, SCATTER_M, LEAST_TRUST = 0.6, 8, 0.02, 0.4
LEG_TURN = float(np.cos(np.radians(15.0)))
ROLLS = 72
AROUND_M, NEAR_M, BESIDE_M, SLACK_M = 3.0, 2.2, 0.2, 0.1
LEG_WIDE_M = 0.3  # sensors of one body fly beside each other
RANGE_SIGMA_M, WANDER, COSINE_SIGMA = 0.02, 0.01, 0.05
OUTLIER = 0.06  # chance that a leg has no echo of a surface
UNLIT, UNHEARD, BEHIND = 0.3, 0.02, -0.3  # chance of an echo from beside the beam, from behind, from where on
ONE_SIDE = float(np.cos(np.radians(17.0)))
STRICT_SIDE = float(np.cos(np.radians(11.0)))
SURE, ENOUGH_LEGS, MANY_LEGS = 0.9, 1.6, 2.5  # beside the beam, where echoes are weak, more is asked
MOST_STRETCHES = 2048
LEAST_BEND, EDGE_BEND, FOCUSED = 0.3, 0.5, 1.7  # bend of ranges, as a share of that of an edge or pole
Told = tuple[list["Traced"], Floats, float]


class Legs:
    """Stretches of followed echoes, and the direction of each once other legs tell it."""

    def __init__(self) -> None:
        self._line: Floats | None
        self._rows = np.zeros((MOST_STRETCHES, COLUMNS))
        self._bends = np.zeros((MOST_STRETCHES, ROLLS), np.float32)
        self._kept: list[tuple[list[Traced], float]] = [([], 0.0)] * MOST_STRETCHES
        self._added = 0
        self._waiting: dict[int, None] = {}
        self._leg, self._line = 0, None

    @property
    def _held(self) -> Floats:
        return self._rows[: min(self._added, MOST_STRETCHES)]

    def add(self, echoes: list[Traced], lately: list[Traced], ahead: Floats, least: float, rim: float) -> None:
        """Take in a stretch of one reflector's echoes; those around it that are open wait to be judged anew.

        Args:
            echoes: of the stretch.
            lately: these and some before, which tell how the surface bends.
            ahead: boresight (3).
            least: cosine to it in which echoes are looked for.
            rim: Fresnel parameter out to which the surface goes on.
        """
        row = stretch_of(echoes)
        if row is None:
            return
        if self._line is None or not _on_line(row, self._line):
            self._leg, self._line = self._leg + 1, row
        row[LEG], row[AHEAD : AHEAD + 3], row[WIDE] = self._leg, ahead, least
        known = [e.way for e in echoes if e.way is not None]
        if 2 * len(known) > len(echoes):
            row[NORMAL : NORMAL + 3] = known[-1]
        at = self._added % MOST_STRETCHES
        self._waiting.pop(at, None)
        self._rows[at], self._kept[at], self._bends[at] = row, (echoes, rim), bends_of(lately, cone(row), row)
        self._added += 1
        held = self._held
        open_ = self._around(at, AROUND_M) & ~held[:, NORMAL : NORMAL + 3].any(axis=1)
        self._waiting.update(dict.fromkeys(np.flatnonzero(open_).tolist()))
        if not known:
            self._waiting[at] = None

    def tell(self, most: int) -> Iterator[Told]:
        """Judge at most so many of those that wait: echoes whose direction is now known, unit vector (3), their rim."""
        for _ in range(min(most, len(self._waiting))):
            at = next(iter(self._waiting))
            del self._waiting[at]
            me, (echoes, rim) = self._rows[at], self._kept[at]
            normal = self._normal(at, AROUND_M, bent=False)
            if normal is None:
                normal = self._normal(at, NEAR_M, bent=True)
            if normal is not None:
                me[NORMAL : NORMAL + 3] = normal
                self._kept[at] = [], 0.0
                yield echoes, normal, rim

    def tell_all(self) -> Iterator[Told]:
        """Judge all that wait."""
        while self._waiting:
            yield from self.tell(len(self._waiting))

    def _around(self, at: int, most_m: float) -> NDArray[np.bool_]:
        """Which stretches of other legs may hear the surface that one hears: near, and not on one line with it."""
        held, me = self._held, self._rows[at]
        gap = held[:, PLACE : PLACE + 3] - me[PLACE : PLACE + 3]
        squared = np.einsum("ij,ij->i", gap, gap)
        along = gap @ me[TRACK : TRACK + 3]
        near = (squared < most_m**2) & (held[:, LEG] != me[LEG])
        near &= (held[:, RANGE] - me[RANGE]) ** 2 < squared + SLACK_M
        turned = abs(held[:, TRACK : TRACK + 3] @ me[TRACK : TRACK + 3]) < LEG_TURN
        return np.asarray(near & (turned | (squared - along**2 > BESIDE_M**2)))

    def _normal(self, at: int, most_m: float, *, bent: bool) -> Floats | None:
        """Unit vector (3) to what made a stretch's echoes, if other legs leave but one side of its ring."""
        me, others = self._rows[at], self._held[self._around(at, most_m)]
        if len(others) < 2:
            return None
        others = np.ascontiguousarray(others[np.argsort(others[:, LEG], kind="stable")])
        ways = cone(me)
        bends, lit = self._bends[at].astype(float), ways @ me[AHEAD : AHEAD + 3]
        focused = (bends > FOCUSED) & (lit > me[WIDE])
        fits = (abs(bends) > LEAST_BEND) & ((bends < EDGE_BEND) | focused) if bent else abs(bends) < EDGE_BEND
        ways, bends, lit = ways[fits], bends[fits] if bent else np.zeros(np.count_nonzero(fits)), lit[fits]
        if not len(ways):
            return None
        odds, legs = np.zeros((2, len(ways)))
        weigh_rolls(me, others, ways, RANGE_SIGMA_M, WANDER, -bends / me[RANGE], OUTLIER, odds, legs)
        odds += np.log(np.where(lit > me[WIDE], 1.0, np.where(lit > BEHIND, UNLIT, UNHEARD)))
        best = int(np.argmax(odds))
        enough, narrow = (ENOUGH_LEGS, ONE_SIDE) if lit[best] > me[WIDE] else (MANY_LEGS, STRICT_SIDE)
        share = np.exp(odds - odds[best])
        side = share * (ways @ ways[best] > narrow)
        if legs[best] < enough or side.sum() < SURE * share.sum():
            return None
        mean = side @ ways
        return np.asarray(mean / np.linalg.norm(mean))


def stretch_of(echoes: list[Traced]) -> Floats | None:
    """What is kept of a stretch (COLUMNS): its middle, its way, range and fall of range; None where these scatter."""
    if np.mean([e.trust for e in echoes]) < LEAST_TRUST:
        return None
    at, reach = np.array([e.position for e in echoes]), np.array([e.range_m for e in echoes])
    track = at[-1] - at[0]
    track /= max(float(np.linalg.norm(track)), 1e-9)
    along = (at - at.mean(axis=0)) @ track
    slope = float(along @ reach) / max(float(along @ along), 1e-9)
    if np.std(reach - slope * along) > SCATTER_M:
        return None
    row = np.zeros(COLUMNS)
    row[PLACE : PLACE + 3], row[TRACK : TRACK + 3] = at.mean(axis=0), track
    row[RANGE], row[COSINE], row[DOUBT] = reach.mean(), np.clip(-slope, -1.0, 1.0), COSINE_SIGMA
    return row


def _on_line(row: Floats, line: Floats) -> bool:
    """Whether a stretch goes on with the straight leg of another."""
    track = line[TRACK : TRACK + 3]
    gap = row[PLACE : PLACE + 3] - line[PLACE : PLACE + 3]
    aside = gap - (gap @ track) * track
    return bool(abs(row[TRACK : TRACK + 3] @ track) > LEG_TURN and aside @ aside < LEG_WIDE_M**2)


def bends_of(echoes: list[Traced], ways: Floats, row: Floats) -> Floats:
    """How far ranges bow from those of a flat wall in each way (w): 0; an edge or a pole has 1.

    The near side of a round tank has less than 0, its far side, past the focus, more than 1.
    The bend times the range's inverse is by how much the way turns for each metre flown.
    """
    at, reach = np.array([e.position for e in echoes]), np.array([e.range_m for e in echoes])
    gap = at - row[PLACE : PLACE + 3]
    along = gap @ row[TRACK : TRACK + 3]
    bow = 0.5 * (1 - row[COSINE] ** 2) * along**2 / row[RANGE]
    basis = np.column_stack([bow, along, np.ones(len(bow))])
    return np.asarray(np.linalg.lstsq(basis, reach[:, None] + gap @ ways.T, rcond=1e-6)[0][0])


def cone(row: Floats) -> Floats:
    """Unit vectors (ROLLS, 3) at a stretch's cosine to its track."""
    track, cosine = row[TRACK : TRACK + 3], float(row[COSINE])
    level = np.cross(track, [0.0, 0.0, 1.0] if abs(track[2]) < 0.9 else [0.0, 1.0, 0.0])
    level /= np.linalg.norm(level)
    turn = np.arange(ROLLS)[:, None] * (2 * np.pi / ROLLS)
    off = np.sqrt(max(1 - cosine**2, 0.0))
    return np.asarray(cosine * track + off * (np.cos(turn) * level + np.sin(turn) * np.cross(level, track)))
