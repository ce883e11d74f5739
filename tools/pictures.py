"""Draw the pictures of the documentation that need no recordings: python tools/pictures.py [NAMES].

`docs/pictures/drawn.json` holds a digest of the code that drew each: its script or the cells of its tutorial, and the
modules of `ullage.view` and of the studies that this imports. `stale` lists the pictures whose code has changed since.
A tutorial's picture and the stored outputs of its notebook are made together.
"""

from __future__ import annotations

import ast
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import notebooks

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs" / "pictures"
DRAWN = PICTURES / "drawn.json"
PLOTS = "ullage.view.plots"
BEHIND = ("ullage.view.", "studies.")
"""Where the modules lie that drawings import and digests follow."""


@dataclass(frozen=True, slots=True)
class Drawing:
    """Some pictures, and the code that draws them."""

    pictures: tuple[str, ...]  # below docs/pictures
    script: Path  # run bare, it leaves the pictures in the folder where it runs, or writes them to their place
    modules: tuple[str, ...] = ()  # of `BEHIND` that the script runs and does not import
    commands: tuple[tuple[str, ...], ...] = ()  # words behind `python -m`, in place of the script
    left: str = ""  # where these leave the picture; empty: under its own name


def drawings() -> list[Drawing]:
    """Every drawing of the documentation that needs no recordings."""
    made = [Drawing((f"made/{one.stem}.png",), one) for one in sorted((ROOT / "examples" / "gallery").glob("*.py"))]
    books = sorted((ROOT / "docs/tutorials").glob("*.ipynb"))
    tutorials = [Drawing((f"tutorials/{book.stem}.png",), book) for book in books]
    tools = [
        Drawing(tuple(f"{folder}/{one.name}" for one in (PICTURES / folder).glob("*.png")), ROOT / "tools" / tool)
        for folder, tool in (("concepts", "concepts.py"), ("gallery", "gallery.py"), ("worlds", "world_pictures.py"))
    ]
    page, figures = ROOT / "docs" / "gallery.md", "runs/latest/figures/{}.png"
    runs = [
        Drawing(("cargo_hold.webp",), page, ("ullage.view.moving_picture",),
                (("ullage", "run", "cargo-hold", "--law", "physical", "--force"),
                 ("ullage.view.moving_picture", "runs/latest", "cargo_hold.webp"))),
        Drawing(("ballast_tank.webp",), page, ("ullage.view.moving_picture",),
                (("ullage", "explore", "ballast-tank", "--time", "180", "--seed", "1"),
                 ("ullage.view.moving_picture", "runs/latest", "ballast_tank.webp"))),
        Drawing(("explain.png",), page, ("ullage.view.report_figures",),
                (("ullage", "run", "ntnu-plate", "--law", "physical", "--force"),), figures.format("explain")),
        Drawing(("silo_map.png",), page, ("ullage.view.figures",),
                (("ullage", "run", "silo", "--force"),), figures.format("map")),
    ]  # fmt: skip
    return [*made, *tutorials, *tools, *runs]


def digest(drawing: Drawing) -> str:
    """Return the digest of a drawing's own code and of the modules of `BEHIND` that it imports."""
    text = "" if drawing.commands else drawing.script.read_text(encoding="utf-8")
    if drawing.script.suffix == ".ipynb":
        text = "\n".join(code for _, code in notebooks.blocks(drawing.script))
    start = [*drawing.modules, *_imported(text), *([PLOTS] if ".plot(" in text or "figures." in text else [])]
    code = hashlib.sha256(repr(drawing.commands).encode() + text.encode())
    for module in sorted(_with_imports(start)):
        code.update(_file(module).read_bytes())
    return code.hexdigest()[:16]


def _imported(text: str) -> Iterator[str]:
    """Give the modules of `BEHIND` that a source imports, anywhere in it."""
    for node in ast.walk(ast.parse(text)):
        names = [one.name for one in node.names] if isinstance(node, ast.Import | ast.ImportFrom) else []
        if isinstance(node, ast.ImportFrom):
            names = [node.module or "", *(f"{node.module}.{name}" for name in names)]
        yield from (name for name in names if name.startswith(BEHIND) and _file(name).is_file())


def _file(module: str) -> Path:
    return ROOT / ("src" if module.startswith("ullage") else "") / Path(*module.split(".")).with_suffix(".py")


def _with_imports(modules: Iterable[str]) -> set[str]:
    """Return modules of `BEHIND` with those that they import."""
    found: set[str] = set()
    left = list(modules)
    while left:
        if (module := left.pop()) not in found:
            found.add(module)
            left += _imported(_file(module).read_text(encoding="utf-8"))
    return found


def stale() -> list[str]:
    """Return the pictures that other code than today's drew."""
    known = json.loads(DRAWN.read_text(encoding="utf-8"))
    return [name for one in drawings() for name in one.pictures if known.get(name) != digest(one)]


def draw(drawing: Drawing) -> None:
    """Run the code of a drawing in an empty folder and take over the pictures that it leaves."""
    search = {"PYTHONPATH": f"{ROOT / 'src'}{os.pathsep}{ROOT / 'tools'}{os.pathsep}{ROOT}", "MPLBACKEND": "agg"}
    script = ("notebooks.py", drawing.script.stem) if drawing.script.suffix == ".ipynb" else (drawing.script.name,)
    bare = drawing.script.parent if drawing.script.suffix == ".py" else ROOT / "tools"
    words = [["-m", *one] for one in drawing.commands] or [[str(bare / script[0]), *script[1:]]]
    with tempfile.TemporaryDirectory() as place:
        tool = not drawing.commands and bare == ROOT / "tools"  # these write to their place by themselves
        for one in words:
            subprocess.run([sys.executable, *one], check=True, cwd=ROOT if tool else place, env=os.environ | search)
        for name in () if tool else drawing.pictures:
            shutil.copy(Path(place, drawing.left or Path(name).name), PICTURES / name)


def main(names: Sequence[str]) -> None:
    """Draw the pictures with these names, or all that are stale, and note what drew them."""
    wanted = set(names or stale())
    known = json.loads(DRAWN.read_text(encoding="utf-8")) if DRAWN.exists() else {}
    for one in drawings():
        if wanted & set(one.pictures):
            draw(one)
            known |= dict.fromkeys(one.pictures, digest(one))
            DRAWN.write_text(json.dumps(dict(sorted(known.items())), indent=1) + "\n", encoding="utf-8")
            print(*one.pictures, sep="\n", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
