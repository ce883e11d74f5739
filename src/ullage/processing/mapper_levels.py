"""Floor and ceiling heard from a level flight: echoes at a constant height below or above, whatever the heading."""

from __future__ import annotations

from collections import deque

import numpy as np

from ullage.arrays import Bools, Floats
from ullage.processing.mapper_looks import Look

BIN_M = 0.05
REACH_M = 12.0
PERSISTENT, RETURNING = 0.55, 0.3
ENOUGH_LOOKS = 60
NEAR_M = 0.08
LOUDER = 4.0
REMEMBERED = 400
RISE_M, SAME_M, SAME_ALONG_M, SAME_WAY = (0.3, 4.0), 0.025, 0.08, 0.95
ONE_HEADING, ABEAM, SOME = 0.94, 0.6, 0.25
SECTORS, ENOUGH_SECTORS, ENOUGH_THERE = 4, 3, 10
OFTEN, OFTEN_EACH, ALIKE = 0.35, 0.2, 2.5


class LevelFinder:
    """Finds sheets straight above or below by their persistence: no wall keeps its range on every heading.

    Each echo whose bearing allows a vertical way votes for a floor at z - R and a ceiling at z + R. A height that over
    half of the looks vote for is a level; its echoes are then left out of a map that is a plane. Walls at the same
    range in the beam are louder than a level at the beam's rim and stay.

    Where walls' echoes run into a level's, as of a turn on one spot, a third of the looks is enough, if looks of all
    headings are among them and all sensors hear it about as loud: a wall is some 10 dB louder or weaker as they turn.

    A wall abeam of a straight flight keeps its range too. While sensors that look abeam flew one heading alone, a sheet
    that echoes nearly as well as the best that is heard is taken for that wall: a level does not, at the beam's rim.
    Nor does one echo better than a perfect mirror there (`rim_m`): one radar that follows walls hears them so.

    Args:
        known: levels that are there for certain: -1 for a floor or 1 for a ceiling, and its height [m].

    Attributes:
        rim_m: amplitude times range of a perfect mirror a quarter turn off boresight [m].
    """

    def __init__(self, known: tuple[tuple[int, float], ...] = ()) -> None:
        self._known = known
        self.rim_m = np.inf
        self._votes = {sign: np.zeros((SECTORS, 2 * int(REACH_M / BIN_M))) for sign in (-1, 1)}
        self._flown = np.zeros(SECTORS)  # looks of each sector of headings, opposite ones alike
        self._looks = 0
        self._base: float | None = None
        self._loud: dict[int, list[float]] = {}
        self._strong: deque[float] = deque(maxlen=REMEMBERED)
        self._headings, self._abeam = 0j, 0

    @property
    def ready(self) -> bool:
        """Whether enough was heard to judge."""
        return self._looks >= ENOUGH_LOOKS

    def hear(self, look: Look) -> None:
        """Count one look's votes."""
        if not look.track.any():
            return
        z = float(look.heard.position[2])
        self._base = z if self._base is None else self._base
        self._looks += 1
        sector = int(np.arctan2(look.track[1], look.track[0]) % np.pi / np.pi * SECTORS) % SECTORS
        self._flown[sector] += 1
        self._notice(look)
        for sign in (-1, 1):
            seen: set[int] = set()
            for echo in look.echoes[self._vertical(look, sign)]:
                place = int((z + sign * echo[0] - self._base + REACH_M) / BIN_M)
                seen.update(k for k in (place, place + 1) if 0 <= k < self._votes[sign].shape[1])
                self._loud.setdefault(sign * (place + 1), []).append(float(echo[0] * echo[5]))
                del self._loud[sign * (place + 1)][:-REMEMBERED]
            self._votes[sign][sector, list(seen)] += 1

    def levels(self, *, least: float = PERSISTENT) -> list[tuple[int, float]]:
        """Heights [m] with -1 for a floor, 1 for a ceiling; `least` is the share of looks that hear them."""
        out: list[tuple[int, float]] = []
        for sign, by_sector in self._votes.items():
            votes = by_sector.sum(0)
            everywhere = self._everywhere(by_sector)
            for k in np.flatnonzero((votes >= least * max(self._looks, 1)) | everywhere):
                if votes[k] == votes[max(k - 3, 0) : k + 4].max() and self._base is not None:
                    height = self._base + k * BIN_M - REACH_M
                    often = votes[k] >= least * self._looks or self._alike(sign, height)
                    if often and not any(s == sign and abs(h - height) < 3 * BIN_M for s, h in out):
                        out.append((sign, float(height)))
        found = [level for level in out if not self._may_be_wall(*level)]
        new = [(s, h) for s, h in found if all(s != t or abs(h - g) > NEAR_M for t, g in self._known)]
        return [*self._known, *new]

    def _everywhere(self, votes: Floats) -> Bools:
        """Heights (h) that looks of every heading vote for (sectors, h), of those with enough of them."""
        flown = self._flown >= ENOUGH_THERE
        if flown.sum() < ENOUGH_SECTORS:
            return np.zeros(votes.shape[1], bool)
        each = votes[flown] / self._flown[flown, None]
        return np.asarray((each.min(0) >= OFTEN_EACH) & (votes.sum(0) >= OFTEN * self._looks))

    def _alike(self, sign: int, height: float) -> bool:
        """Whether the echoes from a height are about as loud for all that hear it."""
        low, high = np.percentile(self._heard_at(sign, height) or [0.0], [25, 75])
        return bool(high < ALIKE * low)

    def _notice(self, look: Look) -> None:
        """Take down where the look was flown, opposite headings alike, and how well its best echo reflects."""
        ahead = complex(*look.track[:2])
        self._headings += (ahead / max(abs(ahead), 1e-9)) ** 2
        self._abeam += int(abs(look.heard.axes[:2, 0] @ [-ahead.imag, ahead.real]) > ABEAM * abs(ahead))
        if len(look.echoes):
            self._strong.append(float((look.echoes[:, 0] * look.echoes[:, 5]).max()))

    def _may_be_wall(self, sign: int, height: float) -> bool:
        """Whether a persistent sheet may stand upright: it is too loud, or nothing but one way along it was flown."""
        if self._usual(sign, height) > self.rim_m:
            return True
        turned = abs(self._headings) < ONE_HEADING * self._looks
        if turned or self._abeam < (1 - SOME) * self._looks:
            return False
        return self._usual(sign, height) * LOUDER > float(np.median(self._strong))

    def without_levels(self, look: Look) -> Look:
        """The look without its echoes of floor and ceiling."""
        drop = np.zeros(len(look.echoes), bool)
        z = float(look.heard.position[2])
        for sign, height in self.levels():
            at = self._vertical(look, sign) & (abs(look.echoes[:, 0] - sign * (height - z)) < NEAR_M)
            drop |= at & (look.echoes[:, 0] * look.echoes[:, 5] < LOUDER * self._usual(sign, height))
        return look.only(~drop)

    def feet_and_heads(self, look: Look, others: list[Look]) -> Bools:
        """Which echoes (k) of a look come from where an upright thing that is heard ends, at a floor or a ceiling.

        An upright wall and a floor, and the corner of two walls and a floor, mirror a wave back as from where they
        meet: as far along the track as the wall or the corner itself, and at a range that is longer by Pythagoras.
        What ends there may be heard in that look, or while what stands before it hides it, in others.
        """
        z = float(look.heard.position[2])
        rises = np.unique([round(abs(height - z) / BIN_M) * BIN_M for _, height in self.levels()])
        rises = rises[(rises > RISE_M[0]) & (rises < RISE_M[1])]
        return _feet_of(look, [other for other in others if abs(look.track @ other.track) > SAME_WAY], rises)

    def _usual(self, sign: int, height: float) -> float:
        """How well what lies at a height reflects: amplitude times range [m], the same from every height flown at."""
        near = self._heard_at(sign, height)
        return float(np.median(near)) if near else 0.0

    def _heard_at(self, sign: int, height: float) -> list[float]:
        """Amplitudes times ranges [m] of the last echoes from about a height."""
        place = int((height - (self._base or 0.0) + REACH_M) / BIN_M + 0.5)
        return [v for k in range(place - 1, place + 3) for v in self._loud.get(sign * k, [])]

    @staticmethod
    def _vertical(look: Look, sign: int) -> Bools:
        miss = abs(look.echoes[:, 2] - sign * look.track[2])
        return np.asarray(miss < 3 * look.echoes[:, 3] + 0.08)


def _feet_of(look: Look, others: list[Look], rises: Floats) -> Bools:
    """Which echoes (k) of a look are from so far below or above (h) what others of its sensor heard level [m]."""
    if not len(rises) or not others or not len(look.echoes):
        return np.zeros(len(look.echoes), bool)
    mine, heard = look.echoes[:, None, None], np.concatenate([other.echoes for other in others])
    reach, along, there = mine[..., 0], mine[..., 0] * mine[..., 2], heard[:, 0]
    count = [len(other.echoes) for other in others]
    moved = np.repeat([(other.heard.position - look.heard.position) @ look.track for other in others], count)
    signs = np.repeat([np.sign(look.track @ other.track) for other in others], count)
    onward = there * heard[:, 2] * signs + moved
    doubt = SAME_ALONG_M + 3 * np.hypot(reach * mine[..., 3], there * heard[:, 3])
    level = np.sqrt(np.maximum(reach**2 - rises[:, None] ** 2 - along**2 + (along - moved) ** 2, 0.0))
    loud = reach * mine[..., 5] < LOUDER * there * heard[:, 5]
    return np.asarray((loud & (abs(level - there) < SAME_M) & (abs(along - onward) < doubt)).any(axis=(1, 2)))
