"""Draws the docs' gallery: the thesis' own illustrations, made by this package: python tools/gallery.py."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ullage.data import Frames, Trajectory
from ullage.grids import Grid
from ullage.specs import RadarSpec
from ullage.view.figures import TRUTH_COLOR, draw_map, drawing

FOLDER = Path("docs/pictures/gallery")
BLUE = "#2e86ab"
LOBE_DEG = 65.0


def draw_gallery(folder: Path = FOLDER) -> list[Path]:
    """Every figure of the gallery, as picture files in `folder`."""
    return [draw(folder / f"{name}.png") for name, draw in FIGURES.items()]


def _quiet(**changes: Any) -> RadarSpec:
    return RadarSpec.preset("x4m05", noise=None, thesis={"noise_sigma": 0.0} | changes)


def draw_hyperbola(path: Path) -> Path:
    """A point target seen from a straight track: the thesis' summation beside back-projection (thesis fig. 2.4)."""
    from ullage.processing.sar import focus
    from ullage.radar.simulate import simulate
    from ullage.world.scenes import sphere

    track = Trajectory.line((0, -1.5, 0), (0, 1.5, 0), speed_m_s=0.15)
    frames = simulate(sphere(radius_m=0.005, distance_m=2.5), track, _quiet())
    grid = Grid.covering([(1.6, -1.5, 0), (3.4, 1.5, 0)], step_m=0.01)
    images = [focus(frames, grid, method="summation"), focus(frames, grid, method="backprojection")]
    with drawing(path, size_in=(8.0, 4.6), columns=2) as (figure, axes):
        for panel, image in zip(axes, images, strict=True):
            level = 20 * np.log10(np.maximum(image.amplitude / image.amplitude.max(), 1e-4))
            mesh = panel.imshow(level, extent=grid.extent_m, origin="lower", cmap="inferno", vmin=-40, vmax=0)
            panel.plot(
                2.5, 0.0, "o", markersize=11, markerfacecolor="none", markeredgecolor="#7bdff2", label="where it stands"
            )
            panel.set(xlabel="ahead of the track x [m]", title=image.method, aspect="equal")
        axes[0].set_ylabel("along the track y [m]")
        axes[0].legend(fontsize=9, loc="upper left", facecolor="0.2", labelcolor="white")
        figure.colorbar(mesh, ax=list(axes), label="amplitude below the brightest cell [dB]")
    return path


def draw_smoothing(path: Path) -> Path:
    """A profile of the ray model with and without the moving average (thesis fig. 4.7)."""
    from ullage.radar.simulate import simulate
    from ullage.world.scenes import room

    scene = room(size_m=(8, 6, 3), plate={"width_m": 1.0, "height_m": 1.0, "distance_m": 2.0})
    with drawing(path, size_in=(7.5, 3.4)) as (_, axes):
        for width, style in ((1, {"color": "0.6", "linewidth": 0.9}), (5, {"color": BLUE, "linewidth": 1.6})):
            spec = _quiet(smoothing_bins=width)
            frames = simulate(scene, Trajectory.stationary(), spec, fidelity="thesis")
            label = "rays in bins" if width == 1 else f"moving average over {width} bins"
            axes.plot(frames.range_m, frames.amplitude[0], label=label, **style)
        axes.axhline(0.038, color=TRUTH_COLOR, linestyle="--", linewidth=0.9, label="threshold 0.038")
        axes.set(xlabel="range [m]", ylabel="amplitude, eq. 4.2", xlim=(1, 6), ylim=(0, None))
        axes.legend(fontsize=8)
        axes.grid(alpha=0.3)
    return path


def draw_ray_spacing(path: Path) -> Path:
    """Distance between rays against their number (thesis eq. 4.3 to 4.5, fig. 4.4)."""
    from ullage.fan import ray_spacing_m, rays_for

    counts = np.arange(10, 101)
    with drawing(path, size_in=(7.0, 3.8)) as (_, axes):
        for range_m, color in ((5.0, "0.55"), (10.0, BLUE)):
            spacing = [ray_spacing_m(LOBE_DEG, int(n), range_m) for n in counts]
            axes.plot(counts, spacing, color=color, label=f"at {range_m:g} m")
        wanted = rays_for(LOBE_DEG, 0.2, 10.0)
        for n, range_m, spot in ((wanted, 10.0, (62, 0.33)), (30, 5.0, (14, 0.08)), (30, 10.0, (36, 0.52))):
            spacing_m = ray_spacing_m(LOBE_DEG, 30, range_m) if n == 30 else 0.2
            axes.plot(n, spacing_m, "o", color=TRUTH_COLOR)
            text = f"{n:.2f} rays: {spacing_m:.1f} m" if n != 30 else f"30 rays: {spacing_m:.2f} m"
            axes.annotate(text, (n, spacing_m), spot, arrowprops={"arrowstyle": "-", "color": "0.5"}, fontsize=8)
        axes.set(xlabel="rays across 65 deg, n", ylabel="spacing of rays x_n [m]", ylim=(0, 1.0), xlim=(10, 100))
        axes.legend(fontsize=8)
        axes.grid(alpha=0.3)
    return path


def _reading(position_m: tuple[float, float], yaw_deg: float, range_m: float) -> Frames:
    """One frame whose only peak is an echo at this range: enough for a mapper that reads first peaks."""
    spec = _quiet()
    path = Trajectory.stationary((*position_m, 0.0), yaw_deg)
    profile = np.exp(-0.5 * ((spec.range_m - range_m) / 0.05) ** 2)[None]
    return Frames(profile.astype(np.float32), spec.range_m, path.t_ns, spec, path, None, "radar", "thesis")


def draw_overlap(path: Path) -> Path:
    """One, ten and a hundred readings of one object in passing: Elfes' grid (thesis fig. 5.1)."""
    from ullage.processing.elfes import ElfesMapper

    target = np.array([2.0, 1.6])
    grid = Grid.covering([(-0.6, -0.4, 0), (4.6, 3.2, 0)], step_m=0.1)
    with drawing(path, size_in=(11.0, 3.0), columns=3) as (figure, axes):
        for panel, count in zip(axes, (1, 10, 100), strict=True):
            mapper = ElfesMapper(grid, threshold=0.5)
            for x in np.linspace(0.4, 3.6, count) if count > 1 else [0.4]:
                away = target - (x, 0.0)
                turn_deg = 0.6 * float(np.degrees(np.arctan2(away[0], away[1])))  # so that it is seen off the axis
                mapper.update(_reading((float(x), 0.0), 90 - turn_deg, float(np.hypot(*away))))
                panel.plot(x, 0.0, "o", color=BLUE, markersize=4, zorder=3)
            mesh = draw_map(panel, mapper.map())
            panel.plot(*target, "o", markersize=11, markerfacecolor="none", markeredgecolor=TRUTH_COLOR, label="object")
            panel.set(xlim=grid.extent_m[:2], ylim=grid.extent_m[2:])
            panel.set_title(f"{count} reading{'s' * (count > 1)}", fontsize=9)
        axes[0].legend(fontsize=7, loc="upper right")
        figure.colorbar(mesh, ax=list(axes), label="chance of being occupied [%]")
    return path


def draw_square(path: Path) -> Path:
    """The square that is traversed in place of the whole grid (thesis fig. 5.2)."""
    from matplotlib.patches import Rectangle, Wedge

    from ullage.processing.elfes import ElfesMapper

    yaw_deg, reach = 25.0, 2.6
    grid = Grid.covering([(0, 0, 0), (6, 4, 0)], step_m=0.1)
    mapper = ElfesMapper(grid, threshold=0.5)
    mapper.update(_reading((1.0, 1.2), yaw_deg, reach))
    box = mapper.traversed
    half = LOBE_DEG / 2
    with drawing(path, size_in=(6.4, 4.4)) as (_, axes):
        draw_map(axes, mapper.map())
        axes.add_patch(Wedge((1.0, 1.2), reach, yaw_deg - half, yaw_deg + half, fill=False, edgecolor=BLUE, lw=1.2))
        corners = np.radians([yaw_deg - half, yaw_deg + half, 0.0])
        axes.plot(1.0, 1.2, "o", color=BLUE, markersize=8, label="sensor")
        axes.plot(1 + reach * np.cos(corners), 1.2 + reach * np.sin(corners), "o", color=TRUTH_COLOR, markersize=5,
                  label="ends and easternmost point of the arc")  # fmt: skip
        if box is not None:
            rows, columns = box
            low, step = np.array(grid.origin_m[:2]), grid.step_m
            corner = low + step * np.array([columns.start, rows.start])
            size = step * np.array([columns.stop - columns.start, rows.stop - rows.start])
            patch = Rectangle(tuple(corner), *size, fill=False, edgecolor=TRUTH_COLOR, label="cells traversed")
            axes.add_patch(patch)
        axes.set(xlim=grid.extent_m[:2], ylim=grid.extent_m[2:])
        axes.set_xticks(grid.extent_m[0] + grid.step_m * np.arange(grid.shape[1] + 1), minor=True)
        axes.set_yticks(grid.extent_m[2] + grid.step_m * np.arange(grid.shape[0] + 1), minor=True)
        axes.grid(which="minor", color="0.75", linewidth=0.2)
        axes.legend(fontsize=8, loc="lower right")
    return path


FIGURES: dict[str, Callable[[Path], Path]] = {
    "hyperbola": draw_hyperbola,
    "smoothing": draw_smoothing,
    "ray_spacing": draw_ray_spacing,
    "overlap": draw_overlap,
    "square": draw_square,
}

if __name__ == "__main__":
    for drawn in draw_gallery(Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER):
        print(drawn)
