"""References for the physical radar that share no code with it: dense integrals, Mie and Bessel series, images."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.special import jv, spherical_jn, spherical_yn, yv

from ullage.geometry import C0

Floats = NDArray[np.float64]


def wave_number(frequency_hz: float) -> float:
    """2 pi f / c [1/m]."""
    return 2 * np.pi * frequency_hz / C0


def dense_plate(size_m: float, distance_m: float, frequency_hz: float, yaw_deg: float = 0.0) -> complex:
    """Near-field Kirchhoff integral of a conducting square at one frequency, sampled every 2 mm."""
    n = max(round(size_m / 0.002), 20)
    side = (np.arange(n) + 0.5) / n * size_m - size_m / 2
    across, up = np.meshgrid(side, side)
    yaw = np.radians(yaw_deg)
    x, y = distance_m - across * np.sin(yaw), across * np.cos(yaw)
    r = np.sqrt(x * x + y * y + up * up)
    cosine = abs(x * np.cos(yaw) + y * np.sin(yaw)) / r
    total = np.sum(cosine / r**2 * np.exp(-2j * wave_number(frequency_hz) * r))
    return complex(-1j / (4 * np.pi) * total * (size_m / n) ** 2)


def dense_dihedral(edge_m: float, distance_m: float, frequency_hz: float, yaw_deg: float) -> complex:
    """Double bounce of a right dihedral: image in one face, Kirchhoff integral on what it lights of the other."""
    n, k, total = 400, wave_number(frequency_hz), 0j
    yaw = np.radians(yaw_deg)
    fold = np.array([distance_m, 0.0])
    out = [np.array([np.cos(yaw + s * 3 * np.pi / 4), np.sin(yaw + s * 3 * np.pi / 4)]) for s in (1, -1)]
    t = (np.arange(n) + 0.5) / n * edge_m
    up = (np.arange(n) + 0.5) / n * edge_m - edge_m / 2
    for first, last in (out, out[::-1]):
        normal = last  # the first face's normal lies along the other face, and the other way round
        image = -2 * ((-fold) @ normal) * normal
        q = fold + t[:, None] * last
        share = (image - fold) @ normal / ((image - fold) @ normal - (q - fold) @ normal)
        hit = (image - fold) @ first + share * ((q - fold) @ first - (image - fold) @ first)
        lit = (hit > 0) & (hit < edge_m)
        a, b = np.linalg.norm(q - image, axis=1), np.linalg.norm(q, axis=1)
        ra, rb = np.hypot(a[:, None], up), np.hypot(b[:, None], up)
        slope = (abs((q - image) @ first)[:, None] / ra + abs(q @ first)[:, None] / rb) / 2
        total += np.sum(lit[:, None] * slope / ra / rb * np.exp(-1j * k * (ra + rb))) * (edge_m / n) ** 2
    return complex(1j / (4 * np.pi) * total)


def mie_width(radius_m: float, frequency_hz: float) -> float:
    """Radar cross section of a conducting sphere [m^2] [Balanis2012, ch. 11]."""
    x = wave_number(frequency_hz) * radius_m
    n = np.arange(1, int(x + 4 * x ** (1 / 3)) + 10)
    j, y = spherical_jn(n, x), spherical_yn(n, x)
    dj = j + x * spherical_jn(n, x, derivative=True)
    dh = dj - 1j * (y + x * spherical_yn(n, x, derivative=True))
    total = np.sum((-1.0) ** n * (2 * n + 1) * (j / (j - 1j * y) - dj / dh))
    return float(np.pi / wave_number(frequency_hz) ** 2 * abs(total) ** 2)


def wire_gain(radius_m: float, distance_m: float, frequency_hz: float, *, tm: bool) -> float:
    """Path gain amplitude of an endless conducting wire between isotropic antennas [Balanis2012, ch. 11]."""
    k = wave_number(frequency_hz)
    x = k * radius_m
    total = 0j
    for n in range(-int(x + 4 * x ** (1 / 3)) - 10, int(x + 4 * x ** (1 / 3)) + 11):
        if tm:
            j, y = jv(n, x), yv(n, x)
        else:
            j, y = (jv(n - 1, x) - jv(n + 1, x)) / 2, (yv(n - 1, x) - yv(n + 1, x)) / 2
        total += (-1) ** n * j / (j - 1j * y)
    width = 4 / k * abs(total) ** 2
    # the wave spreads in a ring from a spherical source: 1 / r out, 1 / sqrt(2 r) back
    return float(1 / (2 * k) * np.sqrt(width / (4 * np.pi * distance_m**3)))


def keller_strip(width_m: float, distance_m: float, frequency_hz: float, tilt_deg: float, *, soft: bool) -> complex:
    """Tall conducting strip, turned, by Keller's coefficients [Keller1962].

    Two edges, and for the field across them (not `soft`) the wave from edge to edge, each with the stationary part of
    its length.
    """
    k, t = wave_number(frequency_hz), np.radians(tilt_deg)
    along = np.array([-np.sin(t), np.cos(t)])
    total, r, half = 0j, [], []
    for side in (1, -1):
        p = np.array([distance_m, 0.0]) + side * width_m / 2 * along
        r.append(float(np.hypot(*p)))
        phi = np.arccos(side * (p @ along) / r[-1])
        half.append(float(np.cos(phi / 2)))
        edge = (-1 + 1 / np.cos(phi)) / 2 if soft else (1 + 1 / np.cos(phi)) / 2
        reach = np.sqrt(np.pi * r[-1] / k) * np.exp(-1j * np.pi / 4)
        total += edge / (4 * np.pi * k * r[-1] ** 2) * reach * np.exp(-2j * k * r[-1])
    if not soft:
        twice = 2 * np.exp(-1j * np.pi / 4) / np.sqrt(2 * np.pi * k * width_m) / half[0] / half[1]
        reach = np.sqrt(2 * np.pi * r[0] * r[1] / (r[0] + r[1]) / k) * np.exp(-1j * np.pi / 4)
        total -= twice / (4 * np.pi * k * r[0] * r[1]) * reach * np.exp(-1j * k * (r[0] + r[1] + width_m))
    return complex(total)


def shoebox_lengths(size_m: Floats, position_m: Floats, orders: tuple[int, ...], longest_m: float) -> Floats:
    """Path lengths [m] of the image method in a room centred on the origin, source and receiver at one point."""
    found = []
    span = range(-max(orders), max(orders) + 1)
    for cell in itertools.product(span, repeat=3):
        if sum(map(abs, cell)) in orders:
            image = [m * s + (p if m % 2 == 0 else -p) for m, s, p in zip(cell, size_m, position_m, strict=True)]
            found.append(float(np.linalg.norm(np.asarray(image) - position_m)))
    return np.sort([d for d in found if d <= longest_m])
