"""Loops over what paths over flat mirrors can reach: within their beams and the gate, on its lit side, how loud."""

from __future__ import annotations

import math
from typing import NamedTuple

from ullage.arrays import Bools, Floats, Ints, Longs
from ullage.kernels.edges import FaceOutlines, Outline
from ullage.kernels.facets import BALL, ONE, TriangleClusters, toward
from ullage.kernels.loops import core, lean
from ullage.kernels.vectors import apart, dot, unit_to


class MirrorPaths(NamedTuple):
    """Paths (n) over flat mirrors on the leg from the transmitter, and on the leg to the receiver."""

    images: Floats  # (n, 2, 3, 3) each antenna, then its images, the last one again where there are fewer [m]
    frames: Floats  # (n, 2, 3, 3) sensor_from_world rotations of the last images
    faces: Longs  # (n, 2, 2) of each leg from its antenna on, -1 for none
    planes: Floats  # (n, 20, 4) that bound what a path can reach
    counts: Longs  # (n) how many of them there are
    weights: Floats  # (n) how much each path counts


class FaceSides(NamedTuple):
    """Outer sides of faces (p), as in `solids.Backs`."""

    outward: Floats  # (p, 4) plane of each face, turned to the outside of its body
    inside: Bools  # (p) whether the antennas may be in the body of the face


class EchoBounds(NamedTuple):
    """What bounds the echoes of faces (p)."""

    gate_m: float  # greatest mean range [m]
    wave: float  # wave number [1/m]
    table: Floats  # magnitudes of that of `facets.Antennas`
    isotropic: bool  # as in `facets.Antennas`
    most: Floats  # (s, c) the larger reflection coefficient of each material over cos(incidence)
    materials: Ints  # (p) row of each face in that table


class MetFaces(NamedTuple):
    """Pairs (m) of a path and a face that it reaches."""

    of: Longs  # (m) path
    on: Longs  # (m) face
    gains: Floats  # (m) the antennas' gains there, times the path's weight and what it reflects
    louds: Floats  # (m) upper bound of the path gain amplitude; squares add up to the power of a curved surface
    paths: Floats  # (m) mean range [m]


class BoundScratch(NamedTuple):
    """Scratch of `meet_faces`."""

    axes: Floats  # (3, 3) along the longest edge, across it, and a corner of the face [m]
    places: Floats  # (3, 3) where the path is shortest, and next to each image [m]
    slopes: Floats  # (6) as `_strength` gives them


@core(error_model="numpy")
def _shone(sphere: Floats, planes: Floats, count: int, one: Floats, other: Floats, gate: float) -> bool:
    """Whether some of a sphere (4) lies in the beams and within the gate of a path that ends at two images."""
    if 0.5 * (apart(sphere, one) + apart(sphere, other)) - sphere[3] > gate:
        return False
    held = True
    for w in range(count):
        held = held and dot(planes[w], sphere) + planes[w, 3] >= -sphere[3]
    return held


@core(error_model="numpy")
def _strength(
    point: Floats, ends: Floats, turned: Floats, table: Floats, flat: bool, axes: Floats, slopes: Floats
) -> float:
    """Antenna gains over both ranges at a point, for a radar at two images; the path's slopes (3) there go to `slopes`.

    Args:
        point: (3) [m].
        ends: (2, 3, 3), the last of each three are the images [m].
        turned: (1, 2, 3, 3) sensor_from_world of the images.
        table, flat: as in `facets.accumulate`.
        axes: (2 or more, 3) unit vectors.
        slopes: (6) gets them, how the path bends along the first two axes [1/m], and the gains alone.
    """
    strong, gains = 1.0, 1.0
    for k in range(5):
        slopes[k] = 0.0
    for side in range(2):
        x, y, z = point[0] - ends[side, 2, 0], point[1] - ends[side, 2, 1], point[2] - ends[side, 2, 2]
        r = max(math.sqrt(x * x + y * y + z * z), 1e-2)
        x, y, z = x / r, y / r, z / r
        gain = toward(table, flat, turned, ONE, side, x, y, z)
        strong, gains = strong * gain / r, gains * gain
        slopes[0], slopes[1], slopes[2] = slopes[0] + x, slopes[1] + y, slopes[2] + z
        for a in range(2):
            along = axes[a, 0] * x + axes[a, 1] * y + axes[a, 2] * z
            slopes[3 + a] += (1 - along * along) / r
    slopes[5] = gains
    return strong


@core(error_model="numpy", forceinline=True)
def _turn_to_edge(p: int, normals: Floats, first: Ints, starts: Floats, axes: Floats) -> None:
    """Sets axes[0] along the longest edge of a face, axes[1] across it in the face."""
    longest = 0.0
    for e in range(first[p], first[p + 1]):
        f = e + 1 if e + 1 < first[p + 1] else first[p]
        if apart(starts[e], starts[f]) > longest:
            longest = unit_to(starts[e], starts[f], axes[0])
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        axes[1, k] = normals[p, a] * axes[0, b] - normals[p, b] * axes[0, a]


@core(error_model="numpy")
def _loud(
    p: int, ends: Floats, frames: Floats, faces: FaceOutlines, bounds: EchoBounds, scratch: BoundScratch
) -> tuple[float, float, float]:
    """Bound the echo of a face for a radar at two images, per path gain amplitude.

    Along each of two axes counts the face's width or, if that is less, what a phase that turns leaves of it: two ends,
    2 / (k slope) [BornWolf1999], or where its path is shortest the Fresnel zone. Three places along the middle of the
    face are asked: where the path is shortest, and next to each image.

    Args:
        p: the face.
        ends: (2, 3, 3), the last of each three are the images [m].
        frames: (1, 2, 3, 3) sensor_from_world rotations of the images.
        faces: `edges.FaceOutlines`.
        bounds: `EchoBounds`.
        scratch: `BoundScratch`.

    Returns:
        The bound, the face's width [m], and the largest product of both gains at those places.
    """
    axes, places, slopes, wave = scratch.axes, scratch.places, scratch.slopes, bounds.wave
    normals, spheres, first, starts = faces.normals, faces.spheres, faces.first, faces.starts
    _turn_to_edge(p, normals, first, starts, axes)
    low, high, under, over = math.inf, -math.inf, math.inf, -math.inf
    for e in range(first[p], first[p + 1]):
        u, v = 0.0, 0.0
        for k in range(3):
            u, v = u + axes[0, k] * (starts[e, k] - spheres[p, k]), v + axes[1, k] * (starts[e, k] - spheres[p, k])
        low, high, under, over = min(low, u), max(high, u), min(under, v), max(over, v)
    for k in range(3):
        axes[2, k] = spheres[p, k] + low * axes[0, k] + 0.5 * (under + over) * axes[1, k]
    for side in range(2):
        foot = dot(axes[0], ends[side, 2]) - dot(axes[0], axes[2])
        foot = min(max(foot, 0.0), high - low)
        for k in range(3):
            places[1 + side, k] = axes[2, k] + foot * axes[0, k]
    spot(axes[2], axes[0], high - low, ends[0, 2], ends[1, 2], places[0])
    least, bend, best, gain = math.inf, math.inf, 0.0, 0.0
    for step in range(2, -1, -1):  # slopes are left as they are where the path is shortest
        strong = _strength(places[step], ends, frames, bounds.table, bounds.isotropic, axes, slopes)
        along, across, facing = 0.0, 0.0, 0.0
        for k in range(3):
            along, across = along + slopes[k] * axes[0, k], across + slopes[k] * axes[1, k]
            facing += 0.5 * slopes[k] * normals[p, k]
        least, bend = min(least, abs(along)), min(bend, slopes[3])
        across = max(abs(across) - 0.5 * (over - under) * slopes[4], 1e-9)
        gain = max(gain, slopes[5])
        best = max(best, strong * abs(facing) * min(over - under, 2 / (wave * across)))
    zone = 1.5 * math.sqrt(2 * math.pi / (wave * max(bend, 1e-9)))
    loud = best * min(high - low, zone, 2 / (wave * max(least, 1e-9))) / (4 * math.pi)
    return loud, over - under, gain


@core(error_model="numpy")
def _kept(
    point: Floats,
    images: Floats,
    faces: Longs,
    normals: Floats,
    object_ids: Ints,
    most: Floats,
    object_id: int,
    slopes: Floats,
) -> float:
    """Bound what the mirrors of a path and a thing at a point (3) reflect.

    Args:
        point: (3) [m]; images: (2, 3, 3) and faces: (2, 2) of the path, as in `paths.lead`.
        normals: (p, 3) and object ids: (p) of the faces; object: the thing's object.
        most: (s, c) the larger of both coefficients over cos(incidence).
        slopes: (6) as `_strength` gives them.
    """
    half = 0.5 * math.sqrt(slopes[0] * slopes[0] + slopes[1] * slopes[1] + slopes[2] * slopes[2])
    out = most[object_id, round(min(half, 1.0) * (most.shape[1] - 1))]
    for side in range(2):
        x, y, z = point[0] - images[side, 2, 0], point[1] - images[side, 2, 1], point[2] - images[side, 2, 2]
        r = max(math.sqrt(x * x + y * y + z * z), 1e-9)
        for step in range(2):
            p = faces[side, 1 - step]
            if p < 0:
                continue
            along = normals[p, 0] * x + normals[p, 1] * y + normals[p, 2] * z
            out *= most[object_ids[p], round(min(abs(along) / r, 1.0) * (most.shape[1] - 1))]
            x, y, z = x - 2 * along * normals[p, 0], y - 2 * along * normals[p, 1], z - 2 * along * normals[p, 2]
    return out


@core(error_model="numpy", forceinline=True)
def _faced(one: Floats, other: Floats, normal: Floats, offset: float, outward: Floats, inside: bool) -> bool:
    """Whether two images see the same side of a face, of a closed body the outer one unless they are inside its box."""
    ahead, behind, out = dot(normal, one) - offset, dot(normal, other) - offset, dot(outward, one) + outward[3]
    return not (ahead * behind <= 1e-9 or (out < 0 and not inside))


@lean(error_model="numpy")
def meet_faces(
    paths: MirrorPaths,
    items: Longs,
    faces: FaceOutlines,
    sides: FaceSides,
    bounds: EchoBounds,
    met: MetFaces,
    scratch: BoundScratch,
) -> int:
    """Find the faces that each path reaches so that both legs end on the same side, of closed bodies on the outer one.

    Args:
        paths: `MirrorPaths` (n).
        items: (k) faces to ask for.
        faces: `edges.FaceOutlines` (p).
        sides: `FaceSides` (p).
        bounds: `EchoBounds` (p).
        met: `MetFaces` (m), written.
        scratch: `BoundScratch`.

    Returns:
        How many pairs there are; only those that fit are written.
    """
    images, planes, counts, spheres, materials = (
        paths.images, paths.planes, paths.counts, faces.spheres, bounds.materials)  # fmt: skip
    count = 0
    for p in items:
        direct = 0.5 * (apart(spheres[p], images[0, 0, 0]) + apart(spheres[p], images[0, 1, 0]))
        if direct - spheres[p, 3] > bounds.gate_m:  # no path is shorter
            continue
        for i in range(len(images)):
            one, other = images[i, 0, 2], images[i, 1, 2]
            if not _shone(spheres[p], planes[i], counts[i], one, other, bounds.gate_m):
                continue
            if not _faced(one, other, faces.normals[p], faces.offsets[p], sides.outward[p], sides.inside[p]):
                continue
            if not _cornered(planes[i], counts[i], faces.starts, faces.first[p], faces.first[p + 1]):
                continue
            loud, width, gain = _loud(p, images[i], paths.frames[i : i + 1], faces, bounds, scratch)
            kept = paths.weights[i] * _kept(scratch.places[0], images[i], paths.faces[i], faces.normals,
                                            materials, bounds.most, materials[p], scratch.slopes)  # fmt: skip
            if count < len(met.of):
                half = math.pi / bounds.wave  # strips narrower than half a wave add up in phase with those beside them
                met.of[count], met.on[count], met.gains[count] = i, p, kept * gain
                met.louds[count] = kept * loud * math.sqrt(max(half / max(width, 1e-9), 1.0))
                met.paths[count] = 0.5 * (apart(spheres[p], one) + apart(spheres[p], other))
            count += 1
    return count


@lean(error_model="numpy")
def outline_louds(outline: Outline, gains: Floats, unit: float, louds: Floats, paths: Floats) -> int:
    """Bound the path gains of pieces and ends of outlines; an end from which a piece goes on counts with the piece.

    Args:
        outline: `edges.Outline` (m, n).
        gains: (k) of the faces.
        unit: wavelength over 16 pi squared [m].
        louds: (m + n) gets path gain amplitudes of pieces, then of ends.
        paths: (m + n) gets their mean ranges [m].

    Returns:
        How many there are.
    """
    pieces, tips = outline.pieces, outline.tips
    count = len(pieces)
    for i in range(count):
        louds[i] = unit * max(pieces[i, 8], pieces[i, 9]) * abs(pieces[i, 10]) * gains[outline.owner[i]]
        paths[i] = 0.5 * pieces[i, 6]
    for i in range(len(tips)):
        loud, tie = unit * math.hypot(tips[i, 4], tips[i, 5]) * gains[outline.holders[i]], outline.ties[i]
        if tie >= 0:
            louds[tie] = max(louds[tie], loud)
        else:
            louds[count], paths[count] = loud, 0.5 * tips[i, 3]
            count += 1
    return count


@lean(error_model="numpy")
def sift(louds: Floats, paths: Floats, long: float, rest: float, least: float, sums: Floats, out: Bools) -> None:
    """Which echoes (n) count: all but those that together, with phases at random, make at most `rest` in a pulse.

    Args:
        louds: (n) path gain amplitudes.
        paths: (n) mean ranges [m]; long: those of a pulse [m].
        least: one that makes more counts by itself.
        sums: (cells, levels) of 0, for cells so long and steps of 3 dB, the last for what makes `rest` alone.
        out: (n) gets whether each counts.
    """
    last = sums.shape[1] - 1
    for i in range(len(louds)):
        share = (louds[i] / rest) ** 2
        sums[int(paths[i] / long), min(max(math.frexp(share)[1] + last, 0), last)] += share
    for cell in range(len(sums)):
        for level in range(last):
            sums[cell, level + 1] += sums[cell, level]
    for i in range(len(louds)):
        share = (louds[i] / rest) ** 2
        held = sums[int(paths[i] / long), min(max(math.frexp(share)[1] + last, 0), last)] > 1
        out[i] = louds[i] != 0 and (held or abs(louds[i]) > least)


@core(error_model="numpy")
def _near(corners: Floats, one: Floats, other: Floats, gate: float) -> bool:
    """Whether some of a ball about a triangle lies within the gate of a path that ends at two images."""
    here, there, longest = 0.0, 0.0, 0.0
    for e in range(3):
        longest = max(longest, apart(corners[e - 1], corners[e]))
    for k in range(3):
        centre = (corners[0, k] + corners[1, k] + corners[2, k]) / 3
        here, there = here + (centre - one[k]) ** 2, there + (centre - other[k]) ** 2
    return 0.5 * (math.sqrt(here) + math.sqrt(there)) - BALL * longest <= gate


@lean(error_model="numpy")
def meet_triangles(
    paths: MirrorPaths, gate: float, clusters: TriangleClusters, normals: Floats, sides: FaceSides, lit: Bools
) -> None:
    """Find the small triangles that each path reaches so that both legs end on the same side of them.

    Args:
        paths: `MirrorPaths` (n).
        gate: greatest mean range [m].
        clusters: `facets.TriangleClusters` (f).
        normals: (f, 3) of the triangles.
        sides: `FaceSides` (f).
        lit: (n, f) gets True where a path reaches a triangle.
    """
    images, planes, counts = paths.images, paths.planes, paths.counts
    spheres, first, corners, outward, inside = (
        clusters.spheres, clusters.first, clusters.corners, sides.outward, sides.inside)  # fmt: skip
    for i in range(len(images)):
        one, other = images[i, 0, 2], images[i, 1, 2]
        for c in range(len(spheres)):
            if not _shone(spheres[c], planes[i], counts[i], one, other, gate):
                continue
            for f in range(first[c], first[c + 1]):
                out, level = dot(outward[f], one) + outward[f, 3], dot(normals[f], corners[f, 0])
                ahead, behind = dot(normals[f], one) - level, dot(normals[f], other) - level
                if ahead * behind > 0 and (out >= 0 or inside[f]):
                    lit[i, f] = _cornered(planes[i], counts[i], corners[f], 0, 3) and _near(
                        corners[f], one, other, gate
                    )


@lean(error_model="numpy")
def pair_up(lit: Bools, owner: Ints, of: Longs, at: Longs) -> int:
    """List the pairs of a path and a piece of a triangle that it reaches.

    Args:
        lit: (n, f) as `meet_triangles` gives it; owner: (m) triangle of each piece.
        of, at: (n m) get path and piece of each pair, path by path.

    Returns:
        How many pairs there are.
    """
    count = 0
    for i in range(len(lit)):
        for k in range(len(owner)):
            if lit[i, owner[k]]:
                of[count], at[count] = i, k
                count += 1
    return count


@core(error_model="numpy")
def _cornered(planes: Floats, count: int, starts: Floats, begin: int, end: int) -> bool:
    """Whether no plane leaves all corners of an outline outside."""
    for w in range(count):
        some = False
        for e in range(begin, end):
            if dot(planes[w], starts[e]) + planes[w, 3] >= 0:
                some = True
                break
        if not some:
            return False
    return True


@core(error_model="numpy")
def spot(begin: Floats, axis: Floats, size: float, one: Floats, other: Floats, out: Floats) -> float:
    """Point of a wire over which the path between two places is shortest, and that path [m]."""
    z0, z1, h0, h1 = 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        a, b = one[k] - begin[k], other[k] - begin[k]
        z0, z1, h0, h1 = z0 + a * axis[k], z1 + b * axis[k], h0 + a * a, h1 + b * b
    h0, h1 = math.sqrt(max(h0 - z0 * z0, 1e-12)), math.sqrt(max(h1 - z1 * z1, 1e-12))
    place = min(max((z0 * h1 + z1 * h0) / (h0 + h1), 0.0), size)
    for k in range(3):
        out[k] = begin[k] + place * axis[k]
    return math.sqrt(h0 * h0 + (place - z0) ** 2) + math.sqrt(h1 * h1 + (place - z1) ** 2)
