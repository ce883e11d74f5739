"""Compiles the kernels of the main job once, on a world of two triangles, so that a run starts at full speed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ullage import kernels
from ullage.config import Fidelity, MapMethod

FOLDER = Path(kernels.__path__[0])


def compiled() -> bool:
    """Whether every kernel module has a compiled copy newer than its source."""
    sources = [p for p in FOLDER.glob("*.py") if "njit" in p.read_text(encoding="utf-8")]
    return all(_newest(p) > p.stat().st_mtime for p in sources)


def _newest(source: Path) -> float:
    copies = (source.parent / "__pycache__").glob(f"{source.stem}.*.nbi")
    return max((p.stat().st_mtime for p in copies), default=0.0)


def compile_kernels() -> None:
    """Run simulation, detection, imaging and mapping once, very small."""
    from ullage.data import Trajectory
    from ullage.grids import Grid
    from ullage.processing.detect import detect
    from ullage.processing.occupancy import map_occupancy
    from ullage.processing.sar import focus
    from ullage.radar.simulate import simulate
    from ullage.specs import RadarSpec
    from ullage.world import scenes

    wall = scenes.plate(width_m=0.5, height_m=0.5, distance_m=2.0)
    track = Trajectory.line((0, -0.1, 0), (0, 0.1, 0), 0.5, 17)
    grid = Grid.covering(np.array([[-1, -1, -1], [3, 1, 1]]), 0.2)
    radar = RadarSpec.preset("x4m05")
    fidelities: tuple[Fidelity, ...] = ("thesis", "physical")
    methods: tuple[MapMethod, ...] = ("elfes", "ullage")
    for fidelity in fidelities:
        frames = simulate(wall, track, radar, fidelity=fidelity)
        detect(frames)
        focus(frames, grid, method="summation" if fidelity == "thesis" else "backprojection")
        for method in methods:
            map_occupancy(frames, grid, method=method)
