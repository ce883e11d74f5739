"""Stand-ins for both autopilots, flown towards walls by decoded OBSTACLE_DISTANCE alone.

The rows that a real ArduCopter 4.7-dev flew are flown again with the messages of that day, so that the stand-in is
known to behave alike before anything is concluded from it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from mavlink_brakes import UNKNOWN, ArduPilotBrake, Brake, Px4Brake
from pymavlink.dialects.v20 import common as mav

import ullage as ul
from ullage.ports.mavlink.sink import obstacle_distance
from ullage.processing.obstacles import ObstacleStage
from ullage.radar.live import LiveRadars

STEP_S, RADAR_S = 0.01, 0.05
STALE_S, LAG_S, DELAY_S = 0.5, 0.3, 0.1
FREE = math.inf
Sides = tuple[float | None, float | None, float | None, float | None]


def moved(state: tuple[float, float], brake: Brake, wish_m_s: float, now_s: float, lag_s: float) -> tuple[float, float]:
    """Place and speed one step later."""
    x, v = state
    wanted = brake.velocity(np.array([wish_m_s, 0.0]), np.array([v, 0.0]), now_s)[0]
    v += float(np.clip((wanted - v) / lag_s, -3.0, 3.0)) * STEP_S
    return x + v * STEP_S, v


def elements(front: float | None, left: float | None, back: float | None, right: float | None) -> Any:
    """OBSTACLE_DISTANCE of four radars of 90 degrees; None: unknown [m]."""
    cm = []
    for j in range(72):
        away = (5 * j + 180) % 360 - 180
        side = front if abs(away) <= 45 else back if abs(away) >= 135 else right if away > 0 else left
        cm.append(UNKNOWN if side is None else 941 if math.isinf(side) else max(int(100 * side), 21))
    return mav.MAVLink_obstacle_distance_message(0, 3, cm, 5, 20, 940, 5.0, 0.0, mav.MAV_FRAME_BODY_FRD)


def fly_by(brake: Brake, wish_m_s: float, seconds: float, sides: Callable[[float], Sides]) -> Any:
    """Places [m] and speeds [m/s] with the messages of `sides`, which come a little late."""
    state, track, due = (0.0, 0.0), [], list[tuple[float, Any]]()
    for k in range(round(seconds / STEP_S)):
        now_s = k * STEP_S
        if k % round(RADAR_S / STEP_S) == 0:
            due.append((now_s + DELAY_S, elements(*sides(state[0]))))
        while due and due[0][0] <= now_s:
            brake.take(due.pop(0)[1], now_s)
        state = moved(state, brake, wish_m_s, now_s, LAG_S)
        track.append(state)
    return np.array(track)


def wall_in_all_directions(wall_m: float) -> Callable[[float], Sides]:
    """A wall ahead that every radar receives, each from its own place."""
    return lambda x: (wall_m - x - 0.1, wall_m - x, wall_m - x + 0.1, wall_m - x)


def fly(
    *, wall_m: float, wish_m_s: float, brake: Brake, seed: int, seconds: float, silent_after_s: float = math.inf
) -> Any:
    """Positions [m] and speeds [m/s] of a flight towards a wall."""
    scene = ul.scenes.plate(width_m=3, height_m=3, distance_m=wall_m, material="concrete")
    radars = LiveRadars(scene, ul.RadarSpec.preset("x4m05"), seed=seed, rate_hz=1 / RADAR_S)
    stage, sender, receiver = ObstacleStage(), mav.MAVLink(None, 1, 196), mav.MAVLink(None)
    x = v = 0.0
    track = []
    for k in range(round(seconds / STEP_S)):
        now_s = k * STEP_S
        chunk = radars.advance(round(now_s * 1e9), (x, 0, 0), (0, 0, 0, 1))
        for sectors in stage.update(chunk) if chunk and now_s < silent_after_s else ():
            data = obstacle_distance(sectors, sectors.t_ns // 1000).pack(sender)
            (message,) = receiver.parse_buffer(data)
            brake.take(message, now_s)
        x, v = moved((x, v), brake, wish_m_s, now_s, STEP_S)
        track.append((x, v))
    radars.close()
    return np.array(track)


@pytest.mark.parametrize(("wish_m_s", "bins"), [(0.5, 72), (1.0, 36)])
def test_it_stops_before_the_wall_at_the_distance_that_px4_was_given(wish_m_s: float, bins: int) -> None:
    brake = Px4Brake(cp_dist=1.0, bins=bins)
    track = fly(wall_m=3.0, wish_m_s=wish_m_s, brake=brake, seed=3, seconds=2 / wish_m_s + 4)
    left = 3.0 - track[-1, 0]
    assert track[:, 1].max() > 0.8 * wish_m_s  # it was not stopped from the start
    assert abs(track[-100:, 1]).max() < 0.1
    assert 0.8 < left < 1.6
    assert (3.0 - track[:, 0]).min() > 0.8


def test_without_the_messages_the_same_flight_hits_the_wall() -> None:
    """ArduPilot flies on where it gets no distances."""
    track = fly(wall_m=3.0, wish_m_s=1.0, brake=ArduPilotBrake(), seed=3, seconds=4.0, silent_after_s=0.0)
    assert track[-1, 0] > 3.0


def test_a_radar_that_falls_silent_stops_it_within_half_a_second_and_the_braking_time() -> None:
    track = fly(wall_m=8.0, wish_m_s=1.0, brake=Px4Brake(), seed=4, seconds=5.0, silent_after_s=3.0)
    after = round((3.0 + STALE_S + 0.5) / STEP_S)
    assert track[round(2.9 / STEP_S), 1] > 0.5
    assert abs(track[after:, 1]).max() < 1e-6


def test_ardupilot_stops_before_the_wall_too() -> None:
    track = fly(wall_m=3.5, wish_m_s=0.5, brake=ArduPilotBrake(margin=1.5), seed=3, seconds=8.0)
    assert track[:, 1].max() > 0.4
    assert (3.5 - track[:, 0]).min() > 1.0


def test_px4_moves_into_no_direction_that_is_unknown_unless_it_may() -> None:
    def dark(x: float) -> Sides:
        return (None, FREE, FREE, FREE)

    assert fly_by(Px4Brake(), 1.0, 3.0, dark)[-1, 0] == 0.0
    assert fly_by(Px4Brake(cp_go_no_data=True), 1.0, 3.0, dark)[-1, 0] > 2.0


def test_px4_guides_the_wish_around_a_post_within_its_angle() -> None:
    message = elements(FREE, FREE, FREE, FREE)
    message.distances = [120 if j in (71, 0, 1) else one for j, one in enumerate(message.distances)]
    wish, rest = np.array([1.0, 0.0]), np.zeros(2)
    straight, guided = Px4Brake(), Px4Brake(cp_guide_ang=30)
    for brake in (straight, guided):
        brake.take(message, 0.0)
    assert straight.velocity(wish, rest, 0.0)[1] == 0.0
    assert math.degrees(abs(math.atan2(*guided.velocity(wish, rest, 0.0)[::-1]))) == pytest.approx(15, abs=6)


# what a real ArduCopter 4.7-dev did, with the messages that it got


def test_ardupilot_in_loiter_stops_at_its_margin_before_a_wall() -> None:
    """Flown: margin 1.5 m, closest 1.42 m, held at 1.57 m."""
    away = 8.0 - fly_by(ArduPilotBrake(margin=1.5), 0.5, 40.0, wall_in_all_directions(8.0))[:, 0]
    assert away.min() == pytest.approx(1.42, abs=0.1)
    assert np.median(away[-500:]) == pytest.approx(1.57, abs=0.2)


@pytest.mark.parametrize("wish_m_s", [0.7, 1.5])
def test_ardupilot_in_guided_stops_about_its_margin_before_a_wall(wish_m_s: float) -> None:
    """Flown: margin 2 m, between 1.7 and 2.4 m."""
    away = 8.0 - fly_by(ArduPilotBrake(margin=2.0), wish_m_s, 40.0, wall_in_all_directions(8.0))[:, 0]
    assert 1.5 <= away.min() < 2.0
    assert away[-2000:].max() < 2.4


@pytest.mark.parametrize("wish_m_s", [1.0, 1.5])
def test_without_its_filter_ardupilot_in_guided_stops_at_its_margin(wish_m_s: float) -> None:
    """Flown, margin 1.5 m: 0.89 and 0.55 m with PRX_FILT 0.25 Hz, 1.52 and 1.43 m with 0."""
    lagged, prompt = (
        6.0 - fly_by(ArduPilotBrake(margin=1.5, filt_hz=hz), wish_m_s, 15.0, lambda x: (6.0 - x, *3 * (FREE,)))[:, 0]
        for hz in (0.25, 0.0)
    )
    assert lagged.min() < 1.2
    assert prompt.min() == pytest.approx(1.5, abs=0.3)


def test_ardupilot_is_slow_over_a_floor_that_three_radars_report() -> None:
    """Flown: 1.5 m/s asked, never above 0.88."""
    track = fly_by(ArduPilotBrake(margin=2.0), 1.5, 20.0, lambda x: (FREE, 3.04, 3.04, 3.04))
    assert track[:, 1].max() == pytest.approx(0.88, abs=0.1)


def test_ardupilot_flies_backwards_from_an_echo_that_is_folded_near() -> None:
    """Flown: backwards by itself at 0.74 m/s, with nothing nearer than 10 m."""
    track = fly_by(ArduPilotBrake(), 0.0, 3.0, lambda x: (0.1, None, None, None))
    assert track[:, 1].min() == pytest.approx(-0.74, abs=0.03)


def test_ardupilot_flies_on_when_distances_end_and_px4_stops() -> None:
    for brake, flies_on in ((ArduPilotBrake(), True), (Px4Brake(), False)):
        brake.take(elements(1.0, FREE, FREE, FREE), 0.0)
        wish = np.array([1.0, 0.0])
        assert (brake.velocity(wish, np.zeros(2), 0.6)[0] == 1.0) == flies_on
