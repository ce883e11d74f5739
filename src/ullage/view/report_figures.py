"""Figures that only a run's report draws: calibration, own echo, radars at rest, explorations, echoes explained."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ullage.arrays import Floats
from ullage.data import Calibration, Frames, Trajectory
from ullage.grids import OccupancyMap
from ullage.processing.own_echo import OwnEcho
from ullage.radar.explain import Contribution
from ullage.view.figures import TRUTH_COLOR, UNIT_LABEL, decibels, draw_map, drawing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BOUNCE_COLORS = ("#1f6feb", "#d97706", "#2a9d5c")
"""Of echoes by one, two and three bounces."""
LAGS = 6
"""Of the correlation of noise over bins."""
MARKS = {"view": ("o", "goal"), "home": ("s", "home")}
"""Mark and name of each kind of goal."""


def calibration_figure(path: Path, found: Mapping[str, Calibration], *, title: str = "") -> Path:
    """Draw log density over the clock offset, and every candidate with its probability and the standard deviations.

    Args:
        path: where to write.
        found: calibration of each sensor by name.
        title: above both panels.
    """
    with drawing(path, size_in=(9.5, 3.8), columns=2) as (figure, (clock, both)):
        for name, one in found.items():
            color = None
            if one.clock_posterior:
                offset, log_density = np.array(one.clock_posterior).T
                (line,) = clock.plot(offset, log_density, linewidth=1.0, label=name)
                color = line.get_color()
            clock.axvline(one.t_offset_s, color=color, linestyle=":", linewidth=1.0)
            for t_s, range_m, probability in one.modes[1:]:
                both.plot(1e3 * (t_s - one.t_offset_s), range_m, "x", color=color, label=f"{100 * probability:.1f} %")
            both.errorbar(
                0, one.range_offset_m, xerr=1e3 * one.t_sigma_s, yerr=one.range_sigma_m, fmt="o",
                color=color, capsize=3,
                label=f"{name}: {one.t_offset_s:+.3f} s, {one.range_offset_m:+.3f} m, {100 * one.probability:.1f} %",
            )  # fmt: skip
        clock.set(xlabel="clock offset [s]", ylabel="log posterior density, from motion", ylim=(-52, 3))
        clock.set_title("echoes predicted from the track's motion", fontsize=9)
        both.set(xlabel="clock offset from the one applied [ms]", ylabel="range offset [m]")
        both.set_title("candidates, with one standard deviation", fontsize=9)
        _finish(clock, both)
        figure.suptitle(f"{title}: calibration of the radar's clock and range", fontsize=10)
    return path


def own_echo_figure(path: Path, found: Mapping[str, OwnEcho], *, title: str = "") -> Path:
    """Draw mean power received, own echo removed and power that remains over range, one panel a radar.

    Args:
        path: where to write.
        found: the estimates by sensor name.
        title: above all.
    """
    shown = {name: one for name, one in found.items() if one.energy_share}
    width = 3.1 * max(len(shown), 2) + 0.9
    with drawing(path, size_in=(width, 4.0), columns=max(len(shown), 1)) as (figure, axes):
        for panel, (name, one) in zip(np.atleast_1d(axes), shown.items(), strict=False):
            panel.plot(one.range_m, one.received_db, color="0.5", linewidth=1.0, label="received")
            removed = one.level_db > one.received_db.min() - 20
            panel.plot(one.range_m, np.where(removed, one.level_db, np.nan), color=TRUTH_COLOR, linewidth=1.2,
                       label="own echo, removed")  # fmt: skip
            panel.plot(one.range_m, one.remaining_db, color="#2e86ab", linewidth=1.0, label="remains")
            panel.axvspan(one.range_m[0], one.extent_m, color="0.93", zorder=0)
            panel.set(xlabel="range [m]", title=name)
            place = "track unknown" if not one.places else f"{one.places} places, ambiguity {one.ambiguity:.2f}"
            text = f"{100 * one.energy_share:.0f} % of the energy, up to {one.extent_m:.2f} m\n{place}"
            panel.text(0.98, 0.98, text, transform=panel.transAxes, ha="right", va="top", fontsize=7)
            panel.grid(alpha=0.3)
        first = np.atleast_1d(axes)[0]
        first.set_ylabel("power [dB], in the frames' unit")
        figure.legend(*first.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8,
                      frameon=False)  # fmt: skip
        figure.suptitle(title, fontsize=10)
    return path


def rest_figure(path: Path, still: Mapping[str, Frames], *, title: str) -> Path:
    """Draw the mean profile with its noise, and the correlation of the noise from bin to bin.

    Args:
        path: where to write.
        still: frames of each sensor while nothing moved.
        title: above both panels.
    """
    unit = next(iter(still.values())).unit
    with drawing(path, size_in=(9.0, 3.8), columns=2) as (figure, (profile, correlation)):
        for name, frames in still.items():
            noise = np.diff(frames.samples, axis=0) / np.sqrt(2)
            sigma = np.sqrt(np.mean(np.abs(noise) ** 2, axis=0))
            mean = np.abs(frames.samples.mean(axis=0))
            (line,) = profile.plot(frames.range_m, decibels(mean), linewidth=1.0)
            line.set_label(f"{name}: mean, direct path first")
            color = line.get_color()
            profile.plot(frames.range_m, decibels(sigma), ":", color=color, label=f"{name}: noise, rms per bin")
            far = noise[:, len(sigma) // 2 :]
            power = np.mean(np.abs(far) ** 2)
            shared = [np.mean(far[:, : far.shape[1] - k] * far[:, k:].conj()) / power for k in range(LAGS + 1)]
            correlation.plot(range(LAGS + 1), np.abs(shared), "o-", color=color, label=name)
        profile.set(xlabel="range [m]", ylabel=UNIT_LABEL[unit], title="direct path, standing echoes, noise")
        correlation.set(xlabel="lag [bins]", ylabel="correlation", ylim=(0, 1.05))
        correlation.set_title("noise from bin to bin (far half)")
        _finish(profile, correlation)
        count = max(len(frames) for frames in still.values())
        figure.suptitle(f"{title}: at rest, {count} frames", fontsize=10)
    return path


def exploration_figure(
    path: str | Path, omap: OccupancyMap, flown: Trajectory, goals: Sequence[tuple[float, str, Floats]], *,
    title: str, walls: Floats | None = None, upcoming: Floats | None = None,
) -> Path:  # fmt: skip
    """Write the picture file.

    Args:
        path: of the file.
        omap: the last map.
        flown: true path of the body.
        goals: time [s], kind and place (2) [m] of each decision.
        title: of the figure.
        walls: true outline as segments (s, 2, 2) [m].
        upcoming: where the flight would go on (2) [m].
    """
    from matplotlib.collections import LineCollection

    with drawing(path) as (figure, axes):
        draw_map(axes, omap, walls=walls)
        xy, t_s = flown.position[:, :2], (flown.t_ns - flown.t_ns[0]) * 1e-9
        line = LineCollection(list(np.stack([xy[:-1], xy[1:]], axis=1)), array=t_s[:-1], cmap="viridis", linewidths=2)
        axes.add_collection(line)
        for kind, (mark, text) in MARKS.items():
            if len(places := np.array([goal for _, one, goal in goals if one == kind])):
                axes.scatter(*places.T, 26, marker=mark, color="#b5179e", edgecolors="white", linewidths=0.6,
                             label=text, zorder=5)  # fmt: skip
        if upcoming is not None:
            axes.scatter(*upcoming, 60, marker="*", color="#f77f00", label="where it would go on", zorder=5)
        figure.colorbar(line, ax=axes, label="time [s]", shrink=0.8)
        figure.set_size_inches(7.0, 5.4)
        figure.legend(loc="outside lower center", ncols=3, fontsize=8, frameon=False)
        figure.suptitle(title, fontsize=10)
        axes.set_title("path by time; red: true walls; grey: unknown", fontsize=8)
    return Path(path)


def explain_figure(
    path: Path,
    frames: Frames,
    i: int,
    found: Sequence[Contribution],
    *,
    walls: Floats | None = None,
    title: str = "",
    most: int = 8,
) -> Path:
    """Draw frame `i` with its strongest contributions, in the profile and in plan.

    Args:
        path: PNG file.
        frames: of one radar, with poses.
        i: number of the frame.
        found: what `ul.explain` gives for it.
        walls: the world's outline as segments (s, 2, 2) [m].
        title: over the picture.
        most: how many contributions are drawn.
    """
    shown = list(found)[:most]
    with drawing(path, size_in=(11.0, 4.8), columns=2) as (figure, (left, right)):
        _echoes_in_profile(left, frames, i, shown)
        _echoes_in_plan(right, frames, i, shown, walls)
        figure.suptitle(title, fontsize=11)
    return path


def _echoes_in_profile(axes: Axes, frames: Frames, i: int, shown: Sequence[Contribution]) -> None:
    level = decibels(abs(frames.samples[i]))
    axes.plot(frames.range_m, level, color="0.35", lw=1)
    base = float(np.percentile(level, 5))
    top = max([float(level.max()), *(c.path_gain_db for c in shown)], default=0.0)
    base = max(base, top - 90)
    for k, c in enumerate(shown):
        at = c.seen_m
        axes.plot(at, c.path_gain_db, "o", color=BOUNCE_COLORS[c.bounces - 1], ms=5)
        axes.annotate(str(k + 1), (at, c.path_gain_db), xytext=(3, 5), textcoords="offset points", fontsize=8,
                      color=BOUNCE_COLORS[c.bounces - 1])  # fmt: skip
    lines = [f"{k + 1}  {' > '.join(c.path)}, {c.range_m:.2f} m, {c.path_gain_db:.0f} dB" for k, c in enumerate(shown)]
    axes.text(0.985, 0.975, "\n".join(lines), transform=axes.transAxes, ha="right", va="top", fontsize=7,
              bbox={"facecolor": "white", "edgecolor": "0.85", "alpha": 0.9})  # fmt: skip
    axes.set_ylim(base - 3, top + 0.75 * (top - base))
    axes.set_yticks([v for v in range(-200, 21, 20) if base - 3 < v <= top + 5])
    axes.set_xlabel("range [m]")
    axes.set_ylabel("path gain [dB]")
    axes.grid(alpha=0.3)


def _echoes_in_plan(axes: Axes, frames: Frames, i: int, shown: Sequence[Contribution], walls: Floats | None) -> None:
    from matplotlib.collections import LineCollection

    track = frames.truth if frames.truth is not None else frames.poses
    if walls is not None and len(walls):
        axes.add_collection(LineCollection(list(walls), colors=TRUTH_COLOR, linewidths=0.8))
    if track is not None:
        here = track.position[i, :2]
        ahead = track.world_from_body[i, :2, 0]
        axes.plot(*here, "k^", ms=7)
        tip = (float(here[0] + 0.6 * ahead[0]), float(here[1] + 0.6 * ahead[1]))
        axes.annotate("", tip, (float(here[0]), float(here[1])), arrowprops={"arrowstyle": "->", "lw": 1.2})
        spots: dict[tuple[float, float], list[int]] = {}
        for k, c in enumerate(shown):
            color, style = BOUNCE_COLORS[c.bounces - 1], "-" if c.bounces == 1 else "--"
            axes.plot([here[0], c.point[0]], [here[1], c.point[1]], style, color=color, lw=0.9)
            axes.plot(*c.point[:2], "o", color=color, ms=4)
            spots.setdefault((round(c.point[0], 1), round(c.point[1], 1)), []).append(k + 1)
        for spot, numbers in spots.items():
            axes.annotate(", ".join(map(str, numbers)), spot, xytext=(4, 4), textcoords="offset points", fontsize=8)
    for n, color in enumerate(BOUNCE_COLORS[: max((c.bounces for c in shown), default=1)]):
        name = ("one bounce", "two bounces: where it met the last face", "three bounces: where it met the last face")[n]
        axes.plot([], [], "-" if n == 0 else "--", color=color, lw=1, label=name)
    axes.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=3)
    axes.autoscale()
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_title("plan", fontsize=9)


def _finish(*panels: Axes) -> None:
    """Give panels a grid, and a legend where something in them has a name."""
    for axes in panels:
        axes.grid(alpha=0.3)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(fontsize=7)
