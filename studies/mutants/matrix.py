"""All sections; `python -m studies.mutants.matrix` prints which error breaks which statement."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from studies.mutants.bounds import BOUNDS
from studies.mutants.flights import BASELINE, FLIGHTS
from studies.mutants.measured import MEASURED
from studies.thesis.plan import EXPERIMENTS
from ullage.experiments.catalog import find_scenario, scenario_names

SECTIONS = (*FLIGHTS, *MEASURED, *BOUNDS)
STUDIES = Path(__file__).parents[2] / "studies"
HEAD = """# Statements and the errors that break them

Each statement of *The thesis, reproduced* has at least one error that breaks it. A test puts each error into the
method, the world or the flight, and checks that the statement no longer holds. Flights are flown once and spoilt
afterwards. Some experiments use part of a flight, and fewer speeds or seeds, to save time. For CPU and memory, the test
spoils the measured values.

`make statements` runs them all, and `make slow` a sample. Two sets of bounds have no error of their own here.
`cluttered-room-physical-again` differs from `cluttered-room-physical` only in the seed of its noise. World, flight
and bounds are equal, so an error for the one is an error for the other, and the test saves the second flight. The F1
of `cargo-hold-physical` is that of the whole hold. The test flies the first 2.5 m only, where a bound for the whole
flight cannot hold.
"""


def statements(page: str) -> Iterator[tuple[str, str, str]]:
    """Experiment, text and place in the thesis of each statement of the page."""
    names = {experiment.title: experiment.name for experiment in EXPERIMENTS}
    name, inside = "", False
    for line in page.splitlines():
        if line.startswith("## "):
            name = names.get(line[3:].split(" (")[0], "")
        inside = line.startswith("| statement |") or (inside and line.startswith("|"))
        if inside and not line.startswith(("| statement |", "|---")):
            text, where = line.strip("| ").split(" | ")[:2]
            yield name, text, where


def breaking(experiment: str, text: str) -> list[str]:
    """Errors that break a statement."""
    sections = [one for one in (*BASELINE, *SECTIONS) if one.experiment == experiment]
    found = [mutant.name for one in sections for mutant in one.mutants if any(words in text for words in mutant.fells)]
    return list(dict.fromkeys(found))


def bounds() -> Iterator[tuple[str, str]]:
    """Scenario and metric of each bound, as the sections state them, with the scenario's name."""
    for name in scenario_names():
        for metric in find_scenario(name).expect:
            yield name, f"{name}: {metric}"


def page() -> str:
    titles = {experiment.name: experiment.title for experiment in EXPERIMENTS}
    lines, last = [HEAD], ""
    for name, text, where in statements((STUDIES / "reproduced.md").read_text()):
        if name != last:
            lines += [f"\n## {titles[name]}\n", "| statement | thesis | broken by |", "|---|---|---|"]
        last = name
        lines.append(f"| {text} | {where} | {'; '.join(breaking(name, f'{text} ({where})'))} |")
    lines += ["\n## Bounds of the scenarios\n", "| scenario and metric | broken by |", "|---|---|"]
    lines += [f"| `{text}` | {'; '.join(breaking('expect', text))} |" for name, text in bounds() if states(name, text)]
    return "\n".join(lines) + "\n"


def states(name: str, text: str) -> bool:
    """Whether a section states a bound."""
    return name != "cluttered-room-physical-again" and text != "cargo-hold-physical: f1"


if __name__ == "__main__":
    print(page())
