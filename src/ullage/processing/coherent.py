"""How far an echo's bearing can be trusted: by phase along the track while the poses allow it, else by range alone."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from ullage.processing.mapper_looks import Look

Floats = NDArray[np.float64]

REMEMBERED = 128
ENOUGH = 12
FOCUSED = 0.6
STEADY = 0.9


class EchoJudge:
    """Chooses between phase and range by measured coherence, and says how likely an echo's bearing is true.

    The chances were read off simulated flights as the share of echoes within 15 cm of a surface, by coherence, by the
    share of frames that hold the echo, and by the scatter of its range about the fitted line; docs/mapping.md has them.

    Args:
        phase: whether phase may be used at all.
    """

    def __init__(self, *, phase: bool = True) -> None:
        self._phase = phase
        self._recent: deque[float] = deque(maxlen=REMEMBERED)

    @property
    def coherent(self) -> bool:
        """Whether steady echoes have lately kept their phase along the track."""
        return self._phase and len(self._recent) >= ENOUGH and float(np.median(self._recent)) > FOCUSED

    def weigh(self, look: Look) -> tuple[Floats, Floats, Floats]:
        """Cosine to the track, its sigma, and the chance that the bearing is true, for each echo of a look."""
        share, sigma = look.echoes[:, 4], np.hypot(look.echoes[:, 3], look.wobble)
        coherence = look.sharp[:, 0]
        if coherence.any():
            self._recent.extend(coherence[(share >= STEADY) & (sigma < 0.03)].tolist())
        by_range = np.interp(sigma, [0.008, 0.015, 0.03, 0.06, 0.12], [0.93, 0.72, 0.5, 0.3, 0.15])
        by_range = by_range * np.interp(share, [0.4, 0.7, 0.95], [0.4, 0.6, 1.0])
        if not self.coherent:
            return look.echoes[:, 2], sigma, by_range
        by_phase = np.interp(coherence, [0.2, 0.5, 0.6, 1.0], [0.15, 0.5, 0.85, 0.93])
        by_phase = by_phase * np.interp(share, [0.4, 0.95], [0.65, 1.0])
        return look.sharp[:, 1], np.hypot(look.sharp[:, 2], look.wobble), by_phase
