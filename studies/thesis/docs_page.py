"""Writes all results of the reproduction as a page: python -m studies.thesis.docs_page RESULTS REPOSITORY."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from studies.thesis.plan import EXPERIMENTS
from studies.thesis.report import opening
from studies.thesis.results import Results, Table, read_results
from studies.thesis.task import origin_of
from ullage.errors import InputError
from ullage.experiments.folder import read_json, write_text

HEAD = """# The thesis, reproduced: all results

`python -m studies.thesis.docs_page RESULTS REPOSITORY` writes this page from the folder of `ullage reproduce`.
Each chapter is a whole run of its experiment. `docs/reproduce.md` sums it up.
"""
PICTURES = {
    "baseline": (),
    "detection": (
        "ntnu-plate.png",
        "ntnu-plate_sar.png",
        "ntnu-plate45.png",
        "ntnu-plate45_sar.png",
        "ntnu-pole.png",
        "ntnu-pole_sar.png",
        "ntnu-wire.png",
        "ntnu-wire_sar.png",
    ),
    "room": ("maps.png", "sar.png"),
    "hall": ("maps.png", "hover.png"),
    "hold": ("maps.png",),
    "causes": (),
    "budget": ("budget.png",),
    "speeds": ("speeds.png",),
    "methods": ("maps.png",),
    "images": ("poles.png",),
    "rail": ("rail.png",),
    "rest": (),
}
"""Which figures stand on the page, and in the documentation."""


def write_docs(root: Path, repository: Path) -> Path:
    """Write `studies/reproduced.md`, and its pictures below `docs`, from a folder of results.

    Raises:
        InputError: the folder holds no experiment.
    """
    done = [experiment for experiment in EXPERIMENTS if (root / experiment.name / "results.json").is_file()]
    if not done:
        raise InputError("no experiment here", where=root, allowed="a folder of `ullage reproduce`, whole or quick")
    lines = [HEAD, *_opening([(e.title, read_results(root / e.name / "results.json")) for e in done])]
    for experiment in done:
        tree = read_json(root / experiment.name / "results.json")
        section = f" ({experiment.section})" if experiment.section[0].isdigit() else ""
        lines.append(f"\n## {experiment.title}{section}\n")
        lines.append(f"{origin_of(tree)}\n")
        lines += _chapter(read_results(root / experiment.name / "results.json"), experiment.name, root, repository)
    page = repository / "studies" / "reproduced.md"
    page.parent.mkdir(exist_ok=True)
    write_text(page, "\n".join(lines).rstrip("\n") + "\n")
    return page


def _opening(chapters: Sequence[tuple[str, Results]]) -> Iterator[str]:
    found = opening(chapters)
    yield "\n## What holds\n"
    yield "\n".join(f"- {line}" for line in found["holds"]) + "\n"
    yield "\n## Where this reproduction differs\n"
    yield "| thesis | it says | here | cause |\n|---|---|---|---|"
    yield "\n".join(f"| {d.where} | {d.thesis} | {d.here} | {d.cause} |" for d in found["differs"]) + "\n"
    yield "\n## What could not be compared\n"
    yield "\n".join(f"- {line}" for line in found["lacking"]) + "\n"
    yield "\n## Figure beside figure\n"
    yield "| thesis | shows | here |\n|---|---|---|"
    yield "\n".join(f"| {f['number']} | {f['shows']} | {f['here']} |" for f in found["figures"]) + "\n"


def _chapter(found: Results, name: str, root: Path, repository: Path) -> Iterator[str]:
    for note in found.notes:
        yield f"{note}\n"
    if found.skipped:
        yield f"Not done: {found.skipped}\n"
    if found.statements:
        yield "| statement | thesis | measured | wanted | holds |\n|---|---|---|---|---|"
        for s in found.statements:
            verdict = "yes" if s.holds else "**no**"
            yield f"| {s.text} | {s.where} | {s.value:.3g} {s.unit} | {s.wanted} | {verdict} |"
        yield ""
    for table in found.tables:
        yield from _table(table)
    folder = repository / "docs" / "pictures" / "reproduce"
    folder.mkdir(parents=True, exist_ok=True)
    for item in found.figures:
        if item.file in PICTURES.get(name, ()):
            target = folder / f"{name}_{item.file}"
            shutil.copyfile(root / name / item.file, target)
            words = f"**Thesis {item.figure}.** {item.caption}" if item.figure else item.caption
            yield f"![{item.figure or name}](../docs/pictures/reproduce/{target.name})\n\n{words}\n"


def _table(table: Table) -> Iterator[str]:
    yield f"### {table.title}\n"
    yield "| " + " | ".join(cell or " " for cell in table.head) + " |\n|" + "---|" * len(table.head)
    for row in table.rows:
        yield "| " + " | ".join(row) + " |"
    yield ""
    if table.note:
        yield f"{table.note}\n"


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    print(write_docs(Path(sys.argv[1]), Path(sys.argv[2])))
