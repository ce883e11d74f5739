"""How far an echo's bearing can be trusted: by phase along the track while the poses allow it, else by range alone."""

from __future__ import annotations

from collections import deque

import numpy as np

from ullage.arrays import Floats
from ullage.processing.mapper_looks import Look

REMEMBERED = 128
ENOUGH = 12
FOCUSED = 0.6
STEADY = 0.9
SURE = 0.99
DEPENDENCE = 0.6  # looks of one window share frames: their odds count only so far

Table = tuple[float, dict[str, tuple[tuple[float, ...], tuple[float, ...]]]]

# Log-odds that a bearing is true, as sums of piecewise linear terms: (places, values) of each measured quantity.
# Fitted to eight flights through rooms that no table and no test uses.
BY_PHASE: Table = (
    1.05,
    {
        "level": ((-3, -2, -1.5, -1, -0.5, 0), (-1.47, 0.6, -0.44, -1.21, 0.61, 1.91)),
        "coherence": ((0.15, 0.3, 0.5, 0.65, 0.8, 0.93, 1), (-2.51, -1.01, -0.94, -0.24, 1.11, 1.55, 2.03)),
        "share": ((0.3, 0.5, 0.7, 0.9, 1), (1.09, -0.07, -0.27, -0.55, -0.19)),
        "range_scatter": ((0.0009, 0.0015, 0.003, 0.006, 0.012), (1.17, 0.68, 0.58, -0.36, -2.07)),
        "cosine_scatter": ((0.006, 0.012, 0.02, 0.05, 0.12), (-0.57, 0.43, 0.1, 0.07, -0.04)),
        "cosine": ((0, 0.15, 0.5, 0.85, 0.97), (-1.19, 0.41, 1.2, 0.31, -0.72)),
    },
)
BY_RANGE: Table = (
    0.72,
    {
        "level": ((-3, -2, -1.5, -1, -0.5, 0), (-1.31, 0.78, -0.73, -1.77, 0.52, 2.51)),
        "share": ((0.3, 0.5, 0.7, 0.9, 1), (0.67, -0.17, -0.23, -0.35, 0.08)),
        "range_scatter": ((0.0009, 0.0015, 0.003, 0.006, 0.012), (1.58, 1.08, 0.3, -0.95, -2.01)),
        "cosine_scatter": ((0.006, 0.012, 0.02, 0.05, 0.12), (1.2, -0.44, -0.03, -0.48, -0.25)),
        "cosine": ((0, 0.15, 0.5, 0.85, 0.97), (-0.55, 0.06, 0.3, 0.35, -0.16)),
    },
)


class EchoJudge:
    """Chooses between phase and range by measured coherence, and says how likely an echo's bearing is true.

    The chance is a sum of log-odds, one term for each measured quantity, fitted to the echoes of simulated flights
    through rooms that no test uses; docs/mapping.md tells how.

    Args:
        phase: whether phase may be used at all.
    """

    def __init__(self, *, phase: bool = True) -> None:
        self._phase = phase
        self._recent: deque[float] = deque(maxlen=REMEMBERED)
        self._strong: deque[float] = deque(maxlen=REMEMBERED)

    @property
    def coherent(self) -> bool:
        """Whether steady echoes have lately kept their phase along the track."""
        return self._phase and len(self._recent) >= ENOUGH and float(np.median(self._recent)) > FOCUSED

    @property
    def usual(self) -> float:
        """Strength, range times height, of the strongest echoes lately heard; infinite before any was."""
        return float(np.percentile(self._strong, 90)) if self._strong else np.inf

    def weigh(self, look: Look) -> tuple[Floats, Floats, Floats]:
        """Cosine to the track, its sigma, and the chance that the bearing is true, for each echo of a look."""
        share, sigma = look.echoes[:, 4], np.hypot(look.echoes[:, 3], look.wobble)
        coherence = look.sharp[:, 0]
        if coherence.any():
            self._recent.extend(coherence[(share >= STEADY) & (sigma < 0.03)].tolist())
        measured = {
            "level": self._level(look),
            "coherence": coherence,
            "share": share,
            "range_scatter": look.echoes[:, 1],
            "cosine_scatter": sigma,
        }
        if not self.coherent:
            return look.echoes[:, 2], sigma, chance(BY_RANGE, measured | {"cosine": abs(look.echoes[:, 2])})
        trust = chance(BY_PHASE, measured | {"cosine": abs(look.sharp[:, 1])})
        return look.sharp[:, 1], np.hypot(look.sharp[:, 2], look.wobble), trust

    def _level(self, look: Look) -> Floats:
        """Echo strength without its spreading, against the strongest echoes lately heard, as a power of ten."""
        strength = look.echoes[:, 5] * look.echoes[:, 0]
        if len(strength):
            self._strong.append(float(strength.max()))
        usual = float(np.percentile(self._strong, 90)) if self._strong else 1.0
        return np.asarray(np.log10(np.maximum(strength / max(usual, 1e-30), 1e-6)))


def chance(table: Table, measured: dict[str, Floats]) -> Floats:
    """Chance (k) that a bearing is true, from what was measured of each echo."""
    bias, terms = table
    odds = bias + sum(np.interp(measured[name], *term) for name, term in terms.items())
    return np.asarray(np.minimum(1 / (1 + np.exp(-DEPENDENCE * odds)), SURE))
