"""Every mapping method on the same simulated flights, five seeds, as a Markdown table: mean and 95 % interval.

python benchmarks/mapping_table.py [--seeds 5] [--only WORD] [--figure map.png] [--targets]
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

import numpy as np
from target_table import cost_rows, hover_change, print_targets, truth_rows

import ullage as ul
from ullage.data import Frames, Trajectory
from ullage.geometry import rpy_quat
from ullage.grids import OccupancyMap, Tiles
from ullage.processing.truth import spaced_looks, surface_of
from ullage.world.scene import Scene

SIZE = (8.0, 6.0, 3.0)
COLUMNS = {
    "f1": "F1",
    "precision": "precision",
    "recall": "recall",
    "accuracy_median": "error median [m]",
    "accuracy_p90": "error p90 [m]",
    "surface_declared_free": "surface free",
    "known_behind": "known behind",
    "false_occupied_per_100m2": "false /100 m²",
    "corridor_falsely_blocked": "corridor blocked",
    "log_likelihood": "log-lik. [nat]",
    "free_found": "free found",
}


def room() -> tuple[Scene, ul.Grid]:
    """A concrete room with a steel plate, and the plane on which it is mapped."""
    scene = ul.scenes.room(SIZE, plate={"width_m": 1.0, "height_m": 2.0, "distance_m": 2.6})
    return scene, ul.Grid.covering(scene.bounds, 0.1, margin_m=1.0)


def route(seed: int, *, rate: float = 25.0) -> Trajectory:
    corners = np.array([(-2.6, -1.4), (1.2, -1.5), (1.3, 1.4), (-2.5, 1.5), (-2.6, -1.2)])
    corners = corners + np.random.default_rng(seed).uniform(-0.25, 0.25, corners.shape)
    way = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    s = np.arange(0, way[-1], 0.5 / rate)
    xy = np.stack([np.interp(s, way, corners[:, k]) for k in (0, 1)], axis=1)
    kernel = np.hanning(25) / np.hanning(25).sum()
    xy = np.stack([np.convolve(np.pad(c, 12, mode="edge"), kernel, "valid") for c in xy.T], axis=1)
    dx, dy = np.gradient(xy, axis=0).T
    quat = rpy_quat(0.02 * np.sin(s), 0.03 * np.cos(s), np.unwrap(np.arctan2(dy, dx)))
    height = 0.05 * np.sin(1.3 * s)
    return Trajectory(np.rint(np.arange(len(s)) * 1e9 / rate).astype(np.int64), np.column_stack([xy, height]), quat)


def believed(frames: dict[str, Frames], offset: np.ndarray) -> dict[str, Frames]:
    return {
        name: replace(f, poses=Trajectory(f.t_ns, f.believed.position + offset, f.believed.quat_xyzw))
        for name, f in frames.items()
    }


def drift(n: int, size_m: float, rng: np.random.Generator) -> np.ndarray:
    phase, rate = rng.uniform(0, 6.28, 3), rng.uniform(0.7, 1.6, 3)
    out = size_m * np.sin(np.linspace(0, 6.28, n)[:, None] * rate + phase) * [1, 1, 0.3]
    return out - out[0]


def cases(seed: int, scene, grid):
    path = route(seed)
    rng = np.random.default_rng(seed + 100)
    frames = ul.simulate(scene, path, ul.Rig.preset("thesis-4"), seed=seed)
    rays = ul.simulate(scene, path, ul.Rig.preset("thesis-4"), fidelity="thesis", seed=seed)
    n = len(path)
    bare = {name: replace(f, samples=f.amplitude) for name, f in frames.items()}
    yield "elfes (thesis), physical frames", frames, {"method": "elfes"}
    yield "elfes (thesis), the thesis' frames", rays, {"method": "elfes"}
    yield "ullage, the thesis' frames", rays, {}
    yield "ullage, amplitude only", bare, {}
    yield "ullage, exact poses", frames, {}
    for noise in (0.003, 0.01):
        noisy = believed(frames, rng.normal(0, noise, (n, 3)))
        yield f"ullage, {1e3 * noise:.0f} mm white pose error", noisy, {}
    drifting = believed(frames, drift(n, 0.2, rng))
    yield "ullage, 20 cm smooth drift", drifting, {}
    yield "ullage, the same, drift_m=0.2", drifting, {"drift_m": 0.2}
    yield "told the walls", frames, None


def told(scene: Scene, frames: dict[str, Frames], grid: ul.Grid, *, zones: int = 1) -> OccupancyMap:
    """What a map without any error holds: the surface within some Fresnel zones of a foot of the perpendicular."""
    grid = grid.at_height(float(np.mean([f.believed.position[:, 2].mean() for f in frames.values()])))
    surface = surface_of(scene, grid, frames)
    heard = np.flatnonzero(surface.looks > 0)
    points, normals = surface.points[heard], surface.normals[heard]
    keep = np.zeros(len(heard), bool)
    for part in frames.values():
        for i in spaced_looks(part.believed):
            ray = part.believed.position[i] - points
            away = np.sum(ray * normals, axis=1)
            aside = np.linalg.norm(ray - away[:, None] * normals, axis=1)
            keep |= aside < np.sqrt(zones * part.spec.wavelength_m * abs(away) / 2)
    percent = np.full(grid.shape, -1, np.int8)
    cell, _ = grid.index(points[keep] + 1e-3 * normals[keep])
    percent[tuple(np.clip(cell, 0, np.array(grid.shape) - 1).T)] = 99
    return OccupancyMap(grid, Tiles.of(percent, shape=grid.shape, corner=(0,) * grid.dims), "told")


def draw(omap, scene, frames, path: str) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    from ullage.world.section import section

    percent = omap.percent.astype(float)
    shade = np.full((*percent.shape, 3), 0.7)
    shade[percent >= 0] = 1 - percent[percent >= 0][:, None] / 100
    shade[omap.ambiguous] = (1, 0.75, 0.3)
    figure, axes = plt.subplots(figsize=(8, 6))
    axes.imshow(shade, origin="lower", extent=omap.grid.extent_m)
    for line in section(scene, 0.0):
        axes.plot(*line.T, "r-", lw=1)
    axes.plot(*next(iter(frames.values())).believed.position[:, :2].T, "b-", lw=0.7)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    figure.savefig(path, dpi=80)


def print_table(first: str, columns: dict[str, str], scores: dict[str, list[dict[str, float]]]) -> None:
    """Markdown: a row for each name, mean and 95 % interval over its flights."""
    print(f"| {first} |", " | ".join(columns.values()), "|")
    print("|---|" + "---|" * len(columns))
    for name, rows in scores.items():
        cells = []
        for key in columns:
            values = np.array([row[key] for row in rows])
            spread = 1.96 * values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else 0.0
            cells.append(f"{values.mean():.3f} ± {spread:.3f}")
        print(f"| {name} |", " | ".join(cells), "|")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--only", default="", help="rows that hold this word")
    parser.add_argument("--figure")
    parser.add_argument("--targets", action="store_true", help="a minute's hover and the costs too, beside the targets")
    options = parser.parse_args()
    scene, grid = room()
    scores: dict[str, list[dict[str, float]]] = {}
    hover: list[dict[str, float]] = []
    for seed in range(options.seeds):
        for name, frames, how in cases(seed, scene, grid):
            if options.only not in name:
                continue
            omap = told(scene, frames, grid) if how is None else ul.map_occupancy(frames, grid, **how)
            got = ul.metrics.map_quality(omap, scene, frames)
            scores.setdefault(name, []).append({k: got[k].value for k in COLUMNS})
            print(f"{seed} {name}: F1 {got['f1'].value:.3f}", file=sys.stderr, flush=True)
            if options.figure and seed == 0 and name.endswith("exact poses"):
                draw(omap, scene, frames, options.figure)
            if options.targets and name.endswith("exact poses"):
                hover.append(hover_change(scene, grid, frames, route(seed), seed))
                print(f"{seed} hover: {hover[-1]}", file=sys.stderr, flush=True)
    print_table("method", COLUMNS, scores)
    if options.targets:
        print_targets(truth_rows(scores | {"hover": hover}) + cost_rows())


if __name__ == "__main__":
    main()
