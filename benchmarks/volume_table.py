"""Ordinary inspection missions through volumes, cells of 0.1 m: mean and 95 % interval over the flights of each.

Worlds and missions are those of `volume_missions`; "others" are rooms with a mission each. In tanks each tenth frame
counts for what could be seen. `ullage reproduce --only volumes` judges flights that rise and sink, and level ones, over
five seeds.

python benchmarks/volume_table.py [--missions room,cabin,others] [--flights 0,1,2] [--only WORD] [--bounces 3]
    [--plane] [--keep FOLDER]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from volume_missions import MISSIONS, OTHERS, TANKS, frames_of, world

import ullage as ul
from ullage.thesis import flights
from ullage.thesis.volumes import COLUMNS

SAID = ("f1", "precision", "recall", "surface_declared_free", "known_behind")


def missions(names: list[str], word: str) -> list[tuple[str, str]]:
    """Worlds and missions, of those worlds and with that word in their name."""
    out = [(name, m) for name in names if name not in ("others", "boiler") for m in MISSIONS if word in m]
    out += [(name, "lanes") for name in names if name == "boiler"]
    return out + [(name, "") for name in OTHERS if "others" in names and word in name]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--missions", default="room", help="worlds to fly missions through, as room,tank")
    parser.add_argument("--flights", default="0", help="seeds of the flights, as 0,1,2")
    parser.add_argument("--only", default="", help="missions that hold this word")
    parser.add_argument("--bounces", type=int, default=1, help="of the echoes, 1 to 3")
    parser.add_argument("--plane", action="store_true", help="a map of the plane that is flown in, not of the volume")
    parser.add_argument("--keep", type=Path, help="folder that keeps simulated frames for the next run")
    options = parser.parse_args()
    scores: flights.Scores = {}
    with tempfile.TemporaryDirectory() as own:
        folder = options.keep or Path(own)
        folder.mkdir(parents=True, exist_ok=True)
        for name, mission in missions(options.missions.split(","), options.only):
            scene = world(name)
            grid = ul.Grid.covering(scene.bounds, 0.1, dims=2 if options.plane else 3, margin_m=0.5)
            for seed in map(int, options.flights.split(",")):
                frames = frames_of(name, mission, seed, folder, options.bounces)
                heard = {key: f[::10] for key, f in frames.items()} if name in TANKS else frames
                got = ul.metrics.map_quality(ul.map_occupancy(frames, grid, method="rules"), scene, heard)
                row = flights.values_of(got, tuple(COLUMNS))
                scores.setdefault(f"{name}, {mission}".rstrip(", "), []).append(row)
                said = " ".join(f"{COLUMNS[key]} {row[key]:.4f}" for key in SAID)
                print(f"{seed} {name}, {mission}: {said}", file=sys.stderr, flush=True)
    print("| mission |", " | ".join(COLUMNS.values()), "|")
    print("|---|" + "---|" * len(COLUMNS))
    for line in flights.rows_of(scores, COLUMNS):
        print("|", " | ".join(line), "|")


if __name__ == "__main__":
    main()
