"""Where the echoes of straight legs come from in a volume: rings of different legs are joined to one surface.

An echo of range r whose range falls by a for each metre flown lies on a ring about its track: every normal n with
n . t = a will do. What range a place p hears of a smooth surface is its distance, which obeys the eikonal equation
|grad r| = 1 with grad r = -n [BornWolf1999]. The same surface heard at p' is nearer by n . (p' - p) where it is flat,
and by the mean of both normals on that way where it is bent a little, as the bow of a stretch's own ranges tells. Each
other leg that hears it so bears out some part of the ring, and what several bear out is the normal. A ring that stays
open on two sides, as those of legs in one plane do (each direction's mirror image in that plane fits them as well), is
left open. So is one that a straight edge, whose distance is that to a line, explains better than a surface.
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
UPRIGHT, EDGES, EDGE_BETTER = 0.26, 8, 1.0  # ways so level may be of upright edges; slopes; [nat]
LEAST_SHARE = 0.1  # of the legs around bear a surface out
MOST_STRETCHES = 2048
LEAST_BEND, EDGE_BEND, FOCUSED = 0.3, 0.5, 1.7  # bend of ranges, as a share of that of an edge or pole
LEAST_BOW_M = 0.008  # root of the sum of squares of what an edge would bow: less is not heard
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

    def _around(self, at: int, most_m: float, *, own: bool = False) -> NDArray[np.bool_]:
        """Which stretches may hear the surface that one hears: near, of other legs, and not on one line with it.

        With `own`, those of its own leg and line as well.
        """
        held, me = self._held, self._rows[at]
        gap = held[:, PLACE : PLACE + 3] - me[PLACE : PLACE + 3]
        squared = np.einsum("ij,ij->i", gap, gap)
        near = (squared < most_m**2) & ((held[:, RANGE] - me[RANGE]) ** 2 < squared + SLACK_M)
        if own:
            return np.asarray(near)
        along = gap @ me[TRACK : TRACK + 3]
        turned = abs(held[:, TRACK : TRACK + 3] @ me[TRACK : TRACK + 3]) < LEG_TURN
        return np.asarray(near & (held[:, LEG] != me[LEG]) & (turned | (squared - along**2 > BESIDE_M**2)))

    def _normal(self, at: int, most_m: float, *, bent: bool) -> Floats | None:
        """Unit vector (3) to what made a stretch's echoes, if other legs leave but one side of its ring."""
        me, others = self._rows[at], self._held[self._around(at, most_m)]
        if len(others) < 2:
            return None
        others = np.ascontiguousarray(others[np.argsort(others[:, LEG], kind="stable")])
        ways = ring = cone(me)
        bends, lit = self._bends[at].astype(float), ways @ me[AHEAD : AHEAD + 3]
        focused = (bends > FOCUSED) & (lit > me[WIDE])
        if bent:
            fits = (abs(bends) > LEAST_BEND) & ((bends < EDGE_BEND) | focused)
        else:
            fits = (abs(bends) < EDGE_BEND) & (lit >= np.median([e.within for e in self._kept[at][0]]))
        ways, bends, lit = ways[fits], bends[fits] if bent else np.zeros(np.count_nonzero(fits)), lit[fits]
        if not len(ways):
            return None
        odds, legs = weigh(me, others, ways, bends)
        odds += np.log(np.where(lit > me[WIDE], 1.0, np.where(lit > BEHIND, UNLIT, UNHEARD)))
        best = int(np.argmax(odds))
        share = np.exp(odds - odds[best])
        enough, narrow = (ENOUGH_LEGS, ONE_SIDE) if lit[best] > me[WIDE] else (MANY_LEGS, STRICT_SIDE)
        side = share * (ways @ ways[best] > narrow)
        around = 0 if bent else 1 + np.count_nonzero(np.diff(others[:, LEG]))  # few legs see far along a round wall
        if legs[best] < max(enough, LEAST_SHARE * around) or side.sum() < SURE * share.sum():
            return None
        mean = side @ ways
        mean /= np.linalg.norm(mean)
        if not bent:
            others = self._held[self._around(at, most_m, own=True)]
            others[:, LEG] = np.arange(len(others))
        own = float(self._bends[at][fits][best])
        return None if is_edge(me, others, ring, mean, own if bent else min(own, 0.0)) else np.asarray(mean)


def weigh(
    me: Floats, others: Floats, ways: Floats, bends: Floats | None = None, edges: Floats | None = None
) -> tuple[Floats, Floats]:
    """Log-likelihood of surfaces, or of edges of these directions (w, 3), and the legs that bear each out; both (w)."""
    odds, legs = np.zeros((2, len(ways)))
    turn = np.zeros(len(ways)) if bends is None else -bends / me[RANGE]
    straight = np.zeros_like(ways) if edges is None else edges
    weigh_rolls(me, others, ways, RANGE_SIGMA_M, WANDER, turn, straight, OUTLIER, odds, legs)
    return odds, legs


def is_edge(me: Floats, others: Floats, ring: Floats, way: Floats, bend: float) -> bool:
    """Whether a straight edge explains what all stretches around hear better than the surface that is told.

    An edge is heard as a wall is from places beside each other along it. Against a flat wall so each stretch should
    count, as a leg, not each leg by its best one; of a bent wall stretches farther off tell nothing.

    Args:
        me: the stretch (17).
        others: those around (m, 17), ordered by leg.
        ring: unit vectors (w, 3) on its cone, at each of which upright and level edges are tried.
        way: (3) the one that is told; about it edges of all slopes are tried.
        bend: of the surface there, as a share of that of an edge; a flat one is tried beside it.
    """
    near = _about(me, way)
    surface = max(weigh(me, others, near, np.full(len(near), one))[0].max() for one in (0.0, bend))
    ways, edges = _edges(ring, near)
    return bool(weigh(me, others, ways, edges=edges)[0].max() > surface + EDGE_BETTER)


def _edges(ring: Floats, near: Floats) -> tuple[Floats, Floats]:
    """Ways (e, 3) to edges and their directions (e, 3): of all slopes near a way, upright and level on the ring."""
    level = np.cross(near, [0.0, 0.0, 1.0] if abs(near.mean(axis=0)[2]) < 0.9 else [1.0, 0.0, 0.0])
    level /= np.linalg.norm(level, axis=1)[:, None]
    turn = (np.arange(EDGES) * (np.pi / EDGES))[:, None, None]
    sloped = (np.cos(turn) * level + np.sin(turn) * np.cross(level, near)).reshape(-1, 3)
    flat = np.cross(ring, [0.0, 0.0, 1.0])
    long_ = np.linalg.norm(flat, axis=1) > 0.1
    flat = flat[long_] / np.linalg.norm(flat[long_], axis=1)[:, None]
    upright = np.concatenate([ring, near])
    upright = upright[abs(upright[:, 2]) < UPRIGHT]
    ways = np.concatenate([np.tile(near, (EDGES, 1)), ring[long_], upright])
    return ways, np.concatenate([sloped, flat, np.tile([0.0, 0.0, 1.0], (len(upright), 1))])


def _about(me: Floats, way: Floats) -> Floats:
    """Unit vectors (15, 3) within some degrees of a way, round the track and along it."""
    track = me[TRACK : TRACK + 3]
    aside = way - (way @ track) * track
    aside /= max(float(np.linalg.norm(aside)), 1e-9)
    across = np.cross(track, aside)
    cosine = np.clip(way @ track + np.array([-0.02, 0.0, 0.02]), -1.0, 1.0)[:, None, None]
    roll = np.radians([-4.0, -2.0, 0.0, 2.0, 4.0])[None, :, None]
    out = cosine * track + np.sqrt(1 - cosine**2) * (np.cos(roll) * aside + np.sin(roll) * across)
    return np.asarray(out.reshape(-1, 3))


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
    The bend times the range's inverse is by how much the way turns for each metre flown. Flown almost straight at what
    echoes, a bow is too small to be heard, and is taken for none.
    """
    at, reach = np.array([e.position for e in echoes]), np.array([e.range_m for e in echoes])
    gap = at - row[PLACE : PLACE + 3]
    along = gap @ row[TRACK : TRACK + 3]
    bow = 0.5 * (1 - row[COSINE] ** 2) * along**2 / row[RANGE]
    plain = np.column_stack([along, np.ones(len(along))])
    both = np.linalg.lstsq(plain, np.column_stack([bow, reach[:, None] + gap @ ways.T]), rcond=1e-6)[0]
    bow, miss = bow - plain @ both[:, 0], reach[:, None] + gap @ ways.T - plain @ both[:, 1:]
    heard = float(bow @ bow)
    return np.asarray(bow @ miss / heard if heard > LEAST_BOW_M**2 else np.zeros(len(ways)))


def cone(row: Floats) -> Floats:
    """Unit vectors (ROLLS, 3) at a stretch's cosine to its track."""
    track, cosine = row[TRACK : TRACK + 3], float(row[COSINE])
    level = np.cross(track, [0.0, 0.0, 1.0] if abs(track[2]) < 0.9 else [0.0, 1.0, 0.0])
    level /= np.linalg.norm(level)
    turn = np.arange(ROLLS)[:, None] * (2 * np.pi / ROLLS)
    off = np.sqrt(max(1 - cosine**2, 0.0))
    return np.asarray(cosine * track + off * (np.cos(turn) * level + np.sin(turn) * np.cross(level, track)))
