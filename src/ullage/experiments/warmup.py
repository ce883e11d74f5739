"""Compiles the kernels a run needs, once after installation: those of flight, radar and map."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Literal

import numpy as np

from ullage.config import Scenario
from ullage.data import Frames, Trajectory
from ullage.grids import Grid
from ullage.kernels import loops
from ullage.processing.occupancy import BEST, map_occupancy
from ullage.radar import warmup as radar
from ullage.radar.warmup import Job, Log, radar_parts
from ullage.specs import RadarSpec
from ullage.world import scenes
from ullage.world.scene import Scene


def parts_of(scenario: Scenario, scene: Scene | None = None) -> tuple[str, ...]:
    """Return the parts of `JOBS` that a scenario runs.

    Args:
        scenario: to run.
        scene: its world, to find the parts that the physical radar needs; None: all parts.
    """
    parts = [scenario.flight.vehicle, *radar_parts(scenario.sensing.fidelity, scenario.sensing.max_bounces, scene)]
    method = scenario.map.method
    method = BEST if method == "ullage" else method
    if method == "likelihood" and scenario.map.dims == 3:
        method = "likelihood in volumes"
    parts += [method] if "map" in scenario.do else []
    parts += [scenario.image.method] if "image" in scenario.do else []
    return tuple(part for part in parts if part in {job.part for job in JOBS})


def compiled(parts: Iterable[str] | None = None) -> bool:
    """Whether the kernels of these parts, or of all, are compiled from their sources as they are."""
    return loops.compiled(job.part for job in _jobs(parts))


def compile_kernels(parts: Iterable[str] | None = None, *, log: Log | None = None) -> None:
    """Compile the kernels of these parts, or of all; `log` is called with what is being compiled."""
    radar.run_jobs(_jobs(parts), module=__name__, log=log)


def _jobs(parts: Iterable[str] | None) -> list[Job]:
    wanted = None if parts is None else set(parts)
    return [job for job in JOBS if wanted is None or job.part in wanted]


def _flight() -> None:
    from ullage.flight.missions import Waypoints
    from ullage.flight.vehicle import fly

    wall = scenes.plate(width_m=0.5, height_m=0.5, distance_m=2.0)
    fly(Waypoints(np.array([[0.0, 0, 0], [0, 0.1, 0]])), scene=wall, rate_hz=10)


def _first_peaks() -> None:
    map_occupancy(_few(), Grid.covering(np.array([[-1, -1, -1], [3, 1, 1]]), 0.2), method="elfes")


def _surfaces(dims: Literal[2, 3]) -> None:
    from ullage.processing.likelihood.methods import likelihood_mapper

    floor_z_m = None if dims == 2 else -2.0  # a volume takes the echo for the floor's, and draws it
    mapper = likelihood_mapper(Grid.covering(np.array([[-1, -1, -1], [3, 1, 1]]), 0.2, dims=dims), floor_z_m=floor_z_m)
    mapper.update(_few(0.9))
    mapper.finish()
    mapper.map()


def _obstacles() -> None:
    from ullage.processing.obstacles import ObstacleStage

    list(ObstacleStage().update({"radar": _few()}))


def _image() -> None:
    from ullage.processing.sar import focus

    focus(_few(), Grid.covering(np.array([[-1, -1, -1], [3, 1, 1]]), 0.2))


def _few(half_m: float = 0.1) -> Frames:
    """Some frames with one echo from a line across it, made by no kernel."""
    spec = RadarSpec.preset("x4m05")
    track = Trajectory.line((0, -half_m, 0), (0, half_m, 0), 0.5, 17)
    samples = np.exp(-(((spec.range_m - 2.0) / 0.1) ** 2)) * np.ones((len(track), 1)) * 1e-3
    return Frames(samples.astype(np.complex64), spec.range_m, track.t_ns, spec, track, track, "radar", "path_gain")


JOBS = (
    *radar.JOBS,
    Job("elfes", _first_peaks),
    Job("obstacles", _obstacles),
    Job("backprojection", _image),
    Job("likelihood", partial(_surfaces, 2)),
    Job("likelihood in volumes", partial(_surfaces, 3)),
    Job("hector", _flight),
)

if __name__ == "__main__":
    radar.do_named_jobs(JOBS)
