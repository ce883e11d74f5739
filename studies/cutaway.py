"""Pictures of worlds: a cutaway view from a corner, and a plan in metres with the flight.

Ray casting resolves occlusion exactly. Rays start behind the near walls and the roof, which would hide the inside.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from PIL import Image

from ullage.arrays import Bools, Floats
from ullage.errors import InputError
from ullage.files import write_whole
from ullage.view.figures import new_figure
from ullage.view.world_picture import PATH_COLOR, Eye, Paint, draw_plan
from ullage.world.scene import Scene, Wires


def world_picture(
    scene: Scene,
    path: str | Path | None = None,
    *,
    elevation_deg: float = 35.0,
    azimuth_deg: float = -60.0,
    cut_height_m: float | None = None,
    cut_side_m: float | tuple[float, float] = 0.3,
    plan_height_m: float | None = None,
    waypoints: ArrayLike | None = None,
    title: str = "",
    colors: Sequence[str] | None = None,
    width_px: int = 1150,
) -> Figure:
    """Draw a cutaway view and a plan of a world.

    Args:
        scene: what to draw.
        path: PNG file to write, or None.
        elevation_deg: elevation of the eye above the horizon [deg].
        azimuth_deg: direction of the eye from the middle; 0 is +x, 90 is +y [deg].
        cut_height_m: height above which everything is cut away [m]; None: no cut.
        cut_side_m: depth that is cut away at the sides facing the eye, along x and y [m]; 0: no cut.
        plan_height_m: height of the plan's section [m]; None: a third of the way up.
        waypoints: the flight (n, 3 or more) [m], drawn into both.
        title: text over the picture.
        colors: a colour for each object; None: by material.
        width_px: rays across the cutaway; the plan has two thirds of them.

    Returns:
        The figure.

    Raises:
        InputError: the world is empty.
    """
    low, high = scene.bounds
    if not (high > low).any():
        raise InputError("there is nothing to draw", where=scene.name)
    top = float(high[2]) if cut_height_m is None else cut_height_m
    figure = new_figure((11.0, 4.9))
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1))
    paint = Paint(scene, colors)
    box = np.array([low, [high[0], high[1], top]])
    eye = _looking(box, elevation_deg, azimuth_deg, width_px)
    route = None if waypoints is None else np.asarray(waypoints, float)[:, :3]
    _draw_cutaway(left, paint, eye, _inside(box, eye.toward, cut_side_m), route)
    level = float(low[2] + (high[2] - low[2]) / 3) if plan_height_m is None else plan_height_m
    draw_plan(right, scene, paint, Eye.above(box, width_px * 2 // 3), level, route)
    if title:
        figure.suptitle(title)
    if path is not None:
        save_palette_png(figure, Path(path))
    return figure


def _looking(box: Floats, elevation_deg: float, azimuth_deg: float, width_px: int) -> Eye:
    e, a = np.radians([elevation_deg, azimuth_deg])
    toward = -np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    return Eye(toward, right, np.cross(right, toward), box, width_px)


def _inside(box: Floats, toward: Floats, side_m: float | tuple[float, float]) -> list[tuple[Floats, float]]:
    """Return half-spaces n.x <= d that bound the drawn part: below the cut, and behind the near sides."""
    keep = [(np.array([0.0, 0.0, 1.0]), float(box[1, 2]) + 1e-3)]
    for axis, cut in zip((0, 1), np.broadcast_to(side_m, 2), strict=True):
        if abs(toward[axis]) > 1e-6 and cut > 0:
            sign = -np.sign(toward[axis])
            edge = box[1, axis] if sign > 0 else -box[0, axis]
            keep.append((sign * np.eye(3)[axis], float(edge) - float(cut)))
    return keep


def _draw_cutaway(axes: Any, paint: Paint, eye: Eye, keep: list[tuple[Floats, float]], route: Floats | None) -> None:
    picture, depth = paint.picture(eye, keep)
    axes.imshow(np.clip(picture, 0, 1), extent=eye.extent, interpolation="antialiased")
    if route is not None:
        _draw_route(axes, eye, depth, route)
    _draw_wires(axes, eye, depth, paint.wires, keep)
    span = eye.extent[1] - eye.extent[0]
    decade = 10.0 ** math.floor(math.log10(span / 4))
    bar = max(step * decade for step in (1, 2, 5) if step * decade <= span / 4)
    x, y = eye.extent[0] + 0.03 * span, eye.extent[2] + 0.01 * span
    axes.plot([x, x + bar], [y, y], color="black", lw=3, solid_capstyle="butt")
    axes.text(x + bar / 2, y + 0.008 * span, f"{bar:g} m", ha="center", va="bottom", fontsize=9)
    axes.set_axis_off()


def _draw_route(axes: Any, eye: Eye, depth: Floats, route: Floats) -> None:
    """Draw the flight as a line, faint where a surface hides it."""
    fine = np.concatenate([np.linspace(a, b, 60) for a, b in pairwise(route)])
    spot = eye.project(fine)
    axes.plot(*spot.T, color=PATH_COLOR, lw=1.0, alpha=0.35)
    axes.plot(*np.where(_hidden(eye, depth, fine)[:, None], np.nan, spot).T, color=PATH_COLOR, lw=1.6)
    axes.plot(*spot[0], "o", color=PATH_COLOR, ms=5)


def _draw_wires(axes: Any, eye: Eye, depth: Floats, wires: Wires, keep: list[tuple[Floats, float]]) -> None:
    """Draw wires as thin lines: a pixel is wider than most of them."""
    for start, end in zip(wires.start, wires.end, strict=True):
        fine = np.linspace(start, end, 200)
        gone = _hidden(eye, depth, fine)
        for normal, edge in keep:
            gone |= fine @ normal > edge
        axes.plot(*np.where(gone[:, None], np.nan, eye.project(fine)).T, color="#222222", lw=0.8)


def _hidden(eye: Eye, depth: Floats, points: Floats) -> Bools:
    """Return whether a surface hides each point (n, 3) from the eye."""
    spot = eye.project(points)
    column = np.clip(((spot[:, 0] - eye.extent[0]) / eye.pixel).astype(int), 0, eye.shape[1] - 1)
    row = np.clip(((eye.extent[3] - spot[:, 1]) / eye.pixel).astype(int), 0, eye.shape[0] - 1)
    return np.asarray(points @ eye.toward - eye.back > depth[row, column] + 0.05)


def save_palette_png(figure: Figure, file: Path) -> None:
    """Write a PNG with 256 colours, at a third of the size, under a temporary name until complete."""
    file.parent.mkdir(parents=True, exist_ok=True)
    whole = io.BytesIO()
    figure.savefig(whole, dpi=100, format="png")
    small = Image.open(whole).convert("RGB").quantize(256, dither=Image.Dither.NONE)
    write_whole(file, lambda out: small.save(out, format="PNG", optimize=True))
