"""A vehicle that explores a world by its radars: the loop of vehicle, radars and guard, the mapper, and a view planner.

The planner gets poses, the map and the guard's distances, never the world. The box of the world bounds the map, as the
fence that a person draws around a flight.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np

from ullage import checks
from ullage.arrays import Floats
from ullage.config import Scenario
from ullage.data import Frames, Trajectory, gathered, strung
from ullage.errors import InputError
from ullage.experiments.explorer import LATE_S, Explorer
from ullage.experiments.guarded_flight import Believe, Loop
from ullage.experiments.simulated import radars_and_world, waypoints_of
from ullage.flight.airframe import airframe
from ullage.flight.vehicle import check_clear
from ullage.flow import Sink
from ullage.geometry import quat_rpy, rpy_quat
from ullage.grids import OccupancyMap
from ullage.pipeline import LOGGER
from ullage.ports.protocol import Passing
from ullage.ports.received import ReceivedRadars
from ullage.ports.vehicle import LiveVehicle, open_vehicle
from ullage.specs import Rig
from ullage.world.raycast import Raycaster
from ullage.world.scene import Scene

PIECE_S = 0.5
"""Between two maps, and so between two decisions."""
MOST_HZ = 20.0  # steps of a flight with real radars


class Exploration:
    """A flight that explores, as a source of frames; as a sink it takes the maps that its pilot decides by.

    Args:
        loop: vehicle, radars and guard.
        start: x, y, z [m], yaw [deg].
        time_s: of the flight, with the way home.
        report_progress: called with what the vehicle is doing, in words.
    """

    piece_s = PIECE_S
    """Length of its pieces."""

    def __init__(
        self, loop: Loop, start: Floats, *, time_s: float, report_progress: Callable[[str], None] | None = None
    ) -> None:
        plan = loop.scenario.flight
        self.loop, self.start, self.report_progress = loop, start, report_progress
        loop.yields = True
        hull_m = airframe(plan.vehicle).radius_m if loop.vehicle is None else loop.vehicle.hull_m
        clearance_m = hull_m + plan.guard.margin_m
        self.pilot = Explorer(start, time_s=time_s, speed_m_s=plan.speed_m_s, clearance_m=clearance_m,
                              drop_m=_height_over_ground(loop.scene, start),
                              free_probability=plan.free_probability, free_start_m=plan.free_start_m)  # fmt: skip
        self.maps = MapFeed(self.pilot)
        self._flown: list[Trajectory] = []
        self._believed: list[Trajectory] = []
        self._stopping = False
        self.states: list[str] = []  # of the guard

    def stream(self) -> Iterator[dict[str, Frames]]:
        """Give the frames of each radar, piece by piece, until the flight has ended."""
        held: list[dict[str, Frames]] = []
        count, most = 0, max(round(self.piece_s * self.loop.rate_hz), 1)
        with closing(self.loop.steps(self.pilot, self.start, longest_s=self.pilot.time_s + 2 * LATE_S)) as steps:
            for now in steps:
                self._flown.append(now.truth)
                self._believed.append(now.believed)
                self.states.append(now.step.limit.state)
                count += 1
                if not now.lost:  # else they would spoil the map
                    held.append(now.frames)
                self.pilot.update(now.believed, lost=now.lost)
                if count % most == 0:
                    yield gathered(held)
                    held = []
                    if self.report_progress is not None:
                        self.report_progress(f"{self.maps.words}; {self.pilot.words}")
                if self.pilot.ended or self._stopping:
                    break
        if held:
            yield gathered(held)
        if self.loop.vehicle is not None and self.loop.vehicle.ended and not self.pilot.ended:
            self.pilot.stop(self.loop.vehicle.ended)

    @property
    def first(self) -> Trajectory:
        """Its start, as a path of one pose."""
        quat = rpy_quat(0.0, 0.0, np.radians(self.start[3:]))
        return Trajectory(np.zeros(1, np.int64), self.start[None, :3], quat)

    @property
    def clearance_m(self) -> float:
        """Least distance of planned paths from the vehicle's centre to what is not known to be free [m]."""
        return self.pilot.clearance_m

    def summary(self) -> str:
        """Return how the flight ended and where it would go on, in one sentence."""
        ended, onward = self.pilot.ended or "by hand", self.pilot.upcoming
        if onward is None:
            return f"The flight ended {ended}."
        x, y = onward.goal
        return f"The flight ended {ended}. Next it would fly to ({x:.1f}, {y:.1f}) m, to learn {onward.gain_m2:.1f} m2."

    @property
    def flown(self) -> Trajectory:
        """True path of the body so far."""
        return strung(self._flown)

    @property
    def aloft(self) -> Trajectory:
        """The same before it lands."""
        flown, end_s = self.flown, self.pilot.landing_from_s
        return flown if end_s is None else flown[flown.t_ns <= end_s * 1e9]

    @property
    def contacts(self) -> tuple[tuple[float, str, float], ...]:
        """Time [s], object, speed [m/s] of each contact before it lands: from then on the ground is touched."""
        end_s = self.pilot.landing_from_s
        return tuple(one for one in self.loop.contacts if end_s is None or one[0] < end_s)

    @property
    def believed(self) -> Trajectory:
        """The same as navigation has it."""
        return strung(self._believed)


class LiveExploration(Exploration):
    """The same by an aircraft, in this machine's time: no map holds up the loop, which `stop` ends."""

    piece_s = 0.0  # each step at once: an autopilot may get the distances

    def __init__(self, loop: Loop, start: Floats, aircraft: LiveVehicle, *, time_s: float) -> None:
        loop.vehicle, self._aircraft = aircraft, aircraft
        super().__init__(loop, start, time_s=time_s)
        self.passing = Passing()  # by this `run` knows a live source

    def summary(self) -> str:
        """Return how the flight ended, where it would go on, and who flew."""
        return f"{super().summary()} {self._aircraft.words}"

    def stop(self) -> None:
        """End the flight at the next step: the aircraft hovers."""
        self._stopping = True

    def close(self) -> None:
        """Leave the aircraft hovering, also where the flight has not begun."""
        self._aircraft.release(landed=False)


def prepare(
    scenario: Scenario, *, time_s: float, height_m: float | None = None, scene: Scene | None = None,
    poses: Believe | None = None, vehicle: str | None = None, report_progress: Callable[[str], None] | None = None,
    log: Callable[[str], None] = LOGGER.info,
) -> Exploration:  # fmt: skip
    """Get an exploring flight ready in the world of a scenario, from its first waypoint on.

    Args:
        scenario: world, radars, vehicle, guard and speed.
        time_s: of the flight, with the way home [s].
        height_m: of the flight, over the world's zero [m]; None: that of the first waypoint.
        scene: its world, if it is loaded already.
        poses: gives the believed poses; None: the scenario's navigation, which is exact by default.
        vehicle: live port of an aircraft that hovers, whose place is the start; None: the scenario's, simulated.
        report_progress: called with what the vehicle is doing, in words.
        log: called with a change of the radars.

    Raises:
        InputError: the world, the start or the radars cannot be used, or a number is out of bounds.
    """
    checks.number("time_s", time_s, "explore", above=0.0, allowed="> 0")
    rig, scene = radars_and_world(scenario, scene)
    if longer := _without_folds(scenario, rig, scene):
        scenario = scenario.but(sensing=scenario.sensing.but(changes=scenario.sensing.changes | longer))
        rig, scene = radars_and_world(scenario, scene)
        log(f"the world is longer than the radars' unambiguous range, so they take {longer}")
    rate_hz = scenario.sensing.rate_hz or next(iter(rig.sensors.values())).fps
    loop = Loop(scenario, scene, rig, rate_hz, poses=poses)
    if vehicle is not None:
        return _on_aircraft(vehicle, loop, time_s, height_m=height_m, report_progress=report_progress, log=log)
    first = np.array(waypoints_of(scenario.flight, scenario.world, scene)[0], float)
    start = np.append(first, np.zeros(4 - len(first)))
    if height_m is not None:
        start[2] = checks.number("height_m", height_m, "explore")
    check_clear(start, scenario.flight.vehicle, scene)
    return Exploration(loop, start, time_s=time_s, report_progress=report_progress)


def _on_aircraft(
    target: str, loop: Loop, time_s: float, *, height_m: float | None,
    report_progress: Callable[[str], None] | None, log: Callable[[str], None],
) -> Exploration:  # fmt: skip
    """Wait until an aircraft hovers and follows; it explores from there, at its height."""
    plan = loop.scenario.flight
    if height_m is not None or plan.poses == "radar" or loop.poses is not None:
        what = "a height" if height_m is not None else "poses by radar"
        raise InputError(f"an aircraft with {what} of its own", where="explore", allowed="its reported poses")
    aircraft = open_vehicle(target, hold_s=plan.guard.latency_s, log=log)
    try:
        pose = aircraft.wait()
        start = np.array([*pose.position[0], math.degrees(quat_rpy(pose.quat_xyzw[0])[2])])
        check_clear(start, plan.vehicle, loop.scene)
        if aircraft.options.radars:
            loop.radars = ReceivedRadars(aircraft.options.radars, lambda: aircraft.epoch_ns)
            loop.rate_hz = min(max(spec.fps for spec in loop.radars.sensors.values()), MOST_HZ)
        flight = LiveExploration(loop, start, aircraft, time_s=time_s)
    except BaseException:
        aircraft.release(landed=False)
        raise
    flight.report_progress = report_progress
    return flight


def _without_folds(scenario: Scenario, rig: Rig, scene: Scene) -> dict[str, int]:
    """Return changes of the radars in whose pulse interval the world fits; none where it does, or they are set."""
    longest_m = float(np.ptp(scene.bounds, axis=0).max())
    some = next(iter(rig.sensors.values()))
    times = 1 << max(math.ceil(math.log2(longest_m / some.unambiguous_range_m)), 0)
    if times == 1 or scenario.sensing.is_declared or {"prf_div", "stagger_div"} & scenario.sensing.changes.keys():
        return {}
    return {"prf_div": some.prf_div * times, "iterations": max(some.iterations // times, 1)}


@dataclass(slots=True)
class MapFeed(Sink):
    """Sink that hands each new map to the pilot."""

    pilot: Explorer
    words: str = "no map yet"

    def write(self, item: Any) -> None:
        """Take a map; everything else passes by."""
        if isinstance(item, OccupancyMap):
            self.pilot.take_map(item)
            area = item.grid.step_m**2
            self.words = (
                f"{item.free.sum() * area:.0f} m2 free, {item.occupied.sum() * item.grid.step_m:.0f} m of surface"
            )


def _height_over_ground(scene: Scene, start: Floats) -> float | None:
    """Return the height [m] of the start over what is below it; None: nothing is."""
    away_m = float(Raycaster(scene).distances(start[None, :3], np.array([[0.0, 0.0, -1.0]]))[0])
    return away_m if math.isfinite(away_m) else None
