"""Save figures whole or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ullage.files import write_whole, writing

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def save_figure(figure: Figure, path: Path, *, dpi: int = 110) -> Path:
    """Write a figure in the format of its suffix, and make its folder.

    Raises:
        InputError: the folder cannot be written, or the disk is full.
    """
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, lambda out: figure.savefig(out, dpi=dpi, format=path.suffix[1:]))
    return path
