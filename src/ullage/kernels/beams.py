"""Loops of multipath: beams from mirror images of the transmitter through mirrors, clipped on the face they end on."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ullage.kernels.edges import mirror

MOST = 96  # corners of a clipped outline


@njit(cache=True, nogil=True, error_model="numpy")
def _clip(points, count, plane, out):  # type: ignore[no-untyped-def]
    """Keeps the part of a closed outline where plane . (x, 1) >= 0 (Sutherland-Hodgman); gives the corner count."""
    kept = 0
    if count == 0:
        return 0
    px, py, pz = points[count - 1, 0], points[count - 1, 1], points[count - 1, 2]
    before = plane[0] * px + plane[1] * py + plane[2] * pz + plane[3]
    for i in range(count):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        now = plane[0] * x + plane[1] * y + plane[2] * z + plane[3]
        if (now >= 0) != (before >= 0) and kept < MOST - 2:
            s = before / (before - now)
            out[kept, 0], out[kept, 1], out[kept, 2] = px + s * (x - px), py + s * (y - py), pz + s * (z - pz)
            kept += 1
        if now >= 0 and kept < MOST - 2:
            out[kept, 0], out[kept, 1], out[kept, 2] = x, y, z
            kept += 1
        px, py, pz, before = x, y, z, now
    return kept


@njit(cache=True, nogil=True, error_model="numpy")
def _walls(apex, outline, count, normal, offset, planes):  # type: ignore[no-untyped-def]
    """Planes of the beam from an image through a convex outline, on the side where it comes out; gives their count."""
    cx, cy, cz = 0.0, 0.0, 0.0
    for i in range(count):
        cx, cy, cz = cx + outline[i, 0] / count, cy + outline[i, 1] / count, cz + outline[i, 2] / count
    made = 0
    for i in range(count):
        j = (i + 1) % count
        ax, ay, az = outline[i, 0] - apex[0], outline[i, 1] - apex[1], outline[i, 2] - apex[2]
        bx, by, bz = outline[j, 0] - apex[0], outline[j, 1] - apex[1], outline[j, 2] - apex[2]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        size = math.sqrt(nx * nx + ny * ny + nz * nz)
        if size < 1e-12:
            continue
        d = -(nx * apex[0] + ny * apex[1] + nz * apex[2])
        if nx * cx + ny * cy + nz * cz + d < 0:
            size = -size
        planes[made, 0], planes[made, 1], planes[made, 2], planes[made, 3] = nx / size, ny / size, nz / size, d / size
        made += 1
    behind = normal[0] * apex[0] + normal[1] * apex[1] + normal[2] * apex[2] - offset
    sign = -1.0 if behind > 0 else 1.0
    for k in range(3):
        planes[made, k] = sign * normal[k]
    planes[made, 3] = -sign * offset
    return made + 1


@njit(cache=True, nogil=True, error_model="numpy")
def _reached(sphere, planes, made, apex, receiver, gate):  # type: ignore[no-untyped-def]
    """Whether a face's sphere meets the beam and can echo within the gate."""
    for i in range(made):
        gap = planes[i, 0] * sphere[0] + planes[i, 1] * sphere[1] + planes[i, 2] * sphere[2] + planes[i, 3]
        if gap < -sphere[3]:
            return False
    a, b = 0.0, 0.0
    for k in range(3):
        a += (sphere[k] - apex[k]) ** 2
        b += (sphere[k] - receiver[k]) ** 2
    return 0.5 * (math.sqrt(a) + math.sqrt(b)) - sphere[3] <= gate


@njit(cache=True, nogil=True, error_model="numpy")
def _emit(target, apex, planes, made, loop_of, loops, starts, old, new, edges, at):  # type: ignore[no-untyped-def]
    """Writes the clipped outline of a face as edges (m, 2, 3) from `at` on; gives where it ends."""
    for loop in range(loop_of[target], loop_of[target + 1]):
        count = loops[loop + 1] - loops[loop]
        if count > MOST - 2:
            continue
        for i in range(count):
            for k in range(3):
                old[i, k] = starts[loops[loop] + i, k]
        for i in range(made):
            count = _clip(old, count, planes[i], new)
            old, new = new, old
            if count < 3:
                break
        if count < 3:
            continue
        for i in range(count):
            j = (i + 1) % count
            if at < len(edges):
                for k in range(3):
                    edges[at, 0, k], edges[at, 1, k] = old[i, k], old[j, k]
            at += 1
    return at


@njit(cache=True, nogil=True, error_model="numpy")
def trace(origins, order, gate, mirrors, outlines, sizes, flat_of, normals, offsets, spheres, loop_of, loops, starts,  # type: ignore[no-untyped-def]
          targets, apexes, chains, ends_on, first, edges):  # fmt: skip
    """Every beam of `order` bounces: over one or two mirrors, then on the face it ends on.

    Args:
        origins: (2, 3) transmitter and receiver [m].
        order: 2 or 3.
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

    Returns:
        How many beams and edges there are; only those that fit are written.
    """
    one, two = np.empty(3), np.empty(3)
    planes1, planes2 = np.empty((16, 4)), np.empty((MOST + 2, 4))
    old, new = np.empty((MOST, 3)), np.empty((MOST, 3))
    lit, spare = np.empty((MOST, 3)), np.empty((MOST, 3))
    beams, at = 0, 0
    first[0] = 0
    for a in mirrors:
        p = flat_of[a]
        if _gap(origins[0], normals[p], offsets[p]) < 1e-3:
            continue
        mirror(origins[0], normals[p], offsets[p], one)
        made = _walls(one, outlines[a], sizes[a], normals[p], offsets[p], planes1)
        nexts = targets if order == 2 else mirrors
        for b in nexts:
            q = b if order == 2 else flat_of[b]
            if q == p or _gap(one, normals[q], offsets[q]) < 1e-3:
                continue
            if not _reached(spheres[q], planes1, made, one, origins[1] if order == 2 else one, gate):
                continue
            if order == 2:
                end = _emit(b, one, planes1, made, loop_of, loops, starts, old, new, edges, at)
                if end > at:
                    if beams < len(ends_on) and end <= len(edges):
                        for k in range(3):
                            apexes[beams, k] = one[k]
                        chains[beams, 0], chains[beams, 1] = a, -1
                        ends_on[beams], first[beams + 1] = b, end
                    beams, at = beams + 1, end
                continue
            count = sizes[b]
            for i in range(count):
                for k in range(3):
                    lit[i, k] = outlines[b, i, k]
            for i in range(made):
                count = _clip(lit, count, planes1[i], spare)
                lit, spare = spare, lit
                if count < 3:
                    break
            if count < 3:
                continue
            mirror(one, normals[q], offsets[q], two)
            made2 = _walls(two, lit, count, normals[q], offsets[q], planes2)
            for t in targets:
                if t == q or _gap(two, normals[t], offsets[t]) < 1e-3:
                    continue
                if not _reached(spheres[t], planes2, made2, two, origins[1], gate):
                    continue
                end = _emit(t, two, planes2, made2, loop_of, loops, starts, old, new, edges, at)
                if end > at:
                    if beams < len(ends_on) and end <= len(edges):
                        for k in range(3):
                            apexes[beams, k] = two[k]
                        chains[beams, 0], chains[beams, 1] = a, b
                        ends_on[beams], first[beams + 1] = t, end
                    beams, at = beams + 1, end
    return beams, at


@njit(cache=True, nogil=True, error_model="numpy")
def _gap(point, normal, offset):  # type: ignore[no-untyped-def]
    return abs(normal[0] * point[0] + normal[1] * point[1] + normal[2] * point[2] - offset)
