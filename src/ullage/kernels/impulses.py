"""Loops over paths of geometrical optics over round things: what becomes of the field, and impulses on delay grids."""

from __future__ import annotations

import math

from ullage.kernels.bounces import reflect_field
from ullage.kernels.facets import FROM, ONE, TO, toward, turned
from ullage.kernels.loops import lean
from ullage.kernels.vectors import dot, field_across, unit_to


@lean(nogil=True, error_model="numpy")
def polarised(corners, normals, object_ids, gamma, frames, fields, table, flat, units, field, out):  # type: ignore[no-untyped-def]
    """What the antennas and all reflections make of waves.

    Args:
        corners: (s + 2, n, 3) of each path from transmitter to receiver [m].
        normals: (s, n, 3) unit normals, and object ids: (s, n) materials, where it is reflected.
        gamma: (m, taps, 2, c) reflection over cos(incidence), TE and TM; only the first tap bounces.
        frames: (1, 2, 3, 3) sensor_from_world and fields: (1, 2, 3) of transmitter and receiver.
        table, flat: as in `facets.accumulate`.
        units, field: (2, 3), (3) complex, scratch.
        out: (n) gets the factors.
    """
    way, taken = units[0], units[1]
    for i in range(len(out)):
        unit_to(corners[0, i], corners[1, i], way)
        gain = toward(table, flat, frames, ONE, FROM, way[0], way[1], way[2])
        field_across(fields[0, 0], way, taken)
        for k in range(3):
            field[k] = taken[k]
        for s in range(len(normals)):
            reflect_field(gamma, object_ids[s, i], normals[s, i], way, field)
            unit_to(corners[s + 1, i], corners[s + 2, i], way)
        gain *= toward(table, flat, frames, ONE, TO, -way[0], -way[1], -way[2])
        field_across(fields[0, 1], way, taken)
        out[i] = gain * dot(field, taken)


@lean(nogil=True, error_model="numpy")
def impulses(delays, values, omega, t0, dt, fold, shares, grids, echo):  # type: ignore[no-untyped-def]
    """Lays impulses on the delay grids, with a cubic B-spline.

    Args:
        delays: (n) [s]; values: (n) complex.
        omega: carrier [rad/s].
        t0: delay of the first grid place, dt: grid step, fold: delay at which the frame folds [s].
        shares: what of them falls as 1 and as 1 / f.
        grids: (3, g) complex, added to.
        echo: (n) gets the echoes at the carrier.
    """
    last = t0 + grids.shape[1] * dt
    for i in range(len(delays)):
        landed = delays[i] - math.floor((delays[i] - t0) / fold) * fold
        echo[i] = values[i] * turned(omega * landed)  # what lands a pulse later is the same echo
        while landed < last and values[i] != 0:
            value = values[i] * turned(omega * landed)
            first = math.floor((landed - t0) / dt)
            up = (landed - t0) / dt - first
            down = 1 - up
            spline = (down**3 / 6, 2 / 3 - up**2 * (2 - up) / 2, 2 / 3 - down**2 * (2 - down) / 2, up**3 / 6)
            for step in range(4):
                at = first - 1 + step
                if 0 <= at < grids.shape[1]:
                    for kind in range(2):
                        grids[kind, at] += shares[kind] * spline[step] * value
            landed += fold
