"""Loops over paths between two curved bodies and a flat face: mirror them to paths over two bodies, and back."""

from __future__ import annotations

import math
from typing import NamedTuple

from ullage.arrays import Bools, Floats, Longs
from ullage.kernels.edges import mirror
from ullage.kernels.loops import core, lean
from ullage.kernels.pairs import BodyPairs, PairPaths
from ullage.kernels.vectors import dot, mirrored, unit_to

BEFORE, BETWEEN, AFTER = 0, 1, 2  # where a path meets the face


class CurvedBodies(NamedTuple):
    """Spheres and cylinders (b), the rows of `radar.body_pairs.Bodies`."""

    centres: Floats  # (b, 3) [m]
    axes: Floats  # (b, 3, 3) rows: two across the axis, and the axis
    radii: Floats  # (b) [m]
    ends: Floats  # (b, 2) of cylinders along the axis, from the centre [m]
    is_sphere: Bools  # (b) whether each is a sphere


class PlaneMirrors(NamedTuple):
    """Flat faces (p)."""

    normals: Floats  # (p, 3) unit normals
    offsets: Floats  # (p) plane normal . x = offset [m]
    widths: Floats  # (p, 2) extent of each along its longest edge and across it [m]


class Chains(NamedTuple):
    """Chains (m) of a face and two bodies that waves may follow."""

    rows: Longs  # (m, 4) where each meets its face; the face; both bodies
    counts: Floats  # (m) how often each counts
    loud: Longs  # (m) gets the chains that `unfold` keeps


class Limits(NamedTuple):
    """Bounds on paths."""

    gate: float  # greatest length [m]
    least: float  # smaller spreads are left out [1/m]
    wavelength: float  # [m]
    pull: float  # least distance of contact points from the ends of bodies [m]


class FoldedPaths(NamedTuple):
    """Paths of chains with the mirrored part reflected back, the results of `fold`."""

    some: Longs  # (m) which of the chains that `unfold` kept
    values: Floats  # (m) spread, times what the face passes on and how often the chain counts [1/m]
    alongs: Floats  # (2, m) distance from the middle of each body to the point of contact along its axis [m]
    corners: Floats  # (5, m, 3) [m]
    faces: Floats  # (3, m, 3) unit normals there, as the wave meets them


@lean(nogil=True, error_model="numpy")
def gaps(origins, centres, axes, ends, is_sphere, out):  # type: ignore[no-untyped-def]
    """Write how far points (s, 3) lie from the centres of balls or axes of drums (s, m) [m]; bodies as in `unfold`."""
    for s in range(len(origins)):
        for i in range(len(centres)):
            out[s, i] = _gap(centres[i], axes[i, 2], ends[i], is_sphere[i], origins[s])


@core(nogil=True, error_model="numpy")
def _gap(centre, axis, ends, is_sphere, point):  # type: ignore[no-untyped-def]
    along, square = 0.0, 0.0
    for k in range(3):
        along += (point[k] - centre[k]) * axis[k]
        square += (point[k] - centre[k]) ** 2
    if is_sphere:
        return math.sqrt(square)
    past_end = along - min(max(along, ends[0]), ends[1])
    return math.sqrt(max(square - along * along, 0.0) + past_end * past_end)


@core(nogil=True, error_model="numpy")
def _height(n, offset, point):  # type: ignore[no-untyped-def]
    """Compute the height of a point over a face [m]."""
    return n[0] * point[0] + n[1] * point[1] + n[2] * point[2] - offset


@lean(by_fields=True, nogil=True, error_model="numpy")
def unfold(  # type: ignore[no-untyped-def]
    chains: Chains, origins, mirrors: PlaneMirrors, bodies: CurvedBodies, limits: Limits, points, pairs: BodyPairs
):
    """Mirror the part of each chain behind its face, so that it becomes a path over two bodies; drop weak chains.

    Args:
        chains: `Chains`.
        origins: (2, 3) where paths begin and end [m].
        mirrors: `PlaneMirrors`.
        bodies: `CurvedBodies`.
        limits: `Limits`.
        points: (2, m, 3) get both ends [m].
        pairs: `pairs.BodyPairs` gets the bodies.

    Returns:
        How many chains are left.
    """
    rows, counts, loud = chains
    normals, offsets = mirrors.normals, mirrors.offsets
    centres, axes, radii, ends, is_sphere = bodies
    middles, turns, sizes, kinds = pairs
    gate, least = limits.gate, limits.least
    count = 0
    for i in range(len(rows)):
        at, face, a, b = rows[i]
        n, d = normals[face], offsets[face]
        if _height(n, d, origins[0]) * _height(n, d, origins[1]) <= 0:
            continue
        start, stop = points[0, count], points[1, count]
        for k in range(3):
            start[k], stop[k] = origins[0, k], origins[1, k]
            middles[0, count, k], middles[1, count, k] = centres[a, k], centres[b, k]
            for j in range(3):
                turns[0, count, j, k], turns[1, count, j, k] = axes[a, j, k], axes[b, j, k]
        if at == BEFORE:
            mirror(origins[0], n, d, start)
        else:
            mirror(origins[1], n, d, stop)
        if at == BETWEEN:
            mirror(centres[b], n, d, middles[1, count])
            for j in range(3):
                mirrored(n, turns[1, count, j])
        axis, last = turns[1, count, 2], middles[1, count]
        aslant = 0.0 if is_sphere[b] else math.sqrt(max(1 - dot(axis, axes[a, 2]) ** 2, 0.0)) * ends[b, 1]
        one = max(_gap(centres[a], axes[a, 2], ends[a], is_sphere[a], start) - radii[a], 1e-3)
        two = max(_gap(centres[a], axes[a, 2], ends[a], is_sphere[a], last) - aslant - radii[a] - radii[b], 1e-3)
        three = max(_gap(last, axis, ends[b], is_sphere[b], stop) - radii[b], 1e-3)
        most = math.sqrt(radii[a] * radii[b] / (4 * one * two * three * (one + two + three)))
        if one + two + three < gate and most * counts[i] > least:
            sizes[0, count], sizes[1, count] = radii[a], radii[b]
            kinds[0, count], kinds[1, count] = is_sphere[a], is_sphere[b]
            loud[count] = i
            count += 1
    return count


@core(nogil=True, error_model="numpy")
def _clamp(point, centre, axis, ends, is_sphere, bend, limits, out):  # type: ignore[no-untyped-def]
    """Move a point past the ends of a cylinder onto the cylinder.

    Returns:
        The original distance along the axis [m], and an upper bound of the truncation of the wave by the cylinder's
        ends: past an end it is the tail of a Fresnel integral.
    """
    wavelength, pull = limits.wavelength, limits.pull
    along, most = 0.0, 1.2
    for k in range(3):
        along += (point[k] - centre[k]) * axis[k]
    inner = along if is_sphere else min(max(along, ends[0] + pull), ends[1] - pull)
    for k in range(3):
        out[k] = point[k] + (inner - along) * axis[k]
    if not is_sphere:
        past_end = max(ends[0] - along, along - ends[1]) * math.sqrt(max(2 * bend / wavelength, 0.0))
        if past_end > 0:
            most = min(most, math.sqrt(2) / (math.pi * past_end))
    return along, most


@lean(by_fields=True, nogil=True, error_model="numpy")
def fold(  # type: ignore[no-untyped-def]
    chains: Chains,
    paths: PairPaths,
    pairs: BodyPairs,
    bodies: CurvedBodies,
    mirrors: PlaneMirrors,
    limits: Limits,
    out: FoldedPaths,
    scratch,
):
    """Keep the strong chains with valid paths, and reflect their mirrored parts back.

    Args:
        chains: `Chains`, whose `loud` holds only those that `unfold` kept.
        paths: `pairs.PairPaths` of those.
        pairs: `pairs.BodyPairs` of those.
        bodies: `CurvedBodies`.
        mirrors: `PlaneMirrors`.
        limits: `Limits`.
        out: `FoldedPaths` gets the results.
        scratch: (5, 3).

    Returns:
        How many are left.
    """
    rows, counts, loud = chains
    corners, bent, lengths, spreads, bends = paths
    middles, turns, ends, is_sphere = pairs.centres, pairs.axes, bodies.ends, bodies.is_sphere
    normals, offsets, widths, wavelength = mirrors.normals, mirrors.offsets, mirrors.widths, limits.wavelength
    some, values, alongs, real, faces = out
    gate, least = limits.gate, limits.least
    count, one, other, start, stop, hit = 0, scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
    for i in range(len(loud)):
        at, face, a, b = rows[loud[i]]
        n, d, value = normals[face], offsets[face], spreads[i] * counts[loud[i]]
        if value <= least or lengths[i] >= gate:
            continue
        along, most = _clamp(
            corners[1, i], middles[0, i], turns[0, i, 2], ends[a], is_sphere[a], bends[i, 0], limits, one
        )
        further, more = _clamp(corners[2, i], middles[1, i], turns[1, i, 2], ends[b], is_sphere[b], bends[i, 1], limits,
                               other)  # fmt: skip
        if value * most * more <= least:
            continue
        for k in range(3):
            start[k], stop[k] = corners[0, i, k], corners[3, i, k]
        here, there = (start, one) if at == BEFORE else (one, other) if at == BETWEEN else (other, stop)
        height, end_height = _height(n, d, here), _height(n, d, there)
        if height * end_height >= 0:
            continue
        for k in range(3):
            hit[k] = here[k] + height / (height - end_height) * (there[k] - here[k])
        value *= _passed(here, hit, there, widths[face], wavelength, faces[0, count])
        if value * most * more <= least:
            continue
        _back(at, n, d, start, other, stop)
        side = 1.0 if _height(n, d, start) > 0 else -1.0
        if side * _height(n, d, one) <= 0 or side * _height(n, d, other) <= 0:
            continue
        some[count], values[count], alongs[0, count], alongs[1, count] = i, value, along, further
        before, after = (0, 2) if at == BETWEEN else (1, 2) if at == BEFORE else (0, 1)
        for k in range(3):
            real[0, count, k], real[4, count, k], real[1 + at, count, k] = start[k], stop[k], hit[k]
            real[1 + before, count, k], real[1 + after, count, k] = one[k], other[k]
            faces[at, count, k] = side * n[k]
            faces[before, count, k], faces[after, count, k] = bent[0, i, k], bent[1, i, k]
        if at == BETWEEN:
            mirrored(n, faces[after, count])
        count += 1
    return count


@core(nogil=True, error_model="numpy")
def _back(at, n, offset, start, other, stop):  # type: ignore[no-untyped-def]
    """Reflect back the part behind a face: the start of the path, or its end and the body that follows the face."""
    if at == BEFORE:
        _over(n, offset, start)
    else:
        _over(n, offset, stop)
    if at == BETWEEN:
        _over(n, offset, other)


@core(nogil=True, error_model="numpy")
def _over(n, offset, point):  # type: ignore[no-untyped-def]
    twice = 2 * _height(n, offset, point)
    for k in range(3):
        point[k] -= twice * n[k]


@core(nogil=True, error_model="numpy")
def _passed(before, hit, then, widths, wavelength, way):  # type: ignore[no-untyped-def]
    """Compute the share of a wave that a face reflects if it does not cover its Fresnel zone."""
    there, back = unit_to(before, hit, way), unit_to(hit, then, way)
    zone = math.sqrt(wavelength * there * back / (there + back))
    return min(widths[0] / zone, 1.0) * min(widths[1] / zone, 1.0)
