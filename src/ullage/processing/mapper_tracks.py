"""Where an echo comes from in a volume: its range, followed along a track that also rises and turns, gives all of it.

The range of a flat surface falls along the track with the cosine of the angle to its normal, which leaves a ring of
directions. Over a metre or two the track itself bends, mostly by changing height, and each stretch has another ring:
the normal is where they cross. What one straight stretch leaves open, the length of the normal and the beam settle or
leave open.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from ullage.antenna import BoresightPattern, boresight_pattern
from ullage.arrays import Floats
from ullage.processing.inverse_sensor import least_cosine
from ullage.processing.mapper_bows import own_share
from ullage.processing.mapper_echoes import LEAST_RIM, Echo, SpecularPoint
from ullage.processing.mapper_hollows import Piece
from ullage.processing.mapper_legs import LEAST_ECHOES, STRETCH_M, Legs
from ullage.processing.mapper_looks import Look, dense_looks
from ullage.processing.mapper_loudness import fallen, level_db, too_faint
from ullage.processing.mapper_rims import rim_of
from ullage.processing.mapper_screens import (
    BEYOND_M,
    FITS_COSINE,
    FITS_M,
    across_beam,
    explained_by,
    further,
    screens_of,
    sheets_of,
)
from ullage.specs import AntennaSpec

LINK_M, LINK_PATH_M, LINK_NS = 0.05, 0.25, 1_000_000_000
LINK_COSINE, LOUDER = 0.25, 5.0
FOLLOWED = 48
LEAST_LOOKS, FIT_EVERY = 8, 3
RANGE_SIGMA_M, COSINE_SIGMA = 0.03, 0.06
SCATTER_M, TURN_SIGMA = 0.015, 0.12
APART_SHARE = 0.4  # looks of one window share their frames: so much of what they say is each one's own
TOLD_APART, SAME_WAY = 9.0, 0.28
SAME_WALL, SAME_WALL_M, MOST_WALLS, SURE_FEET = 0.98, 0.12, 96, 15
POST_BETTER, LEAST_SCATTER_M = 0.6, 0.004
MOST_RIM = 4.0
MOST_GONE = 32


@dataclass(slots=True, eq=False)
class Followed:
    """The echoes of one reflector, look after look, and its direction once that is known."""

    echoes: list[Echo] = field(default_factory=list)
    normal: Floats | None = None
    post: Floats | None = None  # (2) where it stands, if it is an upright edge or pole [m]
    screens: Floats = field(default_factory=lambda: np.zeros((0, 8)))  # walls it may be while its direction is open
    rim: float = LEAST_RIM  # Fresnel parameter out to which no edge stands
    count: float = 0.0  # of looks of a dense flight
    fresh: list[Echo] = field(default_factory=list)  # echoes that are part of no stretch yet
    doubts: int = 0  # echoes that may have been folded, less those after them that cannot have been

    def add(self, echo: Echo, ahead: Floats, least: float) -> None:
        """Go on with an echo; every few of them, find the direction anew."""
        self.echoes.append(echo)
        while sum(e.looks for e in self.echoes) > FOLLOWED:
            del self.echoes[0]
        before, self.count = self.count, self.count + echo.looks
        if self.count >= LEAST_LOOKS and self.count // FIT_EVERY > before // FIT_EVERY:
            self.normal = normal_of(self.echoes, ahead, least)
            self.post = None if self.normal is None else post_of(self.echoes, self.normal)
            level = np.array([e.height * e.range_m for e in self.echoes])
            self.rim = rim_of(level, least=LEAST_RIM, most=MOST_RIM)
            self.screens = np.zeros((0, 8)) if self.normal is not None else screens_of(self.echoes, ahead, least)

    def way(self, echo: Echo) -> tuple[Floats, bool]:
        """Unit vector (3) to what made an echo, and whether that is flat."""
        if self.post is None or self.normal is None:
            return np.zeros(3) if self.normal is None else self.normal, True
        level = np.array([*(self.post - echo.position[:2]), 0.0])
        return level / max(float(np.linalg.norm(level)), 1e-9), False

    def miss(self, echo: Echo) -> float:
        """By how much an echo's range misses what this one's is by now, infinite where it cannot be the same [m]."""
        last = self.echoes[-1]
        step = echo.position - last.position
        if (
            abs(echo.cosine * np.sign(echo.track @ last.track) - last.cosine)
            > LINK_COSINE * echo.looks + 2 * echo.sigma
        ):
            return np.inf
        if not 1 / LOUDER < echo.height / max(last.height, 1e-30) < LOUDER:
            return np.inf
        slope = last.cosine * (last.track @ step) if self.normal is None else self.normal @ step
        return abs(echo.range_m - last.range_m + float(slope))


class EchoTracks:
    """Follows the echoes of each sensor and tells their directions.

    Args:
        may_be_folded: whether an echo of a sensor, in some way (3), may come from farther off than its range says.

    Attributes:
        mirror_m: amplitude times range of a perfect mirror before an antenna of 0 dBi, by sensor where it is known [m].
        patterns: of the antennas, by sensor; the X4's where none is given.
        wave_m: wavelength of the carrier [m].
    """

    def __init__(self, may_be_folded: Callable[[str, Echo, Floats], bool] = lambda *_: False) -> None:
        self._may_be_folded = may_be_folded
        self.mirror_m: dict[str, float] = {}
        self.patterns: dict[str, BoresightPattern] = {}
        self.wave_m = 0.0
        self._open: dict[str, list[Followed]] = {}
        self._walls: list[Floats] = []
        self._held: list[list[SpecularPoint]] = []
        self._levels = self._sheets = np.zeros((0, 8))
        self._gone: deque[Followed] = deque(maxlen=MOST_GONE)
        self._legs = Legs()

    @property
    def hollow_pieces(self) -> list[Piece]:
        """Bent walls told so far, with the ways and places where they were heard."""
        return self._legs.hollow_pieces

    @property
    def walls(self) -> Floats:
        """Flat surfaces so far (p, 8): normal and distance, centre and radius of where echoes place them [m]."""
        rows = np.array(self._walls).reshape(-1, 9)
        out = rows[rows[:, 8] >= SURE_FEET, :8]
        out[:, 7] += BEYOND_M
        return np.concatenate([self._levels, out])

    def screens(self, walls: Floats) -> Floats:
        """Walls (p, 8) that may stand where silence is heard, beside those that are known.

        Those that echoes of an open direction may have come from, but where known ones explain them, and those that
        are known or heard now, as far as they may go on.
        """
        heard = [one for held in self._open.values() for one in held]
        asked = [*self._gone, *(one for one in heard if len(one.screens))]
        wall_of = explained_by([one.echoes[-1] for one in asked], walls).tolist()
        left = [one.screens for one, k in zip(asked, wall_of, strict=True) if k < 0]
        known = [across_beam(one.echoes[-1], walls[k, :3]) for one, k in zip(asked, wall_of, strict=True) if k >= 0]
        known += [across_beam(one.echoes[-1], way) for one in heard if (way := one.echoes[-1].way) is not None]
        here = np.array(known).reshape(-1, 8)
        return np.concatenate([self._sheets, further(walls), self._legs.planes, here, *left])

    def believe(
        self, levels: list[tuple[int, float]], position: Floats, *, possible: list[tuple[int, float]] | None = None
    ) -> None:
        """Take floor (-1) and ceiling (1) at these heights for walls around a place; others may be [m]."""
        self._levels, self._sheets = sheets_of(levels, position), sheets_of(possible or [], position)

    def _known(self, echo: Echo) -> Floats | None:
        """Normal of the one known wall that range and bearing of an echo fit."""
        if not len(walls := self.walls):
            return None
        normal = walls[:, :3]
        foot = echo.position + echo.range_m * normal
        miss = abs(walls[:, 3] - normal @ echo.position - echo.range_m) / FITS_M
        turn = abs(normal @ echo.track - echo.cosine) / (FITS_COSINE + echo.sigma)
        fits = np.hypot(miss, turn) + 9 * (np.linalg.norm(foot - walls[:, 4:7], axis=1) > walls[:, 7])
        fits += 9 * (normal @ echo.ahead < echo.within)
        best = int(np.argmin(fits))
        other = fits[normal @ normal[best] < 0.9]
        told = fits[best] < 1 and (not len(other) or other.min() > 2) and not too_faint([echo], normal[best])
        return normal[best] if told else None

    def _remember(self, foot: SpecularPoint, *, hold: bool = True) -> list[SpecularPoint]:
        """Add a foot to its wall; the feet that are to be told, all of a wall's once it has enough."""
        at, normal = foot.at, foot.way
        for k, wall in enumerate(self._walls):
            if normal @ wall[:3] > SAME_WALL and abs(at @ wall[:3] - wall[3]) < SAME_WALL_M:
                apart = at - wall[4:7]
                far = float(np.linalg.norm(apart))
                if far < wall[7] + 2 * BEYOND_M:
                    wall[8] += foot.echo.looks
                    grow = max(far - wall[7], 0.0) / 2
                    wall[4:7] += grow / max(far, 1e-9) * apart
                    wall[7] += grow
                    if wall[8] < SURE_FEET:
                        self._held[k] += [foot] * hold
                        return [foot] * (not hold)
                    out, self._held[k] = [*self._held[k], foot], []
                    return out
        self._walls.append(np.array([*normal, at @ normal, *at, 0.0, foot.echo.looks]))
        self._held.append([foot] * hold)
        del self._walls[:-MOST_WALLS], self._held[:-MOST_WALLS]
        return [foot] * (not hold)

    def follow(
        self, name: str, look: Look, cosine: Floats, sigma: Floats, trust: Floats, least: float
    ) -> list[SpecularPoint]:
        """Add a look's echoes; the feet of perpendiculars that are now known and were not told before.

        Args:
            name: of the sensor.
            look: its look, with a track.
            cosine: to the track (k).
            sigma: its doubt (k).
            trust: chance that the bearing is true (k).
            least: cosine to boresight in which echoes are looked for.
        """
        here, now, ahead = look.heard.position, look.heard.t_ns, look.heard.axes[:, 0]
        pattern = self.patterns.setdefault(name, boresight_pattern(AntennaSpec()))
        mirror, loud = self.mirror_m.get(name, np.inf), (look.echoes[:, 0] * look.echoes[:, 5]).tolist()
        held: list[Followed] = []
        gone: list[Followed] = []
        for one in self._open.get(name, []):
            last = one.echoes[-1]
            goes_on = now - last.t_ns < LINK_NS and np.linalg.norm(here - last.position) < LINK_PATH_M
            (held if goes_on else gone).append(one)
        self._gone.extend(one for one in gone if len(one.screens))
        free = list(held)
        feet = [f for one in gone if one.normal is not None and not one.doubts for f in self._tell_passed(one, None)]
        for k in np.argsort(-trust):
            echo = Echo(
                now, here, look.track, float(look.echoes[k, 0]), float(cosine[k]), float(look.echoes[k, 5]),
                float(sigma[k]), float(trust[k]), ahead, least_cosine(loud[k], mirror, pattern),
                dense_looks(look.heard.step_m), level_db(loud[k], mirror), sensor=name, pattern=pattern,
            )  # fmt: skip
            misses = [one.miss(echo) for one in free]
            if misses and min(misses) < LINK_M * echo.looks:
                one = free.pop(int(np.argmin(misses)))
            else:
                one = Followed()
                held.append(one)
            one.add(echo, ahead, least)
            feet += self._told(one, echo)
            one.fresh.append(echo)
            if (
                sum(e.looks for e in one.fresh) >= LEAST_ECHOES
                and np.linalg.norm(here - one.fresh[0].position) > STRETCH_M
            ):
                self._legs.add(one.fresh, one.echoes[-2 * len(one.fresh) :], ahead, least, one.rim)
                one.fresh = []
        self._open[name] = held
        return feet

    def join(self, most: int | None = None) -> Iterator[SpecularPoint]:
        """The feet of echoes of straight legs that other legs have told by now; of at most so many stretches."""
        for echoes, ways, rim, radius, post in self._legs.tell_all() if most is None else self._legs.tell(most):
            some = {0, len(echoes) // 2, len(echoes) - 1}
            if any(self._may_be_folded(echoes[k].sensor, echoes[k], ways[k]) for k in some):
                continue
            for echo, way in zip(echoes, ways, strict=True):
                if not echo.laid:
                    echo.laid, echo.way = True, way
                    foot = SpecularPoint(echo, way, post is None, rim, radius, post)
                    yield from [foot] if post is not None else self._remember(foot, hold=False)

    def _told(self, one: Followed, echo: Echo) -> list[SpecularPoint]:
        """The feet that one reflector's latest echo makes known."""
        if one.normal is not None:
            doubtful = self._may_be_folded(echo.sensor, echo, one.normal)
            one.doubts = min(one.doubts + 1, SURE_FEET) if doubtful else max(one.doubts - 1, 0)
            if one.doubts:
                return []
            return self._tell_passed(one, echo.position)
        way = None if echo.laid else self._known(echo)
        if way is None or self._may_be_folded(echo.sensor, echo, way):
            return []
        echo.laid, echo.way = True, way
        return [SpecularPoint(echo, way, True, one.rim)]

    def _tell_passed(self, one: Followed, here: Floats | None) -> list[SpecularPoint]:
        """The feet of a reflector that was followed half a Fresnel zone beyond them, or to its end, are told.

        From the edge of a wall on, an echo's level falls by over 6 dB in so much; one that does is of no wall.

        Args:
            one: with a direction.
            here: where it is followed now (3), None at its end [m].
        """
        feet = [SpecularPoint(e, *one.way(e), one.rim) for e in one.echoes if not e.laid]
        for foot in feet:
            foot.echo.way = foot.way
        zone = np.sqrt(self.wave_m / 2)
        ripe = [
            f for f in feet if here is None or np.linalg.norm(here - f.echo.position) > zone * np.sqrt(f.echo.range_m)
        ]
        for foot in ripe:
            foot.echo.laid = True
        if one.post is None and one.normal is not None and ripe:
            if too_faint(one.echoes, one.normal):
                return []
            past = fallen([f.echo for f in ripe], one.echoes, one.normal, zone)
            ripe = [foot for foot, none in zip(ripe, past, strict=True) if not none]
        return [told for foot in ripe for told in (self._remember(foot) if foot.flat else [foot])]

    def end(self) -> list[SpecularPoint]:
        """The feet of all that was followed to the last look."""
        last = [one for held in self._open.values() for one in held if one.normal is not None and not one.doubts]
        return [foot for one in last for foot in self._tell_passed(one, None)]


def normal_of(echoes: list[Echo], ahead: Floats, least: float) -> Floats | None:
    """Unit vector (3) to a flat surface from the ranges along a bent track; None while that is not known.

    Range and cosine are linear in the normal. Its two best known components come by least squares, the third by its
    unit length with a sign that the beam or the third component's own data tell.
    """
    at = np.array([e.position for e in echoes])
    reach = np.array([e.range_m for e in echoes])
    track = np.array([e.track for e in echoes])
    turn = np.array([e.cosine for e in echoes])
    weigh = 1 / (COSINE_SIGMA**2 + np.array([e.sigma for e in echoes]) ** 2)
    apart, gone = (at - at.mean(0)) / RANGE_SIGMA_M, (reach - reach.mean()) / RANGE_SIGMA_M
    matrix = apart.T @ apart + (track * weigh[:, None]).T @ track
    right = -apart.T @ gone + (track * weigh[:, None]).T @ turn
    strength, axes = np.linalg.eigh(matrix)
    along = (axes.T @ right) / np.maximum(strength, 1e-9)
    rest = 1 - along[1] ** 2 - along[2] ** 2
    if rest < -0.1:
        return None
    third, share = np.sqrt(max(rest, 0.0)), own_share(APART_SHARE, echoes)
    both = [sign * third * axes[:, 0] + along[1] * axes[:, 1] + along[2] * axes[:, 2] for sign in (-1.0, 1.0)]
    lit = [k for k in (0, 1) if both[k] @ ahead > least]
    if third < SAME_WAY:
        level = along[1] * axes[:, 1] + along[2] * axes[:, 2]
        return _settled(level, matrix, right, apart * RANGE_SIGMA_M, gone * RANGE_SIGMA_M, share)
    if not lit:
        return None
    if len(lit) == 2:
        cost = [strength[0] * (sign * third - along[0]) ** 2 for sign in (-1.0, 1.0)]
        if abs(cost[0] - cost[1]) < TOLD_APART:
            return None
        lit = [int(np.argmin(cost))]
    return _settled(both[lit[0]], matrix, right, apart * RANGE_SIGMA_M, gone * RANGE_SIGMA_M, share)


def post_of(echoes: list[Echo], normal: Floats) -> Floats | None:
    """Place (2) of an upright edge or pole, where that explains the ranges much better than a wall does [m]."""
    at, reach = np.array([e.position for e in echoes]), np.array([e.range_m for e in echoes])
    off = reach - reach.mean() + (at - at.mean(0)) @ normal
    post = (at[-1] + reach[-1] * normal)[:2]
    miss = off
    for _ in range(6):
        gap = post - at[:, :2]
        away = np.maximum(np.linalg.norm(gap, axis=1), 1e-3)
        miss = reach - away
        post = post + np.linalg.lstsq(gap / away[:, None], miss, rcond=1e-3)[0]
    return post if np.sqrt(np.mean(miss**2)) < POST_BETTER * max(float(np.std(off)), LEAST_SCATTER_M) else None


def _settled(
    normal: Floats, matrix: Floats, right: Floats, apart: Floats, gone: Floats, share: float
) -> Floats | None:  # fmt: skip
    """The normal improved on the sphere, or None where it is vague or ranges miss a plane."""
    for _ in range(3):
        normal = normal / np.linalg.norm(normal)
        side = np.linalg.svd(normal[None])[2][1:].T
        inside = side.T @ matrix @ side
        normal = normal + side @ np.linalg.solve(inside + 1e-9 * np.eye(2), side.T @ (right - matrix @ normal))
    normal = normal / np.linalg.norm(normal)
    doubt = 1 / np.sqrt(max(share * float(np.linalg.eigvalsh(inside)[0]), 1e-9))
    scatter = float(np.std(gone + apart @ normal))
    return np.asarray(normal) if doubt < TURN_SIGMA and scatter < SCATTER_M else None
