"""Whether a track is made of folded echoes: levels of frames with two pulse intervals, compared.

Where the pulse interval alternates from frame to frame, an echo from beyond the unambiguous range jumps by the
difference of the two intervals. Among many such echoes one may come to lie where another was, so that a false echo is
there in every frame. Levels tell them apart. An obstacle has nearly the same level in both kinds of frames. A fold has
its level where it jumps from, and at its new place the level before was that of another echo. Both explanations thus
predict a level in the frame before, with errors of an unknown variance. The generalised likelihood ratio of n Gaussian
errors is the quotient of their mean squares to the power of n / 2 [Kay1998, ch. 9].
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ullage.arrays import Floats
from ullage.processing.bearings import LEVEL_DB
from ullage.specs import RadarSpec

FOLDS = 2
"""By how many pulse intervals an echo may be late."""
_NEAR_BINS = 1  # a peak lies so far from where it is expected


@dataclass(slots=True)
class FoldErrors:
    """Mean squares of what obstacle and fold predict wrongly of a track, for each fold and phase of alternation."""

    most: int = 10  # frames that count
    count: Floats = field(default_factory=lambda: np.zeros(2 * FOLDS))
    obstacle: Floats = field(default_factory=lambda: np.full(2 * FOLDS, LEVEL_DB**2))  # [dB^2]
    fold: Floats = field(default_factory=lambda: np.full(2 * FOLDS, LEVEL_DB**2))  # [dB^2]

    def add(self, obstacle_db: float, fold_db: Floats) -> None:
        """Add the errors of one frame [dB]: the obstacle's, and each fold's (2 FOLDS), NaN where it is not seen."""
        seen = ~np.isnan(fold_db)
        self.count = np.minimum(self.count + seen, self.most)
        share = np.where(seen, 1 / np.maximum(self.count, 1), 0.0)
        self.obstacle = self.obstacle + share * (obstacle_db**2 - self.obstacle)
        self.fold = self.fold + share * (np.nan_to_num(fold_db) ** 2 - self.fold)

    @property
    def log_odds(self) -> float:
        """Logarithm of how much likelier the likeliest fold is than an obstacle."""
        ratio = (self.obstacle + LEVEL_DB**2) / (self.fold + LEVEL_DB**2)
        return float((self.count / 2 * np.log(ratio)).max())


def errors_of(
    spec: RadarSpec,
    number: int,
    here_m: tuple[float, float],
    level_db: tuple[Floats, Floats],
    axis_m: Floats,
    blind_m: float,
) -> tuple[float, Floats] | None:
    """Compute by how much obstacle and folds err on the level in the frame before.

    Args:
        spec: of the radar.
        number: of the frame; which interval an even one has is not known, so both phases are tried.
        here_m: range of a detection, and where an obstacle there was in the frame before [m].
        level_db: profiles (b) of its frame and of the frame before [dB].
        axis_m: ranges of the bins (b) [m].
        blind_m: nothing is detected below this [m].

    Returns:
        The obstacle's error and those of the folds (2 FOLDS) [dB], NaN where the fold was not in the frame; None: there
        is only one pulse interval, or the obstacle was outside the profile before.
    """
    if spec.stagger_div is None or not axis_m[0] <= here_m[1] <= axis_m[-1]:
        return None
    jump_m = (spec.stagger_div / spec.prf_div - 1) * spec.unambiguous_range_m
    here = _level(level_db[0], axis_m, here_m[0])
    sign = 1 if number % 2 else -1
    there_m = here_m[1] + sign * jump_m * np.array([way * k for way in (-1, 1) for k in range(1, FOLDS + 1)])
    seen = (there_m >= max(blind_m, axis_m[0])) & (there_m <= axis_m[-1])
    folds = np.array([here - _level(level_db[1], axis_m, place) if known else math.nan
                      for place, known in zip(there_m.tolist(), seen.tolist(), strict=True)])  # fmt: skip
    folds[folds < -2 * LEVEL_DB] = math.nan  # a louder echo hides it
    return here - _level(level_db[1], axis_m, here_m[1]), folds


def _level(level_db: Floats, axis_m: Floats, range_m: float) -> float:
    """The highest level near a range [dB]."""
    middle = round((range_m - axis_m[0]) / (axis_m[1] - axis_m[0]))
    return float(level_db[max(middle - _NEAR_BINS, 0) : middle + _NEAR_BINS + 1].max())
