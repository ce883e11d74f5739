"""Runs a short flight through the pipeline, with everything a run makes of it. Arguments: sinks to write to."""

from __future__ import annotations

import sys

import numpy as np

import ullage as ul
from ullage.grids import Grid
from ullage.pipeline import DetectStage, ImageStage, MapStage, run, sink


def main() -> None:
    seconds, *targets = sys.argv[1:]
    scene = ul.scenes.room(size_m=(6, 4, 3))
    path = ul.Trajectory.line((-1, 0, 0), (-1 + 0.2 * float(seconds), 0, 0), 0.2, 17.0)
    frames = ul.simulate(scene, path, ul.Rig.preset("thesis-4"), fidelity="thesis", seed=3)
    plane = Grid.covering(np.array([[-8.0, -8.0, 0.0], [8.0, 8.0, 0.0]]), 0.1)
    sinks = [sink(target) for target in targets]
    for taker in sinks:
        taker.write(scene)
    assert isinstance(frames, dict)
    pieces = [slice(0, 16), *(slice(start, start + 64) for start in range(16, len(path), 64))]

    class Pieces:
        def stream(self) -> object:
            return ({name: part[piece] for name, part in frames.items()} for piece in pieces)

    stages = [DetectStage(), MapStage(plane, "elfes"), ImageStage(plane, "summation")]
    run(Pieces(), stages=stages, sinks=sinks)  # type: ignore[arg-type]


main()
