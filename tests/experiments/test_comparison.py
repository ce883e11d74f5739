"""Comparing a run with another law on the same flight, and saying what the map found and missed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ullage as ul
from ullage.cli import main
from ullage.data import Metric
from ullage.experiments.catalog import rival_scenario
from ullage.experiments.verdict import found_line, inspect, place_of

SHORT = ["flight.waypoints=[[-1.5, -1, 1], [-1, -1, 1]]", "flight.vehicle=ideal", "map.step_m=0.2"]


def test_a_run_is_compared_with_another_law_on_the_same_flight(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    options = [word for option in SHORT for word in ("-o", option)]
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        main(["run", "ntnu-mapping", "--do", "map", "--compare", "thesis", *options])
    assert not end.value.code
    said = capsys.readouterr().out.splitlines()
    f1 = json.loads(Path("runs/latest/metrics.json").read_text())["f1"]["value"]
    kept = json.loads(Path("runs/latest/findings.json").read_text())
    assert kept["compared"]["metrics"]["f1"]["value"] == f1  # the same law: the same score
    assert said[-2].startswith(f"found: F1 {f1:.3f}, ")
    assert said[-1] == f"the method of 2018 on the same flight: F1 {f1:.3f}"
    assert f"The method of 2018 on the same flight reaches F1 {f1:.3f}." in Path("runs/latest/report.html").read_text()


def test_only_the_same_flight_is_compared() -> None:
    with pytest.raises(ul.InputError, match=r"--compare: 'walls\.yaml' is no shipped scenario"):
        rival_scenario("walls.yaml", "thesis")
    with pytest.raises(ul.InputError, match="no law 'optics'"):
        rival_scenario("cargo-hold", "optics")


def test_an_object_without_an_occupied_cell_is_missed() -> None:
    room = {"size_m": (6, 4, 3), "plate": {"width_m": 0.5, "height_m": 0.5, "distance_m": 2.0}}
    scene = ul.scenes.room(**room)
    frames = ul.simulate(
        scene, ul.Trajectory.line((0, -0.3, 0), (0, 0.3, 0), 0.5, 10), ul.Rig.preset("thesis-4"), fidelity="thesis"
    )
    grid = ul.Grid.covering(scene.bounds, 0.1, z_m=0.0, margin_m=0.5)
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    walls = (abs(abs(x) - 3) < 0.11) & (abs(y) < 2.1) | (abs(abs(y) - 2) < 0.11) & (abs(x) < 3.1)
    percent = np.where(walls, 100, 0).astype(np.int8)
    found = {one.name: one.state for one in inspect(ul.OccupancyMap(grid, percent), scene, frames)[0]}
    assert found.pop("plate") == "missed"
    assert set(found.values()) == {"mapped"}
    plate = (abs(x - 2) < 0.1) & (abs(y) < 0.3)
    whole, left = inspect(ul.OccupancyMap(grid, np.where(walls | plate, 100, 0).astype(np.int8)), scene, frames)
    assert not len(left)
    assert {one.state for one in whole} == {"mapped"}
    nothing, left = inspect(ul.OccupancyMap(grid, np.zeros_like(percent)), scene, frames)
    assert len(left) > 100
    assert {one.state for one in nothing} <= {"missed", "not observable"}
    line = found_line(
        [replace(one, state="missed") if one.name == "plate" else one for one in whole], {"f1": Metric("f1", 0.5)}
    )
    assert line == (
        f"found: F1 0.500, {len(whole) - 1} of {len(whole)} objects in sight mapped; partly: none; missed: plate"
    )
    corner = (abs(x - 2.9) < 0.3) & (abs(y - 1.9) < 0.3)  # a few cells of walls that are in sight as a whole
    piece, _ = inspect(ul.OccupancyMap(grid, np.where(walls & corner, 100, 0).astype(np.int8)), scene, frames)
    assert "mapped" not in {one.state for one in piece}
    assert "partly mapped" in {one.state for one in piece}
    assert place_of(ul.OccupancyMap(grid, percent), scene, frames) == "In the plane 1.5 m above floor"
