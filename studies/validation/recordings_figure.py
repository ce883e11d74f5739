"""A recording beside its simulation: range profiles, shares of the near clutter, and images of the reflector."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ullage.arrays import Floats
from ullage.grids import Image
from ullage.view.figures import save_figure

LINES = {
    "recorded": ("#22577a", "-"), "world": ("#d1495b", "-"), "receiver": ("#d1495b", "--"),
    "tails": ("#8d99ae", ":"), "isotropic": ("#edae49", ":"),
}  # fmt: skip
MEANING = {
    "recorded": "recorded", "world": "simulated: the known world", "receiver": "simulated: with the fitted receiver",
    "tails": "simulated: the direct path's tail on every echo", "isotropic": "simulated: isotropic antenna",
}  # fmt: skip


def draw_recorded(
    path: Path, range_m: Floats, profiles_db: Mapping[str, Floats], *, title: str,
    images: tuple[Image, Image] | None = None, place: Floats | None = None,
) -> None:  # fmt: skip
    """Draw range profiles, and the reflector as recorded and as simulated.

    Args:
        path: picture file.
        range_m: (b) [m].
        profiles_db: (b) by name, over the noise of one frame [dB].
        title: above the profiles.
        images: of the reflector, recorded and simulated.
        place: (3) its survey [m].
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0 if images else 7.5, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    columns = 3 if images else 1
    panels = np.atleast_1d(figure.subplots(1, columns, width_ratios=[1.6, 1, 1][:columns]))
    for name, level in profiles_db.items():
        color, style = LINES[name]
        panels[0].plot(range_m, level, style, color=color, linewidth=1.1, label=MEANING[name])
    panels[0].axhline(0, color="#888888", linewidth=0.8)
    panels[0].set(xlabel="range [m]", ylabel="dB over the noise of one frame", title=title)
    highest = max(float(level.max()) for level in profiles_db.values())
    panels[0].set_ylim(-20, 1.45 * highest + 10)  # with room for the legend
    panels[0].set_xlim(max(0.0, float(range_m[0])), float(range_m[-1]))
    panels[0].grid(alpha=0.3)
    panels[0].legend(fontsize=7, loc="upper right")
    for axes, image, name in zip(panels[1:], images or (), ("recorded", "simulated"), strict=False):
        _reflector(axes, image, place, name, figure)
    save_figure(figure, path, dpi=130)


def _reflector(axes: Any, image: Image, place: Floats | None, name: str, figure: Any) -> None:
    level = 20 * np.log10(np.maximum(image.amplitude / image.amplitude.max(), 1e-6))
    mesh = axes.imshow(level, extent=image.grid.extent_m, origin="lower", vmin=-25, vmax=0)
    if place is not None:
        axes.plot(place[0], place[1], "+", color="#d1495b", markersize=12, markeredgewidth=1.6)
    axes.set(xlabel="x [m]", ylabel="y [m]", title=f"reflector, {name}", aspect="equal")
    figure.colorbar(mesh, ax=axes, label="dB", shrink=0.8)
