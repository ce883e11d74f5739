"""The thesis' simple summation: each profile is added along the boresight [Billdal2018, 2.3.1]."""

from __future__ import annotations

import numpy as np

from ullage.arrays import Floats, Singles
from ullage.data import Frames
from ullage.geometry import quat_matrix
from ullage.grids import Grid, Image
from ullage.processing.baseband import checked, envelope


def summed(parts: list[Frames], grid: Grid) -> Image:
    """Amplitudes of every sensor's profiles, summed along lines; objects become hyperbolas as the sensor passes.

    Raises:
        InputError: the grid would not fit into memory.
    """
    heights = np.concatenate([part.believed.position[:, 2] for part in parts])
    grid = grid.at_height(float(heights.mean()))
    grid.check_memory(20, "the image")  # the sum, one part of it, and the image
    out = np.zeros(grid.size)
    for part in parts:
        for frames in part.chunks(128):
            _accumulate(checked(frames), grid, out)
    return Image(grid, out.reshape(grid.shape).astype(np.float32), None, "summation")


def _accumulate(frames: Frames, grid: Grid, out: Floats) -> None:
    """Add profiles with two samples a cell, each shared between the nearest cells by distance."""
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


def _at(profiles: Singles, range_m: Floats, wanted: Floats) -> Floats:
    u = np.interp(wanted, range_m, np.arange(len(range_m)))
    i = np.minimum(u.astype(np.int64), len(range_m) - 2)
    f = u - i
    return np.asarray((1 - f) * profiles[:, i] + f * profiles[:, i + 1])


def apex(image: Image, *, look_deg: float | None = None) -> Floats:
    """The flat top of the brightest hyperbola (3) [m], which the thesis takes as the object's place.

    The ridge is followed from the brightest cell to either side while it stays above a quarter of its brightness. The
    hyperbola of a point, r(s) = sqrt(r0^2 + (s - s0)^2), is fitted to it; its vertex is the answer. The track need not
    be known: range counts from a line at any distance r0 before the vertex.

    Args:
        image: an image by summation.
        look_deg: direction of the boresight from +x towards +y [deg], a multiple of 90; None: the one that fits best.
    """
    turns = range(4) if look_deg is None else [round(look_deg / 90) % 4]
    fits = [_fit(image, turn) for turn in turns]
    return min(fits, key=lambda fit: fit[0])[1]


def _fit(image: Image, turn: int) -> tuple[float, Floats]:
    """Return misfit and vertex for a view along +x, turned by `turn` quarter circles."""
    amplitude = np.asarray(image.amplitude if image.grid.dims == 2 else image.amplitude.max(0), np.float64)
    view = np.rot90(amplitude, turn)  # rows run across the view, columns along it
    row, col = np.unravel_index(int(np.argmax(view)), view.shape)
    rows, cols = [int(row)], [int(col)]
    for side in (1, -1):
        k, c = int(row), int(col)
        while 0 <= k + side < view.shape[0]:
            k += side
            low = max(c - 2, 0)
            c = low + int(np.argmax(view[k, low : c + 3]))
            if view[k, c] < 0.25 * view[row, col]:
                break
            rows.append(k)
            cols.append(c)
    across, along = np.array(rows, float), np.array(cols, float)
    vertex, misfit = _hyperbola(across, along) if len(rows) >= 5 else (None, np.inf)
    place = (float(row), float(col)) if vertex is None else vertex
    return misfit, _place(image, turn, place)


FLATTEST = 1e-3
"""Curvature 1 / r0 at the vertex below which a ridge is a line [1/cell]: no track is so many cells away."""


def _hyperbola(across: Floats, along: Floats) -> tuple[tuple[float, float] | None, float]:
    """Vertex (across, along) of the hyperbola of a point through a ridge [cells], and the misfit.

    The vertex is None, and the misfit infinite, where the ridge is straight or opens towards the track.
    """
    from scipy.optimize import least_squares

    def off(p: Floats) -> Floats:
        return np.asarray(p[0] + (np.sqrt(1 + (p[2] * (across - p[1])) ** 2) - 1) / p[2] - along)

    ends = float(across.min()), float(across.max())
    start = [along.min(), float(across[int(np.argmin(along))]), 0.03]
    start[1] = float(np.clip(start[1], ends[0] + 1e-3, ends[1] - 1e-3))
    low, high = [-np.inf, ends[0], 0.5 * FLATTEST], [np.inf, ends[1], 1.0]
    fit = least_squares(off, start, bounds=(low, high), loss="soft_l1")
    if fit.x[2] < FLATTEST:
        return None, np.inf
    return (float(fit.x[1]), float(fit.x[0])), float(np.abs(off(fit.x)).mean() / len(across))


def _place(image: Image, turn: int, at: tuple[float, float]) -> Floats:
    """World point of a row and column of the turned view."""
    ny, nx = image.grid.shape[-2:]
    row, col = at
    row, col = [(row, col), (col, nx - 1 - row), (ny - 1 - row, nx - 1 - col), (ny - 1 - col, row)][turn]
    x0, y0 = float(image.grid.x_m[0]), float(image.grid.y_m[0])
    return np.array([x0 + col * image.grid.step_m, y0 + row * image.grid.step_m, float(image.grid.z_m.mean())])
