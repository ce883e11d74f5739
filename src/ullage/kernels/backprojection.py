"""Time-domain back-projection: per row of cells and frame, first the geometry of all cells, then their echoes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Floats, Singles
from ullage.kernels.loops import inner, loop

# Least squares on |t| <= 1/2: sin(2 pi t) to 6e-6, cos(2 pi t) to 4e-5. Single precision throughout, for wide vectors.
_S1, _S3, _S5 = np.float32(6.28305409), np.float32(-41.33112295), np.float32(81.36549856)
_S7, _S9 = np.float32(-74.47097755), np.float32(32.76890242)
_C0, _C2, _C4 = np.float32(0.99995902), np.float32(-19.73094237), np.float32(64.67144178)
_C6, _C8 = np.float32(-82.39080631), np.float32(45.62105110)


class Rows(NamedTuple):
    """Rows of image cells along x."""

    y: NDArray[np.float64]  # (k) of each row [m]
    z: NDArray[np.float64]  # (k) of each row [m]
    x0: float  # centre of the first cells [m]
    step: float  # from cell to cell [m]


class Profiles(NamedTuple):
    """Oversampled range profiles, and how ranges become samples and phases."""

    real: NDArray[np.float32]  # (n, m)
    imag: NDArray[np.float32]  # (n, m)
    per_m: np.float32  # samples per metre
    first: np.float32  # range of sample 0, in samples
    cycles_per_m: np.float32  # two-way carrier phase per metre of range [cycles/m]: 2 / wavelength


class Track(NamedTuple):
    """Where the sensor was, and what each frame counts."""

    position: NDArray[np.float64]  # (n, 3) [m]
    rotation: NDArray[np.float64]  # (n, 3, 3) world_from_sensor
    weight: NDArray[np.float32]  # (n)


class Pattern(NamedTuple):
    """The antenna's pattern: the two-way amplitude is (1 - q)^2, q = inv_y2 sin^2 + inv_z2 sin^2 off the boresight."""

    inv_y2: np.float32  # 1 / (span sin^2 of half the opening) across; 0 in both: isotropic
    inv_z2: np.float32  # and up
    least: np.float32  # weights below this count as 0


class _Aimed(NamedTuple):
    """Scratch: what the cells of one row see of one frame, each (nx)."""

    place: NDArray[np.int32]  # sample before the cell
    near: NDArray[np.float32]  # share of the way to the next sample, 0 to 1
    cos: NDArray[np.float32]  # of the carrier phase
    sin: NDArray[np.float32]
    weight: NDArray[np.float32]  # of the pattern


@inner(error_model="numpy")
def _seen(gx: float, step: float, flat: float, reach: float, count: int) -> tuple[int, int]:
    """Return the first cell of a row that may lie within a range of the sensor [m], and the one after the last."""
    left = reach * reach - flat
    if left < 0:
        return 0, 0
    half = np.sqrt(left)
    begin, end = (-half - gx) / step - 1, (half - gx) / step + 2  # a cell more at both ends: the range is rounded
    return int(min(max(begin, 0), count)), int(min(max(end, 0), count))


@inner(error_model="numpy")
def _ahead(gx: float, step: float, ax: float, a0: float, begin: int, end: int) -> tuple[int, int]:
    """Narrow cells to those that may lie ahead of the antenna, where ax x + a0 > 0."""
    if abs(ax) < 1e-6:
        return begin, end
    at = min(max((-a0 / ax - gx) / step, -1.0), end + 1.0)
    if ax > 0:
        return max(begin, int(at) - 1), end
    return begin, min(end, int(at) + 2)


@inner(fastmath=True, error_model="numpy")
def _aim(
    offset: tuple[float, float, float],
    step: float,
    turn: Floats,
    profiles: Profiles,
    pattern: Pattern,
    last: float,
    aimed: _Aimed,
) -> tuple[int, int]:
    """Find where each cell of a row lies in a frame's profile, its phase and its weight in the beam.

    Cells out of range or behind the antenna, most cells of a large image, are left out.

    Args:
        offset: (3) first cell of the row from the sensor [m]; x is a float32.
        step: from cell to cell along x [m].
        turn: (3, 3) world_from_sensor.
        profiles, pattern: as in `backproject_rows`.
        last: greatest place in a profile [samples].
        aimed: gets the results.

    Returns:
        The first cell with results, and the one after the last.
    """
    gx, gy, gz = offset
    place, near, cos, sin, weight = aimed
    one, half, zero = np.float32(1.0), np.float32(0.5), np.float32(0.0)
    flat = np.float32(gy * gy + gz * gz + 1e-12)
    ax, bx, cx = np.float32(turn[0, 0]), np.float32(turn[0, 1]), np.float32(turn[0, 2])
    a0 = np.float32(turn[1, 0] * gy + turn[2, 0] * gz)
    b0 = np.float32(turn[1, 1] * gy + turn[2, 1] * gz)
    c0 = np.float32(turn[1, 2] * gy + turn[2, 2] * gz)
    per_m, first, turns = profiles.per_m, profiles.first, profiles.cycles_per_m
    iy, iz, least = pattern.inv_y2, pattern.inv_z2, pattern.least
    everywhere = iy == zero and iz == zero
    begin, end = _seen(gx, step, flat, (last + first) / per_m, len(place))
    if not everywhere:
        begin, end = _ahead(gx, step, ax, a0, begin, end)
    for i in range(begin, end):
        x = gx + np.float32(i) * step
        d2 = x * x + flat
        r = np.sqrt(d2)
        b, c = bx * x + b0, cx * x + c0
        w = one - (b * b * iy + c * c * iz) / d2
        w = w * w if w > zero else zero
        w = w if ax * x + a0 > zero else zero
        w = one if everywhere else w
        u = r * per_m - first
        w = w if w >= least else zero
        w = w if u >= zero else zero
        w = w if u <= last else zero
        u = min(max(u, zero), last)
        j = np.int32(u)
        t = r * turns
        t = t - np.floor(t + half)
        t2 = t * t
        place[i] = j
        near[i] = u - np.float32(j)
        sin[i] = t * (_S1 + t2 * (_S3 + t2 * (_S5 + t2 * (_S7 + t2 * _S9))))
        cos[i] = _C0 + t2 * (_C2 + t2 * (_C4 + t2 * (_C6 + t2 * _C8)))
        weight[i] = w
    return begin, end


@loop(fastmath=True, error_model="numpy")
def backproject_rows(rows: Rows, profiles: Profiles, track: Track, pattern: Pattern, sums: Singles) -> None:
    """Add the echoes of every frame to rows of cells.

    Args:
        rows: (k) rows of cells.
        profiles: (n) of the frames.
        track: (n) of the frames.
        pattern: of the antenna.
        sums: (k, 5, nx) float32: real, imaginary, weighted power, weight, weight^2; added to.
    """
    nx, position, weight = sums.shape[2], track.position, track.weight
    near, cos, sin, share = np.empty((4, nx), np.float32)
    aimed = _Aimed(np.empty(nx, np.int32), near, cos, sin, share)
    last, step = np.float32(profiles.real.shape[1] - 1.001), np.float32(rows.step)
    for k in range(len(rows.y)):
        total = sums[k]
        for n in range(len(weight)):
            gx = np.float32(rows.x0 - position[n, 0])
            offset = gx, rows.y[k] - position[n, 1], rows.z[k] - position[n, 2]
            begin, end = _aim(offset, step, track.rotation[n], profiles, pattern, last, aimed)
            row_re, row_im = profiles.real[n], profiles.imag[n]
            for i in range(begin, end):
                w = aimed.weight[i] * weight[n]
                if w > np.float32(0.0):
                    j, f = aimed.place[i], near[i]
                    vr = row_re[j] + f * (row_re[j + 1] - row_re[j])
                    vi = row_im[j] + f * (row_im[j + 1] - row_im[j])
                    total[0, i] += w * (vr * cos[i] - vi * sin[i])
                    total[1, i] += w * (vr * sin[i] + vi * cos[i])
                    total[2, i] += w * (vr * vr + vi * vi)
                    total[3, i] += w
                    total[4, i] += w * w
