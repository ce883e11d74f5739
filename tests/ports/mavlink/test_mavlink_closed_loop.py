"""An autopilot that brakes as PX4 documents it, flown towards a simulated wall by decoded OBSTACLE_DISTANCE alone.

The stand-in follows the velocity limit of PX4's collision prevention [PX4Collision]: the speed towards the obstacle of
an element is that from which a jerk- and acceleration-limited vehicle stops before CP_DIST, less the way flown in
CP_DELAY and in the age of the data. Without data newer than 0.5 s, or in an unknown direction, it does not move.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from pymavlink.dialects.v20 import common as mav

import ullage as ul
from ullage.ports.mavlink.encode import obstacle_distance
from ullage.processing.obstacles import ObstacleStage
from ullage.radar.live import LiveRadars

STEP_S, RADAR_S = 0.01, 0.05
UNKNOWN, STALE_S = 65535, 0.5


@dataclass
class Px4Brake:
    """The limit on the forward speed, with the names of PX4's parameters."""

    cp_dist: float = 1.0  # [m]
    cp_delay: float = 0.4  # [s]
    acc_hor: float = 3.0  # [m/s^2]
    jerk_max: float = 8.0  # [m/s^3]
    element: int = UNKNOWN  # forward [cm]
    limits: tuple[int, int] = (0, 0)
    came_s: float = field(default=-math.inf)

    def take(self, message: Any, now_s: float) -> None:
        assert message.frame == mav.MAV_FRAME_BODY_FRD
        assert message.increment_f == 5.0
        self.element, self.limits, self.came_s = (
            message.distances[0],
            (message.min_distance, message.max_distance),
            now_s,
        )

    def most_m_s(self, speed_m_s: float, now_s: float) -> float:
        age_s = now_s - self.came_s
        if age_s > STALE_S or self.element == UNKNOWN:
            return 0.0
        least, most = self.limits
        assert self.element > least  # PX4 leaves the others out
        delay_s = self.cp_delay + (age_s if self.element < most else 0.0)
        keep_m = max(self.cp_dist, least / 100)
        stop_m = max(0.0, self.element / 100 - keep_m - speed_m_s * delay_s)
        b = 4 * self.acc_hor**2 / self.jerk_max  # v^2 / (2 a) + v a / j = s with PX4's margin on the jerk
        return 0.5 * (-b + math.sqrt(b * b + 8 * self.acc_hor * stop_m))


def fly(*, wall_m: float, wish_m_s: float, brake: Px4Brake | None, seed: int, silent_after_s: float = math.inf) -> Any:
    """Positions [m] and speeds [m/s] of 12 s towards a wall; without a brake the wish is flown."""
    scene = ul.scenes.plate(width_m=3, height_m=3, distance_m=wall_m, material="concrete")
    radars = LiveRadars(scene, ul.RadarSpec.preset("x4m05"), seed=seed, rate_hz=1 / RADAR_S)
    stage, sender, receiver = ObstacleStage(), mav.MAVLink(None, 1, 196), mav.MAVLink(None)
    x = v = 0.0
    track = []
    for k in range(round(12 / STEP_S)):
        now_s = k * STEP_S
        chunk = radars.advance(round(now_s * 1e9), (x, 0, 0), (0, 0, 0, 1))
        for sectors in stage.update(chunk) if chunk and now_s < silent_after_s else ():
            data = obstacle_distance(sectors, sectors.t_ns // 1000).pack(sender)
            (message,) = receiver.parse_buffer(data)
            if brake is not None:
                brake.take(message, now_s)
        wanted = wish_m_s if brake is None else min(wish_m_s, brake.most_m_s(v, now_s))
        v += float(np.clip(wanted - v, -3.0 * STEP_S, 3.0 * STEP_S))
        x += v * STEP_S
        track.append((x, v))
    radars.close()
    return np.array(track)


@pytest.mark.parametrize("wish_m_s", [0.5, 1.0])
def test_it_stops_before_the_wall_at_the_distance_that_px4_was_given(wish_m_s: float) -> None:
    track = fly(wall_m=5.0, wish_m_s=wish_m_s, brake=Px4Brake(cp_dist=1.0), seed=3)
    left = 5.0 - track[-1, 0]
    assert track[:, 1].max() > 0.8 * wish_m_s  # it was not stopped from the start
    assert abs(track[-100:, 1]).max() < 0.1
    assert 0.8 < left < 1.6
    assert (5.0 - track[:, 0]).min() > 0.8


def test_without_the_messages_the_same_flight_hits_the_wall() -> None:
    assert fly(wall_m=5.0, wish_m_s=1.0, brake=None, seed=3)[-1, 0] > 5.0


def test_a_radar_that_falls_silent_stops_it_within_half_a_second_and_the_braking_time() -> None:
    track = fly(wall_m=8.0, wish_m_s=1.0, brake=Px4Brake(), seed=4, silent_after_s=3.0)
    after = round((3.0 + STALE_S + 0.5) / STEP_S)
    assert track[round(2.9 / STEP_S), 1] > 0.5
    assert abs(track[after:, 1]).max() < 1e-6
