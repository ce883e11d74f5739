"""Size of one map in several representations: python -m studies.tables.map_sizes [SCENARIO]."""

from __future__ import annotations

import sys

import numpy as np

from ullage.experiments.catalog import find_scenario
from ullage.experiments.simulated import prepare
from ullage.grids import Grid
from ullage.processing.occupancy import map_occupancy
from ullage.radar.simulate import simulate

NODE, SURFEL = 8, 28  # bytes: a quadtree leaf with its key and value; position, normal and radius at 32 bit


def quadtree_leaves(classes: np.ndarray) -> int:
    """Count the leaves of a quadtree over free, occupied and unknown cells, each leaf of one class."""
    size = 1 << int(np.ceil(np.log2(max(classes.shape))))
    square = np.zeros((size, size), np.int8)
    square[: classes.shape[0], : classes.shape[1]] = classes
    low = high = square
    same = np.ones(square.shape, bool)
    leaves = 0
    while True:
        if len(low) == 1:
            return leaves + int(same[0, 0])
        quads = same.reshape(len(low) // 2, 2, -1, 2)
        low4, high4 = (a.reshape(len(a) // 2, 2, -1, 2) for a in (low, high))
        least, most = low4.min((1, 3)), high4.max((1, 3))
        merged = quads.all((1, 3)) & (least == most)
        leaves += int((quads & ~merged[:, None, :, None]).sum())
        low, high, same = least, most, merged


def main() -> None:
    plan = find_scenario(sys.argv[1] if len(sys.argv) > 1 else "ntnu-mapping-physical")
    made = prepare(plan)
    frames = simulate(made.scene, made.flown, made.rig, fidelity=plan.sensing.fidelity, seed=plan.seed)
    centre = made.flown.position.mean(0)
    print("cells [m] | 64 bit, dense | int8, dense | ullage's tiles | quadtree | surfels")
    for step in (0.2, 0.1, 0.05):
        omap = map_occupancy(frames, Grid.covering(np.stack([centre - 25, centre + 25]), step), method=plan.map.method)
        percent = np.asarray(omap.percent)
        classes = np.where(percent < 0, 0, np.where(percent > 50, 2, 1)).astype(np.int8)
        sizes = (8 * percent.size, percent.size, omap.nbytes, NODE * quadtree_leaves(classes),
                 SURFEL * int((classes == 2).sum()))  # fmt: skip
        print(f"{step:g} | " + " | ".join(f"{size / 1e3:.1f} kB" for size in sizes))


if __name__ == "__main__":
    main()
