"""Giving things at the pace of their own clock."""

from __future__ import annotations

import warnings

from ullage.errors import UllageWarning

LATE_S = 1.0
"""A maker that falls behind by more [s] is not made up for."""
LEAP_S = 10.0
"""A silence of more than this [s of stream] is not waited for."""


class Pace:
    """When each stamp is due on this machine's clock.

    Args:
        rate: seconds of stream a second; 0: at once.
    """

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._anchor: tuple[int, float] | None = None  # a stamp, and when it was due
        self._last_ns = 0

    def due_s(self, t_ns: int, now_s: float) -> float:
        """When a stamp is due [s, monotonic].

        The pace starts anew after a jump back, after falling far behind, and where stamps leap far ahead, as where a
        clock is set or recordings are strung together; the last is said.
        """
        if not self._rate:
            return now_s
        if self._anchor is not None:
            ahead_s = (t_ns - self._last_ns) * 1e-9
            due = self._anchor[1] + (t_ns - self._anchor[0]) * 1e-9 / self._rate
            if ahead_s > LEAP_S:
                warnings.warn(
                    f"the stamps leap {ahead_s:.3g} s ahead, which is not waited for", UllageWarning, stacklevel=2
                )
            elif t_ns >= self._anchor[0] and now_s - due <= LATE_S:
                self._last_ns = t_ns
                return due
        self._anchor, self._last_ns = (t_ns, now_s), t_ns
        return now_s

    def stamp_at(self, now_s: float) -> int | None:
        """The stamp that is due now [ns]."""
        if self._anchor is None:
            return None
        return self._anchor[0] + round((now_s - self._anchor[1]) * 1e9 * self._rate)
