"""Work of keyframes, spread over the frames that follow; its order is fixed, so pieces do not change the result."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

MOST_OPEN = 4  # keyframes that may wait; the first one is completed when another one comes
SPARE = 2  # steps that a keyframe may take more than the last one did, without falling behind


class Workload:
    """Work of each keyframe as an iterator of steps.

    It completes a keyframe within about as many frames as passed between the last two.
    """

    def __init__(self) -> None:
        self._open: deque[Iterator[None]] = deque()
        self._frames, self._interval = 0, 1  # since the last keyframe, and between the two before it
        self._steps, self._usual = 0, 1  # of the keyframe in work, and the most of a keyframe lately

    def add(self, work: Iterator[None]) -> None:
        """Append the work of a keyframe."""
        self._interval, self._frames = max(self._frames, 1), 0
        self._open.append(work)
        while len(self._open) > MOST_OPEN:
            self._advance()

    def spend(self, frames: int) -> None:
        """Work for as many frames as came."""
        self._frames += frames
        share = -(-(self._usual + SPARE) * max(len(self._open), 1) // self._interval)
        for _ in range(frames * share):
            if not self._open:
                break
            self._advance()

    def finish(self) -> None:
        """Do all work that waits."""
        while self._open:
            self._advance()

    def _advance(self) -> None:
        """Take one step of the first keyframe."""
        self._steps += 1
        if next(self._open[0], self) is self:
            self._open.popleft()
            self._usual, self._steps = max(self._steps, self._usual - 1), 0
