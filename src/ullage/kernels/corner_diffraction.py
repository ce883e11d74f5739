"""Loops for waves that two edges diffract one after the other where they meet at a corner of a face.

The first edge sends a wave along the face in the direction of Keller's cone. Near the corner it meets the second edge,
whose fringe currents return it to the radar. Both diffractions are of first order: the wave of the first edge is
Keller's with the transition function of the uniform theory [Keller1962], [KouyoumjianPathak1974], and the currents at
the second are those of the physical theory of diffraction for a wave that grazes the face [Michaeli1986].
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ullage.arrays import Bools, Floats, Longs
from ullage.kernels.double_edge_diffraction import along_sheet
from ullage.kernels.facets import ONE, VERTEX, Antennas, EchoSums, PulseGrid, Transmission, toward
from ullage.kernels.facets import turned as phasor
from ullage.kernels.loops import core, lean
from ullage.kernels.near import spread
from ullage.kernels.outlines import LineEcho, accumulate_pulses

C0 = 299_792_458.0
_PARTS = 6  # of the second edge, finer towards the corner
TRAVEL, SENT, RECEIVED, WAVE, INWARD, ALONG, SCRATCH, RATIOS = range(8)
"""Rows of scratch."""


class Corners(NamedTuple):
    """Corners (c) of sheets, at each of which two edges meet."""

    places: Floats  # (c, 3) [m]
    along: Floats  # (c, 2, 3) unit vectors from the corner along both edges
    lengths: Floats  # (c, 2) of both [m]
    normals: Floats  # (c, 3) unit normals of the sheet
    bare: Bools  # (c) whether a wave from behind meets it too


class Order(NamedTuple):
    """Wave from one edge of a corner across the sheet to the other, and what it makes there."""

    corner: int
    first: int  # edge that sends it
    strength: complex
    bend: float  # phase of the way across the sheet per length of the second edge [rad/m]
    before: float  # distance of the crossing's start before the corner, over that of its end behind it
    across: float  # its length over that distance
    sine2: float  # square of the sine of the first edge's cone


@lean(fastmath=True, error_model="numpy")
def audible(corners: Corners, antennas: Antennas, wave: float, gate: Floats, least: float, out: Longs) -> int:
    """Find the corners that face the radar and can return more than `least`.

    Args:
        corners: `Corners` (c).
        antennas: `facets.Antennas` of one radar.
        wave: wave number [1/m].
        gate: (2) least and greatest range [m].
        least: path gain amplitude.
        out: (c) gets their rows.

    Returns:
        How many there are.
    """
    at, origins = 0, antennas.origins
    for c in range(len(corners.places)):
        far, level, above = 0.0, 4 / (4 * math.pi * wave * wave), 0.0
        for s in range(2):
            x, y, z = (corners.places[c, 0] - origins[0, s, 0], corners.places[c, 1] - origins[0, s, 1],
                       corners.places[c, 2] - origins[0, s, 2])  # fmt: skip
            r = max(math.sqrt(x * x + y * y + z * z), 1e-2)
            far += 0.5 * r
            above -= x * corners.normals[c, 0] + y * corners.normals[c, 1] + z * corners.normals[c, 2]
            level *= toward(antennas.table, antennas.isotropic, antennas.frames, ONE, s, x / r, y / r, z / r) / r
        if gate[0] <= far <= gate[1] and level > least and (above > 0 or corners.bare[c]):
            out[at] = c
            at += 1
    return at


@core(fastmath=True, error_model="numpy")
def _seen(place: Floats, antennas: Antennas, wave: float, rows: Floats) -> float:
    """Antenna gains over ranges at a place; rows get the direction of travel and both fields across it."""
    g, origins = 1.0, antennas.origins
    for j in range(3):
        rows[TRAVEL, j] = 0.0
    for s in range(2):
        x, y, z = place[0] - origins[0, s, 0], place[1] - origins[0, s, 1], place[2] - origins[0, s, 2]
        r = max(math.sqrt(x * x + y * y + z * z), 1e-9)
        x, y, z = x / r, y / r, z / r
        g *= toward(antennas.table, antennas.isotropic, antennas.frames, ONE, s, x, y, z) * spread(wave, r)
        rows[TRAVEL, 0], rows[TRAVEL, 1], rows[TRAVEL, 2] = (
            rows[TRAVEL, 0] + x, rows[TRAVEL, 1] + y, rows[TRAVEL, 2] + z)  # fmt: skip
    size = math.sqrt(rows[TRAVEL, 0] ** 2 + rows[TRAVEL, 1] ** 2 + rows[TRAVEL, 2] ** 2)
    for j in range(3):
        rows[TRAVEL, j] /= max(size, 1e-6)
    for s in range(2):
        along, square = 0.0, 0.0
        for j in range(3):
            along += antennas.fields[0, s, j] * rows[TRAVEL, j]
        for j in range(3):
            rows[SENT + s, j] = antennas.fields[0, s, j] - along * rows[TRAVEL, j]
            square += rows[SENT + s, j] ** 2
        for j in range(3):
            rows[SENT + s, j] /= math.sqrt(max(square, 1e-12))
    return g


@core(fastmath=True, error_model="numpy", forceinline=True)
def _dot(a: Floats, b: Floats) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@core(fastmath=True, error_model="numpy", forceinline=True)
def _cross(a: Floats, b: Floats, out: Floats) -> None:
    out[0], out[1], out[2] = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@core(fastmath=True, error_model="numpy", forceinline=True)
def _frame(corners: Corners, c: int, edge: int, rows: Floats) -> None:
    """Rows `INWARD` and `ALONG` get the unit vectors from an edge into its sheet, and along it."""
    along, other = corners.along[c, edge], corners.along[c, 1 - edge]
    share = _dot(along, other)
    size = math.sqrt(max(1 - share * share, 1e-12))
    for j in range(3):
        rows[INWARD, j] = (other[j] - share * along[j]) / size
    _cross(rows[INWARD], corners.normals[c], rows[ALONG])


@core(fastmath=True, error_model="numpy")
def _first(corners: Corners, c: int, edge: int, field: int, rows: Floats) -> tuple[float, float, float]:
    """Magnetic field along an edge, sine of the cone's half angle, and cosine of half the angle of incidence.

    Row `WAVE` gets the unit direction in which the diffracted wave runs along the sheet.
    """
    _frame(corners, c, edge, rows)
    _cross(rows[TRAVEL], rows[SENT + field], rows[SCRATCH])
    magnetic, cosine = _dot(rows[SCRATCH], rows[ALONG]), _dot(rows[TRAVEL], rows[ALONG])
    sine = math.sqrt(max(1 - cosine * cosine, 1e-6))
    for j in range(3):
        rows[WAVE, j] = sine * rows[INWARD, j] + cosine * rows[ALONG, j]
    phi = math.atan2(-_dot(rows[TRAVEL], corners.normals[c]), -_dot(rows[TRAVEL], rows[INWARD]))
    return magnetic, sine, math.cos(0.5 * (phi + 2 * math.pi if phi < 0 else phi))


@core(fastmath=True, error_model="numpy")
def _second(corners: Corners, c: int, edge: int, field: int, rows: Floats) -> float:
    """Strength of an edge for a unit current along the sheet in the direction of row `WAVE` [Michaeli1986]."""
    _frame(corners, c, edge, rows)
    cosine = _dot(rows[WAVE], rows[ALONG])
    sine2 = max(1 - cosine * cosine, 1e-6)
    sine = math.sqrt(sine2)
    back = sine * _dot(rows[TRAVEL], rows[INWARD]) + cosine * _dot(rows[TRAVEL], rows[ALONG])
    half = math.sqrt(max(0.5 * (1 + back) / sine2, 1e-6))  # cosine of half Michaeli's angle
    fringe = 1 / (2 * half * (1 + half))
    seen = rows[RECEIVED - field]
    # the magnetic field along the edge is that of a wave that meets it: one that runs away fades in `_lit_share`
    along = cosine * (1 + (1 - 2 * half * half) * fringe) / sine
    return -(_dot(seen, rows[ALONG]) * along + _dot(seen, rows[INWARD]) * fringe)


@core(fastmath=True, error_model="numpy")
def _path(corners: Corners, c: int, one: int, before: float, behind: float, origins: Floats) -> float:
    """Ranges of edge `one` at a distance before the corner and of the other behind it, mean of both antennas [m]."""
    total = 0.0
    for s in range(2):
        near, far = 0.0, 0.0
        for j in range(3):
            near += (corners.places[c, j] + before * corners.along[c, one, j] - origins[0, s, j]) ** 2
            far += (corners.places[c, j] + behind * corners.along[c, 1 - one, j] - origins[0, s, j]) ** 2
        total += 0.5 * (math.sqrt(near) + math.sqrt(far))
    return total


@core(fastmath=True, error_model="numpy")
def _route(corners: Corners, c: int, one: int, rows: Floats, out: Floats) -> bool:
    """Follow the wave of edge `one` to the other; whether it gets there.

    `out` gets the distances before the corner and across the sheet, over that behind the corner.
    """
    along, other = corners.along[c, one], corners.along[c, 1 - one]
    _frame(corners, c, 1 - one, rows)
    down, rise = -_dot(rows[WAVE], rows[INWARD]), _dot(along, rows[INWARD])
    bottom = _dot(along, other) * down / rise + _dot(rows[WAVE], other)
    if bottom <= 1e-3:
        return False
    out[0], out[1] = down / (rise * bottom), 1 / bottom
    return out[1] > 0


@core(fastmath=True, error_model="numpy")
def _lit_share(before: float, x: float) -> complex:
    """Share of a wave that the first edge sends to a place, as far as the edge goes: Fresnel's integral from its end.

    Args:
        before: distance of the stationary point before the end of the edge, over that of the place behind it.
        x: phase by which the path from the end is longer than the stationary path, to second order [rad].
    """
    beyond = 0.5 * phasor(x) * along_sheet(x)
    return 1 - beyond if before > 0 else beyond


@core(fastmath=True, error_model="numpy")
def _accumulate(
    corners: Corners, order: Order, late: float, antennas: Antennas, pulse: PulseGrid, sums: EchoSums, k: int
) -> None:
    """Add the echo of one order of both edges, in parts of the second that are finer towards the corner."""
    c, one, before, across = order.corner, order.first, order.before, order.across
    wave, size = pulse.omega / C0, corners.lengths[c, 1 - one]
    if before > 0:
        size = min(size, corners.lengths[c, one] / before)
    x0, path0, w0 = 0.0, _path(corners, c, one, 0.0, 0.0, antennas.origins), 0.5 * order.strength
    sums.delay_s[k] = path0 / C0 + late
    quadratic = 0.5 * wave * before * before * order.sine2 / across  # of the phase about the stationary point
    for i in range(_PARTS):
        x1 = size * ((i + 1) / _PARTS) ** 2
        path1 = _path(corners, c, one, before * x1, x1, antennas.origins) + across * x1
        w1 = order.strength * along_sheet(order.bend * x1) * _lit_share(before, quadratic * x1)
        mean = 0.5 * (path0 + path1) / C0 + late
        line = LineEcho(w0 * (x1 - x0), w1 * (x1 - x0), path0 / C0, path1 / C0, 0.0)
        sums.echo[k] += accumulate_pulses(sums.grids, pulse, True, VERTEX, line, late, mean)
        x0, path0, w0 = x1, path1, w1


@lean(fastmath=True, error_model="numpy")
def accumulate_corners(
    which: Longs,
    corners: Corners,
    between: Transmission,
    antennas: Antennas,
    pulse: PulseGrid,
    sums: EchoSums,
    rows: Floats,
) -> None:
    """Add the echoes of corners to the delay grids.

    Args:
        which: (m) corners to add.
        corners: `Corners` (c).
        between: `facets.Transmission` (m).
        antennas: `facets.Antennas` of one radar.
        pulse: `facets.PulseGrid`.
        sums: `facets.EchoSums` (m), written.
        rows: (8, 3), scratch.
    """
    wave = pulse.omega / C0
    for k in range(len(which)):
        sums.echo[k], sums.delay_s[k] = 0j, 0.0
        if between.factor[k] == 0:
            continue
        c = which[k]
        scale = antennas.factor[0] / (4 * math.pi * wave) * between.factor[k]
        scale *= _seen(corners.places[c], antennas, wave, rows)
        for one in range(2):
            value = 0.0
            for field in range(2):  # the same where both antennas are
                magnetic, sine, half = _first(corners, c, one, field, rows)
                if not _route(corners, c, one, rows, rows[RATIOS]):
                    break
                magnetic = magnetic if half < 0 else -magnetic
                value += 0.5 * magnetic / sine * _second(corners, c, 1 - one, field, rows)
            if value == 0:
                continue
            before, across = rows[RATIOS, 0], rows[RATIOS, 1]
            bend = 2 * wave * (sine * half) ** 2 * across
            order = Order(c, one, scale * value, bend, before, across, sine * sine)
            _accumulate(corners, order, between.delay_s[k], antennas, pulse, sums, k)
