"""CPU and memory of this process for `/diagnostics`, where rqt's runtime monitor shows them node by node."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

_STATM = Path("/proc/self/statm")


class ProcessLoad:
    """Measure what this process takes between two reports.

    Args:
        now: gives the time [s].
        cpu: gives the CPU time of all threads so far [s].
    """

    def __init__(
        self, *, now: Callable[[], float] = time.monotonic, cpu: Callable[[], float] = time.process_time
    ) -> None:
        self._now, self._cpu = now, cpu
        self._last_s, self._spent_s = now(), cpu()

    def values(self) -> list[tuple[str, str]]:
        """Return CPU since the last call [% of one core] and resident memory [MB] as pairs of key and value."""
        now, spent = self._now(), self._cpu()
        percent = 100 * (spent - self._spent_s) / max(now - self._last_s, 1e-9)
        self._last_s, self._spent_s = now, spent
        return [("CPU [% of a core]", f"{percent:.0f}"), ("memory [MB]", f"{resident_bytes() / 1e6:.0f}")]


def resident_bytes() -> int:
    """Return the memory that this process holds now; its peak so far where there is no /proc."""
    if _STATM.is_file():
        return int(_STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # macOS counts bytes
