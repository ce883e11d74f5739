"""What a round wall echoes beyond the flat strips that it is made of.

A mesh has strips where a tank or a drum is round. From a smooth wall it differs by a depth that is the same in every
strip, and so it echoes as a grating does: where the echoes of neighbouring strips differ by whole waves, it throws back
what no round wall would, an arc of ghosts between the near wall and the far one, some 25 dB below them. Finer
strips do not help down to half a wave: a parabola's harmonics fall as their order squared, its depth as its width.

So each strip adds what Kirchhoff's integral over its arc has beyond that over its chord [Balanis2012, ch. 7]: across
the strip a sum at Gauss's points, along the axis, where nothing bends, Fresnel's integral from end to end. The arc goes
through the strip's corners: there a mesh lies on the surface that it stands for.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import fresnel

from ullage.geometry import C0
from ullage.radar.antenna import gain
from ullage.radar.facets import Surfaces
from ullage.radar.laid import Laid
from ullage.radar.physical import Bench, View, shading
from ullage.radar.rounds import Round
from ullage.radar.wall_bounces import deposit

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Longs = NDArray[np.int64]
Bools = NDArray[np.bool_]

NODES, SHARES = np.polynomial.legendre.leggauss(4)
PANEL_M = 0.025
"""Strips are added panel by panel, none wider than this: their delays must not spread over a pulse."""
_PULL_M = 4e-3  # points of walls are looked at so far off their strips and ends
_LEAST_M = 0.05  # nearer to a wall the wave is no ray
_AT_FOOT = 1e-2  # of Fresnel's argument: an end so near to the shortest path is at it
_WHOLE_RAD = 1e-3  # half of a gap that is none
_SIDES = np.array([0, -1, 1])
_PAIRS = ("ends", "caps")  # rows of lines that are (2, n)


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Lines along the axes of walls on the chords of strips, each for a panel of its strip."""

    at: Floats  # (n, 3) where they pass the middle of their wall [m]
    axes: Floats  # (n, 3) unit vectors along them
    inward: Floats  # (n, 3) unit vectors to the axis, square to the strip
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
    stuffs: Longs  # (n) object

    def some(self, which: NDArray[np.generic] | slice) -> Lines:
        """Some of them."""
        return Lines(*(getattr(self, row.name)[..., which] if row.name in _PAIRS else getattr(self, row.name)[which]
                       for row in fields(self)))  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Spots:
    """Where waves over lines come from: the places of the shortest ways, and the ends of strips; caps' after these."""

    lines: Lines  # (m) the line of each
    side: Longs  # (m) -1 and 1: the lower and the upper end, 0: the shortest way
    flat: Bools  # (m) whether it is what a flat cap has there, not the wall
    heights: Floats  # (m) along the line [m]
    ways: Floats  # (2, m, 3) unit vectors from both antennas to them
    ranges: Floats  # (2, m) [m]

    def some(self, which: NDArray[np.generic] | slice) -> Spots:
        """Some of them."""
        return Spots(self.lines.some(which), self.side[which], self.flat[which], self.heights[which],
                     self.ways[:, which], self.ranges[:, which])  # fmt: skip

    @property
    def points(self) -> Floats:
        """Where they are (m, 3) [m]."""
        return np.asarray(self.lines.at + self.heights[:, None] * self.lines.axes)

    @property
    def upward(self) -> Floats:
        """Cosines (2, m) of both ways to the axis."""
        return np.asarray((self.ways * self.lines.axes).sum(2))

    @property
    def outward(self) -> Floats:
        """Cosines (2, m) of both ways to the way from the axis."""
        return np.asarray(-(self.ways * self.lines.inward).sum(2))


def lay_arcs(
    ready: Bench, parts: list[Surfaces], rounds: tuple[Round, ...], view: View, grids: Complexes
) -> list[Laid]:
    """Adds to the delay grids what arcs of round walls and drums echo beyond the strips of their meshes.

    Args:
        ready: radar and scene.
        parts: what stands still and what moves.
        rounds: round walls and bodies.
        view: where the radar is.
        grids: (3, g) complex, added to.
    """
    wavelength = ready.spec.wavelength_m
    lines = lines_of(rounds, wavelength / 2, float(np.sqrt(wavelength * ready.gate[1] / 2)))
    if lines is None:
        return []
    spots = _spots(view, lines, ~ready.sheets.thin, 2 * ready.gate[1])
    if not len(spots.side):
        return []
    spots, between = _free(ready, parts, view, spots)
    return [_laid(ready, view, spots, between, grids)] if len(spots.side) else []


@lru_cache(maxsize=8)  # walls that stand still are the same from frame to frame
def lines_of(rounds: tuple[Round, ...], narrowest: float, widest: float) -> Lines | None:
    """Lines on all strips of those walls whose strips are of such widths [m]: no grating, or mirrors of their own."""
    made = [_lines(wall) for wall in rounds if len(wall.strips) and narrowest < wall.widest < widest]
    if not made:
        return None
    first = np.cumsum([0, *(one.strips.max() + 1 for one in made)])
    rows = {row.name: np.concatenate([getattr(one, row.name) for one in made], axis=-1 if row.name in _PAIRS else 0)
            for row in fields(Lines)}  # fmt: skip
    rows["walls"] = np.repeat(np.arange(len(made)), [len(one.strips) for one in made])
    rows["strips"] = np.concatenate([one.strips + k for one, k in zip(made, first[:-1], strict=True)])
    return Lines(**rows)


def _lines(wall: Round) -> Lines:
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
    return Lines(wall.centre + at @ wall.axes[:2], each[:, None] * wall.axes[2], -outward @ wall.axes[:2],
                 np.stack([low, high])[:, strips], caps.T[:, strips], aside, (chord / panels)[strips], chord[strips],
                 (wall.radius * (1 - np.cos(half)))[strips], (wall.depth + _PULL_M) * each, strips,
                 np.zeros(len(strips), np.int64), np.full(len(strips), _sealed(wall)),
                 np.full(len(strips), wall.stuff))  # fmt: skip


def _sealed(wall: Round) -> bool:
    """Whether strips go all round, and flat caps end on all of them."""
    return bool(len(wall.caps) and (wall.caps == 1).all() and wall.strips[:, 1].sum() > np.pi - _WHOLE_RAD)


def _left(ways: Floats) -> Floats:
    """Vectors (n, 2) a quarter turn on."""
    return np.asarray(ways[:, ::-1] * [-1, 1])


def _spots(view: View, lines: Lines, opaque: Bools, most: float) -> Spots:
    """Where waves over lines come from that go no farther than `most` [m], walls of some objects (o) being opaque."""
    gaps = view.origins[:, None] - lines.at
    climb, inside = (gaps * lines.axes).sum(2), (gaps * lines.inward).sum(2) > 0
    apart = np.sqrt(np.maximum((gaps**2).sum(2) - climb**2, _LEAST_M**2))
    feet = climb[0] + (climb[1] - climb[0]) * apart[0] / apart.sum(0)
    heights = np.stack([feet, *lines.ends])
    ahead = heights[:, None] - climb
    heard = np.hypot(apart, ahead).sum(1) < most
    heard[0] &= (lines.ends[0] <= feet) & (feet < lines.ends[1])
    level = (ahead[1:, 0] * ahead[1:, 1] > 0) & (lines.caps != 0)
    beyond = ahead[1:, 0] * _SIDES[1:, None] < 0
    out = lines.sealed & opaque[lines.stuffs] & _any(~inside.any(0) | beyond.any(0), lines.walls)
    wall, row = np.nonzero(heard & (inside[0] == inside[1]) & ~(out & inside[0]))
    cap, rim = np.nonzero(heard[1:] & level & ~(out & ~beyond))
    group, row = np.concatenate([wall, cap + 1]), np.concatenate([row, rim])
    lines, heights = lines.some(row), heights[group, row]
    ways = heights[:, None] * lines.axes - gaps[:, row]
    ranges = np.maximum(np.sqrt((ways**2).sum(2)), _LEAST_M)
    return Spots(lines, _SIDES[group], np.arange(len(row)) >= len(wall), heights, ways / ranges[..., None], ranges)


def _any(some: Bools, walls: Longs) -> Bools:
    """Of lines (n) in the order of their walls, whether anything is true of some line of the same wall."""
    first = np.flatnonzero(np.diff(walls, prepend=-1))
    return np.asarray(np.repeat(np.logical_or.reduceat(some, first), np.diff(first, append=len(walls))))


def _free(ready: Bench, parts: list[Surfaces], view: View, spots: Spots) -> tuple[Spots, tuple[Complexes, Floats]]:
    """The spots (m) that are seen, and factor and delay [s] of what stands before them.

    Looked at is one of each strip: before the wall and off its ends, and before the cap and off the wall.
    """
    lines, flat = spots.lines, spots.flat
    first = np.flatnonzero((np.diff(2 * lines.strips + flat, prepend=-1) != 0) | (np.diff(spots.side, prepend=-9) != 0))
    one = spots.some(first)
    inward = np.where(one.flat, one.lines.pull, np.copysign(one.lines.pull, one.outward[0]))
    along = -_PULL_M * np.where(one.flat, np.sign(one.upward[0]), one.side)
    points = one.points + inward[:, None] * one.lines.inward + along[:, None] * one.lines.axes
    shade, late = shading(ready, parts, view, points)
    back = np.repeat(np.arange(len(first)), np.diff(first, append=len(flat)))
    free = np.flatnonzero(shade[back])
    return spots.some(free), (shade[back[free]], late[back[free]])


def _laid(ready: Bench, view: View, spots: Spots, between: tuple[Complexes, Floats], grids: Complexes) -> Laid:
    """Lays what comes from spots (m), with factor and delay [s] of what stands before each."""
    (shade, late), wave, lines = between, 2 * np.pi / ready.spec.wavelength_m, spots.lines
    behind, caps = _behind(spots), int(np.searchsorted(spots.flat, True))
    walls, slivers = spots.some(slice(caps)), spots.some(slice(caps, None))
    value = np.concatenate([_along(walls, wave) * _bulge(walls, wave), _sliver(slivers, wave)])
    value *= 1j / (4 * np.pi) * view.factor * shade * np.exp(1j * wave * behind)
    for way, frame, far in zip(spots.ways, view.frames, spots.ranges, strict=True):
        value *= gain(ready.spec.antenna, way @ frame.T) / far
    cosine = np.where(spots.flat, spots.upward, spots.outward)
    normals = np.where(spots.flat[:, None], lines.axes, lines.inward)
    cosine = abs(cosine).mean(0)
    value *= cosine * reflection(ready, view, lines.stuffs, cosine, spots.ways, normals)
    delay = (spots.ranges.sum(0) + behind) / C0 + late

    def put(value: Complexes, grids: Complexes) -> Complexes:
        kinds = ((slice(caps), (1.5, -0.5)), (slice(caps, None), (1.0, 0.0)))  # as the root of f, and as it is
        return np.concatenate([deposit(ready, delay[some], value[some], grids, shares) for some, shares in kinds])

    def again(factors: Complexes, others: Complexes) -> None:
        put(value * factors, others)

    return Laid(lines.stuffs.astype(np.int32), spots.points, put(value, grids), delay, again)


def _behind(spots: Spots) -> Floats:
    """By so much longer is the way over what lies between panels (m) and their arcs, in the mean [m]."""
    lines = spots.lines
    rise = lines.depth * (1 - lines.aside**2 - (lines.half / lines.chord) ** 2 / 3)
    return np.asarray(spots.outward.sum(0) * rise / 2)


def _along(spots: Spots, wave: float) -> Complexes:
    """What the integral along the axis makes of waves (m) over the spots [m]: of all of the line, or of an end of it.

    Fresnel's. Each end has the phase and the slope of the phase that it has there.
    """
    slope = spots.upward
    apart = spots.ranges * np.sqrt(np.maximum(1 - slope**2, 1e-12))
    climb = spots.heights - spots.ranges * slope
    shortest = np.hypot(apart.sum(0), climb[1] - climb[0])
    feet = climb[0] + (climb[1] - climb[0]) * apart[0] / apart.sum(0)
    root = np.sqrt(np.pi * shortest**3 / (wave * apart.sum(0) ** 3 * (1 / apart).sum(0)))  # by the second derivative
    total = (1 - 1j) * root
    ends = np.flatnonzero(spots.side)
    sign = np.where(spots.heights > feet, 1, -1)[ends]
    more = np.maximum(spots.ranges.sum(0) - shortest, 1e-12)[ends]
    detour = sign * np.sqrt(2 / np.pi * wave * more)
    close = abs(detour) < _AT_FOOT
    steep = np.where(close, root[ends], np.pi * detour / np.where(close, 1.0, wave * slope.sum(0)[ends]))
    sine, cosine = fresnel(detour)
    rest = cosine - 1j * sine - sign * (0.5 - 0.5j)
    total[ends] = spots.side[ends] * steep * rest * np.exp(1j * wave * more)
    return np.asarray(total)


def _bulge(spots: Spots, wave: float) -> Complexes:
    """What the integral across panels (m) is over their arcs, less what it is over their chords [m]."""
    lines = spots.lines
    plain, across, aside = _across_chord(spots, wave)
    rise = wave * lines.depth * spots.outward.sum(0)  # of the phase, from the ends of an arc to its middle
    steep = 1 + across * (
        4 * lines.depth / lines.chord * aside.mean(0) / spots.outward.sum(0)
    )  # what its slope does to cos
    return np.asarray(lines.half * (plain * (steep * np.exp(-1j * rise * (1 - across**2)) - 1)).sum(0))


def _sliver(spots: Spots, wave: float) -> Complexes:
    """What the integral is over the plane across the axis between panels (m) and their arcs [m2]."""
    lines = spots.lines
    hole = np.where(spots.side > 0, lines.caps[1], lines.caps[0])
    plain, across, _ = _across_chord(spots, wave)
    deep = lines.depth * (1 - across**2)
    rise = wave * spots.outward.sum(0) * deep / 2
    return np.asarray(hole * lines.half * (plain * deep * np.sinc(rise / np.pi) * np.exp(-1j * rise)).sum(0))


def _across_chord(spots: Spots, wave: float) -> tuple[Complexes, Floats, Floats]:
    """Waves at Gauss's points (4, m) of panels times their shares; where along half the chord they are; ways (2, m)."""
    lines, u = spots.lines, NODES[:, None]
    aside = (spots.ways * np.cross(lines.inward, lines.axes)).sum(2)
    turn = wave * lines.half * aside.sum(0)
    curve = wave * lines.half**2 / 2 * ((1 - aside**2) / spots.ranges).sum(0)
    across = lines.aside + u * lines.half / lines.chord
    return SHARES[:, None] * np.exp(-1j * (turn * u + curve * u * u)), across, aside


def reflection(ready: Bench, view: View, stuffs: Longs, cosine: Floats, ways: Floats, inward: Floats) -> Complexes:
    """Reflection coefficients (n) at the share of the fields that lies across the plane of incidence.

    Args:
        ready: radar and scene.
        view: where the radar is.
        stuffs: (n) objects.
        cosine: (n) of incidence.
        ways: (2, n, 3) unit vectors from both antennas.
        inward: (n, 3) normals.
    """
    rows = ready.gamma[stuffs, 0]
    places = np.minimum(cosine, 1.0) * (rows.shape[2] - 1)
    low = np.minimum(places.astype(np.int64), rows.shape[2] - 2)
    up, each = places - low, np.arange(len(low))
    te, tm = (rows[each, k, low] * (1 - up) + rows[each, k, low + 1] * up for k in range(2))
    one, other = (_across(*told, inward) for told in zip(view.fields, ways, strict=True))
    share = (one + other) / 2
    return np.asarray(share * te + (1 - share) * tm)


def _across(field: Floats, ways: Floats, normals: Floats) -> Floats:
    """Share (n) of a field's power that is TE, for waves (n, 3) at faces with some normals (n, 3)."""
    side = np.cross(ways, normals)
    square = (side**2).sum(1) * (1 - (ways @ field) ** 2)
    return np.where(square < 1e-12, 0.5, np.minimum((side @ field) ** 2 / np.maximum(square, 1e-12), 1.0))
