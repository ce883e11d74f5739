"""The runner of flights with an autopilot's own simulator: what it does without one, and how it measures a flight."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pymavlink")

import fly_autopilot
import ullage as ul
from fly_autopilot import AHEAD_M, CASES, CEILING_M, Flight, measure, table
from studies.tables import autopilot

START = (0.0, 0.0, 1.5)


def straight(to_m: float, *, climbs: bool = False) -> object:
    """Times and places of a straight flight along +x, or up, a tenth of a second apart."""
    way = np.linspace(0, to_m, 200)
    return np.stack([0.1 * np.arange(200), 0 * way if climbs else way, 0 * way, 1.5 + way * climbs], axis=1)


def test_without_a_binary_it_flies_nothing_and_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["fly_autopilot", "--binary", str(tmp_path / "none"), "--to", str(tmp_path)])
    fly_autopilot.main()
    assert "skipped: no program at" in capsys.readouterr().out
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", list(CASES))
def test_a_flight_through_the_obstacle_is_a_hit_and_one_that_stops_is_none(name: str) -> None:
    if CASES[name].passes or CASES[name].speeds_m_s == (0.0,):
        return
    through, before = Flight(name, "guided", 1.0), Flight(name, "guided", 1.0)
    climbs, at_m = CASES[name].climbs, CEILING_M - 1.5 if CASES[name].climbs else AHEAD_M
    measure(through, CASES[name], straight(at_m + 3, climbs=climbs), START)
    measure(before, CASES[name], straight(at_m - 2, climbs=climbs), START)
    assert through.hit
    assert not before.hit
    assert before.closest_m == pytest.approx(2.0, abs=1.1)  # a slanted wall and a corner are nearer beside the path
    assert through.fastest_m_s == pytest.approx((at_m + 3) / 19.9, rel=0.02)
    assert "| hit |" in table([through, before])


def test_a_gap_and_a_wall_beside_let_it_pass() -> None:
    for name, away_m in (("gap 1.5 m", 0.75), ("gap 2.2 m", 1.1), ("wall 1 m beside", 1.0)):
        flight = Flight(name, "guided", 1.0)
        measure(flight, CASES[name], straight(AHEAD_M + 3), START)
        assert not flight.hit
        assert flight.closest_m == pytest.approx(away_m, abs=0.01)


def test_an_explored_flight_s_contacts_are_those_of_the_true_place_before_it_lands() -> None:
    room = ul.scenes.room(size_m=(6, 5, 3))
    times, x = np.arange(301) * 0.1, np.zeros(301)
    x[50:100], x[150:200] = 2.8, 2.3  # in the wall at 3 m once, with a hull of 0.40 m; then 0.3 m from it
    truth = np.stack([times, x, 0 * x, np.where(times < 25, 0.0, -1.4)], axis=1)
    estimate = truth + np.array([0.0, 0.1, 0.0, 0.0])
    verdict = "map and image were up to 1.3 s behind\nSet-points left 40 ms (median) and 90 ms (99 %) after"
    seen = autopilot.Flown(truth, estimate, 1.0, {"duration": 30.0, "explored": 0.5}, verdict, "", "")
    row = autopilot.row_of(room, seen, 2.0)
    contacts, closest = row[2].split("; ")
    assert contacts == "1"
    assert float(closest) == pytest.approx(0.2 - 0.4, abs=0.01)
    assert row[3] == "40; 90"
    assert row[4] == "2.0; 1.3"
    assert autopilot.pose_error_m(seen) == pytest.approx(0.1)
    assert len(row) == len(autopilot.HEADER) - 1
