"""Run folders lose nothing: not to a refusal, a kill, a full disk, a signal, nor to a second run."""

from __future__ import annotations

import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from process_table import alive, children

import ullage as ul
from tests.command import ended
from ullage.experiments.doctor import recording_rate
from ullage.experiments.folder import RunFolder
from ullage.experiments.run import PICTURE_S, MapSaver, Report, Run
from ullage.experiments.runner import execute
from ullage.experiments.source_resolution import make_run, record
from ullage.ports import read_map, sink

WALL = """<sdf version="1.9"><world name="w"><model name="wall"><static>true</static><pose>4 0 1 0 0 0</pose>
<link name="l"><collision name="c"><geometry><box><size>0.1 4 2</size></box></geometry></collision></link></model>
</world></sdf>"""
PLAN = """
world: {file: wall.sdf}
flight: {vehicle: ideal, waypoints: [[0, -1, 1], [0, 1, 1]]}
sensing: {fidelity: thesis, rig: single, rate_hz: 10}
do: [detect, map]
map: {method: elfes}
"""
LONG = ("-o", "sensing.rate_hz=400", "-o", "map.step_m=0.02", "-o", "flight.speed_m_s=0.005")


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, heeded_signals: None) -> Path:
    (tmp_path / "wall.sdf").write_text(WALL)
    (tmp_path / "plan.yaml").write_text(PLAN)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def made(*options: str, force: bool = False) -> Run:
    return make_run("plan.yaml", options=options, force=force, log=lambda _: None)


def done(*, force: bool = False) -> Report:
    return execute(made(force=force), log=lambda _: None, draw=False)


def ullage(*words: str) -> int:
    """The exit code of a command, run within this process."""
    return int(ended(words, Path()) or 0)


def tree(folder: Path) -> dict[str, tuple[int, bytes]]:
    return {str(p): (p.stat().st_mtime_ns, p.read_bytes()) for p in sorted(folder.rglob("*")) if p.is_file()}


@contextmanager
def files_up_to(size: int) -> Iterator[None]:
    """No file may grow beyond that: what writes it meets an error as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


REFUSED = [
    ("--to", "foo:"),
    ("--to", "thing.xyz"),
    ("--to", "wall.sdf/x.mcap"),
    ("--to", "there.mcap"),
    ("--to", "new.mcap", "--to", "foo:"),
    ("--to", "imc:tcp://127.0.0.1:9?x=1"),
    ("--to", "viewer:page.html"),
    ("--do", "dance"),
    ("-o", "map.step=1"),
    ("-o", "map.margin_m=1e9"),
    ("--out", "wall.sdf"),
]


@pytest.mark.parametrize("words", REFUSED, ids=" ".join)
def test_what_is_refused_touches_nothing(
    place: Path, words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    (place / "there.mcap").write_bytes(b"")
    done()
    before = tree(place)
    for force in ((), ("--force",)):
        capsys.readouterr()
        assert ullage("run", "plan.yaml", *force, *words) == 2
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
        assert tree(place) == before
    assert ullage("run", "plan.yaml", "-o", "seed=5", *words) == 2
    assert tree(place) == before


def test_the_old_run_lives_until_the_new_one_is_complete(place: Path) -> None:
    folder = done().folder
    before, seen = tree(folder), []

    class Probe:
        def write(self, item: object) -> None:
            seen.append(tree(folder) == before)

        def close(self) -> None: ...

    with pytest.raises(ul.InputError, match="this run exists"):
        made()
    assert execute(made(force=True), sinks=[Probe()], log=lambda _: None, draw=False).folder == folder
    assert len(seen) > 2
    assert all(seen)
    assert tree(folder) != before
    assert sorted(os.listdir(place / "runs")) == ["latest", folder.name]
    assert json.loads((folder / "provenance.json").read_text())["state"] == "complete"


class Cut:
    """A source that Ctrl-C ends after its first pieces."""

    def __init__(self, job: Run) -> None:
        self.source = job.source

    def stream(self) -> Iterator[dict[str, ul.Frames]]:
        pieces = self.source.stream()
        yield next(iter(pieces))
        raise KeyboardInterrupt


def test_an_interrupted_run_is_whole_but_replaces_no_complete_one(place: Path) -> None:
    job = made()
    job.source = Cut(job)
    cut = execute(job, log=lambda _: None, draw=False)
    assert RunFolder(cut.folder).state == "interrupted"
    assert "interrupted" in (cut.folder / "report.html").read_text()
    whole = done(force=True)
    assert RunFolder(whole.folder).state == "complete"
    before = tree(whole.folder)
    job = made(force=True)
    job.source = Cut(job)
    beside = execute(job, log=lambda _: None, draw=False)
    assert beside.folder != whole.folder
    assert tree(whole.folder) == before
    assert RunFolder(beside.folder).state == "interrupted"
    assert (beside.folder / "map.yaml").is_file()


def test_a_second_run_of_one_folder_is_refused_while_the_first_lives(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = made()
    assert ullage("run", "plan.yaml") == 2
    assert ullage("run", "plan.yaml", "--force") == 2
    assert re.fullmatch(rf"(.*plan-\w+: process {os.getpid()} is writing this run .*\n){{2}}", capsys.readouterr().err)
    assert ullage("list") == 0
    assert f"running, process {os.getpid()} on" in capsys.readouterr().out
    job.place.discard()
    assert ullage("run", "plan.yaml") == 0


@pytest.mark.parametrize("limit", ["recording", "figure", "report"])
def test_a_full_disk_takes_one_line_and_leaves_no_half_a_file(
    place: Path, limit: str, capsys: pytest.CaptureFixture[str]
) -> None:
    rate = "sensing.rate_hz=50"  # so many frames that some arrive whole
    assert ullage("run", "plan.yaml", "-o", rate) == 0
    folder = RunFolder.find("latest").path
    before = tree(folder)
    figures = [p.stat().st_size for p in (folder / "figures").iterdir()]
    size = {
        "recording": (folder / "frames.mcap").stat().st_size * 3 // 4,
        "figure": min(figures) // 2,
        "report": max(figures) + 1000,
    }[limit]
    capsys.readouterr()
    job = made(rate, force=True)
    sinks = [record(job)] if limit == "recording" else []
    with files_up_to(size), pytest.raises(ul.InputError, match="cannot write: File too large"):
        execute(job, sinks=sinks, log=lambda _: None)
    assert tree(folder) == before
    assert RunFolder(job.folder).state == "unfinished"
    assert not [p for p in job.folder.rglob(".*") if p.is_file()]
    assert ullage("list") == 0
    assert "File too large" in capsys.readouterr().out
    if limit == "recording":
        assert len(ul.open(str(job.folder)).frames()) > 0
    else:
        assert np.array_equal(read_map(job.folder / "map.yaml").percent, read_map(folder / "map.yaml").percent)


def test_the_map_so_far_is_saved_at_once_and_then_every_minute(tmp_path: Path) -> None:
    grid = ul.Grid((0, 0, 0), 0.5, (2, 2))
    maps = [ul.OccupancyMap(grid, np.full((2, 2), value, np.int8), "elfes") for value in (0, 100)]
    saver = MapSaver(tmp_path, every_s=3600)
    for omap in maps:
        saver.write(omap)
    assert (read_map(tmp_path / "map.yaml").percent == 0).all()
    saver.every_s = 0
    saver.write(maps[1])
    assert (read_map(tmp_path / "map.yaml").percent == 100).all()


def test_a_run_that_takes_long_draws_one_picture_of_its_map_so_far(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now, drawn = [0.0], []
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    saver = MapSaver(tmp_path, draw=drawn.append)
    maps = [ul.OccupancyMap(ul.Grid((0, 0, 0), 1.0, (2, 2)), np.full((2, 2), k, np.int8)) for k in range(20)]
    for second, omap in enumerate(maps):
        now[0] = float(second)
        saver.write(omap)
    assert drawn == [maps[round(PICTURE_S)]]


@pytest.mark.parametrize(("fidelity", "sample_bytes"), [("physical", 8), ("thesis", 4)])
def test_doctor_knows_what_a_recording_takes(tmp_path: Path, fidelity: str, sample_bytes: int) -> None:
    rig = ul.Rig.preset("thesis-4")
    path = ul.Trajectory.line((0, -1, 0), (0, 1, 0), 0.5, 17)
    with sink(tmp_path / "flight.mcap") as recording:
        recording.write(ul.simulate(ul.scenes.room((6, 4, 3)), path, rig, fidelity=fidelity, max_bounces=1))
    measured = (tmp_path / "flight.mcap").stat().st_size / path.duration_s
    assert measured == pytest.approx(recording_rate(rig, sample_bytes=sample_bytes), rel=0.15)


def started(*words: str, ready: Callable[[], bool]) -> subprocess.Popen[str]:
    """A command in a process of its own, once it is as far as that."""
    command = [sys.executable, "-m", "ullage", *words]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    until = time.monotonic() + 120
    while not ready() and process.poll() is None and time.monotonic() < until:
        time.sleep(0.02)
    if process.poll() is not None:
        pytest.fail(process.communicate()[0])
    return process


def mapped() -> bool:
    """Whether a run under way has frames in its recording and a first map."""
    drafts = list(Path("runs").glob(".*.draft"))
    return any((d / "map.yaml").exists() and (d / "frames.mcap").stat().st_size > 30_000 for d in drafts)


def test_a_killed_run_is_unfinished_readable_and_replaced(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    old = done().folder
    process = started("run", "plan.yaml", *LONG, ready=mapped)
    process.kill()
    process.communicate()
    (draft,) = (place / "runs").glob(".*.draft")
    assert RunFolder.find("latest").path == old.resolve()
    assert RunFolder(draft).state == "unfinished"
    assert len(ul.open(str(draft)).frames()) > 0
    assert (read_map(draft / "map.yaml").percent >= 0).any()
    name = draft.name[1:-6]
    for words in (("list",), ("show", name)):
        capsys.readouterr()
        assert ullage(*words) == 0
        assert "unfinished" in capsys.readouterr().out
    assert ullage("report", name) == 0
    assert "unfinished" in (draft / "report.html").read_text()
    assert ullage("measure", name) == 2
    again = RunFolder.of(*name.rsplit("-", 1)).begin()
    assert RunFolder(draft).state == "running"
    again.discard()


@pytest.mark.parametrize(
    "number", [signal.SIGINT, *(pytest.param(one, marks=pytest.mark.slow) for one in (signal.SIGTERM, signal.SIGHUP))]
)
def test_ctrl_c_sigterm_and_sighup_leave_a_whole_run(place: Path, number: signal.Signals) -> None:
    process = started("run", "plan.yaml", *LONG, ready=mapped)
    process.send_signal(number)
    printed, _ = process.communicate(timeout=120)
    assert process.returncode == 0, printed
    assert "interrupted" in printed
    folder = RunFolder.find("latest").path
    assert RunFolder(folder).state == "interrupted"
    assert {"map.yaml", "metrics.json", "report.html", "metadata.yaml"} <= set(os.listdir(folder))


def test_a_second_signal_ends_at_once_with_readable_files(place: Path) -> None:
    process = started("run", "plan.yaml", *LONG, ready=mapped)
    process.send_signal(signal.SIGTERM)
    assert process.stdout is not None
    assert any("drawing figures" in line for line in process.stdout)
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=120)
    assert process.returncode == 130
    (draft,) = (place / "runs").glob(".*.draft")
    assert RunFolder(draft).state == "unfinished"
    assert (read_map(draft / "map.yaml").percent >= 0).any()
    assert len(ul.open(str(draft)).frames()) > 0
    assert not [p for p in draft.rglob(".*") if p.is_file()]


def test_a_second_signal_that_foreign_code_loses_ends_the_run_too(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def loses_it(*_: object) -> None:
        with suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr("ullage.experiments.runner.keep_replay", loses_it)
    assert ullage("run", "plan.yaml") == 130
    (draft,) = (place / "runs").glob(".*.draft")
    assert RunFolder(draft).state == "unfinished"


def wait_for_the_end(pids: set[int]) -> None:
    until = time.monotonic() + 30
    while any(map(alive, pids)) and time.monotonic() < until:
        time.sleep(0.05)
    assert not any(map(alive, pids))


@pytest.mark.slow
def test_workers_of_a_killed_sweep_end_and_the_sweep_resumes(place: Path) -> None:
    words = ("sweep", "plan.yaml", "--seeds", "4", "-o", "flight.speed_m_s=0.1", "-o", "sensing.rate_hz=100",
             "--out", "runs")  # fmt: skip
    process = started(*words, ready=lambda: len(list(Path("runs").glob(".*.draft"))) == 2)
    workers = children(process.pid)
    assert len(workers) >= 2
    process.kill()
    process.communicate()
    wait_for_the_end(workers)
    assert ullage(*words) == 0
    assert len((place / "runs/sweep.csv").read_text().splitlines()) == 5
    assert not list((place / "runs").glob(".*"))


@pytest.mark.slow
def test_sigterm_ends_a_sweep_and_its_workers(place: Path) -> None:
    words = ("sweep", "plan.yaml", "--seeds", "2", *LONG, "--out", "runs")
    process = started(*words, ready=lambda: len(list(Path("runs").glob(".*.draft"))) == 2)
    workers = children(process.pid)
    process.send_signal(signal.SIGTERM)
    printed, _ = process.communicate(timeout=120)
    assert process.returncode == 130, printed
    wait_for_the_end(workers)
