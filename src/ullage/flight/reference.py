"""Make a smooth reference through waypoints: straight segments at even speed, filtered by moving averages.

Three moving averages over a piecewise linear motion give continuous position, velocity, acceleration and jerk, in
closed form, never faster than the legs and never outside their hull [BiagiottiMelchiorri2012]. Where the raw motion
rests for as long as the filters are, the smooth one passes exactly through the point; elsewhere it rounds the corner.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from ullage.arrays import Floats
from ullage.errors import InputError
from ullage.flight.missions import Waypoints

LONGEST_S = 14400.0
"""Longest mission [s]: its control samples take 0.4 GB."""


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Reference of the controller, at an even rate."""

    rate_hz: float
    track: Floats  # (n, 14): position, velocity, acceleration, jerk, yaw, yaw rate


@dataclass(frozen=True, slots=True)
class _Schedule:
    times: Floats  # (k) [s] when each point is reached, and left: two entries per point
    points: Floats  # (k, 3) [m]


def plan(waypoints: Waypoints, *, rate_hz: float, start: Floats | None = None, start_yaw_deg: float = 0.0) -> Reference:
    """Make the reference for a mission.

    Args:
        waypoints: the mission.
        rate_hz: samples per second [Hz].
        start: position of the drone at the start (3) [m]; None: the first waypoint.
        start_yaw_deg: heading held by yaw="hold" [deg].

    Raises:
        InputError: the mission takes more than four hours.
    """
    goals = _headings(waypoints, start, start_yaw_deg)
    points = waypoints.points if start is None else np.vstack([start, waypoints.points])
    boxes = _boxes(waypoints, points)
    rate = math.radians(waypoints.yaw_rate_deg_s)
    legs = _schedule(waypoints, points, goals, sum(boxes), rate)
    turns = _turns(waypoints, legs, goals, rate)
    duration_s = float(max(legs.times[-1], turns[-1, 0]) + sum(boxes))
    if duration_s > LONGEST_S:
        raise InputError(f"the mission takes {duration_s:.3g} s", where="Waypoints", allowed=f"up to {LONGEST_S:.0f} s")
    count = math.ceil(duration_s * rate_hz) + 1
    t_s = np.arange(count) / rate_hz
    track = np.empty((count, 14))
    for k, part in enumerate(_smooth(t_s, legs.times, legs.points, boxes)):
        track[:, 3 * k : 3 * k + 3] = part
    yaw = _smooth(t_s, turns[:, 0], turns[:, 1:], boxes)
    track[:, 12:13], track[:, 13:14] = yaw[0], yaw[1]
    if waypoints.wander is not None:
        _stray(track, waypoints.wander.at(t_s), t_s)
    return Reference(rate_hz, track)


def _headings(mission: Waypoints, start: Floats | None, start_yaw_deg: float) -> Floats:
    """Return the unwrapped goal heading at each point [rad], with the start; "along": of the segment that leaves it."""
    points = mission.points if start is None else np.vstack([start, mission.points])
    if isinstance(mission.yaw, str):
        legs = np.diff(points, axis=0)
        level = np.hypot(legs[:, 0], legs[:, 1]) > 1e-6
        if mission.yaw == "hold" or not level.any():
            return np.full(len(points), math.radians(start_yaw_deg))
        angle = np.arctan2(legs[:, 1], legs[:, 0])
        last = np.maximum.accumulate(np.where(level, np.arange(len(legs)), -1))
        angle = angle[np.where(last < 0, np.argmax(level), last)]
        goals = np.append(angle, angle[-1])
    else:
        goals = np.radians(np.broadcast_to(np.asarray(mission.yaw, float), (len(mission),)))
        goals = goals if start is None else np.append(math.radians(start_yaw_deg), goals)
    return np.asarray(np.unwrap(goals))


def _boxes(mission: Waypoints, points: Floats) -> tuple[float, float, float]:
    """Widths of the three moving averages [s]: the first sets the acceleration, the others the jerk."""
    legs = np.diff(points, axis=0)
    length = np.linalg.norm(legs, axis=1, keepdims=True)
    speed = np.where(length > 0, mission.speed_m_s * legs / np.maximum(length, 1e-12), 0.0)
    if not mission.stop and mission.hold_s == 0 and len(speed) > 1:
        change = max(mission.speed_m_s, float(np.linalg.norm(np.diff(speed, axis=0), axis=1).max()))
    else:
        change = mission.speed_m_s
    first = max(change / mission.acceleration_m_s2, 0.3)
    return first, first / 2, first / 2


def _schedule(mission: Waypoints, points: Floats, goals: Floats, settle_s: float, rate: float) -> _Schedule:
    """When the raw motion reaches and leaves each point."""
    stops = mission.stop or mission.hold_s > 0
    along = isinstance(mission.yaw, str)
    times, now = [], 0.0
    for i in range(len(points)):
        turn = abs(goals[i] - goals[i - 1]) / rate if i else 0.0
        if i:
            leg = float(np.linalg.norm(points[i] - points[i - 1])) / mission.speed_m_s
            now += max(leg, 1e-9 if along else max(turn, 1e-9))  # two points may be one
        times.append(now)
        last = i == len(points) - 1
        if (i or len(points) == 1) and mission.hold_s > 0:
            now += mission.hold_s
        if stops and i and not last:
            now += settle_s + (turn if along else 0.0)
        now += 1e-9
        times.append(now)
    return _Schedule(np.asarray(times), np.repeat(points, 2, axis=0))


def _turns(mission: Waypoints, legs: _Schedule, goals: Floats, rate: float) -> Floats:
    """Knots (k, 2) of the raw heading: time [s] and angle [rad], nowhere steeper than the rate."""
    arrive, leave = legs.times[::2], legs.times[1::2]
    if not isinstance(mission.yaw, str):
        return np.stack([legs.times, np.repeat(goals, 2)], axis=1)
    knots = [(-1.0, float(goals[0]))]
    for i in range(1, len(goals)):
        needs = abs(goals[i] - knots[-1][1]) / rate
        if needs < 1e-9:
            continue
        begin = max((arrive[i] + leave[i] - needs) / 2, knots[-1][0], 0.0)
        knots += [(begin + 1e-9, knots[-1][1]), (begin + 1e-9 + needs, float(goals[i]))]
    return np.asarray([*knots, (knots[-1][0] + 1.0, knots[-1][1])])


def _smooth(t_s: Floats, knots_s: Floats, values: Floats, boxes: tuple[float, float, float]) -> list[Floats]:
    """Piecewise linear motion (at rest before and after) through the filters: value and three derivatives, (n, d) each.

    A bend of the raw motion adds a ramp; filtered, it is a polynomial spline for as long as the filters are wide, and
    the same ramp half that width later after that.
    """
    slope = np.diff(values, axis=0) / np.diff(knots_s)[:, None]
    bend = np.diff(slope, axis=0, prepend=0.0 * slope[:1], append=0.0 * slope[:1])
    width = sum(boxes)
    n, d = len(t_s), values.shape[1]
    out = [np.zeros((n, d)) for _ in range(4)]
    began = np.searchsorted(t_s, knots_s)
    done = np.searchsorted(t_s, knots_s + width)
    jump, lag = np.zeros((n + 1, d)), np.zeros((n + 1, d))
    np.add.at(jump, done, bend)
    np.add.at(lag, done, bend * (knots_s + width / 2)[:, None])
    out[1] += np.cumsum(jump, axis=0)[:n]
    out[0] += values[0] + out[1] * t_s[:, None] - np.cumsum(lag, axis=0)[:n]
    shifts = [(sum(c), (-1) ** sum(x > 0 for x in c)) for c in itertools.product(*((0.0, b) for b in boxes))]
    scale = 1 / math.prod(boxes)
    for k in np.flatnonzero(np.abs(bend).max(1) > 0):
        part = slice(began[k], done[k])
        x = t_s[part] - knots_s[k]
        for order in range(4):
            power = 4 - order
            ramp = sum(sign * np.maximum(x - c, 0.0) ** power for c, sign in shifts) * scale / math.factorial(power)
            out[order][part] += np.multiply.outer(ramp, bend[k])
    return out


def _stray(track: Floats, offset: Floats, t_s: Floats) -> None:
    """Adds wander (4, n, 4), faded in and out over two seconds so that the flight starts and ends at rest."""
    total = float(t_s[-1])
    span = min(2.0, total / 2)
    fade = _fade(t_s / span) * _fade((total - t_s) / span)
    blend = [fade]
    for _ in range(3):
        blend.append(np.gradient(blend[-1], t_s))
    for order in range(4):
        mixed = sum(
            math.comb(order, j) * blend[j][:, None] * offset[order - j] for j in range(order + 1)
        )  # Leibniz: the derivative of the product
        track[:, 3 * order : 3 * order + 3] += mixed[:, :3]
        if order < 2:
            track[:, 12 + order] += mixed[:, 3]


def _fade(x: Floats) -> Floats:
    """0 to 1 over 0..1, with four continuous derivatives."""
    u = np.clip(x, 0.0, 1.0)
    return np.asarray(u**5 * (126 + u * (-420 + u * (540 + u * (-315 + 70 * u)))))
