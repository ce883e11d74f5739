"""What the radar sees: one ray to the middle of every piece of surface, through thin sheets where there are any."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ullage.radar.facets import Surfaces
from ullage.radar.penetration import Curtains

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

SLACK_M = 2e-3
"""Two surfaces nearer than this along a ray count as one [m]; Embree's float32 and shared edges need it."""
SHEETS = 4
"""A wave is followed through at most so many sheets, one way."""


def seen(parts: Sequence[Surfaces], origin: Floats, points: Floats, sheets: Curtains) -> tuple[Complexes, Floats]:
    """Two-way factor (n) and delay [s] (n) of what stands between the origin (3) and points (n, 3) on surfaces.

    1 in the open, 0 behind anything opaque; behind thin sheets what they let through, at most `SHEETS` of them.
    """
    ray = points - origin
    length = np.sqrt(np.einsum("ni,ni->n", ray, ray))
    ray /= np.maximum(length, 1e-9)[:, None]
    factor, late = np.ones(len(points), complex), np.zeros(len(points))
    distance, stuff, cosine = _first(parts, np.broadcast_to(origin, ray.shape), ray)
    hidden = distance < length - SLACK_M
    through = hidden & sheets.thin[stuff]
    factor[hidden & ~through] = 0
    todo = np.flatnonzero(through)
    passed, stuff, cosine = distance[todo], stuff[todo], cosine[todo]
    for _ in range(SHEETS):
        if not len(todo):
            return factor, late
        place = np.minimum(cosine * (sheets.factor.shape[1] - 1), sheets.factor.shape[1] - 1.001)
        low, u = place.astype(int), place % 1
        factor[todo] *= sheets.factor[stuff, low] * (1 - u) + sheets.factor[stuff, low + 1] * u
        late[todo] += sheets.delay_s[stuff, low] * (1 - u) + sheets.delay_s[stuff, low + 1] * u
        passed = passed + 2 * SLACK_M
        distance, stuff, cosine = _first(parts, origin + ray[todo] * passed[:, None], ray[todo])
        passed = passed + distance
        again = passed < length[todo] - SLACK_M
        stop = again & ~sheets.thin[stuff]
        factor[todo[stop]] = 0
        keep = again & ~stop
        todo, passed, stuff, cosine = todo[keep], passed[keep], stuff[keep], cosine[keep]
    factor[todo] = 0
    return factor, late


def _first(parts: Sequence[Surfaces], origins: Floats, rays: Floats) -> tuple[Floats, NDArray[np.int32], Floats]:
    """Distance [m], object and cos(incidence) of the first thing each ray meets; inf where there is none."""
    least = np.full(len(rays), np.inf)
    stuff, cosine = np.zeros(len(rays), np.int32), np.ones(len(rays))
    for part in parts:
        face, distance = part.rays.hits(origins, rays)
        near = np.flatnonzero((face >= 0) & (distance < least))
        hit = face[near]
        least[near], stuff[near] = distance[near], part.ray_stuffs[hit]
        cosine[near] = abs(np.einsum("ni,ni->n", part.rays.normals[hit], rays[near]))
    return least, stuff, cosine


def between(parts: Sequence[Surfaces], a: Floats, b: Floats) -> NDArray[np.bool_]:
    """Whether nothing stands between the points a (n, 3) and b (n, 3), which may lie on surfaces."""
    ray = b - a
    length = np.sqrt(np.einsum("ni,ni->n", ray, ray))
    ray /= np.maximum(length, 1e-9)[:, None]
    clear = np.ones(len(a), bool)
    for part in parts:
        _, distance = part.rays.hits(a + SLACK_M * ray, ray)
        clear &= distance >= length - 2 * SLACK_M
    return np.asarray(clear | (length < 4 * SLACK_M))
