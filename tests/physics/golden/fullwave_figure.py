"""One figure that sets our echoes beside those of a full-wave solver."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ullage.view.figures import drawing

Curves = Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]]
COLORS = ("#22577a", "#d1495b", "#57a773", "#edae49")


def draw_fullwave(path: Path, panels: Mapping[str, tuple[str, str, Curves]], solver: str = "gprMax") -> None:
    """Draws a panel for each scene: dots of the full-wave solver, lines of ours.

    Args:
        path: .png, .svg or .pdf.
        panels: by title: label across, label up, and by name of the curve: place, full-wave, ours (each (n)).
        solver: name of the full-wave solver.
    """
    with drawing(path, size_in=(4.2 * len(panels), 4.0), columns=1) as (figure, first):
        first.remove()
        for axes, (title, (across, up, curves)) in zip(
            figure.subplots(1, len(panels), squeeze=False)[0], panels.items(), strict=True
        ):
            for color, (name, (x, wave, ours)) in zip(COLORS, curves.items(), strict=False):
                axes.plot(x, ours, "-", color=color, lw=1.4, label=f"{name}: ullage")
                axes.plot(x, wave, "o", color=color, ms=5, mfc="none", label=f"{name}: {solver}")
            axes.set_title(title, fontsize=10)
            axes.set_xlabel(across)
            axes.set_ylabel(up)
            axes.grid(alpha=0.3)
            axes.legend(fontsize=7, frameon=False)
