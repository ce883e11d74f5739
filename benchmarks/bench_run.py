"""Whole-process figures: import, help, the main job against real time, memory over a long flight.

CPU seconds are the children's own; wall seconds are given beside them, since machines are shared.
"""

from __future__ import annotations

import json
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path


def child(*words: str, env: dict[str, str] | None = None) -> tuple[float, float, float]:
    """CPU seconds, wall seconds and peak megabytes of one process."""
    began = time.perf_counter()
    quiet = os.open(os.devnull, os.O_WRONLY)
    actions = [(os.POSIX_SPAWN_DUP2, quiet, 1), (os.POSIX_SPAWN_DUP2, quiet, 2)]
    pid = os.posix_spawn(sys.executable, [sys.executable, *words], {**os.environ, **(env or {})}, file_actions=actions)
    _, status, used = os.wait4(pid, 0)
    os.close(quiet)
    if status:
        raise SystemExit(f"{' '.join(words)} failed")
    return used.ru_utime + used.ru_stime, time.perf_counter() - began, used.ru_maxrss / 1024


def median_of(count: int, *words: str) -> tuple[float, float, float]:
    rows = [child(*words) for _ in range(count)]
    return tuple(statistics.median(column) for column in zip(*rows, strict=True))


def main() -> None:
    empty = median_of(5, "-c", "pass")
    for name, words in (("import ullage", ("-c", "import ullage")), ("ullage --help", ("-m", "ullage", "--help"))):
        cpu, wall, _ = median_of(5, *words)
        print(f"{name}: {1000 * (cpu - empty[0]):.0f} CPU-ms over an empty Python, {1000 * wall:.0f} ms wall in all")
    with tempfile.TemporaryDirectory() as out:
        run = ("-m", "ullage", "run", "cargo-hold", "--force", "--out", out)
        child(*run)
        cpu, wall, peak = child(*run)
        seconds = json.loads((Path(out) / "latest" / "metrics.json").read_text())["duration"]["value"]
        print(
            f"ullage run cargo-hold: {seconds:.0f} s of flight in {wall:.1f} s wall, {cpu:.1f} CPU-s: "
            f"{seconds / wall:.1f} times real time here, {seconds / cpu:.1f} times per CPU-second; peak {peak:.0f} MB"
        )
        ideal = ("-o", "flight.vehicle=ideal", "-o", "image.step_m=0.2")
        for laps in (1, 4):
            path = [[-11.5, -7, 4, 0], [11, -7, 4, 0], [11, 7, 4, 0], [-11.5, 7, 4, 0]] * laps
            _, _, peak = child(*run, *ideal, "-o", f"flight.waypoints={json.dumps(path)}")
            print(f"memory of a flight of {laps} round(s), about {150 * laps} s: peak {peak:.0f} MB")


if __name__ == "__main__":
    main()
