"""The task `obstacles`: distances of a recording as a table, in words and as metrics."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
from mcap.reader import make_reader
from typer.testing import CliRunner

import ullage as ul
from ullage.cli import app


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two radars approach a plate 2.5 m ahead; the one behind falls silent after half of the 1.5 s."""
    path = tmp_path_factory.mktemp("recorded") / "flight.mcap"
    rig = ul.Rig.preset("thesis-4")
    pair = ul.Rig(sensors={name: rig.sensors[name] for name in ("front", "back")})
    flown = ul.Trajectory.line((0, 0, 0), (0.9, 0, 0), speed_m_s=0.6, rate_hz=20)
    plate = ul.scenes.plate(width_m=3, height_m=3, distance_m=2.5, material="steel")
    frames = ul.simulate(plate, flown, pair, seed=2)
    frames["back"] = frames["back"][: len(frames["back"]) // 2]
    ul.run(frames, sinks=[ul.sink(path)])
    return path


@pytest.fixture(scope="module")
def folder(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run folder of the recording."""
    out = tmp_path_factory.mktemp("runs")
    found = CliRunner().invoke(app, ["run", str(recording), "--do", "obstacles", "--out", str(out)])
    assert found.exit_code == 0, found.output
    return out / "latest"


def test_a_recording_alone_gives_its_table(folder: Path) -> None:
    rows = list(csv.DictReader((folder / "obstacles.csv").open()))
    front = [row for row in rows if row["sensor"] == "front"]
    back = [row for row in rows if row["sensor"] == "back"]
    assert front[0]["distance_m"] == ""  # nothing is confirmed yet
    assert float(front[-1]["distance_m"]) == pytest.approx(1.6, abs=0.08)
    assert float(front[-1]["closing_speed_m_s"]) == pytest.approx(0.6, abs=0.1)
    assert float(front[-1]["time_to_collision_s"]) == pytest.approx(1.6 / 0.6, rel=0.2)
    assert back[-1]["distance_m"] == "nan"
    assert back[-1]["fault"] == "no frames came"


def test_the_run_says_it_in_words_and_as_metrics(folder: Path) -> None:
    words = (folder / "verdict.txt").read_text().splitlines()
    assert words[0].startswith("back: no frames came from ")
    front = next(line for line in words if line.startswith("obstacles of 'front': "))
    assert "nearest 1." in front
    assert "time to collision" in front
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["obstacle_nearest"]["value"] == pytest.approx(1.6, abs=0.08)
    assert 5 < metrics["obstacle_unknown"]["value"] < 25
    assert "map.yaml" not in {path.name for path in folder.iterdir()}


def test_distances_in_the_recording_are_a_laser_scan_that_ros_reads(folder: Path) -> None:
    with (folder / "frames.mcap").open("rb") as file:
        found = make_reader(file).iter_messages()
        kinds = {schema.name for schema, channel, _ in found if schema and channel.topic.endswith("obstacles")}
    assert kinds == {"sensor_msgs/msg/LaserScan"}
