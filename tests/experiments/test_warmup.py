"""Kernels are compiled once, before the run that needs them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ullage.experiments.catalog import find_scenario
from ullage.experiments.warmup import FOLDER, NEEDED, compile_kernels, compiled, parts_of


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
