"""Time from four frames to a velocity limit, the share of a core that takes, and the closed loop against real time.

    python benchmarks/bench_guard.py [--seconds 30] [--rate-hz 17]

The latency ends when the limit is known; the estimate of the radars' own echo goes on after it and counts as load.
CPU time is that of this process. Wall time depends on what else the machine does.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import ullage as ul
from ullage.config import make_scenario
from ullage.experiments.guarded_flight import Loop


def steps(seconds: float, rate_hz: float) -> tuple[np.ndarray, float]:
    """CPU and wall time of each step until the limit is known (n, 2) [s], and CPU time of all in all [s]."""
    scene = ul.scenes.room(size_m=(0.3 * seconds + 6, 5, 3), material="steel")
    rig = ul.Rig.preset("thesis-4", radar=ul.RadarSpec.preset("x4m05", prf_div=64, iterations=12))
    x_m = 0.15 * seconds
    path = ul.Trajectory.line((-x_m, 0, 0), (x_m, 0, 0), speed_m_s=0.3, rate_hz=rate_hz)
    frames = ul.simulate(scene, path, rig, seed=1)
    stage, guard, out = ul.ObstacleStage(rig.sensors), ul.Guard(ul.GuardSpec(), hull_m=0.4), []
    begun = time.process_time()
    for row in range(len(path)):
        chunk = {name: part[row : row + 1] for name, part in frames.items()}
        cpu, wall = time.process_time(), time.perf_counter()
        for sectors in stage.update(chunk):
            guard.limit((0.3, 0, 0), sectors, path[row : row + 1])
            out.append((time.process_time() - cpu, time.perf_counter() - wall))
    return np.array(out), time.process_time() - begun


def closed_loop(rate_hz: float) -> float:
    """CPU seconds for each simulated second with four physical radars and the guard."""
    options = ["flight.guard.on=true", "flight.speed_m_s=0.4", f"sensing.rate_hz={rate_hz:g}"]
    plan = make_scenario({"name": "bench"}, options=options)
    scene = ul.scenes.room(size_m=(8, 5, 3), material="steel")
    points = np.array([[-2.0, 0, 0], [2.0, 0, 0]])
    begun = time.process_time()
    flight = Loop(plan, scene, plan.sensing.radars(), rate_hz).fly(points)
    return (time.process_time() - begun) / flight.flown.duration_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0, help="length of the flight for the latency")
    parser.add_argument("--rate-hz", type=float, default=17.0)
    given = parser.parse_args()
    steps(2.0, given.rate_hz)  # kernels are loaded
    closed_loop(given.rate_hz)
    each, whole = steps(given.seconds, given.rate_hz)
    each = each[10:]  # the first frames allocate
    print("| figure | p50 | p99 | target |\n|---|---|---|---|")
    for name, column, target in (("CPU", 0, "5 ms (p99)"), ("wall", 1, "")):
        middle, late = np.percentile(each[:, column] * 1e3, [50, 99])
        print(f"| frames to limit, {name} [ms] | {middle:.2f} | {late:.2f} | {target} |")
    print(f"| share of a core, {given.rate_hz:g} Hz [%] | {100 * whole / given.seconds:.1f} | | 10 % |")
    print(f"| closed loop, CPU-s a simulated second | {closed_loop(given.rate_hz):.2f} | | 1 |")


if __name__ == "__main__":
    main()
