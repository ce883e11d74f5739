"""Stand-ins for the two autopilots: velocity limits by OBSTACLE_DISTANCE alone, as their documents and sources say.

Velocities are (forward, right) in the body's frame [m/s]. Parameters have the autopilots' own names.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from pymavlink.dialects.v20 import common as mav

UNKNOWN, STALE_S = 65535, 0.5


class Brake(Protocol):
    """What limits a wanted velocity."""

    def take(self, message: Any, now_s: float) -> None:
        """Take an OBSTACLE_DISTANCE."""

    def velocity(self, wish: Any, now: Any, now_s: float) -> Any:
        """The velocity (2) that is flown instead of the wanted one, with the present one and the time."""


@dataclass
class Px4Brake:
    """PX4's collision prevention [PX4Collision]: a limit for each bin that the wish moves towards.

    Bins are 10 degrees wide up to version 1.14 and 5 degrees since.
    """

    cp_dist: float = 1.0  # [m]
    cp_delay: float = 0.4  # [s]
    cp_guide_ang: float = 0.0  # [deg]
    cp_go_no_data: bool = False
    bins: int = 72
    acc_hor: float = 3.0  # [m/s^2]
    jerk_max: float = 8.0  # [m/s^3]
    element: Any = None  # (bins) [cm]
    limits: tuple[int, int] = (0, 0)
    came_s: float = -math.inf

    def take(self, message: Any, now_s: float) -> None:
        assert message.frame == mav.MAV_FRAME_BODY_FRD
        assert message.increment_f == 5.0
        self.element = np.array(message.distances)[:: 72 // self.bins]
        self.limits, self.came_s = (message.min_distance, message.max_distance), now_s

    def velocity(self, wish: Any, now: Any, now_s: float) -> Any:
        speed = float(np.hypot(*wish))
        if now_s - self.came_s > STALE_S or not speed:
            return np.zeros(2)
        step = 2 * math.pi / self.bins
        towards = self._guided(round(math.atan2(wish[1], wish[0]) / step) % self.bins)
        if self.element[towards] == UNKNOWN and not self.cp_go_no_data:
            return np.zeros(2)
        ahead = np.array([math.cos(towards * step), math.sin(towards * step)])
        most = speed
        for k in np.flatnonzero(self.element != UNKNOWN):
            bearing = np.array([math.cos(k * step), math.sin(k * step)])
            if (along := float(ahead @ bearing)) > 1e-6:
                most = min(most, self._most_m_s(int(self.element[k]), max(float(now @ bearing), 0.0), now_s) / along)
        return most * ahead

    def _guided(self, towards: int) -> int:
        """The bin within CP_GUIDE_ANG that costs least: far from obstacles, and near the wish."""
        reach = math.floor(self.cp_guide_ang / (360 / self.bins))
        cm = np.where(self.element == UNKNOWN, 0, self.element).astype(float)

        def cost(off: int) -> float:
            k = (towards + off) % self.bins
            return 9.0 * abs(off) - float(np.mean([cm[(k + n) % self.bins] for n in (-1, 0, 1)])) - float(cm[k])

        return (towards + min(range(-reach, reach + 1), key=cost)) % self.bins

    def _most_m_s(self, cm: int, speed_m_s: float, now_s: float) -> float:
        least, most = self.limits
        assert cm > least  # PX4 leaves the others out
        delay_s = self.cp_delay + (now_s - self.came_s if cm < most else 0.0)
        stop_m = max(0.0, cm / 100 - max(self.cp_dist, least / 100) - speed_m_s * delay_s)
        b = 4 * self.acc_hor**2 / self.jerk_max  # v^2 / (2 a) + v a / j = s with PX4's margin on the jerk
        return 0.5 * (-b + math.sqrt(b * b + 8 * self.acc_hor * stop_m))


@dataclass
class ArduPilotBrake:
    """ArduPilot's simple avoidance [ArduPilotProximity]: eight filtered sectors, a boundary between them, a margin.

    The boundary's points lie between sectors, at the lesser of both distances. Each side of it within the margin and
    ahead limits the part of the velocity towards it (BEHAVE 0: slide); one that is nearer pushes back. Without
    distances for 0.5 s, or in a sector without any, it flies on.
    """

    margin: float = 1.5  # AVOID_MARGIN [m]
    backup_spd: float = 0.75  # AVOID_BACKUP_SPD [m/s]
    backup_dz: float = 0.1  # AVOID_BACKUP_DZ [m]
    accel_max: float = 3.0  # AVOID_ACCEL_MAX [m/s^2]
    filt_hz: float = 0.25  # PRX_FILT; 0: none
    gain: float = 1.0  # of the position controller [1/s]
    came_s: float = -math.inf
    sector: Any = field(default_factory=lambda: np.full(8, np.nan))  # filtered [m]
    valid: Any = field(default_factory=lambda: np.zeros(8, bool))
    last: Any = field(default_factory=lambda: np.zeros(2))
    limited_s: float = -math.inf

    def take(self, message: Any, now_s: float) -> None:
        cm = np.array(message.distances)
        used = (cm != UNKNOWN) & (cm >= message.min_distance) & (cm <= message.max_distance)
        sector = ((5.0 * np.arange(72) + 22.5) % 360 // 45).astype(int)
        for k in range(8):
            mine = used & (sector == k)
            self.valid[k] = mine.any()
            if mine.any():
                nearest, step_s = cm[mine].min() / 100, now_s - self.came_s
                share = 1.0 if step_s > 1.0 or np.isnan(self.sector[k]) or not self.filt_hz else step_s / (
                    step_s + 1 / (2 * math.pi * self.filt_hz))  # fmt: skip
                self.sector[k] = nearest if share == 1.0 else self.sector[k] + share * (nearest - self.sector[k])
        self.came_s = now_s

    def obstacles(self) -> list[Any]:
        """The nearest point (2) of each side of the boundary to the vehicle [m]."""
        seen = np.where(self.valid, self.sector, np.inf)
        edge = np.minimum(seen, np.roll(seen, -1))  # between sector k and the next one clockwise
        cup = [edge[k] if np.isfinite(edge[k]) else min(edge[k - 1], edge[(k + 1) % 8]) for k in range(8)]
        angle = np.radians(45.0 * np.arange(8) + 22.5)
        point = np.maximum(np.where(np.isfinite(cup), cup, 100.0), 0.6)[:, None] * np.stack(
            [np.cos(angle), np.sin(angle)], axis=1
        )
        found = []
        for k in range(8):
            if not any(self.valid[(k + n) % 8] for n in range(3)):
                continue
            a, b = point[(k + 1) % 8], point[k]
            found.append(a + np.clip(a @ (a - b) / max((b - a) @ (b - a), 1e-9), 0, 1) * (b - a))
        return found

    def velocity(self, wish: Any, now: Any, now_s: float, step_s: float = 0.01) -> Any:
        out, push = np.array(wish, float), np.zeros((2, 2))
        for to in self.obstacles() if now_s - self.came_s <= STALE_S else ():
            away = float(np.hypot(*to))
            unit = to / away
            if self.margin - away > self.backup_dz:
                back = -unit * self._speed(self.margin - away, 0.4)
                push = np.stack([np.minimum(push[0], back), np.maximum(push[1], back)])
            if np.hypot(*wish):
                out += unit * min(self._speed(max(away - self.margin, 0.0), 1.0) - float(out @ unit), 0.0)
        back = push.sum(0)
        if self.backup_spd and (speed := float(np.hypot(*back))):
            back = back * min(1.0, self.backup_spd / speed)
            out = np.where(back > 0, np.maximum(out, back), np.where(back < 0, np.minimum(out, back), out))
        return self._smooth(np.array(wish, float), out, now_s, step_s)

    def _smooth(self, wish: Any, out: Any, now_s: float, step_s: float) -> Any:
        if np.array_equal(wish, out):
            return out
        if now_s - self.limited_s > 0.2:
            self.last = wish
        change, most = out - self.last, self.accel_max * step_s
        if (size := float(np.hypot(*change))) > most:
            out = self.last + change * most / size
        self.last, self.limited_s = out, now_s
        return out

    def _speed(self, distance_m: float, accel_m_s2: float) -> float:
        """From which it stops within a distance: linear near the end, then at a constant deceleration."""
        linear_m = accel_m_s2 / self.gain**2
        if distance_m <= linear_m:
            return distance_m * self.gain
        return math.sqrt(2 * accel_m_s2 * (distance_m - linear_m / 2))
