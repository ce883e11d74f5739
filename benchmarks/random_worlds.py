"""Maps of random worlds by kind, judged by one evaluator: a row a flight, and a table of means at the end.

    python benchmarks/random_worlds.py --kinds tuning --seeds 4 [--bounces 3] [--volume] [--drift 0.2] [--amplitude]
    python benchmarks/random_worlds.py --short --method likelihood

Choose thresholds on the kinds "tuning" only. Run the kinds "testing" when a method stands, to judge it. Rows go to a
CSV file; rows that it holds already are not made again, so the command goes on where it was stopped.
`--kinds all` flies both. `--publish NAME` writes the table to `studies/results`, and `python tools/results.py` writes
it into the pages.
"""

from __future__ import annotations

import argparse
import csv
import shlex
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import ullage as ul
from ullage.data import Frames
from ullage.processing.occupancy import Mapper
from ullage.processing.own_echo import without_own_echo
from ullage.world.scene import Scene

sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))
import results

STEP_M = {False: 0.1, True: 0.1}
SCORES = (
    "f1",
    "precision",
    "recall",
    "recall_in_view",
    "surface_declared_free",
    "known_behind",
    "flyable_found",
    "flyable_false",
    "free_found",
    "ambiguous",
    "accuracy_median",
    "accuracy_p90",
)
HEADER = {
    "f1": "F1", "precision": "precision", "surface_declared_free": "surface declared free",
    "cpu_mean": "CPU of a frame, mean [ms]", "cpu_p99": "99th percentile [ms]",
}  # fmt: skip
COSTS = ("cpu_mean", "cpu_p99")
KEY = ("kind", "seed", "dims", "bounces", "drift_m", "phase", "method", "short")
SHORT_M, LEAST_SPACING_M = 14.0, 0.035
TABLE = ("f1", "precision", "recall_in_view", "surface_declared_free", "flyable_found", "flyable_false", *COSTS)


def flown(kind: str, seed: int, given: argparse.Namespace) -> tuple[Scene, dict[str, Frames]]:
    """The world and the frames of the flight through it; poses drift where that is asked for."""
    scene, path = ul.worlds.random(kind, seed), ul.worlds.flight(kind, seed, volume=given.volume)
    path = shortened(path) if given.short else path
    believed = drifting(path, given.drift, seed) if given.drift else None
    frames = ul.simulate(
        scene, path, ul.worlds.rig(kind, seed), max_bounces=given.bounces, seed=seed, believed=believed
    )
    return scene, frames


def drifting(path: ul.Trajectory, drift_m: float, seed: int) -> ul.Trajectory:
    """A believed path whose drift counts from the first pose: a shift of flight and map together changes no echo."""
    believed = ul.navigate(path, drift_m=drift_m, seed=seed)
    return replace(believed, position=believed.position - believed.position[0] + path.position[0])


def shortened(path: ul.Trajectory) -> ul.Trajectory:
    """The first metres of a flight, every second frame where frames lie close."""
    spacing = float(np.linalg.norm(path.position[1] - path.position[0]))
    return path[: int(SHORT_M / spacing) : 2 if spacing < LEAST_SPACING_M else 1]


def grid_of(scene: Scene, frames: dict[str, Frames], volume: bool) -> ul.Grid:
    """A grid that holds the world and the flight; open sides end at the radar's range."""
    place = np.concatenate([part.believed.position for part in frames.values()])
    box = np.stack([np.minimum(scene.bounds[0], place.min(0)), np.maximum(scene.bounds[1], place.max(0))])
    return ul.Grid.covering(box, STEP_M[volume], dims=3 if volume else 2, margin_m=0.5)


def row_of(kind: str, seed: int, given: argparse.Namespace) -> dict[str, str]:
    """Fly, map and judge one flight."""
    start = time.process_time()
    scene, frames = flown(kind, seed, given)
    simulated = time.process_time() - start
    if given.amplitude:
        frames = {name: replace(part, samples=part.amplitude) for name, part in frames.items()}
    grid = grid_of(scene, frames, given.volume)
    omap = ul.map_occupancy(frames, grid, method=given.method, drift_m=given.drift)
    got = {name: metric.value for name, metric in ul.metrics.map_quality(omap, scene, frames).items()}
    if given.cost:
        cost = ul.metrics.map_cost(Mapper(grid, method=given.method), without_own_echo(frames))
        got |= {name: metric.value for name, metric in cost.items()}
    whole = time.process_time() - start
    key = (kind, seed, grid.dims, given.bounces, given.drift, not given.amplitude, given.method, given.short)
    out = dict(zip(KEY, map(str, key), strict=True))
    out |= {name: f"{got[name]:.4g}" for name in (*SCORES, *COSTS) if name in got}
    return out | {"simulated_s": f"{simulated:.1f}", "whole_s": f"{whole:.1f}"}


def table(rows: list[dict[str, str]]) -> list[list[str]]:
    """Means by kind and by group of kinds, below a header."""
    kinds = {kind: (kind,) for kind in ul.worlds.KINDS}
    groups = kinds | {"all tuning kinds": ul.worlds.TUNING, "all testing kinds": ul.worlds.TESTING}
    shown = [name for name in TABLE if rows[0].get(name)]
    out = [["kind", "flights", *(HEADER.get(name, f"`{name}`") for name in shown)]]
    for label, members in groups.items():
        mine = [row for row in rows if row["kind"] in members]
        if mine:
            means = [np.mean([float(row[name]) for row in mine]) for name in shown]
            out.append([label, str(len(mine)), *(f"{value:.3f}" for value in means)])
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", default="tuning", help="tuning, testing, all, or names with commas between them")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--bounces", type=int, default=1)
    parser.add_argument("--volume", action="store_true")
    parser.add_argument("--drift", type=float, default=0.0, help="rms of the poses' drift [m]")
    parser.add_argument("--amplitude", action="store_true", help="drop the phase")
    parser.add_argument("--method", default="ullage")
    parser.add_argument("--short", action="store_true", help="the first 14 m, frames at least 3.5 cm apart")
    parser.add_argument("--cost", action="store_true", help="time each profile too")
    parser.add_argument("--to", type=Path, default=Path("random_worlds.csv"))
    parser.add_argument("--publish", metavar="NAME", help="write the table of means to studies/results/NAME.csv")
    parser.add_argument("--groups", action="store_true", help="means of the tuning and the testing kinds only")
    given = parser.parse_args()
    groups = {"tuning": ul.worlds.TUNING, "testing": ul.worlds.TESTING, "all": ul.worlds.KINDS}
    kinds = groups.get(given.kinds, tuple(given.kinds.split(",")))
    fields = (*KEY, *SCORES, *COSTS, "simulated_s", "whole_s")
    known = list(csv.DictReader(given.to.open())) if given.to.exists() else []
    if not known:
        given.to.write_text(",".join(fields) + "\n")
    rows = []
    for kind in kinds:
        for seed in range(given.first, given.first + given.seeds):
            dims = 3 if given.volume else 2
            what = (kind, seed, dims, given.bounces, given.drift, not given.amplitude, given.method, given.short)
            key = tuple(map(str, what))
            row = next((row for row in known if tuple(row[name] for name in KEY) == key), None)
            if row is None:
                row = row_of(kind, seed, given)
                with given.to.open("a") as file:
                    csv.DictWriter(file, fields).writerow(row)
            rows.append(row)
            print(", ".join(f"{name} {row[name]}" for name in ("kind", "seed", *TABLE) if row.get(name)), flush=True)
    means = table(rows)
    if given.groups:
        means = [row for row in means if row[0] == "kind" or row[0].startswith("all ")]
    print("", *(", ".join(row) for row in means), sep="\n")
    if given.publish:
        print(results.save(given.publish, means, shlex.join(["python", *sys.argv])))


if __name__ == "__main__":
    main()
