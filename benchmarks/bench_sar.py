"""Coherent 2D imaging at 2.5 cm of four sensors at 25 Hz in a local window, as a share of one core."""

from __future__ import annotations

import time

import numpy as np

import ullage as ul
from ullage.processing.backprojection import Backprojector


def cost(reach: float, seconds: int = 2) -> float:
    """CPU time of one profile into a square window of this side [ms]."""
    spec = ul.RadarSpec.preset("x4m05", noise=None)
    rng = np.random.default_rng(0)
    grid = ul.Grid((0.0, -reach / 2, 0.0), 0.025, (int(reach / 0.025), int(reach / 0.025)))
    image = Backprojector(grid, threads=1)
    path = ul.Trajectory.line((0, 0, 0), (0, 0.5 * seconds, 0), 0.5, 25)
    samples = rng.standard_normal((len(path), spec.bins, 2)) @ [1, 1j]
    frames = ul.Frames(samples, spec.range_m, path.t_ns, spec, poses=path)
    image.update(frames[:2])
    start = time.process_time()
    for part in frames.chunks(25):
        image.update(part)
    each = (time.process_time() - start) / len(frames)
    print(f"{reach:.0f} x {reach:.0f} m, {grid.size} cells: {1e3 * each:.2f} CPU-ms a profile,", end=" ")
    print(f"{each * 1e9 / grid.size:.1f} ns a cell; 4 x 25 Hz take {1e4 * each:.0f} % of a core (target 30 %)")
    return 1e3 * each


def main() -> None:
    for reach in (5.0, 10.0):
        cost(reach)


if __name__ == "__main__":
    main()
