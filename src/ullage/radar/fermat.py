"""Echoes over sequences of round bodies and flat faces, by Fermat paths.

Each sequence has one path, whose length is stationary over the places of all reflections. Its spread follows from the
integral over all surfaces by stationary phase [BornWolf1999]: the determinant of the second derivatives of the length.
From outside no body focuses, so the determinant is nowhere 0. Fresnel integrals give what the ends of drums leave of
the wave.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise, product

import numpy as np
from scipy.special import fresnel

from ullage.arrays import Bools, Complexes, Floats, Ints, Longs
from ullage.geometry import C0
from ullage.kernels import fermat as kernel
from ullage.radar.context import AntennaPair, RadarContext
from ullage.radar.echo_set import EchoSet
from ullage.radar.facets import PlanarPatches, Surfaces
from ullage.radar.multipath import choose_largest
from ullage.radar.paths import FACES, largest
from ullage.radar.quadrics import Quadric
from ullage.radar.reflected_paths import ReflectedPaths, free, reflection_gains
from ullage.radar.wall_bounces import PULL_M, accumulate


@dataclass(frozen=True, slots=True)
class Selection:
    """What forms the sequences of one number of bounces."""

    bodies: int  # those of the largest apparent sizes; each fades in
    faces: int  # those of the largest apparent sizes, one in each sequence; each fades in
    faint: float  # least amplitude, as a share of the strongest echo in the frame


SELECTIONS = {2: Selection(8, 0, 5e-4), 3: Selection(4, FACES, 2e-3)}
"""Selection for each number of bounces: two bodies, with three bounces a face before them, between them or after."""
_STEPS = 12  # most steps of Newton's method
_ENDS = np.array([0, 1])  # rows of reflectors for both antennas


@dataclass(frozen=True, slots=True, eq=False)
class Bodies:
    """Spheres and drums as reflectors, one per row."""

    surfaces: kernel.Reflectors
    depths: Floats  # (m) largest distance of facets from the surface [m]
    object_ids: Ints  # (m)

    def gaps(self, points: Floats) -> Floats:
        """Return the distances (p, m) of points (p, 3) from the centres of spheres or the axes of drums [m]."""
        _, centres, axes, _, ends = self.surfaces
        away = points[:, None] - centres
        along = (away * axes[:, 2]).sum(2)
        past_end = along - np.clip(along, ends[:, 0], ends[:, 1])
        return np.asarray(np.sqrt(np.maximum((away * away).sum(2) - along**2, 0.0) + past_end**2))


@lru_cache(maxsize=16)
def bodies_of(quadrics: tuple[Quadric, ...]) -> Bodies:
    """Collect quadrics as rows; spheres have no ends."""
    half = np.array([0.0 if r.is_sphere else (r.high - r.low) / 2 for r in quadrics])
    surfaces = kernel.Reflectors(
        kinds=np.array([kernel.SPHERE if r.is_sphere else kernel.CYLINDER for r in quadrics], np.int64),
        centres=np.array([r.centre + (r.low + r.high) / 2 * r.axes[2] for r in quadrics]).reshape(-1, 3),
        axes=np.array([r.axes for r in quadrics]).reshape(-1, 3, 3),
        radii=np.array([r.radius for r in quadrics]),
        extents=np.stack([-half, half], 1),
    )
    object_ids = np.array([r.object_id for r in quadrics], np.int32)
    return Bodies(surfaces, np.array([r.depth for r in quadrics]), object_ids)


def points_of(points: Floats) -> kernel.Reflectors:
    """Return points (n, 3) as reflectors, where paths begin and end."""
    many = len(points)
    return kernel.Reflectors(np.full(many, kernel.SPHERE), points, np.tile(np.eye(3), (many, 1, 1)), np.zeros(many),
                             np.zeros((many, 2)))  # fmt: skip


@lru_cache(maxsize=8)
def planes_of(planar: PlanarPatches) -> kernel.Reflectors:
    """Return flat faces as reflectors."""
    across = np.cross(planar.normals, np.eye(3)[abs(planar.normals).argmin(1)])
    across /= np.linalg.norm(across, axis=1)[:, None]
    axes = np.stack([across, np.cross(planar.normals, across), planar.normals], 1)
    points, many = planar.offsets[:, None] * planar.normals, len(planar)
    return kernel.Reflectors(np.full(many, kernel.PLANE), points, axes, np.zeros(many), planar.widths)


def taken(surfaces: kernel.Reflectors, which: Longs) -> kernel.Reflectors:
    """Select some reflectors."""
    kinds, centres, axes, radii, extents = surfaces
    return kernel.Reflectors(kinds[which], centres[which], axes[which], radii[which], extents[which])


def joined(parts: Sequence[kernel.Reflectors]) -> kernel.Reflectors:
    """Join lists of reflectors."""
    return kernel.Reflectors(*(np.concatenate(rows) for rows in zip(*parts, strict=True)))


def fermat_paths(surfaces: kernel.Reflectors, rows: Longs, *, follow: bool = False) -> kernel.FermatPaths:
    """Find the stationary path over each sequence (n, s + 2) of reflectors, of points where it begins and ends too.

    With `follow`, each search begins where the path before was found.
    """
    many, count = rows.shape[1] - 2, len(rows)
    out = kernel.FermatPaths(np.empty((many + 2, count, 3)), np.empty((many, count, 3)), np.empty(count),
                             np.empty(count), np.empty((many, count)))  # fmt: skip
    scratch = kernel.Scratch(np.empty((4, 3, 3)), np.empty((4, 4)), np.empty((6, 10)), np.empty((3, 3)))
    kernel.stationary(surfaces, rows, follow, _STEPS, out, scratch)
    return out


def accumulate_fermat(
    context: RadarContext, parts: list[Surfaces], quadrics: tuple[Quadric, ...], planar: PlanarPatches,
    antennas: AntennaPair, most: int, sizes: Floats, grids: Complexes,
) -> list[EchoSet]:  # fmt: skip
    """Add the echoes of two to `most` bounces over round bodies, and flat faces of apparent `sizes` (p), to the grids.

    Echoes that are too weak against those in the grids are left out.
    """
    narrow = np.sqrt(context.spec.wavelength_m * context.gate[1] / 2)
    bodies = bodies_of(tuple(r for r in quadrics if r.widest < narrow))
    if not len(bodies.object_ids):
        return []
    gaps = bodies.gaps(antennas.origins)
    radii = bodies.surfaces.radii
    seen = np.where(gaps.min(0) < context.gate[1] + radii, radii / np.maximum(gaps.max(0), 1e-6), 0.0)
    out: list[EchoSet] = []
    for bounces in range(2, most + 1):
        out += _of_order(context, parts, bodies, planar, antennas, bounces, (seen, sizes), grids)
    return out


def _of_order(
    context: RadarContext, parts: list[Surfaces], bodies: Bodies, planar: PlanarPatches, antennas: AntennaPair,
    bounces: int, sizes: tuple[Floats, Floats], grids: Complexes,
) -> list[EchoSet]:  # fmt: skip
    """Add the echoes of some number of bounces; `sizes` are the apparent ones of bodies and faces."""
    chosen = SELECTIONS[bounces]
    which, weights = choose_largest(sizes[0], chosen.bodies)
    some = largest(sizes[1] * ~planar.smooth, chosen.faces)
    held, shares = choose_largest(sizes[1][some], chosen.faces)
    faces = some[held]
    rows, counts = _sequences(bounces, len(faces), len(which), antennas.monostatic)
    if not len(rows):
        return []
    surfaces = joined([points_of(antennas.origins), taken(planes_of(planar), faces), bodies.surfaces])
    numbers = np.concatenate([_ENDS, 2 + np.arange(len(faces)), 2 + len(faces) + which])
    factors = np.concatenate([[1.0, 1.0], shares[held], weights[which]])
    depths = np.concatenate([[0.0, 0.0], np.zeros(len(faces)), bodies.depths])
    object_ids = np.concatenate([[-1, -1], planar.object_ids[faces], bodies.object_ids]).astype(np.int64)
    chains = kernel.Chains(numbers[rows], counts * factors[rows].prod(1))
    return _echoes_of(context, parts, antennas, _Met(surfaces, depths, object_ids), chains, chosen.faint, grids)


@lru_cache(maxsize=64)
def _sequences(bounces: int, faces: int, bodies: int, one: bool) -> tuple[Longs, Floats]:
    """List the sequences (n, bounces + 2) of two bodies and faces, and how often each counts (n).

    They begin and end with the antennas, 0 and 1; faces follow, and then bodies. With both antennas in one place
    (`one`), a sequence and its reverse are listed once.
    """
    flat, things = set(range(2, 2 + faces)), range(2, 2 + faces + bodies)
    found = [row for row in product(things, repeat=bounces) if sum(k in flat for k in row) <= bounces - 2
             and all(a != b for a, b in pairwise(row)) and not (one and row > row[::-1])]  # fmt: skip
    counts = [2.0 if one and row != row[::-1] else 1.0 for row in found]
    return np.array([(0, *row, 1) for row in found], np.int64).reshape(-1, bounces + 2), np.array(counts)


@dataclass(frozen=True, slots=True, eq=False)
class _Met:
    """All reflectors (r) of a frame."""

    surfaces: kernel.Reflectors
    depths: Floats  # (r) largest distance of facets from the surface [m]
    object_ids: Longs  # (r)


def _echoes_of(
    context: RadarContext, parts: list[Surfaces], antennas: AntennaPair, met: _Met, chains: kernel.Chains,
    faint: float, grids: Complexes,
) -> list[EchoSet]:  # fmt: skip
    """Add the echoes over chains (n) that are strong enough."""
    least, wavelength = faint * float(abs(grids).max()), context.spec.wavelength_m
    full = wavelength / (4 * np.pi) * antennas.factor
    limits = kernel.Limits(2 * context.gate[1], least / (abs(full) * float(context.table.max()) ** 2))
    some = np.empty(len(chains.rows), np.int64)
    some = some[: kernel.may_be_strong(met.surfaces, chains, limits, some)]
    rows, counts = chains.rows[some], chains.counts[some]
    paths = fermat_paths(met.surfaces, rows)
    value = counts * paths.spreads * (paths.lengths < limits.gate)
    some = np.flatnonzero(value > limits.least)
    corners, rows = paths.corners[:, some], rows[some]
    left = value[some] * end_factors(met.surfaces, rows, corners, paths.bends[:, some], wavelength)
    within_ends(met.surfaces, rows, corners)
    left *= _covered(met.surfaces, rows, corners, wavelength)
    strong = np.flatnonzero(abs(left) > limits.least)  # most are not, and need no rays
    if not len(strong):
        return []
    on = rows[strong, 1:-1].T
    path = ReflectedPaths(corners[:, strong], paths.normals[:, some[strong]], met.depths[on], met.object_ids[on],
                          np.ones(len(strong), np.bool_))  # fmt: skip
    echo = full * left[strong] * reflection_gains(context, antennas, path)
    echo *= (abs(echo) > least) * free(parts, path)
    flat = met.surfaces.kinds[on] == kernel.PLANE
    return [_as_echo_set(context, path, flat, paths.lengths[some[strong]], echo, grids)]


def end_factors(
    surfaces: kernel.Reflectors, rows: Longs, corners: Floats, bends: Floats, wavelength: float
) -> Complexes:
    """Compute what the ends of drums and walls leave of waves (n), by Fresnel integrals along the axes.

    Args:
        surfaces: the reflectors; those without ends have infinite ones.
        rows: (n, s + 2) reflectors of the paths.
        corners: (s + 2, n, 3) of the paths, also past the ends [m].
        bends: (s, n) second derivatives of the lengths along the axes [1/m].
        wavelength: [m].
    """
    on = rows[:, 1:-1].T
    along = ((corners[1:-1] - surfaces.centres[on]) * surfaces.axes[on, 2]).sum(2)
    ended = _ended(surfaces.kinds[on])
    root = np.sqrt(np.where(ended, np.maximum(2 * bends, 0.0), 0.0) / wavelength)
    sine, cosine = fresnel((surfaces.extents[on] - along[..., None]) * root[..., None])
    return np.asarray(np.where(ended, np.diff(cosine - 1j * sine, axis=2)[..., 0] / (1 - 1j), 1.0).prod(0))


def within_ends(surfaces: kernel.Reflectors, rows: Longs, corners: Floats) -> None:
    """Move corners (s + 2, n, 3) past the ends of drums and walls onto these; those on planes follow."""
    on = rows[:, 1:-1].T
    axes, ends = surfaces.axes[on, 2], surfaces.extents[on]
    along = ((corners[1:-1] - surfaces.centres[on]) * axes).sum(2)
    inner = np.clip(along, ends[..., 0] + PULL_M, ends[..., 1] - PULL_M)
    corners[1:-1] += np.where(_ended(surfaces.kinds[on]), inner - along, 0.0)[..., None] * axes
    kernel.settle(surfaces, rows, corners, np.empty(3))


def _ended(kinds: Longs) -> Bools:
    """Tell which reflectors end along an axis."""
    return np.asarray((kinds == kernel.LINE) | (kinds == kernel.CYLINDER))


def _covered(surfaces: kernel.Reflectors, rows: Longs, corners: Floats, wavelength: float) -> Floats:
    """Compute the shares of waves (n) that planes reflect if they do not cover the Fresnel zones."""
    on, legs = rows[:, 1:-1].T, np.linalg.norm(np.diff(corners, axis=0), axis=2)
    zones = np.sqrt(wavelength / (1 / legs[:-1] + 1 / legs[1:]))
    shares = np.minimum(surfaces.extents[on] / zones[..., None], 1.0).prod(2)
    return np.asarray(np.where(surfaces.kinds[on] == kernel.PLANE, shares, 1.0).prod(0))


def _as_echo_set(
    context: RadarContext, path: ReflectedPaths, flat: Bools, lengths: Floats, value: Complexes, grids: Complexes
) -> EchoSet:
    """Add the echoes of paths (n) whose reflectors (s, n) are `flat` or bodies: the last body scatters the wave."""
    echo = accumulate(context, lengths / C0, value, grids, (0.0, 1.0))
    many, count = flat.shape
    at, each = many - 1 - (~flat[::-1]).argmax(0), np.arange(count)
    via = np.full((count, 2), -1, np.int64)
    for s in range(many - 1):
        via[:, s] = path.object_ids[np.where(at <= s, s + 1, s), each]

    def again(factors: Complexes, others: Complexes) -> None:
        accumulate(context, lengths / C0, value * factors, others, (0.0, 1.0))

    points, object_ids = path.corners[1 + at, each], path.object_ids[at, each].astype(np.int32)
    return EchoSet(object_ids, points, echo, lengths / C0, again, via, at)
