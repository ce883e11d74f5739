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


def fermat() -> None:
    """The kernels of `fermat`, from one point over a ball to another."""
    from ullage.kernels import fermat as kernel
    from ullage.radar.fermat import fermat_paths
    from ullage.radar.quadrics import Quadric
    from ullage.radar.reflectors import bodies_of, joined, points_of

    ball = Quadric(np.zeros(3), np.eye(3), 0.3, -0.3, 0.3, 0.0, 0.1, 0, is_sphere=True)
    surfaces = joined([points_of(np.ones((2, 3))), bodies_of((ball,))]).surfaces
    chains = kernel.Chains(np.array([[0, 2, 1]]), np.ones(1))
    kernel.may_be_strong(surfaces, chains, kernel.Limits(1.0, 1.0), np.empty(1, np.int64))
    kernel.settle(surfaces, chains.rows, fermat_paths(surfaces, chains.rows).corners, np.empty(3))


def chains() -> None:
    """The kernels of `wall_bodies`, on no lines."""
    from ullage.kernels import chains as kernel

    points, least, rows = np.zeros((0, 3)), np.zeros(2), np.zeros((3, 3))
    none, long, wave = np.zeros(0), np.zeros(0, np.int64), np.zeros(0, complex)
    kernel.beside(np.zeros((3, 0, 3)), 0, points, np.zeros(3), none, none, least, rows)
    places = kernel.WallPlaces(long, none, none)
    kernel.sampled(none, none, none > 0, 1.0, 1.0, 1, places)
    kernel.summed(none, none, 1.0, wave, places, wave, none, none)
