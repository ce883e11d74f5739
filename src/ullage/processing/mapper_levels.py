"""Floor and ceiling heard from a level flight: echoes at a constant height below or above, whatever the heading."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from ullage.processing.mapper_looks import Look

Floats = NDArray[np.float64]

BIN_M = 0.05
REACH_M = 12.0
PERSISTENT = 0.55
ENOUGH_LOOKS = 60
NEAR_M = 0.08
LOUDER = 4.0
REMEMBERED = 400
ONE_HEADING, ABEAM, SOME = 0.94, 0.6, 0.25


class LevelFinder:
    """Finds sheets straight above or below by their persistence: no wall keeps its range on every heading.

    Each echo whose bearing allows a vertical way votes for a floor at z - R and a ceiling at z + R. A height that over
    half of the looks vote for is a level; its echoes are then left out of a map that is a plane. Walls at the same
    range in the beam are louder than a level at the beam's rim and stay.

    A wall abeam of a straight flight keeps its range too. While sensors that look abeam flew one heading alone, a sheet
    that echoes nearly as well as the best that is heard is taken for that wall: a level does not, at the beam's rim.
    """

    def __init__(self) -> None:
        self._votes = {-1: np.zeros(2 * int(REACH_M / BIN_M)), 1: np.zeros(2 * int(REACH_M / BIN_M))}
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
        self._notice(look)
        for sign in (-1, 1):
            seen: set[int] = set()
            for echo in look.echoes[self._vertical(look, sign)]:
                place = int((z + sign * echo[0] - self._base + REACH_M) / BIN_M)
                seen.update(k for k in (place, place + 1) if 0 <= k < len(self._votes[sign]))
                self._loud.setdefault(sign * (place + 1), []).append(float(echo[5]))
                del self._loud[sign * (place + 1)][:-REMEMBERED]
            self._votes[sign][list(seen)] += 1

    def levels(self) -> list[tuple[int, float]]:
        """Heights [m] with -1 for a floor, 1 for a ceiling."""
        out: list[tuple[int, float]] = []
        for sign, votes in self._votes.items():
            strong = votes >= PERSISTENT * max(self._looks, 1)
            for k in np.flatnonzero(strong):
                if votes[k] == votes[max(k - 3, 0) : k + 4].max() and self._base is not None:
                    height = self._base + k * BIN_M - REACH_M
                    if not any(s == sign and abs(h - height) < 3 * BIN_M for s, h in out):
                        out.append((sign, float(height)))
        return [level for level in out if not self._may_be_wall(*level)]

    def _notice(self, look: Look) -> None:
        """Take down where the look was flown, opposite headings alike, and how well its best echo reflects."""
        ahead = complex(*look.track[:2])
        self._headings += (ahead / max(abs(ahead), 1e-9)) ** 2
        self._abeam += int(abs(look.heard.axes[:2, 0] @ [-ahead.imag, ahead.real]) > ABEAM * abs(ahead))
        if len(look.echoes):
            self._strong.append(float((look.echoes[:, 0] * look.echoes[:, 5]).max()))

    def _may_be_wall(self, sign: int, height: float) -> bool:
        """Whether a persistent sheet may stand upright: only while nothing but one way along it was flown."""
        turned = abs(self._headings) < ONE_HEADING * self._looks
        if turned or self._abeam < (1 - SOME) * self._looks or self._base is None:
            return False
        return abs(height - self._base) * self._usual(sign, height) * LOUDER > float(np.median(self._strong))

    def without_levels(self, look: Look) -> Look:
        """The look without its echoes of floor and ceiling."""
        drop = np.zeros(len(look.echoes), bool)
        z = float(look.heard.position[2])
        for sign, height in self.levels():
            at = self._vertical(look, sign) & (abs(look.echoes[:, 0] - sign * (height - z)) < NEAR_M)
            drop |= at & (look.echoes[:, 5] < LOUDER * self._usual(sign, height))
        return look.only(~drop)

    def _usual(self, sign: int, height: float) -> float:
        place = int((height - (self._base or 0.0) + REACH_M) / BIN_M + 0.5)
        near = [v for k in range(place - 1, place + 3) for v in self._loud.get(sign * k, [])]
        return float(np.median(near)) if near else 0.0

    @staticmethod
    def _vertical(look: Look, sign: int) -> NDArray[np.bool_]:
        miss = abs(look.echoes[:, 2] - sign * look.track[2])
        return np.asarray(miss < 3 * look.echoes[:, 3] + 0.08)
