"""Which of several sensors on one body an echo belongs to: that whose main lobe it came through is much the louder."""

from __future__ import annotations

import numpy as np

from ullage.processing.mapper_looks import Look

NEAR_M = 0.4
RECENT_NS = 400_000_000
SAME_RANGE_M = 0.3
SAME_COSINE = 0.12
LOUDER = 2.5


class LobeComparison:
    """Drops an echo that another sensor, looking elsewhere from the same place, hears much louder at the same range."""

    def __init__(self) -> None:
        self._last: dict[str, Look] = {}

    def without_sidelobes(self, name: str, look: Look) -> Look:
        """The look without the echoes that came through a side lobe."""
        self._last[name] = look
        keep = np.ones(len(look.echoes), bool)
        for other_name, other in self._last.items():
            if other_name != name and self._beside(look, other) and len(other.echoes):
                mine, theirs = look.echoes[:, None, :], other.echoes[None, :, :]
                same = abs(mine[..., 0] - theirs[..., 0]) < SAME_RANGE_M
                if look.track.any() and other.track.any():
                    sign = 1.0 if look.track @ other.track > 0 else -1.0
                    blur = SAME_COSINE + 2 * (mine[..., 3] + theirs[..., 3])
                    same &= abs(mine[..., 2] - sign * theirs[..., 2]) < blur
                keep &= ~np.any(same & (theirs[..., 5] > LOUDER * mine[..., 5]), axis=1)
        return look.only(keep)

    @staticmethod
    def _beside(look: Look, other: Look) -> bool:
        apart = np.linalg.norm(look.heard.position - other.heard.position)
        turned = look.heard.axes[:, 0] @ other.heard.axes[:, 0] < 0.9
        return bool(apart < NEAR_M and turned and abs(look.heard.t_ns - other.heard.t_ns) < RECENT_NS)
