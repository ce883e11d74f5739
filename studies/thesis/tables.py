"""Measure speed, CPU and memory of every stage, next to the thesis' values (tables 6.1 to 6.4)."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import Any

import numpy as np

from studies.thesis.workspace import Workspace
from ullage.data import Frames
from ullage.experiments.catalog import find_scenario
from ullage.experiments.folder import provenance
from ullage.experiments.run import RangeTime
from ullage.experiments.simulated import Simulated, prepare
from ullage.flow import Stage
from ullage.grids import Grid
from ullage.pipeline import ImageStage, MapStage
from ullage.radar.simulate import simulate_stream

PRINTED = {
    "6.1": ("NTNU room, amplitudes and SAR", 1.0, {"simulation": 75, "amplitudes": 25, "image": 35}),
    "6.2": ("NTNU room, mapping", 1.0, {"simulation": 80, "map": 15}),
    "6.3": ("cluttered room, mapping", 0.5, {"simulation": 60, "map": 55}),
    "6.4": ("cargo hold, mapping", 0.4, {"simulation": 38, "map": 128}),
}
"""What the thesis prints: title, speed relative to real time, CPU of each program [% of a core]."""
SCENARIOS = {"6.1": "ntnu-plate", "6.2": "ntnu-mapping", "6.3": "cluttered-room", "6.4": "cargo-hold"}
PART_S = 6.0
"""Seconds of flight that are measured under the physical law; the small run measures half of it, and an eighth."""


@dataclass(slots=True)
class Spent:
    """CPU time of each stage [s], duration of the flight [s], and sizes of map and image [bytes]."""

    flight_s: float = 0.0
    cpu_s: dict[str, float] = field(default_factory=dict)
    held: dict[str, int] = field(default_factory=dict)

    def clocked(self, name: str, do: Callable[[], Any]) -> Any:
        """Call a function and add its CPU time to a stage's."""
        start = time.process_time()
        out = do()
        self.cpu_s[name] = self.cpu_s.get(name, 0.0) + time.process_time() - start
        return out

    def percent(self, name: str) -> float:
        """Return the CPU of a stage at real time [% of a core]."""
        return 100 * self.cpu_s.get(name, 0.0) / self.flight_s


def run(work: Workspace) -> None:
    """Measure tables 6.1 to 6.4, each under both laws."""
    machine = provenance()["machine"]
    work.log("loading what is measured")  # or the first table would pay for it
    for options in ([], ["sensing.fidelity=physical", "map.method=likelihood", "image.method=backprojection"]):
        measure(SCENARIOS["6.2"], options, 0.3)
    for table, scenario in SCENARIOS.items():
        title, speed, printed = PRINTED[table]
        work.log(f"table {table}")
        thesis = measure(scenario, [], PART_S / 2 if work.quick else None)
        method = "image.method=backprojection"
        waves = ["sensing.fidelity=physical", "map.method=likelihood", method]
        physical = measure(scenario, waves, PART_S / 8 if work.quick else PART_S)
        rows: list[tuple[str, ...]] = [("speed, times real time", f"{speed:g}", _speed(thesis), _speed(physical))]
        for stage in ("simulation", "amplitudes", "image", "map"):
            value = f"{printed[stage]} % ({printed[stage] / speed:.0f} % at real time)" if stage in printed else ""
            rows.append(
                (f"CPU of {stage}", value, f"{thesis.percent(stage):.1f} %", f"{physical.percent(stage):.1f} %")
            )
        rows.append(("memory of the mapping process", "0.43 % of the machine's" if table != "6.1" else "",
                     f"{thesis.held['node'] / 1e6:.0f} MB", ""))  # fmt: skip
        rows.append(("memory of the finished map", "",
                     *(f"{spent.held.get('map', 0) / 1e3:.0f} kB" for spent in (thesis, physical))))  # fmt: skip
        work.results.add_table(
            f"Table {table}: {title}",
            ("", "thesis (i7-4790, 3.6 GHz, 8 threads)", "ullage, thesis' methods", "ullage, physical law and methods"),
            rows,
            note=f"CPU at real time, in % of one core of {machine['processor']}; speed is that of one core doing "
            f"it all. Of the physical run {physical.flight_s:.0f} s of flight were measured. What differs from the "
            "thesis: another CPU, compiled code for its Python nodes, no windows drawn, no physics engine while this "
            "runs, and no messages between processes. So the ratio says nothing of the methods alone.",
        )  # fmt: skip
        if table != "6.1":
            work.results.not_compared.append(
                f"Table {table}: the node's memory is 0.43 % of a machine whose memory is not printed; ours takes "
                f"{thesis.held['node'] / 1e6:.0f} MB with its Python."
            )
        work.results.numbers[f"speed {table}"] = _factor(thesis)
        work.results.numbers[f"physical speed {table}"] = _factor(physical)
        state(work, table, thesis)


def state(work: Workspace, table: str, spent: Spent) -> None:
    """Compare speed and CPU of the thesis' methods with a table of the thesis."""
    _, speed, printed = PRINTED[table]
    faster = f"the thesis' methods run faster than the thesis' {speed:g} times real time"
    work.results.add_statement(faster, f"table {table}", _factor(spent), "times", low=speed)
    if "map" in printed:
        work.results.add_statement(
            "Elfes' map takes less CPU at real time than the thesis' node",
            f"table {table}",
            spent.percent("map"),
            "%",
            high=printed["map"] / speed,
        )


def _factor(spent: Spent) -> float:
    return spent.flight_s / max(sum(spent.cpu_s.values()), 1e-9)


def _speed(spent: Spent) -> str:
    return f"{_factor(spent):.3g}"


@cache
def flight_of(scenario: str) -> tuple[Simulated, float]:
    """Return a scenario's flight, which both laws share, and the CPU time that flying it took [s]."""
    start = time.process_time()
    return prepare(find_scenario(scenario)), time.process_time() - start


def measure(scenario: str, options: list[str], part_s: float | None) -> Spent:
    """Run a scenario and time every stage separately.

    Args:
        scenario: name of a shipped one.
        options: `a.b=value` over it.
        part_s: seconds of flight to measure; None: all. The cost of flying is shared by time.
    """
    spent = Spent()
    plan = find_scenario(scenario, options=options)
    flown, cpu_s = flight_of(scenario)
    simulated = replace(flown, scenario=plan)
    whole = simulated.flown.duration_s
    spent.flight_s = whole if part_s is None else min(part_s, whole)
    spent.cpu_s["simulation"] = cpu_s * spent.flight_s / whole
    amplitudes, image, mapper = RangeTime(), *_stages(simulated)
    frames = iter(stream_part(simulated, spent.flight_s))
    while (chunk := spent.clocked("simulation", lambda: next(frames, None))) is not None:
        spent.clocked("amplitudes", partial(amplitudes.update, chunk))
        spent.clocked("image", partial(_all, image, chunk))
        spent.clocked("map", partial(_all, mapper, chunk))
    spent.clocked("image", lambda: list(image.finish()))
    omap = spent.clocked("map", lambda: list(mapper.finish()))[-1]
    spent.held["map"] = int(omap.nbytes)
    if plan.map.method == "elfes":
        spent.held["node"] = resident_bytes(mapper.grid)
    return spent


NODE = """
import sys
import numpy as np
from ullage.grids import Grid
from ullage.processing.elfes import ElfesMapper
step, rows, columns = float(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
mapper = ElfesMapper(Grid((0.0, 0.0, 0.0), step, (rows, columns)))
mapper.map()
print(next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM")))
"""


def resident_bytes(grid: Grid) -> int:
    """Return the peak resident memory of a process with only Elfes' mapper of a grid [bytes]."""
    command = [sys.executable, "-c", NODE, str(grid.step_m), str(grid.shape[-2]), str(grid.shape[-1])]
    told = subprocess.run(command, capture_output=True, text=True, check=True)
    return 1024 * int(told.stdout)


def _all(stage: Stage, chunk: dict[str, Frames]) -> list[Any]:
    return list(stage.update(chunk))


def _stages(simulated: Simulated) -> tuple[ImageStage, MapStage]:
    plan, path = simulated.scenario, simulated.flown.position
    box = np.stack(
        [np.minimum(simulated.scene.bounds[0], path.min(0)), np.maximum(simulated.scene.bounds[1], path.max(0))]
    )
    height = float(np.median(path[:, 2]))
    image = ImageStage(Grid.covering(box, plan.image.step_m, z_m=height), plan.image.method)
    return image, MapStage(Grid.covering(box, plan.map.step_m, margin_m=1.0), plan.map.method)


def stream_part(simulated: Simulated, part_s: float) -> Iterator[dict[str, Frames]]:
    """Give the frames of the first seconds of a flight."""
    count = int(np.searchsorted(simulated.flown.t_ns, part_s * 1e9)) + 1
    sensing = simulated.scenario.sensing
    yield from simulate_stream(
        simulated.scene, simulated.flown[:count], simulated.rig, fidelity=sensing.fidelity, seed=simulated.scenario.seed
    )
