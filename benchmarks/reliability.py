"""Do the percents of maps come true? A table by kind of world, and a reliability diagram.

    python benchmarks/reliability.py --seeds 3 --to rows.csv [--publish reliability]
    python benchmarks/reliability.py --draw docs/pictures/reliability.png rows.csv

The numbers behind the percents were fitted to the kinds "tuning"; the kinds "testing" judge them. Flights are those of
`random_worlds.py --short`.
"""

from __future__ import annotations

import argparse
import csv
import shlex
import sys
from pathlib import Path

import numpy as np
from random_worlds import flown, grid_of

import ullage as ul

sys.path.append(str(Path(__file__).parents[1] / "tools"))
import results

LEAST_CELLS = 50
"""Of a mark in the diagram."""
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


def table(rows: list[dict[str, str]]) -> list[list[str]]:
    """What maps say and what holds, by kind: of the free cells, and of the occupied ones."""
    out = [["kind", "cells of at most 1 %", "of these solid", "cells of 65 % and more", "said", "solid"]]
    for kind in dict.fromkeys(row["kind"] for row in rows):
        line = [kind]
        for wanted in (lambda row: row["percent_to"] == "1", lambda row: int(row["percent_from"]) >= 65):
            mine = [row for row in rows if row["kind"] == kind and wanted(row)]
            cells = [int(row["cells"]) for row in mine]
            said, held = (np.average([float(row[name]) for row in mine], weights=cells) for name in ("said", "held"))
            line += [
                str(sum(cells)),
                *([f"{said:.3f}"] if len(line) > 1 else []),
                f"{held:.{4 if len(line) < 2 else 3}f}",
            ]
        out.append(line)
    return out


def draw(rows: list[dict[str, str]], picture: Path) -> None:
    """Draw what was said of occupied cells against what held, a line for each kind of world."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9.6, 4.8), sharey=True, layout="constrained")
    for ax, group in zip(axes, ("tuning", "testing"), strict=True):
        ax.plot([0, 100], [0, 100], color="0.6", lw=1)
        for kind in dict.fromkeys(row["kind"] for row in rows if row["group"] == group):
            mine = [row for row in rows if row["kind"] == kind and int(row["percent_from"]) >= 0]
            mine = [row for row in mine if int(row["cells"]) >= LEAST_CELLS]
            said, held = (100 * np.array([float(row[name]) for row in mine]) for name in ("said", "held"))
            ax.plot(said, held, "-o", ms=5, lw=1.4, label=kind)
        ax.set(xlabel="map says [% occupied]", title=f"{group} kinds", xlim=(-2, 102), ylim=(-2, 102), aspect="equal")
        ax.legend(loc="upper left")
    axes[0].set_ylabel("cells that hold surface [%]")
    figure.savefig(picture, dpi=130)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--volume", action="store_true")
    parser.add_argument("--to", type=Path, default=Path("reliability.csv"))
    parser.add_argument("--publish", metavar="NAME", help="write the table to studies/results/NAME.csv")
    parser.add_argument("--draw", type=Path, help="draw the rows of a file, and fly nothing")
    parser.add_argument("rows", type=Path, nargs="?", help="written by --to")
    given = parser.parse_args(namespace=argparse.Namespace(short=True, drift=0.0, bounces=1))
    if given.draw:
        draw(list(csv.DictReader(given.rows.open())), given.draw)
        return
    made: list[dict[str, str]] = []
    with given.to.open("w") as file:
        writer = csv.DictWriter(file, FIELDS)
        writer.writeheader()
        for kind in (*ul.worlds.TUNING, *ul.worlds.TESTING):
            for row in rows_of(kind, given):
                writer.writerow(row)
                made.append({name: str(value) for name, value in row.items()})
                print(*row.values(), sep=", ", flush=True)
    if given.publish:
        print(results.save(given.publish, table(made), shlex.join(["python", *sys.argv])))


if __name__ == "__main__":
    main()
