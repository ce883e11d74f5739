"""The command line as a person meets it: what it prints, what it leaves behind, how it refuses."""

from __future__ import annotations

import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import trimesh
import typer
import yaml
from rich.console import Console

import ullage as ul
from tests.command import ended
from ullage.cli import app
from ullage.experiments.catalog import Variant, families, scenario_names
from ullage.view import progress

ROOM = """<?xml version="1.0"?><sdf version="1.9"><world name="w">
<model name="east"><static>true</static><pose>3 0 1 0 0 0</pose><link name="l"><collision name="c">
<geometry><box><size>0.1 6 2</size></box></geometry></collision></link></model>
<model name="north"><static>true</static><pose>0 3 1 0 0 0</pose><link name="l"><collision name="c">
<geometry><box><size>6 0.1 2</size></box></geometry></collision></link></model>
</world></sdf>"""
PLAN = """
title: Two walls
world: {file: room.sdf}
flight: {vehicle: ideal, waypoints: [[-1, -1, 1], [1, -1, 1], [1, 1, 1]]}
sensing: {fidelity: thesis, rig: single}
map: {method: elfes}
image: {method: summation, step_m: 0.1}
expect: {frames: {min: 100}, recall: {max: 1.0}}
"""


class Told:
    """What a command said and how it ended."""

    def __init__(self, words: tuple[str, ...], cwd: Path, capsys: pytest.CaptureFixture[str]) -> None:
        capsys.readouterr()
        self.returncode = ended(words, cwd)
        self.stdout, self.stderr = capsys.readouterr()


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cli")
    (folder / "room.sdf").write_text(ROOM)
    (folder / "walls.yaml").write_text(PLAN)
    (folder / "walls.fbx").touch()
    assert not ended(("run", "walls.yaml"), folder)
    return folder


def test_a_run_leaves_everything_in_one_folder(place: Path) -> None:
    folder = place / "runs" / "latest"
    names = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}
    wanted = {"scenario.yaml", "provenance.json", "frames.mcap", "metrics.json", "report.html", "map.pgm", "map.yaml"}
    assert wanted | {f"figures/{n}.png" for n in ("map", "image", "range_time", "snapshot")} <= names
    assert json.loads((folder / "provenance.json").read_text())["interrupted"] is False


QUICK = ("--do", "map", "-o", "sensing.rig=single", "-o", "sensing.fidelity=thesis", "-o", "flight.vehicle=ideal",
         "-o", "flight.speed_m_s=4", "-o", "map.method=elfes")  # fmt: skip


@pytest.mark.parametrize("name", ["room.sdf", "model.stl"])
def test_a_world_file_alone_is_flown_by_default(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "my tank"
    folder.mkdir()
    write_world(folder / name)
    told = Told(("run", f"my tank/{name}", *QUICK), tmp_path, capsys)
    assert told.returncode == 0, told.stderr
    said = " ".join(told.stdout.split())
    assert f"default flight in {name}: " in said
    assert "to change it: -o 'flight.waypoints=" in said
    kept = yaml.safe_load((tmp_path / "runs" / "latest" / "scenario.yaml").read_text())
    assert len(kept["flight"]["waypoints"]) > 1
    assert kept["name"] == ("my-tank" if name == "model.stl" else Path(name).stem)
    again = Told(("run", "runs/latest/scenario.yaml"), tmp_path, capsys)
    assert (again.returncode, "this run exists" in again.stderr) == (2, True)  # the file holds the whole run


def test_arguments_of_xacro_and_waypoints_that_are_given_are_part_of_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ULLAGE_TRUST_XACRO", "0")  # which the option sets, and which is put back after the test
    body = '<xacro:arg name="h" default="3"/><link name="l"><collision><geometry><box size="6 4 $(arg h)"/>'
    head = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    (tmp_path / "room.xacro").write_text(f"{head}{body}</geometry></collision></link></robot>")
    words = ("--trust-xacro", "--xacro", "h:=4", *QUICK, "-o", "flight.waypoints=[[-1, 0, 0], [1, 0, 0]]")
    told = Told(("run", "room.xacro", *words), tmp_path, capsys)
    assert told.returncode == 0, told.stderr
    assert "default flight" not in told.stdout
    kept = yaml.safe_load((tmp_path / "runs" / "latest" / "scenario.yaml").read_text())
    assert (kept["name"], kept["world"]["file"]) == ("room", "room.xacro?h:=4")
    assert kept["flight"]["waypoints"] == [[-1, 0, 0], [1, 0, 0]]
    again = Told(("run", "runs/latest/scenario.yaml", "--xacro", "h:=5"), tmp_path, capsys)
    assert (again.returncode, "world.file: robot.xacro?NAME:=VALUE" in again.stderr) == (2, True)


def write_world(path: Path) -> None:
    """A room of 6 x 4 x 3 m about the origin, in the format of the file's name."""
    if path.suffix == ".sdf":
        path.write_text(ROOM)
        return
    scene = ul.scenes.room(size_m=(6, 4, 3))
    trimesh.Trimesh(scene.vertices, scene.faces, process=False).export(path)


def test_a_world_without_shapes_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "void.sdf").write_text('<?xml version="1.0"?><sdf version="1.9"><world name="w"/></sdf>')
    told = Told(("run", "void.sdf"), tmp_path, capsys)
    assert told.returncode == 2
    assert told.stderr.strip().splitlines()[-1].startswith("ullage: void.sdf: the world holds no shapes")
    assert "world.geometry=visual" in told.stderr
    assert not (tmp_path / "runs").exists()


def test_a_run_is_measured_against_its_bounds(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert Told(("measure",), place, capsys).returncode in (0, None)
    broken = Told(("run", "walls.yaml", "-o", "expect.frames={max: 3}", "--do", "detect"), place, capsys)
    assert broken.returncode in (0, None), broken.stderr
    judged = Told(("measure",), place, capsys)
    assert judged.returncode == 1
    assert "OUT" in judged.stdout
    (place / "runs" / "latest").unlink()
    first = next(p for p in (place / "runs").iterdir() if (p / "map.pgm").exists())
    (place / "runs" / "latest").symlink_to(first.name)


def test_a_recording_replays_to_the_same_map(place: Path) -> None:
    grid = ("-o", "map.method=elfes", "-o", "map.margin_m=1")
    assert not ended(("run", "runs/latest/frames.mcap", "--do", "map", *grid, "--out", "replayed"), place)
    frames = json.loads((place / "replayed/latest/metrics.json").read_text())["frames"]["value"]
    assert frames == json.loads((place / "runs/latest/metrics.json").read_text())["frames"]["value"]


def test_quiet_runs_say_nothing_and_verbose_ones_each_step(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("run", "walls.yaml", "--force", "--do", "detect")
    said = {level: Told((*words, *level), place, capsys) for level in ((), ("--quiet",), ("--verbose",))}
    assert [told.returncode for told in said.values()] == [0, 0, 0]
    assert said["--quiet",].stdout == said["--quiet",].stderr == ""
    assert "receiving and mapping" in said[()].stdout
    assert "frames of" in said[()].stdout
    assert re.search(r"\d s  \d+ frames of front", said["--verbose",].stdout)
    assert "frames of front" not in said[()].stdout
    assert "cargo-hold" in Told(("--quiet", "list"), place, capsys).stdout


def test_the_library_logs_and_prints_nothing(capsys: pytest.CaptureFixture[str], caplog: Any) -> None:
    path = ul.Trajectory.line((-1, 0, 0), (1, 0, 0), 0.5, 9)
    with caplog.at_level("DEBUG", logger="ullage"):
        ul.run(ul.simulate(ul.scenes.room((4, 3, 3)), path, ul.RadarSpec.preset("x4m05")))
    assert any("frames of" in record.getMessage() for record in caplog.records)
    assert capsys.readouterr() == ("", "")


def test_brackets_in_names_are_names(tmp_path, capsys):
    progress.answer(" pip install 'ullage[view]'", mark="none", style="yellow")
    progress.log_report(tmp_path / "odd[red]" / "report.html")
    assert capsys.readouterr().out == f"none pip install 'ullage[view]'\nreport: {tmp_path}/odd[red]/report.html\n"


def test_a_job_that_is_retitled_often_tells_little_without_a_terminal(capsys):
    with progress.progress_bar("reproducing", total=7.0) as bar:
        for k in range(500):
            bar.retitle(f"hold: {k / 5:.0f} %")
            bar(0.0)
        bar.log("the first frames are recorded")
    assert capsys.readouterr().out == "reproducing\nthe first frames are recorded\n"


@pytest.mark.parametrize("terminal", [True, False])
def test_a_run_says_at_its_end_why_its_map_stays_empty(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, terminal: bool
) -> None:
    out = io.StringIO()
    monkeypatch.setattr(progress, "console", Console(file=out, force_terminal=terminal, width=200))
    (tmp_path / "still.yaml").write_text(
        "{name: still, title: Still, world: {name: ntnu-room}, sensing: {rig: single, fidelity: thesis}, do: [map],"
        " flight: {vehicle: ideal, waypoints: [[0, 0, 1.2], [0.001, 0, 1.2]], hover_s: 1}}"
    )
    assert ended(("run", "still.yaml"), tmp_path) == 0
    _, _, after = out.getvalue().rpartition("drawing figures")
    assert "\nNo cell of the map is occupied: no radar moves 0.05 m" in after


def test_a_job_of_an_hour_writes_few_lines_without_a_terminal_and_says_what_is_left(capsys, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    with progress.progress_bar("mapping", total=3600.0, unit="s of flight") as bar:
        for second in range(3600):
            now[0] = float(second)
            bar(now[0])
        now[0] = 36000.0
        bar(3610.0)  # a flight lands later than planned
    said = capsys.readouterr().out.splitlines()
    assert said[:2] == ["mapping", "mapping: 1 %, 0:59:39 left"]
    assert said[-1] == "mapping: 100 %"
    assert len(said) < 9


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("show", "latest"), "frames.mcap"),
        (("show", "latest", "--png"), "/figures/"),
        (("report", "latest", "--html"), "report.html"),
        (("list",), "cargo-hold"),
        (("list",), "x4m05"),
        (("config", "cargo-hold"), "step_m: 0.1"),
        (("config", "--schema"), '"properties"'),
        (("doctor",), "a plate at 3 m is met at 3.000000 m"),
        (("--version",), "ullage 0."),
    ],
)
def test_what_is_there_is_shown(
    place: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], says: str
) -> None:
    told = Told(words, place, capsys)
    assert told.returncode in (0, None)
    assert says in told.stdout


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("run", "gone.sdf"), "gone.sdf: no such file"),
        (("run", "nowhere"), "no scenario, recording or port 'nowhere'"),
        (("run", "gone.mcap"), "gone.mcap: no such file"),
        (("run", "gone/flight"), "gone/flight: no such file"),
        (("run", "walls.fbx"), r"walls.fbx: no kind .*ntnu-wire.*scenario.yaml.*\.sdf.*\.mcap.*\.npz.*imc:"),
        (("run", "walls.yaml", "--force", "--to", "gone/deep/x.mcap"), "no folder gone/deep"),
        (("run", "walls.yaml", "--force", "--to", "gone/deep"), "no folder gone"),
        (("run", "walls.yaml", "--force", "--to", "gone/x.yaml"), "no folder gone"),
        (("run", "walls.yaml"), "this run exists.*--force"),
        (("run", "walls.yaml", "-o", "map.step_m=-1"), "map.step_m"),
        (("run", "walls.yaml", "--do", "dance"), "no task 'dance'.*detect, image, map, obstacles"),
        (("run", "walls.yaml", "-o", "sensing.preset=x5"), "no radar preset 'x5'"),
        (("run", "walls.yaml", "-o", "sensing.changes={fps: -3}"), "fps"),
        (("run", "walls.yaml", "-o", "world.file=gone.sdf"), "gone.sdf"),
        (("run", "walls.yaml", "--force", "--to", "thing.xyz"), "thing.xyz"),
        (("run", "walls.yaml", "--out", "/proc/nowhere"), "cannot write"),
        (("show", "nothing"), "no run 'nothing'"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(
    place: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], says: str
) -> None:
    told = Told(words, place, capsys)
    assert told.returncode == 2
    lines = told.stderr.strip().splitlines()
    assert len(lines) == 1, told.stderr
    assert re.search(says, lines[0])


def test_a_run_that_is_not_there_is_not_answered_with_a_hidden_draft(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "runs/.cut-01234567.draft").mkdir(parents=True)
    (tmp_path / "runs/.cut-01234567.draft/provenance.json").write_text("{}")
    told = Told(("show", "nothere"), tmp_path, capsys)
    assert told.stderr == "ullage: no run 'nothere' (allowed: a run folder, one of cut-01234567)\n"


def test_the_overview_fits_a_screen_and_names_every_family(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    told = Told(("list",), tmp_path, capsys).stdout.splitlines()
    assert sum(max(-(-len(line) // 80), 1) for line in told) <= 24
    assert max(map(len, told[:10])) <= 80
    names = {line.split()[0].rstrip("*") for line in told if line.startswith(" ")}
    assert names >= set(families())


def test_help_has_a_whole_sentence_for_every_command() -> None:
    shown = [command.get_short_help_str() for command in typer.main.get_command(app).commands.values()]
    assert [text for text in shown if not re.fullmatch(r"[A-Z][^.]*\.(html anew\.)?", text)] == []


def test_nothing_is_got_ready_for_a_name_that_is_unknown(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert Told(("run", "nowhere"), place, capsys).stdout == ""


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("run", "cargo-hld"), "no scenario, recording or port 'cargo-hld'; did you mean 'cargo-hold'"),
        (("config", "ntnu-plat45"), "did you mean 'ntnu-plate45'"),
        (("fly", "clutered-room"), "did you mean 'cluttered-room'"),
        (("config", "cargo-hold", "--law", "optics"), "no law 'optics' .allowed: thesis, physical."),
        (("config", "cargo-hold", "--by-hand"), "no scenario 'cargo-hold --by-hand' .allowed: cargo-hold --law"),
        (("config", "walls.yaml", "--law", "physical"), "'walls.yaml' is no shipped scenario"),
        (("run", "ntnu-wir", "--by-hand"), "no shipped scenario; did you mean 'ntnu-wire'"),
        (("list", "wolds"), "did you mean 'worlds'"),
    ],
)
def test_a_wrong_name_gets_the_nearest_right_one(
    place: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], says: str
) -> None:
    told = Told(words, place, capsys)
    assert told.returncode == 2
    assert re.search(says, told.stderr)
    assert len(told.stderr.strip().splitlines()) == 1


def test_a_family_with_options_is_the_scenario_of_the_older_name(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for variants in families().values():
        for one in variants:
            (older,) = [name for name in scenario_names() if Variant.of(name) == one]
            assert Told(("config", *one.words.split()), place, capsys).stdout == Told(
                ("config", older), place, capsys
            ).stdout.replace(f'name: "{one.words}"', f'name: "{older}"')
    assert len(families()) == 13


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
@pytest.mark.parametrize("words", [["list"], ["config"]])
def test_output_onto_a_full_disk_is_one_line(tmp_path: Path, words: list[str]) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run([sys.executable, "-m", "ullage", *words], stdout=full, stderr=subprocess.PIPE, text=True,
                              cwd=tmp_path, timeout=120, check=False)  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.strip().splitlines() == ["ullage: [Errno 28] No space left on device"]


@pytest.mark.parametrize("verb", ["validate", "reproduce"])
def test_an_installed_package_says_where_the_studies_are(verb: str, tmp_path: Path) -> None:
    site = tmp_path / "lib" / "site"
    site.mkdir(parents=True)
    (site / "ullage").symlink_to(Path(ul.__file__).parent)
    command, path = [sys.executable, "-m", "ullage", verb], os.environ | {"PYTHONPATH": str(site)}
    done = subprocess.run(command, cwd=tmp_path, env=path, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert re.fullmatch(
        r"ullage: studies/: the studies are not installed.* source tree.*a checkout of http.*\n", done.stderr
    )
