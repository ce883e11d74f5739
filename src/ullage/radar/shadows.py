"""What is left of a mirror point's echo where borders of shadow lie on its face.

The wave bends around what stands before a face twice, there and back. Behind a straight border this is the double knife
edge: with x and y the places at which the wave passes the edge's plane, Kirchhoff's integral over both [BornWolf1999]
is 1/4 at the border of a screen next to the radar, 1/2 of one next to the face. It depends on v of the edge in the
whole path and on r = d1 / (d1 + 2 d2), by which both places belong together, d1 from the radar to the screen, d2 from
there to the face. In polar coordinates about the mirror point it is an integral of e^{-j r phi} along the border, phi
the phase by which the path over a point of the face exceeds the shortest: over all angles for one way, and within
atan sqrt((1 - r) / (1 + r)) of the border's nearest point for both ways together.

Borders are found by rays: along some directions about each mirror point, halved until they are sharp. They are straight
from direction to direction. Where a face ends its rim echoes; that is no border of shadow.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.kernels import rims
from ullage.kernels import shadows as kernel

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Longs = NDArray[np.int64]
Bools = NDArray[np.bool_]

RAYS = 20
"""Directions about a mirror point."""
CELLS = np.array([1.0, 2.0, 3.3, 5.5, 9.0, 14.0])
"""Places along each at which is asked, to where the phase is 1 rad."""
FADED = np.array([10.0, 20.0, 100.0, 200.0])
"""Phases between which borders fade out, and the same before the screen's distance counts [rad]."""
PARTS, TIMES = 9, 2
"""A border is found by cutting a cell into so many parts, so many times."""
MOST = 4
"""Borders along a direction: what lies beyond more is left out."""
_NODES, _WEIGHTS = (np.ascontiguousarray(row) for row in np.polynomial.legendre.leggauss(24))

Clear = Callable[[Floats], Bools]
"""Whether nothing opaque stands before points (n, 3)."""
Blocked = Callable[[Floats], Floats]
"""How far off stands what hides points (n, 3), as a share of their distance."""


@lru_cache(maxsize=1)
def pattern() -> Floats:
    """Places (RAYS CELLS, 2) at which is asked, over the radius at which the phase is pi."""
    angle = 2 * np.pi * np.arange(RAYS) / RAYS
    turn = np.stack([np.cos(angle), np.sin(angle)], 1)
    return np.asarray((turn[:, None] * CELLS[:, None] / np.sqrt(np.pi)).reshape(-1, 2))


def shares(
    points: Floats, which: Longs, free: Bools, wavelength_m: float, faces: tuple[Any, ...], clear: Clear,
    blocked: Blocked,
) -> Complexes:  # fmt: skip
    """What part (k) of the echoes of mirror points is left by borders of shadow about them.

    Args:
        points: (k, 9) as `rims.crossings` gives them.
        which: (k) the face of each.
        free: (k) whether they are seen themselves.
        wavelength_m: [m].
        faces: across, normals, first, starts and ends, as in `facets.Flats`.
        clear: tells what is seen.
        blocked: tells what hides.
    """
    many, (across, *rest) = len(points), faces
    places, of = np.empty((many * len(pattern()), 3)), np.empty(many * len(pattern()), np.int64)
    held = np.empty((many, len(pattern())), np.bool_)
    rims.look_about(points, which, across, pattern(), wavelength_m, *rest, places, of, held)
    held = np.logical_and.accumulate(held.reshape(many, RAYS, len(CELLS)), axis=2)  # as far as the face goes
    seen = np.zeros(held.shape, np.bool_)
    seen[held] = clear(places[held.ravel()])
    before = np.concatenate([np.broadcast_to(free[:, None, None], (many, RAYS, 1)), seen[:, :, :-1]], 2)
    at, ray, cell = np.nonzero(held & (seen != before))
    counts = np.zeros((many, RAYS), np.int64)
    np.add.at(counts, (at, ray), 1)
    counts = np.minimum(counts, MOST)
    reach, ratios = np.zeros((2, many, RAYS, MOST))
    start = np.searchsorted(at * RAYS + ray, at * RAYS + ray)
    slot = np.arange(len(at)) - start
    zone = np.sqrt(wavelength_m * points[at, 3] / (4 * np.pi))
    angle = 2 * np.pi * ray / RAYS
    along = np.cos(angle)[:, None] * across[which[at], 0] + np.sin(angle)[:, None] * across[which[at], 1]
    along *= zone[:, None]
    rho, dark = _borders(points[at, :3], along, np.append(0.0, CELLS)[cell], CELLS[cell], seen[at, ray, cell], clear)
    share = blocked(points[at, :3] + dark[:, None] * along)
    few = slot < MOST
    reach[at[few], ray[few], slot[few]] = rho[few]
    ratios[at[few], ray[few], slot[few]] = (share / (2 - share))[few]
    out = np.empty(many, complex)
    kernel.shares(free, counts, reach, ratios, FADED, (1 + _NODES) / 2, _WEIGHTS / 2, np.empty((RAYS, MOST), np.int64),
                  np.empty((RAYS * MOST, 3), complex), out)  # fmt: skip
    return out


def _borders(
    middles: Floats, along: Floats, low: Floats, high: Floats, lit: Bools, clear: Clear
) -> tuple[Floats, Floats]:
    """Where light changes (n) between two places along rays, `lit` at the far one, and the dark side of that (n)."""
    low, high, inner = low.copy(), high.copy(), np.arange(1, PARTS) / PARTS
    for _ in range(TIMES if len(low) else 0):
        asked = low[:, None] + (high - low)[:, None] * inner
        same = clear((middles[:, None] + asked[..., None] * along[:, None]).reshape(-1, 3)).reshape(asked.shape)
        step = (np.logical_and.accumulate(same == ~lit[:, None], axis=1)).sum(1)
        size = (high - low) / PARTS
        low = low + step * size
        high = low + size
    return (low + high) / 2, np.where(lit, low, high)
