"""Paths of several bounces: their corners, and the field after their reflections."""

from __future__ import annotations

import math
from typing import NamedTuple

from ullage.arrays import Bools, Complexes, Floats, Ints, Longs
from ullage.kernels.edges import Outline
from ullage.kernels.loops import core, lean
from ullage.kernels.vectors import apart, dot, field_across, mirrored, unit_to


class Mirrors(NamedTuple):
    """Flat faces (p) that reflect a wave of one carrier."""

    normals: Floats  # (p, 3) unit normals
    offsets: Floats  # (p) plane normal . x = offset [m]
    object_ids: Ints  # (p) object of each, which is a row of `gamma`
    widths: Floats  # (p, 2) extent of each along its longest edge and across it [m]
    gamma: Complexes  # (s, 1, 2, c) reflection over cos(incidence), TE and TM
    wavelength_m: float  # of the carrier, for Fresnel zones


class ImagePaths(NamedTuple):
    """Mirror images of the transmitter, one row for each beam (b)."""

    images: Floats  # (b, d, 3) over the first mirror, the first two and so on [m]
    chains: Longs  # (b, d) faces that mirror, -1 for none


class Orientations(NamedTuple):
    """Frames and fields of a transmitter and a receiver, or of those of each path (b)."""

    frames: Floats  # (2, 3, 3) or (b, 2, 3, 3) sensor_from_world rotations
    fields: Floats  # (2, 3) or (b, 2, 3) unit electric fields


class ReflectScratch(NamedTuple):
    """Scratch of `reflect`."""

    units: Floats  # (2, 3)
    field: Complexes  # (3)


@core(error_model="numpy", forceinline=True)
def count_mirrors(chain: Longs) -> int:
    """Count the mirrors of a chain, which ends at its first -1."""
    count = 0
    while count < len(chain) and chain[count] >= 0:
        count += 1
    return count


@core(error_model="numpy", forceinline=True)
def first_leg(path: Floats) -> int:
    """Return the last corner of a path (d, 3) at the transmitter, which stands in for absent mirrors too."""
    first = 0
    while first + 4 < len(path):
        for k in range(3):
            if path[first + 1, k] != path[first, k]:
                return first
        first += 1
    return first


@lean(error_model="numpy")
def stand_ins(
    middle: Floats, outline: Outline, points: Floats, which: Longs, least: Floats, cut: Bools, out: Floats
) -> None:
    """Choose one point on each beam's lit part: the mirror point, or where the path over the outline is shortest.

    Args:
        middle: (b, 3) a point well inside each lit part [m].
        outline: `edges.Outline` of the lit parts, whose faces are the beams.
        points: (k, 3) mirror points [m].
        which: (k) beam of each.
        least, cut: (b), (b), scratch.
        out: (b, 3) gets the points, slightly inside the outline [m].
    """
    pieces, owner, tips, holders = outline.pieces, outline.owner, outline.tips, outline.holders
    count = len(middle)
    for i in range(count):
        least[i], cut[i] = math.inf, False
        for k in range(3):
            out[i, k] = middle[i, k]
    for j in range(len(pieces)):
        i = owner[j]
        cut[i] = True
        for end in range(2):  # two pieces on either side of the least path may be as long: they share this end
            if pieces[j, 6 + end] < least[i]:
                least[i] = pieces[j, 6 + end]
                for k in range(3):
                    out[i, k] = pieces[j, 3 * end + k]
    for j in range(len(tips)):
        i = holders[j]
        if not cut[i] and tips[j, 3] < least[i]:
            least[i] = tips[j, 3]
            for k in range(3):
                out[i, k] = tips[j, k]
    for j in range(len(points)):
        for k in range(3):
            out[which[j], k] = points[j, k]
    for i in range(count):
        share = min((0.02 if cut[i] else 0.1) / max(apart(middle[i], out[i]), 1e-9), 0.5)
        for k in range(3):
            out[i, k] += share * (middle[i, k] - out[i, k])


@core(error_model="numpy")
def _cross(image: Floats, target: Floats, normal: Floats, offset: float, out: Floats) -> None:
    """Write the point where the line from an image to a target crosses a face's plane."""
    here, there = dot(normal, image) - offset, dot(normal, target) - offset
    span = here - there
    share = here / (span if abs(span) > 1e-12 else 1.0)
    share = min(max(share, 0.0), 1.0)
    for k in range(3):
        out[k] = image[k] + share * (target[k] - image[k])


@lean(error_model="numpy")
def legs(
    beams: ImagePaths, normals: Floats, offsets: Floats, origins: Floats, rows: Longs, lit: Floats, out: Floats
) -> None:
    """Find the corners (n, d + 3, 3) of each path from transmitter to receiver.

    With fewer than d mirrors the first corner comes several times.

    Args:
        beams: `ImagePaths`.
        normals: (p, 3) and offsets: (p) of the faces.
        origins: (2, 3) transmitter and receiver [m].
        rows: (n) beam of each path.
        lit: (n, 3) point on the face at the end of each [m].
        out: gets the corners [m].
    """
    images, chains = beams
    most = chains.shape[1]
    for i in range(len(lit)):
        beam, count = rows[i], count_mirrors(chains[rows[i]])
        for k in range(3):
            for step in range(most - count + 1):
                out[i, step, k] = origins[0, k]
            out[i, most + 1, k], out[i, most + 2, k] = lit[i, k], origins[1, k]
        for step in range(count - 1, -1, -1):
            p, corner = chains[beam, step], most - count + 1 + step
            _cross(images[beam, step], out[i, corner + 1], normals[p], offsets[p], out[i, corner])


@lean(error_model="numpy")
def stretches(paths: Floats, wanted: Floats, starts: Floats, ends: Floats, owner: Longs) -> int:
    """Write the ends (m, 3) of the legs of paths (n, d, 3) that are wanted (not 0) and their paths; return m."""
    count = 0
    for i in range(len(paths)):
        if wanted[i] == 0:
            continue
        for step in range(first_leg(paths[i]), paths.shape[1] - 1):
            for k in range(3):
                starts[count, k], ends[count, k] = paths[i, step, k], paths[i, step + 1, k]
            owner[count] = i
            count += 1
    return count


@lean(error_model="numpy")
def middles(first: Ints, edges: Floats, out: Floats) -> None:
    """Write the middle (b, 3) of the outline of each beam by length; a corner that clipping doubles counts once."""
    for i in range(len(first) - 1):
        whole = 0.0
        for k in range(3):
            out[i, k] = 0.0
        for e in range(first[i], first[i + 1]):
            size = apart(edges[e, 0], edges[e, 1])
            whole += size
            for k in range(3):
                out[i, k] += size * 0.5 * (edges[e, 0, k] + edges[e, 1, k])
        for k in range(3):
            out[i, k] = out[i, k] / whole if whole > 0 else edges[first[i], 0, k]


@lean(error_model="numpy")
def cover(
    paths: Floats, chains: Longs, normals: Floats, widths: Floats, wavelength: float, size: Floats, out: Floats
) -> None:
    """Multiply `out` (b) by the share of a wave that each path's mirrors (b, d) reflect.

    A mirror smaller than the Fresnel zone sqrt(lambda d1 d2 / (d1 + d2)) reflects, by Kirchhoff's integral, the area
    it covers over that of the zone's square, side by side; d1 is the path to it, d2 the path from it to the last face.

    Args:
        paths: (b, d + 3, 3) corners from transmitter to receiver [m].
        chains: (b, d) faces that mirror, -1 for none.
        normals: (p, 3) and widths: (p, 2) of the faces [m].
        wavelength: [m].
        size: (d + 1) scratch.
        out: (b) multiplied.
    """
    most = chains.shape[1]
    for i in range(len(paths)):
        total = 0.0
        for j in range(most + 1):
            size[j] = apart(paths[i, j], paths[i, j + 1])
            total += size[j]
        before, count = 0.0, count_mirrors(chains[i])
        for step in range(count):
            face, corner = chains[i, step], most - count + 1 + step
            before += size[corner - 1]
            along = dot(normals[face], paths[i, corner + 1]) - dot(normals[face], paths[i, corner])
            cosine = abs(along) / max(size[corner], 1e-9)
            zone = math.sqrt(wavelength * before * max(total - before, 0.0) / max(total, 1e-9))
            for k in range(2):
                out[i] *= min(1.0, widths[face, k] * math.sqrt(cosine) / max(zone, 1e-9))


@core(error_model="numpy")
def reflect_field(gamma: Complexes, object_id: int, n: Floats, u: Floats, field: Complexes) -> None:
    """Replace the field (3) by that after a bounce: Fresnel's coefficients by polarisation, then mirrored."""
    cosine = abs(dot(n, u))
    place = min(cosine, 1.0) * (gamma.shape[3] - 1)
    i = min(int(place), gamma.shape[3] - 2)
    w = place - i
    te = gamma[object_id, 0, 0, i] * (1 - w) + gamma[object_id, 0, 0, i + 1] * w
    tm = gamma[object_id, 0, 1, i] * (1 - w) + gamma[object_id, 0, 1, i + 1] * w
    sx, sy, sz = u[1] * n[2] - u[2] * n[1], u[2] * n[0] - u[0] * n[2], u[0] * n[1] - u[1] * n[0]
    size = max(math.sqrt(sx * sx + sy * sy + sz * sz), 1e-12)
    sx, sy, sz = sx / size, sy / size, sz / size
    across = (te - tm) * (sx * field[0] + sy * field[1] + sz * field[2])
    field[0], field[1], field[2] = tm * field[0] + across * sx, tm * field[1] + across * sy, tm * field[2] + across * sz
    mirrored(n, field)


@lean(error_model="numpy")
def reflect(
    paths: Floats,
    chains: Longs,
    ends_on: Longs,
    mirrors: Mirrors,
    antennas: Orientations,
    factor: Complexes,
    imaged: Orientations,
    scratch: ReflectScratch,
) -> None:
    """Multiply paths by the effect of all reflections on the transmitted field, as the receiver's polarisation sees it.

    Args:
        paths: (b, d + 3, 3) corners from transmitter to receiver [m].
        chains: (b, d) faces that mirror, -1 for none.
        ends_on: (b) face at the end.
        mirrors: `Mirrors`.
        antennas: `Orientations` of transmitter and receiver.
        factor: (b) multiplied by the reflections; a path whose factor is 0 is skipped.
        imaged: `Orientations` of each path; gets the frames of the transmitter's last image and of
            the receiver; the field of that image for both, since the factor holds the polarisation.
        scratch: `ReflectScratch`.
    """
    normals, object_ids, gamma, fields = mirrors.normals, mirrors.object_ids, mirrors.gamma, antennas.fields
    units, field = scratch
    unit, taken = units[0], units[1]
    for i in range(len(paths)):
        if factor[i] == 0:
            continue
        for side in range(2):
            for k in range(3):
                imaged.fields[i, side, k] = fields[side, k]
                for row in range(3):
                    imaged.frames[i, side, row, k] = antennas.frames[side, row, k]
        count = count_mirrors(chains[i])
        first = chains.shape[1] - count
        for step in range(count):
            n = normals[chains[i, step]]
            for row in range(3):
                mirrored(n, imaged.frames[i, 0, row])
            mirrored(n, imaged.fields[i, 0])
        for k in range(3):
            imaged.fields[i, 1, k] = imaged.fields[i, 0, k]  # `factor` holds the polarisation
        unit_to(paths[i, first], paths[i, first + 1], unit)
        field_across(fields[0], unit, field)
        for step in range(count + 1):
            face = chains[i, step] if step < count else ends_on[i]
            unit_to(paths[i, first + step], paths[i, first + step + 1], unit)
            reflect_field(gamma, object_ids[face], normals[face], unit, field)
        unit_to(paths[i, first + count + 1], paths[i, first + count + 2], unit)
        field_across(fields[1], unit, taken)
        factor[i] *= dot(field, taken)
