"""Flat walls and one smooth offset of the track, fitted together so that every range fits its wall."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from ullage.arrays import Bools, Floats, Longs

KNOT_S = 1.0
LEAST_KEYFRAMES = 6
SAME_WALL_RAD, SAME_WALL_M, OTHER_WALL_M = 0.3, 0.45, 0.08
WALL_RANGE_SIGMA_M, SHARED_KEYFRAMES = 0.02, 2  # sigma of a wall's range [m]; keyframes that share frames
ROUNDS, SPLIT_ROUND = 12, 5
LEAST_WALLS = 2
SURE_ECHOES, WINDOW_S, IN_SIGHT = 15, 1.5, 0.5
ONE_WALL_RAD, ONE_WALL_M = 0.1, 0.1
# How far a peak may lie from what a wall's range should be, how well those of one window agree, and their sigma [m].
NEARER = ((0.45, 0.05, 0.03), (0.3, 0.05, 0.02), (0.15, 0.04, 0.01), (0.08, 0.03, 0.005), (0.04, 0.03, 0.003))
STEPS = 4
FACING, HIT_M, MAIN_SHARE = 0.85, 0.02, 0.5
BIAS_M = 0.01  # systematic error of a range: of the bin, the pulse and the wall's evenness
MOST_ROWS = 4096


@dataclass(frozen=True, slots=True, eq=False)
class FlatEchoes:
    """Echoes off flat walls, in order of time, each with the run of echoes that it belongs to."""

    t_s: Floats  # (n)
    position: Floats  # (n, 2) of the sensor [m]
    direction: Floats  # (n, 2) unit vectors to the wall
    range_m: Floats  # (n)
    track: Longs  # (n)

    def only(self, keep: Bools) -> FlatEchoes:
        """Return the echoes to keep."""
        return FlatEchoes(
            self.t_s[keep], self.position[keep], self.direction[keep], self.range_m[keep], self.track[keep]
        )


@dataclass(frozen=True, slots=True, eq=False)
class Peaks:
    """All peaks of all keyframes, in order of time."""

    t_s: Floats  # (n)
    position: Floats  # (n, 2) of the sensor [m]
    ahead: Floats  # (n, 2) its boresight
    range_m: Floats  # (n)
    keyframe: Longs  # (n) index of the keyframe that holds it


@dataclass(frozen=True, slots=True, eq=False)
class Offset:
    """Smooth offset of a track, and how well the walls determine it."""

    t_s: Floats  # (k) knots
    offset_m: Floats  # (k, 2) at the knots, to be added to the positions
    sigma_m: Floats  # (k, 2) standard deviation of each axis
    agreement: float  # least share of keyframes facing a wall that hold its echo, over windows of 1.5 s

    def at(self, t_s: Floats) -> Floats:
        """Return the offset (n, 2) [m] at times (n) [s]; outside the knots, that of the nearest knot."""
        return np.asarray(CubicSpline(self.t_s, self.offset_m)(np.clip(t_s, self.t_s[0], self.t_s[-1])))


class WallFit:
    """One smooth offset of the track and all walls, fitted together.

    The first rounds use the echoes whose bearings identify their wall. Later rounds use every peak near the expected
    range of a wall, in all directions of flight, so that walls ahead and behind fix the position along the track.

    Args:
        echoes: echoes off flat walls.
        drift_m: sigma of the drift, of each axis [m].
        time_s: its correlation time [s].
    """

    def __init__(self, echoes: FlatEchoes, drift_m: float, time_s: float) -> None:
        self._echoes = echoes
        first, last = echoes.t_s[0], echoes.t_s[-1]
        self._knots = np.linspace(first, max(last, first + KNOT_S), max(4, math.ceil((last - first) / KNOT_S) + 1))
        count = len(self._knots)
        self._basis = self._basis_at(echoes.t_s)
        apart = (self._knots[:, None] - self._knots) / time_s
        since = np.eye(count)
        since[:, 0] -= 1  # the offset counts from the flight's first moment
        covariance = since @ (drift_m**2 * np.exp(-0.5 * apart**2)) @ since.T
        self._prior = np.linalg.inv(covariance + 1e-4 * drift_m**2 * np.eye(count))
        self._offset = np.zeros((count, 2))
        self._wall = self._grouped()
        self._start()

    def solve(self, peaks: Peaks) -> Offset | None:
        """Find the offset over time, or None where walls in too few directions echo."""
        if not self._walls_in_two_directions():
            return None
        for turn in range(ROUNDS):
            miss = self._improve(WALL_RANGE_SIGMA_M * (4 if turn < 3 else 1))
            if turn == SPLIT_ROUND:
                self._split(miss)
        for reach, agree, sigma in NEARER:
            if not self._observe(peaks, reach, agree):
                break
            for _ in range(STEPS):
                self._improve(sigma)
        return Offset(self._knots, self._offset, self._sigma(), self._agreement(peaks))

    def _sigma(self) -> Floats:
        """Standard deviation (k, 2) of the offset at the knots [m], walls and their turn left free.

        The ranges' scatter counts as independent between windows, a systematic error of 1 cm in full.
        """
        _, _, miss = self._normal_equations(NEARER[-1][2])
        scatter = max(float(np.sqrt(np.mean(miss**2))), NEARER[-1][2])
        matrix, _, _ = self._normal_equations(scatter)
        m = len(self._knots)
        variance = np.diag(np.linalg.inv(matrix))[: 2 * m].reshape(2, m).T
        return np.sqrt(variance + BIAS_M**2)

    def _agreement(self, peaks: Peaks) -> float:
        """Least share, over windows of time, of keyframes facing a wall that hold an echo at its range.

        Only walls count that echo in most keyframes facing them over the flight. A track that slips against a wall
        loses its echoes for that time.
        """
        at = peaks.position + self._basis_at(peaks.t_s) @ self._offset
        window = np.floor((peaks.t_s - peaks.t_s[0]) / WINDOW_S).astype(int)
        hits, facing = np.zeros((2, int(window.max(initial=0)) + 1))
        for k in self._sure_walls():
            normal = np.array([math.cos(self._angle[k]), math.sin(self._angle[k])])
            rows = np.flatnonzero(peaks.ahead @ normal > FACING)
            frame, first, which = np.unique(peaks.keyframe[rows], return_index=True, return_inverse=True)
            near = abs(peaks.range_m[rows] + at[rows] @ normal - self._distance[k]) < HIT_M
            hit = np.zeros(len(frame), bool)
            np.logical_or.at(hit, which, near)
            if len(frame) and hit.mean() > MAIN_SHARE:
                np.add.at(hits, window[rows[first]], hit)
                np.add.at(facing, window[rows[first]], 1)
        asked = facing >= LEAST_KEYFRAMES
        return float((hits[asked] / facing[asked]).min()) if asked.any() else 0.0

    def _basis_at(self, t_s: Floats) -> Floats:
        inside = np.clip(t_s, self._knots[0], self._knots[-1])
        return np.asarray(CubicSpline(self._knots, np.eye(len(self._knots)))(inside))

    def _grouped(self) -> Longs:
        """Group runs of echoes whose walls nearly coincide before the fit."""
        echoes, wall = self._echoes, np.zeros(len(self._echoes.t_s), np.int64)
        walls: list[tuple[float, list[Floats]]] = []
        for track in np.unique(echoes.track):
            mine = echoes.track == track
            direction = echoes.direction[mine].mean(0)
            point = (echoes.position[mine] + echoes.range_m[mine, None] * echoes.direction[mine]).mean(0)
            angle, best, least = math.atan2(direction[1], direction[0]), -1, SAME_WALL_M
            for k, (other, points) in enumerate(walls):
                if abs(math.remainder(angle - other, 2 * math.pi)) < SAME_WALL_RAD:
                    gap = abs((np.mean(points, axis=0) - point) @ [math.cos(other), math.sin(other)])
                    if gap < least:
                        best, least = k, float(gap)
            if best < 0:
                best = len(walls)
                walls.append((angle, []))
            walls[best][1].append(point)
            wall[mine] = best
        return wall

    def _start(self) -> None:
        """Set the walls from the bearings of the echoes."""
        echoes, count = self._echoes, int(self._wall.max()) + 1
        at = echoes.position + self._basis @ self._offset
        self._angle, self._distance = np.zeros(count), np.zeros(count)
        for k in range(count):
            mine = self._wall == k
            if mine.any():
                direction = echoes.direction[mine].sum(0)
                self._angle[k] = math.atan2(direction[1], direction[0])
                normal = np.array([math.cos(self._angle[k]), math.sin(self._angle[k])])
                self._distance[k] = np.median(at[mine] @ normal + echoes.range_m[mine])

    def _walls_in_two_directions(self) -> bool:
        """Whether walls in two directions echo: one alone leaves the position along it unknown."""
        count = np.bincount(self._wall)
        axis = self._angle[count >= LEAST_KEYFRAMES] * 2
        if len(axis) < LEAST_WALLS:
            return False
        return bool(np.max(abs(np.sin((axis[:, None] - axis) / 2))) > 0.5)

    def _improve(self, sigma: float) -> Floats:
        """Make one Gauss-Newton step; return the misfit of each echo's range to its wall [m]."""
        m, k = len(self._knots), len(self._angle)
        matrix, right, miss = self._normal_equations(sigma)
        step = np.linalg.solve(matrix, right)
        self._offset = self._offset + step[: 2 * m].reshape(2, m).T
        self._angle = self._angle + np.clip(step[2 * m : 2 * m + k], -0.2, 0.2)
        self._distance = self._distance + step[2 * m + k :]
        return miss

    def _normal_equations(self, sigma: float) -> tuple[Floats, Floats, Floats]:
        """Information (p, p) and gradient (p) about knots, angles and distances, and the misfit of each range (n)."""
        echoes, wall, m, k = self._echoes, self._wall, len(self._knots), len(self._angle)
        normal = np.column_stack([np.cos(self._angle[wall]), np.sin(self._angle[wall])])
        at = echoes.position + self._basis @ self._offset
        miss = echoes.range_m - self._distance[wall] + (normal * at).sum(1)
        weight = 1 / (1 + (miss / (3 * sigma)) ** 2) ** 2 / (SHARED_KEYFRAMES * sigma**2)
        matrix, right = np.zeros((2 * (m + k), 2 * (m + k))), np.zeros(2 * (m + k))
        for start in range(0, len(miss), MOST_ROWS):  # a long flight's slopes at once would not fit in memory
            rows = slice(start, start + MOST_ROWS)
            slope = self._slope(self._basis[rows], normal[rows], at[rows], wall[rows])
            matrix += (slope * weight[rows, None]).T @ slope
            right += (slope * weight[rows, None]).T @ miss[rows]
        for axis in (0, 1):
            part = slice(axis * m, (axis + 1) * m)
            matrix[part, part] += self._prior
            right[part] -= self._prior @ self._offset[:, axis]
            matrix[axis * m, axis * m] += 1e6
        matrix[np.arange(2 * m, 2 * (m + k)), np.arange(2 * m, 2 * (m + k))] += 1e-3
        return matrix, right, np.asarray(miss, np.float64)

    def _slope(self, basis: Floats, normal: Floats, at: Floats, wall: Longs) -> Floats:
        """Return the negative slope of each misfit over knots of the offset, and angles and distances of the walls."""
        m, k, row = basis.shape[1], len(self._angle), np.arange(len(at))
        slope = np.zeros((len(at), 2 * (m + k)))
        slope[:, :m], slope[:, m : 2 * m] = -basis * normal[:, :1], -basis * normal[:, 1:]
        slope[row, 2 * m + wall] = normal[:, 1] * at[:, 0] - normal[:, 0] * at[:, 1]
        slope[row, 2 * m + k + wall] = 1
        return slope

    def _split(self, miss: Floats) -> None:
        """Give each run of echoes that misses its wall a new wall; then estimate all walls again."""
        count = int(self._wall.max()) + 1
        for track in np.unique(self._echoes.track):
            mine = self._echoes.track == track
            if abs(np.median(miss[mine])) > OTHER_WALL_M:
                self._wall[mine], count = count, count + 1
        self._start()

    def _observe(self, peaks: Peaks, reach: float, agree: float) -> bool:
        """Use the peaks that fit the walls as their echoes; return whether there are any.

        The peaks of a wall miss it by nearly the same range through a window; other peaks scatter. So the misfit where
        most peaks agree belongs to the wall, even if the error of the track is much larger than that agreement.
        """
        at = peaks.position + self._basis_at(peaks.t_s) @ self._offset
        turn = np.floor((peaks.t_s - peaks.t_s[0]) / WINDOW_S).astype(int)
        rows, walls = [], []
        for k in self._sure_walls():
            normal = np.array([math.cos(self._angle[k]), math.sin(self._angle[k])])
            miss = peaks.range_m + at @ normal - self._distance[k]
            near = np.flatnonzero((abs(miss) < reach) & (peaks.ahead @ normal > IN_SIGHT))
            for window in np.split(near, np.flatnonzero(np.diff(turn[near])) + 1):
                off = miss[window]
                votes = np.exp(-0.5 * ((off[:, None] - off) / (agree / 2)) ** 2).sum(1)
                votes *= np.exp(-0.5 * (off / (0.5 * reach)) ** 2)
                mine = window[abs(off - off[np.argmax(votes)]) < agree] if len(window) else window
                if len(mine) >= LEAST_KEYFRAMES:
                    rows.append(mine)
                    walls.append(np.full(len(mine), k))
        if not rows:
            return False
        row, wall = np.concatenate(rows), np.concatenate(walls)
        direction = np.column_stack([np.cos(self._angle[wall]), np.sin(self._angle[wall])])
        self._echoes = FlatEchoes(peaks.t_s[row], peaks.position[row], direction, peaks.range_m[row], wall)
        self._wall, self._basis = wall, self._basis_at(peaks.t_s[row])
        return True

    def _sure_walls(self) -> list[int]:
        """Return the walls with enough echoes, most echoes first; walls that coincide count once."""
        count, kept = np.bincount(self._wall, minlength=len(self._angle)), list[int]()
        for k in np.argsort(-count, kind="stable"):
            twin = any(
                abs(math.remainder(self._angle[k] - self._angle[j], 2 * math.pi)) < ONE_WALL_RAD
                and abs(self._distance[k] - self._distance[j]) < ONE_WALL_M
                for j in kept
            )
            if count[k] >= SURE_ECHOES and not twin:
                kept.append(int(k))
        return kept
