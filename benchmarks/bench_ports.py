"""What recording and replaying cost: CPU per frame, and how many times faster than the flight it goes.

Run: python benchmarks/bench_ports.py
"""

import tempfile
import time
import tracemalloc
from pathlib import Path

import numpy as np

import ullage as ul
from ullage.ports.bag import McapSink

SECONDS, RATE_HZ = 60, 25.0


def flight() -> dict[str, ul.Frames]:
    """One minute of four X4M05 at 25 Hz."""
    rng = np.random.default_rng(1)
    rig = ul.Rig.preset("thesis-4")
    path = ul.Trajectory.line((0, 0, 0), (0.5 * SECONDS, 0, 0), 0.5, RATE_HZ)
    out = {}
    for name, spec in rig.sensors.items():
        noise = rng.normal(size=(len(path), spec.bins, 2)).astype(np.float32) * 2e-5
        poses = path.mounted(spec.mount.body_from_sensor())
        out[name] = ul.Frames(
            noise.view(np.complex64)[..., 0], spec.range_m, path.t_ns, spec, poses=poses, truth=poses, sensor=name
        )
    return out


def record(frames: dict[str, ul.Frames], path: Path, *, profile: bool) -> float:
    """CPU seconds to record in chunks of 64."""
    start = time.process_time()
    with McapSink(path, profile=profile, overwrite=True) as sink:
        for at in range(0, len(frames["front"]), 64):
            sink.write({name: f[at : at + 64] for name, f in frames.items()})
    return time.process_time() - start


def main() -> None:
    frames = flight()
    count = sum(map(len, frames.values()))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bench.mcap"
        record(frames, path, profile=True)  # the first pays for imports
        for profile in (True, False):
            cost = record(frames, path, profile=profile)
            size = path.stat().st_size / 1e6
            speed = f"{1e3 * cost / count:.3f} ms a frame, {SECONDS / cost:.0f} x real time"
            print(f"record, profile={profile}: {speed}, {size:.1f} MB")
        for what in ("stream", "frames"):
            start = time.process_time()
            source = ul.open(path)
            parts = source.stream() if what == "stream" else [source.frames()]
            got = sum(len(frames) for part in parts for frames in part.values())
            cost = time.process_time() - start
            print(f"{what}: {1e3 * cost / got:.3f} ms a frame, {SECONDS / cost:.0f} x real time")
        tracemalloc.start()
        for _ in ul.open(path).stream():
            pass
        print(f"peak of streaming: {tracemalloc.get_traced_memory()[1] / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
