"""What `/diagnostics` tells, once a second: a level, counts, and CPU and memory of this process.

rqt's runtime monitor shows them node by node.
"""

from __future__ import annotations

import math
import os
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from ullage.data import Frames
from ullage.ports.intake import Counters
from ullage.ports.protocol import Passed
from ullage.ports.schema import DIAGNOSTICS, encoded
from ullage.processing.health import HealthMonitor

TOPIC = "/diagnostics"
EVERY_S = 1.0
"""Least time between two messages [s]."""
_STATM = Path("/proc/self/statm")


class Status:
    """A status that is told at most once a second.

    Args:
        name: of the status.
        now: gives the time [s].
        cpu: gives the CPU time of all threads so far [s].
    """

    def __init__(
        self, name: str, *, now: Callable[[], float] = time.monotonic, cpu: Callable[[], float] = time.process_time
    ) -> None:
        self._name, self._now, self._cpu = name, now, cpu
        self._due_s, self._last_s, self._spent_s = -math.inf, now(), cpu()
        self.span_s = 0.0
        """Time between the last two messages that were due [s]."""

    def is_due(self) -> bool:
        """Return whether a message is due; the next one is due a second later."""
        now = self._now()
        if now < self._due_s:
            return False
        self.span_s, self._last_s, self._due_s = now - self._last_s, now, now + EVERY_S
        return True

    def told(self, t_ns: int, level: int, text: str, values: Sequence[tuple[str, str]]) -> Passed:
        """Return the message that is due.

        Args:
            t_ns: stamp [ns].
            level: 0 OK, 1 warning, 2 error, 3 stale.
            text: one line.
            values: pairs of key and value; CPU and memory are added.
        """
        spent = self._cpu()
        percent = 100 * (spent - self._spent_s) / max(self.span_s, 1e-9)
        self._spent_s = spent
        load = [("CPU [% of a core]", f"{percent:.0f}"), ("memory [MB]", f"{resident_bytes() / 1e6:.0f}")]
        status = (level, self._name, text, "ullage", [*values, *load])
        return Passed(t_ns, TOPIC, DIAGNOSTICS, encoded(DIAGNOSTICS, {"status": [status]}, t_ns=t_ns))


def resident_bytes() -> int:
    """Return the memory that this process holds now; its peak so far where there is no /proc."""
    if _STATM.is_file():
        return int(_STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # macOS counts bytes


class RadarStatus(Status):
    """Counts of the radars simulated for a live vehicle.

    Args:
        name: of the status.
        late_s: frames that are made so long after they were due count as late [s].
        now: gives the time [s].
    """

    def __init__(self, name: str, *, late_s: float, now: Callable[[], float] = time.monotonic) -> None:
        super().__init__(name, now=now)
        self._late_s = late_s
        self._frames: Counter[str] = Counter()
        self._late = 0
        self._health = HealthMonitor()
        self._behind_s = self._most_behind_s = 0.0
        self._reported = (0, 0, 0)  # late frames, dropped messages and contacts, as of the last message

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
        if not self.is_due():
            return None
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
        text = ", ".join([*faults, *causes]) or "simulating"
        return self.told(t_ns, 2 if faults else int(bool(causes)), text, values)
