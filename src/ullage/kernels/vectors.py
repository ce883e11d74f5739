"""Small things done with vectors of three, for loops that need them."""

from __future__ import annotations

import math

from ullage.kernels.loops import core


@core(nogil=True, error_model="numpy")
def dot(a, b):  # type: ignore[no-untyped-def]
    """The product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@core(nogil=True, error_model="numpy")
def unit_to(a, b, out):  # type: ignore[no-untyped-def]
    """The unit vector from one point to another goes to `out`; gives how far that is."""
    size = math.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2)
    for k in range(3):
        out[k] = (b[k] - a[k]) / max(size, 1e-12)
    return size


@core(nogil=True, error_model="numpy")
def field_across(field, way, out):  # type: ignore[no-untyped-def]
    """The unit field across a direction of travel."""
    along = field[0] * way[0] + field[1] * way[1] + field[2] * way[2]
    square = 0.0
    for k in range(3):
        out[k] = field[k] - along * way[k]
        square += out[k] * out[k]
    for k in range(3):
        out[k] /= max(math.sqrt(square), 1e-9)


@core(nogil=True, error_model="numpy")
def mirrored(n, vector):  # type: ignore[no-untyped-def]
    """Turns a vector into its image in a plane with unit normal n."""
    twice = 2 * (n[0] * vector[0] + n[1] * vector[1] + n[2] * vector[2])
    for k in range(3):
        vector[k] -= twice * n[k]


@core(nogil=True, error_model="numpy")
def onto(centre, axis, radius, ball, point, normal):  # type: ignore[no-untyped-def]
    """Brings a point (3) to a body's surface, drums going on for ever; its outward normal (3) goes to `normal`."""
    along = 0.0
    if not ball:
        for k in range(3):
            along += (point[k] - centre[k]) * axis[k]
    for k in range(3):
        normal[k] = point[k] - centre[k] - along * axis[k]
    size = max(math.sqrt(dot(normal, normal)), 1e-12)
    for k in range(3):
        normal[k] /= size
        point[k] = centre[k] + along * axis[k] + radius * normal[k]
