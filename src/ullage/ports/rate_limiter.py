"""Give messages in the order of their stamps, at the pace of their own clock."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, Generic, Protocol, TypeVar

from ullage.errors import UllageWarning

LATE_S = 1.0
"""A source that falls behind by more [s] is not made up for."""
LEAP_S = 10.0
"""A gap of more than this [s of stream] is not waited for."""
STEP_BACK_S = 1.0
"""A stamp that lies behind the newest by more [s] is a step of the clock; by less, the message is late."""


class Pace:
    """Tells when each stamp is due on this machine's clock.

    Args:
        rate: seconds of stream a second; 0: at once.
    """

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._anchor: tuple[int, float] | None = None  # a stamp, and when it was due
        self._newest_ns = 0
        self.late_s = 0.0
        """How late the last stamp was asked for, against the pace as it was before it started anew [s]."""

    def due_s(self, t_ns: int, now_s: float) -> float:
        """When a stamp is due [s, monotonic].

        The pace starts anew after a step back, after it falls far behind, and where stamps leap far ahead, as where a
        clock is set or recordings are strung together; a leap is reported. A late message is due at once and moves
        nothing.
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
                warnings.warn(
                    f"the stamps leap {ahead_s:.3g} s ahead, which is not waited for", UllageWarning, stacklevel=2
                )
            elif ahead_s >= 0:
                self.late_s = max(0.0, now_s - due)
                if self.late_s <= LATE_S:
                    self._newest_ns = t_ns
                    return due
        self._anchor, self._newest_ns = (t_ns, now_s), t_ns
        return now_s


class HasStamp(Protocol):
    """Anything with a time."""

    @property
    def t_ns(self) -> int:
        """Its time [ns]."""


Timed = TypeVar("Timed", bound=HasStamp)


class StampOrder(Generic[Timed]):
    """Holds messages until no older one can come, and gives them in the order of their stamps.

    A source gives frames in pieces, and what is made of a piece, such as detections, comes after it. So when the next
    piece begins, everything older than its first stamp is complete. Messages begin to flow once as much is complete
    as the longest piece spans, so that a source which needs time for its pieces does not stall those who listen.

    Args:
        key: by which messages of one stamp are sorted too; it begins with the stamp.
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
        """Give what is complete now that a piece of frames comes.

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
        """Take the messages of a piece, or of what was made of it."""
        self._held += messages

    def finish(self) -> list[Timed]:
        """Give the rest."""
        self._ready += sorted(self._held, key=self._key)
        self._held, self._flows = [], True
        return self._release()

    def _release(self) -> list[Timed]:
        if not self._flows:
            return []
        out, self._ready = self._ready, []
        return out
