"""The obstacle distances of a run: a row for each sector and time in a CSV file, and a summary of each radar."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, TextIO

from ullage.data import Metric
from ullage.files import writing
from ullage.flow import Sink
from ullage.processing.obstacles import ObstacleSectors

FIELDS = (
    "t_s",
    "sensor",
    "distance_m",
    "sigma_m",
    "closing_speed_m_s",
    "closing_sigma_m_s",
    "time_to_collision_s",
    "tracks",
    "fault",
)


@dataclass(slots=True)
class _Summary:
    """Distances of one radar so far."""

    times: int = 0
    seen: int = 0  # times with an obstacle
    unknown: int = 0
    nearest: tuple[float, float, float] = (math.inf, math.nan, math.nan)  # distance, sigma [m] and when [s]
    soonest_s: float = math.inf  # least time to collision


@dataclass(slots=True)
class ObstacleTable(Sink):
    """A sink that writes `obstacles.csv` into a run's folder and sums it up.

    Distances are empty where nothing is detected and `nan` where they are unknown.

    Args:
        folder: of the run.
    """

    gathers: ClassVar[bool] = True
    folder: Path
    _found: dict[str, _Summary] = field(default_factory=dict)
    _file: TextIO | None = None
    _rows: Any = None

    def write(self, item: Any) -> None:
        """Take the distances of one time; everything else passes by.

        Raises:
            InputError: the disk is full or the folder cannot be written.
        """
        if not isinstance(item, ObstacleSectors):
            return
        path = self.folder / "obstacles.csv"
        with writing(path):
            if self._file is None:
                self._file = path.open("w", encoding="utf-8", newline="")
                self._rows = csv.writer(self._file, lineterminator="\n")
                self._rows.writerow(FIELDS)
            self._rows.writerows(self._taken(item, k) for k in range(len(item)))

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()

    def _taken(self, item: ObstacleSectors, k: int) -> list[str]:
        name, t_s = item.sensors[k], item.t_ns * 1e-9
        distance, sigma, soon = (float(part[k]) for part in (item.distance_m, item.sigma_m, item.time_to_collision_s))
        one = self._found.setdefault(name, _Summary())
        one.times += 1
        one.unknown += not item.valid[k]
        one.seen += math.isfinite(distance)
        one.nearest = min(one.nearest, (distance, sigma, t_s)) if math.isfinite(distance) else one.nearest
        one.soonest_s = min(one.soonest_s, soon) if soon >= 0 else one.soonest_s
        closing = float(item.closing_speed_m_s[k]), float(item.closing_sigma_m_s[k])
        tracks = str(int((item.tracks.sensor == k).sum()))
        numbers = [_text(value, known=bool(item.valid[k])) for value in (distance, sigma, *closing, soon)]
        return [f"{t_s:.3f}", name, *numbers, tracks, item.fault[k]]

    def lines(self) -> list[str]:
        """Return one sentence for each radar."""
        return [_sentence(name, one) for name, one in self._found.items()]

    def metrics(self) -> list[Metric]:
        """Return the nearest obstacle, and the share of unknown distances."""
        parts = list(self._found.values())
        if not parts:
            return []
        times, nearest = sum(one.times for one in parts), min(one.nearest[0] for one in parts)
        share = Metric("obstacle_unknown", 100 * sum(one.unknown for one in parts) / times, "%")
        return [share, *([Metric("obstacle_nearest", nearest, "m")] if math.isfinite(nearest) else [])]


def _text(value: float, *, known: bool) -> str:
    return f"{value:.3f}" if math.isfinite(value) else "" if known else "nan"


def _sentence(name: str, one: _Summary) -> str:
    share = f"{100 * one.seen / one.times:.0f} % of the time an obstacle, {100 * one.unknown / one.times:.0f} % unknown"
    distance, sigma, t_s = one.nearest
    if not math.isfinite(distance):
        return f"obstacles of {name!r}: {share}"
    soon = f", least time to collision {one.soonest_s:.1f} s" if math.isfinite(one.soonest_s) else ""
    return f"obstacles of {name!r}: {share}; nearest {distance:.2f} m (sigma {sigma:.2f} m) at t = {t_s:.1f} s{soon}"
