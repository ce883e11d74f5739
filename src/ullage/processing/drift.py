"""Slow drift of the poses, found from flat walls: if a flat wall seems to bend, the poses are wrong."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from ullage.arrays import Floats, Longs
from ullage.data import Frames, Recording, Trajectory, sensors_of
from ullage.errors import InputError, UllageWarning
from ullage.processing.coherent import EchoJudge
from ullage.processing.drift_walls import LEAST_KEYFRAMES, WINDOW_S, FlatEchoes, Offset, Peaks, WallFit
from ullage.processing.inverse_sensor import heard_deg
from ullage.processing.mapper_looks import Listener, Look, lit_ways
from ullage.processing.mapper_runs import fit_edges, fit_walls

TRUSTED = 0.8
LINK_S, LINK_M, LINK_TURN = 0.8, 0.07, 0.9
FLAT_RAD, SCATTER_RAD = 0.25, 0.2
EDGE_BETTER, EDGE_REACH_M, EDGE_EVERY = 0.7, 1.2, 6
LEAST_ECHOES = 40
HARMLESS_M = 0.03
LEAST_AGREEMENT = 0.7  # of keyframes facing a wall, in every window of time


@dataclass(frozen=True, slots=True, eq=False)
class DriftCorrection:
    """Frames with or without the slow error of their poses, and the estimate of that error."""

    frames: dict[str, Frames]
    corrected: bool  # whether the poses were moved
    reason: str  # for the user
    t_s: Floats  # (k) [s], of the frames' clock
    offset_m: Floats  # (k, 2) added to the horizontal positions; zero where the input is kept
    sigma_m: Floats  # (k, 2) standard deviation of the remaining error on each axis


def correct_drift(frames: Recording, *, drift_m: float = 0.2, time_s: float = 5.0) -> DriftCorrection:
    """Correct the slow error of the horizontal positions of frames from echoes of flat walls.

    Echoes that keep one bearing during the flight come from flat walls. One smooth offset of the track and all
    walls' directions and distances are found together, so that every echo's range fits its wall: a spline with a
    Gaussian-process prior, solved by Gauss-Newton with weights that leave outliers aside [Rasmussen2006]. Then every
    peak near the range that a wall should have counts, so that the walls ahead and behind fix the position along the
    track. No angle between walls is assumed.

    The input is kept, with a warning, where the walls do not determine the offset: fewer than two directions of walls
    echo, the fit slips against them (in some window of 1.5 s fewer than 70 % of the keyframes that face a wall hold its
    echo), or the offset is smaller than its standard deviation. It is also kept where the offset is under 3 cm (rms).

    Turning track and walls together changes no range of a point on a straight path. Two assumptions fix the turn: the
    offset is smooth at corners of the flight, and the attitude and the mounts of the sensors are true.

    Args:
        frames: one sensor's, or several on one body, with poses.
        drift_m: sigma of the drift, of each axis [m].
        time_s: its correlation time [s].

    Returns:
        The frames, whether they were corrected and why, and the standard deviation of the error that is left.

    Raises:
        InputError: no poses, or a prior that is not above zero.
    """
    if not (math.isfinite(drift_m) and drift_m > 0 and math.isfinite(time_s) and time_s > 0):
        raise InputError(f"drift_m {drift_m}, time_s {time_s}", where="correct_drift", allowed="> 0")
    parts = sensors_of(frames)
    by_name = {part.sensor: part for part in parts}
    offset = wall_offset(parts, drift_m, time_s)
    return kept(by_name, offset, drift_m) if isinstance(offset, str) else _decided(by_name, offset, drift_m)


def wall_offset(parts: list[Frames], drift_m: float, time_s: float) -> Offset | str:
    """Fit an offset to the echoes of flat walls, however sure it is; or say why there is none."""
    keyframes = {part.sensor: _keyframes(part) for part in parts}
    echoes = _flat_echoes(parts, keyframes)
    if len(echoes.t_s) < LEAST_ECHOES:
        return f"{len(echoes.t_s)} echoes of flat walls, {LEAST_ECHOES} wanted"
    offset = WallFit(echoes, drift_m, time_s).solve(_peaks(list(chain.from_iterable(keyframes.values()))))
    return "walls echo from fewer than two directions" if offset is None else offset


def _decided(by_name: dict[str, Frames], offset: Offset, drift_m: float) -> DriftCorrection:
    """Return the frames moved by an offset, or kept if the offset is unsure or negligible."""
    size, doubt = (float(np.sqrt((part**2).sum(1).mean())) for part in (offset.offset_m, offset.sigma_m))
    if offset.agreement < LEAST_AGREEMENT:
        lost = f"for {WINDOW_S} s the fit misses {100 * (1 - offset.agreement):.0f} % of the walls' echoes"
        return kept(by_name, lost, drift_m)
    if size < HARMLESS_M:
        found = f"the poses are within {1e3 * size:.0f} mm of the walls"
        return DriftCorrection(by_name, False, found, offset.t_s, 0 * offset.offset_m, offset.sigma_m + size)
    if size < doubt:
        return kept(by_name, f"an offset of {1e3 * size:.0f} mm is known to {1e3 * doubt:.0f} mm only", drift_m)
    done = f"moved by {1e3 * size:.0f} mm (rms), known to {1e3 * doubt:.0f} mm"
    moved = {name: _moved(part, offset) for name, part in by_name.items()}
    return DriftCorrection(moved, True, done, offset.t_s, offset.offset_m, offset.sigma_m)


def kept(frames: dict[str, Frames], reason: str, drift_m: float) -> DriftCorrection:
    """Return the input unchanged, and warn with the reason."""
    warnings.warn(f"drift is not corrected: {reason}; the poses are kept", UllageWarning, stacklevel=4)
    path = next(iter(frames.values())).believed
    t_s = np.asarray(path.t_ns[[0, -1]] * 1e-9, np.float64)
    return DriftCorrection(frames, False, reason, t_s, np.zeros((2, 2)), np.full((2, 2), drift_m))


def _moved(frames: Frames, offset: Offset) -> Frames:
    path = frames.believed
    shift = offset.at(np.asarray(path.t_ns * 1e-9, np.float64))
    position = path.position + np.column_stack([shift, np.zeros(len(shift))])
    return replace(frames, poses=Trajectory(path.t_ns, position, path.quat_xyzw))


def _keyframes(part: Frames) -> list[Look]:
    bin_m = float(part.range_m[-1] - part.range_m[0]) / (len(part.range_m) - 1)
    listener = Listener(float(part.range_m[0]), bin_m, part.spec.wavelength_m)
    return [*listener.hear(part), *listener.flush()]


def _peaks(keyframes: list[Look]) -> Peaks:
    """Return all peaks of these keyframes."""
    keyframes = sorted(keyframes, key=lambda keyframe: keyframe.heard.t_ns)
    which = np.repeat(np.arange(len(keyframes)), [len(keyframe.echoes) for keyframe in keyframes])
    return Peaks(
        np.array([keyframe.heard.t_ns * 1e-9 for keyframe in keyframes])[which],
        np.array([keyframe.heard.position[:2] for keyframe in keyframes])[which],
        np.array([keyframe.heard.axes[:2, 0] for keyframe in keyframes])[which],
        np.concatenate([keyframe.echoes[:, 0] for keyframe in keyframes]),
        which,
    )


def _flat_echoes(parts: list[Frames], keyframes: dict[str, list[Look]]) -> FlatEchoes:
    rows, first = [], 0
    for part in parts:
        mine = _trusted_echoes(part, keyframes[part.sensor])
        if len(mine):
            track = _linked(mine)
            rows.append(np.column_stack([mine, track + first]))
            first += int(track.max()) + 1
    table = np.concatenate(rows) if rows else np.zeros((0, 7))
    table = table[np.argsort(table[:, 0], kind="stable")]
    echoes = FlatEchoes(table[:, 0], table[:, 1:3], table[:, 3:5], table[:, 5], table[:, 6].astype(np.int64))
    flat = np.zeros(len(table), bool)
    for track in np.unique(echoes.track):
        mine = echoes.track == track
        run = echoes.only(mine)
        flat[mine] = _is_flat(run.t_s, run.direction) and not is_edge(run)
    return echoes.only(flat)


def _trusted_echoes(part: Frames, keyframes: list[Look]) -> Floats:
    """Rows (n, 6) of one sensor: time [s], position (2), direction (2), range."""
    judge, rows = EchoJudge(), []
    least = math.cos(math.radians(heard_deg(part.spec.antenna)[0]))
    for keyframe in keyframes:
        if not keyframe.track.any():
            continue
        sensor, (cosine, _, trust) = keyframe.heard, judge.weigh(keyframe)
        for k in np.flatnonzero(trust > TRUSTED):
            directions = lit_ways(sensor.axes, keyframe.track, float(np.clip(cosine[k], -1, 1)), least)
            if len(directions) == 1:
                rows.append([sensor.t_ns * 1e-9, *sensor.position[:2], *directions[0][:2], keyframe.echoes[k, 0]])
    return np.array(rows).reshape(-1, 6)


def _linked(rows: Floats) -> Longs:
    """Return the run of echoes of each row of one sensor: within a run, range and bearing follow the motion."""
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


def _is_flat(t_s: Floats, direction: Floats) -> bool:
    """Return whether the bearing of a run of echoes is constant; that of a pole or a corner changes with motion."""
    if len(t_s) < LEAST_KEYFRAMES:
        return False
    angle = np.unwrap(np.arctan2(direction[:, 1], direction[:, 0]))
    time = t_s - t_s.mean()
    turn = abs(time @ angle) / max(float(time @ time), 1e-9) * np.ptp(time)
    return bool(turn <= FLAT_RAD and angle.std() <= SCATTER_RAD)


def is_edge(run: FlatEchoes) -> bool:
    """Whether the ranges of metre-long pieces fit an upright edge or a corner much better than a wall."""
    middles = range(min(len(run.t_s), EDGE_EVERY) // 2, len(run.t_s), EDGE_EVERY)
    edges = 0
    for k in middles:
        near = np.linalg.norm(run.position - run.position[k], axis=1) < EDGE_REACH_M
        at = np.column_stack([run.position[near] - run.position[k], run.range_m[near]])[None]
        use, direction = np.ones((1, int(near.sum()))), run.direction[near].mean(0)[None]
        reach, direction = run.range_m[k : k + 1], direction / np.linalg.norm(direction)
        edges += int(fit_edges(at, use, reach, direction)[2][0] < EDGE_BETTER * fit_walls(at, use, reach, direction)[0])
    return edges > 0.5 * len(middles)
