"""Fly explorers and scripted surveys of equal time, and summarise all flights in `studies/results/exploring.csv`.

    python -m studies.tables.exploring [--seconds 60] [--seeds 1 2] [--worlds ntnu-room silo] [--kinds explorer survey]
    python -m studies.tables.exploring --summary

A world is a library world, or a kind of the random ones, of which the seed picks one. The survey is a round along the
walls, 1 m from them, or the flight of the world itself where there is no such round. It flies without a guard, at the
same speed, back and forth until the time is up, and need not come home. Worlds longer than 9 m get a longer pulse
interval. `studies/results/flights/exploring.csv` has a row for each flight. Flights that it holds are not flown again,
so a run that was cut short goes on. `--summary` only rebuilds the summary from it.
"""

from __future__ import annotations

import argparse
import csv
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

import ullage as ul
from tools.results import RESULTS, save
from ullage.arrays import Floats
from ullage.config import Scenario, make_scenario
from ullage.data import Frames, Imu
from ullage.errors import InputError
from ullage.experiments.exploration import Exploration
from ullage.experiments.exploration_report import closest_m, judge, observable_from, reachable
from ullage.experiments.guarded_flight import Loop
from ullage.experiments.radar_poses import LivePoses
from ullage.experiments.run import SampledFrames
from ullage.flight.missions import along_walls
from ullage.geometry import GRAVITY_M_S2
from ullage.grids import Grid
from ullage.pipeline import InMemorySource, MapStage, run
from ullage.processing.metrics import on_map
from ullage.view.replay import MapHistory
from ullage.world.library import WORLDS
from ullage.world.scene import Scene
from ullage.world.scenes import cylinder

NAME, FLIGHTS, COMMAND = "exploring", "flights/exploring", "python -m studies.tables.exploring"
RATE_HZ, SPEED_M_S, STEP_M = 10.0, 0.5, 0.1
LONG = ("sensing.changes.prf_div=64", "sensing.changes.iterations=24")  # no folds in a world longer than 9.87 m
AMPLE_S, AMPLE = 240.0, ", 240 s"  # time for the whole world, and how the names of such flights end
KINDS = ("explorer", "survey", f"explorer{AMPLE}", f"survey{AMPLE}", "free space only", "wind", "person walks",
         "radar poses", "radar dies", "IMU jumps")  # fmt: skip
OPTIONS = {
    "radar poses": ("flight.poses=radar",),
    "IMU jumps": ("flight.poses=radar",),
    "free space only": ("flight.free_probability=0.95", "flight.free_start_m=0.9"),
    "wind": ("flight.wind_m_s=[2, 0, 0]", "flight.gust_m_s=0.5"),
}
PERSON, WALK_M_S = "person", 1.0
PLACES = ("ntnu-room", "office", "pipe-rack", "ballast-tank", "silo", "lying-tank", "cargo-hold")
HEADER = ("world, seed", "flight", "time [s]; CPU [s/s]", "mapped at half; end", "contacts; closest [m]",
          "pose errors: rms; end [m]; lost [%]")  # fmt: skip
SUMMARY = ("world", "flight", "flights", HEADER[2], "mapped at half; end (worst)", *HEADER[4:])


class Place(NamedTuple):
    """A world and where flights in it go."""

    scene: Scene
    start: Floats  # (4) x, y, z [m], yaw [deg]
    path: Floats  # (n, 3) of its own flight [m]
    plan: Scenario

    @property
    def grid(self) -> Grid:
        """Plane or volume of the map."""
        return Grid.covering(self.scene.bounds, STEP_M, margin_m=1.0, z_m=float(self.start[2]))


def place_of(world: str, seed: int, *options: str) -> Place:
    """Load a world and the settings of a flight in it."""
    if world in WORLDS:
        scene, path = WORLDS[world].scene(), np.array(WORLDS[world].path_xyzyaw)[:, :3]
        start = np.array(WORLDS[world].start)
    else:
        scene, path = ul.worlds.random(world, seed), ul.worlds.flight(world, seed).position
        start = np.array([*path[0, :2], path[:, 2].mean(), 0.0])
    long = LONG if float(np.ptp(scene.bounds, axis=0)[:2].max()) > 9.0 else ()
    given = ["flight.guard.on=true", f"flight.speed_m_s={SPEED_M_S}", f"seed={seed}", *long, *options]
    return Place(scene, start, path, make_scenario({"name": "exploring"}, options=given))


class Dying:
    """Frames without those of one radar from a time on."""

    def __init__(self, sensor: str, from_s: float) -> None:
        self._sensor, self._from_s = sensor, from_s

    def __call__(self, frames: dict[str, Frames]) -> Mapping[str, Frames]:
        """Return what still comes."""
        late = float(next(iter(frames.values())).t_ns[-1]) * 1e-9 >= self._from_s
        return {name: part for name, part in frames.items() if not (late and name == self._sensor)}


class Jumping(LivePoses):
    """Poses by an inertial unit whose offsets jump at a time."""

    def __init__(self, seed: int, from_s: float) -> None:
        super().__init__(seed)
        self._from_s = from_s

    def read(self, imu: Imu) -> Imu:
        """Return readings with the jump: 1 deg/s about the vertical, and 50 mg ahead."""
        late = (imu.t_ns * 1e-9 >= self._from_s)[:, None]
        turn, push = np.array([0.0, 0.0, math.radians(1.0)]), np.array([0.05 * GRAVITY_M_S2, 0.0, 0.0])
        return Imu(imu.t_ns, imu.angular_velocity + late * turn, imu.specific_force + late * push)


def walker(scene: Scene, seconds: float) -> Scene:
    """Return a body as large as a person that walks up and down across the middle of a world, wall to wall."""
    low, high = scene.bounds
    radius_m, height_m = 0.25, 1.8
    t_ns = (np.arange(round(seconds / 0.1) + 1) * 1e8).astype(np.int64)
    length_m = high[1] - low[1] - 4 * radius_m
    at_m = WALK_M_S * t_ns * 1e-9 % (2 * length_m)
    y = low[1] + 2 * radius_m + np.minimum(at_m, 2 * length_m - at_m)
    x, z = np.full(len(y), (low[0] + high[0]) / 2), np.full(len(y), low[2] + height_m / 2)
    body = cylinder(radius_m, height_m, material="skin", name=PERSON)
    motion = ul.Trajectory(t_ns, np.column_stack([x, y, z]), np.tile([0.0, 0.0, 0.0, 1.0], (len(y), 1)))
    return replace(body, objects=(replace(body.objects[0], motion=motion),))


def explore(world: str, seed: int, seconds: float, kind: str) -> list[str]:
    """Let the explorer fly, and judge it by what stands still, but contacts and distance by a person too."""
    place = place_of(world, seed, *OPTIONS.get(kind, ()))
    person = walker(place.scene, 2 * seconds) if kind == "person walks" else None
    scene = place.scene if person is None else place.scene.add(person)
    loop = Loop(place.plan, scene, place.plan.sensing.radars(), RATE_HZ)
    if kind == "IMU jumps":
        loop.poses = Jumping(seed, seconds / 10)  # before the poses are lost
    if kind == "radar dies":
        loop.receive = Dying(next(iter(loop.rig.sensors)), seconds / 2)
    history, kept = MapHistory(), SampledFrames()
    begun = time.process_time()
    flight = Exploration(loop, place.start, time_s=seconds)
    stages = [kept, MapStage(place.grid, every_s=0.5, live=True)]
    out = run(flight, stages=stages, sinks=[flight.maps, history])
    cpu_s = time.process_time() - begun
    maps = [*history.maps(), (flight.flown.duration_s, out.results[0])]
    judged = judge(flight, maps, place.scene, kept.frames())
    print(*judged.lines, sep="\n", flush=True)
    found = {one.name: one.value for one in judged.metrics}
    closest = found["closest_approach"]
    if person is not None:  # also while it lands
        closest = min(closest, closest_m(person, flight.flown, place.plan.flight.vehicle))
    touched = [
        *(one for one in loop.contacts if one[1] == PERSON),
        *(one for one in flight.contacts if one[1] != PERSON),
    ]
    errors = [f"{found[name]:.{digits}f}"
              for name, digits in (("pose_rms", 2), ("pose_end", 2), ("poses_lost", 0)) if name in found]  # fmt: skip
    return [
        f"{flight.flown.duration_s:.0f}; {cpu_s / flight.flown.duration_s:.1f}",
        f"{found.get('explored_at_50', 0):.2f}; {found.get('explored', 0):.2f}",
        f"{len(touched)}; {closest:.2f}", "; ".join(errors),
    ]  # fmt: skip


def survey(world: str, seed: int, seconds: float) -> list[str]:
    """Fly the script, map it as the explorer does, and judge by the same surface."""
    place = place_of(world, seed)
    scene, rig, start = place.scene, place.plan.sensing.radars(), place.start
    begun = time.process_time()
    flown = scripted(place, seconds, seed)
    frames, history = ul.simulate(scene, flown, rig, seed=seed), MapHistory()
    out = run(InMemorySource(frames, round(RATE_HZ / 2)), stages=[MapStage(place.grid, every_s=0.5, live=True)],
              sinks=[history])  # fmt: skip
    cpu_s = time.process_time() - begun
    clearance_m = Exploration(Loop(place.plan, scene, rig, RATE_HZ), start, time_s=1.0).clearance_m
    surface = observable_from(scene, place.grid, rig,
                              reachable(scene, start, clearance_m=clearance_m))  # fmt: skip
    points = surface.points[surface.observable(1)]
    half = [omap for at, omap in history.maps() if at <= flown.duration_s / 2][-1]
    return [
        f"{flown.duration_s:.0f}; {cpu_s / flown.duration_s:.1f}",
        f"{on_map(half, points).mean():.2f}; {on_map(out.results[0], points).mean():.2f}",
        f"-; {closest_m(scene, flown, 'hector'):.2f}", "",
    ]  # fmt: skip


def scripted(place: Place, seconds: float, seed: int) -> ul.Trajectory:
    """The survey's flight."""
    start = place.start
    try:
        points = along_walls(place.scene, float(start[2]), distance_m=1.0, inside=start[:2]).points[:, :3]
    except InputError:
        points = place.path
    first = int(np.argmin(np.linalg.norm(points - start[:3], axis=1)))
    points = np.vstack([start[:3], np.roll(points[:-1], -first, axis=0), points[first]])
    points = points[np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 0.05)]
    while np.linalg.norm(np.diff(points, axis=0), axis=1).sum() < SPEED_M_S * seconds:
        points = np.vstack([points, points[-2::-1]])
    return ul.fly(ul.Waypoints(points, SPEED_M_S, yaw="along"), rate_hz=RATE_HZ, seed=seed)[: int(seconds * RATE_HZ)]


def summary(rows: Sequence[Sequence[str]]) -> list[list[str]]:
    """Return a row for each world and kind of flight: means, the least mapped, all contacts, the least distance.

    The least shares that are mapped follow the means where there are several flights.

    Raises:
        InputError: a flight is there twice.
    """
    groups: dict[tuple[str, str], list[Sequence[str]]] = {}
    for row in rows:
        groups.setdefault((row[0].rsplit(", ", 1)[0], row[1]), []).append(row)
    for (world, kind), some in groups.items():
        if len({row[0] for row in some}) < len(some):
            raise InputError(
                f"a flight {kind!r} in {world} is there twice", where=f"{FLIGHTS}.csv", allowed="one a seed"
            )
    worlds = [*PLACES, *sorted({world for world, _ in groups} - set(PLACES))]
    keys = sorted(groups, key=lambda key: (worlds.index(key[0]), KINDS.index(key[1])))
    return [[*key, str(len(groups[key])), *_digest(sorted(groups[key]))] for key in keys]


def _digest(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the cells of a summary of some flights."""
    times, mapped, meets, errors = ([row[k].split("; ") for row in rows if row[k]] for k in range(2, 6))
    time_s, cpu = np.array(times, float).mean(0)
    shares = np.array(mapped, float)
    mean, worst = ("; ".join(f"{share:.2f}" for share in part) for part in (shares.mean(0), shares.min(0)))
    met = "-" if any(count == "-" for count, _ in meets) else f"{sum(int(count) for count, _ in meets)}"
    rms, end, lost = np.array(errors, float).mean(0) if errors else np.zeros(3)
    return [
        f"{time_s:.0f}; {cpu:.1f}", f"{mean} ({worst})" if len(rows) > 1 else mean,
        f"{met}; {min(float(gap) for _, gap in meets):.2f}", f"{rms:.2f}; {end:.2f}; {lost:.0f}" if errors else "",
    ]  # fmt: skip


def rows_of(name: str) -> list[list[str]]:
    """Return the rows of a table of results without its header; none where there is no such file."""
    file = RESULTS / f"{name}.csv"
    return [*csv.reader(line for line in file.open() if not line.startswith("# "))][1:] if file.exists() else []


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--worlds", nargs="+", default=list(PLACES))
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=["explorer", "survey", "radar poses"])
    parser.add_argument("--summary", action="store_true", help="fly nothing")
    given, rows = parser.parse_args(), rows_of(FLIGHTS)
    wanted = [(f"{world}, {seed}", kind, world, seed) for seed in given.seeds for world in given.worlds
              for kind in given.kinds]  # fmt: skip
    for name, kind, world, seed in [] if given.summary else wanted:
        if [name, kind] in [row[:2] for row in rows]:
            continue
        seconds, what = (AMPLE_S if kind.endswith(AMPLE) else given.seconds), kind.removesuffix(AMPLE)
        row = survey(world, seed, seconds) if what == "survey" else explore(world, seed, seconds, what)
        rows.append([name, kind, *row])
        print(" | ".join(rows[-1]), flush=True)
        save(FLIGHTS, [HEADER, *rows], COMMAND, earlier=True)
    save(NAME, [SUMMARY, *summary(rows)], COMMAND, earlier=True)


if __name__ == "__main__":
    main()
