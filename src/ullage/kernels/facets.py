"""Loops of physical optics on triangles: culling and splitting, closed-form echoes.

A flat triangle whose delay is taken linear across it is a sum of a few impulses, each of one spectral kind n = 0, 1, 2
(bulk, edge, vertex), whose spectrum falls as frequency^-n. Impulses are added to one fine delay grid per kind with a
cubic B-spline, demodulated at the carrier; one short convolution per kind (`pulse.convolve`) then makes the range bins.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ullage.arrays import Bools, Complexes, Floats, Ints, Longs
from ullage.kernels.loops import core, lean
from ullage.kernels.near import TOUCH_M, lifted

C0 = 299_792_458.0
# numbers handed to other kernels are no literals: Numba compiles a function anew for each literal integer
BULK, EDGE, VERTEX = np.int64(0), np.int64(1), np.int64(2)  # spectral kinds, rows of the delay grids
ONE = np.int64(0)  # the radar, where there is but one
FROM, TO = np.int64(0), np.int64(1)  # ends of a piece
BALL = 0.67
"""Radius of a ball about a triangle's centre that holds it, over its longest edge: 2/3 of a median is shorter."""


class Antennas(NamedTuple):
    """Radars of a transmitter and a receiver each, or of their mirror images, with the pattern that both share."""

    origins: Floats  # (w, 2, 3) transmitter and receiver of each radar [m]
    frames: Floats  # (w, 2, 3, 3) sensor_from_world rotations of both, with mirrors
    fields: Floats  # (w, 2, 3) unit electric fields in the world
    table: Complexes  # (1 or 2, 6, n, n) of both, or each: one-way amplitude gains on a cube in the sensor's frame
    isotropic: bool  # whether the gain is table[0, 0, 0, 0] in all directions
    factor: Complexes  # (w) multiplies every echo


class Reflection(NamedTuple):
    """Reflection of each material against cos(incidence)."""

    gamma: Complexes  # (s, taps, 2, c) coefficients of each material and tap, TE and TM
    lag: Floats  # (s, taps, c) delay of each tap [s], negative where there is no such tap


class LitFaces(NamedTuple):
    """Faces (f) of materials, and the radars that see them."""

    normals: Floats  # (f, 3) unit normals
    materials: Ints  # (f) row of each face in the reflection tables
    antennas: Antennas
    reflection: Reflection


class PulseGrid(NamedTuple):
    """Carrier of a pulse, and the delays at which its echoes are summed."""

    omega: float  # carrier [rad/s]
    start_s: float  # delay of the first grid place [s]
    step_s: float  # grid step [s]
    fold_s: float  # time between pulses, after which an echo lands again [s]


class Transmission(NamedTuple):
    """Effect of what lies between the radar and each of m echoes."""

    factor: Complexes  # (m) two-way amplitude, 0 where hidden
    delay_s: Floats  # (m) two-way delay added [s]


class EchoSums(NamedTuple):
    """Where a kernel writes its echoes."""

    grids: Complexes  # (3, g) one delay grid for each spectral kind, added to
    echo: Complexes  # (m) gets each echo at the carrier
    delay_s: Floats  # (m) gets the delay of each [s]


class TriangleClusters(NamedTuple):
    """Triangles (f) in clusters (k)."""

    spheres: Floats  # (k, 4) centre and radius of each cluster [m]
    first: Ints  # (k + 1) first triangle of each cluster
    corners: Floats  # (f, 3, 3) [m]


class PieceLimits(NamedTuple):
    """Where pieces are wanted, and how small they must be."""

    gate: Floats  # (2) least and greatest mean range [m]
    kappa_lambda: float  # largest squared transverse edge over range [m]
    reach: float  # longest edge over range


class TrianglePieces(NamedTuple):
    """Pieces (m) of triangles."""

    corners: Floats  # (m, 3, 3) [m]
    triangle: Ints  # (m) triangle of each piece
    radar: Longs  # (m) radar that sees each piece


class CornerScratch(NamedTuple):
    """Scratch of `accumulate`: quantities at the three corners of a piece."""

    phase: Floats  # (3) carrier phase delay [rad]
    place: Floats  # (3) delay [grid steps]
    base: Complexes  # (3) antenna gains over ranges
    cosine: Floats  # (3) cos(incidence)
    path: Floats  # (3) path length there and back [m]
    weight: Complexes  # (3) complex amplitude


@lean(fastmath=True, error_model="numpy")
def split(
    clusters: TriangleClusters,
    dark: Bools,
    origins: Floats,
    limits: PieceLimits,
    leaves: Floats,
    owner: Ints,
    stack: Floats,
) -> int:
    """Cut the triangles within the gate until each is small against the Fresnel zone.

    Args:
        clusters: `TriangleClusters` (f).
        dark: (f) triangles to leave out.
        origins: (2, 3) transmitter and receiver, or their images [m].
        limits: `PieceLimits`.
        leaves: (m, 3, 3) gets the pieces [m].
        owner: (m) gets the index of each piece's triangle.
        stack: (96, 3, 3) scratch.

    Returns:
        How many pieces there are; only the first m are written.
    """
    spheres, first, corners, gate = clusters.spheres, clusters.first, clusters.corners, limits.gate
    count = 0
    for k in range(len(spheres)):
        r = _mean_range(spheres[k, 0], spheres[k, 1], spheres[k, 2], origins)
        if r - spheres[k, 3] > gate[1] or r + spheres[k, 3] < gate[0]:
            continue
        for face in range(first[k], first[k + 1]):
            if dark[face]:
                continue
            for i in range(3):
                for j in range(3):
                    stack[0, i, j] = corners[face, i, j]
            top = 1
            while top > 0:
                top -= 1
                edge = _longest(stack[top], origins, limits)
                if edge == -2:
                    continue
                if edge == -1 or top > 92:
                    if count < len(leaves):
                        for i in range(3):
                            for j in range(3):
                                leaves[count, i, j] = stack[top, i, j]
                        owner[count] = face
                    count += 1
                    continue
                _halve(stack, top, edge)
                top += 2
    return count


@core(fastmath=True, error_model="numpy")
def _mean_range(x: float, y: float, z: float, origins: Floats) -> float:
    a = math.sqrt((x - origins[0, 0]) ** 2 + (y - origins[0, 1]) ** 2 + (z - origins[0, 2]) ** 2)
    b = math.sqrt((x - origins[1, 0]) ** 2 + (y - origins[1, 1]) ** 2 + (z - origins[1, 2]) ** 2)
    return 0.5 * (a + b)


@core(fastmath=True, error_model="numpy")
def _longest(t: Floats, origins: Floats, limits: PieceLimits) -> int:
    """The edge to halve (from corner e to e + 1), -1 when the piece is small enough, -2 when outside the gate."""
    cx, cy, cz = (
        (t[0, 0] + t[1, 0] + t[2, 0]) / 3,
        (t[0, 1] + t[1, 1] + t[2, 1]) / 3,
        (t[0, 2] + t[1, 2] + t[2, 2]) / 3,
    )
    r = _mean_range(cx, cy, cz, origins)
    dx, dy, dz = cx - origins[0, 0], cy - origins[0, 1], cz - origins[0, 2]
    gx, gy, gz = cx - origins[1, 0], cy - origins[1, 1], cz - origins[1, 2]
    unit = 1.0 / max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
    other = 1.0 / max(math.sqrt(gx * gx + gy * gy + gz * gz), 1e-9)
    longest, which, across = 0.0, 0, 0.0
    for e in range(3):
        f = (e + 1) % 3
        ex, ey, ez = t[f, 0] - t[e, 0], t[f, 1] - t[e, 1], t[f, 2] - t[e, 2]
        square = ex * ex + ey * ey + ez * ez
        along = min(abs(ex * dx + ey * dy + ez * dz) * unit, abs(ex * gx + ey * gy + ez * gz) * other)
        across = max(across, square - along * along)
        if square > longest * 1.000001:  # equal edges: always the same one, so that pieces nest
            longest, which = square, e
    size = math.sqrt(longest)
    if r - BALL * size > limits.gate[1] or r + BALL * size < limits.gate[0]:
        return -2
    near = max(r, 3 * TOUCH_M)
    if across > limits.kappa_lambda * near or size > limits.reach * near:
        return which
    return -1


@core(fastmath=True, error_model="numpy")
def _halve(stack: Floats, top: int, edge: int) -> None:
    a, b, c = edge, (edge + 1) % 3, (edge + 2) % 3
    for k in range(3):
        pa, pb, pc = stack[top, a, k], stack[top, b, k], stack[top, c, k]
        middle = 0.5 * (pa + pb)
        stack[top, 0, k], stack[top, 1, k], stack[top, 2, k] = pa, middle, pc
        stack[top + 1, 0, k], stack[top + 1, 1, k], stack[top + 1, 2, k] = middle, pb, pc


@lean(fastmath=True, error_model="numpy")
def toward(table: Complexes, flat: bool, frames: Floats, o: int, s: int, ux: float, uy: float, uz: float) -> complex:
    """One-way amplitude gain of antenna s along u in the world, for a sensor_from_world rotation frames[o, s].

    From `Antennas.table`; where `flat`, the same everywhere.
    """
    t = s if len(table) > 1 else 0
    if flat:
        return table[t, 0, 0, 0]
    x = frames[o, s, 0, 0] * ux + frames[o, s, 0, 1] * uy + frames[o, s, 0, 2] * uz
    y = frames[o, s, 1, 0] * ux + frames[o, s, 1, 1] * uy + frames[o, s, 1, 2] * uz
    z = frames[o, s, 2, 0] * ux + frames[o, s, 2, 1] * uy + frames[o, s, 2, 2] * uz
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        face, a, b, m = (0 if x > 0 else 1), y, z, ax
    elif ay >= az:
        face, a, b, m = (2 if y > 0 else 3), x, z, ay
    else:
        face, a, b, m = (4 if z > 0 else 5), x, y, az
    n = table.shape[2] - 1
    scale = 0.5 * n / max(m, 1e-300)
    u, v = min(max(a * scale + 0.5 * n, 0.0), n - 1e-9), min(max(b * scale + 0.5 * n, 0.0), n - 1e-9)
    i, j = int(u), int(v)
    u, v = u - i, v - j
    low = table[t, face, i, j] * (1 - v) + table[t, face, i, j + 1] * v
    high = table[t, face, i + 1, j] * (1 - v) + table[t, face, i + 1, j + 1] * v
    return low * (1 - u) + high * u


@core(fastmath=True, error_model="numpy")
def sight(
    antennas: Antennas, o: int, s: int, x: float, y: float, z: float
) -> tuple[float, float, float, float, complex]:
    """Range [m], unit vector and gain from an antenna to a place."""
    origins = antennas.origins
    dx, dy, dz = x - origins[o, s, 0], y - origins[o, s, 1], z - origins[o, s, 2]
    r = max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
    dx, dy, dz = dx / r, dy / r, dz / r
    return r, dx, dy, dz, toward(antennas.table, antennas.isotropic, antennas.frames, o, s, dx, dy, dz)


@core(fastmath=True, error_model="numpy")
def same(antennas: Antennas, o: int) -> bool:
    """Whether transmitter and receiver of a radar stand at one place and have one pattern."""
    origins = antennas.origins
    return (len(antennas.table) == 1 and origins[o, 0, 0] == origins[o, 1, 0] and origins[o, 0, 1] == origins[o, 1, 1]
            and origins[o, 0, 2] == origins[o, 1, 2])  # fmt: skip


@core(fastmath=True, error_model="numpy")
def turned(x: float) -> complex:
    """e^{-jx}, to 1e-11 and less for thousands of radians: nearest quarter turn, then Taylor's series."""
    n = math.floor(x * (2 / math.pi) + 0.5)
    y = x - n * (0.5 * math.pi)
    z = y * y
    sine = y * (1 - z * (1 / 6 - z * (1 / 120 - z * (1 / 5040 - z * (1 / 362880 - z / 39916800)))))
    cosine = 1 - z * (0.5 - z * (1 / 24 - z * (1 / 720 - z * (1 / 40320 - z * (1 / 3628800 - z / 479001600)))))
    quarter = int(n) & 3
    if quarter & 1:
        sine, cosine = cosine, -sine
    if quarter & 2:
        sine, cosine = -sine, -cosine
    return complex(cosine, -sine)


@core(fastmath=True, error_model="numpy")
def _accumulate(grids: Complexes, kind: int, place: float, value: complex) -> None:
    """Add an impulse at a fractional place of one grid, with a cubic B-spline; outside the grid it is lost."""
    i = math.floor(place)
    if i < 1 or i + 2 >= grids.shape[1]:
        return
    u = place - i
    v = 1.0 - u
    grids[kind, i - 1] += value * (v * v * v / 6)
    grids[kind, i] += value * (2.0 / 3 - 0.5 * u * u * (2 - u))
    grids[kind, i + 1] += value * (2.0 / 3 - 0.5 * v * v * (2 - v))
    grids[kind, i + 2] += value * (u * u * u / 6)


@core(fastmath=True, error_model="numpy")
def accumulate_triangle(grids: Complexes, w: Complexes, x: Floats, places: Floats, scale: complex) -> complex:
    """Add the echo of a triangle of unit area, amplitude and phase linear between its corners.

    Args:
        grids: (3, g) one delay grid for each spectral kind.
        w: (3) complex amplitudes at the corners.
        x: (3) carrier phase delays of the corners [rad].
        places: (3) the same delays in grid steps.
        scale: complex factor.

    Returns:
        The echo at the carrier, scale included.
    """
    d01, d12, d20 = abs(x[0] - x[1]), abs(x[1] - x[2]), abs(x[2] - x[0])
    if max(d01, d12, d20) < 1.5:
        return _bulk(grids, w, x, places, scale)
    least = min(d01, d12, d20)
    if least < 0.5:
        lone = 0 if d12 == least else 1 if d20 == least else 2
        return _strip(grids, w, x, places, scale, lone, (lone + 1) % 3, (lone + 2) % 3)
    total = 0j
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        ab, ac = 1.0 / (x[a] - x[b]), 1.0 / (x[a] - x[c])
        inner = w[a] + 1j * ((w[b] - w[a]) * ab + (w[c] - w[a]) * ac)
        value = scale * (-2.0 * ab * ac) * inner * turned(x[a])
        _accumulate(grids, VERTEX, places[a], value)
        total += value
    return total


@core(fastmath=True, error_model="numpy")
def _bulk(grids: Complexes, w: Complexes, x: Floats, places: Floats, scale: complex) -> complex:
    """Corners nearly at one delay: the moment series to sixth order."""
    middle = (x[0] + x[1] + x[2]) / 3
    y0, y1, y2 = x[0] - middle, x[1] - middle, x[2] - middle
    p2 = y0 * y0 + y1 * y1 + y2 * y2
    p3 = y0 * y0 * y0 + y1 * y1 * y1 + y2 * y2 * y2
    real = 1 - p2 / 24 + p2 * p2 / 1440 - (p2 * p2 * p2 / 8 + p3 * p3 / 9) / 20160
    imag = p3 / 180 - p2 * p3 / 7560
    mean = (w[0] + w[1] + w[2]) / 3
    value = mean * complex(real, imag) - 1j * (w[0] * y0 + w[1] * y1 + w[2] * y2) / 12
    value *= scale * turned(middle)
    _accumulate(grids, BULK, (places[0] + places[1] + places[2]) / 3, value)
    return value


@core(fastmath=True, error_model="numpy")
def _strip(
    grids: Complexes, w: Complexes, x: Floats, places: Floats, scale: complex, a: int, b: int, c: int
) -> complex:
    """Corners b and c nearly at one delay, a far from it: strips parallel to bc, integrated exactly along the rest."""
    z = 0.5 * (x[b] + x[c]) - x[a]
    eta = 0.5 * (x[c] - x[b])
    w0 = w[a]
    w1 = 0.5 * (w[b] + w[c]) - w0
    w3 = -(eta * eta / 6) * w0 - 1j * (eta / 3) * 0.5 * (w[c] - w[b])
    i = 1j / z
    start1 = -i * (-i)
    start2 = -2 * i * start1
    start3 = -3 * i * start2
    rest1 = -i * i
    rest2 = -2 * i * (i + rest1)
    rest3 = -3 * i * (i + rest2)
    near = scale * 2 * turned(x[a])
    far = scale * 2 * turned(x[a] + z)
    at_a = near * (w0 * start1 + w1 * start2 + w3 * start3)
    edge = far * i * (w0 + w1 + w3)
    rest = far * (w0 * rest1 + w1 * rest2 + w3 * rest3)
    middle = 0.5 * (places[b] + places[c])
    _accumulate(grids, VERTEX, places[a], at_a)
    _accumulate(grids, EDGE, middle, edge)
    _accumulate(grids, VERTEX, middle, rest)
    return at_a + edge + rest


@core(fastmath=True, error_model="numpy")
def _reflection(gamma: Complexes, object_id: int, tap: int, cosine: float, across: float, both: float) -> complex:
    """Reflection coefficient from the tables over cos(incidence); `across` and `both` as `te_share` gives them."""
    n = gamma.shape[3] - 1
    u = min(cosine, 0.9999999) * n
    i = int(u)
    u -= i
    te = gamma[object_id, tap, 0, i] * (1 - u) + gamma[object_id, tap, 0, i + 1] * u
    tm = gamma[object_id, tap, 1, i] * (1 - u) + gamma[object_id, tap, 1, i + 1] * u
    return across * te + (both - across) * tm


@core(fastmath=True, error_model="numpy")
def _late(lag: Floats, object_id: int, tap: int, cosine: float) -> float:
    """Delay of an inner echo from the table over cos(incidence) [s]."""
    n = lag.shape[2] - 1
    u = min(cosine, 0.9999999) * n
    i = int(u)
    return lag[object_id, tap, i] * (1 - u + i) + lag[object_id, tap, i + 1] * (u - i)


@core(fastmath=True, error_model="numpy")
def alike(fields: Floats, o: int) -> bool:
    """Whether transmitter and receiver of a radar have one polarisation."""
    return (fields[o, 0, 0] == fields[o, 1, 0] and fields[o, 0, 1] == fields[o, 1, 1]
            and fields[o, 0, 2] == fields[o, 1, 2])  # fmt: skip


@core(fastmath=True, error_model="numpy")
def te_share(
    fields: Floats, o: int, ux: float, uy: float, uz: float, nx: float, ny: float, nz: float
) -> tuple[float, float]:
    """Product of the transmitted and received unit fields for a wave along u at a face with normal n.

    Returns:
        The product of their parts across the plane of incidence, and the whole product; the latter is 1 for one
        polarisation.
    """
    sx, sy, sz = uy * nz - uz * ny, uz * nx - ux * nz, ux * ny - uy * nx
    ex, ey, ez = fields[o, 0, 0], fields[o, 0, 1], fields[o, 0, 2]
    eu, es = ex * ux + ey * uy + ez * uz, ex * sx + ey * sy + ez * sz
    square = (sx * sx + sy * sy + sz * sz) * (1 - eu * eu)
    if alike(fields, o):
        if square < 1e-12:
            return 0.5, 1.0
        return min(es * es / square, 1.0), 1.0
    rx, ry, rz = fields[o, 1, 0], fields[o, 1, 1], fields[o, 1, 2]
    ru, rs = rx * ux + ry * uy + rz * uz, rx * sx + ry * sy + rz * sz
    size = math.sqrt(max((1 - eu * eu) * (1 - ru * ru), 1e-24))
    both, square = (ex * rx + ey * ry + ez * rz - eu * ru) / size, sx * sx + sy * sy + sz * sz
    return (0.5 * both if square < 1e-12 else es * rs / (square * size)), both


@core(fastmath=True, error_model="numpy")
def _corners(
    leaves: Floats, k: int, normals: Floats, face: int, antennas: Antennas, o: int, scratch: CornerScratch
) -> tuple[float, float, float, float]:
    """Gain over ranges, cos(incidence) and path length at the corners of a piece go to `scratch`.

    Args:
        leaves: (m, 3, 3) pieces [m].
        k: which of them.
        normals: (f, 3) unit normals of the triangles.
        face: triangle of the piece.
        antennas: `Antennas`.
        o: radar that sees the piece.
        scratch: `CornerScratch`.

    Returns:
        How far the chord lies beyond the curved path on average [m], the area [m^2], and the products of
        both fields as of `te_share`.
    """
    base, cosine, tau = scratch.base, scratch.cosine, scratch.path
    mono = same(antennas, o)
    nx, ny, nz = normals[face, 0], normals[face, 1], normals[face, 2]
    bulge, share, both, samples = 0.0, 0.0, 0.0, 1 if alike(antennas.fields, o) else 3
    weight = (1.0 if mono else 0.5) / samples
    for i in range(3):
        j = (i + 1) % 3
        ex, ey, ez = (
            leaves[k, j, 0] - leaves[k, i, 0],
            leaves[k, j, 1] - leaves[k, i, 1],
            leaves[k, j, 2] - leaves[k, i, 2],
        )
        base[i], cosine[i], tau[i] = 1.0, 0.0, 0.0
        for s in range(1 if mono else 2):
            r, ux, uy, uz, gain = sight(antennas, o, s, leaves[k, i, 0], leaves[k, i, 1], leaves[k, i, 2])
            if i < samples:
                te, whole = te_share(antennas.fields, o, ux, uy, uz, nx, ny, nz)
                share, both = share + te * weight, both + whole * weight
            along = ex * ux + ey * uy + ez * uz
            c = nx * ux + ny * uy + nz * uz
            far, c = lifted(r, c)
            curve = (ex * ex + ey * ey + ez * ez - along * along) / far
            twice = 2 if mono else 1
            gain *= 1 / far  # no division of complex numbers
            base[i] *= gain * gain if mono else gain
            if s == 1 and cosine[i] * c <= 0:
                base[i] = 0.0
            cosine[i] += 0.5 * twice * c
            tau[i] += twice * r
            bulge += twice * curve
        cosine[i] = abs(cosine[i])
    ax, ay, az = leaves[k, 1, 0] - leaves[k, 0, 0], leaves[k, 1, 1] - leaves[k, 0, 1], leaves[k, 1, 2] - leaves[k, 0, 2]
    bx, by, bz = leaves[k, 2, 0] - leaves[k, 0, 0], leaves[k, 2, 1] - leaves[k, 0, 1], leaves[k, 2, 2] - leaves[k, 0, 2]
    area = 0.5 * math.sqrt((ay * bz - az * by) ** 2 + (az * bx - ax * bz) ** 2 + (ax * by - ay * bx) ** 2)
    # the chord lies beyond the curved path by sum(lambda_i lambda_j curve_ij / 2), whose mean is sum / 24
    return bulge / 24, area, share, both


@lean(fastmath=True, error_model="numpy")
def accumulate(
    pieces: TrianglePieces,
    lit: LitFaces,
    between: Transmission,
    pulse: PulseGrid,
    sums: EchoSums,
    scratch: CornerScratch,
) -> None:
    """Add the echo of every piece of a triangle to the delay grids.

    Args:
        pieces: `TrianglePieces` (m).
        lit: `LitFaces`, the triangles.
        between: `Transmission` (m).
        pulse: `PulseGrid`.
        sums: `EchoSums` (m), written.
        scratch: `CornerScratch`.
    """
    x, places, base, cosine, tau, w = scratch
    gamma, lag = lit.reflection
    grids, omega, t0, dt, fold = sums.grids, pulse.omega, pulse.start_s, pulse.step_s, pulse.fold_s
    last = t0 + grids.shape[1] * dt
    for k in range(len(pieces.corners)):
        sums.echo[k], sums.delay_s[k] = 0j, 0.0
        if between.factor[k] == 0:
            continue
        face, o = pieces.triangle[k], pieces.radar[k]
        material = lit.materials[face]
        early, area, share, both = _corners(pieces.corners, k, lit.normals, face, lit.antennas, o, scratch)
        scale = 1j * area / (4 * math.pi) * between.factor[k] * lit.antennas.factor[o]
        for tap in range(gamma.shape[1]):
            if lag[material, tap, 0] < 0:
                break
            late = between.delay_s[k] + _late(lag, material, tap, (cosine[0] + cosine[1] + cosine[2]) / 3)
            mean = (tau[0] + tau[1] + tau[2] - 3 * early) / (3 * C0) + late
            if tap == 0:
                sums.delay_s[k] = mean
            landed = mean - math.floor((mean - t0) / fold) * fold
            for i in range(3):
                w[i] = base[i] * cosine[i] * _reflection(gamma, material, tap, cosine[i], share, both)
            while landed < last:
                for i in range(3):
                    t = (tau[i] - early) / C0 + late + landed - mean
                    x[i] = omega * t
                    places[i] = (t - t0) / dt
                value = accumulate_triangle(grids, w, x, places, scale)
                sums.echo[k] += value if landed < t0 + fold else 0j  # what lands a pulse later is the same echo
                landed += fold
