"""Counts of the radars simulated for a live vehicle, for `/diagnostics`."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping

from ullage.data import Frames
from ullage.ports import encode
from ullage.ports.intake import Counters
from ullage.ports.process_load import ProcessLoad
from ullage.ports.protocol import Passed
from ullage.ports.schema import DIAGNOSTICS
from ullage.processing.health import HealthMonitor

TOPIC = "/diagnostics"
EVERY_S = 1.0
"""Least time between two messages [s]."""


class RadarStatus:
    """Counts simulated frames and gives a diagnostic message, at most once a second.

    Args:
        name: of the status.
        late_s: frames that are made so long after they were due count as late [s].
        now: gives the time that limits the rate [s].
    """

    def __init__(self, name: str, *, late_s: float, now: Callable[[], float] = time.monotonic) -> None:
        self._name, self._late_s, self._now = name, late_s, now
        self._frames: Counter[str] = Counter()
        self._late = 0
        self._health = HealthMonitor()
        self._behind_s = self._most_behind_s = 0.0
        self._reported = (0, 0, 0)  # late frames, dropped messages and contacts, as of the last message
        self._given_s = -EVERY_S
        self._load = ProcessLoad()

    def add(self, frames: Mapping[str, Frames], behind_s: float) -> None:
        """Count the frames of one piece.

        Args:
            frames: of each radar by name.
            behind_s: how long after they were due they were made [s].
        """
        self._health.judge(frames)
        for name, part in frames.items():
            self._frames[name] += len(part)
            self._late += len(part) if behind_s > self._late_s else 0
        self._behind_s, self._most_behind_s = behind_s, max(self._most_behind_s, behind_s)

    def message(self, t_ns: int, counters: Counters, *, contacts: int = 0) -> Passed | None:
        """The counts so far as a DiagnosticArray; None where none is due.

        Late frames, dropped messages and contacts since the last message make it a warning, a faulty radar an error.

        Args:
            t_ns: stamp [ns].
            counters: of the messages that the vehicle's poses or commands come with.
            contacts: how often the vehicle has touched something.
        """
        if self._now() - self._given_s < EVERY_S:
            return None
        self._given_s = self._now()
        counts = (self._late, counters.dropped(), contacts)
        fresh = [new - old for new, old in zip(counts, self._reported, strict=True)]
        self._reported = counts
        causes = [text for text, count in zip(("late frames", "dropped messages", "contacts"), fresh, strict=True)
                  if count > 0]  # fmt: skip
        faults = self._health.faulty()
        values = [("frames simulated", str(self._frames.total()))]
        values += [(f"{name}: frames simulated", str(count)) for name, count in self._frames.items()]
        values += [("late frames", str(self._late)), ("behind [s]", f"{self._behind_s:.3f}")]
        values += [("most behind [s]", f"{self._most_behind_s:.3f}"), ("dropped", str(counts[1]))]
        values += [("contacts", str(contacts)), *counters.values()]
        self._most_behind_s = 0.0
        values += [("faulty radars", ", ".join(faults)), ("faults so far", "; ".join(self._health.lines()))]
        values += self._load.values()
        text = ", ".join([*faults, *causes]) or "simulating"
        data = encode.diagnostics_message(t_ns, 2 if faults else int(bool(causes)), self._name, text, values)
        return Passed(t_ns, TOPIC, DIAGNOSTICS, data)
