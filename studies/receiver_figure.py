"""Draw the simulated receiver next to a real recording of a radar at rest."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ullage.arrays import Complexes, Floats
from ullage.data import Frames
from ullage.errors import InputError
from ullage.radar.receiver import noise_sigma, receive, unit
from ullage.specs import RadarSpec
from ullage.view.figures import drawing

COLORS = {"recorded": "#22577a", "simulated": "#d1495b"}
DIRECT = slice(0, 8)
"""Bins of the direct path."""


def draw_receiver(still: Frames, path: Path, *, counts: tuple[int, int] = (4, 1), noise_from: int = 100) -> None:
    """Draw direct path, noise and phase of a recording and of the simulated receiver at the same settings.

    Args:
        still: frames of a radar at rest, in the sensor's normalised units.
        path: of the figure (.png, .svg or .pdf).
        counts: iterations and pulses per step of the recording.
        noise_from: first of the bins that contain little more than noise.

    Raises:
        InputError: the frames are not normalised baseband, or too few.
    """
    if still.unit != "normalised" or not np.iscomplexobj(still.samples) or len(still) < 50:
        raise InputError("not 50 frames of normalised baseband", where="draw_receiver", allowed="a recording at rest")
    iterations, pulses = counts
    bins = still.samples.shape[1]
    spec = RadarSpec.preset("x4m05", iterations=iterations, pulses_per_step=pulses, bins=bins)
    empty = np.zeros((len(still), bins), np.complex64)
    both = {
        "recorded": still.samples.astype(np.complex128),
        "simulated": receive(empty, spec, seed=1).astype(np.complex128) * unit(spec),
    }
    with drawing(path, size_in=(11.0, 6.4), columns=1) as (figure, first):
        first.remove()
        panels = figure.subplots(2, 3).ravel()
        figure.suptitle(f"Receiver at rest: {len(still)} recorded frames and as many simulated, {spec.counts} counts")
        for name, frames in both.items():
            style = {"color": COLORS[name], "label": name}
            panels[0].plot(20 * np.log10(abs(frames.mean(0)[:30])), marker="o", ms=3, lw=1, **style)
            _histogram(panels[1], frames[:, noise_from:], style)
            _correlation(panels[2], frames[:, noise_from:], style)
            _spectrum(panels[3], frames[:, noise_from:], spec, style)
            _stability(panels[4], frames, noise_sigma(spec), style)
            phase = _common_phase(frames)[:200]
            panels[5].plot((phase - phase.mean()) * 1e3, lw=0.8, **style)
        _finish(panels, noise_sigma(spec))


def _steps(frames: Complexes) -> Complexes:
    return np.asarray(np.diff(frames, axis=0) / np.sqrt(2))


def _common_phase(frames: Complexes) -> Floats:
    mean = frames.mean(0)[DIRECT]
    return np.asarray(np.angle((frames[:, DIRECT] * mean.conj()).sum(1)))


def _histogram(axes: Axes, noise_bins: Complexes, style: dict[str, Any]) -> None:
    noise = _steps(noise_bins)
    values = np.concatenate([noise.real.ravel(), noise.imag.ravel()]) * 1e4
    edges = np.linspace(-8, 8, 81)
    density, _ = np.histogram(values, edges, density=True)
    axes.semilogy((edges[1:] + edges[:-1]) / 2, np.where(density > 0, density, np.nan), ".-", ms=3, lw=0.8, **style)


def _correlation(axes: Axes, noise_bins: Complexes, style: dict[str, Any]) -> None:
    noise = _steps(noise_bins)
    bins = noise.shape[1]
    lags = [(noise[:, : bins - k] * noise[:, k:].conj()).mean().real for k in range(7)]
    axes.plot(np.array(lags) / lags[0], marker="o", ms=4, lw=1, **style)


def _spectrum(axes: Axes, noise_bins: Complexes, spec: RadarSpec, style: dict[str, Any]) -> None:
    noise = _steps(noise_bins) * np.hanning(noise_bins.shape[1])
    power = (abs(np.fft.fftshift(np.fft.fft(noise, axis=1), axes=1)) ** 2).mean(0)
    frequency = np.fft.fftshift(np.fft.fftfreq(noise_bins.shape[1], spec.step_s))
    axes.plot(frequency * 1e-9, 10 * np.log10(power / power.mean()), lw=1, **style)


def _stability(axes: Axes, frames: Complexes, floor: float, style: dict[str, Any]) -> None:
    turned = frames * np.exp(-1j * _common_phase(frames))[:, None]
    for part, line in ((frames, "-"), (turned, "--")):
        change = np.sqrt((abs(_steps(part)) ** 2).mean(0))[:40]
        label = style["label"] if line == "-" else f"{style['label']}, referred to direct path"
        axes.plot(20 * np.log10(change / floor), line, lw=1, color=style["color"], label=label)


def _finish(panels: Any, floor: float) -> None:
    words = (
        ("direct path and near echoes", "range bin", "mean |A| [dB, normalised]"),
        ("additive noise, frame to frame", "I or Q [1e-4 normalised]", "density"),
        ("noise from bin to bin", "lag [bins]", "correlation"),
        ("noise spectrum behind the on-chip filter", "offset from the carrier [GHz]", "power [dB, mean = 0]"),
        ("change from frame to frame", "range bin", "rms over additive noise [dB]"),
        ("phase common to the frame", "frame", "phase [mrad]"),
    )
    for axes, (title, across, up) in zip(panels, words, strict=True):
        axes.set_title(title, fontsize=10)
        axes.set_xlabel(across)
        axes.set_ylabel(up)
        axes.grid(alpha=0.3)
        axes.legend(fontsize=7, frameon=False)
    sigma = floor / np.sqrt(2) * 1e4
    x = np.linspace(-6.5, 6.5, 200)
    panels[1].semilogy(x, np.exp(-(x**2) / 2 / sigma**2) / sigma / np.sqrt(2 * np.pi), "k:", lw=1)
    panels[1].set_ylim(1e-6, 1)
    panels[0].set_ylim(-90, -20)
    panels[0].axhline(20 * np.log10(floor), color="k", ls=":", lw=1)
