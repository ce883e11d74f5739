"""Loops of physical optics on large flat faces, by the boundary: specular point plus integrals along the edges.

The Kirchhoff integral over a plane face equals the mirror image's wave where the line from image to receiver crosses
the face, less a line integral along its edge [MiyamotoWolf1962]. With phi the angle around that line,
the rim's share is -(1 / 4 pi) of the integral of e^{-jk(r + s)} K / (r s) dphi, K = 2 L rho^2 / ((r + s)^2 - L^2),
which is smooth even where the line meets the rim. A piece of edge whose delay is nearly linear in phi has a closed
form. Far from where an edge's path is shortest the integrand turns so fast that only its ends count.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ullage.arrays import Floats, Ints, Longs
from ullage.kernels.loops import core, lean
from ullage.kernels.near import height
from ullage.kernels.vectors import apart, dot

C0 = 299_792_458.0
START, STOP, BEGINS, STOPS, HERE, NEXT = (np.int64(i) for i in range(6))
"""Rows of spots: an edge's ends, those of its slow part, the piece being done; others wait behind. No literals."""
NONE = np.int64(-1)
FAR = 0.1  # an outline is done by its ends where the second term there is no more of the first than this


class FaceOutlines(NamedTuple):
    """Flat faces (p) and their edges (e)."""

    spheres: Floats  # (p, 4) centre and radius of each face [m]
    normals: Floats  # (p, 3) unit normals
    offsets: Floats  # (p) planes normal . x = offset [m]
    first: Ints  # (p + 1) first edge of each face
    starts: Floats  # (e, 3) start of each edge, counter-clockwise about the normal [m]
    ends: Floats  # (e, 3) end of each edge [m]


class CutLimits(NamedTuple):
    """How far the outlines of faces are followed."""

    range_m: Floats  # (1 or p) greatest mean range, for all faces or for each [m]
    excess_m: float  # edges whose path exceeds the mirror path by more are left out [m]
    omega: float  # carrier [rad/s]
    whole: bool  # whether all of the outline is cut into pieces


class Outline(NamedTuple):
    """Outlines of k faces: m pieces, and n ends of what is not cut into pieces."""

    pieces: Floats  # (m, 12) start, end (6), path lengths (2) [m], weights (2), angle, early delay as length [m]
    owner: Ints  # (m) face of each piece
    tips: Floats  # (n, 9) place (3) and path length of each end [m], value (2), a vector into the face (3)
    holders: Ints  # (n) face of each end
    ties: Ints  # (n) piece that goes on from each end and is seen where the end is, -1 for none
    windings: Floats  # (k) turns of the outline around the line from image to receiver, 0 where there is no echo

    @staticmethod
    def none(faces: int) -> Outline:
        """No outlines, of so many faces that hold their mirror points."""
        none = np.zeros(0, np.int32)
        return Outline(np.zeros((0, 12)), none, np.zeros((0, 9)), none, none, np.ones(faces))


class CutScratch(NamedTuple):
    """Scratch of `cut`."""

    line: Floats  # (4, 3) the transmitter's image, the receiver, the unit axis between them, and along the edge
    spots: Floats  # (69, 8) places on the edge, as `_spot` fills them
    marks: Floats  # (69, 2) share along the edge, and turn from the spot before
    counts: Longs  # (3) pieces, ends, and the first end of the face


class FaceCut(NamedTuple):
    """A face whose outline is being cut."""

    faces: FaceOutlines
    face: int  # which of them
    sign: float  # of the side on which the axis leaves it
    length: float  # of the axis [m]
    limit: float  # greatest mean range [m]
    most: float  # greatest excess over the mirror path [m]
    wave: float  # wave number [1/m]
    whole: bool  # whether all of the outline is cut into pieces


@core(fastmath=True, error_model="numpy")
def mirror(point: Floats, normal: Floats, offset: float, out: Floats) -> None:
    """The mirror image of a point in the plane normal . x = offset."""
    gap = 2 * (dot(normal, point) - offset)
    for k in range(3):
        out[k] = point[k] - gap * normal[k]


@core(fastmath=True, error_model="numpy")
def _spot(spots: Floats, i: int, line: Floats, length: float) -> None:
    """Fill a spot, row i, whose place is known: path length, weight K / (r s) and offset from the axis follow it.

    Args:
        spots: (n, 8) place (3), path length, weight, offset from the axis (3).
        i: row.
        line: (4, 3) as in `CutScratch`.
        length: of the axis [m].
    """
    along, r2, s2 = 0.0, 0.0, 0.0
    for k in range(3):
        from_image = spots[i, k] - line[0, k]
        along += from_image * line[2, k]
        r2 += from_image * from_image
        s2 += (spots[i, k] - line[1, k]) ** 2
        spots[i, 5 + k] = from_image
    for k in range(3):
        spots[i, 5 + k] -= along * line[2, k]
    r, s = max(math.sqrt(r2), 1e-9), max(math.sqrt(s2), 1e-9)
    spots[i, 3] = r + s
    # K / (r s) is (1 - cos of the angle between r and s) / length: 2 / length on the axis, 0 beyond its ends
    spots[i, 4] = (length - (r - s)) * (length + (r - s)) / (2 * length * r * s)


@core(fastmath=True, error_model="numpy")
def _off(spots: Floats, i: int) -> float:
    """Square of how far spot i is from the axis."""
    return spots[i, 5] ** 2 + spots[i, 6] ** 2 + spots[i, 7] ** 2


@core(fastmath=True, error_model="numpy")
def _turn(spots: Floats, i: int, j: int, line: Floats) -> float:
    """Angle from spot i to spot j around the axis."""
    ux, uy, uz, vx, vy, vz = spots[i, 5], spots[i, 6], spots[i, 7], spots[j, 5], spots[j, 6], spots[j, 7]
    cross = line[2, 0] * (uy * vz - uz * vy) + line[2, 1] * (uz * vx - ux * vz) + line[2, 2] * (ux * vy - uy * vx)
    dot = ux * vx + uy * vy + uz * vz
    if abs(cross) < 0.1 * dot:
        t = cross / dot
        z = t * t
        return t * (1 - z * (1 / 3 - z * (1 / 5 - z * (1 / 7 - z / 9))))  # the arc tangent, to 1e-11
    return math.atan2(cross, dot)


@core(fastmath=True, error_model="numpy")
def _steep(spots: Floats, i: int, line: Floats, length: float, wave: float) -> tuple[float, float, float]:
    """What an edge that ends at spot i, far from where its path is shortest, adds there.

    The integral of F e^{-jkP} dP ends in e^{-jkP} (jF / k)(1 - jy - 3 y^2 ...), with y = F' / (k F) and F the
    integrand over the path's rate [BornWolf1999]; the third term is that of a path like a parabola.

    Returns:
        The path's rate along the edge, F / k and y.
    """
    r2, s2, r1, s1, swept, rho2 = 1e-12, 1e-12, 0.0, 0.0, 0.0, 1e-18
    for k in range(3):
        a, b = spots[i, k] - line[0, k], spots[i, k] - line[1, k]
        r2, s2, r1, s1 = r2 + a * a, s2 + b * b, r1 + line[3, k] * a, s1 + line[3, k] * b
        rho2 += spots[i, 5 + k] ** 2
    x, y, z = spots[i, 5], spots[i, 6], spots[i, 7]
    swept = (line[2, 0] * (y * line[3, 2] - z * line[3, 1]) + line[2, 1] * (z * line[3, 0] - x * line[3, 2])
             + line[2, 2] * (x * line[3, 1] - y * line[3, 0]))  # fmt: skip
    per_r, per_s = 1 / math.sqrt(r2), 1 / math.sqrt(s2)
    r1, s1 = r1 * per_r, s1 * per_s
    rate = r1 + s1
    bend = (1 - r1 * r1) * per_r + (1 - s1 * s1) * per_s
    slow = 1 / (wave * (rate if abs(rate) > 1e-9 else 1e-9))
    excess = max(spots[i, 3] * spots[i, 3] - length * length, 1e-12)
    fade = -r1 * per_r - s1 * per_s - 2 * spots[i, 3] * rate / excess
    return rate, spots[i, 4] * swept * slow / rho2, (fade - wave * bend * slow) * slow


@core(fastmath=True, error_model="numpy")
def _slow_part(spots: Floats, size: float, line: Floats, length: float, wave: float) -> tuple[float, float]:
    """Shares of an edge, from spot 0 to 1, between which its path is too near to its shortest to be done by its ends.

    Spots 2 and 3 become their places, where they are not the edge's own ends.
    """
    za, zb, ha, hb = 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        a, b = line[0, k] - spots[0, k], line[1, k] - spots[0, k]
        za, zb, ha, hb = za + line[3, k] * a, zb + line[3, k] * b, ha + a * a, hb + b * b
    ha, hb = math.sqrt(max(ha - za * za, 1e-8)), math.sqrt(max(hb - zb * zb, 1e-8))
    least = (za * hb + zb * ha) / (ha + hb)
    ra, rb = math.sqrt(ha * ha + (least - za) ** 2), math.sqrt(hb * hb + (least - zb) ** 2)
    step = math.sqrt(1 / (wave * FAR * (1 / ra + 1 / rb)))
    begins, stops = 0.0, 1.0
    for side in range(2):
        sign = 2.0 * side - 1
        gap = max(step, -least if side == 1 else least - size)
        share = 1.0 * side  # all of the edge on this side is slow, if nothing else is found
        for _ in range(8):
            place = min(max(least + sign * gap, 0.0), size)
            if place == side * size:
                break
            for k in range(3):
                spots[2 + side, k] = spots[0, k] + place * line[3, k]
            _spot(spots, BEGINS + side, line, length)
            if abs(_steep(spots, BEGINS + side, line, length, wave)[2]) <= FAR:
                share = place / size
                break
            gap *= 1.3
        if side == 0:
            begins = share if share * size >= 0.5 * step else 0.0
        else:
            stops = share if (1 - share) * size >= 0.5 * step else 1.0
    return begins, stops


@core(fastmath=True, error_model="numpy")
def _end(
    job: FaceCut, i: int, strong: float, y: float, into: float, tie: int, outline: Outline, scratch: CutScratch
) -> None:
    """Write the end of an outline at spot i, or add it to the one at the same corner of the same face.

    Args:
        job: `FaceCut`.
        i: row of the spot.
        strong: as `_steep` gives it.
        y: as `_steep` gives it.
        into: 1 where the outline begins there, -1 where it ends.
        tie: piece that goes on from there; negative: none.
        outline: `Outline`, written.
        scratch: `CutScratch`.
    """
    ends, ties, p = outline.tips, outline.ties, job.face
    spots, line, at, normals = scratch.spots, scratch.line, scratch.counts, job.faces.normals
    row = at[1]
    if tie < 0 and row <= len(ends):
        known = at[1] - 1
        for _ in range(2):
            if (at[2] <= known < at[1] and ties[known] < 0 and ends[known, 0] == spots[i, 0]
                    and ends[known, 1] == spots[i, 1] and ends[known, 2] == spots[i, 2]):  # fmt: skip
                row = known
            known = at[2]
    if row == at[1]:
        at[1] += 1
        if row >= len(ends):
            return
        outline.holders[row], ties[row] = p, tie
        for k in range(9):
            ends[row, k] = spots[i, k] if k < 4 else 0.0
    value = -into * job.sign * strong
    ends[row, 4], ends[row, 5] = ends[row, 4] + value * y, ends[row, 5] + value * (1 - 3 * y * y)
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        ends[row, 6 + k] += normals[p, a] * line[3, b] - normals[p, b] * line[3, a] + into * line[3, k]


@core(fastmath=True, error_model="numpy")
def _before(faces: FaceOutlines, p: int, origins: Floats, aside: Floats, limit: float, line: Floats) -> float:
    """Set `line` to the transmitter's image in face p, the receiver and the axis from one to the other.

    Returns:
        Length of that axis [m]; less than 0 where the face cannot echo within the limit.
    """
    normals, offsets, spheres, o = faces.normals, faces.offsets, faces.spheres, p if len(origins) > 1 else 0
    ahead, behind, near, far = -offsets[p], -offsets[p], 0.0, 0.0
    for k in range(3):
        line[0, k], line[1, k] = origins[o, 0, k], origins[o, 1, k]
        ahead += normals[p, k] * line[0, k]
        behind += normals[p, k] * line[1, k]
        near += (spheres[p, k] - line[0, k]) ** 2
        far += (spheres[p, k] - line[1, k]) ** 2
    r = 0.5 * (math.sqrt(near) + math.sqrt(far))
    above, below = height(ahead, behind), height(behind, ahead)
    if r - spheres[p, 3] > limit or above * below <= 0:
        return -1.0
    for k in range(3):
        line[0, k] -= (ahead + above) * normals[p, k]
        line[1, k] += (below - behind) * normals[p, k]
    # an edge or corner exactly on the axis, as in every corner reflector, has no angle: the image alone is moved aside
    # by a hair, so that of both paths about a corner one goes over each of its faces
    length = 0.0
    for k in range(3):
        line[0, k] += aside[k]
        line[2, k] = line[1, k] - line[0, k]
        length += line[2, k] * line[2, k]
    length = math.sqrt(length)
    for k in range(3):
        line[2, k] /= length
    return length


@core(fastmath=True, error_model="numpy")
def _pieces(job: FaceCut, begins: float, stops: float, size: float, outline: Outline, scratch: CutScratch) -> float:
    """Halve the edge from spot 4 to spot 5 until the delay along each piece is nearly linear in phi.

    Spots from 6 on, with marks of where they are and how far they turn from the one before, wait on a stack.

    Args:
        job: `FaceCut`.
        begins: share of the edge at which spot 4 lies.
        stops: share of the edge at which spot 5 lies.
        size: length of the edge [m].
        outline: `Outline`, written.
        scratch: `CutScratch`.

    Returns:
        The turn of all pieces around the axis [rad].
    """
    spots, marks, line, at = scratch.spots, scratch.marks, scratch.line, scratch.counts
    length, limit, most, wave, pieces = job.length, job.limit, job.most, job.wave, outline.pieces
    winding, top, s0 = 0.0, NEXT, begins
    marks[5, 0], marks[5, 1] = stops, _turn(spots, HERE, NEXT, line)
    while top > 4:
        turn, least = marks[top, 1], min(spots[4, 3], spots[top, 3])
        long, m = (marks[top, 0] - s0) * size, top + 1
        for k in range(3):
            spots[m, k] = 0.5 * (spots[4, k] + spots[top, k])
        _spot(spots, m, line, length)
        if 0.5 * (spots[m, 3] - long) <= limit and spots[m, 3] - long <= length + most:
            early = _turn(spots, HERE, m, line)
            part = early / turn if abs(turn) > 1e-15 else 0.5
            bend = spots[m, 3] - spots[4, 3] - part * (spots[top, 3] - spots[4, 3])
            wide = wave * abs(bend) > (0.1 if abs(turn) > 0.1 else 0.3) or long > 0.2 * spots[m, 3]
            round_part = part * (1 - part)
            if round_part < 0.04 and wave * abs(spots[top, 3] - spots[4, 3]) * abs(turn) > 0.03:
                wide = True
            if not wide and abs(turn) > 0.1 and wave * abs(bend) > 0.01:
                wide = 2 * _off(spots, m) < max(_off(spots, HERE), _off(spots, top))
            if wide and abs(turn) > 2e-4 and top < 66 and min(least, spots[m, 3]) < length + most + 0.5:
                marks[m, 0], marks[m, 1], marks[top, 1] = 0.5 * (s0 + marks[top, 0]), early, turn - early
                top = m
                continue
            if abs(turn) >= 1e-5 and 0.5 * least <= limit and least <= length + most:
                count = at[0]
                at[0] += 1
                if count < len(pieces):
                    for k in range(3):
                        pieces[count, k], pieces[count, 3 + k] = spots[4, k], spots[top, k]
                    for k in range(2):
                        pieces[count, 6 + 2 * k], pieces[count, 7 + 2 * k] = spots[4, 3 + k], spots[top, 3 + k]
                    pieces[count, 10] = job.sign * turn
                    pieces[count, 11] = bend / (6 * round_part) if round_part > 0.04 else 0.0
                    outline.owner[count] = job.face
        winding += turn
        s0 = marks[top, 0]
        for k in range(8):
            spots[4, k] = spots[top, k]
        top -= 1
    return winding


@core(fastmath=True, error_model="numpy")
def _edge(job: FaceCut, size: float, outline: Outline, scratch: CutScratch) -> float:
    """Cut one edge of a face, from spot 0 to 1, of so many metres; give its turn around the axis [rad]."""
    spots, line, at = scratch.spots, scratch.line, scratch.counts
    length, wave = job.length, job.wave
    farthest = min(2 * job.limit, length + job.most)
    rate0, strong0, y0 = _steep(spots, START, line, length, wave)
    rate1, strong1, y1 = _steep(spots, STOP, line, length, wave)
    begins, stops = 0.0, 1.0
    if not job.whole:
        if abs(y0) <= FAR and abs(y1) <= FAR and rate0 * rate1 > 0:
            begins = 1.0
        else:
            begins, stops = _slow_part(spots, size, line, length, wave)
    before, cut = at[0], begins < stops
    winding = 0.0 if cut else _turn(spots, START, STOP, line)
    if cut:
        first, last = BEGINS if begins > 0 else START, STOPS if stops < 1 else STOP
        for k in range(8):
            spots[4, k], spots[5, k] = spots[first, k], spots[last, k]
        winding = _pieces(job, begins, stops, size, outline, scratch)
        winding += _turn(spots, START, BEGINS, line) if first == BEGINS else 0.0
        winding += _turn(spots, STOPS, STOP, line) if last == STOPS else 0.0
    for step in range(4):  # the edge's start, both ends of its slow part, its end
        i, tie, strong, y = (START, NONE, strong0, y0) if step == 0 else (STOP, NONE, strong1, y1)
        if cut and (stops >= 1 if step > 1 else begins <= 0):
            continue
        if 0 < step < 3:
            i, tie = BEGINS + (step - 1), before if step == 1 else at[0] - 1
            if at[0] == before:
                continue
        if spots[i, 3] > farthest:
            continue
        if 0 < step < 3:
            _, strong, y = _steep(spots, i, line, length, wave)
        _end(job, i, strong, y, 1.0 if step % 2 == 0 else -1.0, tie, outline, scratch)
    return winding


@core(fastmath=True, error_model="numpy", forceinline=True)
def _about(spheres: Floats, normals: Floats, p: int, line: Floats) -> tuple[float, bool]:
    """Sign of the side on which the axis leaves face p, and whether the outline may go round the axis."""
    lead = dot(spheres[p], line[2]) - dot(line[0], line[2])
    sign = 1.0 if dot(line[2], normals[p]) > 0 else -1.0
    return sign, apart(line[0], spheres[p]) ** 2 - lead * lead <= 1.0001 * spheres[p, 3] * spheres[p, 3]


@core(fastmath=True, error_model="numpy", forceinline=True)
def _step_on(starts: Floats, ends: Floats, e: int, line: Floats, length: float, spots: Floats) -> float:
    """Set the spots START and STOP to the ends of edge e, and line[3] along it; give the length of the edge [m].

    Most edges start where the one before stops, so that its last spot is known. One shorter than 1e-9 m is none.
    """
    size, follows = 0.0, True
    for k in range(3):
        line[3, k] = ends[e, k] - starts[e, k]
        size += line[3, k] * line[3, k]
        follows = follows and spots[1, k] == starts[e, k]
    size = math.sqrt(size)
    if size < 1e-9:
        spots[1, 0] = 1e300
        return size
    for k in range(3):
        line[3, k] /= size
    for k in range(8):
        spots[0, k] = spots[1, k] if follows else (starts[e, k] if k < 3 else 0.0)
    if not follows:
        _spot(spots, START, line, length)
    for k in range(3):
        spots[1, k] = ends[e, k]
    _spot(spots, STOP, line, length)
    return size


@core(fastmath=True, error_model="numpy", forceinline=True)
def _outline(
    faces: FaceOutlines, p: int, length: float, limit: float, limits: CutLimits, outline: Outline, scratch: CutScratch
) -> float:
    """Cut all edges of face p, as `cut` does; give the turns of the outline around the axis."""
    spots, line, at = scratch.spots, scratch.line, scratch.counts
    sign, round_axis = _about(faces.spheres, faces.normals, p, line)
    job = FaceCut(faces, p, sign, length, limit, limits.excess_m, limits.omega / C0, limits.whole)
    winding, at[2] = 0.0, at[1]
    spots[1, 0] = 1e300
    for e in range(faces.first[p], faces.first[p + 1]):
        size = _step_on(faces.starts, faces.ends, e, line, length, spots)
        if size < 1e-9:
            continue
        # the path over an edge is at least this: ends less half its length there and back
        if 0.5 * (spots[0, 3] + spots[1, 3]) - size > min(2 * limit, length + job.most):
            winding += _turn(spots, START, STOP, line) if round_axis else 0.0
            continue
        winding += _edge(job, size, outline, scratch)
    return sign * winding / (2 * math.pi)


@lean(fastmath=True, error_model="numpy")
def cut(
    patches: Longs,
    faces: FaceOutlines,
    origins: Floats,
    aside: Floats,
    limits: CutLimits,
    outline: Outline,
    scratch: CutScratch,
) -> tuple[int, int]:
    """Cut the outlines of faces within their limits: near the shortest path into pieces, elsewhere by their ends.

    Args:
        patches: (k) the faces to do.
        faces: `FaceOutlines` (p).
        origins: (1 or p, 2, 3) transmitter and receiver, or their images, for all or for each face [m].
        aside: (3) a hair by which images are moved, so that no edge lies on the axis [m].
        limits: `CutLimits`.
        outline: `Outline` (k), written; of pieces and ends those that fit.
        scratch: `CutScratch`.

    Returns:
        How many pieces and ends there are; only those that fit are written.
    """
    at = scratch.counts
    at[0], at[1], at[2] = 0, 0, 0
    for i in range(len(patches)):
        p = patches[i]
        limit = limits.range_m[p] if len(limits.range_m) > 1 else limits.range_m[0]
        outline.windings[i] = 0.0
        length = _before(faces, p, origins, aside, limit, scratch.line)
        if length >= 0:
            outline.windings[i] = _outline(faces, p, length, limit, limits, outline, scratch)
    return at[0], at[1]
