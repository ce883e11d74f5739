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

NODES, SHARES = np.polynomial.legendre.leggauss(4)
PANEL_M = 0.025
"""Strips are added panel by panel, none wider than this: their delays must not spread over a pulse."""
_PULL_M = 4e-3  # points of walls are looked at so far off their strips and ends
_LEAST_M = 0.05  # nearer to a wall the wave is no ray


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Lines along the axes of walls on the chords of strips, each for a panel of its strip."""

    at: Floats  # (n, 3) where they pass the middle of their wall [m]
    axes: Floats  # (n, 3) unit vectors along them
    inward: Floats  # (n, 3) unit vectors to the axis, square to the strip
    ends: Floats  # (2, n) where the strip begins and ends along them, from there [m]
    aside: Floats  # (n) from the middle of the chord, over half of it
    half: Floats  # (n) half of a panel's width [m]
    chord: Floats  # (n) half of the strip's [m]
    depth: Floats  # (n) of the arc over its chord [m]
    pull: Floats  # (n) so far before it nothing of the wall itself is in the way [m]
    strips: Longs  # (n) which strip, of all walls
    stuffs: Longs  # (n) object

    def some(self, which: NDArray[np.generic]) -> Lines:
        """Some of them."""
        return Lines(*(getattr(self, row.name)[..., which] if row.name == "ends" else getattr(self, row.name)[which]
                       for row in fields(self)))  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Spots:
    """Where the way from transmitter to receiver over each line is shortest, or the end of the line next to that."""

    feet: Floats  # (n) along the line, were it endless [m]
    shortest: Floats  # (n) path over it [m]
    level: Floats  # (n) share of that across the axis
    points: Floats  # (n, 3) [m]
    ways: Floats  # (2, n, 3) unit vectors from both antennas to them
    ranges: Floats  # (2, n) [m]
    cosine: Floats  # (n) of incidence, in the mean, less than 0 from outside, 0 between inside and outside

    def some(self, which: NDArray[np.generic]) -> Spots:
        """Some of them."""
        return Spots(self.feet[which], self.shortest[which], self.level[which], self.points[which],
                     self.ways[:, which], self.ranges[:, which], self.cosine[which])  # fmt: skip


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
    spots = _spots(view, lines)
    heard = (spots.shortest < 2 * ready.gate[1]) & (spots.cosine != 0)
    lines, spots = lines.some(heard), spots.some(heard)
    if not heard.any():
        return []
    shade, late = _shade(ready, parts, view, lines, spots)
    lit = np.flatnonzero(shade)
    if not len(lit):
        return []
    return [_laid(ready, view, lines.some(lit), spots.some(lit), (shade[lit], late[lit]), grids)]


@lru_cache(maxsize=8)  # walls that stand still are the same from frame to frame
def lines_of(rounds: tuple[Round, ...], narrowest: float, widest: float) -> Lines | None:
    """Lines on all strips of those walls whose strips are of such widths [m]: no grating, or mirrors of their own."""
    made = [_lines(wall) for wall in rounds if len(wall.strips) and narrowest < wall.widest < widest]
    if not made:
        return None
    first = np.cumsum([0, *(len(one.strips) for one in made)])
    rows = {row.name: np.concatenate([getattr(one, row.name) for one in made], axis=-1 if row.name == "ends" else 0)
            for row in fields(Lines)}  # fmt: skip
    rows["strips"] = np.concatenate([one.strips + k for one, k in zip(made, first[:-1], strict=True)])
    return Lines(**rows)


def _lines(wall: Round) -> Lines:
    angle, half, low, high = wall.strips.T
    chord = wall.radius * np.sin(half)
    panels = np.ceil(2 * chord / PANEL_M).astype(np.int64)
    strips = np.repeat(np.arange(len(panels)), panels)
    number = np.arange(len(strips)) - np.repeat(panels.cumsum() - panels, panels)
    aside = (2 * number + 1) / panels[strips] - 1
    outward = np.stack([np.cos(angle), np.sin(angle)], 1)[strips]
    at = (wall.radius * np.cos(half))[strips, None] * outward + (aside * chord[strips])[:, None] * _left(outward)
    each = np.ones(len(strips))
    return Lines(wall.centre + at @ wall.axes[:2], each[:, None] * wall.axes[2], -outward @ wall.axes[:2],
                 np.stack([low, high])[:, strips], aside, (chord / panels)[strips], chord[strips],
                 (wall.radius * (1 - np.cos(half)))[strips], (wall.depth + _PULL_M) * each, strips,
                 np.full(len(strips), wall.stuff))  # fmt: skip


def _left(ways: Floats) -> Floats:
    """Vectors (n, 2) a quarter turn on."""
    return np.asarray(ways[:, ::-1] * [-1, 1])


def _laid(
    ready: Bench, view: View, lines: Lines, spots: Spots, between: tuple[Complexes, Floats], grids: Complexes
) -> Laid:
    """Lays what lines (n) add, with factor and delay [s] of what stands before each."""
    (shade, late), wave = between, 2 * np.pi / ready.spec.wavelength_m
    value = 1j / (4 * np.pi) * view.factor * shade * _along(lines, spots, wave) * _bulge(lines, spots, wave)
    for way, frame, far in zip(spots.ways, view.frames, spots.ranges, strict=True):
        value *= gain(ready.spec.antenna, way @ frame.T) / far
    cosine = abs(spots.cosine)
    value *= cosine * reflection(ready, view, lines.stuffs, cosine, spots.ways, lines.inward)
    delay = spots.ranges.sum(0) / C0 + late
    echo = deposit(ready, delay, value, grids, (0.5, 0.5))

    def again(factors: Complexes, others: Complexes) -> None:
        deposit(ready, delay, value * factors, others, (0.5, 0.5))

    return Laid(lines.stuffs.astype(np.int32), spots.points, echo, delay, again)


def _spots(view: View, lines: Lines) -> Spots:
    gaps = view.origins[:, None] - lines.at
    climb = (gaps * lines.axes).sum(2)
    apart = np.sqrt(np.maximum((gaps**2).sum(2) - climb**2, _LEAST_M**2))
    level, rise = apart.sum(0), climb[1] - climb[0]
    shortest = np.sqrt(level**2 + rise**2)
    feet = climb[0] + rise * apart[0] / level
    heights = np.minimum(np.maximum(feet, lines.ends[0]), lines.ends[1])
    ways = heights[:, None] * lines.axes - gaps
    ranges = np.maximum(np.sqrt((ways**2).sum(2)), _LEAST_M)
    ways /= ranges[..., None]
    one, other = -(ways * lines.inward).sum(2)
    cosine = np.where(one * other > 0, (one + other) / 2, 0.0)
    return Spots(feet, shortest, level / shortest, lines.at + heights[:, None] * lines.axes, ways, ranges, cosine)


def _shade(ready: Bench, parts: list[Surfaces], view: View, lines: Lines, spots: Spots) -> tuple[Complexes, Floats]:
    """What stands before the lines (n), seen at one of each strip: a little before the wall and off its ends."""
    first = np.flatnonzero(np.diff(lines.strips, prepend=-1))
    feet, (low, high) = spots.feet[first], lines.ends[:, first]
    inner = np.clip(feet, low + _PULL_M, high - _PULL_M) - np.clip(feet, low, high)
    before = (np.sign(spots.cosine) * lines.pull)[first, None] * lines.inward[first]
    shade, late = shading(ready, parts, view, spots.points[first] + inner[:, None] * lines.axes[first] + before)
    back = np.repeat(np.arange(len(first)), np.diff(first, append=len(lines.strips)))
    return shade[back], late[back]


def _along(lines: Lines, spots: Spots, wave: float) -> Complexes:
    """What the integral along the axis, from end to end of the wall, makes of waves (n) over the spots [m]."""
    bend = wave * spots.level**2 * (1 / spots.ranges).sum(0)
    sine, cosine = fresnel((lines.ends - spots.feet) * np.sqrt(bend / np.pi))
    part = (cosine[1] - cosine[0]) - 1j * (sine[1] - sine[0])
    return np.asarray(part * np.sqrt(np.pi / bend) * np.exp(1j * wave * (spots.ranges.sum(0) - spots.shortest)))


def _bulge(lines: Lines, spots: Spots, wave: float) -> Complexes:
    """What the integral across panels (n) is over their arcs, less what it is over their chords [m]."""
    u = NODES[:, None]
    aside = (spots.ways * np.cross(lines.inward, lines.axes)).sum(2)
    turn = wave * lines.half * aside.sum(0)
    curve = wave * lines.half**2 / 2 * ((1 - aside**2) / spots.ranges).sum(0)
    rise = 2 * wave * lines.depth * spots.cosine  # of the phase, from the ends of an arc to its middle
    across = lines.aside + u * lines.half / lines.chord
    steep = 1 + across * (2 * lines.depth / lines.chord * aside.mean(0) / spots.cosine)  # what its slope does to cos
    arc = steep * np.exp(-1j * rise * (1 - across**2)) - 1
    return np.asarray(lines.half * (SHARES[:, None] * np.exp(-1j * (turn * u + curve * u * u)) * arc).sum(0))


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
