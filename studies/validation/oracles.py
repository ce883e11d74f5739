"""Independent references for the physical radar: dense integrals, Mie and Bessel series, the image method."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.fft import next_fast_len
from scipy.special import h2vp, hankel2, jv, jvp, spherical_jn, spherical_yn, yv

from ullage.arrays import Floats
from ullage.geometry import C0


def wave_number(frequency_hz: float) -> float:
    """Return 2 pi f / c [1/m]."""
    return 2 * np.pi * frequency_hz / C0


def dense_plate(size_m: float, distance_m: float, frequency_hz: float, yaw_deg: float = 0.0) -> complex:
    """Compute the near-field Kirchhoff integral of a conducting square at one frequency, sampled every 2 mm."""
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
    """Compute the double bounce of a dihedral: image in one face, Kirchhoff integral over the lit part of the other."""
    n, k, total = 400, wave_number(frequency_hz), 0j
    yaw = np.radians(yaw_deg)
    fold = np.array([distance_m, 0.0])
    out = [np.array([np.cos(yaw + s * 3 * np.pi / 4), np.sin(yaw + s * 3 * np.pi / 4)]) for s in (1, -1)]
    t = (np.arange(n) + 0.5) / n * edge_m
    up = (np.arange(n) + 0.5) / n * edge_m - edge_m / 2
    for first, last in (out, out[::-1]):
        normal = last  # the normal of each face lies along the other face
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


def dense_tank(
    strips: int, radius_m: float, height_m: float, position_m: Floats, frequency_hz: float
) -> tuple[complex, complex]:
    """Compute echoes over floor and wall, and over floor, wall and floor, of a conducting tank of flat strips.

    Kirchhoff integrals over the wall run from the image in the floor to the radar, in both directions, and to the
    image, sampled every centimetre. The field is horizontal, along y.
    """
    k, step, total = wave_number(frequency_hz), 0.01, [0j, 0j]
    angle = 2 * np.pi * np.arange(strips + 1) / strips
    up = (np.arange(round(height_m / step)) + 0.5) * step
    for p, q in itertools.pairwise(radius_m * np.stack([np.cos(angle), np.sin(angle)], 1)):
        width = float(np.linalg.norm(q - p))
        along = p + (np.arange(n := int(width / step) + 1) + 0.5)[:, None] / n * (q - p)
        points = np.concatenate([np.repeat(along, len(up), 0), np.tile(up, n)[:, None]], 1)
        normal = np.array([q[1] - p[1], p[0] - q[0], 0]) / width
        for which, ends in enumerate(((-1, 1), (-1, -1))):
            path, directions, fields = np.zeros(len(points)), [], []
            spread = np.full(len(points), width * height_m / len(points))
            for end in ends:
                mirror = np.array([1, 1, end])
                ray = points - position_m * mirror
                size = np.linalg.norm(ray, axis=1)
                path, spread, direction = path + size, spread / size, ray / size[:, None]
                field = np.array([0.0, 1, 0]) - direction[:, 1:2] * direction * mirror  # as sent, before the floor
                field *= end * mirror / np.linalg.norm(field, axis=1)[:, None]  # a conductor keeps the normal part
                directions.append(direction)
                fields.append(field)
            half = directions[0] + directions[1]
            half /= np.linalg.norm(half, axis=1)[:, None]
            back = 2 * np.sum(fields[0] * half, 1)[:, None] * half - fields[0]
            slope = abs((directions[0] + directions[1]) @ normal) / 2 * np.sum(back * fields[1], 1)
            total[which] += (2 if which == 0 else 1) * np.sum(slope * spread * np.exp(-1j * k * path))
    return complex(1j / (4 * np.pi) * total[0]), complex(1j / (4 * np.pi) * total[1])


def tank_and_drum(
    radius_m: float, drum: tuple[float, float, float], position_m: Floats, frequency_hz: float, *, twice: bool,
    soft: bool = True,
) -> complex:  # fmt: skip
    """Compute the echo over the wall of a cylindrical tank and a vertical conducting drum in it, in two dimensions.

    The drum uses its exact series [Balanis2012, ch. 11]. The wall uses Kirchhoff's integral, with the mean obliquity of
    an electric and a magnetic wall. The spread along the axis is not included: for a path of length P, divide by the
    square root of P.

    Args:
        radius_m: of the tank, about the origin [m].
        drum: its centre (x, y) and its radius [m].
        position_m: (2) the radar [m].
        frequency_hz: [Hz].
        twice: path from the drum to the wall and back to the drum; else over wall and drum, once in each direction.
        soft: whether the field is vertical, along the drum; else horizontal.
    """
    k, step = wave_number(frequency_hz), 1e-4
    angle = 2 * np.pi * np.arange(count := int(8 * k * radius_m)) / count
    out, middle = np.stack([np.cos(angle), np.sin(angle)], 1), np.array(drum[:2])
    sizes = radius_m + step * np.array([-1.0, 0.0, 1.0])
    x, y = np.moveaxis(sizes[:, None, None] * out - middle, 2, 0)
    x_from, y_from = position_m - middle
    apart = np.arctan2(y, x) - np.arctan2(y_from, x_from)
    near, far = k * np.hypot(x_from, y_from), k * np.hypot(x, y)
    before, wave = [hankel2(-1, near), hankel2(-1, far)], [hankel2(0, near), hankel2(0, far)]
    bessel, hankel = (jv, hankel2) if soft else (jvp, h2vp)
    total = np.zeros(far.shape, complex)
    for n in range(int(k * drum[2] + 6 * (k * drum[2]) ** (1 / 3) + 12)):
        share = (2 if n else 1) * bessel(n, k * drum[2]) / hankel(n, k * drum[2])
        total -= share * wave[0] * wave[1] * np.cos(n * apart)
        wave, before = [2 * n / at * w - b for at, w, b in zip((near, far), wave, before, strict=True)], wave
    inner, drums, outer = total * np.sqrt(np.pi * k / 2) * np.exp(-0.25j * np.pi)
    slope = 1j * (outer - inner) / (2 * step * k)  # the wave times cos(incidence)
    direction = radius_m * out - position_m
    gap = np.linalg.norm(direction, axis=1)
    sent, cosine = np.exp(-1j * k * gap) / np.sqrt(gap), (direction * out).sum(1) / gap
    each = drums * slope if twice else sent * (cosine * drums + slope)
    unit = np.sqrt(1j * k / (2 * np.pi)) * 2 * np.pi * radius_m / count / (2 * k)
    return complex(each.sum() * unit * (-1 if soft else 1))


def dense_walls(
    radius_m: float, height_m: float, position_m: Floats, frequency_hz: float, bounces: int, *,
    to_m: Floats | None = None, level: bool = False,
) -> complex:  # fmt: skip
    """Compute bounces from wall to wall of a vertical conducting cylinder above z = 0 by iterated physical optics.

    The currents that a wave induces on the wall radiate to the whole wall and induce currents there. The scalar form
    has samples a third of a wavelength apart; on a cylinder each step is a convolution. The field is vertical, or
    horizontal along y (`level`). Obliquity is the mean of an electric and a magnetic wall, which agree at stationary
    points.

    Args:
        radius_m: [m].
        height_m: [m].
        position_m: (3) the radar, from the lower end of the axis [m].
        frequency_hz: [Hz].
        bounces: 1 or more.
        to_m: (3) the receiver; None: the same place [m].
        level: whether the field is horizontal.
    """
    k = wave_number(frequency_hz)
    n, m = (next_fast_len(int(np.ceil(3 * k * size / (2 * np.pi)))) for size in (2 * np.pi * radius_m, height_m))
    angle, step = 2 * np.pi * np.arange(n) / n, height_m / m
    up, out = (np.arange(m) + 0.5) * step, np.stack([np.cos(angle), np.sin(angle)], 1)
    unit, fields = 1j * k / (2 * np.pi) * (2 * np.pi * radius_m / n) * step, []
    for place in (position_m, position_m if to_m is None else to_m):
        direction = radius_m * out - place[:2]
        r = np.sqrt((direction * direction).sum(1)[:, None] + (up - place[2]) ** 2)
        field = np.sign(direction[:, :1]) if level else 1.0  # component across the direction, with the sign along y
        fields.append((field * np.exp(-1j * k * r) / r, (direction * out).sum(1)[:, None] / r))
    (sent, cosine), (received, back) = fields
    chord, rise = 2 * radius_m * abs(np.sin(angle / 2))[:, None], np.arange(-m, m) * step
    r = np.sqrt(chord**2 + rise**2)
    r[0, m] = 1.0
    across = np.exp(-1j * k * r) / r * chord**2 / (2 * radius_m) / r
    spectrum, total = np.fft.fft2(np.roll(across, m, 1)), 0j
    for first, last in ((cosine, 1.0), (1.0, back)):
        wave = sent * first
        for _ in range(bounces - 1):
            wave = unit * np.fft.ifft2(np.fft.fft2(wave, (n, 2 * m)) * spectrum)[:, :m]
        total += unit * np.sum(wave * received * last) / 2
    return complex(total / (2 * k) * (-1 if level else (-1) ** bounces))


def dense_sphere(radius_m: float, away_m: float, frequency_hz: float, bounces: int) -> complex:
    """Compute bounces from wall to wall inside a conducting sphere by iterated physical optics, in scalar form.

    Symmetry about the line from the centre to the radar makes the currents rings, a fifth of a wavelength apart. The
    reflection coefficient is 1. Obliquity is the mean of an electric and a magnetic wall, which agree at stationary
    points.

    Args:
        radius_m: [m].
        away_m: distance of the radar from the centre [m].
        frequency_hz: [Hz].
        bounces: 1 or more.
    """
    wave, away = wave_number(frequency_hz) * radius_m, away_m / radius_m
    x, shares = np.polynomial.legendre.leggauss(int(2.5 * wave))
    s, turn = np.sqrt(1 - x * x), (np.arange(2 * len(x)) + 0.5) * np.pi / (2 * len(x))
    far = np.sqrt(1 + away * away - 2 * away * x)
    sent, slope = np.exp(-1j * wave * far) / far, (1 - away * x) / far
    rings = np.empty((len(x), len(x)), complex)
    for i in range(len(x) if bounces > 1 else 0):
        gap = np.sqrt(np.maximum(2 - 2 * (x[i] * x[i:, None] + s[i] * s[i:, None] * np.cos(turn)), 1e-12))
        rings[i, i:] = (
            np.exp(-1j * wave * gap).sum(1) * np.pi / len(turn)
        )  # cosines of incidence and departure: gap / 2
        rings[i:, i] = rings[i, i:]
    unit, total = 1j * wave / (2 * np.pi), 0j
    for first, last in ((slope, 1.0), (1.0, slope)):
        field = np.asarray(sent * first, complex)
        for _ in range(bounces - 1):
            field = unit * rings @ (shares * field)
        total += np.sum(unit * 2 * np.pi * shares * sent * field * last) / 2
    return complex(total / (2 * wave))


def mie_width(radius_m: float, frequency_hz: float) -> float:
    """Compute the radar cross section of a conducting sphere [m^2] [Balanis2012, ch. 11]."""
    x = wave_number(frequency_hz) * radius_m
    n = np.arange(1, int(x + 4 * x ** (1 / 3)) + 10)
    j, y = spherical_jn(n, x), spherical_yn(n, x)
    dj = j + x * spherical_jn(n, x, derivative=True)
    dh = dj - 1j * (y + x * spherical_yn(n, x, derivative=True))
    total = np.sum((-1.0) ** n * (2 * n + 1) * (j / (j - 1j * y) - dj / dh))
    return float(np.pi / wave_number(frequency_hz) ** 2 * abs(total) ** 2)


def wire_gain(radius_m: float, distance_m: float, frequency_hz: float, *, tm: bool) -> float:
    """Compute the path gain amplitude of an infinite conducting wire for isotropic antennas [Balanis2012, ch. 11]."""
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
    """Compute the echo of a tall, tilted conducting strip by Keller's coefficients [Keller1962].

    It adds two edges, and the wave from edge to edge for the field across them (not `soft`), each at its stationary
    point.
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
    """List path lengths [m] by the image method in a room around the origin, with source and receiver at one point."""
    found = []
    span = range(-max(orders), max(orders) + 1)
    for cell in itertools.product(span, repeat=3):
        if sum(map(abs, cell)) in orders:
            image = [m * s + (p if m % 2 == 0 else -p) for m, s, p in zip(cell, size_m, position_m, strict=True)]
            found.append(float(np.linalg.norm(np.asarray(image) - position_m)))
    return np.sort([d for d in found if d <= longest_m])
