"""Draw the pictures of the pages of concepts and of the Python API: python tools/concepts.py [NAMES]."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.patches import FancyBboxPatch, Rectangle

import ullage as ul
from ullage.data import Frames
from ullage.flight.missions import along_walls
from ullage.grids import OccupancyMap
from ullage.radar.penetration import slab
from ullage.view.figures import TRUTH_COLOR, draw_map
from ullage.world.materials import MATERIALS
from ullage.world.section import section

FOLDER = Path("docs/pictures/concepts")
BLUE, GREEN, GREY = "#2e86ab", "#2a9d6f", "0.45"
WAVE_M = 299_792_458 / 7.29e9


def panels(columns: int, size_in: tuple[float, float], rows: int = 1, **options: Any) -> tuple[Any, Any]:
    """Return a figure and its panels."""
    return plt.subplots(rows, columns, figsize=size_in, layout="compressed", **options)


@cache
def flown_room() -> tuple[ul.Scene, ul.Trajectory, dict[str, Frames]]:
    """A round through a room with a plate, and its frames."""
    scene = ul.scenes.room(size_m=(8, 6, 3), plate={"width_m": 1.0, "height_m": 1.0, "distance_m": 1.5})
    corners = [(-2.8, -1.8, 0), (2.8, -1.8, 0), (2.8, 1.8, 0), (-2.8, 1.8, 0), (-2.8, -1.5, 0)]
    path = ul.fly(ul.Waypoints(corners, speed_m_s=0.6), scene=scene, rate_hz=17)
    return scene, path, ul.simulate(scene, path, ul.Rig.preset("thesis-4"), seed=7)


def room_map(step_m: float = 0.1, **options: Any) -> OccupancyMap:
    """The map of that round."""
    scene, _, frames = flown_room()
    return ul.map_occupancy(frames, ul.Grid.covering(scene.bounds, step_m=step_m, margin_m=0.4), **options)


def walls(axes: Any, color: str = TRUTH_COLOR, label: str | None = "true walls") -> None:
    """Draw the room's true outline."""
    for k, line in enumerate(section(flown_room()[0], 0.0)):
        axes.plot(*np.asarray(line).T, color=color, linewidth=1.2, label=label if k == 0 else None)


def odometry() -> Any:
    """Poses by radar beside the true ones, and their error beside the stated sigma."""
    _, path, frames = flown_room()
    found = ul.odometry(frames, ul.simulate_imu(path, seed=7), start=path[:1], height=ul.simulate_height(path, seed=7))
    figure, (plan, error) = panels(2, (11.5, 4.4), width_ratios=(1.25, 1))
    walls(plan)
    plan.plot(*path.position[:, :2].T, color=GREY, linewidth=3, label="flown")
    plan.plot(*found.trajectory.position[:, :2].T, color=BLUE, linewidth=1.4, label="by radar and inertial unit")
    plan.set(xlabel="x east [m]", ylabel="y north [m]", aspect="equal", title="the body's path")
    plan.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), frameon=False, fontsize=10, ncols=3)
    t_s = found.trajectory.t_ns / 1e9
    truth = np.column_stack([np.interp(t_s, path.t_ns / 1e9, axis) for axis in path.position.T])
    off = np.linalg.norm(found.trajectory.position[:, :2] - truth[:, :2], axis=1)
    error.fill_between(t_s, 3 * np.linalg.norm(found.sigma[:, :2], axis=1), color="#cfe3ee", label="three sigma")
    error.plot(t_s, off, color=BLUE, label="error in the plane")
    for k, lost in enumerate(found.lost):
        first, last = lost.from_ns / 1e9, lost.to_ns / 1e9
        error.axvspan(first, last, color=TRUTH_COLOR, alpha=0.15, label=None if k else "stated as lost")
    error.set(
        xlabel="time [s]", ylabel="[m]", title="error, and what the odometry states", yscale="log", ylim=(1e-3, 100)
    )
    error.legend(loc="lower right", fontsize=10)
    return figure


def flight() -> Any:
    """A mission along the walls of a hold, and one corner of it in still air and in wind."""
    hold = ul.scenes.cargo_hold()
    mission = along_walls(hold, 9.0, distance_m=1.5)
    still = ul.fly(mission, scene=hold)
    windy = ul.fly(mission, scene=hold, wind_m_s=(4, 3, 0), gust_m_s=1.0, seed=7)
    believed = ul.navigate(windy, drift_m=0.2, seed=3)
    figure, (plan, corner) = panels(2, (11.5, 4.6), width_ratios=(1.5, 1))
    hold.plot(plan, height_m=9.0, path=still)
    plan.set_title("a mission in the cargo hold, from above")
    for path, color, label in ((still, GREY, "flown in still air"), (windy, BLUE, "flown in wind of 5 m/s with gusts"),
                               (believed, GREEN, "the drone's estimate of it, with drift")):  # fmt: skip
        corner.plot(*path.position[:, :2].T, color=color, label=label)
    at = still.position[np.argmax(still.position[:, 0] + still.position[:, 1])]
    box = (at[0] - 3.2, at[1] - 2.6, 4.0, 3.6)
    corner.set(xlim=(box[0], box[0] + box[2]), ylim=(box[1], box[1] + box[3]), aspect="equal", xlabel="x [m]")
    corner.set_title("its corner, enlarged")
    corner.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), frameon=False, fontsize=10)
    plan.add_patch(Rectangle(box[:2], *box[2:], fill=False, edgecolor="black", linestyle="--"))
    return figure


def energy(frames: dict[str, Frames], middle: int, here: Any, x: Any, y: Any) -> Any:
    """Energy that a flat wall with its foot at each place explains in the keyframe about the middle frame.

    It is the matched sum of `likelihood_map.md` without gains, over the frames of the sensor that faces the place.
    """
    range_m = np.hypot(x - here[0], y - here[1])
    direction = np.stack([x - here[0], y - here[1]]) / range_m
    facing = []
    for part in frames.values():
        qx, qy, qz, qw = part.believed.quat_xyzw[middle]
        ahead = (1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy + qz * qw))
        facing.append(np.tensordot(ahead, direction, 1))
    nearest, out = np.argmax(facing, axis=0), np.zeros_like(range_m)
    for k, part in enumerate(frames.values()):
        place = part.believed.position[:, :2]
        near = np.flatnonzero(np.linalg.norm(place - place[middle], axis=1) < 0.22)
        total = np.zeros_like(range_m, complex)
        for n in near:
            r = range_m - np.tensordot(place[n] - here, direction, 1)
            real, imaginary = (np.interp(r, part.range_m, v) for v in (part.samples[n].real, part.samples[n].imag))
            total += (real + 1j * imaginary) * np.exp(4j * np.pi * r / WAVE_M)
        out = np.where(nearest == k, abs(total) ** 2 / len(near), out)
    return np.where(range_m > 0.8, out, 0.0)  # nearer lies the direct path


def likelihood() -> Any:
    """What one keyframe knows of walls, and the map that all keyframes make."""
    scene, path, _ = flown_room()
    track = ul.Trajectory.line((0.08, -1.8, 0), (0.52, -1.8, 0), speed_m_s=0.2)
    frames = ul.simulate(scene, track, ul.Rig.preset("thesis-4"), seed=7)
    middle = len(track) // 2
    here = track.position[middle, :2]
    x, y = np.meshgrid(np.arange(-4.5, 4.5, 0.01), np.arange(-3.5, 3.5, 0.01))
    level = 10 * np.log10(energy(frames, middle, here, x, y) + 1e-30)
    figure, (one, whole) = panels(2, (11.5, 4.6), sharey=True)
    extent = (-4.5, 4.5, -3.5, 3.5)
    mesh = one.imshow(level - level.max(), extent=extent, origin="lower", vmin=-35, vmax=0, cmap="inferno")
    walls(one, "#7bdff2")
    one.plot(*here, "o", color="white", markersize=7, label="keyframe")
    one.legend(loc=(0.1, 0.6), fontsize=10, facecolor="0.2", labelcolor="white")
    figure.colorbar(mesh, ax=one, label="energy a flat wall explains [dB]", shrink=0.85)
    one.set(title="one keyframe: 0.44 m of track", ylabel="y north [m]")
    draw_map(whole, room_map(), path=path)
    walls(whole)
    whole.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), frameon=False, fontsize=10, ncols=2)
    whole.set(title="the map of all keyframes")
    for axes in (one, whole):
        axes.set(xlim=extent[:2], ylim=extent[2:], aspect="equal", xlabel="x east [m]")
    return figure


def representations() -> Any:
    """One map as a grid, a quadtree and surfels."""
    omap = room_map()
    percent = np.asarray(omap.percent)
    classes = np.where(percent < 0, 0, np.where(percent > 50, 2, 1))
    colors = np.array(["#c9ccd1", "#f7f7f7", "#111111"])
    left, _, bottom, _ = omap.grid.extent_m
    figure, axes = panels(3, (12.5, 3.9), sharey=True)
    size = 1 << int(np.ceil(np.log2(max(classes.shape))))
    square = np.full((size, size), -1)
    square[: classes.shape[0], : classes.shape[1]] = classes
    count = 0

    def leaf(row: int, column: int, edge: int) -> None:
        nonlocal count
        part = square[row : row + edge, column : column + edge]
        if (part == part[0, 0]).all():
            if part[0, 0] >= 0:
                count += 1
                corner = (left + 0.1 * column, bottom + 0.1 * row)
                axes[1].add_patch(Rectangle(corner, 0.1 * edge, 0.1 * edge, facecolor=colors[part[0, 0]],
                                            edgecolor="0.6", linewidth=0.4))  # fmt: skip
        else:
            half = edge // 2
            for r, c in ((0, 0), (0, half), (half, 0), (half, half)):
                leaf(row + r, column + c, half)

    leaf(0, 0, size)
    extent = omap.grid.extent_m
    axes[0].pcolormesh(*(np.linspace(*ends, n + 1) for ends, n in zip((extent[:2], extent[2:]), classes.shape[::-1],
                       strict=True)), classes, cmap=plt.matplotlib.colors.ListedColormap(list(colors)),
                       edgecolor="none")  # fmt: skip
    axes[0].set_title(f"occupancy grid: {classes.size} cells")
    axes[1].set_title(f"quadtree: {count} leaves")
    rows, columns = np.nonzero(classes == 2)
    places = np.column_stack([omap.grid.x_m[columns], omap.grid.y_m[rows]])
    for place in places:
        near = places[np.linalg.norm(places - place, axis=1) < 0.35]
        along = np.linalg.svd(near - near.mean(0))[2][0] if len(near) > 2 else np.array([1.0, 0.0])
        axes[2].plot(*(place + 0.09 * np.outer((-1, 1), along)).T, color=BLUE, linewidth=2)
        normal = np.array([-along[1], along[0]]) * (-1 if place @ (-along[1], along[0]) > 0 else 1)
        axes[2].plot(*(place + 0.22 * np.outer((0, 1), normal)).T, color=TRUTH_COLOR, linewidth=0.7)
    axes[2].set_title(f"surfels: {len(places)} patches with normals")
    for one in axes:
        one.set(xlim=extent[:2], ylim=extent[2:], aspect="equal", xlabel="x east [m]")
    axes[0].set_ylabel("y north [m]")
    return figure


def materials() -> Any:
    """How much of the radar's power a sheet of each material returns and lets through at right angles."""
    names = [
        name
        for name, one in MATERIALS.items()
        if not one.conductor and one.thickness_m and one.valid_ghz[0] <= 6.5 and one.valid_ghz[1] >= 8.1
    ]
    band = np.linspace(6.5e9, 8.1e9, 33)
    rows = []
    for name in names:
        one = MATERIALS[name]
        sums = [slab(one.permittivity(f), one.thickness_m, f, [1.0]) for f in band]
        rows.append([10 * np.log10(np.mean([abs(s[k][0]) ** 2 for s in sums])) for k in (0, 2)])
    order = np.argsort([row[0] for row in rows])
    figure, axes = panels(1, (9.5, 0.36 * len(names) + 1.6))
    values = np.maximum(np.array(rows)[order], -40.0)
    y = np.arange(len(names))
    for k, (color, label) in enumerate(((BLUE, "returned"), ("#f4a261", "passes"))):
        axes.barh(y + 0.2 - 0.4 * k, values[:, k] + 40, 0.38, left=-40, color=color, label=label)
    axes.set_yticks(y, [f"{names[k]}, {1e3 * MATERIALS[names[k]].thickness_m:g} mm" for k in order])
    axes.axvline(0, color="0.3", linewidth=1)
    axes.set(xlim=(-40, 1), xlabel="power over the arriving power [dB]; metal returns 0 dB")
    axes.set_title("A wave of 6.5 to 8.1 GHz at right angles to a sheet")
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    axes.grid(axis="x", alpha=0.3)
    return figure


def ros_dune() -> Any:
    """Vehicles with DUNE on the left, ROS 2 on the right, ullage between them."""
    figure, axes = panels(1, (11.5, 4.6))
    axes.set(xlim=(0, 11.5), ylim=(0, 4.6))
    axes.axis("off")
    boxes = (
        (0.2, 2.7, "DUNE", "controls the vehicle", "#cdb4db"),
        (0.2, 0.4, "Neptus", "missions, several vehicles", "#cdb4db"),
        (4.5, 1.55, "ullage", "radar frames, images, maps", "#ffd166"),
        (8.8, 2.7, "RViz, Foxglove, rqt", "maps, clouds, plots", "#a8dadc"),
        (8.8, 0.4, "Nav2, your nodes", "plan on the map", "#a8dadc"),
    )  # fmt: skip
    for x, y, name, text, color in boxes:
        axes.add_patch(FancyBboxPatch((x, y), 2.5, 1.3, boxstyle="round,pad=0.05", facecolor=color, edgecolor="0.4"))
        axes.text(x + 1.25, y + 0.85, name, ha="center", va="center", fontsize=14, fontweight="bold")
        axes.text(x + 1.25, y + 0.4, text, ha="center", va="center", fontsize=11)
    style = {"arrowstyle": "<|-|>", "color": "0.35", "linewidth": 1.6}
    for start, end in (((2.8, 3.2), (4.4, 2.6)), ((2.8, 1.2), (4.4, 1.8)), ((7.1, 2.6), (8.7, 3.2)),
                       ((7.1, 1.8), (8.7, 1.2)), ((1.45, 2.6), (1.45, 1.8))):  # fmt: skip
        axes.annotate("", end, start, arrowprops=style)
    for x, title, lines in ((3.6, "IMC over UDP", "poses,\nraw frames,\nplans, abort"),
                            (7.9, "DDS", "frames, grids,\nclouds, poses,\ncommands")):  # fmt: skip
        axes.text(x, 4.2, title, ha="center", va="center", fontsize=13, fontweight="bold")
        axes.text(x, 3.55, lines, ha="center", va="center", fontsize=11)
    return figure


def detect() -> Any:
    """One frame, and what each method of `ul.detect` finds in it."""
    scene = ul.scenes.room(size_m=(9, 6, 3), plate={"width_m": 0.4, "height_m": 0.4, "distance_m": 3.4})
    scene = scene.add(ul.scenes.wire(0.0015, 2.5, 2.2, tilt_deg=0), at=(0, 0.5, 0))
    track = ul.Trajectory.line((0, -0.8, 0), (0, 0.8, 0), speed_m_s=0.4, rate_hz=17)
    frames = ul.simulate(scene, track, ul.RadarSpec.preset("x4m05"), seed=7)
    shown = len(frames) // 2
    figure, (profile, marks) = panels(1, (10.0, 5.2), rows=2, sharex=True, height_ratios=(2, 1))
    profile.plot(frames.range_m, 20 * np.log10(frames.amplitude[shown] + 1e-9), color=GREY)
    profile.set(ylabel="path gain [dB]", ylim=(-125, -45))
    for name, r in (
        ("floor", 1.5),
        ("wire", float(np.hypot(2.2, 0.5))),
        ("side wall", 3.0),
        ("plate", 3.4),
        ("wall", 4.5),
    ):
        profile.axvline(r, color=TRUTH_COLOR, linestyle="--", linewidth=1)
        profile.text(r, -43, name, color=TRUTH_COLOR, fontsize=11, rotation=50)
    methods = ("first_peak", "peaks", "cfar", "os-cfar", "clean", "track")
    for k, method in enumerate(methods):
        hits = ul.detect(frames, method=method)  # type: ignore[arg-type]
        marks.plot(found := hits.range_m[hits.frame == shown], np.full(len(found), -k), "o", color=BLUE, markersize=6)
    marks.set_yticks(-np.arange(len(methods)), [f'"{method}"' for method in methods])
    marks.set(xlabel="range [m]", xlim=(0.3, 9), ylim=(-len(methods) + 0.4, 0.6))
    marks.grid(alpha=0.3)
    return figure


def focus() -> Any:
    """Two spheres, focused with the options of `ul.focus`."""
    balls = ul.scenes.sphere(radius_m=0.02, distance_m=2.5).add(ul.scenes.sphere(0.02, 3.0), at=(0, 0.4, 0))
    track = ul.Trajectory.line((0, -0.8, 0), (0, 0.8, 0), speed_m_s=0.2)
    radar, grid = ul.RadarSpec.preset("x4m05"), ul.Grid.covering([(2.1, -0.7, 0), (3.4, 0.9, 0)], step_m=0.01)
    frames = ul.simulate(balls, track, radar, seed=7)
    figure, axes = panels(4, (12.5, 4.3), sharey=True)
    shown: tuple[tuple[str, dict[str, Any]], ...] = (
        ("the default", {}),
        ('window="hann"', {"window": "hann"}),
        ("subaperture_m=0.4", {"subaperture_m": 0.4}),
        ('method="summation"', {"method": "summation"}),
    )
    for one, (title, options) in zip(axes, shown, strict=True):
        image = ul.focus(frames, grid, **options)
        level = 20 * np.log10(image.amplitude / image.amplitude.max() + 1e-9)
        mesh = one.imshow(level, extent=grid.extent_m, origin="lower", cmap="inferno", vmin=-35, vmax=0)
        one.plot((2.5, 3.0), (0.0, 0.4), "o", color="#7bdff2", markersize=20, fillstyle="none")
        one.set_title(title, fontsize=12)
        one.set_xlabel("x east [m]")
    axes[0].set_ylabel("y north [m]")
    figure.colorbar(mesh, ax=axes, label="below the brightest cell [dB]")
    return figure


def map_occupancy() -> Any:
    """One flight, mapped with the options of `ul.map_occupancy`."""
    scene, path, frames = flown_room()
    grid = ul.Grid.covering(scene.bounds, step_m=0.1, margin_m=0.4)
    amplitudes = {name: replace(part, samples=part.amplitude) for name, part in frames.items()}
    shown: tuple[tuple[str, Any, dict[str, Any]], ...] = (
        ('the default: "likelihood"', frames, {}),
        ("amplitudes without phase", amplitudes, {}),
        ('method="elfes"', frames, {"method": "elfes"}),
        ("remove_own_echo=False", frames, {"remove_own_echo": False}),
    )
    figure, axes = panels(2, (10.5, 7.6), rows=2, sharex=True, sharey=True)
    for one, (title, given, options) in zip(axes.flat, shown, strict=True):
        draw_map(one, ul.map_occupancy(given, grid, **options))
        walls(one)
        one.plot(*path.position[:, :2].T, color=BLUE, linewidth=1.2, label="flown")
        one.set_title(title, fontsize=12)
        one.set(xlim=grid.extent_m[:2], ylim=grid.extent_m[2:], aspect="equal", xlabel="", ylabel="")
    for one in axes[1]:
        one.set_xlabel("x east [m]")
    for one in axes[:, 0]:
        one.set_ylabel("y north [m]")
    known = "black occupied, white free, grey unknown, striped ambiguous"
    figure.legend(
        *axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2, title=known, frameon=False
    )
    return figure


FIGURES: dict[str, Callable[[], Any]] = {
    "odometry": odometry, "flight": flight, "likelihood": likelihood, "representations": representations,
    "materials": materials, "ros_dune": ros_dune, "detect": detect, "focus": focus, "map_occupancy": map_occupancy,
}  # fmt: skip

if __name__ == "__main__":
    plt.rcParams.update({"font.size": 11, "savefig.dpi": 100})
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name in sys.argv[1:] or FIGURES:
        FIGURES[name]().savefig(FOLDER / f"{name}.png")
        print(FOLDER / f"{name}.png", flush=True)
