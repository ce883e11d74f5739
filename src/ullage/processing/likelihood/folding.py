"""Echoes from beyond the unambiguous range, recognised by the surface that they come from."""

from __future__ import annotations

from itertools import chain
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ullage.arrays import Bools, Floats, Longs
from ullage.processing.likelihood.cells import FOLD_M, FOLD_RAD, FOLD_REACH_M, FOLD_SHARE


def folded(place: Floats, unit: Floats, range_m: Floats, owner: Longs, fold_m: float) -> Bools:
    """Whether echoes of each surface (s) are those of another one, farther by the unambiguous range.

    The test is local: near the place that a folded echo comes from, the other surface must have been seen, at the same
    distance and with the same normal.

    Args:
        place: (k, 3) of the keyframes [m].
        unit: (k, 3) directions of the echoes.
        range_m: (k) of the echoes.
        owner: (k) surface of each.
        fold_m: unambiguous range [m].
    """
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
