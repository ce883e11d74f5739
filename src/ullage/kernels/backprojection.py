"""Time-domain back-projection: per row of cells and frame, first the geometry of all cells, then their echoes.

LLVM runs a loop in vectors only over contiguous arrays from index 0, and if few pairs of them might overlap. So rows
are cut to their cells first, and a loop writes to at most four arrays, or to one where it reads five.
"""

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

    place: NDArray[np.float32]  # of the cell [samples]
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
    one, half, zero = np.float32(1.0), np.float32(0.5), np.float32(0.0)
    flat = np.float32(gy * gy + gz * gz + 1e-12)
    ax, bx, cx = np.float32(turn[0, 0]), np.float32(turn[0, 1]), np.float32(turn[0, 2])
    a0 = np.float32(turn[1, 0] * gy + turn[2, 0] * gz)
    b0 = np.float32(turn[1, 1] * gy + turn[2, 1] * gz)
    c0 = np.float32(turn[1, 2] * gy + turn[2, 2] * gz)
    per_m, first, turns = profiles.per_m, profiles.first, profiles.cycles_per_m
    iy, iz, least = pattern.inv_y2, pattern.inv_z2, pattern.least
    everywhere = iy == zero and iz == zero
    begin, end = _seen(gx, step, flat, (last + first) / per_m, len(aimed.place))
    if not everywhere:
        begin, end = _ahead(gx, step, ax, a0, begin, end)
    place, weight = aimed.place[begin:end], aimed.weight[begin:end]
    cos, sin = aimed.cos[begin:end], aimed.sin[begin:end]
    for i in range(end - begin):
        x = gx + np.float32(begin + i) * step
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
        t = r * turns
        t = t - np.floor(t + half)
        t2 = t * t
        place[i] = min(max(u, zero), last)
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
    place, cos, sin = np.empty(nx, np.float32), np.empty(nx, np.float32), np.empty(nx, np.float32)
    share, real, imag = np.empty(nx, np.float32), np.empty(nx, np.float32), np.empty(nx, np.float32)
    aimed = _Aimed(place, cos, sin, share)
    last, step = np.float32(profiles.real.shape[1] - 1.001), np.float32(rows.step)
    for k in range(len(rows.y)):
        total = sums[k]
        for n in range(len(weight)):
            gx = np.float32(rows.x0 - position[n, 0])
            offset = gx, rows.y[k] - position[n, 1], rows.z[k] - position[n, 2]
            begin, end = _aim(offset, step, track.rotation[n], profiles, pattern, last, aimed)
            _interpolate(profiles.real[n], profiles.imag[n], place[begin:end], real[begin:end], imag[begin:end])
            _weigh(share[begin:end], weight[n])
            seen = share[begin:end], real[begin:end], imag[begin:end]
            _add_turned(total[0][begin:end], seen, cos[begin:end], sin[begin:end], np.float32(-1))
            _add_turned(total[1][begin:end], seen, sin[begin:end], cos[begin:end], np.float32(1))
            _add_power(total[2][begin:end], seen)
            _add_weights(total[3][begin:end], total[4][begin:end], share[begin:end])


@inner(fastmath=True, error_model="numpy")
def _interpolate(row_re: Singles, row_im: Singles, place: Singles, real: Singles, imag: Singles) -> None:
    """Read a profile between its samples."""
    for i in range(len(place)):
        j = np.uint32(place[i])
        near = place[i] - np.float32(j)
        real[i] = row_re[j] + near * (row_re[j + 1] - row_re[j])
        imag[i] = row_im[j] + near * (row_im[j + 1] - row_im[j])


@inner(fastmath=True, error_model="numpy")
def _weigh(weight: Singles, factor: float) -> None:
    for i in range(len(weight)):
        weight[i] *= factor


@inner(fastmath=True, error_model="numpy")
def _add_turned(total: Singles, seen: tuple[Singles, ...], by: Singles, across: Singles, sign: float) -> None:
    weight, real, imag = seen
    for i in range(len(weight)):
        total[i] += weight[i] * (real[i] * by[i] + sign * imag[i] * across[i])


@inner(fastmath=True, error_model="numpy")
def _add_power(total: Singles, seen: tuple[Singles, ...]) -> None:
    weight, real, imag = seen
    for i in range(len(weight)):
        total[i] += weight[i] * (real[i] * real[i] + imag[i] * imag[i])


@inner(fastmath=True, error_model="numpy")
def _add_weights(total: Singles, square: Singles, weight: Singles) -> None:
    for i in range(len(weight)):
        total[i] += weight[i]
        square[i] += weight[i] * weight[i]
