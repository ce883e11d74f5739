"""Count the false stops of guarded flights through the cargo hold with physical radars: a Markdown row a flight.

    python -m studies.tables.guard_hold --seeds 5 [--speed 0.5] [-o KEY=VALUE]
    python -m studies.tables.guard_hold --seeds 5 -o sensing.changes.prf_div=64 -o sensing.changes.iterations=24

The end walls of the hold are up to 27 m away. At the usual pulse rate their echoes fold to short ranges; a `prf_div` of
64 puts the fold at 39.5 m. A stop is false if the hull could fly on for 1 m and keep its margin.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from studies.tables.guard_flights import gap_m, is_false
from ullage.experiments.catalog import find_scenario
from ullage.experiments.guarded_flight import Loop
from ullage.experiments.simulated import radars_and_world, waypoints_of
from ullage.flight.obstacles import bodies


def fly(seed: int, options: list[str]) -> tuple[float, int, int, bool, float, float]:
    """Duration [s], stops, false stops, whether it arrived, closest approach [m], and CPU time [s]."""
    plan = find_scenario("cargo-hold-physical", options=["flight.guard.on=true", f"seed={seed}", *options])
    rig, scene = radars_and_world(plan)
    begun = time.process_time()
    points = np.array(waypoints_of(plan.flight, plan.world))
    flight = Loop(plan, scene, rig, plan.sensing.rate_hz or 10.0).fly(points)
    cpu_s, parts, place = time.process_time() - begun, bodies(scene), flight.flown.position
    states = [step.limit.state in ("stop", "back_off") for step in flight.steps]
    begins = [k for k, now in enumerate(states) if now and not (k and states[k - 1])]
    false = sum(is_false(flight.steps[k], place[k], parts, plan.flight.guard.margin_m) for k in begins)
    closest = min(gap_m(parts, point, int(t_ns)) for point, t_ns in zip(place, flight.flown.t_ns, strict=True))
    return flight.flown.duration_s, len(begins), false, flight.arrived, closest, cpu_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--speed", type=float, default=0.5, help="[m/s]")
    parser.add_argument("-o", dest="options", action="append", default=[], help="key=value of the scenario")
    given = parser.parse_args()
    print(
        "| seed | flown [s] | stops | false | arrived | closest [m] | CPU-s |\n|---|---|---|---|---|---|---|",
        flush=True,
    )
    whole = false = 0.0
    for seed in range(1, given.seeds + 1):
        row = fly(seed, [f"flight.speed_m_s={given.speed:g}", *given.options])
        whole, false = whole + row[0], false + row[2]
        print(f"| {seed} | {row[0]:.0f} | {row[1]} | {row[2]} | {row[3]} | {row[4]:.2f} | {row[5]:.0f} |", flush=True)
    print(f"{false:.0f} false stops in {whole / 60:.1f} minutes: {60 * false / whole:.2f} a minute")


if __name__ == "__main__":
    main()
