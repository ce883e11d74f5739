"""How much of a path of several bounces is free, where a border of shadow crosses its Fresnel zone.

The echo of a flat face comes from about its mirror point, with the weight e^{-j phi}, phi the phase by which the path
over a point of the face exceeds the shortest; in polar coordinates this integrates over phi in closed form between the
borders of face and shadow along each direction [BornWolf1999]. The free share is that integral over what is
free, divided by that over the whole lit part: 1 in the open, a knife edge's Fresnel integral near a straight border.
Paths are followed along some rays; what is hidden has straight borders mostly, which are drawn from ray to ray.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ullage.kernels import bounces
from ullage.kernels import zones as kernel
from ullage.radar.antenna import gain
from ullage.radar.facets import Flats
from ullage.radar.physical import Bench, View

if TYPE_CHECKING:
    from ullage.radar.multipath import Beams

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Longs = NDArray[np.int64]

NEAR = 0.02
"""Paths over points that exceed the mirror path by more than this many waves are judged by one point."""
BEST = 10
"""So many paths of a frame, the strongest if they were free, are judged over their zone."""
FAINT = 0.02
"""Paths this much weaker than the strongest of a frame, free or not, are judged by one point."""
RAYS = 24
"""Directions about the mirror point in which paths are followed."""
FINE = 4
"""So many times as many in which borders of face and shadow are drawn."""
CELLS = 6
"""Points along each that is followed."""
HALVINGS = 1
"""How often the gap is halved between a free point and a hidden one."""
LAST = 2.25 * np.pi
"""Phase [rad] at which the weight of a zone has faded out."""


@lru_cache(maxsize=4)
def _turn(rays: int) -> Floats:
    """Cosine and sine (rays, 2) of the directions."""
    angles = 2 * np.pi * (np.arange(rays) + 0.5) / rays
    return np.stack([np.cos(angles), np.sin(angles)], 1)


def _phases(ends: Floats, shares: Floats) -> Floats:
    """Phases [rad] up to which such shares of the fading weight lie, on rays that end at some phase."""
    return np.asarray(LAST * (1 - np.sqrt(1 - shares * (1 - (1 - ends / LAST) ** 2))))


@dataclass(frozen=True, slots=True, eq=False)
class Zones:
    """The Fresnel zones of some paths (k)."""

    paths: Longs  # (k)
    lit: Floats  # (k, 3) mirror points [m]
    axes: Floats  # (k, 2, 3) to where the phase is 1 rad [m]
    ends: Floats  # (k, FINE RAYS) phases at which the lit part of the last face ends [rad]

    def at(self, zone: Longs, ray: Longs, phase: Floats) -> Floats:
        """Points (n, 3) of zones (n) on rays (n) that are followed, at phases (n) [rad]."""
        turn = np.sqrt(phase)[:, None] * _turn(FINE * RAYS)[::FINE][ray]
        return np.asarray(self.lit[zone] + turn[:, :1] * self.axes[zone, 0] + turn[:, 1:] * self.axes[zone, 1])


def shares(
    ready: Bench,
    flats: Flats,
    view: View,
    beams: Beams,
    path: Floats,
    weights: Floats,
    clear: Callable[[Floats, Floats], NDArray[np.bool_]],
) -> Complexes:
    """What part (b) of the echo of each path (b, 5, 3) is left by what stands in its way.

    Args:
        ready: the bench.
        flats: the faces.
        view: the radar.
        beams: what the paths run in.
        path: corners from transmitter to receiver [m].
        weights: (b) of the paths, 0 where it does not matter.
        clear: whether paths (n, 5, 3) of weights (n) are free.
    """
    zones = _strongest(ready, flats, view, beams, path, weights)
    many = len(zones.paths)

    def legs(of: Longs, points: Floats) -> Floats:
        row, out = zones.paths[of], np.empty((len(of), 5, 3))
        bounces.legs(beams.images[row], beams.firsts[row], beams.chains[row], flats.normals, flats.offsets,
                     view.origins, points, out)  # fmt: skip
        return out

    asked = _phases(zones.ends[:, ::FINE, None], (np.arange(CELLS) + 0.5) / CELLS)
    away = (_turn(FINE * RAYS)[::FINE] @ zones.axes)[:, :, None]
    places = zones.lit[:, None, None] + np.sqrt(asked)[..., None] * away
    more = legs(np.repeat(np.arange(many), RAYS * CELLS), places.reshape(-1, 3))
    clears = clear(np.concatenate([path, more]), np.concatenate([weights, np.ones(len(more))]))
    out, free = clears[: len(path)].astype(complex), clears[len(path) :].reshape(many, RAYS, CELLS)
    borders = _borders(zones, asked, free, lambda of, points: clear(legs(of, points), np.ones(len(of))))
    found = np.empty(many, complex)
    kernel.parts(free, borders, zones.ends, LAST, np.empty((RAYS, CELLS)), np.empty(RAYS, np.int64), found)
    out[zones.paths] = found
    return out


def _borders(
    zones: Zones, asked: Floats, free: NDArray[np.bool_], clear: Callable[[Longs, Floats], NDArray[np.bool_]]
) -> Floats:
    """Phases (k, rays, cells) at which cells begin that were asked at these phases, where light and shadow change.

    `clear` tells whether paths of zones (n) over points (n, 3) are free.
    """
    borders = np.zeros(asked.shape)
    of, ray, cell = np.nonzero(free[:, :, 1:] != free[:, :, :-1])
    low, high, lit = asked[of, ray, cell], asked[of, ray, cell + 1], free[of, ray, cell]
    for _ in range(HALVINGS if len(of) else 0):
        middle = (low + high) / 2
        same = clear(of, zones.at(of, ray, middle)) == lit
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    borders[of, ray, cell + 1] = (low + high) / 2
    return borders


def _strongest(ready: Bench, flats: Flats, view: View, beams: Beams, path: Floats, weights: Floats) -> Zones:
    """Paths over mirror points that would be the strongest if nothing stood in their way, and their zones."""
    normals, offsets = flats.normals[beams.ends_on], flats.offsets[beams.ends_on]
    there, back = _size(path[:, 3] - beams.images), _size(view.origins[1] - path[:, 3])
    twice = 2 * (np.einsum("bi,bi->b", normals, beams.images) - offsets)
    excess = there + back - _size(beams.images - twice[:, None] * normals - view.origins[1])
    some = np.flatnonzero((weights != 0) & (excess < NEAR * ready.spec.wavelength_m))
    level = _level(ready, flats, view, beams, path, weights, some) / (there + back)[some]
    first = np.argsort(-level)[: 2 * BEST]  # laying out a zone costs more than telling these
    some, level = some[first], level[first]
    lit, across = path[some, 3], flats.across[beams.ends_on[some]]
    out = np.einsum("bai,bi->ba", across, view.origins[1] - lit) / back[some, None]
    slant = np.sqrt(np.maximum(1 - (out**2).sum(1), 0.01))[:, None]
    reach = np.sqrt(ready.spec.wavelength_m / np.pi / (1 / there[some] + 1 / back[some]))[:, None]
    size = _size(out)[:, None]
    out = np.where(size > 1e-6, out / np.maximum(size, 1e-9), np.array([1.0, 0.0]))
    turned = np.stack([-out[:, 1], out[:, 0]], 1)
    axes = np.stack([out / slant, turned], 1) * reach[..., None] @ across
    rough = np.empty((len(some), RAYS))
    kernel.outline(lit, axes, some, beams.first, beams.edges, _turn(RAYS), LAST, rough)
    counts = np.empty(len(some), complex)
    kernel.whole(rough, LAST, counts)
    level *= abs(counts)
    order = np.argsort(-level)[:BEST]
    order = order[level[order] > FAINT * level.max(initial=0.0)]
    ends = np.empty((len(order), FINE * RAYS))
    some, lit, axes = some[order], lit[order], np.ascontiguousarray(axes[order])
    kernel.outline(lit, axes, some, beams.first, beams.edges, _turn(FINE * RAYS), LAST, ends)
    return Zones(some, lit, axes, ends)


def _level(ready: Bench, flats: Flats, view: View, beams: Beams, path: Floats, weights: Floats, some: Longs) -> Floats:
    """What reflections and antennas leave of some paths."""
    ways, factor = path[some], weights[some].astype(complex)
    frames, fields = np.empty((len(some), 2, 3, 3)), np.empty((len(some), 2, 3))
    bounces.reflect(ways, beams.chains[some], beams.ends_on[some], flats.normals, flats.stuffs, ready.gamma,
                    view.frames, view.fields, factor, frames, fields)  # fmt: skip
    lone = (ways[:, 1] == ways[:, 0]).all(1)
    sent = (np.where(lone[:, None], ways[:, 2], ways[:, 1]) - ways[:, 0]) @ view.frames[0].T
    taken = (ways[:, 3] - ways[:, 4]) @ view.frames[1].T
    gains = gain(ready.spec.antenna, np.concatenate([sent, taken]))
    return np.asarray(abs(factor) * gains[: len(some)] * gains[len(some) :])


def _size(vectors: Floats) -> Floats:
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", vectors, vectors)))
