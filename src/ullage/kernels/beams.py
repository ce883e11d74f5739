"""Loops of multipath: beams from mirror images of the transmitter through mirrors, clipped on the face they end on."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.kernels.loops import core, lean
from ullage.kernels.near import height

MOST = 96  # corners of a clipped outline
FACE, LIT, NONE = np.int64(0), np.int64(2), np.int64(-1)  # outlines of faces and mirrors; no mirror. No literals
SLIVER_M = 1e-7  # parts no wider than this are none: a face that touches a beam is not lit


def scratch() -> tuple[NDArray[Any], ...]:
    """Room for `trace`: two images, the planes of two beams, outlines, and counts."""
    return (np.empty(3), np.empty(3), np.empty((MOST + 2, 4)), np.empty((MOST + 2, 4)), np.empty((4, MOST, 3)),
            np.empty(2, np.int64))  # fmt: skip


@core(nogil=True, error_model="numpy")
def _clipped(outlines, at, count, planes, made):  # type: ignore[no-untyped-def]
    """Keeps the part of a closed outline where plane . (x, 1) >= 0 for every plane (Sutherland-Hodgman).

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


@core(nogil=True, error_model="numpy")
def _walls(apex, outlines, at, count, normals, offsets, p, planes):  # type: ignore[no-untyped-def]
    """Planes of the beam from an image through outlines[at] in face p, on the side where it comes out; their count."""
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


@core(nogil=True, error_model="numpy")
def _reached(spheres, p, planes, made, apex, receiver, gate):  # type: ignore[no-untyped-def]
    """Whether the sphere of face p meets the beam and can echo within the gate."""
    x, y, z, radius = spheres[p, 0], spheres[p, 1], spheres[p, 2], spheres[p, 3]
    for i in range(made):
        if planes[i, 0] * x + planes[i, 1] * y + planes[i, 2] * z + planes[i, 3] < -radius:
            return False
    a = (x - apex[0]) ** 2 + (y - apex[1]) ** 2 + (z - apex[2]) ** 2
    b = (x - receiver[0]) ** 2 + (y - receiver[1]) ** 2 + (z - receiver[2]) ** 2
    return 0.5 * (math.sqrt(a) + math.sqrt(b)) - radius <= gate


@core(nogil=True, error_model="numpy")
def _emit(target, planes, made, loop_of, loops, starts, outlines, edges, at):  # type: ignore[no-untyped-def]
    """Writes the clipped outline of a face as edges (m, 2, 3) from `at` on; gives where it ends."""
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


@core(nogil=True, error_model="numpy")
def _ends(apex, planes, made, a, b, skip, receiver, gate, targets, normals, offsets, spheres, loop_of, loops, starts,  # type: ignore[no-untyped-def]
          outlines, apexes, chains, ends_on, first, edges, at):  # fmt: skip
    """Writes the beams from an image through `made` planes to every face they may end on.

    Args:
        apex: (3) the transmitter's image [m].
        planes: (made, 4) of the beam.
        a, b: mirrors that it came over, -1 for none; skip: the face of the last.
        outlines: (4, MOST, 3) scratch.
        at: (2) how many beams and edges there are; the rest as in `trace`.
    """
    for t in targets:
        if t == skip:
            continue
        if not _reached(spheres, t, planes, made, apex, receiver, gate):
            continue
        end = _emit(t, planes, made, loop_of, loops, starts, outlines, edges, at[1])
        if end == at[1]:
            continue
        if at[0] < len(ends_on) and end <= len(edges):
            for k in range(3):
                apexes[at[0], k] = apex[k]
            chains[at[0], 0], chains[at[0], 1] = a, b
            ends_on[at[0]], first[at[0] + 1] = t, end
        at[0], at[1] = at[0] + 1, end


@lean(nogil=True, error_model="numpy")
def trace(origins, most, gate, mirrors, outlines, sizes, flat_of, normals, offsets, spheres, loop_of, loops, starts,  # type: ignore[no-untyped-def]
          targets, apexes, chains, ends_on, first, edges, one, two, planes1, planes2, clipped, at):  # fmt: skip
    """Every beam of two or three bounces: over one or two mirrors, then on the face it ends on.

    Args:
        origins: (2, 3) transmitter and receiver [m].
        most: bounces, 2 or 3.
        gate: largest mean range [m].
        mirrors: (q) convex mirrors to use.
        outlines: (c, 12, 3) corners of each convex mirror [m].
        sizes: (c) how many corners.
        flat_of: (c) flat face each belongs to.
        normals: (p, 3), offsets: (p), spheres: (p, 4) of the flat faces.
        loop_of: (p + 1) first loop of each face; loops: (l + 1) first edge of each loop; starts: (e, 3) [m].
        targets: (t) faces where beams may end.
        apexes: (b, 3) gets the transmitter's images; chains: (b, 2) the mirrors, -1 for none; ends_on: (b) the face.
        first: (b + 1) gets the first edge of each beam; edges: (m, 2, 3) the outlines.
        one, two, planes1, planes2, clipped, at: as `scratch` gives them.

    Returns:
        How many beams and edges there are; only those that fit are written.
    """
    at[0], at[1] = 0, 0
    first[0] = 0
    for a in mirrors:
        p = np.int64(flat_of[a])
        _image(origins[0], normals[p], offsets[p], one)
        for i in range(sizes[a]):
            for k in range(3):
                clipped[2, i, k] = outlines[a, i, k]
        made = _walls(one, clipped, LIT, np.int64(sizes[a]), normals, offsets, p, planes1)
        _ends(one, planes1, made, a, NONE, p, origins[1], gate, targets, normals, offsets, spheres, loop_of, loops,
              starts, clipped, apexes, chains, ends_on, first, edges, at)  # fmt: skip
        for b in mirrors:
            q = np.int64(flat_of[b])
            if most < 3 or q == p:
                continue
            if not _reached(spheres, q, planes1, made, one, one, gate):
                continue
            for i in range(sizes[b]):
                for k in range(3):
                    clipped[2, i, k] = outlines[b, i, k]
            count, lit = _clipped(clipped, LIT, np.int64(sizes[b]), planes1, made)
            if count < 3:
                continue
            _image(one, normals[q], offsets[q], two)
            made2 = _walls(two, clipped, lit, count, normals, offsets, q, planes2)
            _ends(two, planes2, made2, a, b, q, origins[1], gate, targets, normals, offsets, spheres, loop_of, loops,
                  starts, clipped, apexes, chains, ends_on, first, edges, at)  # fmt: skip
    return at[0], at[1]


@core(nogil=True, error_model="numpy")
def _image(point, normal, offset, out):  # type: ignore[no-untyped-def]
    """The mirror image of a point in the plane normal . x = offset, never in that plane itself."""
    gap = normal[0] * point[0] + normal[1] * point[1] + normal[2] * point[2] - offset
    gap += height(gap, gap)
    for k in range(3):
        out[k] = point[k] - gap * normal[k]


@lean(nogil=True, error_model="numpy")
def looks(spheres, widths, origins, gate, wavelength, out):  # type: ignore[no-untyped-def]
    """How large faces look from the place nearest to each, less what they lack of a Fresnel zone; 0 beyond the gate.

    Args:
        spheres: (p, 4) centre and radius, and widths: (p, 2) of the faces [m].
        origins: (k, 3) the places [m].
        gate, wavelength: [m].
        out: (p) gets radius over range.
    """
    for i in range(len(out)):
        out[i] = 0.0
        for s in range(len(origins)):
            square = 0.0
            for k in range(3):
                square += (spheres[i, k] - origins[s, k]) ** 2
            gap = math.sqrt(square) + 1e-3
            if gap - spheres[i, 3] <= gate:
                zone = math.sqrt(0.5 * wavelength * gap)
                look = spheres[i, 3] / gap * min(widths[i, 0] / zone, 1.0) * min(widths[i, 1] / zone, 1.0)
                out[i] = max(out[i], look)


@lean(nogil=True, error_model="numpy")
def largest(look, fade, most, which, weights):  # type: ignore[no-untyped-def]
    """Those that look largest, fewer than `most` has places, and what each of all counts.

    Args:
        look: (n) how large each looks.
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
    for i in range(len(look)):
        if look[i] > most[last]:
            k = last
            while k > 0 and most[k - 1] < look[i]:
                most[k] = most[k - 1]
                k -= 1
            most[k] = look[i]
    least, count = most[last] if len(look) > last else 0.0, 0
    for i in range(len(look)):
        weights[i] = 0.0
        if look[i] > least:
            weights[i] = min((look[i] / max(least, 1e-12) - 1) / fade, 1.0)
            which[count] = i
            count += 1
    return count
