"""Draw the code map of the page on architecture: python tools/code_map.py."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from studies.cutaway import save_palette_png

FILE = Path("docs/pictures/code_map.png")
COLORS = {
    "world": "#e9d8a6", "flight": "#d8e2dc", "radar": "#f4acb7", "data": "#ffd166", "processing": "#a8dadc",
    "ports": "#cdb4db", "view": "#b7e4c7",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Box:
    """A place in the code: its package, what it holds, and the files where a reader begins."""

    name: str
    package: str  # colours the box
    text: str
    files: tuple[str, ...]  # under src/ullage
    left: float
    bottom: float
    width: float = 2.3
    height: float = 1.35

    @property
    def middle(self) -> tuple[float, float]:
        """Centre of the box."""
        return self.left + self.width / 2, self.bottom + self.height / 2


RADAR = ("radar/simulate.py", "radar/physical.py", "radar/receiver.py")
BOXES = (
    Box("world", "world", "world files, materials, rays", ("world/load.py", "world/scene.py"), 0.2, 5.0),
    Box("flight", "flight", "missions and dynamics", ("flight/missions.py", "flight/vehicle.py"), 0.2, 3.2),
    Box("specs, antenna", "flight", "radars and antennas", ("specs.py", "antenna.py"), 0.2, 1.4),
    Box("radar", "radar", "echoes, then the receiver", RADAR, 3.2, 3.8, height=1.65),
    Box("ports, as sources", "ports", "recordings and live ports", ("ports/registry.py", "ports/live.py"), 3.2, 1.4),
    Box("Frames", "data", "the waist: all data in one type", ("data.py",), 6.2, 3.2),
    Box("detection", "processing", "which echoes are objects", ("processing/detect.py",), 9.2, 5.0),
    Box("images", "processing", "SAR, calibration, autofocus", ("processing/sar.py",), 9.2, 3.2),
    Box("maps", "processing", "occupancy, two or three axes", ("processing/occupancy.py",), 9.2, 1.4),
    Box("ports, as sinks", "ports", "files, ROS 2, IMC, MAVLink", ("ports/registry.py", "ports/live.py"), 12.2, 5.0),
    Box("view", "view", "figures, report, viewer", ("view/report.py", "view/viewer.py"), 12.2, 3.2),
    Box("metrics", "processing", "scores against the true world", ("processing/metrics.py",), 12.2, 1.4),
)
ARROWS = (
    ("world", "radar"), ("flight", "radar"), ("specs, antenna", "radar"), ("radar", "Frames"),
    ("ports, as sources", "Frames"), ("Frames", "detection"), ("Frames", "images"), ("Frames", "maps"),
    ("detection", "ports, as sinks"), ("images", "view"), ("maps", "metrics"), ("maps", "ports, as sinks"),
    ("maps", "view"),
)  # fmt: skip
BANDS = {
    7.4: ("studies/: the thesis, validation", "cli.py: commands", "experiments/: scenarios, run folders, sweeps"),
    6.65: ("pipeline.py: a source gives frames, stages process them, sinks take the results",),
    0.25: ("kernels/: compiled loops", "grids.py", "config.py: scenario files", "geometry.py", "errors.py",
           "plugins.py: parts of other packages"),
}  # fmt: skip
"""Code around the data: the height of its band, and what it holds."""


def code_map() -> Figure:
    """Return the figure: data from left to right, the code that runs it above, the code that all use below."""
    figure = Figure(figsize=(14.8, 8.2))
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, 14.7), ylim=(0, 8.2))
    axes.axis("off")
    for bottom, parts in BANDS.items():
        _band(axes, bottom, "      ".join(parts))
    places = {box.name: box for box in BOXES}
    for start, end in ARROWS:
        _arrow(axes, places[start], places[end])
    for box in BOXES:
        _draw(axes, box)
    return figure


def _band(axes: Any, bottom: float, text: str) -> None:
    shape = "round,pad=0.05"
    axes.add_patch(FancyBboxPatch((0.25, bottom), 14.2, 0.5, boxstyle=shape, facecolor="#dee2e6", edgecolor="0.5"))
    axes.text(7.35, bottom + 0.25, text, ha="center", va="center", fontsize=10.5)


def _arrow(axes: Any, start: Box, end: Box) -> None:
    head = (end.left - 0.05, end.middle[1])
    tail = (start.left + start.width + 0.05, start.middle[1])
    axes.annotate("", xy=head, xytext=tail, arrowprops={"arrowstyle": "-|>", "color": "0.35", "linewidth": 1.2})


def _draw(axes: Any, box: Box) -> None:
    shape = "round,pad=0.03"
    axes.add_patch(FancyBboxPatch((box.left, box.bottom), box.width, box.height, boxstyle=shape,
                                  facecolor=COLORS[box.package], edgecolor="0.4"))  # fmt: skip
    x, top = box.middle[0], box.bottom + box.height
    axes.text(x, top - 0.22, box.name, ha="center", va="center", fontsize=12, fontweight="bold")
    axes.text(x, top - 0.54, box.text, ha="center", va="center", fontsize=9.5)
    for number, file in enumerate(box.files):
        axes.text(x, top - 0.86 - 0.27 * number, file, ha="center", va="center", fontsize=9.5, family="monospace")


if __name__ == "__main__":
    save_palette_png(code_map(), FILE)
