"""A flight in closed loop: vehicle, radars, obstacle distances and guard step together, frame by frame."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ullage.arrays import Floats
from ullage.config import Scenario, SensingSpec
from ullage.data import Frames, Trajectory, strung
from ullage.errors import InputError, UllageWarning
from ullage.experiments.radar_poses import LivePoses
from ullage.flight.live import Steered, Wish
from ullage.flight.navigation import navigate
from ullage.flight.vehicle import check_clear
from ullage.ports.received import ReceivedRadars
from ullage.ports.vehicle import LiveVehicle
from ullage.processing.guard import Guard, Limit, State
from ullage.processing.obstacles import ObstacleSectors, ObstacleStage
from ullage.radar.receiving import Receiving
from ullage.radar.worker_pool import cores
from ullage.specs import Rig
from ullage.world.scene import Scene

Progress = Callable[[float], None]
Receive = Callable[[dict[str, Frames]], Mapping[str, Frames]]
Believe = Callable[[Trajectory, Mapping[str, Frames]], Trajectory]
"""Believed pose of a step from its true one, of which a simulated IMU is made, and from its frames without poses.

An attribute `lost`, where there is one, says why the latest pose is not to be trusted; it is empty otherwise.
"""

_ARRIVED_M = 0.12
_PULL_S, _ACCELERATION_M_S2 = 1.0, 0.8  # towards the straight line between waypoints [1/s]; before the last one


class WaypointFollower:
    """Wanted velocities along straight lines between waypoints.

    Args:
        points: x, y, z [m] and, if given, yaw [deg] (n, 3 or 4).
        speed_m_s: on the lines [m/s].
    """

    def __init__(self, points: Floats, speed_m_s: float) -> None:
        self._points, self._speed, self._next = points, speed_m_s, min(1, len(points) - 1)
        self.arrived, self.landing, self.landed = False, False, False

    @property
    def ahead(self) -> Floats:
        """Waypoints that are left (n, 3 or 4)."""
        return self._points[self._next :]

    @property
    def heading_rad(self) -> float:
        """Heading wanted now [rad]."""
        if self._points.shape[1] > 3:
            return math.radians(float(self._points[self._next, 3]))
        east, north = (self._points[self._next] - self._points[self._next - 1])[:2]
        return math.atan2(north, east)

    def velocity(self, position: Floats) -> Floats:
        """Velocity (3) wanted at a believed position (3) [m/s]."""
        goal, start = self._points[self._next, :3], self._points[max(self._next - 1, 0), :3]
        left = goal - position
        last = self._next == len(self._points) - 1
        if float(np.linalg.norm(left)) < _ARRIVED_M or (not last and float(left @ (goal - start)) < 0):
            self.arrived = self.arrived or last
            self._next += not last
            goal, start = self._points[self._next, :3], self._points[max(self._next - 1, 0), :3]
            left = goal - position
        line = (goal - start) / max(float(np.linalg.norm(goal - start)), 1e-9)
        ahead = float(left @ line)
        if last:
            speed = min(self._speed, math.sqrt(2 * _ACCELERATION_M_S2 * abs(ahead))) * math.copysign(1.0, ahead)
            speed = min(max(speed, -abs(ahead) * 2), abs(ahead) * 2)
        else:
            speed = self._speed
        aside = _PULL_S * (left - ahead * line)
        size = float(np.linalg.norm(aside))
        return np.asarray(speed * line + aside * min(1.0, 0.5 * self._speed / max(size, 1e-9)))


class Pilot(Protocol):
    """Decides where to fly."""

    @property
    def heading_rad(self) -> float:
        """Heading wanted now [rad]."""

    @property
    def landing(self) -> bool:
        """Whether it sinks to the ground: the guard then watches but limits nothing."""

    @property
    def landed(self) -> bool:
        """Whether it is on the ground."""

    def velocity(self, position: Floats) -> Floats:
        """Velocity (3) wanted at a believed position (3) [m/s]."""


class SimulatedRadars:
    """Radars that are simulated at each pose, each in a thread of its own."""

    def __init__(self, scene: Scene, rig: Rig, sensing: SensingSpec, seed: int) -> None:
        self._work = Receiving(scene, rig, fidelity=sensing.fidelity, max_bounces=sensing.max_bounces, seed=seed)
        self.sensors, self._pool = self._work.sensors, ThreadPoolExecutor(cores())

    def receive(self, body: Trajectory, number: int) -> dict[str, Frames]:
        """Return one frame of each radar, at the pose."""
        work = self._work
        jobs = {name: self._pool.submit(work.samples, name, body, first_frame=number) for name in work.sensors}
        return {name: work.frames(name, job.result(), body) for name, job in jobs.items()}

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown()


Vehicle = Steered | LiveVehicle
"""A multirotor that flies as it is asked to: the simulated one, or an aircraft behind a port."""
Radars = SimulatedRadars | ReceivedRadars
"""Radars on one body: simulated, or real ones."""


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One step of the loop, after the guard has decided."""

    t_ns: int
    sectors: ObstacleSectors
    wanted: Floats  # (3) world [m/s]
    limit: Limit


@dataclass(frozen=True, slots=True, eq=False)
class Flown:
    """All of one step: poses of one moment, the frames received there, and the guard's decision."""

    truth: Trajectory
    believed: Trajectory
    frames: dict[str, Frames]
    step: Step
    lost: str = ""  # why the believed pose is not to be trusted


@dataclass(slots=True, eq=False)
class GuardedFlight:
    """Result of a flight in closed loop."""

    flown: Trajectory  # body, true, one sample a frame
    believed: Trajectory
    frames: list[dict[str, Frames]]
    steps: list[Step]
    contacts: tuple[tuple[float, str, float], ...]  # time [s], object, speed [m/s]
    arrived: bool

    def share(self, state: State) -> float:
        """Share of the steps in a state of the guard, 0 to 1."""
        return float(np.mean([step.limit.state == state for step in self.steps]))


def warn_of(flight: GuardedFlight) -> None:
    """Warn of contacts, and of a flight that the guard ended before its last waypoint."""
    if flight.contacts:
        t_s, name, speed = flight.contacts[0]
        warnings.warn(f"the vehicle hit {name!r} at t = {t_s:.2f} s, {speed:.2f} m/s", UllageWarning, stacklevel=2)
    last = flight.steps[-1].limit
    if not flight.arrived and last.state in ("stop", "back_off"):
        why = f"{last.free_m:.2f} m left before {last.sensor!r}" if math.isfinite(last.free_m) else last.sensor
        text = f"the guard ended the flight at t = {flight.steps[-1].t_ns * 1e-9:.1f} s: {why or 'no radar covers it'}"
        warnings.warn(text + _folds(flight), UllageWarning, stacklevel=2)


def _folds(flight: GuardedFlight) -> str:
    """Advise a change if the world is longer than the radars' unambiguous range; else return nothing."""
    some = next(iter(flight.frames[-1].values()), None)
    if some is None or some.simulated is None:
        return ""
    longest_m, fold_m = float(np.ptp(some.simulated.scene.bounds, axis=0).max()), some.spec.unambiguous_range_m
    if longest_m <= fold_m:
        return ""
    return (
        f"; this world is {longest_m:.0f} m long, and what lies beyond {fold_m:.1f} m appears {fold_m:.1f} m nearer"
        " (a larger sensing.changes.prf_div avoids that)"
    )


@dataclass(slots=True)
class Loop:
    """The parts of a flight in closed loop.

    Args:
        scenario: flight, navigation, radars and seed.
        scene: the world.
        rig: the radars.
        rate_hz: steps a second: frames of every radar, and decisions.
        receive: what reaches the stage of the frames, to try faults of sensors; None: all.
        stage: gives the obstacle distances.
        guarded: False: the guard watches but limits nothing, for comparison.
        yields: where the guard limits the wanted velocity, one turned aside is wanted if it gets on faster, and a
            stopped vehicle does not wait for more room.
        poses: gives the believed poses; None: the scenario's navigation or odometry.
        vehicle: that flies; None: the scenario's, simulated.
        radars: on it; None: simulated at its poses.
    """

    scenario: Scenario
    scene: Scene
    rig: Rig
    rate_hz: float
    receive: Receive | None = None
    stage: ObstacleStage | None = None
    guarded: bool = True
    yields: bool = False
    poses: Believe | None = None
    vehicle: Vehicle | None = None
    radars: Radars | None = None
    contacts: tuple[tuple[float, str, float], ...] = ()  # of the latest flight: time [s], object, speed [m/s]

    def fly(self, points: Floats, *, progress: Progress | None = None) -> GuardedFlight:
        """Fly until the last waypoint is reached and hovered at, or the guard has stopped the flight for good.

        Args:
            points: waypoints (n, 3 or 4).
            progress: called with the fraction of the longest possible flight, 0 to 1.

        Raises:
            InputError: the start is in or too near to something, there is one waypoint only, or a frame takes longer
                than the guard's latency.
        """
        plan, give_up_s = self.scenario.flight, self.scenario.flight.guard.give_up_s
        if len(points) < 2:
            raise InputError("one waypoint", where="flight.waypoints", allowed="two or more with flight.guard.on")
        straight_s = float(np.linalg.norm(np.diff(points[:, :3], axis=0), axis=1).sum()) / plan.speed_m_s
        longest_s = 2 * straight_s + 5.0 + plan.hover_s + give_up_s  # with time for starts and stops
        follower = WaypointFollower(points, plan.speed_m_s)
        out, moved_s, arrived_s = list[Flown](), 0.0, math.inf
        for row, now in enumerate(self.steps(follower, _start(points), longest_s=longest_s)):
            out.append(now)
            now_s = now.step.t_ns * 1e-9
            moved_s = now_s if now.step.limit.state in ("free", "limited") or not self.guarded else moved_s
            arrived_s = min(arrived_s, now_s) if follower.arrived else math.inf
            if now_s - moved_s > give_up_s or now_s - arrived_s > plan.hover_s:
                break
            if progress is not None and row % 20 == 0:
                progress(row / (longest_s * self.rate_hz))
        frames, steps = [now.frames for now in out], [now.step for now in out]
        flown, believed = strung([now.truth for now in out]), strung([now.believed for now in out])
        return GuardedFlight(flown, believed, frames, steps, self.contacts, follower.arrived)

    def steps(self, pilot: Pilot, start: Floats, *, longest_s: float) -> Generator[Flown, None, None]:
        """Fly step by step: the pilot's velocity, limited by the guard, holds until the next step.

        Args:
            pilot: asked at each step.
            start: x, y, z [m], yaw [deg].
            longest_s: the flight ends after so long [s].

        Raises:
            InputError: the start is in or too near to something, or a frame takes longer than the guard's latency.
        """
        plan, guard_spec = self.scenario.flight, self.scenario.flight.guard
        if self.poses is None and plan.poses == "radar":
            self.poses = LivePoses(self.scenario.seed, plan.imu)
        if 1 / self.rate_hz > guard_spec.latency_s:
            what = f"{self.rate_hz:g} frames a second and a latency of {guard_spec.latency_s:g} s"
            least = f">= one frame, {1 / self.rate_hz:.3g} s"
            raise InputError(what, where="flight.guard.latency_s", allowed=least)
        vehicle = self.vehicle or self._simulated(start, longest_s)
        try:
            yield from self._steps(pilot, vehicle, longest_s)
        finally:
            vehicle.release(landed=pilot.landed)

    def _simulated(self, start: Floats, longest_s: float) -> Vehicle:
        """Put the scenario's vehicle into the air."""
        plan = self.scenario.flight
        check_clear(start, plan.vehicle, self.scene)
        return Steered(plan.vehicle, scene=self.scene, start=start, wind_m_s=plan.wind_m_s, gust_m_s=plan.gust_m_s,
                       seed=self.scenario.seed, moving_s=longest_s)  # fmt: skip

    def _steps(self, pilot: Pilot, vehicle: Vehicle, longest_s: float) -> Iterator[Flown]:
        guard_spec, rate_hz, row = self.scenario.flight.guard, self.rate_hz, 0
        radars = self.radars or SimulatedRadars(self.scene, self.rig, self.scenario.sensing, self.scenario.seed)
        stage = self.stage or ObstacleStage(radars.sensors, stale_s=guard_spec.stale_s)
        spec = guard_spec.but(release_m=0.0) if self.yields else guard_spec
        guard, before = Guard(spec, hull_m=vehicle.hull_m), list[Trajectory]()
        with closing(radars):
            while row < round(longest_s * rate_hz):
                if (truth := vehicle.fly_to(round(row * 1e9 / rate_hz))) is None:
                    return
                self.contacts = tuple(
                    (step * 0.004, self.scene.objects[owner].name, speed) for step, owner, speed in vehicle.contacts
                )
                received = radars.receive(truth, row)
                believed = self._believed(truth, received)
                chunk = {name: _placed(part, [*before, believed]) for name, part in received.items()}
                before = [believed]
                sectors = self._sectors(stage, chunk, int(truth.t_ns[0]))
                wanted = pilot.velocity(believed.position[0])
                if self.yields and not pilot.landing:
                    wanted = guard.around(wanted, sectors, believed)
                limit = guard.limit(wanted, sectors, believed)
                allowed = limit.velocity if self.guarded and not pilot.landing else wanted
                vehicle.ask(_wish(allowed, pilot.heading_rad, believed))
                step = Step(int(truth.t_ns[0]), sectors, wanted, limit)
                yield Flown(truth, believed, chunk, step, getattr(self.poses, "lost", ""))
                row = max(row, math.floor(truth.t_ns[0] * 1e-9 * rate_hz + 1e-6)) + 1  # an aircraft does not wait

    def _believed(self, truth: Trajectory, frames: dict[str, Frames]) -> Trajectory:
        nav = self.scenario.navigation
        if self.poses is not None:
            return self.poses(truth, {k: replace(f, poses=None, truth=None, simulated=None) for k, f in frames.items()})
        return navigate(truth, noise_m=nav.noise_m, drift_m=nav.drift_m, yaw_deg=nav.yaw_deg, seed=self.scenario.seed)

    def _sectors(self, stage: ObstacleStage, chunk: dict[str, Frames], t_ns: int) -> ObstacleSectors:
        """Return the obstacles after these frames; the stage never gets the truth."""
        known = {name: replace(part, truth=None, simulated=None) for name, part in chunk.items()}
        heard = self.receive(known) if self.receive is not None else known
        return list(stage.update(heard))[-1] if heard else stage.sectors(t_ns)


def _start(points: Floats) -> Floats:
    if points.shape[1] > 3:
        return np.asarray(points[0], float)
    ahead = points[min(1, len(points) - 1)] - points[0]
    return np.append(points[0], math.degrees(math.atan2(ahead[1], ahead[0])))


def _placed(part: Frames, path: list[Trajectory]) -> Frames:
    """Put frames on the last two believed poses of the body."""
    now = path[-1]
    body = now if np.array_equal(part.t_ns, now.t_ns) else strung(path).at(part.t_ns)
    return replace(part, poses=body.mounted(part.spec.mount.body_from_sensor()))


def _wish(velocity: Floats, heading_rad: float, believed: Trajectory) -> Wish:
    """Convert a velocity in the world to a request in the horizontal frame of the estimated heading."""
    x, y, z, w = believed.quat_xyzw[0]
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    forward = math.cos(yaw) * velocity[0] + math.sin(yaw) * velocity[1]
    left = -math.sin(yaw) * velocity[0] + math.cos(yaw) * velocity[1]
    return Wish(velocity_m_s=(forward, left), climb_m_s=float(velocity[2]), heading_rad=heading_rad)
