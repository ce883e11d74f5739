"""Loops of physical optics on large flat faces, by the boundary: specular point plus integrals along the edges.

The Kirchhoff integral over a plane face equals the mirror image's wave where the line from image to receiver crosses
the face, less a line integral along its rim [MiyamotoWolf1962]. With phi the angle around that line,
the rim's share is -(1 / 4 pi) of the integral of e^{-jk(r + s)} K / (r s) dphi, K = 2 L rho^2 / ((r + s)^2 - L^2),
which is smooth even where the line meets the rim. A piece of edge whose delay is nearly linear in phi has a closed
form.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ullage.kernels.facets import _late, _lay, _reflection, _te_share, toward

C0 = 299_792_458.0


@njit(cache=True, fastmath=True, nogil=True)
def mirror(point, normal, offset, out):  # type: ignore[no-untyped-def]
    """The mirror image of a point in the plane normal . x = offset."""
    gap = 2 * (normal[0] * point[0] + normal[1] * point[1] + normal[2] * point[2] - offset)
    for k in range(3):
        out[k] = point[k] - gap * normal[k]


@njit(cache=True, fastmath=True, nogil=True)
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


@njit(cache=True, fastmath=True, nogil=True)
def _turn(u, v, axis):  # type: ignore[no-untyped-def]
    """Angle from u to v around the axis."""
    cross = (
        axis[0] * (u[6] * v[7] - u[7] * v[6])
        + axis[1] * (u[7] * v[5] - u[5] * v[7])
        + axis[2] * (u[5] * v[6] - u[6] * v[5])
    )
    return math.atan2(cross, u[5] * v[5] + u[6] * v[6] + u[7] * v[7])


@njit(cache=True, fastmath=True, nogil=True)
def cut(patches, spheres, normals, offsets, first, starts, ends, origins, gate, most, omega, pieces, owner, windings):  # type: ignore[no-untyped-def]
    """Cuts the rims of faces within the gate until each piece's delay is nearly linear in phi.

    Args:
        patches: (k) the faces to do.
        spheres: (p, 4) centre and radius of each face [m].
        normals: (p, 3) unit normals.
        offsets: (p) planes normal . x = offset [m].
        first: (p + 1) index of each face's first edge.
        starts: (e, 3) edge starts, counter-clockwise about the normal [m].
        ends: (e, 3) edge ends [m].
        origins: (1 or p, 2, 3) transmitter and receiver, or their images, for all or for each face [m].
        gate: (2) least and greatest mean range [m].
        most: rim whose path exceeds the mirror path by more is left out [m].
        omega: carrier [rad/s].
        pieces: (m, 12) gets start, end (6), path lengths (2), weights (2), angle, early delay as length.
        owner: (m) gets the face of each piece.
        windings: (k) gets the turns of the rim around the line image - receiver, 0 where there is no echo.

    Returns:
        How many pieces there are; only the first m are written.
    """
    count = 0
    image, axis = np.empty(3), np.empty(3)
    stack = np.empty((64, 19))  # of pieces of an edge: where they start and end, their turn, both ends' spots
    m = np.empty(8)
    wave = omega / C0
    for i in range(len(patches)):
        p = patches[i]
        here = origins[p] if len(origins) > 1 else origins[0]
        windings[i] = 0.0
        ahead, behind, near, far = -offsets[p], -offsets[p], 0.0, 0.0
        for k in range(3):
            ahead += normals[p, k] * here[0, k]
            behind += normals[p, k] * here[1, k]
            near += (spheres[p, k] - here[0, k]) ** 2
            far += (spheres[p, k] - here[1, k]) ** 2
        r = 0.5 * (math.sqrt(near) + math.sqrt(far))
        if r - spheres[p, 3] > gate[1] or r + spheres[p, 3] < gate[0]:
            continue
        if ahead * behind <= 0 or min(abs(ahead), abs(behind)) < 1e-4:
            continue
        mirror(here[0], normals[p], offsets[p], image)
        # a rim or corner exactly on the axis, as in every corner reflector, has no angle: stand a hair beside it
        image[0], image[1], image[2] = image[0] + 3.1e-7, image[1] - 4.3e-7, image[2] + 2.7e-7
        length = 0.0
        for k in range(3):
            axis[k] = here[1, k] - image[k]
            length += axis[k] * axis[k]
        length = math.sqrt(length)
        facing, along, square = 0.0, 0.0, 0.0
        for k in range(3):
            axis[k] /= length
            facing += axis[k] * normals[p, k]
            along += (spheres[p, k] - image[k]) * axis[k]
            square += (spheres[p, k] - image[k]) ** 2
        sign = 1.0 if facing > 0 else -1.0
        round_axis = square - along * along <= 1.0001 * spheres[p, 3] * spheres[p, 3]
        winding = 0.0
        for e in range(first[p], first[p + 1]):
            size = 0.0
            for k in range(3):
                size += (ends[e, k] - starts[e, k]) ** 2
            size = math.sqrt(size)
            a, b = stack[0, 3:11], stack[0, 11:]
            _spot(starts[e], ends[e], 0.0, here[1], image, axis, length, a)
            _spot(starts[e], ends[e], 1.0, here[1], image, axis, length, b)
            # the path over an edge is at least this: ends less half its length there and back
            least = 0.5 * (a[3] + b[3]) - size
            if not round_axis and (0.5 * least > gate[1] or least > length + most):
                continue
            stack[0, 0], stack[0, 1] = 0.0, 1.0
            stack[0, 2] = _turn(a, b, axis)
            top = 1
            while top > 0:
                top -= 1
                s0, s1, turn = stack[top, 0], stack[top, 1], stack[top, 2]
                a, b = stack[top, 3:11], stack[top, 11:]
                half = 0.5 * (s0 + s1)
                _spot(starts[e], ends[e], half, here[1], image, axis, length, m)
                if 0.5 * (m[3] - (s1 - s0) * size) > gate[1] or m[3] - (s1 - s0) * size > length + most:
                    winding += turn
                    continue
                early = _turn(a, m, axis)
                part = early / turn if abs(turn) > 1e-15 else 0.5
                bend = m[3] - a[3] - part * (b[3] - a[3])
                wide = wave * abs(bend) > (0.1 if abs(turn) > 0.1 else 0.3) or (s1 - s0) * size > 0.2 * m[3]
                round_part = part * (1 - part)
                if round_part < 0.04 and wave * abs(b[3] - a[3]) * abs(turn) > 0.03:
                    wide = True
                if wide and abs(turn) > 2e-4 and top < 62 and min(a[3], b[3], m[3]) < length + most + 0.5:
                    stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2] = s0, half, early
                    stack[top, 0], stack[top, 2] = half, turn - early
                    for k in range(8):
                        stack[top + 1, 3 + k], stack[top + 1, 11 + k] = a[k], m[k]
                        stack[top, 3 + k] = m[k]
                    top += 2
                    continue
                winding += turn
                if abs(turn) < 1e-5:
                    continue
                if 0.5 * min(a[3], b[3]) > gate[1] or min(a[3], b[3]) > length + most:
                    continue
                if count < len(pieces):
                    for k in range(3):
                        pieces[count, k], pieces[count, 3 + k] = a[k], b[k]
                    pieces[count, 6], pieces[count, 7] = a[3], b[3]
                    pieces[count, 8], pieces[count, 9] = a[4], b[4]
                    pieces[count, 10] = sign * turn
                    pieces[count, 11] = bend / (6 * round_part) if round_part > 0.04 else 0.0
                    owner[count] = p
                count += 1
        windings[i] = sign * winding / (2 * math.pi)
    return count


@njit(cache=True, fastmath=True, nogil=True)
def look_at(pieces, owner, normals, inward, out, middles):  # type: ignore[no-untyped-def]
    """Middles (m, 3) of pieces of rim, and points `inward` of them on the face, to look at [m]."""
    for i in range(len(pieces)):
        p, n = pieces[i], normals[owner[i]]
        ex, ey, ez = p[3] - p[0], p[4] - p[1], p[5] - p[2]
        x, y, z = n[1] * ez - n[2] * ey, n[2] * ex - n[0] * ez, n[0] * ey - n[1] * ex
        scale = inward / max(math.sqrt(x * x + y * y + z * z), 1e-12)
        for k in range(3):
            middles[i, k] = 0.5 * (p[k] + p[3 + k])
        out[i, 0], out[i, 1], out[i, 2] = (
            middles[i, 0] + scale * x,
            middles[i, 1] + scale * y,
            middles[i, 2] + scale * z,
        )


@njit(cache=True, fastmath=True, nogil=True)
def _weight(p, mono, normal, origins, frames, fields, table, flat, gamma, stuff, tap):  # type: ignore[no-untyped-def]
    """Antenna gains and reflection coefficient at a point of a face."""
    dx, dy, dz = p[0] - origins[0, 0], p[1] - origins[0, 1], p[2] - origins[0, 2]
    r = 1 / max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-4)
    ux, uy, uz = dx * r, dy * r, dz * r
    cosine = abs(ux * normal[0] + uy * normal[1] + uz * normal[2])
    share = _te_share(fields[0], ux, uy, uz, normal)
    g = toward(table, flat, frames[0], ux, uy, uz)
    if mono:
        return g * g * _reflection(gamma, stuff, tap, cosine, share), cosine
    dx, dy, dz = p[0] - origins[1, 0], p[1] - origins[1, 1], p[2] - origins[1, 2]
    r = 1 / max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-4)
    ux, uy, uz = dx * r, dy * r, dz * r
    cosine = 0.5 * (cosine + abs(ux * normal[0] + uy * normal[1] + uz * normal[2]))
    g *= toward(table, flat, frames[1], ux, uy, uz)
    return g * _reflection(gamma, stuff, tap, cosine, share), cosine


@njit(cache=True, fastmath=True, nogil=True)
def _same(origins):  # type: ignore[no-untyped-def]
    return origins[0, 0] == origins[1, 0] and origins[0, 1] == origins[1, 1] and origins[0, 2] == origins[1, 2]


@njit(cache=True, fastmath=True, nogil=True)
def lay_line(bulk, ends, w0, w1, x0, x1, bow, place0, place1, scale):  # type: ignore[no-untyped-def]
    """Echo of a line of unit measure, amplitude linear and phase nearly linear along it; gives it at the carrier.

    Phases are those of the mean line; the true phase leads it by bow (4 s (1 - s) - 2 / 3) at share s, to first order.
    """
    z = x1 - x0
    y = 0.5 * z
    y2 = y * y
    scale = scale * (1 - 0.0444 * bow * bow)
    mean, half = 0.5 * (w0 + w1), 0.5 * (w1 - w0)
    if abs(z) < 0.9:
        value = mean * (1 - y2 / 6 + y2 * y2 / 120 + 1j * bow * y2 * (2 / 45 - 0.00317 * y2))
        value -= 1j * half * y / 3 * (1 - y2 / 10)
        middle = 0.5 * (x0 + x1)
        value *= scale * complex(math.cos(middle), -math.sin(middle))
        _lay(bulk, 0.5 * (place0 + place1), value)
        return value
    i = 1j / z
    slope = (w1 - w0) / (z * z)
    odd = mean * bow * (1 / y2 - 1.0 / 3) / y
    even = -1j * mean * bow / y2
    at0 = scale * complex(math.cos(x0), -math.sin(x0)) * (-i * w0 - slope + even + odd)
    at1 = scale * complex(math.cos(x1), -math.sin(x1)) * (i * w1 + slope + even - odd)
    _lay(ends, place0, at0)
    _lay(ends, place1, at1)
    return at0 + at1


@njit(cache=True, fastmath=True, nogil=True)
def lay_rims(pieces, owner, shade, extra, normals, stuffs, origins, frames, fields, table, flat, factor,  # type: ignore[no-untyped-def]
             gamma, lag, omega, t0, dt, fold, grids, echo, delay):  # fmt: skip
    """Lays the echoes of pieces of rim on the delay grids; arguments as in `facets.deposit`."""
    unit = -(2 * math.pi * C0 / omega) / (16 * math.pi * math.pi)
    last = t0 + grids.shape[1] * dt
    weights, cosines = np.zeros(gamma.shape[1], np.complex128), np.zeros(gamma.shape[1])
    known = -2  # the piece whose far end's weights are kept: the next one mostly starts there
    for k in range(len(pieces)):
        echo[k], delay[k] = 0j, 0.0
        if shade[k] == 0:
            continue
        p, n, stuff = pieces[k], normals[owner[k]], stuffs[owner[k]]
        o = owner[k] if len(origins) > 1 else 0
        scale = unit * factor[o]
        mono = _same(origins[o])
        follows = known == k - 1 and owner[known] == owner[k]
        for j in range(3):
            follows = follows and pieces[known, 3 + j] == p[j]
        known = k
        for tap in range(gamma.shape[1]):
            if lag[stuff, tap, 0] < 0:
                break
            if follows:
                w0, c0 = weights[tap], cosines[tap]
            else:
                w0, c0 = _weight(p[:3], mono, n, origins[o], frames[o], fields[o], table, flat, gamma, stuff, tap)
            w1, c1 = _weight(p[3:6], mono, n, origins[o], frames[o], fields[o], table, flat, gamma, stuff, tap)
            weights[tap], cosines[tap] = w1, c1
            late = extra[k] + _late(lag, stuff, tap, 0.5 * (c0 + c1))
            mean = (0.5 * (p[6] + p[7]) + p[11]) / C0 + late
            landed = mean - math.floor((mean - t0) / fold) * fold
            if tap == 0:
                delay[k] = mean
            shift = p[11] / C0 + late + landed - mean
            bow = -1.5 * omega * p[11] / C0
            while landed < last:
                a, b = p[6] / C0 + shift, p[7] / C0 + shift
                echo[k] += lay_line(grids[1], grids[2], p[8] * w0, p[9] * w1, omega * a, omega * b, bow,
                                    (a - t0) / dt, (b - t0) / dt, scale * p[10] * shade[k])  # fmt: skip
                landed += fold
                shift += fold


@njit(cache=True, fastmath=True, nogil=True)
def lay_images(points, owner, lengths, shade, extra, normals, stuffs, origins, frames, fields, table, flat, factor,  # type: ignore[no-untyped-def]
                gamma, lag, omega, t0, dt, fold, grids, echo, delay):  # fmt: skip
    """Lays the specular echoes of faces: unit image waves at (m, 3) points with (m) path lengths [m]."""
    unit = (2 * math.pi * C0 / omega) / (4 * math.pi)
    last = t0 + grids.shape[1] * dt
    for k in range(len(points)):
        echo[k], delay[k] = 0j, 0.0
        if shade[k] == 0:
            continue
        n, stuff = normals[owner[k]], stuffs[owner[k]]
        o = owner[k] if len(origins) > 1 else 0
        scale = unit * factor[o]
        mono = _same(origins[o])
        for tap in range(gamma.shape[1]):
            if lag[stuff, tap, 0] < 0:
                break
            w, cosine = _weight(points[k], mono, n, origins[o], frames[o], fields[o], table, flat, gamma, stuff, tap)
            late = extra[k] + _late(lag, stuff, tap, cosine)
            mean = lengths[k] / C0 + late
            landed = mean - math.floor((mean - t0) / fold) * fold
            if tap == 0:
                delay[k] = mean
            while landed < last:
                value = scale * w * shade[k] / lengths[k] * complex(math.cos(omega * landed), -math.sin(omega * landed))
                _lay(grids[1], (landed - t0) / dt, value)
                landed += fold
            echo[k] += value


@njit(cache=True, fastmath=True, nogil=True)
def crossings(patches, windings, normals, offsets, origins, gate, points, lengths):  # type: ignore[no-untyped-def]
    """Where the lines from image to receiver cross the faces that hold them: points (k, 3) and lengths (k) [m].

    Those whose mean range lies beyond the gate's end are left out, as their rims are.

    Returns:
        How many there are; `patches` is compacted to match, in place.
    """
    count = 0
    image = np.empty(3)
    for i in range(len(patches)):
        if not windings[i] > 0.5:
            continue
        p = patches[i]
        here = origins[p] if len(origins) > 1 else origins[0]
        mirror(here[0], normals[p], offsets[p], image)
        ahead, behind, square = -offsets[p], offsets[p], 1e-300
        for k in range(3):
            ahead += normals[p, k] * here[1, k]
            behind -= normals[p, k] * image[k]
            square += (here[1, k] - image[k]) ** 2
        if square > 4 * gate[1] * gate[1]:
            continue
        share = behind / (ahead + behind)
        for k in range(3):
            points[count, k] = image[k] + share * (here[1, k] - image[k])
        lengths[count] = math.sqrt(square)
        patches[count] = p
        count += 1
    return count


@njit(cache=True, fastmath=True, nogil=True)
def inside(points, owner, normals, first, starts, ends, out):  # type: ignore[no-untyped-def]
    """Whether each point (m, 3) lies within the rim of its face (m)."""
    for i in range(len(points)):
        p = owner[i]
        n = normals[p]
        turn = 0.0
        for e in range(first[p], first[p + 1]):
            ux, uy, uz = starts[e, 0] - points[i, 0], starts[e, 1] - points[i, 1], starts[e, 2] - points[i, 2]
            vx, vy, vz = ends[e, 0] - points[i, 0], ends[e, 1] - points[i, 1], ends[e, 2] - points[i, 2]
            cross = n[0] * (uy * vz - uz * vy) + n[1] * (uz * vx - ux * vz) + n[2] * (ux * vy - uy * vx)
            turn += math.atan2(cross, ux * vx + uy * vy + uz * vz)
        out[i] = abs(turn) > math.pi
