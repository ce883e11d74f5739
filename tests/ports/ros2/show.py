"""Publishes a finished run: its world, its flight and its map. Arguments: the run's folder, the sink's address."""

from __future__ import annotations

import sys
from pathlib import Path

import ullage as ul
from ullage.experiments.catalog import find_scenario
from ullage.experiments.simulated import load_world
from ullage.pipeline import sink


def main() -> None:
    folder = Path(sys.argv[1])
    recorded = ul.open(folder / "frames.mcap")
    omap = recorded.map()
    with sink(sys.argv[2]) as out:
        out.write(load_world(find_scenario(str(folder / "scenario.yaml")).world))
        for number, chunk in enumerate(recorded.stream()):
            out.write(chunk)
            if number == 0 and omap is not None:
                out.write(omap)
        print("written", flush=True)


main()
