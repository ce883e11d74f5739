"""Where the echoes of straight legs come from in a volume: rings of different legs are joined to one surface.

An echo of range r whose range falls by a for each metre flown lies on a ring about its track: every normal n with
n . t = a will do. What range a place p hears of a smooth surface is its distance, which obeys the eikonal equation
|grad r| = 1 with grad r = -n [BornWolf1999]. The same surface heard at p' is nearer by n . (p' - p) where it is flat;
where it is bent, as the bow of a stretch's own ranges tells, by how much nearer the line is on which its normals meet.
Each other leg that hears it so bears out some part of the ring, and what several bear out is the normal. A ring that
stays open on two sides, as those of legs in one plane do (each direction's mirror image in that plane fits them as
well), is left open. So is one that a straight edge, whose distance is that to a line, explains better than a surface.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ullage.arrays import Bools, Floats
from ullage.kernels.rolls import (
    AHEAD,
    BEND,
    BEND_DOUBT,
    COLUMNS,
    COSINE,
    CURL,
    DOUBT,
    LEG,
    NORMAL,
    PLACE,
    RANGE,
    TRACK,
    WIDE,
)  # fmt: skip
from ullage.processing.mapper_barrels import barrel_of
from ullage.processing.mapper_bows import Bow, Hollow, bow_of
from ullage.processing.mapper_echoes import Echo
from ullage.processing.mapper_hollows import Hollows, Piece
from ullage.processing.mapper_loudness import too_faint
from ullage.processing.mapper_posts import LEAST_LEGS as FEWEST_LEGS
from ullage.processing.mapper_posts import UP, post_of
from ullage.processing.mapper_rings import ROLLS, about, beam_odds, cone, is_edge, one_side, weigh
from ullage.processing.mapper_shells import shell_of

STRETCH_M, LEAST_ECHOES, SCATTER_M, LEAST_TRUST = 0.6, 8, 0.02, 0.4
LEG_TURN = float(np.cos(np.radians(15.0)))
AROUND_M, BESIDE_M, SLACK_M = 3.0, 0.2, 0.1
BEHIND_M = 0.3
CORNER_RANGE_M, CORNER_COSINE, LEVEL, MOST_BENT_M = 0.03, 0.06, 0.98, 0.8
LEG_WIDE_M = 0.3  # sensors of one body fly beside each other
COSINE_SIGMA, BOW_COSINE_SIGMA = 0.05, 0.03
ONE_SIDE = float(np.cos(np.radians(17.0)))
STRICT_SIDE = float(np.cos(np.radians(11.0)))
ENOUGH_LEGS, MANY_LEGS = 1.6, 2.5  # beside the beam, where echoes are weak, more is asked
LEAST_SHARE = 0.1  # of the legs around bear a surface out
MOST_STRETCHES = 2048
EDGE_BEND = 0.5  # bend of ranges, as a share of that of an edge or pole
LEAST_BOW_M = 0.008  # root of the sum of squares of what an edge would bow: less is not heard
MORE_LEGS = 1.5  # than when ranges alone were last asked
Told = tuple[list["Echo"], Floats, float, float, "Floats | None"]


class Legs:
    """Stretches of followed echoes, and the direction of each once other legs tell it."""

    def __init__(self) -> None:
        self._line: Floats | None
        self._rows = np.zeros((MOST_STRETCHES, COLUMNS))
        self._bowed = np.zeros((MOST_STRETCHES, COLUMNS))  # the same, with the bow of their ranges where it is known
        self._bends = np.zeros((MOST_STRETCHES, ROLLS), np.float32)
        self._kept: list[tuple[list[Echo], float]] = [([], 0.0)] * MOST_STRETCHES
        self._bows: list[Bow | None] = [None] * MOST_STRETCHES
        self._added = 0
        self._waiting: dict[int, None] = {}
        self._posted = np.zeros(MOST_STRETCHES, bool)  # stretches that were told to hear a post
        self._legs_asked = np.zeros(MOST_STRETCHES)  # around a stretch, when a round wall was last looked for there
        self._hollows = Hollows()
        self._leg, self._line = 0, None

    @property
    def _held(self) -> Floats:
        return self._rows[: min(self._added, MOST_STRETCHES)]

    def _open(self) -> Bools:
        """Which stretches have no direction yet."""
        held = self._held
        return ~held[:, NORMAL : NORMAL + 3].any(axis=1) & ~self._posted[: len(held)]

    @property
    def hollow_pieces(self) -> list[Piece]:
        """Bent walls told so far, with the ways and places where they were heard."""
        return self._hollows.pieces

    @property
    def planes(self) -> Floats:
        """Planes (p, 8) that touch the bent walls told so far, as walls that are known."""
        return self._hollows.planes

    def add(self, echoes: list[Echo], lately: list[Echo], ahead: Floats, least: float, rim: float) -> None:
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
        told = 2 * len(known) > len(echoes)
        if told:
            row[NORMAL : NORMAL + 3] = known[-1]
        at = self._added % MOST_STRETCHES
        self._waiting.pop(at, None)
        self._rows[at], self._kept[at], self._bends[at] = row, (echoes, rim), bends_of(lately, cone(row), row)
        self._bows[at] = bow = bow_of(lately)
        self._bowed[at] = row if bow is None else bowed_row(row, bow)
        self._legs_asked[at], self._posted[at] = 0, False
        self._added += 1
        open_ = self._around(at, AROUND_M, bent=True) & self._open()
        self._waiting.update(dict.fromkeys(np.flatnonzero(open_).tolist()))
        if not told:
            self._waiting[at] = None
        else:
            self._barrel(at)

    def tell(self, most: int) -> Iterator[Told]:
        """Judge at most so many of those that wait.

        Gives the echoes whose direction is now known, unit vectors (n, 3), the rim, the radius of a hollow wall [m],
        and the direction (3) of a post.
        """
        for _ in range(min(most, len(self._waiting))):
            at = next(iter(self._waiting))
            del self._waiting[at]
            me, (echoes, rim) = self._rows[at], self._kept[at]
            found = self._round(at)
            normal, radius = None if found else self._normal(at), np.inf
            ways = np.tile(np.zeros(3) if normal is None else normal, (len(echoes), 1))
            if normal is None:
                found = found or self._hollow(at)
            if found is not None:
                hollow, toward = found
                ways = hollow.ways(np.array([e.position for e in echoes]), toward)
                normal, radius = hollow.ways(me[None, PLACE : PLACE + 3], toward)[0], abs(hollow.radius_m)
            if found is not None and found[0].post:
                self._posted[at], self._kept[at], self._bows[at] = True, ([], 0.0), None
                yield echoes, ways, rim, np.inf, found[0].axis
            elif normal is not None:
                me[NORMAL : NORMAL + 3] = normal
                radius = radius if np.isfinite(radius) else self._barrel(at)
                self._kept[at], self._bows[at] = ([], 0.0), None
                yield echoes, ways, rim, radius, None

    def tell_all(self) -> Iterator[Told]:
        """Judge all that wait."""
        while self._waiting:
            yield from self.tell(len(self._waiting))

    def _around(self, at: int, most_m: float, *, own: bool = False, bent: bool = False) -> Bools:
        """Which stretches may hear the surface that one hears: near, of other legs, and not on one line with it.

        No distance to a surface changes by more than the way between two places. Where it is `bent`, places across the
        line on which its normals meet hear it R - d and R + d' away, and d + d' is no less than the way between them.
        With `own`, those of its own leg and line as well.
        """
        held, me = self._held, self._rows[at]
        gap = held[:, PLACE : PLACE + 3] - me[PLACE : PLACE + 3]
        squared = np.einsum("ij,ij->i", gap, gap)
        near = squared < most_m**2
        if not bent:
            near &= (held[:, RANGE] - me[RANGE]) ** 2 < squared + SLACK_M
        if own:
            return np.asarray(near)
        along = gap @ me[TRACK : TRACK + 3]
        turned = abs(held[:, TRACK : TRACK + 3] @ me[TRACK : TRACK + 3]) < LEG_TURN
        return np.asarray(near & (held[:, LEG] != me[LEG]) & (turned | (squared - along**2 > BESIDE_M**2)))

    def _normal(self, at: int) -> Floats | None:
        """Unit vector (3) to the flat surface of a stretch's echoes, if other legs leave but one side of its ring."""
        me, others = self._rows[at], self._held[self._around(at, AROUND_M)]
        if len(others) < 2:
            return None
        others = np.ascontiguousarray(others[np.argsort(others[:, LEG], kind="stable")])
        ring = cone(me)
        bends, lit = self._bends[at].astype(float), ring @ me[AHEAD : AHEAD + 3]
        fits = (abs(bends) < EDGE_BEND) & (lit >= np.median([e.within for e in self._kept[at][0]]))
        ways, lit = ring[fits], lit[fits]
        if not len(ways):
            return None
        odds, legs = weigh(me, others, ways)
        odds += beam_odds(me, ways)
        best = int(np.argmax(odds))
        enough = ENOUGH_LEGS if lit[best] > me[WIDE] else MANY_LEGS
        around = 1 + np.count_nonzero(np.diff(others[:, LEG]))
        mean = one_side(odds, ways, best, ONE_SIDE if lit[best] > me[WIDE] else STRICT_SIDE)
        if legs[best] < max(enough, LEAST_SHARE * around) or mean is None:
            return None
        others = self._held[self._around(at, AROUND_M, own=True)]
        others[:, LEG] = np.arange(len(others))
        near, bend = about(me, mean), min(float(self._bends[at][fits][best]), 0.0)
        level = np.cross(near, me[TRACK : TRACK + 3])
        level /= np.maximum(np.linalg.norm(level, axis=1), 1e-9)[:, None]
        surface = weigh(me, others, near)[0].max()
        if bend < 0:
            surface = max(surface, weigh(me, others, near, level, np.full(len(near), me[RANGE] / bend))[0].max())
        edge = is_edge(me, others, near, surface) or too_faint(self._kept[at][0], mean)
        return None if edge else np.asarray(mean)

    def _round(self, at: int) -> tuple[Hollow, Floats] | None:
        """The round wall, told by ranges alone or by its pieces, that a stretch's echoes are of, and the way (3) to it.

        It is asked for before a flat one: flown along, each piece of it is flat as well as ranges tell.
        """
        return self._hollows.known(self._rows[at], self._kept[at][0], lambda way: self._behind(at, way), whole=True)

    def _hollow(self, at: int) -> tuple[Hollow, Floats] | None:
        """The bent wall of a stretch's echoes, known or told now, and the way (3) to it."""

        def behind(way: Floats) -> bool:
            return self._behind(at, way) or self._in_corner(at)

        known = self._hollows.known(self._rows[at], self._kept[at][0], behind)
        if known is not None:
            return known
        bow, mask = self._bows[at], self._around(at, AROUND_M, bent=True)
        mask &= self._bowed[: len(mask), BEND_DOUBT] > 0
        told = (
            None
            if bow is None or not mask.any()
            else self._hollows.tell(bow, self._bowed[at], self._bowed[: len(mask)][mask], self._kept[at][0], behind)
        )
        if told is None and (by_range := self._by_ranges(at)) is not None:
            told = by_range if by_range[0].post else self._hollows.known(self._rows[at], self._kept[at][0], behind)
        if told is not None:  # what waits around may have heard it too
            held, here = self._held, self._rows[at, PLACE : PLACE + 3]
            open_ = (np.linalg.norm(held[:, PLACE : PLACE + 3] - here, axis=1) < AROUND_M) & self._open()
            open_[at] = False
            self._waiting.update(dict.fromkeys(np.flatnonzero(open_).tolist()))
        return told

    def _by_ranges(self, at: int) -> tuple[Hollow, Floats] | None:
        """What ranges alone tell about a stretch and the way (3) to it: a round wall, known then, or a post.

        Asked again only once there are half as many legs again.
        """
        around = np.flatnonzero(self._around(at, AROUND_M, own=True, bent=True))
        legs = len(np.unique(self._held[around, LEG]))
        if legs < FEWEST_LEGS or legs < MORE_LEGS * self._legs_asked[at]:
            return None
        self._legs_asked[at] = legs
        others, me, mine = self._bowed[around], self._bowed[at], int(np.searchsorted(around, at))
        others[:, NORMAL : NORMAL + 3] = self._held[around, NORMAL : NORMAL + 3]
        for axis in (me[TRACK : TRACK + 3], UP):
            if (found := shell_of(me, others, axis)) is not None:
                hollow, ways = found
                for row, way in zip(others, ways, strict=True):
                    if way.any():
                        self._hollows.go_on(hollow, way, row[PLACE : PLACE + 3])
                return hollow, ways[mine]
        post = post_of(me, others)
        return (post[0], post[1][mine]) if post is not None and post[1][mine].any() else None

    def _barrel(self, at: int) -> float:
        """Radius of the round wall that a told stretch's piece is one of, infinite while it is of none [m]."""
        around = self._held[self._around(at, AROUND_M, own=True)]
        found = barrel_of(self._rows[at], around)
        if found is None:
            return float(np.inf)
        hollow, on = found
        for row in around[on]:
            self._hollows.go_on(hollow, row[NORMAL : NORMAL + 3], row[PLACE : PLACE + 3])
        return hollow.radius_m

    def _behind(self, at: int, way: Floats) -> bool:
        """Whether the sensor heard a wall nearer in that way (3), there: no wave passes one, but bounces are later."""
        held, me = self._held, self._rows[at]
        gap = held[:, PLACE : PLACE + 3] - me[PLACE : PLACE + 3]
        nearer = (np.einsum("ij,ij->i", gap, gap) < STRETCH_M**2) & (held[:, RANGE] < me[RANGE] - BEHIND_M)
        nearer &= held[:, AHEAD : AHEAD + 3] @ me[AHEAD : AHEAD + 3] > LEG_TURN
        nearer &= abs(held[:, TRACK : TRACK + 3] @ way - held[:, COSINE]) < 2 * held[:, DOUBT]
        for k in np.flatnonzero(nearer):
            normal, (echoes, _) = held[k, NORMAL : NORMAL + 3], self._kept[k]
            told = echoes and not normal.any() and np.isfinite(echoes[-1].level_db)
            if normal @ way > LEG_TURN or (told and not too_faint(echoes, way)):
                return True
        return False

    def _in_corner(self, at: int) -> bool:
        """Whether a stretch may be heard off a floor or ceiling that is known and off an upright wall in turn.

        Waves come back from where they meet: at range r with r^2 = h^2 + d^2 and fall a with r a = h b + d c, for h
        and b of the floor and d and c of the wall, which the same sensor hears there too. Between places the range of a
        bent wall changes by the mean of its falls.
        """
        held, me = self._held, self._rows[at]
        sheets = held[abs(held[:, NORMAL + 2]) > LEVEL]
        up = np.sign(sheets[:, NORMAL + 2])
        high = up * (sheets[:, PLACE + 2] - me[PLACE + 2]) + sheets[:, RANGE]
        high, first = np.unique(np.round(high / CORNER_RANGE_M), return_index=True)
        high, rise = high * CORNER_RANGE_M, up[first] * me[TRACK + 2]
        near = (high > 0) & (high < 0.9 * me[RANGE])
        high, rise = high[near, None], rise[near, None]
        wall = np.sqrt(me[RANGE] ** 2 - high**2)
        fall = (me[RANGE] * me[COSINE] - high * rise) / wall
        along = (held[:, PLACE : PLACE + 3] - me[PLACE : PLACE + 3]) @ me[TRACK : TRACK + 3]
        turn = held[:, TRACK : TRACK + 3] @ me[TRACK : TRACK + 3]
        there = (
            (abs(along) < STRETCH_M)
            & (abs(turn) > LEG_TURN)
            & (held[:, AHEAD : AHEAD + 3] @ me[AHEAD : AHEAD + 3] > LEG_TURN)
        )
        there &= np.linalg.norm(held[:, PLACE : PLACE + 3] - me[PLACE : PLACE + 3], axis=1) < STRETCH_M
        there &= abs(held[:, NORMAL + 2]) < LEVEL  # the floor itself is no wall, though it may be as far off as one
        its = held[there, COSINE] * np.sign(turn[there])
        miss = abs(held[there, RANGE] + along[there] * (its + fall) / 2 - wall)
        return bool(
            ((miss < CORNER_RANGE_M) & (abs(its - fall) < CORNER_COSINE + abs(along[there]) / MOST_BENT_M)).any()
        )


def stretch_of(echoes: list[Echo]) -> Floats | None:
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


def bowed_row(row: Floats, bow: Bow) -> Floats:
    """A stretch (22) as its bow tells it."""
    out = row.copy()
    out[PLACE : PLACE + 3], out[TRACK : TRACK + 3], out[RANGE], out[COSINE] = (
        bow.place,
        bow.track,
        bow.range_m,
        bow.cosine,
    )
    out[DOUBT], out[BEND], out[BEND_DOUBT], out[CURL : CURL + 3] = BOW_COSINE_SIGMA, bow.rise, bow.doubt, bow.curl
    return out


def _on_line(row: Floats, line: Floats) -> bool:
    """Whether a stretch goes on with the straight leg of another."""
    track = line[TRACK : TRACK + 3]
    gap = row[PLACE : PLACE + 3] - line[PLACE : PLACE + 3]
    aside = gap - (gap @ track) * track
    return bool(abs(row[TRACK : TRACK + 3] @ track) > LEG_TURN and aside @ aside < LEG_WIDE_M**2)


def bends_of(echoes: list[Echo], ways: Floats, row: Floats) -> Floats:
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
