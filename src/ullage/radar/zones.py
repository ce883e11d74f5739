"""How much of a path of several bounces is free, where a border of shadow crosses its Fresnel zone.

The echo of a flat face comes from about its mirror point, with the weight e^{-j phi}, phi the phase by which the path
over a point of the face exceeds the shortest; in polar coordinates this integrates over phi in closed form between the
borders of face and shadow along each direction [BornWolf1999]. The free share is that integral over what is
free, divided by that over the whole lit part: 1 in the open, a knife edge's Fresnel integral near a straight border.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ullage.kernels import bounces
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
BEST = 8
"""So many paths of a frame, the strongest if they were free, are judged over their zone."""
FAINT = 0.02
"""Paths this much weaker than the strongest of a frame, free or not, are judged by one point."""
RAYS = 12
"""Directions about the mirror point."""
CELLS = 8
"""Points along each."""
LAST = 1.5 * np.pi
"""Phase [rad] at which the weight of a zone has faded out."""


_ANGLES = 2 * np.pi * (np.arange(RAYS) + 0.5) / RAYS
_TURN = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], 1)


class Zone:
    """Cells of the zones of some paths (k): points on their last faces, and what each cell counts for."""

    __slots__ = ("points", "weights")

    def __init__(self, lit: Floats, axes: Floats, last: Floats) -> None:
        """Lays RAYS x CELLS cells about points (k, 3), as far as the phases `last` (k, RAYS) [rad].

        The axes (k, 2, 3) [m] lead from each point to where the phase is 1 rad.
        """
        border = last[..., None] * (np.arange(CELLS + 1) / CELLS)
        value = _summed(border)
        self.weights = value[..., 1:] - value[..., :-1]
        middle = np.sqrt((border[..., 1:] + border[..., :-1]) / 2)  # where the cell is asked
        self.points = lit[:, None, None] + middle[..., None] * (_TURN @ axes)[:, :, None]


def _summed(phase: Floats) -> Complexes:
    """What a direction of a zone counts as far as a phase [rad], the weight fading until `LAST`; -1 / LAST + j at 0."""
    return np.asarray(np.exp(-1j * phase) * (1j * (1 - phase / LAST) - 1 / LAST))


def _outline(lit: Floats, axes: Floats, edges: Floats, turn: Floats) -> Floats:
    """How far (k, rays) the outline lies from each point in each direction, in units of the axes."""
    square = np.einsum("kai,kai->ka", axes, axes)
    flat = np.einsum("kesi,kai->kesa", edges - lit[:, None, None], axes) / square[:, None, None]
    a, b = flat[:, None, :, 0], flat[:, None, :, 1]
    d = b - a
    t = turn[None, :, None]
    bottom = t[..., 0] * d[..., 1] - t[..., 1] * d[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        away = (a[..., 0] * d[..., 1] - a[..., 1] * d[..., 0]) / bottom
        along = (a[..., 0] * t[..., 1] - a[..., 1] * t[..., 0]) / bottom
    met = (away > 0) & (along >= -1e-9) & (along <= 1 + 1e-9)
    return np.asarray(np.where(met, away, np.inf).min(2))


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
    chosen, zone = _strongest(ready, flats, view, beams, path, weights)
    owner, counts = np.repeat(chosen, RAYS * CELLS), zone.weights.reshape(len(chosen), RAYS * CELLS)
    more = np.empty((len(owner), 5, 3))
    bounces.legs(beams.images[owner], beams.firsts[owner], beams.chains[owner], flats.normals, flats.offsets,
                 view.origins, zone.points.reshape(-1, 3), more)  # fmt: skip
    counts[abs(counts) < 1e-2 * abs(counts).max(1, keepdims=True)] = 0
    some = counts.ravel() != 0
    free = clear(np.concatenate([path, more[some]]), np.concatenate([weights, np.ones(some.sum())]))
    out = free[: len(path)].astype(complex)
    seen = np.zeros(counts.shape, bool)
    seen.ravel()[some] = free[len(path) :]
    out[chosen] = (counts * seen).sum(1) / counts.sum(1)
    return out


def _strongest(
    ready: Bench, flats: Flats, view: View, beams: Beams, path: Floats, weights: Floats
) -> tuple[Longs, Zone]:
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
    last = np.minimum(_outline(lit, axes, _outlines(beams, some), _TURN) ** 2, LAST)
    level *= abs((_summed(last) - _summed(np.zeros(1))).sum(1))
    order = np.argsort(-level)[:BEST]
    order = order[level[order] > FAINT * level.max(initial=0.0)]
    return some[order], Zone(lit[order], axes[order], last[order])


def _outlines(beams: Beams, some: Longs) -> Floats:
    """Outlines (k, e, 2, 3) of the lit parts of some beams, the last edge again where one has fewer than others."""
    first, last = beams.first[some], beams.first[some + 1] - 1
    most = int((last - first).max(initial=0)) + 1
    return np.asarray(beams.edges[np.minimum(first[:, None] + np.arange(most), last[:, None])])


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
