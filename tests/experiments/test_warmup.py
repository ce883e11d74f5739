"""Kernels are compiled once, before the run that needs them."""

from __future__ import annotations

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
