"""Echoes from beyond the unambiguous range, recognised by two pulse intervals or by the surface that they come from."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ullage.arrays import Bools, Floats, Longs
from ullage.processing.likelihood.keyframes import Keyframe

FOLD_M, FOLD_RAD, FOLD_SHARE = 0.06, np.radians(4.0), 0.5  # how well a folded echo fits, and for how many
FOLD_REACH_M = 1.0  # along a surface, from where it was seen to where a folded echo comes from
FOLDS = 2  # pulse intervals by which an echo may be late


def unfold(key: Keyframe, sums: Floats, energy: Callable[[], float]) -> Keyframe:
    """Find the fold by which an echo explains most energy in the frames of both pulse intervals.

    An echo from beyond the unambiguous range appears at another range with each of them. Which interval the first
    frame had is not known, so both are tried.

    Args:
        key: the keyframe; the delays between its sensors are set.
        sums: (s, 3) real and imaginary part of each sensor's sum where the echo appears, and its rows.
        energy: that the echo explains with the delays as they are.

    Returns:
        The keyframe with the echo's true ranges, or itself.
    """
    late, both = key.aperture.late, key.interval >= 0
    if not both.any():
        return key
    here = key.interval[int(np.argmax(np.where(both, np.hypot(sums[:, 0], sums[:, 1]), -1)))]
    other = key.interval == 1 - here
    best, most, out = 0.0, energy(), key
    for own, its in (key.folds, key.folds[::-1]):
        for n in range(1, FOLDS + 1):
            late[other] = n * (own - its)
            explained = energy()
            if explained > most:
                best, most, out = n * (own - its), explained, replace(key, start_m=key.start_m + n * own * key.bin_m)
    late[other] = best
    return out


def folded(place: Floats, unit: Floats, range_m: Floats, owner: Longs, fold_m: float) -> Bools:
    """Whether echoes of each surface (s) are those of another one, farther by the unambiguous range.

    The test is local: near the place that a folded echo comes from, the other surface must have been seen, at the same
    distance and with the same normal.

    Args:
        place: (k, 2 or 3) of the keyframes [m].
        unit: (k, 2 or 3) directions of the echoes.
        range_m: (k) of the echoes.
        owner: (k) surface of each.
        fold_m: unambiguous range [m]; infinite where two pulse intervals have shown the true ranges.
    """
    if not math.isfinite(fold_m):
        return np.zeros(owner.max() + 1, bool)
    point = place + range_m[:, None] * unit
    origin = point + fold_m * unit
    near: Any = cKDTree(point).query_ball_point(origin, FOLD_REACH_M)
    echo = np.repeat(np.arange(len(near)), [len(one) for one in near])
    other = np.fromiter(chain.from_iterable(near), np.int64, len(echo))
    apart = np.abs(np.sum((point[other] - origin[echo]) * unit[echo], axis=1))
    parallel = np.sum(unit[other] * unit[echo], axis=1) > np.cos(FOLD_RAD)
    fits = (owner[other] != owner[echo]) & parallel & (apart < FOLD_M)
    same = np.bincount(echo, fits, len(owner)) > 0
    return np.asarray(np.bincount(owner, same) / np.bincount(owner) > FOLD_SHARE)
