"""Loops of the physical theory of diffraction: what straight edges of conductors add to physical optics.

The currents that the exact solution of an endless wedge has beyond physical optics are integrated from the edge along
both faces, in the direction in which the diffracted wave runs along them; that gives each length of edge a strength
at every aspect [Michaeli1986], [Ufimtsev2007]. Only straight back, at the bisector of transmitter and receiver.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ullage.kernels.facets import _lay, toward
from ullage.kernels.rims import lay_line

C0 = 299_792_458.0


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def excess(open_angle, phi, mu, out):  # type: ignore[no-untyped-def]
    """Fringe current of one face of a wedge, integrated from the edge: along it (soft) and across it (hard).

    Args:
        open_angle: of the free space, over pi (2 for a thin sheet, 1.5 for the edge of a box).
        phi: angle from the face to where the wave comes from [rad].
        mu: rate of phase along the face towards the receiver, over that of the wave across the edge; at most 1.
        out: (2) gets soft, hard.
    """
    n = open_angle
    lit = 1.0 if phi < math.pi else 0.0
    if -mu <= 1:
        y = math.acos(max(-mu, -1.0))
        sine = max(math.sqrt(max(1 - mu * mu, 0.0)), 1e-6)
        ratio = math.sin(y / n) / sine if y > 1e-5 else 1 / n
        turn = math.cos(y / n)
    else:
        t = min(math.acosh(-mu), 60.0)
        ratio = math.sinh(t / n) / math.sinh(t) if t > 1e-5 else 1 / n
        turn = math.cosh(t / n)
    gap = math.cos(phi / n) - turn
    plain = math.cos(phi) + mu
    out[0] = math.sin(phi / n) / (n * gap) - lit * math.sin(phi) / plain
    out[1] = ratio / (n * gap) - lit / plain


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def fringe(open_angle, phi, mu, out):  # type: ignore[no-untyped-def]
    """As `excess`, also where exact and optical current grow without bound together."""
    if phi < math.pi and abs(math.cos(phi) + mu) < 0.03:
        step = 0.05
        excess(open_angle, abs(phi - step), mu, out)
        soft, hard = out[0], out[1]
        if phi < step:
            soft = -soft
        excess(open_angle, phi + step, mu, out)
        out[0], out[1] = 0.5 * (soft + out[0]), 0.5 * (hard + out[1])
        return
    excess(open_angle, phi, mu, out)


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def face(open_angle, inward, normal, u, e0, e1, out):  # type: ignore[no-untyped-def]
    """One face's share of an edge's strength straight back, times the wave number.

    Args:
        open_angle: of the free space, over pi.
        inward: (3) unit vector in the face, away from the edge.
        normal: (3) unit normal of the face, into the free space.
        u: (3) unit direction of travel.
        e0: (3) unit transmitted field, across u.
        e1: (3) unit field that is received, across u.
        out: (2) scratch.
    """
    tx = inward[1] * normal[2] - inward[2] * normal[1]
    ty = inward[2] * normal[0] - inward[0] * normal[2]
    tz = inward[0] * normal[1] - inward[1] * normal[0]
    cosine = u[0] * tx + u[1] * ty + u[2] * tz
    sx = -(u[0] * inward[0] + u[1] * inward[1] + u[2] * inward[2])
    sy = -(u[0] * normal[0] + u[1] * normal[1] + u[2] * normal[2])
    sine2 = sx * sx + sy * sy
    if sine2 < 1e-3:
        return 0.0
    phi = math.atan2(sy, sx)
    if phi < 0:
        phi += 2 * math.pi
    if phi >= open_angle * math.pi:
        return 0.0
    sine = math.sqrt(sine2)
    mu = math.cos(phi) - 2 * cosine * cosine / sine2
    fringe(open_angle, phi, mu, out)
    lit = 1.0 if phi < math.pi else 0.0
    ez = e0[0] * tx + e0[1] * ty + e0[2] * tz
    hz = (u[1] * e0[2] - u[2] * e0[1]) * tx + (u[2] * e0[0] - u[0] * e0[2]) * ty + (u[0] * e0[1] - u[1] * e0[0]) * tz
    along = (ez * out[0] + cosine * hz * (lit - 1 / open_angle + mu * out[1])) / sine2
    across = hz * out[1] / sine
    seen_along = e1[0] * tx + e1[1] * ty + e1[2] * tz
    seen_across = e1[0] * inward[0] + e1[1] * inward[1] + e1[2] * inward[2]
    return seen_along * along + seen_across * across


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def strength(p, open_angle, inward, normal, sheet, origins, frames, fields, table, flat, rows, out):  # type: ignore[no-untyped-def]
    """Antenna gains over ranges times the edge's strength at point p; path length and its bend go to out[2:4]."""
    u, e0, e1 = rows[0], rows[1], rows[2]
    u[0] = u[1] = u[2] = 0.0
    g, path, bend = 1.0, 0.0, 0.0
    tx = inward[0, 1] * normal[0, 2] - inward[0, 2] * normal[0, 1]
    ty = inward[0, 2] * normal[0, 0] - inward[0, 0] * normal[0, 2]
    tz = inward[0, 0] * normal[0, 1] - inward[0, 1] * normal[0, 0]
    for s in range(2):
        dx, dy, dz = p[0] - origins[s, 0], p[1] - origins[s, 1], p[2] - origins[s, 2]
        r = max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-2)
        dx, dy, dz = dx / r, dy / r, dz / r
        g *= toward(table, flat, frames[s], dx, dy, dz) / r
        path += r
        along = tx * dx + ty * dy + tz * dz
        bend += (1 - along * along) / r
        u[0], u[1], u[2] = u[0] + dx, u[1] + dy, u[2] + dz
    out[2], out[3] = path, bend
    size = math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    if size < 1e-6:
        return 0.0
    for k in range(3):
        u[k] /= size
    for s in range(2):
        e = e0 if s == 0 else e1
        along = fields[s, 0] * u[0] + fields[s, 1] * u[1] + fields[s, 2] * u[2]
        square = 0.0
        for k in range(3):
            e[k] = fields[s, k] - along * u[k]
            square += e[k] * e[k]
        for k in range(3):
            e[k] /= math.sqrt(max(square, 1e-12))
    total = 0.0
    if sheet:  # the rim of a thin body: only its wide face, from the side it looks to
        if u[0] * normal[0, 0] + u[1] * normal[0, 1] + u[2] * normal[0, 2] >= 0:
            return 0.0
        total = face(2.0, inward[0], normal[0], u, e0, e1, out)
        for k in range(3):
            rows[3, k] = -normal[0, k]
        return g * (total + face(2.0, inward[0], rows[3], u, e0, e1, out))
    for i in range(2):
        total += face(open_angle, inward[i], normal[i], u, e0, e1, out)
    return g * total


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _along(e, p, origin):  # type: ignore[no-untyped-def]
    """Share of the field that lies along the way to p."""
    x, y, z = p[0] - origin[0], p[1] - origin[1], p[2] - origin[2]
    return (e[0] * x + e[1] * y + e[2] * z) ** 2 / max(x * x + y * y + z * z, 1e-9)


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def audible(starts, ends, lit, factors, across, origins, frames, fields, table, flat, wave, gate, least, out):  # type: ignore[no-untyped-def]
    """Whether each edge (w, 3)-(w, 3) can return more than `least`, by the most its strength and length allow.

    Args:
        starts: (w, 3) [m].
        ends: (w, 3) [m].
        lit: (w) which to ask about; the others cannot.
        factors: (w) strength over that of an edge by itself.
        across: whether only the electric field across the edge counts.
        origins: (2, 3), as in `facets.deposit`, and so the next ones.
        wave: wave number [1/m].
        gate: (2) least and greatest range [m].
        least: path gain amplitude.
        out: (w) gets the answer.
    """
    t = np.empty(3)
    for w in range(len(starts)):
        out[w] = False
        if not lit[w]:
            continue
        size = 0.0
        for k in range(3):
            t[k] = ends[w, k] - starts[w, k]
            size += t[k] * t[k]
        size = max(math.sqrt(size), 1e-9)
        foot = 0.0
        for k in range(3):
            t[k] /= size
            foot += (origins[0, k] - starts[w, k]) * t[k]
        near = min(max(foot, 0.0), size)
        square = 0.0
        for k in range(3):
            square += (starts[w, k] + near * t[k] - origins[0, k]) ** 2
        if square > gate[1] * gate[1]:
            continue
        best, gain, most = max(math.sqrt(square), 1e-2), 0.0, 0.0
        for step in range(3):
            along = near if step == 0 else (0.0 if step == 1 else size)
            x, y, z = (starts[w, 0] + along * t[0] - origins[0, 0], starts[w, 1] + along * t[1] - origins[0, 1],
                       starts[w, 2] + along * t[2] - origins[0, 2])  # fmt: skip
            r = max(math.sqrt(x * x + y * y + z * z), 1e-2)
            if across:
                hard = abs((y * fields[0, 2] - z * fields[0, 1]) * t[0] + (z * fields[0, 0] - x * fields[0, 2]) * t[1]
                           + (x * fields[0, 1] - y * fields[0, 0]) * t[2]) / r  # fmt: skip
                most = max(most, hard)
            gain = max(gain, toward(table, flat, frames[0], x / r, y / r, z / r))
        reach = math.sqrt(math.pi * best / wave)  # of the stationary part
        beside = abs(foot - near)
        if beside > 0:
            reach = min(reach, best / (wave * beside))
        strong = gain * gain / (best * best) * min(size, reach) / (4 * math.pi * wave)
        if across:
            strong *= most * most / max(1 - _along(fields[0], starts[w], origins[0]), 0.05)
        out[w] = 1.5 * factors[w] * strong > least


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _meet(p, q):  # type: ignore[no-untyped-def]
    return p[0] == q[0] and p[1] == q[1] and p[2] == q[2]


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def lay_fringes(pieces, owner, shade, extra, angles, inward, normals, sheets, origins, frames, fields, table, flat,  # type: ignore[no-untyped-def]
                factor, omega, t0, dt, fold, grids, echo, delay):  # fmt: skip
    """Lays the echoes of pieces of edge (m, 2, 3) on the delay grids.

    Args:
        pieces: (m, 2, 3) ends of each piece [m].
        owner: (m) edge of each piece.
        shade: (m) complex two-way factor of what lies between.
        extra: (m) delay added by it [s].
        angles: (w) of the free space about each edge, over pi.
        inward: (w, 2, 3) unit vectors in its two faces, away from it.
        normals: (w, 2, 3) their unit normals, into the free space.
        sheets: (w) whether it is the rim of a thin body, whose first face is the wide one.
        origins: (2, 3), as in `facets.deposit`, and so the rest.
    """
    scale = factor * C0 / (4 * math.pi * omega)
    last = t0 + grids.shape[1] * dt
    out, rows = np.empty(4), np.empty((4, 3))
    w0, path0, bend0 = 0.0, 0.0, 0.0
    for k in range(len(pieces)):
        echo[k], delay[k] = 0j, 0.0
        if shade[k] == 0:
            continue
        w, size = owner[k], 0.0
        for j in range(3):
            size += (pieces[k, 1, j] - pieces[k, 0, j]) ** 2
        size = math.sqrt(size)
        if k > 0 and owner[k - 1] == w and shade[k - 1] != 0 and _meet(pieces[k - 1, 0], pieces[k, 1]):
            w1, path1, bend1 = w0, path0, bend0  # pieces of an edge come one after the other, from its end
        else:
            w1 = strength(pieces[k, 1], angles[w], inward[w], normals[w], sheets[w], origins, frames, fields, table,
                          flat, rows, out)  # fmt: skip
            path1, bend1 = out[2], out[3]
        w0 = strength(pieces[k, 0], angles[w], inward[w], normals[w], sheets[w], origins, frames, fields, table, flat,
                      rows, out)  # fmt: skip
        path0, bend0 = out[2], out[3]
        bend = 0.5 * (bend0 + bend1)
        if w0 == 0 and w1 == 0:
            continue
        early = bend * size * size / 12  # as for wires: by what the chord lies beyond the path, on average
        late = extra[k] - early / C0
        mean = 0.5 * (path0 + path1) / C0 + late
        delay[k] = mean
        landed = mean - math.floor((mean - t0) / fold) * fold
        shift = late + landed - mean
        while landed < last:
            a, b = path0 / C0 + shift, path1 / C0 + shift
            echo[k] += lay_line(grids[1], grids[2], complex(w0), complex(w1), omega * a, omega * b,
                                1.5 * omega * early / C0, (a - t0) / dt, (b - t0) / dt,
                                scale * size * shade[k])  # fmt: skip
            landed += fold
            shift += fold


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def lay_tips(tips, owner, shade, extra, angles, inward, normals, sheets, origins, frames, fields, table, flat, factor,  # type: ignore[no-untyped-def]
             omega, t0, dt, fold, grids, echo, delay):  # fmt: skip
    """Lays the ends of edges (n, 5), as `lines.part` gives them; arguments as in `lay_fringes`."""
    scale = factor * C0 / (4 * math.pi * omega)
    last = t0 + grids.shape[1] * dt
    out, rows = np.empty(4), np.empty((4, 3))
    for k in range(len(tips)):
        echo[k], delay[k] = 0j, 0.0
        if shade[k] == 0:
            continue
        w = owner[k]
        strong = strength(tips[k, :3], angles[w], inward[w], normals[w], sheets[w], origins, frames, fields, table,
                          flat, rows, out)  # fmt: skip
        late = out[2] / C0 + extra[k]
        delay[k] = late
        landed = late - math.floor((late - t0) / fold) * fold
        while landed < last:
            value = scale * shade[k] * strong * complex(tips[k, 3], tips[k, 4])
            value *= complex(math.cos(omega * landed), -math.sin(omega * landed))
            _lay(grids[2], (landed - t0) / dt, value)
            echo[k] += value
            landed += fold
