"""Field and echo of paths of geometrical optics over curved bodies."""

from __future__ import annotations

import math
from typing import NamedTuple

from ullage.arrays import Complexes, Floats, Longs
from ullage.kernels.bounces import reflect_field
from ullage.kernels.facets import BULK, EDGE, FROM, ONE, TO, Antennas, PulseGrid, _accumulate, toward, turned
from ullage.kernels.loops import lean
from ullage.kernels.vectors import dot, field_across, unit_to


class ReflectedPaths(NamedTuple):
    """Paths (n) from transmitter to receiver over s surfaces each."""

    corners: Floats  # (s + 2, n, 3) [m]
    normals: Floats  # (s, n, 3) unit normals where each is reflected
    object_ids: Longs  # (s, n) objects there, which are rows of the materials


class FieldScratch(NamedTuple):
    """Scratch of `polarised`."""

    units: Floats  # (2, 3)
    field: Complexes  # (3)


@lean(error_model="numpy")
def polarised(
    paths: ReflectedPaths, gamma: Complexes, antennas: Antennas, scratch: FieldScratch, out: Complexes
) -> None:
    """Compute the factor that the antennas and all reflections put on the wave of each path.

    Args:
        paths: `ReflectedPaths`.
        gamma: (m, 1, 2, c) reflection over cos(incidence), TE and TM.
        antennas: `facets.Antennas` of one radar.
        scratch: `FieldScratch`.
        out: (n) gets the factors.
    """
    corners, normals, object_ids = paths
    frames, fields, table, flat = antennas.frames, antennas.fields, antennas.table, antennas.isotropic
    direction, taken, field = scratch.units[0], scratch.units[1], scratch.field
    for i in range(len(out)):
        unit_to(corners[0, i], corners[1, i], direction)
        gain = toward(table, flat, frames, ONE, FROM, direction[0], direction[1], direction[2])
        field_across(fields[0, 0], direction, field)
        for s in range(len(normals)):
            reflect_field(gamma, object_ids[s, i], normals[s, i], direction, field)
            unit_to(corners[s + 1, i], corners[s + 2, i], direction)
        gain *= toward(table, flat, frames, ONE, TO, -direction[0], -direction[1], -direction[2])
        field_across(fields[0, 1], direction, taken)
        out[i] = gain * dot(field, taken)


@lean(error_model="numpy")
def impulses(
    delays: Floats, values: Complexes, pulse: PulseGrid, shares: tuple[float, float], grids: Complexes, echo: Complexes
) -> None:
    """Add impulses to the delay grids, each spread by a cubic B-spline.

    Args:
        delays: (n) [s]; values: (n) complex.
        pulse: `facets.PulseGrid`.
        shares: (2) of each value that fall as 1 and as 1 / f.
        grids: (3, g) complex, added to.
        echo: (n) gets the echoes at the carrier.
    """
    omega, t0, dt, fold = pulse.omega, pulse.start_s, pulse.step_s, pulse.fold_s
    last = t0 + grids.shape[1] * dt
    for i in range(len(delays)):
        landed = delays[i] - math.floor((delays[i] - t0) / fold) * fold
        echo[i] = values[i] * turned(omega * landed)  # an echo that arrives one pulse later is the same echo
        while landed < last and values[i] != 0:
            value = values[i] * turned(omega * landed)
            _accumulate(grids, BULK, (landed - t0) / dt, shares[0] * value)
            _accumulate(grids, EDGE, (landed - t0) / dt, shares[1] * value)
            landed += fold
