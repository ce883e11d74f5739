"""Publishes a short flight with everything that flows. Argument: the sink's address."""

from __future__ import annotations

import sys

import numpy as np

import ullage as ul
from ullage.data import sensors_of
from ullage.grids import Image, OccupancyMap
from ullage.pipeline import sink


def main() -> None:
    scene = ul.scenes.room(size_m=(6, 4, 3))
    path = ul.Trajectory.line((-1, 0, 0), (1, 0, 0), 1.0, 17.0)
    frames = ul.simulate(scene, path, ul.Rig.preset("thesis-4"), fidelity="thesis", seed=3)
    plane, volume = ul.Grid((-3.0, -2.0, 0.0), 0.1, (40, 60)), ul.Grid((-3.0, -2.0, -1.5), 0.5, (6, 8, 12))
    with sink(sys.argv[1]) as out:
        out.write(scene)
        for start in range(0, len(path), 5):
            out.write({part.sensor: part[start : start + 5] for part in sensors_of(frames)})
            percent = np.full(plane.shape, -1, np.int8)
            percent[5 : 10 + start, 3:20] = 100
            out.write(OccupancyMap(plane, percent))
        cells = np.zeros(volume.shape, np.int8)
        cells[0] = 100
        out.write(OccupancyMap(volume, cells))
        out.write(Image(plane, np.ones(plane.shape, np.complex64)))
        print("written", flush=True)


main()
