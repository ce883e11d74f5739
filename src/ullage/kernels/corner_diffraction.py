"""Loops for waves that two edges diffract one after the other where they meet at a corner of a face.

The currents at the first edge run along the face in the direction of Keller's cone. Near the corner they meet the
second edge, whose fringe currents return them to the radar. The first currents are those of a sheet, by either
polarisation, scaled on a wedge to Keller's wave far away [Keller1962]. Those at the second edge are of the physical
theory of diffraction for a wave that grazes the face [Michaeli1986].
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ullage.arrays import Bools, Floats, Longs
from ullage.kernels.double_edge_diffraction import along_sheet, transition
from ullage.kernels.edge_diffraction import face_currents
from ullage.kernels.facets import ONE, VERTEX, Antennas, EchoSums, PulseGrid, Transmission, sight
from ullage.kernels.facets import turned as phasor
from ullage.kernels.loops import core, lean
from ullage.kernels.near import spread
from ullage.kernels.outlines import LineEcho, accumulate_pulses
from ullage.kernels.vectors import dot, fields_across

C0 = 299_792_458.0
_PARTS = 6  # of the second edge at least, finer towards the corner
TRAVEL, SENT, RECEIVED, WAVE, INWARD, ALONG, SCRATCH, RATIOS, CURRENTS = range(9)
"""Rows of scratch."""


class Corners(NamedTuple):
    """Corners (c) of faces, at each of which two edges meet."""

    places: Floats  # (c, 3) [m]
    along: Floats  # (c, 2, 3) unit vectors from the corner along both edges
    lengths: Floats  # (c, 2) of both [m]
    angles: Floats  # (c, 2) of the free space about both edges, over pi; 2 at those of thin bodies
    normals: Floats  # (c, 3) unit normals of the face
    bare: Bools  # (c) whether a wave from behind meets it too


class Order(NamedTuple):
    """Wave from one edge of a corner across the face to the other, and what it makes there."""

    corner: int
    first: int  # edge that sends it
    hard: complex  # strength by the magnetic field along the first edge
    soft: complex  # by the currents along that edge
    half: float  # cosine of half the angle of incidence, without its sign
    bend: float  # twice the phase across the first edge per length of the second [rad/m]
    before: float  # distance of the crossing's start before the corner, over that of its end behind it
    across: float  # its length over that distance
    sine2: float  # square of the sine of the first edge's cone


@lean(fastmath=True, error_model="numpy")
def audible(corners: Corners, antennas: Antennas, wave: float, gate: Floats, least: float, out: Longs) -> int:
    """Find the corners that the radar sees and that can return more than `least`.

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
    at, places = 0, corners.places
    for c in range(len(places)):
        far, level, above = 0.0, 4 / (4 * math.pi * wave * wave), 0.0
        for s in range(2):
            r, x, y, z, gain = sight(antennas, ONE, s, places[c, 0], places[c, 1], places[c, 2])
            far += 0.5 * r
            above -= r * (x * corners.normals[c, 0] + y * corners.normals[c, 1] + z * corners.normals[c, 2])
            level *= abs(gain) / max(r, 1e-2)
        if gate[0] <= far <= gate[1] and level > least and (above > 0 or corners.bare[c]):
            out[at] = c
            at += 1
    return at


@core(fastmath=True, error_model="numpy")
def _seen(place: Floats, antennas: Antennas, wave: float, rows: Floats) -> complex:
    """Antenna gains over ranges at a place; rows get the direction of travel and both fields across it."""
    g = 1.0 + 0j
    for j in range(3):
        rows[TRAVEL, j] = 0.0
    for s in range(2):
        r, x, y, z, gain = sight(antennas, ONE, s, place[0], place[1], place[2])
        g *= gain * spread(wave, r)
        rows[TRAVEL, 0], rows[TRAVEL, 1], rows[TRAVEL, 2] = (
            rows[TRAVEL, 0] + x, rows[TRAVEL, 1] + y, rows[TRAVEL, 2] + z)  # fmt: skip
    fields_across(antennas.fields[0], rows)
    return g


@core(fastmath=True, error_model="numpy", forceinline=True)
def _cross(a: Floats, b: Floats, out: Floats) -> None:
    out[0], out[1], out[2] = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@core(fastmath=True, error_model="numpy", forceinline=True)
def _frame(corners: Corners, c: int, edge: int, rows: Floats) -> None:
    """Rows `INWARD` and `ALONG` get the unit vectors from an edge into its face, and along it."""
    along, other = corners.along[c, edge], corners.along[c, 1 - edge]
    share = dot(along, other)
    size = math.sqrt(max(1 - share * share, 1e-12))
    for j in range(3):
        rows[INWARD, j] = (other[j] - share * along[j]) / size
    _cross(rows[INWARD], corners.normals[c], rows[ALONG])


@core(fastmath=True, error_model="numpy", forceinline=True)
def _incidence(corners: Corners, c: int, rows: Floats) -> float:
    """Angle from the face to where row `TRAVEL` comes from, about the edge of row `INWARD` [rad]."""
    phi = math.atan2(-dot(rows[TRAVEL], corners.normals[c]), -dot(rows[TRAVEL], rows[INWARD]))
    return phi + 2 * math.pi if phi < 0 else phi


@core(fastmath=True, error_model="numpy")
def _first(corners: Corners, c: int, edge: int, field: int, rows: Floats) -> tuple[float, float, float, float]:
    """Currents along the face by both polarisations, sine of the cone's half angle, cosine of half that of incidence.

    Row `WAVE` gets the unit direction in which they run. Near the edge those along it are larger than the wave that
    they become; only their part in that direction counts.
    """
    n = corners.angles[c, edge]
    _frame(corners, c, edge, rows)
    _cross(rows[TRAVEL], rows[SENT + field], rows[SCRATCH])
    magnetic, electric = dot(rows[SCRATCH], rows[ALONG]), dot(rows[SENT + field], rows[ALONG])
    cosine = dot(rows[TRAVEL], rows[ALONG])
    sine = math.sqrt(max(1 - cosine * cosine, 1e-6))
    for j in range(3):
        rows[WAVE, j] = sine * rows[INWARD, j] + cosine * rows[ALONG, j]
    phi = _incidence(corners, c, rows)
    half = math.cos(0.5 * phi)
    if abs(half) < 1e-4:
        half, phi = 1e-4, math.pi - 2e-4
    # Keller's coefficient over that of a sheet
    scale = 2 * math.sin(math.pi / n) * half / (n * (math.cos(phi / n) - math.cos(math.pi / n)))
    if min(corners.angles[c, 0], corners.angles[c, 1]) < 2 - 1e-6:  # else the wave runs over both sides
        magnetic, electric = 0.5 * magnetic, 0.5 * electric
    soft = scale * half * cosine * magnetic - scale * scale * math.sin(phi / n) / math.sin(math.pi / n) * electric
    hard = scale * magnetic if half > 0 else -scale * magnetic
    return hard / sine, 2 * cosine / sine * soft, sine, half


@core(fastmath=True, error_model="numpy")
def _second(corners: Corners, c: int, edge: int, field: int, wave: float, rows: Floats) -> complex:
    """Strength of an edge for a unit current along the face in the direction of row `WAVE` [Michaeli1986].

    Its own currents run as far as the edges are long, by the transition of uniform theory [KouyoumjianPathak1974].
    """
    _frame(corners, c, edge, rows)
    turn, total, facing = corners.angles[c, edge] * math.pi, 0.0, 0.0
    along, inward, seen = rows[ALONG], rows[INWARD], rows[RECEIVED - field]
    cosine = dot(rows[WAVE], along)
    sine = math.sqrt(max(1 - cosine * cosine, 1e-6))
    for side in range(2):  # this face, which the wave grazes, and the one beyond the edge
        sign = 1.0 - 2 * side
        for j in range(3):
            rows[SCRATCH, j] = inward[j]
            if side == 1:
                rows[SCRATCH, j] = math.cos(turn) * inward[j] + math.sin(turn) * corners.normals[c, j]
        back = 1 + sine * dot(rows[TRAVEL], rows[SCRATCH]) + cosine * dot(rows[TRAVEL], along)
        facing = back if side == 0 else facing
        face_currents(turn / math.pi, side * turn, 0.0, sign * sine, sign * cosine, back, rows[CURRENTS])
        total += sign * dot(seen, along) * rows[CURRENTS, 0] + dot(seen, rows[SCRATCH]) * rows[CURRENTS, 1]
    reach = max(abs(cosine) / corners.lengths[c, edge], sine / corners.lengths[c, 1 - edge])
    return total * transition(wave * max(facing, 0.0) / reach)


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
def _over_face(corners: Corners, c: int, edge: int, wave: float, rows: Floats) -> complex:
    """What passes over the face to an edge of a solid body and back, where the face hides it from a lower radar."""
    if corners.angles[c, edge] > 2 - 1e-6:
        return 1 + 0j
    _frame(corners, c, edge, rows)
    cosine, half = dot(rows[TRAVEL], rows[ALONG]), math.sin(0.5 * _incidence(corners, c, rows))
    across = corners.lengths[c, 1 - edge] * dot(corners.along[c, 1 - edge], rows[INWARD])
    return transition(2 * wave * across * (1 - cosine * cosine) * half * half)


@core(fastmath=True, error_model="numpy")
def _route(corners: Corners, c: int, one: int, rows: Floats, out: Floats) -> bool:
    """Follow the wave of edge `one` to the other; whether it gets there.

    `out` gets the distances before the corner and across the sheet, over that behind the corner.
    """
    along, other = corners.along[c, one], corners.along[c, 1 - one]
    _frame(corners, c, 1 - one, rows)
    down, rise = -dot(rows[WAVE], rows[INWARD]), dot(along, rows[INWARD])
    bottom = dot(along, other) * down / rise + dot(rows[WAVE], other)
    if bottom <= 1e-3:
        return False
    out[0], out[1] = down / (rise * bottom), 1 / bottom
    return out[1] > 0


@lean(fastmath=True, error_model="numpy")
def sheet_currents(half: float, phase: float) -> tuple[complex, complex]:
    """Fringe currents across the edge of a sheet, and along it, exact for a half plane.

    Args:
        half: cosine of half the angle of incidence.
        phase: twice the phase from the edge to the place [rad].

    Returns:
        Both over the wave that runs along the sheet, without its own phase.
    """
    hard = along_sheet(half * half * phase)
    return hard, complex(math.sqrt(0.5), -math.sqrt(0.5)) / math.sqrt(math.pi * phase) - half * hard


@core(fastmath=True, error_model="numpy")
def _strength(order: Order, wave: float, x: float) -> complex:
    """Strength of an order at a place of the second edge, so far behind the corner [m].

    The first edge sends its wave there as far as it goes itself: Fresnel's integral from its end.
    """
    hard, soft = sheet_currents(order.half, order.bend * x)
    late = 0.5 * wave * order.before * order.before * order.sine2 / order.across * x
    beyond = 0.5 * phasor(late) * along_sheet(late)
    return (order.hard * hard + order.soft * soft) * (1 - beyond if order.before > 0 else beyond)


@core(fastmath=True, error_model="numpy")
def _accumulate(
    corners: Corners, order: Order, late: float, antennas: Antennas, pulse: PulseGrid, sums: EchoSums, k: int
) -> None:
    """Add the echo of one order of both edges, in parts of the second that are finer towards the corner."""
    c, one, before, across = order.corner, order.first, order.before, order.across
    wave, size = pulse.omega / C0, corners.lengths[c, 1 - one]
    if before > 0:
        size = min(size, corners.lengths[c, one] / before)
    x0, path0, w0 = 0.0, _path(corners, c, one, 0.0, 0.0, antennas.origins), 0j
    sums.delay_s[k] = path0 / C0 + late
    parts = max(_PARTS, int(math.sqrt(2 * wave * size)) + 1)
    for i in range(parts):
        x1 = size * ((i + 1) / parts) ** 2
        path1 = _path(corners, c, one, before * x1, x1, antennas.origins) + across * x1
        w1, middle = _strength(order, wave, x1), _strength(order, wave, size * ((i + 0.5) / parts) ** 2)
        slope = 0.5 * (w1 - w0) if i > 0 else 0j  # it may grow without bound towards the corner
        mean, long = 0.5 * (path0 + path1) / C0 + late, x1 - x0
        line = LineEcho((middle - slope) * long, (middle + slope) * long, path0 / C0, path1 / C0, 0.0)
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
        rows: (9, 3), scratch.
    """
    wave = pulse.omega / C0
    for k in range(len(which)):
        sums.echo[k], sums.delay_s[k] = 0j, 0.0
        if between.factor[k] == 0:
            continue
        c = which[k]
        scale = antennas.factor[0] / (4 * math.pi * wave) * between.factor[k]
        scale *= _seen(corners.places[c], antennas, wave, rows)
        scale *= _over_face(corners, c, 0, wave, rows) * _over_face(corners, c, 1, wave, rows)
        for one in range(2):
            hard, soft = 0j, 0j
            for field in range(2):  # the same where both antennas are
                h, e, sine, half = _first(corners, c, one, field, rows)
                if not _route(corners, c, one, rows, rows[RATIOS]):
                    break
                met = 0.5 * _second(corners, c, 1 - one, field, wave, rows)
                hard, soft = hard + h * met, soft + e * met
            if hard == 0 and soft == 0:
                continue
            before, across = rows[RATIOS, 0], rows[RATIOS, 1]
            bend = 2 * wave * sine * sine * across
            order = Order(c, one, scale * hard, scale * soft, abs(half), bend, before, across, sine * sine)
            _accumulate(corners, order, between.delay_s[k], antennas, pulse, sums, k)
