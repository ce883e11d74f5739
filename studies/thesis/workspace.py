"""Workspace of an experiment: its folder, settings and results, and a method that runs scenarios."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from studies.thesis.results import Results
from ullage.config import Scenario
from ullage.data import Frames, Metric, Trajectory, joined
from ullage.experiments.catalog import find_scenario
from ullage.experiments.folder import RunFolder
from ullage.experiments.run import of_scenario
from ullage.experiments.runner import execute
from ullage.experiments.simulated import Simulated, prepare, radars_and_world
from ullage.grids import Image, OccupancyMap
from ullage.world.scene import Scene

Log = Callable[[str], None]


class Interrupted(KeyboardInterrupt):
    """Raised on Ctrl-C during a scenario, after its frames so far are written."""


@dataclass(slots=True)
class FrameCollector:
    """Sink that collects every frame in memory."""

    parts: dict[str, list[Frames]] = field(default_factory=dict)

    def write(self, item: Any) -> None:
        """Keep frames; ignore other items."""
        if isinstance(item, Mapping):
            for name, part in item.items():
                self.parts.setdefault(name, []).append(part)

    def close(self) -> None:
        """Do nothing: no file is open."""

    def frames(self) -> dict[str, Frames]:
        """Return all frames by sensor."""
        return {name: joined(parts) for name, parts in self.parts.items()}


@dataclass(frozen=True, slots=True, eq=False)
class Flown:
    """Finished run of a scenario: world, flight, frames and results."""

    name: str
    simulated: Simulated
    frames: dict[str, Frames]
    image: Image | None
    omap: OccupancyMap | None
    metrics: dict[str, Metric]

    @property
    def scene(self) -> Scene:
        """World of the scenario."""
        return self.simulated.scene

    @property
    def track(self) -> Trajectory:
        """True path of the body."""
        return self.simulated.flown

    @property
    def height_m(self) -> float:
        """Mean height of the flight [m]."""
        return float(self.track.position[:, 2].mean())

    @property
    def only(self) -> Frames:
        """Frames of the only or first radar."""
        return next(iter(self.frames.values()))

    def number(self, name: str) -> float:
        """Return the value of a metric."""
        return self.metrics[name].value


@dataclass(slots=True)
class Workspace:
    """Folder, settings and results of one experiment while it runs."""

    folder: Path
    quick: bool
    log: Log
    recordings: Path
    results: Results = field(default_factory=Results)
    flights: dict[str, Simulated] = field(default_factory=dict)

    def prepared(self, scenario: Scenario) -> Simulated:
        """Load a scenario's world and fly it; scenarios with the same flight share it."""
        flight = scenario.flight, scenario.world, scenario.navigation, scenario.sensing.rig, scenario.seed
        key = repr((*flight, scenario.sensing.rate_hz))
        if key not in self.flights:
            self.flights[key] = prepare(scenario)
            return self.flights[key]
        same = self.flights[key]
        return replace(same, scenario=scenario, rig=radars_and_world(scenario, same.scene)[0])

    def fly(self, name: str, options: Sequence[str] = (), *, reads: Sequence[str] = ("image", "map")) -> Flown:
        """Run a scenario into its own run folder and keep its frames.

        Args:
            name: of a shipped scenario.
            options: `a.b=value` over it.
            reads: what the experiment reads beside frames: `image`, `map`. A small run makes nothing else.

        Raises:
            Interrupted: Ctrl-C.
        """
        if self.quick and set(reads) != {"image", "map"}:
            options = [f"do=[{', '.join(('detect', *reads))}]", *options]
        scenario = find_scenario(name, options=options)
        if options:  # the bounds are those of the shipped scenario
            scenario = scenario.but(expect={})
            self.log(f"{name}: its bounds are not checked, as it is flown with other options")
        self.log(f"{name}: flying")
        simulated = self.prepared(scenario)
        place = RunFolder.of(scenario.name, scenario.digest, root=self.folder / "runs").begin(force=True)
        collector, started = FrameCollector(), time.monotonic()
        total = max(simulated.flown.duration_s, 1e-9)

        def report_progress(done: float) -> None:
            self.log(f"{name}: {100 * min(done / total, 1):.0f} %, {time.monotonic() - started:.0f} s")

        report = execute(
            of_scenario(place, simulated), sinks=[collector], progress=report_progress, log=lambda _: None, draw=False
        )
        if report.outcome.interrupted:
            raise Interrupted
        self.results.scenarios.append(str(report.folder.relative_to(self.folder)))
        results = report.outcome.results
        image = next((item for item in results if isinstance(item, Image)), None)
        omap = next((item for item in results if isinstance(item, OccupancyMap)), None)
        return Flown(name, simulated, collector.frames(), image, omap, report.metrics)
