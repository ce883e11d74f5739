"""Looks of several sensors in the order of their times, however their frames are handed over."""

from __future__ import annotations

from collections.abc import Mapping

from ullage.processing.mapper_looks import Listener, Look

SILENT_NS, LATE_NS = 1_000_000_000, 10_000_000_000  # sensors that are not waited for; that a look waits at most
Named = tuple[int, str, Look]  # its time [ns], its sensor


class InOrder:
    """Lets a look pass once no sensor may still complete an earlier one.

    A look is complete when the drone has flown on, by each sensor's own way, and so later than it was heard. What legs
    tell hangs on the order, and a map should not hang on whether frames come one by one, as from a radar, or all at
    once, as from a recording.
    """

    def __init__(self) -> None:
        self._waiting: list[Named] = []

    def passed(self, looks: list[Named], listeners: Mapping[str, Listener] | None = None) -> list[Named]:
        """The looks that may pass now, of these and those that waited; all of them where no sensor goes on."""
        every = sorted([*self._waiting, *looks], key=lambda item: item[:2])
        count = len(every)
        if listeners:
            now = max(one.heard_ns for one in listeners.values())
            pending = min(one.pending_ns for one in listeners.values() if one.heard_ns > now - SILENT_NS)
            count = sum(item[0] < max(pending, now - LATE_NS) for item in every)
        self._waiting = every[count:]
        return every[:count]
