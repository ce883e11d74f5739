"""Run the tutorials' Python blocks and keep the picture that each ends with: python tools/run_tutorials.py."""

from __future__ import annotations

import contextlib
import re
import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
TUTORIALS = ROOT / "docs" / "tutorials"
PICTURES = ROOT / "docs" / "pictures" / "tutorials"


def run_page(page: Path, folder: Path, **given: Any) -> dict[str, Any]:
    """Run a page's Python blocks in order, inside `folder` and in one namespace that starts with what is given."""
    import matplotlib

    matplotlib.use("agg")
    names: dict[str, Any] = {**given, "__name__": "__main__"}  # a module that is there: dataclasses ask for theirs
    text = page.read_text(encoding="utf-8")
    with contextlib.chdir(folder):
        for block in re.finditer(r"^```python\n(.*?)^```", text, re.S | re.M):
            line = text[: block.start(1)].count("\n")
            exec(compile("\n" * line + block[1], str(page), "exec"), names)
    return names


def main(names: Sequence[str]) -> None:
    """Run some tutorials, or all, and write their pictures into the documentation."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    for page in sorted(TUTORIALS.glob("*.md")):
        if not names or page.stem in names:
            with tempfile.TemporaryDirectory() as folder:
                run_page(page, Path(folder))
                shutil.copy(Path(folder) / f"{page.stem}.png", PICTURES)
            print(PICTURES / f"{page.stem}.png")


if __name__ == "__main__":
    main(sys.argv[1:])
