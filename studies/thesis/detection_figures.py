"""Draw the thesis' object detection (6.3 to 6.8): snapshot, sum of amplitudes, range over time, SAR images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ullage.arrays import Floats
from ullage.data import Frames
from ullage.grids import Image
from ullage.view.figures import TRUTH_COLOR, save_figure
from ullage.world.scene import Scene
from ullage.world.section import section, wire_section

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BLUE = "#22577a"
LEAST_M, MOST_M = 0.45, 9.0
"""Ranges drawn [m]; the direct path lies nearer."""


@dataclass(frozen=True, slots=True, eq=False)
class Pass:
    """One strafe past the target."""

    label: str  # beside its row
    frames: Frames
    snapshot: int  # the frame nearest to the target
    target_m: Floats  # (n) true distance to the target [m]


def draw_target(path: Path, passes: Sequence[Pass], *, title: str) -> None:
    """Draw a row for each strafe: one profile, the sum of all profiles, and range over time.

    Args:
        path: picture file.
        passes: the targets.
        title: of the figure.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.5, 2.35 * len(passes) + 0.6), layout="constrained")
    FigureCanvasAgg(figure)
    rows = figure.subplots(len(passes), 3, squeeze=False, width_ratios=[1, 1, 1.15])
    for axes, one in zip(rows, passes, strict=True):
        _profile(axes[0], one, one.frames.amplitude[one.snapshot].astype(float), one.target_m[one.snapshot])
        _profile(axes[1], one, one.frames.amplitude.astype(float).sum(0), None)
        _over_time(axes[2], one, figure)
        axes[0].set_ylabel(f"{one.label}\n{_unit(one.frames)}", fontsize=8)
    for axes, name in zip(rows[0], ("snapshot in passing", "sum of all amplitudes", "range over time"), strict=True):
        axes.set_title(name, fontsize=9)
    for axes in rows[-1][:2]:
        axes.set_xlabel("range [m]")
    rows[-1][2].set_xlabel("time [s]")
    rows[0][0].legend(fontsize=7, loc="upper left")
    figure.suptitle(title, fontsize=11)
    save_figure(figure, path)


def _unit(frames: Frames) -> str:
    return "amplitude, eq. 4.2" if frames.ray_model else "amplitude, root of path gain"


def _profile(axes: Axes, one: Pass, row: Floats, target_m: float | None) -> None:
    drawn = (one.frames.range_m > LEAST_M) & (one.frames.range_m < MOST_M)
    axes.fill_between(one.frames.range_m[drawn], row[drawn], color=BLUE, alpha=0.25, linewidth=0)
    axes.plot(one.frames.range_m[drawn], row[drawn], color=BLUE, linewidth=1.1)
    if target_m is not None:
        axes.axvline(target_m, color=TRUTH_COLOR, linestyle="--", linewidth=1.0, label="target truly here")
    axes.set(xlim=(0, MOST_M), ylim=(0, None))
    axes.ticklabel_format(axis="y", scilimits=(-2, 3))
    axes.grid(alpha=0.3)


def _over_time(axes: Axes, one: Pass, figure: Any) -> None:
    frames = one.frames
    drawn = (frames.range_m > LEAST_M) & (frames.range_m < MOST_M)
    level = 20 * np.log10(np.maximum(frames.amplitude[:, drawn].T, 1e-12))
    top = float(np.quantile(level, 0.999))
    t_s = frames.t_ns * 1e-9
    extent = (t_s[0], t_s[-1], frames.range_m[drawn][0], frames.range_m[drawn][-1])
    mesh = axes.imshow(level, extent=extent, origin="lower", aspect="auto", cmap="viridis", vmin=top - 40, vmax=top)
    axes.plot(t_s, one.target_m, "--", color=TRUTH_COLOR, linewidth=0.8)
    axes.set_ylabel("range [m]", fontsize=8)
    figure.colorbar(mesh, ax=axes, label="dB", pad=0.01)


def draw_images(
    path: Path, images: Mapping[str, Image], *, target_m: ArrayLike, walls: Scene, title: str, span_db: float = 35.0
) -> None:
    """Draw SAR images side by side, each in dB under its own brightest 0.2 %.

    Args:
        path: picture file.
        images: by title.
        target_m: true place of the target, x and y [m].
        walls: the world, whose outline at the images' height is drawn.
        title: of the figure.
        span_db: range of the colours [dB].
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = min(len(images), 3)
    rows = -(-len(images) // columns)
    figure = Figure(figsize=(4.3 * columns + 0.6, 3.1 * rows + 0.6), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in panels[len(images) :]:
        axes.remove()
    for axes, (name, image) in zip(panels, images.items(), strict=False):
        top = max(float(np.quantile(image.amplitude, 0.998)), 1e-30)
        level = 20 * np.log10(np.maximum(image.amplitude / top, 1e-9))
        mesh = axes.imshow(level, extent=image.grid.extent_m, origin="lower", cmap="inferno", vmin=-span_db, vmax=0)
        outline(axes, walls, float(image.grid.z_m[0]))
        axes.plot(*np.asarray(target_m, float), "o", markersize=12, markerfacecolor="none", markeredgecolor="#7bdff2",
                  label="target truly here")  # fmt: skip
        left, right, bottom, top = image.grid.extent_m
        axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
        axes.set_title(name, fontsize=9)
    for axes in panels[: len(images)]:
        axes.set_xlabel("ahead of the track x [m]", fontsize=8)
    panels[0].set_ylabel("along the track y [m]", fontsize=8)
    panels[0].legend(fontsize=7, loc="upper left", facecolor="0.2", labelcolor="white")
    figure.colorbar(
        mesh, ax=list(panels[: len(images)]), label="amplitude under the brightest 0.2 % of cells [dB]", shrink=0.8
    )
    figure.suptitle(title, fontsize=11)
    save_figure(figure, path)


def outline(axes: Axes, scene: Scene, z_m: float) -> None:
    """Draw the world's section at a height in thin lines; wires as dots."""
    from matplotlib.collections import LineCollection

    axes.add_collection(LineCollection(list(section(scene, z_m)), color="#7bdff2", linewidth=0.7))
    wires = wire_section(scene, z_m)
    axes.plot(wires[:, 0], wires[:, 1], ".", color="#7bdff2", markersize=3)
