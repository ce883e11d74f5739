"""Ordinary inspection missions through volumes, cells of 0.1 m: mean and 95 % interval over the flights of each.

Worlds and missions are those of `volume_missions`. `ullage reproduce --only volumes` judges flights that rise and sink,
and level ones, over five seeds.

python benchmarks/volume_table.py [--missions room,cabin] [--flights 0,1,2] [--only WORD] [--keep FOLDER]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from volume_missions import MISSIONS, frames_of, world

import ullage as ul
from ullage.experiments.reproduce import flights
from ullage.experiments.reproduce.volumes import COLUMNS


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--missions", default="room", help="worlds to fly missions through, as room,tank")
    parser.add_argument("--flights", default="0", help="seeds of the flights, as 0,1,2")
    parser.add_argument("--only", default="", help="missions that hold this word")
    parser.add_argument("--keep", type=Path, help="folder that keeps simulated frames for the next run")
    options = parser.parse_args()
    scores: flights.Scores = {}
    with tempfile.TemporaryDirectory() as own:
        folder = options.keep or Path(own)
        folder.mkdir(parents=True, exist_ok=True)
        for name in options.missions.split(","):
            scene = world(name)
            grid = ul.Grid.covering(scene.bounds, 0.1, dims=3, margin_m=0.5)
            for mission in (m for m in MISSIONS if options.only in m):
                for seed in map(int, options.flights.split(",")):
                    frames = frames_of(name, mission, seed, folder)
                    got = ul.metrics.map_quality(ul.map_occupancy(frames, grid), scene, frames)
                    row = flights.values_of(got, tuple(COLUMNS))
                    scores.setdefault(f"{name}, {mission}", []).append(row)
                    print(f"{seed} {name}, {mission}: F1 {row['f1']:.3f}", file=sys.stderr, flush=True)
    print("| mission |", " | ".join(COLUMNS.values()), "|")
    print("|---|" + "---|" * len(COLUMNS))
    for line in flights.rows_of(scores, COLUMNS):
        print("|", " | ".join(line), "|")


if __name__ == "__main__":
    main()
