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

from dataclasses import dataclass, replace

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
    """Lines along the axis on the chords of strips, each for a panel of its strip, and the shortest way over each."""

    wall: Round
    strips: Longs  # (n) which strip
    aside: Floats  # (n) from the middle of the chord, over half of it
    half: Floats  # (n) half of a panel's width [m]
    outward: Floats  # (n, 2) unit vectors off the strips, in the wall's axes
    places: Floats  # (2, 3) of the antennas [m]
    at: Floats  # (n, 2) [m]
    foot: Floats  # (n) along the axis [m]
    shortest: Floats  # (n) path [m]
    level: Floats  # (n) share of it that runs across the axis

    def some(self, which: NDArray[np.generic]) -> Lines:
        """Some of them."""
        rows = ("strips", "aside", "half", "outward", "at", "foot", "shortest", "level")
        return replace(self, **{row: getattr(self, row)[which] for row in rows})


@dataclass(frozen=True, slots=True, eq=False)
class Spots:
    """A place on each of some lines."""

    heights: Floats  # (n) along the axis [m]
    points: Floats  # (n, 3) [m]
    ways: Floats  # (2, n, 3) unit vectors from both antennas to them
    ranges: Floats  # (2, n) [m]
    inward: Floats  # (n, 3) unit vectors to the axis
    cosine: Floats  # (n) of incidence, in the mean, less than 0 from outside, 0 between inside and outside

    def some(self, which: NDArray[np.generic]) -> Spots:
        """Some of them."""
        return Spots(self.heights[which], self.points[which], self.ways[:, which], self.ranges[:, which],
                     self.inward[which], self.cosine[which])  # fmt: skip


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
    half_wave, zone = ready.spec.wavelength_m / 2, np.sqrt(ready.spec.wavelength_m * ready.gate[1] / 2)
    out = []
    for wall in rounds:
        if len(wall.strips) and half_wave < wall.widest < zone:
            lines = _lines(wall, view)
            lines = lines.some(lines.shortest < 2 * ready.gate[1])
            laid = _laid(ready, parts, view, lines, grids) if len(lines.strips) else None
            out += [laid] if laid is not None else []
    return out


def _lines(wall: Round, view: View) -> Lines:
    angle, half = wall.strips[:, :2].T
    chord = 2 * wall.radius * np.sin(half)
    panels = np.ceil(chord / PANEL_M).astype(np.int64)
    strips = np.repeat(np.arange(len(panels)), panels)
    number = np.arange(len(strips)) - np.repeat(panels.cumsum() - panels, panels)
    aside = (2 * number + 1) / panels[strips] - 1
    outward = np.stack([np.cos(angle), np.sin(angle)], 1)[strips]
    around = outward[:, ::-1] * [-1, 1]
    at = (wall.radius * np.cos(half))[strips, None] * outward + (aside * chord[strips] / 2)[:, None] * around
    places = wall.local(view.origins)
    apart = np.maximum(np.linalg.norm(places[:, None, :2] - at, axis=2), _LEAST_M)
    rise, level = places[1, 2] - places[0, 2], apart.sum(0)
    shortest = np.hypot(level, rise)
    foot = places[0, 2] + rise * apart[0] / level
    wide = (chord / 2 / panels)[strips]
    return Lines(wall, strips, aside, wide, outward, places, at, foot, shortest, level / shortest)


def _laid(ready: Bench, parts: list[Surfaces], view: View, lines: Lines, grids: Complexes) -> Laid | None:
    """Lays what lines (n) add, where the way over each is shortest."""
    spots = _spots(view, lines)
    shade, late = _shade(ready, parts, view, lines, spots)
    lit = np.flatnonzero((shade != 0) & (spots.cosine != 0))
    if not len(lit):
        return None
    lines, spots, shade, late = lines.some(lit), spots.some(lit), shade[lit], late[lit]
    stuff, wave = lines.wall.stuff, 2 * np.pi / ready.spec.wavelength_m
    value = 1j / (4 * np.pi) * view.factor * shade * _along(lines, spots, wave) * _bulge(lines, spots, wave)
    for way, frame, far in zip(spots.ways, view.frames, spots.ranges, strict=True):
        value *= gain(ready.spec.antenna, way @ frame.T) / far
    value *= abs(spots.cosine) * _reflection(ready, view, stuff, spots)
    delay = spots.ranges.sum(0) / C0 + late
    echo = deposit(ready, delay, value, grids, (0.5, 0.5))

    def again(factors: Complexes, others: Complexes) -> None:
        deposit(ready, delay, value * factors, others, (0.5, 0.5))

    return Laid(np.full(len(delay), stuff, np.int32), spots.points, echo, delay, again)


def _spots(view: View, lines: Lines) -> Spots:
    axes = lines.wall.axes
    low, high = lines.wall.strips[lines.strips, 2:].T
    heights = np.clip(lines.foot, low, high)
    outward = lines.outward @ axes[:2]
    points = lines.wall.centre + lines.at @ axes[:2] + heights[:, None] * axes[2]
    ways = points - view.origins[:, None]
    ranges = np.maximum(np.sqrt((ways**2).sum(2)), _LEAST_M)
    ways = ways / ranges[..., None]
    one, other = (ways * outward).sum(2)
    return Spots(heights, points, ways, ranges, -outward, np.where(one * other > 0, (one + other) / 2, 0.0))


def _shade(ready: Bench, parts: list[Surfaces], view: View, lines: Lines, spots: Spots) -> tuple[Complexes, Floats]:
    """What stands before the lines (n), seen at one of each strip: a little before the wall and off its ends."""
    first = np.flatnonzero(np.diff(lines.strips, prepend=-1))
    heights, wall = spots.heights[first], lines.wall
    low, high = wall.strips[lines.strips[first], 2:].T
    inner = np.clip(heights, low + _PULL_M, high - _PULL_M)
    before = np.sign(spots.cosine[first])[:, None] * (wall.depth + _PULL_M) * spots.inward[first]
    points = spots.points[first] + (inner - heights)[:, None] * wall.axes[2] + before
    shade, late = shading(ready, parts, view, points)
    back = np.repeat(np.arange(len(first)), np.diff(first, append=len(lines.strips)))
    return shade[back], late[back]


def _along(lines: Lines, spots: Spots, wave: float) -> Complexes:
    """What the integral along the axis, from end to end of the wall, makes of waves (n) over the spots [m]."""
    bend = wave * lines.level**2 * (1 / spots.ranges).sum(0)
    sine, cosine = fresnel((lines.wall.strips[lines.strips, 2:].T - lines.foot) * np.sqrt(bend / np.pi))
    part = (cosine[1] - cosine[0]) - 1j * (sine[1] - sine[0])
    return np.asarray(part * np.sqrt(np.pi / bend) * np.exp(1j * wave * (spots.ranges.sum(0) - lines.shortest)))


def _bulge(lines: Lines, spots: Spots, wave: float) -> Complexes:
    """What the integral across panels (n) is over their arcs, less what it is over their chords [m]."""
    wall, u = lines.wall, NODES[:, None]
    half = wall.strips[lines.strips, 1]
    depth, chord = wall.radius * (1 - np.cos(half)), wall.radius * np.sin(half)
    around = lines.outward[:, ::-1] * [-1, 1] @ wall.axes[:2]
    aside = (spots.ways * around).sum(2)
    turn = wave * lines.half * aside.sum(0)
    curve = wave * lines.half**2 / 2 * ((1 - aside**2) / spots.ranges).sum(0)
    rise = 2 * wave * depth * spots.cosine  # of the phase, from the ends of an arc to its middle
    across = lines.aside + u * lines.half / chord
    steep = 1 + across * (2 * depth / chord * aside.mean(0) / spots.cosine)  # what the arc's own slope does to cos
    arc = steep * np.exp(-1j * rise * (1 - across**2)) - 1
    return np.asarray(lines.half * (SHARES[:, None] * np.exp(-1j * (turn * u + curve * u * u)) * arc).sum(0))


def _reflection(ready: Bench, view: View, stuff: int, spots: Spots) -> Complexes:
    """Reflection coefficients (n) at the share of the fields that lies across the plane of incidence."""
    rows = ready.gamma[stuff, 0]
    places = np.minimum(abs(spots.cosine), 1.0) * (rows.shape[1] - 1)
    te, tm = (np.interp(places, np.arange(rows.shape[1]), row) for row in rows)
    share = np.mean([_across(field, way, spots.inward) for field, way in zip(view.fields, spots.ways, strict=True)], 0)
    return np.asarray(share * te + (1 - share) * tm)


def _across(field: Floats, ways: Floats, normals: Floats) -> Floats:
    """Share (n) of a field's power that is TE, for waves (n, 3) at faces with some normals (n, 3)."""
    side = np.cross(ways, normals)
    square = (side**2).sum(1) * (1 - (ways @ field) ** 2)
    return np.where(square < 1e-12, 0.5, np.minimum((side @ field) ** 2 / np.maximum(square, 1e-12), 1.0))
