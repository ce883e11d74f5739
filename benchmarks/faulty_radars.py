"""Maps of random worlds by radars that are few, faulty or mounted elsewhere than believed: a row for each fault.

    python benchmarks/faulty_radars.py [--kinds testing] [--seeds 1] [--faults FAULTS] [--publish faulty_radars]

Flights are those of `random_worlds.py --short`.
"""

from __future__ import annotations

import argparse
import shlex
import sys
import warnings
import zlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from random_worlds import grid_of, shortened

import ullage as ul
from ullage.data import Frames
from ullage.errors import UllageWarning
from ullage.flight.random_flights import flight
from ullage.world.scene import Scene

sys.path.append(str(Path(__file__).parents[1] / "tools"))
import results

SCORES = ("f1", "precision", "recall", "surface_declared_free", "flyable_found", "flyable_false")
BROKEN = 1 / 3
"""Share of the flight after which a radar fails."""
OFF_M, OFF_DEG = 0.02, 2.0
"""Standard deviations of mounts, stated and drawn."""
Flown = Callable[[ul.Rig], dict[str, Frames]]


def failing(frames: dict[str, Frames], samples: Callable[[Frames, int], np.ndarray]) -> dict[str, Frames]:
    """Frames whose radar on the right sends other samples after a third of the flight."""
    part = frames["right"]
    first = int(BROKEN * len(part))
    made = part.samples.copy()
    made[first:] = samples(part, first)
    return frames | {"right": replace(part, samples=made)}


def noise(part: Frames, first: int) -> np.ndarray:
    """Noise of a deaf radar, as strong as what its far bins hold."""
    rng, level = np.random.default_rng(0), np.median(np.abs(part.samples)) / 1.18
    shape = part.samples[first:].shape
    return level * (rng.normal(size=shape) + 1j * rng.normal(size=shape))


def elsewhere(fly: Flown, rig: ul.Rig, seed: int) -> dict[str, Frames]:
    """Frames of radars that are mounted elsewhere than their poses say; the standard deviations are stated."""
    rng, off, stated = np.random.default_rng(seed), {}, {}
    for name, spec in rig.sensors.items():
        mount = spec.mount
        turned = {
            f"{axis}_deg": getattr(mount, f"{axis}_deg") + rng.normal(0, OFF_DEG) for axis in ("roll", "pitch", "yaw")
        }
        place = tuple(np.add(mount.position_m, rng.normal(0, OFF_M, 3)).tolist())
        off[name] = spec.but(mount=mount.but(position_m=place, **turned))
        stated[name] = spec.but(mount=mount.but(position_sigma_m=OFF_M, angle_sigma_deg=OFF_DEG))
    sent, believed = fly(ul.Rig(sensors=off)), fly(ul.Rig(sensors=stated))
    return {name: replace(part, samples=sent[name].samples) for name, part in believed.items()}


def faults(fly: Flown, rig: ul.Rig, seed: int) -> Mapping[str, Callable[[], dict[str, Frames]]]:
    """What may be wrong, by name."""
    pulson = ul.Rig(
        sensors={name: ul.RadarSpec.preset("pulson440").but(mount=spec.mount) for name, spec in rig.sensors.items()}
    )
    return {
        "none": lambda: fly(rig),
        "one deaf": lambda: failing(fly(rig), noise),
        "one stuck": lambda: failing(fly(rig), lambda part, first: part.samples[first - 1]),
        "one missing": lambda: {name: part for name, part in fly(rig).items() if name != "right"},
        "two radars, left and right": lambda: {name: fly(rig)[name] for name in ("left", "right")},
        "one radar, left": lambda: {"left": fly(rig)["left"]},
        "mounts 2 cm and 2 deg off": lambda: elsewhere(fly, rig, seed),
        "PulsON 440": lambda: fly(pulson),
    }


def scores(scene: Scene, frames: dict[str, Frames]) -> list[float]:
    """The scores of the map."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UllageWarning)
        omap = ul.map_occupancy(frames, grid_of(scene, frames, volume=False))
    found = ul.metrics.map_quality(omap, scene, frames)
    return [found[name].value for name in SCORES]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", default="testing", help="tuning, testing, all, or names with commas between them")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--faults", help="names with semicolons between them; all without")
    parser.add_argument("--publish", metavar="NAME", help="write the table of means to studies/results/NAME.csv")
    given = parser.parse_args()
    groups = {"tuning": ul.worlds.TUNING, "testing": ul.worlds.TESTING, "all": ul.worlds.KINDS}
    found: dict[str, list[list[float]]] = {}
    for kind in groups.get(given.kinds, tuple(given.kinds.split(","))):
        for seed in range(given.seeds):
            scene, path = ul.worlds.random(kind, seed), shortened(flight(kind, seed))
            number = zlib.crc32(f"{kind} {seed}".encode())

            def fly(
                rig: ul.Rig, scene: Scene = scene, path: ul.Trajectory = path, seed: int = seed
            ) -> dict[str, Frames]:
                return ul.simulate(scene, path, rig, max_bounces=1, seed=seed)

            for name, make in faults(fly, ul.worlds.rig(kind, seed), number).items():
                if given.faults is None or name in given.faults.split(";"):
                    row = scores(scene, make())
                    found.setdefault(name, []).append(row)
                    print(kind, seed, name, *(f"{value:.3f}" for value in row), sep=", ", flush=True)
    free, false_ = "surface declared free", "`flyable_false`"
    rows = [["fault", "flights", "F1", "worst F1", free, "most of it", "`flyable_found`", false_, f"most {false_}"]]
    for name, values in found.items():
        f1, _, _, declared, offered, false = np.array(values).T
        shown = f1.mean(), f1.min(), declared.mean(), declared.max(), offered.mean(), false.mean(), false.max()
        rows.append([name, str(len(values)), *(f"{value:.3f}" for value in shown)])
    print("", *(", ".join(row) for row in rows), sep="\n")
    if given.publish:
        print(results.save(given.publish, rows, shlex.join(["python", *sys.argv])))


if __name__ == "__main__":
    main()
