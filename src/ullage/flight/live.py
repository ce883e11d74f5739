"""A multirotor that is steered while it flies: by height, velocity and heading, by rates, to a position, or by forces.

Body, rotors, air and obstacles are those of `fly`. Only the reference is made on the way, at each control step, from
the request at that moment.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ullage.arrays import Floats
from ullage.data import Trajectory
from ullage.errors import InputError
from ullage.flight.airframe import Airframe, airframe
from ullage.flight.control import Tables, air
from ullage.flight.obstacles import bodies
from ullage.flight.physics import CONTROL_EVERY, CONTROL_HZ, PHYSICS_HZ, CollisionModel
from ullage.kernels.flight import command, wrench
from ullage.world.scene import Scene

_PULL_S = 1.2  # climb rate per metre of height error [1/s]
_CLIMB_M_S, _ACCELERATION_M_S2 = 1.0, 1.5
_GOAL_M_S = 1.0  # greatest level speed on the direct path to a position
_AHEAD = 1.5  # how far ahead on a path the vehicle aims, over the distance at which it slows down
_SPEED_S, _SMOOTH_S = 0.35, 0.08  # time constants of the requested speed and acceleration [s]
LAG_S = _SPEED_S + _SMOOTH_S
"""Time by which a vehicle lags behind a step of the requested speed, below the limit of its acceleration [s]."""
_TURN_S, _TURN_RAD_S = 1.5, math.radians(60)


@dataclass(frozen=True, slots=True)
class Wish:
    """Request to the vehicle; None: the previous request, at first to hover."""

    height_m: float | None = None  # z in the world
    velocity_m_s: tuple[float, float] | None = None  # forward and left, level
    heading_rad: float | None = None  # counter-clockwise from east
    force_n: tuple[float, float, float] | None = None  # forward, left, up; on top of what carries the weight
    climb_m_s: float | None = None  # in place of a height
    turn_rad_s: float | None = None  # counter-clockwise, in place of a heading
    position_m: tuple[float, float, float] | None = None  # in the world, in place of height and velocity
    from_m: tuple[float, float, float] | None = None  # where the straight path to that position begins; None: anywhere
    speed_m_s: float | None = None  # greatest horizontal speed towards a position

    def then(self, later: Wish) -> Wish:
        """This one with the changes of a later one: a command replaces those before it on the same axes."""
        vertical = later.height_m is not None or later.climb_m_s is not None
        level = later.velocity_m_s is not None
        placed = later.position_m is not None
        pushed = later.force_n is not None and not (vertical or level or placed)
        turned = later.heading_rad is not None or later.turn_rad_s is not None
        goal = self.position_m
        kept_m = goal[2] if goal is not None and level and not vertical else self.height_m
        return Wish(
            None if placed else later.height_m if vertical else kept_m,
            None if placed else later.velocity_m_s if level else self.velocity_m_s,
            later.heading_rad if turned else self.heading_rad,
            later.force_n if pushed else None if vertical or level or placed else self.force_n,
            None if placed else later.climb_m_s if vertical else self.climb_m_s,
            later.turn_rad_s if turned else self.turn_rad_s,
            later.position_m if placed else None if vertical or level or pushed else goal,
            later.from_m if placed else None if vertical or level or pushed else self.from_m,
            later.speed_m_s if placed or later.speed_m_s is not None else self.speed_m_s,
        )

    def velocity(self, position: Sequence[float] | Floats, heading_rad: float) -> tuple[float, float, float]:
        """Return the velocity in the world [m/s] that moves a vehicle at this place and heading to the request."""
        if self.position_m is not None:
            goal, most_m_s = self.goal(position), self.speed_m_s or _GOAL_M_S
            east, north = (_PULL_S * (goal[k] - float(position[k])) for k in range(2))
            share = min(1.0, most_m_s / max(math.hypot(east, north), 1e-12))
            return east * share, north * share, _climb(_PULL_S * (goal[2] - float(position[2])))
        ahead, aside = self.velocity_m_s or (0.0, 0.0)
        climb = self.climb_m_s or 0.0
        if self.height_m is not None:
            climb = _PULL_S * (self.height_m - float(position[2]))
        cos, sin = math.cos(heading_rad), math.sin(heading_rad)
        return ahead * cos - aside * sin, ahead * sin + aside * cos, _climb(climb)

    def turn(self, heading_rad: float) -> float:
        """Return the turn rate [rad/s] that brings a vehicle of this heading to the request."""
        rate = self.turn_rad_s
        if rate is None:
            rate = _TURN_S * math.remainder((self.heading_rad or 0.0) - heading_rad, math.tau)
        return min(max(rate, -_TURN_RAD_S), _TURN_RAD_S)

    def goal(self, position: Sequence[float] | Floats) -> tuple[float, float, float]:
        """Return the current goal: the requested position, or a point ahead on the straight path to it."""
        end = self.position_m or (float(position[0]), float(position[1]), float(position[2]))
        if self.from_m is None:
            return end
        start, along = np.array(self.from_m), np.array(end) - np.array(self.from_m)
        length_m = float(np.linalg.norm(along))
        if length_m < 1e-9:
            return end
        ahead_m = _AHEAD * (self.speed_m_s or _GOAL_M_S) / _PULL_S
        at_m = float((np.asarray(position, float) - start) @ along) / length_m + ahead_m
        east, north, up = start + along * min(max(at_m, 0.0), length_m) / length_m
        return float(east), float(north), float(up)


class Steered:
    """A multirotor in the air, a control step at a time.

    Args:
        vehicle: name of a vehicle, or an `Airframe`.
        scene: what can be hit; None: free space. Moving objects stand where they are at first, but for `moving_s`.
        start: where it hovers at first: x, y, z [m], and yaw [deg] or not.
        wind_m_s: mean wind (3) [m/s] world.
        gust_m_s: rms of the gusts along x and y [m/s]; half of it along z.
        seed: which gusts.
        moving_s: for so long gusts blow and moving objects move, from the start on [s].

    Raises:
        InputError: the start is not three or four finite numbers, or the vehicle unknown.
    """

    def __init__(
        self,
        vehicle: str | Airframe = "hector",
        *,
        scene: Scene | None = None,
        start: ArrayLike = (0.0, 0.0, 1.0),
        wind_m_s: Sequence[float] = (0.0, 0.0, 0.0),
        gust_m_s: float = 0.0,
        seed: int = 0,
        moving_s: float = 0.0,
    ) -> None:
        place = np.asarray(start, float)
        if place.shape not in ((3,), (4,)) or not np.isfinite(place).all():
            raise InputError(f"start is {start!r}", where="Steered", allowed="x, y, z [m], and yaw [deg] or not")
        self._tables = Tables.of(airframe(vehicle))
        self._rows = max(math.ceil(moving_s * CONTROL_HZ), 0) + 1
        self._collisions = CollisionModel(airframe(vehicle), bodies(scene) if scene is not None else [], self._rows)
        self._memory = self._tables.memory(airframe(vehicle).hover_rad_s)
        self._track = np.zeros((1, 14))
        self._wind = air(np.asarray(wind_m_s, float), gust_m_s, count=self._rows, rate_hz=CONTROL_HZ, seed=seed)
        self._mass_kg, self.hull_m = airframe(vehicle).mass_kg, airframe(vehicle).radius_m
        yaw = math.radians(float(place[3])) if len(place) == 4 else 0.0
        self._track[0, :3], self._track[0, 12] = place[:3], yaw
        self._collisions.data.qpos[:] = [*place[:3], math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)]
        self._collisions.data.qvel[:] = 0
        self.wish = Wish(float(place[2]), (0.0, 0.0), yaw)
        self.steps = 0

    @property
    def t_ns(self) -> int:
        """Time flown [ns]."""
        return round(self.steps * 1e9 / CONTROL_HZ)

    @property
    def ended(self) -> str:
        """Why it flies no more: never."""
        return ""

    @property
    def touched(self) -> int:
        """Number of contacts so far."""
        return len(self._collisions.touches)

    @property
    def contacts(self) -> tuple[tuple[int, int, float], ...]:
        """Each contact: control step at which it began, number of the object, speed [m/s]."""
        return tuple((touch.step, touch.owner, touch.speed) for touch in self._collisions.touches)

    @property
    def position(self) -> Floats:
        """Position (3) [m]."""
        return np.array(self._collisions.data.qpos[:3])

    @property
    def quat_xyzw(self) -> Floats:
        """Its attitude (4), world_from_body."""
        return np.array(self._collisions.data.qpos[[4, 5, 6, 3]])

    @property
    def velocity(self) -> Floats:
        """Its velocity (3) in the world [m/s]."""
        return np.array(self._collisions.data.qvel[:3])

    @property
    def spin(self) -> Floats:
        """Its turn rate (3) in the body [rad/s]."""
        return np.array(self._collisions.data.qvel[3:6])

    def ask(self, wish: Wish) -> None:
        """Change the request."""
        self.wish = self.wish.then(wish)

    def advance(self, until_ns: int) -> None:
        """Fly on until this time or the control step just before it."""
        while round((self.steps + 1) * 1e9 / CONTROL_HZ) <= until_ns:
            self._step()

    def fly_to(self, t_ns: int) -> Trajectory:
        """Advance to a time of the flight and return the pose then [ns]."""
        self.advance(t_ns)
        one = (self.position, self.quat_xyzw, self.velocity, self.spin)
        return Trajectory(np.array([self.t_ns]), *(row[None] for row in one))

    def release(self, *, landed: bool) -> None:
        """Do nothing: nobody else flies it."""

    def _step(self) -> None:
        import mujoco

        collisions, tables = self._collisions, self._tables
        row = min(self.steps, self._rows - 1)
        collisions.update(row)
        data = collisions.data
        self._steer(1 / CONTROL_HZ)
        command(tables.vehicle(data.qpos, data.qvel, self._memory), self._track, 0, 1 / CONTROL_HZ)
        for _ in range(CONTROL_EVERY):
            wrench(data.qpos, data.qvel, self._memory, tables.plane, tables.rotors, self._wind[row], 1 / PHYSICS_HZ,
                   data.qfrc_applied)  # fmt: skip
            mujoco.mj_step(collisions.model, data)
            if collisions.near and data.ncon:
                collisions.record_contacts(self.steps)
        self.steps += 1

    def _steer(self, dt: float) -> None:
        """Move the reference on by one control step."""
        row, wish, data = self._track[0], self.wish, self._collisions.data
        row[13] = wish.turn(row[12])
        row[12] += row[13] * dt
        if wish.force_n is not None:
            cos, sin = math.cos(row[12]), math.sin(row[12])
            forward, left, up = (f / self._mass_kg for f in wish.force_n)
            row[0:3], row[3:6] = data.qpos[:3], data.qvel[:3]  # nothing to track: the force alone decides
            row[6:9] = forward * cos - left * sin, forward * sin + left * cos, up
            return
        wanted = wish.velocity(row[:3], row[12])
        for k in range(3):
            push = min(max((wanted[k] - row[3 + k]) / _SPEED_S, -_ACCELERATION_M_S2), _ACCELERATION_M_S2)
            row[6 + k] += (push - row[6 + k]) * dt / _SMOOTH_S
            row[k] += row[3 + k] * dt + 0.5 * row[6 + k] * dt * dt
            row[3 + k] += row[6 + k] * dt


def _climb(wanted_m_s: float) -> float:
    return min(max(wanted_m_s, -_CLIMB_M_S), _CLIMB_M_S)
