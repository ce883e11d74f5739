"""Checks of a track for faults that no offset corrects: another scale, and mirrored or swapped axes.

On a track of another scale scatterers stay coherent over short parts only: the curvature of an echo's phase goes with
the square of the track's length, its delay does not. They are looked for anew at each scale, because those found at one
favour it. On a straight track scale and range offset trade: a scale of 1 % equals an offset of 2 % of the range.
Mirrored or swapped axes keep every range. Only directions of echoes on the body show them, if the mount is known.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ullage.arrays import Floats
from ullage.data import Frames, Trajectory
from ullage.errors import UllageWarning
from ullage.processing.point_focus import Point, PointFocus
from ullage.specs import MountSpec, RadarSpec

DECISIVE = 8.0  # difference of log-likelihoods: four standard deviations
LEAST_PROBABILITY = 0.95
STEP = 0.05  # between scales: the evidence on a flight is as wide
REACHES = 2, 5  # scales on either side of 1 that are tried, the second where the first do not decide
FINER = 2.0  # shorter parts of the track to draw scatterers from than for offsets: a scale hardly defocuses them
MOST_STARTS, MOST_RANGES = 16, 16
DISPERSION = 10.0  # of this evidence: between wrong scales the log-likelihood of scatterers drawn anew differs by 25
OPEN = "the echoes do not decide the scale of the track"
BROAD = 0.5  # extent of an axis over the longest from which on its own scale is checked
PIECES = 200  # straight pieces that a track's length is measured in
LINE = 0.1  # width of a track over its length below which directions round it, and so heights, are open
STRAIGHT = 0.02  # share of a track's length below which its extent shows no direction
TURNS = {
    "mirrored in x": np.diag([-1.0, 1, 1]),
    "mirrored in y": np.diag([1.0, -1, 1]),
    "mirrored in z": np.diag([1.0, 1, -1]),
    "with x and y swapped": np.eye(3)[[1, 0, 2]],
    "with x and z swapped": np.eye(3)[[2, 1, 0]],
    "with y and z swapped": np.eye(3)[[0, 2, 1]],
}


class TrackScale(NamedTuple):
    """How much larger than given the echoes take a track to be."""

    scale: float
    sigma: float
    off: float  # log-likelihood of the best scale over that of 1, which may have another range zero
    words: str  # what the echoes cannot tell, or nothing


def track_scale(frames: Frames, track: Trajectory, clock_s: float, ranges_m: Floats, log_prior: Floats) -> TrackScale:
    """Compare the evidence of scales of a track, under a clock offset [s] and a prior of range offsets (k) [m]."""
    likely = np.flatnonzero(log_prior > log_prior.max() - DECISIVE)
    open_zero = len(likely) == len(ranges_m)
    likely, zero_m = likely[:: max(1, len(likely) // MOST_RANGES)], float(ranges_m[log_prior.argmax()])

    def evidence(stretch: Floats) -> float:
        moved = Trajectory(track.t_ns, track.position @ stretch, track.quat_xyzw)
        gain = _coherence(PointFocus(frames, moved, clock_s, finer=FINER), clock_s, ranges_m[likely], zero_m)
        longer = _length(moved) / _length(track)  # as many samples at every scale
        return float(max(gain / longer / DISPERSION + log_prior[likely]))

    found: dict[int, float] = {}
    for reach in REACHES:
        for k in set(range(-reach, reach + 1)) - set(found):
            found[k] = evidence((1 + STEP) ** k * np.eye(3))
        value, scale = np.array(list(found.values())), (1 + STEP) ** np.array(list(found), float)
        share = np.exp(value - value.max()) / np.exp(value - value.max()).sum()
        decided = share[list(found).index(0)] >= LEAST_PROBABILITY
        if decided:
            break
    mean = float(share @ scale)
    off = float(value.max() - found[0])
    if off > DECISIVE:  # unless another range zero explains the echoes as well
        gain = _coherence(PointFocus(frames, track, clock_s, finer=FINER), clock_s, ranges_m, zero_m)
        off = float(value.max() - gain.max() / DISPERSION - log_prior.max())
    words = "" if decided else OPEN
    extent, axes = np.linalg.svd(track.position - track.position.mean(0), full_matrices=False)[1:]
    if off > DECISIVE and open_zero and extent[1] < LINE * extent[0]:  # scatterers at other heights bend echoes alike
        off, words = 0.0, f"{OPEN}: they fit one {mean:.2f} times as large, or scatterers at other heights"
    if decided and off <= DECISIVE and extent[1] > LINE * extent[0]:  # on a line, one scale is the other
        words = _stretched(evidence, found[0], axes[extent > BROAD * extent[0]])
    sigma = float(np.sqrt(share @ (scale - mean) ** 2 + (STEP * mean) ** 2 / 12))
    return TrackScale(mean, sigma, off, words)


def _stretched(evidence: Callable[[Floats], float], same: float, axes: Floats) -> str:
    """What the echoes do not decide of the scales along the axes (q, 3) of a track, the longest first."""
    for number, axis in enumerate(axes):
        scales = (1 + STEP) ** np.array([k for k in range(-REACHES[0], REACHES[0] + 1) if k], float)
        off = np.array([evidence(np.eye(3) + (scale - 1) * np.outer(axis, axis)) for scale in scales]) - same
        if 1 / (1 + np.exp(off).sum()) < LEAST_PROBABILITY:
            return f"{OPEN} {'across' if number else 'along'} its length"
    return ""


def _length(track: Trajectory) -> float:
    """Length of a track [m], without the noise of its poses."""
    return float(np.linalg.norm(np.diff(track.position[:: max(1, len(track) // PIECES)], axis=0), axis=1).sum())


def _coherence(focus: PointFocus, clock_s: float, ranges_m: Floats, zero_m: float) -> Floats:
    """Log-likelihoods (k) of the three most coherent scatterers at range offsets."""
    starts = focus.starts(clock_s, zero_m)[:MOST_STARTS]
    drawn = [focus.drawn(starts, clock_s, float(range_m)) for range_m in ranges_m]
    return np.array([sum(points[k].gain for k in focus.distinct(points, clock_s)[:3]) for points in drawn])


def track_axes(path: Floats, rotation: Floats, points: Sequence[Point], weight: Floats, spec: RadarSpec) -> str:
    """Compare a track with mirrored and swapped ones; return what a reader must know, and warn of what is suspected.

    Args:
        path: (n, 3) positions [m].
        rotation: (n, 3, 3) world_from_sensor.
        points: scatterers.
        weight: (n) of the frames.
        spec: of the radar; the two-way width of its antenna is the spread of directions to expect.
    """
    antenna = spec.antenna
    if spec.mount == MountSpec() or antenna.kind == "isotropic" or not points:
        return "the axes and attitudes of the track are unchecked, since no mount= was set"
    width = np.radians(max(antenna.azimuth_deg, antenna.elevation_deg)) / 2.355 / np.sqrt(2)
    misfit = {name: _misfit(path, rotation, points, weight, turn) for name, turn in {"": np.eye(3), **TURNS}.items()}
    spread = width**2 + np.radians(spec.mount.angle_sigma_deg) ** 2 + min(misfit.values()) / len(points)
    off = {name: (misfit[name] - misfit[""]) / (2 * spread) for name in TURNS}
    likelier = " or ".join(name for name in TURNS if off[name] < -DECISIVE)
    alike = " or ".join(name for name in TURNS if abs(off[name]) <= DECISIVE)
    if likelier:
        words = f"echoes do not come from where the mount points; the track may be {likelier}"
        warnings.warn(words, UllageWarning, stacklevel=6)
        return words
    return f"echoes cannot tell this track from one {alike}" if alike else ""


def _misfit(path: Floats, rotation: Floats, points: Sequence[Point], weight: Floats, turn: Floats) -> float:
    """Squared distances of the scatterers' directions from the boresight; of a straight track only along it."""
    size, along = np.linalg.svd(path - path.mean(0), full_matrices=False)[1:]
    known = along[size > STRAIGHT * size[0]] @ turn.T  # (q, 3) directions in which places are known
    total = 0.0
    for point in points:
        share = point.amplitude * weight / max(float(point.amplitude @ weight), 1e-30)
        ray = (point.place - path) @ turn.T
        away = ray / np.linalg.norm(ray, axis=1)[:, None] - rotation[:, :, 0]
        total += float((share @ (away @ known.T) ** 2).sum())
    return total
