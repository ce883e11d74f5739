"""Round walls told by ranges alone: circles about an axis that is guessed, the track's or the plumb line's.

Inside a round wall of radius R, a distance d off its axis, waves come back from its near side at R - d and from its far
side at R + d, both in the plane square to the axis. Flown along its axis that is all there is to hear: no range falls
or bows. Squared, both are (R - r)^2 = |q - c|^2 at a place q, of which any three give the centre c and R: the algebra
of pseudo-ranges [Bancroft1985]. So circles are laid through a stretch's range and pairs of others', and one stands if
chance does not lay so many ranges on it [DesolneuxEtAl2000] and no other circle nearly as many: a room has many such, a
round tank one.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc

from ullage.arrays import Bools, Floats, Longs
from ullage.kernels.rolls import AHEAD, COSINE, LEG, NORMAL, PLACE, RANGE, TRACK, WIDE
from ullage.processing.mapper_bows import Hollow

SAME_M, SAME_RANGE_M = 0.1, 0.05  # places and ranges that tell the same
LEAST_ASKED, MOST_ASKED, MOST_PAIRS = 6, 64, 400
POST_M = 0.1  # radius of what is heard from outside alone, at most
LEAST_AREA_M2 = 0.06  # spanned by three places
RADIUS_M, ASIDE_M = (0.8, 6.0), 0.2  # of walls that are looked for; how far from them the drone flies at least
NEAR_M, FITS_M, CLOSE_M, FITS_COSINE = 0.05, 0.025, 0.01, 0.1
REFINED, THROUGH = 3, 3  # times; ranges that a circle is laid through
TILT_RAD, RANGE_DOUBT_M = 0.05, 0.01  # of the axis that is guessed; of a range
RIVAL_M, RIVAL = 0.4, 0.75  # off its centre another circle's is; share of its ranges that one may have
LEAST_LEGS, LEAST_OFF_M, LEAST_APART = 4, 0.25, 0.5
LEAST_SHARE, LEAST_FACED = 0.5, 0.42  # of sides of legs that face a wall; of what they hear
MOST_CHANCE, MOST_CONTRARY, SAME_WAY = 1e-3, 0.3, 0.9
SQUARE = 0.8  # of what lies along two ways at right angles, as a room's walls do


@dataclass(frozen=True, slots=True, eq=False)
class Heard:
    """What stretches heard, seen along an axis from the place of one."""

    place: Floats  # (m, 2) [m]
    along: Floats  # (m) down the axis [m]
    track: Floats  # (m, 2) parts of unit vectors
    ahead: Floats  # (m, 2) parts of unit vectors
    reach: Floats  # (m) [m]
    cosine: Floats  # (m) fall of range for each metre flown
    leg: Floats  # (m) number of the leg
    wide: Floats  # (m) cosine to boresight in which echoes are looked for

    @staticmethod
    def of(rows: Floats, here: Floats, axis: Floats, across: Floats) -> Heard:
        """Stretches (m, 22) seen along an axis (3), square to which `across` (2, 3) are, from a place (3)."""
        place = rows[:, PLACE : PLACE + 3] - here
        return Heard(
            place @ across.T, place @ axis, rows[:, TRACK : TRACK + 3] @ across.T,
            rows[:, AHEAD : AHEAD + 3] @ across.T, rows[:, RANGE], rows[:, COSINE], rows[:, LEG], rows[:, WIDE],
        )  # fmt: skip

    def only(self, which: NDArray[Any]) -> Heard:
        """Some of them."""
        return Heard(*(getattr(self, one.name)[which] for one in fields(self)))

    def askable(self) -> Bools:
        """Which may be of a wall about the axis (m): none falls faster than its track, or is out of the beam."""
        slow = abs(self.cosine) < np.linalg.norm(self.track, axis=1) + FITS_COSINE
        return np.asarray(slow & (np.linalg.norm(self.ahead, axis=1) > self.wide))

    def differing(self) -> Longs:
        """One of each that tell the same, evenly at most so many."""
        key = np.column_stack([self.place / SAME_M, self.reach / SAME_RANGE_M, self.ahead])
        first = np.unique(np.round(key).astype(np.int64), axis=0, return_index=True)[1]
        return np.asarray(first[:: 1 + len(first) // MOST_ASKED])

    def looks(self) -> Longs:
        """Which side of which leg each is heard on (m)."""
        key = np.column_stack([self.leg, np.round(self.ahead)])
        return np.asarray(np.unique(key, axis=0, return_inverse=True)[1].ravel())

    def upright(self, tilt: Floats) -> Heard:
        """The same about an axis that leans by so much (2)."""
        return replace(self, place=self.place - self.along[:, None] * tilt)

    def sides(self, circles: Floats) -> tuple[Floats, Floats, Floats]:
        """How they hear circles (k, 3): by how much ranges miss (k, m), the side, and the way out (k, m, 2).

        The side is 1 for the near one, -1 for the far one, heard from inside. Of a post, whose radius is less than
        nothing, only the way towards it counts. A side that is out of the beam, or to which ranges fall otherwise, is
        missed by infinity.
        """
        gap = self.place - circles[:, None, :2]
        off = np.hypot(gap[..., 0], gap[..., 1])
        out = gap / np.maximum(off, 1e-6)[..., None]
        falls, faces = (out[..., 0] * part[:, 0] + out[..., 1] * part[:, 1] for part in (self.track, self.ahead))
        radius, post = circles[:, 2, None], circles[:, 2, None] <= POST_M
        inside = post | (off < radius - ASIDE_M)
        near, far = (
            np.where(
                heard & (abs(side * falls - self.cosine) < FITS_COSINE) & (side * faces > self.wide),
                abs(self.reach - radius + side * off),
                np.inf,
            )
            for side, heard in ((1.0, inside & ~post), (-1.0, inside))
        )
        return np.minimum(near, far), np.where(near <= far, 1.0, -1.0), out


def shell_of(me: Floats, others: Floats, axis: Floats) -> tuple[Hollow, Floats] | None:
    """The round wall about an axis of about some direction that a stretch and others hear, and the ways to it (m, 3).

    Those that do not hear it have none, but zeros.

    Args:
        me: the stretch (22).
        others: those around (m, 22), itself among them.
        axis: unit vector (3).
    """
    across = np.linalg.svd(axis[None])[2][1:]
    here = me[PLACE : PLACE + 3]
    mine, heard = Heard.of(me[None], here, axis, across), Heard.of(others, here, axis, across)
    found = _found(mine, heard.only(heard.askable())) if mine.askable()[0] else None
    if found is None:
        return None
    circle, tilt = found
    miss, side, out = heard.upright(tilt).sides(circle[None])
    on = miss[0] < FITS_M
    ways, told = (side[0, :, None] * out[0]) @ across, others[:, NORMAL : NORMAL + 3]
    known = on & told.any(axis=1)
    contrary = np.sum(ways[known] * told[known], axis=1) < SAME_WAY
    if contrary.sum() > MOST_CONTRARY * on.sum():
        return None
    leaning = axis + tilt @ across
    leaning /= np.linalg.norm(leaning)
    return Hollow(here + circle[:2] @ across, leaning, float(circle[2]), int(on.sum())), ways * on[:, None]


def _found(mine: Heard, asked: Heard) -> tuple[Floats, Floats] | None:
    """The circle (3) that one stretch, at the origin, and most others are on, and by how much its axis leans (2)."""
    some = asked.only(asked.differing())
    if len(some.reach) < LEAST_ASKED or len(np.unique(some.leg)) < LEAST_LEGS:
        return None
    circles = circles_through(some, float(mine.reach[0]), RADIUS_M)
    circles = circles[mine.sides(circles)[0][:, 0] < NEAR_M]
    if not len(circles):
        return None
    fits = some.sides(circles)[0] < NEAR_M
    best = int(np.argmax(fits.sum(axis=1)))
    rivals = np.linalg.norm(circles[:, :2] - circles[best, :2], axis=1) > RIVAL_M
    if fits[rivals].sum(axis=1).max(initial=0) > RIVAL * fits[best].sum():
        return None
    circle, tilt = refined(circles[best], some)
    return (circle, tilt) if _stands(circle, some.upright(tilt), len(circles)) else None


def refined(circle: Floats, some: Heard) -> tuple[Floats, Floats]:
    """The circle (3) that ranges near to one fit best, and by how much its axis leans (2)."""
    tilt, prior = np.zeros(2), np.column_stack([np.zeros((2, 3)), RANGE_DOUBT_M / TILT_RAD * np.eye(2)])
    for _ in range(REFINED):
        seen = some.upright(tilt)
        miss, side, out = (part[0] for part in seen.sides(circle[None]))
        on = miss < NEAR_M
        way = side[on, None] * out[on]
        off = np.linalg.norm(seen.place[on] - circle[:2], axis=1)
        rows = np.column_stack([way, np.ones(len(way)), way * seen.along[on, None]])
        right = np.concatenate([seen.reach[on] - circle[2] + side[on] * off, -prior[:, 3:] @ tilt])
        step = np.linalg.lstsq(np.concatenate([rows, prior]), right, rcond=1e-6)[0]
        circle, tilt = circle + step[:3], tilt + step[3:]
    return circle, tilt


def _stands(circle: Floats, some: Heard, tried: int) -> bool:
    """Whether a circle (3) is one of so many tried that neither chance nor walls at right angles explain.

    Args:
        circle: centre and radius [m].
        some: what was heard, no two alike.
        tried: how many circles were.
    """
    miss, _, out = (part[0] for part in some.sides(circle[None]))
    on = miss < FITS_M
    off = on & (abs(circle[2] - some.reach) > LEAST_OFF_M)
    if len(np.unique(some.leg[on])) < LEAST_LEGS or off.sum() < max(LEAST_ASKED - 1, LEAST_APART * on.sum()):
        return False
    close = on.any() and float(np.sqrt(np.mean(miss[on] ** 2))) < CLOSE_M
    faced, looks = abs(np.sum(out * some.ahead, axis=1)) > some.wide, some.looks()
    share = len(np.unique(looks[on])) / max(len(np.unique(looks[faced])), 1)
    square = abs(np.mean((out[off] @ [1.0, 1.0j]) ** 4))
    told = on.sum() >= LEAST_FACED * faced.sum() and share >= LEAST_SHARE
    return bool(close and told and square <= SQUARE and by_chance(on, some, tried) < MOST_CHANCE)


def by_chance(on: Bools, some: Heard, tried: int) -> float:
    """How many of so many circles chance would lay as many ranges on as lie on one (m), its own three aside."""
    chance = min(2 * FITS_M / max(float(np.ptp(some.reach)), 2 * FITS_M), 1.0)
    return float(tried * bdtrc(on.sum() - THROUGH - 1, len(on) - THROUGH, chance))


def circles_through(some: Heard, reach: float, radius_m: tuple[float, float]) -> Floats:
    """Circles (k, 3), centre and radius between two, through a range heard at the origin and each two of others."""
    first, second = np.triu_indices(len(some.reach), 1)
    p, q = some.place[first], some.place[second]
    area = p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]
    wide = np.flatnonzero(abs(area) > LEAST_AREA_M2)
    wide = wide[:: 1 + len(wide) // MOST_PAIRS]
    p, q, area, first, second = p[wide], q[wide], area[wide, None], first[wide], second[wide]
    slope = some.reach - reach
    rest = (reach**2 + np.sum(some.place**2, axis=1) - some.reach**2) / 2

    def solved(right: Floats) -> Floats:
        """Solutions (k, 2) of p . c = right, q . c = right."""
        a, b = right[first, None], right[second, None]
        return np.asarray((a * np.column_stack([q[:, 1], -q[:, 0]]) + b * np.column_stack([-p[:, 1], p[:, 0]])) / area)

    a, b = solved(slope), solved(rest)  # the centre is a R + b, as far from the origin as R from the range there
    square, half = np.sum(a * a, axis=1) - 1, np.sum(a * b, axis=1) + reach
    root = half**2 - square * (np.sum(b * b, axis=1) - reach**2)
    good = (root >= 0) & (abs(square) > 1e-6)
    out = []
    for sign in (-1.0, 1.0):
        radius = (sign * np.sqrt(root[good]) - half[good]) / square[good]
        out.append(np.column_stack([a[good] * radius[:, None] + b[good], radius]))
    found = np.concatenate(out)
    return found[(found[:, 2] > radius_m[0]) & (found[:, 2] < radius_m[1])]
