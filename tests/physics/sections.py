"""A method of moments in two dimensions for cross-sections of perfect conductors, the field along the cylinder (TM).

Pulses expand the current and points test the field [Harrington1993, ch. 3]. A line source illuminates the section and
receives its echo. Far from all surfaces a point source in front of the same section, drawn out along the third axis,
has the same echoes, weaker by the square root of each path's length.

`python tests/physics/sections.py` writes the golden numbers of `SECTIONS`.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.special import j0, y0

C0 = 299_792_458.0
GOLDEN = Path(__file__).parent / "golden/sections.npz"
FREQUENCIES_HZ = np.arange(5.8e9, 8.8e9, 3.75e7)
LENGTHS_M = np.arange(0.4, 7.6, 0.01)
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)


def flanged(*heights):
    """Webs of .3 m with flanges of .1 m, on a wall of 2.4 m."""
    webs = [line for y in heights for line in (((2, y), (1.7, y)), ((1.7, y - 0.05), (1.7, y + 0.05)))]
    return [((2, -1.2), (2, 1.2)), *webs]


SECTIONS = {  # lines [m], pipes with radius [m], place of the radar [m]
    "corner": ([((2, -1.2), (2, 0.8)), ((0.2, 0.8), (2, 0.8))], [], (0.6, -0.3)),
    "corner with a pipe in it": ([((2, -1.2), (2, 0.8)), ((0.2, 0.8), (2, 0.8))], [((1.5, -0.5), 0.06)], (0.6, 0.1)),
    "flanged webs": (flanged(-0.6, 0.0, 0.6), [], (0.5, 0.17)),
    "flanged webs, slanted": (flanged(-0.6, 0.0, 0.6), [], (0.8, -1.0)),
    "pipe before a wall": ([((2, -1.2), (2, 1.2))], [((1.5, 0.0), 0.03)], (0.5, 0.0)),
    "pipe before a wall, aside": ([((2, -1.2), (2, 1.2))], [((1.5, 0.3), 0.03)], (0.5, 0.0)),
}


def response(name, frequency_hz, per_wave=10.0):
    """Echo of a section at one frequency, on the scale of a path gain: times the root of the path's length [m^.5]."""
    lines, pipes, at = SECTIONS[name]
    for centre, radius in pipes:
        turn = np.linspace(0, 2 * np.pi, 49)
        ring = np.array(centre) + radius * np.stack([np.cos(turn), np.sin(turn)], 1)
        lines = [*lines, *pairwise(ring)]
    k, starts, ends = 2 * np.pi * frequency_hz / C0, [], []
    for one, other in np.array(lines, float):
        count = max(int(np.ceil(np.hypot(*(other - one)) * per_wave * frequency_hz / C0)), 2)
        corners = one + np.linspace(0, 1, count + 1)[:, None] * (other - one)
        starts, ends = [*starts, corners[:-1]], [*ends, corners[1:]]
    start, end = np.concatenate(starts), np.concatenate(ends)
    middle, half = (start + end) / 2, (end - start) / 2
    size = 2 * np.hypot(*half.T)
    matrix, back = np.zeros((len(size), len(size)), complex), np.zeros(len(size), complex)
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        points = middle + node * half
        apart = np.hypot(middle[:, None, 0] - points[:, 0], middle[:, None, 1] - points[:, 1])
        np.fill_diagonal(apart, 1.0)
        matrix += weight / 2 * size * _hankel(k * apart)
        back += weight / 2 * size * _hankel(k * np.hypot(*(points - at).T))
    own = 1 - 2j / np.pi * (np.log(k * size * np.exp(np.euler_gamma) / 4) - 1)  # [Harrington1993, eq. 3-14]
    matrix[np.diag_indices(len(size))] = size * own
    current = np.linalg.solve(matrix, -_hankel(k * np.hypot(*(middle - at).T)))
    line = 0.25 * np.sqrt(2 / (np.pi * k)) * np.exp(-0.25j * np.pi)  # a line source at 1 m, its phase left out
    return -0.25j * (back @ current) / (4 * np.pi * line) * C0 / frequency_hz


def delays(values):
    """Envelope over the path's length (n) of responses (f), by a Gaussian band."""
    middle = FREQUENCIES_HZ.mean()
    band = np.exp(-0.5 * ((FREQUENCIES_HZ - middle) / 0.55e9) ** 2)
    turn = np.exp(2j * np.pi * FREQUENCIES_HZ * LENGTHS_M[:, None] / C0)
    return turn @ (values * band / band.sum())


def _hankel(x):
    return j0(x) - 1j * y0(x)


if __name__ == "__main__":
    np.savez(GOLDEN, **{name: [response(name, f) for f in FREQUENCIES_HZ] for name in SECTIONS})
