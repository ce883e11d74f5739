"""Fly the simulated multirotor by hand: receive commands, give frames and the readings of its other sensors."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import numpy as np
from pydantic import Field

from ullage.arrays import Floats
from ullage.data import Frames, Trajectory
from ullage.errors import InputError
from ullage.flight.airframe import GRAVITY_M_S2
from ullage.flight.live import Steered, Wish
from ullage.flight.pilot import Pilot, PilotOptions
from ullage.flight.vehicle import check_clear
from ullage.geometry import quat_matrix
from ullage.ports import encode
from ullage.ports import schema as ros
from ullage.ports.conversions import BODY
from ullage.ports.cosimulation import BEHIND_S, UnboundedSource
from ullage.ports.imu import ImuNoise
from ullage.ports.intake import PIECE_S, Counters, Inbox, LiveOptions, Log
from ullage.ports.protocol import Passed, Passing
from ullage.ports.radar_status import RadarStatus
from ullage.specs import Rig
from ullage.world.raycast import Raycaster
from ullage.world.scene import Scene

IMU_TOPIC, SONAR_TOPIC = "raw_imu", "sonar_height"
"""Names of the Hector quadrotor's topics."""
SONAR_M, SONAR_FOV_RAD, SONAR_HZ = (0.03, 3.0), math.radians(40), 10.0
"""Limits, opening and rate of the sonar of [HectorQuadrotor]."""
BATCH_S = 0.05
"""Poses are gathered for so long before the radars are simulated along them."""
STEP_S = 0.01


class FlyOptions(PilotOptions, LiveOptions):
    """Settings of a flight by hand."""

    fly: str = Field("", description="library world or file to fly in")
    vehicle: str = Field("hector", description="the multirotor")
    start: str = Field("", description="x,y,z [m] and, if given, yaw [deg]; none: the library world's own")
    rig: str = Field(
        "", description="rig preset, or SDF/URDF file with radars; none: as the world declares, or thesis-4"
    )
    fidelity: str = Field("physical", pattern="^(physical|thesis)$", description="physical or thesis")
    max_bounces: int = Field(1, ge=1, le=3)
    seed: int = Field(0, ge=0)
    rate_hz: float | None = Field(None, gt=0, le=10_000, description="frames a second; none: each radar's own")
    state_hz: float = Field(50.0, ge=10, le=250, description="poses and IMU readings a second")
    imu_noise: bool = Field(True, description="white noise of an MPU-6000 on turn rate and acceleration")
    pace: float = Field(1.0, gt=0, le=10, description="times real time")
    duration_s: float | None = Field(None, gt=0, description="ends after so long a flight")

    def place(self) -> tuple[float, ...] | None:
        """Return the start of the flight; None: not given.

        Raises:
            InputError: it is not three or four finite numbers.
        """
        if not self.start:
            return None
        try:
            numbers = tuple(float(part) for part in self.start.split(","))
        except ValueError:
            numbers = ()
        if len(numbers) not in (3, 4) or not all(map(math.isfinite, numbers)):
            raise InputError(
                f"start is {self.start!r}", where="fly", allowed="X,Y,Z or X,Y,Z,YAW in metres and degrees"
            )
        return numbers


class Controls(Protocol):
    """Source of commands: a keyboard or topics."""

    counters: Counters  # of what could not be used

    def update(self, pilot: Pilot, now_s: float) -> None:
        """Pass all commands since the last call to the pilot."""

    def close(self) -> None:
        """Release the terminal or the network."""


@dataclass(frozen=True, slots=True)
class State:
    """The vehicle at one time."""

    t_ns: int  # of the flight, from 0
    position: Floats  # (3) [m]
    quat_xyzw: Floats  # (4)
    spin: Floats  # (3) body [rad/s]
    force_m_s2: Floats  # (3) specific force in the body: acceleration less gravity
    velocity: Floats  # (3) world [m/s]
    asked: Wish | None = None  # the command that the vehicle got for the step to here


class HandFlight:
    """A vehicle, its pilot and the commands, advanced to any time: no clock is read here.

    Args:
        vehicle: in the air.
        pilot: takes the commands.
        controls: give them.
        state_hz: states a second of flight.
    """

    def __init__(self, vehicle: Steered, pilot: Pilot, controls: Controls, *, state_hz: float) -> None:
        self.vehicle, self.pilot, self._controls = vehicle, pilot, controls
        self._period_ns = round(1e9 / state_hz)
        self._count = 0
        self._velocity, self._last_ns = vehicle.velocity, vehicle.t_ns

    def until(self, t_ns: int) -> list[State]:
        """Fly on to a time of the flight [ns]; the states on the path."""
        out = []
        while (due_ns := (self._count + 1) * self._period_ns) <= t_ns:
            self._count += 1
            now_s = due_ns * 1e-9
            self._controls.update(self.pilot, now_s)
            if (wish := self.pilot.request(now_s)) is not None:
                self.vehicle.ask(wish)
            self.vehicle.advance(due_ns)
            out.append(self._state(due_ns, wish))
        return out

    def _state(self, t_ns: int, asked: Wish | None) -> State:
        vehicle = self.vehicle
        velocity, step_s = vehicle.velocity, (vehicle.t_ns - self._last_ns) * 1e-9
        change = (velocity - self._velocity) / step_s if step_s > 0 else np.zeros(3)
        self._velocity, self._last_ns = velocity, vehicle.t_ns
        turn = quat_matrix(vehicle.quat_xyzw)
        force = turn.T @ (change + np.array([0.0, 0.0, GRAVITY_M_S2]))
        return State(t_ns, vehicle.position, vehicle.quat_xyzw, vehicle.spin, force, velocity, asked)


class HandFlownSource(UnboundedSource):
    """Frames of radars on a vehicle that somebody flies, in this machine's time.

    A thread flies, so that no simulation of radars delays a command or the state. Beside frames the source passes on
    the path, and the readings of an IMU and of a sonar that points down on the topics of the Hector quadrotor.

    Args:
        scene: the world.
        rig: the radars.
        options: how.
        controls: where commands come from; closed with the source.
        start: x, y, z [m] and, if given, yaw [deg].
        log: takes lines for the user; None: they become warnings.
        frame_prefix: goes before the names of frames of reference.

    Raises:
        InputError: the start is in or too near to something, or there is no such vehicle.
    """

    def __init__(
        self, scene: Scene, rig: Rig, options: FlyOptions, controls: Controls, *, start: tuple[float, ...],
        log: Log | None = None, frame_prefix: str = "",
    ) -> None:  # fmt: skip
        from ullage.radar.live import LiveRadars

        super().__init__(options.duration_s, log, topic="flight", lag_s=options.lag_s)
        self.scene: Scene | None = scene
        self.passing = Passing()
        self._options, self._controls, self._body = options, controls, frame_prefix + BODY
        self._count_with(controls.counters, "flight")
        check_clear(start, options.vehicle, scene)
        vehicle = Steered(options.vehicle, scene=scene, start=start)
        self.flight = HandFlight(vehicle, Pilot(options), controls, state_hz=options.state_hz)
        fidelity: Any = options.fidelity
        self._radars = LiveRadars(
            scene, rig, fidelity=fidelity, max_bounces=options.max_bounces, seed=options.seed, rate_hz=options.rate_hz
        )
        self._names = tuple(rig.sensors)
        self._status = RadarStatus("flight", late_s=BEHIND_S)
        self._sonar = Sonar(scene)
        self._imu = ImuNoise(options.state_hz, seed=options.seed) if options.imu_noise else None
        self._epoch_ns = self._done_ns = self._touched = 0
        self._states: Inbox[State] = Inbox(self.counters)
        self._lost = 0  # states that were dropped before the last piece
        self._slowed_s = 0.0  # by which the flight took longer than real time
        self._ending = False
        self._error: BaseException | None = None
        self._thread: threading.Thread | None = None

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the radars."""
        return self._names

    def stream(self, chunk: int = 64) -> Iterator[dict[str, Frames]]:
        """Frames as they fall due, at most about `chunk` of each radar at a time, until the asked end or `stop`."""
        self._warm_up()
        self._epoch_ns = time.time_ns()
        self._thread = threading.Thread(target=self._fly, name="ullage flight", daemon=True)
        self._thread.start()
        fastest_hz = max(self._options.rate_hz or spec.fps for spec in self._radars.sensors.values())
        try:
            while not self._over():
                stopping = self._stopping
                states = self._gathered(min(chunk / fastest_hz, PIECE_S))
                if states:
                    yield from self._made(states)
                    self._done_ns = states[-1].t_ns
                elif stopping:
                    return
                self._complain()
        finally:
            self._report()
            self.close()

    def _made(self, states: list[State]) -> Iterator[dict[str, Frames]]:
        """The frames along some states."""
        if self._states.lost > self._lost:
            self._lost = self._states.lost
            count = self._radars.skip(self._epoch_ns + states[0].t_ns)
            self.counters.drop("frames", "lost", f"more than {self._limit_s:g} s late", count=count)
        found = self._radars.advance(
            [self._epoch_ns + state.t_ns for state in states],
            [state.position for state in states],
            [state.quat_xyzw for state in states],
        )
        self._status.add(found, self._behind_s())
        touched = self.flight.vehicle.touched
        status = self._status.message(self._epoch_ns + self._done_ns, self.counters, contacts=touched)
        if status is not None:
            self.passing.give(lambda: [status])
        if found:
            yield found

    def _behind_s(self) -> float:
        """Return the part of the flight that waits for simulation [s]."""
        return len(self._states) / self._options.state_hz

    def _state_of(self, states: list[State]) -> Iterator[Passed | Trajectory]:
        """Give the path along some states and the readings of the other sensors."""
        rows = [(s.position, s.quat_xyzw, s.velocity, s.spin) for s in states]
        times = np.array([self._epoch_ns + state.t_ns for state in states])
        yield Trajectory(times, *(np.array(column) for column in zip(*rows, strict=True)))
        for state in states:
            yield from self._readings(state)

    def _readings(self, state: State) -> Iterator[Passed]:
        t_ns = self._epoch_ns + state.t_ns
        if state.asked is not None:
            yield encode.command_message(t_ns, state.asked, state.quat_xyzw, frame_id=self._body)
        spin, force, variances = state.spin, state.force_m_s2, (0.0, 0.0)
        if self._imu is not None:
            number = round(state.t_ns * 1e-9 * self._options.state_hz)
            spin, force = self._imu.add(number, spin, force)
            variances = self._imu.rate_sigma**2, self._imu.force_sigma**2
        imu = encode.imu_message(t_ns, state.quat_xyzw, spin, force, frame_id=self._body, variances=variances)
        yield Passed(t_ns, IMU_TOPIC, ros.IMU, imu)
        if (range_m := self._sonar.reading(state)) is not None:
            message = encode.range_message(t_ns, range_m, SONAR_M, SONAR_FOV_RAD, frame_id=self._body + "_sonar")
            yield Passed(t_ns, SONAR_TOPIC, ros.RANGE, message)

    def _warm_up(self) -> None:
        """Load and compile before the flight."""
        vehicle = self.flight.vehicle
        self._radars.advance(0, vehicle.position, vehicle.quat_xyzw)
        self._radars.reset()
        self.flight.until(self.flight.vehicle.t_ns)

    def _fly(self) -> None:
        """The flight's thread: advance to the present in short steps, so that its state comes however slow it is."""
        begun, flown_s, pace = time.monotonic(), 0.0, self._options.pace
        try:
            while not self._ending:
                due_s = (time.monotonic() - begun) * pace
                flown_s = min(due_s, flown_s + BATCH_S)
                if due_s - flown_s > BEHIND_S:  # it does not try to catch up
                    begun += (due_s - flown_s) / pace
                    self._slowed_s += (due_s - flown_s) / pace
                fresh = self.flight.until(int(flown_s * 1e9))
                if fresh:
                    self.passing.give(partial(self._state_of, fresh))
                for state in fresh:
                    self._states.put(state, topic=self._intake.topic)
                time.sleep(STEP_S if flown_s == due_s else 0.0)
        except BaseException as error:  # raised when frames are requested
            self._error = error

    def _gathered(self, most_s: float) -> list[State]:
        """States of about a tenth of a second, or as many as wait, at most those of `most_s`."""
        enough = max(round(BATCH_S * self._options.state_hz), 1)
        found: list[State] = []
        while len(found) < max(int(most_s * self._options.state_hz), 1):
            state = self._states.get(2 * BATCH_S if len(found) < enough and not self._ending else 0.0)
            if state is None:
                break
            found.append(state)
        if self._error is not None:
            raise self._error
        return found

    def _over(self) -> bool:
        return self._duration_s is not None and self._done_ns >= self._duration_s * 1e9

    def _cheaper(self) -> str:
        """Options that cost less, as `ullage fly` takes them."""
        law = () if self._options.fidelity == "thesis" else ("-o sensing.fidelity=thesis",)
        return ", ".join((*law, "-o sensing.rate_hz=HZ or fewer radars"))

    def _complain(self) -> None:
        self.counters.report()
        if (touched := self.flight.vehicle.touched) > self._touched:
            self._touched = touched
            self._log_throttled("the vehicle touches something")
        if self._slowed_s:
            self._log_throttled(f"the flight itself takes {self._slowed_s:.1f} s longer than real time", kind="slow")
        if (behind_s := self._behind_s()) > BEHIND_S:
            self._log_throttled(
                f"the radars are {behind_s:.1f} s behind the flight; {self._cheaper()} cost less",
                kind="behind",
            )

    def keep_up(self, lag_s: float) -> None:
        """From now on leave out what is later than this [s]."""
        self._states.lag_s = self._limit_s = lag_s

    def stop(self) -> None:
        """End the flight; the frames of what was flown still come."""
        self._states.lag_s = None
        self._ending = True
        if self._thread is not None:
            self._thread.join(1.0)
        super().stop()

    def close(self) -> None:
        """Land: end the thread, let go of terminal and network."""
        self._ending = True
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(3.0)
        self._controls.close()
        self._radars.close()


class Sonar:
    """The height over what lies below: the nearest hit of a cone of rays, ten times a second.

    Args:
        scene: the world.
    """

    def __init__(self, scene: Scene) -> None:
        half = SONAR_FOV_RAD / 2
        tilt = np.array([0.0, *[half / 2] * 6, *[half] * 12])
        around = np.concatenate([[0.0], np.arange(6) * math.tau / 6, np.arange(12) * math.tau / 12])
        self._rays = np.stack([np.sin(tilt) * np.cos(around), np.sin(tilt) * np.sin(around), -np.cos(tilt)], axis=1)
        self._caster = Raycaster(scene)
        self._due_ns = 0

    def reading(self, state: State) -> float | None:
        """Range [m], +inf where nothing is within reach (REP-117); None where no reading is due."""
        if state.t_ns < self._due_ns:
            return None
        self._due_ns = state.t_ns + round(1e9 / SONAR_HZ)
        rays = self._rays @ quat_matrix(state.quat_xyzw).T
        near = float(np.min(self._caster.distances(state.position, rays)))
        return near if near <= SONAR_M[1] else math.inf
