"""A scenario as a source: the world is loaded and the flight flown at once, the echoes come piece by piece."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from ullage.config import FlightSpec, Scenario, WorldSpec
from ullage.data import Frames, Trajectory, even_times, gathered, strung
from ullage.errors import InputError
from ullage.experiments.radar_poses import RadarPoses, of_flight
from ullage.flight.missions import Waypoints, erratic
from ullage.flight.navigation import navigate
from ullage.flight.tour import tour
from ullage.flight.vehicle import fly
from ullage.geometry import rpy_quat
from ullage.radar.simulate import simulate_stream
from ullage.specs import Rig
from ullage.world.library import WORLDS
from ullage.world.load import load_scene
from ullage.world.scene import Scene

Progress = Callable[[float], None]
PIECE = 64
"""Frames of a sensor in one piece."""
WATCHED_S = 0.5
"""Longest piece of a flight that somebody watches, so that map and path come once a second."""


@dataclass(frozen=True, slots=True)
class Simulated:
    """World, flight and radars of a scenario."""

    scenario: Scenario
    scene: Scene
    flown: Trajectory  # body, true, one sample a frame
    believed: Trajectory
    rig: Rig
    received: tuple[dict[str, Frames], ...] = ()  # of a flight in closed loop, which needs its frames during the flight
    piece: int = PIECE  # frames of a sensor that come at once
    odometry: RadarPoses | None = None  # gives the poses that processors believe

    def stream(self) -> Iterator[dict[str, Frames]]:
        """Give the frames of each radar, chunk by chunk."""
        return self._stream() if self.odometry is None or self.received else self.odometry.placed(self._stream())

    def _stream(self) -> Iterator[dict[str, Frames]]:
        if self.received:
            for start in range(0, len(self.received), self.piece):
                yield gathered(self.received[start : start + self.piece])
            return
        sensing = self.scenario.sensing
        yield from simulate_stream(
            self.scene,
            self.flown,
            self.rig,
            fidelity=sensing.fidelity,
            max_bounces=sensing.max_bounces,
            seed=self.scenario.seed,
            believed=self.believed,
            chunk=self.piece,
        )

    def watched(self) -> Simulated:
        """Return the same in pieces of half a second."""
        rate_hz = (len(self.flown) - 1) / max((self.flown.t_ns[-1] - self.flown.t_ns[0]) * 1e-9, 1e-9)
        return replace(self, piece=min(max(int(WATCHED_S * rate_hz), 1), self.piece))


def prepare(scenario: Scenario, *, scene: Scene | None = None, progress: Progress | None = None) -> Simulated:
    """Load the world and fly the flight of a scenario.

    Args:
        scenario: the settings.
        scene: its world, if it is loaded already.
        progress: called with the share of the flight done, 0 to 1.

    Raises:
        InputError: the world, the flight or the radars cannot be used.
    """
    rig, scene = radars_and_world(scenario, scene)
    rate_hz = scenario.sensing.rate_hz or next(iter(rig.sensors.values())).fps
    if scenario.flight.guard.on:
        return _guarded(scenario, scene, rig, rate_hz=rate_hz, progress=progress)
    flown = fly_scenario(scenario, scene, rate_hz=rate_hz, progress=progress)
    nav = scenario.navigation
    believed = navigate(flown, noise_m=nav.noise_m, drift_m=nav.drift_m, yaw_deg=nav.yaw_deg, seed=scenario.seed)
    odometry = None
    if scenario.flight.poses == "radar":
        odometry = RadarPoses(flown, seed=scenario.seed, source="true flight", unit=scenario.flight.imu)
    return Simulated(scenario, scene, flown, believed, rig, odometry=odometry)


def _guarded(scenario: Scenario, scene: Scene, rig: Rig, *, rate_hz: float, progress: Progress | None) -> Simulated:
    """Fly in closed loop with the guard, which needs the echoes on the way."""
    from ullage.experiments.guarded_flight import Loop, warn_of

    points = np.array(waypoints_of(scenario.flight, scenario.world, scene))
    loop = Loop(scenario, scene, rig, rate_hz)
    flight = loop.fly(points, progress=progress)
    warn_of(flight)
    return Simulated(scenario, scene, flight.flown, flight.believed, rig, tuple(flight.frames),
                     odometry=of_flight(loop.poses, flight.flown))  # fmt: skip


def radars_and_world(scenario: Scenario, scene: Scene | None = None) -> tuple[Rig, Scene]:
    """Return a scenario's radars and its world, without the model that carries the radars.

    Args:
        scenario: the settings.
        scene: its world, if it is loaded already.

    Raises:
        InputError: the world or the file of the radars cannot be read, or declares no radars.
    """
    sensing, imu_file = scenario.sensing, scenario.flight.imu_file
    if imu_file not in ("", "simulated"):
        raise InputError(f"a simulated flight reads no {imu_file}", where="flight.imu_file", allowed="simulated")
    scene = load_world(scenario.world) if scene is None else scene
    if not sensing.is_declared:
        return sensing.radars(), scene
    if sensing.rig != "declared":
        return sensing.changed(load_scene(sensing.rig).rig()), scene
    rig = sensing.changed(scene.rig())
    return rig, scene.without(next(iter(scene.rigs or scene.ray_rigs)))


def load_world(spec: WorldSpec) -> Scene:
    """The world of a scenario.

    Raises:
        InputError: it is unknown or cannot be read.
    """
    if bool(spec.name) == bool(spec.file):
        raise InputError("a scenario wants either world.name or world.file", where="world", allowed=", ".join(WORLDS))
    if spec.file:
        return load_scene(
            spec.file, geometry=spec.geometry, search_path=spec.search_path, missing=spec.missing,
            origin_m=spec.origin_m, scale=spec.scale, smooth=spec.smooth,
        )  # fmt: skip
    if spec.name not in WORLDS:
        raise InputError(f"no world {spec.name!r}", where="world.name", allowed=", ".join(WORLDS))
    return load_scene(WORLDS[spec.name].path, geometry=spec.geometry, origin_m=spec.origin_m, smooth=spec.smooth)


def fly_scenario(scenario: Scenario, scene: Scene, *, rate_hz: float, progress: Progress | None = None) -> Trajectory:
    """The flight of a scenario, sampled at the radars' rate.

    Raises:
        InputError: there is no path, or a waypoint lies in a wall.
    """
    spec = scenario.flight
    points = np.array(waypoints_of(spec, scenario.world, scene))
    hand = {"lateral_m": spec.wander_m, "vertical_m": spec.wander_m / 2, "yaw_deg": spec.wander_deg}
    astray = any(hand.values())
    if spec.vehicle == "ideal":
        straight = ideal_path(points, spec.speed_m_s, rate_hz)
        return _hovering(erratic(straight, scenario.seed, **hand) if astray else straight, spec.hover_s, rate_hz)
    mission = Waypoints(points, speed_m_s=spec.speed_m_s)
    flown = fly(
        erratic(mission, scenario.seed, **hand) if astray else mission,
        vehicle=spec.vehicle,
        scene=scene,
        wind_m_s=spec.wind_m_s,
        gust_m_s=spec.gust_m_s,
        rate_hz=rate_hz,
        seed=scenario.seed,
        progress=progress,
    )
    return _hovering(flown, spec.hover_s, rate_hz)


def _hovering(flown: Trajectory, hover_s: float, rate_hz: float) -> Trajectory:
    """The path with its last pose kept for a time [s]."""
    if not hover_s:
        return flown
    more = even_times(rate_hz, count=max(round(hover_s * rate_hz), 1) + 1)[1:]
    still = np.zeros((len(more), 3))
    held = Trajectory(
        flown.t_ns[-1] + more, still + flown.position[-1], np.tile(flown.quat_xyzw[-1], (len(more), 1)), still, still
    )
    return strung([flown, held])


def waypoints_of(flight: FlightSpec, world: WorldSpec, scene: Scene) -> tuple[tuple[float, ...], ...]:
    """Return the flight's waypoints, those of its library world, or a tour of the world's free space.

    Raises:
        InputError: there are none, and the world has no space to fly.
    """
    if flight.waypoints:
        return flight.waypoints
    if world.name in WORLDS:
        return tuple(tuple(point) for point in WORLDS[world.name].path_xyzyaw)
    vehicle = "hector" if flight.vehicle == "ideal" else flight.vehicle
    try:
        return tuple(tuple(point) for point in tour(scene, vehicle=vehicle).points.round(2).tolist())
    except InputError as error:
        raise InputError(error.what, where=world.file or scene.name, allowed=error.allowed) from None


def ideal_path(points: np.ndarray, speed_m_s: float, rate_hz: float) -> Trajectory:
    """Straight lines at constant speed through waypoints (n, 3 or 4), yaw turning evenly between them [deg]."""
    legs = np.linalg.norm(np.diff(points[:, :3], axis=0), axis=1)
    when = np.concatenate([[0.0], np.cumsum(np.maximum(legs, 1e-9))]) / speed_m_s
    t_ns = even_times(rate_hz, t1_ns=round(when[-1] * 1e9))
    t_s = t_ns * 1e-9
    position = np.stack([np.interp(t_s, when, points[:, k]) for k in range(3)], axis=1)
    heading = np.unwrap(np.radians(points[:, 3])) if points.shape[1] > 3 else np.zeros(len(points))
    return Trajectory(t_ns, position, rpy_quat(0, 0, np.interp(t_s, when, heading)))
