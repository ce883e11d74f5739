"""How near a drifting track comes back to the truth, nothing aligned: two drifts of 20 cm on each of five flights.

python benchmarks/drift_table.py [--flights 5] [--drifts 2]
"""

from __future__ import annotations

import argparse

import numpy as np
from mapping_table import believed, drift, room, route

import ullage as ul
from ullage.processing.drift import correct_drift

DRIFT_M = 0.2


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--flights", type=int, default=5)
    parser.add_argument("--drifts", type=int, default=2)
    options = parser.parse_args()
    scene, _ = room()
    print(
        "| flight | drift | before, rms [mm] | after, rms [mm] | of this one shift of all [mm] |\n|---|---|---|---|---|"
    )
    for seed in range(options.flights):
        path = route(seed)
        frames = ul.simulate(scene, path, ul.Rig.preset("thesis-4"), seed=seed)
        for k in range(options.drifts):
            offset = drift(len(path), DRIFT_M, np.random.default_rng([seed, 300 + k]))
            found = next(iter(correct_drift(believed(frames, offset), drift_m=DRIFT_M).values()))
            left = (found.believed.position - next(iter(frames.values())).believed.position)[:, :2]
            rms = [1e3 * np.sqrt((part**2).sum(1).mean()) for part in (offset[:, :2], left)]
            print(f"| {seed} | {k} | {rms[0]:.0f} | {rms[1]:.0f} | {1e3 * np.hypot(*left.mean(0)):.0f} |", flush=True)


if __name__ == "__main__":
    main()
