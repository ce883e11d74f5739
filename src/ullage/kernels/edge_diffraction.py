"""Loops of the physical theory of diffraction: what straight edges of conductors add to physical optics.

The currents that the exact solution of an endless wedge has beyond physical optics are integrated from the edge along
both faces, in the direction in which the diffracted wave runs along them; that gives each length of edge a strength
at every aspect [Michaeli1986], [Ufimtsev2007]. Only straight back, at the bisector of transmitter and receiver.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ullage.arrays import Bools, Floats, Ints, Longs
from ullage.kernels.facets import (
    FROM,
    ONE,
    TO,
    VERTEX,
    Antennas,
    EchoSums,
    PulseGrid,
    Transmission,
    alike,
    same,
    sight,
    toward,
)
from ullage.kernels.loops import core, lean
from ullage.kernels.near import spread
from ullage.kernels.outlines import LineEcho, accumulate_pulses
from ullage.kernels.vectors import dot, fields_across, unit_to

C0 = 299_792_458.0


class Wedges(NamedTuple):
    """Straight edges (w) of conductors between two faces each."""

    angles: Floats  # (w) of the free space about each edge, over pi
    inward: Floats  # (w, 2, 3) unit vectors in both faces, away from the edge
    normals: Floats  # (w, 2, 3) unit normals of both faces, into the free space
    transmissive: Bools  # (w) whether it is the edge of a thin body, whose first face is the wide one


class EdgePieces(NamedTuple):
    """Pieces (m) of edges, and ends (n) of edges."""

    pieces: Floats  # (m, 2, 3) both ends of each piece [m]
    tips: Floats  # (n, 2, 3) place of each end [m]; real and imaginary value, as `lines.part` gives it
    owner: Ints  # (m + n) edge of each piece, then of each end


class EdgeLines(NamedTuple):
    """Edges (w) as straight lines."""

    starts: Floats  # (w, 3) [m]
    ends: Floats  # (w, 3) [m]
    lit: Bools  # (w) which of them can return anything
    factors: Floats  # (w) strength over that of an edge by itself, at most


@core(fastmath=True, error_model="numpy")
def excess(open_angle: float, phi: float, mu: float, out: Floats) -> None:
    """Fringe current of one face of a wedge, integrated from the edge: along it (soft) and across it (hard).

    Args:
        open_angle: of the free space, over pi (2 for a thin sheet, 1.5 for the edge of a box).
        phi: angle from the face to where the wave comes from [rad].
        mu: rate of phase along the face towards the receiver, over that of the wave across the edge; at most 1.
        out: (2) gets soft, hard.
    """
    n = open_angle
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
    out[0], out[1] = math.sin(phi / n) / (n * gap), ratio / (n * gap)
    if phi < math.pi:  # on the lit side physical optics has its share
        plain = math.cos(phi) + mu
        out[0], out[1] = out[0] - math.sin(phi) / plain, out[1] - 1 / plain


@lean(fastmath=True, error_model="numpy")
def edge_diffraction(open_angle: float, phi: float, mu: float, out: Floats) -> None:
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


@lean(fastmath=True, error_model="numpy")
def face_currents(
    open_angle: float, phi: float, along: float, across: float, cosine: float, back: float, out: Floats
) -> None:
    """Fringe currents of one face for a wave from any direction, towards any receiver, times the wave number.

    Args:
        open_angle: of the free space, over pi.
        phi: angle from the face to where the wave comes from [rad].
        along: electric field of the wave along the edge; across: its magnetic field along the edge.
        cosine: of the angle between the direction of travel and the edge.
        back: 1 plus the cosine between the strip of current along the face and the way from the receiver.
        out: (2) gets the currents along the edge and across it [Michaeli1986].
    """
    sine2 = max(1 - cosine * cosine, 1e-6)
    mu = min(1 - back / sine2, 1 - 2e-6)
    edge_diffraction(open_angle, phi, mu, out)
    lit = 1.0 if phi < math.pi else 0.0
    out[0] = (along * out[0] + cosine * across * (lit - 1 / open_angle + mu * out[1])) / sine2
    out[1] = across * out[1] / math.sqrt(sine2)


@lean(fastmath=True, error_model="numpy")
def face(
    open_angle: float, inward: Floats, normals: Floats, w: int, i: int, sign: float, rows: Floats, out: Floats
) -> float:
    """One face's share of an edge's strength straight back, times the wave number.

    Args:
        open_angle: of the free space, over pi.
        inward: (w, 2, 3) unit vectors in the faces, away from the edge.
        normals: (w, 2, 3) unit normals of the faces, into the free space.
        w, i: edge and face; sign: -1 for the back of the face.
        rows: (3, 3) unit direction of travel, and transmitted and received unit fields across it.
        out: (2) scratch.
    """
    ix, iy, iz = inward[w, i, 0], inward[w, i, 1], inward[w, i, 2]
    nx, ny, nz = sign * normals[w, i, 0], sign * normals[w, i, 1], sign * normals[w, i, 2]
    tx, ty, tz = iy * nz - iz * ny, iz * nx - ix * nz, ix * ny - iy * nx
    ux, uy, uz, ex, ey, ez = rows[0, 0], rows[0, 1], rows[0, 2], rows[1, 0], rows[1, 1], rows[1, 2]
    cosine = ux * tx + uy * ty + uz * tz
    sx = -(ux * ix + uy * iy + uz * iz)
    sy = -(ux * nx + uy * ny + uz * nz)
    sine2 = sx * sx + sy * sy
    if sine2 < 1e-3:
        return 0.0
    phi = math.atan2(sy, sx)
    if phi < 0:
        phi += 2 * math.pi
    if phi >= open_angle * math.pi:
        return 0.0
    hz = (uy * ez - uz * ey) * tx + (uz * ex - ux * ez) * ty + (ux * ey - uy * ex) * tz
    back = 1 + cosine * cosine - math.sqrt(sine2) * sx
    face_currents(open_angle, phi, ex * tx + ey * ty + ez * tz, hz, cosine, back, out)
    seen_along = rows[2, 0] * tx + rows[2, 1] * ty + rows[2, 2] * tz
    seen_across = rows[2, 0] * ix + rows[2, 1] * iy + rows[2, 2] * iz
    return seen_along * out[0] + seen_across * out[1]


@core(fastmath=True, error_model="numpy")
def strength(
    places: Floats, k: int, end: int, w: int, wedges: Wedges, wave: float, antennas: Antennas, rows: Floats
) -> tuple[complex, float, float]:
    """Antenna gains over ranges times the strength of edge w at places[k, end].

    The length of the path there [m] and its bend along the edge [1/m] follow.
    """
    g, path, bend = 1.0 + 0j, 0.0, 0.0
    inward, normals, transmissive = wedges.inward, wedges.normals, wedges.transmissive
    fields = antennas.fields
    ix, iy, iz = inward[w, 0, 0], inward[w, 0, 1], inward[w, 0, 2]
    nx, ny, nz = normals[w, 0, 0], normals[w, 0, 1], normals[w, 0, 2]
    tx, ty, tz = iy * nz - iz * ny, iz * nx - ix * nz, ix * ny - iy * nx
    rows[0, 0] = rows[0, 1] = rows[0, 2] = 0.0
    for s in range(2):
        r, dx, dy, dz, one = sight(antennas, ONE, s, places[k, end, 0], places[k, end, 1], places[k, end, 2])
        one *= spread(wave, r)
        along = tx * dx + ty * dy + tz * dz
        g, path, bend = g * one, path + r, bend + (1 - along * along) / r
        rows[0, 0], rows[0, 1], rows[0, 2] = rows[0, 0] + dx, rows[0, 1] + dy, rows[0, 2] + dz
        if s == 0 and same(antennas, ONE):
            g, path, bend = g * one, 2 * path, 2 * bend
            break
    if not fields_across(fields[0], rows):
        return 0j, path, bend
    # the rim of a thin body: only its wide face, from the side it looks to, front and back
    if transmissive[w] and rows[0, 0] * nx + rows[0, 1] * ny + rows[0, 2] * nz >= 0:
        return 0j, path, bend
    total, orders = 0.0, 1 if alike(fields, ONE) else 2
    for order in range(orders):
        for i in range(2):
            side, sign = (0, 1.0 - 2.0 * i) if transmissive[w] else (i, 1.0)
            total += face(2.0 if transmissive[w] else wedges.angles[w], inward, normals, w, side, sign, rows, rows[3])
        if order < orders - 1:  # straight back the echo is that of exchanged antennas: the mean of both
            for j in range(3):
                rows[1, j], rows[2, j] = rows[2, j], rows[1, j]
    return g * total / orders, path, bend


@core(fastmath=True, error_model="numpy", forceinline=True)
def _best_seen(
    start: Floats, near: float, size: float, t: Floats, across: bool, antennas: Antennas
) -> tuple[float, float]:
    """Largest two-way gain, and largest field across an edge, at both ends of it and `near` along it [m]."""
    origins, fields = antennas.origins, antennas.fields
    ex, ey, ez = fields[0, 0, 0], fields[0, 0, 1], fields[0, 0, 2]
    gain, most = 0.0, 0.0
    for step in range(3):
        along = near if step == 0 else (0.0 if step == 1 else size)
        x, y, z = (start[0] + along * t[0] - origins[0, 0, 0], start[1] + along * t[1] - origins[0, 0, 1],
                   start[2] + along * t[2] - origins[0, 0, 2])  # fmt: skip
        r = max(math.sqrt(x * x + y * y + z * z), 1e-2)
        if across:
            hard = (y * ez - z * ey) * t[0] + (z * ex - x * ez) * t[1] + (x * ey - y * ex) * t[2]
            most = max(most, abs(hard) / r)
        one = toward(antennas.table, antennas.isotropic, antennas.frames, ONE, FROM, x / r, y / r, z / r)
        other = one
        if len(antennas.table) > 1:
            other = toward(antennas.table, antennas.isotropic, antennas.frames, ONE, TO, x / r, y / r, z / r)
        gain = max(gain, abs(one * other))
    return gain, most


@lean(fastmath=True, error_model="numpy")
def audible(
    edges: EdgeLines, across: bool, antennas: Antennas, wave: float, gate: Floats, least: float, t: Floats, out: Longs
) -> int:
    """Find the edges that can return more than `least`, by the most that their strength and length allow.

    Args:
        edges: `EdgeLines` (w).
        across: whether only the electric field across the edge counts.
        antennas: `facets.Antennas` of one radar.
        wave: wave number [1/m].
        gate: (2) least and greatest range [m].
        least: path gain amplitude.
        t: (3), scratch.
        out: (w) gets their rows.

    Returns:
        How many there are.
    """
    count = 0
    starts, ends, origins, fields = edges.starts, edges.ends, antennas.origins, antennas.fields
    ex, ey, ez = fields[0, 0, 0], fields[0, 0, 1], fields[0, 0, 2]
    for w in range(len(starts)):
        if not edges.lit[w]:
            continue
        size = max(unit_to(starts[w], ends[w], t), 1e-9)
        foot = dot(origins[0, 0], t) - dot(starts[w], t)
        near = min(max(foot, 0.0), size)
        square = 0.0
        for k in range(3):
            square += (starts[w, k] + near * t[k] - origins[0, 0, k]) ** 2
        if square > gate[1] * gate[1]:
            continue
        best = max(math.sqrt(square), 1e-2)
        gain, most = _best_seen(starts[w], near, size, t, across, antennas)
        reach = math.sqrt(math.pi * best / wave)  # of the stationary part
        beside = abs(foot - near)
        if beside > 0:
            reach = min(reach, best / (wave * beside))
        strong = gain / (best * best) * min(size, reach) / (4 * math.pi * wave)
        if across:
            x, y, z = starts[w, 0] - origins[0, 0, 0], starts[w, 1] - origins[0, 0, 1], starts[w, 2] - origins[0, 0, 2]
            along = ex * x + ey * y + ez * z
            along *= along / max(x * x + y * y + z * z, 1e-9)
            strong *= most * most / max(1 - along, 0.05)
        if 1.5 * edges.factors[w] * strong > least:
            out[count] = w
            count += 1
    return count


@lean(fastmath=True, error_model="numpy")
def accumulate_edge_diffraction(
    edges: EdgePieces,
    wedges: Wedges,
    between: Transmission,
    antennas: Antennas,
    pulse: PulseGrid,
    sums: EchoSums,
    rows: Floats,
) -> None:
    """Add the echoes of pieces of edges, and of ends of edges, to the delay grids.

    Args:
        edges: `EdgePieces` (m + n).
        wedges: `Wedges` (w).
        between: `facets.Transmission` (m + n).
        antennas: `facets.Antennas` of one radar.
        pulse: `facets.PulseGrid`.
        sums: `facets.EchoSums` (m + n), written.
        rows: (4, 3), scratch.
    """
    pieces, tips, owner, omega = edges.pieces, edges.tips, edges.owner, pulse.omega
    many, wave = len(pieces), omega / C0
    known, w0, path0, bend0 = -2, 0j, 0.0, 0.0
    for k in range(len(owner)):
        sums.echo[k], sums.delay_s[k] = 0j, 0.0
        if between.factor[k] == 0:
            continue
        w, size, early = owner[k], 1.0, 0.0
        scale = antennas.factor[0] / (4 * math.pi * wave) * between.factor[k]
        w1, path1, bend1 = w0, path0, bend0
        if k < many:
            square = 0.0
            follows = known == k - 1 and k > 0 and owner[known] == w
            for j in range(3):
                square += (pieces[k, 1, j] - pieces[k, 0, j]) ** 2
                follows = follows and pieces[known, 0, j] == pieces[k, 1, j]
            size, known = math.sqrt(square), k
            if not follows:  # pieces of an edge come one after the other, from its end
                w1, path1, bend1 = strength(pieces, k, TO, w, wedges, wave, antennas, rows)
            w0, path0, bend0 = strength(pieces, k, FROM, w, wedges, wave, antennas, rows)
            # as for wires: what the chord lies beyond the path
            early = min(0.5 * (bend0 + bend1) * size / 12, 0.5) * size
            scale *= size
        else:
            w0, path0, bend0 = strength(tips, k - many, FROM, w, wedges, wave, antennas, rows)
            w1, path1 = w0, path0
            scale *= complex(tips[k - many, 1, 0], tips[k - many, 1, 1])
        if w0 == 0 and w1 == 0:
            continue
        late = between.delay_s[k] - early / C0
        mean = 0.5 * (path0 + path1) / C0 + late
        sums.delay_s[k] = mean
        line = LineEcho(scale * w0, scale * w1, path0 / C0, path1 / C0, 1.5 * omega * early / C0)
        sums.echo[k] = accumulate_pulses(sums.grids, pulse, k < many, VERTEX, line, late, mean)
