"""Sweeps: every combination once, what is there is kept, and the table holds each run's numbers."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from process_table import alive
from typer.testing import CliRunner

import ullage as ul
from ullage.cli import app
from ullage.experiments.folder import write_json
from ullage.experiments.sweep import Point, Sweep, axis_of, plan, sweep

SMALL = ("flight.waypoints=[[0, 0, 1], [0.5, 0, 1]]", "flight.vehicle=ideal", "do=[detect, map]")


@pytest.mark.parametrize(
    ("text", "key", "values"),
    [
        ("map.step_m=0.1,0.2", "map.step_m", ["0.1", "0.2"]),
        ("navigation.noise_m=1e-3", "navigation.noise_m", ["1e-3"]),
        ("flight.wind_m_s=[0, 0, 0],[1, 0, 0]", "flight.wind_m_s", ["[0, 0, 0]", "[1, 0, 0]"]),
    ],
)
def test_an_axis_is_read_as_yaml(text, key, values):
    assert axis_of(text) == (key, values)


@pytest.mark.parametrize("text", ["map.step_m", "map.step_m=", "=1", "a=[1", "a=}"])
def test_what_is_no_axis_is_refused(text):
    with pytest.raises(ul.InputError, match=r"--over: cannot read .*map\.step_m=0\.1,0\.2"):
        axis_of(text)


def test_every_combination_comes_once_with_each_seed(tmp_path):
    over = {"map.step_m": ["0.1", "0.2"], "navigation.noise_m": ["0", "0.01", "0.1"]}
    points = plan("ntnu-plate", over, seeds=2, out=tmp_path)
    assert len({point.folder for point in points}) == len(points) == 12
    assert {point.seed for point in points} == {7, 8}
    assert points[0].title == "map.step_m=0.1 navigation.noise_m=0 seed=7"
    assert not tmp_path.joinpath("sweep.csv").exists()


def test_what_a_scenario_has_not_is_refused_before_anything_runs(tmp_path):
    with pytest.raises(ul.InputError, match=r"map\.step"):
        plan("ntnu-plate", {"map.step_m": ["0.1", "-1"]}, out=tmp_path)
    with pytest.raises(ul.InputError, match=r"20000 runs .*at most 10000"):
        plan("ntnu-plate", {}, seeds=20_000, out=tmp_path)


def test_runs_are_done_once_and_tabulated(tmp_path):
    words = ["sweep", "ntnu-plate", "--over", "map.step_m=0.2,0.5", "--jobs", "1", "--out", str(tmp_path)]
    words += [word for option in SMALL for word in ("-o", option)]
    told = CliRunner().invoke(app, words)
    assert told.exit_code == 0, told.output
    assert "2 of 2 runs" in told.output
    rows = list(csv.DictReader(tmp_path.joinpath("sweep.csv").open()))
    assert [row["map.step_m"] for row in rows] == ["0.2", "0.5"]
    for row in rows:
        metrics = json.loads((tmp_path / row["run"] / "metrics.json").read_text())
        assert float(row["detections"]) == metrics["detections"]["value"]
    before = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*/metrics.json")}
    assert CliRunner().invoke(app, [*words, "--metric", "nonsense"]).exit_code != 0
    assert {path: path.stat().st_mtime_ns for path in tmp_path.glob("*/metrics.json")} == before


def planted(folder, seed, value):
    point = Point("s", (("a", "1"),), (), seed, folder / f"s-{seed}")
    point.folder.mkdir()
    write_json(point.folder / "metrics.json", {"f1": {"value": value, "unit": ""}})
    write_json(point.folder / "provenance.json", {"interrupted": False})
    return point


def test_seeds_are_summed_up_by_mean_and_deviation(tmp_path):
    points = tuple(planted(tmp_path, seed, value) for seed, value in ((1, 0.5), (2, 0.7), (3, None)))
    done = Sweep(points, tmp_path / "sweep.csv", False)
    count, mean, spread = done.summary("f1")[("a", "1"),]
    assert (count, mean, spread) == (2, pytest.approx(0.6), pytest.approx(0.02**0.5))
    with pytest.raises(ul.InputError, match="no run gave 'f2'"):
        done.summary("f2")


class Stopped(Point):
    """A run that Ctrl-C meets."""

    def do(self, say):
        raise KeyboardInterrupt


def test_ctrl_c_keeps_what_is_done(tmp_path):
    done, cut = planted(tmp_path, 1, 0.5), Stopped("s", (("a", "1"),), (), 2, tmp_path / "s-2")
    found = sweep([done, cut], out=tmp_path)
    assert found.interrupted
    assert found.done == (done,)
    assert len(tmp_path.joinpath("sweep.csv").read_text().splitlines()) == 2


class Failing(Point):
    """A run that cannot be made."""

    def do(self, say):
        raise ul.InputError("no such wall", where="world") if self.seed == 2 else ZeroDivisionError("by nought")


def test_a_run_that_fails_is_a_row_with_its_reason(tmp_path):
    points = [
        planted(tmp_path, 1, 0.5),
        *(Failing("s", (("a", "1"),), (), seed, tmp_path / f"s-{seed}") for seed in (2, 3)),
    ]
    found = sweep(points, out=tmp_path)
    assert not found.interrupted
    rows = list(csv.DictReader(found.table.open()))
    assert [row["seed"] for row in rows] == ["1", "2", "3"]
    assert [row["f1"] for row in rows] == ["0.5", "", ""]
    assert [row["failed"] for row in rows] == ["", "world: no such wall", "ZeroDivisionError: by nought"]


SLEEPERS = """
import sys, time
from dataclasses import dataclass
from pathlib import Path
from ullage.experiments.cluster import carry_out

@dataclass
class Sleeper:
    name: str
    folder: Path
    title: str = "sleeps"
    cost: float = 1.0
    done: bool = False

    def do(self, say):
        import os
        started = self.folder / f"{self.name}.starts"
        started.write_text(str(os.getpid()))
        started.rename(self.folder / f"{self.name}.pid")
        time.sleep(600)  # says nothing, so that no broken pipe ends it either

if __name__ == "__main__":
    carry_out([Sleeper(str(n), Path(sys.argv[1])) for n in range(2)], where=2)
"""


def within_a_minute(reached) -> bool:
    end = time.monotonic() + 60
    while not reached() and time.monotonic() < end:
        time.sleep(0.05)
    return reached()


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_workers_end_with_their_parent_however_it_ends(tmp_path):
    """Those that are silent too, which would work on for ten minutes."""
    (tmp_path / "sleepers.py").write_text(SLEEPERS)
    parent = subprocess.Popen([sys.executable, tmp_path / "sleepers.py", tmp_path])
    assert within_a_minute(lambda: len(list(tmp_path.glob("*.pid"))) == 2)
    workers = [int(path.read_text()) for path in tmp_path.glob("*.pid")]
    try:
        assert all(map(alive, workers))
        parent.send_signal(signal.SIGKILL)
        parent.wait()
        assert within_a_minute(lambda: not any(map(alive, workers)))
    finally:
        for pid in filter(alive, workers):
            os.kill(pid, signal.SIGKILL)
