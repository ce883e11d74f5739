"""Loops for waves that cross a face from edge to edge, there and back, by uniform diffraction."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ullage.kernels.facets import toward
from ullage.kernels.rims import lay_line

C0 = 299_792_458.0


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def transition(x):  # type: ignore[no-untyped-def]
    """The transition function F(x) of uniform diffraction, 1 far from the shadow's border [KouyoumjianPathak1974]."""
    if x > 12:
        return 1 + 0.5j / x - 0.75 / (x * x) - 1.875j / (x * x * x)
    s = math.sqrt(x)
    # erfc(sqrt(j) s) by its series: enough terms for s < 2.4
    z2 = complex(0.0, x)
    term = complex(1.0, 0.0)
    total = term
    for n in range(1, 60):
        term *= -z2 / n
        total += term / (2 * n + 1)
    root = complex(math.sqrt(0.5), math.sqrt(0.5))
    tail = 0.5 * math.sqrt(math.pi) / root - s * total  # integral of e^{-j t^2} from s on
    return 2j * s * complex(math.cos(x), math.sin(x)) * tail


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _graze(p, open_angle, inward, normal, wave, width, origins, frames, fields, table, flat, out):  # type: ignore[no-untyped-def]
    """One edge of a pair: diffraction along the face, with gains over ranges; out gets hz of both ends and path."""
    u = np.zeros(3)
    g, path = 1.0, 0.0
    tx = inward[1] * normal[2] - inward[2] * normal[1]
    ty = inward[2] * normal[0] - inward[0] * normal[2]
    tz = inward[0] * normal[1] - inward[1] * normal[0]
    for s in range(2):
        dx, dy, dz = p[0] - origins[s, 0], p[1] - origins[s, 1], p[2] - origins[s, 2]
        r = max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-2)
        g *= math.sqrt(max(toward(table, flat, frames[s], dx / r, dy / r, dz / r), 0.0) / r)
        path += 0.5 * r
        u[0], u[1], u[2] = u[0] + dx / r, u[1] + dy / r, u[2] + dz / r
    size = max(math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2]), 1e-6)
    for k in range(3):
        u[k] /= size
    for s in range(2):
        e = fields[s]
        along = e[0] * u[0] + e[1] * u[1] + e[2] * u[2]
        square = max(e[0] * e[0] + e[1] * e[1] + e[2] * e[2] - along * along, 1e-12)
        hz = (u[1] * e[2] - u[2] * e[1]) * tx + (u[2] * e[0] - u[0] * e[2]) * ty + (u[0] * e[1] - u[1] * e[0]) * tz
        out[s] = hz / math.sqrt(square)
    out[2] = path
    sx = -(u[0] * inward[0] + u[1] * inward[1] + u[2] * inward[2])
    sy = -(u[0] * normal[0] + u[1] * normal[1] + u[2] * normal[2])
    phi = math.atan2(sy, sx)
    if phi < 0:
        phi += 2 * math.pi
    if phi >= open_angle * math.pi:
        return 0j
    half = math.cos(0.5 * phi)
    if abs(half) < 1e-4:
        half = 1e-4
        phi = math.pi - 2e-4
    n = open_angle
    d = 2 * math.sin(math.pi / n) / (n * (math.cos(math.pi / n) - math.cos(phi / n)))
    return g * d * transition(2 * wave * width * half * half)


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _twice(p, gap, width, angles, inward, normal, sheet, wave, origins, frames, fields, table, flat, out, other):  # type: ignore[no-untyped-def]
    """Strength per length of the wave that runs over the face from edge to edge; path length goes to out[2]."""
    q = np.empty(3)
    for k in range(3):
        q[k] = p[k] + gap[k]
    first = _graze(p, angles[0], inward[0], normal, wave, width, origins, frames, fields, table, flat, out)
    second = _graze(q, angles[1], inward[1], normal, wave, width, origins, frames, fields, table, flat, other)
    # the second edge runs the other way in its own face's frame
    both = -0.5 * (out[0] * other[1] + out[1] * other[0])
    path = out[2] + other[2]
    out[2] = path + width
    spread = 1 / math.sqrt(2 * math.pi * wave * width * (1 + width / path))
    faces = 2.0 if sheet else 1.0
    return -faces * both * spread * first * second * complex(math.sqrt(0.5), -math.sqrt(0.5))


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def lay_doubles(pieces, owner, shade, extra, gaps, angles, inward, normals, sheets, origins, frames, fields, table,  # type: ignore[no-untyped-def]
                flat, factor, omega, t0, dt, fold, grids, echo, delay):  # fmt: skip
    """Lays the echoes of waves that cross a face between two parallel edges, there and back.

    Args:
        pieces: (m, 2, 3) ends of each piece of the first edge [m].
        owner: (m) pair of each piece.
        shade: (m) complex two-way factor of what lies between.
        extra: (m) delay added by it [s].
        gaps: (p, 3) from the first edge to the second [m].
        angles: (p, 2) of the free space about both edges, over pi.
        inward: (p, 2, 3) from each edge into the face.
        normals: (p, 3) of the face.
        sheets: (p) whether the wave runs over both sides.
        origins: (2, 3), as in `facets.deposit`, and so the rest.
    """
    wave = omega / C0
    scale = factor / (4 * math.pi * wave)
    last = t0 + grids.shape[1] * dt
    out, other = np.empty(3), np.empty(3)
    for k in range(len(pieces)):
        echo[k], delay[k] = 0j, 0.0
        if shade[k] == 0:
            continue
        w, size, width = owner[k], 0.0, 0.0
        for j in range(3):
            size += (pieces[k, 1, j] - pieces[k, 0, j]) ** 2
            width += gaps[w, j] * gaps[w, j]
        size, width = math.sqrt(size), math.sqrt(width)
        w0 = _twice(pieces[k, 0], gaps[w], width, angles[w], inward[w], normals[w], sheets[w], wave, origins, frames,
                    fields, table, flat, out, other)  # fmt: skip
        path0 = out[2]
        w1 = _twice(pieces[k, 1], gaps[w], width, angles[w], inward[w], normals[w], sheets[w], wave, origins, frames,
                    fields, table, flat, out, other)  # fmt: skip
        path1 = out[2]
        early = size * size / 12 * 4 / max(path0 + path1 - 2 * width, 0.02)
        late = extra[k] - early / C0
        mean = 0.5 * (path0 + path1) / C0 + late
        delay[k] = mean
        landed = mean - math.floor((mean - t0) / fold) * fold
        shift = late + landed - mean
        while landed < last:
            a, b = path0 / C0 + shift, path1 / C0 + shift
            echo[k] += lay_line(grids[1], grids[2], w0, w1, omega * a, omega * b, 1.5 * omega * early / C0,
                                (a - t0) / dt, (b - t0) / dt, scale * size * shade[k])  # fmt: skip
            landed += fold
            shift += fold
