"""Break the code at random places and count how many of the breaks the tests notice (mutation testing).

Each mutant changes one place of a copy of the source: an operator, a comparison, a number. The tests that run the
changed line then run until the first one fails. A mutant that no test notices survives: either the change has no
effect, or a law is missing from the tests. The mutations are those of Cosmic Ray; this script draws the sample and
picks the tests. Which test runs which line is recorded once in `.mutants/` by coverage.py. Compiled kernels cannot be
recorded: a changed kernel is tested where Python code calls it, or calls a kernel that depends on it.

    make mutants                                   # 100 mutants, an hour or two on two quiet cores
    .venv/bin/python tools/mutants.py -n 10 --seed 7 --in kernels
    .venv/bin/python tools/mutants.py --seed 7 --pick 3 8     # two of them again
    .venv/bin/python tools/mutants.py --record tests/radar    # record new tests
"""

from __future__ import annotations

import argparse
import ast
import difflib
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import cosmic_ray.plugins
import coverage
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from numba.core.caching import _CacheLocator

ROOT = Path(__file__).parent.parent
RECORDS = ROOT / ".mutants"
AREAS = ("kernels", "radar", "processing", "ports", "world")
LEFT_OUT = ("Decorator", "ExceptionReplacer", "Variable")  # change how code is compiled or caught, or need arguments
PLUGIN = ("-p", "tests_by_line", "-p", "no:cacheprovider", "-m", "not slow", "-q")


def operators() -> dict[str, type]:
    """The mutations to draw from, by name."""
    names = [n for n in cosmic_ray.plugins.operator_names() if not any(word in n for word in LEFT_OUT)]
    return {name: cosmic_ray.plugins.get_operator(name) for name in names}


def draw(source: Path, rng: random.Random) -> tuple[str, int, int] | None:
    """Draw one mutation of a file: operator, its occurrence and the line; None where the file offers none.

    Places are drawn first, then what is done there: an addition offers ten mutations, a number one.
    """
    nodes = [(node, _idle(node)) for node in ast_nodes(get_ast(source.read_text(encoding="utf-8")))]
    places = defaultdict(list)
    for name, operator in operators().items():
        occurrence = 0
        for node, idle in nodes:
            for spot in operator().mutation_positions(node):
                if not idle:
                    places[spot].append((name, occurrence))
                occurrence += 1
    if not places:
        return None
    (start, _), found = rng.choice(sorted(places.items()))
    name, occurrence = rng.choice(found)
    return name, occurrence, start[0]


def _idle(node: Any) -> bool:
    """Whether a node changes no result: it belongs to an annotation, a decorator, or a `strict=` of zip."""
    while node is not None:
        kind, parent = getattr(node, "type", ""), getattr(node, "parent", None)
        if kind in ("annassign", "tfpdef", "decorator") or (
            kind == "argument" and node.get_first_leaf().value == "strict"
        ):
            return True
        if getattr(parent, "type", "") == "funcdef" and getattr(parent, "annotation", None) is node:
            return True
        node = parent
    return False


def record(tests: Iterable[str]) -> None:
    """Record which lines of the source these tests run, beside what is recorded already."""
    command = [sys.executable, "-m", "pytest", *PLUGIN, "--record", str(RECORDS), *tests]
    subprocess.run(command, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT / "tools")}, check=False)


class Tests:
    """The tests, by the lines that they run."""

    def __init__(self) -> None:
        coverage.Coverage(data_file=str(RECORDS / "all"), config_file=False).combine(
            [str(path) for path in RECORDS.glob("lines.*")], keep=True
        )
        self._lines = coverage.CoverageData(str(RECORDS / "all"))
        self._lines.read()
        self._seconds: dict[str, float] = {}
        for path in RECORDS.glob("seconds.*.json"):
            self._seconds |= json.loads(path.read_text(encoding="utf-8"))

    def running(self, source: Path, line: int) -> list[str]:
        """The tests that run a line, the quickest first; those of the file where no test runs it by itself.

        Args:
            source: the file, relative to the root.
            line: its number.
        """
        spots = set(calls(source, line)) if source.parent.name == "kernels" else {(source, line)}
        found = self._of(spots) or self._of({(file, None) for file, _ in spots}) or self._naming(source)
        return sorted(found, key=lambda name: self._seconds.get(name, 0.0))

    def seconds(self, name: str) -> float:
        """How long a test took when it was recorded."""
        return self._seconds.get(name, 0.0)

    def _of(self, spots: Iterable[tuple[Path, int | None]]) -> set[str]:
        out: set[str] = set()
        for file, line in spots:
            by_line = self._contexts(file)
            for context in by_line.get(line, []) if line else {c for found in by_line.values() for c in found}:
                out |= {context} if "::" in context else set(self._in_file(context))
        return out

    @cache  # noqa: B019
    def _contexts(self, file: Path) -> dict[int, list[str]]:
        return {n: [c for c in found if c] for n, found in self._lines.contexts_by_lineno(str(ROOT / file)).items()}

    @cache  # noqa: B019
    def _in_file(self, file: str) -> list[str]:
        return [name for name in self._seconds if name.startswith(f"{file}::")] if file else []

    def _naming(self, source: Path) -> set[str]:
        """What runs in processes of its own is not recorded: the tests of files that name the module."""
        files = {name.partition("::")[0] for name in self._seconds}
        text = {file: (ROOT / file).read_text(encoding="utf-8") for file in files if (ROOT / file).exists()}
        place = re.compile(rf"\b{source.parent.name}\b.*\b{source.stem}\b|\b{source.stem}\b.*\b{source.parent.name}\b")
        return {name for file in text if place.search(text[file]) for name in self._in_file(file)}


def calls(source: Path, line: int) -> Iterator[tuple[Path, int]]:
    """Where Python code calls what depends on a line of the kernels."""
    functions, used = kernel_names()
    names = {name for name, (file, first, last) in functions.items() if file == source.name and first <= line <= last}
    names = names or {name for name, (file, _, _) in functions.items() if file == source.name}
    while more := {name for name, uses in used.items() if uses & names} - names:
        names |= more
    for file in [*sorted((ROOT / "src").rglob("*.py")), *sorted((ROOT / "tests").rglob("*.py"))]:
        if file.parent.name != "kernels":
            for node in ast.walk(_parsed(file)):
                if isinstance(node, ast.Name | ast.Attribute) and _name(node) in names:
                    yield file.relative_to(ROOT), node.lineno


@cache
def kernel_names() -> tuple[dict[str, tuple[str, int, int]], dict[str, set[str]]]:
    """Where each kernel stands, and the names that it uses."""
    functions, used = {}, {}
    for file in (ROOT / "src/ullage/kernels").glob("*.py"):
        for node in _parsed(file).body:
            if isinstance(node, ast.FunctionDef):
                functions[node.name] = file.name, node.lineno, node.end_lineno or node.lineno
                used[node.name] = {_name(n) for n in ast.walk(node) if isinstance(n, ast.Name | ast.Attribute)}
    return functions, used


@cache
def _parsed(file: Path) -> ast.Module:
    return ast.parse(file.read_text(encoding="utf-8"))


def _name(node: ast.Name | ast.Attribute) -> str:
    return node.id if isinstance(node, ast.Name) else node.attr


class Copy:
    """A copy of source and tests, so that the tree itself stays whole."""

    def __init__(self, place: Path) -> None:
        self.folder = place / "tree"
        for name in ("src", "studies", "tests", "integrations", "examples", "docs", "benchmarks"):
            shutil.copytree(ROOT / name, self.folder / name, ignore=shutil.ignore_patterns("kernels-*"))
        shutil.copy(ROOT / "pyproject.toml", self.folder)
        if (ROOT.parent / "shared").exists():
            (place / "shared").symlink_to(ROOT.parent / "shared")
        for name in (".venv", ".venv-ros2"):
            if (ROOT / name).exists():
                (self.folder / name).symlink_to(ROOT / name)
        self._environment = os.environ | {
            "PYTHONPATH": f"{self.folder / 'src'}:{ROOT / 'tools'}",
            "NUMBA_CACHE_DIR": str(place / "kernels"),
            "PYTHONDONTWRITEBYTECODE": "1",
        }

    def killed(self, source: Path, code: str, tests: list[str], limit_s: float) -> bool:
        """Whether some test fails, or the tests hang, where a file has this code."""
        file, chosen = self.folder / source, self.folder / "chosen.json"
        before, times = file.read_bytes(), file.stat()
        chosen.write_text(json.dumps(tests), encoding="utf-8")
        try:
            file.write_text(code, encoding="utf-8")
            self._compiled_copies(source)
            return self._fails(["--chosen", str(chosen), *sorted({t.partition("::")[0] for t in tests})], limit_s)
        finally:
            file.write_bytes(before)
            os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))

    def _fails(self, words: list[str], limit_s: float) -> bool:
        command = [sys.executable, "-m", "pytest", "-x", *PLUGIN, *words]
        try:
            return subprocess.run(command, cwd=self.folder, env=self._environment, stdout=subprocess.DEVNULL,
                                  stderr=subprocess.DEVNULL, timeout=limit_s, check=False).returncode != 0  # fmt: skip
        except subprocess.TimeoutExpired:
            return True

    def _compiled_copies(self, source: Path) -> None:
        """Take over the compiled kernels that do not depend on a changed file, so that only the others are compiled."""
        home = Path("src/ullage/kernels")
        stale = dependents(source.stem) if source.parent == home else set()
        asked = "from ullage.kernels.loops import cache_folder; print(cache_folder())"
        old, new = (
            Path(subprocess.run([sys.executable, "-c", asked], env=environment, capture_output=True, text=True,
                                check=True).stdout.strip())
            for environment in (os.environ | {"PYTHONPATH": str(ROOT / "src")}, self._environment)
        )  # fmt: skip
        old /= _CacheLocator.get_suitable_cache_subpath(str(ROOT / home / "x.py"))
        new /= _CacheLocator.get_suitable_cache_subpath(str(self.folder / home / "x.py"))
        if not new.exists():
            shutil.copytree(old, new, ignore=lambda _, names: [n for n in names if n.partition(".")[0] in stale])


def dependents(stem: str) -> set[str]:
    """The kernel modules that import one, directly or not, and itself."""
    imports = {}
    for file in (ROOT / "src/ullage/kernels").glob("*.py"):
        froms = [node for node in ast.walk(_parsed(file)) if isinstance(node, ast.ImportFrom)]
        imports[file.stem] = {n.module.rpartition(".")[2] for n in froms if n.module}
        imports[file.stem] |= {alias.name for n in froms for alias in n.names}
    out = {stem}
    while more := {name for name, needs in imports.items() if needs & out} - out:
        out |= more
    return out


def sample(seed: int, areas: Iterable[str]) -> Iterator[tuple[Path, str, int, int]]:
    """Draw mutants without end: file relative to the root, operator, occurrence, line."""
    rng = random.Random(seed)
    files = [f for area in areas for f in sorted((ROOT / "src/ullage" / area).rglob("*.py"))]
    weights = [len(f.read_text(encoding="utf-8").splitlines()) for f in files]
    while True:
        (source,) = rng.choices(files, weights)
        if (mutation := draw(source, rng)) is not None:
            yield source.relative_to(ROOT), *mutation


def change(source: Path, name: str, occurrence: int) -> tuple[str, str]:
    """The changed code, and the lines that differ."""
    code = (ROOT / source).read_text(encoding="utf-8")
    new = mutate_code(code, operators()[name](), occurrence)
    lines = difflib.unified_diff(code.splitlines(), new.splitlines(), n=0, lineterm="")
    return new, "\n".join(f"        {line}" for line in list(lines)[3:])


def quickest(tests: list[str], known: Tests, most_s: float) -> list[str]:
    """As many of the tests, in their order, as took this long when they were recorded; at least one."""
    total, out = 0.0, []
    for name in tests:
        total += known.seconds(name)
        if out and total > most_s:
            break
        out.append(name)
    return out


def main() -> int:
    """Draw mutants, run the tests on each, print the survivors; exit 1 when too many survive."""
    wanted = _arguments()
    if wanted.record is not None or not list(RECORDS.glob("lines.*")):
        record(wanted.record or [])
        if wanted.record is not None:
            return 0
    known, survivors, done = Tests(), [], 0
    with tempfile.TemporaryDirectory(prefix="mutants-") as place:
        copy = Copy(Path(place))
        drawn = sample(wanted.seed, wanted.areas)
        for number in range(1, max([wanted.n, *wanted.pick]) + 1):
            source, name, occurrence, line = next(drawn)
            if wanted.pick and number not in wanted.pick:
                continue
            began, (code, diff) = time.monotonic(), change(source, name, occurrence)
            tests = known.running(source, line)
            noticed = bool(tests) and copy.killed(source, code, quickest(tests, known, wanted.most_s), wanted.limit_s)
            done += 1
            text = f"{source}:{line} {name.removeprefix('core/')} ({len(tests)} tests)"
            survivors += [] if noticed else [f"{number} {text}\n{diff}"]
            verdict = "noticed " if noticed else "SURVIVED"
            print(f"{number:3d} {verdict} {time.monotonic() - began:5.0f} s {text}", flush=True)
    print(f"{len(survivors)} of {done} survive", *survivors, sep="\n  ")
    return int(len(survivors) > wanted.most * done / 100)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-n", type=int, default=100, help="mutants (default 100)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--in", dest="areas", nargs="+", choices=AREAS, default=list(AREAS))
    parser.add_argument("--pick", type=int, nargs="+", default=[], help="only these of the sample, by their numbers")
    parser.add_argument("--most", type=int, default=15, help="of 100, how many may survive (default 15)")
    parser.add_argument(
        "--most-s", type=float, default=120.0, help="of the tests of a line, run those of the first [s]"
    )
    parser.add_argument("--limit-s", type=float, default=900.0, help="tests that run longer are taken to hang")
    parser.add_argument("--record", nargs="*", help="record which lines these tests run, and end (default: all)")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
