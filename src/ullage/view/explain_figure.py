"""Draw one frame's profile with its strongest echoes marked, and a plan of their origins."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ullage.arrays import Floats
from ullage.data import Frames
from ullage.radar.explain import Contribution
from ullage.view.figures import TRUTH_COLOR, drawing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLORS = ("#1f6feb", "#d97706", "#2a9d5c")  # one, two, three bounces


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
        _profile(left, frames, i, shown)
        _plan(right, frames, i, shown, walls)
        figure.suptitle(title, fontsize=11)
    return path


def _profile(axes: Axes, frames: Frames, i: int, shown: Sequence[Contribution]) -> None:
    level = 20 * np.log10(np.maximum(abs(frames.samples[i]), 1e-12))
    axes.plot(frames.range_m, level, color="0.35", lw=1)
    base = float(np.percentile(level, 5))
    top = max([float(level.max()), *(c.path_gain_db for c in shown)], default=0.0)
    base = max(base, top - 90)
    for k, c in enumerate(shown):
        at = c.seen_m
        axes.plot(at, c.path_gain_db, "o", color=_COLORS[c.bounces - 1], ms=5)
        axes.annotate(str(k + 1), (at, c.path_gain_db), xytext=(3, 5), textcoords="offset points", fontsize=8,
                      color=_COLORS[c.bounces - 1])  # fmt: skip
    lines = [f"{k + 1}  {' > '.join(c.path)}, {c.range_m:.2f} m, {c.path_gain_db:.0f} dB"
             for k, c in enumerate(shown)]  # fmt: skip
    axes.text(0.985, 0.975, "\n".join(lines), transform=axes.transAxes, ha="right", va="top", fontsize=7,
              bbox={"facecolor": "white", "edgecolor": "0.85", "alpha": 0.9})  # fmt: skip
    axes.set_ylim(base - 3, top + 0.75 * (top - base))
    axes.set_yticks([v for v in range(-200, 21, 20) if base - 3 < v <= top + 5])
    axes.set_xlabel("range [m]")
    axes.set_ylabel("path gain [dB]")
    axes.grid(alpha=0.3)


def _plan(axes: Axes, frames: Frames, i: int, shown: Sequence[Contribution], walls: Floats | None) -> None:
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
            color, style = _COLORS[c.bounces - 1], "-" if c.bounces == 1 else "--"
            axes.plot([here[0], c.point[0]], [here[1], c.point[1]], style, color=color, lw=0.9)
            axes.plot(*c.point[:2], "o", color=color, ms=4)
            spots.setdefault((round(c.point[0], 1), round(c.point[1], 1)), []).append(k + 1)
        for spot, numbers in spots.items():
            axes.annotate(", ".join(map(str, numbers)), spot, xytext=(4, 4), textcoords="offset points", fontsize=8)
    for n, color in enumerate(_COLORS[: max((c.bounces for c in shown), default=1)]):
        name = ("one bounce", "two bounces: where it met the last face", "three bounces: where it met the last face")[n]
        axes.plot([], [], "-" if n == 0 else "--", color=color, lw=1, label=name)
    axes.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=3)
    axes.autoscale()
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_title("plan", fontsize=9)
