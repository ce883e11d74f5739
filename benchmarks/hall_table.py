"""Maps of halls wider than the range at which echoes fold, as a Markdown table: a ship's hold and halls of our own.

The hold is the scenario cargo-hold-physical, at 25 frames a second too. The halls have pillars or a panel; three more
have twelve wires and poles each, at places drawn for each.

python benchmarks/hall_table.py [--only WORD]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence

import numpy as np
from wire_table import OBJECTS

import ullage as ul
from ullage.data import Frames, Trajectory
from ullage.experiments.catalog import find_scenario
from ullage.experiments.simulated import prepare
from ullage.geometry import rpy_quat
from ullage.world.scene import Scene
from ullage.world.solids import block

RATE_HZ, SPEED_M_S = 12.5, 0.5
THINGS, CLEAR_M, APART_M = 12, 0.6, 1.0
PANEL = {"width_m": 2.0, "height_m": 3.0, "distance_m": 4.0, "yaw_deg": 30}


def round_trip(corners: Sequence[tuple[float, float]]) -> Trajectory:
    """A rounded way through corners, heading along it."""
    at = np.array(corners, float)
    way = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(at, axis=0), axis=1))])
    s = np.arange(0, way[-1], SPEED_M_S / RATE_HZ)
    xy = np.stack([np.interp(s, way, at[:, k]) for k in (0, 1)], axis=1)
    kernel = np.hanning(25) / np.hanning(25).sum()
    xy = np.stack([np.convolve(np.pad(c, 12, mode="edge"), kernel, "valid") for c in xy.T], axis=1)
    dx, dy = np.gradient(xy, axis=0).T
    quat = rpy_quat(0.02 * np.sin(s), 0.03 * np.cos(s), np.unwrap(np.arctan2(dy, dx)))
    t_ns = np.rint(np.arange(len(s)) * 1e9 / RATE_HZ).astype(np.int64)
    return Trajectory(t_ns, np.column_stack([xy, 0.05 * np.sin(1.3 * s)]), quat)


def pillars(hall: Scene, places: Sequence[tuple[float, float]], half_m: float) -> Scene:
    """The hall with square pillars from floor to ceiling."""
    low, high = hall.bounds[:, 2]
    parts = [
        Scene.of_mesh(*block((x - half_m, y - half_m, low), (x + half_m, y + half_m, high)), name=f"pillar {k}",
                      made_of="concrete")
        for k, (x, y) in enumerate(places)
    ]  # fmt: skip
    return Scene.union([hall, *parts])


def wired(seed: int) -> tuple[Scene, Trajectory]:
    """A hall with wires and poles of three sizes, clear of the way and of each other."""
    rng = np.random.default_rng([77, seed])
    path = round_trip([(-8, -3.5), (8, -3.5), (8, 3.5), (-8, 3.5), (-8, -3)])
    stand: list[np.ndarray] = []
    while len(stand) < THINGS:
        at = rng.uniform([-10, -7], [10, 7])
        clear = np.linalg.norm(path.position[:, :2] - at, axis=1).min() > CLEAR_M
        if clear and all(np.linalg.norm(at - other) > APART_M for other in stand):
            stand.append(at)
    sizes = list(OBJECTS.values())
    things = [
        Scene.of_wires((*at, -2.5), (*at, 2.5), sizes[k % len(sizes)], name=f"thing {k}") for k, at in enumerate(stand)
    ]
    return Scene.union([ul.scenes.room((22.0, 16.0, 5.0)), *things]), path


def cases() -> Iterator[tuple[str, Scene, Trajectory, int]]:
    for rate in (10, 25):
        made = prepare(find_scenario("cargo-hold-physical", options=[f"sensing.rate_hz={rate}"]))
        yield f"cargo hold, {rate} frames a second", made.scene, made.flown, made.scenario.seed
    hall = pillars(ul.scenes.room((25.0, 12.0, 5.0)), [(-6, -2), (0, 2.5), (6, -2)], 0.25)
    yield "25 x 12 m, concrete", hall, round_trip([(-10, -4), (10, -4), (10, 4), (-10, 4), (-10, -3.5)]), 3
    hall = pillars(ul.scenes.room((18.0, 14.0, 6.0), material="brick", plate=PANEL), [(-3, 3), (-4, -2)], 0.15)
    yield "18 x 14 m, brick", hall, round_trip([(-6.5, -4.5), (6.0, -5.0), (6.5, 4.8), (-6.5, 4.5), (-6.5, -4)]), 4
    places = [(-5.0, -5.5), (-1.0, -5.5), (3.0, -5.5), (5.0, 5.0), (-3.0, 4.5)]
    hall = pillars(ul.scenes.room((22.0, 16.0, 8.0), material="steel"), places, 0.05)
    yield "22 x 16 m, steel", hall, round_trip([(-8, -3), (8, -3), (8, 3), (-8, 3), (-8, -2.5)]), 5
    for seed in range(3):
        yield f"22 x 16 m with wires, {seed}", *wired(seed), seed


def rising(path: Trajectory) -> Trajectory:
    """The same way, rising and sinking by 0.9 m every 2.4 m."""
    place = path.position.copy()
    place[:, 2] += 0.45 * np.sin(2 * np.pi / 2.4 * SPEED_M_S / RATE_HZ * np.arange(len(place)))
    return Trajectory(path.t_ns, place, path.quat_xyzw)


def volumes() -> Iterator[tuple[str, Scene, Trajectory, int]]:
    hall = pillars(ul.scenes.room((25.0, 12.0, 5.0)), [(-6, -2), (0, 2.5), (6, -2)], 0.25)
    yield "25 x 12 m, volume", hall, rising(round_trip([(-10, -4), (10, -4), (10, 4), (-10, 4), (-10, -3.5)])), 0
    hall = pillars(ul.scenes.room((22.0, 16.0, 4.0)), [(-5, -3), (5, 3)], 0.3)
    yield "22 x 16 m, volume", hall, rising(round_trip([(-8, -5), (8, -5), (8, 5), (-8, 5), (-8, -4.5)])), 0


def row(scene: Scene, path: Trajectory, frames: dict[str, Frames], dims: int) -> str:
    box = np.stack(
        [np.minimum(scene.bounds[0], path.position.min(0)), np.maximum(scene.bounds[1], path.position.max(0))]
    )
    omap = ul.map_occupancy(frames, ul.Grid.covering(box, 0.1, dims=dims, margin_m=1.0), method="rules")
    got = {name: metric.value for name, metric in ul.metrics.map_quality(omap, scene, frames).items()}
    found = [value for name, value in got.items() if name.startswith("found:thing")]
    things = f"{sum(found):.0f} of {len(found)}" if found else ""
    scores = " | ".join(f"{got[name]:.3f}" for name in ("f1", "precision", "recall", "surface_declared_free"))
    return f"{scores} | {got['false_occupied']:.0f} | {things} |"


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--only", default="", help="halls whose name holds this word")
    parser.add_argument("--volume", action="store_true", help="halls in three dimensions")
    options = parser.parse_args()
    print(
        "| hall | F1 | precision | recall | surface free | false cells | things found |\n|---|---|---|---|---|---|---|"
    )
    for name, scene, path, seed in volumes() if options.volume else cases():
        if options.only in name:
            frames = ul.simulate(scene, path, ul.Rig.preset("thesis-4"), seed=seed)
            print(f"| {name} |", row(scene, path, frames, 3 if options.volume else 2), flush=True)


if __name__ == "__main__":
    main()
