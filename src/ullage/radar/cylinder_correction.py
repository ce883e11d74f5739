"""Correct the echoes of cylindrical walls that a mesh describes by flat strips, and of the flat caps at their ends.

A strip lies inside the smooth wall by a depth that is the same in every strip, so the mesh echoes like a grating. Where
the echoes of neighbouring strips differ by whole wavelengths, it returns ghosts between the near and the far wall, some
25 dB below them. Finer strips do not help down to half a wavelength: the harmonics of a parabola fall with the square
of their order, and its depth with the square of its width.

So each strip adds the difference of Kirchhoff's integral over its arc and over its chord [Balanis2012, ch. 7]. Across
the strip this is a sum at Gauss points. Along the axis, where the surface is straight, it is a Fresnel integral from
end to end. The arc passes through the corners of the strip, where the mesh lies on the surface that it describes. Each
end of a strip has a phase, an amplitude and a delay of its own. A flat cap ends on the chords. The slivers between
chords and arcs are added, so that the end of the wall and the rim of the cap coincide.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import fresnel

from ullage.arrays import Bools, Complexes, Floats, Longs
from ullage.geometry import C0
from ullage.kernels.facets import Transmission
from ullage.radar.context import AntennaPair, RadarFrame
from ullage.radar.echo_set import EchoSet
from ullage.radar.quadrics import Quadric
from ullage.radar.reflected_paths import accumulate, scattered

NODES, SHARES = np.polynomial.legendre.leggauss(4)
PANEL_M = 0.025
"""Largest width of the panels of a strip [m]: the delays within one must not spread over a pulse."""
_PULL_M = 4e-3  # distance of visibility rays from strips and their ends [m]
_LEAST_M = 0.05  # least distance to a wall for rays [m]
_AT_SPECULAR = 1e-2  # Fresnel argument below which an end counts as at the specular point
_THIN = 1e-4  # phase [rad] below which a sliver counts as flat
_SIDES = np.array([0, -1, 1])


class Lines(NamedTuple):
    """Lines along the axes of walls on the chords of strips, each for a panel of its strip."""

    at: Floats  # (n, 3) points of the lines at the middle of their wall [m]
    axes: Floats  # (n, 3) unit vectors along them
    inward: Floats  # (n, 3) unit vectors to the axis, square to the strip
    left: Floats  # (n, 3) unit vectors across both
    ends: Floats  # (n, 2) begin and end of the strip along the line, from that point [m]
    caps: Floats  # (n, 2) flat cap at each end: 1, around a hole -1, none 0
    aside: Floats  # (n) offset from the middle of the chord, as a share of half the chord
    half: Floats  # (n) half of a panel's width [m]
    chord: Floats  # (n) half of the strip's [m]
    depth: Floats  # (n) of the arc over its chord [m]
    pull: Floats  # (n) distance in front of the strip at which the wall itself hides nothing [m]
    strips: Longs  # (n) index of the strip, over all walls
    object_ids: Longs  # (n) object


class Places(NamedTuple):
    """Points on lines that contribute: the specular points and the ends of strips of walls, then the ends of caps."""

    rows: Longs  # (m) the line of each
    side: Longs  # (m) -1: lower end, 1: upper end, 0: specular point
    flat: Bools  # (m) whether the point belongs to a flat cap, not to the wall
    heights: Floats  # (m) position along the line [m]


class Spots(NamedTuple):
    """Places with their directions and distances from both antennas."""

    lines: Lines  # (m) the line of each
    places: Places  # (m)
    points: Floats  # (m, 3) [m]
    paths: Floats  # (2, m, 3) unit vectors from both antennas to them
    ranges: Floats  # (2, m) [m]
    upward: Floats  # (2, m) cosines between both paths and the axis
    outward: Floats  # (2, m) cosines between both paths and the outward normal


def accumulate_cylinder_corrections(frame: RadarFrame) -> list[EchoSet]:
    """Add to the delay grids the difference between the arcs of walls and drums and the strips of their meshes."""
    wavelength, gate = frame.context.spec.wavelength_m, frame.context.gate[1]
    lines = lines_of(frame.quadrics, wavelength / 2, frame.context.widest_m)
    if lines is None:
        return []
    places = _places(frame.antennas, lines, 2 * gate)
    if not len(places.rows):
        return []
    places, between = _free(frame, lines, places)
    return [_echoes_of(frame, _spots(frame.antennas, lines, places), between)] if len(places.rows) else []


@lru_cache(maxsize=8)  # walls at rest are the same from frame to frame
def lines_of(quadrics: tuple[Quadric, ...], narrowest: float, widest: float) -> Lines | None:
    """Make lines on all strips between two widths [m]: finer strips are no grating, wider ones are mirrors."""
    made = [_lines(wall) for wall in quadrics if len(wall.strips) and narrowest < wall.widest < widest]
    if not made:
        return None
    first = np.cumsum([0, *(one.strips.max() + 1 for one in made)])
    numbered = [one._replace(strips=one.strips + k) for one, k in zip(made, first[:-1], strict=True)]
    return Lines(*(np.concatenate(rows) for rows in zip(*numbered, strict=True)))


def _lines(wall: Quadric) -> Lines:
    angle, half, low, high = wall.strips.T
    chord = wall.radius * np.sin(half)
    panels = np.ceil(2 * chord / PANEL_M).astype(np.int64)
    strips = np.repeat(np.arange(len(panels)), panels)
    number = np.arange(len(strips)) - np.repeat(panels.cumsum() - panels, panels)
    aside = (2 * number + 1) / panels[strips] - 1
    caps = wall.caps if len(wall.caps) else np.zeros((len(panels), 2))
    outward = np.stack([np.cos(angle), np.sin(angle)], 1)[strips]
    at = (wall.radius * np.cos(half))[strips, None] * outward + (aside * chord[strips])[:, None] * _left(outward)
    each = np.ones(len(strips))
    axes, inward = each[:, None] * wall.axes[2], -outward @ wall.axes[:2]
    return Lines(wall.centre + at @ wall.axes[:2], axes, inward, np.cross(inward, axes),
                 np.stack([low, high], 1)[strips], caps[strips], aside, (chord / panels)[strips], chord[strips],
                 (wall.radius * (1 - np.cos(half)))[strips], (wall.depth + _PULL_M) * each, strips,
                 np.full(len(strips), wall.object_id))  # fmt: skip


def _left(paths: Floats) -> Floats:
    """Turn vectors (n, 2) by 90 deg."""
    return np.asarray(paths[:, ::-1] * [-1, 1])


def _places(antennas: AntennaPair, lines: Lines, most: float) -> Places:
    """Find the places on lines with two-way paths of at most `most` [m]."""
    gaps = antennas.origins[:, None] - lines.at
    climb, inside = _dots(gaps, lines.axes), _dots(gaps, lines.inward) > 0
    apart = np.sqrt(np.maximum(_dots(gaps, gaps) - climb**2, _LEAST_M**2))
    specular = climb[0] + (climb[1] - climb[0]) * apart[0] / apart.sum(0)
    heights = np.stack([specular, *lines.ends.T])
    ahead = heights[:, None] - climb
    within = np.hypot(apart, ahead).sum(1) < most
    within[0] &= (lines.ends[:, 0] <= specular) & (specular < lines.ends[:, 1])
    level = (ahead[1:, 0] * ahead[1:, 1] > 0) & (lines.caps.T != 0)
    wall, row = np.nonzero(within & (inside[0] == inside[1]))
    cap, outline = np.nonzero(within[1:] & level)
    group, row = np.concatenate([wall, cap + 1]), np.concatenate([row, outline])
    return Places(row, _SIDES[group], np.arange(len(row)) >= len(wall), heights[group, row])


def _spots(antennas: AntennaPair, lines: Lines, places: Places) -> Spots:
    some = Lines._make(row[places.rows] for row in lines)
    points = some.at + places.heights[:, None] * some.axes
    paths = points - antennas.origins[:, None]
    ranges = np.maximum(np.sqrt(_dots(paths, paths)), _LEAST_M)
    paths /= ranges[..., None]
    return Spots(some, places, points, paths, ranges, _dots(paths, some.axes), -_dots(paths, some.inward))


def _free(frame: RadarFrame, lines: Lines, places: Places) -> tuple[Places, Transmission]:
    """Select the visible places (m), with the factor and the delay [s] of transmissive objects before them.

    One ray per strip decides: in front of the wall and off its ends, or in front of the cap and off the wall.
    """
    flat, strips = places.flat, lines.strips[places.rows]
    first = np.flatnonzero((np.diff(2 * strips + flat, prepend=-1) != 0) | (np.diff(places.side, prepend=-9) != 0))
    one, at = Places._make(row[first] for row in places), places.rows[first]
    axes, inward, pull = lines.axes[at], lines.inward[at], lines.pull[at]
    points = lines.at[at] + one.heights[:, None] * axes
    paths = points - frame.antennas.origins[0]
    off = np.where(one.flat, pull, np.copysign(pull, -_dots(paths, inward)))
    along = -_PULL_M * np.where(one.flat, np.sign(_dots(paths, axes)), one.side)
    transmission, late = frame.transmission_to(points + off[:, None] * inward + along[:, None] * axes)
    back = np.repeat(np.arange(len(first)), np.diff(first, append=len(flat)))
    free = np.flatnonzero(transmission[back])
    return Places._make(row[free] for row in places), Transmission(transmission[back[free]], late[back[free]])


def _echoes_of(frame: RadarFrame, spots: Spots, between: Transmission) -> EchoSet:
    """Add the echoes of spots (m), with the factor and the delay [s] of transmissive objects before each."""
    wave, lines = 2 * np.pi / frame.context.spec.wavelength_m, spots.lines
    extra, flat, caps = _extra_length(spots), spots.places.flat, int(np.searchsorted(spots.places.flat, True))
    value = _across_chord(spots, wave)
    value[:caps] *= _along(spots, wave)
    value *= 1j / (4 * np.pi) * frame.antennas.factor * between.factor * np.exp(1j * wave * extra)
    normals = np.where(flat[:, None], lines.axes, lines.inward)
    value *= scattered(frame, lines.object_ids, spots.points, normals) / spots.ranges.prod(0)
    delay = (spots.ranges.sum(0) + extra) / C0 + between.delay_s

    def put(value: Complexes, grids: Complexes) -> Complexes:
        kinds = (slice(caps), (1.5, -0.5)), (slice(caps, None), (1.0, 0.0))  # growing with the root of f, and constant
        return np.concatenate(
            [accumulate(frame.context, delay[some], value[some], grids, shares) for some, shares in kinds]
        )

    def again(factors: Complexes, others: Complexes) -> None:
        put(value * factors, others)

    return EchoSet(lines.object_ids.astype(np.int32), spots.points, put(value, frame.grids), delay, again)


def _extra_length(spots: Spots) -> Floats:
    """Average the extra two-way path of the arcs over their panels (m) [m]; negative outside."""
    lines = spots.lines
    rise = lines.depth * (1 - lines.aside**2 - (lines.half / lines.chord) ** 2 / 3)
    return np.asarray(spots.outward.sum(0) * rise / 2)


def _along(spots: Spots, wave: float) -> Complexes:
    """Integrate along the axis at spots (m) of walls [m]: over the whole line, or the share of an end.

    This is a Fresnel integral. Each end takes the phase and the phase slope at its own place.
    """
    places, many = spots.places, int(np.searchsorted(spots.places.flat, True))
    slope, ranges, heights = spots.upward[:, :many], spots.ranges[:, :many], places.heights[:many]
    apart = ranges * np.sqrt(np.maximum(1 - slope**2, 1e-12))
    climb, level = heights - ranges * slope, apart.sum(0)
    shortest = np.hypot(level, climb[1] - climb[0])
    specular = climb[0] + (climb[1] - climb[0]) * apart[0] / level
    root = np.sqrt(np.pi * (shortest / level) ** 3 / (wave * (1 / apart).sum(0)))  # by the second derivative
    total = (1 - 1j) * root
    ends = np.flatnonzero(places.side[:many])
    sign = np.where(heights > specular, 1, -1)[ends]
    more = np.maximum(ranges.sum(0) - shortest, 1e-12)[ends]
    detour = sign * np.sqrt(2 / np.pi * wave * more)
    close = abs(detour) < _AT_SPECULAR
    steep = np.where(close, root[ends], np.pi * detour / np.where(close, 1.0, wave * slope.sum(0)[ends]))
    sine, cosine = fresnel(detour)
    rest = cosine - 1j * sine - sign * (0.5 - 0.5j)
    total[ends] = places.side[ends] * steep * rest * np.exp(1j * wave * more)
    return np.asarray(total)


def _across_chord(spots: Spots, wave: float) -> Complexes:
    """Integrate across panels (m): over the arc, less over the chord [m]; for caps over the plane between both [m2]."""
    lines, flat, u = spots.lines, spots.places.flat, NODES[:, None]
    aside = _dots(spots.paths, lines.left)
    turn = wave * lines.half * aside.sum(0)
    curve = wave * lines.half**2 / 2 * ((1 - aside**2) / spots.ranges).sum(0)
    across = lines.aside + u * lines.half / lines.chord
    deep = lines.depth * (1 - across**2)
    outward = spots.outward.sum(0)
    arc = np.exp(-1j * (wave * outward) * deep)
    lean = 2 * lines.depth / lines.chord * aside.sum(0) / np.where(flat, 1.0, outward)
    bulge = (1 + across * lean) * arc - 1  # including the change of the cosine by the slope of the arc
    if flat.any():
        hole = np.where(spots.places.side > 0, lines.caps[:, 1], lines.caps[:, 0])
        rise = 1j * wave * outward * deep
        thin = abs(rise) < _THIN
        bulge = np.where(flat, hole * deep * np.where(thin, 1 - rise / 2, (1 - arc) / np.where(thin, 1, rise)), bulge)
    waves = np.exp(-1j * (turn * u + curve * u * u)) * bulge
    return np.asarray(lines.half * np.einsum("k,km->m", SHARES, waves))  # matrix products would keep all cores busy


def _dots(a: Floats, b: Floats) -> Floats:
    """Products (..., n) of vectors (..., n, 3)."""
    return np.asarray(np.einsum("...i,...i->...", a, b))
