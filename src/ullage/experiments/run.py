"""State of a run while it goes on, what it collects beside its recording, and its report when it is finished.

The stages and sinks here collect in bounded memory, however long the run: pictures and frames for the report, the
obstacle distances as a table, and map files, at the end and every minute of a long run.
"""

from __future__ import annotations

import csv
import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TextIO

import numpy as np

from ullage import flow
from ullage.arrays import Floats, Singles
from ullage.config import Scenario, Task
from ullage.data import Frames, Imu, Metric, Trajectory, joined, makes_room
from ullage.experiments.folder import RunFolder
from ullage.experiments.imaging import ImagePlane
from ullage.experiments.radar_poses import RadarPoses
from ullage.experiments.simulated import Simulated
from ullage.experiments.verdict import ObjectOnMap
from ullage.files import writing
from ullage.grids import OccupancyMap
from ullage.pipeline import DetectStage, MapStage, Outcome, Sink, Source
from ullage.ports.maps import write_map_server, write_ply
from ullage.ports.octomap import write_octomap
from ullage.processing.health import HealthMonitor
from ullage.processing.obstacles import ObstacleSectors
from ullage.processing.own_echo import OwnEchoFilter
from ullage.view.replay import MapHistory
from ullage.world.scene import Scene

if TYPE_CHECKING:
    from ullage.experiments.exploration import Exploration


@dataclass(slots=True)
class _Pooled:
    """Rows of one sensor, each the highest amplitude of `stride` frames in a row."""

    range_m: Floats
    stride: int = 1
    rows: list[Singles] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    left: list[tuple[float, Singles]] = field(default_factory=list)

    def add(self, part: Frames, most: int) -> None:
        self.left += [(float(t) * 1e-9, row) for t, row in zip(part.t_ns, part.amplitude, strict=True)]
        while len(self.left) >= self.stride:
            batch, self.left = self.left[: self.stride], self.left[self.stride :]
            self.times.append(batch[0][0])
            self.rows.append(np.max([row for _, row in batch], axis=0))
        if len(self.rows) > most:
            pairs = zip(self.rows[::2], [*self.rows[1::2], self.rows[-1]], strict=False)
            self.rows = [np.maximum(a, b) for a, b in pairs]
            self.times = self.times[::2]
            self.stride *= 2


@dataclass(slots=True)
class RangeTime(flow.Stage):
    """Range-time amplitude pictures of every sensor, at most `most` rows each."""

    most: int = 1200
    unit: str = "path_gain"
    _sensors: dict[str, _Pooled] = field(default_factory=dict)

    def update(self, chunk: dict[str, Frames]) -> Iterable[Any]:
        """Pool this chunk."""
        for name, part in chunk.items():
            self.unit = part.unit
            self._sensors.setdefault(name, _Pooled(part.range_m)).add(part, self.most)
        return ()

    def pictures(self) -> list[tuple[str, Floats, Floats, Floats]]:
        """Name, times [s], ranges [m] and amplitudes (n, b) of each sensor."""
        return [
            (name, np.array(p.times), p.range_m, np.array(p.rows, dtype=float))
            for name, p in self._sensors.items()
            if p.rows
        ]


@dataclass(slots=True)
class SampledFrames(flow.Stage):
    """Keep every n-th frame of each sensor, at most `most` of each: enough to find the surfaces in sight."""

    most: int = 400
    _stride: dict[str, int] = field(default_factory=dict)
    _seen: dict[str, int] = field(default_factory=dict)
    _kept: dict[str, list[Frames]] = field(default_factory=dict)

    @property
    def received(self) -> int:
        """Frames of all sensors so far."""
        return sum(self._seen.values())

    def update(self, chunk: dict[str, Frames]) -> Iterable[Any]:
        """Keep some frames of this chunk."""
        for name, part in chunk.items():
            stride, seen = self._stride.setdefault(name, 1), self._seen.get(name, 0)
            kept = self._kept.setdefault(name, [])
            rows = np.arange(-seen % stride, len(part), stride)
            if len(rows) and makes_room(kept, part):
                kept.append(part[rows])  # a copy: a view would keep the whole chunk
            self._seen[name] = seen + len(part)
            while sum(map(len, self._kept[name])) > self.most:
                whole = joined(self._kept[name])
                self._kept[name] = [whole[np.arange(0, len(whole), 2)]]
                self._stride[name] *= 2
        return ()

    def number(self, name: str, index: int) -> int:
        """The number in the whole recording of a sensor's `index`-th kept frame."""
        return index * self._stride.get(name, 1)

    def frames(self) -> dict[str, Frames]:
        """Return the kept frames by sensor."""
        return {name: joined(parts) for name, parts in self._kept.items() if parts}


@dataclass(slots=True)
class QuietestFrames(flow.Stage):
    """The chunk of each sensor that changes least: it shows the noise and the standing echoes of a radar at rest."""

    _best: dict[str, tuple[float, Frames]] = field(default_factory=dict)

    def update(self, chunk: dict[str, Frames]) -> Iterable[Any]:
        """Keep this chunk if it changes less than the quietest so far."""
        for name, part in chunk.items():
            if len(part) < 16 or part.ray_model:
                continue
            change = float(np.mean(np.abs(np.diff(part.samples, axis=0)) ** 2))
            if name not in self._best or change < self._best[name][0]:
                self._best[name] = change, part
        return ()

    def frames(self) -> dict[str, Frames]:
        """Return the quietest chunk of each sensor."""
        return {name: part for name, (_, part) in self._best.items()}


MAP_EVERY_S = 60.0
"""Between two maps that are saved while a run goes on [s]."""
PICTURE_S = 10.0
"""A run that takes longer draws a picture of its map this long after its start [s]."""


@dataclass(slots=True)
class MapSaver(flow.Sink):
    """A sink that saves the map so far, so that a kill leaves one that is at most a minute old.

    Attributes:
        folder: of the run.
        every_s: between two maps, by the wall clock [s].
        draw: draws the first picture of a run that takes long.
    """

    gathers: ClassVar[bool] = True
    folder: Path
    every_s: float = MAP_EVERY_S
    draw: Callable[[OccupancyMap], None] | None = None
    _saved_s: float = -float("inf")
    _started_s: float = field(init=False)

    def __post_init__(self) -> None:
        self._started_s = time.monotonic()

    def write(self, item: Any) -> None:
        """Save a map if the last one is old enough; everything else passes by.

        Raises:
            InputError: the disk is full.
        """
        if isinstance(item, OccupancyMap) and time.monotonic() - self._saved_s >= self.every_s:
            write_map_files(self.folder, item)
            self._saved_s = time.monotonic()
        if isinstance(item, OccupancyMap) and self.draw and time.monotonic() - self._started_s >= PICTURE_S:
            self.draw(item)
            self.draw = None


def write_map_files(folder: Path, omap: OccupancyMap) -> None:
    """Write a plane as map_server files, a volume as an OctoMap tree and as points, each whole or not at all.

    Raises:
        InputError: the disk is full.
    """
    if omap.grid.dims == 2:
        write_map_server(omap, folder / "map.yaml")
    else:
        write_octomap(omap, folder / "map.bt")
        write_ply(omap, folder / "map.ply")


OBSTACLE_FIELDS = (
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
class ObstacleTable(flow.Sink):
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
                self._rows.writerow(OBSTACLE_FIELDS)
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


@dataclass(frozen=True, slots=True)
class Compared:
    """Scores of another law's echoes and map on the same flight."""

    name: str  # in words
    scenario: str
    metrics: dict[str, Metric]

    @property
    def line(self) -> str:
        """Comparison in one line."""
        return f"{self.name} on the same flight: F1 {self.metrics['f1'].value:.3f}"


@dataclass(slots=True)
class Run:
    """Run in progress: its source, stages and settings."""

    place: RunFolder  # a draft until the run is complete
    scenario: Scenario
    source: Source
    scene: Scene | None = None
    flown: Trajectory | None = None
    marks: Floats | None = None  # surveyed places of reflectors (m, 3) [m], for the pictures only
    settled: bool = False  # whether these settled clock and range
    live: bool = False  # `flown` is then the first pose, and later poses follow during the run
    watched: bool = False  # a viewer or a live port is attached, so growing images are sent too
    tasks: tuple[Task, ...] = ("detect", "image", "map")
    detect: DetectStage = field(default_factory=DetectStage)
    range_time: RangeTime = field(default_factory=RangeTime)
    sampled: SampledFrames = field(default_factory=SampledFrames)
    quietest: QuietestFrames = field(default_factory=QuietestFrames)
    own_echo: OwnEchoFilter = field(default_factory=OwnEchoFilter)
    health: HealthMonitor = field(default_factory=HealthMonitor)
    history: MapHistory = field(default_factory=MapHistory)
    plane: ImagePlane | None = None
    map: MapStage | None = None
    obstacles: ObstacleTable | None = None
    exploration: Exploration | None = None  # the source, where it chose its own path
    odometry: RadarPoses | None = None  # where the poses come from the radars
    imu: Imu | None = None  # readings that came with a recording
    findings: list[str] = field(default_factory=list)  # sentences of the report
    unmapped: Floats | None = None  # (k, 3) surface in sight that is not on the map [m]
    map_place: str = ""  # the plane or volume of the map, in words that begin a sentence
    timing: dict[str, float] = field(default_factory=dict)
    sinks: list[Sink] = field(default_factory=list)  # requested sinks, open
    rival: Callable[[], Compared] | None = None  # runs another method on the same flight
    objects: list[ObjectOnMap] = field(default_factory=list)  # what the map shows of each, where the world is known

    @property
    def folder(self) -> Path:
        """Where its files are now."""
        return self.place.path

    @property
    def title(self) -> str:
        """Title of its figures."""
        return self.scenario.title or self.scenario.name


@dataclass(frozen=True, slots=True)
class Report:
    """Results of a finished run."""

    folder: Path
    outcome: Outcome
    metrics: dict[str, Metric]
    figures: tuple[Path, ...]
    objects: tuple[ObjectOnMap, ...] = ()
    compared: Compared | None = None
    findings: tuple[str, ...] = ()  # sentences of the report


def of_scenario(place: RunFolder, simulated: Simulated) -> Run:
    """Make the run of a simulated scenario."""
    scenario = simulated.scenario
    return Run(place, scenario, simulated, simulated.scene, simulated.flown, tasks=scenario.do,
               odometry=simulated.odometry)  # fmt: skip
