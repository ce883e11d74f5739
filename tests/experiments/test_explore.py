"""Exploring flights: the pilot over maps that grow as it flies, and the whole loop with radars, mapper and guard."""

from __future__ import annotations

import json
import math
import signal
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import ullage as ul
from ullage.cli import app
from ullage.config import make_scenario
from ullage.errors import InputError
from ullage.experiments.exploration import prepare
from ullage.experiments.exploration_report import observable_from, reachable
from ullage.experiments.explorer import HOLD_S, LATE_S, TOUCH_M_S, Explorer
from ullage.experiments.guarded_flight import WaypointFollower
from ullage.flight.explore import ViewPlanner
from ullage.flight.live import Steered, Wish
from ullage.geometry import rpy_quat
from ullage.grids import UNKNOWN, Grid, OccupancyMap
from ullage.pipeline import MapStage, run
from ullage.processing.metrics import on_map
from ullage.view.replay import MapHistory

START = np.array([1.0, 1.0, 1.0, 0.0])
GRID = Grid((-0.5, -0.5, 1.0), 0.1, (50, 70))
QUICK = ["sensing.rate_hz=10", "flight.waypoints=[[-1,0,0]]"]
ROOM = ul.scenes.room(size_m=(6, 5, 3))
EMPTY = ul.scenes.room(size_m=(10, 10, 3))


def pose(place: np.ndarray, yaw_rad: float, t_s: float) -> ul.Trajectory:
    return ul.Trajectory(np.array([round(t_s * 1e9)]), place[None], rpy_quat(0.0, 0.0, np.array([yaw_rad])))


def hall() -> np.ndarray:
    """The cells of a hall of 6 x 4 m with an inner wall."""
    percent = np.full(GRID.shape, 95, np.int8)
    percent[5:45, 5:65] = 5
    percent[5:28, 32:35] = 95
    return percent


def fly_by_sight(
    explorer: Explorer, *, sight_m: float, moves: bool = True, ground_m: float = -9.0, cells: np.ndarray | None = None
) -> tuple[list[np.ndarray], OccupancyMap]:
    """Fly a point that sees everything within some distance, until the explorer ends."""
    place, yaw, track, known = START[:3].copy(), 0.0, [], np.full(GRID.shape, UNKNOWN, np.int8)
    x, y = np.meshgrid(GRID.x_m, GRID.y_m)
    world = hall() if cells is None else cells
    for step in range(round(10 * (explorer.time_s + 2 * LATE_S))):
        near = np.hypot(x - place[0], y - place[1]) <= sight_m
        known[near] = world[near]
        if step % 10 == 0:
            explorer.take_map(OccupancyMap(GRID, known.copy()))
        explorer.update(pose(place, yaw, step / 10))
        track.append(place.copy())
        if explorer.ended:
            break
        if moves:
            place = place + 0.1 * explorer.velocity(place)
            place[2] = max(place[2], ground_m)
            yaw = explorer.heading_rad
    return track, OccupancyMap(GRID, known)


@pytest.mark.parametrize("time_s", [20.0, 100.0])
def test_a_pilot_is_home_in_time_and_never_near_what_it_does_not_know(time_s: float) -> None:
    explorer = Explorer(START, time_s=time_s, speed_m_s=0.5, clearance_m=0.4)
    track, omap = fly_by_sight(explorer, sight_m=1.5)
    flown = np.array(track)
    assert explorer.at_home
    assert explorer.ended.startswith("at home: ")
    assert np.linalg.norm(flown[-1, :2] - START[:2]) < 0.3
    assert len(track) / 10 <= time_s + 2
    cells, _ = GRID.index(flown)
    assert omap.free[cells[:, 0], cells[:, 1]].all()
    solid = np.argwhere(hall() == 95)
    centres = np.column_stack([GRID.x_m[solid[:, 1]], GRID.y_m[solid[:, 0]]])
    assert np.linalg.norm(flown[:, None, :2] - centres[None], axis=2).min() > 0.25
    if time_s == 100:
        assert (omap.percent[5:45, 5:65] != UNKNOWN).mean() > 0.9
        assert "nothing is left" in explorer.ended


@pytest.mark.parametrize("ground_m", [0.1, 0.4])
def test_a_pilot_lands_at_home_in_time_on_ground_that_is_not_where_it_was_thought(ground_m: float) -> None:
    explorer = Explorer(START, time_s=40.0, speed_m_s=0.5, clearance_m=0.4, drop_m=0.9)
    track, _ = fly_by_sight(explorer, sight_m=1.5, ground_m=ground_m)
    assert explorer.landed
    assert explorer.ended.startswith("on the ground at home: ")
    assert len(track) / 10 <= 40.0
    assert np.allclose(track[-1], [*START[:2], ground_m], atol=0.1)
    falls = -np.diff([place[2] for place in track[-20:]])
    assert falls.max() <= 0.1 * TOUCH_M_S + 1e-9


def fly_and_lose(*, from_s: float, until_s: float, away_m: float = 0.0) -> tuple[np.ndarray, Explorer]:
    """Fly a point that sees 1.5 m and whose poses are lost, or err, for a while; its true places."""
    explorer = Explorer(START, time_s=40.0, speed_m_s=0.5, clearance_m=0.4, drop_m=0.9)
    place, yaw, track, known = START[:3].copy(), 0.0, [], np.full(GRID.shape, UNKNOWN, np.int8)
    x, y = np.meshgrid(GRID.x_m, GRID.y_m)
    for step in range(600):
        near = np.hypot(x - place[0], y - place[1]) <= 1.5
        known[near] = hall()[near]
        explorer.take_map(OccupancyMap(GRID, known.copy()))
        off = from_s <= step / 10 < until_s
        drift_m = 0.1 * (step / 10 - from_s)  # lost poses wander
        believed = place + np.array([(away_m or drift_m) if off else 0.0, 0.0, 0.0])
        lost = "no echo fits" if off and not away_m else ""
        explorer.update(pose(believed, yaw, step / 10), lost=lost)
        track.append(place.copy())
        if explorer.ended:
            break
        place, yaw = place + 0.1 * explorer.velocity(believed), explorer.heading_rad
        place[2] = max(place[2], 0.1)
    return np.array(track), explorer


@pytest.mark.parametrize(("away_m", "why"), [(0.0, "no echo fits"), (20.0, "outside the box of the world")])
def test_a_vehicle_whose_poses_are_lost_hovers_and_lands_where_it_is(away_m: float, why: str) -> None:
    track, explorer = fly_and_lose(from_s=3.0, until_s=60.0, away_m=away_m)
    level = np.linalg.norm(np.diff(track[:, :2], axis=0), axis=1)
    assert level[:30].max() > 0.04
    assert level[31:].max() == 0.0
    lands = round(10 * (3.0 + HOLD_S))
    assert (track[31:lands, 2] == track[31, 2]).all()
    assert explorer.landed
    assert explorer.ended.endswith(f"of home: its poses were lost for 5 s ({why})")
    assert explorer.ended.startswith("on the ground ")
    assert len(track) < lands + 60


def test_a_vehicle_whose_poses_come_back_goes_on_and_comes_home() -> None:
    track, explorer = fly_and_lose(from_s=3.0, until_s=3.0 + HOLD_S - 0.2)
    level = np.linalg.norm(np.diff(track[:, :2], axis=0), axis=1)
    assert level[31 : round(10 * (3.0 + HOLD_S)) - 3].max() == 0.0
    assert level[90:].max() > 0.04
    assert explorer.ended.startswith("on the ground at home: ")


def test_frames_of_lost_poses_stay_off_the_map() -> None:
    class Losing:
        lost = ""

        def __call__(self, truth: ul.Trajectory, frames: object) -> ul.Trajectory:
            self.lost = "as asked" if truth.t_ns[0] > 2e9 else ""
            return truth

    explored = ul.explore(ROOM, time_s=60.0, options=QUICK, poses=Losing())
    assert explored.frames["front"].t_ns[-1] <= 2e9
    assert explored.flown.duration_s > 2 + HOLD_S
    assert "lost for 5 s (as asked)" in explored.summary
    still = explored.flown.position[explored.flown.t_ns > 4e9]
    assert np.linalg.norm(still[:, :2] - still[0, :2], axis=1).max() < 0.1


CORNERS = st.lists(st.tuples(st.floats(-4, 4), st.floats(-4, 4)), min_size=2, max_size=5)


@settings(deadline=None, max_examples=12)
@given(corners=CORNERS, speed_m_s=st.floats(0.3, 0.8))
def test_the_planner_knows_how_long_a_path_takes(corners: list[tuple[float, float]], speed_m_s: float) -> None:
    """The vehicle's own controller flies it in an empty room of 10 x 10 m."""
    path = np.array(corners)
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assume(steps.min() > 0.5)
    assume(steps.sum() > 2.0)
    planner = ViewPlanner(GRID, START, clearance_m=0.4, speed_m_s=speed_m_s)
    points = np.column_stack([path, np.zeros(len(path))])
    follower, vehicle, row = WaypointFollower(points, speed_m_s), Steered(scene=EMPTY, start=points[0]), 0
    while not follower.arrived and row < 2000:
        vehicle.advance(row * 50_000_000)
        level = follower.velocity(vehicle.position)
        vehicle.ask(Wish(velocity_m_s=(level[0], level[1]), climb_m_s=level[2], heading_rad=0.0))
        row += 1
    assert planner.path_s(path) == pytest.approx(row * 0.05, rel=0.15)


def test_a_vehicle_that_never_gets_on_ends_with_words() -> None:
    explorer = Explorer(START, time_s=30.0, speed_m_s=0.5, clearance_m=0.4)
    track, _ = fly_by_sight(explorer, sight_m=1.5, moves=False)
    assert explorer.ended
    assert len(track) / 10 <= 30.0 + LATE_S + 1
    goals = [one.leg.goal for one in explorer.decisions]
    assert max(np.linalg.norm(goal - goals[0]) for goal in goals) > 1.0  # where the guard stops it, it tries others


@pytest.mark.parametrize(("door_m", "fits"), [(1.2, True), (0.6, False)])
def test_a_pilot_flies_through_a_door_that_fits_and_else_says_so(door_m: float, fits: bool) -> None:
    """Two rooms of 2.7 x 4 m; the pilot needs 0.4 m to each side."""
    cells, half = hall(), round(door_m / 0.2)
    cells[:, 32:35] = 95
    cells[25 - half : 25 + half, 32:35] = 5
    explorer = Explorer(START, time_s=90.0, speed_m_s=0.5, clearance_m=0.4)
    track, omap = fly_by_sight(explorer, sight_m=1.5, cells=cells)
    assert explorer.at_home
    assert (max(place[0] for place in track) > 3.2) == fits
    assert ("could not be reached, as surfaces leave too little room" in explorer.ended) == (not fits)
    assert (omap.percent[5:45, 36:65] != UNKNOWN).mean() > 0.9 or not fits


def test_a_pilot_without_room_is_boxed_in_and_says_so() -> None:
    explorer = Explorer(START, time_s=60.0, speed_m_s=0.5, clearance_m=0.4)
    cells = hall()
    cells[5:26, 5:26] = 95
    cells[12:19, 12:19] = 5
    track, _ = fly_by_sight(explorer, sight_m=1.5, cells=cells)
    assert "boxed in" in explorer.ended
    assert explorer.at_home
    assert len(track) / 10 < 10


def test_a_pilot_through_free_space_only_never_has_its_clearance_over_a_cell_not_known_free() -> None:
    explorer = Explorer(START, time_s=100.0, speed_m_s=0.5, clearance_m=0.4, free_probability=0.95)
    track, omap = fly_by_sight(explorer, sight_m=1.5)
    assert explorer.at_home
    assert (omap.percent[5:45, 5:65] != UNKNOWN).mean() > 0.9
    x, y = np.meshgrid(GRID.x_m, GRID.y_m)
    known = np.zeros(GRID.shape, bool)
    for step, place in enumerate(track):
        away_m = np.hypot(x - place[0], y - place[1])
        assert known[away_m <= 0.3].all() or not step  # less a cell
        known |= (away_m <= 1.5) & (hall() == 5)


@pytest.mark.parametrize("free_start_m", [0.0, 1.2])
def test_a_flight_through_free_space_only_leaves_where_its_start_is_free_and_else_says_why_not(
    free_start_m: float,
) -> None:
    """By the map of each decision: the hull covers no cell that is not known free, but at the start."""
    low = [QUICK[0], "flight.waypoints=[[-1,0,-0.3]]", "flight.guard.on=true"]  # it lands soon
    options = [*low, "flight.free_probability=0.95", f"flight.free_start_m={free_start_m}"]
    flight = prepare(make_scenario({"name": "explore"}, options=options), time_s=40.0, scene=ROOM)
    grid, history = Grid.covering(ROOM.bounds, 0.1, z_m=-0.3), MapHistory()
    run(flight, stages=[MapStage(grid, every_s=0.5, live=True)], sinks=[flight.maps, history])
    assert flight.pilot.at_home
    assert flight.pilot.landed
    if not free_start_m:
        assert "boxed in: mapped surfaces and space not known to be free at 0.95 leave no room" in flight.summary()
        return
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    places, times = flight.aloft.position, np.array([t_s for t_s, _ in history.maps()])
    safe = np.hypot(x - places[0, 0], y - places[0, 1]) <= free_start_m
    for t_ns, place in zip(flight.aloft.t_ns, places, strict=True):
        away_m = np.hypot(x - place[0], y - place[1])
        if (before := int(np.searchsorted(times, t_ns * 1e-9 - 1e-9)) - 1) >= 0:
            percent = history.maps()[before][1].percent
            assert (safe | ((percent >= 0) & (percent <= 5)))[away_m <= 0.4].all()
        safe |= away_m <= 0.25
    assert np.linalg.norm(places - places[0], axis=1).max() > free_start_m


def test_the_same_seed_gives_the_same_flight_and_frames_carry_its_believed_poses() -> None:
    given: list[bool] = []

    def shifted(truth: ul.Trajectory, frames: object) -> ul.Trajectory:
        given.append(all(part.poses is None and part.truth is None for part in frames.values()))  # type: ignore[attr-defined]
        return truth

    low = ["sensing.rate_hz=10", "flight.waypoints=[[-1,0,-0.8]]"]  # it lands soon
    first = ul.explore(ROOM, time_s=19.0, seed=3, options=low)
    second = ul.explore(ROOM, time_s=19.0, seed=3, options=low, poses=shifted)
    assert np.array_equal(first.flown.position, second.flown.position)
    assert np.array_equal(first.frames["front"].samples, second.frames["front"].samples)
    assert [one.leg.words for one in first.decisions] == [one.leg.words for one in second.decisions]
    assert first.decisions[0].leg.kind == "view"
    assert not first.contacts
    assert len(given) == len(second.flown)
    assert all(given)


@pytest.mark.usefixtures("heeded_signals")
def test_ctrl_c_ends_the_flight_in_order() -> None:
    def stop(words: str) -> None:
        signal.raise_signal(signal.SIGINT)

    explored = ul.explore(ROOM, time_s=60.0, options=QUICK, progress=stop)
    assert explored.flown.duration_s < 2
    assert explored.summary.startswith("The flight ended by hand")
    assert not explored.at_home


def test_the_surface_to_explore_is_what_the_vehicle_could_see_from_where_it_fits() -> None:
    grid = Grid.covering(ROOM.bounds, 0.1, z_m=0.0)
    places = reachable(ROOM, np.array([-1.0, 0.0, 0.0, 0.0]), clearance_m=0.7)
    assert np.abs(places[:, :2]).max(0) == pytest.approx([2.3, 1.8], abs=0.16)
    surface = observable_from(ROOM, grid, ul.Rig.preset("thesis-4"), places[::4])
    assert 0.7 < surface.observable(1).mean() <= 1.0
    percent = np.zeros(grid.shape, np.int8)
    percent[0] = 95  # the wall in the south
    shown = on_map(OccupancyMap(grid, percent), surface.points)
    assert shown[surface.points[:, 1] < -2.45].all()
    assert not shown[surface.points[:, 1] > -2.2].any()


@pytest.mark.slow
def test_a_drone_flies_through_an_opening_of_a_web_frame_and_back() -> None:
    """The first web stands at x = -4.8 m; its opening is 1.8 m wide, and hull and margin take 1.4 m."""
    explored = ul.explore("ballast-tank", time_s=60.0, seed=1)
    assert explored.flown.position[:, 0].max() > -4.0
    assert explored.at_home
    assert not explored.contacts


@pytest.mark.slow
def test_a_room_is_explored_without_contact_and_the_run_folder_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["explore", "ntnu-room", "--time", "60", "--seed", "1", "-o", "sensing.rate_hz=10"])
    assert done.exit_code == 0, done.output
    folder = Path("runs/latest")
    metrics = {name: one["value"] for name, one in json.loads((folder / "metrics.json").read_text()).items()}
    assert metrics["contacts"] == 0
    assert metrics["closest_approach"] >= 0.25
    assert metrics["explored"] > 0.5
    assert metrics["explored"] >= metrics["explored_at_25"]
    assert "The flight ended on the ground at home" in (folder / "verdict.txt").read_text()
    assert (folder / "figures" / "explore.png").stat().st_size > 10_000
    assert len(ul.open(folder / "frames.mcap").frames()) == 4
    assert math.isfinite(metrics["flight_length"])


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["explore", "ntnu-rom"], "no scenario or world 'ntnu-rom'; did you mean 'ntnu-room'"),
        (["explore", "ntnu-room", "--height", "2.95"], "the start at"),
        (["explore", "ntnu-room", "-o", "flight.speed=1"], "flight.speed"),
        (["explore", "ntnu-room", "-o", "sensing.rate_hz=2"], "flight.guard.latency_s"),
        (["explore", "ntnu-room", "-o", "flight.free_probability=0.3"], "flight.free_probability"),
        (["explore", "ntnu-room", "-o", "flight.free_start_m=-1"], "flight.free_start_m"),
    ],
)
def test_what_cannot_be_explored_is_refused_in_one_line(
    words: list[str], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, words)
    assert isinstance(done.exception, InputError)
    assert says in str(done.exception)
    assert not list(tmp_path.glob("runs/*/frames.mcap"))


def test_poses_that_are_no_source_of_poses_are_refused() -> None:
    with pytest.raises(InputError, match=r"poses is .gps..*\"radar\", or a callable"):
        ul.explore("ntnu-room", poses="gps")  # type: ignore[arg-type]
