"""Loops for straight round wires: cutting within the Fresnel zone, and closed-form echoes of the pieces."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ullage.arrays import Complexes, Floats, Ints
from ullage.kernels.facets import (
    FROM,
    TO,
    Antennas,
    EchoSums,
    PulseGrid,
    Transmission,
    _mean_range,
    alike,
    sight,
    te_share,
)
from ullage.kernels.loops import core, loop
from ullage.kernels.near import spread
from ullage.kernels.outlines import accumulate_line
from ullage.kernels.vectors import apart, unit_to

C0 = 299_792_458.0


class WirePieces(NamedTuple):
    """Pieces of wires (m), and the wires (w) that they belong to."""

    ends: Floats  # (m, 2, 3) both ends of each piece [m]
    wire: Ints  # (m) wire of each piece
    radii: Floats  # (w) [m]
    series: Complexes  # (w, 2, c) backscatter series, TM and TE, over the sine of the angle to the axis


@loop(fastmath=True, error_model="numpy")
def cut_wires(
    starts: Floats,
    ends: Floats,
    origins: Floats,
    gate: Floats,
    kappa_lambda: float,
    reach: float,
    pieces: Floats,
    owner: Ints,
) -> int:
    """Halve each wire within the gate until the delay along each piece is nearly linear.

    Args:
        starts: (w, 3) one end of each wire [m].
        ends: (w, 3) the other end [m].
        origins: (1 or w, 2, 3) transmitter and receiver, for all wires or for each [m].
        gate: (2) least and greatest mean range [m].
        kappa_lambda: largest squared transverse length of a piece over its range [m].
        reach: greatest length of a piece over its range.
        pieces: (m, 2, 3) gets the ends of the pieces [m].
        owner: (m) gets the wire of each piece.

    Returns:
        How many pieces there are; only the first m are written.
    """
    count = 0
    stack = np.empty((64, 2))
    p = np.empty(3)
    for w in range(len(starts)):
        radar = origins[w if len(origins) > 1 else 0]
        size = apart(starts[w], ends[w])
        stack[0, 0], stack[0, 1] = 0.0, 1.0
        top = 1
        while top > 0:
            top -= 1
            s0, s1 = stack[top, 0], stack[top, 1]
            half = 0.5 * (s0 + s1)
            for k in range(3):
                p[k] = starts[w, k] + half * (ends[w, k] - starts[w, k])
            cosine2 = 1.0  # of the antenna that sees more of the wire's length
            for s in range(2):
                along, square = 0.0, 1e-12
                for k in range(3):
                    along += (p[k] - radar[s, k]) * (ends[w, k] - starts[w, k]) / size
                    square += (p[k] - radar[s, k]) ** 2
                cosine2 = min(cosine2, along * along / square)
            r = _mean_range(p[0], p[1], p[2], radar)
            piece = (s1 - s0) * size
            if r - 0.5 * piece > gate[1]:
                continue
            near = max(r, 0.02)
            across = piece * piece * (1 - cosine2)
            if (across > kappa_lambda * near or piece > reach * near) and top < 62:
                stack[top, 0], stack[top, 1] = s0, half
                stack[top + 1, 0], stack[top + 1, 1] = half, s1
                top += 2
                continue
            if count < len(pieces):
                for k in range(3):
                    pieces[count, 0, k] = starts[w, k] + s0 * (ends[w, k] - starts[w, k])
                    pieces[count, 1, k] = starts[w, k] + s1 * (ends[w, k] - starts[w, k])
                owner[count] = w
            count += 1
    return count


@core(fastmath=True, error_model="numpy")
def _element(
    pieces: WirePieces, k: int, end: int, axis: Floats, antennas: Antennas, o: int, wave: float, out: Floats
) -> complex:
    """Complex strength per length at an end of piece k, seen by radar o.

    The path length [m] and its bend along the wire [1/m] go to `out`.
    """
    g, path, bend, sine = 1.0 + 0j, 0.0, 0.0, 0.0
    share, both, w = 0.0, 0.0, pieces.wire[k]
    fields, points = antennas.fields, pieces.ends
    for s in range(2):
        r, ux, uy, uz, gain = sight(antennas, o, s, points[k, end, 0], points[k, end, 1], points[k, end, 2])
        along = axis[0] * ux + axis[1] * uy + axis[2] * uz
        slope = math.sqrt(max(1 - along * along, 0.0))
        if alike(fields, o):
            ex, ey, ez = fields[o, s, 0], fields[o, s, 1], fields[o, s, 2]
            eu, ea = ex * ux + ey * uy + ez * uz, ex * axis[0] + ey * axis[1] + ez * axis[2]
            square = slope * slope * max(1 - eu * eu, 1e-12)
            share += 0.5 * min((ea - eu * along) ** 2 / square, 1.0) if square > 1e-12 else 0.0
            both += 0.5
        else:
            across, whole = te_share(fields, o, ux, uy, uz, axis[0], axis[1], axis[2])
            share, both = share + 0.5 * (whole - across), both + 0.5 * whole
        g *= gain * spread(wave, r)
        path += max(r - pieces.radii[w] * slope, 0.0)
        bend += (1 - along * along) / r
        sine += 0.5 * slope
    series = pieces.series
    n = series.shape[2] - 1
    u = min(sine, 0.9999999) * n
    i = int(u)
    u -= i
    tm = series[w, 0, i] * (1 - u) + series[w, 0, i + 1] * u
    te = series[w, 1, i] * (1 - u) + series[w, 1, i + 1] * u
    out[0], out[1] = path, bend
    return g * (share * tm + (both - share) * te)


@loop(fastmath=True, error_model="numpy")
def accumulate_wires(
    pieces: WirePieces, between: Transmission, antennas: Antennas, pulse: PulseGrid, sums: EchoSums
) -> None:
    """Add the echoes of pieces of wire to the delay grids.

    Args:
        pieces: `WirePieces` (m).
        between: `facets.Transmission` (m).
        antennas: `facets.Antennas`, one radar for all wires or one for each wire.
        pulse: `facets.PulseGrid`.
        sums: `facets.EchoSums` (m), written.
    """
    omega, start, step = pulse.omega, pulse.start_s, pulse.step_s
    unit, wave = 1j * (2 * math.pi * C0 / omega) / (4 * math.pi * math.pi), omega / C0
    last = start + sums.grids.shape[1] * step
    axis, out = np.empty(3), np.empty(2)
    for k in range(len(pieces.ends)):
        sums.echo[k], sums.delay_s[k] = 0j, 0.0
        if between.factor[k] == 0:
            continue
        o, size = (
            pieces.wire[k] if len(antennas.origins) > 1 else 0,
            unit_to(pieces.ends[k, 0], pieces.ends[k, 1], axis),
        )
        scale = unit * antennas.factor[o]
        w0 = _element(pieces, k, FROM, axis, antennas, o, wave, out)
        path0, bend = out[0], out[1]
        w1 = _element(pieces, k, TO, axis, antennas, o, wave, out)
        path1, bend = out[0], 0.5 * (bend + out[1])
        w0, w1 = w0 * scale * size * between.factor[k], w1 * scale * size * between.factor[k]
        # mean of bend s (L - s) / 2, by which the chord lies beyond the path: half of it at the most
        early = min(bend * size / 12, 0.5) * size
        late = between.delay_s[k] - early / C0
        mean = 0.5 * (path0 + path1) / C0 + late
        sums.delay_s[k] = mean
        landed = mean - math.floor((mean - start) / pulse.fold_s) * pulse.fold_s
        shift = late + landed - mean
        while landed < last:
            a, b = path0 / C0 + shift, path1 / C0 + shift
            value = accumulate_line(sums.grids, w0, w1, omega * a, omega * b, 1.5 * omega * early / C0,
                                    (a - start) / step, (b - start) / step)  # fmt: skip
            sums.echo[k] += value if landed < start + pulse.fold_s else 0j  # a pulse later it is the same echo
            landed += pulse.fold_s
            shift += pulse.fold_s
