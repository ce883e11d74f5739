"""Every statement about the thesis can fail: broken methods, worlds and flights, and the statements that fall."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from studies.mutants.matrix import BASELINE, SECTIONS, STUDIES, bounds, breaking, statements, states
from studies.mutants.spoilt import RECORDINGS, Fleet, Section, quiet_workspace

Patch = pytest.MonkeyPatch
SAMPLE = {
    "targets alone", "floor and wire", "behind the last wall", "CPU of a reading",
    "the node on board", "an X4 at rest", "bounds of two flights by hand",
}  # fmt: skip
"""Sections that `make slow` runs, at least one of each file of the matrix; `make statements` runs all."""


def marked(section: Section) -> Any:
    """The section with its marks."""
    marks = [pytest.mark.slow] if section.name in SAMPLE else [pytest.mark.slow, pytest.mark.statements]
    return pytest.param(section, id=section.name, marks=marks)


def stated(section: Section, material: Any, folder: Path) -> dict[str, bool]:
    """Whether each statement holds, by its text and where in the thesis it belongs."""
    work = quiet_workspace(folder, quick=section.quick)
    section.state(work, material)
    return {f"{s.text} ({s.where})": s.holds for s in work.results.statements}


def survivors(section: Section, fleet: Fleet, folder: Path) -> list[str]:
    """Statements that stand although a mutant ought to fell them, and statements that no mutant fells."""
    material, out = section.material(fleet), []
    sound = stated(section, material, folder)
    assert all(sound.values()), [text for text, holds in sound.items() if not holds]
    left = set(sound)
    for mutant in section.mutants:
        with pytest.MonkeyPatch.context() as patch:
            mutant.patch(patch)
            found = stated(section, mutant.change(material), folder)
        for words in mutant.fells:
            mine = {text for text in sound if words in text}
            left -= mine
            out += [f"{mutant.name}: {text}" for text in mine if found.get(text)]
            out += [] if mine else [f"{mutant.name}: no statement has the words {words!r}"]
    return out + [f"no mutant: {text}" for text in sorted(left)]


@pytest.mark.parametrize("section", BASELINE, ids=lambda section: section.name)
def test_every_statement_about_a_term_falls_to_a_mutant(section, tmp_path):
    assert not survivors(section, Fleet(tmp_path), tmp_path)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory) -> Fleet:
    return Fleet(tmp_path_factory.mktemp("fleet"))


@pytest.mark.timeout(1200)
@pytest.mark.filterwarnings("ignore:divide by zero")
@pytest.mark.parametrize("section", [marked(section) for section in SECTIONS])
def test_every_statement_of_an_experiment_falls_to_a_mutant(section, fleet, tmp_path):
    if absent := [name for name in section.reads if not (RECORDINGS / name).is_file()]:
        pytest.skip(f"the recordings are not part of the package: {absent[0]}")
    assert not survivors(section, fleet, tmp_path)


def test_every_statement_of_the_page_has_a_mutant():
    stated_there = list(statements((STUDIES / "reproduced.md").read_text()))
    assert len(stated_there) > 120
    assert {section.name for section in SECTIONS} > SAMPLE
    assert not [text for name, text, where in stated_there if not breaking(name, f"{text} ({where})")]
    assert not [text for name, text in bounds() if states(name, text) and not breaking("expect", text)]
