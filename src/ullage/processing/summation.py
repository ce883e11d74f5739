"""The thesis' simple summation: each profile laid on a straight line ahead of the sensor [Billdal2018, 2.3.1]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ullage.data import Frames
from ullage.geometry import quat_matrix
from ullage.grids import Grid, Image
from ullage.processing.baseband import checked, envelope

Floats = NDArray[np.float64]


def summed(parts: list[Frames], grid: Grid) -> Image:
    """Amplitudes of every sensor's profiles, summed along lines; objects become hyperbolas as the sensor passes."""
    heights = np.concatenate([part.believed.position[:, 2] for part in parts])
    grid = grid.at_height(float(heights.mean()))
    out = np.zeros(grid.size)
    for part in parts:
        for frames in part.chunks(128):
            _lay(checked(frames), grid, out)
    return Image(grid, out.reshape(grid.shape).astype(np.float32), None, "summation")


def _lay(frames: Frames, grid: Grid, out: Floats) -> None:
    """Adds profiles, two samples a cell, each shared between the nearest cells by distance."""
    path = frames.believed
    reach = np.arange(frames.range_m[0], frames.range_m[-1], grid.step_m / 2)
    ahead = quat_matrix(path.quat_xyzw)[:, :, 0]
    values = 0.5 * _at(envelope(frames), frames.range_m, reach)
    points = path.position[:, None, :] + reach[None, :, None] * ahead[:, None, :]
    cell = (points[..., : grid.dims] - np.asarray(grid.origin_m)[: grid.dims]) / grid.step_m - 0.5
    low = np.floor(cell).astype(np.int64)
    near = cell - low
    for corner in np.ndindex(*(2,) * grid.dims):
        index = low + np.asarray(corner)
        share = np.prod(np.where(np.asarray(corner), near, 1 - near), axis=-1) * values
        inside = np.all((index >= 0) & (index < np.asarray(grid.shape[::-1])), axis=-1)
        flat = np.ravel_multi_index(tuple(index[inside].T[::-1]), grid.shape)
        out += np.bincount(flat, weights=share[inside], minlength=grid.size)


def _at(profiles: NDArray[np.float32], range_m: Floats, wanted: Floats) -> Floats:
    u = np.interp(wanted, range_m, np.arange(len(range_m)))
    i = np.minimum(u.astype(np.int64), len(range_m) - 2)
    f = u - i
    return np.asarray((1 - f) * profiles[:, i] + f * profiles[:, i + 1])
