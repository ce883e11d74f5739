"""Rival directions of an echo, which a straight aperture cannot separate by phase.

All directions at one angle to a straight track have the same ranges along it: they form a ring about the track. Bends
of the track separate them, and the levels of sensors that look in different directions. One sensor alone has a third
clue: no surface echoes more strongly than a mirror. A direction in which the antenna hardly receives would need one.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from ullage.arrays import Floats
from ullage.kernels.matched_sums import Aperture, explain

ROLLS = np.arange(1, 12) * (2 * np.pi / 12)  # places of the rivals on the ring
APART = math.cos(math.radians(31.0))  # nearer directions are no rivals: the fit itself separates them
LATEST = 161  # echoes that show the level of a mirror
MIRROR_PERCENT = 90.0
LEVEL_SIGMA_DB = 6.0  # by which an echo may exceed that level: surfaces differ, and round ones focus
MOST_LEAD = 20.0  # nats that one keyframe may say


class Rivals(NamedTuple):
    """Directions of one echo on the ring; the first one is its own."""

    cosine: Floats  # (m) level part of the unit vector
    bearing: Floats  # (m) [rad]
    left: Floats  # (m) share of the energy that is not explained


class MirrorLevel:
    """Level of a mirror as the strongest echoes show it: amplitude times range [m].

    An echo shows a bound only, by the direction on its ring in which its sensor receives most.
    """

    def __init__(self) -> None:
        self._levels: deque[float] = deque(maxlen=LATEST)
        self._most = 0.0

    def learn(self, level: float) -> None:
        """Take the least level that the strongest echo of a keyframe may have."""
        self._levels.append(level)
        self._most = float(np.percentile(self._levels, MIRROR_PERCENT))

    def excess_nats(self, level: Floats) -> Floats:
        """Nats against levels (m), for as far as they exceed a mirror's."""
        if not self._levels:
            return np.zeros_like(level)
        over_db = 20 * np.log10(np.maximum(level / max(self._most, 1e-30), 1.0))
        return np.asarray(0.5 * (over_db / LEVEL_SIGMA_DB) ** 2)


def track_of(aperture: Aperture) -> Floats:
    """Unit vector (3) along which the rows of an aperture are spread most."""
    apart = aperture.offset - aperture.offset.mean(axis=0)
    return np.asarray(np.linalg.eigh(apart.T @ apart)[1][:, -1])


def ring_of(track: Floats, cosine: float, bearing: float) -> Floats:
    """Directions (m, 3) on the ring about a track through a direction, which comes first.

    Args:
        track: unit vector (3).
        cosine: of the elevation of the direction.
        bearing: of the direction [rad].
    """
    up = math.sqrt(max(1 - cosine**2, 0.0))
    unit = np.array([cosine * math.cos(bearing), cosine * math.sin(bearing), up])
    along = float(unit @ track)
    side = unit - along * track
    other = np.cross(track, side)
    ring = along * track + np.cos(ROLLS)[:, None] * side + np.sin(ROLLS)[:, None] * other
    return np.vstack([unit, ring[ring @ unit < APART]])


def rivals_of(aperture: Aperture, fit: Floats, directions: Floats) -> Rivals:
    """Fit an echo in all directions of its ring.

    Args:
        aperture: the rows.
        fit: (7) as of `refine`.
        directions: (m, 3) as of `ring_of`.
    """
    cosine = np.hypot(directions[:, 0], directions[:, 1])
    bearing = np.where(cosine > 0, np.arctan2(directions[:, 1], directions[:, 0]), directions[:, 2])
    shares = np.empty(len(directions))
    explain(aperture, np.column_stack([cosine, bearing]), fit[3:5], shares)
    return Rivals(cosine, bearing, 1 - shares)
