"""What frames farther apart cost a map: the five judged flights with every n-th frame alone, as a Markdown table.

python benchmarks/spacing_table.py [--flights 5] [--volume]
"""

from __future__ import annotations

import argparse

import numpy as np

import ullage as ul
from ullage.data import Frames, Trajectory
from ullage.grids import Grid
from ullage.thesis import flights
from ullage.world.scene import Scene

STEP_M = 0.02  # of the judged flights: 0.5 m/s at 25 frames a second
PLANE, VOLUME = (1, 2, 3, 4, 5), (1, 2, 3, 5, 7)
COLUMNS = ("f1", "precision", "recall", "surface_declared_free", "free_found")


def judged(scene: Scene, path: Trajectory, grid: Grid, strides: tuple[int, ...], seed: int) -> np.ndarray:
    """Scores by stride and column of one flight; each map is judged by the frames that it had."""
    frames = flights.received(scene, path, seed)
    rows = []
    for stride in strides:
        sparse: dict[str, Frames] = {name: part[::stride] for name, part in frames.items()}
        found = ul.metrics.map_quality(ul.map_occupancy(sparse, grid, method="rules"), scene, sparse)
        rows.append([found[column].value for column in COLUMNS])
    return np.array(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=5)
    parser.add_argument("--volume", action="store_true", help="flights that rise and sink, in three dimensions")
    options = parser.parse_args()
    strides = VOLUME if options.volume else PLANE
    route = flights.rising_round if options.volume else flights.level_round
    scene = flights.judged_room()
    grid = flights.volume_of(scene) if options.volume else flights.plane_of(scene)
    found = np.array([judged(scene, route(seed), grid, strides, seed) for seed in range(options.flights)])
    print("| frames apart | F1 | precision, least to most | recall | surface free, most | free found |")
    print("|---|---|---|---|---|---|")
    for i, stride in enumerate(strides):
        f1, precision, recall, free, open_found = found[:, i].T
        print(
            f"| {100 * STEP_M * stride:.0f} cm | {f1.mean():.3f} | {precision.min():.3f} to {precision.max():.3f} "
            f"| {recall.mean():.3f} | {free.max():.3f} | {open_found.mean():.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
