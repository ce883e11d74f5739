"""The guard: its braking law, what it knows of bearings, hysteresis, back-off, and bad input."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

import ullage as ul
from ullage.config import GuardSpec, make_scenario
from ullage.data import Trajectory
from ullage.errors import InputError
from ullage.flight.live import Steered, Wish
from ullage.processing.bearings import CELLS
from ullage.processing.braking import distance_to_rest, stopping_distance
from ullage.processing.guard import Guard, Limit
from ullage.processing.obstacles import ObstacleSectors, ObstacleStage, ObstacleTracks

HULL_M = 0.4
NAMES = ("front", "left", "back", "right")
STEP_S = 1 / 17
EMPTY = ObstacleStage(expected=ul.Rig.preset("thesis-4").sensors).sectors(0)
Echo = tuple[str, float, float]  # sensor, distance [m], closing speed [m/s]


def sectors(
    row: float, *echoes: Echo, dead: tuple[str, ...] = (), outside: bool = False, sigma_m: float = 0.0
) -> ObstacleSectors:
    """Four sectors of 95 degrees with given tracks."""
    valid = np.array([name not in dead for name in NAMES])
    rows = len(echoes)
    tracks = ObstacleTracks(
        np.array([NAMES.index(name) for name, _, _ in echoes], np.int64), np.arange(rows),
        np.array([d for _, d, _ in echoes], float), np.full(rows, sigma_m),
        np.array([c for _, _, c in echoes], float), np.full(rows, 0.02),
        np.full(rows, 30.0), np.full(rows, outside),
    )  # fmt: skip
    return ObstacleSectors(
        round(row * STEP_S * 1e9), NAMES, EMPTY.boresight, EMPTY.centre_rad, EMPTY.width_rad, EMPTY.least_m,
        EMPTY.reach_m, EMPTY.distance_m, EMPTY.sigma_m, EMPTY.closing_speed_m_s, EMPTY.closing_sigma_m_s, valid,
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


@dataclass
class Vehicle:
    """One dimension: it follows the last command that has arrived, with a lag and a limited deceleration."""

    gap_m: float  # from the hull to the obstacle
    lag_s: float
    braking_m_s2: float
    speed: float = 0.0
    now_s: float = 0.0
    commands: list[tuple[float, float]] = field(default_factory=lambda: [(0.0, 0.0)])  # when each acts, and its speed

    def ask(self, speed: float, delay_s: float) -> None:
        """Commands arrive in their order."""
        self.commands.append((max(self.now_s + delay_s, self.commands[-1][0]), speed))

    def fly(self, time_s: float) -> None:
        count = math.ceil(time_s / 0.005)
        step_s = time_s / count
        for _ in range(count):
            while len(self.commands) > 1 and self.commands[1][0] <= self.now_s:
                del self.commands[0]
            pull = (self.commands[0][1] - self.speed) / max(self.lag_s, step_s)
            self.speed += step_s * min(max(pull, -self.braking_m_s2), 5.0)
            self.gap_m -= self.speed * step_s
            self.now_s += step_s


SPECS = st.builds(
    GuardSpec, latency_s=st.floats(0.1, 1.0), lag_s=st.floats(0.0, 1.0), braking_m_s2=st.floats(0.3, 3.0),
    back_off_m_s=st.just(0.0), release_m=st.just(0.0), recovery_m_s2=st.just(5.0),
)  # fmt: skip


@settings(max_examples=20, deadline=None)
@given(spec=SPECS, wanted=st.floats(0.1, 3.0), share=st.floats(0.2, 1.0), part=st.floats(0.0, 1.0),
       harder=st.floats(1.0, 4.0), phase=st.floats(0.0, 1.0), seed=st.integers(0, 9))  # fmt: skip
def test_no_vehicle_within_the_limits_enters_the_margin(
    spec: GuardSpec, wanted: float, share: float, part: float, harder: float, phase: float, seed: int
) -> None:
    """Any frame period, delay that changes from command to command, lag and deceleration that the settings allow."""
    period_s = max(share * spec.latency_s, 0.03)
    room = float(stopping_distance(wanted, spec)) + spec.margin_m
    car = Vehicle(room + phase * wanted * period_s, part * spec.lag_s, spec.braking_m_s2 * harder)
    guard, draw = Guard(spec, hull_m=HULL_M), np.random.default_rng(seed)
    for row in range(round(min(15.0, 4 * room / wanted + 6) / period_s)):
        echo = ("front", car.gap_m + HULL_M, car.speed)
        limit = guard.limit((wanted, 0, 0), sectors(row * period_s / STEP_S, echo), odometry((car.speed, 0, 0)))
        car.ask(float(limit.velocity[0]), draw.uniform(0, max(spec.latency_s - period_s, 0.0)))
        car.fly(period_s)
        assert car.gap_m > spec.margin_m - 5e-3 * wanted
    assert car.gap_m < spec.margin_m + 0.1 + 0.1 * room  # and it comes as near as it may


@pytest.mark.parametrize("wind", [0.0, 3.0])
def test_the_default_settings_bound_the_multirotor_shipped(wind: float) -> None:
    """It comes to rest from a command of zero within the distance that the law gives it, less one frame at 10 Hz."""
    spec = GuardSpec()
    for speed in (0.2, 0.5, 1.0, 1.5):
        drone = Steered("hector", start=(0, 0, 1, 0), wind_m_s=(wind, 0, 0), gust_m_s=wind / 5, moving_s=12)
        drone.ask(Wish(velocity_m_s=(speed, 0.0), heading_rad=0.0))
        drone.advance(round(8e9))
        start, fast = drone.position[0], drone.velocity[0]
        drone.ask(Wish(velocity_m_s=(0.0, 0.0)))
        places = []
        for k in range(1, 40):
            drone.advance(round((8 + k / 10) * 1e9))
            places.append(drone.position[0] - start)
        assert max(places) < float(fast * (spec.latency_s - 0.1) + distance_to_rest(fast, spec))


def allowed_speed(free_m: float) -> float:
    """The greatest constant speed that stops within a distance by the default law [m/s]."""
    return float(brentq(lambda speed: float(stopping_distance(speed, GuardSpec())) - free_m, 0, 20))


def test_the_stopping_distance_of_a_fast_drone_is_that_of_the_law() -> None:
    spec = GuardSpec()
    fast = 1.0 * spec.latency_s + 1.0 / (2 * spec.braking_m_s2)
    assert stopping_distance(1.0, spec) == pytest.approx(fast + spec.braking_m_s2 * spec.lag_s**2 / 2)


@pytest.mark.parametrize("speed", [0.2, 0.7, 1.5])
def test_the_velocity_of_another_pilot_is_judged_by_the_distance_that_it_needs_to_stop(speed: float) -> None:
    guard, own = Guard(GuardSpec(), hull_m=HULL_M), odometry((speed, 0, 0))
    needed = HULL_M + GuardSpec().margin_m + float(stopping_distance(speed, GuardSpec()))
    states = [guard.judge(sectors(0, ("front", needed + more, speed)), own).state for more in (0.01, -0.01)]
    assert states == ["free", "stop"]
    assert guard.judge(sectors(0, ("back", 0.8, -speed)), own).state == "free"
    blind = guard.judge(sectors(0, dead=("front",)), own)
    assert (blind.state, blind.sensor) == ("stop", "front")


def test_a_wall_abeam_does_not_stop_a_flight_along_it() -> None:
    guard = Guard(GuardSpec(), hull_m=HULL_M)
    assert settled(guard, (0.6, 0, 0), ("left", 0.8, 0.0), own=(0.5, 0, 0)).state == "free"
    assert settled(guard, (0.0, 0.6, 0), ("left", 0.8, 0.0), own=(0.5, 0, 0)).velocity[1] < 0.25


def test_from_a_hover_an_obstacle_bounds_its_whole_sector() -> None:
    ahead = settled(Guard(GuardSpec(), hull_m=HULL_M), (1, 0, 0), ("front", 1.2, 0.0)).velocity[0]
    aslant = settled(Guard(GuardSpec(), hull_m=HULL_M), (0.8, 0.6, 0), ("front", 1.2, 0.0)).velocity
    assert ahead == pytest.approx(allowed_speed(0.5), rel=2e-3)
    assert np.linalg.norm(aslant) == pytest.approx(ahead, rel=1e-6)  # 37 degrees off: still in the main lobe
    away = settled(Guard(GuardSpec(), hull_m=HULL_M), (-1, 0, 0), ("front", 1.2, 0.0))
    assert away.state == "free"


def test_what_ego_motion_shows_outside_the_lobe_limits_only_what_closes_on_it() -> None:
    level = settled(Guard(GuardSpec(), hull_m=HULL_M), (1, 0, 0), ("front", 0.9, 0.0), own=(1, 0, 0), outside=True)
    assert level.state == "free"
    down = settled(Guard(GuardSpec(), hull_m=HULL_M), (0, 0, -1), ("front", 0.9, 0.5), own=(0, 0, -0.5), outside=True)
    assert down.velocity[2] > -0.4


def test_directions_bound_a_velocity_more_sharply_than_the_lobe() -> None:
    """An obstacle ahead to the left, from a hover: the way to its right is free, the way to it is not."""
    at = sectors(0, ("front", 0.8, 0.0))
    cells = np.degrees(np.arccos(CELLS @ [math.cos(0.6), math.sin(0.6), 0.0])) < 10
    seen = replace(at, tracks=replace(at.tracks, cells=cells[None]))
    guard, other = Guard(GuardSpec(back_off_m_s=0), hull_m=HULL_M), Guard(GuardSpec(back_off_m_s=0), hull_m=HULL_M)
    for row in range(68):
        seen = replace(seen, t_ns=round(row * STEP_S * 1e9))
        aside = guard.limit((0.3, -0.8, 0), seen, odometry())
        towards = other.limit((0.8, 0.5, 0), seen, odometry())
    assert aside.state == "free"
    assert np.linalg.norm(towards.velocity) == pytest.approx(allowed_speed(0.1), rel=0.01)


def test_an_obstacle_that_approaches_by_itself_costs_its_own_speed() -> None:
    still = settled(Guard(GuardSpec(), hull_m=HULL_M), (0.5, 0, 0), ("front", 2.0, 0.3), own=(0.3, 0, 0))
    person = settled(Guard(GuardSpec(), hull_m=HULL_M), (0.5, 0, 0), ("front", 2.0, 1.3), own=(0.3, 0, 0))
    assert still.state == "free"
    assert 0 <= person.velocity[0] < allowed_speed(2.0 - HULL_M - 0.3) - 1.0 + 0.005


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


@pytest.mark.parametrize(
    ("bearing_deg", "closing", "state"),
    [(180, 0, "back_off"), (205, 0, "back_off"), (90, 0, "stop"), (0, 0, "stop"), (180, 0.6, "stop")],
)
def test_a_stopped_drone_may_go_back_where_it_came_from(bearing_deg: float, closing: float, state: str) -> None:
    """What rests inside the margin, in whatever direction, is not where the drone has been; a person may come there."""
    guard = Guard(GuardSpec(), hull_m=HULL_M)
    for row in range(20):  # 1.5 m east
        pose = replace(odometry((0.5, 0, 0)), position=np.array([[0.075 * row, 0, 0]]))
        assert guard.limit((0.5, 0, 0), sectors(row), pose).state in ("free", "limited")
    here = replace(odometry(), position=np.array([[1.425, 0, 0]]))
    near = sectors(20, ("front", 0.6, closing))
    near = replace(near, tracks=replace(near.tracks, cells=np.ones((1, len(CELLS)), bool)))
    want = 0.5 * np.array([math.cos(math.radians(bearing_deg)), math.sin(math.radians(bearing_deg)), 0.0])
    limits = [guard.limit(want, replace(near, t_ns=round((20 + k) * STEP_S * 1e9)), here) for k in range(68)]
    assert limits[-1].state == state
    speed = GuardSpec().back_off_m_s if state == "back_off" else 0.0
    np.testing.assert_allclose(limits[-1].velocity, want / 0.5 * speed, atol=1e-9)


def test_after_a_jump_of_the_poses_no_way_back_is_known() -> None:
    """The places from before it are no longer where they seem to be."""
    for jump_m, state in ((0.0, "back_off"), (0.2, "stop")):
        guard = Guard(GuardSpec(), hull_m=HULL_M)
        for row in range(20):
            pose = replace(odometry((0.5, 0, 0)), position=np.array([[0.5 * STEP_S * row, 0, 0]]))
            guard.limit((0.5, 0, 0), sectors(row), pose)
        near = sectors(20, ("front", 0.6, 0.0))
        near = replace(near, tracks=replace(near.tracks, cells=np.ones((1, len(CELLS)), bool)))
        here = replace(odometry(), position=np.array([[0.5 * STEP_S * 19 - jump_m, 0, 0]]))
        assert guard.limit((-0.5, 0, 0), near, here).state == state


def test_a_drone_that_goes_back_stays_on_its_track() -> None:
    """Wherever its pilot wishes to go next, it strays by less than a third of the margin."""
    guard = Guard(GuardSpec(), hull_m=HULL_M)
    for row in range(20):
        pose = replace(odometry((0.5, 0, 0)), position=np.array([[0.075 * row, 0, 0]]))
        guard.limit((0.5, 0, 0), sectors(row), pose)
    near = sectors(20, ("front", 0.6, 0.0))
    near = replace(near, tracks=replace(near.tracks, cells=np.ones((1, len(CELLS)), bool)))
    place, rng, most_m = np.array([1.425, 0.0, 0.0]), np.random.default_rng(0), 0.0
    for k in range(1500):
        here = replace(odometry(), position=place[None])
        now = replace(near, t_ns=round((20 + k) * STEP_S * 1e9))
        turn = rng.uniform(-math.pi, math.pi)
        place = place + 0.3 * guard.limit((0.5 * math.cos(turn), 0.5 * math.sin(turn), 0), now, here).velocity
        most_m = max(most_m, abs(place[1]))
    assert 0.02 < most_m < GuardSpec().margin_m / 3


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


@settings(deadline=None, max_examples=60)
@given(
    echoes=st.lists(st.tuples(st.sampled_from(NAMES), st.floats(0.5, 3.0), st.floats(-0.4, 0.4)), max_size=4),
    course=st.floats(-math.pi, math.pi), speed=st.floats(0.1, 0.8),
)  # fmt: skip
def test_a_velocity_turned_aside_gets_on_no_slower_and_is_limited_by_the_same_law(
    echoes: list[Echo], course: float, speed: float
) -> None:
    want = speed * np.array([math.cos(course), math.sin(course), 0.0])
    guard = Guard(GuardSpec(release_m=0.0, recovery_m_s2=10.0, back_off_m_s=0.0), hull_m=HULL_M)
    turned = guard.around(want, sectors(0, *echoes), odometry())
    assert np.linalg.norm(turned) == pytest.approx(speed)
    got = []
    for velocity in (want, turned):
        fresh = Guard(GuardSpec(release_m=0.0, recovery_m_s2=10.0, back_off_m_s=0.0), hull_m=HULL_M)
        fresh.limit(velocity, sectors(-1, *echoes), odometry())
        got.append(fresh.limit(velocity, sectors(60, *echoes), odometry()).velocity @ want / speed)
    assert got[1] >= got[0] - 1e-9
    if got[0] >= speed - 1e-9:
        assert np.allclose(turned, want)


def test_a_velocity_along_a_wall_on_the_left_is_turned_away_from_it() -> None:
    guard = Guard(GuardSpec(), hull_m=HULL_M)
    turned = guard.around((0.4, 0.3, 0.0), sectors(0, ("left", 0.72, 0.0)), odometry())
    assert turned[0] > 0.3
    assert turned[1] < 0
