"""The inner loop of time-domain back-projection."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

# Least squares on |t| <= 1/2: sin(2 pi t) to 6e-6, cos(2 pi t) to 4e-5. Single precision throughout, for wide vectors.
_S1, _S3, _S5 = np.float32(6.28305409), np.float32(-41.33112295), np.float32(81.36549856)
_S7, _S9 = np.float32(-74.47097755), np.float32(32.76890242)
_C0, _C2, _C4 = np.float32(0.99995902), np.float32(-19.73094237), np.float32(64.67144178)
_C6, _C8 = np.float32(-82.39080631), np.float32(45.62105110)


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def backproject_rows(  # type: ignore[no-untyped-def]
    y, z, x0, dx, re, im, r0, per_m, cycles_per_m, position, rotation, weight, inv_y2, inv_z2, span, min_w, sums
):
    """Adds the echoes of every frame to rows of cells.

    y, z: (k) of the rows [m]; x0, dx: first cell and step along x [m].
    re, im: (n, m) oversampled profiles; r0 [m], per_m [1/m]: range of sample 0, samples per metre.
    cycles_per_m: 2 / wavelength.
    position: (n, 3) [m]; rotation: (n, 3, 3) world_from_sensor; weight: (n).
    inv_y2, inv_z2: 1 / sin^2 of the half openings, 0 for isotropic; the two-way amplitude is (1 - q / span)^2.
    min_w: cells where the pattern is below this are left alone.
    sums: (5, k, nx) float32: real, imaginary, weighted power, weight, weight^2; added to.
    """
    nx = sums.shape[2]
    last = np.float32(re.shape[1] - 1.001)
    one, half, inv_span = np.float32(1.0), np.float32(0.5), np.float32(1.0 / span)
    scale, turns, zero = np.float32(per_m), np.float32(cycles_per_m), np.float32(0.0)
    iy, iz, step, floor_w = np.float32(inv_y2), np.float32(inv_z2), np.float32(dx), np.float32(min_w)
    isotropic = inv_y2 == 0.0 and inv_z2 == 0.0
    for k in range(len(y)):
        for n in range(len(weight)):
            gx = np.float32(x0 - position[n, 0])
            gy, gz = y[k] - position[n, 1], z[k] - position[n, 2]
            flat = np.float32(gy * gy + gz * gz)
            turn = rotation[n]
            ax, bx, cx = np.float32(turn[0, 0]), np.float32(turn[0, 1]), np.float32(turn[0, 2])
            a0 = np.float32(turn[1, 0] * gy + turn[2, 0] * gz)
            b0 = np.float32(turn[1, 1] * gy + turn[2, 1] * gz)
            c0 = np.float32(turn[1, 2] * gy + turn[2, 2] * gz)
            shift, wn = np.float32(-r0 * per_m), np.float32(weight[n])
            row_re, row_im = re[n], im[n]
            for i in range(nx):
                x = gx + np.float32(i) * step
                d2 = x * x + flat
                r = math.sqrt(d2)
                w = one
                if not isotropic:
                    b, c = bx * x + b0, cx * x + c0
                    w = one - (b * b * iy + c * c * iz) * inv_span / max(d2, np.float32(1e-12))
                    w = w * w if (w > zero and ax * x + a0 > zero) else zero
                u = r * scale + shift
                w = w * wn if (w >= floor_w and u >= zero and u <= last) else zero
                u = min(max(u, zero), last)
                j = int(u)
                f = u - np.float32(j)
                vr = row_re[j] + f * (row_re[j + 1] - row_re[j])
                vi = row_im[j] + f * (row_im[j + 1] - row_im[j])
                t = r * turns
                t = t - math.floor(t + half)
                t2 = t * t
                sn = t * (_S1 + t2 * (_S3 + t2 * (_S5 + t2 * (_S7 + t2 * _S9))))
                cs = _C0 + t2 * (_C2 + t2 * (_C4 + t2 * (_C6 + t2 * _C8)))
                sums[0, k, i] += w * (vr * cs - vi * sn)
                sums[1, k, i] += w * (vr * sn + vi * cs)
                sums[2, k, i] += w * (vr * vr + vi * vi)
                sums[3, k, i] += w
                sums[4, k, i] += w * w
