"""Echoes over two curved bodies, or one twice, and a large flat face: drums next to a wall, a sphere on a floor.

A flat face mirrors bodies and antennas exactly, and the image of a sphere or a drum is one again. So each path is a
path over two bodies, as in `body_pairs`, with everything behind the face mirrored [AllenBerkley1979].
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Bools, Complexes, Floats, Longs
from ullage.geometry import C0
from ullage.kernels import mirrored_pairs as kernel
from ullage.kernels.pairs import BodyPairs, PairPaths
from ullage.radar.body_pairs import Bodies, bodies_of, largest_bodies, shortest, truncation
from ullage.radar.context import AntennaPair, RadarContext
from ullage.radar.echo_set import EchoSet
from ullage.radar.facets import PlanarPatches, Surfaces
from ullage.radar.multipath import choose_largest
from ullage.radar.paths import FACES, largest
from ullage.radar.quadrics import Quadric
from ullage.radar.reflected_paths import ReflectedPaths, free, reflection_gains
from ullage.radar.wall_bounces import PULL_M, accumulate

FAINT = 2e-3
"""Least amplitude of a chain, as a share of the strongest echo in the frame."""
MOST = 4
"""Number of bodies with the largest apparent sizes that form chains; each fades in."""
BEFORE, BETWEEN, AFTER = 0, 1, 2
"""Position of the face in a path: before both bodies, between them, or after both."""


def accumulate_mirrored_pairs(
    context: RadarContext,
    parts: list[Surfaces],
    quadrics: tuple[Quadric, ...],
    planar: PlanarPatches,
    antennas: AntennaPair,
    sizes: Floats,
    grids: Complexes,
) -> list[EchoSet]:
    """Add the echoes over two bodies and one of the flat faces of the largest apparent sizes (p) to the delay grids.

    Echoes that are too weak against those in the grids are left out.
    """
    bodies = bodies_of(quadrics, np.sqrt(context.spec.wavelength_m * context.gate[1] / 2))
    if not len(bodies.radii):
        return []
    which, weights, _ = largest_bodies(context, bodies, antennas, MOST)
    some = largest(sizes * ~planar.smooth, FACES)
    held, shares = choose_largest(sizes[some], FACES)
    faces = some[held]
    rows, twice = _rows(len(faces), len(which), antennas.monostatic)
    if not len(rows):
        return []
    nth = rows[:, 1]
    rows = np.stack([rows[:, 0], faces[nth], which[rows[:, 2]], which[rows[:, 3]]], 1)
    counts = twice * shares[held][nth] * weights[rows[:, 2]] * weights[rows[:, 3]]
    return _echoes_of(context, parts, planar, antennas, bodies, rows, counts, grids)


@lru_cache(maxsize=64)
def _rows(faces: int, bodies: int, one: bool) -> tuple[Longs, Floats]:
    """List the chains (m, 4): position of the face, face, both bodies; and their multiplicity (m).

    With both antennas in one place (`one`), a chain and its reverse are listed once.
    """
    rows = [(at, face, a, b)
            for at in (BEFORE, BETWEEN, AFTER) for face in range(faces) for a in range(bodies) for b in range(bodies)
            if (a != b or at == BETWEEN) and not (one and (at == AFTER or (at == BETWEEN and a > b)))]  # fmt: skip
    twice = [2.0 if one and not (at == BETWEEN and a == b) else 1.0 for at, _, a, b in rows]
    return np.array(rows, np.int64).reshape(-1, 4), np.array(twice)


def _echoes_of(
    context: RadarContext,
    parts: list[Surfaces],
    planar: PlanarPatches,
    antennas: AntennaPair,
    bodies: Bodies,
    rows: Longs,
    counts: Floats,
    grids: Complexes,
) -> list[EchoSet]:
    """Add the echoes over chains (m, 4) of some multiplicity (m) that are strong enough."""
    least = FAINT * float(abs(grids).max())
    wavelength, top = context.spec.wavelength_m, float(context.table.max()) ** 2
    full, gate = wavelength / (4 * np.pi) * antennas.factor, 2 * context.gate[1]
    faint = least / (abs(full) * top)  # as a spread
    many = len(rows)
    points = np.empty((2, many, 3))
    pairs = BodyPairs(np.empty((2, many, 3)), np.empty((2, many, 3, 3)), np.empty((2, many)),
                      np.empty((2, many), np.bool_))  # fmt: skip
    chosen = kernel.Chains(rows, counts, np.empty(many, np.int64))
    mirrors = kernel.PlaneMirrors(planar.normals, planar.offsets, planar.widths)
    things = kernel.CurvedBodies(bodies.centres, bodies.axes, bodies.radii, bodies.ends, bodies.is_sphere)
    limits = kernel.Limits(gate, faint, wavelength, PULL_M)
    count = kernel.unfold(chosen, antennas.origins, mirrors, things, limits, points, pairs)
    if not count:
        return []
    loud = chosen.loud[:count]
    pairs = BodyPairs(pairs.centres[:, :count].copy(), pairs.axes[:, :count].copy(), pairs.radii[:, :count].copy(),
                      pairs.is_sphere[:, :count].copy())  # fmt: skip
    paths = shortest(points[0, :count], points[1, :count], pairs)
    out = kernel.FoldedPaths(np.empty(count, np.int64), np.empty(count), np.empty((2, count)), np.empty((5, count, 3)),
                             np.empty((3, count, 3)))  # fmt: skip
    found = PairPaths(paths.corners, paths.normals, paths.length, paths.spread, paths.bends)
    left = kernel.fold(chosen._replace(loud=loud), found, pairs, things, mirrors, limits, out, np.empty((5, 3)))
    if not left:
        return []
    some, values, alongs, corners, normals = out
    some = some[:left]
    chains, lengths, value = rows[loud[some]], paths.length[some], full * values[:left]
    for k in range(2):
        body = chains[:, 2 + k]
        value = value * truncation(bodies.ends[body], bodies.is_sphere[body], alongs[k, :left], paths.bends[some, k],
                                   wavelength)  # fmt: skip
    path = _reflected_paths(planar, bodies, chains, corners[:, :left], normals[:, :left])
    value = value * reflection_gains(context, antennas, path)
    value = value * (abs(value) > least) * free(parts, path)
    return [_as_echo_set(context, path, chains[:, 0] == AFTER, lengths, value, grids)]


def _reflected_paths(
    planar: PlanarPatches, bodies: Bodies, chains: Longs, corners: Floats, normals: Floats
) -> ReflectedPaths:
    """Return the paths of chains (n, 4) with the objects that they meet, in the order of the wave."""
    at, face, first, last = chains.T
    many = len(at)
    depths = _met(at, np.zeros(many), bodies.depths[first], bodies.depths[last])
    object_ids = _met(at, planar.object_ids[face], bodies.object_ids[first], bodies.object_ids[last])
    return ReflectedPaths(corners, normals, depths, object_ids, np.ones(many, np.bool_))


def _met(at: Longs, face: NDArray[Any], first: NDArray[Any], last: NDArray[Any]) -> NDArray[Any]:
    """Stack values of a face and both bodies (m) in the order in which waves meet them (3, m)."""
    return np.stack([np.where(at == BEFORE, face, first), np.choose(at, (first, face, last)),
                     np.where(at == AFTER, face, last)])  # fmt: skip


def _as_echo_set(
    context: RadarContext, path: ReflectedPaths, after: Bools, lengths: Floats, value: Complexes, grids: Complexes
) -> EchoSet:
    """Add the echoes of paths (n), some of which meet their face after both bodies."""
    echo = accumulate(context, lengths / C0, value, grids, (0.0, 1.0))
    object_ids = path.object_ids
    via = np.stack([object_ids[0], np.where(after, object_ids[2], object_ids[1])], 1).astype(np.int64)

    def again(factors: Complexes, others: Complexes) -> None:
        accumulate(context, lengths / C0, value * factors, others, (0.0, 1.0))

    points = np.where(after[:, None], path.corners[2], path.corners[3])
    last = np.where(after, object_ids[1], object_ids[2]).astype(np.int32)
    return EchoSet(last, points, echo, lengths / C0, again, via, np.where(after, 1, 2))
