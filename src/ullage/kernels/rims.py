"""Loops that lay the echoes of flat faces' rims and mirror images on the delay grids."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ullage.kernels.edges import mirror
from ullage.kernels.facets import _late, _lay, _reflection, _te_share, toward

C0 = 299_792_458.0


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def look_at(pieces, owner, normals, inward, out):  # type: ignore[no-untyped-def]
    """Points (m, 3) on the faces `inward` of the middles of pieces of rim, to look at [m]."""
    for i in range(len(pieces)):
        p, n = pieces[i], normals[owner[i]]
        ex, ey, ez = p[3] - p[0], p[4] - p[1], p[5] - p[2]
        x, y, z = n[1] * ez - n[2] * ey, n[2] * ex - n[0] * ez, n[0] * ey - n[1] * ex
        scale = inward / max(math.sqrt(x * x + y * y + z * z), 1e-12)
        out[i, 0] = 0.5 * (p[0] + p[3]) + scale * x
        out[i, 1] = 0.5 * (p[1] + p[4]) + scale * y
        out[i, 2] = 0.5 * (p[2] + p[5]) + scale * z


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
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


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _same(origins):  # type: ignore[no-untyped-def]
    return origins[0, 0] == origins[1, 0] and origins[0, 1] == origins[1, 1] and origins[0, 2] == origins[1, 2]


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
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


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
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


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def look_at_tips(tips, inward, out):  # type: ignore[no-untyped-def]
    """Points (n, 3) on the faces, `inward` of both rims that meet at the ends of rims (n, 9), to look at [m]."""
    for i in range(len(tips)):
        x, y, z = tips[i, 6], tips[i, 7], tips[i, 8]
        scale = math.sqrt(2) * inward / max(math.sqrt(x * x + y * y + z * z), 0.1)
        for k in range(3):
            out[i, k] = tips[i, k] + scale * tips[i, 6 + k]


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def lay_tips(tips, owner, shade, extra, normals, stuffs, origins, frames, fields, table, flat, factor,  # type: ignore[no-untyped-def]
             gamma, lag, omega, t0, dt, fold, grids, echo, delay):  # fmt: skip
    """Lays the echoes of the ends of rims (n, 9), as `edges.cut` gives them; arguments as in `facets.deposit`."""
    unit = -(2 * math.pi * C0 / omega) / (16 * math.pi * math.pi)
    last = t0 + grids.shape[1] * dt
    for k in range(len(tips)):
        echo[k], delay[k] = 0j, 0.0
        if shade[k] == 0:
            continue
        p, n, stuff = tips[k], normals[owner[k]], stuffs[owner[k]]
        o = owner[k] if len(origins) > 1 else 0
        scale = unit * factor[o] * shade[k] * complex(p[4], p[5])
        mono = _same(origins[o])
        for tap in range(gamma.shape[1]):
            if lag[stuff, tap, 0] < 0:
                break
            w, cosine = _weight(p[:3], mono, n, origins[o], frames[o], fields[o], table, flat, gamma, stuff, tap)
            mean = p[3] / C0 + extra[k] + _late(lag, stuff, tap, cosine)
            landed = mean - math.floor((mean - t0) / fold) * fold
            if tap == 0:
                delay[k] = mean
            while landed < last:
                value = scale * w * complex(math.cos(omega * landed), -math.sin(omega * landed))
                _lay(grids[2], (landed - t0) / dt, value)
                echo[k] += value
                landed += fold


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
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


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def crossings(patches, windings, normals, offsets, origins, limits, points, lengths):  # type: ignore[no-untyped-def]
    """Where the lines from image to receiver cross the faces that hold them: points (k, 3) and lengths (k) [m].

    Those whose mean range lies beyond the face's limit are left out, as their rims are.

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
        limit = limits[p] if len(limits) > 1 else limits[0]
        if square > 4 * limit * limit:
            continue
        share = behind / (ahead + behind)
        for k in range(3):
            points[count, k] = image[k] + share * (here[1, k] - image[k])
        lengths[count] = math.sqrt(square)
        patches[count] = p
        count += 1
    return count


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
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
