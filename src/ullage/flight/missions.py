"""Waypoints of a flight, and missions made of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, overload

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from ullage import checks
from ullage.arrays import Floats
from ullage.data import Trajectory
from ullage.errors import InputError, shown
from ullage.flight.wander import Wander
from ullage.world.scene import Scene
from ullage.world.section import section, wire_section

Yaw = Literal["along", "hold"] | float | Sequence[float]


@dataclass(frozen=True, slots=True, eq=False)
class Waypoints:
    """Points to fly through in order, at an even speed, from rest to rest.

    Args:
        points: (n, 3) x, y, z [m] world ENU, or (n, 4) with yaw [deg] last.
        speed_m_s: speed on the straights [m/s].
        yaw: "along" points along the flight, "hold" keeps the heading of the start, a number is a heading [deg] for the
            whole flight, a list is one heading [deg] per point, turned evenly between them.
        stop: halts at every point and passes exactly through it; otherwise corners are rounded.
        hold_s: how long it hovers at each point [s]; above zero it stops there.
        acceleration_m_s2: of starts, stops and corners; a smaller one rounds corners more [m/s^2].
        yaw_rate_deg_s: fastest turn [deg/s]; where a leg is too short for its turn, the leg takes longer.
        wander: how the flight strays from the track, as under a human hand.

    Raises:
        InputError: a value is not finite, out of bounds, or of the wrong shape.
    """

    points: Floats
    speed_m_s: float = 0.5
    yaw: Yaw = field(default="along", kw_only=True)
    stop: bool = field(default=False, kw_only=True)
    hold_s: float = field(default=0.0, kw_only=True)
    acceleration_m_s2: float = field(default=0.8, kw_only=True)
    yaw_rate_deg_s: float = field(default=45.0, kw_only=True)
    wander: Wander | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        points = _points(self.points)
        for name, low in (("speed_m_s", 0.0), ("acceleration_m_s2", 0.0), ("yaw_rate_deg_s", 0.0), ("hold_s", -1e-300)):
            value = getattr(self, name)
            if not (isinstance(value, int | float) and math.isfinite(value) and value > low):
                raise InputError(f"{name} is {value!r}", where="Waypoints", allowed=">= 0" if low < 0 else "> 0")
        if points.shape[1] == 4:
            if self.yaw != "along":
                raise InputError("yaw is given twice", where="Waypoints", allowed="a fourth column or yaw=, not both")
            object.__setattr__(self, "yaw", tuple(points[:, 3].tolist()))
        if self.wander is not None and not isinstance(self.wander, Wander):
            raise InputError(f"wander is {shown(self.wander)}", where="Waypoints", allowed="a Wander, or None")
        object.__setattr__(self, "points", points[:, :3].copy())
        object.__setattr__(self, "yaw", _yaw(self.yaw, len(points)))

    def __len__(self) -> int:
        return len(self.points)

    @property
    def length_m(self) -> float:
        """Length of the straight lines between the points [m]."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())


def _points(value: ArrayLike) -> Floats:
    try:
        points = np.array(value, float)
    except (TypeError, ValueError):
        raise InputError(
            "points are not numbers in rows of equal length", where="Waypoints", allowed="(n, 3) or (n, 4)"
        ) from None
    if points.ndim == 1 and points.size in (3, 4):
        points = points[None]
    if points.ndim != 2 or points.shape[1] not in (3, 4) or len(points) < 1:
        raise InputError(
            f"points have shape {points.shape}", where="Waypoints",
            allowed="at least one row of x, y, z [m], with yaw [deg] as a fourth column or not",
        )  # fmt: skip
    bad = np.flatnonzero(~np.isfinite(points).all(1))
    if bad.size:
        raise InputError(f"waypoint {bad[0]} is not finite: {points[bad[0]].tolist()}", where="Waypoints")
    if np.abs(points[:, :3]).max() > 1e5:
        far = int(np.argmax(np.abs(points[:, :3]).max(1)))
        raise InputError(
            f"waypoint {far} is {points[far].tolist()}", where="Waypoints", allowed="within 100 km of the origin"
        )
    return points


def _yaw(yaw: Yaw, count: int) -> Yaw:
    if isinstance(yaw, str):
        if yaw not in ("along", "hold"):
            raise InputError(f"yaw is {yaw!r}", where="Waypoints", allowed='"along", "hold", degrees, or one per point')
        return yaw
    angles = checks.array("yaw", yaw)
    if angles.ndim > 1 or (angles.ndim == 1 and len(angles) != count):
        raise InputError(f"yaw has shape {angles.shape} for {count} points", where="Waypoints", allowed=f"({count},)")
    if not np.isfinite(angles).all():
        raise InputError("yaw is not finite", where="Waypoints")
    return float(angles) if angles.ndim == 0 else tuple(angles.tolist())


@overload
def erratic(mission: Waypoints, seed: int = 0, **changes: float) -> Waypoints: ...
@overload
def erratic(mission: Trajectory, seed: int = 0, **changes: float) -> Trajectory: ...
def erratic(mission: Waypoints | Trajectory, seed: int = 0, **changes: float) -> Waypoints | Trajectory:
    """Return a flight as flown by hand: with smooth random wander in place, height and heading.

    Args:
        mission: waypoints (the vehicle then flies the wander too), or a finished path, which is moved as it is.
        seed: which hand.
        changes: fields of `Wander`: lateral_m, vertical_m, yaw_deg, pace_s.
    """
    wander = Wander(seed=seed, **changes)
    if isinstance(mission, Waypoints):
        return replace(mission, wander=wander)
    offset = wander.at(mission.t_ns * 1e-9)
    velocity, spin = mission.rates
    up = np.array([0.0, 0.0, 1.0])
    attitude = Rotation.from_quat(mission.quat_xyzw)
    return Trajectory(
        mission.t_ns,
        mission.position + offset[0, :, :3],
        (Rotation.from_rotvec(np.outer(offset[0, :, 3], up)) * attitude).as_quat(),
        velocity + offset[1, :, :3],
        spin + attitude.inv().apply(np.outer(offset[1, :, 3], up)),
    )


def hover(point_m: Sequence[float], duration_s: float, *, yaw_deg: float = 0.0) -> Waypoints:
    """Stays at one point (3) [m] for a time [s]."""
    if not (math.isfinite(duration_s) and duration_s > 0):
        raise InputError(f"duration_s is {duration_s}", where="hover", allowed="> 0")
    return Waypoints(np.asarray([point_m], float), yaw=yaw_deg, hold_s=duration_s)


def lawnmower(
    corner_m: Sequence[float],
    opposite_m: Sequence[float],
    spacing_m: float,
    *,
    speed_m_s: float = 0.5,
    yaw: Yaw = "along",
) -> Waypoints:
    """Covers a rectangle in parallel rows along its longer side, turning at each end.

    Args:
        corner_m: where it begins: x, y, z [m]; its height is that of the flight.
        opposite_m: the far corner: x, y [m].
        spacing_m: greatest distance between rows [m].
        speed_m_s: [m/s].
        yaw: as in `Waypoints`.

    Raises:
        InputError: the spacing is not above zero, or a corner is not finite.
    """
    _above_zero("lawnmower", spacing_m=spacing_m)
    x0, y0, z = (float(v) for v in corner_m)
    x1, y1 = (float(v) for v in opposite_m[:2])
    swap = abs(y1 - y0) > abs(x1 - x0)
    u0, u1, v0, v1 = (y0, y1, x0, x1) if swap else (x0, x1, y0, y1)
    rows = np.linspace(v0, v1, max(math.ceil(abs(v1 - v0) / spacing_m - 1e-9), 0) + 1)
    ends = [((u0, u1) if i % 2 == 0 else (u1, u0), row) for i, row in enumerate(rows)]
    points = [(v, u, z) if swap else (u, v, z) for pair, v in ends for u in pair]
    return Waypoints(np.asarray(points), speed_m_s, yaw=yaw)


def orbit(
    centre_m: Sequence[float], radius_m: float, *, turns: float = 1.0, speed_m_s: float = 0.5, begin_deg: float = 0.0
) -> Waypoints:
    """Circles a point (3) [m] at its height, looking at it; turns below zero go clockwise.

    Raises:
        InputError: the radius is not above zero, or there are no turns.
    """
    _above_zero("orbit", radius_m=radius_m, turns=abs(turns))
    steps = max(math.ceil(abs(turns) * 48), 1)
    angle = math.radians(begin_deg) + np.linspace(0, 2 * np.pi * turns, steps + 1)
    x, y, z = (float(v) for v in centre_m)
    points = np.stack([x + radius_m * np.cos(angle), y + radius_m * np.sin(angle), np.full(len(angle), z)], axis=1)
    return Waypoints(points, speed_m_s, yaw=tuple(np.degrees(angle + np.pi).tolist()))


def along_walls(
    scene: Scene,
    height_m: float,
    *,
    distance_m: float = 1.0,
    inside: Sequence[float] | None = None,
    speed_m_s: float = 0.5,
    look: Literal["along", "wall"] = "along",
) -> Waypoints:
    """Return a round of a room at one height, at a distance from all surfaces at that height.

    Args:
        scene: the room.
        height_m: of the flight [m].
        distance_m: from walls and objects, measured level [m].
        inside: a point x, y [m] in the room, where there is doubt; None: the middle of the scene.
        speed_m_s: [m/s].
        look: "along" the flight, or at the "wall" on its right.

    Raises:
        InputError: there is no surface at this height, or no space to fly at this distance.
    """
    from shapely import MultiLineString, MultiPoint, Point, box
    from shapely.geometry.polygon import orient

    _above_zero("along_walls", distance_m=distance_m)
    cuts = [section(scene, height_m + dz) for dz in (-0.2, 0.0, 0.2)]
    lines = np.concatenate(cuts)
    if not len(lines):
        raise InputError(f"nothing stands at height {height_m} m", where="along_walls")
    wires = MultiPoint(wire_section(scene, height_m, slab_m=0.2))
    taken = MultiLineString(list(lines)).union(wires).buffer(distance_m)
    low, high = lines.min((0, 1)), lines.max((0, 1))
    seed = Point((low + high) / 2 if inside is None else inside[:2])
    free = box(*(low + distance_m), *np.maximum(high - distance_m, low + distance_m)).difference(taken)
    rooms = [part for part in getattr(free, "geoms", [free]) if part.area > 0 and part.distance(seed) < distance_m]
    if not rooms:
        raise InputError(
            f"no room to fly at {height_m} m height around ({seed.x:.2f}, {seed.y:.2f}) at {distance_m} m distance",
            where="along_walls", allowed="another height, a smaller distance, or `inside` in the free space",
        )  # fmt: skip
    room = min(rooms, key=lambda part: part.distance(seed))
    ring = np.asarray(orient(room.simplify(0.03)).exterior.coords)  # to the left around the room
    points = np.column_stack([ring, np.full(len(ring), height_m)])
    return Waypoints(points, speed_m_s) if look == "along" else _facing_right(points, speed_m_s)


def _facing_right(points: Floats, speed_m_s: float) -> Waypoints:
    """Return segments flown sideways, each with its right-hand side ahead of the drone, which turns between them."""
    legs = np.diff(points, axis=0)
    yaw = np.degrees(np.arctan2(legs[:, 1], legs[:, 0])) - 90.0
    both = np.stack([points[:-1], points[1:]], axis=1).reshape(-1, 3)
    return Waypoints(np.column_stack([both, np.repeat(yaw, 2)]), speed_m_s)


def _above_zero(where: str, **values: float) -> None:
    for name, value in values.items():
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"{name} is {value}", where=where, allowed="> 0")
