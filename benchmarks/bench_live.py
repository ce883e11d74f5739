"""From frame to obstacle message in a live run with detections, map, image and recording on, and how far the map lags.

    python benchmarks/bench_live.py [--seconds 30] [--world ntnu-mapping] [--slow 0] [--fidelity physical]

`--slow S` makes one stage sleep S seconds for each second of frames, as a map on a slower machine would. Run it with
`taskset -c 0,1` for the two cores.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

import ullage as ul
from ullage.flight.pilot import Pilot, Velocity
from ullage.pipeline import DetectStage, ImageStage, MapStage
from ullage.ports.by_hand import FlyOptions, HandFlownSource
from ullage.ports.intake import Counters
from ullage.processing.obstacles import ObstacleStage
from ullage.world.library import WORLDS


class Turning:
    """Turns on the spot, back and forth."""

    counters = Counters()

    def update(self, pilot: Pilot, now_s: float) -> None:
        """Command a turn rate."""
        pilot.command(Velocity(turn_rad_s=0.4 if int(now_s / 5) % 2 else -0.4), now_s)

    def close(self) -> None:
        """Nothing is open."""


class Slow:
    """A stage that takes its time.

    Args:
        share: seconds for each second of frames.
    """

    def __init__(self, share: float) -> None:
        self.share = share

    def update(self, chunk: dict[str, ul.Frames]) -> Iterable[Any]:
        """Sleep."""
        time.sleep(self.share * max(len(part) / part.spec.fps for part in chunk.values()))
        return ()

    def finish(self) -> Iterable[Any]:
        """Nothing is left over."""
        return ()


class Sent:
    """Stands for a port that sends messages; notes the memory of the process at each second."""

    sends = True

    def __init__(self) -> None:
        self.obstacles, self.memory_mb, self.last_s = 0, list[float](), 0.0

    def write(self, item: Any) -> None:
        """Take an item."""
        self.obstacles += type(item).__name__ == "ObstacleSectors"
        if time.monotonic() - self.last_s > 1:
            self.last_s = time.monotonic()
            pages = int(Path("/proc/self/statm").read_text().split()[1])
            self.memory_mb.append(pages * resource.getpagesize() / 1e6)

    def close(self) -> None:
        """Nothing is open."""


def main() -> None:
    """Fly, and print the figures."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--seconds", type=float, default=30.0)
    words.add_argument("--world", default="ntnu-mapping")
    words.add_argument("--slow", type=float, default=0.0)
    words.add_argument("--lag", type=float, default=2.0)
    words.add_argument("--fidelity", default="physical")
    words.add_argument("--bare", action="store_true", help="obstacles only, without map, image and recording")
    given = words.parse_args()
    scene = WORLDS[given.world].scene()
    start = tuple(WORLDS[given.world].start)
    options = FlyOptions(duration_s=given.seconds, fidelity=given.fidelity, lag=given.lag)
    grid = ul.Grid.covering(scene.bounds, 0.1)
    image = ImageStage(grid, "summation" if given.fidelity == "thesis" else "backprojection", every_s=0.2)
    stages = [DetectStage(), ObstacleStage(), MapStage(grid, live=True, every_s=0.2), image]
    stages = [ObstacleStage()] if given.bare else stages
    stages += [Slow(given.slow)] if given.slow else []
    with tempfile.TemporaryDirectory() as folder:
        for seconds in (3.0, given.seconds):  # the first flight compiles
            chosen = options.but(duration_s=seconds)
            source = HandFlownSource(scene, ul.Rig.preset("thesis-4"), chosen, Turning(), start=start, log=print)
            sent = Sent()
            sinks = [sent] if given.bare else [ul.sink(Path(folder, f"{seconds}.mcap")), sent]
            used = time.process_time()
            done = ul.run(source, stages=stages, sinks=sinks)
            used = time.process_time() - used
    assert done.live is not None
    print(f"{done.frames} frames of {done.duration_s:.1f} s, {used / done.duration_s:.2f} CPU s a second")
    print(f"{sent.obstacles} obstacle messages")
    print("\n".join(done.live.lines()))
    print(f"map and image at most {done.live.most_behind_s:.2f} s behind, {done.live.left_out} frames left out")
    some = np.array(sent.memory_mb)
    print("memory [MB], each tenth of the run: " + " ".join(f"{part.mean():.0f}" for part in np.array_split(some, 10)))


if __name__ == "__main__":
    main()
