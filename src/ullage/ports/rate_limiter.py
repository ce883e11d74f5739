"""Release messages in the order of their stamps, at the rate of their own clock."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Generic, Protocol, TypeVar

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


class HasStamp(Protocol):
    """Anything with a time stamp."""

    @property
    def t_ns(self) -> int:
        """Its time [ns]."""


Timed = TypeVar("Timed", bound=HasStamp)


class StampOrder(Generic[Timed]):
    """Hold messages until no older one can come, and release them in the order of their stamps.

    A source gives frames in pieces. Results of a piece, such as detections, come after it. So when the next piece
    begins, everything older than its first stamp is complete. The first messages are released once the complete ones
    span as much time as the longest piece. A source that needs time for its pieces then does not stall listeners.

    Args:
        key: sorts the messages; its first part is the stamp.
    """

    def __init__(self, key: Callable[[Timed], Any] = lambda message: message.t_ns) -> None:
        self._key = key
        self._held: list[Timed] = []
        self._ready: list[Timed] = []  # complete, while the flow has not begun
        self._flows = False
        self._newest_ns: int | None = None
        self._longest_ns = 0

    @property
    def longest_s(self) -> float:
        """Span of the longest piece so far [s]."""
        return self._longest_ns * 1e-9

    def begin_piece(self, first_ns: int, last_ns: int) -> list[Timed]:
        """Return the messages that are complete when a piece of frames begins.

        Args:
            first_ns: the oldest stamp of the piece [ns].
            last_ns: the newest [ns].
        """
        back = self._newest_ns is not None and first_ns < self._newest_ns - STEP_BACK_S * 1e9
        done = self._held if back else [message for message in self._held if message.t_ns < first_ns]
        self._held = [] if back else [message for message in self._held if message.t_ns >= first_ns]
        self._ready += sorted(done, key=self._key)
        self._longest_ns = max(self._longest_ns, last_ns - first_ns)
        self._newest_ns = last_ns
        span = self._ready[-1].t_ns - self._ready[0].t_ns if self._ready else 0
        self._flows = self._flows or (bool(self._ready) and span >= self._longest_ns)
        return self._release()

    def hold(self, messages: list[Timed]) -> None:
        """Add the messages of a piece or of its results."""
        self._held += messages

    def finish(self) -> list[Timed]:
        """Return the remaining messages."""
        self._ready += sorted(self._held, key=self._key)
        self._held, self._flows = [], True
        return self._release()

    def _release(self) -> list[Timed]:
        if not self._flows:
            return []
        out, self._ready = self._ready, []
        return out
