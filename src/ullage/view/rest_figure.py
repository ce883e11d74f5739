"""Draw the properties of a radar at rest: standing echoes, direct path, noise and its correlation over bins."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ullage.data import Frames
from ullage.view.figures import UNIT_LABEL, drawing

LAGS = 6


def rest_figure(path: Path, still: Mapping[str, Frames], *, title: str) -> Path:
    """Draw the mean profile with its noise, and the correlation of the noise from bin to bin.

    Args:
        path: where to write.
        still: frames of each sensor while nothing moved.
        title: above both panels.
    """
    with drawing(path, size_in=(9.0, 3.8), columns=2) as (figure, (profile, correlation)):
        for name, frames in still.items():
            noise = np.diff(frames.samples, axis=0) / np.sqrt(2)
            sigma = np.sqrt(np.mean(np.abs(noise) ** 2, axis=0))
            mean = np.abs(frames.samples.mean(axis=0))
            (line,) = profile.plot(frames.range_m, _db(mean), linewidth=1.0, label=f"{name}: mean, direct path first")
            profile.plot(frames.range_m, _db(sigma), ":", color=line.get_color(), label=f"{name}: noise, rms per bin")
            far = noise[:, len(sigma) // 2 :]
            power = np.mean(np.abs(far) ** 2)
            shared = [np.mean(far[:, : far.shape[1] - k] * far[:, k:].conj()) / power for k in range(LAGS + 1)]
            correlation.plot(range(LAGS + 1), np.abs(shared), "o-", color=line.get_color(), label=name)
        unit = next(iter(still.values())).unit
        profile.set(xlabel="range [m]", ylabel=UNIT_LABEL[unit], title="direct path, standing echoes, noise")
        correlation.set(
            xlabel="lag [bins]", ylabel="correlation", title="noise from bin to bin (far half)", ylim=(0, 1.05)
        )
        for axes in (profile, correlation):
            axes.legend(fontsize=7)
            axes.grid(alpha=0.3)
        count = max(len(frames) for frames in still.values())
        figure.suptitle(f"{title}: at rest, {count} frames", fontsize=10)
    return path


def _db(amplitude: np.ndarray) -> np.ndarray:
    return np.asarray(20 * np.log10(np.maximum(amplitude, 1e-12)))
