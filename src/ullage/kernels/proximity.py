"""Nearest points on triangles, over plain arrays."""

from __future__ import annotations

import numpy as np

from ullage.kernels.loops import loop


@loop()
def nearest_points(point: np.ndarray, corners: np.ndarray, out: np.ndarray) -> None:
    """Writes the nearest point on each triangle (f, 3) [m], by the regions of Voronoi [Ericson2004]."""
    px, py, pz = point[0], point[1], point[2]
    for f in range(len(corners)):
        ax, ay, az = corners[f, 0, 0], corners[f, 0, 1], corners[f, 0, 2]
        ux, uy, uz = corners[f, 1, 0] - ax, corners[f, 1, 1] - ay, corners[f, 1, 2] - az
        vx, vy, vz = corners[f, 2, 0] - ax, corners[f, 2, 1] - ay, corners[f, 2, 2] - az
        wx, wy, wz = px - ax, py - ay, pz - az
        uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
        uw, vw = ux * wx + uy * wy + uz * wz, vx * wx + vy * wy + vz * wz
        det = uu * vv - uv * uv
        s, t = vv * uw - uv * vw, uu * vw - uv * uw
        if det > 1e-12 * uu * vv and s >= 0 and t >= 0 and s + t <= det:
            s, t = s / det, t / det
        else:  # nearest point is on an edge: the best of three
            best = np.inf
            s0 = min(max(uw / uu, 0.0), 1.0) if uu > 0 else 0.0
            t0 = min(max(vw / vv, 0.0), 1.0) if vv > 0 else 0.0
            ee = uu - 2 * uv + vv
            k0 = min(max((vw - uw - uv + uu) / ee, 0.0), 1.0) if ee > 0 else 0.0
            for edge in range(3):
                a = s0 if edge == 0 else (0.0 if edge == 1 else 1.0 - k0)
                b = 0.0 if edge == 0 else (t0 if edge == 1 else k0)
                gap = (wx - a * ux - b * vx) ** 2 + (wy - a * uy - b * vy) ** 2 + (wz - a * uz - b * vz) ** 2
                if gap < best:
                    best, s, t = gap, a, b
        out[f, 0], out[f, 1], out[f, 2] = ax + s * ux + t * vx, ay + s * uy + t * vy, az + s * uz + t * vz
