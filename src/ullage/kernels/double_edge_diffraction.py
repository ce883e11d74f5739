"""Loops for waves that cross a face from edge to edge, there and back, by uniform diffraction.

A wave crosses straight over, or it turns at the edge of a sheet at right angles between both. That turn sends it back
to where it came from, as a dihedral does: for a distant radar all these paths of one sheet have the same length, off
the principal planes too. Each diffraction is Keller's [Keller1962] with the transition function of the uniform theory,
whose distance parameter at the turn is that of two edges in a row [KouyoumjianPathak1974].
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ullage.arrays import Bools, Floats, Ints, Longs
from ullage.kernels.facets import FROM, ONE, TO, VERTEX, Antennas, EchoSums, PulseGrid, Transmission, same, sight
from ullage.kernels.facets import turned as phasor
from ullage.kernels.loops import core, lean
from ullage.kernels.near import spread
from ullage.kernels.outlines import LineEcho, accumulate_pulses
from ullage.kernels.vectors import apart, dot, unit_to

C0 = 299_792_458.0
_LEAST_PARTS = 8  # over which the reflection at the edge between changes slowly


class EdgePairs(NamedTuple):
    """Pairs (p) of parallel edges of one face each."""

    gaps: Floats  # (p, 3) from the first edge to the second [m]
    angles: Floats  # (p, 2) of the free space about both edges, over pi
    inward: Floats  # (p, 2, 3) unit vectors from each edge into the face
    normals: Floats  # (p, 3) unit normals of the face
    transmissive: Bools  # (p) whether the wave runs over both sides
    lengths: Floats  # (p) of the first edge [m]


class PairLines(NamedTuple):
    """Pairs (p) of parallel edges as lines, and the edges that close the face between them."""

    starts: Floats  # (p, 3) of the first edge [m]
    ends: Floats  # (p, 3) [m]
    gaps: Floats  # (p, 3) from the first edge to the second [m]
    closed: Bools  # (p) whether it is a sheet, and edges run from start to start and from end to end


class PairPieces(NamedTuple):
    """Pieces (m) of the first edges of pairs."""

    ends: Floats  # (m, 2, 3) both ends of each piece [m]; of a path that turns as `turning` gives them
    pair: Ints  # (m) pair of each piece
    turns: Bools  # (m) whether the wave turns at an edge between both; otherwise it crosses straight over


@lean(fastmath=True, error_model="numpy")
def transition(x: float) -> complex:
    """The transition function F(x) of uniform diffraction, 1 far from the shadow's border [KouyoumjianPathak1974]."""
    if x > 12:
        return 1 + 0.5j / x - 0.75 / (x * x) - 1.875j / (x * x * x)
    s = math.sqrt(x)
    # erfc(sqrt(j) s) by its series: enough terms for s < 2.4
    z2 = complex(0.0, x)
    term = complex(1.0, 0.0)
    total = term
    for n in range(1, 60):
        term *= -z2 / n
        total += term / (2 * n + 1)
        if abs(term.real) + abs(term.imag) < 1e-10:
            break
    root = complex(math.sqrt(0.5), math.sqrt(0.5))
    tail = 0.5 * math.sqrt(math.pi) / root - s * total  # integral of e^{-j t^2} from s on
    return 2j * s * phasor(-x) * tail


@core(fastmath=True, error_model="numpy")
def _graze(
    w: int, side: int, pairs: EdgePairs, width: float, wave: float, antennas: Antennas, out: Floats
) -> tuple[complex, complex, complex]:
    """Diffraction along the face by one edge of a pair, at `out[2]`; the path length goes to `out[0, side]` [m].

    The magnetic field along the edge follows, of each antenna with its gain over the range.
    """
    inward, normals, fields, p = pairs.inward, pairs.normals, antennas.fields, out[2]
    ux, uy, uz, sent, taken, path = 0.0, 0.0, 0.0, 0j, 0j, 0.0
    nx, ny, nz = normals[w, 0], normals[w, 1], normals[w, 2]
    ix, iy, iz = inward[w, side, 0], inward[w, side, 1], inward[w, side, 2]
    tx, ty, tz = iy * nz - iz * ny, iz * nx - ix * nz, ix * ny - iy * nx
    for s in range(2):
        r, dx, dy, dz, gain = sight(antennas, ONE, s, p[0], p[1], p[2])
        sent, taken = taken, gain * spread(wave, r)
        path += 0.5 * r
        ux, uy, uz = ux + dx, uy + dy, uz + dz
        if s == 0 and same(antennas, ONE):
            sent, path = taken, r
            break
    size = max(math.sqrt(ux * ux + uy * uy + uz * uz), 1e-6)
    ux, uy, uz = ux / size, uy / size, uz / size
    for s in range(2):
        ex, ey, ez = fields[0, s, 0], fields[0, s, 1], fields[0, s, 2]
        along = ex * ux + ey * uy + ez * uz
        square = max(ex * ex + ey * ey + ez * ez - along * along, 1e-12)
        hz = ((uy * ez - uz * ey) * tx + (uz * ex - ux * ez) * ty + (ux * ey - uy * ex) * tz) / math.sqrt(square)
        if s == 0:
            sent *= hz
        else:
            taken *= hz
    out[0, side] = path
    sx = -(ux * ix + uy * iy + uz * iz)
    sy = -(ux * nx + uy * ny + uz * nz)
    phi = math.atan2(sy, sx)
    if phi < 0:
        phi += 2 * math.pi
    n = pairs.angles[w, side]
    if phi >= n * math.pi:
        return 0j, sent, taken
    half = math.cos(0.5 * phi)
    if abs(half) < 1e-4:
        half = 1e-4
        phi = math.pi - 2e-4
    d = 2 * math.sin(math.pi / n) / (n * (math.cos(math.pi / n) - math.cos(phi / n)))
    return d * transition(2 * wave * width * half * half), sent, taken


@core(fastmath=True, error_model="numpy")
def _across(w: int, pairs: EdgePairs, width: float, wave: float, antennas: Antennas, out: Floats) -> complex:
    """Diffraction by both edges of a pair, the first at `out[2]`, times fields; `out[0]` gets both path lengths [m].

    The wave of each antenna meets either edge first.
    """
    one, sent, taken = _graze(w, 0, pairs, width, wave, antennas, out)
    for j in range(3):
        out[2, j] += pairs.gaps[w, j]
    other, passed, met = _graze(w, 1, pairs, width, wave, antennas, out)
    # the second edge runs the other way in its own face's frame
    return -0.5 * (sent * met + taken * passed) * one * other * complex(math.sqrt(0.5), -math.sqrt(0.5))


@core(fastmath=True, error_model="numpy")
def _twice(
    pieces: PairPieces, k: int, end: int, pairs: EdgePairs, width: float, wave: float, antennas: Antennas, out: Floats
) -> tuple[complex, float]:
    """Strength per length of the wave that crosses the face from edge to edge, and path length [m]."""
    w = pieces.pair[k]
    for j in range(3):
        out[2, j] = pieces.ends[k, end, j]
    both = _across(w, pairs, width, wave, antennas, out)
    path = out[0, 0] + out[0, 1]
    spread = 1 / math.sqrt(2 * math.pi * wave * width * (1 + width / path))
    value = -(2.0 if pairs.transmissive[w] else 1.0) * both * spread
    return value, path + width


@core(fastmath=True, error_model="numpy", forceinline=True)
def _forward(x: float, y: float, z: float, t: Floats, sign: float, origins: Floats) -> float:
    """Mean cosine between the directions from both antennas to a place and the unit vector sign t."""
    total = 0.0
    for s in range(2):
        dx, dy, dz = x - origins[0, s, 0], y - origins[0, s, 1], z - origins[0, s, 2]
        total += (dx * t[0] + dy * t[1] + dz * t[2]) / max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
    return 0.5 * sign * total


@core(fastmath=True, error_model="numpy")
def _advance(lines: PairLines, w: int, end: int, t: Floats, size: float, sign: float, origins: Floats) -> float:
    """How far a wave runs along pair w while it crosses the face and turns at its `end`; 0 where no path does [m]."""
    run, gap, corner = 0.0, lines.gaps[w], lines.ends[w] if end == 1 else lines.starts[w]
    width2 = dot(gap, gap)
    for _ in range(3):
        back = -sign * min(0.5 * run, size)
        x, y, z = corner[0] + back * t[0], corner[1] + back * t[1], corner[2] + back * t[2]
        one = _forward(x, y, z, t, sign, origins)
        cosine = 0.5 * (one + _forward(x + gap[0], y + gap[1], z + gap[2], t, sign, origins))
        if cosine <= 0:
            return 0.0
        run = math.sqrt(width2 / max(1 - cosine * cosine, 1e-9)) * cosine
    return run if run < 2 * size else 0.0


@lean(fastmath=True, error_model="numpy")
def turning(which: Longs, lines: PairLines, origins: Floats, t: Floats, ends: Floats, pair: Ints) -> int:
    """Find the paths from the first edge of pairs to the second that turn at the edge between them.

    The path leaves the first edge as far before the turn as it meets the second behind it, in the mean. That point lies
    half way between both ends that are written: the corner, and the place by the wave's run along the pair before it.

    Args:
        which: (q) pairs to follow.
        lines: `PairLines` (p).
        origins: (1, 2, 3) transmitter and receiver [m].
        t: (3) scratch.
        ends: (q, 2, 3) gets both ends of each path's piece of the first edge, moved by half the gap [m].
        pair: (q) gets the pair of each path.

    Returns:
        How many paths there are.
    """
    at = 0
    for w in which:
        if not lines.closed[w]:
            continue
        size = unit_to(lines.starts[w], lines.ends[w], t)
        for j in range(3):
            ends[at, 0, j] = 0.5 * (lines.starts[w, j] + lines.ends[w, j] + lines.gaps[w, j])
        end = 1 if _forward(ends[at, 0, 0], ends[at, 0, 1], ends[at, 0, 2], t, 1.0, origins) > 0 else 0
        sign = 2.0 * end - 1
        run = _advance(lines, w, end, t, size, sign, origins)
        if run <= 0:
            continue
        for j in range(3):
            ends[at, 0, j] = (lines.ends[w, j] if end == 1 else lines.starts[w, j]) + 0.5 * lines.gaps[w, j]
            ends[at, 1, j] = ends[at, 0, j] - sign * run * t[j]
        pair[at] = w
        at += 1
    return at


@core(fastmath=True, error_model="numpy")
def along_sheet(x: float) -> complex:
    """e^{jx} erfc(sqrt(jx)): what is left at some distance of the wave that the edge of a sheet sends along it.

    At the edge the current across it has no way out, and the wave cancels the incident one (x = 0). Far off the wave
    is Keller's.
    """
    x = max(x, 1e-6)
    return transition(x) / math.sqrt(math.pi * x) * complex(math.sqrt(0.5), -math.sqrt(0.5))


@core(fastmath=True, error_model="numpy")
def _turned_strength(
    pieces: PairPieces, k: int, pairs: EdgePairs, width: float, run: float, wave: float, antennas: Antennas, out: Floats
) -> complex:
    """Strength per length of the wave that crosses obliquely, as if the turn returned all of it."""
    w, sine = pieces.pair[k], width / math.sqrt(width * width + run * run)
    for j in range(3):
        out[2, j] = 0.5 * (pieces.ends[k, 0, j] + pieces.ends[k, 1, j])
    both = _across(w, pairs, width * sine, wave, antennas, out)
    crossing = width / sine
    spreading = 1 / math.sqrt(2 * math.pi * wave * width * (1 + crossing / (out[0, 0] + out[0, 1])))
    # the stationary crossing and both diffractions at oblique incidence
    oblique = 1 / (sine * sine * math.sqrt(sine))
    return -2 * both * spreading * oblique


@core(fastmath=True, error_model="numpy")
def _turned_path(pieces: PairPieces, k: int, pairs: EdgePairs, shift: float, run: float, origins: Floats) -> float:
    """Both ranges [m] of the path that leaves the first edge by `shift` farther from the turn than in the mean.

    It meets the second edge by as much nearer to the turn.
    """
    total, w = 0.0, pieces.pair[k]
    for side in range(2):
        share = 0.5 + (shift if side == 0 else -shift) / run
        for s in range(2):
            square = 0.0
            for j in range(3):
                place = pieces.ends[k, 0, j] + share * (pieces.ends[k, 1, j] - pieces.ends[k, 0, j])
                square += (place + (pairs.gaps[w, j] if side == 1 else 0.0) - origins[0, s, j]) ** 2
            total += 0.5 * math.sqrt(square)
    return total


@core(fastmath=True, error_model="numpy")
def _accumulate_turned(
    pieces: PairPieces,
    k: int,
    pairs: EdgePairs,
    between: Transmission,
    antennas: Antennas,
    pulse: PulseGrid,
    sums: EchoSums,
    rows: Floats,
) -> None:
    """Add the echo of the paths of one pair that turn; they form a family along the first edge."""
    w, wave, late = pieces.pair[k], pulse.omega / C0, between.delay_s[k]
    run, width = apart(pieces.ends[k, 0], pieces.ends[k, 1]), math.sqrt(dot(pairs.gaps[w], pairs.gaps[w]))
    scale = antennas.factor[0] / (4 * math.pi * wave) * between.factor[k]
    reach = min(0.5 * run, pairs.lengths[w] - 0.5 * run)
    strength = scale * _turned_strength(pieces, k, pairs, width, run, wave, antennas, rows)
    crossing = math.sqrt(width * width + run * run)
    middle = _turned_path(pieces, k, pairs, 0.0, run, antennas.origins)
    sums.delay_s[k] = (middle + crossing) / C0 + late
    count = max(_LEAST_PARTS, int(2 * reach / math.sqrt(math.pi * middle / wave)) + 1)
    half = math.asin(min(2 * reach / run, 1.0))  # even parts of this angle: the reflection changes fast at the ends
    low = -reach
    before = _turned_path(pieces, k, pairs, low, run, antennas.origins)
    for i in range(count):
        high = 0.5 * run * math.sin(half * (2 * (i + 1) / count - 1))
        cosine = math.cos(half * ((2 * i + 1) / count - 1))
        after = _turned_path(pieces, k, pairs, high, run, antennas.origins)
        size = high - low
        returned = along_sheet(0.5 * wave * (run * cosine) ** 2 / crossing)
        value = strength * returned * size
        early = size * size / 12 * 4 / max(before + after, 0.02)
        delay = late - early / C0
        mean = (0.5 * (before + after) + crossing) / C0 + delay
        line = LineEcho(value, value, (before + crossing) / C0, (after + crossing) / C0, 1.5 * pulse.omega * early / C0)
        sums.echo[k] += accumulate_pulses(sums.grids, pulse, True, VERTEX, line, delay, mean)
        low, before = high, after


@lean(fastmath=True, error_model="numpy")
def accumulate_doubles(
    pieces: PairPieces,
    pairs: EdgePairs,
    between: Transmission,
    antennas: Antennas,
    pulse: PulseGrid,
    sums: EchoSums,
    rows: Floats,
) -> None:
    """Add the echoes of waves that cross a face between two parallel edges, there and back, to the delay grids.

    Args:
        pieces: `PairPieces` (m).
        pairs: `EdgePairs` (p).
        between: `facets.Transmission` (m).
        antennas: `facets.Antennas` of one radar.
        pulse: `facets.PulseGrid`.
        sums: `facets.EchoSums` (m), written.
        rows: (3, 3), scratch.
    """
    omega = pulse.omega
    wave = omega / C0
    scale = antennas.factor[0] / (4 * math.pi * wave)
    for k in range(len(pieces.ends)):
        sums.echo[k], sums.delay_s[k] = 0j, 0.0
        if between.factor[k] == 0:
            continue
        w, size = pieces.pair[k], apart(pieces.ends[k, 0], pieces.ends[k, 1])
        width = math.sqrt(dot(pairs.gaps[w], pairs.gaps[w]))
        if pieces.turns[k]:
            _accumulate_turned(pieces, k, pairs, between, antennas, pulse, sums, rows)
            continue
        w0, path0 = _twice(pieces, k, FROM, pairs, width, wave, antennas, rows)
        w1, path1 = _twice(pieces, k, TO, pairs, width, wave, antennas, rows)
        w0, w1 = w0 * scale * size * between.factor[k], w1 * scale * size * between.factor[k]
        early = size * size / 12 * 4 / max(path0 + path1 - 2 * width, 0.02)
        late = between.delay_s[k] - early / C0
        mean = 0.5 * (path0 + path1) / C0 + late
        sums.delay_s[k] = mean
        line = LineEcho(w0, w1, path0 / C0, path1 / C0, 1.5 * omega * early / C0)
        sums.echo[k] = accumulate_pulses(sums.grids, pulse, True, VERTEX, line, late, mean)
