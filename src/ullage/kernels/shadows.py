"""Loops over borders of shadow about mirror points: what part of the echo they leave."""

from __future__ import annotations

import cmath
import math

from ullage.kernels.loops import core, lean

CLOSE = 0.1
"""The nearest point of a border that passes nearer than this lies in the middle of the directions that meet it."""


@core(nogil=True, error_model="numpy", forceinline=True)
def _fading(phase, least, last):  # type: ignore[no-untyped-def]
    """1 up to a phase, smoothly down to 0 at another."""
    if phase <= least:
        return 1.0
    if phase >= last:
        return 0.0
    half = math.cos(0.5 * math.pi * (phase - least) / (last - least))
    return half * half


@core(nogil=True, error_model="numpy")
def _along(gap, foot, begin, end, ratio, faded, nodes, weights):  # type: ignore[no-untyped-def]
    """Integral of e^{-j phase} over an angle along a line whose nearest point lies `gap` away, at the angle `foot`."""
    begin, end = max(begin, foot - 0.5 * math.pi), min(end, foot + 0.5 * math.pi)
    if end <= begin:
        return 0j
    total = 0j
    for k in range(len(nodes)):
        angle = begin + nodes[k] * (end - begin)
        square = (gap / max(math.cos(angle - foot), 1e-6)) ** 2
        weight = _fading(ratio * square, faded[0], faded[1]) * _fading(square, faded[2], faded[3])
        if weight > 0:
            total += weights[k] * weight * cmath.exp(-1j * ratio * square)
    return total * (end - begin)


@core(nogil=True, error_model="numpy")
def _piece(x0, y0, x1, y1, begin, end, ratio, sign, faded, nodes, weights, part):  # type: ignore[no-untyped-def]
    """Adds what a border through two points does between two angles: one way, and both ways together."""
    ex, ey = x1 - x0, y1 - y0
    turned = x0 * ey - y0 * ex
    gap = abs(turned) / max(math.sqrt(ex * ex + ey * ey), 1e-12)
    foot = math.atan2(-ex, ey) if turned >= 0 else math.atan2(ex, -ey)
    foot += 2 * math.pi * math.floor((0.5 * (begin + end) - foot) / (2 * math.pi) + 0.5)
    part[0] += sign * _along(gap, foot, begin, end, ratio, faded, nodes, weights)
    if gap < CLOSE:
        foot = cmath.phase(part[2])
        foot += 2 * math.pi * math.floor((0.5 * (begin + end) - foot) / (2 * math.pi) + 0.5)
    wide = math.atan(math.sqrt((1 - ratio) / (1 + ratio)))
    part[1] += _along(gap, foot, max(begin, foot - wide), min(end, foot + wide), ratio, faded, nodes, weights)


@core(nogil=True, error_model="numpy")
def _lines(counts, reach, labels):  # type: ignore[no-untyped-def]
    """Numbers borders (n, m) that go on from direction to direction alike; gives how many there are."""
    many, made = len(counts), 0
    for a in range(many):
        for m in range(counts[a]):
            labels[a, m] = -1
    for a in range(many):
        b = a + 1 if a + 1 < many else 0
        for m in range(counts[a]):
            if labels[a, m] < 0:
                labels[a, m] = made
                made += 1
            old, new = labels[b, m] if m < counts[b] else -2, labels[a, m]
            if old == -1:
                labels[b, m] = new
            elif old >= 0 and old != new:
                for c in range(many):
                    for q in range(counts[c]):
                        if labels[c, q] == old:
                            labels[c, q] = new
    return made


@core(nogil=True, error_model="numpy")
def _ended(counts, reach, ratios, a, m, side, sign, faded, nodes, weights, part):  # type: ignore[no-untyped-def]
    """Adds what a border does beyond the last direction in which it was met, on one side (1 or -1).

    A straight one goes on; where it would have been met in the next direction, it ends half way there.
    """
    many = len(counts)
    step = 2 * math.pi / many
    here, back = a * step, a - side
    back = back - many if back >= many else back + many if back < 0 else back
    rho = reach[a, m]
    x0, y0 = rho * math.cos(here), rho * math.sin(here)
    if m < counts[back]:
        x1, y1 = reach[back, m] * math.cos(back * step), reach[back, m] * math.sin(back * step)
    else:
        x1, y1 = x0 - y0, y0 + x0
    ex, ey = x1 - x0, y1 - y0
    turned = x0 * ey - y0 * ex
    gap = abs(turned) / max(math.sqrt(ex * ex + ey * ey), 1e-12)
    foot = math.atan2(-ex, ey) if turned >= 0 else math.atan2(ex, -ey)
    cosine = math.cos(here + side * step - foot)
    far = cosine <= 0 or (gap / max(cosine, 1e-9)) ** 2 > faded[3]
    end = here + side * step * (1.0 if far else 0.5)
    _piece(x0, y0, x1, y1, min(here, end), max(here, end), ratios[a, m], sign, faded, nodes, weights, part)


@lean(nogil=True, error_model="numpy")
def shares(free, counts, reach, ratios, faded, nodes, weights, labels, parts, out):  # type: ignore[no-untyped-def]
    """What part of the echo of mirror points is left by what stands before their faces, there and back.

    Args:
        free: (k) whether the mirror point itself is seen.
        counts: (k, n) borders along each direction about it.
        reach: (k, n, m) where they lie, in order, to where the phase over the face is 1 rad.
        ratios: (k, n, m) r of each border.
        faded: (4) phases between which borders fade out, and the same for the squares of `reach`.
        nodes, weights: of Gauss's rule over (0, 1).
        labels: (n, m) whole numbers, parts: (n m, 3) complex, scratch.
        out: (k) gets them.
    """
    many = counts.shape[1]
    step = 2 * math.pi / many
    for i in range(len(out)):
        made = _lines(counts[i], reach[i], labels)
        for label in range(made):
            for k in range(3):
                parts[label, k] = 0j
        total, met = 0.0, 0
        for a in range(many):
            for m in range(counts[i, a]):
                parts[labels[a, m], 2] += cmath.exp(1j * a * step)
        for a in range(many):
            b, before = a + 1 if a + 1 < many else 0, a - 1 if a > 0 else many - 1
            here, there = a * step, (a + 1) * step
            for m in range(counts[i, a]):
                sign = -1.0 if (m % 2 == 0) == free[i] else 1.0
                part, rho, ratio = parts[labels[a, m]], reach[i, a, m], ratios[i, a, m]
                total, met = total + ratio, met + 1
                if m >= counts[i, before]:
                    _ended(counts[i], reach[i], ratios[i], a, m, -1, sign, faded, nodes, weights, part)
                if m >= counts[i, b]:
                    _ended(counts[i], reach[i], ratios[i], a, m, 1, sign, faded, nodes, weights, part)
                    continue
                other = reach[i, b, m]
                _piece(rho * math.cos(here), rho * math.sin(here), other * math.cos(there), other * math.sin(there),
                       here, there, 0.5 * (ratio + ratios[i, b, m]), sign, faded, nodes, weights, part)  # fmt: skip
        whole = 1 + 0j if free[i] else 0j
        first = whole
        for label in range(made):
            first += parts[label, 0] / (2 * math.pi)
        apart = 1 - 2 / math.pi * math.asin(min(total / met, 1.0)) if met else 0.0
        second = first - apart * (first - first * first)
        for label in range(made):
            lone = whole + parts[label, 0] / (2 * math.pi)
            second += apart * (lone - lone * lone) - parts[label, 1] / (2 * math.pi)
        out[i] = second
