"""State of a run while it goes on, and its report when it is finished."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from ullage.arrays import Floats
from ullage.config import Scenario, Task
from ullage.data import Metric, Trajectory
from ullage.experiments.folder import RunFolder
from ullage.experiments.imaging import ImagePlane
from ullage.experiments.radar_poses import RadarPoses
from ullage.experiments.report_collectors import ObstacleTable, QuietestFrames, RangeTime, SampledFrames
from ullage.experiments.simulated import Simulated
from ullage.experiments.verdict import ObjectOnMap
from ullage.pipeline import DetectStage, MapStage, Outcome, Sink, Source
from ullage.processing.health import HealthMonitor
from ullage.processing.own_echo import OwnEchoFilter
from ullage.view.replay import MapHistory
from ullage.world.scene import Scene

if TYPE_CHECKING:
    from ullage.experiments.exploration import Exploration


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
