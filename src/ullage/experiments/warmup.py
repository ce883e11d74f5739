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
    "physical": (
        "facets",
        "pulse",
        "edges",
        "rims",
        "lines",
        "wires",
        "fringe",
        "double_fringe",
        "grit",
        "beams",
        "bounces",
        "rays",
        "receiver",
    ),
    "elfes": ("elfes",),
    "ullage": ("occupancy", "occupancy_cone", "occupancy_listen", "occupancy_show"),
    "backprojection": ("backprojection",),
}
"""Kernel modules behind each part of a run."""


def parts_of(scenario: Scenario) -> tuple[str, ...]:
    """The parts of `NEEDED` that a scenario runs."""
    parts = [scenario.flight.vehicle, scenario.sensing.fidelity]
    parts += [scenario.map.method] if "map" in scenario.do else []
    parts += [scenario.image.method] if "image" in scenario.do else []
    return tuple(part for part in parts if part in NEEDED)


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


def _shared(jobs: list[Job]) -> tuple[list[Job], list[Job]]:
    """Two shares of about the same time."""
    shares: tuple[list[Job], list[Job]] = ([], [])
    for job in sorted(jobs, key=lambda j: -j.seconds):
        min(shares, key=lambda share: sum(j.seconds for j in share)).append(job)
    return shares


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


def _walls() -> None:
    from ullage.world import scenes

    room = scenes.room((2, 2, 2))
    rough = tuple(replace(wall, material=wall.material.but(roughness_m=1e-3)) for wall in room.objects)
    _frames(replace(room, objects=rough), max_bounces=2)


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
    lay_edges(ready, ready.world.parts(0), view_of(spec, np.zeros(3), np.eye(3)), 0, grids)


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
    Job("flat faces and bounces", "physical", 16, _walls),
    Job("edges of conductors", "physical", 12, _conductors),
    Job("curved faces and wires", "physical", 9, _shapes),
    Job("Elfes' map", "elfes", 2, partial(_map, "elfes")),
    Job("map", "ullage", 10, partial(_map, "ullage")),
    Job("images", "backprojection", 2, _image),
)

if __name__ == "__main__":
    for name in sys.argv[1:]:
        next(job for job in JOBS if job.name == name).run()
