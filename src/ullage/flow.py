"""What frames flow through: stages make something of them, sinks take the frames and what was made, when it is due."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Protocol, Self


class Stage(Protocol):
    """Anything that makes something of frames; it sees each piece once."""

    def update(self, chunk: Any) -> Iterable[Any]:
        """Return the results of this chunk: Detections, OccupancyMap, Image; or none yet."""

    def finish(self) -> Iterable[Any]:
        """Return the remaining results after the last frames; none, unless a stage holds some back."""
        return ()


class Closing:
    """Something that a `with` block closes."""

    def close(self) -> None:
        """End, with everything written; nothing to do, unless something is open."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class Sink(Closing, ABC):
    """Receiver that keeps or shows items, and ignores those that it cannot use."""

    @abstractmethod
    def write(self, item: Any) -> None:
        """Take one item."""


@dataclass(slots=True)
class Due:
    """Decide when a periodic result is due; the mean rate does not depend on the size of the pieces.

    Attributes:
        every_s: period by the clock of the stream [s].
        late_s: stamps that lie back by so much more than a period are late; beyond that the clock has stepped [s].
    """

    every_s: float
    late_s: float = 0.0
    _next_ns: int | None = None

    def reached(self, now_ns: int) -> bool:
        """Return whether it is due now, by the clock of the frames; a step of the clock restarts the interval."""
        period_ns, next_ns = round(self.every_s * 1e9), self._next_ns
        if next_ns is not None and next_ns - period_ns - self.late_s * 1e9 <= now_ns < next_ns:
            return False
        on_time = next_ns is not None and 0 <= now_ns - next_ns < period_ns
        self._next_ns = (next_ns if on_time and next_ns is not None else now_ns) + period_ns
        return True
