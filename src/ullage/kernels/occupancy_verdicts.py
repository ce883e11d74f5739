"""What one look of the full-profile mapper says of a place: of all of a ball, or of the middle of a cell."""

from __future__ import annotations

import math

import numpy as np

from ullage.kernels.loops import core
from ullage.kernels.occupancy_reach import Beam, sectors_of

NOTHING, WHOLE, PARTLY, ARC = 0, 1, 2, 4
Columns = tuple[float, float, float, float, float, float, float, float, float]
Scales = tuple[float, float, float]


@core(fastmath=True)
def judge(at: np.ndarray, radius: float, step: float, farthest: float, beam: Beam, fine: bool, out: np.ndarray) -> None:
    """What the look says of balls around points (n, 3) from the eye: NOTHING, WHOLE silent, PARTLY, ARC or both.

    A `fine` one on the border of the beam, or of what it reaches, goes by its middle.
    """
    ax, ay, az, bx, by, bz, cx, cy, cz = columns_of(beam.axes)
    (cos_hit, sin_hit), (cos_free, sin_free) = beam.hit, beam.free
    for i in range(len(at)):
        out[i] = NOTHING
        dx, dy, dz = at[i, 0], at[i, 1], at[i, 2]
        middle = math.sqrt(dx * dx + dy * dy + dz * dz)
        if middle - radius > farthest or middle + radius < beam.near:
            continue
        fore = dx * ax + dy * ay + dz * az
        across = math.sqrt(max(middle * middle - fore * fore, 0.0))
        if across * cos_hit - fore * sin_hit > radius:
            continue
        verdict = ARC if _meets_arc(dx, dy, dz, middle, radius, beam.arcs) else NOTHING
        silent, bins = _silent_bins(middle, radius, beam)
        outside = across * cos_free - fore * sin_free
        heard = silent > 0 and outside <= radius
        if verdict == NOTHING and not heard:
            continue
        side, rise = dx * bx + dy * by + dz * bz, dx * cx + dy * cy + dz * cz
        least, most = _reach_about(side, rise, fore, radius, beam)
        if middle - radius > most + 0.5 * step:
            continue
        if not heard:
            out[i] = verdict
            continue
        if silent < bins or verdict != NOTHING or middle < 2.0 * radius:
            out[i] = verdict | PARTLY
            continue
        inside = beam.near + radius < middle < farthest - radius
        if fine:
            ends = _silence_at(side, rise, fore, beam)
            out[i] = WHOLE if inside and outside < 0.0 and middle + 0.5 * radius < ends else NOTHING
        else:
            out[i] = WHOLE if inside and outside < -radius and middle + radius < least else PARTLY


@core(fastmath=True)
def _meets_arc(dx: float, dy: float, dz: float, middle: float, radius: float, arcs: np.ndarray) -> bool:
    """Whether an arc passes through a ball so far from the eye."""
    for k in range(len(arcs)):
        if abs(middle - arcs[k, 0]) < radius + 2.5 * arcs[k, 1]:
            cosine = (dx * arcs[k, 2] + dy * arcs[k, 3] + dz * arcs[k, 4]) / middle
            if abs(cosine - arcs[k, 5]) < 3.0 * arcs[k, 6] + radius / max(middle - radius, 1e-3):
                return True
    return False


@core(fastmath=True)
def _silent_bins(middle: float, radius: float, beam: Beam) -> tuple[int, int]:
    """How many bins of those that a ball at this range lies in are silent, and how many there are."""
    quiet, start, per_bin = beam.quiet, beam.start, 1.0 / beam.bin_m
    bins = len(quiet) - 1
    first = int((max(middle - radius, start) - start) * per_bin + 0.5)
    last = min(int((max(middle + radius, start) - start) * per_bin + 0.5), bins - 1)
    return quiet[last + 1] - quiet[min(first, bins)], last + 1 - first


@core(fastmath=True)
def _reach_about(side: float, rise: float, fore: float, radius: float, beam: Beam) -> tuple[float, float]:
    """How far silence counts in each sector that a ball lies in, and how far some of them sees."""
    up, left = beam.reach.shape
    a0, a1, e0, e1 = sectors_of(side, rise, fore, radius, beam.tangent, left, up)
    least, most = 1e9, 0.0
    if fore < 1.2 * radius:
        return 0.0, 1e9
    for e in range(e0, e1 + 1):
        for a in range(a0, a1 + 1):
            least, most = min(least, beam.hush[e, a]), max(most, beam.reach[e, a])
    return least, most


@core(fastmath=True)
def _silence_at(side: float, rise: float, fore: float, beam: Beam) -> float:
    """How far silence counts in the sector of a point; 0 outside them all."""
    up, left = beam.reach.shape
    a = int((side / (fore * beam.tangent) + 1.0) * 0.5 * left)
    e = int((rise / (fore * beam.tangent) + 1.0) * 0.5 * up)
    return beam.hush[e, a] if 0 <= a < left and 0 <= e < up else 0.0


@core(fastmath=True, forceinline=True)
def hear_cell(
    dx: float,
    dy: float,
    dz: float,
    r: float,
    wanted: int,
    slack: float,
    farthest: float,
    axes: Columns,
    scales: Scales,
    beam: Beam,
) -> int:
    """What the look says of a cell, its middle and range given from the eye: NOTHING, PARTLY (silent) or ARC.

    Only what is `wanted` of it. An arc may yet pass it by: its bin is not silent, that is all.
    """
    ax, ay, az, bx, by, bz, cx, cy, cz = axes
    quiet, (up, left), (per_bin, wide, high) = beam.quiet, beam.reach.shape, scales
    fore = dx * ax + dy * ay + dz * az
    b = int((r - beam.start) * per_bin + 0.5)
    if r < beam.near or r > farthest or fore < beam.hit[0] * r or b < 0 or b >= len(quiet) - 1:
        return NOTHING
    silent = quiet[b + 1] > quiet[b]
    if silent and (wanted & PARTLY == 0 or fore < beam.free[0] * r):
        return NOTHING
    if not silent and wanted & ARC == 0:
        return NOTHING
    ahead = 1.0 / fore
    a = int((dx * bx + dy * by + dz * bz) * ahead * wide + 0.5 * left)
    e = int((dx * cx + dy * cy + dz * cz) * ahead * high + 0.5 * up) if up > 1 else 0
    if a < 0 or e < 0 or a >= left or e >= up:
        return NOTHING
    if r > (beam.hush[e, a] if silent else beam.reach[e, a]) + slack:
        return NOTHING
    return PARTLY if silent else ARC


@core()
def scales_of(beam: Beam) -> Scales:
    """Bins a metre, and sectors over the tangent of the angle, across and up."""
    up, left = beam.reach.shape
    return 1.0 / beam.bin_m, 0.5 * left / beam.tangent, 0.5 * up / beam.tangent


@core()
def columns_of(axes: np.ndarray) -> Columns:
    """The sensor's axes (3, 3) as numbers, which loops need not fetch again: ahead (3), to the left (3), up (3)."""
    return (
        axes[0, 0], axes[1, 0], axes[2, 0],
        axes[0, 1], axes[1, 1], axes[2, 1],
        axes[0, 2], axes[1, 2], axes[2, 2],
    )  # fmt: skip
