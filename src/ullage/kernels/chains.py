"""Loops over places along a round wall: the integral across the paths over lines along it."""

from __future__ import annotations

import math
from typing import NamedTuple

from ullage.arrays import Bools, Complexes, Floats, Longs
from ullage.kernels.loops import core, lean
from ullage.kernels.vectors import dot, unit_to


class WallLines(NamedTuple):
    """Paths over lines (n) along a wall, or over the places where rays meet it."""

    lengths: Floats  # (n) [m]
    slopes: Floats  # (n) how fast the paths grow along the wall
    rates: Floats  # (n) distance from one to the next over the step
    cuts: Floats  # (n) no part of the sum comes from where the path grows faster than this
    step: float  # [m]


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
def _between(lines: WallLines, i: int, share: float) -> tuple[float, float]:
    """Compute the path [m] at a share of the distance from line i to the next, by a cubic, and its slope."""
    lengths, slopes, rates, _, step = lines
    j = (i + 1) % len(lengths)
    a, b, p, q = lengths[i], lengths[j], step * rates[i] * slopes[i], step * rates[j] * slopes[j]
    bow, bend = 3 * (b - a) - 2 * p - q, 2 * (a - b) + p + q
    return a + share * (p + share * (bow + share * bend)), slopes[i] + share * (slopes[j] - slopes[i])


@lean(error_model="numpy")
def sampled(lines: WallLines, there: Bools, many: float, places: WallPlaces) -> int:
    """Choose places for the sum along a wall: all about points of stationary phase.

    Args:
        lines: `WallLines` (n).
        there: (n) whether there are such paths.
        many: places between two lines that are a step apart, where paths grow as they are long.
        places: `WallPlaces` gets the places.

    Returns:
        How many places there are.
    """
    first, share, weights = places
    slopes, rates, cuts = lines.slopes, lines.rates, lines.cuts
    count = 0
    for i in range(len(slopes)):
        j = (i + 1) % len(slopes)
        least = min(abs(slopes[i]), abs(slopes[j])) if slopes[i] * slopes[j] > 0 else 0.0
        cut = max(cuts[i], cuts[j])
        if not (there[i] and there[j] and least < cut):
            continue
        parts = int(many * cut * max(abs(rates[i]), abs(rates[j]))) + 1
        for k in range(parts):
            part = (k + 0.5) / parts
            gone = abs(_between(lines, i, part)[1]) / (cuts[i] + part * (cuts[j] - cuts[i]))
            if gone < 1:
                first[count], share[count] = i, part
                weights[count] = math.sin(math.pi * min(1 - gone, 0.5)) ** 2 * (lines.step / parts)
                count += 1
    return count


@lean(error_model="numpy")
def summed(
    lines: WallLines, seen: Complexes, places: WallPlaces, values: Complexes, paths: Floats, rates: Floats
) -> None:
    """Compute the contribution of each place along a wall.

    Args:
        lines: `WallLines` (n).
        seen: (n) contribution of each line.
        places: `WallPlaces` (m).
        values: (m) get the contributions; paths: (m) get their lengths [m]; rates: (m) get how fast these grow.
    """
    first, share, weights = places
    for i in range(len(first)):
        here, u = first[i], share[i]
        values[i] = (seen[here] * (1 - u) + seen[(here + 1) % len(seen)] * u) * weights[i]
        paths[i], rates[i] = _between(lines, here, u)
