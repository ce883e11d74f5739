"""Loops for straight round wires: cutting within the Fresnel zone, and closed-form echoes of the pieces."""

from __future__ import annotations

import math

import numpy as np

from ullage.kernels.facets import FROM, TO, _mean_range, toward
from ullage.kernels.loops import core, loop
from ullage.kernels.near import spread
from ullage.kernels.outlines import accumulate_line

C0 = 299_792_458.0


@loop(fastmath=True, nogil=True, error_model="numpy")
def cut_wires(starts, ends, origins, gate, kappa_lambda, reach, pieces, owner):  # type: ignore[no-untyped-def]
    """Halves each wire (w, 3)-(w, 3) within the gate until each piece's delay is nearly linear; gives the count.

    The radar is at origins (1 or w, 2, 3), one for all or one for each.
    """
    count = 0
    stack = np.empty((64, 2))
    p = np.empty(3)
    for w in range(len(starts)):
        radar = origins[w if len(origins) > 1 else 0]
        size = 0.0
        for k in range(3):
            size += (ends[w, k] - starts[w, k]) ** 2
        size = math.sqrt(size)
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


@core(fastmath=True, nogil=True, error_model="numpy")
def _element(pieces, k, end, axis, radius, series, w, wave, origins, o, frames, fields, table, flat, out):  # type: ignore[no-untyped-def]
    """Complex strength per length at a point of a wire; path length and its rate along the wire go to `out`."""
    g, path, bend, sine = 1.0 + 0j, 0.0, 0.0, 0.0
    share = 0.0
    for s in range(2):
        dx, dy, dz = (pieces[k, end, 0] - origins[o, s, 0], pieces[k, end, 1] - origins[o, s, 1],
                      pieces[k, end, 2] - origins[o, s, 2])  # fmt: skip
        r = max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
        ux, uy, uz = dx / r, dy / r, dz / r
        along = axis[0] * ux + axis[1] * uy + axis[2] * uz
        slope = math.sqrt(max(1 - along * along, 0.0))
        ex, ey, ez = fields[o, s, 0], fields[o, s, 1], fields[o, s, 2]
        eu, ea = ex * ux + ey * uy + ez * uz, ex * axis[0] + ey * axis[1] + ez * axis[2]
        square = slope * slope * max(1 - eu * eu, 1e-12)
        share += 0.5 * min((ea - eu * along) ** 2 / square, 1.0) if square > 1e-12 else 0.0
        g *= toward(table, flat, frames, o, s, ux, uy, uz) * spread(wave, r)
        path += max(r - radius * slope, 0.0)
        bend += (1 - along * along) / r
        sine += 0.5 * slope
    n = series.shape[2] - 1
    u = min(sine, 0.9999999) * n
    i = int(u)
    u -= i
    tm = series[w, 0, i] * (1 - u) + series[w, 0, i + 1] * u
    te = series[w, 1, i] * (1 - u) + series[w, 1, i + 1] * u
    out[0], out[1] = path, bend
    return g * (share * tm + (1 - share) * te)


@loop(fastmath=True, nogil=True, error_model="numpy")
def accumulate_wires(pieces, owner, transmission, extra, radii, series, origins, frames, fields, table, flat, factor,  # type: ignore[no-untyped-def]
              omega, t0, dt, fold, grids, echo, delay):  # fmt: skip
    """Lays the echoes of pieces of wire (m, 2, 3) on the delay grids.

    Args:
        pieces: (m, 2, 3) ends of each piece [m].
        owner: (m) wire of each piece.
        transmission: (m) complex two-way factor of what lies between.
        extra: (m) delay added by it [s].
        radii: (w) [m].
        series: (w, 2, c) complex backscatter series, TM and TE, over the sine of the angle to the axis.
        origins: (1 or w, 2, 3) radars for all or for each wire, as in `facets.accumulate`, and so the rest.
    """
    unit, wave = 1j * (2 * math.pi * C0 / omega) / (4 * math.pi * math.pi), omega / C0
    last = t0 + grids.shape[1] * dt
    axis, out = np.empty(3), np.empty(2)
    for k in range(len(pieces)):
        echo[k], delay[k] = 0j, 0.0
        if transmission[k] == 0:
            continue
        w, size = owner[k], 0.0
        o = w if len(origins) > 1 else 0
        scale = unit * factor[o]
        for j in range(3):
            axis[j] = pieces[k, 1, j] - pieces[k, 0, j]
            size += axis[j] * axis[j]
        size = math.sqrt(size)
        for j in range(3):
            axis[j] /= size
        w0 = _element(pieces, k, FROM, axis, radii[w], series, w, wave, origins, o, frames, fields, table, flat, out)
        path0, bend = out[0], out[1]
        w1 = _element(pieces, k, TO, axis, radii[w], series, w, wave, origins, o, frames, fields, table, flat, out)
        path1, bend = out[0], 0.5 * (bend + out[1])
        w0, w1 = w0 * scale * size * transmission[k], w1 * scale * size * transmission[k]
        # mean of bend s (L - s) / 2, by which the chord lies beyond the path: half of it at the most
        early = min(bend * size / 12, 0.5) * size
        late = extra[k] - early / C0
        mean = 0.5 * (path0 + path1) / C0 + late
        delay[k] = mean
        landed = mean - math.floor((mean - t0) / fold) * fold
        shift = late + landed - mean
        while landed < last:
            a, b = path0 / C0 + shift, path1 / C0 + shift
            value = accumulate_line(grids, w0, w1, omega * a, omega * b, 1.5 * omega * early / C0, (a - t0) / dt,
                             (b - t0) / dt)  # fmt: skip
            echo[k] += value if landed < t0 + fold else 0j  # what lands a pulse later is the same echo
            landed += fold
            shift += fold
