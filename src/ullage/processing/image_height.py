"""Find the height at which the surroundings of an image's brightest point focus best."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ullage.arrays import Floats
from ullage.data import Frames
from ullage.grids import Grid, Image
from ullage.processing.backprojection import Backprojector
from ullage.processing.sar import frame_weights

_REACH_M, _STEP_M = 2.4, 0.16  # largest height offset tried, of either sign [m]
_WINDOW_M, _CELL_M = 2.1, 0.03  # side and cells of the planes tried [m]
_MOST_FRAMES, _AROUND_M = 160, 2.0  # used for them; as much farther than the nearest frame they may be [m]
_FLAT_DB = 1.5  # a focus that loses less at most other heights gives no height


@dataclass(frozen=True, slots=True)
class FocusHeight:
    """Focus around an image's brightest point against the height of the plane."""

    best_m: Floats  # (3) brightest point over all heights tried [m]
    gain_db: float  # amplitude gained there over the plane [dB]
    resolved: bool  # False: the track is too straight to separate heights


def focus_height(frames: Frames, image: Image) -> FocusHeight:
    """Image the surroundings of the brightest point at other heights and compare the brightest cells.

    On a straight track all places on a circle around it give the same echoes, so no height is better than another:
    `resolved` is then False.

    Args:
        frames: of the sensor that made the image, without its own echo.
        image: a plane, with coherence or without.
    """
    strength = image.amplitude * np.sqrt(1.0 if image.coherence is None else image.coherence)
    row, column = np.unravel_index(int(np.argmax(strength)), strength.shape)
    point = np.array([image.grid.x_m[column], image.grid.y_m[row], image.grid.origin_m[2]])
    part = _nearest(frames, point)
    offsets = np.arange(-round(_REACH_M / _STEP_M), round(_REACH_M / _STEP_M) + 1) * _STEP_M
    planes = [_plane(part, point + np.array([0.0, 0.0, offset])) for offset in offsets]
    level_db = np.array([20 * np.log10(max(float(plane.amplitude.max()), 1e-30)) for plane in planes])
    top = int(np.argmax(level_db))
    gain_db = float(level_db[top] - level_db[np.argmin(np.abs(offsets))])
    falls_db = float(level_db[top] - np.median(level_db))
    return FocusHeight(planes[top].peak_m, gain_db, falls_db > _FLAT_DB)


def _nearest(frames: Frames, point: Floats) -> Frames:
    """Return the frames nearest to a point, evenly thinned."""
    away = np.linalg.norm(frames.believed.position - point, axis=1)
    near = np.flatnonzero(away < away.min() + _AROUND_M)
    return frames[near[:: max(1, -(-len(near) // _MOST_FRAMES))]]


def _plane(frames: Frames, middle: Floats) -> Image:
    cells = round(_WINDOW_M / _CELL_M)
    corner = middle - [_WINDOW_M / 2, _WINDOW_M / 2, 0.0]
    image = Backprojector(Grid((corner[0], corner[1], corner[2]), _CELL_M, (cells, cells)))
    image.update(frames, weights=frame_weights(frames))
    return image.image()
