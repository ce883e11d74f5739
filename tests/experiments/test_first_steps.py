"""What a newcomer does first: a flight beside an open world, and the last run taken up again."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ullage.config import make_scenario
from ullage.errors import InputError
from ullage.experiments.folder import RunFolder
from ullage.experiments.run import Run, of_scenario
from ullage.experiments.runner import execute
from ullage.experiments.simulated import prepare
from ullage.experiments.source_resolution import make_run
from ullage.ports import sink

WALL = """<sdf version="1.9"><world name="w"><model name="wall"><static>true</static><pose>4 0 1 0 0 0</pose>
<link name="l"><collision name="c"><geometry><box><size>0.1 4 2</size></box></geometry></collision></link></model>
</world></sdf>"""


def job(tmp_path: Path, *do: str, height_m: float = 1.0) -> Run:
    """A flight past a wall, in a folder of its own."""
    (tmp_path / "wall.sdf").write_text(WALL)
    (tmp_path / "run").mkdir()
    tree = {
        "name": "wall", "world": {"file": str(tmp_path / "wall.sdf")}, "do": do, "map": {"method": "elfes"},
        "flight": {"vehicle": "ideal", "waypoints": [[0, -1, height_m], [0, 1, height_m]]},
        "sensing": {"fidelity": "thesis", "rig": "single", "rate_hz": 5},
    }  # fmt: skip
    return of_scenario(RunFolder(tmp_path / "run"), prepare(make_scenario(tree)))


def test_the_map_holds_a_flight_that_stays_outside_the_world(tmp_path: Path) -> None:
    report = execute(job(tmp_path, "map"), log=lambda _: None)
    left, right, _, _ = report.outcome.results[0].grid.extent_m
    assert left <= 0
    assert right >= 4.05


def test_a_flight_above_all_walls_is_complete_without_scores(tmp_path: Path) -> None:
    report = execute(job(tmp_path, "map", height_m=3.0), log=lambda _: None)
    assert "f1" not in report.metrics
    assert "The map has no scores: w: no surface of the scene lies on the grid at z = 3.00 m." in report.findings
    assert "The map has no scores" in (report.folder / "report.html").read_text()


def test_the_last_run_can_be_taken_up_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import ullage as ul

    monkeypatch.chdir(tmp_path)
    first = tmp_path / "runs" / "flight-00000000"
    first.mkdir(parents=True)
    (tmp_path / "runs" / "latest").symlink_to(first.name)
    path = ul.Trajectory.line((0, 0, 0), (0, 1, 0), rate_hz=5)
    with sink(first / "frames.mcap") as taker:
        taker.write(ul.simulate(ul.scenes.plate(1, 1, 3), path, ul.RadarSpec.preset("x4m05")))
    with pytest.raises(InputError, match="no run 'latest'"):
        RunFolder.find("latest")
    job = make_run("runs/latest", tasks=("detect",), log=lambda _: None)
    assert execute(job, log=lambda _: None).outcome.frames == len(path)
    assert RunFolder.find("runs/latest").path == job.folder.resolve()


def test_options_follow_the_name_of_a_recording(tmp_path: Path) -> None:
    file = tmp_path / "own.npz"
    np.savez(file, samples=np.ones((20, 60)), times_s=np.arange(20.0), ranges_m=0.05 * np.arange(60))
    with pytest.raises(InputError, match="preset= one of x4m05"):
        make_run(str(file))
    job = make_run(f"{file}?preset=x4m05-8ghz", tasks=("detect",), out=tmp_path)
    assert job.scenario.name == "own"
    assert next(job.source.stream())["radar"].spec.center_hz == 8.748e9
    with pytest.raises(InputError, match="no such file"):
        make_run(f"{tmp_path / 'none.npz'}?preset=x4m05")


def test_a_run_refused_under_way_says_how_far_it_came(tmp_path: Path) -> None:
    class Full:
        def __init__(self) -> None:
            self.taken = 0

        def write(self, item: object) -> None:
            self.taken += 1
            if self.taken > 1:
                raise InputError("no space left", where="sink")

        def close(self) -> None: ...

    with pytest.raises(InputError, match="no space left"):
        execute(job(tmp_path, "detect"), sinks=[Full()], log=lambda _: None)
    assert json.loads((tmp_path / "run/metrics.json").read_text())["frames"]["value"] > 0
    assert "no space left" in json.loads((tmp_path / "run/provenance.json").read_text())["refused"]
