"""Lying cylinders: round bodies whose axis is level, such as lying tanks from inside and level pipes from outside.

The axis is level, so the specular point lies in the vertical plane across it. From the place p the centre lies at the
signed distance c = 1 / curvature along the direction, and the radius is the size of r - c, with r the range. The plane
of flight cuts such a body in two lines along its axis. They are not above or below the specular point.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ullage.arrays import Bools, Floats, Longs

LEAST_CURVATURE = 1e-3  # nearly planes count as cylinders of this curvature [1/m]
STEPS = np.array([1e-4, 0.0, 1e-4, 1e-4])  # of the numerical derivatives: m, rad, 1/m, cosine


class Cuts(NamedTuple):
    """Where the plane of flight cuts lying cylinders on one side of the axis."""

    distance_m: Floats  # (m) level distance across the axis, along the bearing
    arc_m: Floats  # (m) along the surface from the specular point; infinite where the plane does not cut the surface


class InPlane(NamedTuple):
    """Sightings of a lying cylinder as upright walls where the plane of flight cuts it, on both sides."""

    sighting: Longs  # (k) row of each
    state: Floats  # (k, 4) distance, bearing, no curvature, and the share of the distance that its echo shows free
    confirmed: Bools  # (k) whether the surface was seen near the cut on this side
    possible: Bools  # (k) whether it may go on to there all the same


def lying_share(cosine: Floats | float, along: Floats | float) -> Floats:
    """Curvature that a short aperture shows of a lying cylinder, over that in the vertical plane across its axis.

    A straight aperture cannot tell a reflector that bends on all sides from one that bends in that plane only.

    Args:
        cosine: of the elevation of its direction.
        along: cosine between the track and the level part of the direction.
    """
    square = np.square(along)
    return np.asarray((1 - np.square(cosine)) * square / np.maximum(1 - np.square(cosine) * square, 1e-3))


def cuts(state: Floats, *, across: bool = False) -> Cuts:
    """Find the cuts of lying cylinders with the plane of flight.

    Args:
        state: (m, 4) range [m], bearing [rad], curvature in the vertical plane [1/m] and cosine of the elevation.
        across: on the other side of the axis than the specular point.
    """
    range_m, _, curvature, cosine = state.T
    sign, sine = np.where(curvature < 0, -1.0, 1.0), np.sqrt(np.maximum(1 - state[:, 3] ** 2, 0.0))
    centre = sign / np.maximum(np.abs(curvature), LEAST_CURVATURE)
    radius, height = range_m - centre, centre * sine  # the radius is below 0 where it is seen from outside
    half = np.copysign(np.sqrt(np.maximum(radius**2 - height**2, 0.0)), -radius if across else radius)
    distance = centre * cosine + half
    turn = np.clip((cosine * half - sine * height) / radius, -1.0, 1.0)
    meets = (np.abs(height) < np.abs(radius)) & ((distance < 0) if across else (distance > 0))
    return Cuts(distance, np.where(meets, np.abs(radius) * np.arccos(turn), np.inf))


def cut_or_foot(state: Floats) -> Floats:
    """Level distance (m) to the cut, or to the foot of the perpendicular from the specular point without a cut [m]."""
    cut = cuts(state)
    return np.where(np.isfinite(cut.arc_m), cut.distance_m, state[:, 0] * state[:, 3])


def cut_sigma(state: Floats, covariance: Floats) -> float:
    """Standard deviation of the distance to a cut, from the covariance (4, 4) of one state (4) [m]."""
    moved = state + np.diag(STEPS)[[0, 2, 3]]
    moved[:, 3] = np.minimum(moved[:, 3], 1.0)
    change = (cuts(moved).distance_m - cuts(state[None]).distance_m) / STEPS[[0, 2, 3]]
    return float(np.sqrt(change @ covariance[np.ix_([0, 2, 3], [0, 2, 3])] @ change))


def in_plane(state: Floats, sure: Bools, reach_m: float, least: int) -> InPlane:
    """Find where the plane of flight cuts one lying cylinder at each of its sightings.

    The axis is level: where the surface was seen near the cut on one side, the cut goes on along the axis on this side
    as far as the cylinder was seen at all.

    Args:
        state: (m, 4) as of `cuts`.
        sure: (m) which states are sure enough.
        reach_m: along the surface, from a specular point to the cut that it confirms [m].
        least: sightings that confirm a side.
    """
    count = len(state)
    here, there = cuts(state), cuts(state, across=True)
    side = np.cos(state[:, 1] - state[0, 1]) < 0
    near = sure & (here.arc_m <= reach_m)
    known = np.array([(near & ~side).sum() >= least, (near & side).sum() >= least])
    first, second = state.copy(), state.copy()
    met = sure & np.isfinite(here.arc_m)
    first[met, 0] = here.distance_m[met]
    first[met, 3] = np.minimum(state[met, 0] * state[met, 3] / here.distance_m[met], 1.0)
    second[:, 0], second[:, 3] = -there.distance_m, 0.0
    second[:, 1] += np.pi
    opposite = np.flatnonzero(sure & np.isfinite(there.arc_m) & known[(~side).astype(int)])
    out = np.concatenate([first, second[opposite]])
    out[:, 2] = 0.0
    confirmed = np.concatenate([met & known[side.astype(int)], np.ones(len(opposite), bool)])
    possible = np.concatenate([met, np.ones(len(opposite), bool)])
    return InPlane(np.concatenate([np.arange(count), opposite]), out, confirmed, possible)
