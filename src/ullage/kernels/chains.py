"""Loops over places along a round wall: the integral across the paths over lines along it."""

from __future__ import annotations

import math
from typing import NamedTuple

from ullage.arrays import Bools, Complexes, Floats, Longs
from ullage.kernels.loops import core, lean
from ullage.kernels.vectors import dot, unit_to


class WallPlaces(NamedTuple):
    """Places (m) for the sum along a wall."""

    first: Longs  # line before each place
    share: Floats  # share of the distance to the next line
    weights: Floats  # weight of each


@lean(error_model="numpy")
def beside(
    corners: Floats, at: int, out: Floats, up: Floats, spreads: Floats, slopes: Floats, least: Floats, rows: Floats
) -> None:
    """Compute the slopes of paths from line to line, and their spreads times what Kirchhoff's integral has at the wall.

    Args:
        corners: (s + 2, n, 3) of the paths [m]; at: which surface is the wall that is integrated over.
        out: (n, 3) its outward unit normals; up: (3) along the lines.
        spreads: (n) multiplied by the mean cosine of both legs there; 0 where one of them comes from behind.
        slopes: (n) get how fast the paths grow along the wall.
        least: (2) gets the shortest leg before it and after it, of the paths that there are [m].
        rows: (3, 3), room to work.
    """
    there, back, along = rows[0], rows[1], rows[2]
    least[0] = least[1] = math.inf
    for i in range(len(out)):
        before, after = (
            unit_to(corners[at, i], corners[at + 1, i], there),
            unit_to(corners[at + 1, i], corners[at + 2, i], back),
        )
        if spreads[i] > 0:
            least[0], least[1] = min(least[0], before), min(least[1], after)
        inward, outward = dot(there, out[i]), -dot(back, out[i])
        spreads[i] *= 0.5 * (inward + outward) if inward > 0 and outward > 0 else 0.0
        for k in range(3):
            a, b = (k + 1) % 3, (k + 2) % 3
            along[k] = up[a] * out[i, b] - up[b] * out[i, a]
        slopes[i] = dot(there, along) - dot(back, along)


@core(error_model="numpy")
def _between(lengths: Floats, slopes: Floats, i: int, share: float, step: float) -> tuple[float, float]:
    """Compute the path [m] at a share of the distance from line i to the next, and its slope, by a cubic."""
    j = (i + 1) % len(lengths)
    a, b, p, q = lengths[i], lengths[j], step * slopes[i], step * slopes[j]
    bow, bend = 3 * (b - a) - 2 * p - q, 2 * (a - b) + p + q
    return a + share * (p + share * (bow + share * bend)), (p + share * (2 * bow + 3 * share * bend)) / step


@lean(error_model="numpy")
def sampled(
    lengths: Floats, slopes: Floats, there: Bools, step: float, cut: float, many: int, places: WallPlaces
) -> int:
    """Choose places for the sum along a wall: all about points of stationary phase.

    Args:
        lengths, slopes: (n) of the paths over lines along the wall [m]; there: (n) whether there are such paths.
        step: from line to line [m]; many: places between two of them.
        cut: no places where the path grows faster than this.
        places: `WallPlaces` (n many) gets the places.

    Returns:
        How many places there are.
    """
    first, share, weights = places
    count = 0
    for i in range(len(lengths)):
        j = (i + 1) % len(lengths)
        least = min(abs(slopes[i]), abs(slopes[j])) if slopes[i] * slopes[j] > 0 else 0.0
        if not (there[i] and there[j] and least < cut):
            continue
        for k in range(many):
            part = (k + 0.5) / many
            gone = abs(_between(lengths, slopes, i, part, step)[1]) / cut
            if gone < 1:
                first[count], share[count] = i, part
                weights[count] = math.sin(math.pi * min(1 - gone, 0.5)) ** 2 * (step / many)
                count += 1
    return count


@lean(error_model="numpy")
def summed(
    lengths: Floats,
    slopes: Floats,
    step: float,
    seen: Complexes,
    places: WallPlaces,
    values: Complexes,
    paths: Floats,
    rates: Floats,
) -> None:
    """Compute the contribution of each place along a wall.

    Args:
        lengths, slopes, step: as in `sampled`.
        seen: (n) contribution of each line.
        places: `WallPlaces` (m).
        values: (m) get the contributions; paths: (m) get their lengths [m]; rates: (m) get how fast these grow.
    """
    first, share, weights = places
    for i in range(len(first)):
        here, u = first[i], share[i]
        values[i] = (seen[here] * (1 - u) + seen[(here + 1) % len(seen)] * u) * weights[i]
        paths[i], rates[i] = _between(lengths, slopes, here, u, step)
