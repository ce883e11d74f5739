"""Beams from mirror images of the transmitter through mirrors, clipped on the face where they end."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ullage.arrays import Floats, Ints, Longs
from ullage.kernels.loops import core, lean
from ullage.kernels.near import height
from ullage.kernels.vectors import apart

MOST = 96  # corners of a clipped outline
FACE, LIT, NONE = np.int64(0), np.int64(2), np.int64(-1)  # outlines of faces and mirrors; no mirror. No literals
SLIVER_M = 1e-7  # parts no wider than this are none: a face that touches a beam is not lit


class ConvexMirrors(NamedTuple):
    """Convex parts (c) of flat faces that can mirror, and those to use."""

    chosen: Longs  # (q) parts to use
    outlines: Floats  # (c, 12, 3) corners [m]
    sizes: Ints  # (c) corners of each
    flat_of: Ints  # (c) flat face of each


class EndFaces(NamedTuple):
    """Flat faces (p), and those on which beams may end."""

    targets: Longs  # (t) faces on which beams may end
    normals: Floats  # (p, 3) unit normals
    offsets: Floats  # (p) plane normal . x = offset [m]
    spheres: Floats  # (p, 4) centre and radius [m]
    loop_of: Ints  # (p + 1) first loop of each face
    loops: Ints  # (l + 1) first edge of each loop
    starts: Floats  # (e, 3) start of each edge [m]


class BeamRows(NamedTuple):
    """Beams (b) as `trace` writes them, with m edges in all."""

    images: Floats  # (b, d, 3) of the transmitter over the first mirror, the first two and so on [m]
    chains: Longs  # (b, d) convex mirrors, -1 for none
    ends_on: Longs  # (b) face on which each ends
    first: Ints  # (b + 1) first edge of each
    edges: Floats  # (m, 2, 3) outlines of the lit parts [m]


class BeamScratch(NamedTuple):
    """Scratch of `trace`."""

    images: Floats  # (d, 3) over the first mirror, the first two and so on [m]
    planes: Floats  # (d, MOST + 2, 4) that bound the beam over so many mirrors
    made: Longs  # (d) how many planes
    chain: Longs  # (d) convex mirrors
    next: Longs  # (d) place of the mirror to try next
    outlines: Floats  # (4, MOST, 3) outlines while they are clipped [m]
    counts: Longs  # (2) beams and edges so far


def scratch(mirrors: int) -> BeamScratch:
    """Allocate the scratch of `trace` over so many mirrors."""
    made, chain, following = np.empty((3, mirrors), np.int64)
    return BeamScratch(np.empty((mirrors, 3)), np.empty((mirrors, MOST + 2, 4)), made, chain, following,
                       np.empty((4, MOST, 3)), np.empty(2, np.int64))  # fmt: skip


@core(error_model="numpy")
def _clipped(outlines: Floats, at: int, count: int, planes: Floats, made: int) -> tuple[int, int]:
    """Keep the part of a closed outline where plane . (x, 1) >= 0 for every plane (Sutherland-Hodgman).

    The outline is outlines[at] or, as it goes to and fro between them, the one after an even `at`.

    Returns:
        Corner count, less than 3 where nothing is left, and which outline holds them.
    """
    for w in range(made):
        if count < 3:
            break
        low, high = 0.0, 0.0
        for i in range(count):
            side = planes[w, 0] * outlines[at, i, 0] + planes[w, 1] * outlines[at, i, 1]
            side += planes[w, 2] * outlines[at, i, 2] + planes[w, 3]
            low, high = min(low, side), max(high, side)
        if high <= SLIVER_M:
            return 0, at
        if low >= -SLIVER_M:
            continue
        kept, to = 0, at ^ 1
        px, py, pz = outlines[at, count - 1, 0], outlines[at, count - 1, 1], outlines[at, count - 1, 2]
        before = planes[w, 0] * px + planes[w, 1] * py + planes[w, 2] * pz + planes[w, 3]
        for i in range(count):
            x, y, z = outlines[at, i, 0], outlines[at, i, 1], outlines[at, i, 2]
            now = planes[w, 0] * x + planes[w, 1] * y + planes[w, 2] * z + planes[w, 3]
            if (now >= 0) != (before >= 0) and kept < MOST - 2:
                s = before / (before - now)
                outlines[to, kept, 0], outlines[to, kept, 1] = px + s * (x - px), py + s * (y - py)
                outlines[to, kept, 2] = pz + s * (z - pz)
                kept += 1
            if now >= 0 and kept < MOST - 2:
                outlines[to, kept, 0], outlines[to, kept, 1], outlines[to, kept, 2] = x, y, z
                kept += 1
            px, py, pz, before = x, y, z, now
        count, at = kept, to
    return count, at


@core(error_model="numpy")
def _walls(
    apex: Floats, outlines: Floats, at: int, count: int, normals: Floats, offsets: Floats, p: int, planes: Floats
) -> int:
    """Write the planes of the beam that leaves face p from an image through outlines[at]; return their count."""
    cx, cy, cz = 0.0, 0.0, 0.0
    for i in range(count):
        cx, cy, cz = cx + outlines[at, i, 0], cy + outlines[at, i, 1], cz + outlines[at, i, 2]
    cx, cy, cz = cx / count, cy / count, cz / count
    made = 0
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        ax, ay, az = outlines[at, i, 0] - apex[0], outlines[at, i, 1] - apex[1], outlines[at, i, 2] - apex[2]
        bx, by, bz = outlines[at, j, 0] - apex[0], outlines[at, j, 1] - apex[1], outlines[at, j, 2] - apex[2]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        size = math.sqrt(nx * nx + ny * ny + nz * nz)
        if size < 1e-12:
            continue
        d = -(nx * apex[0] + ny * apex[1] + nz * apex[2])
        if nx * cx + ny * cy + nz * cz + d < 0:
            size = -size
        planes[made, 0], planes[made, 1], planes[made, 2], planes[made, 3] = nx / size, ny / size, nz / size, d / size
        made += 1
    behind = normals[p, 0] * apex[0] + normals[p, 1] * apex[1] + normals[p, 2] * apex[2] - offsets[p]
    sign = -1.0 if behind > 0 else 1.0
    for k in range(3):
        planes[made, k] = sign * normals[p, k]
    planes[made, 3] = -sign * offsets[p]
    return made + 1


@core(error_model="numpy")
def _reached(spheres: Floats, p: int, planes: Floats, made: int, apex: Floats, receiver: Floats, gate: float) -> bool:
    """Return whether the sphere of face p meets the beam and can echo within the gate."""
    x, y, z, radius = spheres[p, 0], spheres[p, 1], spheres[p, 2], spheres[p, 3]
    for i in range(made):
        if planes[i, 0] * x + planes[i, 1] * y + planes[i, 2] * z + planes[i, 3] < -radius:
            return False
    a = (x - apex[0]) ** 2 + (y - apex[1]) ** 2 + (z - apex[2]) ** 2
    b = (x - receiver[0]) ** 2 + (y - receiver[1]) ** 2 + (z - receiver[2]) ** 2
    return 0.5 * (math.sqrt(a) + math.sqrt(b)) - radius <= gate


@core(error_model="numpy")
def _emit(target: int, planes: Floats, made: int, faces: EndFaces, outlines: Floats, edges: Floats, at: int) -> int:
    """Write the clipped outline of a face as edges (m, 2, 3) from `at` on; return where it ends."""
    loop_of, loops, starts = faces.loop_of, faces.loops, faces.starts
    for ring in range(loop_of[target], loop_of[target + 1]):
        count = np.int64(loops[ring + 1]) - loops[ring]
        if count > MOST - 2:
            continue
        for i in range(count):
            for k in range(3):
                outlines[0, i, k] = starts[loops[ring] + i, k]
        count, lit = _clipped(outlines, FACE, count, planes, made)
        if count < 3:
            continue
        for i in range(count):
            j = i + 1 if i + 1 < count else 0
            if at < len(edges):
                for k in range(3):
                    edges[at, 0, k], edges[at, 1, k] = outlines[lit, i, k], outlines[lit, j, k]
            at += 1
    return at


@core(error_model="numpy")
def _ends(
    last: int, skip: int, receiver: Floats, gate: float, faces: EndFaces, out: BeamRows, scratch: BeamScratch
) -> None:
    """Write the parts of the beam over the mirrors up to `last` that light each of the faces on which beams may end.

    Args:
        last: place of the last mirror in the chain.
        skip: its face.
        receiver: (3) [m].
        gate, faces, out, scratch: as in `trace`.
    """
    at, planes, made = scratch.counts, scratch.planes[last], scratch.made[last]
    for t in faces.targets:
        if t == skip:
            continue
        if not _reached(faces.spheres, t, planes, made, scratch.images[last], receiver, gate):
            continue
        end = _emit(t, planes, made, faces, scratch.outlines, out.edges, at[1])
        if end == at[1]:
            continue
        if at[0] < len(out.ends_on) and end <= len(out.edges):
            for step in range(out.chains.shape[1]):
                out.chains[at[0], step] = scratch.chain[step] if step <= last else NONE
                for k in range(3):
                    out.images[at[0], step, k] = scratch.images[min(step, last), k]
            out.ends_on[at[0]], out.first[at[0] + 1] = t, end
        at[0], at[1] = at[0] + 1, end


@lean(error_model="numpy")
def trace(
    origins: Floats,
    most: int,
    gate: float,
    mirrors: ConvexMirrors,
    faces: EndFaces,
    out: BeamRows,
    scratch: BeamScratch,
) -> tuple[int, int]:
    """Trace every beam of two to `most` bounces: over the mirrors, then on the face where it ends.

    A beam is clipped by each mirror; what is left of the next mirror in it goes on [FunkhouserEtAl1998].

    Args:
        origins: (2, 3) transmitter and receiver [m].
        most: bounces.
        gate: largest mean range [m].
        mirrors: `ConvexMirrors`.
        faces: `EndFaces`.
        out: `BeamRows` gets the beams.
        scratch: `BeamScratch`.

    Returns:
        How many beams and edges there are; only those that fit are written.
    """
    images, planes, made, chain, following, clipped, at = scratch
    normals, offsets, sizes, flat_of = faces.normals, faces.offsets, mirrors.sizes, mirrors.flat_of
    at[0], at[1], following[0] = 0, 0, 0
    out.first[0] = 0
    level = 0
    while level >= 0:
        if following[level] == len(mirrors.chosen):
            level -= 1
            continue
        a = mirrors.chosen[following[level]]
        following[level] += 1
        p, count, lit = np.int64(flat_of[a]), np.int64(sizes[a]), LIT
        source = origins[0]
        if level > 0:
            source = images[level - 1]
            if p == flat_of[chain[level - 1]]:
                continue
            if not _reached(faces.spheres, p, planes[level - 1], made[level - 1], source, source, gate):
                continue
        for i in range(count):
            for k in range(3):
                clipped[2, i, k] = mirrors.outlines[a, i, k]
        if level > 0:
            count, lit = _clipped(clipped, LIT, count, planes[level - 1], made[level - 1])
            if count < 3:
                continue
        _image(source, normals[p], offsets[p], images[level])
        chain[level] = a
        made[level] = _walls(images[level], clipped, lit, count, normals, offsets, p, planes[level])
        _ends(level, p, origins[1], gate, faces, out, scratch)
        if level + 2 < most:
            level += 1
            following[level] = 0
    return at[0], at[1]


@core(error_model="numpy")
def _image(point: Floats, normal: Floats, offset: float, out: Floats) -> None:
    """Write the mirror image of a point in the plane normal . x = offset, never in that plane itself."""
    gap = normal[0] * point[0] + normal[1] * point[1] + normal[2] * point[2] - offset
    gap += height(gap, gap)
    for k in range(3):
        out[k] = point[k] - gap * normal[k]


@lean(error_model="numpy")
def apparent_sizes(
    spheres: Floats, widths: Floats, origins: Floats, gate: float, wavelength: float, out: Floats
) -> None:
    """Compute the apparent size of faces from the nearest antenna, reduced for faces smaller than a Fresnel zone.

    Faces beyond the gate get 0.

    Args:
        spheres: (p, 4) centre and radius, and widths: (p, 2) of the faces [m].
        origins: (k, 3) the places [m].
        gate, wavelength: [m].
        out: (p) gets radius over range.
    """
    for i in range(len(out)):
        out[i] = 0.0
        for s in range(len(origins)):
            gap = apart(spheres[i], origins[s]) + 1e-3
            if gap - spheres[i, 3] <= gate:
                zone = math.sqrt(0.5 * wavelength * gap)
                size = spheres[i, 3] / gap * min(widths[i, 0] / zone, 1.0) * min(widths[i, 1] / zone, 1.0)
                out[i] = max(out[i], size)


@lean(error_model="numpy")
def largest(sizes: Floats, fade: float, most: Floats, which: Longs, weights: Floats) -> int:
    """Choose the faces of the largest apparent size, fewer than `most` has places, and weigh all of them.

    Args:
        sizes: (n) apparent size of each.
        fade: they fade in over this share of the size at which they are taken.
        most: (count + 1) scratch.
        which: (n) gets those that are larger than the largest one left out.
        weights: (n) gets what each counts, 0 for those left out.

    Returns:
        How many they are.
    """
    last = len(most) - 1
    for k in range(last + 1):
        most[k] = 0.0
    for i in range(len(sizes)):
        if sizes[i] > most[last]:
            k = last
            while k > 0 and most[k - 1] < sizes[i]:
                most[k] = most[k - 1]
                k -= 1
            most[k] = sizes[i]
    least, count = most[last] if len(sizes) > last else 0.0, 0
    for i in range(len(sizes)):
        weights[i] = 0.0
        if sizes[i] > least:
            weights[i] = min((sizes[i] / max(least, 1e-12) - 1) / fade, 1.0)
            which[count] = i
            count += 1
    return count
