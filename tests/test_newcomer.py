"""Tasks of a newcomer, each as the documentation tells it: public names and the command line only.

The one with live ROS 2 stands in `ports/ros2/test_first_frames.py`.
"""

from __future__ import annotations

import csv
import runpy
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import ullage as ul
from ullage.cli import app

SHORT = """title: A short flight
world: {file: plate.stl}
flight: {vehicle: ideal, waypoints: [[0, -0.2, 0, 0], [0, 0.2, 0, 0]], speed_m_s: 0.5}
sensing: {rig: single, rate_hz: 17}
"""
PLATE = """solid plate
facet normal -1 0 0
outer loop
vertex 2 -1 -1
vertex 2 1 -1
vertex 2 1 1
endloop
endfacet
facet normal -1 0 0
outer loop
vertex 2 -1 -1
vertex 2 1 1
vertex 2 -1 1
endloop
endfacet
endsolid plate
"""


def ullage(folder: Path, *words: str) -> None:
    """Run the command in a folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert CliRunner().invoke(app, words).exit_code == 0


@pytest.fixture(scope="module")
def frames() -> ul.Frames:
    """Past a plate of 1 m at 2 m."""
    path = ul.Trajectory.line((0, -0.3, 0), (0, 0.3, 0), speed_m_s=0.5, rate_hz=17)
    return ul.simulate(ul.scenes.plate(1.0, 1.0, distance_m=2.0), path, ul.RadarSpec.preset("x4m05"), seed=7)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a mesh and a scenario of it."""
    out = tmp_path_factory.mktemp("newcomer")
    (out / "plate.stl").write_text(PLATE)
    (out / "mine.yaml").write_text(SHORT)
    return out


def test_a_room_of_my_own(tmp_path: Path) -> None:  # README
    room = ul.scenes.room(size_m=(5, 4, 3))
    room = room.add(ul.scenes.cylinder(0.1, 2.0, distance_m=0.0), at=(1.5, 0.5, 0))
    path = ul.Trajectory.line((0, -1, 0), (0, 1, 0), speed_m_s=0.5, rate_hz=10)
    flown = ul.simulate(room, path, ul.RadarSpec.preset("x4m05"), seed=7)
    near = np.median(flown.range_m[(flown.amplitude * (flown.range_m > 0.6)).argmax(axis=1)])
    assert 1.3 < near < 2.6
    ul.figures.map_figure(tmp_path / "room.png", ul.map_occupancy(flown, ul.Grid.covering(room.bounds, step_m=0.1)),
                          title="Mine", flown=path)  # fmt: skip
    assert (tmp_path / "room.png").stat().st_size > 5000


def test_a_mesh(folder: Path) -> None:  # howto_world.md
    scene = ul.load_scene(folder / "plate.stl")
    echo = ul.simulate(scene, ul.Trajectory.stationary(), ul.RadarSpec.preset("x4m05", noise=None))
    assert ul.explain(echo, 0, count=1)[0].range_m == pytest.approx(2.0, abs=0.01)


def test_a_radar_of_my_own() -> None:  # howto_radar.md
    radar = ul.RadarSpec.preset("x4m05", iterations=32, fps=25, antenna={"kind": "cosine", "azimuth_deg": 40})
    rig = ul.Rig(sensors={"ahead": radar, "left": radar.but(mount=ul.MountSpec(position_m=(0, 0.1, 0), yaw_deg=90))})
    path = ul.Trajectory.line((0, 0, 0), (0.2, 0, 0), speed_m_s=0.5, rate_hz=25)
    wall = ul.scenes.plate(2.0, 2.0, distance_m=2.0)
    found = ul.simulate(wall, path, rig, seed=1)
    behind = found["ahead"].range_m > 0.6
    assert found["ahead"].amplitude[:, behind].max() > 5 * found["left"].amplitude[:, behind].max()


def test_profiles_of_numpy(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:  # recordings.md, gallery.md
    monkeypatch.chdir(tmp_path)
    omap = runpy.run_path(str(Path(__file__).parents[1] / "examples/gallery/arrays.py"))["omap"]
    rows, _ = np.nonzero(omap.occupied)
    assert np.median(omap.grid.y_m[rows]) == pytest.approx(3.0, abs=0.1)  # the wall


def test_a_recording_of_my_own(frames: ul.Frames, tmp_path: Path) -> None:  # recordings.md
    assert frames.poses is not None
    np.savez(tmp_path / "mine.npz", samples=frames.samples, times_ns=frames.t_ns, ranges_m=frames.range_m,
             positions_m=frames.poses.position, quaternions_xyzw=frames.poses.quat_xyzw)  # fmt: skip
    again = ul.open(tmp_path / "mine.npz", preset="x4m05").frames()
    assert np.array_equal(again.samples, frames.samples)
    with ul.sink(tmp_path / "mine.mcap") as sink:
        sink.write(again)
    assert len(ul.open(tmp_path / "mine.mcap").frames()) == len(frames)


@dataclass
class Loudest:
    """A detector of my own: the range of the loudest echo of each frame."""  # tutorial.md

    nearest_m: float = 0.6

    def __post_init__(self) -> None:
        self.ranges: list[float] = []

    def update(self, chunk: dict[str, ul.Frames]) -> Iterable[Any]:
        for part in chunk.values():
            self.ranges += part.range_m[(part.amplitude * (part.range_m > self.nearest_m)).argmax(axis=1)].tolist()
        return ()

    def finish(self) -> Iterable[Any]:
        yield np.array(self.ranges)


def test_a_detector_of_my_own(frames: ul.Frames) -> None:
    (ranges,) = ul.run(frames, stages=[Loudest()]).results
    assert len(ranges) == len(frames)
    assert np.allclose(ranges, 2.0, atol=0.1)


def test_an_export_to_octomap(tmp_path: Path) -> None:  # maps.md
    percent = np.full((8, 8, 8), 5, np.int8)
    percent[2, 3, 4] = 95
    volume = ul.OccupancyMap(ul.Grid((0, 0, 0), 0.1, percent.shape), percent)
    with ul.sink(tmp_path / "map.bt") as sink:
        sink.write(volume)
    assert (tmp_path / "map.bt").read_bytes().startswith(b"# Octomap OcTree")
    from ullage.ports import read_map

    assert np.array_equal(read_map(tmp_path / "map.bt").occupied, volume.occupied)


def test_a_report(folder: Path) -> None:  # tutorial.md, report.md
    ullage(folder, "run", "mine.yaml")
    page = (folder / "runs" / "latest" / "report.html").read_text(encoding="utf-8")
    assert "A short flight" in page
    assert "plate" in page


def test_a_sweep(folder: Path) -> None:  # sweeps.md
    ullage(folder, "sweep", "mine.yaml", "--over", "map.step_m=0.1,0.2", "--seeds", "1", "--jobs", "1")
    rows = list(csv.DictReader((folder / "sweep" / "sweep.csv").open()))
    assert [row["map.step_m"] for row in rows] == ["0.1", "0.2"]
    assert not any(row.get("failed") for row in rows)
