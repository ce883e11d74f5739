"""Equations 5.1 and 5.2: what a map of 50 x 50 m takes, as the thesis computes it and as ullage keeps it.

Eq. 5.2 is misprinted: it multiplies 50000 by 8 bytes where eq. 5.1 has found 1000000 cells; its 8 MB is right.
"""

import numpy as np

import ullage as ul
from ullage.processing.metrics import map_size


def main() -> None:
    cells = round(50 / 0.05) ** 2
    print(f"eq. 5.1: {cells} cells; eq. 5.2: {cells * 8 / 1e6:g} MB at 64 bit (as printed: {50000 * 8 / 1e6:g} MB)")
    print(f"one byte a cell, as numpy allowed the thesis: {cells / 1e6:g} MB")

    room = ul.scenes.room(size_m=(8, 6, 3), plate={"width_m": 1.0, "height_m": 1.0, "distance_m": 2.0})
    path = ul.Trajectory.line((-1.5, -1.5, 0), (-1.5, 1.5, 0), 0.5, 10)
    frames = ul.simulate(room, path, ul.Rig.preset("thesis-4"), fidelity="thesis")
    grid = ul.Grid(origin_m=(-25.0, -25.0, 0.0), step_m=0.05, shape=(1000, 1000))
    omap = ul.map_occupancy(frames, grid)
    omap.plot(scene=room, path=path).figure.savefig("thesis_memory.png")
    size = map_size(omap)
    print(f"ullage, a room mapped on that grid: {size['ram'].value / 1e3:.0f} kB in memory, "
          f"{size['file'].value / 1e3:.1f} kB as a file")  # fmt: skip

    if cells != 1_000_000 or not np.count_nonzero(omap.percent >= 0):
        raise SystemExit("the grid of eq. 5.1 is not what was mapped")
    if not size["ram"].value < 0.1 * cells:
        raise SystemExit("blocks should take far less than a byte a cell")


if __name__ == "__main__":
    main()
