"""Small things done with vectors of three, for loops that need them."""

from __future__ import annotations

import math

from ullage.arrays import Complexes, Floats
from ullage.kernels.loops import core


@core(error_model="numpy")
def dot(a: Floats | Complexes, b: Floats) -> complex:
    """Compute the scalar product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@core(error_model="numpy")
def apart(a: Floats, b: Floats) -> float:
    """Compute the distance of two points."""
    return math.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2)


@core(error_model="numpy")
def unit_to(a: Floats, b: Floats, out: Floats) -> float:
    """Write the unit vector from one point to another to `out`; return their distance."""
    size = apart(a, b)
    for k in range(3):
        out[k] = (b[k] - a[k]) / max(size, 1e-12)
    return size


@core(error_model="numpy")
def field_across(field: Floats, direction: Floats, out: Floats | Complexes) -> None:
    """Write the unit field across a direction of travel to `out`."""
    along, square = field[0] * direction[0] + field[1] * direction[1] + field[2] * direction[2], 0.0
    for k in range(3):
        part = field[k] - along * direction[k]
        out[k] = part
        square += part * part
    for k in range(3):
        out[k] /= max(math.sqrt(square), 1e-9)


@core(fastmath=True, error_model="numpy")
def fields_across(fields: Floats, rows: Floats) -> bool:
    """Bring a sum of directions, row 0, to length 1; rows 1 and 2 get both unit fields across it.

    Returns:
        Whether the directions do not cancel.
    """
    size = math.sqrt(rows[0, 0] ** 2 + rows[0, 1] ** 2 + rows[0, 2] ** 2)
    for k in range(3):
        rows[0, k] /= max(size, 1e-6)
    for s in range(2):
        field_across(fields[s], rows[0], rows[1 + s])
    return size >= 1e-6


@core(error_model="numpy")
def mirrored(n: Floats, vector: Floats) -> None:
    """Replace a vector by its image in a plane with unit normal n."""
    twice = 2 * (n[0] * vector[0] + n[1] * vector[1] + n[2] * vector[2])
    for k in range(3):
        vector[k] -= twice * n[k]


@core(error_model="numpy")
def onto(centre: Floats, axis: Floats, radius: float, is_sphere: bool, point: Floats, normal: Floats) -> None:
    """Move a point (3) to a body's surface, cylinders without ends; write its outward normal (3) to `normal`."""
    along = 0.0
    if not is_sphere:
        for k in range(3):
            along += (point[k] - centre[k]) * axis[k]
    for k in range(3):
        normal[k] = point[k] - centre[k] - along * axis[k]
    size = max(math.sqrt(dot(normal, normal)), 1e-12)
    for k in range(3):
        normal[k] /= size
        point[k] = centre[k] + along * axis[k] + radius * normal[k]
