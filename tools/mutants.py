"""Break the code at random places and count how many of the breaks the tests notice (mutation testing).

Each mutant changes one place of a copy of the source: an operator, a comparison, a number. The tests related to that
file then run until the first one fails. A mutant that no test notices survives: either the change has no effect, or a
law is missing from the tests. The mutations are those of Cosmic Ray; this script draws the sample and picks the tests.

    make mutants                                   # 100 mutants, an hour or two on two quiet cores
    .venv/bin/python tools/mutants.py -n 10 --seed 7 --in kernels
"""

from __future__ import annotations

import argparse
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

import cosmic_ray.plugins
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import use_mutation

ROOT = Path(__file__).parent.parent
AREAS = {
    "kernels": ("kernels", "physics", "radar", "processing", "flight"),
    "radar": ("radar", "physics"),
    "processing": ("processing",),
    "ports": ("ports",),
}
"""Folders of `src/ullage`, and the folders of `tests` that test each."""
LEFT_OUT = ("Decorator", "ExceptionReplacer", "Variable")  # change how code is compiled or caught, or need arguments


def operators() -> dict[str, type]:
    """The mutations to draw from, by name."""
    names = [n for n in cosmic_ray.plugins.operator_names() if not any(word in n for word in LEFT_OUT)]
    return {name: cosmic_ray.plugins.get_operator(name) for name in names}


def draw(source: Path, rng: random.Random) -> tuple[str, int, int] | None:
    """Draw one mutation of a file: operator, its occurrence and the line; None where the file offers none.

    Places are drawn first, then what is done there: an addition offers ten mutations, a number one.
    """
    tree = get_ast(source.read_text(encoding="utf-8"))
    nodes = list(ast_nodes(tree))
    places = defaultdict(list)
    for name, operator in operators().items():
        spots = [spot for node in nodes if not _typing(node) for spot in operator().mutation_positions(node)]
        everywhere = [spot for node in nodes for spot in operator().mutation_positions(node)]
        for occurrence, spot in enumerate(everywhere):
            if spot in spots:
                places[spot].append((name, occurrence))
    if not places:
        return None
    (start, _), found = rng.choice(sorted(places.items()))
    name, occurrence = rng.choice(found)
    return name, occurrence, start[0]


def _typing(node: object) -> bool:
    """Whether a node belongs to an annotation, which is never run."""
    while node is not None:
        if getattr(node, "type", "") in ("annassign", "tfpdef"):
            return True
        parent = getattr(node, "parent", None)
        if getattr(parent, "type", "") == "funcdef" and getattr(parent, "annotation", None) is node:
            return True
        node = parent
    return False


def related(source: Path, area: str, tests: Path) -> list[str]:
    """The test files of an area, those that name the module first."""
    files = [f for folder in AREAS[area] for f in sorted((tests / folder).rglob("test_*.py"))]
    return [str(f) for f in sorted(files, key=lambda f: source.stem not in f.read_text(encoding="utf-8"))]


def killed(tests: list[str], folder: Path, limit_s: float) -> bool:
    """Whether some test fails, or the tests hang, on the source as it is."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-m", "not slow", "-p", "no:cacheprovider", *tests]
    try:
        return subprocess.run(command, cwd=folder, env=_environment(folder), stdout=subprocess.DEVNULL,
                              stderr=subprocess.DEVNULL, timeout=limit_s, check=False).returncode != 0  # fmt: skip
    except subprocess.TimeoutExpired:
        return True


def _environment(folder: Path) -> dict[str, str]:
    import os

    return os.environ | {"PYTHONPATH": str(folder / "src")}


def copied(place: str) -> Path:
    """Copy source and tests, with a link to the recordings beside them, so that the tree itself stays whole."""
    folder = Path(place) / "tree"
    for name in ("src", "tests", "integrations", "examples", "docs", "benchmarks"):
        shutil.copytree(ROOT / name, folder / name)
    shutil.copy(ROOT / "pyproject.toml", folder)
    if (ROOT.parent / "shared").exists():
        (Path(place) / "shared").symlink_to(ROOT.parent / "shared")
    return folder


def main() -> int:
    """Draw mutants, run the tests on each, print the survivors; exit 1 when too many survive."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-n", type=int, default=100, help="mutants (default 100)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--in", dest="areas", nargs="+", choices=AREAS, default=list(AREAS))
    parser.add_argument("--most", type=int, default=15, help="of 100, how many may survive (default 15)")
    parser.add_argument("--limit-s", type=float, default=900.0, help="tests that run longer are taken to hang")
    wanted = parser.parse_args()
    rng, survivors = random.Random(wanted.seed), []
    with tempfile.TemporaryDirectory(prefix="mutants-") as place:
        folder = copied(place)
        files = [(f, area) for area in wanted.areas for f in sorted((folder / "src/ullage" / area).rglob("*.py"))]
        weights = [len(f.read_text(encoding="utf-8").splitlines()) for f, _ in files]
        done = 0
        while done < wanted.n:
            ((source, area),) = rng.choices(files, weights)
            if (mutation := draw(source, rng)) is None:
                continue
            name, occurrence, line = mutation
            began = time.monotonic()
            with use_mutation(source, operators()[name](), occurrence):
                noticed = killed(related(source, area, folder / "tests"), folder, wanted.limit_s)
            done += 1
            text = f"{source.relative_to(folder)}:{line} {name.removeprefix('core/')}"
            survivors += [] if noticed else [text]
            print(
                f"{done:3d} {'noticed ' if noticed else 'SURVIVED'} {time.monotonic() - began:5.0f} s {text}",
                flush=True,
            )
    print(f"{len(survivors)} of {done} survive", *survivors, sep="\n  ")
    return int(len(survivors) > wanted.most * done / 100)


if __name__ == "__main__":
    sys.exit(main())
