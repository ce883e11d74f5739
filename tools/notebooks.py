"""Run the tutorials' notebooks and store what each cell shows: python tools/notebooks.py [NAMES].

A notebook `docs/tutorials/NAME.ipynb` is the only source of its page. Its last cell draws its one picture, also kept as
`docs/pictures/tutorials/NAME.png`.
"""

from __future__ import annotations

import base64
import contextlib
import io
import json
import re
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
TUTORIALS = ROOT / "docs" / "tutorials"
PICTURES = ROOT / "docs" / "pictures" / "tutorials"


def run(page: Path, folder: Path, **given: Any) -> list[list[dict[str, Any]]]:
    """Run the Python of a page or notebook in order, inside `folder`, in one namespace.

    Args:
        page: the page or notebook.
        folder: working directory of the code.
        given: names that the code finds defined.

    Returns:
        The outputs of each block as nbformat 4.5 has them: printed text, then open figures.
    """
    import matplotlib

    matplotlib.use("agg")
    names: dict[str, Any] = {**given, "__name__": "__main__"}  # a module that is there: dataclasses ask for theirs
    outputs = []
    with contextlib.chdir(folder):
        for line, code in blocks(page):
            with contextlib.redirect_stdout(io.StringIO()) as printed:
                exec(compile("\n" * line + code, str(page), "exec"), names)
            text = printed.getvalue().splitlines(keepends=True)
            shown = [{"name": "stdout", "output_type": "stream", "text": text}] if text else []
            outputs.append(shown + [_picture(png) for png in _open_figures()])
    return outputs


def blocks(page: Path) -> list[tuple[int, str]]:
    """Return the Python of a page or notebook in order, each block with the lines before it in its file."""
    text = page.read_text(encoding="utf-8")
    if page.suffix == ".ipynb":
        return [(0, "".join(cell["source"])) for cell in json.loads(text)["cells"] if cell["cell_type"] == "code"]
    found = re.finditer(r"^```python\n(.*?)^```", text, re.S | re.M)
    return [(text[: block.start(1)].count("\n"), block[1]) for block in found]


def page_of(notebook: Path) -> str:
    """Return a notebook as a page of Markdown: its text, its code, and below each cell what that has shown."""
    parts = []
    for cell in json.loads(notebook.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        parts.append(f"```python\n{source}\n```" if cell["cell_type"] == "code" else source)
        for output in cell.get("outputs", ()):
            if output["output_type"] == "stream":
                parts.append(f'```text title="output"\n{"".join(output["text"]).rstrip()}\n```')
            else:
                parts.append(f"![What the cell draws](../pictures/tutorials/{notebook.stem}.png)")
    parts.append(f'<a href="../{notebook.name}" download>Download this page as a notebook.</a>')
    return "\n\n".join(parts) + "\n"


def store(notebook: Path) -> None:
    """Run a notebook and write its outputs into it, and its picture into the documentation."""
    book = json.loads(notebook.read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder:
        outputs = run(notebook, Path(folder))
    cells = [cell for cell in book["cells"] if cell["cell_type"] == "code"]
    for count, (cell, shown) in enumerate(zip(cells, outputs, strict=True), 1):
        cell |= {"execution_count": count, "outputs": shown}
    notebook.write_text(json.dumps(book, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    (picture,) = (one["data"]["image/png"] for shown in outputs for one in shown if "data" in one)
    (PICTURES / f"{notebook.stem}.png").write_bytes(base64.b64decode(picture))


def _picture(png: bytes) -> dict[str, Any]:
    data = {"image/png": base64.b64encode(png).decode() + "\n"}
    return {"data": data, "metadata": {}, "output_type": "display_data"}


def _open_figures() -> list[bytes]:
    """Return the open figures of pyplot, which Jupyter shows below a cell, as PNG files, and close them."""
    from matplotlib import pyplot as plt

    out = []
    for number in plt.get_fignums():
        plt.figure(number).savefig(png := io.BytesIO(), format="png", dpi=100)
        out.append(png.getvalue())
    plt.close("all")
    return out


def main(names: Sequence[str]) -> None:
    """Run some notebooks, or all."""
    for notebook in sorted(TUTORIALS.glob("*.ipynb")):
        if not names or notebook.stem in names:
            store(notebook)
            print(notebook)


if __name__ == "__main__":
    main(sys.argv[1:])
