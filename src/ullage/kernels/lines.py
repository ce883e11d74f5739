"""Split straight lines that echo into the part to integrate and the ends of the rest."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ullage.arrays import Bools, Floats, Ints, Longs
from ullage.kernels.edges import FAR
from ullage.kernels.loops import core, inner, lean, loop
from ullage.kernels.vectors import unit_to

C0 = 299_792_458.0


class PartedLines(NamedTuple):
    """Results of `part` for w lines: the part of each that must be integrated, and the ends of the rest."""

    near: Floats  # (w, 2, 3) ends of the part to integrate [m]
    held: Bools  # (w) whether there is such a part
    tips: Floats  # (4 w, 2, 3) place [m] of each end, and value (real, imaginary, 0) for a unit strength
    holders: Ints  # (4 w) line of each end
    sides: Ints  # (4 w) 0 or 1 where the part to integrate starts or stops, -1 at the line's own ends


@core(fastmath=True, error_model="numpy")
def _steep(start: Floats, along: Floats, place: float, origins: Floats, wave: float, out: Floats) -> float:
    """Do as `edges._steep` at a distance from a line's start, for an integrand that falls as 1 / (r s)."""
    path, rate, bend, fade = 0.0, 0.0, 0.0, 0.0
    for s in range(2):
        square, run = 1e-8, 0.0
        for k in range(3):
            gap = start[k] + place * along[k] - origins[s, k]
            square += gap * gap
            run += gap * along[k]
        r = math.sqrt(square)
        run /= r
        path, rate, bend, fade = path + r, rate + run, bend + (1 - run * run) / r, fade - run / r
    slow = rate if abs(rate) > 1e-9 else 1e-9
    out[0], out[1], out[2] = 1 / (wave * slow), (fade - bend / slow) / (wave * slow), path
    return rate


@inner(fastmath=True, error_model="numpy")
def _slow_part(
    start: Floats, along: Floats, size: float, origins: Floats, wave: float, term: Floats, out: Floats
) -> None:
    """Write to `out` (2) the distances from a line's start between which its ends cannot stand for the integral [m]."""
    foot, off = np.empty(2), np.empty(2)
    for s in range(2):
        run, square = 0.0, 0.0
        for k in range(3):
            gap = origins[s, k] - start[k]
            run += gap * along[k]
            square += gap * gap
        foot[s], off[s] = run, math.sqrt(max(square - run * run, 1e-8))
    least = (foot[0] * off[1] + foot[1] * off[0]) / (off[0] + off[1])
    bend = 0.0
    for s in range(2):
        bend += 1 / math.sqrt(off[s] * off[s] + (least - foot[s]) ** 2)
    step = math.sqrt(1 / (wave * FAR * bend))
    for side in range(2):
        sign = 2.0 * side - 1
        gap = max(step, -least if side == 1 else least - size)
        out[side] = side * size  # all of the line on this side is slow, if nothing else is found
        for _ in range(8):
            place = least + sign * gap
            if place <= 0 or place >= size:
                break
            _steep(start, along, place, origins, wave, term)
            if abs(term[1]) <= FAR:
                out[side] = place
                break
            gap *= 1.3
    if out[0] < 0.5 * step:
        out[0] = 0.0
    if size - out[1] < 0.5 * step:
        out[1] = size


@loop(fastmath=True, error_model="numpy")
def part(starts: Floats, ends: Floats, origins: Floats, gate: Floats, wave: float, out: PartedLines) -> int:
    """Split lines: near the shortest path there is something to integrate, of the rest only the ends count.

    Args:
        starts: (w, 3) and ends: (w, 3) of the lines [m].
        origins: (2, 3) transmitter and receiver [m].
        gate: (2) least and greatest mean range [m].
        wave: wave number [1/m].
        out: `PartedLines` gets the results.

    Returns:
        How many ends there are.
    """
    near, held, tips, holders, sides = out
    at = 0
    along, term, share = np.empty(3), np.empty(3), np.empty(2)
    for w in range(len(starts)):
        size, held[w] = unit_to(starts[w], ends[w], along), False
        if size < 1e-9:
            continue
        rate = _steep(starts[w], along, 0.0, origins, wave, term)
        steep = abs(term[1]) <= FAR
        if rate * _steep(starts[w], along, size, origins, wave, term) > 0 and steep and abs(term[1]) <= FAR:
            share[0], share[1] = size, size
        else:
            _slow_part(starts[w], along, size, origins, wave, term, share)
        held[w] = share[0] < share[1]
        for k in range(3):
            near[w, 0, k], near[w, 1, k] = starts[w, k] + share[0] * along[k], starts[w, k] + share[1] * along[k]
        for step in range(4):  # the line's ends, then those of the part to integrate
            far = step % 2
            if held[w] and (share[1] >= size if far else share[0] <= 0):
                continue
            if step > 1 and not held[w]:
                continue
            place = share[far] if step > 1 else far * size
            _steep(starts[w], along, place, origins, wave, term)
            if 0.5 * term[2] > gate[1]:
                continue
            value, y = term[0] if 0 < step < 3 else -term[0], term[1]
            for k in range(3):
                tips[at, 0, k] = starts[w, k] + place * along[k]
            tips[at, 1, 0], tips[at, 1, 1], tips[at, 1, 2] = value * y, value * (1 - 3 * y * y), 0.0
            holders[at], sides[at] = w, far if step > 1 else -1
            at += 1
    return at


@lean(error_model="numpy")
def tie(owner: Ints, begin: Longs, tips: Floats, holders: Ints, sides: Ints, ties: Longs) -> int:
    """Find the piece that goes on from each end, and leave out ends of parts of which nothing was cut.

    Args:
        owner: (m) line of each piece, rising; pieces of a line come from its end to its start.
        begin: (w + 1) gets the first piece of each line.
        tips: (n, 2, 3) ends as `part` gives them; those kept move to the front, as do `holders` and `sides`.
        holders: (n) line of each.
        sides: (n) as `part` gives them.
        ties: (n) gets the piece that goes on from each end kept, -1 for none.

    Returns:
        How many ends are kept.
    """
    at = 0
    for w in range(len(begin)):
        while at < len(owner) and owner[at] < w:
            at += 1
        begin[w] = at
    count = 0
    for i in range(len(tips)):
        w, on = holders[i], -1
        if sides[i] >= 0:
            if begin[w] == begin[w + 1]:
                continue
            on = begin[w + 1] - 1 if sides[i] == 0 else begin[w]
        for j in range(2):
            for k in range(3):
                tips[count, j, k] = tips[i, j, k]
        holders[count], sides[count], ties[count] = w, sides[i], on
        count += 1
    return count
