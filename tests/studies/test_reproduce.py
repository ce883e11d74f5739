"""The reproduction: what is done is kept, what is broken is told, and the small run holds all its statements."""

from __future__ import annotations

import json
import math
import re
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import ullage as ul
from studies.thesis import maps, rail, rest
from studies.thesis.plan import EXPERIMENTS, Experiment, wanted
from studies.thesis.report import opening
from studies.thesis.reproduce import reproduce
from studies.thesis.results import Results, Statement, read_results
from studies.thesis.workspace import Flown, Workspace
from ullage.cli import app
from ullage.errors import InputError, UllageError
from ullage.experiments.catalog import find_scenario, scenario_names
from ullage.experiments.simulated import Simulated
from ullage.radar.receiver import receive

PATH = ul.Trajectory.line((0, -0.5, 0), (0, 0.5, 0), 0.5, 10)


@dataclass(frozen=True, slots=True)
class Told(Experiment):
    """An experiment that says a number, or is interrupted."""

    number: float = 1.0
    calls: list[str] = field(default_factory=list)
    stops: bool = False

    def run(self, work: Workspace) -> None:
        self.calls.append(self.name)
        if self.stops and len(self.calls) == 1:
            raise KeyboardInterrupt
        work.results.add_statement("the number is small", "6.1", self.number, "m", low=0, high=2)

    def reads(self, recordings: Path) -> list[Path]:
        return []


@pytest.mark.parametrize(
    ("value", "low", "high", "holds"),
    [(1, 0, 2, True), (3, 0, 2, False), (-1, 0, None, False), (math.nan, None, None, False), (5, None, None, True)],
)
def test_a_statement_holds_within_its_bounds_and_never_unknown(value, low, high, holds):
    assert Statement("it", "6", value, "", low, high).holds is holds


def test_results_come_back_as_they_were_written(tmp_path):
    found = Results()
    found.add_statement("known", "6.1", 0.25, "m", high=1)
    found.add_statement("unknown", "6.1", math.nan)
    found.add_figure(tmp_path / "a.png", "figure 6.3", "a plate")
    found.add_table("t", ("a", "b"), [("1", "2")], note="n")
    found.numbers["x"] = 2.0
    found.write(tmp_path / "results.json", inputs="abc")
    back = read_results(tmp_path / "results.json")
    assert back.statements[0] == found.statements[0]
    assert math.isnan(back.statements[1].value)
    assert (back.figures, back.tables, back.numbers) == (found.figures, found.tables, found.numbers)


def test_what_is_done_is_not_done_again_and_what_was_interrupted_is(tmp_path):
    first, second = Told("first", "First", "6.1"), Told("second", "Second", "6.2", stops=True)
    done = reproduce(tmp_path, [first, second], quick=True)
    assert done.interrupted
    assert [c.experiment.name for c in done.chapters] == ["first"]
    assert "Interrupted: 1 of 2" in done.report.read_text()
    again = reproduce(tmp_path, [first, second], quick=True)
    assert not again.interrupted
    assert (first.calls, second.calls) == (["first"], ["second", "second"])
    assert again.counts == (2, 2)
    assert re.search(r"Small run \(`--quick`\) of commit \S+, \d{4}-\d\d-\d\d, on .*load", again.report.read_text())
    reproduce(tmp_path, [first], quick=True, fresh=True)
    assert first.calls == ["first", "first"]


def test_a_statement_out_of_bounds_is_told(tmp_path):
    done = reproduce(tmp_path, [Told("wrong", "Wrong", "6.1", number=3.0)])
    assert len(done.broken) == 1
    assert "the number is small: 3 m, wanted >= 0 and <= 2" in done.broken[0]
    assert json.loads((done.folder / "verdict.json").read_text())["broken"] == done.broken
    assert "Out of bounds" in done.report.read_text()


@dataclass(frozen=True, slots=True)
class Apart(Experiment):
    """An experiment for a process of its own: it fails, or waits, or says a number."""

    how: str = "says"

    def run(self, work: Workspace) -> None:
        if self.how == "fails":
            raise UllageError("the radar is on fire")
        if self.how == "waits":
            time.sleep(600)
        work.results.add_statement("it is done", "6.1", 1.0)

    def reads(self, recordings: Path) -> list[Path]:
        return []


def test_ctrl_c_ends_the_processes_and_keeps_what_is_done(tmp_path):
    def pressed(done: int, text: str) -> None:
        if done == 2:
            raise KeyboardInterrupt

    trio = [
        Apart("one", "One", "6.1"),
        Apart("two", "Two", "6.2", weight=2.0),
        Apart("three", "Three", "6.3", how="waits"),
    ]
    found = reproduce(tmp_path, trio, jobs=2, report_progress=pressed)
    assert found.interrupted
    assert [c.experiment.name for c in found.chapters] == ["one", "two"]
    assert "Interrupted: 2 of 3" in found.report.read_text()
    seen: list[int] = []
    done = reproduce(tmp_path, trio[:2], report_progress=lambda done, text: seen.append(done))
    assert [c.experiment.name for c in done.chapters] == ["one", "two"]
    assert min(seen) == 2  # both were done before


def test_an_experiment_that_fails_is_named(tmp_path):
    with pytest.raises(UllageError, match="Three: the radar is on fire"):
        reproduce(tmp_path, [Apart("one", "One", "6.1"), Apart("three", "Three", "6.3", how="fails")])


def test_an_unknown_experiment_is_refused_by_name():
    with pytest.raises(InputError, match=r"no experiment 'detektion'.*detection"):
        wanted(False, ["detektion"])
    assert [e.name for e in wanted(False, ["detection"])] == ["detection"]


def test_every_scenario_of_the_thesis_says_where_in_it_it_belongs():
    for name in scenario_names():
        of_thesis = find_scenario(name).world.name.startswith(("ntnu", "cluttered", "cargo"))
        assert ("(thesis 6." in find_scenario(name).title) == of_thesis


def test_the_page_opens_with_what_holds_what_differs_and_every_figure(tmp_path):
    found = Results()
    found.add_statement("it grows", "7.1", 1.0, low=0)
    found.add_statement("ours", "beyond", 1.0, low=0)
    found.add_difference("figure 6.14", "it says so", "it does not", "unknown")
    found.not_compared.append("no recording")
    found.add_figure(tmp_path / "hold.png", "figures 6.15 to 6.17", "the hold")
    found.write(tmp_path / "results.json")
    found = opening([("The hold", read_results(tmp_path / "results.json"))])
    assert found["holds"] == ["The hold: 1 of 1 statements about the thesis hold."]
    assert found["differs"][0].cause == "unknown"
    assert found["lacking"] == ["no recording"]
    assert [row["number"] for row in found["figures"]] == [f"6.{k}" for k in range(1, 19)]
    assert [row["here"] for row in found["figures"][14:17]] == ["The hold: hold.png"] * 3


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_the_small_reproduction_holds_everything_it_states(tmp_path):
    told = CliRunner().invoke(app, ["reproduce", "--quick", "--out", str(tmp_path)])
    assert told.exit_code == 0, told.output
    verdict = json.loads((tmp_path / "quick" / "verdict.json").read_text())
    assert set(verdict["experiments"]) == {e.name for e in EXPERIMENTS if e.quick}
    assert verdict["holding"] == verdict["statements"] >= 20


def test_waveforms_are_laid_on_each_other_at_their_lag():
    place = np.array([3.0, 0.0, 0.0])
    spec = ul.RadarSpec.preset("pulson440", noise=None, bins=600)
    path = ul.Trajectory.line((0, -0.2, 0), (0, 0.2, 0), 0.5, 20)
    corner = ul.scenes.trihedral(edge_m=0.2, distance_m=3.0)
    twin = ul.simulate(corner, path, spec, max_bounces=3)
    late = replace(twin, samples=np.roll(twin.samples, 7, axis=1))
    found = rail.echoes(late, twin, place)
    assert np.allclose(found.lag_m, 7 * spec.bin_m)
    assert np.allclose(found.correlation, 1.0, atol=1e-6)
    turned = replace(twin, samples=-twin.samples)
    assert np.median(rail.echoes(turned, twin, place).correlation) < 0.95  # a waveform, not an envelope, is compared


def test_a_radar_at_rest_is_measured_alike_whatever_its_scale():
    spec = ul.RadarSpec.preset("x4m05", iterations=4, pulses_per_step=1, bins=180)
    rows = receive(np.zeros((600, 180), np.complex64), spec, seed=3).astype(np.complex128)
    once, twice = rest.measure(rows, spec), rest.measure(3 * rows, spec)
    assert twice["noise"] == pytest.approx(3 * once["noise"])
    assert twice["direct"] == pytest.approx(once["direct"])
    assert 0.5 < once["lag 1"] < 0.75
    assert 40 < once["direct"] < 60


def test_false_cells_are_those_far_from_everything_true():
    wall = ul.scenes.plate(2, 2, 3.0)
    frames = ul.simulate(wall, PATH, ul.RadarSpec.preset("x4m05"), fidelity="thesis")
    flown = Flown("wall", Simulated(None, wall, PATH, PATH, None), {"front": frames}, None, None, {})
    grid = ul.Grid.covering([(0, -2, 0), (4, 2, 0)], 0.1, z_m=0.0)
    percent = np.zeros(grid.shape, np.int8)
    percent[20, 29] = 100  # on the plate
    percent[20, 10] = percent[30, 10] = 100  # nowhere
    omap = ul.OccupancyMap(grid, percent)
    assert maps.false_cells(omap, flown) == 2
    assert maps.false_cells(omap, flown, around=[np.array([1.0, 0.0])], radius_m=0.5) == 1


@pytest.mark.parametrize("name", scenario_names())
def test_every_scenario_sets_bounds_on_metrics_that_runs_have(name: str) -> None:
    known = {"detections", "f1", "precision", "recall", "known_behind", "surface_declared_free"}
    known |= {"accuracy_median", "completeness_p90", "free_found", "f1_half_cell", "brier"}
    bounds = find_scenario(name).expect
    assert bounds
    assert set(bounds) <= known
