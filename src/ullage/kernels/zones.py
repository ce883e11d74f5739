"""Loops over the Fresnel zones of mirror paths: how far faces reach in each direction, and what of a zone is free."""

from __future__ import annotations

import math
from typing import NamedTuple

from ullage.arrays import Bools, Complexes, Floats, Ints, Longs
from ullage.kernels.bounces import first_leg
from ullage.kernels.facets import FROM, ONE, TO, Antennas, toward
from ullage.kernels.loops import core, lean
from ullage.kernels.vectors import apart, dot, unit_to


@core(error_model="numpy", forceinline=True)
def _lengths(
    place: Floats, image: Floats, receiver: Floats, normal: Floats, offset: float
) -> tuple[float, float, float]:
    """Both legs of a path from its last image over a place (3) to the receiver, and the path over a mirror [m]."""
    twice, straight = 2 * (dot(normal, image) - offset), 0.0
    for k in range(3):
        straight += (image[k] - twice * normal[k] - receiver[k]) ** 2
    return apart(image, place), apart(place, receiver), math.sqrt(straight)


class BeamEnds(NamedTuple):
    """Where beams (b) from the transmitter's images end."""

    images: Floats  # (b, 3) the transmitter's last image [m]
    receiver: Floats  # (3) [m]
    on: Longs  # (b) face at the end


class FacePlanes(NamedTuple):
    """Planes of faces (p)."""

    normals: Floats  # (p, 3) unit normals
    offsets: Floats  # (p) normal . x = offset [m]
    across: Floats  # (p, 2, 3) two unit vectors in each face, at right angles


class Strengths(NamedTuple):
    """What paths (b) would bring if nothing stood in their way and faces had no ends."""

    level: Floats  # (b) path gain amplitudes, 0 for paths that are left out
    excess: Floats  # (b) by which each path is longer than that over the mirror point [m]
    axes: Floats  # (b, 2, 3) of its Fresnel zone, in the plane of incidence and across it, to where the phase is 1 [m]


@lean(error_model="numpy")
def strengths(
    paths: Floats,
    ends: BeamEnds,
    faces: FacePlanes,
    factor: Complexes,
    antennas: Antennas,
    wave: float,
    found: Strengths,
    units: Floats,
) -> None:
    """Find how strong paths would be if nothing stood in their way and faces had no ends, and the axes of their zones.

    Args:
        paths: (b, d, 3) corners from transmitter to receiver, the last but one on the face at the end [m].
        ends: `BeamEnds` (b).
        faces: `FacePlanes`.
        factor: (b) complex, what reflections leave; paths where it is 0 are left out.
        antennas: `facets.Antennas` of one radar.
        wave: wave number [1/m].
        found: `Strengths` (b), written.
        units: (2, 3) scratch.
    """
    sent, taken = units[0], units[1]
    level, excess, axes, across = found.level, found.excess, found.axes, faces.across
    for i in range(len(paths)):
        level[i], excess[i] = 0.0, 0.0
        if factor[i] == 0:
            continue
        p = ends.on[i]
        lit = paths[i, paths.shape[1] - 2]
        there, back, straight = _lengths(lit, ends.images[i], ends.receiver, faces.normals[p], faces.offsets[p])
        excess[i] = there + back - straight
        unit_to(paths[i, 0], paths[i, first_leg(paths[i]) + 1], sent)
        along, aside = 0.0, 0.0
        for k in range(3):
            taken[k] = (lit[k] - ends.receiver[k]) / max(back, 1e-12)
            along -= across[p, 0, k] * taken[k]
            aside -= across[p, 1, k] * taken[k]
        gain = toward(antennas.table, antennas.isotropic, antennas.frames, ONE, FROM, sent[0], sent[1], sent[2])
        gain *= toward(antennas.table, antennas.isotropic, antennas.frames, ONE, TO, taken[0], taken[1], taken[2])
        level[i] = abs(factor[i] * gain) / (2 * wave * (there + back))
        slant = math.sqrt(max(1 - along * along - aside * aside, 0.01))
        reach = math.sqrt(2 / wave / (1 / there + 1 / back))
        size = math.sqrt(along * along + aside * aside)
        along, aside = (along / size, aside / size) if size > 1e-6 else (1.0, 0.0)
        for k in range(3):
            axes[i, 0, k] = (along * across[p, 0, k] + aside * across[p, 1, k]) * reach / slant
            axes[i, 1, k] = (along * across[p, 1, k] - aside * across[p, 0, k]) * reach


@lean(error_model="numpy")
def outline(
    lit: Floats, axes: Floats, which: Longs, first: Ints, edges: Floats, turn: Floats, last: float, out: Floats
) -> None:
    """Phase (k, rays) at which each ray from a mirror point leaves the face's lit part, at most `last` [rad].

    Args:
        lit: (k, 3) mirror points [m].
        axes: (k, 2, 3) at right angles, to where the phase is 1 rad [m].
        which: (k) outline of each.
        first: (b + 1) first edge of each outline; edges: (e, 2, 3) [m].
        turn: (rays, 2) cosine and sine of each ray's angle to the axes.
        last: [rad].
        out: (k, rays) gets the phases [rad].
    """
    for i in range(len(lit)):
        for r in range(len(turn)):
            out[i, r] = last
        sizes = 0.0, 0.0
        for k in range(3):
            sizes = sizes[0] + axes[i, 0, k] ** 2, sizes[1] + axes[i, 1, k] ** 2
        for e in range(first[which[i]], first[which[i] + 1]):
            ax, ay, bx, by = 0.0, 0.0, 0.0, 0.0
            for k in range(3):
                a, b = edges[e, 0, k] - lit[i, k], edges[e, 1, k] - lit[i, k]
                ax, ay = ax + a * axes[i, 0, k] / sizes[0], ay + a * axes[i, 1, k] / sizes[1]
                bx, by = bx + b * axes[i, 0, k] / sizes[0], by + b * axes[i, 1, k] / sizes[1]
            for r in range(len(turn)):
                x, y = turn[r, 0], turn[r, 1]
                bottom = x * (by - ay) - y * (bx - ax)
                if bottom == 0:
                    continue
                away, along = (ax * (by - ay) - ay * (bx - ax)) / bottom, (ax * y - ay * x) / bottom
                if away > 0 and -1e-9 <= along <= 1 + 1e-9:
                    out[i, r] = min(out[i, r], away * away)


@lean(error_model="numpy")
def places(lit: Floats, axes: Floats, ends: Floats, turn: Floats, last: float, asked: Floats, out: Floats) -> None:
    """Where to ask about zones (k): along each ray in the middles of cells of like shares of the fading weight.

    Args:
        lit: (k, 3) mirror points and axes: (k, 2, 3) of the zones [m].
        ends: (k, n rays) phases at which the face ends, on n times as many rays, those asked for among them [rad].
        turn: (n rays, 2) cosine and sine of each.
        last: phase at which the weight has faded out [rad].
        asked: (k, rays, cells) gets the phases [rad].
        out: (k rays cells, 3) gets the places [m].
    """
    rays, cells = asked.shape[1], asked.shape[2]
    row, fine = 0, ends.shape[1] // rays
    for i in range(len(lit)):
        for r in range(rays):
            left = 1 - ends[i, fine * r] / last
            whole = 1 - left * left
            for c in range(cells):
                asked[i, r, c] = last * (1 - math.sqrt(1 - (c + 0.5) / cells * whole))
                away = math.sqrt(asked[i, r, c])
                x, y = away * turn[fine * r, 0], away * turn[fine * r, 1]
                for k in range(3):
                    out[row, k] = lit[i, k] + x * axes[i, 0, k] + y * axes[i, 1, k]
                row += 1


@core(error_model="numpy")
def _summed(phase: float, last: float) -> complex:
    """What a direction counts as far as a phase, the weight fading until `last`."""
    real, imag = -1 / last, 1 - phase / last
    cosine, sine = math.cos(phase), -math.sin(phase)
    return complex(real * cosine - imag * sine, real * sine + imag * cosine)


@lean(error_model="numpy")
def whole(ends: Floats, last: float, out: Complexes) -> None:
    """What rays (k, rays) that end at these phases count together (k) if all is free."""
    for i in range(len(ends)):
        total = 0j
        for r in range(ends.shape[1]):
            total += _summed(ends[i, r], last) - _summed(0.0, last)
        out[i] = total


@core(error_model="numpy")
def _between(one: float, other: float, share: float, step: float) -> float:
    """Phase at which a line that crosses two rays at these phases crosses one between them."""
    first, second = math.sin((1 - share) * step), math.sin(share * step)
    place = math.sin(step) / (first / math.sqrt(max(one, 1e-12)) + second / math.sqrt(max(other, 1e-12)))
    return place * place


@core(error_model="numpy")
def _turns(free: Bools, borders: Floats, out: Floats) -> int:
    """Phases at which light and shadow change along a ray of cells, and how many there are."""
    count = 0
    for c in range(1, len(free)):
        if free[c] != free[c - 1]:
            out[count] = borders[c]
            count += 1
    return count


@lean(error_model="numpy")
def parts(
    free: Bools, borders: Floats, ends: Floats, last: float, turns: Floats, counts: Longs, out: Complexes
) -> None:
    """What part (k) of each zone is free. Borders of shadow run straight from one ray that was followed to the next.

    Args:
        free: (k, rays, cells) whether each cell of the rays that were followed is free.
        borders: (k, rays, cells) phases at which the cells begin [rad].
        ends: (k, n rays) phases at which the face ends, on n times as many rays, those followed among them [rad].
        last: phase at which the weight has faded out [rad].
        turns, counts: (rays, cells), (rays), scratch.
        out: (k) gets the shares.
    """
    rays, fine = free.shape[1], ends.shape[1] // free.shape[1]
    step = 2 * math.pi / rays
    for i in range(len(free)):
        total, some = 0j, 0j
        for r in range(rays):
            counts[r] = _turns(free[i, r], borders[i, r], turns[r])
        for j in range(rays * fine):
            one = j // fine
            other, share, end = (one + 1) % rays, j / fine - one, ends[i, j]
            total += _summed(end, last) - _summed(0.0, last)
            alike = share > 0 and counts[one] == counts[other] and free[i, one, 0] == free[i, other, 0]
            here = one if share < 0.5 else other
            lit, begin = free[i, here, 0], 0.0
            for c in range(counts[here] + 1):
                stop = end
                if c < counts[here]:
                    stop = min(_between(turns[one, c], turns[other, c], share, step) if alike else turns[here, c], end)
                if lit:
                    some += _summed(stop, last) - _summed(begin, last)
                lit, begin = not lit, stop
        out[i] = some / total
