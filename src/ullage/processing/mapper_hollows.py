"""Bent walls, as those of tanks, told by the places of other legs that hear them, and known again from there on."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ullage.arrays import Floats
from ullage.kernels.rolls import AHEAD, LEG, PLACE, TRACK, TURNED, WIDE
from ullage.processing.mapper_bows import Bow, Hollow, hollow_of, lines_of
from ullage.processing.mapper_echoes import Echo
from ullage.processing.mapper_loudness import too_faint
from ullage.processing.mapper_rings import EDGE_BETTER, about, beam_odds, cone, is_edge, one_side, weigh

Piece = tuple[Hollow, Floats, Floats]  # of a wall, the way (3) to where it was heard, and the place (3) there [m]

PLACE_M = 0.6
ONE_SIDE = float(np.cos(np.radians(17.0)))
LEAST_PLACES, HEARD_SHARE = 2.5, 0.4  # that bear a wall out; of those that look at it
MOST_HOLLOWS, FAR_M = 64, 1e4
SAME_PIECE_M = 0.5  # of one wall
FITS_M, FITS_COSINE = 0.03, 0.08  # of a wall known from elsewhere, so far on round it and along its line
BEYOND_M = 1.0
ON_ROUND, ON_ALONG_M = float(np.cos(np.radians(40.0))), 1.0
FURTHER = float(np.cos(np.radians(15.0)))  # on round from where a wall was heard, it is known from there on too


class Hollows:
    """The bent walls that were told so far: the last ones, which others go on from, and all for what is behind them."""

    def __init__(self) -> None:
        self.told: list[Piece] = []
        self._everywhere: dict[tuple[int, ...], Piece] = {}
        self._planes: list[Floats] = []

    def tell(
        self, bow: Bow, me: Floats, others: Floats, echoes: list[Echo], behind: Callable[[Floats], bool]
    ) -> tuple[Hollow, Floats] | None:
        """The bent wall of a stretch's echoes and the way (3) to it, if other legs leave but one side of its ring.

        Every place of another leg counts here, not each leg by its best: one bend describes all around.

        Args:
            bow: of the stretch.
            me: the stretch as its bow tells it (22).
            others: those around whose bow is known (m, 22).
            echoes: of the stretch.
            behind: whether what they come from in some way (3) would lie behind another wall.
        """
        others, ring = _by_place(others), cone(me)
        which, axes, focal, doubt = lines_of(bow, ring)
        if not len(which):
            return None
        odds = weigh(me, others, ring[which], axes, focal, doubt)[0] + beam_odds(me, ring)[which]
        best = int(np.argmax(odds))
        way, axis = ring[which[best]], axes[best]
        if one_side(odds, ring[which], best, ONE_SIDE) is None or way @ me[AHEAD : AHEAD + 3] < me[WIDE]:
            return None
        near = about(me, way)
        lines = np.tile(axis, (len(near), 1)), np.full(len(near), focal[best]), np.full(len(near), doubt[best])
        odds, places = weigh(me, others, near, *lines)
        way = np.exp(odds - odds.max()) @ near
        way /= np.linalg.norm(way)
        hollow, most = hollow_of(bow, way, axis), float(odds.max())
        if places.max() < LEAST_PLACES or _share_heard(me, hollow, way, others, doubt[best]) < HEARD_SHARE:
            return None
        middle = hollow.ways(np.mean([e.position for e in echoes], axis=0)[None], way)[0]
        if too_faint(echoes, middle, hollow.radius_m) or behind(middle):
            return None
        if _is_flat(bow, me, others, most) or is_edge(me, others, near, most):
            return None
        self._keep(hollow, way, bow.place + bow.range_m * way)
        return hollow, way

    def go_on(self, hollow: Hollow, normal: Floats, place: Floats) -> None:
        """Know a wall that is flown along in a way (3) from a place (3), unless it is known as well there."""
        way = hollow.ways(place[None], normal)[0]
        foot = place + float(hollow.ranges(place[None], way[None])[0]) * way
        here = [
            k
            for k, (_, there, at) in enumerate(self.told)
            if way @ there > ON_ROUND and abs((foot - at) @ hollow.axis) < ON_ALONG_M
        ]
        if all(0 < self.told[k][0].pieces < hollow.pieces for k in here):
            for k in reversed(here):
                if self._everywhere.get(_cell(self.told[k][2])) is self.told[k]:  # not another wall's next to it
                    del self._everywhere[_cell(self.told[k][2])]
                del self.told[k]
            self._keep(hollow, way, foot)

    def _keep(self, hollow: Hollow, way: Floats, foot: Floats) -> None:
        self._remember(hollow, way, foot)
        beside = hollow.tangents(way, foot)
        self._planes.append(np.column_stack([beside, np.full(len(beside), BEYOND_M)]))
        del self._planes[:-MOST_HOLLOWS]

    def _remember(self, hollow: Hollow, way: Floats, foot: Floats) -> None:
        self.told.append((hollow, way, foot))
        self._everywhere[_cell(foot)] = self.told[-1]
        del self.told[:-MOST_HOLLOWS]

    @property
    def pieces(self) -> list[Piece]:
        """Every wall, once wherever it was heard."""
        return list(self._everywhere.values())

    @property
    def planes(self) -> Floats:
        """Planes (p, 8) that touch them on all sides of where they were heard: normal, distance, foot and reach [m]."""
        return np.concatenate([np.zeros((0, 8)), *self._planes])

    def known(
        self, me: Floats, echoes: list[Echo], behind: Callable[[Floats], bool], *, whole: bool = False
    ) -> tuple[Hollow, Floats] | None:
        """A wall known from other stretches that ranges and cosines of a stretch (22) fit, and the way (3) to it."""
        places, track = np.array([e.position for e in echoes]), np.array([e.track for e in echoes])
        reach, cosine = np.array([(e.range_m, e.cosine) for e in echoes]).T
        for hollow, way, foot in reversed(self.told):
            if whole and not hollow.pieces:
                continue
            ways = hollow.ways(places, way)
            middle = ways[len(ways) // 2]
            lit = middle @ me[AHEAD : AHEAD + 3] > me[WIDE]
            beside = abs((places[len(ways) // 2] - foot) @ hollow.axis) > ON_ALONG_M or middle @ way < ON_ROUND
            turn = abs(np.mean(np.sum(ways * track, axis=1) - cosine))
            miss = abs(hollow.ranges(places, ways) - reach).max()
            fits = lit and not beside and miss < FITS_M and turn < FITS_COSINE
            if fits and not too_faint(echoes, middle, hollow.radius_m) and not behind(middle):
                if middle @ way < FURTHER:
                    self._remember(hollow, middle, places[len(ways) // 2] + reach[len(ways) // 2] * middle)
                return hollow, middle
        return None


def _cell(foot: Floats) -> tuple[int, ...]:
    return tuple(np.floor(foot / SAME_PIECE_M).astype(int).tolist())


def _is_flat(bow: Bow, me: Floats, others: Floats, hollow: float) -> bool:
    """Whether a flat wall explains what places around hear nearly as well as a hollow one of that log-likelihood."""
    ways = cone(me)
    ways = ways[~bow.bent(ways)]
    if not len(ways):
        return False
    axes = np.cross(ways, me[TRACK : TRACK + 3])
    axes /= np.maximum(np.linalg.norm(axes, axis=1), 1e-9)[:, None]
    flat = weigh(me, others, ways, axes, np.full(len(ways), FAR_M))[0]
    return bool((flat + beam_odds(me, ways)).max() > hollow - EDGE_BETTER)


def _share_heard(me: Floats, hollow: Hollow, way: Floats, others: Floats, doubt: float) -> float:
    """Of the places (m, 22) of other legs that look at a hollow wall, the share at which it is heard.

    A place hears it if it does so on the way to the next one. What else is heard there, as by way of other walls, has
    its middle elsewhere, and so makes places of its own.
    """
    ways = hollow.ways(others[:, PLACE : PLACE + 3], way)
    lit = np.einsum("ij,ij->i", ways, others[:, AHEAD : AHEAD + 3]) > others[:, WIDE]
    looks = others[lit & (ways @ way > TURNED)]
    rows = [
        others[np.linalg.norm(others[:, PLACE : PLACE + 3] - middle, axis=1) < PLACE_M]
        for number in np.unique(looks[:, LEG])
        for middle in [looks[looks[:, LEG] == number, PLACE : PLACE + 3].mean(axis=0)]
    ]
    if not rows:
        return 0.0
    count = np.repeat(np.arange(len(rows)), [len(some) for some in rows])
    around = np.concatenate(rows)
    around[:, LEG] = count
    line = hollow.axis[None], np.array([(hollow.centre - me[PLACE : PLACE + 3]) @ way]), np.array([doubt])
    return float(weigh(me, around, way[None], *line)[1][0]) / len(rows)


def _by_place(others: Floats) -> Floats:
    """Stretches (m, 22) ordered by place of their leg, each of which has a number of its own in place of the leg's."""
    cell = np.floor(others[:, PLACE : PLACE + 3] / PLACE_M)
    others[:, LEG] = np.unique(np.column_stack([others[:, LEG], cell]), axis=0, return_inverse=True)[1].ravel()
    return np.ascontiguousarray(others[np.argsort(others[:, LEG], kind="stable")])
