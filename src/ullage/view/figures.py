"""Draw figures for a report: axes with units, a colour bar, and true walls over the results."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ullage.arrays import Floats
from ullage.data import Frames, Trajectory
from ullage.files import write_whole, writing
from ullage.grids import UNKNOWN, Image, OccupancyMap
from ullage.view.map_picture import map_picture, plane_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.text import Text

__all__ = [
    "draw_image",
    "draw_map",
    "draw_plan",
    "draw_profile",
    "draw_range_time",
    "drawing",
    "fit_titles",
    "image_figure",
    "level_limits",
    "map_figure",
    "range_time_figure",
    "snapshot_figure",
]

TRUTH_COLOR = "#d1495b"


def new_figure(size_in: tuple[float, float], *, layout: Literal["constrained", "compressed"] = "constrained") -> Figure:
    """Make a figure that is drawn to a file, without a window."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size_in, layout=layout)
    FigureCanvasAgg(figure)
    return figure


@contextmanager
def drawing(
    path: str | Path, *, size_in: tuple[float, float] = (7.0, 5.0), columns: int = 1
) -> Iterator[tuple[Figure, Any]]:
    """Make a figure that is written to `path` at the end, under a temporary name until complete."""
    figure = new_figure(size_in)
    yield figure, figure.subplots(1, columns)
    fit_titles(figure)
    save_figure(figure, Path(path), dpi=130)


def save_figure(figure: Figure, path: Path, *, dpi: int = 110) -> Path:
    """Write a figure in the format of its suffix, and make its folder.

    Raises:
        InputError: the folder cannot be written, or the disk is full.
    """
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, lambda out: figure.savefig(out, dpi=dpi, format=path.suffix[1:]))
    return path


def fit_titles(figure: Figure) -> None:
    """Break titles that are wider than the figure, or than a panel's share of it, into lines that fit."""
    whole = figure.get_figwidth() * figure.dpi
    for axes in figure.axes:
        place = axes.get_subplotspec()
        columns = 1 if place is None else place.get_gridspec().ncols
        _break_lines(axes.title, 0.85 * whole / columns)
    for text in figure.texts:
        if text.get_text() == figure.get_suptitle():
            _break_lines(text, 0.95 * whole)


def _break_lines(text: Text, width_px: float) -> None:
    """Break a text at its words so that no line is wider [px]."""
    lines = text.get_text().split("\n")
    wide = text.get_window_extent().width
    if wide > width_px:
        most = max(int(max(map(len, lines)) * width_px / wide), 8)
        text.set_text("\n".join(textwrap.fill(line, most) for line in lines))


def draw_map(
    axes: Axes,
    omap: OccupancyMap,
    *,
    walls: Floats | None = None,
    path: Trajectory | None = None,
    marks: Floats | None = None,
    level: int | None = None,
) -> Any:
    """Draw an occupancy map: white free, black occupied, grey unknown, striped ambiguous; true walls and path over it.

    Args:
        axes: where to draw.
        omap: the map; of a volume one level is drawn, or the highest chance over all levels.
        walls: true outline as segments (s, 2, 2) [m].
        path: where the drone flew.
        marks: (m, 2 or 3) surveyed places [m].
        level: index along z, of a volume.
    """
    from matplotlib.cm import ScalarMappable

    axes.set_facecolor("#c9ccd1")
    picture = map_picture(omap, level=level)
    axes.imshow(picture, extent=omap.grid.extent_m, origin="lower", interpolation="antialiased")
    mesh = ScalarMappable(cmap="gray_r")
    mesh.set_clim(0, 100)
    draw_plan(axes, walls=walls, path=path, marks=marks)
    known = np.argwhere(plane_of(omap, level) != UNKNOWN)
    if len(known):
        low, high = known.min(0), known.max(0)
        x, y, pad = omap.grid.x_m, omap.grid.y_m, 5 * omap.grid.step_m
        left, right, bottom, top = omap.grid.extent_m
        axes.set_xlim(max(x[low[1]] - pad, left), min(x[high[1]] + pad, right))
        axes.set_ylim(max(y[low[0]] - pad, bottom), min(y[high[0]] + pad, top))
    return mesh


def draw_plan(
    axes: Axes, *, walls: Floats | None = None, path: Trajectory | None = None, marks: Floats | None = None
) -> None:
    """Draw true walls (red), marks (m, 2 or 3) (green) and the flown path (blue) on axes in metres of equal scale."""
    from matplotlib.collections import LineCollection

    if walls is not None and len(walls):
        axes.add_collection(LineCollection(list(walls), color=TRUTH_COLOR, linewidth=0.9, label="true walls"))
    if path is not None:
        axes.plot(path.position[:, 0], path.position[:, 1], color="#2e86ab", linewidth=0.9, label="flown")
        axes.plot(*path.position[0, :2], "o", color="#2e86ab", markersize=4)
    if marks is not None and len(marks):
        axes.scatter(
            marks[:, 0], marks[:, 1], s=160, facecolors="none", edgecolors="#4ade80", label="surveyed reflector"
        )
    axes.set(xlabel="x east [m]", ylabel="y north [m]", aspect="equal")


def map_figure(
    path: str | Path,
    omap: OccupancyMap,
    *,
    title: str,
    walls: Floats | None = None,
    flown: Trajectory | None = None,
    marks: Floats | None = None,
) -> Path:
    """Write the occupancy map with colour bar and legend as a picture file."""
    with drawing(path) as (figure, axes):
        mesh = draw_map(axes, omap, walls=walls, path=flown, marks=marks)
        figure.set_size_inches(_size_about(axes))
        figure.colorbar(mesh, ax=axes, label="chance of being occupied [%]", shrink=0.8)
        _legend_below(figure, axes)
        figure.suptitle(title, fontsize=10)
        axes.set_title(f"{omap.method}, {omap.grid.step_m:g} m cells; grey unknown, striped ambiguous", fontsize=8)
    return Path(path)


def _legend_below(figure: Figure, axes: Axes) -> None:
    """Put a legend under the picture where something in it has a name."""
    if axes.get_legend_handles_labels()[1]:
        figure.legend(loc="outside lower center", ncols=2, fontsize=8, frameon=False)


def _size_about(axes: Axes) -> tuple[float, float]:
    """Return the size of a figure that axes of equal scale fill, with a colour bar and a legend [in]."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    width = min(5.4, 7.0 * (right - left) / (top - bottom))
    return max(width + 2.0, 4.5), max(width * (top - bottom) / (right - left) + 1.5, 3.2)


def draw_image(
    axes: Axes,
    image: Image,
    *,
    walls: Floats | None = None,
    path: Trajectory | None = None,
    marks: Floats | None = None,
    span_db: float = 40,
) -> Any:
    """Draw a SAR image in dB below its brightest cell; a volume is shown as its brightest value over height.

    Args:
        axes: where to draw.
        image: the image.
        walls: true outline as segments (s, 2, 2) [m].
        path: where the radar went.
        marks: (m, 2 or 3) surveyed places [m].
        span_db: range of the colours [dB].
    """
    amplitude = image.amplitude
    flat = amplitude.max(axis=0) if amplitude.ndim == 3 else amplitude
    level = 20 * np.log10(np.maximum(flat / max(float(flat.max()), 1e-30), 1e-10))
    left, right, bottom, top = extent = image.grid.extent_m
    mesh = axes.imshow(level, extent=extent, origin="lower", cmap="inferno", vmin=-span_db, vmax=0)
    draw_plan(axes, walls=walls, path=path, marks=marks)
    axes.set(xlim=(left, right), ylim=(bottom, top))
    return mesh


def image_figure(
    path: str | Path,
    image: Image,
    *,
    title: str,
    walls: Floats | None = None,
    flown: Trajectory | None = None,
    marks: Floats | None = None,
    notes: Sequence[str] = (),
    span_db: float = 40,
) -> Path:
    """Write a SAR image in dB below its peak as a picture file; a volume is shown as its brightest value over height.

    `notes` stand beneath the title, as which plane was imaged.
    """
    ny, nx = image.grid.shape[-2:]
    with drawing(path, size_in=(7.5, min(max(7.0 * ny / nx, 3.2), 9.0))) as (figure, axes):
        mesh = draw_image(axes, image, walls=walls, path=flown, marks=marks, span_db=span_db)
        figure.colorbar(mesh, ax=axes, label="amplitude below the brightest cell [dB]", shrink=0.8)
        _legend_below(figure, axes)
        figure.suptitle(title, fontsize=10)
        about = [f"{image.method}, {image.grid.step_m:g} m cells", *notes[:1]]
        axes.set_title("\n".join([", ".join(about), *notes[1:]]), fontsize=8)
    return Path(path)


UNIT_LABEL = {
    "path_gain": "path gain [dB]",
    "normalised": "amplitude, sensor's own units [dB]",
    "thesis": "amplitude, eq. 4.2",
}
LINEAR_UNITS = ("thesis",)
"""Units drawn on a linear scale; all others are drawn in decibels."""


def decibels(amplitude: ArrayLike) -> Floats:
    """Return amplitudes in dB, no less than -240."""
    return np.asarray(20 * np.log10(np.maximum(amplitude, 1e-12)))


def _levels(amplitude: ArrayLike, unit: str) -> Floats:
    """Return amplitudes for drawing: in dB, or unchanged."""
    value = np.asarray(amplitude, float)
    return value if unit in LINEAR_UNITS else decibels(value)


def level_limits(amplitudes: Sequence[ArrayLike], unit: str) -> tuple[float, float]:
    """Return the lowest and highest level of the colours of range-time pictures, at most 70 dB apart."""
    values = [_levels(one, unit) for one in amplitudes]
    top = max(float(np.quantile(v, 0.999)) for v in values)
    low = 0.0 if unit in LINEAR_UNITS else max(min(float(np.quantile(v, 0.05)) for v in values), top - 70)
    return low, top


def draw_range_time(
    axes: Axes, t_s: Floats, range_m: Floats, amplitude: ArrayLike, *, unit: str, limits: tuple[float, float]
) -> Any:
    """Draw amplitudes (n, b) in colour over times (n) [s] and ranges (b) [m]; limits from `level_limits`."""
    extent = (t_s[0], max(t_s[-1], t_s[0] + 1e-3), range_m[0], range_m[-1])
    low, top = limits
    value = _levels(amplitude, unit).T
    mesh = axes.imshow(value, extent=extent, origin="lower", aspect="auto", vmin=low, vmax=top)
    axes.set_xlabel("time [s]")
    return mesh


def draw_profile(axes: Axes, frames: Frames, index: int) -> None:
    """Draw one frame's amplitude over range."""
    axes.plot(frames.range_m, _levels(frames.amplitude[index], frames.unit), linewidth=1.0, label=frames.sensor)
    axes.set_xlabel("range [m]")


def range_time_figure(
    path: Path, pictures: Sequence[tuple[str, Floats, Floats, Floats]], *, unit: str, title: str
) -> Path:
    """Draw range-time amplitude pictures, one panel for each sensor.

    Args:
        path: where to write.
        pictures: name, times (n) [s], ranges (b) [m], amplitudes (n, b), one for each sensor.
        unit: of the amplitudes, as `Frames.unit`.
        title: above all.
    """
    with drawing(path, size_in=(3.1 * max(len(pictures), 2) + 0.9, 4.2), columns=len(pictures)) as (figure, axes):
        panels = np.atleast_1d(axes)
        limits = level_limits([amplitude for *_, amplitude in pictures], unit)
        for panel, (name, t_s, range_m, amplitude) in zip(panels, pictures, strict=True):
            mesh = draw_range_time(panel, t_s, range_m, amplitude, unit=unit, limits=limits)
            panel.set_title(name)
        panels[0].set_ylabel("range [m]")
        figure.colorbar(mesh, ax=list(panels), label=UNIT_LABEL[unit])
        figure.suptitle(title, fontsize=10)
    return path


def snapshot_figure(path: Path, frames: Sequence[Frames], index: int, *, threshold: float | None, title: str) -> Path:
    """Draw one profile of each sensor: amplitude over range, with the detection threshold."""
    with drawing(path, size_in=(7.5, 3.6)) as (_, axes):
        for part in frames:
            draw_profile(axes, part, min(index, len(part) - 1))
        if threshold is not None:
            level = float(_levels(threshold, frames[0].unit))
            axes.axhline(level, color="0.4", linestyle="--", linewidth=0.8, label=f"threshold {threshold:g}")
        axes.set(ylabel=UNIT_LABEL[frames[0].unit], title=title)
        axes.legend(fontsize=7)
        axes.grid(alpha=0.3)
    return path


def __dir__() -> list[str]:
    return __all__
