"""Which cells of the default map are wrong, and which surface it misses: five flights, exact poses.

python benchmarks/map_errors.py [--seeds 5]
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np
from scipy.spatial import cKDTree

import ullage as ul
from ullage.data import Frames
from ullage.processing.metrics import MATCH_M, cell_centres
from ullage.processing.truth import surface_of
from ullage.thesis import flights
from ullage.world.scene import Scene
from ullage.world.section import section

NEAR_END_M = 0.45
CELLS = (
    "cells held occupied",
    "of these false",
    "second row, 0.15 m to a rounding",
    "beside an end or corner",
    "elsewhere",
)
SURFACE = (
    "surface observable",
    "of this missed",
    "missed by a map told the walls",
    "missed by both",
    "by ours alone, under 10 looks",
    "by ours alone, 10 to 30 looks",
    "by ours alone, 30 looks and more",
    "missed only by the map told the walls",
)


def centres(omap) -> np.ndarray:
    return cell_centres(omap.grid, np.flatnonzero(omap.occupied))[:, :2]


def ends_of(lines: np.ndarray) -> np.ndarray:
    """Ends and corners (n, 2) of lines (m, 2, 2): where none goes straight on."""
    starts = np.concatenate([lines, lines[:, ::-1]])
    way = starts[:, 1] - starts[:, 0]
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    out = []
    for at in np.unique(starts[:, 0].round(6), axis=0):
        mine = way[np.linalg.norm(starts[:, 0] - at, axis=1) < 1e-5]
        if (mine @ mine.T).min() > -0.999:
            out.append(at)
    return np.array(out)


def false_cells(omap, points: np.ndarray, ends: np.ndarray) -> Counter:
    """False cells: in the second row from a wall, beside an end or corner of a surface, or anywhere else."""
    cells = centres(omap)
    gap = cKDTree(points).query(cells)[0]
    to_end = cKDTree(ends).query(cells)[0]
    row = gap < MATCH_M + 0.01
    false, beside = gap > MATCH_M, to_end < NEAR_END_M
    kinds = (false, false & row, false & ~row & beside, false & ~row & ~beside)
    return Counter(dict(zip(CELLS, (len(cells), *(int(kind.sum()) for kind in kinds)), strict=True)))


def missed_surface(omap, perfect, surface) -> Counter:
    """Observable surface that is missed: by a perfect mapper too, with few looks, or with many."""
    seen = surface.observable(3)
    points, looks = surface.points[seen, :2], surface.looks[seen]
    ours, best = (cKDTree(centres(m)).query(points)[0] > MATCH_M for m in (omap, perfect))
    alone = ours & ~best
    kinds = (ours, best, ours & best, alone & (looks < 10), alone & (looks >= 10) & (looks < 30), alone & (looks >= 30),
             best & ~ours)  # fmt: skip
    return Counter(dict(zip(SURFACE, (len(points), *(int(kind.sum()) for kind in kinds)), strict=True)))


def of_flight(scene: Scene, grid: ul.Grid, frames: dict[str, Frames]) -> Counter:
    surface = surface_of(scene, grid, frames)
    omap, perfect = ul.map_occupancy(frames, grid, method="rules"), flights.told_walls(scene, frames, grid)
    ends = ends_of(section(scene, 0.0)[:, :, :2])
    return false_cells(omap, surface.points[:, :2], ends) + missed_surface(omap, perfect, surface)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=5)
    options = parser.parse_args()
    scene = flights.judged_room()
    grid = flights.plane_of(scene)
    total: Counter = Counter()
    for seed in range(options.seeds):
        frames = flights.received(scene, flights.level_round(seed), seed)
        total += of_flight(scene, grid, frames)
    print("| | share |\n|---|---|")
    for name in CELLS + SURFACE:
        count, whole = total[name], total["cells held occupied" if name in CELLS else "surface observable"]
        print(f"| {name} | {100 * count / whole:.1f} % ({count}) |")


if __name__ == "__main__":
    main()
