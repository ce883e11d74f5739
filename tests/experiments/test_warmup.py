"""Kernels are compiled once, before the run that needs them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import ullage as ul
from ullage.experiments.catalog import find_scenario
from ullage.experiments.warmup import (
    FOLDER,
    JOBS,
    NEEDED,
    _shared,
    compile_kernels,
    compiled,
    parts_of,
    radar_parts,
)


@pytest.mark.parametrize("part", NEEDED)
def test_every_part_names_kernels_that_are_there(part: str) -> None:
    assert all("njit" in (FOLDER / f"{stem}.py").read_text() for stem in NEEDED[part])


def test_compiling_what_the_main_job_needs_leaves_nothing_to_compile() -> None:
    parts = parts_of(find_scenario("cargo-hold"))
    assert {"hector", "thesis", "elfes"} <= set(parts)
    compile_kernels(parts)
    assert compiled(parts)


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
    assert set(radar_parts("physical")) == {"physical", "rough", "bounces", "shapes", "conductors"}


def test_jobs_that_need_the_same_kernels_are_in_one_process() -> None:
    mine, others = _shared(list(JOBS))
    assert sorted(job.name for job in mine + others) == sorted(job.name for job in JOBS)
    for share in (mine, others):
        names = {job.name for job in share}
        assert all(not job.along or job.along in names for job in share)
