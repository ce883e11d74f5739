"""Draw one object on one pair of axes, for `.plot()` and notebooks."""

from __future__ import annotations

import base64
import html as escape
import io
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ullage.data import Detections, Frames, Trajectory
from ullage.errors import InputError, MissingExtra, need
from ullage.grids import Image, OccupancyMap
from ullage.view.figures import (
    TRUTH_COLOR,
    UNIT_LABEL,
    draw_image,
    draw_map,
    draw_plan,
    draw_profile,
    draw_range_time,
    level_limits,
    new_figure,
)
from ullage.world.scene import Scene
from ullage.world.section import section

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DPI = 100
"""Dots per inch of a notebook's picture."""
MOST_ROWS = 2000
"""Rows of a range-time picture; more frames than that are pooled."""


def plot_frames(frames: Frames, ax: Any = None, *, frame: int | None = None) -> Axes:
    """Draw amplitude over time and range, or one profile.

    Args:
        frames: of one radar.
        ax: matplotlib Axes; None: a new figure.
        frame: index of the only frame to draw; None: all.

    Raises:
        InputError: there is no such frame.
        MissingExtra: matplotlib is not installed.
    """
    if frame is not None and not -len(frames) <= frame < len(frames):
        raise InputError(f"frame is {frame}", where="plot", allowed=f"0 to {len(frames) - 1}")
    axes = _axes(ax)
    if frame is not None or len(frames) == 1:
        draw_profile(axes, frames, frame or 0)
        axes.set(ylabel=UNIT_LABEL[frames.unit], title=f"{frames.sensor}, frame {frame or 0}")
        axes.grid(alpha=0.3)
        return axes
    rows = np.arange(0, len(frames), -(-len(frames) // MOST_ROWS))
    amplitude, t_s = np.maximum.reduceat(frames.amplitude, rows, axis=0), np.asarray(frames.t_ns[rows] * 1e-9)
    low, top = level_limits([amplitude], frames.unit)
    mesh = draw_range_time(axes, t_s, frames.range_m, amplitude, unit=frames.unit, limits=(low, top))
    axes.set(ylabel="range [m]", title=f"{frames.sensor}, {len(frames)} frames")
    _bar(axes, mesh, UNIT_LABEL[frames.unit])
    return axes


def plot_image(
    image: Image, ax: Any = None, *, scene: Scene | None = None, path: Trajectory | None = None, span_db: float = 40.0
) -> Axes:
    """Draw amplitude in dB below the brightest cell; of a volume, the highest over z.

    Args:
        image: the image.
        ax: matplotlib Axes; None: a new figure.
        scene: the true world, whose outline is drawn in red.
        path: where the radar went.
        span_db: range of the colours [dB].

    Raises:
        InputError: the span is not above zero.
        MissingExtra: matplotlib is not installed.
    """
    if not (np.isfinite(span_db) and span_db > 0):
        raise InputError(f"span_db is {span_db}", where="plot", allowed="> 0")
    axes = _axes(ax)
    mesh = draw_image(axes, image, walls=_walls(scene, image.grid.z_m, path), path=path, span_db=span_db)
    over = ", highest over z" if image.grid.dims == 3 else ""
    axes.set_title(f"SAR image, {image.method or 'no method'}, {image.grid.step_m:g} m cells{over}")
    _bar(axes, mesh, "amplitude below the brightest cell [dB]")
    _legend(axes)
    return axes


def plot_map(
    omap: OccupancyMap, ax: Any = None, *, scene: Scene | None = None, path: Trajectory | None = None,
    level: int | None = None,
) -> Axes:  # fmt: skip
    """Draw an occupancy map: white free, black occupied, grey unknown, amber ambiguous.

    Args:
        omap: the map.
        ax: matplotlib Axes; None: a new figure.
        scene: the true world, whose outline is drawn in red.
        path: where the drone flew.
        level: index along z of a volume's only level to draw; None: the highest probability over z.

    Raises:
        InputError: there is no such level.
        MissingExtra: matplotlib is not installed.
    """
    count = len(omap.grid.z_m)
    if level is not None and not -count <= level < count:
        raise InputError(f"level is {level}", where="plot", allowed=f"0 to {count - 1}")
    axes = _axes(ax)
    heights = omap.grid.z_m if level is None else omap.grid.z_m[[level]]
    mesh = draw_map(axes, omap, walls=_walls(scene, heights, path), path=path, level=level)
    at = "" if omap.grid.dims == 2 else ", highest over z" if level is None else f", z = {heights[0]:.2f} m"
    axes.set_title(f"occupancy, {omap.method or 'no method'}, {omap.grid.step_m:g} m cells{at}")
    _bar(axes, mesh, "probability of being occupied [%]")
    _legend(axes)
    return axes


def plot_scene(scene: Scene, ax: Any = None, *, height_m: float | None = None, path: Trajectory | None = None) -> Axes:
    """Draw a plan: everything below a horizontal cut, and the cut itself in black.

    Args:
        scene: the world.
        ax: matplotlib Axes; None: a new figure.
        height_m: of the cut [m]; None: that of the path, or a third of the scene's height.
        path: where the drone flew.

    Raises:
        InputError: the height is not finite.
        MissingExtra: matplotlib is not installed.
    """
    from ullage.view.world_picture import draw_cut

    if height_m is not None and not np.isfinite(height_m):
        raise InputError(f"height_m is {height_m}", where="plot", allowed="a finite number")
    axes = _axes(ax)
    if not len(scene.objects):
        axes.text(0.5, 0.5, "an empty scene", ha="center", va="center", transform=axes.transAxes)
        axes.set(xlabel="x, east [m]", ylabel="y, north [m]", aspect="equal", title=scene.name)
        return axes
    level = float(np.median(path.position[:, 2])) if path is not None and height_m is None else height_m
    draw_cut(axes, scene, level, None if path is None else path.position)
    axes.set_title(f"{scene.name}, {axes.get_title()}")
    return axes


def plot_detections(hits: Detections, ax: Any = None) -> Axes:
    """Draw range over time, coloured by signal-to-noise ratio; over another drawing, as open circles.

    Args:
        hits: the detections of one radar.
        ax: matplotlib Axes, as those of `Frames.plot`; None: a new figure.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    axes = _axes(ax)
    t_s = hits.t_ns * 1e-9
    if axes.has_data():
        axes.scatter(t_s, hits.range_m, s=16, facecolors="none", edgecolors=TRUTH_COLOR, label="detections")
        return axes
    known = np.isfinite(hits.snr_db)
    axes.scatter(t_s[~known], hits.range_m[~known], s=9, color="0.6")
    mesh = axes.scatter(t_s[known], hits.range_m[known], s=9, c=hits.snr_db[known], cmap="viridis")
    if known.any():
        _bar(axes, mesh, "signal-to-noise ratio [dB]")
    axes.set(xlabel="time [s]", ylabel="range [m]", title=f"{hits.sensor}, {len(hits)} detections")
    axes.grid(alpha=0.3)
    return axes


def plot_trajectory(path: Trajectory, ax: Any = None) -> Axes:
    """Draw a flight in plan, a dot at its start.

    Args:
        path: the flight.
        ax: matplotlib Axes; None: a new figure.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    axes = _axes(ax)
    over = axes.has_data()
    draw_plan(axes, path=path)
    if not over:
        z = path.position[:, 2]
        axes.set_title(f"flight of {path.duration_s:.1f} s, z from {z.min():.2f} to {z.max():.2f} m")
        axes.margins(0.1)
        axes.set_adjustable("datalim")
        axes.grid(alpha=0.3)
    return axes


_PLOTS: dict[type, Callable[..., Any]] = {
    Frames: plot_frames,
    Image: plot_image,
    OccupancyMap: plot_map,
    Scene: plot_scene,
    Detections: plot_detections,
    Trajectory: plot_trajectory,
}


def html(thing: Any) -> str:
    """Return the picture and the short text of an object for a notebook; only the text without matplotlib."""
    text = f"<pre>{escape.escape(repr(thing))}</pre>"
    try:
        need("matplotlib")
    except MissingExtra:
        return text
    figure = new_figure((7.0, 4.5), layout="compressed")
    _PLOTS[type(thing)](thing, figure.subplots())
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=DPI)
    picture = base64.b64encode(out.getvalue()).decode()
    return f'<img src="data:image/png;base64,{picture}" alt="{escape.escape(repr(thing))}">{text}'


def _axes(ax: Any) -> Axes:
    """Return the given axes, or those of a new figure."""
    if ax is not None:
        return ax  # type: ignore[no-any-return]
    axes: Axes = need("matplotlib.pyplot").subplots(figsize=(7.0, 4.5), layout="compressed")[1]
    return axes


def _bar(axes: Axes, mesh: Any, label: str) -> None:
    axes.figure.colorbar(mesh, ax=axes, label=label, shrink=0.9)


def _legend(axes: Axes) -> None:
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, frameon=False)


def _walls(scene: Scene | None, z_m: Any, path: Trajectory | None) -> Any:
    """Return the outline (s, 2, 2) of the true world at the height of a plane, a flight or a volume's middle [m]."""
    if scene is None:
        return None
    flown = float(np.median(path.position[:, 2])) if path is not None else float(scene.bounds[:, 2].mean())
    height = float(np.median(z_m))
    return section(scene, height if np.isfinite(height) else flown)
