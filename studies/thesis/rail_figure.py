"""Draw a recording next to a simulation of the same scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ullage.arrays import Floats
from ullage.data import Frames
from ullage.grids import Image
from ullage.processing.baseband import envelope
from ullage.view.figures import save_figure

COLORS = {"recorded": "#22577a", "simulated": "#d1495b"}


@dataclass(frozen=True, slots=True, eq=False)
class Rail:
    """One side of the comparison: the frames of a rail and their measured values."""

    name: str
    frames: Frames
    image: Image
    wave: Floats  # (m) mean waveform of the reflector's echo
    peaks: Floats  # (n) its peak in each frame
    gain: float  # scales its amplitudes to those of the recording


def draw_rail(path: Path, rails: Sequence[Rail], *, place: Floats, reach_m: Floats, bias_m: float) -> None:
    """Draw range-time pictures and images above, and waveform, peaks and mean profile below.

    Args:
        path: picture file.
        rails: the recording first.
        place: surveyed place of the reflector (3) [m].
        reach_m: distance to it in each frame (n) [m].
        bias_m: recorded range minus simulated range [m].
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14.5, 7.6), layout="constrained")
    FigureCanvasAgg(figure)
    upper, lower = np.asarray(figure.subfigures(2, 1, height_ratios=[1.15, 1]))
    above, below = upper.subplots(1, 4, width_ratios=[1.2, 1.2, 1, 1]), lower.subplots(1, 3)
    reference = float(np.median(rails[0].peaks))
    for axes, rail in zip(above[:2], rails, strict=True):
        _range_time(axes, rail, reference, reach_m, upper)
    for axes, rail in zip(above[2:], rails, strict=True):
        _image(axes, rail, place, upper)
    for rail in rails:
        color, wave = COLORS[rail.name], rail.wave * rail.gain / reference
        offset = (np.arange(len(wave)) - len(wave) // 2) * rail.frames.spec.bin_m
        below[0].plot(100 * offset, wave, color=color, linewidth=1.3, label=rail.name)
        along = rail.frames.believed.position[:, 1]
        below[1].plot(along, _db(rail.peaks * rail.gain / reference), color=color, linewidth=1.0, label=rail.name)
        level = np.sqrt(np.mean(envelope(rail.frames).astype(float) ** 2, axis=0)) * rail.gain / reference
        below[2].plot(rail.frames.range_m, _db(level), color=color, linewidth=1.0, label=rail.name)
    shift = f"recorded moved by {-100 * bias_m:.0f} cm"
    below[0].set(
        xlabel="range from the reflector [cm]", ylabel="amplitude", title=f"mean waveform of its echo ({shift})"
    )
    below[1].set(xlabel="along the rail y [m]", ylabel="dB", title="its peak in every frame", ylim=(-25, 12))
    below[2].set(xlabel="range [m]", ylabel="dB", title="rms profile over the track", ylim=(-60, 30))
    for axes in below:
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    save_figure(figure, path)


def _db(value: Any) -> Floats:
    return np.asarray(20 * np.log10(np.maximum(value, 1e-6)))


def _range_time(axes: Any, rail: Rail, reference: float, reach_m: Floats, figure: Any) -> None:
    level = _db(envelope(rail.frames).astype(float) * rail.gain / reference)
    t_s = (rail.frames.t_ns - rail.frames.t_ns[0]) * 1e-9
    extent = (rail.frames.range_m[0], rail.frames.range_m[-1], t_s[0], t_s[-1])
    mesh = axes.imshow(level, extent=extent, origin="lower", aspect="auto", cmap="viridis", vmin=-35, vmax=5)
    axes.plot(reach_m + 0.35, t_s, ":", color="white", linewidth=0.9, label="35 cm beyond the survey")
    axes.plot(reach_m - 0.35, t_s, ":", color="white", linewidth=0.9)
    axes.set(xlabel="range [m]", ylabel="time [s]", title=f"{rail.name}: range over time")
    figure.colorbar(mesh, ax=axes, label="dB of the reflector's peak", pad=0.01)


def _image(axes: Any, rail: Rail, place: Floats, figure: Any) -> None:
    amplitude = rail.image.amplitude
    x, y = np.meshgrid(rail.image.grid.x_m, rail.image.grid.y_m)
    peak = float(amplitude[np.hypot(x - place[0], y - place[1]) < 0.4].max())
    mesh = axes.imshow(_db(amplitude / peak), extent=rail.image.grid.extent_m, origin="lower", vmin=-25, vmax=0)
    axes.contour(rail.image.grid.x_m, rail.image.grid.y_m, _db(amplitude / peak), [-6], colors="white", linewidths=0.8)
    axes.plot(place[0], place[1], "+", color="#d1495b", markersize=12, markeredgewidth=1.6)
    axes.set(xlabel="x [m]", ylabel="y [m]", title=f"{rail.name}: focused", aspect="equal")
    figure.colorbar(mesh, ax=axes, label="dB", pad=0.01, shrink=0.8)
