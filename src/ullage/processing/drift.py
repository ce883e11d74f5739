"""Slow drift of the poses, found from flat walls: a wall that bends as the drone flies past it tells of the drone."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ullage.data import Frames, Recording, Trajectory, sensors_of
from ullage.errors import InputError
from ullage.processing.coherent import EchoJudge
from ullage.processing.inverse_sensor import heard_deg
from ullage.processing.mapper_looks import Listener, lit_ways

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

TRUSTED = 0.8
KNOT_S = 1.5
LINK_S, LINK_M, LINK_TURN = 0.8, 0.07, 0.9
LEAST_LOOKS, FLAT_RAD, SCATTER_RAD = 6, 0.25, 0.2
SAME_WALL_RAD, SAME_WALL_M, OTHER_WALL_M = 0.3, 0.45, 0.08
RANGE_SIGMA_M, SHARED_LOOKS = 0.02, 8
SQUARE_RAD, SQUARE_SIGMA_RAD = 0.17, 0.02
ROUNDS, SPLIT_ROUND = 12, 5
LEAST_WALLS, LEAST_ECHOES = 2, 40
HARMLESS_M = 0.03


def correct_drift(frames: Recording, *, drift_m: float = 0.2, time_s: float = 5.0) -> dict[str, Frames]:
    """The frames with the slow error of their horizontal positions taken out, as far as flat walls show it.

    Echoes that keep one bearing while the drone flies on come off flat walls. One smooth offset of the track and all
    walls' directions and distances are found together, so that every echo's range fits its wall: a spline with a
    Gaussian-process prior, solved by Gauss-Newton with weights that leave outliers aside [Rasmussen2006]. Walls that
    stand within 10 deg of square or parallel to the main one are taken to be so. Where fewer than two directions of
    walls are heard, or the offset stays within 3 cm throughout, the frames come back as they were.

    What ranges cannot tell, whatever the method: turning track and walls together by a small angle changes no range.
    That part of the drift stays, held down by the prior alone.

    Args:
        frames: one sensor's, or several on one body, with poses.
        drift_m: sigma of the drift, of each axis [m].
        time_s: its correlation time [s].

    Raises:
        InputError: no poses, or a prior that is not above zero.
    """
    if not (math.isfinite(drift_m) and drift_m > 0 and math.isfinite(time_s) and time_s > 0):
        raise InputError(f"drift_m {drift_m}, time_s {time_s}", where="correct_drift", allowed="> 0")
    parts = sensors_of(frames)
    heard = _flat_echoes(parts)
    by_name = {part.sensor: part for part in parts}
    if len(heard.t_s) < LEAST_ECHOES:
        return by_name
    offset = _Walls(heard, drift_m, time_s).solve()
    if offset is None:
        return by_name
    return {name: _moved(part, offset) for name, part in by_name.items()}


def _moved(frames: Frames, offset: CubicSpline) -> Frames:
    path = frames.believed
    time = np.clip(path.t_ns * 1e-9, offset.x[0], offset.x[-1])
    position = path.position + np.column_stack([offset(time), np.zeros(len(time))])
    return replace(frames, poses=Trajectory(path.t_ns, position, path.quat_xyzw))


@dataclass(frozen=True, slots=True, eq=False)
class _FlatEchoes:
    """Echoes off flat walls, in order of time, each with the track of echoes that it belongs to."""

    t_s: Floats  # (n)
    position: Floats  # (n, 2) of the sensor [m]
    way: Floats  # (n, 2) unit vectors to the wall
    range_m: Floats  # (n)
    track: Ints  # (n)

    def only(self, keep: NDArray[np.bool_]) -> _FlatEchoes:
        return _FlatEchoes(self.t_s[keep], self.position[keep], self.way[keep], self.range_m[keep], self.track[keep])


def _flat_echoes(parts: list[Frames]) -> _FlatEchoes:
    rows, first = [], 0
    for part in parts:
        mine = _trusted_echoes(part)
        if len(mine):
            track = _linked(mine)
            rows.append(np.column_stack([mine, track + first]))
            first += int(track.max()) + 1
    table = np.concatenate(rows) if rows else np.zeros((0, 7))
    table = table[np.argsort(table[:, 0], kind="stable")]
    heard = _FlatEchoes(table[:, 0], table[:, 1:3], table[:, 3:5], table[:, 5], table[:, 6].astype(np.int64))
    flat = np.zeros(len(table), bool)
    for track in np.unique(heard.track):
        mine = heard.track == track
        flat[mine] = _is_flat(heard.t_s[mine], heard.way[mine])
    return heard.only(flat)


def _trusted_echoes(part: Frames) -> Floats:
    """Rows (n, 6) of one sensor: time [s], position (2), way (2), range."""
    bin_m = float(part.range_m[-1] - part.range_m[0]) / (len(part.range_m) - 1)
    listener, judge = Listener(float(part.range_m[0]), bin_m, part.spec.wavelength_m), EchoJudge()
    least, rows = math.cos(math.radians(heard_deg(part.spec.antenna)[0])), []
    for look in [*listener.hear(part), *listener.flush()]:
        if not look.track.any():
            continue
        cosine, _, trust = judge.weigh(look)
        for k in np.flatnonzero(trust > TRUSTED):
            ways = lit_ways(look.heard.axes, look.track, float(np.clip(cosine[k], -1, 1)), least)
            if len(ways) == 1:
                rows.append([look.heard.t_ns * 1e-9, *look.heard.position[:2], *ways[0][:2], look.echoes[k, 0]])
    return np.array(rows).reshape(-1, 6)


def _linked(rows: Floats) -> Ints:
    """Which run of echoes each of one sensor's rows continues: range and bearing go on as the motion says."""
    ends: dict[int, int] = {}
    track, count = np.zeros(len(rows), np.int64), 0
    for i, row in enumerate(rows):
        ends = {k: j for k, j in ends.items() if row[0] - rows[j, 0] < LINK_S}
        best, least = -1, LINK_M
        for k, j in ends.items():
            last = rows[j]
            miss = abs(row[5] - last[5] + (row[1:3] - last[1:3]) @ last[3:5])
            if miss < least and last[3:5] @ row[3:5] > LINK_TURN:
                best, least = k, miss
        if best < 0:
            best, count = count, count + 1
        track[i] = best
        ends[best] = i
    return track


def _is_flat(t_s: Floats, way: Floats) -> bool:
    """Whether the bearing of a run of echoes stays the same: that of a pole or a corner turns as one flies past."""
    if len(t_s) < LEAST_LOOKS:
        return False
    angle = np.unwrap(np.arctan2(way[:, 1], way[:, 0]))
    time = t_s - t_s.mean()
    turn = abs(time @ angle) / max(float(time @ time), 1e-9) * np.ptp(time)
    return bool(turn <= FLAT_RAD and angle.std() <= SCATTER_RAD)


class _Walls:
    """One smooth offset of the track and all walls, fitted together."""

    def __init__(self, heard: _FlatEchoes, drift_m: float, time_s: float) -> None:
        self._heard = heard
        first, last = heard.t_s[0], heard.t_s[-1]
        self._knots = np.linspace(first, max(last, first + KNOT_S), max(4, math.ceil((last - first) / KNOT_S) + 1))
        count = len(self._knots)
        self._basis = CubicSpline(self._knots, np.eye(count))(heard.t_s)
        apart = (self._knots[:, None] - self._knots) / time_s
        since = np.eye(count)
        since[:, 0] -= 1  # the offset counts from the flight's first moment
        covariance = since @ (drift_m**2 * np.exp(-0.5 * apart**2)) @ since.T
        self._prior = np.linalg.inv(covariance + 1e-4 * drift_m**2 * np.eye(count))
        self._offset = np.zeros((count, 2))
        self._wall = self._grouped()
        self._start()

    def _grouped(self) -> Ints:
        """Runs of echoes whose walls nearly coincide as heard are of one wall."""
        heard, wall = self._heard, np.zeros(len(self._heard.t_s), np.int64)
        walls: list[tuple[float, list[Floats]]] = []
        for track in np.unique(heard.track):
            mine = heard.track == track
            way = heard.way[mine].mean(0)
            foot = (heard.position[mine] + heard.range_m[mine, None] * heard.way[mine]).mean(0)
            angle, best, least = math.atan2(way[1], way[0]), -1, SAME_WALL_M
            for k, (other, feet) in enumerate(walls):
                if abs(math.remainder(angle - other, 2 * math.pi)) < SAME_WALL_RAD:
                    gap = abs((np.mean(feet, axis=0) - foot) @ [math.cos(other), math.sin(other)])
                    if gap < least:
                        best, least = k, float(gap)
            if best < 0:
                best = len(walls)
                walls.append((angle, []))
            walls[best][1].append(foot)
            wall[mine] = best
        return wall

    def _start(self) -> None:
        """Walls as the echoes' own bearings give them."""
        heard, count = self._heard, int(self._wall.max()) + 1
        at = heard.position + self._basis @ self._offset
        self._angle, self._distance = np.zeros(count), np.zeros(count)
        for k in range(count):
            mine = self._wall == k
            if mine.any():
                way = heard.way[mine].sum(0)
                self._angle[k] = math.atan2(way[1], way[0])
                normal = np.array([math.cos(self._angle[k]), math.sin(self._angle[k])])
                self._distance[k] = np.median(at[mine] @ normal + heard.range_m[mine])

    def solve(self) -> CubicSpline | None:
        """The offset over time (2) [m], or None where it says nothing."""
        if not self._heard_crosswise():
            return None
        for turn in range(ROUNDS):
            miss = self._improve(RANGE_SIGMA_M * (4 if turn < 3 else 1))
            if turn == SPLIT_ROUND:
                self._split(miss)
        if np.linalg.norm(self._offset, axis=1).max() < HARMLESS_M:
            return None
        return CubicSpline(self._knots, self._offset)

    def _heard_crosswise(self) -> bool:
        """Whether walls in two directions speak: one alone cannot tell where along it the drone is."""
        count = np.bincount(self._wall)
        axis = self._angle[count >= LEAST_LOOKS] * 2
        if len(axis) < LEAST_WALLS:
            return False
        return bool(np.max(abs(np.sin((axis[:, None] - axis) / 2))) > 0.5)

    def _improve(self, sigma: float) -> Floats:
        """One Gauss-Newton step; returns what each echo's range missed its wall by."""
        heard, wall, m, k = self._heard, self._wall, len(self._knots), len(self._angle)
        normal = np.column_stack([np.cos(self._angle[wall]), np.sin(self._angle[wall])])
        at = heard.position + self._basis @ self._offset
        miss = heard.range_m - self._distance[wall] + (normal * at).sum(1)
        weight = 1 / (1 + (miss / (3 * sigma)) ** 2) ** 2 / (SHARED_LOOKS * sigma**2)
        slope = np.zeros((len(miss), 2 * (m + k)))
        slope[:, :m], slope[:, m : 2 * m] = -self._basis * normal[:, :1], -self._basis * normal[:, 1:]
        row = np.arange(len(miss))
        slope[row, 2 * m + wall] = normal[:, 1] * at[:, 0] - normal[:, 0] * at[:, 1]
        slope[row, 2 * m + k + wall] = 1
        matrix, right = (slope * weight[:, None]).T @ slope, (slope * weight[:, None]).T @ miss
        for axis in (0, 1):
            part = slice(axis * m, (axis + 1) * m)
            matrix[part, part] += self._prior
            right[part] -= self._prior @ self._offset[:, axis]
            matrix[axis * m, axis * m] += 1e6
        matrix[np.arange(2 * m, 2 * (m + k)), np.arange(2 * m, 2 * (m + k))] += 1e-3
        self._square_up(matrix, right, 2 * m)
        step = np.linalg.solve(matrix, right)
        self._offset = self._offset + step[: 2 * m].reshape(2, m).T
        self._angle = self._angle + np.clip(step[2 * m : 2 * m + k], -0.2, 0.2)
        self._distance = self._distance + step[2 * m + k :]
        return np.asarray(miss, np.float64)

    def _square_up(self, matrix: Floats, right: Floats, first: int) -> None:
        """Walls nearly square or parallel to the one heard most are taken to be so."""
        count = np.bincount(self._wall, minlength=len(self._angle))
        main = int(np.argmax(count))
        for k in np.flatnonzero(count):
            off = math.remainder(self._angle[k] - self._angle[main], math.pi / 2)
            if k != main and abs(off) < SQUARE_RAD:
                pull = np.zeros(len(right))
                pull[first + k], pull[first + main] = 1 / SQUARE_SIGMA_RAD, -1 / SQUARE_SIGMA_RAD
                matrix += np.outer(pull, pull)
                right -= pull * off / SQUARE_SIGMA_RAD

    def _split(self, miss: Floats) -> None:
        """Runs of echoes that do not fit their wall get one of their own; then all walls start anew."""
        count = int(self._wall.max()) + 1
        for track in np.unique(self._heard.track):
            mine = self._heard.track == track
            if abs(np.median(miss[mine])) > OTHER_WALL_M:
                self._wall[mine], count = count, count + 1
        self._start()
