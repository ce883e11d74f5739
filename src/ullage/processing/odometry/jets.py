"""Surfaces as jets of their distance field: range, direction and level curvature at one place, and so at all places.

About an anchor p0 a smooth surface lies at r0 along the unit vector u, and its distance bends by k across u on the
level. With d = p - p0, and its level part d', the range at p is

    r(p) = r0 + (k |d'|^2 - 2 u.d') / (|u - k d'| + 1) - u_z d_z.

It is exact for planes of any slope (k = 0), for upright edges and poles (k = 1 / r0), pillars and round tanks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ullage.arrays import Floats

LEVEL = np.array([1.0, 1.0, 0.0])
UP = np.array([0.0, 0.0, 1.0])
SIZE = 4  # numbers in the error of a jet: range, two of direction, curvature
_STEP = 1e-5


def cross(v: Floats) -> Floats:
    """The matrix (3, 3) of a cross product from the left."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


@dataclass(frozen=True, slots=True, eq=False)
class Jet:
    """A surface as seen from one place; its error has four numbers: range, direction along `across`, curvature."""

    anchor: Floats  # (3) [m]
    range_m: float
    unit: Floats  # (3) from the anchor to the surface
    curvature: float  # [1/m]

    @property
    def across(self) -> Floats:
        """Two unit vectors (2, 3) across the direction, the first one level."""
        first = np.array([-self.unit[1], self.unit[0], 0.0])
        size = np.linalg.norm(first)
        first = first / size if size > 1e-3 else np.array([0.0, 1.0, 0.0])
        return np.stack([first, cross(self.unit) @ first])

    def seen_from(self, place: Floats) -> tuple[float, Floats, Floats]:
        """Range at a place (3) [m], its gradient by the place (3), and by the error of the jet (4)."""
        d = place - self.anchor
        flat, k = LEVEL * d, self.curvature
        w, q = float(self.unit @ flat), float(flat @ flat)
        size = np.sqrt(max(1 - 2 * k * w + k * k * q, 1e-6))
        bend = (k * q - 2 * w) / (size + 1)
        slope = -(LEVEL * (self.unit - k * flat) / size + UP * self.unit[2])
        by_direction = -self.across @ (flat / size + UP * d[2])
        by_curvature = q / (size + 1) - bend / (size + 1) * (k * q - w) / size
        return self.range_m + bend - float(self.unit[2] * d[2]), slope, np.array([1.0, *by_direction, by_curvature])

    def moved(self, error: Floats) -> Jet:
        """The jet with an error (4) added."""
        unit = self.unit + error[1:3] @ self.across
        return Jet(self.anchor, self.range_m + error[0], unit / np.linalg.norm(unit), self.curvature + error[3])

    def anchored(self, place: Floats) -> tuple[Jet, Floats]:
        """The same surface about another anchor (3), and how its error (4) follows from that of this one (4, 4)."""
        there = self._at(place)
        inverse, slopes = there.across, np.empty((SIZE, SIZE))
        for i in range(SIZE):
            ends = [self.moved(sign * _STEP * np.eye(SIZE)[i])._at(place) for sign in (1, -1)]
            turn = inverse @ (ends[0].unit - ends[1].unit)
            change = (ends[0].range_m - ends[1].range_m, *turn, ends[0].curvature - ends[1].curvature)
            slopes[:, i] = np.array(change) / (2 * _STEP)
        return there, slopes

    def _at(self, place: Floats) -> Jet:
        flat = LEVEL * (place - self.anchor)
        w, q = float(self.unit @ flat), float(flat @ flat)
        size = np.sqrt(max(1 - 2 * self.curvature * w + self.curvature**2 * q, 1e-6))
        unit = (self.unit - self.curvature * flat) / size
        return Jet(place, self.seen_from(place)[0], unit / np.linalg.norm(unit), self.curvature / size)

    def gauge(self) -> Floats:
        """How the error (4) follows from a shift (3) of all the world, and from its turn about the vertical (1)."""
        flat, k = LEVEL * self.unit, self.curvature
        shift = np.vstack([self.unit, self.across @ (k * (np.diag(LEVEL) - np.outer(flat, flat))), -k * k * flat])
        turn = shift @ cross(UP) @ self.anchor
        turn[1:3] += self.across @ cross(UP) @ self.unit
        return np.column_stack([shift, turn])
