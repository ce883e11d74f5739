"""Compiles the kernels a run needs, once after installation: those of flight and radar first, the map's after."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from ullage import kernels
from ullage.config import MapMethod, Scenario
from ullage.data import Frames
from ullage.processing.occupancy import BEST
from ullage.radar import warmup as radar
from ullage.radar.warmup import Compiling, Job, Log, radar_parts
from ullage.world.scene import Scene

FOLDER = Path(kernels.__path__[0])
NEEDED = {
    "hector": ("flight", "proximity"),
    **radar.NEEDED,
    "elfes": ("elfes",),
    "rules": (
        *("occupancy", "occupancy_cone", "occupancy_listen", "occupancy_reach", "occupancy_show", "occupancy_strip"),
        "rolls",
    ),
    "likelihood": ("matched_sums", "surface_cells", "silence"),
    "likelihood in volumes": ("matched_sums", "directed_sums", "volume_cells"),
    "backprojection": ("backprojection",),
}
"""Kernel modules behind each part of a run."""
LATER = ("elfes", "rules", "likelihood", "likelihood in volumes", "backprojection")
"""Parts that a run can begin without."""


def parts_of(scenario: Scenario, scene: Scene | None = None) -> tuple[str, ...]:
    """Return the parts of `NEEDED` that a scenario runs.

    Args:
        scenario: to run.
        scene: its world, to find the parts that the physical radar needs; None: all parts.
    """
    parts = [scenario.flight.vehicle, *radar_parts(scenario.sensing.fidelity, scenario.sensing.max_bounces, scene)]
    method = scenario.map.method
    method = BEST[scenario.map.dims] if method == "ullage" else method
    if method == "likelihood" and scenario.map.dims == 3:
        method = "likelihood in volumes"
    parts += [method] if "map" in scenario.do else []
    parts += [scenario.image.method] if "image" in scenario.do else []
    return tuple(part for part in parts if part in NEEDED)


def compiled(parts: Iterable[str] = tuple(NEEDED)) -> bool:
    """Whether every kernel module behind these parts has a compiled copy newer than its source."""
    return all(kernels.compiled(stem) for part in parts for stem in NEEDED[part])


def estimated_s(parts: Iterable[str]) -> float:
    """Estimate how long it takes to compile what a run of these parts cannot begin without [s]."""
    wanted = {part for part in parts if part not in LATER and not compiled((part,))}
    return radar.estimated_s([job for job in JOBS if job.part in wanted])


def begin(parts: Iterable[str], *, log: Log | None = None, work: Compiling | None = None) -> Compiling:
    """Compile what a run of these parts cannot begin without, in two processes where there are two cores.

    Args:
        parts: keys of `NEEDED`.
        log: called with the part being compiled.
        work: one whose other process has started, as `ahead` gives it.

    Returns:
        What goes on compiling; `wait_later` waits for it.
    """
    wanted = [job for job in JOBS if job.part in set(parts)]
    now, later = ([job for job in wanted if (job.part in LATER) == late] for late in (False, True))
    work = work or Compiling(module=__name__)
    work.now, work.later, work.log = now, [job for job in later if not compiled((job.part,))], log
    work.wait()
    return work


def ahead() -> Compiling:
    """Python started beside this process, to compile what will turn out to be needed; `begin` tells it."""
    work = Compiling(module=__name__)
    work.open()
    return work


def compile_kernels(parts: Iterable[str] = tuple(NEEDED), *, log: Log | None = None) -> None:
    """Compile all kernels of these parts before returning, unlike `begin`."""
    wanted = set(parts)
    Compiling([job for job in JOBS if job.part in wanted], module=__name__, log=log).wait()


def _flight() -> None:
    from ullage.flight.missions import Waypoints
    from ullage.flight.vehicle import fly
    from ullage.world import scenes

    wall = scenes.plate(width_m=0.5, height_m=0.5, distance_m=2.0)
    fly(Waypoints(np.array([[0.0, 0, 0], [0, 0.1, 0]])), scene=wall, rate_hz=10)


def _map(method: MapMethod) -> None:
    from ullage.grids import Grid
    from ullage.processing.occupancy import map_occupancy

    map_occupancy(_few(), Grid.covering(np.array([[-1, -1, -1], [3, 1, 1]]), 0.2), method=method)
    if method == "rules":
        _join_legs()


def _join_legs() -> None:
    """Run the kernels that a volume needs after several straight segments have detected a wall."""
    from ullage.processing.mapper_echoes import Traced
    from ullage.processing.mapper_legs import LEAST_ECHOES, Legs

    legs, along, abeam = Legs(), np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
    for height in (0.0, 0.5, 1.0):
        places = [np.array([0.05 * k, 0, height]) for k in range(LEAST_ECHOES)]
        echoes = [Traced(k, at, along, 2.0, 0.0, 1e-3, 0.02, 1.0) for k, at in enumerate(places)]
        legs.add(echoes, echoes, abeam, 0.5, 2.0)
    deque(legs.tell_all(), maxlen=0)


def _surfaces(dims: Literal[2, 3]) -> None:
    from ullage.grids import Grid
    from ullage.processing.likelihood.methods import likelihood_mapper

    floor_z_m = None if dims == 2 else -2.0  # a volume takes the echo for the floor's, and draws it
    mapper = likelihood_mapper(Grid.covering(np.array([[-1, -1, -1], [3, 1, 1]]), 0.2, dims=dims), floor_z_m=floor_z_m)
    mapper.update(_few(0.9))
    mapper.finish()
    mapper.map()


def _image() -> None:
    from ullage.grids import Grid
    from ullage.processing.sar import focus

    focus(_few(), Grid.covering(np.array([[-1, -1, -1], [3, 1, 1]]), 0.2))


def _few(half_m: float = 0.1) -> Frames:
    """Some frames with one echo from a line across it, made by no kernel."""
    from ullage.data import Trajectory
    from ullage.specs import RadarSpec

    spec = RadarSpec.preset("x4m05")
    track = Trajectory.line((0, -half_m, 0), (0, half_m, 0), 0.5, 17)
    samples = np.exp(-(((spec.range_m - 2.0) / 0.1) ** 2)) * np.ones((len(track), 1)) * 1e-3
    return Frames(samples.astype(np.complex64), spec.range_m, track.t_ns, spec, track, track, "radar", "path_gain")


JOBS = (
    Job("flight", "hector", 3.5, _flight),
    *radar.JOBS,
    Job("Elfes' map", "elfes", 0.8, partial(_map, "elfes")),
    Job("map", "rules", 12, partial(_map, "rules")),
    Job("map of surfaces", "likelihood", 4, partial(_surfaces, 2)),
    Job("surfaces in a volume", "likelihood in volumes", 8, partial(_surfaces, 3)),
    Job("images", "backprojection", 1, _image),
)

if __name__ == "__main__":
    radar.beside(JOBS)
