"""Do the percents of maps come true? A row for each kind of world and range of percent, and a reliability diagram.

    python benchmarks/reliability.py [--seeds 2] [--volume] --to studies/results/reliability_plane.csv
    python benchmarks/reliability.py --draw docs/pictures/reliability.png studies/results/reliability_*.csv

The numbers behind the percents were fitted to the kinds "tuning"; the kinds "testing" judge them. Flights are those of
`random_worlds.py --short`.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
from random_worlds import flown, grid_of

import ullage as ul

FIELDS = ("group", "kind", "percent_from", "percent_to", "cells", "said", "held")


def rows_of(kind: str, given: argparse.Namespace) -> list[dict[str, object]]:
    """The reliability of the maps of one kind of world, all seeds together."""
    found: dict[tuple[int, int], list[ul.metrics.Reliable]] = {}
    for seed in range(given.seeds):
        scene, frames = flown(kind, seed, given)
        omap = ul.map_occupancy(frames, grid_of(scene, frames, given.volume))
        for row in ul.metrics.reliability(omap, scene, frames):
            found.setdefault((row.low, row.high), []).append(row)
    group = "tuning" if kind in ul.worlds.TUNING else "testing"
    out = []
    for (low, high), rows in sorted(found.items()):
        cells = [row.cells for row in rows]
        said, held = (np.average([getattr(row, name) for row in rows], weights=cells) for name in ("said", "held"))
        values = group, kind, low, high, sum(cells), f"{said:.4f}", f"{held:.4f}"
        out.append(dict(zip(FIELDS, values, strict=True)))
    return out


def draw(files: list[Path], picture: Path) -> None:
    """Draw what was said against what held, a line for each kind of world."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(files), figsize=(5.2 * len(files), 4.6), squeeze=False, layout="constrained")
    for ax, file in zip(axes[0], files, strict=True):
        rows = list(csv.DictReader(file.open()))
        ax.plot([0, 100], [0, 100], color="0.6", lw=1)
        for kind in dict.fromkeys(row["kind"] for row in rows):
            mine = [
                row for row in rows if row["kind"] == kind and int(row["percent_from"]) >= 0 and int(row["cells"]) >= 50
            ]
            said, held = (100 * np.array([float(row[name]) for row in mine]) for name in ("said", "held"))
            style = "-o" if mine and mine[0]["group"] == "testing" else ":s"
            ax.plot(said, held, style, ms=4, lw=1.2, label=f"{kind} ({mine[0]['group']})" if mine else kind)
        ax.set(xlabel="map says [% occupied]", ylabel="cells that hold surface [%]", xlim=(-2, 102), ylim=(-2, 102))
        ax.set_title("volume" if "volume" in file.stem else "plane")
        ax.legend(fontsize=8, loc="upper left")
    figure.savefig(picture, dpi=130)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--volume", action="store_true")
    parser.add_argument("--to", type=Path, default=Path("reliability.csv"))
    parser.add_argument("--draw", type=Path, help="draw the files that follow, and fly nothing")
    parser.add_argument("files", type=Path, nargs="*")
    given = parser.parse_args(namespace=argparse.Namespace(short=True, drift=0.0, bounces=1))
    if given.draw:
        draw(given.files, given.draw)
        return
    with given.to.open("w") as file:
        writer = csv.DictWriter(file, FIELDS)
        writer.writeheader()
        for kind in (*ul.worlds.TUNING, *ul.worlds.TESTING):
            for row in rows_of(kind, given):
                writer.writerow(row)
                print(*row.values(), sep=", ", flush=True)


if __name__ == "__main__":
    main()
