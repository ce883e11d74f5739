"""What a plane's map costs, beside the best seen elsewhere and the aim.

How true the maps are, beside the same, is told by `ullage reproduce --only methods`.

python benchmarks/map_costs.py
"""

from __future__ import annotations

import bench_mapping
import bench_sar

import ullage as ul
from ullage.processing.occupancy import Mapper


def cost_rows() -> list[tuple[str, str, str, str]]:
    """Rows of what a plane's map costs, measured here and now: what, best seen, target, ours."""
    flown = bench_mapping.flight(5.0, 3.0)
    plane = ul.Grid.covering([[-10, -10, -1], [10, 10, 1]], 0.1, z_m=0.0)
    large = ul.Grid.covering([[-25, -25, -1], [25, 25, 1]], 0.05, z_m=0.0)
    bench_mapping.warm_up(flown, plane)
    thesis = bench_mapping.row("elfes, plane 0.1 m", Mapper(plane, method="elfes"), flown)
    near = bench_mapping.row("rules, plane 0.1 m", Mapper(plane, method="rules"), flown)
    wide = bench_mapping.row("rules, plane 50 x 50 m at 0.05 m", Mapper(large, method="rules"), flown)
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


def main() -> None:
    print("|  | best seen | target | ours |\n|---|---|---|---|")
    for row in cost_rows():
        print("|", " | ".join(row), "|")


if __name__ == "__main__":
    main()
