"""Loops over paths by lines along a round wall and over a round body before it: the shortest over both, by Newton."""

from __future__ import annotations

import math
from typing import NamedTuple

from ullage.arrays import Bools, Floats, Longs
from ullage.kernels.loops import core, lean
from ullage.kernels.pairs import eliminate
from ullage.kernels.vectors import dot, field_across, onto, unit_to


class WallLines(NamedTuple):
    """Lines (n) along a round wall, and which surfaces of a path they are."""

    walls: Bools  # (s) which of the two or three surfaces are lines, as the wave meets them; the others are the body
    feet: Floats  # (n, 3) a point of each line [m]
    up: Floats  # (3) unit vector along all lines


class RoundBody(NamedTuple):
    """A sphere or a cylinder."""

    centre: Floats  # (3) [m]
    axes: Floats  # (3, 3) rows: two across the axis, and the axis of a cylinder
    radius: float  # [m]
    is_sphere: bool  # whether it is a sphere


class LinePaths(NamedTuple):
    """Shortest paths (n) over each line and the body."""

    corners: Floats  # (s + 2, n, 3) [m]
    normals: Floats  # (s, n, 3) unit normals of the body
    lengths: Floats  # (n) [m]
    spreads: Floats  # (n) amplitude at the end without the integral across the lines [m^-1.5]; 0: no such path
    bends: Floats  # (s, n) second derivative of the path along the axis of each surface, all else at its best [1/m]


class LineScratch(NamedTuple):
    """Scratch of `over_lines`."""

    rows: Floats  # (16, 3)
    table: Floats  # (5, 9)


class WallPlaces(NamedTuple):
    """Places (m) for the sum along a wall."""

    first: Longs  # line before each place
    share: Floats  # share of the distance to the next line
    weights: Floats  # weight of each


@lean(by_fields=True, nogil=True, error_model="numpy")
def over_lines(ends, lines: WallLines, body: RoundBody, steps, out: LinePaths, scratch: LineScratch):  # type: ignore[no-untyped-def]
    """Find the shortest paths from one point to another over a line and one body, in some order, for each line.

    Args:
        ends: (2, 3) where paths begin and end [m].
        lines: `WallLines`.
        body: `RoundBody`.
        steps: of Newton's method, at most.
        out: `LinePaths` gets the results.
        scratch: `LineScratch`.
    """
    rows, table = scratch
    known = False
    for i in range(len(lines.feet)):
        _start(ends, lines, body, known, out.corners, i, rows)
        far = math.inf
        for _ in range(steps):
            if far < 1e-4:  # the next step would be its square
                break
            _frames(out.corners, i, lines, body, rows)
            size = _second(lines.walls, body.radius, body.is_sphere, rows, table)
            eliminate(table, size)
            far = _step(out.corners, i, lines.walls, body.radius, body.is_sphere, rows, table)
        _frames(out.corners, i, lines, body, rows)
        size = _second(lines.walls, body.radius, body.is_sphere, rows, table)
        known = _record(i, lines.walls, size, out, rows, table)


@core(nogil=True, error_model="numpy")
def _start(ends, lines, body, known, corners, i, rows):  # type: ignore[no-untyped-def]
    """Put the corners of a path where those of the last one were, or where the body faces both neighbours."""
    walls, feet, up = lines
    centre, axes, radius, is_sphere = body
    many, middle, along = len(walls), rows[2], 0.0
    for k in range(3):
        corners[0, i, k], corners[many + 1, i, k] = ends[0, k], ends[1, k]
        along += (0.5 * (ends[0, k] + ends[1, k]) - centre[k]) * axes[2, k]
    for k in range(3):
        middle[k] = centre[k] + (0.0 if is_sphere else along * axes[2, k])
    for s in range(many):
        here, along = corners[1 + s, i], 0.0
        if walls[s]:
            for k in range(3):
                before = corners[1 + s, i - 1, k] if known else 0.5 * (middle[k] + ends[min(s, 1), k])
                along += (before - feet[i, k]) * up[k]
            for k in range(3):
                here[k] = feet[i, k] + along * up[k]
    for s in range(many):
        here = corners[1 + s, i]
        if not walls[s]:
            unit_to(middle, corners[s, i], rows[0])
            unit_to(middle, corners[s + 2, i], rows[1])
            for k in range(3):
                here[k] = corners[1 + s, i - 1, k] if known else middle[k] + rows[0, k] + rows[1, k]
            onto(centre, axes[2], radius, is_sphere, here, rows[3])


@core(nogil=True, error_model="numpy")
def _frames(corners, i, lines, body, rows):  # type: ignore[no-untyped-def]
    """Write the directions in which corners may move.

    Rows 3 s to 3 s + 2 get those of surface s, the one along its axis second, and its normal. Rows 9 to 12 get the
    directions of the legs, 13 and 14 their lengths [m].
    """
    walls, up = lines.walls, lines.up
    centre, axes, radius, is_sphere = body
    many, sizes = len(walls), rows[13:15].reshape(6)
    for s in range(many):
        f, g, normal = rows[3 * s], rows[3 * s + 1], rows[3 * s + 2]
        if walls[s]:
            for k in range(3):
                f[k] = up[k]
            continue
        onto(centre, axes[2], radius, is_sphere, corners[1 + s, i], normal)
        for k in range(3):
            rows[15, k] = axes[2, k] + (1e-3 * axes[0, k] if is_sphere else 0.0)  # at a ball's pole, too, there is one
        field_across(rows[15], normal, g)
        for k in range(3):
            a, b = (k + 1) % 3, (k + 2) % 3
            f[k] = g[a] * normal[b] - g[b] * normal[a]
    for leg in range(many + 1):  # only now is all of the path where it belongs
        sizes[leg] = unit_to(corners[leg, i], corners[leg + 1, i], rows[9 + leg])


@core(nogil=True, error_model="numpy")
def _second(walls, radius, is_sphere, rows, table):  # type: ignore[no-untyped-def]
    """Write second and first derivatives of a path to columns 0 to 4, and 5, of `table`; return the unknowns' number.

    A line has one, along it; a body two, around and along its axis. Columns 6 to 8 are made unit vectors along the
    axes of the surfaces. Of `rows`, as `_frames` gives them, 15 is made use of.
    """
    many, sizes, turn, first = len(walls), rows[13:15].reshape(6), rows[15], 0
    for a in range(5):
        for b in range(9):
            table[a, b] = 0.0
    for s in range(many):
        free = 1 if walls[s] else 2
        for k in range(3):
            turn[k] = rows[9 + s, k] - rows[10 + s, k]
        for a in range(free):
            one = rows[3 * s + a]
            table[first + a, 5] = dot(one, turn)
            for b in range(free):
                other, total = rows[3 * s + b], 0.0
                for leg in range(s, s + 2):
                    direction = rows[9 + leg]
                    total += ((1.0 if a == b else 0.0) - dot(one, direction) * dot(other, direction)) / sizes[leg]
                if a == b and not walls[s] and (a == 0 or is_sphere):
                    total -= dot(turn, rows[3 * s + 2]) / radius
                table[first + a, first + b] = total
            for b in range(0 if s + 1 == many else (1 if walls[s + 1] else 2)):
                other, direction = rows[3 * s + 3 + b], rows[10 + s]
                mixed = (dot(one, direction) * dot(other, direction) - dot(one, other)) / sizes[s + 1]
                table[first + a, first + free + b], table[first + free + b, first + a] = mixed, mixed
        table[first + free - 1, 6 + s] = 1.0
        first += free
    return first


@core(nogil=True, error_model="numpy")
def _step(corners, i, walls, radius, is_sphere, rows, table):  # type: ignore[no-untyped-def]
    """Move the corners of a path by a step of Newton's method; return the length of the step [m]."""
    total, wide, row = 0.0, 1e-12, 0
    for s in range(len(walls)):
        if not walls[s]:
            wide = max(wide, math.hypot(table[row, 5], table[row + 1, 5] if is_sphere else 0.0))
        row += 1 if walls[s] else 2
    share, row = min(1.0, 0.7 * radius / wide), 0
    for s in range(len(walls)):
        for a in range(1 if walls[s] else 2):
            for k in range(3):
                corners[1 + s, i, k] -= share * table[row, 5] * rows[3 * s + a, k]
            total += table[row, 5] ** 2
            row += 1
    return math.sqrt(total)


@core(nogil=True, error_model="numpy")
def _record(i, walls, size, out, rows, table):  # type: ignore[no-untyped-def]
    """Write a path with its second derivatives to the results; return whether it is one."""
    _, normals, lengths, spreads, bends = out
    many, sizes, steep, row = len(walls), rows[13:15].reshape(6), 0.0, 0
    lengths[i], facing, over, under = sizes[0], 1.0, 1.0, sizes[0]
    for s in range(many):
        lengths[i] += sizes[s + 1]
        under *= sizes[s + 1]
        if not walls[s]:
            there, back = -dot(rows[9 + s], rows[3 * s + 2]), dot(rows[10 + s], rows[3 * s + 2])
            facing, over = min(facing, there, back), over * there
            for k in range(3):
                normals[s, i, k] = rows[3 * s + 2, k]
    for row in range(size):
        steep = max(steep, abs(table[row, 5]))
    area, row = eliminate(table, size), 0
    for s in range(many):
        row += 1 if walls[s] else 2
        bends[s, i] = 1 / table[row - 1, 6 + s]
    good = facing > 1e-3 and steep < 1e-5 and area > 0
    spreads[i] = over / (under * math.sqrt(area)) if good else 0.0
    return good


@lean(nogil=True, error_model="numpy")
def beside(corners, at, out, up, spreads, slopes, least, rows):  # type: ignore[no-untyped-def]
    """Compute the slopes of paths from line to line, and their spreads times what Kirchhoff's integral has at the wall.

    Args:
        corners: (s + 2, n, 3) of the paths [m]; at: which surface is the wall that is integrated over.
        out: (n, 3) its outward unit normals; up: (3) along the lines.
        spreads: (n) multiplied by the mean cosine of both legs there; 0 where one of them comes from behind.
        slopes: (n) get how fast the paths grow along the wall.
        least: (2) gets the shortest leg before it and after it [m].
        rows: (3, 3), room to work.
    """
    there, back, along = rows[0], rows[1], rows[2]
    least[0] = least[1] = math.inf
    for i in range(len(out)):
        least[0] = min(least[0], unit_to(corners[at, i], corners[at + 1, i], there))
        least[1] = min(least[1], unit_to(corners[at + 1, i], corners[at + 2, i], back))
        inward, outward = dot(there, out[i]), -dot(back, out[i])
        spreads[i] *= 0.5 * (inward + outward) if inward > 0 and outward > 0 else 0.0
        for k in range(3):
            a, b = (k + 1) % 3, (k + 2) % 3
            along[k] = up[a] * out[i, b] - up[b] * out[i, a]
        slopes[i] = dot(there, along) - dot(back, along)


@core(nogil=True, error_model="numpy")
def _between(lengths, slopes, i, share, step):  # type: ignore[no-untyped-def]
    """Compute the path [m] at a share of the distance from line i to the next, and its slope, by a cubic."""
    j = (i + 1) % len(lengths)
    a, b, p, q = lengths[i], lengths[j], step * slopes[i], step * slopes[j]
    bow, bend = 3 * (b - a) - 2 * p - q, 2 * (a - b) + p + q
    return a + share * (p + share * (bow + share * bend)), (p + share * (2 * bow + 3 * share * bend)) / step


@lean(by_fields=True, nogil=True, error_model="numpy")
def sampled(lengths, slopes, there, step, cut, many, places: WallPlaces):  # type: ignore[no-untyped-def]
    """Choose places for the sum along a wall: all about points of stationary phase.

    Args:
        lengths, slopes: (n) of the paths over lines along the wall [m]; there: (n) whether there are such paths.
        step: from line to line [m]; many: places between two of them.
        cut: no places where the path grows faster than this.
        places: `WallPlaces` (n many) gets the places.

    Returns:
        How many places there are.
    """
    first, share, weights = places
    count = 0
    for i in range(len(lengths)):
        j = (i + 1) % len(lengths)
        least = min(abs(slopes[i]), abs(slopes[j])) if slopes[i] * slopes[j] > 0 else 0.0
        if not (there[i] and there[j] and least < cut):
            continue
        for k in range(many):
            part = (k + 0.5) / many
            gone = abs(_between(lengths, slopes, i, part, step)[1]) / cut
            if gone < 1:
                first[count], share[count] = i, part
                weights[count] = math.sin(math.pi * min(1 - gone, 0.5)) ** 2 * (step / many)
                count += 1
    return count


@lean(by_fields=True, nogil=True, error_model="numpy")
def summed(lengths, slopes, step, seen, places: WallPlaces, values, paths, rates):  # type: ignore[no-untyped-def]
    """Compute the contribution of each place along a wall.

    Args:
        lengths, slopes, step: as in `sampled`.
        seen: (n) contribution of each line.
        places: `WallPlaces` (m).
        values: (m) get the contributions; paths: (m) get their lengths [m]; rates: (m) get how fast these grow.
    """
    first, share, weights = places
    for i in range(len(first)):
        here, u = first[i], share[i]
        values[i] = (seen[here] * (1 - u) + seen[(here + 1) % len(seen)] * u) * weights[i]
        paths[i], rates[i] = _between(lengths, slopes, here, u, step)


@lean(nogil=True, error_model="numpy")
def gathered(first, share, leads, many, echo, led, total):  # type: ignore[no-untyped-def]
    """Add up the echoes of places (m) by which of some of them, `leads`, is next round a wall of so many lines.

    `led` (m) gets that, `total` the sums.
    """
    for j in range(len(leads)):
        total[j] = 0j
    for i in range(len(first)):
        least = math.inf
        for j in range(len(leads)):
            apart = abs(first[i] - first[leads[j]] + share[i] - share[leads[j]])
            apart = min(apart, many - apart)
            if apart < least:
                least, led[i] = apart, j
        total[led[i]] += echo[i]
