"""Loops that add the echoes of the outlines and mirror images of flat faces to the delay grids."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ullage.arrays import Bools, Complexes, Floats, Ints, Longs
from ullage.kernels.edges import FaceOutlines, Outline
from ullage.kernels.facets import (
    EDGE,
    VERTEX,
    EchoSums,
    LitFaces,
    PulseGrid,
    Transmission,
    _accumulate,
    _late,
    _reflection,
    same,
    sight,
    te_share,
    turned,
)
from ullage.kernels.loops import core, lean
from ullage.kernels.near import eased, height
from ullage.kernels.vectors import dot

C0 = 299_792_458.0
START, STOP = np.int64(0), np.int64(3)  # columns of a piece's ends


class OutlineEchoes(NamedTuple):
    """What of outlines echoes: pieces (m), and ends of outlines followed by mirror points (n)."""

    pieces: Floats  # (m, 12) as `edges.cut` gives them
    ends: Floats  # (n, 9) ends as `edges.cut` gives them, then mirror points as `crossings` does
    tips: int  # how many of these are ends
    owner: Ints  # (m + n) face of each


class KnownEnd(NamedTuple):
    """What is known of the far end of the last piece, for each tap of the reflection."""

    weight: Complexes  # (taps) antenna gains times the reflection coefficient
    cosine: Floats  # (taps) cos(incidence)


class Spots(NamedTuple):
    """Points (m) at which faces are looked at."""

    places: Floats  # (m, 3) [m]
    faces: Longs  # (m) face of each


class LineEcho(NamedTuple):
    """Echo of a line whose amplitude is linear along it, and whose phase nearly is."""

    start: complex  # amplitude at the start
    stop: complex  # amplitude at the end
    start_delay_s: float  # delay of the path to the start [s]
    stop_delay_s: float  # delay of the path to the end [s]
    bow: float  # as in `accumulate_line` [rad]


@lean(fastmath=True, error_model="numpy")
def look_at(outline: Outline, normals: Floats, inward: float, spots: Spots, seats: Longs) -> int:
    """Find points on faces from which pieces and ends of outlines are seen, `inward` of them [m].

    An end from which a piece goes on is seen where that piece is.

    Args:
        outline: `edges.Outline` (m, n).
        normals: (p, 3) of the faces.
        inward: distance from the edge into the face [m].
        spots: `Spots`, written.
        seats: (m + n) gets which of the points each piece, then each end, is seen by.

    Returns:
        How many points there are.
    """
    pieces, owner, tips, ties = outline.pieces, outline.owner, outline.tips, outline.ties
    out, faces = spots.places, spots.faces
    count = len(pieces)
    for i in range(count):
        p = owner[i]
        nx, ny, nz = normals[p, 0], normals[p, 1], normals[p, 2]
        ex, ey, ez = pieces[i, 3] - pieces[i, 0], pieces[i, 4] - pieces[i, 1], pieces[i, 5] - pieces[i, 2]
        x, y, z = ny * ez - nz * ey, nz * ex - nx * ez, nx * ey - ny * ex
        scale = inward / max(math.sqrt(x * x + y * y + z * z), 1e-12)
        out[i, 0] = 0.5 * (pieces[i, 0] + pieces[i, 3]) + scale * x
        out[i, 1] = 0.5 * (pieces[i, 1] + pieces[i, 4]) + scale * y
        out[i, 2] = 0.5 * (pieces[i, 2] + pieces[i, 5]) + scale * z
        faces[i], seats[i] = p, i
    for i in range(len(tips)):
        seats[len(pieces) + i] = ties[i]
        if ties[i] >= 0:
            continue
        square = 0.0
        for k in range(3):
            square += tips[i, 6 + k] ** 2
        scale = math.sqrt(2) * inward / max(math.sqrt(square), 0.1)
        for k in range(3):
            out[count, k] = tips[i, k] + scale * tips[i, 6 + k]
        faces[count], seats[len(pieces) + i] = outline.holders[i], count
        count += 1
    return count


@core(fastmath=True, error_model="numpy")
def _weight(rows: Floats, k: int, at: int, lit: LitFaces, face: int, tap: int) -> tuple[complex, float]:
    """Antenna gains times the reflection coefficient at the point rows[k, at : at + 3] of a face; cos(incidence)."""
    normals, antennas = lit.normals, lit.antennas
    o = face if len(antennas.origins) > 1 else 0
    nx, ny, nz = normals[face, 0], normals[face, 1], normals[face, 2]
    gain, cosine, share, both = 1.0 + 0j, 0.0, 0.0, 0.0
    for s in range(2):
        _, ux, uy, uz, one = sight(antennas, o, s, rows[k, at], rows[k, at + 1], rows[k, at + 2])
        te, whole = te_share(antennas.fields, o, ux, uy, uz, nx, ny, nz)
        share, both = share + 0.5 * te, both + 0.5 * whole
        gain *= one
        cosine += 0.5 * abs(ux * nx + uy * ny + uz * nz)
        if s == 0 and same(antennas, o):
            gain *= one
            cosine *= 2
            share, both = te, whole
            break
    return gain * _reflection(lit.reflection.gamma, lit.materials[face], tap, cosine, share, both), cosine


@lean(fastmath=True, error_model="numpy")
def weigh(points: Floats, lit: LitFaces, out: Complexes) -> None:
    """Write antenna gains times reflection times cos(incidence) at points (n, 3), each on a face of its own (n)."""
    for i in range(len(points)):
        value, cosine = _weight(points, i, 0, lit, i, 0)
        out[i] = value * cosine


@core(fastmath=True, error_model="numpy")
def accumulate_line(
    grids: Complexes, w0: complex, w1: complex, x0: float, x1: float, bow: float, place0: float, place1: float
) -> complex:
    """Add the echo of a line of unit measure, its amplitude linear and its phase nearly linear; give it at the carrier.

    Phases are those of the mean line; the true phase leads it by bow (4 s (1 - s) - 2 / 3) at share s, to first order.
    """
    z = x1 - x0
    y = 0.5 * z
    y2 = y * y
    scale = 1 - 0.0444 * bow * bow
    mean, half = 0.5 * (w0 + w1), 0.5 * (w1 - w0)
    if abs(z) < 0.9:
        value = mean * complex(1 - y2 / 6 + y2 * y2 / 120, bow * y2 * (2 / 45 - 0.00317 * y2))
        value -= half * complex(0.0, y / 3 * (1 - y2 / 10))
        value *= scale * turned(0.5 * (x0 + x1))
        _accumulate(grids, EDGE, 0.5 * (place0 + place1), value)
        return value
    slope = (w1 - w0) / (z * z)
    bent = mean * complex(bow * (1 / y2 - 1.0 / 3) / y, 0.0)
    even = mean * complex(0.0, -bow / y2)
    at0 = scale * turned(x0) * (bent + even - slope - w0 * complex(0.0, 1 / z))
    at1 = scale * turned(x1) * (slope + even - bent + w1 * complex(0.0, 1 / z))
    _accumulate(grids, VERTEX, place0, at0)
    _accumulate(grids, VERTEX, place1, at1)
    return at0 + at1


@core(fastmath=True, error_model="numpy", forceinline=True)
def accumulate_pulses(
    grids: Complexes, pulse: PulseGrid, lines: bool, kind: int, line: LineEcho, late: float, mean: float
) -> complex:
    """Add an echo to the delay grids wherever a pulse brings it, once each `pulse.fold_s`.

    Args:
        grids: (3, g) as in `facets.EchoSums`.
        pulse: `facets.PulseGrid`.
        lines: whether the echo is that of a line, or that of a point of strength `line.start`.
        kind: spectral kind of a point.
        line: `LineEcho`.
        late: delay added to that of the paths [s].
        mean: mean delay of the whole echo [s].

    Returns:
        The echo of one pulse at the carrier.
    """
    omega, start, step, fold = pulse.omega, pulse.start_s, pulse.step_s, pulse.fold_s
    echo, shift = 0j, late - math.floor((mean - start) / fold) * fold
    while mean - late + shift < start + grids.shape[1] * step:
        a, b = line.start_delay_s + shift, line.stop_delay_s + shift
        if lines:
            value = accumulate_line(grids, line.start, line.stop, omega * a, omega * b, line.bow, (a - start) / step,
                                    (b - start) / step)  # fmt: skip
        else:
            value = line.start * turned(omega * a)
            _accumulate(grids, kind, (a - start) / step, value)
        echo += value if mean - late + shift < start + fold else 0j  # a pulse later it is the same echo
        shift += fold
    return echo


@core(fastmath=True, error_model="numpy", forceinline=True)
def _ends_of(
    echoes: OutlineEchoes, k: int, follows: bool, lit: LitFaces, tap: int, known: KnownEnd
) -> tuple[complex, complex, float]:
    """Weights of both ends of piece k of an outline, and the mean of cos(incidence) there.

    Where it `follows` the piece before, the weight of its start is kept in `known`, as that of its end is.
    """
    w0, c0 = known.weight[tap], known.cosine[tap]
    if not follows:
        w0, c0 = _weight(echoes.pieces, k, START, lit, echoes.owner[k], tap)
    w1, c1 = _weight(echoes.pieces, k, STOP, lit, echoes.owner[k], tap)
    known.weight[tap], known.cosine[tap] = w1, c1
    return w0, w1, 0.5 * (c0 + c1)


@core(fastmath=True, error_model="numpy", forceinline=True)
def _piece(pieces: Floats, k: int, w0: complex, w1: complex, scale: complex, omega: float) -> LineEcho:
    """The echo of piece k of an outline, of which the weights of both ends are known."""
    wave = omega / C0
    w0 *= pieces[k, 8] * eased(wave, pieces[k, 6]) * pieces[k, 10] * scale
    w1 *= pieces[k, 9] * eased(wave, pieces[k, 7]) * pieces[k, 10] * scale
    return LineEcho(w0, w1, pieces[k, 6] / C0, pieces[k, 7] / C0, -1.5 * omega * pieces[k, 11] / C0)


@core(fastmath=True, error_model="numpy", forceinline=True)
def _tip(
    ends: Floats, i: int, scale: complex, extra: float, tap: int, lit: LitFaces, face: int, wave: float
) -> tuple[LineEcho, float]:
    """The echo of an end of an outline or of a mirror point, and its additional delay [s]."""
    weight, cosine = _weight(ends, i, START, lit, face, tap)
    weight *= eased(wave, ends[i, 3]) * scale * complex(ends[i, 4], ends[i, 5])
    late = extra + _late(lit.reflection.lag, lit.materials[face], tap, cosine)
    return LineEcho(weight, 0j, ends[i, 3] / C0, ends[i, 3] / C0, 0.0), late


@lean(fastmath=True, error_model="numpy")
def accumulate_outlines(
    echoes: OutlineEchoes, lit: LitFaces, between: Transmission, pulse: PulseGrid, sums: EchoSums, known: KnownEnd
) -> None:
    """Add the echoes of faces to the delay grids: pieces of outlines, ends of outlines, and mirror points.

    Args:
        echoes: `OutlineEchoes` (m + n).
        lit: `facets.LitFaces`, with one radar for all or one for each face.
        between: `facets.Transmission` (m + n).
        pulse: `facets.PulseGrid`.
        sums: `facets.EchoSums` (m + n), written.
        known: `KnownEnd`, scratch.
    """
    pieces, ends, owner, gamma, lag = echoes.pieces, echoes.ends, echoes.owner, lit.reflection.gamma, lit.reflection.lag
    omega = pulse.omega
    unit, wave = -(2 * math.pi * C0 / omega) / (16 * math.pi * math.pi), omega / C0
    last = -2  # the piece whose far end's weights are kept: the next one mostly starts there
    for k in range(len(owner)):
        sums.echo[k], sums.delay_s[k] = 0j, 0.0
        if between.factor[k] == 0:
            continue
        face = owner[k]
        o = face if len(lit.antennas.origins) > 1 else 0
        scale = unit * lit.antennas.factor[o] * between.factor[k]
        i = k - len(pieces)
        follows = i < 0 and k > 0 and last == k - 1 and owner[last] == face
        for j in range(3 if follows else 0):
            follows = follows and pieces[last, 3 + j] == pieces[k, j]
        last = k
        for tap in range(gamma.shape[1]):
            if lag[lit.materials[face], tap, 0] < 0:
                break
            if i < 0:
                w0, w1, cosine = _ends_of(echoes, k, follows, lit, tap, known)
                late = between.delay_s[k] + _late(lag, lit.materials[face], tap, cosine)
                late += pieces[k, 11] / C0
                line = _piece(pieces, k, w0, w1, scale, omega)
            else:
                line, late = _tip(ends, i, scale, between.delay_s[k], tap, lit, face, wave)
            mean = 0.5 * (line.start_delay_s + line.stop_delay_s) + late
            if tap == 0:
                sums.delay_s[k] = mean
            kind = VERTEX if i < echoes.tips else EDGE
            sums.echo[k] += accumulate_pulses(sums.grids, pulse, i < 0, kind, line, late, mean)


@lean(fastmath=True, error_model="numpy")
def crossings(
    patches: Longs, windings: Floats, normals: Floats, offsets: Floats, origins: Floats, limits: Floats, points: Floats
) -> int:
    """Find where the lines from image to receiver cross the faces that hold them: (k, 9) rows as for ends of outlines.

    Those whose mean range lies beyond the face's limit are left out, as their outlines are.

    Returns:
        How many there are; `patches` is compacted to match, in place.
    """
    count = 0
    for i in range(len(patches)):
        if not windings[i] > 0.5:
            continue
        p = patches[i]
        o = p if len(origins) > 1 else 0
        front, back = dot(normals[p], origins[o, 1]) - offsets[p], dot(normals[p], origins[o, 0]) - offsets[p]
        square = 0.0
        ahead, behind = height(front, back), height(back, front)
        for k in range(3):
            points[count, k] = origins[o, 0, k] - (behind + back) * normals[p, k]
            square += (origins[o, 1, k] + (ahead - front) * normals[p, k] - points[count, k]) ** 2
        limit = limits[p] if len(limits) > 1 else limits[0]
        if square > 4 * limit * limit:
            continue
        share = behind / (ahead + behind)
        for k in range(3):
            points[count, k] += share * (origins[o, 1, k] + (ahead - front) * normals[p, k] - points[count, k])
            points[count, 6 + k] = 0.0
        points[count, 3] = math.sqrt(square)
        points[count, 4], points[count, 5] = -4 * math.pi / points[count, 3], 0.0  # over what outlines have in common
        patches[count] = p
        count += 1
    return count


@lean(error_model="numpy")
def look_about(
    points: Floats,
    which: Longs,
    faces: FaceOutlines,
    across: Floats,
    zone: Floats,
    wavelength: float,
    spots: Spots,
    within: Bools,
) -> int:
    """Find the places about mirror points that lie on their faces.

    Args:
        points: (k, 9) mirror points, as `crossings` gives them.
        which: (k) face of each.
        faces: `edges.FaceOutlines` (p).
        across: (p, 2, 3) unit vectors in the faces, at right angles.
        zone: (z, 2) places over the zone's radius, the first in its middle.
        wavelength: [m].
        spots: `Spots` (k z or fewer), written in order.
        within: (k, z) gets which places lie on their faces: those in the middle do.

    Returns:
        How many places there are.
    """
    row = 0
    for i in range(len(points)):
        p, radius = which[i], math.sqrt(0.25 * wavelength * points[i, 3])
        for j in range(len(zone)):
            for k in range(3):
                away = zone[j, 0] * across[p, 0, k] + zone[j, 1] * across[p, 1, k]
                spots.places[row, k] = points[i, k] + radius * away
            spots.faces[row] = p
            within[i, j] = j == 0 or held(spots.places[row], p, faces.normals, faces.first, faces.starts, faces.ends)
            if within[i, j]:
                row += 1
    return row


@lean(error_model="numpy")
def through_sheets(
    transmission: Complexes,
    extra: Floats,
    within: Bools,
    inner: int,
    between: Transmission,
    lit: Bools,
    bordered: Bools,
) -> None:
    """Average what sheets let through over the lit places about mirror points, and find those near shadow borders.

    Args:
        transmission: (n) complex factor of what stands before the places on faces, in order; 0 where one is hidden.
        extra: (n) delay [s].
        within: (k, z) whether each place lies on its face.
        inner: how many of the places count; those farther off count where none of these is lit.
        between: `facets.Transmission` (k), written.
        lit: (k) gets whether the mirror points are lit.
        bordered: (k) gets whether some places are lit and others hidden.
    """
    row = 0
    for i in range(len(within)):
        lit[i] = transmission[row] != 0
        factor, late, count, dark, near = 0j, 0.0, 0, False, False
        for j in range(within.shape[1]):
            if not within[i, j]:
                continue
            if transmission[row] == 0:
                dark = True
            elif j < inner or not near:
                factor, late, count = factor + transmission[row], late + extra[row], count + 1
                near = j < inner
            row += 1
        between.factor[i], between.delay_s[i] = factor / max(count, 1), late / max(count, 1)
        bordered[i] = dark and count > 0


@core(error_model="numpy")
def held(point: Floats, p: int, normals: Floats, first: Ints, starts: Floats, ends: Floats) -> bool:
    """Whether a point lies within face p: a line from it crosses the outline an odd number of times."""
    ax, ay, az = abs(normals[p, 0]), abs(normals[p, 1]), abs(normals[p, 2])
    u, v = np.int64(0), np.int64(1)  # the two axes across which the face is largest
    if ax >= ay and ax >= az:
        u, v = np.int64(1), np.int64(2)
    elif ay >= az:
        v = np.int64(2)
    x, y = point[u], point[v]
    odd = False
    for e in range(first[p], first[p + 1]):
        above = starts[e, v] > y
        if above != (ends[e, v] > y):
            left = x - starts[e, u]
            rise = ends[e, v] - starts[e, v]
            if (left * rise < (ends[e, u] - starts[e, u]) * (y - starts[e, v])) == (rise > 0):
                odd = not odd
    return odd


@lean(error_model="numpy")
def held_by(centres: Floats, axes: Floats, halves: Floats, origins: Floats, clear: float, out: Bools) -> None:
    """Find which boxes (m) hold which places (k, 3), or have them no farther outside than `clear` [m]: out (m, k)."""
    for i in range(len(out)):
        for s in range(len(origins)):
            out[i, s] = True
            for k in range(3):
                away = dot(axes[i, k], origins[s]) - dot(axes[i, k], centres[i])
                out[i, s] = out[i, s] and abs(away) <= halves[i, k] + clear


@lean(error_model="numpy")
def hidden(outward: Floats, body: Ints, inside: Bools, origins: Floats, opaque: Bools, out: Bools) -> None:
    """Find the faces that turn their backs to all of some places outside their bodies.

    Args:
        outward: (n, 4) and body: (n) as in `radar.solids.Backs`.
        inside: (m, k) whether a place may be in a body.
        origins: (k, 3) the places [m].
        opaque: (n) whether nothing goes through.
        out: (n) gets the answer.
    """
    for i in range(len(out)):
        out[i] = opaque[i]
        for s in range(len(origins) if opaque[i] else 0):
            above = dot(outward[i], origins[s]) + outward[i, 3]
            out[i] = out[i] and above < 0 and not inside[body[i], s]


@lean(error_model="numpy")
def limits(
    normals: Floats, offsets: Floats, spheres: Floats, origin: Floats, gate: float, far: float, out: Floats
) -> None:
    """How far the echoes of faces (p) are followed [m]: to the gate, or `far` where they mirror a radar beyond it."""
    for i in range(len(out)):
        gap, beside = dot(normals[i], origin) - offsets[i], 0.0
        out[i] = gate
        if gate - 0.5 < abs(gap) < far:
            for k in range(3):
                beside += (origin[k] - gap * normals[i, k] - spheres[i, k]) ** 2
            if beside < (spheres[i, 3] + 0.5) ** 2:
                out[i] = far
