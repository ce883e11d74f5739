"""Loops for rough surfaces: the echoes of scatterers that are fixed to them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ullage.arrays import Complexes, Floats, Ints, Longs
from ullage.kernels.facets import (
    BULK,
    ONE,
    Antennas,
    EchoSums,
    PulseGrid,
    Transmission,
    _accumulate,
    same,
    sight,
    te_share,
    turned,
)
from ullage.kernels.loops import lean
from ullage.kernels.near import spread

C0 = 299_792_458.0


class ScattererTiles(NamedTuple):
    """Scatterers (n) fixed to rough surfaces, tile by tile (t)."""

    points: Floats  # (n, 3) [m]
    normals: Floats  # (n, 3) unit normals of the surface there
    weights: Complexes  # (n) amplitude of each, the root of its area [m]
    object_ids: Ints  # (n) object of each
    first: Longs  # (t + 1) first scatterer of each tile


@lean(fastmath=True, error_model="numpy")
def accumulate_diffuse_scatterers(
    tiles: ScattererTiles, lobes: Floats, between: Transmission, antennas: Antennas, pulse: PulseGrid, sums: EchoSums
) -> None:
    """Add the echoes of scatterers to the delay grids; the echo of a tile is that of all its scatterers.

    Args:
        tiles: `ScattererTiles` (t).
        lobes: (o, 2, c) amplitude per root area of each object over cos(incidence), TE and TM [1/m].
        between: `facets.Transmission` (t).
        antennas: `facets.Antennas` of one radar.
        pulse: `facets.PulseGrid`.
        sums: `facets.EchoSums` (t), written; the delay of a tile is the mean of its scatterers.
    """
    omega, start, fold = pulse.omega, pulse.start_s, pulse.fold_s
    last = start + sums.grids.shape[1] * pulse.step_s
    most = lobes.shape[2] - 1
    points, normals, object_ids = tiles.points, tiles.normals, tiles.object_ids
    scale, mono = antennas.factor[0] / (4 * math.pi), same(antennas, ONE)
    ways = 1.0 if mono else 2.0
    for k in range(len(tiles.first) - 1):
        sums.echo[k], sums.delay_s[k] = 0j, 0.0
        if between.factor[k] == 0:
            continue
        total = 0.0
        for i in range(tiles.first[k], tiles.first[k + 1]):
            g, path, cosine, share, both = 1.0 + 0j, 0.0, 0.0, 0.0, 0.0
            for s in range(1 if mono else 2):
                r, ux, uy, uz, gain = sight(antennas, ONE, s, points[i, 0], points[i, 1], points[i, 2])
                te, whole = te_share(antennas.fields, ONE, ux, uy, uz, normals[i, 0], normals[i, 1], normals[i, 2])
                share, both = share + te / ways, both + whole / ways
                cosine += abs(ux * normals[i, 0] + uy * normals[i, 1] + uz * normals[i, 2]) / ways
                gain *= spread(omega / C0, r)
                g *= gain * gain if mono else gain
                path += 2 * r / ways
            u = min(cosine, 0.9999999) * most
            j = int(u)
            u -= j
            te = lobes[object_ids[i], 0, j] * (1 - u) + lobes[object_ids[i], 0, j + 1] * u
            tm = lobes[object_ids[i], 1, j] * (1 - u) + lobes[object_ids[i], 1, j + 1] * u
            value = scale * between.factor[k] * tiles.weights[i] * g * (share * te + (both - share) * tm)
            late = path / C0 + between.delay_s[k]
            total += late
            landed = late - math.floor((late - start) / fold) * fold
            while landed < last:
                part = value * turned(omega * landed)
                _accumulate(sums.grids, BULK, (landed - start) / pulse.step_s, part)
                sums.echo[k] += part if landed < start + fold else 0j  # what lands a pulse later is the same echo
                landed += fold
        sums.delay_s[k] = total / max(tiles.first[k + 1] - tiles.first[k], 1)


@lean(error_model="numpy")
def lobe(roughness: float, length: float, sine: float, terms: int) -> float:
    """Sum the spectrum of exp(j phase) of a rough surface, less its mean, at 2 k sine [correlation areas].

    Args:
        roughness: variance of the phase.
        length: 2 k times the correlation length.
        sine: of the incidence.
        terms: how many terms of the series to sum.
    """
    total, weight = 0.0, -roughness
    for n in range(1, terms):
        weight += math.log(roughness / n)
        bend = length * sine / n
        total += math.exp(weight) / (n * n) / (1 + bend * bend) ** 1.5
    return 2 * np.pi * total
