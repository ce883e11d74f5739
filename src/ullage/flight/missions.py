"""Where a drone is asked to fly: waypoints, and missions made of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ullage.errors import InputError
from ullage.flight.wander import Wander

Floats = NDArray[np.float64]
Yaw = Literal["along", "hold"] | float | Sequence[float]


@dataclass(frozen=True, slots=True, eq=False)
class Waypoints:
    """Points to fly through in order, at an even speed, from rest to rest.

    Args:
        points: (n, 3) x, y, z [m] world ENU, or (n, 4) with yaw [deg] last.
        speed_m_s: speed on the straights [m/s].
        yaw: "along" looks where it flies, "hold" keeps the heading of the start, a number is a heading [deg] for the
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
    angles = np.asarray(yaw, float)
    if angles.ndim > 1 or (angles.ndim == 1 and len(angles) != count):
        raise InputError(f"yaw has shape {angles.shape} for {count} points", where="Waypoints", allowed=f"({count},)")
    if not np.isfinite(angles).all():
        raise InputError("yaw is not finite", where="Waypoints")
    return float(angles) if angles.ndim == 0 else tuple(angles.tolist())


def erratic(waypoints: Waypoints, seed: int = 0, **changes: float) -> Waypoints:
    """The same mission flown by hand: with smooth random wander in place, height and heading.

    Args:
        waypoints: the mission meant.
        seed: which hand.
        changes: fields of `Wander`: lateral_m, vertical_m, yaw_deg, pace_s.
    """
    return replace(waypoints, wander=Wander(seed=seed, **changes))
