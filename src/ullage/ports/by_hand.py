"""Fly the simulated multirotor by hand: receive commands, give frames and the readings of its other sensors.

Commands come from topics or from a terminal: the arrow keys, and the letters of ROS' teleop_twist_keyboard.
"""

from __future__ import annotations

import math
import os
import re
import select
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol

import numpy as np
from pydantic import Field

from ullage.arrays import Floats
from ullage.data import Frames, Trajectory
from ullage.errors import InputError
from ullage.flight.imu import MPU6000, white_noise
from ullage.flight.live import Steered, Wish
from ullage.flight.pilot import HOVER, Pilot, PilotOptions, Velocity
from ullage.flight.vehicle import check_clear
from ullage.geometry import GRAVITY_M_S2, quat_matrix
from ullage.ports import encode
from ullage.ports import schema as ros
from ullage.ports.conversions import BODY
from ullage.ports.cosimulation import BEHIND_S, CosimulationSource, SensingOptions
from ullage.ports.intake import Counters, Inbox, Log, Worker
from ullage.ports.live import point_of
from ullage.ports.pose_events import BodyState, ModelPose, path_along
from ullage.ports.protocol import Passed
from ullage.specs import Rig
from ullage.world.raycast import Raycaster
from ullage.world.scene import Scene

IMU_TOPIC, SONAR_TOPIC = "raw_imu", "sonar_height"
"""Names of the Hector quadrotor's topics."""
SONAR_M, SONAR_FOV_RAD, SONAR_HZ = (0.03, 3.0), math.radians(40), 10.0
"""Limits, opening and rate of the sonar of [HectorQuadrotor]."""
BATCH_S = 0.05
"""Longest piece of a flight that is advanced at once [s]."""
STEP_S = 0.01


class FlyOptions(PilotOptions, SensingOptions):
    """Settings of a flight by hand."""

    fly: str = Field("", description="library world or file to fly in")
    vehicle: str = Field("hector", description="the multirotor")
    start: str = Field("", description="x,y,z [m] and, if given, yaw [deg]; none: the library world's own")
    state_hz: float = Field(50.0, ge=10, le=250, description="poses and IMU readings a second")
    imu_noise: bool = Field(True, description="white noise of an MPU-6000 on turn rate and acceleration")
    pace: float = Field(1.0, gt=0, le=10, description="times real time")

    def place(self) -> tuple[float, ...] | None:
        """Return the start of the flight; None: not given.

        Raises:
            InputError: it is not three or four finite numbers.
        """
        return point_of(self.start, "start", where="fly", yaw=True) if self.start else None


class Controls(Protocol):
    """Source of commands: a keyboard or topics."""

    counters: Counters  # of what could not be used

    def update(self, pilot: Pilot, now_s: float) -> None:
        """Pass all commands since the last call to the pilot."""

    def close(self) -> None:
        """Release the terminal or the network."""


@dataclass(frozen=True, slots=True)
class State(BodyState):
    """The vehicle at a time of the flight, from 0 on [ns]."""

    force_m_s2: Floats  # (3) specific force in the body: acceleration less gravity
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
        self.vehicle, self.pilot, self.controls = vehicle, pilot, controls
        self._period_ns = round(1e9 / state_hz)
        self._count = 0
        self._velocity, self._last_ns = vehicle.velocity, vehicle.t_ns

    def until(self, t_ns: int) -> list[State]:
        """Fly on to a time of the flight [ns]; the states on the path."""
        out = []
        while (due_ns := (self._count + 1) * self._period_ns) <= t_ns:
            self._count += 1
            now_s = due_ns * 1e-9
            self.controls.update(self.pilot, now_s)
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
        return State(t_ns, vehicle.position, vehicle.quat_xyzw, velocity, vehicle.spin, force, asked)


class FlightFeed:
    """Poses of a vehicle that a thread flies in this machine's time, so that no simulation of radars delays a command.

    Args:
        flight: the vehicle.
        pace: times real time.
        give: takes the states of each short piece of the flight, and the time at which it began [ns].
    """

    def __init__(self, flight: HandFlight, pace: float, give: Callable[[list[State], int], None]) -> None:
        self._flight, self._pace, self._give = flight, pace, give
        self.counters = flight.controls.counters
        self._inbox: Inbox[ModelPose] = Inbox(self.counters)
        self.newest_ns = 0
        self.slowed_s = 0.0  # by which the flight took longer than real time
        self._ending = False
        self._worker: Worker | None = None

    @property
    def behind_s(self) -> float:
        """How long the oldest pose waits already [s]."""
        return self._inbox.behind_s

    def next(self, timeout_s: float) -> ModelPose | None:
        """Return the next pose, or None if none came within the timeout; the first call begins the flight."""
        if self._worker is None:
            self._worker = Worker(partial(self._fly, time.time_ns()), "ullage flight")
            self._worker.start()
        found = self._inbox.get(timeout_s)
        self._worker.check()
        return found

    def _fly(self, epoch_ns: int) -> None:
        """Advance to the present in short steps, so that the state comes however slow the flight is."""
        begun, flown_s, pace = time.monotonic(), 0.0, self._pace
        while not self._ending:
            due_s = (time.monotonic() - begun) * pace
            flown_s = min(due_s, flown_s + BATCH_S)
            if due_s - flown_s > BEHIND_S:  # it does not try to catch up
                begun += (due_s - flown_s) / pace
                self.slowed_s += (due_s - flown_s) / pace
            if fresh := self._flight.until(int(flown_s * 1e9)):
                self._give(fresh, epoch_ns)
            for state in fresh:
                self.newest_ns = epoch_ns + state.t_ns
                pose = ModelPose(self.newest_ns, tuple(state.position), tuple(state.quat_xyzw))
                self._inbox.put(pose, topic=HandFlownSource.name)
            time.sleep(STEP_S if flown_s == due_s else 0.0)

    def give(self, chunk: dict[str, Frames], offset_ns: int) -> None:
        """Do nothing: nobody else sees the flight."""

    def land(self) -> None:
        """End the flight; its poses still come."""
        self._ending = True
        if self._worker is not None and self._worker is not threading.current_thread():
            self._worker.join(3.0)

    def close(self) -> None:
        """Land, and let go of terminal and network."""
        self.land()
        self._flight.controls.close()


class HandFlownSource(CosimulationSource):
    """Frames of radars on a vehicle that somebody flies, in this machine's time.

    Beside frames the source passes on the path, and the readings of an IMU and of a sonar that points down on the
    topics of the Hector quadrotor.

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

    name = "flight"
    rest_s = 0.0

    def __init__(
        self, scene: Scene, rig: Rig, options: FlyOptions, controls: Controls, *, start: tuple[float, ...],
        log: Log | None = None, frame_prefix: str = "",
    ) -> None:  # fmt: skip
        check_clear(start, options.vehicle, scene)
        vehicle = Steered(options.vehicle, scene=scene, start=start)
        self.flight = HandFlight(vehicle, Pilot(options), controls, state_hz=options.state_hz)
        self._air = FlightFeed(self.flight, options.pace, lambda *flown: self.passing.give(partial(self._told, *flown)))
        self._options, self._body = options, frame_prefix + BODY
        self._sonar = Sonar(scene)
        self._imu = MPU6000.but(rate_hz=options.state_hz) if options.imu_noise else None
        self._touched = 0
        super().__init__(lambda: self._air, scene, rig, options, log=log)

    def _told(self, states: list[State], epoch_ns: int) -> Iterator[Passed | Trajectory]:
        """Give the path along some states and the readings of the other sensors."""
        path = path_along(states)
        yield replace(path, t_ns=epoch_ns + path.t_ns)
        for state in states:
            yield from self._readings(state, epoch_ns + state.t_ns)

    def _readings(self, state: State, t_ns: int) -> Iterator[Passed]:
        if state.asked is not None:
            yield encode.command_message(t_ns, state.asked, state.quat_xyzw, frame_id=self._body)
        spin, force, variances = state.spin, state.force_m_s2, (0.0, 0.0)
        if self._imu is not None:
            turned, pushed = white_noise(np.array([state.t_ns]), self._imu, seed=self._options.seed)
            spin, force = spin + turned[0], force + pushed[0]
            variances = self._imu.sigma[0] ** 2, self._imu.sigma[1] ** 2
        imu = encode.imu_message(t_ns, state.quat_xyzw, spin, force, frame_id=self._body, variances=variances)
        yield Passed(t_ns, IMU_TOPIC, ros.IMU, imu)
        if (range_m := self._sonar.reading(state)) is not None:
            message = encode.range_message(t_ns, range_m, SONAR_M, SONAR_FOV_RAD, frame_id=self._body + "_sonar")
            yield Passed(t_ns, SONAR_TOPIC, ros.RANGE, message)

    def _contacts(self) -> int:
        return self.flight.vehicle.touched

    def _log_if_behind(self) -> None:
        if (touched := self._contacts()) > self._touched:
            self._touched = touched
            self._log_throttled("the vehicle touches something")
        if slowed_s := self._air.slowed_s:
            self._log_throttled(f"the flight itself takes {slowed_s:.1f} s longer than real time", kind="slow")
        if (behind_s := self.behind_s) > BEHIND_S:
            law = "" if self._options.fidelity == "thesis" else "-o sensing.fidelity=thesis, "
            cheaper = f"{law}-o sensing.rate_hz=HZ or fewer radars"
            self._log_throttled(
                f"the radars are {behind_s:.1f} s behind the flight; {cheaper} cost less", kind="behind"
            )  # fmt: skip

    def stop(self) -> None:
        """End the flight; the frames of what was flown still come."""
        self._air.land()
        super().stop()


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


HELP = """\
arrow up/down: forward/back      arrow left/right: turn      page up/down or t/b: climb/sink
u i o / j k l / m , .            as teleop_twist_keyboard: move and turn, k hovers; with shift: sideways
q/z, w/x, e/c                    faster/slower: both, speed, turn      Ctrl-C ends the flight
Hold a key to go on; the vehicle hovers half a second after the last one."""
MOVES = {
    "up": (1, 0, 0, 0), "down": (-1, 0, 0, 0), "left": (0, 0, 0, 1), "right": (0, 0, 0, -1),
    "page up": (0, 0, 1, 0), "page down": (0, 0, -1, 0),
    "i": (1, 0, 0, 0), "o": (1, 0, 0, -1), "j": (0, 0, 0, 1), "l": (0, 0, 0, -1), "u": (1, 0, 0, 1),
    ",": (-1, 0, 0, 0), ".": (-1, 0, 0, 1), "m": (-1, 0, 0, -1), "I": (1, 0, 0, 0), "O": (1, -1, 0, 0),
    "J": (0, 1, 0, 0), "L": (0, -1, 0, 0), "U": (1, 1, 0, 0), "<": (-1, 0, 0, 0), ">": (-1, -1, 0, 0),
    "M": (-1, 1, 0, 0), "t": (0, 0, 1, 0), "b": (0, 0, -1, 0),
}  # fmt: skip
"""Forward, left, up and turn of each key, as shares of speed and turn rate."""
RATES = {"q": (1.1, 1.1), "z": (0.9, 0.9), "w": (1.1, 1.0), "x": (0.9, 1.0), "e": (1.0, 1.1), "c": (1.0, 0.9)}
"""By how much a key changes speed and turn rate."""
SEQUENCES = {
    "[A": "up", "[B": "down", "[C": "right", "[D": "left", "[5~": "page up", "[6~": "page down",
    "OA": "up", "OB": "down", "OC": "right", "OD": "left",
}  # fmt: skip
KEY = re.compile(r"\x1b(\[[0-9;]*[A-Za-z~]|O[A-Z])|\x1b(?![\[O])|[^\x1b]", re.DOTALL)
BEGUN = re.compile(r"\x1b(\[[0-9;]*|O)?\Z")


def keys_in(text: str) -> tuple[list[str], str]:
    """The keys in what a terminal sent, and the start of a sequence that has not come whole."""
    begun = BEGUN.search(text)
    whole, rest = (text, "") if begun is None else (text[: begun.start()], begun[0][-16:])
    return [SEQUENCES.get(found[1], "") if found[1] else found[0] for found in KEY.finditer(whole)], rest


class Keyboard:
    """Turns keys into velocity commands.

    Args:
        terminal: file descriptor of a terminal; None: standard input.
        speed_m_s: at first.
        turn_rad_s: at first.

    Raises:
        InputError: there is no terminal.
    """

    def __init__(self, terminal: int | None = None, *, speed_m_s: float = 0.5, turn_rad_s: float = 1.0) -> None:
        self.counters = Counters()
        self._fd = _standard_input() if terminal is None else terminal
        self.speed_m_s, self.turn_rad_s = speed_m_s, turn_rad_s
        self._rest = ""
        self._before: list[Any] | None = _raw(self._fd)

    def update(self, pilot: Pilot, now_s: float) -> None:
        """Pass the keys pressed since the last call to the pilot."""
        while self._before is not None and select.select([self._fd], [], [], 0)[0]:
            data = os.read(self._fd, 1024)
            if not data:
                return
            keys, self._rest = keys_in(self._rest + data.decode("utf-8", "replace"))
            for key in keys:
                self._press(key, pilot, now_s)

    def _press(self, key: str, pilot: Pilot, now_s: float) -> None:
        if key in RATES:
            faster, quicker = RATES[key]
            self.speed_m_s, self.turn_rad_s = self.speed_m_s * faster, self.turn_rad_s * quicker
            return
        forward, left, up, turn = MOVES.get(key, (0, 0, 0, 0))
        if not any((forward, left, up, turn)):  # as teleop_twist_keyboard: any other key stops
            pilot.command(HOVER, now_s)
            return
        v = self.speed_m_s
        pilot.command(Velocity(forward * v, left * v, up * v, turn * self.turn_rad_s), now_s)

    def close(self) -> None:
        """Give the terminal back as it was."""
        before, self._before = self._before, None
        if before is not None:
            import termios

            termios.tcsetattr(self._fd, termios.TCSADRAIN, before)


def _standard_input() -> int:
    try:
        return sys.stdin.fileno()
    except (OSError, ValueError, AttributeError):
        return -1


def _raw(fd: int) -> list[Any]:
    """Let keys come one by one, without echo; how the terminal was before. Ctrl-C still interrupts."""
    refused = InputError("the keyboard needs a terminal", where="fly", allowed="a terminal, or --by ros2:")
    if fd < 0 or not os.isatty(fd):
        raise refused
    try:
        import termios
        import tty
    except ImportError:
        raise refused from None
    before: list[Any] = termios.tcgetattr(fd)
    tty.setcbreak(fd)
    return before
