"""What frames flow through: stages make something of them, sinks take the frames and what was made."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
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
