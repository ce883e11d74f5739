"""Compiles the kernels a run needs, once after installation, on a world of two triangles."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from ullage import kernels
from ullage.config import Fidelity, MapMethod, Scenario

FOLDER = Path(kernels.__path__[0])
NEEDED = {
    "hector": ("flight", "proximity"),
    "thesis": ("rays", "receiver"),
    "physical": (
        "facets",
        "edges",
        "rims",
        "lines",
        "wires",
        "fringe",
        "double_fringe",
        "grit",
        "beams",
        "bounces",
        "rays",
        "receiver",
    ),
    "elfes": ("elfes",),
    "ullage": ("occupancy", "occupancy_cone", "occupancy_listen", "occupancy_show"),
    "backprojection": ("backprojection",),
}
"""Kernel modules behind each part of a run."""


def parts_of(scenario: Scenario) -> tuple[str, ...]:
    """The parts of `NEEDED` that a scenario runs."""
    parts = [scenario.flight.vehicle, scenario.sensing.fidelity]
    parts += [scenario.map.method] if "map" in scenario.do else []
    parts += [scenario.image.method] if "image" in scenario.do else []
    return tuple(part for part in parts if part in NEEDED)


def compiled(parts: Iterable[str] = tuple(NEEDED)) -> bool:
    """Whether every kernel module behind these parts has a compiled copy newer than its source."""
    sources = [FOLDER / f"{stem}.py" for part in parts for stem in NEEDED[part]]
    return all(_newest(source) > source.stat().st_mtime for source in sources)


def _newest(source: Path) -> float:
    copies = (source.parent / "__pycache__").glob(f"{source.stem}.*.nbi")
    return max((p.stat().st_mtime for p in copies), default=0.0)


def compile_kernels(parts: Iterable[str] = tuple(NEEDED)) -> None:
    """Run these parts once, very small."""
    from ullage.data import Trajectory
    from ullage.flight.missions import Waypoints
    from ullage.flight.vehicle import fly
    from ullage.grids import Grid
    from ullage.processing.occupancy import map_occupancy
    from ullage.processing.sar import focus
    from ullage.radar.simulate import simulate
    from ullage.specs import RadarSpec
    from ullage.world import scenes

    wanted = set(parts)
    wall = scenes.plate(width_m=0.5, height_m=0.5, distance_m=2.0)
    track = Trajectory.line((0, -0.1, 0), (0, 0.1, 0), 0.5, 17)
    grid = Grid.covering(np.array([[-1, -1, -1], [3, 1, 1]]), 0.2)
    if "hector" in wanted:
        fly(Waypoints(np.array([[0.0, 0, 0], [0, 0.1, 0]])), scene=wall, rate_hz=10)
    fidelities: tuple[Fidelity, ...] = ("thesis", "physical")
    methods: tuple[MapMethod, ...] = ("elfes", "ullage")
    for fidelity in [f for f in fidelities if f in wanted]:
        frames = simulate(wall, track, RadarSpec.preset("x4m05"), fidelity=fidelity, max_bounces=2)
        for method in [m for m in methods if m in wanted]:
            map_occupancy(frames, grid, method=method)
        if fidelity == "physical" and "backprojection" in wanted:
            focus(frames, grid)
