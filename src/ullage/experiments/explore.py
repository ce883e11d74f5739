"""Explore a world by radar in one call."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from ullage import checks
from ullage.config import Scenario, is_set_by, make_scenario
from ullage.data import Frames, Trajectory, gathered
from ullage.errors import InputError
from ullage.experiments.exploration import PIECE_S, prepare
from ullage.experiments.explorer import Decision
from ullage.experiments.guarded_flight import Believe
from ullage.experiments.source_resolution import flight_scenario
from ullage.flow import Sink
from ullage.grids import Grid, OccupancyMap
from ullage.pipeline import MapStage, run
from ullage.world.scene import Scene


def exploring(scenario: Scenario, options: Sequence[str] = ()) -> Scenario:
    """Return a scenario as an explorer flies it, but for what options set: physical echoes, a real vehicle, a guard."""
    flight, sensing = scenario.flight, scenario.sensing
    if not is_set_by(options, "sensing.fidelity"):
        sensing = sensing.but(fidelity="physical")
    vehicle = "hector" if flight.vehicle == "ideal" else flight.vehicle
    flight = flight.but(vehicle=vehicle, wander_m=0.0, wander_deg=0.0, guard=flight.guard.but(on=True))
    every_s = scenario.map.every_s or PIECE_S
    return scenario.but(flight=flight, sensing=sensing, map=scenario.map.but(every_s=every_s, dims=2), expect={})


@dataclass(frozen=True, slots=True, eq=False)
class Explored:
    """Result of an exploring flight."""

    map: OccupancyMap
    frames: dict[str, Frames]
    flown: Trajectory  # true path of the body
    believed: Trajectory
    decisions: tuple[Decision, ...]
    contacts: tuple[tuple[float, str, float], ...]  # time [s], object, speed [m/s]
    at_home: bool
    summary: str  # how it ended, and where it would fly next


def explore(
    world: str | Path | Scene, *, time_s: float = 120.0, height_m: float | None = None, seed: int = 7,
    options: Sequence[str] = (), poses: Literal["navigation", "radar"] | Believe = "navigation",
    vehicle: str | None = None, progress: Callable[[str], None] | None = None,
) -> Explored:  # fmt: skip
    """Explore a world by radar: fly where the map could learn most for the time, guard always on, and come home.

    Args:
        world: name of a world or scenario, a file of either, or a `Scene`.
        time_s: of the flight, with the way home [s].
        height_m: of the flight [m]; None: that of the scenario's first waypoint.
        seed: of noise and gusts.
        options: `a.b=value` over the scenario.
        poses: "navigation": that of the scenario, exact by default; "radar": odometry; or a callable that gives the
            believed pose of each step from the true one, of which a simulated IMU is made, and from the step's frames
            without poses; its attribute `lost`, if it has one, says why the latest pose is not to be trusted.
        vehicle: live port of an aircraft that hovers, such as mavlink:udpin://127.0.0.1:14540; None: simulated.
        progress: called with what the vehicle is doing, in words.

    Returns:
        The map, the frames and the flight.

    Raises:
        InputError: the world, its start or an option cannot be used.
    """
    if poses not in ("navigation", "radar") and not callable(poses):
        raise InputError(f"poses is {poses!r}", where="explore", allowed='"navigation", "radar", or a callable')
    by = [] if callable(poses) else [f"flight.poses={poses}"]
    options = [*by, *options, f"seed={checks.whole('seed', seed, 'explore', low=0)}"]
    scene = world if isinstance(world, Scene) else None
    if scene is not None:
        scenario = make_scenario({"name": "explore", "do": ["map"]}, options=options)
    else:
        scenario = flight_scenario(str(world), tasks=("map",), options=options, kind="explore")
    given = poses if callable(poses) else None
    flight = prepare(exploring(scenario, options), time_s=time_s, height_m=height_m, scene=scene, poses=given,
                     vehicle=vehicle, report_progress=progress)  # fmt: skip
    kept = _Kept()
    plan = flight.loop.scenario.map
    grid = Grid.covering(flight.loop.scene.bounds, plan.step_m, margin_m=plan.margin_m, z_m=float(flight.start[2]))
    stage = MapStage(grid, plan.method, every_s=plan.every_s or PIECE_S, live=True, floor_z_m=plan.floor_z_m,
                     vehicle_radius_m=plan.vehicle_radius_m)  # fmt: skip
    out = run(flight, stages=[stage], sinks=[flight.maps, kept])
    pilot = flight.pilot
    return Explored(out.results[-1], gathered(kept.chunks), flight.flown, flight.believed, tuple(pilot.decisions),
                    flight.contacts, pilot.at_home, flight.summary())  # fmt: skip


@dataclass(slots=True)
class _Kept(Sink):
    """Sink that keeps all frames."""

    chunks: list[dict[str, Frames]] = field(default_factory=list)

    def write(self, item: Any) -> None:
        if isinstance(item, dict):
            self.chunks.append(item)
