"""Silence as evidence: cells from which the least obstacle that matters would have been received."""

from __future__ import annotations

from collections import deque

import numpy as np

from ullage.arrays import Bools, Floats
from ullage.grids import Grid
from ullage.kernels.silence import Residual, cover, fit_between, listen
from ullage.kernels.surface_cells import Plane
from ullage.processing.likelihood.echoes import Echoes, Left, gains_of
from ullage.processing.likelihood.keyframes import Keyframe
from ullage.processing.likelihood.spec import LikelihoodSpec

LATEST = 161  # keyframes whose strongest echoes show the level of a mirror
LEAST_FLATNESS = 0.1
NORMALS = 18  # of walls, over half a turn
REACH_M = 5.0  # from which a wall seen square is surely received
PLACE_M = 0.2  # between places of the track
HALF_M = 0.15  # half length of the shortest wall that counts: shorter ones scatter as poles do


class Silence:
    """Log-likelihood that nothing stands in a cell, against a pole of the least size, as keyframes come.

    The level of a mirror is that of the strongest echoes, so that samples need no calibration. A cylinder of radius a
    returns the share sqrt(a / (a + r)) of a mirror's amplitude, at the range r [Balanis2012].
    """

    def __init__(self, grid: Grid, spec: LikelihoodSpec) -> None:
        self._plane = Plane(*grid.origin_m[:2], grid.step_m, *grid.shape)
        self._spec = spec
        self._levels: deque[float] = deque(maxlen=LATEST)
        self.nats = np.zeros(grid.size)

    def add(self, key: Keyframe, echoes: Echoes, left: Left | None) -> None:
        """Take what a keyframe's echoes left in its samples."""
        if len(echoes):
            flatness = abs(1 - echoes.state[0, 2] * echoes.state[0, 0])
            self._levels.append(float(echoes.level[0]) / np.sqrt(max(flatness, LEAST_FLATNESS)))
        if left is None or not self._levels or not key.aperture.phase:  # amplitudes leave too much unexplained
            return
        spec, rows = self._spec, np.bincount(key.aperture.sensor, minlength=len(key.aperture.axes))
        gains = np.stack([gains_of(key.aperture, unit) for unit in left.directions])
        expected = float(np.median(self._levels)) ** 2 * (gains**2 @ rows)
        residual = Residual(left.energy, left.clutter, expected, left.low, left.high, key.start_m, key.bin_m)
        defocus_m = 2 * spec.window_m**2 / key.wavelength_m
        weight = spec.keyframe_m / (2 * spec.window_m)  # keyframes share frames
        listen(self._plane, key.position[:2], residual, spec.least_obstacle_m / 2, defocus_m, weight, self.nats)


def excluded_walls(plane: Plane, flown: Floats, blocked: Bools, free: Bools) -> Floats:
    """Share of the directions of a wall's normal under which none stands there (cells).

    It would have been seen square from the track, or it does not fit between free cells.

    Args:
        plane: the cells.
        flown: (f, 2) places of the track [m].
        blocked: (cells) that end a line of sight.
        free: (cells) through which echoes came.
    """
    places = (np.unique(np.floor(flown / PLACE_M), axis=0) + 0.5) * PLACE_M
    out = np.zeros((len(blocked), NORMALS), bool)
    cover(plane, places, blocked, REACH_M, HALF_M, out)
    fit_between(plane, free, 2 * HALF_M, out)
    return np.asarray(out.mean(axis=1))
