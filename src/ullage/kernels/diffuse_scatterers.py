"""Loops for rough surfaces: the echoes of scatterers that are fixed to them."""

from __future__ import annotations

import math

import numpy as np

from ullage.kernels.facets import BULK, ONE, _accumulate, same, te_share, toward, turned
from ullage.kernels.loops import lean
from ullage.kernels.near import spread

C0 = 299_792_458.0


@lean(fastmath=True, nogil=True, error_model="numpy")
def accumulate_diffuse_scatterers(  # type: ignore[no-untyped-def]
    points,
    normals,
    weights,
    object_ids,
    first,
    transmission,
    extra,
    lobes,
    origins,
    frames,
    fields,
    table,
    flat,
    factor,
    omega,
    t0,
    dt,
    fold,
    grids,
    echo,
    delay,
):
    """Lays the echoes of scatterers on the delay grids.

    Args:
        points: (n, 3) scatterers, tile by tile [m].
        normals: (n, 3) unit normals of the surface there.
        weights: (n) complex amplitude of each, the root of its area [m].
        object_ids: (n) object of each.
        first: (t + 1) first scatterer of each tile.
        transmission: (t) complex two-way factor of what stands before a tile.
        extra: (t) delay added by it [s].
        lobes: (o, 2, c) amplitude per root area of each object over cos(incidence), TE and TM [1/m].
        origins: (1, 2, 3), as in `facets.accumulate`, and so the rest.
        echo: (t) gets the sum of each tile at the carrier.
        delay: (t) gets its mean delay [s].
    """
    last = t0 + grids.shape[1] * dt
    most = lobes.shape[2] - 1
    scale, mono = factor[0] / (4 * math.pi), same(origins, ONE)
    for k in range(len(first) - 1):
        echo[k], delay[k] = 0j, 0.0
        if transmission[k] == 0:
            continue
        total = 0.0
        for i in range(first[k], first[k + 1]):
            g, path, cosine, share = 1.0, 0.0, 0.0, 0.0
            for s in range(2):
                dx, dy, dz = (points[i, 0] - origins[0, s, 0], points[i, 1] - origins[0, s, 1],
                              points[i, 2] - origins[0, s, 2])  # fmt: skip
                r = max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
                ux, uy, uz = dx / r, dy / r, dz / r
                if s == 0 or not mono:
                    te = te_share(fields, ONE, ux, uy, uz, normals[i, 0], normals[i, 1], normals[i, 2])
                    share += te if mono else 0.5 * te
                cosine += 0.5 * abs(ux * normals[i, 0] + uy * normals[i, 1] + uz * normals[i, 2])
                g *= toward(table, flat, frames, ONE, s, ux, uy, uz) * spread(omega / C0, r)
                path += r
            u = min(cosine, 0.9999999) * most
            j = int(u)
            u -= j
            te = lobes[object_ids[i], 0, j] * (1 - u) + lobes[object_ids[i], 0, j + 1] * u
            tm = lobes[object_ids[i], 1, j] * (1 - u) + lobes[object_ids[i], 1, j + 1] * u
            value = scale * transmission[k] * weights[i] * g * (share * te + (1 - share) * tm)
            late = path / C0 + extra[k]
            total += late
            landed = late - math.floor((late - t0) / fold) * fold
            while landed < last:
                part = value * turned(omega * landed)
                _accumulate(grids, BULK, (landed - t0) / dt, part)
                echo[k] += part if landed < t0 + fold else 0j  # what lands a pulse later is the same echo
                landed += fold
        delay[k] = total / max(first[k + 1] - first[k], 1)


@lean(nogil=True, error_model="numpy")
def lobe(roughness, length, sine, terms):  # type: ignore[no-untyped-def]
    """Spectrum of exp(j phase) of a rough surface less its mean, per area, at 2 k sine [the area of its correlation].

    Args:
        roughness: variance of the phase.
        length: 2 k times the correlation length.
        sine: of the incidence.
        terms: how many of the series.
    """
    total, weight = 0.0, -roughness
    for n in range(1, terms):
        weight += math.log(roughness / n)
        bend = length * sine / n
        total += math.exp(weight) / (n * n) / (1 + bend * bend) ** 1.5
    return 2 * np.pi * total
