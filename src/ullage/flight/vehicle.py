"""Flies a mission with a multirotor in MuJoCo [TodorovEtAl2012] and returns where it truly went."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ullage import checks
from ullage.arrays import Floats, Longs
from ullage.data import Trajectory, even_times
from ullage.errors import InputError, UllageError, UllageWarning
from ullage.flight.airframe import Airframe, airframe
from ullage.flight.control import Tables, air
from ullage.flight.missions import Waypoints
from ullage.flight.obstacles import Body, Solids, bodies, into
from ullage.flight.physics import CONTROL_EVERY, CONTROL_HZ, PHYSICS_HZ, CollisionModel, Touch
from ullage.flight.reference import Reference, plan
from ullage.kernels.flight import control, wrench
from ullage.world.scene import Scene

Progress = Callable[[float], None]


class Collision(UllageError):
    """The vehicle hit something, and the flight was asked to end there."""


@dataclass(frozen=True, slots=True)
class Contact:
    """The vehicle touched an object."""

    t_ns: int  # when the contact began
    until_ns: int  # when it was last felt
    point: tuple[float, float, float]  # where it began, world [m]
    object: str  # name of the object in contact
    speed_m_s: float  # of the vehicle when it began [m/s]

    def __str__(self) -> str:
        x, y, z = self.point
        when, speed = self.t_ns * 1e-9, self.speed_m_s
        return f"{self.object!r} at t = {when:.2f} s at ({x:.2f}, {y:.2f}, {z:.2f}) m, {speed:.2f} m/s"


@dataclass(frozen=True, slots=True, eq=False)
class FlightLog:
    """Log of a flight, at the times of its trajectory."""

    contacts: tuple[Contact, ...]
    t_ns: Longs  # (n)
    wanted: Floats  # (n, 3) position of the reference [m]
    error_m: Floats  # (n) distance from the reference [m]
    rotor_rad_s: Floats  # (n, r) rotor speeds


def fly(
    waypoints: Waypoints | ArrayLike,
    vehicle: str | Airframe = "hector",
    *,
    scene: Scene | None = None,
    wind_m_s: Sequence[float] = (0.0, 0.0, 0.0),
    gust_m_s: float = 0.0,
    rate_hz: float = 25.0,
    seed: int = 0,
    start: ArrayLike | None = None,
    on_contact: Literal["record", "raise"] = "record",
    progress: Progress | None = None,
) -> Trajectory:
    """Fly waypoints with a real multirotor: rigid body, rotor lag, drag, wind, contact, a tracking controller.

    Args:
        waypoints: a mission, or its points.
        vehicle: name of a vehicle, or an `Airframe`.
        scene: what can be hit; None: free space. Moving objects push the vehicle, but not by friction.
        wind_m_s: mean wind (3) [m/s] world.
        gust_m_s: rms of the gusts along x and y [m/s]; half of it along z.
        rate_hz: samples per second of the result [Hz].
        seed: which gusts.
        start: where it hovers at first: x, y, z [m], and yaw [deg] or not; None: at the first waypoint.
        on_contact: "record" flies on, as physics has it, and warns; "raise" ends the flight.
        progress: called with the fraction done, 0 to 1.

    Returns:
        The true path of the body, with true velocities and body rates, at `rate_hz`, from time zero.

    Raises:
        InputError: a value is out of bounds, or the start or a waypoint lies inside something or too near to it.
        Collision: something was hit, with on_contact="raise".
    """
    conditions = _Conditions(scene, wind_m_s, gust_m_s, rate_hz, seed, start, on_contact, progress)
    flown, log = _fly(waypoints, vehicle, conditions)
    _warn(log)
    return flown


def fly_log(
    waypoints: Waypoints | ArrayLike,
    vehicle: str | Airframe = "hector",
    *,
    scene: Scene | None = None,
    wind_m_s: Sequence[float] = (0.0, 0.0, 0.0),
    gust_m_s: float = 0.0,
    rate_hz: float = 25.0,
    seed: int = 0,
    start: ArrayLike | None = None,
    on_contact: Literal["record", "raise"] = "record",
    progress: Progress | None = None,
) -> tuple[Trajectory, FlightLog]:
    """Fly as `fly` does, with a log: contacts, the reference, tracking error, rotor speeds.

    Returns:
        The true path, and the log at its times.

    Raises:
        InputError: as `fly`.
        Collision: as `fly`.
    """
    conditions = _Conditions(scene, wind_m_s, gust_m_s, rate_hz, seed, start, on_contact, progress)
    flown, log = _fly(waypoints, vehicle, conditions)
    _warn(log)
    return flown, log


def _warn(log: FlightLog) -> None:
    if log.contacts:
        more = f", and {len(log.contacts) - 1} more" if len(log.contacts) > 1 else ""
        warnings.warn(f"the vehicle hit {log.contacts[0]}{more}", UllageWarning, stacklevel=3)


class _Conditions(NamedTuple):
    """The options of `fly`."""

    scene: Scene | None
    wind_m_s: Sequence[float]  # (3)
    gust_m_s: float
    rate_hz: float
    seed: int
    start: ArrayLike | None  # x, y, z [m], and yaw [deg] or not
    on_contact: str
    progress: Progress | None


def _fly(waypoints: Waypoints | ArrayLike, vehicle: str | Airframe, given: _Conditions) -> tuple[Trajectory, FlightLog]:
    mission = waypoints if isinstance(waypoints, Waypoints) else Waypoints(checks.array("waypoints", waypoints))
    frame, scene = airframe(vehicle), given.scene
    if scene is not None and not isinstance(scene, Scene):
        raise InputError(f"scene is a {type(scene).__name__}", where="fly", allowed="a Scene, or None")
    checks.whole("seed", given.seed, "fly", low=0)
    wind = _checked(given.wind_m_s, given.gust_m_s, given.rate_hz, given.on_contact)
    place, yaw_deg = _start(given.start)
    parts = bodies(scene) if scene is not None else []
    if scene is not None:
        _clear(mission, place, frame, scene, parts)
    reference = plan(mission, rate_hz=CONTROL_HZ, start=place, start_yaw_deg=yaw_deg)
    blowing = air(wind, given.gust_m_s, count=len(reference.track), rate_hz=CONTROL_HZ, seed=given.seed)
    collisions = CollisionModel(frame, parts, len(reference.track))
    table = integrate(frame, reference, blowing, collisions, scene, given.on_contact, given.progress)
    contacts = tuple(_contact(touch, scene) for touch in collisions.touches) if scene is not None else ()
    return _result(table, reference, contacts, given.rate_hz)


def integrate(
    frame: Airframe, reference: Reference, wind: Floats, collisions: CollisionModel, scene: Scene | None,
    on_contact: str, progress: Progress | None,
) -> Floats:  # fmt: skip
    """Fly along a reference: sense, control, push, integrate. Return the state (n, 13 + rotors) at each control step.

    Raises:
        Collision: the vehicle hits something of the scene, and `on_contact` is "raise".
    """
    import mujoco

    tables, first, dt = Tables.of(frame), reference.track[0], 1 / PHYSICS_HZ
    collisions.data.qpos[:] = [*first[:3], math.cos(first[12] / 2), 0, 0, math.sin(first[12] / 2)]
    memory, track = tables.memory(frame.hover_rad_s), reference.track
    log = np.zeros((len(track), 13 + len(tables.rotors)))
    plane, rotors, period, mj_step = tables.plane, tables.rotors, dt * CONTROL_EVERY, mujoco.mj_step
    for row in range(len(track)):
        if collisions.update(row) or row == 0:
            model, data = collisions.model, collisions.data
            qpos, qvel, push = data.qpos, data.qvel, data.qfrc_applied
            body = tables.vehicle(qpos, qvel, memory)
        control(body, track, row, period, log)
        near, blowing = collisions.near, wind[row]
        for _ in range(CONTROL_EVERY if row < len(track) - 1 else 1):
            wrench(qpos, qvel, memory, plane, rotors, blowing, dt, push)
            mj_step(model, data)
            if near and data.ncon:
                collisions.record_contacts(row)
                if on_contact == "raise" and scene is not None:
                    raise Collision(f"the vehicle hit {_contact(collisions.touches[0], scene)}")
        if progress is not None and row % CONTROL_HZ == 0:
            progress(row / len(track))
    if progress is not None:
        progress(1.0)
    return log


def _contact(touch: Touch, scene: Scene) -> Contact:
    period = 1e9 / CONTROL_HZ
    name = scene.objects[touch.owner].name
    return Contact(round(touch.step * period), round(touch.last * period), touch.point, name, touch.speed)


def _result(
    table: Floats, reference: Reference, contacts: tuple[Contact, ...], rate_hz: float
) -> tuple[Trajectory, FlightLog]:
    t_ns = even_times(CONTROL_HZ, count=len(table))
    whole = Trajectory(t_ns, table[:, :3], table[:, [4, 5, 6, 3]], table[:, 7:10], table[:, 10:13])
    flown = whole.resampled(rate_hz)
    wanted = np.stack([np.interp(flown.t_ns, t_ns, reference.track[:, k]) for k in range(3)], axis=1)
    rotors = np.stack([np.interp(flown.t_ns, t_ns, column) for column in table[:, 13:].T], axis=1)
    error = np.linalg.norm(flown.position - wanted, axis=1)
    return flown, FlightLog(contacts, flown.t_ns, wanted, error, rotors)


def _checked(wind_m_s: Sequence[float], gust_m_s: float, rate_hz: float, on_contact: str) -> Floats:
    wind = checks.array("wind_m_s", wind_m_s)
    if wind.shape != (3,) or not np.isfinite(wind).all() or np.linalg.norm(wind) > 60:
        raise InputError(f"wind_m_s is {wind_m_s}", where="fly", allowed="three finite numbers, at most 60 m/s")
    if not 0 <= checks.number("gust_m_s", gust_m_s, "fly", allowed="0 .. 30") <= 30:
        raise InputError(f"gust_m_s is {gust_m_s}", where="fly", allowed="0 .. 30")
    if not 0 < checks.number("rate_hz", rate_hz, "fly", allowed="above 0, at most 10000") <= 1e4:
        raise InputError(f"rate_hz is {rate_hz}", where="fly", allowed="above 0, at most 10000")
    if on_contact not in ("record", "raise"):
        raise InputError(f"on_contact is {on_contact!r}", where="fly", allowed='"record", "raise"')
    return wind


def _start(start: ArrayLike | None) -> tuple[Floats | None, float]:
    if start is None:
        return None, 0.0
    place = checks.array("start", start)
    if place.shape not in ((3,), (4,)) or not np.isfinite(place).all():
        raise InputError(f"start is {start}", where="fly", allowed="x, y, z [m], and yaw [deg] or not, all finite")
    return place[:3], float(place[3]) if len(place) == 4 else 0.0


def check_clear(start: ArrayLike, vehicle: str | Airframe, scene: Scene) -> None:
    """Check that a vehicle can hover at its start.

    Args:
        start: x, y, z [m] and, if given, yaw [deg].
        vehicle: name of a vehicle, or an `Airframe`.
        scene: its obstacles.

    Raises:
        InputError: the start is inside a solid or nearer to a surface than the vehicle reaches, or the vehicle unknown.
    """
    _clear(None, _start(start)[0], airframe(vehicle), scene, bodies(scene))


def _clear(mission: Waypoints | None, place: Floats | None, frame: Airframe, scene: Scene, parts: list[Body]) -> None:
    """Refuses a start or waypoint inside a solid or nearer to a surface than the vehicle reaches, level."""
    points = () if mission is None else mission.points
    spots = [(f"waypoint {i}", point) for i, point in enumerate(points)]
    if place is not None:
        spots.insert(0, ("the start", place))
    squash = frame.radius_m / frame.half_height_m
    for part in parts:
        checked = spots if part.motion is None else spots[:1]  # the future place of a moving object is not known here
        solids = Solids(part)
        local = [into(part, point, 0) for _, point in checked]
        held = [solids.holding(point) for point in local]
        around_all = set.intersection(*held) if part.motion is None else set()
        if around_all:
            names = ", ".join(sorted({scene.objects[owner].name for _, owner in around_all}))
            warnings.warn(
                f"the whole mission is inside {names}, taken for the hull of a tank", UllageWarning, stacklevel=4
            )
        for (what, point), here, inside in zip(checked, local, held, strict=True):
            where = f"{what} at ({', '.join(f'{v:.2f}' for v in point)}) m"
            for _, owner in inside - around_all:
                raise InputError(f"{where} is inside {scene.objects[owner].name!r}", where="fly")
            index, gap, near = part.gaps(here, frame.radius_m, squash=squash)
            if len(gap) and gap.min() < frame.radius_m:
                best = int(gap.argmin())
                name = scene.objects[part.owner_of(int(index[best]))].name
                raise InputError(
                    f"{where} is {np.linalg.norm(near[best] - here):.2f} m from {name!r}", where="fly",
                    allowed=f"{frame.radius_m:.2f} m to the side, {frame.half_height_m:.2f} m up and down",
                )  # fmt: skip
