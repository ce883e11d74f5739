"""Draw maps and images of one flight side by side (figures 6.9, 6.13, 6.14, 6.18)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ullage.arrays import Floats
from ullage.data import Trajectory
from ullage.grids import Image, OccupancyMap
from ullage.view.figures import draw_map, draw_plan, save_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """One map or image with its title."""

    title: str
    shown: OccupancyMap | Image
    flown: Trajectory | None = None
    marks: Floats | None = None  # (m, 2) circled [m]


def draw_panels(
    path: Path,
    rows: Sequence[Sequence[Panel]],
    *,
    walls: Floats,
    title: str,
    width_in: float = 3.4,
    span_db: float = 40.0,
    view: Floats | None = None,
) -> None:
    """Draw maps in white, black, grey and stripes and images in dB, with the true walls on top.

    Args:
        path: picture file.
        rows: panels by row.
        walls: true outline as segments (s, 2, 2) [m].
        title: of the figure.
        width_in: of one panel.
        span_db: range of an image's colours [dB].
        view: low and high corner of the drawn area (2, 2) [m]; None: 0.8 m beyond the walls.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    low, high = (walls.reshape(-1, 2).min(0) - 0.8, walls.reshape(-1, 2).max(0) + 0.8) if view is None else view
    shape = float((high[1] - low[1]) / (high[0] - low[0]))
    columns = max(len(row) for row in rows)
    figure = Figure(
        figsize=(width_in * columns + 1.0, (width_in * shape + 0.45) * len(rows) + 0.6), layout="constrained"
    )
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(rows), columns, squeeze=False)
    bars: dict[str, Any] = {}
    for axes_row, row in zip(grid, rows, strict=True):
        for axes in axes_row[len(row) :]:
            axes.remove()
        for axes, panel in zip(axes_row, row, strict=False):
            kind, mesh = _draw(axes, panel, walls, span_db)
            bars[kind] = mesh
            axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
            axes.set_title(panel.title, fontsize=8.5)
            axes.tick_params(labelsize=7)
            axes.set(xlabel="", ylabel="")
    for axes in grid[-1]:
        axes.set_xlabel("x east [m]", fontsize=8)
    for axes in grid[:, 0]:
        axes.set_ylabel("y north [m]", fontsize=8)
    _finish(figure, grid, bars, title, path)


def _draw(axes: Any, panel: Panel, walls: Floats, span_db: float) -> tuple[str, Any]:
    if isinstance(panel.shown, OccupancyMap):
        mesh = draw_map(axes, panel.shown, walls=walls, path=panel.flown)
        kind = "chance of being occupied [%]; grey unknown, striped ambiguous"
    else:
        top = max(float(np.quantile(panel.shown.amplitude, 0.998)), 1e-30)
        level = 20 * np.log10(np.maximum(panel.shown.amplitude / top, 1e-9))
        extent = panel.shown.grid.extent_m
        mesh = axes.imshow(level, extent=extent, origin="lower", cmap="inferno", vmin=-span_db, vmax=0)
        draw_plan(axes, walls=walls, path=panel.flown)
        kind = "amplitude under the brightest 0.2 % of cells [dB]"
    if panel.marks is not None and len(panel.marks):
        axes.scatter(*panel.marks.T, s=260, facecolors="none", edgecolors="#e07a00", linewidths=1.4)
    return kind, mesh


def _finish(figure: Figure, grid: Any, bars: dict[str, Any], title: str, path: Path) -> None:
    for label, mesh in bars.items():
        bar = figure.colorbar(mesh, ax=[axes for axes in grid.flat if axes.figure is not None], shrink=0.7, pad=0.01)
        bar.set_label(label, fontsize=8)
    figure.suptitle(title, fontsize=11)
    save_figure(figure, path)
