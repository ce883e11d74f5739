"""Explain why the mapping node's CPU grows less in the hold than the thesis' (table 6.4)."""

from __future__ import annotations

import sys
import time
from types import FunctionType
from typing import Any

import numpy as np

from studies.thesis.workspace import Workspace
from ullage.data import Frames
from ullage.experiments.catalog import find_scenario
from ullage.experiments.simulated import prepare
from ullage.grids import Grid
from ullage.kernels.elfes import insert_reading
from ullage.processing.elfes import ElfesMapper
from ullage.radar.simulate import simulate
from ullage.world.scene import Scene

Costs = dict[str, tuple[float, float]]
"""CPU of a reading [s] and cells that it traverses, by what was measured."""
ROOM, HOLD, EMPTY = "NTNU room", "cargo hold", "cargo hold, no echoes"
THESIS_RATIO = 128 / 0.4 / 15
"""CPU of the thesis' mapping node in the hold over that in the NTNU room, both at real time (tables 6.2, 6.4)."""


def interpreted(kernel: Any) -> Any:
    """Return a compiled function, with the functions of its module that it calls, as plain Python."""
    module = dict(vars(sys.modules[kernel.py_func.__module__]))
    for name, value in list(module.items()):
        plain = getattr(value, "py_func", None)
        if plain is not None:
            module[name] = FunctionType(plain.__code__, module, name, plain.__defaults__)
    return module[kernel.py_func.__name__]


def reading_cost(frames: dict[str, Frames], grid: Grid, kernel: Any = insert_reading) -> tuple[float, float]:
    """Measure the CPU of a reading [s], the least of three, and the cells it traverses, as means over the readings.

    Args:
        frames: by sensor.
        grid: of the map.
        kernel: that blends a reading into the map's layers.
    """
    mapper, costs, cells = ElfesMapper(grid, kernel=kernel), [], []
    parts = list(frames.values())
    for _ in range(3):
        start = time.process_time()
        for part in parts:
            mapper.update(part)
        costs.append((time.process_time() - start) / sum(map(len, parts)))
    for part in parts:
        for one in part.chunks(1):
            mapper.update(one)
            if mapper.traversed is not None:
                cells.append(float(np.prod([cut.stop - cut.start for cut in mapper.traversed])))
    return min(costs), float(np.mean(cells))


def run(work: Workspace) -> None:
    """Measure table 6.4: the cost of one reading in the NTNU room, in the hold, and with nothing in range."""
    work.log("CPU of a reading")
    cases: dict[str, tuple[dict[str, Frames], Grid]] = {}
    for name, scenario in ((ROOM, "ntnu-mapping"), (HOLD, "cargo-hold")):
        flight = prepare(find_scenario(scenario))
        track = flight.flown[:: 160 if work.quick else 20]
        box = np.stack([np.minimum(flight.scene.bounds[0], track.position.min(0)),
                        np.maximum(flight.scene.bounds[1], track.position.max(0))])  # fmt: skip
        for scene, suffix in ((flight.scene, ""), (Scene.empty(), ", no echoes")):
            if scenario == "cargo-hold" or not suffix:
                frames = dict(simulate(scene, track, flight.rig, fidelity="thesis", seed=7))
                cases[name + suffix] = frames, Grid.covering(box, 0.1, margin_m=1.0)
    compiled = {name: reading_cost(*case) for name, case in cases.items()}
    plain = {name: reading_cost(*case, kernel=interpreted(insert_reading)) for name, case in cases.items()}
    tabulate(work, compiled, plain)
    state(work, compiled, plain)


def over_room(costs: Costs) -> dict[str, float]:
    """Return the CPU of a reading relative to that in the room."""
    return {name: cost / costs[ROOM][0] for name, (cost, _) in costs.items()}


def tabulate(work: Workspace, compiled: Costs, plain: Costs) -> None:
    """Tabulate cells and CPU of a reading, also relative to those in the room."""
    over = over_room(compiled), over_room(plain)
    cells = {name: compiled[name][1] / compiled[ROOM][1] for name in compiled}
    rows = [(name, f"{compiled[name][1]:.0f}", f"{cells[name]:.1f}",
             f"{1e6 * compiled[name][0]:.0f}", f"{over[0][name]:.1f}",
             f"{1e3 * plain[name][0]:.2f}", f"{over[1][name]:.1f}") for name in compiled]  # fmt: skip
    work.results.add_table(
        "A reading of Elfes' mapper", ("frames", "cells traversed", "over the room", "compiled [us]", "over the room",
                                       "plain Python [ms]", "over the room"), rows,
        note="The same update, compiled and run by the Python interpreter. \"No echoes\": the hold's flight and grid, "
        "with nothing in range.",
    )  # fmt: skip


def state(work: Workspace, compiled: Costs, plain: Costs) -> None:
    """State which part of the thesis' ratio the interpreter and the lack of echoes explain."""
    cells = {name: compiled[name][1] / compiled[ROOM][1] for name in compiled}
    fast, slow = over_room(compiled), over_room(plain)
    work.results.add_statement(
        "Elfes in the hold: a reading without echoes passes so many times the cells of one with echoes",
        "7.3",
        cells[EMPTY] / cells[HOLD],
        low=2.0,
    )
    work.results.add_difference(
        "table 6.4", f"the mapping node takes {THESIS_RATIO:.0f} times as much as in the NTNU room",
        f"{fast[HOLD]:.1f} times a reading, {fast[EMPTY]:.1f} times where nothing is in range",
        f"two parts. Detection: in our hold readings end at walls, {cells[HOLD]:.1f} times the room's cells; without "
        f"echoes it is {cells[EMPTY]:.1f} times. Language: the same update in plain Python takes "
        f"{slow[HOLD]:.1f} and {slow[EMPTY]:.1f} times as much as in the room; compiled, a fixed cost per reading "
        f"weighs more. Of {THESIS_RATIO:.0f} a factor of {THESIS_RATIO / slow[EMPTY]:.1f} remains unknown.",
    )  # fmt: skip
