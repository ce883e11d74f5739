"""Loops over pairs of round bodies: the shortest path over both, and its second derivatives, by Newton's method."""

from __future__ import annotations

import math
from typing import NamedTuple

from ullage.arrays import Bools, Floats
from ullage.kernels.loops import core, lean
from ullage.kernels.vectors import dot, field_across, onto, unit_to


class BodyPairs(NamedTuple):
    """Pairs (m) of round bodies, in the order in which the wave meets them."""

    centres: Floats  # (2, m, 3) [m]
    axes: Floats  # (2, m, 3, 3) rows: two across the axis, and the axis of a cylinder
    radii: Floats  # (2, m) [m]
    is_sphere: Bools  # (2, m) whether each is a sphere; a cylinder otherwise


class PairPaths(NamedTuple):
    """Shortest paths over pairs (m) of round bodies."""

    corners: Floats  # (4, m, 3) from start to stop [m]
    normals: Floats  # (2, m, 3) outward unit normals of the bodies there
    lengths: Floats  # (m) [m]
    spreads: Floats  # (m) amplitude of a source's wave at the end [1/m], 0 where there is no such path
    bends: Floats  # (m, 2) second derivative of the path along either body's axis, all else at its best [1/m]


@lean(by_fields=True, nogil=True, error_model="numpy")
def shortest(starts, stops, bodies: BodyPairs, steps, out: PairPaths, scratch):  # type: ignore[no-untyped-def]
    """Find the shortest paths from one point over the first and then the last body of each pair to another point.

    Args:
        starts, stops: (m, 3) [m].
        bodies: `BodyPairs`.
        steps: of Newton's method, at most.
        out: `PairPaths` gets the results.
        scratch: (76).
    """
    centres, axes, radii, is_sphere = bodies
    corners, normals, lengths, spreads, bends = out
    rows, table = scratch[:48].reshape((16, 3)), scratch[48:].reshape((4, 7))
    for i in range(len(radii[0])):
        for k in range(3):
            corners[0, i, k], corners[3, i, k] = starts[i, k], stops[i, k]
        _begin(corners, i, centres, axes, radii, is_sphere, rows)
        far, least = math.inf, min(radii[0, i], radii[1, i])
        for _ in range(steps):
            if far < 1e-4:  # the next step would be its square
                break
            _shape(corners, i, centres, axes, radii, is_sphere, rows, table)
            eliminate(table, len(table))
            far, wide = 0.0, 1e-12
            for side in range(2):  # along drums steps of any length do
                far += table[2 * side, 4] ** 2 + table[2 * side + 1, 4] ** 2
                wide += table[2 * side, 4] ** 2 + (table[2 * side + 1, 4] ** 2 if is_sphere[side, i] else 0.0)
            far = math.sqrt(far)
            share = min(1.0, 0.7 * least / math.sqrt(wide))
            for side in range(2):
                here = corners[1 + side, i]
                for k in range(3):
                    step = table[2 * side, 4] * rows[4 * side, k] + table[2 * side + 1, 4] * rows[4 * side + 1, k]
                    here[k] -= share * step
                onto(centres[side, i], axes[side, i, 2], radii[side, i], is_sphere[side, i], here, rows[2])
        _shape(corners, i, centres, axes, radii, is_sphere, rows, table)
        for k in range(3):
            normals[0, i, k], normals[1, i, k] = rows[2, k], rows[6, k]
        lengths[i] = rows[15, 0] + rows[15, 1] + rows[15, 2]
        steep = max(abs(table[0, 4]), abs(table[1, 4]), abs(table[2, 4]), abs(table[3, 4]))
        there, back = -dot(rows[12], rows[2]), -dot(rows[13], rows[6])
        facing = min(there, back, dot(rows[13], rows[2]), dot(rows[14], rows[6]))
        area = eliminate(table, len(table))
        bends[i, 0], bends[i, 1] = 1 / table[1, 5], 1 / table[3, 6]
        spreads[i] = 0.0
        if facing > 1e-3 and steep < 1e-5 and area > 0:
            spreads[i] = there * back / (rows[15, 0] * rows[15, 1] * rows[15, 2] * math.sqrt(area))


@core(nogil=True, error_model="numpy")
def _begin(corners, i, centres, axes, radii, is_sphere, rows):  # type: ignore[no-untyped-def]
    """Put the middle corners of a path where each body faces both neighbours, those of drums as high as its ends."""
    for side in range(2):
        along, axis = 0.0, axes[side, i, 2]
        if not is_sphere[side, i]:
            for k in range(3):
                along += (0.5 * (corners[0, i, k] + corners[3, i, k]) - centres[side, i, k]) * axis[k]
        for k in range(3):
            rows[3 + side, k] = centres[side, i, k] + along * axis[k]
    for side in range(2):
        body, here = rows[3 + side], corners[1 + side, i]
        unit_to(body, corners[3 * side, i], rows[0])
        unit_to(body, rows[4 - side], rows[1])
        for k in range(3):
            here[k] = body[k] + rows[0, k] + rows[1, k]
        onto(centres[side, i], axes[side, i, 2], radii[side, i], is_sphere[side, i], here, rows[2])


@core(nogil=True, error_model="numpy")
def _shape(corners, i, centres, axes, radii, is_sphere, rows, table):  # type: ignore[no-untyped-def]
    """Write the second and first derivatives of a path along frames of both bodies: columns 0 to 3 and 4 of `table`.

    Columns 5 and 6 are made unit vectors, along the axes of both. Of `rows`, 0 and 1 get the first body's frame, 2 its
    normal, 4 to 6 those of the last; 12 to 14 the directions of the legs, and 15 their lengths [m].
    """
    for leg in range(3):
        rows[15, leg] = unit_to(corners[leg, i], corners[leg + 1, i], rows[12 + leg])
    for side in range(2):
        f, g, normal, turn = rows[4 * side], rows[4 * side + 1], rows[4 * side + 2], rows[4 * side + 3]
        onto(centres[side, i], axes[side, i, 2], radii[side, i], is_sphere[side, i], corners[1 + side, i], normal)
        for k in range(3):
            rows[8, k] = axes[side, i, 2, k] + 1e-3 * axes[side, i, 0, k]
            turn[k] = rows[12 + side, k] - rows[13 + side, k]
        field_across(rows[8], normal, g)
        for k in range(3):
            a, b = (k + 1) % 3, (k + 2) % 3
            f[k] = g[a] * normal[b] - g[b] * normal[a]
        bent = -dot(turn, normal) / radii[side, i]
        for a in range(2):
            one = rows[4 * side + a]
            table[2 * side + a, 4] = dot(one, turn)
            for b in range(2):
                other, total = rows[4 * side + b], 0.0
                for leg in range(side, side + 2):
                    direction = rows[12 + leg]
                    total += ((1.0 if a == b else 0.0) - dot(one, direction) * dot(other, direction)) / rows[15, leg]
                if a == b and (a == 0 or is_sphere[side, i]):
                    total += bent
                table[2 * side + a, 2 * side + b] = total
    for a in range(2):
        for b in range(2):
            one, other, direction = rows[a], rows[4 + b], rows[13]
            mixed = (dot(one, direction) * dot(other, direction) - dot(one, other)) / rows[15, 1]
            table[a, 2 + b], table[2 + b, a] = mixed, mixed
    for row in range(4):
        table[row, 5], table[row, 6] = 1.0 if row == 1 else 0.0, 1.0 if row == 3 else 0.0


@core(nogil=True, error_model="numpy")
def eliminate(table, size):  # type: ignore[no-untyped-def]
    """Solve the first rows and columns of a table for its other columns, in place; return the determinant."""
    columns, area = table.shape[1], 1.0
    for c in range(size):
        best = c
        for row in range(c + 1, size):
            if abs(table[row, c]) > abs(table[best, c]):
                best = row
        if best != c:
            area = -area
            for k in range(columns):
                table[c, k], table[best, k] = table[best, k], table[c, k]
        pivot = table[c, c]
        area *= pivot
        if pivot == 0:
            pivot = 1e-300
        for k in range(columns):
            table[c, k] /= pivot
        for row in range(size):
            if row != c:
                share = table[row, c]
                for k in range(columns):
                    table[row, k] -= share * table[c, k]
    return area
