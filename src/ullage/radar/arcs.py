"""What a round wall echoes beyond the flat strips that it is made of, and its flat caps beyond their polygons.

A mesh has strips where a tank or a drum is round. From a smooth wall it differs by a depth that is the same in every
strip, and so it echoes as a grating does: where the echoes of neighbouring strips differ by whole waves, it throws back
what no round wall would, an arc of ghosts between the near wall and the far one, some 25 dB below them. Finer
strips do not help down to half a wave: a parabola's harmonics fall as their order squared, its depth as its width.

So each strip adds what Kirchhoff's integral over its arc has beyond that over its chord [Balanis2012, ch. 7]: across
the strip a sum at Gauss's points, along the axis, where nothing bends, Fresnel's integral from end to end. The arc goes
through the strip's corners: there a mesh lies on the surface that it stands for. Each end of a strip has a phase,
a strength and a delay of its own. A flat cap ends on the chords; the slivers between these and the arcs are added, or
the wall's end and the cap's rim would not be in one place.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import fresnel

from ullage.antenna import gain
from ullage.arrays import Bools, Complexes, Floats, Longs
from ullage.geometry import C0
from ullage.radar.context import AntennaPair, RadarContext, transmission_to
from ullage.radar.echo_set import EchoSet
from ullage.radar.facets import Surfaces
from ullage.radar.quadrics import Quadric
from ullage.radar.wall_bounces import accumulate

NODES, SHARES = np.polynomial.legendre.leggauss(4)
PANEL_M = 0.025
"""Strips are added panel by panel, none wider than this: their delays must not spread over a pulse."""
_PULL_M = 4e-3  # points of walls are looked at so far off their strips and ends
_LEAST_M = 0.05  # nearer to a wall the wave is no ray
_AT_FOOT = 1e-2  # of Fresnel's argument: an end so near to the shortest path is at it
_WHOLE_RAD = 1e-3  # half of a gap that is none
_THIN = 1e-4  # [rad]: what turns the phase by less is next to flat
_SIDES = np.array([0, -1, 1])
_PAIRS = ("ends", "caps")  # rows of lines that are (2, n)


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Lines along the axes of walls on the chords of strips, each for a panel of its strip."""

    at: Floats  # (n, 3) where they pass the middle of their wall [m]
    axes: Floats  # (n, 3) unit vectors along them
    inward: Floats  # (n, 3) unit vectors to the axis, square to the strip
    left: Floats  # (n, 3) unit vectors across both
    ends: Floats  # (2, n) where the strip begins and ends along them, from there [m]
    caps: Floats  # (2, n) whether a flat cap ends there: 1, around a hole -1, else 0
    aside: Floats  # (n) from the middle of the chord, over half of it
    half: Floats  # (n) half of a panel's width [m]
    chord: Floats  # (n) half of the strip's [m]
    depth: Floats  # (n) of the arc over its chord [m]
    pull: Floats  # (n) so far before it nothing of the wall itself is in the way [m]
    strips: Longs  # (n) which strip, of all walls
    walls: Longs  # (n) which wall
    sealed: Bools  # (n) whether flat caps close that all round at both ends
    object_ids: Longs  # (n) object

    def some(self, which: NDArray[np.generic] | slice) -> Lines:
        """Some of them."""
        return Lines(*(getattr(self, row.name)[..., which] if row.name in _PAIRS else getattr(self, row.name)[which]
                       for row in fields(self)))  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Where waves over lines come from: the places of the shortest ways, and the ends of strips; caps' after these."""

    rows: Longs  # (m) the line of each
    side: Longs  # (m) -1 and 1: the lower and the upper end, 0: the shortest way
    flat: Bools  # (m) whether it is what a flat cap has there, not the wall
    heights: Floats  # (m) along the line [m]

    def some(self, which: NDArray[np.generic]) -> Places:
        """Some of them."""
        return Places(self.rows[which], self.side[which], self.flat[which], self.heights[which])


@dataclass(frozen=True, slots=True, eq=False)
class Spots:
    """Places as both antennas see them."""

    lines: Lines  # (m) the line of each
    places: Places  # (m)
    points: Floats  # (m, 3) [m]
    paths: Floats  # (2, m, 3) unit vectors from both antennas to them
    ranges: Floats  # (2, m) [m]
    upward: Floats  # (2, m) cosines of both ways to the axis
    outward: Floats  # (2, m) and to the way from the axis


def accumulate_arcs(
    context: RadarContext, parts: list[Surfaces], quadrics: tuple[Quadric, ...], antennas: AntennaPair, grids: Complexes
) -> list[EchoSet]:
    """Adds to the delay grids what arcs of round walls and drums echo beyond the strips of their meshes.

    Args:
        context: radar and scene.
        parts: what stands still and what moves.
        quadrics: fitted cylinders and spheres.
        antennas: where the radar is.
        grids: (3, g) complex, added to.
    """
    wavelength = context.spec.wavelength_m
    lines = lines_of(quadrics, wavelength / 2, float(np.sqrt(wavelength * context.gate[1] / 2)))
    if lines is None:
        return []
    places = _places(antennas, lines, ~context.transmissive.thin, 2 * context.gate[1])
    if not len(places.rows):
        return []
    places, between = _free(context, parts, antennas, lines, places)
    return [_echoes_of(context, antennas, _spots(antennas, lines, places), between, grids)] if len(places.rows) else []


@lru_cache(maxsize=8)  # walls that stand still are the same from frame to frame
def lines_of(quadrics: tuple[Quadric, ...], narrowest: float, widest: float) -> Lines | None:
    """Lines on all strips of those walls whose strips are of such widths [m]: no grating, or mirrors of their own."""
    made = [_lines(wall) for wall in quadrics if len(wall.strips) and narrowest < wall.widest < widest]
    if not made:
        return None
    first = np.cumsum([0, *(one.strips.max() + 1 for one in made)])
    rows = {row.name: np.concatenate([getattr(one, row.name) for one in made], axis=-1 if row.name in _PAIRS else 0)
            for row in fields(Lines)}  # fmt: skip
    rows["walls"] = np.repeat(np.arange(len(made)), [len(one.strips) for one in made])
    rows["strips"] = np.concatenate([one.strips + k for one, k in zip(made, first[:-1], strict=True)])
    return Lines(**rows)


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
                 np.stack([low, high])[:, strips], caps.T[:, strips], aside, (chord / panels)[strips], chord[strips],
                 (wall.radius * (1 - np.cos(half)))[strips], (wall.depth + _PULL_M) * each, strips,
                 np.zeros(len(strips), np.int64), np.full(len(strips), _sealed(wall)),
                 np.full(len(strips), wall.object_id))  # fmt: skip


def _sealed(wall: Quadric) -> bool:
    """Whether strips go all round, and flat caps end on all of them."""
    return bool(len(wall.caps) and (wall.caps == 1).all() and wall.strips[:, 1].sum() > np.pi - _WHOLE_RAD)


def _left(paths: Floats) -> Floats:
    """Vectors (n, 2) a quarter turn on."""
    return np.asarray(paths[:, ::-1] * [-1, 1])


def _places(antennas: AntennaPair, lines: Lines, opaque: Bools, most: float) -> Places:
    """Where waves over lines come from that go no farther than `most` [m], walls of some objects (o) being opaque."""
    gaps = antennas.origins[:, None] - lines.at
    climb, inside = _dots(gaps, lines.axes), _dots(gaps, lines.inward) > 0
    apart = np.sqrt(np.maximum(_dots(gaps, gaps) - climb**2, _LEAST_M**2))
    feet = climb[0] + (climb[1] - climb[0]) * apart[0] / apart.sum(0)
    heights = np.stack([feet, *lines.ends])
    ahead = heights[:, None] - climb
    heard = np.hypot(apart, ahead).sum(1) < most
    heard[0] &= (lines.ends[0] <= feet) & (feet < lines.ends[1])
    level = (ahead[1:, 0] * ahead[1:, 1] > 0) & (lines.caps != 0)
    beyond = ahead[1:, 0] * _SIDES[1:, None] < 0
    out = lines.sealed & opaque[lines.object_ids] & _any(~inside.any(0) | beyond.any(0), lines.walls)
    wall, row = np.nonzero(heard & (inside[0] == inside[1]) & ~(out & inside[0]))
    cap, outline = np.nonzero(heard[1:] & level & ~(out & ~beyond))
    group, row = np.concatenate([wall, cap + 1]), np.concatenate([row, outline])
    return Places(row, _SIDES[group], np.arange(len(row)) >= len(wall), heights[group, row])


def _spots(antennas: AntennaPair, lines: Lines, places: Places) -> Spots:
    some = lines.some(places.rows)
    points = some.at + places.heights[:, None] * some.axes
    paths = points - antennas.origins[:, None]
    ranges = np.maximum(np.sqrt(_dots(paths, paths)), _LEAST_M)
    paths /= ranges[..., None]
    return Spots(some, places, points, paths, ranges, _dots(paths, some.axes), -_dots(paths, some.inward))


def _any(some: Bools, walls: Longs) -> Bools:
    """Of lines (n) in the order of their walls, whether anything is true of some line of the same wall."""
    first = np.flatnonzero(np.diff(walls, prepend=-1))
    return np.asarray(np.repeat(np.logical_or.reduceat(some, first), np.diff(first, append=len(walls))))


def _free(
    context: RadarContext, parts: list[Surfaces], antennas: AntennaPair, lines: Lines, places: Places
) -> tuple[Places, tuple[Complexes, Floats]]:
    """The places (m) that are seen, and factor and delay [s] of what stands before them.

    Looked at is one of each strip: before the wall and off its ends, and before the cap and off the wall.
    """
    flat, strips = places.flat, lines.strips[places.rows]
    first = np.flatnonzero((np.diff(2 * strips + flat, prepend=-1) != 0) | (np.diff(places.side, prepend=-9) != 0))
    one, at = places.some(first), places.rows[first]
    axes, inward, pull = lines.axes[at], lines.inward[at], lines.pull[at]
    points = lines.at[at] + one.heights[:, None] * axes
    paths = points - antennas.origins[0]
    off = np.where(one.flat, pull, np.copysign(pull, -_dots(paths, inward)))
    along = -_PULL_M * np.where(one.flat, np.sign(_dots(paths, axes)), one.side)
    transmission, late = transmission_to(
        context, parts, antennas, points + off[:, None] * inward + along[:, None] * axes
    )
    back = np.repeat(np.arange(len(first)), np.diff(first, append=len(flat)))
    free = np.flatnonzero(transmission[back])
    return places.some(free), (transmission[back[free]], late[back[free]])


def _echoes_of(
    context: RadarContext, antennas: AntennaPair, spots: Spots, between: tuple[Complexes, Floats], grids: Complexes
) -> EchoSet:
    """Lays what comes from spots (m), with factor and delay [s] of what stands before each."""
    (transmission, late), wave, lines = between, 2 * np.pi / context.spec.wavelength_m, spots.lines
    behind, flat, caps = _behind(spots), spots.places.flat, int(np.searchsorted(spots.places.flat, True))
    value = _across_chord(spots, wave)
    value[:caps] *= _along(spots, wave)
    value *= 1j / (4 * np.pi) * antennas.factor * transmission * np.exp(1j * wave * behind)
    value *= _gains(context, antennas, spots.paths) / spots.ranges.prod(0)
    cosine = np.where(flat, spots.upward, spots.outward)
    normals = np.where(flat[:, None], lines.axes, lines.inward)
    cosine = abs(cosine).mean(0)
    value *= cosine * reflection(context, antennas, lines.object_ids, cosine, spots.paths, normals)
    delay = (spots.ranges.sum(0) + behind) / C0 + late

    def put(value: Complexes, grids: Complexes) -> Complexes:
        kinds = ((slice(caps), (1.5, -0.5)), (slice(caps, None), (1.0, 0.0)))  # as the root of f, and as it is
        return np.concatenate([accumulate(context, delay[some], value[some], grids, shares) for some, shares in kinds])

    def again(factors: Complexes, others: Complexes) -> None:
        put(value * factors, others)

    return EchoSet(lines.object_ids.astype(np.int32), spots.points, put(value, grids), delay, again)


def _gains(context: RadarContext, antennas: AntennaPair, paths: Floats) -> Floats:
    """What both antennas' patterns make of waves (2, m, 3)."""
    one = gain(context.spec.antenna, paths[0] @ antennas.frames[0].T)
    return one * (one if _one_place(antennas) else gain(context.spec.antenna, paths[1] @ antennas.frames[1].T))


def _behind(spots: Spots) -> Floats:
    """By so much longer is the way over what lies between panels (m) and their arcs, in the mean [m]."""
    lines = spots.lines
    rise = lines.depth * (1 - lines.aside**2 - (lines.half / lines.chord) ** 2 / 3)
    return np.asarray(spots.outward.sum(0) * rise / 2)


def _along(spots: Spots, wave: float) -> Complexes:
    """What the integral along the axis makes of waves over spots (m) of walls [m]: of all of the line, or of an end.

    Fresnel's. Each end has the phase and the slope of the phase that it has there.
    """
    places, many = spots.places, int(np.searchsorted(spots.places.flat, True))
    slope, ranges, heights = spots.upward[:, :many], spots.ranges[:, :many], places.heights[:many]
    apart = ranges * np.sqrt(np.maximum(1 - slope**2, 1e-12))
    climb, level = heights - ranges * slope, apart.sum(0)
    shortest = np.hypot(level, climb[1] - climb[0])
    feet = climb[0] + (climb[1] - climb[0]) * apart[0] / level
    root = np.sqrt(np.pi * (shortest / level) ** 3 / (wave * (1 / apart).sum(0)))  # by the second derivative
    total = (1 - 1j) * root
    ends = np.flatnonzero(places.side[:many])
    sign = np.where(heights > feet, 1, -1)[ends]
    more = np.maximum(ranges.sum(0) - shortest, 1e-12)[ends]
    detour = sign * np.sqrt(2 / np.pi * wave * more)
    close = abs(detour) < _AT_FOOT
    steep = np.where(close, root[ends], np.pi * detour / np.where(close, 1.0, wave * slope.sum(0)[ends]))
    sine, cosine = fresnel(detour)
    rest = cosine - 1j * sine - sign * (0.5 - 0.5j)
    total[ends] = places.side[ends] * steep * rest * np.exp(1j * wave * more)
    return np.asarray(total)


def _across_chord(spots: Spots, wave: float) -> Complexes:
    """What the integral across panels (m) is over their arcs, less what it is over their chords [m].

    Of caps, what it is over the plane between both [m2].
    """
    lines, flat, u = spots.lines, spots.places.flat, NODES[:, None]
    aside = _dots(spots.paths, lines.left)
    turn = wave * lines.half * aside.sum(0)
    curve = wave * lines.half**2 / 2 * ((1 - aside**2) / spots.ranges).sum(0)
    across = lines.aside + u * lines.half / lines.chord
    deep = lines.depth * (1 - across**2)
    outward = spots.outward.sum(0)
    arc = np.exp(-1j * (wave * outward) * deep)
    lean = 2 * lines.depth / lines.chord * aside.sum(0) / np.where(flat, 1.0, outward)
    bulge = (1 + across * lean) * arc - 1  # with what an arc's slope does to the cosine
    if flat.any():
        hole = np.where(spots.places.side > 0, lines.caps[1], lines.caps[0])
        rise = 1j * wave * outward * deep
        thin = abs(rise) < _THIN
        bulge = np.where(flat, hole * deep * np.where(thin, 1 - rise / 2, (1 - arc) / np.where(thin, 1, rise)), bulge)
    waves = np.exp(-1j * (turn * u + curve * u * u)) * bulge
    return np.asarray(lines.half * np.einsum("k,km->m", SHARES, waves))  # matrix products would keep all cores busy


def _dots(a: Floats, b: Floats) -> Floats:
    """Products (..., n) of vectors (..., n, 3)."""
    return np.asarray(np.einsum("...i,...i->...", a, b))


def _one_place(antennas: AntennaPair) -> bool:
    """Whether one antenna is the other."""
    return antennas.monostatic and bool((antennas.frames[0] == antennas.frames[1]).all())


def reflection(
    context: RadarContext, antennas: AntennaPair, object_ids: Longs, cosine: Floats, paths: Floats, inward: Floats
) -> Complexes:
    """Reflection coefficients (n) at the share of the fields that lies across the plane of incidence.

    Args:
        context: radar and scene.
        antennas: where the radar is.
        object_ids: (n) objects.
        cosine: (n) of incidence.
        paths: (2, n, 3) unit vectors from both antennas.
        inward: (n, 3) normals.
    """
    rows = context.bounce[object_ids, 0]
    places = np.minimum(cosine, 1.0) * (rows.shape[2] - 1)
    low = np.minimum(places.astype(np.int64), rows.shape[2] - 2)
    up, each = places - low, np.arange(len(low))
    te, tm = (rows[each, k, low] * (1 - up) + rows[each, k, low + 1] * up for k in range(2))
    share = _across(antennas.fields[0], paths[0], inward)
    if not _one_place(antennas):
        share = (share + _across(antennas.fields[1], paths[1], inward)) / 2
    return np.asarray(share * te + (1 - share) * tm)


def _across(field: Floats, paths: Floats, normals: Floats) -> Floats:
    """Share (n) of a field's power that is TE, for waves (n, 3) at faces with some normals (n, 3)."""
    x, y, z = field
    side = normals @ np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])  # times the ways: the field across both
    square = (1 - _dots(paths, normals) ** 2) * (1 - (paths @ field) ** 2)
    return np.where(square < 1e-12, 0.5, np.minimum(_dots(paths, side) ** 2 / np.maximum(square, 1e-12), 1.0))
