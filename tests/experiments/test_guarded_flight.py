"""Flights in closed loop: the guard sees what the radars receive, and the vehicle flies what the guard allows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import ullage as ul
from ullage.cli import app
from ullage.config import Scenario, make_scenario
from ullage.data import Frames
from ullage.errors import InputError
from ullage.experiments.guarded_flight import GuardedFlight, Loop, WaypointFollower
from ullage.experiments.simulated import prepare
from ullage.flight.airframe import airframe
from ullage.world.scene import Scene

HULL_M = airframe("hector").radius_m
POINTS = np.array([[-0.2, 0.0, -0.3], [2.9, 0.0, -0.3]])
ROOM = ul.scenes.room(size_m=(6, 5, 3))


def scenario(speed_m_s: float = 0.8, **flight: object) -> Scenario:
    guard = {"on": True, "give_up_s": 0.8}
    return make_scenario({"name": "x", "flight": {"speed_m_s": speed_m_s, "guard": guard, **flight}})


def flight(plan: Scenario, **changes: object) -> GuardedFlight:
    return Loop(plan, ROOM, plan.sensing.radars(), 10.0, **changes).fly(POINTS)  # type: ignore[arg-type]


def test_a_flight_at_a_wall_stops_before_it_and_without_a_guard_hits_it() -> None:
    plan = scenario()
    stopped = flight(plan)
    gap = 3.0 - stopped.flown.position[:, 0].max() - HULL_M
    assert not stopped.contacts
    assert not stopped.arrived
    assert 0.2 < gap < 0.6
    assert stopped.steps[-1].limit.sensor == "front"
    hit = Loop(plan, ROOM, ul.Rig.preset("single"), 10.0, guarded=False).fly(POINTS)
    assert hit.contacts


def test_a_radar_that_falls_silent_stops_the_flight_within_the_limit_of_staleness() -> None:
    def without_front_after_2_s(chunk: dict[str, Frames]) -> dict[str, Frames]:
        lost = int(next(iter(chunk.values())).t_ns[0]) > 2e9
        return {name: part for name, part in chunk.items() if not (lost and name == "front")}

    plan = scenario(0.5)
    lost = flight(plan, receive=without_front_after_2_s)
    at_loss = np.searchsorted(lost.flown.t_ns, 2e9)
    travelled = lost.flown.position[-1, 0] - lost.flown.position[at_loss, 0]
    assert lost.steps[-1].limit.state == "stop"
    assert lost.steps[-1].limit.sensor == "front"
    assert not lost.contacts
    assert travelled < 0.5 * (plan.flight.guard.stale_s + 0.9)


def test_waypoints_are_followed_in_order_to_the_last() -> None:
    follower = WaypointFollower(np.array([[0, 0, 1.0], [1, 0, 1], [1, 1, 1]]), 0.5)
    place, seen = np.array([0.0, 0.2, 1.0]), []
    for _ in range(400):
        place = place + 0.02 * follower.velocity(place)
        seen.append(place)
    assert follower.arrived
    assert place == pytest.approx([1, 1, 1], abs=0.13)
    assert min(np.linalg.norm(np.array(seen) - [1, 0, 1], axis=1)) < 0.2


def test_one_waypoint_is_no_guarded_flight() -> None:
    plan = scenario()
    with pytest.raises(InputError, match=r"one waypoint.*two or more"):
        Loop(plan, ROOM, plan.sensing.radars(), 10.0).fly(POINTS[:1])


def test_a_latency_shorter_than_a_frame_is_refused() -> None:
    plan = scenario()
    with pytest.raises(InputError, match=r"flight.guard.latency_s: 2 frames a second.*>= one frame, 0.5 s"):
        Loop(plan, ROOM, plan.sensing.radars(), 2.0).fly(POINTS)


@pytest.mark.slow
@pytest.mark.parametrize(("radius_m", "speed_m_s"), [(0.0015, 1.0), (0.01, 0.5)])
def test_a_thin_thing_across_the_path_stops_the_flight_before_it(radius_m: float, speed_m_s: float) -> None:
    """A level wire of 3 mm at 1 m/s, and a pole of 2 cm at 0.5 m/s, both without an end in the main lobe."""
    ends = np.array([[1.5, -2.4, -0.3], [1.5, 2.4, -0.3]] if radius_m < 0.01 else [[1.5, 0.1, -1.5], [1.5, 0.1, 1.5]])
    scene = Scene.union([ROOM, Scene.of_wires(ends[:1], ends[1:], radius_m, name="thin")])
    plan = scenario(speed_m_s)
    points = np.array([[-2.2, 0.0, -0.3], [2.2, 0.0, -0.3]])
    stopped = Loop(plan, scene, plan.sensing.radars(), 10.0).fly(points)
    gap = 1.5 - radius_m - stopped.flown.position[:, 0].max() - HULL_M
    assert not stopped.contacts
    assert not stopped.arrived
    assert plan.flight.guard.margin_m - 0.05 < gap < 0.8


@pytest.mark.slow
def test_run_with_the_guard_on_writes_a_run_and_says_why_it_ended(tmp_path: Path) -> None:
    file = tmp_path / "wall.yaml"
    file.write_text(
        "world: {name: ntnu-room}\nflight: {speed_m_s: 0.6, waypoints: [[0, 0, 1.2], [9, 0, 1.2]]}\n"
        "sensing: {rate_hz: 10}\ndo: [detect]\n"
    )
    result = CliRunner().invoke(
        app, ["run", str(file), "-o", "flight.guard.on=true", "-o", "flight.guard.give_up_s=1", "--out", str(tmp_path)]
    )
    assert result.exit_code == 0, result.output
    assert (tmp_path / "latest" / "frames.mcap").exists()


def test_a_guard_that_stops_where_echoes_fold_says_so() -> None:
    plan = make_scenario({
        "name": "hold", "world": {"name": "cargo-hold"}, "sensing": {"rate_hz": 10},
        "flight": {"speed_m_s": 0.6, "guard": {"on": True, "give_up_s": 0.5}, "waypoints": [[0, 9, 4], [0, 13, 4]]},
    })  # fmt: skip
    with pytest.warns(ul.UllageWarning, match=r"31 m long, .* beyond 9.9 m .* larger sensing.changes.prf_div"):
        prepare(plan)
