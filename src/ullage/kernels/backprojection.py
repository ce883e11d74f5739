"""The inner loops of time-domain back-projection: per row of cells and frame, first geometry, then the echoes."""

from __future__ import annotations

import numpy as np

from ullage.kernels.loops import inner, loop

# Least squares on |t| <= 1/2: sin(2 pi t) to 6e-6, cos(2 pi t) to 4e-5. Single precision throughout, for wide vectors.
_S1, _S3, _S5 = np.float32(6.28305409), np.float32(-41.33112295), np.float32(81.36549856)
_S7, _S9 = np.float32(-74.47097755), np.float32(32.76890242)
_C0, _C2, _C4 = np.float32(0.99995902), np.float32(-19.73094237), np.float32(64.67144178)
_C6, _C8 = np.float32(-82.39080631), np.float32(45.62105110)


@inner(nogil=True, fastmath=True, error_model="numpy")
def _aim(gx, dx, gy, gz, turn, axis, beam, last, place, near, cos, sin, weight):  # type: ignore[no-untyped-def]
    """Where each cell of a row lies in a frame's profile, its phase and its weight in the beam.

    gx: first cell from the sensor along x [m]; dx: step [m]; gy, gz: the row from the sensor [m].
    turn: (3, 3) world_from_sensor; axis: samples per metre, sample 0 [samples], cycles per metre.
    beam: 1 / (span sin^2 half azimuth), the same in elevation, least weight.
    Out: place (int), near 0..1, cos, sin, weight of each cell.
    """
    one, half, zero = np.float32(1.0), np.float32(0.5), np.float32(0.0)
    flat = np.float32(gy * gy + gz * gz + 1e-12)
    ax, bx, cx = np.float32(turn[0, 0]), np.float32(turn[0, 1]), np.float32(turn[0, 2])
    a0 = np.float32(turn[1, 0] * gy + turn[2, 0] * gz)
    b0 = np.float32(turn[1, 1] * gy + turn[2, 1] * gz)
    c0 = np.float32(turn[1, 2] * gy + turn[2, 2] * gz)
    per_m, first, turns = axis[0], axis[1], axis[2]
    iy, iz, least = beam[0], beam[1], beam[2]
    everywhere = iy == zero and iz == zero
    for i in range(len(place)):
        x = gx + np.float32(i) * dx
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


@loop(nogil=True, fastmath=True, error_model="numpy")
def backproject_rows(y, z, x0, dx, re, im, axis, beam, position, rotation, weight, sums):  # type: ignore[no-untyped-def]
    """Adds the echoes of every frame to rows of cells.

    y, z: (k) of the rows [m]; x0, dx: first cell and step along x [m].
    re, im: (n, m) float32 oversampled profiles.
    axis: (3) float32, samples per metre, sample number of range 0, 2 / wavelength.
    beam: (3) float32, 1 / (span sin^2 of the half openings) in y and z (0: isotropic), the least weight that counts;
    the two-way amplitude is (1 - q)^2.
    position: (n, 3) [m]; rotation: (n, 3, 3) world_from_sensor; weight: (n) float32.
    sums: (k, 5, nx) float32: real, imaginary, weighted power, weight, weight^2; added to.
    """
    nx = sums.shape[2]
    place = np.empty(nx, np.int32)
    near, cos, sin, pattern = np.empty((4, nx), np.float32)
    last, step = np.float32(re.shape[1] - 1.001), np.float32(dx)
    for k in range(len(y)):
        total = sums[k]
        for n in range(len(weight)):
            gx, gy, gz = np.float32(x0 - position[n, 0]), y[k] - position[n, 1], z[k] - position[n, 2]
            _aim(gx, step, gy, gz, rotation[n], axis, beam, last, place, near, cos, sin, pattern)
            row_re, row_im = re[n], im[n]
            for i in range(nx):
                w = pattern[i] * weight[n]
                if w > np.float32(0.0):
                    j, f = place[i], near[i]
                    vr = row_re[j] + f * (row_re[j + 1] - row_re[j])
                    vi = row_im[j] + f * (row_im[j + 1] - row_im[j])
                    total[0, i] += w * (vr * cos[i] - vi * sin[i])
                    total[1, i] += w * (vr * sin[i] + vi * cos[i])
                    total[2, i] += w * (vr * vr + vi * vi)
                    total[3, i] += w
                    total[4, i] += w * w
