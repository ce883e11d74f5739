"""Exploring flights beside scripted surveys of equal time: surface mapped, closest approach, CPU time of each part.

    python benchmarks/explore.py [--seconds 60] [--worlds office:1 tank:1 cluttered-room cargo-hold] [--to FILE.csv]

A world is a library world, or KIND:SEED of the random ones. The survey is a round along the walls, 1 m from them, or
the flight of a library or random world where there is no such round. It flies without a guard, at the same speed, and
back and forth until the time is up. Rows go to a CSV file; those that it holds already are not made again.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import ullage as ul
from ullage.config import make_scenario
from ullage.errors import InputError
from ullage.experiments.exploration import Exploration, Explorer
from ullage.experiments.exploration_report import closest_m, judge, mapped, observable_from, reachable
from ullage.experiments.guarded_flight import Loop
from ullage.experiments.report_collectors import SampledFrames
from ullage.flight.live import Steered
from ullage.flight.missions import along_walls
from ullage.grids import Grid
from ullage.pipeline import InMemorySource, MapStage, run
from ullage.processing.guard import Guard
from ullage.processing.obstacles import ObstacleStage
from ullage.radar.receiving import Receiving
from ullage.view.replay import MapHistory
from ullage.world.library import WORLDS

RATE_HZ, SPEED_M_S, STEP_M = 10.0, 0.5, 0.1
LONG = ["sensing.changes.prf_div=64", "sensing.changes.iterations=24"]  # no folds in a world longer than 9.87 m
FIELDS = ("world", "seed", "seconds", "explored", "survey", "explored_at_50", "survey_at_50", "closest_m", "contacts",
          "survey_closest_m", "length_m", "guard_stops", "ended", "radars", "guard", "mapper", "planner", "vehicle",
          "all")  # fmt: skip


class Clock:
    """CPU time of functions, in whatever thread they run."""

    def __init__(self) -> None:
        self.spent_s: dict[str, float] = defaultdict(float)

    def watch(self, part: str, owner: Any, name: str) -> None:
        """Count the time of a method as that of a part."""
        inner: Callable[..., Any] = getattr(owner, name)

        def timed(*args: Any, **kwargs: Any) -> Any:
            begun = time.thread_time()
            try:
                out = inner(*args, **kwargs)
                return list(out) if hasattr(out, "__next__") else out
            finally:
                self.spent_s[part] += time.thread_time() - begun

        setattr(owner, name, timed)


def world_of(name: str, seed: int) -> tuple[Any, np.ndarray, np.ndarray]:
    """Scene, start (4) and path (n, 3) of the world's own flight."""
    if ":" in name:
        kind, number = name.split(":")
        path = ul.worlds.flight(kind, int(number)).position
        return ul.worlds.random(kind, int(number)), np.array([*path[0, :2], path[:, 2].mean(), 0.0]), path
    world = WORLDS[name]
    return world.scene(), np.array(world.start), np.array(world.path_xyzyaw)[:, :3]


def survey(scene: Any, start: np.ndarray, path: np.ndarray, seconds: float, seed: int) -> ul.Trajectory:
    """The scripted flight."""
    try:
        points = along_walls(scene, float(start[2]), distance_m=1.0, inside=start[:2]).points[:, :3]
    except InputError:
        points = path
    first = int(np.argmin(np.linalg.norm(points - start[:3], axis=1)))
    points = np.vstack([start[:3], np.roll(points[:-1], -first, axis=0), points[first]])
    points = points[np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 0.05)]
    while np.linalg.norm(np.diff(points, axis=0), axis=1).sum() < SPEED_M_S * seconds:
        points = np.vstack([points, points[-2::-1]])
    flown = ul.fly(ul.Waypoints(points, SPEED_M_S, yaw="along"), rate_hz=RATE_HZ, seed=seed)
    return flown[: int(seconds * RATE_HZ)]


def row_of(name: str, seed: int, seconds: float, clock: Clock) -> dict[str, Any]:
    """Fly both ways and judge."""
    scene, start, path = world_of(name, seed)
    long = float(np.ptp(scene.bounds, axis=0)[:2].max()) > 9.0
    options = ["flight.guard.on=true", f"flight.speed_m_s={SPEED_M_S}", f"seed={seed}", *(LONG if long else [])]
    plan = make_scenario({"name": "bench"}, options=options)
    rig, grid = plan.sensing.radars(), Grid.covering(scene.bounds, STEP_M, margin_m=1.0)
    clock.spent_s.clear()
    begun = time.process_time()
    flight = Exploration(Loop(plan, scene, rig, RATE_HZ), start, time_s=seconds)
    history, kept = MapHistory(), SampledFrames()
    out = run(flight, stages=[kept, MapStage(grid, every_s=0.5, live=True)], sinks=[flight.maps, history])
    spent = dict(clock.spent_s) | {"all": time.process_time() - begun}
    maps = [*history.maps(), (flight.flown.duration_s, out.results[0])]
    found = {one.name: one.value for one in judge(flight, maps, scene, kept.frames()).metrics}
    scripted = survey(scene, start, path, flight.flown.duration_s, seed)
    frames = ul.simulate(scene, scripted, rig, seed=seed)
    history = MapHistory()
    out = run(InMemorySource(frames, round(RATE_HZ / 2)), stages=[MapStage(grid, every_s=0.5, live=True)],
              sinks=[history])  # fmt: skip
    places = reachable(scene, start, clearance_m=flight.clearance_m)
    surface = observable_from(scene, grid.at_height(float(start[2])), rig, places)
    points = surface.points[surface.observable(1)]
    half = [omap for at, omap in history.maps() if at <= scripted.duration_s / 2][-1]
    flown_s, far_m = flight.flown.duration_s, found["flight_length"]
    rate = {part: round(spent.get(part, 0.0) / flight.flown.duration_s, 3)
            for part in ("radars", "guard", "mapper", "planner", "vehicle", "all")}  # fmt: skip
    return {
        "world": name, "seed": seed, "seconds": round(flown_s, 1), "explored": round(found["explored"], 3),
        "survey": round(float(mapped(out.results[0], points).mean()), 3),
        "explored_at_50": round(found["explored_at_50"], 3),
        "survey_at_50": round(float(mapped(half, points).mean()), 3),
        "closest_m": round(found["closest_approach"], 2), "contacts": int(found["contacts"]),
        "survey_closest_m": round(closest_m(scene, scripted, "hector"), 2), "length_m": round(far_m, 1),
        "guard_stops": round(found["guard_stops"], 1), "ended": flight.pilot.ended, **rate,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--worlds", nargs="+", default=["office:1", "tank:1", "cluttered-room", "cargo-hold"])
    parser.add_argument("--to", type=Path, default=Path("explore.csv"))
    given = parser.parse_args()
    clock = Clock()
    for part, owner, name in (
        ("radars", Receiving, "samples"), ("guard", ObstacleStage, "update"), ("guard", Guard, "limit"),
        ("mapper", MapStage, "update"), ("planner", Explorer, "update"), ("vehicle", Steered, "advance"),
    ):  # fmt: skip
        clock.watch(part, owner, name)
    rows = list(csv.DictReader(given.to.open())) if given.to.exists() else []
    for seed in given.seeds:
        for world in given.worlds:
            if not any(row["world"] == world and row["seed"] == str(seed) for row in rows):
                row = row_of(world, seed, given.seconds, clock)
                rows.append({key: str(value) for key, value in row.items()})
                print(row, flush=True)
                with given.to.open("w", newline="") as file:
                    writer = csv.DictWriter(file, FIELDS)
                    writer.writeheader()
                    writer.writerows(rows)
    print("| " + " | ".join(FIELDS) + " |\n|" + "---|" * len(FIELDS))
    for row in rows:
        print("| " + " | ".join(row[name] for name in FIELDS) + " |")


if __name__ == "__main__":
    main()
