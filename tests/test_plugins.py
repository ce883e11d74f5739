"""Recipes of CONTRIBUTING.md, followed once: parts of a toy package that stands outside of ullage."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import ullage as ul
from ullage.cli import main

TOY = '''
import numpy as np
from ullage import Frames, OccupancyMap, RadarSpec
from ullage.grids import UNKNOWN, Changes
from ullage.ports.protocol import WholeSource


class Ball:
    """Something stands 2 m before every radar."""

    unit, forks = "path_gain", False

    def __init__(self, scene, max_bounces, seed):
        pass

    def sensor(self, spec):
        return spec

    def check(self, path, sensors):
        pass

    def samples(self, truth, spec, *, seed, first_frame):
        rows = np.zeros((len(truth), spec.bins), np.complex64)
        rows[:, np.argmin(abs(spec.range_m - 2.0))] = 1e-3
        return rows


class Blank:
    """A map of which nothing is known."""

    def __init__(self, grid):
        self.grid = grid

    def update(self, frames):
        pass

    def map(self):
        return OccupancyMap(self.grid, np.full(self.grid.shape, UNKNOWN, np.int8), "blank")

    def changed(self):
        return Changes(self.map(), np.zeros((0, self.grid.dims), np.int64))

    def finish(self):
        pass


def _rows(count):
    spec = RadarSpec.preset("x4m05")
    rows = np.full((count, spec.bins), 1e-4, np.complex64)
    return WholeSource({"radar": Frames(rows, spec.range_m, np.arange(count) * 10**8, spec)})


def read(path):
    return _rows(int(path.read_text()))


def listen(place, options):
    return _rows(int(place))


class Count:
    """Keeps the number of frames."""

    def __init__(self, path):
        self.path, self.count = path, 0

    def write(self, item):
        if isinstance(item, dict):
            self.count += sum(map(len, item.values()))

    def close(self):
        self.path.write_text(str(self.count))
'''
POINTS = """
[ullage.echo_models]
ball = toy:Ball
[ullage.map_methods]
blank = toy:Blank
broken = toy_that_is_not_there:Mapper
[ullage.sources]
.toy = toy:read
toy = toy:listen
[ullage.sinks]
.count = toy:Count
"""
HERE = ul.Trajectory.stationary(n=3)


@pytest.fixture(autouse=True)
def toy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install the toy package as pip does: a module, and its metadata with the entry points."""
    about = tmp_path / "site" / "toy-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: toy\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(POINTS)
    (about.parent / "toy.py").write_text(TOY)
    monkeypatch.syspath_prepend(str(about.parent))
    monkeypatch.delitem(sys.modules, "toy", raising=False)


def ullage(*words: str) -> object:
    with pytest.raises(SystemExit) as end:
        main(list(words))
    return end.value.code or 0


def test_an_echo_model_simulates_frames() -> None:
    frames = ul.simulate(ul.scenes.plate(0.5, 0.5, 3.0), HERE, ul.RadarSpec.preset("x4m05"), fidelity="ball")
    assert abs(frames.samples).argmax(1) == pytest.approx(abs(frames.range_m - 2.0).argmin())
    assert frames.unit == "path_gain"


def test_a_scenario_takes_an_echo_model_and_a_map_method() -> None:
    from ullage.config import Scenario

    plan = Scenario.model_validate({"name": "toy", "sensing": {"fidelity": "ball"}, "map": {"method": "blank"}})
    assert (plan.sensing.fidelity, plan.map.method) == ("ball", "blank")
    with pytest.raises(ul.InputError, match=r"map.method is 'blanc' \(allowed: 'ullage' or .* or 'blank'"):
        plan.but(map={"method": "blanc"})


def test_a_map_method_maps() -> None:
    frames = ul.simulate(ul.scenes.plate(0.5, 0.5, 3.0), HERE, ul.RadarSpec.preset("x4m05"))
    grid = ul.Grid.covering([[-1, -1, -1], [4, 1, 1]], step_m=0.2)
    omap = ul.map_occupancy(frames, grid, method="blank")
    assert omap.method == "blank"
    assert (omap.percent == -1).all()


def test_a_part_that_is_not_there_or_fails_is_named_in_one_line() -> None:
    scene, spec = ul.scenes.sphere(0.3, 2.0), ul.RadarSpec.preset("x4m05")
    with pytest.raises(ul.InputError, match=r"no fidelity 'bal' \(allowed: physical, thesis, ball\)"):
        ul.simulate(scene, HERE, spec, fidelity="bal")
    grid = ul.Grid.covering(scene.bounds, step_m=0.2)
    with pytest.raises(ul.InputError, match=r"no mapping method 'blanc' \(allowed: ullage, .*, blank, broken\)"):
        ul.map_occupancy(ul.simulate(scene, HERE, spec), grid, method="blanc")
    with pytest.raises(ul.UllageError, match=r"toy has 'broken' \(toy_that.*\), which fails on import: ModuleNot"):
        ul.map_occupancy(ul.simulate(scene, HERE, spec), grid, method="broken")


def test_a_format_is_opened_and_its_damage_is_named(tmp_path: Path) -> None:
    file = tmp_path / "flight.toy"
    file.write_text("5")
    assert len(ul.open(file).frames()) == 5
    with pytest.raises(ul.InputError, match="no option 'rate'"):
        ul.open(file, rate=3)
    file.write_text("five")
    with pytest.raises(ul.InputError, match=r"flight\.toy"):
        ul.open(file).frames()
    with pytest.raises(ul.InputError, match=r"allowed: \.toy, \.mcap"):
        ul.open(__file__)


def test_a_live_port_is_listened_to() -> None:
    assert sum(len(piece["radar"]) for piece in ul.open("toy:70").stream()) == 70


def test_a_sink_takes_what_flows(tmp_path: Path) -> None:
    outcome = ul.run(ul.open("toy:7"), sinks=[ul.sink(tmp_path / "frames.count")])
    assert outcome.frames == 7
    assert (tmp_path / "frames.count").read_text() == "7"
    with pytest.raises(ul.InputError, match=r"allowed: \.count, \.mcap"):
        ul.sink(tmp_path / "frames.cuont")


def test_the_command_reads_and_writes_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "flight.toy").write_text("5")
    assert ullage("run", "flight.toy", "--do", "detect", "--to", "frames.count") == 0
    assert (tmp_path / "frames.count").read_text() == "5"


def test_a_measured_radar_is_a_file(tmp_path: Path) -> None:
    table = tmp_path / "horn.csv"
    rows = [
        f"{az},{el},{20 if max(abs(az), abs(el)) < 30 else 0}" for az in range(-40, 41, 10) for el in range(-40, 41, 10)
    ]
    table.write_text("azimuth_deg,elevation_deg,gain_dbi\n" + "\n".join(rows) + "\n")
    device = tmp_path / "mine.yaml"
    device.write_text(f"center_hz: 6.0e9\nantenna: {{kind: table, file: {table}}}\nnoise: null\n")
    spec = ul.RadarSpec.preset(str(device))
    frames = ul.simulate(ul.scenes.sphere(0.3, 2.0), HERE[:1], spec)
    other = ul.simulate(ul.scenes.sphere(0.3, 2.0), HERE[:1], spec.but(antenna={"kind": "isotropic"}))
    gain = 20 * np.log10(abs(frames.samples).max() / abs(other.samples).max())
    assert gain == pytest.approx(40, abs=0.1)  # 20 dBi on the way out and on the way back
