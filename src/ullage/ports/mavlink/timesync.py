"""The offset and drift of the autopilot's clock, estimated from TIMESYNC exchanges."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from ullage.ports.intake import Counters

KEPT = 64
"""Exchanges that the estimate uses."""
LEAST = 5
"""Exchanges before there is an estimate."""
DRIFT = 100e-6
"""Standard deviation of the drift of a crystal, before anything is measured."""
FLOOR_NS = 20_000.0
"""Least standard deviation of one exchange [ns]."""
STEP_NS = 20_000_000
"""An exchange that differs from the estimate by more than this and half its round trip does not fit [ns]."""
STEPS = 3
"""So many exchanges in a row that do not fit are a step of the clock; a single one is dropped."""
TOPIC = "TIMESYNC"


class Exchange(NamedTuple):
    """Request and its answer."""

    at_ns: float  # middle of the round trip by this clock
    offset_ns: float  # the peer's clock less this one
    round_trip_ns: float


class ClockOffset:
    """Estimates a peer's clock less this one, as a line over time.

    The peer's time belongs to the middle of the round trip, and cannot be wrong by more than half of it [RFC5905]. So
    exchanges with long round trips have little weight in the fit. An expected drift of zero, known to 100 ppm, keeps
    the slope small while the exchanges span a short time.

    Args:
        counters: count exchanges that do not fit, and report steps of the peer's clock.
    """

    def __init__(self, counters: Counters) -> None:
        self._counters = counters
        self._exchanges: deque[Exchange] = deque(maxlen=KEPT)
        self._odd: list[Exchange] = []
        self._line: tuple[float, float, float] | None = None  # time, offset there [ns], slope
        self.sigma_s: float | None = None
        """Standard deviation of the offset at the last exchange [s]; None: not known yet."""

    @property
    def known(self) -> bool:
        """Whether there were enough exchanges."""
        return self._line is not None

    @property
    def drift_ppm(self) -> float:
        """Drift of the peer's clock relative to ours [ppm]; 0 while it is not known."""
        return self._line[2] * 1e6 if self._line is not None else 0.0

    def take(self, sent_ns: int, peer_ns: int, received_ns: int) -> None:
        """Take one exchange: when the question left, the peer's time, and when the answer came [ns]."""
        if received_ns < sent_ns or peer_ns <= 0:
            self._counters.drop(TOPIC, "bad", "an answer from before its question")
            return
        at = (sent_ns + received_ns) / 2
        found = Exchange(at, peer_ns - at, float(received_ns - sent_ns))
        if self._line is None or abs(found.offset_ns - self._at(at)) <= STEP_NS + found.round_trip_ns / 2:
            self._counters.drop(TOPIC, "bad", "a single answer that does not fit", count=len(self._odd))
            self._odd = []
            self._exchanges.append(found)
        else:
            self._odd.append(found)
            if len(self._odd) < STEPS:
                return
            step_s = (found.offset_ns - self._at(at)) * 1e-9
            self._counters.step(f"the autopilot's clock jumped {step_s:+.3g} s: it is measured anew")
            self._exchanges, self._odd = deque(self._odd, maxlen=KEPT), []
            self._line = None
        self._fit()

    def offset_ns(self, local_ns: int) -> int | None:
        """The peer's clock less this one at a time by this one [ns]; None while it is not known."""
        return round(self._at(local_ns)) if self._line is not None else None

    def _at(self, local_ns: float) -> float:
        assert self._line is not None
        at, offset, slope = self._line
        return offset + slope * (local_ns - at)

    def _fit(self) -> None:
        if len(self._exchanges) < LEAST:
            return
        at, offset, trip = (np.array(column) for column in zip(*self._exchanges, strict=True))
        weight = 1 / (FLOOR_NS**2 + ((trip - trip.min()) / 2) ** 2)
        here, base = at[-1], offset[-1]  # differences, since clocks in nanoseconds fill a float
        design = np.stack([np.ones_like(at), at - here], axis=1)
        normal = design.T @ (design * weight[:, None]) + np.diag([0.0, DRIFT**-2])
        spread = np.linalg.inv(normal)
        level, slope = spread @ (design.T @ (weight * (offset - base)))
        self._line = (float(here), float(base + level), float(slope))
        self.sigma_s = float(np.sqrt(spread[0, 0])) * 1e-9
