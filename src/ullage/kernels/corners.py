"""Loops over corners of flat faces: which faces touch at right angles, and how strong echoes of corners are."""

from __future__ import annotations

import math
from typing import NamedTuple

from ullage.arrays import Floats, Ints
from ullage.kernels.loops import core, lean


class Rims(NamedTuple):
    """Flat faces (p) with their rims of e edges."""

    normals: Floats  # (p, 3) unit normals
    offsets: Floats  # (p) plane normal . x = offset [m]
    spheres: Floats  # (p, 4) centre and radius [m]
    across: Floats  # (p, 2, 3) two unit vectors in each, at right angles
    first: Ints  # (p + 1) first edge of each
    starts: Floats  # (e, 3) [m]
    ends: Floats  # (e, 3) [m]


class CornerFaces(NamedTuple):
    """Flat faces (p), as far as the strength of a corner depends on them."""

    normals: Floats  # (p, 3) unit normals
    offsets: Floats  # (p) plane normal . x = offset [m]
    spheres: Floats  # (p, 4) centre and radius [m]
    widths: Floats  # (p, 2) extents [m]


@core(nogil=True, error_model="numpy")
def _near(rims, a, x, y, z, least):  # type: ignore[no-untyped-def]
    """Return whether a point of the plane of face a lies on that face, or nearer than `least` to its rim."""
    inside = False
    u, v = rims.across[a, 0], rims.across[a, 1]
    for e in range(rims.first[a], rims.first[a + 1]):
        sx, sy, sz = rims.starts[e, 0] - x, rims.starts[e, 1] - y, rims.starts[e, 2] - z
        ex, ey, ez = rims.ends[e, 0] - x, rims.ends[e, 1] - y, rims.ends[e, 2] - z
        su, sv = u[0] * sx + u[1] * sy + u[2] * sz, v[0] * sx + v[1] * sy + v[2] * sz
        eu, ev = u[0] * ex + u[1] * ey + u[2] * ez, v[0] * ex + v[1] * ey + v[2] * ez
        if (sv > 0) != (ev > 0) and su + (eu - su) * sv / (sv - ev) > 0:
            inside = not inside
        du, dv = eu - su, ev - sv
        share = min(max(-(su * du + sv * dv) / max(du * du + dv * dv, 1e-30), 0.0), 1.0)
        if (su + share * du) ** 2 + (sv + share * dv) ** 2 <= least * least:
            return True
    return inside


@core(nogil=True, error_model="numpy")
def _above(rims, a, point):  # type: ignore[no-untyped-def]
    """Height of a point over the plane of face a [m]."""
    n = rims.normals[a]
    return n[0] * point[0] + n[1] * point[1] + n[2] * point[2] - rims.offsets[a]


@core(nogil=True, error_model="numpy")
def _stands_on(rims, a, b, least):  # type: ignore[no-untyped-def]
    """Return whether an edge of face b lies on face a, to `least`."""
    for e in range(rims.first[b], rims.first[b + 1]):
        if abs(_above(rims, a, rims.starts[e])) > least or abs(_above(rims, a, rims.ends[e])) > least:
            continue
        for place in range(3):
            t = 0.1 + 0.4 * place
            x = rims.starts[e, 0] + t * (rims.ends[e, 0] - rims.starts[e, 0])
            y = rims.starts[e, 1] + t * (rims.ends[e, 1] - rims.starts[e, 1])
            z = rims.starts[e, 2] + t * (rims.ends[e, 2] - rims.starts[e, 2])
            if _near(rims, a, x, y, z, least):
                return True
    return False


@core(nogil=True, error_model="numpy")
def _side(rims, a, b, least):  # type: ignore[no-untyped-def]
    """Return on which side of face a face b lies: 1 or -1, or 0 for both."""
    low, high = 0.0, 0.0
    for e in range(rims.first[b], rims.first[b + 1]):
        above = _above(rims, a, rims.starts[e])
        low, high = min(low, above), max(high, above)
    if low < -least and high > least:
        return 0
    return 1 if high > -low else -1


@lean(by_fields=True, nogil=True, error_model="numpy")
def touching(rims: Rims, asked, cosine, least, pairs, sides):  # type: ignore[no-untyped-def]
    """Find the pairs of faces that touch about at right angles.

    Args:
        rims: `Rims`.
        asked: (p) the faces to compare.
        cosine: greatest of the angle between them.
        least: gaps up to this count as touching [m].
        pairs: (m, 2) gets the pairs that fit.
        sides: (m, 2) gets the side of the first face on which the second one lies, and that of the second: 1, -1, or 0
            for both.

    Returns:
        How many pairs there are.
    """
    normals, spheres, found = rims.normals, rims.spheres, 0
    for a in range(len(asked)):
        if not asked[a]:
            continue
        for b in range(a + 1, len(asked)):
            gap = spheres[a, 3] + spheres[b, 3] + least
            x, y, z = spheres[a, 0] - spheres[b, 0], spheres[a, 1] - spheres[b, 1], spheres[a, 2] - spheres[b, 2]
            if not asked[b] or x * x + y * y + z * z > gap * gap:
                continue
            dot = normals[a, 0] * normals[b, 0] + normals[a, 1] * normals[b, 1] + normals[a, 2] * normals[b, 2]
            if abs(dot) > cosine:
                continue
            if not (_stands_on(rims, a, b, least) or _stands_on(rims, b, a, least)):
                continue
            if found < len(pairs):
                pairs[found, 0], pairs[found, 1] = a, b
                sides[found, 0], sides[found, 1] = _side(rims, a, b, least), _side(rims, b, a, least)
            found += 1
    return found


@core(nogil=True, error_model="numpy")
def _in_front(faces, chain, sides, origins):  # type: ignore[no-untyped-def]
    """Return whether both antennas stand on the inner side of all faces of a corner."""
    for step in range(3):
        p = chain[step]
        if p < 0:
            break
        one, other = -faces.offsets[p], -faces.offsets[p]
        for k in range(3):
            one += faces.normals[p, k] * origins[0, k]
            other += faces.normals[p, k] * origins[1, k]
        if one * other <= 0 or one * sides[step] < 0:
            return False
    return True


@lean(by_fields=True, nogil=True, error_model="numpy")
def strengths(origins, gate, wavelength, chains, sides, faces: CornerFaces, out, lengths, images):  # type: ignore[no-untyped-def]
    """Estimate how strong the echoes of corners are, over that of an endless mirror at their range.

    The mirror path over all faces meets each plane at one point. Two right angles, or three, return a wave to where it
    came from, so that the path runs over the fold, or over the corner. The echo falls with the distance of these
    points from the faces, and where faces do not fill their Fresnel zone.

    Args:
        origins: (2, 3) transmitter and receiver [m].
        gate: largest mean range [m].
        wavelength: [m].
        chains: (n, 3) faces as the wave meets them, -1 for none.
        sides: (n, 3) side of each face on which the corner is open, 0 for both.
        faces: `CornerFaces`.
        out: (n) gets the estimates, 0 where nothing returns.
        lengths: (n) gets the lengths of the paths there and back, where something returns [m].
        images: (5, 3) scratch.
    """
    for i in range(len(chains)):
        out[i], lengths[i] = 0.0, 1.0
        if not _in_front(faces, chains[i], sides[i], origins):
            continue
        count = 3 if chains[i, 2] >= 0 else 2
        for k in range(3):
            images[0, k], images[4, k] = origins[0, k], origins[1, k]
        for step in range(count):
            p, gap = chains[i, step], -faces.offsets[chains[i, step]]
            for k in range(3):
                gap += faces.normals[p, k] * images[step, k]
            for k in range(3):
                images[step + 1, k] = images[step, k] - 2 * gap * faces.normals[p, k]
        square = 0.0
        for k in range(3):
            square += (images[count, k] - origins[1, k]) ** 2
        length, miss, share, narrow = max(math.sqrt(square), 1e-3), 0.0, 1.0, math.inf
        if 0.5 * length > gate:
            continue
        zone = math.sqrt(0.25 * wavelength * length)
        for step in range(count - 1, -1, -1):
            p = chains[i, step]
            here, there, away = -faces.offsets[p], -faces.offsets[p], 0.0
            for k in range(3):
                here += faces.normals[p, k] * images[step + 1, k]
                there += faces.normals[p, k] * images[4, k]
            span = here - there
            t = min(max(-there / (span if abs(span) > 1e-12 else 1.0), 0.0), 1.0)
            for k in range(3):
                images[4, k] += t * (images[step + 1, k] - images[4, k])
                away += (images[4, k] - faces.spheres[p, k]) ** 2
            miss += max(math.sqrt(away) - faces.spheres[p, 3], 0.0)
            fill = min(faces.widths[p, 0] / zone, 1.0) * min(faces.widths[p, 1] / zone, 1.0)
            share, narrow = min(share, fill), min(narrow, max(faces.widths[p, 0], faces.widths[p, 1]))
        lengths[i] = length
        out[i] = share / (1 + math.pi * miss * min(narrow, zone) / (zone * zone))
