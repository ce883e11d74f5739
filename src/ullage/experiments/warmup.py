"""Compiles the kernels a run needs, once after installation, on a world of two triangles."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ullage import kernels
from ullage.config import Fidelity, MapMethod, Scenario

if TYPE_CHECKING:
    from ullage.data import Frames
    from ullage.world.scene import Scene

FOLDER = Path(kernels.__path__[0])
NEEDED = {
    "hector": ("flight", "proximity"),
    "thesis": ("rays", "receiver"),
    "physical": ("pulse", "edges", "rims", "rays", "receiver"),
    "rough": ("grit",),
    "bounces": ("beams", "bounces"),
    "shapes": ("facets", "wires"),
    "conductors": ("lines", "fringe", "double_fringe"),
    "elfes": ("elfes",),
    "ullage": ("occupancy", "occupancy_cone", "occupancy_listen", "occupancy_reach", "occupancy_show"),
    "backprojection": ("backprojection",),
}
"""Kernel modules behind each part of a run."""


def parts_of(scenario: Scenario, scene: Scene | None = None) -> tuple[str, ...]:
    """The parts of `NEEDED` that a scenario runs.

    Args:
        scenario: what is to be run.
        scene: its world, for what the physical radar needs there; None: whatever there may be.
    """
    parts = [scenario.flight.vehicle, *radar_parts(scenario.sensing.fidelity, scenario.sensing.max_bounces, scene)]
    parts += [scenario.map.method] if "map" in scenario.do else []
    parts += [scenario.image.method] if "image" in scenario.do else []
    return tuple(part for part in parts if part in NEEDED)


def radar_parts(fidelity: str, max_bounces: int = 3, scene: Scene | None = None) -> tuple[str, ...]:
    """The parts of `NEEDED` behind a radar, in a world where that is known."""
    if fidelity != "physical":
        return (fidelity,)
    there = {"rough": True, "bounces": max_bounces > 1, "shapes": True, "conductors": True}
    if scene is not None:
        from ullage.radar.prepared import prepare

        made = prepare(scene)
        there["rough"] = any(material.roughness_m > 0 for material in made.materials)
        there["shapes"] = bool(len(made.still.corners) or made.moving.any() or len(scene.wires))
        there["conductors"] = bool(len(made.edges.edges) or made.moving.any())
    return (fidelity, *(part for part, needed in there.items() if needed))


def compiled(parts: Iterable[str] = tuple(NEEDED)) -> bool:
    """Whether every kernel module behind these parts has a compiled copy newer than its source."""
    return all(kernels.compiled(stem) for part in parts for stem in NEEDED[part])


def compile_kernels(parts: Iterable[str] = tuple(NEEDED), *, tell: Callable[[str], None] | None = None) -> None:
    """Run these parts once, very small; half of the work in a process of its own where there are two cores.

    Args:
        parts: keys of `NEEDED`.
        tell: called with what is being compiled.
    """
    wanted = set(parts)
    mine, others = _shared([job for job in JOBS if job.part in wanted])
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if cores < 2 or len(others) == 0:
        mine, others = mine + others, []
    names = [job.name for job in others]
    beside = subprocess.Popen([sys.executable, "-m", __name__, *names]) if others else None
    try:
        for job in mine:
            if tell is not None:
                tell(", ".join([job.name, *(names if beside is not None and beside.poll() is None else [])]))
            job.run()
        if beside is not None:
            if tell is not None:
                tell(", ".join(names))
            beside.wait()
    finally:
        if beside is not None and beside.poll() is None:
            beside.terminate()
    for job in others:
        job.run()  # from the cache; and should the other process have failed


@dataclass(frozen=True, slots=True)
class Job:
    """Something small to run, that compiles some kernels."""

    name: str
    part: str
    seconds: float  # CPU time it takes, about
    run: Callable[[], None]
    along: str = ""  # the job whose kernels it needs too, so that both belong in one process


def _shared(jobs: list[Job]) -> tuple[list[Job], list[Job]]:
    """Two shares of about the same time."""
    groups: dict[str, list[Job]] = {}
    for job in jobs:
        groups.setdefault(job.along or job.name, []).append(job)
    shares: tuple[list[Job], list[Job]] = ([], [])
    for group in sorted(groups.values(), key=_seconds, reverse=True):
        min(shares, key=_seconds).extend(group)
    return shares


def _seconds(jobs: Iterable[Job]) -> float:
    return sum(job.seconds for job in jobs)


def _frames(scene: Scene, *, fidelity: Fidelity = "physical", max_bounces: int = 1) -> None:
    from ullage.data import Trajectory
    from ullage.radar.simulate import simulate_stream
    from ullage.specs import RadarSpec

    track = Trajectory.line((0, -0.1, 0), (0, 0.1, 0), 0.5, 17)
    for _ in simulate_stream(scene, track, RadarSpec.preset("x4m05"), fidelity=fidelity, max_bounces=max_bounces):
        pass


def _flight() -> None:
    from ullage.flight.missions import Waypoints
    from ullage.flight.vehicle import fly
    from ullage.world import scenes

    wall = scenes.plate(width_m=0.5, height_m=0.5, distance_m=2.0)
    fly(Waypoints(np.array([[0.0, 0, 0], [0, 0.1, 0]])), scene=wall, rate_hz=10)


def _thesis() -> None:
    from ullage.world import scenes

    _frames(scenes.plate(width_m=0.5, height_m=0.5, distance_m=2.0), fidelity="thesis")


def _walls(*, roughness_m: float = 0.0, max_bounces: int = 1) -> None:
    from ullage.world import scenes

    room = scenes.room((2, 2, 2))
    walls = tuple(replace(wall, material=wall.material.but(roughness_m=roughness_m)) for wall in room.objects)
    _frames(replace(room, objects=walls), max_bounces=max_bounces)


def _shapes() -> None:
    from ullage.world import scenes

    _frames(scenes.sphere(0.2, 2.0))
    _frames(scenes.wire(radius_m=0.001, length_m=0.5, distance_m=2.0))


def _conductors() -> None:
    from ullage.radar.fringes import lay_edges
    from ullage.radar.physical import bench, view_of
    from ullage.specs import RadarSpec
    from ullage.world import scenes

    spec = RadarSpec.preset("x4m05")
    ready = bench(scenes.plate(width_m=0.5, height_m=0.5, distance_m=2.0, material="pec"), spec)
    grids = np.zeros((3, ready.places), complex)
    lay_edges(ready, ready.world.parts(), view_of(spec, np.zeros(3), np.eye(3)), None, grids)


def _map(method: MapMethod) -> None:
    from ullage.grids import Grid
    from ullage.processing.occupancy import map_occupancy

    map_occupancy(_few(), Grid.covering(np.array([[-1, -1, -1], [3, 1, 1]]), 0.2), method=method)


def _image() -> None:
    from ullage.grids import Grid
    from ullage.processing.sar import focus

    focus(_few(), Grid.covering(np.array([[-1, -1, -1], [3, 1, 1]]), 0.2))


def _few() -> Frames:
    """Some frames with one echo, made by no kernel."""
    from ullage.data import Frames, Trajectory
    from ullage.specs import RadarSpec

    spec = RadarSpec.preset("x4m05")
    track = Trajectory.line((0, -0.1, 0), (0, 0.1, 0), 0.5, 17)
    samples = np.exp(-(((spec.range_m - 2.0) / 0.1) ** 2)) * np.ones((len(track), 1)) * 1e-3
    return Frames(samples.astype(np.complex64), spec.range_m, track.t_ns, spec, track, track, "radar", "path_gain")


JOBS = (
    Job("flight", "hector", 3, _flight),
    Job("rays", "thesis", 3, _thesis),
    Job("flat faces", "physical", 16, _walls),
    Job("rough faces", "rough", 5, partial(_walls, roughness_m=1e-3), "flat faces"),
    Job("bounces", "bounces", 9, partial(_walls, max_bounces=2), "flat faces"),
    Job("edges of conductors", "conductors", 12, _conductors),
    Job("curved faces and wires", "shapes", 9, _shapes),
    Job("Elfes' map", "elfes", 2, partial(_map, "elfes")),
    Job("map", "ullage", 13, partial(_map, "ullage")),
    Job("images", "backprojection", 2, _image),
)

if __name__ == "__main__":
    for name in sys.argv[1:]:
        next(job for job in JOBS if job.name == name).run()
