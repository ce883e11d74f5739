"""CPU time and memory of the mappers: ours beside the thesis' method, far beside near, plane beside volume.

python benchmarks/bench_mapping.py [--volume]
"""

from __future__ import annotations

import sys
import time
import zlib
from pathlib import Path

import numpy as np

import ullage as ul
from ullage.data import Frames
from ullage.processing.occupancy import Mapper

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "processing"))
import mirror_world as world


def flight(half_x: float, half_y: float) -> dict[str, Frames]:
    path = ul.Trajectory.line((-0.8 * half_x, 0.1, 0), (0.8 * half_x, 0.3, 0), rate_hz=25)
    return world.rig(path, world.box_plan(-half_x, half_x, -half_y, half_y))


def each(mapper, frames: dict[str, Frames]) -> np.ndarray:
    spent = []
    for i in range(len(frames["front"])):
        for part in frames.values():
            piece = part[i : i + 1]
            start = time.process_time()
            mapper.update(piece)
            spent.append(1e3 * (time.process_time() - start))
    return np.array(spent)


def row(label: str, mapper, frames: dict[str, Frames]) -> dict[str, float]:
    spent = each(mapper, frames)
    start = time.process_time()
    omap = mapper.map()
    drawn = 1e3 * (time.process_time() - start)
    seconds = (frames["front"].t_ns[-1] - frames["front"].t_ns[0]) * 1e-9
    out = {
        "mean_ms": float(spent.mean()),
        "p99_ms": float(np.percentile(spent, 99)),
        "core": float(100 * spent.sum() / 1e3 / seconds),
        "file_kb": len(zlib.compress(omap.percent.tobytes(), 6)) / 1e3,
    }
    print(
        f"{label:34s} mean {out['mean_ms']:6.3f} ms  median {np.median(spent):6.3f}  p99 {out['p99_ms']:6.2f}"
        f"  core {out['core']:5.1f} %  map() {drawn:6.1f} ms"
        f"  map {omap.nbytes / 1e6:6.3f} MB  file {out['file_kb']:6.1f} kB"
    )
    return out


def warm_up(frames: dict[str, Frames], *grids: ul.Grid) -> None:
    """Compile what the mappers need, so that no figure holds it."""
    first = {name: f[:40] for name, f in frames.items()}
    for grid in grids:
        Mapper(grid, method="likelihood").update(first)
    Mapper(grids[0], method="elfes").update(first)


def main() -> None:
    near, far = flight(5.0, 3.0), flight(9.0, 9.0)
    plane = ul.Grid.covering([[-10, -10, -1], [10, 10, 1]], 0.1, z_m=0.0)
    volume = ul.Grid.covering([[-10, -10, -4], [10, 10, 4]], 0.1, dims=3)
    large = ul.Grid.covering([[-25, -25, -1], [25, 25, 1]], 0.05, z_m=0.0)
    coarse = ul.Grid.covering([[-25, -25, -1], [25, 25, 1]], 0.1, z_m=0.0)
    warm_up(near, plane, volume)
    if "--volume" in sys.argv:
        solid = row("likelihood, volume 0.1 m, near", Mapper(volume, method="likelihood"), near)
        open_ = row("likelihood, volume 0.1 m, far", Mapper(volume, method="likelihood"), far)
        print(f"far over near {open_['mean_ms'] / solid['mean_ms']:.2f}")
        return
    print("one profile at a time, four sensors at 25 Hz, 0.5 m/s")
    base = row("elfes, plane 0.1 m, near", Mapper(plane, method="elfes"), near)
    ours = row("likelihood, plane 0.1 m, near", Mapper(plane, method="likelihood"), near)
    wide = row("likelihood, plane 0.1 m, far", Mapper(plane, method="likelihood"), far)
    solid = row("likelihood, volume 0.1 m, near", Mapper(volume, method="likelihood"), near)
    open_ = row("likelihood, volume 0.1 m, far", Mapper(volume, method="likelihood"), far)
    row("likelihood, plane 50 x 50 m at 0.05 m", Mapper(large, method="likelihood"), near)
    row("likelihood, plane 50 x 50 m at 0.1 m", Mapper(coarse, method="likelihood"), near)
    base, ours, wide, solid, open_ = (one["mean_ms"] for one in (base, ours, wide, solid, open_))
    print(f"ullage over elfes {ours / base:.1f}; far over near: plane {wide / ours:.2f}, volume {open_ / solid:.2f}")


if __name__ == "__main__":
    main()
