"""SAR images from frames: the thesis' summation and coherent back-projection, behind one call."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ullage.data import Frames, Recording, sensors_of
from ullage.errors import InputError
from ullage.grids import Grid, Image
from ullage.processing.backprojection import Backprojector
from ullage.processing.summation import summed

Floats = NDArray[np.float64]
Window = Literal["path", "none", "hann", "taylor"]


def focus(
    frames: Recording,
    grid: Grid,
    *,
    method: Literal["backprojection", "summation"] = "backprojection",
    window: Window = "path",
    antenna: bool = True,
    combine: Literal["incoherent", "coherent"] = "incoherent",
    threads: int = 0,
) -> Image:
    """An image of what stood where, from the frames of one sensor or several and their believed poses.

    Args:
        frames: one sensor's frames, or several by name or in a row.
        grid: where to look; a plane without a height takes the sensors' mean height.
        method: "backprojection" sums echoes in phase over the true distances to each cell; "summation" is the
            thesis' sum of amplitudes straight ahead.
        window: weight of each frame along the track: "path" by the distance moved, so that standing still adds
            nothing; "none" all alike; "hann" and "taylor" (-35 dB) lower the side lobes of one straight pass.
        antenna: weigh cells with the two-way antenna pattern.
        combine: whether several sensors are added in phase; in power otherwise.
        threads: 0 takes every core.

    Raises:
        InputError: unknown method, no poses, no phase, a sample that is not finite, or a grid too large for memory.
    """
    parts = sensors_of(frames)
    if method == "summation":
        return summed(parts, grid)
    if method != "backprojection":
        raise InputError(f"no method {method!r}", where="focus", allowed="backprojection, summation")
    grid = grid.at_height(float(np.concatenate([p.believed.position[:, 2] for p in parts]).mean()))
    together = combine == "coherent" or len(parts) == 1
    images = [Backprojector(grid, antenna=antenna, threads=threads) for _ in (parts[:1] if together else parts)]
    for k, part in enumerate(parts):
        images[0 if together else k].update(part, weights=frame_weights(part, window))
    if together:
        return images[0].image()
    power = np.sqrt(np.sum([np.abs(i.values) ** 2 for i in images], axis=0))
    coherence = np.max([i.coherence for i in images], axis=0)
    return Image(grid, power.astype(np.float32), coherence, "backprojection")


def frame_weights(frames: Frames, window: Window = "path") -> Floats:
    """Weight of each frame (n) along its track.

    Raises:
        InputError: unknown window.
    """
    position = frames.believed.position
    if window == "none" or len(frames) < 3:
        return np.ones(len(frames))
    step = np.linalg.norm(np.diff(position, axis=0), axis=1)
    moved = np.minimum((np.append(step, step[-1]) + np.insert(step, 0, step[0])) / 2, frames.spec.wavelength_m / 2)
    if moved.sum() < 1e-6:
        return np.ones(len(frames))
    moved = moved * len(moved) / moved.sum()
    if window == "path":
        return np.asarray(moved)
    from scipy.signal.windows import hann, taylor

    if window not in ("hann", "taylor"):
        raise InputError(f"no window {window!r}", where="focus", allowed="path, none, hann, taylor")
    shape = hann(1001) if window == "hann" else taylor(1001, nbar=5, sll=35)
    centred = position - position.mean(0)
    along = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
    place = (along - along.min()) / max(float(np.ptp(along)), 1e-9)
    return np.asarray(moved * np.interp(place, np.linspace(0, 1, 1001), shape))
