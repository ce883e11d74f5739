"""Figure of an exploring flight: the map, the path coloured by time, and the goals."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ullage.arrays import Floats
from ullage.data import Trajectory
from ullage.grids import OccupancyMap
from ullage.view.figures import draw_map, drawing

MARKS = {"view": ("o", "goal"), "probe": ("^", "careful first look"), "home": ("s", "home")}


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
