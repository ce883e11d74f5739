"""The full-profile mapper in a volume, on flights that change height by a metre: Markdown, mean and 95 % interval.

Beside it, on the same frames, what the yardstick allows: a map of all surface within two Fresnel zones of the true foot
of a perpendicular from one of the looks ("told the walls").

python benchmarks/volume_table.py [--seeds 3] [--level]
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from mapping_table import SIZE, believed, print_table, told
from mapping_table import route as level_route

import ullage as ul
from ullage.data import Trajectory

COLUMNS = {
    "f1": "F1",
    "precision": "precision",
    "recall": "recall",
    "accuracy_median": "error median [m]",
    "accuracy_p90": "error p90 [m]",
    "surface_declared_free": "surface free",
    "known_behind": "known behind",
    "ambiguous": "ambiguous",
    "free_found": "free found",
}
RISE_M, WAVE_M = 0.45, 2.4


def route(seed: int, *, rise_m: float = RISE_M) -> Trajectory:
    """The round of the plane's table, but rising and sinking by twice `rise_m`."""
    flat = level_route(seed)
    way = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(flat.position, axis=0), axis=1))])
    position = flat.position.copy()
    position[:, 2] += rise_m * np.sin(2 * np.pi * way / WAVE_M + seed)
    return Trajectory(flat.t_ns, position, flat.quat_xyzw)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--level", action="store_true", help="fly level instead")
    options = parser.parse_args()
    scene = ul.scenes.room(SIZE, plate={"width_m": 1.0, "height_m": 2.0, "distance_m": 2.6})
    grid = ul.Grid.covering(scene.bounds, 0.1, dims=3, margin_m=0.5)
    scores: dict[str, list[dict[str, float]]] = {}
    for seed in range(options.seeds):
        path = level_route(seed) if options.level else route(seed)
        frames = ul.simulate(scene, path, ul.Rig.preset("thesis-4"), seed=seed)
        bare = {name: replace(f, samples=f.amplitude) for name, f in frames.items()}
        noise = np.random.default_rng(seed + 100).normal(0, 0.003, (len(path), 3))
        for name, recording in (
            ("exact poses", frames),
            ("amplitude only", bare),
            ("3 mm white pose error", believed(frames, noise)),
            ("told the walls", None),
        ):
            omap = told(scene, frames, grid, zones=2) if recording is None else ul.map_occupancy(recording, grid)
            got = ul.metrics.map_quality(omap, scene, frames)
            scores.setdefault(name, []).append({key: got[key].value for key in COLUMNS})
    print_table("volume", COLUMNS, scores)


if __name__ == "__main__":
    main()
