"""The rules of the house, checked: quick import, layers, docstrings, sources that exist."""

from __future__ import annotations

import ast
import graphlib
import importlib
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import ullage as ul

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "src" / "ullage").rglob("*.py"))
STUDIES = sorted((ROOT / "studies").rglob("*.py"))
HEAVY = {
    "matplotlib",
    "numba",
    "mujoco",
    "trimesh",
    "embreex",
    "scipy",
    "rosbags",
    "mcap",
    "typer",
    "numpy",
    "pydantic",
}


@cache
def parsed(path: Path) -> ast.Module:
    """The syntax tree of a source file, made once."""
    return ast.parse(path.read_text(encoding="utf-8"))


def test_importing_the_package_loads_nothing_heavy() -> None:
    code = "import sys, ullage; print(*{name.split('.')[0] for name in sys.modules})"
    loaded = set(
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    )
    assert not loaded & HEAVY


def test_help_loads_no_number_crunching() -> None:
    code = "import sys, ullage.cli; print(*{name.split('.')[0] for name in sys.modules})"
    loaded = set(
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    )
    assert not loaded & (HEAVY - {"typer"})


def test_a_live_run_loads_nothing_that_only_simulated_flights_need() -> None:
    """Its first frames are to be seen within two seconds: each of these takes a tenth of one or more."""
    parts = "runner, ullage.experiments.source_resolution, ullage.ports.instruments.group, ullage.ports.mavlink.source"
    code = f"import sys, ullage.cli, ullage.experiments.{parts}; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    wanted = {"scipy.signal", "scipy.stats", "scipy.interpolate", "ullage.experiments.exploration"}
    assert not wanted & set(loaded)


def test_every_public_name_is_there_and_has_a_docstring() -> None:
    assert [name for name in ul.__all__ if name != "C0" and not getattr(ul, name).__doc__] == []


def test_a_file_says_what_it_is_for() -> None:
    assert [path for path in SOURCES + STUDIES if not ast.get_docstring(parsed(path))] == []


def test_every_source_named_is_in_the_references() -> None:
    known = set(re.findall(r"@\w+\{([^,]+),", (ROOT / "docs" / "references.bib").read_text(encoding="utf-8")))
    missing = {}
    for path in SOURCES + STUDIES:
        for node in ast.walk(parsed(path)):
            if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef) and (text := ast.get_docstring(node)):
                keys = set(re.findall(r"\[([A-Z][A-Za-z-]*\d[\w-]*)", text)) - known
                missing |= dict.fromkeys(keys, path.name)
    assert not missing


def test_kernels_know_none_of_our_types() -> None:
    for path in (ROOT / "src" / "ullage" / "kernels").glob("*.py"):
        for node in ast.walk(parsed(path)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("ullage"):
                assert node.module.startswith(("ullage.kernels", "ullage.geometry", "ullage.arrays")), path.name


def imported(tree: ast.Module) -> set[str]:
    """Modules named by a file's imports, with the packages above them; not those for type checkers only."""
    names: set[str] = set()
    waiting: list[ast.AST] = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            continue
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
        waiting += ast.iter_child_nodes(node)
    return {name.rsplit(".", cut)[0] for name in names for cut in range(name.count(".") + 1)}


def test_no_module_imports_itself_through_others() -> None:
    """Importing a module runs the packages above it too, so a package that imports its own modules makes a circle."""
    graph = {}
    for path in SOURCES:
        parts = path.relative_to(ROOT / "src").with_suffix("").parts
        graph[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    edges = {name: imported(parsed(path)) & graph.keys() - {name} for name, path in graph.items()}
    order = graphlib.TopologicalSorter(edges).static_order()  # raises CycleError with the modules of a circle
    assert set(order) == graph.keys()


def test_editors_see_every_public_name() -> None:
    tree = ast.parse((ROOT / "src" / "ullage" / "__init__.pyi").read_text(encoding="utf-8"))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    names = [(node.module, alias) for node in imports if "ullage" in str(node.module) for alias in node.names]
    seen = {}
    for module, alias in names:
        inner = getattr(importlib.import_module(str(module)), alias.name, None)
        seen[alias.asname] = inner or importlib.import_module(f"{module}.{alias.name}")
    assert seen == {name: getattr(ul, name) for name in ul.__all__}


def test_no_function_takes_more_than_eight_parameters() -> None:
    """Options that are given to a public function by name are not counted, nor those of commands."""
    many = {}
    for path in SOURCES:
        for node in ast.walk(parsed(path)):
            if isinstance(node, ast.FunctionDef) and path.name != "cli.py":
                by_name = node.args.kwonlyargs if node.name.startswith("_") else []
                given = [*node.args.posonlyargs, *node.args.args, *by_name]
                if sum(one.arg not in {"self", "cls"} for one in given) > 8:
                    many[f"{path.name}: {node.name}"] = len(given)
    assert not many
