"""Frames of real radars for a flight in closed loop, received in a thread of their own."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

from ullage.data import Frames, Trajectory, gathered
from ullage.errors import InputError
from ullage.ports.intake import Worker
from ullage.ports.live import Address
from ullage.ports.publisher import shifted
from ullage.specs import RadarSpec

FIRST_S, SETTLE_S = 30.0, 1.0
"""How long the first frames are waited for, and from then on those of further radars [s]."""
MOST_PIECES = 4096


class ReceivedRadars:
    """Radars behind a live port, on an aircraft that reports its poses.

    Args:
        target: the port, as `scheme:place?key=value`.
        epoch_ns: gives the time at which the flight began [ns since 1970].

    Raises:
        InputError: there is no such port, or no frames come.
    """

    def __init__(self, target: str, epoch_ns: Callable[[], int]) -> None:
        address = Address.of(target)
        if address is None or not address.known:
            raise InputError(f"no radars at {target!r}", where="radars", allowed="a live port that gives frames")
        self.sensors: dict[str, RadarSpec] = {}
        self._target, self._epoch_ns = target, epoch_ns
        self._source = address.open("source")
        self._pieces: deque[dict[str, Frames]] = deque(maxlen=MOST_PIECES)
        self._waiting: dict[str, Frames] = {}  # newer than the last pose
        self._done_ns = -1
        self._worker = Worker(self._run, "ullage radars")
        self._worker.start()
        try:
            self._meet()
        except BaseException:
            self.close()
            raise

    def _meet(self) -> None:
        begun = time.monotonic()
        while not self._pieces:
            self._worker.check()
            if time.monotonic() - begun > FIRST_S:
                raise InputError(f"no frames within {FIRST_S:g} s", where=self._target)
            time.sleep(0.05)
        time.sleep(SETTLE_S)
        for piece in list(self._pieces):
            self.sensors |= {name: part.spec for name, part in piece.items()}

    def receive(self, body: Trajectory, number: int) -> dict[str, Frames]:
        """Return the frames since the last call, up to the time of the body's pose; times are those of the flight."""
        self._worker.check()
        held, now_ns, epoch_ns = [self._waiting], int(body.t_ns[0]), self._epoch_ns()
        while self._pieces:
            held.append({name: shifted(part, -epoch_ns) for name, part in self._pieces.popleft().items()})
        found = gathered(held)
        self._waiting = _cut(found, now_ns, None)
        out, self._done_ns = _cut(found, self._done_ns, now_ns), now_ns
        return out

    def close(self) -> None:
        """Leave the port."""
        self._source.close()
        self._worker.join(3.0)

    def _run(self) -> None:
        for piece in self._source.stream():
            if piece:
                self._pieces.append(piece)


def _cut(found: dict[str, Frames], after_ns: int, until_ns: int | None) -> dict[str, Frames]:
    """Return the frames of a time, of the radars that have some."""
    out = {}
    for name, part in found.items():
        rows = part.t_ns > after_ns
        if until_ns is not None:
            rows &= part.t_ns <= until_ns
        if rows.any():
            out[name] = part[rows]
    return out
