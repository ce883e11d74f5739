"""Release messages at the rate of their own clock."""

from __future__ import annotations

import time

from ullage.ports.intake import warn

LATE_S = 1.0
"""Beyond this delay [s] the limiter starts anew and does not catch up."""
LEAP_S = 10.0
"""The limiter does not wait for a gap longer than this [s of stream]."""
STEP_BACK_S = 1.0
"""A stamp older than the newest by more than this [s] is a step of the clock; otherwise the message is late."""


class RateLimiter:
    """Compute when each stamp is due on this machine's clock.

    Args:
        rate: seconds of stream a second; 0: at once.
    """

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._anchor: tuple[int, float] | None = None  # a stamp, and when it was due
        self._newest_ns = 0
        self.late_s = 0.0
        """Delay of the last stamp against the schedule before the limiter started anew [s]."""

    def due_s(self, t_ns: int, now_s: float) -> float:
        """Return when a stamp is due [s, monotonic].

        The limiter starts anew after a step back, after a long delay, and after stamps leap far ahead. Stamps leap when
        a clock is set or when recordings are joined; a leap is reported. A late message is due at once and does not
        change the schedule.
        """
        self.late_s = 0.0
        if not self._rate:
            return now_s
        if self._anchor is not None:
            ahead_s = (t_ns - self._newest_ns) * 1e-9
            due = self._anchor[1] + (t_ns - self._anchor[0]) * 1e-9 / self._rate
            if -STEP_BACK_S <= ahead_s < 0:
                return min(due, now_s)
            if ahead_s > LEAP_S:
                warn(f"the stamps leap {ahead_s:.3g} s ahead, which is not waited for")
            elif ahead_s >= 0:
                self.late_s = max(0.0, now_s - due)
                if self.late_s <= LATE_S:
                    self._newest_ns = t_ns
                    return due
        self._anchor, self._newest_ns = (t_ns, now_s), t_ns
        return now_s

    def wait(self, t_ns: int) -> None:
        """Sleep until a stamp is due."""
        now = time.monotonic()
        time.sleep(max(0.0, self.due_s(t_ns, now) - now))
