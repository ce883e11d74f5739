"""Paths over flat mirrors to other objects and back: their corners, and the field after the mirrors."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Bools, Complexes, Floats, Ints, Longs
from ullage.kernels.bounces import Mirrors, Orientations, count_mirrors, reflect_field
from ullage.kernels.edges import mirror
from ullage.kernels.lit import spot as shortest
from ullage.kernels.loops import core, lean
from ullage.kernels.near import LEAST_M
from ullage.kernels.outlines import held
from ullage.kernels.vectors import apart, dot, field_across, mirrored, unit_to

PLANES = 20  # of the beams of both legs of a path: five for each of two mirrors


class FlatFaces(NamedTuple):
    """Flat faces (p) and their edges (e)."""

    normals: Floats  # (p, 3) unit normals
    offsets: Floats  # (p) plane normal . x = offset [m]
    first: Ints  # (p + 1) first edge of each face
    starts: Floats  # (e, 3) [m]
    ends: Floats  # (e, 3) [m]


class FaceExtents(NamedTuple):
    """Extents of flat faces (p)."""

    spheres: Floats  # (p, 4) centre and radius [m]
    across: Floats  # (p, 2, 3) two unit vectors in each face, at right angles


class Leads(NamedTuple):
    """Where paths (n) over mirrors lead, as `lead` finds it."""

    images: Floats  # (n, 2, 3, 3) each antenna, then its images, the last one again where there are fewer [m]
    frames: Floats  # (n, 2, 3, 3) sensor_from_world of the last images
    planes: Floats  # (n, PLANES, 4) planes within which, where plane . (x, 1) >= 0, lies all that a path can reach
    counts: Longs  # (n) how many planes
    reach: Floats  # (n) least mean of the lengths of both legs [m]


class MirrorPaths(NamedTuple):
    """Paths (n) over mirrors, from each antenna on."""

    faces: Longs  # (n, 2, 2) mirrors of each leg from its antenna on, -1 for none
    images: Floats  # (n, 2, 3, 3) as in `Leads` [m]
    legs: Longs  # (n, 2) numbers of the legs; equal legs have one number


class PathPoints(NamedTuple):
    """Pairs (m) of a path and a point to which it may lead."""

    points: Floats  # (n, 3) [m]
    at: Longs  # (m) point of each pair
    of: Longs  # (m) path of each pair


class KnownLegs(NamedTuple):
    """Legs to points that have been followed, one row (q) each."""

    known: Ints  # (l, n) row of each leg to each point, -1 where it is not known
    rows: Longs  # (m, 2) rows of both legs of each pair
    stops: Floats  # (q, 4, 3) corners: antenna, at the mirrors, point [m]
    free: Bools  # (q) whether every mirror is met from in front and within its outline


class Segments(NamedTuple):
    """Straight parts of legs that must be free: those to points first, all others from the back."""

    starts: Floats  # (3 m, 3) [m]
    ends: Floats  # (3 m, 3) [m]
    owner: Longs  # (3 m) row of the leg of each


class Weighed(NamedTuple):
    """Pairs of a path and a point of which `weigh` computes the factor."""

    stops: Floats  # (q, 4, 3) corners of each leg [m]
    rows: Longs  # (m, 2) legs of each pair
    todo: Longs  # (k) pairs to compute
    of: Longs  # (m) path of each pair
    object_ids: NDArray[np.integer]  # (m) object of each point


class WireMeetings(NamedTuple):
    """Pairs (n w) of a path and a wire that it meets."""

    of: Longs  # path of each
    on: Longs  # wire of each
    waves: Complexes  # (n w, 2) factors of the cylinder's series for fields along it (TM) and across it (TE)
    turns: Floats  # angle about the wire between the path there and the path back [rad]


class FieldScratch(NamedTuple):
    """Scratch of `weigh` and `meet_wires`."""

    units: Floats  # (3, 3), or (5, 4, 3) for wires
    waves: Complexes  # (2, 3)


@lean(error_model="numpy")
def lead(
    faces: Longs,
    antennas: Orientations,
    origins: Floats,
    flat: FlatFaces,
    extents: FaceExtents,
    out: Leads,
    box: Floats,
) -> None:
    """Find where paths (n) over mirrors lead: images of the antennas, and the beams that leave the mirrors' boxes.

    Args:
        faces: (n, 2, 2) mirrors of each leg from its antenna on, -1 for none.
        antennas: `bounces.Orientations` of transmitter and receiver.
        origins: (2, 3) transmitter and receiver [m].
        flat: `FlatFaces`.
        extents: `FaceExtents` of the same faces.
        out: `Leads` gets the results.
        box: (2, 2) scratch.
    """
    images, turned, planes, counts, reach = out
    normals, offsets, frames = flat.normals, flat.offsets, antennas.frames
    spheres, across, first, starts = extents.spheres, extents.across, flat.first, flat.starts
    for i in range(len(faces)):
        counts[i], reach[i] = 0, 0.0
        for side in range(2):
            for k in range(3):
                for row in range(3):
                    turned[i, side, row, k] = frames[side, row, k]
                for step in range(3):
                    images[i, side, step, k] = origins[side, k]
            begin, least = counts[i], 0.0
            for step in range(2):
                p = faces[i, side, step]
                if p < 0:
                    break
                n, apex = normals[p], images[i, side, step + 1]
                mirror(images[i, side, step], n, offsets[p], apex)
                for k in range(3):
                    images[i, side, 2, k] = apex[k]
                for row in range(3):
                    mirrored(n, turned[i, side, row])
                for w in range(begin, counts[i]):  # those of the mirror before, as seen in this one
                    planes[i, w, 3] += 2 * dot(planes[i, w], n) * offsets[p]
                    mirrored(n, planes[i, w])
                _box(across[p], starts, first[p], first[p + 1], box)
                counts[i] = _beam(apex, n, offsets[p], across[p], box, planes[i], counts[i])
                least = max(apart(spheres[p], apex) - spheres[p, 3], abs(dot(n, apex) - offsets[p]))
            reach[i] += 0.5 * least


@core(error_model="numpy")
def _box(axes: Floats, starts: Floats, begin: int, end: int, box: Floats) -> None:
    """Write the least and greatest coordinates (2, 2) of the corners of an outline along two axes (2, 3)."""
    for a in range(2):
        box[a, 0], box[a, 1] = math.inf, -math.inf
        for e in range(begin, end):
            place = dot(axes[a], starts[e])
            box[a, 0], box[a, 1] = min(box[a, 0], place), max(box[a, 1], place)


@core(error_model="numpy")
def _beam(apex: Floats, n: Floats, offset: float, axes: Floats, box: Floats, planes: Floats, made: int) -> int:
    """Add the planes of the beam from an image through a box (2, 2) in its mirror; return how many there are then."""
    gap = dot(n, apex) - offset
    sign = -1.0 if gap > 0 else 1.0
    for k in range(3):
        planes[made, k] = sign * n[k]
    planes[made, 3] = -sign * offset
    made += 1
    if abs(gap) < 1e-6:
        return made
    for a in range(2):
        here = dot(axes[a], apex)
        for end in range(2):
            # across the mirror a point at depth z behind the image may lie within z / |gap| of the box's side
            inward = 1.0 if end == 0 else -1.0
            slope = -inward * (box[a, end] - here) / abs(gap)
            size = math.sqrt(1 + slope * slope)
            for k in range(3):
                planes[made, k] = (inward * axes[a, k] + slope * sign * n[k]) / size
            planes[made, 3] = -dot(planes[made], apex)
            made += 1
    return made


@core(error_model="numpy")
def _stops(i: int, side: int, point: Floats, paths: MirrorPaths, flat: FlatFaces, out: Floats) -> int:
    """Write the corners (4, 3) of one leg of path i to a point: antenna, at the mirrors, point.

    Returns:
        How many mirrors the leg has; -1 where a mirror does not stand between an image and what it mirrors, or is
        passed outside its outline.
    """
    faces, images, normals, offsets = paths.faces, paths.images, flat.normals, flat.offsets
    count = count_mirrors(faces[i, side])
    for k in range(3):
        out[0, k] = images[i, side, 0, k]
        out[count + 1, k] = point[k]
    for step in range(count, 0, -1):
        p = faces[i, side, step - 1]
        before = dot(normals[p], images[i, side, step - 1]) - offsets[p]
        here, there = dot(normals[p], images[i, side, step]) - offsets[p], dot(normals[p], out[step + 1]) - offsets[p]
        # a point in the mirror's plane is not before it, and round-off must not decide
        if before * there <= LEAST_M * abs(before):
            return -1
        share = here / (here - there)
        for k in range(3):
            out[step, k] = images[i, side, step, k] + share * (out[step + 1, k] - images[i, side, step, k])
        if not held(out[step], p, normals, flat.first, flat.starts, flat.ends):
            return -1
    return count


@lean(error_model="numpy")
def corners(
    side: int, made: int, pairs: PathPoints, paths: MirrorPaths, flat: FlatFaces, legs: KnownLegs, segments: Segments
) -> tuple[int, int, int]:
    """Find where one leg of each path meets its mirrors, and which segments must be free; each leg to a point once.

    Args:
        side: 0 for the leg from the transmitter, 1 for that to the receiver.
        made: how many legs to points are known.
        pairs: `PathPoints`.
        paths: `MirrorPaths`.
        flat: `FlatFaces`.
        legs: `KnownLegs`; new legs are added. Only pairs whose leg on side 1 is free are followed on side 0.
        segments: `Segments` gets those of new legs.

    Returns:
        How many legs are known, how many segments lead to points, and how many others there are.
    """
    points, at, of = pairs
    known, rows, stops, free = legs
    a, b, owner = segments
    count, others = 0, 0
    for j in range(len(of)):
        if side == 0 and not free[rows[j, 1]]:
            continue
        i, p = of[j], at[j]
        row = known[paths.legs[i, side], p]
        if row < 0:
            row = made
            made += 1
            known[paths.legs[i, side], p] = row
            over = _stops(i, side, points[p], paths, flat, stops[row])
            free[row] = over >= 0
            for step in range(over + 1):
                if step < over:
                    others += 1
                place = count if step == over else len(a) - others
                for k in range(3):
                    a[place, k], b[place, k] = stops[row, step, k], stops[row, step + 1, k]
                owner[place] = row
            count += 1 if over >= 0 else 0
        rows[j, side] = row
    return made, count, others


@core(error_model="numpy")
def _followed(stops: Floats, faces: Longs, field: Floats, mirrors: Mirrors, last: Floats, wave: Complexes) -> float:
    """Compute the field of an antenna at the end of one leg (4, 3) over its mirrors (2).

    Args:
        stops: (4, 3) corners of the leg [m].
        faces: (2) mirrors, -1 for none.
        field: (3) unit field of the antenna.
        mirrors: `bounces.Mirrors`.
        last: (3) gets the direction in which the wave arrives.
        wave: (3) gets the field.

    Returns:
        The share of the wave that the mirrors cover.
    """
    normals, object_ids, widths = mirrors.normals, mirrors.object_ids, mirrors.widths
    wavelength, gamma = mirrors.wavelength_m, mirrors.gamma
    count, total, before, cover = count_mirrors(faces), 0.0, 0.0, 1.0
    for step in range(count + 1):
        total += unit_to(stops[step], stops[step + 1], last)
    size = unit_to(stops[0], stops[1], last)
    field_across(field, last, wave)
    for step in range(count):
        p = faces[step]
        before += size
        zone = math.sqrt(wavelength * before * max(total - before, 0.0) / max(total, 1e-9))
        slope = abs(dot(normals[p], last))
        for k in range(2):
            cover *= min(1.0, widths[p, k] * math.sqrt(slope) / max(zone, 1e-9))
        reflect_field(gamma, object_ids[p], normals[p], last, wave)
        size = unit_to(stops[step + 1], stops[step + 2], last)
    return cover


@lean(error_model="numpy")
def weigh(
    pairs: Weighed, faces: Longs, fields: Floats, mirrors: Mirrors, scratch: FieldScratch, out: Complexes
) -> None:
    """Compute the effect of the bounces of each path on a wave by polarisation; the point reflects as a mirror.

    Args:
        pairs: `Weighed`.
        faces: (n, 2, 2) mirrors of each leg from its antenna on, -1 for none.
        fields: (2, 3) unit fields of the antennas.
        mirrors: `bounces.Mirrors`.
        scratch: `FieldScratch`.
        out: (m) gets the factor of the pairs to compute.
    """
    stops, rows, todo, of, object_ids = pairs
    units, waves = scratch
    sent, taken, between, there, back = units[0], units[1], units[2], waves[0], waves[1]
    for j in todo:
        i, cover = of[j], 1.0
        cover *= _followed(stops[rows[j, 0]], faces[i, 0], fields[0], mirrors, sent, there)
        cover *= _followed(stops[rows[j, 1]], faces[i, 1], fields[1], mirrors, taken, back)
        for k in range(3):
            between[k] = sent[k] + taken[k]
        size = max(math.sqrt(dot(between, between)), 1e-9)
        for k in range(3):
            between[k] /= size
        reflect_field(mirrors.gamma, object_ids[j], between, sent, there)
        out[j] = cover * dot(there, back)


@lean(error_model="numpy")
def meet_wires(
    wires: Floats,
    paths: MirrorPaths,
    gate: float,
    fields: Floats,
    mirrors: Mirrors,
    flat: FlatFaces,
    met: WireMeetings,
    scratch: FieldScratch,
) -> int:
    """Find the wires that each path reaches within the gate at its point of shortest path, and the field there.

    Args:
        wires: (2, w, 3) starts and ends [m].
        paths: `MirrorPaths`.
        gate: largest mean range [m].
        fields: (2, 3) unit fields of the antennas.
        mirrors: `bounces.Mirrors`.
        flat: `FlatFaces`, the same faces.
        met: `WireMeetings` gets the results.
        scratch: `FieldScratch`.

    Returns:
        How many pairs there are.
    """
    begins, stops_at, images, faces = wires[0], wires[1], paths.images, paths.faces
    of, on, waves, turns = met
    units, field = scratch
    axis, spot, coming, part, stops = units[0, 0], units[0, 1], units[1], units[2], units[3:]
    count = 0
    for w in range(len(begins)):
        size = unit_to(begins[w], stops_at[w], axis)
        for i in range(len(images)):
            path = shortest(begins[w], axis, size, images[i, 0, 2], images[i, 1, 2], spot)
            if path > 2 * gate:
                continue
            cover, reached = 1.0, True
            for side in range(2):
                if reached:
                    reached = _stops(i, side, spot, paths, flat, stops[side]) >= 0
                if reached:
                    cover *= _followed(stops[side], faces[i, side], fields[side], mirrors, coming[side], field[side])
            if not reached:
                continue
            along, across = complex(cover, 0.0), complex(cover, 0.0)
            for side in range(2):
                field_across(axis, coming[side], part[0])
                _cross(axis, coming[side], part[1])
                along *= dot(field[side], part[0])
                across *= dot(field[side], part[1])
            across = -across  # the wave goes on against the way in which the receiver's would come
            field_across(coming[0], axis, part[0])
            field_across(coming[1], axis, part[1])
            cosine = -dot(part[0], part[1])
            of[count], on[count] = i, w
            waves[count, 0], waves[count, 1] = along, across
            turns[count] = math.acos(min(max(cosine, -1.0), 1.0))
            count += 1
    return count


@core(error_model="numpy")
def _cross(a: Floats, b: Floats, out: Floats) -> None:
    """Write the unit vector at right angles to two others."""
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    size = max(math.sqrt(x * x + y * y + z * z), 1e-12)
    out[0], out[1], out[2] = x / size, y / size, z / size
