"""The floor as a check of the range axis: over level ground its echo comes from the height of the radar."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ullage.data import Frames
from ullage.geometry import C0
from ullage.processing.baseband import to_baseband

STEP_M, SPAN_M = 0.01, 0.6
LEAST_CLIMB_M = 0.3  # of height, 5th to 95th percentile: a level flight has many echoes of constant range
LEAST_SCORE = 5.0  # standard deviations of the best offset over chance


@dataclass(frozen=True, slots=True)
class FloorEcho:
    """Range of the floor's echo."""

    long_m: float  # range read minus height over the floor [m]
    sigma_m: float
    score: float  # in standard deviations over chance


def floor_echo(frames: Frames, floor_z_m: float = 0.0) -> FloorEcho | None:
    """Compare the range of the floor's echo with the height flown; None where no echo follows the height.

    Amplitudes are ranked within 0.6 m of the height in every frame. An echo that follows the height has a high mean
    rank at one distance. Places a quarter of a range cell of climb apart count as independent.

    Args:
        frames: with poses, and without the radar's own echo.
        floor_z_m: height of the floor [m].
    """
    height = frames.believed.position[:, 2] - floor_z_m
    low, high = np.quantile(height, [0.05, 0.95])
    offset = np.arange(-SPAN_M, SPAN_M + STEP_M / 2, STEP_M)
    use = height - SPAN_M > frames.range_m[0]
    use |= height > frames.range_m[0] + 0.1
    use &= height + SPAN_M < frames.range_m[-1]
    if high - low < LEAST_CLIMB_M or use.sum() < 20:
        return None
    cell_m = C0 / (2 * frames.spec.bandwidth_hz)
    climbed = np.concatenate([[0.0], np.cumsum(abs(np.diff(height[use])))])
    apart = np.unique(np.floor(climbed / (cell_m / 4)), return_index=True)[1]
    amplitude = np.abs(to_baseband(frames))[use][apart]
    at = height[use][apart, None] + offset
    near = np.stack([np.interp(x, frames.range_m, row, left=np.nan) for x, row in zip(at, amplitude, strict=True)])
    seen = np.isfinite(near)
    rank = np.where(seen, np.argsort(np.argsort(np.where(seen, near, -1.0), axis=1), axis=1), np.nan)
    missing = (~seen).sum(1, keepdims=True)
    rank = (rank - missing) / np.maximum(len(offset) - missing - 1, 1) - 0.5
    count = seen.sum(0)
    score = np.where(count >= 10, np.nansum(rank, axis=0) / np.sqrt(np.maximum(count, 1) / 12), -np.inf)
    best = int(np.argmax(score))
    if score[best] < LEAST_SCORE:
        return None
    wide = offset[score > score[best] - 1]
    return FloorEcho(float(offset[best]), max(float(np.ptp(wide)) / 2, STEP_M), float(score[best]))
