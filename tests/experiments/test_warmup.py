"""Kernels are compiled once, before the run that needs them."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import ullage as ul
from ullage.experiments.catalog import find_scenario
from ullage.experiments.warmup import JOBS, compile_kernels, compiled, parts_of
from ullage.kernels import loops
from ullage.radar.warmup import Job, radar_parts, run_jobs
from ullage.world.library import WORLDS


def test_each_part_has_one_job() -> None:
    assert len({job.part for job in JOBS}) == len(JOBS)
    assert set(radar_parts("physical")) < {job.part for job in JOBS}


def test_compiling_what_the_main_job_needs_leaves_nothing_to_compile() -> None:
    parts = parts_of(find_scenario("cargo-hold"))
    assert {"hector", "thesis", "elfes"} <= set(parts)
    compile_kernels(parts)
    assert compiled(parts)


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


@pytest.mark.parametrize("module", ["ullage.no_such_module", "ullage.radar.warmup"])
def test_what_the_other_process_cannot_do_is_done_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str
) -> None:
    monkeypatch.setattr(loops, "cache_folder", lambda: tmp_path)
    done: list[str] = []
    jobs = [Job(name, lambda name=name: done.append(name)) for name in "abcde"]  # that process knows none of them
    loops.mark_compiled("b")
    told: list[str] = []
    run_jobs(jobs, module=module, log=told.append)
    assert sorted(done) == ["a", "c", "d", "e"]
    assert told[0].startswith("kernels for a")
    assert loops.compiled("abcde")


def test_a_failure_while_compiling_is_raised_and_nothing_is_marked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loops, "cache_folder", lambda: tmp_path)

    def fail() -> None:
        raise ValueError("failed")

    with pytest.raises(ValueError, match="failed"):
        run_jobs([Job("a", fail)], module="ullage.no_such_module")
    assert not loops.compiled("a")


FRESH = """
import ullage as ul
from ullage.kernels.loops import cache_folder
from ullage.radar.live import LiveRadars
from ullage.world.library import WORLDS
hold = ul.load_scene(WORLDS["cargo-hold"].path)
path = ul.Trajectory.line((-5.5, -7, 4), (-5.4, -7, 4), 0.5, 17)
LiveRadars(hold, ul.RadarSpec.preset("x4m05"), max_bounces=3)  # before the flight, not in it
before = set(cache_folder().rglob("*.nbc"))
ul.simulate(hold, path, ul.RadarSpec.preset("x4m05"), max_bounces=3)
print(sorted(file.name for file in set(cache_folder().rglob("*.nbc")) - before))
"""


@pytest.mark.slow
def test_nothing_is_left_to_compile_once_a_radar_is_warm(tmp_path: Path) -> None:
    settings = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    answer = subprocess.run([sys.executable, "-c", FRESH], env=settings, capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"
