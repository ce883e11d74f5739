"""Command an external drone through a port: receive its state, send velocities or set-points.

`Guided` closes the loop between the request (`flight.live.Wish`) and the commands that the drone takes. It needs no
middleware; the ports `ros2`, `gazebo`, `mavlink` and `imc` give a `Drone` each.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field

from ullage.arrays import Floats
from ullage.errors import InputError
from ullage.flight.live import Wish
from ullage.flight.pilot import HOVER, Velocity
from ullage.geometry import quat_matrix, quat_rpy
from ullage.ports.intake import Counters, Log, Once, checked_pose
from ullage.ports.pose_events import BodyState
from ullage.ports.publisher import is_present
from ullage.specs import Spec

Takes = Literal["velocity", "pose"]
COMMAND_S = 0.1
"""Time between two commands [s]."""
STALE_S = 1.0
"""A state older than this [s] is no ground for a command but to hover."""
REFERENCE_M = 1.0
"""How far a moving set-point may run ahead of the drone [m]."""
LEAD_S = 1.0
"""How long the drone may take to it, so that a slower command leaves a nearer one [s]."""


class CommandOptions(Spec):
    """How a drone is commanded."""

    takes: Takes = Field("velocity", description="what a drone of others is commanded by")
    limit_m_s: float = Field(1.0, gt=0, le=20, description="greatest speed that it is commanded")


class VehicleOptions(CommandOptions):
    """A drone in the loop with radars and guard."""

    hull_m: float = Field(0.4, gt=0, le=10, description="from the body's centre to its farthest part")
    radars: str = Field("", description="live port of its radars; none: they are simulated at its poses")


class DroneOptions(Spec):
    """Topics of a drone; empty: the defaults of its kind."""

    odom: str = Field("", description="topic of that drone's odometry; none: odom, or /model/NAME/odometry in Gazebo")
    cmd_vel: str = Field("", description="topic of its velocities; none: cmd_vel, or /model/NAME/cmd_vel in Gazebo")
    setpoint: str = Field("", description="topic of its set-points; none: command/pose")


class TopicVehicleOptions(VehicleOptions, DroneOptions):
    """A drone in the loop, commanded by topics."""


class Limits(NamedTuple):
    """Greatest rates of a command."""

    level_m_s: float = 1.0
    climb_m_s: float = 1.0
    turn_rad_s: float = math.radians(60)


def state_of(t_ns: int, pose: Any, twist: Any) -> BodyState | str:
    """Return the state that an odometry message gives, with its twist in the body; or what is wrong with it.

    Args:
        t_ns: Unix time; a simulator's clock is replaced by this machine's.
        pose: position [m] and orientation, with the fields that ROS and Gazebo both have.
        twist: linear [m/s] and angular [rad/s] rates in the body.
    """
    at, turn = pose.position, pose.orientation
    linear, angular = (np.array([one.x, one.y, one.z]) for one in (twist.linear, twist.angular))
    placed = checked_pose((at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w))
    if isinstance(placed, str):
        return placed
    if not np.isfinite([linear, angular]).all():
        return "twist is not finite"
    t_ns = t_ns if is_present(t_ns) else time.time_ns()
    return BodyState(t_ns, *placed, quat_matrix(placed[1]) @ linear, angular)


class Drone(ABC):
    """External drone that publishes its odometry; messages that cannot be used are counted.

    Args:
        odom: topic of the odometry.
        counters: of its messages.
    """

    takes: ClassVar[tuple[Takes, ...]] = ("velocity", "pose")
    refusal = ""
    """Why it does not take the other commands."""
    settings: ClassVar[type[VehicleOptions]] = TopicVehicleOptions
    """Options of its address as a vehicle in the loop."""
    away = ""
    """Why it does not follow: somebody else flies it, or it is not ready; empty: it follows."""
    broken = ""
    """Why it can fly no more, as its states are not to be trusted or it refuses; empty: it can."""

    def __init__(self, odom: str, counters: Counters) -> None:
        self._odom, self.counters = odom, counters
        self._last: BodyState | None = None
        self.answered_ns = 0
        """Time of the state that the next commands answer; 0: unknown [ns since 1970]."""

    def states(self) -> list[BodyState]:
        """Return the states since the last call, in order of time."""
        out = []
        for data in self._arrived():
            self.counters.receive(self._odom)
            with self.counters.reading(self._odom):
                found = self._state(data)
                if isinstance(found, str):
                    self.counters.drop(self._odom, "bad", found)
                elif self._last is not None and found.t_ns <= self._last.t_ns:
                    self.counters.drop(self._odom, "late")
                else:
                    self._last = found
                    out.append(found)
        return out

    @abstractmethod
    def steer(self, velocity: Velocity) -> None:
        """Command a velocity in the level frame of the heading."""

    def go_to(self, position: tuple[float, float, float], heading_rad: float) -> None:
        """Command a set-point in the world of the drone's odometry.

        Raises:
            InputError: it takes none.
        """
        raise InputError(self.refusal, where="takes", allowed=", ".join(self.takes))

    def hold(self) -> None:
        """Let it hover by itself from now on."""
        self.steer(HOVER)

    def land(self) -> None:
        """Tell it that it has landed, so that it stops its motors if it can."""
        self.hold()

    @abstractmethod
    def close(self) -> None:
        """Leave the network."""

    @abstractmethod
    def _arrived(self) -> Iterator[Any]:
        """Give the odometry messages, or the states, since the last call."""

    def _state(self, data: Any) -> BodyState | str:
        """Return the state in an odometry message, or what is wrong with it."""
        return data  # type: ignore[no-any-return]


class Guided:
    """Flies a drone of others as it is asked to. Nothing is commanded before the first request.

    Without a fresh state of the drone it is commanded to hover (by velocity) or left at its last set-point (by pose).

    Args:
        drone: to command.
        takes: velocities or poses.
        limits: of the velocities.
        log: takes lines for the user.
        now: gives the time [s].
    """

    def __init__(
        self, drone: Drone, takes: Takes, limits: Limits, *, log: Log, now: Callable[[], float] = time.monotonic
    ) -> None:
        self._drone, self._takes, self._limits, self._log, self._now = drone, takes, limits, log, now
        self._once = Once(log)
        self.wish = Wish()
        self._asked = self._stale = False
        self._state: BodyState | None = None
        self._fresh_s = self._due_s = self._last_s = -math.inf
        self._step_s = COMMAND_S  # since the command before [s]
        self._reference: Floats | None = None  # the set-point that a velocity moves
        self._moving = False

    @property
    def position(self) -> Floats | None:
        """Its last position (3) [m]; None before the first state."""
        return None if self._state is None else self._state.position

    def ask(self, wish: Wish) -> None:
        """Change the request; forces cannot be commanded and are left out."""
        if wish.force_n is not None:
            self._once("the drone takes no forces: DesiredControl is left out")
            return
        if not self._asked and self._state is not None:
            here, yaw = self._state.position, float(quat_rpy(self._state.quat_xyzw)[2])
            self.wish = Wish(height_m=float(here[2]), velocity_m_s=(0.0, 0.0), heading_rad=yaw)
        self._asked = True
        self.wish = self.wish.then(wish)

    def fly(self) -> list[BodyState]:
        """The drone's states since the last call; a command is sent when one is due."""
        states, now = self._drone.states(), self._now()
        if states:
            self._state, self._fresh_s = states[-1], now
        if now >= self._due_s:
            self.command()
        return states

    def command(self) -> None:
        """Send the command of the present request, if there is one; the next one is due a little later."""
        now = self._now()
        if not self._asked:
            return
        self._step_s = min(now - self._last_s, 2 * COMMAND_S)
        self._last_s, self._due_s = now, now + COMMAND_S
        state = self._state
        stale = state is None or now - self._fresh_s > STALE_S
        if stale and not self._stale:
            self._log(f"no state of the drone for {STALE_S:g} s: hovering")
        self._stale = stale
        if state is None or stale:
            self._reference = None
            if self._takes == "velocity":
                self._drone.steer(HOVER)
        elif self._takes == "velocity":
            self._drone.steer(self.velocity(state))
        else:
            self._drone.go_to(*self._set_point(state))

    def velocity(self, state: BodyState) -> Velocity:
        """The velocity to command at this state, in the level frame of the heading, within the limits."""
        yaw = float(quat_rpy(state.quat_xyzw)[2])
        east, north, up = self.wish.velocity(state.position, yaw)
        cos, sin, most = math.cos(yaw), math.sin(yaw), self._limits
        share = min(1.0, most.level_m_s / max(math.hypot(east, north), 1e-12))
        forward, left = (east * cos + north * sin) * share, (north * cos - east * sin) * share
        turn = self.wish.turn(yaw) if self._turns else 0.0
        return Velocity(forward, left, _within(up, most.climb_m_s), _within(turn, most.turn_rad_s))

    @property
    def _turns(self) -> bool:
        return self.wish.turn_rad_s is not None or self.wish.heading_rad is not None

    def _set_point(self, state: BodyState) -> tuple[tuple[float, float, float], float]:
        yaw = float(quat_rpy(state.quat_xyzw)[2])
        wish = self.wish
        if wish.turn_rad_s is not None:
            heading = yaw + wish.turn_rad_s * COMMAND_S * 5
        else:
            heading = yaw if wish.heading_rad is None else wish.heading_rad
        if wish.position_m is not None:
            self._reference = np.array(wish.goal(state.position))
        else:
            if self._reference is None:
                self._reference = state.position.copy()
            v = self.velocity(state)
            cos, sin = math.cos(yaw), math.sin(yaw)
            step = np.array([v.forward_m_s * cos - v.left_m_s * sin, v.forward_m_s * sin + v.left_m_s * cos, v.up_m_s])
            if not step.any() and self._moving:
                self._reference = state.position.copy()
            self._moving = bool(step.any())
            most_m = min(REFERENCE_M, LEAD_S * float(np.linalg.norm(step))) if self._moving else REFERENCE_M
            away = self._reference + step * self._step_s - state.position
            away *= min(1.0, most_m / max(float(np.linalg.norm(away)), 1e-12))
            self._reference = state.position + away
            if wish.height_m is not None:
                self._reference[2] = wish.height_m
        x, y, z = (float(value) for value in self._reference)
        return (x, y, z), heading

    def close(self) -> None:
        """Let the drone hover, and leave the network."""
        if self._asked and self._takes == "velocity":
            self._drone.steer(HOVER)
        self._drone.close()
        for line in self._drone.counters.lines():
            self._log(line)


def _within(value: float, most: float) -> float:
    return min(max(value, -most), most)
