"""Every statement about the thesis can fail: broken methods, worlds and flights, and the statements that fall."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from spoilt import Fleet, quiet_bench
from statement_matrix import BASELINE, SECTIONS, Section

Patch = pytest.MonkeyPatch


def stated(section: Section, material: Any, folder: Path) -> dict[str, bool]:
    bench = quiet_bench(folder, quick=section.quick)
    section.state(bench, material)
    return {s.text: s.holds for s in bench.findings.statements}


def survivors(section: Section, fleet: Fleet, folder: Path) -> list[str]:
    """Mutants that leave a statement standing which they ought to fell, and statements that no mutant fells."""
    material, out = section.material(fleet), []
    sound = stated(section, material, folder)
    assert all(sound.values()), [text for text, holds in sound.items() if not holds]
    for mutant in section.mutants:
        with pytest.MonkeyPatch.context() as patch:
            mutant.patch(patch)
            found = stated(section, mutant.change(material), folder)
        standing = [words for words in mutant.fells if not any(words in text and not found[text] for text in found)]
        out += [f"{mutant.name}: {words}" for words in standing]
    expected = [words for mutant in section.mutants for words in mutant.fells]
    return out + [f"no mutant: {text}" for text in sound if not any(words in text for words in expected)]


def test_every_statement_about_a_term_falls_to_a_mutant(tmp_path):
    assert not survivors(BASELINE, Fleet(tmp_path), tmp_path)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory) -> Fleet:
    return Fleet(tmp_path_factory.mktemp("fleet"))


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.name)
def test_every_statement_of_an_experiment_falls_to_a_mutant(section, fleet, tmp_path):
    assert not survivors(section, fleet, tmp_path)
