"""Horizontal sections of a scene: the true walls of a plan."""

from __future__ import annotations

import numpy as np

from ullage.arrays import Floats
from ullage.world.scene import Scene


def section(scene: Scene, z_m: float) -> Floats:
    """Return the segments (s, 2, 2) [m] where faces cross the height `z_m`; moving objects are at their start.

    Faces in the plane give nothing. A plane exactly through vertices counts as just above them.
    """
    corners = scene.corners()
    above = corners[:, :, 2] > z_m
    cut = above.any(1) & ~above.all(1)
    corners, above = corners[cut], above[cut]
    if not len(corners):
        return np.zeros((0, 2, 2))
    # The vertex that is alone on its side has the two edges that are cut.
    lonely = np.where(above.sum(1) == 1, above.argmax(1), (~above).argmax(1))
    row = np.arange(len(corners))
    apex = corners[row, lonely]
    ends = []
    for step in (1, 2):
        other = corners[row, (lonely + step) % 3]
        share = (z_m - apex[:, 2]) / (other[:, 2] - apex[:, 2])
        ends.append(apex[:, :2] + share[:, None] * (other - apex)[:, :2])
    return np.stack(ends, axis=1)


def wire_section(scene: Scene, z_m: float, *, slab_m: float = 0.0) -> Floats:
    """Points (p, 2) in x, y [m] where wires cross the height `z_m`; level ones within `slab_m` of it give both ends."""
    a, b = scene.wires.start, scene.wires.end
    rise = b[:, 2] - a[:, 2]
    crosses = (np.minimum(a[:, 2], b[:, 2]) <= z_m) & (np.maximum(a[:, 2], b[:, 2]) >= z_m) & (abs(rise) > 1e-9)
    share = (z_m - a[crosses, 2]) / rise[crosses]
    level = ~crosses & (abs((a[:, 2] + b[:, 2]) / 2 - z_m) <= slab_m)
    pierced = a[crosses, :2] + share[:, None] * (b - a)[crosses, :2]
    return np.concatenate([pierced, a[level, :2], b[level, :2]])
