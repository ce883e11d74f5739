"""Loops over shadow borders about mirror points: what part of the echo they leave."""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple

from ullage.arrays import Bools, Complexes, Floats, Longs
from ullage.kernels.facets import turned
from ullage.kernels.loops import core, lean

QUARTER = cmath.sqrt(0.5j)
FAR, SLOPE = 5.0, 0.1
"""A line runs on where the next direction would meet it so far off, or is so nearly parallel to it."""


class Fading(NamedTuple):
    """Phases [rad] between which borders fade out."""

    least: float  # over the occluder
    last: float
    least_on_face: float  # over the face, whatever the occluder's distance
    last_on_face: float


class ShadowBorders(NamedTuple):
    """Shadow borders about mirror points (k), along n directions, n even."""

    lit: Bools  # (k) whether the mirror point itself is lit
    counts: Longs  # (k, n) borders along each direction
    reach: Floats  # (k, n, m) their distances in order, over the distance at which the phase is 1 rad
    ratios: Floats  # (k, n, m) correlation r of both passes at each
    normals: Floats  # (k, n, m, 2) unit normals to them, along the first direction and across it; NaN if not known


class QuadratureRule(NamedTuple):
    """Gauss's rule over (0, 1)."""

    nodes: Floats  # (q)
    weights: Floats  # (q)


class Rules(NamedTuple):
    """Rules for integrands whose phase changes little, and for others."""

    coarse: QuadratureRule
    fine: QuadratureRule


ALIKE = 0.5
"""Cosine of the angle between the normals of one border along two directions, at the least."""
STEADY = 6.0
"""Change of phase over an integral up to which the coarse rule does [rad]."""


@core(error_model="numpy", forceinline=True)
def _fading(phase: float, least: float, last: float) -> float:
    """1 up to a phase, smoothly down to 0 at another."""
    if phase <= least:
        return 1.0
    if phase >= last:
        return 0.0
    half = math.cos(0.5 * math.pi * (phase - least) / (last - least))
    return half * half


@core(error_model="numpy", forceinline=True)
def _fresnel(t: float) -> complex:
    """C(t) - j S(t) to 0.002 [AbramowitzStegun1964, 7.3.32]."""
    x = min(abs(t), 1e4)  # beyond, `turned` is not exact
    f, g = (1 + 0.926 * x) / (2 + 1.792 * x + 3.104 * x * x), 1 / (2 + 4.142 * x + 3.492 * x * x + 6.670 * x**3)
    out = 0.5 - 0.5j + complex(-g, f) * turned(0.5 * math.pi * x * x)
    return out if t >= 0 else -out


@core(error_model="numpy")
def _along(line: Floats, ratio: float, fading: Fading, rules: Rules) -> complex:
    """Integral of e^{-j ratio reach^2} over the angle along a line as `_lines` gives it."""
    gap, foot, begin, end = line[2], line[3], line[4], line[5]
    begin, end = max(begin, foot - 0.5 * math.pi), min(end, foot + 0.5 * math.pi)
    if end <= begin or ratio * gap * gap >= fading.last or gap * gap >= fading.last_on_face:
        return 0j
    total = 0j
    least, most = abs(begin - foot), abs(end - foot)
    least, most = (0.0 if begin <= foot <= end else min(least, most)), max(least, most)
    swept = ratio * gap * gap * (1 / max(math.cos(most), 1e-3) ** 2 - 1 / max(math.cos(least), 1e-3) ** 2)
    rule = rules.coarse if swept < STEADY else rules.fine
    for k in range(len(rule.nodes)):
        angle = begin + rule.nodes[k] * (end - begin)
        square = (gap / max(math.cos(angle - foot), 1e-6)) ** 2
        weight = _fading(ratio * square, fading.least, fading.last)
        weight *= _fading(square, fading.least_on_face, fading.last_on_face)
        if weight > 0:
            total += rule.weights[k] * weight * turned(ratio * square)
    return total * (end - begin)


@core(error_model="numpy")
def _bound(a: float, b: float, ratio: float, fading: Fading, rules: Rules) -> complex:
    """What two parallel edges, one on each pass, add because the places of both passes correlate [Plackett1954].

    Integral over the correlation, from none to `ratio`; a and b: distances of the edges, 1 where the phase is 1 rad.
    """
    total, most = 0j, math.asin(min(ratio, 1.0))
    near, far = 0.5 * (a - b) ** 2, 0.5 * (a + b) ** 2
    weight = _fading(0.5 * (near + far), fading.least, fading.last)
    if weight == 0:
        return 0j
    sine = min(ratio, 1.0)
    swept = far * sine / (1 + sine) + near * sine / max(1 - sine, 1e-9)
    rule = rules.coarse if swept < STEADY else rules.fine
    for k in range(len(rule.nodes)):
        sine = math.sin(rule.nodes[k] * most)
        total += rule.weights[k] * turned(far / (1 + sine) + near / max(1 - sine, 1e-9))
    return total * weight * most / (2 * math.pi)


@core(error_model="numpy", forceinline=True)
def _line(x0: float, y0: float, x1: float, y1: float, out: Floats) -> None:
    """Unit normal (away from the middle), distance and foot's angle of a line through two points."""
    ex, ey = x1 - x0, y1 - y0
    length = max(math.sqrt(ex * ex + ey * ey), 1e-12)
    turned = (x0 * ey - y0 * ex) / length
    side = 1.0 if turned >= 0 else -1.0
    out[0], out[1], out[2] = side * ey / length, -side * ex / length, abs(turned)
    out[3] = math.atan2(out[1], out[0])


@core(error_model="numpy", forceinline=True)
def _goes_on(borders: ShadowBorders, i: int, a: int, b: int, m: int) -> bool:
    """Whether border m along direction a is border m along direction b too: those of a rod's two sides are not."""
    if m >= borders.counts[i, b]:
        return False
    one, other = borders.normals[i, a, m], borders.normals[i, b, m]
    return not one[0] * other[0] + one[1] * other[1] < ALIKE


@core(error_model="numpy")
def _lines(borders: ShadowBorders, i: int, lines: Floats) -> None:
    """Straight lines (n, m, 6) of all borders about mirror point i: as `_line`, then the angles where each ends."""
    counts, reach = borders.counts[i], borders.reach[i]
    many = len(counts)
    step = 2 * math.pi / many
    for a in range(many):
        b, c = a + 1 if a + 1 < many else 0, a - 1 if a > 0 else many - 1
        for m in range(counts[a]):
            out = lines[a, m]
            rho, here = reach[a, m], a * step
            x, y = rho * math.cos(here), rho * math.sin(here)
            on, back = _goes_on(borders, i, a, b, m), _goes_on(borders, i, a, c, m)
            nx, ny = borders.normals[i, a, m, 0], borders.normals[i, a, m, 1]
            if on:
                _line(x, y, reach[b, m] * math.cos(here + step), reach[b, m] * math.sin(here + step), out)
            elif not math.isnan(nx):
                _line(x, y, x - ny, y + nx, out)
            elif back:
                _line(x, y, reach[c, m] * math.cos(here - step), reach[c, m] * math.sin(here - step), out)
            else:
                _line(x, y, x - y, y + x, out)
            out[3] += 2 * math.pi * math.floor((here - out[3]) / (2 * math.pi) + 0.5)
            out[4] = here if back else here - step * _beyond(out, here - step)
            out[5] = here + step * (1.0 if on else _beyond(out, here + step))


@core(error_model="numpy", forceinline=True)
def _beyond(line: Floats, angle: float) -> float:
    """Share of a step that a line continues beyond its last crossing: half, or all where it may be far off."""
    return 1.0 if math.cos(angle - line[3]) < max(SLOPE, line[2] / FAR) else 0.5


@core(error_model="numpy", forceinline=True)
def _run(line: Floats, ratio: float) -> complex:
    """Fresnel's integral along a line between its angles: 1 for all of it."""
    root = math.sqrt(2 * ratio / math.pi) * line[2]
    least, last = line[3] - 0.5 * math.pi + 1e-9, line[3] + 0.5 * math.pi - 1e-9
    begin, end = min(max(line[4], least), last), max(min(line[5], last), least)
    return QUARTER * (_fresnel(root * math.tan(end - line[3])) - _fresnel(root * math.tan(begin - line[3])))


@core(error_model="numpy")
def _paired(borders: ShadowBorders, i: int, a: int, m: int, lines: Floats, fading: Fading, rules: Rules) -> complex:
    """What border m along direction a adds with itself and with the other borders along its line through the middle."""
    many = borders.counts.shape[1]
    line, ratio, step = lines[a, m], borders.ratios[i, a, m], 2 * math.pi / many
    x, y = math.cos(a * step), math.sin(a * step)
    gap = line[2] * math.sqrt(ratio)
    both = _bound(gap, gap, ratio, fading, rules)
    for side in range(2):
        c = a if side == 0 else (a + many // 2) % many
        for q in range(borders.counts[i, c]):
            if side == 0 and q == m:
                continue
            other = borders.ratios[i, c, q]
            alike = line[0] * lines[c, q, 0] + line[1] * lines[c, q, 1]
            alike *= 1.0 if (q - m) % 2 == 0 else -1.0
            away = borders.reach[i, c, q] * (line[0] * x + line[1] * y) * (1 - 2 * side)
            both += alike * _bound(gap, away * math.sqrt(other), math.sqrt(ratio * other), fading, rules)
    return both * _run(line, ratio)


@lean(error_model="numpy")
def echo_shares(borders: ShadowBorders, fading: Fading, rules: Rules, lines: Floats, out: Complexes) -> None:
    """Find what part of the echoes of mirror points is left by what stands before their faces, there and back.

    Args:
        borders: `ShadowBorders` (k, n, m).
        fading: `Fading`.
        rules: `Rules`.
        lines: (n, m, 6) scratch.
        out: (k) complex, gets them.
    """
    for i in range(len(out)):
        lit = borders.lit[i]
        _lines(borders, i, lines)
        first, bound = (1 + 0j if lit else 0j), 0j
        for a in range(borders.counts.shape[1]):
            for m in range(borders.counts[i, a]):
                sign = -1.0 if (m % 2 == 0) == lit else 1.0
                first += sign / (2 * math.pi) * _along(lines[a, m], borders.ratios[i, a, m], fading, rules)
                bound += _paired(borders, i, a, m, lines, fading, rules)
        out[i] = first * first + bound
