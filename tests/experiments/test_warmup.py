"""Kernels are compiled once, before the run that needs them."""

from __future__ import annotations

import gc
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import ullage as ul
from ullage.experiments.catalog import find_scenario
from ullage.experiments.runner import execute
from ullage.experiments.source_resolution import make_run
from ullage.experiments.warmup import (
    FOLDER,
    JOBS,
    NEEDED,
    compile_kernels,
    compiled,
    parts_of,
)
from ullage.pipeline import sink
from ullage.radar.warmup import Compiling, Job, estimated_s, radar_parts, shared, unswept
from ullage.world.library import WORLDS


@pytest.mark.parametrize("part", NEEDED)
def test_every_part_names_kernels_that_are_there(part: str) -> None:
    kernels = ((FOLDER / f"{stem}.py").read_text() for stem in NEEDED[part])
    assert all("@loop(" in source or "@lean(" in source for source in kernels)


def test_compiling_what_the_main_job_needs_leaves_nothing_to_compile() -> None:
    parts = parts_of(find_scenario("cargo-hold"))
    assert {"hector", "thesis", "elfes"} <= set(parts)
    compile_kernels(parts)
    assert compiled(parts)


def test_what_joins_legs_of_a_volume_is_compiled_with_the_map(monkeypatch: pytest.MonkeyPatch) -> None:
    met: list[int] = []
    monkeypatch.setattr("ullage.processing.mapper_rings.weigh_rolls", lambda me, others, *_: met.append(len(others)))
    next(job for job in JOBS if job.part == "rules").run()
    assert met, "a volume would compile it in the middle"


def test_all_kernels_of_volumes_by_likelihood_are_compiled_with_the_map() -> None:
    from ullage.kernels import directed_sums, volume_cells

    next(job for job in JOBS if job.part == "likelihood in volumes").run()
    for module in (directed_sums, volume_cells):
        source = Path(str(module.__file__)).read_text()
        for name in re.findall(r"@loop\(.*?\)\ndef (\w+)", source):
            assert getattr(module, name).signatures, f"a volume would compile {name} in the middle"


TOLD = """
import numpy as np, ullage as ul
path = ul.Trajectory.line((0, 0, 0), (0, 0.1, 0), 0.5, 5)
for _ in range(2):
    ul.simulate(ul.scenes.plate(0.5, 0.5, 2.0), path, ul.RadarSpec.preset("x4m05"), fidelity="thesis")
"""


def test_simulating_tells_that_it_compiles_once_and_where_numba_keeps_its_copies(tmp_path: Path) -> None:
    settings = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}

    def run() -> str:
        return subprocess.run([sys.executable, "-c", TOLD], env=settings, capture_output=True, text=True,
                              check=True).stderr  # fmt: skip

    said = run()
    assert said.count("compiling kernels") == 1
    assert list(tmp_path.rglob("*.nbi"))
    asked = "from ullage.kernels import compiled; print(compiled('rays'), compiled('track'))"
    answer = subprocess.run([sys.executable, "-c", asked], env=settings, capture_output=True, text=True, check=True)
    assert answer.stdout.split() == ["True", "False"]
    assert "compiling" not in run()


def test_a_world_needs_the_kernels_of_what_is_in_it() -> None:
    room = ul.scenes.room(material="concrete")
    assert radar_parts("thesis", 3, room) == ("thesis",)
    assert radar_parts("physical", 1, room) == ("physical",)
    assert radar_parts("physical", 2, room) == ("physical", "bounces")
    assert radar_parts("physical", 1, ul.scenes.sphere(0.2, 2.0, material="wood")) == ("physical", "shapes")
    assert radar_parts("physical", 1, ul.scenes.wire(0.001, 0.5, 2.0)) == ("physical", "shapes")
    assert radar_parts("physical", 1, ul.scenes.plate(0.5, 0.5, 2.0)) == ("physical", "conductors")
    tank = ul.scenes.tank(2.0, 1.0, "concrete", strips=30)
    assert radar_parts("physical", 1, tank) == ("physical", "curved")
    assert radar_parts("physical", 2, tank) == ("physical", "bounces", "paths", "curved")
    assert radar_parts("physical", 2, ul.Scene.union([room, ul.scenes.wire(0.001, 0.5, 2.0)])) == (
        "physical", "bounces", "shapes", "paths")  # fmt: skip
    assert "paths" in radar_parts("physical", 3, ul.scenes.hold())
    assert "fermat" in radar_parts("physical", 3, ul.load_scene(WORLDS["cluttered-room"].path))
    assert "chains" not in radar_parts("physical", 3, ul.load_scene(WORLDS["cluttered-room"].path))
    ball = ul.scenes.sphere(0.3, 1.0)
    deep = ul.Scene.union([replace(tank, vertices=tank.vertices - [0, 0, 0.5]), ball])
    assert "chains" in radar_parts("physical", 2, deep)
    assert "fermat" not in radar_parts("physical", 1, ul.load_scene(WORLDS["cluttered-room"].path))
    everything = {"physical", "rough", "bounces", "shapes", "conductors", "paths", "curved", "fermat", "chains"}
    assert set(radar_parts("physical")) == everything


def test_jobs_are_shared_evenly_and_what_needs_others_waits_in_this_process() -> None:
    mine, others = shared(JOBS)
    assert sorted(job.name for job in mine + others) == sorted(job.name for job in JOBS)
    assert not any(job.needs for job in others)
    place = {job.name: index for index, job in enumerate(JOBS)}
    assert all(place[name] < place[job.name] for job in JOBS for name in job.needs)
    for share in (mine, others):
        assert [place[job.name] for job in share] == sorted(place[job.name] for job in share)
    radar = [job for job in JOBS if job.part in ("physical", "bounces", "shapes", "conductors")]
    one, other = (sum(job.seconds for job in share) for share in shared(radar))
    assert abs(one - other) < 0.3 * (one + other)


def test_garbage_is_left_while_compiling_and_collected_again_after_a_failure() -> None:
    assert gc.isenabled()
    seen: list[bool] = []

    def fail() -> None:
        with unswept():
            seen.append(gc.isenabled())
            raise ValueError("failed")

    with pytest.raises(ValueError, match="failed"):
        fail()
    assert seen == [False]
    assert gc.isenabled()
    gc.disable()
    try:
        with unswept():
            pass
        assert not gc.isenabled()  # that is for whoever turned it off
    finally:
        gc.enable()


def test_what_the_other_process_leaves_undone_is_done_here() -> None:
    done: list[str] = []
    jobs = [Job(name, "", 3.0, lambda name=name: done.append(name)) for name in "abc"]
    late = Job("d", "", 1.0, lambda: done.append("d"))
    work = Compiling(jobs, [late], module="ullage.no_such_module", log=lambda what: None)
    work.wait()
    assert sorted(done) == ["a", "b", "c"]
    work.wait_later()
    work.wait_later()
    assert sorted(done) == ["a", "b", "c", "d"]


def test_compiling_announces_the_time_that_is_left() -> None:
    said: list[str] = []
    work = Compiling([Job(name, "", 4.0, lambda: None, needs=("x",)) for name in "abc"], log=said.append)
    assert estimated_s(work.now) == 12
    work.wait()
    assert said[0] == "a, about 12 s left"
    assert work.left_s == 0
    assert said[-1] == "c"  # the first ones took no time, so nor will the last


class _Watched(Compiling):
    """Something under way that looks at the recording when it is waited for."""

    def __init__(self, folder: Path) -> None:
        super().__init__([], JOBS[-2:])
        self.folder, self.closed, self.seen = folder, False, -1

    def wait_later(self) -> None:
        self.seen = sum(p.stat().st_size for p in self.folder.glob("*.mcap*")) + len(list(self.folder.glob(".*mcap*")))
        raise KeyboardInterrupt

    def close(self) -> None:
        self.closed = True


def test_ctrl_c_while_the_map_is_compiled_leaves_the_frames_received_by_then(tmp_path: Path) -> None:
    options = ["sensing.fidelity=thesis", "flight.vehicle=ideal"]
    job = make_run("ntnu-plate", tasks=("map", "image"), options=options, out=tmp_path)
    work = _Watched(job.folder)
    report = execute(job, sinks=[sink(str(job.folder / "frames.mcap"))], log=lambda text: None, draw=False,
                     under_way=work)  # fmt: skip
    assert report.outcome.interrupted
    assert work.closed
    assert work.seen > 0  # the recording had begun before the map was waited for
    kept = ul.open(str(job.folder / "frames.mcap")).frames()
    assert len(kept) == report.outcome.frames > 0
    assert (job.folder / "metrics.json").is_file()


FRESH = """
import ullage as ul
from numba.core import event
from ullage.radar.warmup import warm_up
from ullage.world.library import WORLDS
hold = ul.load_scene(WORLDS["cargo-hold"].path)
path = ul.Trajectory.line((-5.5, -7, 4), (-5.4, -7, 4), 0.5, 17)
warm_up("physical", 3, hold)
with event.install_recorder("numba:compile") as found:
    ul.simulate(hold, path, ul.RadarSpec.preset("x4m05"), max_bounces=3)
print(sorted({e.data["dispatcher"].py_func.__name__ for _, e in found.buffer}))
"""


@pytest.mark.slow
def test_nothing_is_left_to_compile_once_a_radar_is_warm(tmp_path: Path) -> None:
    settings = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    answer = subprocess.run([sys.executable, "-c", FRESH], env=settings, capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"
