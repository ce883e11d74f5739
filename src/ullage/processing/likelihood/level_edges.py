"""Heights of floor and ceiling, by the level edges at which walls end.

Antennas that look ahead do not see a floor below them. But the floor ends the walls, and each lower end is a straight,
level edge. It is received where the plane across it passes the sensor: at the range sqrt(r^2 + h^2), with r the
distance of the wall and h the height over the edge. Physical optics gives the level of a plate's edge against that of
the plate seen square: 1 / (2 sqrt(pi k R) tan a), with R the range, and a the angle to the plate's normal,
tan a = h / r [Keller1962]. All walls and keyframes vote for one height.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from ullage.arrays import Bools, Floats, Longs
from ullage.grids import Grid
from ullage.kernels.edge_sums import sum_edges
from ullage.processing.likelihood.directions import DirectedEchoes
from ullage.processing.likelihood.keyframes import Keyframe
from ullage.processing.likelihood.volume_surfaces import PLANE, PROJECTORS, SpatialSurface, transported

SURE_ODDS, SURE_SHARE = 300.0, 0.9  # log-odds of a wall, and share of the likelihood that its direction has
LEVEL = 0.1  # upward part of a level normal
LEAST_M = 0.3  # heights and distances below which the edge's echo is not apart from the wall's
NEAR_M, NEAR = 0.06, 0.06  # range and cosine to the track within which an echo may be the edge's
QUARTER = 0.25  # share of the expected energy from which an edge is received
FAINT = 0.15  # share of the least energy of an echo that is expected of an edge at least, where one was found
LEAST_VIEWS, LEAST_SHARE = 20, 0.6  # views in which an edge would be received, and share in which it is
BLUR_M = 0.6  # heights over which one edge is received


class LevelEdges:
    """Counts at each height how often the edges of walls would be received, and how often they are."""

    def __init__(self, grid: Grid) -> None:
        self._z_m = grid.z_m
        self._counts = np.zeros((3, len(grid.z_m)))  # views in which an edge is expected, expected and received, found

    def add(self, key: Keyframe, echoes: DirectedEchoes, surfaces: Iterable[SpatialSurface]) -> None:
        """Take what the echoes of a keyframe left in its samples, and the echoes themselves."""
        walls = [one for one in surfaces if _is_wall(one)]
        height = self._z_m - key.position[2]
        silent = np.where(np.isfinite(echoes.silent), echoes.silent, 0.0).astype(float)
        last_m = key.start_m + key.bin_m * (len(silent) - 2)
        for wall in walls:
            state = transported(wall.states[[wall.leader]], PROJECTORS[[PLANE]], (key.position - wall.position)[None])
            r, course = state[0, 0], math.atan2(state[0, 2], state[0, 1])
            range_m = np.hypot(r, height)
            rows = np.flatnonzero((np.abs(height) > LEAST_M) & (range_m > key.start_m) & (range_m < last_m))
            if r < LEAST_M or not len(rows):
                continue
            far, up = range_m[rows], height[rows]
            unit = np.stack([r * math.cos(course) / far, r * math.sin(course) / far, up / far], axis=1)
            bins = np.round((far - key.start_m) / key.bin_m).astype(np.int64)
            energy, power = np.zeros((2, len(rows)))
            sum_edges(key.aperture, echoes.patterns, unit, bins, echoes.rows, energy, power)
            near = np.abs(echoes.state[:, :1] - far) < NEAR_M
            near &= np.abs((echoes.state[:, 1:4] @ echoes.track)[:, None] - unit @ echoes.track) < NEAR
            energy = np.maximum(energy, np.max(np.where(near, echoes.energy[:, None], 0.0), axis=0, initial=0.0))
            edge = np.minimum(r / (2 * np.sqrt(2 * math.pi**2 / key.wavelength_m * far) * np.abs(up)), 1.0)
            level = float(np.median([seen.level for seen in wall.sightings.values()]))
            expected, least = power * (level * edge / far) ** 2, silent[bins]
            receivable = (least > 0) & (expected > least)
            self._counts[0, rows] += receivable
            self._counts[1, rows] += receivable & (energy > QUARTER * expected)
            self._counts[2, rows] += (least > 0) & (energy > least) & (expected > FAINT * least)

    def nearest(self, low_m: float, high_m: float) -> tuple[float, float]:
        """Heights of the first edges below and above two heights [m]; infinite where none is found."""
        expected, received, found = (np.convolve(one, np.ones(3), "same") for one in self._counts)
        edge = (expected >= LEAST_VIEWS) & (received >= LEAST_SHARE * expected)
        below = np.flatnonzero(self._z_m < low_m - LEAST_M)[::-1]
        above = np.flatnonzero(self._z_m > high_m + LEAST_M)
        return (
            self._first(below, edge, found, -np.inf),
            self._first(above, edge, found, np.inf),
        )

    def _first(self, rows: Longs, edge: Bools, found: Floats, none: float) -> float:
        """Height of the first edge along rows: the place where most echoes are found about it."""
        near = rows[np.argmax(edge[rows]) :] if edge[rows].any() else rows[:0]
        near = near[np.abs(self._z_m[near] - self._z_m[near[:1]]) < BLUR_M]
        return float(self._z_m[near[np.argmax(found[near])]]) if len(near) else none


def _is_wall(one: SpatialSurface) -> bool:
    upright = one.shapes[one.leader] == PLANE and abs(one.states[one.leader, 3]) < LEVEL
    return bool(upright and one.log_odds >= SURE_ODDS and one.share >= SURE_SHARE)
