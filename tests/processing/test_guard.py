"""The guard: its braking law, what it knows of bearings, hysteresis, back-off, and bad input."""

from __future__ import annotations

import math

import numpy as np
import pytest

import ullage as ul
from ullage.config import GuardSpec, make_scenario
from ullage.data import Trajectory
from ullage.errors import InputError
from ullage.processing.guard import Guard, Limit, allowed_speed
from ullage.processing.obstacles import ObstacleSectors, ObstacleStage, ObstacleTracks

HULL_M = 0.4
NAMES = ("front", "left", "back", "right")
STEP_S = 1 / 17
Echo = tuple[str, float, float]  # sensor, distance [m], closing speed [m/s]


def sectors(
    row: int, *echoes: Echo, dead: tuple[str, ...] = (), outside: bool = False, sigma_m: float = 0.0
) -> ObstacleSectors:
    """Four sectors of 95 degrees with given tracks."""
    empty = ObstacleStage(expected=ul.Rig.preset("thesis-4").sensors).sectors(0)
    valid = np.array([name not in dead for name in NAMES])
    rows = len(echoes)
    tracks = ObstacleTracks(
        np.array([NAMES.index(name) for name, _, _ in echoes], np.int64), np.arange(rows),
        np.array([d for _, d, _ in echoes], float), np.full(rows, sigma_m),
        np.array([c for _, _, c in echoes], float), np.full(rows, 0.02),
        np.full(rows, 30.0), np.full(rows, outside),
    )  # fmt: skip
    return ObstacleSectors(
        round(row * STEP_S * 1e9), NAMES, empty.boresight, empty.centre_rad, empty.width_rad, empty.least_m,
        empty.reach_m, empty.distance_m, empty.sigma_m, empty.closing_speed_m_s, empty.closing_sigma_m_s, valid,
        ~valid, tuple("" if ok else "silent" for ok in valid), tracks,
    )  # fmt: skip


def odometry(velocity: tuple[float, float, float] = (0, 0, 0)) -> Trajectory:
    one = np.array([0])
    return Trajectory(one, np.zeros((1, 3)), np.array([[0, 0, 0, 1.0]]), np.array([velocity], float), np.zeros((1, 3)))


def settled(
    guard: Guard,
    wanted: tuple[float, float, float],
    *echoes: Echo,
    own: tuple[float, float, float] = (0, 0, 0),
    dead: tuple[str, ...] = (),
    outside: bool = False,
) -> Limit:
    """The limit after four seconds, when it has grown as far as it may."""
    limits = [
        guard.limit(wanted, sectors(row, *echoes, dead=dead, outside=outside), odometry(own)) for row in range(68)
    ]
    return limits[-1]


@pytest.mark.parametrize("speed", [0.3, 0.7, 1.0, 2.0])
@pytest.mark.parametrize("latency_s", [0.1, 0.5, 1.0])
@pytest.mark.parametrize("braking", [0.4, 0.8, 2.0])
def test_a_vehicle_with_the_latency_given_never_enters_the_margin(
    speed: float, latency_s: float, braking: float
) -> None:
    """It closes at a constant speed; a latency after the limit falls below that, it brakes at the given rate."""
    spec = GuardSpec(latency_s=latency_s, braking_m_s2=braking, back_off_m_s=0.0)
    guard, gap, first = Guard(spec, hull_m=HULL_M), 12.0, None
    step_s, now = 0.001, speed
    for row in range(60_000):
        if row % 58 == 0:  # a frame: nearly 17 a second
            echo = ("front", gap + HULL_M - speed * 0.059, now)  # the echo may be one frame old when it counts
            limit = guard.limit((speed, 0, 0), sectors(row // 58, echo), odometry((now, 0, 0)))
            if first is None and row > 58 * 70 and limit.velocity[0] < speed:
                first = row * step_s
        if first is not None and row * step_s >= first + latency_s:
            now = max(now - braking * step_s, 0.0)
        gap -= now * step_s if row > 58 * 70 else 0.0  # the limit has grown to the speed before it flies
        if now == 0:
            break
    assert spec.margin_m - 1e-3 <= gap < spec.margin_m + 0.2


def test_allowed_speed_is_what_stops_within_the_free_distance() -> None:
    spec = GuardSpec()
    speed = allowed_speed([0.0, -1.0, 1.0], spec)
    assert speed[0] == 0.0
    assert speed[1] == 0.0
    assert speed[2] * spec.latency_s + speed[2] ** 2 / (2 * spec.braking_m_s2) == pytest.approx(1.0)


def test_a_wall_abeam_does_not_stop_a_flight_along_it() -> None:
    guard = Guard(GuardSpec(), hull_m=HULL_M)
    assert settled(guard, (0.6, 0, 0), ("left", 0.8, 0.0), own=(0.5, 0, 0)).state == "free"
    assert settled(guard, (0.0, 0.6, 0), ("left", 0.8, 0.0), own=(0.5, 0, 0)).velocity[1] < 0.25


def test_from_a_hover_an_obstacle_bounds_its_whole_sector() -> None:
    ahead = settled(Guard(GuardSpec(), hull_m=HULL_M), (1, 0, 0), ("front", 1.2, 0.0)).velocity[0]
    aslant = settled(Guard(GuardSpec(), hull_m=HULL_M), (0.8, 0.6, 0), ("front", 1.2, 0.0)).velocity
    assert ahead == pytest.approx(float(allowed_speed(0.5, GuardSpec())), rel=1e-6)
    assert np.linalg.norm(aslant) == pytest.approx(ahead, rel=1e-6)  # 37 degrees off: still in the main lobe
    away = settled(Guard(GuardSpec(), hull_m=HULL_M), (-1, 0, 0), ("front", 1.2, 0.0))
    assert away.state == "free"


def test_what_ego_motion_shows_outside_the_lobe_limits_only_what_closes_on_it() -> None:
    level = settled(Guard(GuardSpec(), hull_m=HULL_M), (1, 0, 0), ("front", 0.9, 0.0), own=(1, 0, 0), outside=True)
    assert level.state == "free"
    down = settled(Guard(GuardSpec(), hull_m=HULL_M), (0, 0, -1), ("front", 0.9, 0.5), own=(0, 0, -0.5), outside=True)
    assert down.velocity[2] > -0.4


def test_an_obstacle_that_approaches_by_itself_costs_its_own_speed() -> None:
    still = settled(Guard(GuardSpec(), hull_m=HULL_M), (0.5, 0, 0), ("front", 2.0, 0.3), own=(0.3, 0, 0))
    person = settled(Guard(GuardSpec(), hull_m=HULL_M), (0.5, 0, 0), ("front", 2.0, 1.3), own=(0.3, 0, 0))
    assert still.state == "free"
    assert person.velocity[0] < 0.1


def test_a_silent_sensor_stops_its_own_direction_and_no_other() -> None:
    ahead = settled(Guard(GuardSpec(), hull_m=HULL_M), (1, 0, 0), dead=("front",))
    assert ahead.state == "stop"
    assert ahead.sensor == "front"
    assert settled(Guard(GuardSpec(), hull_m=HULL_M), (0, 1, 0), dead=("front",)).state == "free"
    slow = Guard(GuardSpec(unseen_m_s=0.2), hull_m=HULL_M)
    assert settled(slow, (1, 0, 0), dead=("front",)).velocity[0] == pytest.approx(0.2)


def test_a_stopped_flight_goes_on_only_with_more_room_and_slowly() -> None:
    guard = Guard(GuardSpec(release_m=0.2, recovery_m_s2=0.5), hull_m=HULL_M)
    edge = HULL_M + 0.3
    assert settled(guard, (1, 0, 0), ("front", edge - 0.01, 0.0)).state == "stop"
    for row in range(68, 90):
        assert guard.limit((1, 0, 0), sectors(row, ("front", edge + 0.15, 0.0)), odometry()).state == "stop"
    first = guard.limit((1, 0, 0), sectors(90, ("front", edge + 2.0, 0.0)), odometry())
    second = guard.limit((1, 0, 0), sectors(91, ("front", edge + 2.0, 0.0)), odometry())
    assert second.velocity[0] - first.velocity[0] <= 0.5 * STEP_S + 1e-9


def test_well_inside_the_margin_it_retreats_unless_something_is_behind() -> None:
    near = ("front", HULL_M + 0.1, 0.0)
    back = settled(Guard(GuardSpec(), hull_m=HULL_M), (1, 0, 0), near)
    assert back.state == "back_off"
    assert back.velocity[0] == pytest.approx(-0.15)
    for other in (("back", HULL_M + 0.35, 0.0), ("back", HULL_M + 0.1, 0.0)):
        held = settled(Guard(GuardSpec(), hull_m=HULL_M), (1, 0, 0), near, other)
        assert held.state == "stop"
    assert settled(Guard(GuardSpec(), hull_m=HULL_M), (1, 0, 0), near, dead=("back",)).state == "stop"
    assert settled(Guard(GuardSpec(back_off_m_s=0), hull_m=HULL_M), (1, 0, 0), near).state == "stop"


def test_uncertain_distances_count_as_shorter() -> None:
    exact, vague = (
        Guard(GuardSpec(), hull_m=HULL_M).limit((1, 0, 0), sectors(0, ("front", 1.5, 0.0), sigma_m=s), odometry())
        for s in (0.0, 0.2)
    )
    assert vague.free_m == pytest.approx(exact.free_m - 0.4)


def test_a_guard_without_odometry_says_so() -> None:
    guard = Guard(GuardSpec(), hull_m=HULL_M)
    with pytest.raises(InputError, match=r"guard has no odometry.*believed poses"):
        guard.limit((1, 0, 0), sectors(0), None)
    with pytest.raises(InputError, match="wanted velocity"):
        guard.limit((math.nan, 0, 0), sectors(0), odometry())
    with pytest.raises(InputError, match="hull_m"):
        Guard(GuardSpec(), hull_m=0.0)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("margin_m=-1", "flight.guard.margin_m"),
        ("braking_m_s2=0", "flight.guard.braking_m_s2"),
        ("latency_s=fast", "flight.guard.latency_s"),
        ("sigma=2", "flight.guard.sigma"),
        ("back_off_share=2", "flight.guard.back_off_share"),
    ],
)
def test_wrong_settings_are_refused_by_name(setting: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        make_scenario({"name": "x"}, options=[f"flight.guard.{setting}"])


def test_a_guard_wants_a_vehicle_that_brakes_and_a_steady_hand() -> None:
    with pytest.raises(InputError, match="vehicle that can brake"):
        make_scenario({"name": "x"}, options=["flight.guard.on=true", "flight.vehicle=ideal"])
    with pytest.raises(InputError, match="no wander"):
        make_scenario({"name": "x"}, options=["flight.guard.on=true", "flight.wander_m=0.1"])
