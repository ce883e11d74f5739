"""Silence as evidence: cells from which the least obstacle that matters would have been received."""

from __future__ import annotations

import math
from collections import deque
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d

from ullage.arrays import Bools, Floats
from ullage.grids import Grid
from ullage.kernels.silence import NEAR_BINS, Continuations, Residual, Sight, Walls, exclude, hear, listen
from ullage.kernels.surface_cells import Plane
from ullage.processing.likelihood.echoes import Echoes, Left, gains_of
from ullage.processing.likelihood.keyframes import Keyframe
from ullage.processing.likelihood.spec import LikelihoodSpec

LATEST = 161  # keyframes whose strongest echoes show the level of a mirror
LEAST_FLATNESS = 0.1
LOBE, DEPTH = 1, 1  # directions and bins about an echo that are its own
NORMALS = 36  # of surfaces, over half a turn
BENDS = 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0  # curvatures of surfaces [1/m]
ROUNDS = 3  # of views, since surfaces that may stand somewhere hide what lies behind
REACH_M, RANGE_M = 5.0, 0.1  # range up to which hearing is kept, and its steps
CLEAR = 200.0  # energy of a mirror over the received, from which no wall is there: one 10 dB weaker leads by 13 dB
SIGMAS = 2.0  # by which mounts may be off
PLACE_M = 0.2  # between places of the track
CELL_M = 0.2  # least size of the cells in which surfaces are followed, for its time grows with the inverse cube
HALF_M = 0.15  # half length of the shortest wall that counts: shorter ones scatter as poles do


class Silence:
    """Log-likelihoods that nothing stands in a cell, against a pole of the least size and against an edge.

    The level of a mirror is that of the strongest echoes, so that samples need no calibration. A cylinder of radius a
    returns the share sqrt(a / (a + r)) of a mirror's amplitude, at the range r [Balanis2012]. The end of a surface
    returns sqrt(wavelength / (2 pi^2 r)) [Keller1962], as much as a thin cylinder.
    """

    def __init__(self, grid: Grid, spec: LikelihoodSpec) -> None:
        self._plane = Plane(*grid.origin_m[:2], grid.step_m, *grid.shape)
        self._spec = spec
        self._levels: deque[float] = deque(maxlen=LATEST)
        self.nats = np.zeros((2, grid.size))
        self._walls: dict[
            tuple[int, int], tuple[int, NDArray[np.float32]]
        ] = {}  # by place: keyframes, sum of logarithms

    def add(self, key: Keyframe, echoes: Echoes, left: Left | None, sigma_m: float) -> None:
        """Take what a keyframe received, without what its echoes explain elsewhere.

        Args:
            key: the keyframe.
            echoes: of it.
            left: what these leave.
            sigma_m: white error of its poses [m].
        """
        if len(echoes):
            flatness = abs(1 - echoes.state[0, 2] * echoes.state[0, 0])
            self._levels.append(float(echoes.level[0]) / np.sqrt(max(flatness, LEAST_FLATNESS)))
        if left is None or not self._levels or not key.aperture.phase:  # amplitudes leave too much unexplained
            return
        spec, rows = self._spec, np.bincount(key.aperture.sensor, minlength=len(key.aperture.axes))
        gains = gains_of(key.aperture, left.directions) ** 2 @ rows
        energy = _with_echoes(key, echoes, left.energy, gains)
        coherent = math.exp(-((4 * math.pi / key.wavelength_m * sigma_m) ** 2))
        turned = 2 * round(SIGMAS * key.mount_sigma_rad / (2 * math.pi) * len(gains)) + 1
        expected = float(np.median(self._levels)) ** 2 * coherent * minimum_filter1d(gains, turned, mode="wrap")
        low, near = max(left.low, key.silent_bin), NEAR_BINS + round(SIGMAS * key.mount_sigma_m / key.bin_m)
        residual = Residual(energy, left.clutter, expected, low, left.high, key.start_m, key.bin_m, near)
        self._add_walls(key, residual)
        defocus_m = 2 * spec.window_m**2 / key.wavelength_m
        weight = spec.keyframe_m / (2 * spec.window_m)  # keyframes share frames
        edge_m = key.wavelength_m / (2 * math.pi**2)
        for radius_m, nats in zip((spec.least_obstacle_m / 2, edge_m), self.nats, strict=True):
            listen(self._plane, key.position[:2], residual, radius_m, defocus_m, weight, nats)

    def _add_walls(self, key: Keyframe, residual: Residual) -> None:
        x, y = np.floor(key.position[:2] / PLACE_M).astype(int).tolist()
        ratio = np.zeros((2 * NORMALS, round(REACH_M / RANGE_M)), np.float32)
        hear(residual, key.noise**2, RANGE_M, ratio)
        count, total = self._walls.get((x, y), (0, np.zeros_like(ratio)))
        self._walls[x, y] = count + 1, total + np.log1p(ratio)

    def hearing(self) -> tuple[Floats, Bools]:
        """Places (f, 2) of the track [m], and where a wall would have been received from there.

        The second (f, n, m) is by direction over the circle and by range. A range counts with both its neighbours, as
        cells are wider than its steps.
        """
        places = (np.array(list(self._walls), float).reshape(-1, 2) + 0.5) * PLACE_M
        means = [total / count for count, total in self._walls.values()]
        mean = np.array(means, np.float32).reshape(len(means), 2 * NORMALS, round(REACH_M / RANGE_M))
        return places, minimum_filter1d(mean, 3, axis=2) >= math.log1p(CLEAR)


def _with_echoes(key: Keyframe, echoes: Echoes, energy: NDArray[np.float32], gains: Floats) -> NDArray[np.float32]:
    """Energy (d, b) by direction and bin, with that of the echoes at their own places.

    An obstacle where an echo comes from explains it as well, whether a surface is sure there or not.
    """
    out = energy.copy()
    directions, bins = out.shape
    for state, level in zip(echoes.state, echoes.level, strict=True):
        d, k = round(state[1] / (2 * math.pi) * directions), round((state[0] - key.start_m) / key.bin_m)
        own = np.ix_(
            np.arange(d - LOBE, d + LOBE + 1) % directions, np.arange(max(k - DEPTH, 0), min(k + DEPTH + 1, bins))
        )
        out[own] = np.maximum(out[own], (level / state[0]) ** 2 * gains[d % directions])
    return out


def without_surfaces(
    plane: Plane, hearing: tuple[Floats, Bools], shown: Bools, free: Bools, possible: Bools, ends: Bools
) -> Bools:
    """Cells in which no smooth surface stands (cells).

    One that is seen square would have been received. Any other one goes on to both sides, as a plane or a cylinder,
    until it ends. So it is excluded where it meets, before it may end, a cell in which it would have been received.

    Args:
        plane: the cells.
        hearing: places of the track, and what would have been received from there, as of `Silence.hearing`.
        shown: (cells) of known surfaces, which end a line of sight.
        free: (cells) through which echoes came.
        possible: (cells) to look at; others end no line of sight.
        ends: (cells) in which a surface may end without being received.
    """
    side = max(round(CELL_M / plane.step), 1)
    rows, columns = -(-plane.rows // side), -(-plane.columns // side)

    def blocks(cells: Bools, *, whole: bool) -> Bools:
        """Which blocks, `side` cells wide, these cells fill, or else touch; none lie beyond the plane."""
        padded = np.zeros((rows * side, columns * side), bool)
        padded[: plane.rows, : plane.columns] = cells.reshape(plane.rows, plane.columns)
        parts = padded.reshape(rows, side, columns, side)
        return np.asarray(parts.all(axis=(1, 3)) if whole else parts.any(axis=(1, 3))).ravel()

    coarse, through = Plane(plane.x, plane.y, side * plane.step, rows, columns), blocks(free, whole=True)
    seen = blocks(possible | free, whole=True) & ~through
    left = through | _left(coarse, hearing, blocks(shown, whole=False), through, seen, blocks(ends, whole=False))
    fine = np.repeat(np.repeat(left.reshape(rows, columns), side, axis=0), side, axis=1)
    return possible & fine[: plane.rows, : plane.columns].ravel()


def _left(
    plane: Plane, hearing: tuple[Floats, Bools], shown: Bools, free: Bools, possible: Bools, ends: Bools
) -> Bools:
    """The same, in cells of one size."""
    continuations = _continuations(plane.rows, plane.columns, plane.step)
    out, blocked = possible, shown
    for _ in range(ROUNDS):
        square = np.repeat(free[:, None], NORMALS, axis=1)
        out, sight = out.copy(), Sight(*hearing, RANGE_M, blocked, HALF_M)  # more blocked views never exclude more
        exclude(plane, Walls(sight, square, free.copy(), ends, continuations), out)
        blocked = shown | (possible & ~out)
    return out


@lru_cache(maxsize=4)
def _continuations(rows: int, columns: int, step_m: float) -> Continuations:
    """Steps of half a cell along planes and cylinders, as far as the plane reaches or half a turn."""
    first, found = [0], []
    count = np.arange(2 * math.ceil(math.hypot(rows, columns)))
    for n in range(NORMALS):
        start = ((n + 0.5) / NORMALS + 0.5) * math.pi
        for bend in (0.0, *BENDS, *(-one for one in BENDS)):
            for side in (-1.0, 1.0):
                turn = 0.5 * side * bend * step_m
                some = count[np.abs(turn) * count < math.pi]
                moving, angle = start + (some + 0.5) * turn, start + (some + 1) * turn
                row = np.floor(0.5 + np.cumsum(0.5 * side * np.sin(moving)))
                column = np.floor(0.5 + np.cumsum(0.5 * side * np.cos(moving)))
                normal = np.floor((angle / math.pi - 0.5) * NORMALS) % NORMALS
                steps = np.stack([row, column, normal], axis=1).astype(np.int32)
                fresh = np.any(np.diff(steps, axis=0, prepend=-1), axis=1)
                found.append(steps[fresh])
                first.append(first[-1] + len(found[-1]))
    return Continuations(np.array(first), np.concatenate(found))
