"""Draw SAR images for a report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ullage.data import Trajectory
from ullage.grids import Image
from ullage.view.figures import fit_titles


def sar_figure(
    image: Image,
    path: str | Path,
    *,
    track: Trajectory | None = None,
    truth_m: ArrayLike | None = None,
    title: str = "",
    span_db: float = 30.0,
    zoom_m: float = 0.6,
) -> Path:
    """Draw an image in dB below its peak, with the sensor's track and the true places of reflectors.

    Args:
        image: an image on a plane.
        path: of the picture; the suffix gives the format.
        track: the sensor's path.
        truth_m: (k, 3) true places [m]; the first is drawn again, enlarged.
        title: over the picture.
        span_db: range of the colours [dB].
        zoom_m: half the width of the enlarged part [m].
    """
    from matplotlib.figure import Figure

    points = None if truth_m is None else np.atleast_2d(np.asarray(truth_m, float))
    figure = Figure(figsize=(11 if points is not None else 7, 5.4), layout="constrained")
    axes = figure.subplots(
        1, 1 if points is None else 2, squeeze=False, width_ratios=[1] if points is None else [1.5, 1]
    )
    level = 20 * np.log10(np.maximum(image.amplitude, 1e-30) / image.amplitude.max())
    for k, ax in enumerate(axes[0]):
        shown = _draw(ax, image, level, points, span_db)
        if k == 0 and track is not None:
            ax.plot(*track.position[:, :2].T, color="white", lw=2.5)
            ax.plot(*track.position[:, :2].T, color="tab:red", lw=1.5, label="radar's track (motion capture)")
        if k == 1 and points is not None:
            ax.set(xlim=points[0, 0] + zoom_m * np.array([-1, 1]), ylim=points[0, 1] + zoom_m * np.array([-1, 1]))
            ax.contour(
                image.grid.x_m,
                image.grid.y_m,
                level - _near(image, level, points[0]),
                [-6],
                colors="white",
                linewidths=1,
            )
            ax.set_title("the reflector; white line: -6 dB under its peak", fontsize=9)
    axes[0, 0].set_title(title, fontsize=10)
    axes[0, 0].legend(loc="upper right", fontsize=8)
    figure.colorbar(shown, ax=list(axes[0]), label="amplitude under the brightest cell [dB]", shrink=0.85)
    fit_titles(figure)
    figure.savefig(path, dpi=130)
    return Path(path)


def _draw(ax: Any, image: Image, level: NDArray[np.float32], points: NDArray[np.float64] | None, span_db: float) -> Any:
    shown = ax.imshow(
        level,
        origin="lower",
        extent=image.grid.extent_m,
        cmap="viridis",
        vmin=-span_db,
        vmax=0,
        interpolation="nearest",
    )
    if points is not None:
        ax.plot(*points[:, :2].T, "+", ms=15, mew=1.8, color="tab:red", label="reflector, surveyed")
    ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    return shown


def _near(image: Image, level: NDArray[np.float32], point: NDArray[np.float64]) -> float:
    x, y = np.meshgrid(image.grid.x_m, image.grid.y_m)
    return float(level[np.hypot(x - point[0], y - point[1]) < 0.3].max())
