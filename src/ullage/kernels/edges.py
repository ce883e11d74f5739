"""Loops of physical optics on large flat faces, by the boundary: specular point plus integrals along the edges.

The Kirchhoff integral over a plane face equals the mirror image's wave where the line from image to receiver crosses
the face, less a line integral along its rim [MiyamotoWolf1962]. With phi the angle around that line,
the rim's share is -(1 / 4 pi) of the integral of e^{-jk(r + s)} K / (r s) dphi, K = 2 L rho^2 / ((r + s)^2 - L^2),
which is smooth even where the line meets the rim. A piece of edge whose delay is nearly linear in phi has a closed
form. Far from where an edge's path is shortest the integrand turns so fast that only its ends count.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

C0 = 299_792_458.0
FAR = 0.1  # a rim is done by its ends where the second term there is no more of the first than this


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def mirror(point, normal, offset, out):  # type: ignore[no-untyped-def]
    """The mirror image of a point in the plane normal . x = offset."""
    gap = 2 * (normal[0] * point[0] + normal[1] * point[1] + normal[2] * point[2] - offset)
    for k in range(3):
        out[k] = point[k] - gap * normal[k]


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _spot(p, q, share, source, image, axis, length, out):  # type: ignore[no-untyped-def]
    """Point at `share` of the edge p-q: its place, path length, weight K / (r s) and offset from the axis."""
    along, r2, s2 = 0.0, 0.0, 0.0
    for k in range(3):
        out[k] = p[k] + share * (q[k] - p[k])
        from_image = out[k] - image[k]
        along += from_image * axis[k]
        r2 += from_image * from_image
        s2 += (out[k] - source[k]) ** 2
    rho2 = 0.0
    for k in range(3):
        out[5 + k] = out[k] - image[k] - along * axis[k]
        rho2 += out[5 + k] * out[5 + k]
    r, s = max(math.sqrt(r2), 1e-4), max(math.sqrt(s2), 1e-4)
    out[3] = r + s
    excess = (r + s) * (r + s) - length * length
    weight = 2 * length * rho2 / excess if rho2 > 1e-9 * r2 else 2 * r * s / length
    out[4] = weight / (r * s)


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _turn(u, v, axis):  # type: ignore[no-untyped-def]
    """Angle from u to v around the axis."""
    cross = (
        axis[0] * (u[6] * v[7] - u[7] * v[6])
        + axis[1] * (u[7] * v[5] - u[5] * v[7])
        + axis[2] * (u[5] * v[6] - u[6] * v[5])
    )
    return math.atan2(cross, u[5] * v[5] + u[6] * v[6] + u[7] * v[7])


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _steep(u, along, source, image, axis, length, wave, out):  # type: ignore[no-untyped-def]
    """What a rim that ends at a spot, far from where its path is shortest, adds there; gives the path's rate along it.

    The integral of F e^{-jkP} dP ends in e^{-jkP} (jF / k)(1 - jy - 3 y^2 ...), with y = F' / (k F) and F the
    integrand over the path's rate [BornWolf1999]; the third term is that of a path like a parabola.

    Args:
        u: the spot, as `_spot` gives it.
        along: (3) unit vector along the rim.
        source: (3) receiver, image: (3) of the transmitter [m].
        axis: (3) unit vector from image to receiver, length [m] of that line.
        wave: wave number [1/m].
        out: (2) gets F / k and y.
    """
    r2, s2, r1, s1, swept, rho2 = 1e-12, 1e-12, 0.0, 0.0, 0.0, 1e-18
    for k in range(3):
        a, b = u[k] - image[k], u[k] - source[k]
        r2, s2, r1, s1 = r2 + a * a, s2 + b * b, r1 + along[k] * a, s1 + along[k] * b
        rho2 += u[5 + k] * u[5 + k]
        i, j = (k + 1) % 3, (k + 2) % 3
        swept += axis[k] * (u[5 + i] * along[j] - u[5 + j] * along[i])
    r, s = math.sqrt(r2), math.sqrt(s2)
    r1, s1 = r1 / r, s1 / s
    rate = r1 + s1
    bend = (1 - r1 * r1) / r + (1 - s1 * s1) / s
    slow = rate if abs(rate) > 1e-9 else 1e-9
    excess = max(u[3] * u[3] - length * length, 1e-12)
    fade = -r1 / r - s1 / s - 2 * u[3] * rate / excess
    out[0] = u[4] * swept / (rho2 * slow * wave)
    out[1] = (fade - bend / slow) / (wave * slow)
    return rate


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _slow_part(p, q, size, along, source, image, axis, length, wave, spot, term, out):  # type: ignore[no-untyped-def]
    """Shares of the edge p-q between which its path is too near to its shortest for the rim to be done by its ends."""
    za, zb, ha, hb = 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        a, b = image[k] - p[k], source[k] - p[k]
        za, zb, ha, hb = za + along[k] * a, zb + along[k] * b, ha + a * a, hb + b * b
    ha, hb = math.sqrt(max(ha - za * za, 1e-8)), math.sqrt(max(hb - zb * zb, 1e-8))
    least = (za * hb + zb * ha) / (ha + hb)
    ra, rb = math.sqrt(ha * ha + (least - za) ** 2), math.sqrt(hb * hb + (least - zb) ** 2)
    step = math.sqrt(1 / (wave * FAR * (1 / ra + 1 / rb)))
    for side in range(2):
        sign = 2.0 * side - 1
        gap = max(step, -least if side == 1 else least - size)
        place = 0.0
        for _ in range(8):
            place = least + sign * gap
            if place <= 0 or place >= size:
                break
            _spot(p, q, place / size, source, image, axis, length, spot)
            _steep(spot, along, source, image, axis, length, wave, term)
            if abs(term[1]) <= FAR:
                break
            gap *= 1.3
        out[side] = min(max(place / size, 0.0), 1.0)
    if out[0] * size < 0.5 * step:
        out[0] = 0.0
    if (1 - out[1]) * size < 0.5 * step:
        out[1] = 1.0


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _end(u, along, into, normal, factor, term, tie, p, ends, holders, ties, at):  # type: ignore[no-untyped-def]
    """Writes the end of a rim, or adds it to the one at the same corner of the same face.

    Args:
        u: the spot, as `_spot` gives it.
        along: (3) unit vector along the rim, which leads `into` (1 or -1) times so from there.
        normal: (3) of the face.
        factor: 1 where the rim ends, -1 where it begins, by the sign of the face.
        term: (2) as `_steep` gives it.
        tie: piece that goes on from there; negative: none.
        p: the face.
        ends, holders, ties: as in `cut`.
        at: (4) how many ends there are in at[1], the face's first in at[2].
    """
    value = factor * term[0]
    turned, straight = value * term[1], value * (1 - 3 * term[1] * term[1])
    row = at[1]
    if tie < 0 and row <= len(ends):
        known = at[1] - 1
        for _ in range(2):
            if (at[2] <= known < at[1] and ties[known] < 0 and ends[known, 0] == u[0] and ends[known, 1] == u[1]
                    and ends[known, 2] == u[2]):  # fmt: skip
                row = known
            known = at[2]
    if row == at[1]:
        at[1] += 1
        if row >= len(ends):
            return
        holders[row], ties[row], ends[row, 3] = p, tie, u[3]
        for k in range(3):
            ends[row, k], ends[row, 6 + k] = u[k], 0.0
        ends[row, 4], ends[row, 5] = 0.0, 0.0
    ends[row, 4], ends[row, 5] = ends[row, 4] + turned, ends[row, 5] + straight
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        ends[row, 6 + k] += normal[i] * along[j] - normal[j] * along[i] + into * along[k]


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _before(normal, offset, sphere, here, limit, image, axis):  # type: ignore[no-untyped-def]
    """Whether a face can echo within the limit; the transmitter's image and the unit axis from it go to the last two.

    Gives the length of that axis, less than 0 where the face cannot echo.
    """
    ahead, behind, near, far = -offset, -offset, 0.0, 0.0
    for k in range(3):
        ahead += normal[k] * here[0, k]
        behind += normal[k] * here[1, k]
        near += (sphere[k] - here[0, k]) ** 2
        far += (sphere[k] - here[1, k]) ** 2
    r = 0.5 * (math.sqrt(near) + math.sqrt(far))
    if r - sphere[3] > limit:
        return -1.0
    if ahead * behind <= 0 or min(abs(ahead), abs(behind)) < 1e-4:
        return -1.0
    mirror(here[0], normal, offset, image)
    # a rim or corner exactly on the axis, as in every corner reflector, has no angle: stand a hair beside it
    image[0], image[1], image[2] = image[0] + 3.1e-7, image[1] - 4.3e-7, image[2] + 2.7e-7
    length = 0.0
    for k in range(3):
        axis[k] = here[1, k] - image[k]
        length += axis[k] * axis[k]
    length = math.sqrt(length)
    for k in range(3):
        axis[k] /= length
    return length


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _pieces(a, b, size, source, image, axis, length, limit, most, wave, sign, p, stack, m, pieces, owner, at):  # type: ignore[no-untyped-def]
    """Halves the rim between two spots until each piece's delay is nearly linear in phi.

    Gives the turn of all of them around the axis; at[0] counts the pieces.
    """
    winding = 0.0
    stack[0, 0], stack[0, 1], stack[0, 2] = 0.0, 1.0, _turn(a, b, axis)
    for k in range(8):
        stack[0, 3 + k], stack[0, 11 + k] = a[k], b[k]
    top = 1
    while top > 0:
        top -= 1
        s0, s1, turn = stack[top, 0], stack[top, 1], stack[top, 2]
        u, v = stack[top, 3:11], stack[top, 11:]
        long = (s1 - s0) * size
        _spot(u, v, 0.5, source, image, axis, length, m)
        if 0.5 * (m[3] - long) > limit or m[3] - long > length + most:
            winding += turn
            continue
        early = _turn(u, m, axis)
        part = early / turn if abs(turn) > 1e-15 else 0.5
        bend = m[3] - u[3] - part * (v[3] - u[3])
        wide = wave * abs(bend) > (0.1 if abs(turn) > 0.1 else 0.3) or long > 0.2 * m[3]
        round_part = part * (1 - part)
        if round_part < 0.04 and wave * abs(v[3] - u[3]) * abs(turn) > 0.03:
            wide = True
        if wide and abs(turn) > 2e-4 and top < 62 and min(u[3], v[3], m[3]) < length + most + 0.5:
            half = 0.5 * (s0 + s1)
            stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2] = s0, half, early
            stack[top, 0], stack[top, 2] = half, turn - early
            for k in range(8):
                stack[top + 1, 3 + k], stack[top + 1, 11 + k] = u[k], m[k]
                stack[top, 3 + k] = m[k]
            top += 2
            continue
        winding += turn
        if abs(turn) < 1e-5 or 0.5 * min(u[3], v[3]) > limit or min(u[3], v[3]) > length + most:
            continue
        count = at[0]
        at[0] += 1
        if count < len(pieces):
            for k in range(3):
                pieces[count, k], pieces[count, 3 + k] = u[k], v[k]
            pieces[count, 6], pieces[count, 7] = u[3], v[3]
            pieces[count, 8], pieces[count, 9] = u[4], v[4]
            pieces[count, 10] = sign * turn
            pieces[count, 11] = bend / (6 * round_part) if round_part > 0.04 else 0.0
            owner[count] = p
    return winding


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def cut(patches, spheres, normals, offsets, first, starts, ends, origins, limits, most, omega, whole, pieces, owner,  # type: ignore[no-untyped-def]
        tips, holders, ties, windings):  # fmt: skip
    """Parts the rims of faces within their limits: near the shortest path into pieces, elsewhere by their ends.

    Args:
        patches: (k) the faces to do.
        spheres: (p, 4) centre and radius of each face [m].
        normals: (p, 3) unit normals.
        offsets: (p) planes normal . x = offset [m].
        first: (p + 1) index of each face's first edge.
        starts: (e, 3) edge starts, counter-clockwise about the normal [m].
        ends: (e, 3) edge ends [m].
        origins: (1 or p, 2, 3) transmitter and receiver, or their images, for all or for each face [m].
        limits: (1 or p) greatest mean range, for all or for each face [m].
        most: rim whose path exceeds the mirror path by more is left out [m].
        omega: carrier [rad/s].
        whole: whether to cut all of the rim into pieces.
        pieces: (m, 12) gets start, end (6), path lengths (2), weights (2), angle, early delay as length.
        owner: (m) gets the face of each piece.
        tips: (n, 9) gets of each end: place (3), path length, value (2), a vector into the face (3).
        holders: (n) gets the face of each end.
        ties: (n) gets the piece that goes on from there, whose shade it has; -1: none.
        windings: (k) gets the turns of the rim around the line image - receiver, 0 where there is no echo.

    Returns:
        How many pieces and ends there are; only those that fit are written.
    """
    at = np.zeros(4, np.int64)  # pieces, ends, first end of the face, none
    at[3] = -1
    image, axis, along, term, share = np.empty(3), np.empty(3), np.empty(3), np.empty(2), np.empty(2)
    stack = np.empty((64, 19))  # of pieces of an edge: where they start and end, their turn, both ends' spots
    spots = np.empty((5, 8))
    a, b, c, d, m = spots[0], spots[1], spots[2], spots[3], spots[4]
    wave = omega / C0
    for i in range(len(patches)):
        p = patches[i]
        here = origins[p] if len(origins) > 1 else origins[0]
        windings[i] = 0.0
        limit = limits[p] if len(limits) > 1 else limits[0]
        n, source = normals[p], here[1]
        length = _before(n, offsets[p], spheres[p], here, limit, image, axis)
        if length < 0:
            continue
        facing, lead, square = 0.0, 0.0, 0.0
        for k in range(3):
            facing += axis[k] * n[k]
            lead += (spheres[p, k] - image[k]) * axis[k]
            square += (spheres[p, k] - image[k]) ** 2
        sign = 1.0 if facing > 0 else -1.0
        round_axis = square - lead * lead <= 1.0001 * spheres[p, 3] * spheres[p, 3]
        winding = 0.0
        at[2] = at[1]
        farthest = min(2 * limit, length + most)
        for e in range(first[p], first[p + 1]):
            size = 0.0
            for k in range(3):
                along[k] = ends[e, k] - starts[e, k]
                size += along[k] * along[k]
            size = math.sqrt(size)
            if size < 1e-9:
                b[0] = 1e300
                continue
            for k in range(3):
                along[k] /= size
            if e == first[p] or b[0] != starts[e, 0] or b[1] != starts[e, 1] or b[2] != starts[e, 2]:
                _spot(starts[e], ends[e], 0.0, source, image, axis, length, a)
            else:
                for k in range(8):
                    a[k] = b[k]
            _spot(starts[e], ends[e], 1.0, source, image, axis, length, b)
            # the path over an edge is at least this: ends less half its length there and back
            if not round_axis and 0.5 * (a[3] + b[3]) - size > farthest:
                continue
            rate0 = _steep(a, along, source, image, axis, length, wave, term)
            steep = abs(term[1]) <= FAR
            start0, start1 = term[0], term[1]
            rate1 = _steep(b, along, source, image, axis, length, wave, term)
            share[0], share[1] = 0.0, 1.0
            if not whole:
                if steep and abs(term[1]) <= FAR and rate0 * rate1 > 0:
                    share[0] = 1.0
                else:
                    _slow_part(starts[e], ends[e], size, along, source, image, axis, length, wave, m, term, share)
            if share[0] >= share[1]:
                winding += _turn(a, b, axis)
                if b[3] <= farthest:
                    _end(b, along, -1.0, n, sign, term, at[3], p, tips, holders, ties, at)
                if a[3] <= farthest:
                    term[0], term[1] = start0, start1
                    _end(a, along, 1.0, n, -sign, term, at[3], p, tips, holders, ties, at)
                continue
            before = at[0]
            begins, stops = a, b
            if share[0] > 0:
                begins = c
                _spot(starts[e], ends[e], share[0], source, image, axis, length, c)
            if share[1] < 1:
                stops = d
                _spot(starts[e], ends[e], share[1], source, image, axis, length, d)
            winding += _pieces(begins, stops, (share[1] - share[0]) * size, source, image, axis, length, limit,
                                    most, wave, sign, p, stack, m, pieces, owner, at)  # fmt: skip
            if share[0] > 0:
                winding += _turn(a, c, axis)
                if at[0] > before and c[3] <= farthest:
                    _steep(c, along, source, image, axis, length, wave, term)
                    _end(c, along, -1.0, n, sign, term, before, p, tips, holders, ties, at)
                if a[3] <= farthest:
                    term[0], term[1] = start0, start1
                    _end(a, along, 1.0, n, -sign, term, at[3], p, tips, holders, ties, at)
            if share[1] < 1:
                winding += _turn(d, b, axis)
                if at[0] > before and d[3] <= farthest:
                    _steep(d, along, source, image, axis, length, wave, term)
                    _end(d, along, 1.0, n, -sign, term, at[0] - 1, p, tips, holders, ties, at)
                if b[3] <= farthest:
                    _steep(b, along, source, image, axis, length, wave, term)
                    _end(b, along, -1.0, n, sign, term, at[3], p, tips, holders, ties, at)
        windings[i] = sign * winding / (2 * math.pi)
    return at[0], at[1]
