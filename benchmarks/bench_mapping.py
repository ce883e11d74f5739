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
    held = mapper.blocks.nbytes if hasattr(mapper, "blocks") else 2 * 4 * omap.percent.size
    out = {
        "mean_ms": float(spent.mean()),
        "p99_ms": float(np.percentile(spent, 99)),
        "core": float(100 * spent.sum() / 1e3 / seconds),
        "state_mb": held / 1e6,
        "file_kb": len(zlib.compress(omap.percent.tobytes(), 6)) / 1e3,
    }
    print(
        f"{label:34s} mean {out['mean_ms']:6.3f} ms  median {np.median(spent):6.3f}  p99 {out['p99_ms']:6.2f}"
        f"  core {out['core']:5.1f} %  map() {drawn:6.1f} ms  state {out['state_mb']:7.3f} MB"
        f"  map {omap.nbytes / 1e6:6.3f} MB  file {out['file_kb']:6.1f} kB"
    )
    return out


def rays() -> tuple[float, float]:
    """Lidar-like rays into a volume at 0.1 m, a CPU-second: ours beside pyoctomap's, in this one run (NaN: missing)."""
    from ullage.processing.blocks import Blocks

    rng = np.random.default_rng(1)
    way = rng.normal(size=(20_000, 3))
    half = np.array([4.95, 3.95, 1.45])
    ends = way * (half / abs(way)).min(axis=1, keepdims=True)
    eyes = np.column_stack([np.linspace(-2, 2, 5), np.zeros(5), np.zeros(5)])
    blocks = Blocks(ul.Grid.covering([[-5.2, -4.2, -1.6], [5.2, 4.2, 1.6]], 0.1, dims=3))
    blocks.insert_rays(eyes[0], ends[:10])
    start = time.process_time()
    for eye in eyes:
        blocks.insert_rays(eye, ends)
    ours = len(eyes) * len(ends) / (time.process_time() - start)
    print(f"rays of 1.5 to 5 m, ullage          {ours / 1e6:6.3f} M rays/CPU-s  state {blocks.nbytes / 1e6:6.3f} MB")
    try:
        import pyoctomap
    except ImportError:
        print("pyoctomap is not installed: no comparison")
        return ours, np.nan
    tree = pyoctomap.OcTree(0.1)
    start = time.process_time()
    for eye in eyes:
        tree.insertPointCloud(ends, eye)
    theirs = len(eyes) * len(ends) / (time.process_time() - start)
    print(
        f"the same, pyoctomap                 {theirs / 1e6:6.3f} M rays/CPU-s, ours {ours / theirs:.1f} times as fast"
    )
    return ours, theirs


def warm_up(frames: dict[str, Frames], *grids: ul.Grid) -> None:
    """Compile what the mappers need, so that no figure holds it."""
    first = {name: f[:40] for name, f in frames.items()}
    for grid in grids:
        Mapper(grid, method="rules").update(first)
    Mapper(grids[0], method="elfes").update(first)


def main() -> None:
    near, far = flight(5.0, 3.0), flight(9.0, 9.0)
    plane = ul.Grid.covering([[-10, -10, -1], [10, 10, 1]], 0.1, z_m=0.0)
    volume = ul.Grid.covering([[-10, -10, -4], [10, 10, 4]], 0.1, dims=3)
    large = ul.Grid.covering([[-25, -25, -1], [25, 25, 1]], 0.05, z_m=0.0)
    coarse = ul.Grid.covering([[-25, -25, -1], [25, 25, 1]], 0.1, z_m=0.0)
    warm_up(near, plane, volume)
    if "--volume" in sys.argv:
        solid = row("rules, volume 0.1 m, near", Mapper(volume, method="rules"), near)
        open_ = row("rules, volume 0.1 m, far", Mapper(volume, method="rules"), far)
        print(f"far over near {open_['mean_ms'] / solid['mean_ms']:.2f}")
        return
    print("one profile at a time, four sensors at 25 Hz, 0.5 m/s")
    base = row("elfes, plane 0.1 m, near", Mapper(plane, method="elfes"), near)
    ours = row("rules, plane 0.1 m, near", Mapper(plane, method="rules"), near)
    wide = row("rules, plane 0.1 m, far", Mapper(plane, method="rules"), far)
    solid = row("rules, volume 0.1 m, near", Mapper(volume, method="rules"), near)
    open_ = row("rules, volume 0.1 m, far", Mapper(volume, method="rules"), far)
    row("rules, plane 50 x 50 m at 0.05 m", Mapper(large, method="rules"), near)
    row("rules, plane 50 x 50 m at 0.1 m", Mapper(coarse, method="rules"), near)
    rays()
    base, ours, wide, solid, open_ = (one["mean_ms"] for one in (base, ours, wide, solid, open_))
    print(f"ullage over elfes {ours / base:.1f}; far over near: plane {wide / ours:.2f}, volume {open_ / solid:.2f}")


if __name__ == "__main__":
    main()
