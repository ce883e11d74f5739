"""The reproduction: what is done is kept, what is broken is told, and the small run holds all its statements."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from typer.testing import CliRunner

from ullage.cli import app
from ullage.errors import InputError
from ullage.experiments.catalog import find_scenario, scenario_names
from ullage.experiments.reproduce.bench import Bench
from ullage.experiments.reproduce.findings import Findings, Statement, read_findings
from ullage.experiments.reproduce.loop import reproduce
from ullage.experiments.reproduce.plan import EXPERIMENTS, Experiment, wanted


@dataclass(frozen=True, slots=True)
class Told(Experiment):
    """An experiment that says a number, or is interrupted."""

    number: float = 1.0
    calls: list[str] = field(default_factory=list)
    stops: bool = False

    def run(self, bench: Bench) -> None:
        self.calls.append(self.name)
        if self.stops and len(self.calls) == 1:
            raise KeyboardInterrupt
        bench.findings.hold("the number is small", "6.1", self.number, "m", low=0, high=2)

    def reads(self) -> list[Path]:
        return []


@pytest.mark.parametrize(
    ("value", "low", "high", "holds"),
    [(1, 0, 2, True), (3, 0, 2, False), (-1, 0, None, False), (math.nan, None, None, False), (5, None, None, True)],
)
def test_a_statement_holds_within_its_bounds_and_never_unknown(value, low, high, holds):
    assert Statement("it", "6", value, "", low, high).holds is holds


def test_findings_come_back_as_they_were_written(tmp_path):
    found = Findings()
    found.hold("known", "6.1", 0.25, "m", high=1)
    found.hold("unknown", "6.1", math.nan)
    found.show(tmp_path / "a.png", "figure 6.3", "a plate")
    found.tabulate("t", ("a", "b"), [("1", "2")], note="n")
    found.numbers["x"] = 2.0
    found.write(tmp_path / "findings.json", inputs="abc")
    back = read_findings(tmp_path / "findings.json")
    assert back.statements[0] == found.statements[0]
    assert math.isnan(back.statements[1].value)
    assert (back.exhibits, back.tables, back.numbers) == (found.exhibits, found.tables, found.numbers)


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
    reproduce(tmp_path, [first], quick=True, fresh=True)
    assert first.calls == ["first", "first"]


def test_a_statement_out_of_bounds_is_told(tmp_path):
    done = reproduce(tmp_path, [Told("wrong", "Wrong", "6.1", number=3.0)])
    assert len(done.broken) == 1
    assert "the number is small: 3 m, wanted >= 0 and <= 2" in done.broken[0]
    assert json.loads((done.folder / "verdict.json").read_text())["broken"] == done.broken
    assert "Out of bounds" in done.report.read_text()


def test_an_unknown_experiment_is_refused_by_name():
    with pytest.raises(InputError, match=r"no experiment 'detektion'.*detection"):
        wanted(False, ["detektion"])
    assert [e.name for e in wanted(False, ["detection"])] == ["detection"]


def test_every_scenario_says_where_in_the_thesis_it_belongs():
    for name in scenario_names():
        assert "(thesis 6." in find_scenario(name).title


@pytest.mark.slow
def test_the_small_reproduction_holds_everything_it_states(tmp_path):
    told = CliRunner().invoke(app, ["reproduce", "--quick", "--out", str(tmp_path)])
    assert told.exit_code == 0, told.output
    verdict = json.loads((tmp_path / "quick" / "verdict.json").read_text())
    assert set(verdict["experiments"]) == {e.name for e in EXPERIMENTS if e.quick}
    assert verdict["holding"] == verdict["statements"] >= 20
