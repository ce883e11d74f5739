"""Loops over Fermat paths: the stationary path over a sequence of reflectors, by Newton's method.

The length of a path is a function of the places of all reflections, two numbers on each surface. Where it is
stationary, both laws of reflection hold. Its second derivatives there give the spread by stationary phase
[BornWolf1999, app. III]: the product of the cosines of incidence, over the product of the legs and the root of the
determinant.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ullage.arrays import Floats, Longs
from ullage.kernels.loops import core, lean
from ullage.kernels.vectors import apart, dot, field_across, onto, unit_to

PLANE, LINE, CYLINDER, SPHERE = 0, 1, 2, 3
_HALVES = 5  # most trials of a step


class Reflectors(NamedTuple):
    """What paths (n) may begin at, meet and end at; points are spheres without a radius."""

    kinds: Longs  # (r) PLANE, LINE, CYLINDER or SPHERE
    centres: Floats  # (r, 3) centre of a sphere, a point of an axis, a line or a plane [m]
    axes: Floats  # (r, 3, 3) rows: two across the axis, and the axis; for a plane its normal
    radii: Floats  # (r) [m]
    extents: Floats  # (r, 2) ends of cylinders along the axis, from the centre; both widths of planes [m]


class Chains(NamedTuple):
    """Sequences (n) of reflectors, each with the points where the path begins and ends."""

    rows: Longs  # (n, s + 2) reflectors; no two planes follow each other
    counts: Floats  # (n) how often each counts


class FermatPaths(NamedTuple):
    """Stationary paths of chains (n)."""

    corners: Floats  # (s + 2, n, 3) [m]
    normals: Floats  # (s, n, 3) unit normals there, towards the wave; of lines none
    lengths: Floats  # (n) [m]
    spreads: Floats  # (n) amplitude of a point source's wave at the end; 0 where there is no such path
    bends: Floats  # (s, n) second derivative of the length along each axis, stationary over the rest [1/m]


class Limits(NamedTuple):
    """Bounds on paths."""

    gate: float  # greatest length [m]
    least: float  # smaller spreads are left out [1/m]


class Scratch(NamedTuple):
    """Scratch for paths over three reflectors at most."""

    frames: Floats  # (4, 3, 3) directions in which each corner may move, and the normal
    legs: Floats  # (4, 4) direction of each leg and its length [m]
    table: Floats  # (6, 10) second derivatives, first ones, and what is solved for the bends
    before: Floats  # (3, 3) corners before a step [m]


@lean(error_model="numpy")
def may_be_strong(surfaces: Reflectors, chains: Chains, limits: Limits, some: Longs) -> int:
    """Find the chains whose paths may be short and strong enough; from outside, round bodies only spread waves.

    Legs are at least as long as the gaps between reflectors. Each cylinder or sphere spreads the wave by half its
    radius or more, in one direction at least.

    Args:
        surfaces: `Reflectors`.
        chains: `Chains`.
        limits: `Limits`.
        some: (n) gets the numbers of the chains.

    Returns:
        How many there are.
    """
    rows, counts = chains
    count, last = 0, rows.shape[1] - 1
    for i in range(len(rows)):
        before, plane, total, spread = rows[i, 0], -1, 0.0, counts[i] ** 2
        for s in range(1, last + 1):
            here = rows[i, s]
            if surfaces.kinds[here] == PLANE:
                plane = here
                continue
            gap = _gap(surfaces, before, here, plane)
            total, spread = total + gap, spread / gap
            if s < last:
                spread *= surfaces.radii[here] / 2
            before, plane = here, -1
        if total < limits.gate and spread > limits.least**2 * total:
            some[count] = i
            count += 1
    return count


@core(error_model="numpy")
def _gap(surfaces: Reflectors, one: int, other: int, plane: int) -> float:
    """Bound from below how far apart two reflectors are, the other one seen in a plane if that is not -1 [m]."""
    kinds, centres, axes, radii, ends = surfaces
    a, b = (other, one) if kinds[one] == SPHERE else (one, other)  # images are mutual
    up, height, lean_, square, along = axes[a, 2], 0.0, 0.0, 0.0, 0.0
    if plane >= 0:
        n = axes[plane, 2]
        height = dot(n, centres[b]) - dot(n, centres[plane])
        lean_ = 2 * dot(n, up) * dot(n, axes[b, 2])
    for k in range(3):
        away = centres[b, k] - centres[a, k] - (2 * height * axes[plane, 2, k] if plane >= 0 else 0.0)
        square += away * away
        along += away * up[k]
    if kinds[a] == SPHERE:
        return max(math.sqrt(square) - radii[a] - radii[b], 1e-3)
    past_end = along - min(max(along, ends[a, 0]), ends[a, 1])
    gap = math.sqrt(max(square - along * along, 0.0) + past_end * past_end)
    if kinds[b] == CYLINDER:
        gap -= math.sqrt(max(1 - (dot(up, axes[b, 2]) - lean_) ** 2, 0.0)) * ends[b, 1]
    return max(gap - radii[a] - radii[b], 1e-3)


@lean(error_model="numpy")
def stationary(surfaces: Reflectors, rows: Longs, follow: bool, steps: int, out: FermatPaths, scratch: Scratch) -> None:
    """Find the stationary path of each sequence of reflectors.

    Args:
        surfaces: `Reflectors`.
        rows: (n, s + 2) the sequences, as in `Chains`.
        follow: whether the search begins where the path before was found.
        steps: of Newton's method, at most.
        out: `FermatPaths` gets the results.
        scratch: `Scratch`.
    """
    known = False
    for i in range(len(rows)):
        _begin(surfaces, rows[i], i, known and follow, out.corners, scratch.frames[3, 2])
        far = math.inf
        for _ in range(steps):
            if far < 1e-4:  # the next step would be its square
                break
            size = _derivatives(surfaces, rows[i], out.corners, i, scratch)
            _solve(scratch.table, size, 7)
            far = _move(surfaces, rows[i], out.corners, i, scratch)
        size = _derivatives(surfaces, rows[i], out.corners, i, scratch)
        known = _record(surfaces, rows[i], size, i, out, scratch)


@core(error_model="numpy")
def _begin(surfaces: Reflectors, chain: Longs, i: int, known: bool, corners: Floats, normal: Floats) -> None:
    """Put the corners of a path where those of the last one were, or where round bodies face both neighbours."""
    kinds, centres, axes = surfaces.kinds, surfaces.centres, surfaces.axes
    last = len(chain) - 1
    for k in range(3):
        corners[0, i, k], corners[last, i, k] = centres[chain[0], k], centres[chain[last], k]
    for s in range(1, last):
        here, axis, along = chain[s], axes[chain[s], 2], 0.0
        if kinds[here] != SPHERE:
            for k in range(3):
                along += (0.5 * (corners[0, i, k] + corners[last, i, k]) - centres[here, k]) * axis[k]
        for k in range(3):
            corners[s, i, k] = corners[s, i - 1, k] if known else centres[here, k] + along * axis[k]
    _settle(surfaces, chain, corners, i, normal)
    for s in range(1, last):
        if kinds[chain[s]] > LINE and not known:
            here, there, back = corners[s, i], normal, corners[s - 1, i]
            size, onward = max(apart(back, here), 1e-12), max(apart(corners[s + 1, i], here), 1e-12)
            for k in range(3):
                there[k] = (back[k] - here[k]) / size + (corners[s + 1, i, k] - here[k]) / onward
            for k in range(3):
                here[k] += there[k]
            _onto(surfaces, chain[s], here, normal)
    _settle(surfaces, chain, corners, i, normal)


@core(error_model="numpy")
def _onto(surfaces: Reflectors, r: int, point: Floats, normal: Floats) -> None:
    """Move a point to a line or a round body, and write the normal of a body."""
    kinds, centres, axes = surfaces.kinds, surfaces.centres, surfaces.axes
    if kinds[r] == LINE:
        along = dot(point, axes[r, 2]) - dot(centres[r], axes[r, 2])
        for k in range(3):
            point[k] = centres[r, k] + along * axes[r, 2, k]
    else:
        onto(centres[r], axes[r, 2], surfaces.radii[r], kinds[r] == SPHERE, point, normal)


@lean(error_model="numpy")
def settle(surfaces: Reflectors, rows: Longs, corners: Floats, normal: Floats) -> None:
    """Bring the corners (s + 2, n, 3) of paths over rows (n, s + 2) to their reflectors; `normal` (3) is scratch.

    On a plane a corner comes to where both neighbours see each other in it.
    """
    for i in range(len(rows)):
        _settle(surfaces, rows[i], corners, i, normal)


@core(error_model="numpy")
def _settle(surfaces: Reflectors, chain: Longs, corners: Floats, i: int, normal: Floats) -> None:
    kinds, centres, axes = surfaces.kinds, surfaces.centres, surfaces.axes
    for s in range(1, len(chain) - 1):
        if kinds[chain[s]] != PLANE:
            _onto(surfaces, chain[s], corners[s, i], normal)
    for s in range(1, len(chain) - 1):
        if kinds[chain[s]] == PLANE:
            n, level = axes[chain[s], 2], dot(axes[chain[s], 2], centres[chain[s]])
            before, after = dot(n, corners[s - 1, i]) - level, dot(n, corners[s + 1, i]) - level
            share = abs(before) / max(abs(before) + abs(after), 1e-12)
            for k in range(3):
                here, there = corners[s - 1, i, k] - before * n[k], corners[s + 1, i, k] - after * n[k]
                corners[s, i, k] = here + share * (there - here)


@core(error_model="numpy")
def _frame(surfaces: Reflectors, r: int, before: Floats, here: Floats, frame: Floats) -> int:
    """Write the directions in which a corner may move, that along an axis last, and the normal; return how many."""
    kinds, axes = surfaces.kinds, surfaces.axes
    f, g, normal = frame[0], frame[1], frame[2]
    if kinds[r] == LINE:
        for k in range(3):
            f[k] = axes[r, 2, k]
        return 1
    if kinds[r] == PLANE:
        side = 1.0 if dot(axes[r, 2], before) > dot(axes[r, 2], here) else -1.0
        for k in range(3):
            f[k], g[k], normal[k] = axes[r, 0, k], axes[r, 1, k], side * axes[r, 2, k]
        return 2
    _onto(surfaces, r, here, normal)
    for k in range(3):
        f[k] = axes[r, 2, k] + (1e-3 * axes[r, 0, k] if kinds[r] == SPHERE else 0.0)  # there is one at the poles too
    field_across(f, normal, g)
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        f[k] = g[a] * normal[b] - g[b] * normal[a]
    return 2


@core(error_model="numpy")
def _derivatives(surfaces: Reflectors, chain: Longs, corners: Floats, i: int, scratch: Scratch) -> int:
    """Write second and first derivatives of a path to columns 0 to 5, and 6, of the table; return the unknowns' number.

    Columns 7 to 9 are made unit vectors along the axes of the reflectors.
    """
    frames, legs, table, _ = scratch
    kinds, many, turn, first, before = surfaces.kinds, len(chain) - 2, frames[3, 2], 0, 0
    for leg in range(many + 1):
        legs[leg, 3] = unit_to(corners[leg, i], corners[leg + 1, i], legs[leg])
    for a in range(6):
        for b in range(10):
            table[a, b] = 0.0
    for s in range(many):
        free = _frame(surfaces, chain[1 + s], corners[s, i], corners[1 + s, i], frames[s])
        for k in range(3):
            turn[k] = legs[s, k] - legs[s + 1, k]
        for a in range(free):
            one = frames[s, a]
            table[first + a, 6] = dot(one, turn)
            for b in range(free):
                total = 0.0
                for leg in range(s, s + 2):
                    total += ((1.0 if a == b else 0.0) - dot(one, legs[leg]) * dot(frames[s, b], legs[leg])) / legs[
                        leg, 3
                    ]
                if a == b and (kinds[chain[1 + s]] == SPHERE or (kinds[chain[1 + s]] == CYLINDER and a == 0)):
                    total += abs(dot(turn, frames[s, 2])) / surfaces.radii[chain[1 + s]]
                table[first + a, first + b] = total
            for b in range(first - before if s else 0):
                other = frames[s - 1, b]
                mixed = (dot(one, legs[s]) * dot(other, legs[s]) - dot(one, other)) / legs[s, 3]
                table[before + b, first + a], table[first + a, before + b] = mixed, mixed
        table[first + free - 1, 7 + s] = 1.0
        before, first = first, first + free
    return first


@core(error_model="numpy")
def _solve(table: Floats, size: int, columns: int) -> float:
    """Solve the second derivatives for columns 6 and on of the table, in place; return the determinant.

    A corner knows its neighbours only, so three of a row's entries before and after the diagonal are not 0. Lengths are
    convex and round bodies add to that: no pivots are sought.
    """
    area = 1.0
    for c in range(size):
        area *= table[c, c]
        for row in range(c + 1, min(c + 4, size)):
            share = table[row, c] / table[c, c]
            for k in range(c + 1, min(c + 4, size)):
                table[row, k] -= share * table[c, k]
            for k in range(6, columns):
                table[row, k] -= share * table[c, k]
    for c in range(size - 1, -1, -1):
        for k in range(6, columns):
            for row in range(c + 1, min(c + 4, size)):
                table[c, k] -= table[c, row] * table[row, k]
            table[c, k] /= table[c, c]
    return area


@core(error_model="numpy")
def _move(surfaces: Reflectors, chain: Longs, corners: Floats, i: int, scratch: Scratch) -> float:
    """Move the corners of a path by a step of Newton's method, halved until the path grows no longer; return it [m]."""
    frames, legs, table, before = scratch
    many, kinds, total, share, row = len(chain) - 2, surfaces.kinds, 0.0, 1.0, 0
    for s in range(many):  # along lines and cylinders steps of any length do
        kind = kinds[chain[1 + s]]
        if kind > LINE:
            wide = math.hypot(table[row, 6], table[row + 1, 6] if kind == SPHERE else 0.0)
            share = min(share, 0.7 * surfaces.radii[chain[1 + s]] / max(wide, 1e-12))
        for k in range(3):
            before[s, k] = corners[1 + s, i, k]
        for a in range(1 if kind == LINE else 2):
            total += table[row + a, 6] ** 2
        row += 1 if kind == LINE else 2
    for _ in range(_HALVES):
        row = 0
        for s in range(many):
            for k in range(3):
                corners[1 + s, i, k] = before[s, k] - share * table[row, 6] * frames[s, 0, k]
                if kinds[chain[1 + s]] != LINE:
                    corners[1 + s, i, k] -= share * table[row + 1, 6] * frames[s, 1, k]
            row += 1 if kinds[chain[1 + s]] == LINE else 2
        _settle(surfaces, chain, corners, i, frames[3, 2])
        longer = 1e-12
        for leg in range(many + 1):
            longer += legs[leg, 3] - apart(corners[leg, i], corners[leg + 1, i])
        if longer > 0:
            break
        share *= 0.5
    return math.sqrt(total)


@core(error_model="numpy")
def _record(surfaces: Reflectors, chain: Longs, size: int, i: int, out: FermatPaths, scratch: Scratch) -> bool:
    """Write a path with its second derivatives to the results; return whether it is one."""
    frames, legs, table, _ = scratch
    _, normals, lengths, spreads, bends = out
    many, kinds, steep, row = len(chain) - 2, surfaces.kinds, 0.0, 0
    lengths[i], facing, over, under = legs[0, 3], 1.0, 1.0, legs[0, 3]
    for s in range(many):
        lengths[i] += legs[s + 1, 3]
        under *= legs[s + 1, 3]
        if kinds[chain[1 + s]] != LINE:
            there, back = -dot(legs[s], frames[s, 2]), dot(legs[s + 1], frames[s, 2])
            facing, over = min(facing, there, back), over * there
            for k in range(3):
                normals[s, i, k] = frames[s, 2, k]
    for row in range(size):
        steep = max(steep, abs(table[row, 6]))
    area, row = _solve(table, size, 10), 0
    for s in range(many):
        row += 1 if kinds[chain[1 + s]] == LINE else 2
        bends[s, i] = 1 / table[row - 1, 7 + s]
    good = facing > 1e-3 and steep < 1e-5 and area > 0
    spreads[i] = over / (under * math.sqrt(area)) if good else 0.0
    return good
