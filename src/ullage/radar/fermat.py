"""Echoes over sequences of round bodies and flat faces, by Fermat paths.

Each sequence has one path, whose length is stationary over the places of all reflections. Its spread follows from the
integral over all surfaces by stationary phase [BornWolf1999]: the determinant of the second derivatives of the length.
From outside no body focuses, so the determinant is nowhere 0. Fresnel integrals give what the ends of drums leave of
the wave.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise, product

import numpy as np

from ullage.arrays import Floats, Longs
from ullage.kernels import fermat as kernel
from ullage.radar.context import RadarFrame
from ullage.radar.echo_set import EchoSet
from ullage.radar.multipath import choose_largest
from ullage.radar.paths import FACES, largest
from ullage.radar.reflected_paths import PathSum, ReflectedPaths, accumulate_paths, end_factors, free, reflection_gains
from ullage.radar.reflectors import ReflectorSet, bodies_of, faces_of, joined, points_of


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


def accumulate_fermat(frame: RadarFrame) -> list[EchoSet]:
    """Add the echoes of two bounces and more over round bodies and flat faces to the delay grids.

    Echoes that are too weak against those in the grids are left out.
    """
    context, origins = frame.context, frame.antennas.origins
    bodies = bodies_of(tuple(r for r in frame.quadrics if r.widest < context.widest_m))
    if not len(bodies):
        return []
    gaps, radii = bodies.gaps(origins), bodies.surfaces.radii
    seen = np.where(gaps.min(0) < context.gate[1] + radii, radii / np.maximum(gaps.max(0), 1e-6), 0.0)
    out: list[EchoSet] = []
    for bounces in range(2, min(frame.max_bounces, max(SELECTIONS)) + 1):
        out += _of_order(frame, bodies, bounces, seen)
    return out


def _of_order(frame: RadarFrame, bodies: ReflectorSet, bounces: int, seen: Floats) -> list[EchoSet]:
    """Add the echoes of some number of bounces; `seen` are the apparent sizes of bodies."""
    chosen, sizes = SELECTIONS[bounces], frame.sizes
    which, weights = choose_largest(seen, chosen.bodies)
    some = largest(sizes * ~frame.planar.smooth, chosen.faces)
    held, shares = choose_largest(sizes[some], chosen.faces)
    faces = some[held]
    rows, counts = _sequences(bounces, len(faces), len(which), frame.antennas.reversible)
    if not len(rows):
        return []
    met = joined([points_of(frame.antennas.origins), faces_of(frame.planar).take(faces), bodies])
    numbers = np.concatenate([_ENDS, 2 + np.arange(len(faces)), 2 + len(faces) + which])
    factors = np.concatenate([[1.0, 1.0], shares[held], weights[which]])
    chains = kernel.Chains(numbers[rows], counts * factors[rows].prod(1))
    return _echoes_of(frame, met, chains, chosen.faint)


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


def _echoes_of(frame: RadarFrame, met: ReflectorSet, chains: kernel.Chains, faint: float) -> list[EchoSet]:
    """Add the echoes over chains (n) that are strong enough."""
    context, antennas = frame.context, frame.antennas
    least, wavelength = faint * float(abs(frame.grids).max()), context.spec.wavelength_m
    full = wavelength / (4 * np.pi) * antennas.factor
    limits = kernel.Limits(2 * context.gate[1], least / (abs(full) * context.loudest))
    some = np.empty(len(chains.rows), np.int64)
    some = some[: kernel.may_be_strong(met.surfaces, chains, limits, some)]
    rows, counts = chains.rows[some], chains.counts[some]
    paths = fermat_paths(met.surfaces, rows)
    value = counts * paths.spreads * (paths.lengths < limits.gate)
    some = np.flatnonzero(value > limits.least)
    path = ReflectedPaths(paths.corners, paths.normals, rows[:, 1:-1].T, paths.bends, met, value > 0).take(some)
    left = value[some] * end_factors(path, wavelength)
    path = path.within_ends()
    kernel.settle(met.surfaces, rows[some], path.corners, np.empty(3))  # those on planes follow
    left *= _covered(path, wavelength)
    strong = np.flatnonzero(abs(left) > limits.least)  # most are not, and need no rays
    if not len(strong):
        return []
    path = path.take(strong)
    echo = full * left[strong] * reflection_gains(context, antennas, path)
    echo *= (abs(echo) > least) * free(frame.parts, path)
    each = np.arange(len(strong))
    return [accumulate_paths(frame, path, PathSum(paths.lengths[some[strong]], echo, each, each, (0.0, 1.0)))]


def _covered(path: ReflectedPaths, wavelength: float) -> Floats:
    """Compute the shares of waves (n) that planes reflect if they do not cover the Fresnel zones."""
    legs = np.linalg.norm(np.diff(path.corners, axis=0), axis=2)
    zones = np.sqrt(wavelength / (1 / legs[:-1] + 1 / legs[1:]))
    shares = np.minimum(path.reflectors.surfaces.extents[path.on] / zones[..., None], 1.0).prod(2)
    return np.asarray(np.where(path.reflectors.flat[path.on], shares, 1.0).prod(0))
