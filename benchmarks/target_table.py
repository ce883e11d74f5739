"""The plane's targets: the best seen elsewhere, the aim, and ours, from flights just mapped and costs just taken.

`python benchmarks/mapping_table.py --targets` prints it after the table of methods.
"""

from __future__ import annotations

import bench_mapping
import bench_sar
import numpy as np

import ullage as ul
from ullage.data import Frames, Trajectory
from ullage.processing.occupancy import Mapper
from ullage.world.scene import Scene

HOVER_S = 60.0
Scores = dict[str, list[dict[str, float]]]
"""Scores of each flight by the name of the method."""


def hovering(path: Trajectory, rng: np.random.Generator, *, rate: float = 25.0) -> Trajectory:
    """60 s at the end of a flight, wandering by some centimetres as a drone does."""
    n = int(HOVER_S * rate)
    t = np.arange(1, n + 1) / rate
    phase, turn = rng.uniform(0, 2 * np.pi, 3), rng.uniform(0.2, 0.5, 3)
    wander = np.array([0.02, 0.02, 0.01]) * (np.sin(turn * t[:, None] + phase) - np.sin(phase))
    t_ns = path.t_ns[-1] + np.rint(t * 1e9).astype(np.int64)
    return Trajectory(t_ns, path.position[-1] + wander, np.tile(path.quat_xyzw[-1], (n, 1)))


def hover_change(
    scene: Scene, grid: ul.Grid, frames: dict[str, Frames], path: Trajectory, seed: int
) -> dict[str, float]:
    """What a minute's hover at the end of a flight changes of its map."""
    rng = np.random.default_rng(seed + 200)
    still = ul.simulate(scene, hovering(path, rng), ul.Rig.preset("thesis-4"), seed=seed + 200)
    mapper, alone = Mapper(grid), Mapper(grid)
    for one in (mapper, alone):
        one.update(frames)
    alone.finish()
    mapper.update(still)
    mapper.finish()
    found = ul.metrics.hover_change(alone.map(), mapper.map(), scene, frames)
    return {name: metric.value for name, metric in found.items()}


def spread(scores: Scores, name: str, key: str, *, scale: float = 1.0, digits: int = 3) -> str:
    """Mean and 95 % interval over the flights, or a dash where they were not mapped."""
    values = scale * np.array([row[key] for row in scores.get(name, [])])
    if not len(values):
        return "-"
    half = 1.96 * values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else 0.0
    return f"{values.mean():.{digits}f} ± {half:.{digits}f}"


def truth_rows(scores: Scores) -> list[tuple[str, str, str, str]]:
    """Rows of how true the maps are: what, best seen, target, ours."""
    exact, bare = "ullage, exact poses", "ullage, amplitude only"

    def f1(name: str) -> str:
        return spread(scores, name, "f1")

    def error(name: str) -> str:
        parts = (spread(scores, name, f"accuracy_{k}", scale=100, digits=1) for k in ("median", "p90"))
        return " / ".join(parts) + " cm"

    def share(key: str) -> str:
        return spread(scores, exact, key, scale=100, digits=2) + " %"

    cells = [row["hover_false_occupied"] for row in scores.get("hover", [])]
    return [
        (
            "F1, exact poses",
            "0.94, threshold of an oracle",
            "0.92",
            f"{f1(exact)}; told the walls {f1('told the walls')}",
        ),
        ("F1, amplitude only", "0.73", "0.78", f1(bare)),
        ("F1, 3 mm white pose error", "0.76", "0.88", f1("ullage, 3 mm white pose error")),
        ("F1, 10 mm", "0.73", "0.72, and no less than amplitude only", f1("ullage, 10 mm white pose error")),
        ("F1, 20 cm drift, `drift_m=0.2`", "0.72", "0.85", f1("ullage, the same, drift_m=0.2")),
        ("error median / p90, exact poses", "11 / 26 cm", "4 / 15 cm", error(exact)),
        ("error median / p90, amplitude only", "", "8 / 22 cm", error(bare)),
        ("surface declared free", "6.6 %", "1 %", share("surface_declared_free")),
        ("known cells behind walls", "the thesis shows many", "0.5 %", share("known_behind")),
        ("60 s hover, change of F1", "", "under 0.005", spread(scores, "hover", "hover_f1", digits=4)),
        ("60 s hover, new false cells", "", "none", ", ".join(f"{c:+.0f}" for c in cells) or "-"),
        (
            "60 s hover, surface declared free",
            "7 to 21 % without a gate",
            "",
            spread(scores, "hover", "hover_surface_declared_free", scale=100, digits=2) + " %",
        ),
    ]


def cost_rows() -> list[tuple[str, str, str, str]]:
    """Rows of what a plane's map costs, measured here and now: what, best seen, target, ours."""
    flown = bench_mapping.flight(5.0, 3.0)
    plane = ul.Grid.covering([[-10, -10, -1], [10, 10, 1]], 0.1, z_m=0.0)
    large = ul.Grid.covering([[-25, -25, -1], [25, 25, 1]], 0.05, z_m=0.0)
    bench_mapping.warm_up(flown, plane)
    thesis = bench_mapping.row("elfes, plane 0.1 m", Mapper(plane, method="elfes"), flown)
    near = bench_mapping.row("ullage, plane 0.1 m", Mapper(plane), flown)
    wide = bench_mapping.row("ullage, plane 50 x 50 m at 0.05 m", Mapper(large), flown)
    ours, theirs = bench_mapping.rays()
    image = bench_sar.cost(5.0)
    return [
        (
            "four sensors at 25 Hz, plane",
            "thesis: 128 % CPU at 0.4x",
            "25 % of a core (in a volume)",
            f"{near['core']:.0f} % of a core; the thesis' method {thesis['core']:.0f} %",
        ),
        (
            "coherent image, 2.5 cm, 5 x 5 m",
            "2.9 ms a profile",
            "4 x 25 Hz on 30 % of a core",
            f"{image:.2f} ms; {10 * image:.0f} % of a core",
        ),
        (
            "rays of a lidar, 0.1 m",
            "Bonxai 0.69 to 0.75 M, OctoMap 0.012 to 0.024 M a CPU-second",
            "0.5 M",
            f"{ours / 1e6:.2f} M; pyoctomap in the same run {theirs / 1e6:.3f} M",
        ),
        (
            "50 x 50 m at 0.05 m",
            "1 MB",
            "0.5 MB, file 100 kB",
            f"{wide['state_mb']:.2f} MB, file {wide['file_kb']:.1f} kB",
        ),
    ]


def print_targets(rows: list[tuple[str, str, str, str]]) -> None:
    """Markdown."""
    print("|  | best seen | target | ours |\n|---|---|---|---|")
    for row in rows:
        print("|", " | ".join(row), "|")
