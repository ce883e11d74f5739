"""Compare the mapping node's CPU and memory with a BeagleBone Black (thesis table 5.1)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from studies.thesis.node import NodeCost, measure_node
from studies.thesis.tables import stream_part
from studies.thesis.workspace import Workspace
from ullage.experiments.catalog import find_scenario
from ullage.experiments.folder import provenance
from ullage.experiments.simulated import prepare
from ullage.kernels.elfes import Cells, Lobe, Reading, insert_reading
from ullage.ports.registry import sink
from ullage.view.figures import drawing

STEP_M, REACH_M = 0.1, 25.0
"""The thesis' map of 50 x 50 m, in the cells of its figures 6.13 to 6.18."""
PART_S = {False: 12.0, True: 3.0}
"""Seconds of flight, by whether the run is small."""
REPEATS = {False: 3, True: 1}
"""Of each row, by whether the run is small: the cheapest counts, as the first may compile and other work only adds."""
SLOW = {"every_s": 1.0, "batch_s": 1.0}
RUNS: dict[str, tuple[str, dict[str, Any]]] = {
    "NTNU room, Elfes": ("ntnu-mapping", {"method": "elfes"}),
    "cargo hold, Elfes": ("cargo-hold", {"method": "elfes"}),
    "NTNU room, ullage": ("ntnu-mapping-physical", {"method": "likelihood"}),
    "cargo hold, ullage": ("cargo-hold-physical", {"method": "likelihood"}),
    "NTNU room, ullage, 1 Hz": ("ntnu-mapping-physical", {"method": "likelihood"} | SLOW),
    "cargo hold, ullage, 1 Hz": ("cargo-hold-physical", {"method": "likelihood"} | SLOW),
}
"""Scenario and options of the node in each row. Without `SLOW` it maps every 0.1 s and publishes at 5 Hz."""
REFERENCE_S = 0.050
"""CPU time of `yardstick` on the reference machine [s]."""


@dataclass(frozen=True, slots=True)
class Board:
    """Single-board computer, with its speed relative to the reference core."""

    name: str
    memory_mb: float
    cores: int
    coremark: float  # one core [iterations/s]
    whetstone: float  # one core, double precision [MWIPS]

    @property
    def integer(self) -> float:
        """Ratio of the reference core's CoreMark to this board's."""
        return REFERENCE.coremark / self.coremark

    @property
    def double(self) -> float:
        """Ratio of the reference core's Whetstone to this board's."""
        return REFERENCE.whetstone / self.whetstone


REFERENCE = Board("reference core (AMD EPYC, Zen 5)", 0.0, 1, 40_800, 21_400)
"""CoreMark of commit d5fad6b and the C Whetstone of [SbcBenchmarks], gcc 12.2 -O3, by CPU time (November 2026)."""
BEAGLEBONE = Board("BeagleBone Black", 512, 1, 2497, 485.4)
PI_4 = Board("Raspberry Pi 4", 4096, 4, 15_600 / 2, 5555.6)
"""Published in [SbcBenchmarks]: gcc -O3; CoreMark ran two threads, so that a Pi's core has half of the printed sum."""


def yardstick(readings: int = 2000) -> float:
    """Time Elfes' kernel, to relate figures of this machine to the reference core [s of CPU]."""
    empty, box = np.zeros((500, 500), np.float32), np.zeros(4, np.int64)
    occupied = np.zeros_like(empty)
    cells, lobe, times = Cells(-25.0, -25.0, 0.1), Lobe(0.567, 0.15), []
    for count in (10, readings, readings, readings):
        start = time.process_time()
        for i in range(count):
            insert_reading(empty, occupied, cells, Reading(0.0, 0.0, 0.7 * i, 0.3, 4.0, True), lobe, box)
        times.append(time.process_time() - start)
    return min(times[1:])


def loads(cost: NodeCost, board: Board, scale: float) -> tuple[float, float]:
    """Estimate the CPU of the node at real time on a board, by CoreMark and by Whetstone [% of one core].

    Args:
        cost: as measured here.
        board: where it would run.
        scale: speed of this machine over that of the reference core.
    """
    return cost.percent * scale * board.integer, cost.percent * scale * board.double


def run(work: Workspace) -> None:
    """Measure the node on four recordings and compare it with the boards."""
    costs, files = {}, {}
    for row, (scenario, options) in RUNS.items():
        if work.quick and SLOW.items() <= options.items():
            continue  # it holds no more memory than the faster node
        if scenario not in files:
            work.log(f"{scenario}: recording")
            files[scenario] = record_part(work.folder / f"{scenario}.mcap", scenario, PART_S[work.quick])
        work.log(f"{row}: mapping in a process of its own")
        runs = [
            measure_node(files[scenario], step_m=STEP_M, reach_m=REACH_M, **options) for _ in range(REPEATS[work.quick])
        ]
        costs[row] = min(runs, key=lambda cost: cost.cpu_s)
    for file in files.values():
        file.unlink()
    scale = REFERENCE_S / yardstick()
    tabulate(work, costs, scale)
    state(work, costs, scale)
    path = work.folder / "budget.png"
    draw(path, costs, scale)
    work.results.add_figure(path, "table 5.1", "The mapping node beside one core and the memory of a BeagleBone Black.")


def record_part(path: Path, scenario: str, part_s: float) -> Path:
    """Write the first seconds of a scenario as a recording."""
    simulated = prepare(find_scenario(scenario))
    out = sink(path, overwrite=True)
    try:
        for piece in stream_part(simulated, min(part_s, simulated.flown.duration_s)):
            out.write(piece)
    finally:
        out.close()
    return path


def tabulate(work: Workspace, costs: dict[str, NodeCost], scale: float) -> None:
    """Tabulate CPU and memory of each run, here and on the boards."""
    rows = []
    for name, cost in costs.items():
        spans = [_span(loads(cost, board, scale)) for board in (BEAGLEBONE, PI_4)]
        rows.append((name, f"{cost.percent:.1f}", *spans, f"{cost.import_mb:.0f}", f"{cost.peak_mb:.0f}",
                     f"{cost.grid_kb:.0f}", f"{cost.start_cpu_s:.1f}"))  # fmt: skip
    machine = provenance()["machine"]["processor"]
    work.results.add_table(
        "The mapping node on board",
        ("run", "CPU here [%]", "BeagleBone Black [%]", "Raspberry Pi 4 [%]", "memory after imports [MB]",
         "peak memory [MB]", "map [kB]", "CPU to start [s]"),
        rows,
        note=f"% of one core at real time, four X4M05 at 17 frames/s, map of 50 x 50 m in cells of {STEP_M:g} m, "
        f"published at 5 Hz where nothing else is said. Measured in a process of its own on {machine} "
        f"({scale:.2f} times the reference core). "
        f"Boards: from CoreMark to Whetstone, {BEAGLEBONE.integer:.0f} to {BEAGLEBONE.double:.0f} times slower "
        f"(BeagleBone) and {PI_4.integer:.1f} to {PI_4.double:.1f} (Pi 4, one of its four cores) [SbcBenchmarks].",
    )  # fmt: skip


def _span(pair: Sequence[float]) -> str:
    return f"{min(pair):.0f} to {max(pair):.0f}"


def state(work: Workspace, costs: dict[str, NodeCost], scale: float) -> None:
    """State what fits on the thesis' board."""
    ours = [cost for name, cost in costs.items() if "ullage" in name]
    elfes = [cost for name, cost in costs.items() if "Elfes" in name]
    hold = work.results.add_statement
    fits = max(loads(cost, BEAGLEBONE, scale)[1] for cost in elfes)
    if not work.quick:  # a small run maps too little to time: other work on the machine may double it
        hold("Elfes at real time fits one BeagleBone core, by Whetstone", "5.3", fits, "%", high=100)
        hold("ullage's mapper at real time fits one core of the reference machine", "beyond",
             max(cost.percent * scale for cost in ours), "%", high=100)  # fmt: skip
        hold("ullage's mapper needs more than one BeagleBone core, by CoreMark", "5.3",
             min(loads(cost, BEAGLEBONE, scale)[0] for cost in ours), "%", low=100)  # fmt: skip
    hold("the node's peak memory over the board's 512 MB", "table 5.1",
         max(cost.peak_mb for cost in costs.values()) / BEAGLEBONE.memory_mb, "", high=1)  # fmt: skip
    for name, cost in costs.items():
        work.results.numbers[f"cpu {name}"] = cost.percent
        work.results.numbers[f"memory {name}"] = cost.peak_mb


def draw(path: Path, costs: dict[str, NodeCost], scale: float) -> None:
    """Draw CPU on the BeagleBone as bars from CoreMark to Whetstone, and memory beside it."""
    names = list(costs)
    with drawing(path, size_in=(10.0, 3.4), columns=2) as (_, axes):
        for row, name in enumerate(names):
            low, high = sorted(loads(costs[name], BEAGLEBONE, scale))
            axes[0].barh(row, high - low, left=low, color="tab:orange")
        axes[0].axvline(100, color="k", ls="--", lw=1)
        axes[0].set(xscale="log", xlabel="CPU on a BeagleBone Black [% of its one core]", yticks=range(len(names)),
                    yticklabels=names, title="CPU, by CoreMark to Whetstone", xlim=(10, None))  # fmt: skip
        peaks = [costs[name].peak_mb for name in names]
        axes[1].barh(range(len(names)), peaks, color="tab:blue", label="with the map and its buffers")
        axes[1].barh(range(len(names)), [costs[name].import_mb for name in names], color="tab:gray",
                     label="Python and libraries")  # fmt: skip
        axes[1].axvline(BEAGLEBONE.memory_mb, color="k", ls="--", lw=1)
        axes[1].set(xlabel="peak resident memory [MB]", yticks=[], title="memory; dashed: the board's 512 MB")
        axes[1].legend(fontsize=8)
