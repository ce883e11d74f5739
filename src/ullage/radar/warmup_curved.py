"""Compile the kernels for curved surfaces: each function runs its kernels once on minimal input."""

from __future__ import annotations

import numpy as np


def echoes() -> None:
    """The kernels that all curved surfaces share, on no paths."""
    from ullage.kernels import impulses as kernel
    from ullage.kernels.facets import Antennas, PulseGrid

    none, long = np.zeros(0, complex), np.zeros((1, 0), np.int64)
    pulse = PulseGrid(1.0, 0.0, 1.0, 1.0)
    kernel.impulses(none.real.copy(), none, pulse, (0.5, 0.5), np.zeros((3, 0), complex), none)
    paths = kernel.ReflectedPaths(np.zeros((3, 0, 3)), np.zeros((1, 0, 3)), long)
    antennas = Antennas(np.zeros((1, 2, 3)), np.zeros((1, 2, 3, 3)), np.zeros((1, 2, 3)), np.zeros((6, 2, 2)), False,
                        np.ones(1, complex))  # fmt: skip
    scratch = kernel.FieldScratch(np.zeros((2, 3)), np.zeros(3, complex))
    kernel.polarised(paths, np.zeros((1, 1, 2, 2), complex), antennas, scratch, none)


def pairs() -> None:
    """The kernels of `body_pairs` and `mirrored_pairs`, on no bodies."""
    from ullage.kernels import mirrored_pairs as flat
    from ullage.kernels.pairs import BodyPairs, PairPaths
    from ullage.radar.body_pairs import Bodies, paths_over

    none, points = np.zeros(0), np.zeros((0, 3))
    bodies = Bodies(points, np.zeros((0, 3, 3)), none, np.zeros((0, 2)), none > 0, none, none.astype(np.int32))
    paths_over(np.zeros(3), np.zeros(3), bodies, bodies)
    spots, twos, long = np.zeros((2, 0, 3)), np.zeros((2, 0)), np.zeros(0, np.int64)
    chains = flat.Chains(np.zeros((0, 4), np.int64), none, long)
    mirrors = flat.PlaneMirrors(points, none, bodies.ends)
    things = flat.CurvedBodies(points, bodies.axes, none, bodies.ends, bodies.is_sphere)
    limits, both = flat.Limits(1.0, 1.0, 1.0, 1.0), BodyPairs(spots, np.zeros((2, 0, 3, 3)), twos, twos > 0)
    flat.unfold(chains, np.zeros((2, 3)), mirrors, things, limits, spots, both)
    found = PairPaths(np.zeros((4, 0, 3)), spots, none, none, twos.T.copy())
    out = flat.FoldedPaths(long, none, twos, np.zeros((5, 0, 3)), np.zeros((3, 0, 3)))
    flat.fold(chains, found, both, things, mirrors, limits, out, np.zeros((5, 3)))
    flat.gaps(np.zeros((2, 3)), points, bodies.axes, bodies.ends, bodies.is_sphere, twos)


def chains() -> None:
    """The kernels of `wall_bodies`, on one drum in a wall."""
    from ullage.kernels import chains as kernel
    from ullage.radar.quadrics import Quadric
    from ullage.radar.wall_bodies import WALL_FIRST, lines_over

    wall, drum = (Quadric(np.zeros(3), np.eye(3), radius, -1.0, 1.0, 0.0, 0.1, 0) for radius in (2.0, 0.3))
    lines_over(wall, drum, np.ones((2, 3)), WALL_FIRST)
    none, long, wave = np.zeros(0), np.zeros(0, np.int64), np.zeros(0, complex)
    places = kernel.WallPlaces(long, none, none)
    kernel.sampled(none, none, none > 0, 1.0, 1.0, 1, places)
    kernel.summed(none, none, 1.0, wave, places, wave, none, none)
    kernel.gathered(long, none, long, 1, wave, long, wave)
