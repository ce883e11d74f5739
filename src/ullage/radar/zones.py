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

import numpy as np

from ullage.arrays import Bools, Complexes, Floats, Longs
from ullage.kernels import bounces
from ullage.kernels import zones as kernel
from ullage.kernels.zones import Strengths
from ullage.radar.context import AntennaPair, RadarContext
from ullage.radar.facets import PlanarPatches
from ullage.radar.mirrors import Beams

NEAR = 0.02
"""Paths over points that exceed the mirror path by more than this many waves are judged by one point."""
BEST = 10
"""So many paths of a frame, the strongest if they were free, are judged over their zone."""
EVEN = 0.1
"""Paths whose zone is free, or hidden, at five points alike give way to others unless they are stronger by this."""
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
    context: RadarContext,
    planar: PlanarPatches,
    antennas: AntennaPair,
    beams: Beams,
    path: Floats,
    strong: Strengths,
    clear: Callable[[Floats, Floats], Bools],
) -> Complexes:
    """What part (b) of the echo of each path (b, d, 3) is left by what stands in its way.

    Args:
        context: the bench.
        planar: the faces.
        antennas: the radar.
        beams: what the paths run in.
        path: corners from transmitter to receiver [m].
        strong: what they would bring; of 0 for those that do not matter.
        clear: whether paths (n, d, 3) that are wanted (n), not 0, are free.
    """

    def free_paths(of: Longs, points: Floats) -> Bools:
        out = np.empty((len(of), *path.shape[1:]))
        bounces.legs(beams.paths, planar.normals, planar.offsets, antennas.origins, of, points, out)
        return clear(out, np.ones(len(of)))

    out = clear(path, strong.level).astype(complex)
    zones = _strongest(beams, path, strong, NEAR * context.spec.wavelength_m, out != 0, free_paths)
    many = len(zones.paths)

    def reached(of: Longs, points: Floats) -> Bools:
        return free_paths(zones.paths[of], points)

    if not many:
        return out
    asked, places = np.empty((many, RAYS, CELLS)), np.empty((many * RAYS * CELLS, 3))
    kernel.places(zones.lit, zones.axes, zones.ends, _turn(FINE * RAYS), LAST, asked, places)
    free = reached(np.repeat(np.arange(many), RAYS * CELLS), places).reshape(many, RAYS, CELLS)
    borders = _borders(zones, asked, free, reached)
    found = np.empty(many, complex)
    kernel.parts(free, borders, zones.ends, LAST, np.empty((RAYS, CELLS)), np.empty(RAYS, np.int64), found)
    out[zones.paths] = found
    return out


def _borders(zones: Zones, asked: Floats, free: Bools, clear: Callable[[Longs, Floats], Bools]) -> Floats:
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


def strengths(
    context: RadarContext, planar: PlanarPatches, antennas: AntennaPair, beams: Beams, path: Floats, factor: Complexes
) -> Strengths:
    """How strong paths (b, d, 3) would be of which reflections leave a factor (b), 0 where it does not matter."""
    out = Strengths(np.empty(len(path)), np.empty(len(path)), np.empty((len(path), 2, 3)))
    ends = kernel.BeamEnds(beams.images, antennas.origins[1], beams.ends_on)
    faces = kernel.FacePlanes(planar.normals, planar.offsets, planar.across)
    kernel.strengths(path, ends, faces, factor, context.antennas(antennas), 2 * np.pi / context.spec.wavelength_m, out,
                     np.empty((2, 3)))  # fmt: skip
    return out


def _strongest(
    beams: Beams, path: Floats, strong: Strengths, near_m: float, free: Bools, clear: Callable[[Longs, Floats], Bools]
) -> Zones:
    """Choose the paths over mirror points whose shadow matters most, and lay out their zones.

    They would be the strongest if nothing stood in their way, and a border of shadow crosses their zone. `free` tells
    whether paths (b) are free at their mirror points, `clear` whether paths (n) over other points (n, 3) are.
    """
    level = strong.level * (strong.excess < near_m)
    some = np.argsort(-level)[: 2 * BEST]  # laying out a zone costs more than telling these
    some = some[level[some] > 0]
    lit, axes, level = path[some, -2], strong.axes[some], level[some]
    rough = np.empty((len(some), RAYS))
    kernel.outline(lit, axes, some, beams.first, beams.edges, _turn(RAYS), LAST, rough)
    counts = np.empty(len(some), complex)
    kernel.whole(rough, LAST, counts)
    level *= abs(counts)
    loud = level > FAINT * level.max(initial=0.0)
    order = np.flatnonzero(loud)
    if len(order) > BEST:
        even = _even(some[order], lit[order], axes[order], rough[order], free, clear)
        order = order[np.argsort(-level[order] * np.where(even, EVEN, 1.0))[:BEST]]
    ends = np.empty((len(order), FINE * RAYS))
    some, lit, axes = some[order], lit[order], axes[order]
    kernel.outline(lit, axes, some, beams.first, beams.edges, _turn(FINE * RAYS), LAST, ends)
    return Zones(some, lit, axes, ends)


def _even(
    some: Longs, lit: Floats, axes: Floats, rough: Floats, free: Bools, clear: Callable[[Longs, Floats], Bools]
) -> Bools:
    """Whether paths `some` (k) are free, or hidden, alike at their mirror points and at four points around these.

    Args:
        some: (k) paths.
        lit: (k, 3) mirror points [m].
        axes: (k, 2, 3) as in `Zones`.
        rough: (k, RAYS) phases at which the lit part of the last face ends [rad].
        free: (b) whether paths are free at their mirror points.
        clear: whether paths (n) over other points (n, 3) are free.
    """
    rays = np.arange(0, RAYS, RAYS // 4)
    turn = np.sqrt(np.minimum(np.pi, 0.8 * rough[:, rays]))[:, :, None] * _turn(RAYS)[rays]
    points = lit[:, None] + np.einsum("kra,kai->kri", turn, axes)
    there = clear(np.repeat(some, len(rays)), points.reshape(-1, 3)).reshape(len(some), -1)
    return np.asarray((there == free[some][:, None]).all(1))
