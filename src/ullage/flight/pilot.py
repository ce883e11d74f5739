"""Fly by hand: velocity commands that go stale, and position set-points, as requests to a steered vehicle.

Axes are forward, left and up in the level frame of the vehicle's heading, as of `cmd_vel` in ROS (REP-103). No clock
is read here: whoever calls gives the time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from pydantic import Field

from ullage.flight.live import Wish
from ullage.specs import Spec


class PilotOptions(Spec):
    """Limits of flight by hand."""

    timeout_s: float = Field(0.5, gt=0, le=60, description="without a new velocity command for so long: hover")
    speed_m_s: float = Field(1.0, gt=0, le=10, description="greatest level speed; a command beyond is scaled down")
    climb_m_s: float = Field(1.0, gt=0, le=1, description="greatest climb")
    turn_deg_s: float = Field(60.0, gt=0, le=60, description="greatest turn rate")


class Velocity(NamedTuple):
    """A velocity command."""

    forward_m_s: float = 0.0
    left_m_s: float = 0.0
    up_m_s: float = 0.0
    turn_rad_s: float = 0.0  # counter-clockwise


HOVER = Velocity()


@dataclass(slots=True)
class Pilot:
    """Keeps the last command and gives what to ask of the vehicle now.

    A velocity holds until the next command, at most `timeout_s`; then the vehicle hovers. A set-point holds until the
    next command, since a vehicle that has reached it hovers there.

    Args:
        options: limits.
    """

    options: PilotOptions
    stale: int = 0  # how often a stream of velocities has stopped without an order to hover
    _changed: Wish | None = None
    _until_s: float | None = None  # when the velocity goes stale

    def command(self, velocity: Velocity, now_s: float) -> bool:
        """Take a velocity command; whether it can be used (every number is finite).

        Args:
            velocity: as requested; scaled down to the limits.
            now_s: time, on the clock of `request` [s].
        """
        if not all(map(math.isfinite, velocity)):
            return False
        limits = self.options
        share = min(1.0, limits.speed_m_s / max(math.hypot(velocity.forward_m_s, velocity.left_m_s), 1e-12))
        most_rad_s = math.radians(limits.turn_deg_s)
        self._changed = Wish(
            velocity_m_s=(velocity.forward_m_s * share, velocity.left_m_s * share),
            climb_m_s=min(max(velocity.up_m_s, -limits.climb_m_s), limits.climb_m_s),
            turn_rad_s=min(max(velocity.turn_rad_s, -most_rad_s), most_rad_s),
        )
        self._until_s = None if velocity == HOVER else now_s + limits.timeout_s
        return True

    def go_to(self, position_m: tuple[float, float, float], heading_rad: float | None = None) -> bool:
        """Take a set-point in the world; whether it can be used (every number is finite).

        Args:
            position_m: where to hover.
            heading_rad: counter-clockwise from east; None: the present one.
        """
        if not all(map(math.isfinite, (*position_m, heading_rad or 0.0))):
            return False
        self._changed = Wish(
            position_m=position_m, heading_rad=heading_rad, turn_rad_s=0.0 if heading_rad is None else None
        )
        self._until_s = None
        return True

    def request(self, now_s: float) -> Wish | None:
        """Return the request to the vehicle now; None: no change."""
        if self._until_s is not None and now_s >= self._until_s:
            self._until_s = None
            self.stale += 1
            self._changed = Wish(velocity_m_s=(0.0, 0.0), climb_m_s=0.0, turn_rad_s=0.0)
        changed, self._changed = self._changed, None
        return changed
