"""Loops over ways by flat mirrors to points of other surfaces, and back: where they go, what becomes of the field."""

from __future__ import annotations

import math

import numpy as np

from ullage.kernels.bounces import _across, _reflect, _unit
from ullage.kernels.loops import loop


@loop(nogil=True, error_model="numpy")
def corners(points, faces, images, normals, offsets, out, met):  # type: ignore[no-untyped-def]
    """Where both legs of the ways to points meet their mirrors; whether from in front.

    Args:
        points: (m, 3) [m].
        faces: (2, 2) mirrors of each leg from its antenna on, -1 for none.
        images: (2, 3, 3) each antenna, then its images in them [m].
        normals: (p, 3) and offsets: (p) of the faces.
        out: (2, 4, m, 3) gets the corners of each leg: antenna, at the mirrors, point; those not needed are left [m].
        met: (m) gets whether every mirror stands between an image and what it mirrors to.
    """
    for i in range(len(points)):
        met[i] = True
        for side in range(2):
            count = 0
            while count < 2 and faces[side, count] >= 0:
                count += 1
            for k in range(3):
                out[side, 0, i, k] = images[side, 0, k]
                out[side, count + 1, i, k] = points[i, k]
            for step in range(count, 0, -1):
                p = faces[side, step - 1]
                before, here, there = -offsets[p], -offsets[p], -offsets[p]
                for k in range(3):
                    before += normals[p, k] * images[side, step - 1, k]
                    here += normals[p, k] * images[side, step, k]
                    there += normals[p, k] * out[side, step + 1, i, k]
                if before * there <= 0:
                    met[i] = False
                span = here - there
                share = here / (span if abs(span) > 1e-12 else 1.0)
                for k in range(3):
                    out[side, step, i, k] = images[side, step, k] + share * (
                        out[side, step + 1, i, k] - images[side, step, k]
                    )


@loop(nogil=True, error_model="numpy")
def weigh(stops, todo, faces, fields, normals, stuffs, widths, wavelength, gamma, owned, out):  # type: ignore[no-untyped-def]
    """What the bounces of each way make of a wave, by polarisation; the point's is that of a mirror for these legs.

    Args:
        stops: (2, 4, m, 3) as `corners` gives them [m].
        todo: (n) which points to do.
        faces: (2, 2) mirrors of each leg from its antenna on, -1 for none.
        fields: (2, 3) unit fields of the antennas.
        normals: (p, 3), stuffs: (p) and widths: (p, 2) of the faces [m].
        wavelength: [m].
        gamma: (s, taps, 2, c) reflection over cos(incidence), TE and TM; only the first tap bounces.
        owned: (m) object of each point.
        out: (m) gets the factor of the points to do.
    """
    units, sizes, start = np.empty((2, 3, 3)), np.empty(3), np.empty(3)
    waves, between = np.empty((2, 3), np.complex128), np.empty(3)
    counts = np.zeros(2, np.int64)
    for side in range(2):
        while counts[side] < 2 and faces[side, counts[side]] >= 0:
            counts[side] += 1
    for i in todo:
        cover = 1.0
        for side in range(2):
            total = 0.0
            for step in range(counts[side] + 1):
                sizes[step] = _unit(stops[side, step, i], stops[side, step + 1, i], units[side, step])
                total += sizes[step]
            _across(fields[side], units[side, 0], start)
            for k in range(3):
                waves[side, k] = start[k]
            before = 0.0
            for step in range(counts[side]):
                p = faces[side, step]
                before += sizes[step]
                zone = math.sqrt(wavelength * before * max(total - before, 0.0) / max(total, 1e-9))
                along = 0.0
                for k in range(3):
                    along += normals[p, k] * units[side, step, k]
                for k in range(2):
                    cover *= min(1.0, widths[p, k] * math.sqrt(abs(along)) / max(zone, 1e-9))
                _reflect(gamma, stuffs[p], normals[p], units[side, step], waves[side])
        square = 0.0
        for k in range(3):
            between[k] = units[0, counts[0], k] + units[1, counts[1], k]
            square += between[k] * between[k]
        for k in range(3):
            between[k] /= max(math.sqrt(square), 1e-9)
        _reflect(gamma, owned[i], between, units[0, counts[0]], waves[0])
        out[i] = cover * (waves[0, 0] * waves[1, 0] + waves[0, 1] * waves[1, 1] + waves[0, 2] * waves[1, 2])
