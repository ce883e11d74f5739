"""What one turn on the spot maps, with four radars and with one: eight turns in four rooms, as a Markdown table.

python benchmarks/turn_table.py [--turns 2]
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

import ullage as ul
from ullage.data import Trajectory
from ullage.geometry import rpy_quat
from ullage.world.scene import Scene

TURN_S, RATE_HZ, DRIFT_M, CLEAR_M = 20.0, 17.0, 0.02, 1.0
PLATE = {"width_m": 1.0, "height_m": 2.0, "distance_m": 2.0}
ROOMS = (
    ((6.0, 4.0, 3.0), "concrete", PLATE),
    ((6.0, 4.0, 3.0), "wood", None),
    ((10.0, 8.0, 3.0), "metal", None),
    ((8.0, 6.0, 3.0), "concrete", PLATE),
)
COLUMNS = {"f1": "F1", "precision": "precision", "recall": "recall", "false_occupied": "false cells"}


def turning(size: tuple[float, float, float], rng: np.random.Generator) -> Trajectory:
    """Once round at a place clear of walls and plate, drifting as a drone that holds it does."""
    half = np.array(size[:2]) / 2 - CLEAR_M
    place = rng.uniform(-half, [min(half[0], PLATE["distance_m"] - CLEAR_M), half[1]])
    s = np.arange(round(TURN_S * RATE_HZ)) / (TURN_S * RATE_HZ)
    phase = rng.uniform(0, 2 * np.pi, 3)
    drift = DRIFT_M * np.array([1, 1, 0.5]) * (np.sin(2 * np.pi * s[:, None] + phase) - np.sin(phase))
    heading = rng.uniform(0, 2 * np.pi) + 2 * np.pi * s
    t_ns = np.rint(s * TURN_S * 1e9).astype(np.int64)
    return Trajectory(t_ns, np.array([*place, 0.0]) + drift, rpy_quat(0 * s, 0 * s, heading))


def scored(scene: Scene, path: Trajectory, rig: ul.Rig, seed: int) -> dict[str, float]:
    frames = ul.simulate(scene, path, rig, seed=seed)
    got = ul.metrics.map_quality(
        ul.map_occupancy(frames, ul.Grid.covering(scene.bounds, 0.1), method="rules"), scene, frames
    )
    return {name: got[name].value for name in COLUMNS}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--turns", type=int, default=2, help="in each room")
    options = parser.parse_args()
    rows: dict[str, list[dict[str, float]]] = {"four radars": [], "one radar": []}
    for k, (size, material, plate) in enumerate(ROOMS):
        scene = ul.scenes.room(size, material=material, plate=plate)
        for turn in range(options.turns):
            path = turning(size, np.random.default_rng([k, turn]))
            for name, rig in (("four radars", "thesis-4"), ("one radar", "single")):
                rows[name].append(scored(scene, path, ul.Rig.preset(rig), turn))
                print(f"{size} {material} {turn} {name}: {rows[name][-1]}", file=sys.stderr, flush=True)
    print("| |", " | ".join(COLUMNS.values()), "| least precision |\n|---|" + "---|" * (len(COLUMNS) + 1))
    for name, scores in rows.items():
        means = [f"{np.mean([score[key] for score in scores]):.3f}" for key in COLUMNS]
        print(f"| {name} |", " | ".join(means), f"| {min(score['precision'] for score in scores):.2f} |")


if __name__ == "__main__":
    main()
