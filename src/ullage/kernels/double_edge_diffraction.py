"""Loops for waves that cross a face from edge to edge, there and back, by uniform diffraction."""

from __future__ import annotations

import math
from typing import NamedTuple

from ullage.arrays import Bools, Floats, Ints
from ullage.kernels.facets import FROM, ONE, TO, Antennas, EchoSums, PulseGrid, Transmission, same, toward, turned
from ullage.kernels.loops import core, lean
from ullage.kernels.near import spread
from ullage.kernels.outlines import accumulate_line

C0 = 299_792_458.0


class EdgePairs(NamedTuple):
    """Pairs (p) of parallel edges of one face each."""

    gaps: Floats  # (p, 3) from the first edge to the second [m]
    angles: Floats  # (p, 2) of the free space about both edges, over pi
    inward: Floats  # (p, 2, 3) unit vectors from each edge into the face
    normals: Floats  # (p, 3) unit normals of the face
    transmissive: Bools  # (p) whether the wave runs over both sides


class PairPieces(NamedTuple):
    """Pieces (m) of the first edges of pairs."""

    ends: Floats  # (m, 2, 3) both ends of each piece [m]
    pair: Ints  # (m) pair of each piece


@lean(fastmath=True, nogil=True, error_model="numpy")
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
    return 2j * s * turned(-x) * tail


@core(fastmath=True, nogil=True, error_model="numpy")
def _graze(p, w, side, pairs, width, wave, antennas, out):  # type: ignore[no-untyped-def]
    """Diffraction by one edge of a pair along the face, with antenna gains over ranges.

    Row `side` of `out` gets the magnetic field along the edge for both antennas, and the path length [m].
    """
    inward, normals, origins, fields = pairs.inward, pairs.normals, antennas.origins, antennas.fields
    ux, uy, uz, g, path = 0.0, 0.0, 0.0, 1.0, 0.0
    nx, ny, nz = normals[w, 0], normals[w, 1], normals[w, 2]
    ix, iy, iz = inward[w, side, 0], inward[w, side, 1], inward[w, side, 2]
    tx, ty, tz = iy * nz - iz * ny, iz * nx - ix * nz, ix * ny - iy * nx
    for s in range(2):
        dx, dy, dz = p[0] - origins[0, s, 0], p[1] - origins[0, s, 1], p[2] - origins[0, s, 2]
        r = max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
        dx, dy, dz = dx / r, dy / r, dz / r
        one = math.sqrt(
            max(toward(antennas.table, antennas.isotropic, antennas.frames, ONE, s, dx, dy, dz), 0.0) * spread(wave, r)
        )
        g *= one
        path += 0.5 * r
        ux, uy, uz = ux + dx, uy + dy, uz + dz
        if s == 0 and same(origins, ONE):
            g *= one
            path += 0.5 * r
            break
    size = max(math.sqrt(ux * ux + uy * uy + uz * uz), 1e-6)
    ux, uy, uz = ux / size, uy / size, uz / size
    for s in range(2):
        ex, ey, ez = fields[0, s, 0], fields[0, s, 1], fields[0, s, 2]
        along = ex * ux + ey * uy + ez * uz
        square = max(ex * ex + ey * ey + ez * ez - along * along, 1e-12)
        hz = (uy * ez - uz * ey) * tx + (uz * ex - ux * ez) * ty + (ux * ey - uy * ex) * tz
        out[side, s] = hz / math.sqrt(square)
    out[side, 2] = path
    sx = -(ux * ix + uy * iy + uz * iz)
    sy = -(ux * nx + uy * ny + uz * nz)
    phi = math.atan2(sy, sx)
    if phi < 0:
        phi += 2 * math.pi
    n = pairs.angles[w, side]
    if phi >= n * math.pi:
        return 0j
    half = math.cos(0.5 * phi)
    if abs(half) < 1e-4:
        half = 1e-4
        phi = math.pi - 2e-4
    d = 2 * math.sin(math.pi / n) / (n * (math.cos(math.pi / n) - math.cos(phi / n)))
    return g * d * transition(2 * wave * width * half * half)


@core(fastmath=True, nogil=True, error_model="numpy")
def _twice(pieces, k, end, pairs, width, wave, antennas, out):  # type: ignore[no-untyped-def]
    """Strength per length of the wave that crosses the face from edge to edge, and path length [m]."""
    product, w = 1.0 + 0j, pieces.pair[k]
    for side in range(2):
        for j in range(3):
            out[2, j] = pieces.ends[k, end, j] + (pairs.gaps[w, j] if side == 1 else 0.0)
        product *= _graze(out[2], w, side, pairs, width, wave, antennas, out)
    # the second edge runs the other way in its own face's frame
    both = -0.5 * (out[0, 0] * out[1, 1] + out[0, 1] * out[1, 0])
    path = out[0, 2] + out[1, 2]
    spread = 1 / math.sqrt(2 * math.pi * wave * width * (1 + width / path))
    faces = 2.0 if pairs.transmissive[w] else 1.0
    value = -faces * both * spread * product * complex(math.sqrt(0.5), -math.sqrt(0.5))
    return value, path + width


@lean(by_fields=True, fastmath=True, nogil=True, error_model="numpy")
def accumulate_doubles(  # type: ignore[no-untyped-def]
    pieces: PairPieces,
    pairs: EdgePairs,
    between: Transmission,
    antennas: Antennas,
    pulse: PulseGrid,
    sums: EchoSums,
    rows,
):
    """Add the echoes of waves that cross a face between two parallel edges, there and back, to the delay grids.

    Args:
        pieces: `PairPieces` (m).
        pairs: `EdgePairs` (p).
        between: `facets.Transmission` (m).
        antennas: `facets.Antennas` of one radar.
        pulse: `facets.PulseGrid`.
        sums: `facets.EchoSums` (m), written.
        rows: (3, 3), scratch.
    """
    omega, start, step, fold = pulse.omega, pulse.start_s, pulse.step_s, pulse.fold_s
    wave = omega / C0
    scale = antennas.factor[0] / (4 * math.pi * wave)
    last = start + sums.grids.shape[1] * step
    for k in range(len(pieces.ends)):
        sums.echo[k], sums.delay_s[k] = 0j, 0.0
        if between.factor[k] == 0:
            continue
        w, size, width = pieces.pair[k], 0.0, 0.0
        for j in range(3):
            size += (pieces.ends[k, 1, j] - pieces.ends[k, 0, j]) ** 2
            width += pairs.gaps[w, j] * pairs.gaps[w, j]
        size, width = math.sqrt(size), math.sqrt(width)
        w0, path0 = _twice(pieces, k, FROM, pairs, width, wave, antennas, rows)
        w1, path1 = _twice(pieces, k, TO, pairs, width, wave, antennas, rows)
        w0, w1 = w0 * scale * size * between.factor[k], w1 * scale * size * between.factor[k]
        early = size * size / 12 * 4 / max(path0 + path1 - 2 * width, 0.02)
        late = between.delay_s[k] - early / C0
        mean = 0.5 * (path0 + path1) / C0 + late
        sums.delay_s[k] = mean
        landed = mean - math.floor((mean - start) / fold) * fold
        shift = late + landed - mean
        while landed < last:
            a, b = path0 / C0 + shift, path1 / C0 + shift
            value = accumulate_line(sums.grids, w0, w1, omega * a, omega * b, 1.5 * omega * early / C0,
                                    (a - start) / step, (b - start) / step)  # fmt: skip
            sums.echo[k] += value if landed < start + fold else 0j  # what lands a pulse later is the same echo
            landed += fold
            shift += fold
