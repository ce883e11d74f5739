"""Write each tutorial as a Jupyter notebook: python tools/make_notebooks.py."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
TUTORIALS = ROOT / "docs" / "tutorials"
NOTEBOOKS = ROOT / "notebooks"
ABOUT = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}


def cell(kind: str, text: str, name: str) -> dict[str, Any]:
    """A cell as nbformat 4.5 has it."""
    made: dict[str, Any] = {
        "cell_type": kind, "id": name, "metadata": {}, "source": text.strip("\n").splitlines(keepends=True)
    }  # fmt: skip
    return made | ({"execution_count": None, "outputs": []} if kind == "code" else {})


def notebook_of(page: Path) -> str:
    """A page's text and Python blocks as cells, in order; links lead to the documentation's files."""
    text = re.sub(r"\]\(\.\./", "](../docs/", page.read_text(encoding="utf-8"))
    text = re.sub(r"\]\((\w+)\.md\)", r"](\1.ipynb)", text)
    cells = []
    for i, part in enumerate(re.split(r"^```python\n(.*?)^```\n", text, flags=re.S | re.M)):
        if part.strip():
            cells.append(cell("code" if i % 2 else "markdown", part, f"{page.stem.replace('_', '-')}-{i}"))
    book = {"cells": cells, "metadata": ABOUT, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(book, indent=1, ensure_ascii=False) + "\n"


def main() -> None:
    """Write all of them."""
    NOTEBOOKS.mkdir(exist_ok=True)
    for page in sorted(TUTORIALS.glob("*.md")):
        file = NOTEBOOKS / f"{page.stem}.ipynb"
        file.write_text(notebook_of(page), encoding="utf-8")
        print(file)


if __name__ == "__main__":
    main()
